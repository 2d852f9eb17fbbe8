"""Tables, figures and report: committed ones match their inputs, new ones follow theirs."""

import csv
import html
import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from designrl.bodies.walker import WALKER
from designrl.checkpoint import load, save
from designrl.evaluation import Evaluation
from designrl.experiments import EXPERIMENTS, get_experiment
from designrl.policy import Agent
from designrl.recording import read
from designrl.settings import TrainSettings
from designrl.train import TrainingRun
from reproduce import (
    build,
    drawing,
    figure4,
    figure5,
    publish,
    report,
    scores,
    statistics,
    table1,
    table2,
    table3,
)
from reproduce.scores import ROOT

ZOO = Path(os.environ.get("DESIGNRL_ZOO", ROOT / "../shared/zoo"))
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")


@pytest.fixture(autouse=True)
def no_zoo(monkeypatch):
    monkeypatch.delenv("ZOO", raising=False)


def random_agent(experiment: str, seed: int = 0) -> Agent:
    experiment = get_experiment(experiment)
    parameters = np.random.default_rng(seed).normal(0, 0.2, experiment.num_parameters)
    return Agent(experiment, parameters, metadata={"environment_steps": 1000})


def stub_scores(agent, episodes, seed, workers, progress):
    """Stands for an evaluation: scores that depend on the agent, at once."""
    first = abs(float(agent.parameters[0]))
    returns = 300 + 10 * np.random.default_rng(int(1e6 * first)).random(episodes)
    return Evaluation(agent.experiment.name, seed, returns, returns, agent.design, 0.0)


@pytest.fixture
def project(tmp_path, monkeypatch):
    """An empty project folder, where evaluations take no time."""
    (tmp_path / "paper").mkdir()
    shutil.copyfile(ROOT / "paper" / "paper.toml", tmp_path / "paper" / "paper.toml")
    monkeypatch.setattr(scores, "ROOT", tmp_path)
    monkeypatch.setattr(scores, "CACHE", tmp_path / ".cache" / "scores")
    monkeypatch.setattr(scores, "evaluate", stub_scores)
    return tmp_path


def pretrain(project, experiment: str, name: str = "seed0", seed: int = 0):
    path = project / "pretrained" / experiment / f"{name}.safetensors"
    path.parent.mkdir(parents=True, exist_ok=True)
    save(random_agent(experiment, seed), path)
    return path


# ------------------------------------------------------------------------------- what is committed


@pytest.mark.parametrize("name", build.ITEMS)
def test_committed_output_belongs_to_its_inputs(name):
    kept = json.loads(build.manifest(name).read_text())
    mend = f"run `make reproduce-{name}` (or `make reproduce`) and commit paper/"
    assert kept["inputs"] == build.inputs(build.load(name)), mend
    # Written beside the report but not committed: all its pictures once more, anew with every run.
    kept["outputs"].pop("paper/report.html", None)
    assert kept["outputs"] == build.hashes([ROOT / path for path in kept["outputs"]]), mend


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_committed_cards_say_what_their_runs_say(name, tmp_path, monkeypatch):
    with (ROOT / "paper" / "tables" / "table3.csv").open() as file:
        [row] = [row for row in csv.DictReader(file) if row["experiment"] == name]
    means, stds = (
        list(map(float, row[column].split())) for column in ("our_means", "our_stds_over_rollouts")
    )
    for path, mean, std in zip(scores.pretrained(name), means, stds, strict=True):
        # Returns of the mean and deviation that the table has, without a hundred episodes.
        returns = mean + std * np.repeat([-1.0, 1.0], scores.EPISODES // 2)
        monkeypatch.setattr(scores, "score", lambda *_, r=returns: scores.Score(Path(), returns=r))
        copy = tmp_path / path.name
        shutil.copyfile(path, copy)
        shutil.copyfile(path.with_suffix(".md"), copy.with_suffix(".md"))
        card, _ = publish.write_card(copy, scores.log_of(path))
        written = path.with_suffix(".md").read_text()
        assert card.read_text() == written, f"write the card of {path} again"


def test_committed_outputs_are_made_without_the_authors_weights():
    for name in build.ITEMS:
        kept = json.loads(build.manifest(name).read_text())
        assert not [path for path in kept["inputs"] if path.endswith(".json") and "/" not in path]


# ------------------------------------------------------------------------------------- dependency


def test_second_build_does_nothing_and_a_changed_checkpoint_rebuilds_what_reads_it(project):
    path = pretrain(project, "ant-morphology")
    assert build.make("table1") and build.make("figure2") and build.make("table2")
    assert [build.make(name) for name in ("table1", "figure2", "table2")] == [None] * 3
    save(random_agent("ant-morphology", seed=1), path)
    before = (project / "paper/tables/table1.csv").read_text()
    assert build.make("table1")
    assert (project / "paper/tables/table1.csv").read_text() != before
    assert [build.make(name) for name in ("table1", "figure2", "table2")] == [None] * 3


def test_new_checkpoint_and_lost_output_rebuild(project):
    assert build.make("table1")
    pretrain(project, "ant-morphology")
    assert build.make("table1")
    (project / "paper/tables/table1.tex").unlink()
    assert build.make("table1")


def test_stopped_build_leaves_whole_files_and_is_made_again(project, monkeypatch):
    assert build.make("table1")
    old = (project / "paper/tables/table1.tex").read_text()
    pretrain(project, "ant-morphology")
    from reproduce import tables

    real, count = tables.write_atomically, []

    def killed(path, data):
        count.append(path)
        if len(count) == 2:
            raise KeyboardInterrupt
        real(path, data)

    monkeypatch.setattr(tables, "write_atomically", killed)
    with pytest.raises(KeyboardInterrupt):
        build.make("table1")
    assert (project / "paper/tables/table1.tex").read_text() == old
    monkeypatch.setattr(tables, "write_atomically", real)
    assert build.make("table1")
    assert (project / "paper/tables/table1.tex").read_text() != old


def test_equal_inputs_give_equal_figures(project):
    build.make("figure2")
    files = sorted((project / "paper/figures").iterdir())
    first = [path.read_bytes() for path in files]
    build.make("figure2", always=True)
    assert [path.read_bytes() for path in files] == first


def test_unknown_item_is_named():
    with pytest.raises(SystemExit, match="table9"):
        build.main(["table9"])


# ----------------------------------------------------------------------------------------- tables


def test_unusable_checkpoints_are_named_and_the_rest_goes_on(project):
    pretrain(project, "biped")
    broken = pretrain(project, "biped-morphology")
    broken.write_bytes(broken.read_bytes()[:-5])
    shutil.copyfile(
        project / "pretrained/biped/seed0.safetensors",
        broken.with_name("seed1.safetensors"),
    )
    for name in ("table2", "table3", "table4", "statistics"):
        assert build.make(name)
    for name in ("table2", "table3", "table4"):
        text = (project / f"paper/tables/{name}.md").read_text()
        assert "pretrained/biped-morphology/seed0.safetensors is not a whole" in text
        assert "seed1.safetensors is of experiment biped, not biped-morphology" in text
        assert re.search(r"30\d", text), "the usable one is scored"
        assert str(project) not in text, "no path of this machine"


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_papers_summary_follows_from_its_runs(name):
    printed = scores.paper()
    mean, std = printed["table3"][name]
    runs = printed["table4"][name]
    assert np.mean(runs) == pytest.approx(mean, abs=1)  # printed runs are rounded
    assert table3.std_over_runs(runs) == pytest.approx(std, abs=0.2)


def test_table1_prints_the_papers_body_from_the_authors_weights(zoo_agent):
    printed = scores.paper()["table1"]
    shown = table1.percentages(zoo_agent("ant-morphology").design).round()
    assert shown.tolist() == [printed[part] for part in ("top", "middle", "bottom")]


def test_table2_prints_the_papers_legs_from_the_authors_weights(zoo_agent):
    for name in table2.WALKERS:
        printed = scores.paper()["table2"][name]
        s = scores.Score(ZOO, "", zoo_agent(name), np.zeros(100))
        cells, _ = table2.measured(["", "", ""], s)
        assert cells[4] == f"{printed['leg_area']}%"
        assert [float(cell) for cell in cells[5:]] == printed["dimensions"]


def test_zoo_adds_all_runs_that_are_there(project, monkeypatch, zoo_agent):
    zoo_agent("biped")  # skips without the author's weights
    clone = project / "clones" / "estool" / "zoo"
    (clone / "more" / "biped").mkdir(parents=True)
    shutil.copyfile(ZOO / "biped.json", clone / "biped.json")
    shutil.copyfile(ZOO / "biped.json", clone / "more" / "biped" / "biped.7.json")
    monkeypatch.setenv("ZOO", str(project / "clones"))
    assert build.make("table4")
    lines = (project / "paper/with-zoo/tables/table4.md").read_text().splitlines()
    row = next(line for line in lines if line.startswith("| (c) Biped ") and "author" in line)
    cells = [cell.strip() for cell in row.split("|")[3:-1]]
    assert [bool(cell) for cell in cells] == [i in (0, 6) for i in range(10)]
    assert not (project / "paper/tables").exists(), "the committed tables are without ZOO"


def test_wrong_zoo_says_what_was_looked_for(monkeypatch, tmp_path):
    monkeypatch.setenv("ZOO", str(tmp_path))
    with pytest.raises(SystemExit, match="looked in it.*robo_ant.json.*augmentbiped.json"):
        scores.zoo_argument()


# ------------------------------------------------------------------------------------- statistics


def test_probability_of_improvement_counts_ties_half():
    a, b = np.array([1.0, 2.0]), np.array([2.0, 3.0])
    assert statistics.probability_of_improvement(a, b) == (1 + 0.5 + 1 + 1) / 4


def test_interval_of_the_mean_covers_as_often_as_it_says():
    rng = np.random.default_rng(1)
    covered = 0
    for _ in range(100):
        low, high = statistics.mean_interval(rng.normal(5.0, 1.0, 30))
        covered += low <= 5.0 <= high
    assert 87 <= covered <= 99


def test_comparison_of_equal_runs_is_undecided_and_of_single_runs_has_no_interval():
    rng = np.random.default_rng(0)
    same = statistics.compare(rng.normal(size=10), rng.normal(size=10))
    assert statistics.verdict(same) == "undecided" and same["p"] > 0.05
    single = statistics.compare(np.array([1.0]), np.array([2.0]))
    assert np.isnan(single["p"]) and statistics.verdict(single) == "too few runs to tell"


def test_few_runs_are_dealt_out_in_all_ways():
    low, high = np.arange(3.0), np.arange(3.0) + 10
    assert statistics.permutation_p(low, high) == 2 / 20  # the two ways that part them wholly
    assert statistics.permutation_p(np.zeros(1), np.arange(1.0, 4)) == 2 / 4  # 0 or 3 alone
    assert statistics.permutation_p(low, low) == 1


@pytest.mark.parametrize(("runs", "said"), [(3, "undecided"), (4, "lower")])
def test_three_runs_against_three_decide_nothing(runs, said):
    without = np.arange(runs) + 10.0
    few = statistics.compare(without, without - 5.0)
    assert few["difference_high"] < 0, "the bootstrap alone would decide"
    assert statistics.verdict(few) == said


# ---------------------------------------------------------------------------------------- figures


def test_walk_scores_what_an_evaluation_scores():
    agent = random_agent("biped-morphology")
    from designrl.evaluation import evaluate

    [expected] = evaluate(agent, episodes=1, seed=0).scores
    seed = int(drawing.episode_seeds(0, 1)[0])
    w = drawing.walk(agent.experiment, agent.body, agent, seed)
    assert w.score == expected
    assert len(w.moments) == w.steps == len(w.x)


def test_strip_shows_moments_in_order_and_where_it_fell():
    body = [(np.zeros((3, 2)), (0, 0, 0), (0, 0, 0))]
    w = drawing.Walk(moments=[[(b[0] + i, *b[1:]) for b in body] for i in range(5)])
    w.x = [4.0, 5.0, 8.5, 9.0, 8.0]
    chosen = drawing.chosen_moments(w, start=2.0, span=36.0, spacing=4.0)
    assert [shapes[0][0][0, 0] for shapes in chosen] == [0, 2, 4]


def test_figure_without_a_checkpoint_shows_the_papers_design(project):
    assert len(figure4.main()) == 3
    svg = (project / "paper/figures/figure4.svg").read_text()
    assert "no checkpoint of ours yet" in svg
    body = drawing.resting_body("biped-morphology") * WALKER.design.originals
    assert np.allclose(body, scores.paper()["table2"]["biped-morphology"]["dimensions"], atol=0.1)


def test_learning_curve_is_the_recordings(project):
    folder = project / "logs" / "biped" / "seed0"
    settings = TrainSettings.of(
        "biped", generations=4, population=4, rollouts=1, evaluate_every=2
    )
    TrainingRun(settings, folder).run()
    c = figure5.curve(read(folder / "generations.mcap"))
    assert c.at[0].tolist() == [0, 1, 2, 3] and c.tested.tolist() == [1, 3]
    assert (np.diff(c.at[1:]) > 0).all() and c.episodes == "4"
    assert figure5.solved_at(c) is None
    assert build.make("figure5") and build.make("figure5") is None


# ------------------------------------------------------------------------------------- publishing


@pytest.fixture
def published(project):
    """A run's folder and the checkpoint that was published from it."""
    run = project / "runs" / "biped" / "seed0"
    settings = TrainSettings.of(
        "biped", generations=5, population=4, rollouts=((0, 1), (5, 2)), evaluate_every=2
    )
    TrainingRun(settings, run).run()
    publish.publish(run)
    return run, project / "pretrained" / "biped" / "seed0.safetensors"


def contents(project) -> dict[Path, bytes]:
    folders = (project / "pretrained", project / "logs")
    return {p: p.read_bytes() for f in folders for p in f.rglob("*") if p.is_file()}


def test_publishing_again_keeps_the_notes_and_gives_the_same_files(published, project):
    run, checkpoint = published
    card = checkpoint.with_suffix(".md")
    assert "| rollouts per candidate | 1 | 16 |" in card.read_text(), "5:2 was never reached"
    card.write_text(card.read_text() + "\n## Notes\nmine\n")
    before = contents(project)
    publish.publish(run)
    assert contents(project) == before


def test_the_rollout_between_is_half_way_up_not_half_way_through():
    class Evaluations:
        def array(self, topic, field):
            # An evaluation's generation is the last one before it.
            return np.array(
                {"generation": [9, 19, 29, 39], "mean": [0.0, 140.0, 290.0, 300.0]}[field]
            )

    rollouts = [Path(f"generation{g:05d}.mcap") for g in (10, 20, 30, 40)]
    assert publish.halfway(rollouts, Evaluations()) == rollouts[1]
    later = Path("generation00021.mcap")  # recorded after training
    assert publish.halfway([rollouts[0], later, *rollouts[2:]], Evaluations()) == later


@pytest.mark.parametrize("name", ["best.safetensors", "generations.mcap", "rollouts"])
def test_a_damaged_run_leaves_what_is_published(published, project, name):
    run, _ = published
    before = contents(project)
    if name == "rollouts":
        shutil.rmtree(run / name)
    else:
        (run / name).write_bytes((run / name).read_bytes()[:20])
    with pytest.raises(SystemExit, match=rf"publish: .*{name}"):
        publish.main([str(run)])
    assert contents(project) == before


def test_a_worse_run_is_published_only_when_asked(published, project):
    run, checkpoint = published
    better = load(checkpoint)
    better.metadata["score"] += 1
    save(better, checkpoint)
    before = contents(project)
    with pytest.raises(SystemExit, match="seed0.safetensors scored .* add --replace"):
        publish.main([str(run)])
    assert contents(project) == before
    publish.main([str(run), "--replace"])
    assert checkpoint.read_bytes() == (run / "best.safetensors").read_bytes()


# ----------------------------------------------------------------------------------------- report


def test_report_of_a_project_with_a_run(project):
    pretrain(project, "biped")
    for name in build.ITEMS:
        build.make(name)
    text = (project / "paper/report.md").read_text()
    assert "{{" not in text and str(project) not in text
    assert "[305](#origin-c)" in text, "numbers link to their origin"
    assert build.make("report") is None


@pytest.fixture
def page() -> str:
    """The committed report as one file of HTML."""
    return report.page((ROOT / "paper" / "report.md").read_text(), ROOT / "paper")


def test_report_is_one_file_whose_links_lead_somewhere(page):
    assert "<script" not in page
    assert all(source.startswith("data:image/") for source in re.findall(r'src="([^"]*)', page))
    ids = set(re.findall(r'id="([^"]+)"', page))
    for link in map(html.unescape, re.findall(r'href="([^"]+)"', page)):
        if link.startswith("#"):
            assert link[1:] in ids, link
        elif not link.startswith("https://"):
            file, _, anchor = link.partition("#")
            assert (ROOT / "paper" / file).exists(), link
            text = (ROOT / "paper" / file).read_text() if anchor else ""
            # A heading's anchor as GitHub makes it: small letters, hyphens, no other signs.
            assert anchor in re.sub(r"[^\w-]", "", re.sub(r"\s", "-", text.lower())), link
    for experiment in EXPERIMENTS.values():
        assert f"origin-{experiment.letter}" in ids


LOOK = """<!DOCTYPE html><body style="margin:0"><iframe id=f
 style="width:390px;height:800px;border:0"
srcdoc="{page}"></iframe><script>
let errors = [];
window.addEventListener('error', e => errors.push(String(e.message)));
document.getElementById('f').addEventListener('load', e => {{
  let d = e.target.contentDocument;
  let images = [...d.images];
  Promise.all(images.map(i => i.decode().then(() => 0, () => 1))).then(broken => {{
    document.body.innerText = 'SEEN' + JSON.stringify({{
      images: images.length, broken: broken.reduce((a, b) => a + b, 0), errors: errors,
      width: d.documentElement.scrollWidth, small: images.filter(i => i.width < 250).length}})
      + 'NEES';
  }});
}});
</script></body>"""


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (Debian: apt-get install chromium)")
def test_report_in_a_browser_at_phone_width(page, tmp_path):
    look = tmp_path / "look.html"
    look.write_text(LOOK.format(page=html.escape(page, quote=True)))
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000"]
    done = subprocess.run(
        [CHROMIUM, *options, f"--user-data-dir={tmp_path}/profile", "--dump-dom", look.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
    )
    found = re.search("SEEN(.*)NEES", html.unescape(done.stdout).rpartition("<body")[2])
    if found is None:
        pytest.skip(f"Chromium does not run here: {done.stderr[-300:]}")
    seen = json.loads(found[1])
    assert seen["images"] == len(report.CAPTIONS) and seen["broken"] == 0
    assert seen["errors"] == []
    assert seen["width"] <= 390, "the page does not scroll sideways"
    assert seen["small"] == 0
