"""Tables, figures and report: committed ones match their inputs, new ones follow theirs."""

import csv
import dataclasses
import itertools
import json
import re
import runpy
import shutil
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from designrl import author
from designrl.checkpoint import save
from designrl.cli import main
from designrl.engine import missing_reason
from designrl.errors import InputError
from designrl.evaluation import Evaluation, evaluate
from designrl.experiments import EXPERIMENTS, get_experiment
from designrl.files import file_hash, write_atomically
from designrl.names import load
from designrl.policy import Agent
from designrl.recording import read
from designrl.settings import TrainSettings
from designrl.train import TrainingRun
from reproduce import (
    build,
    curves,
    drawing,
    figure5,
    paths,
    publish,
    readme,
    report,
    runs,
    scores,
    statistics,
    studies,
    table1,
    table2,
    table3,
    tables,
    transfer,
)
from reproduce.paths import ROOT, paper, pretrained
from reproduce.sources import AT_PAPERS, Sources


def random_agent(experiment: str, seed: int = 0) -> Agent:
    experiment = get_experiment(experiment)
    parameters = np.random.default_rng(seed).normal(0, 0.2, experiment.num_parameters)
    return Agent(experiment, parameters, metadata={"environment_steps": 1000})


def stub_scores(agent, episodes, seed, *_):
    """Stands for an evaluation: scores that depend on the agent, at once."""
    first = abs(float(agent.parameters[0]))
    returns = 300 + 10 * np.random.default_rng(int(1e6 * first)).random(episodes)
    return Evaluation(agent.experiment.name, seed, returns, returns, agent.design, 0.0)


def empty_project(folder: Path, monkeypatch) -> Path:
    """A project's folder, where evaluations take no time and small runs are published."""
    (folder / "paper").mkdir()
    marks = f"{readme.ANSWERS}\nold\n{readme.ANSWERS_END}\n{readme.START}\nold\n{readme.END}"
    (folder / "README.md").write_text(f"# Results\n{marks}\nmore\n")
    for name in ("paper.toml", "author.csv"):
        shutil.copyfile(ROOT / "paper" / name, folder / "paper" / name)
    monkeypatch.setattr(paths, "ROOT", folder)
    monkeypatch.setattr(scores, "evaluate", stub_scores)
    monkeypatch.setattr(publish, "check_settings", lambda *_: None)
    return folder


@pytest.fixture
def project(tmp_path, monkeypatch):
    return empty_project(tmp_path, monkeypatch)


def pretrain(project, experiment: str, name: str = "seed0", seed: int = 0):
    path = project / "pretrained" / experiment / f"{name}.safetensors"
    path.parent.mkdir(parents=True, exist_ok=True)
    agent = random_agent(experiment, seed)
    agent.metadata["seed"] = paths.seed_of(name)
    save(agent, path)
    return path


# -------------------------------------------------------------------------------------- scores


def test_scores_of_the_engine_are_those_of_the_reference_or_none(project, monkeypatch):
    path = pretrain(project, "biped")
    monkeypatch.setattr(scores, "evaluate", evaluate)
    assert scores.score(path, "biped").backend == "engine"
    shutil.rmtree(project / ".cache")

    def wrong(*args):
        result = evaluate(*args)
        result.scores[20] += 1e-9
        return result

    monkeypatch.setattr(scores, "evaluate", wrong)
    with pytest.raises(InputError, match="seed0.safetensors: episode 20 of evaluation seed 0"):
        scores.score(path, "biped")
    assert not list((project / ".cache").rglob("*.json"))
    monkeypatch.setattr(scores, "evaluate", evaluate)
    assert scores.score(path, "biped", "reference").backend == "reference"


def test_what_the_reference_has_scored_is_kept_through_ctrl_c(project, monkeypatch):
    files = [(pretrain(project, "ant", f"seed{k}", seed=k), "ant") for k in range(2)]

    def stopped(agent, *arguments):
        if any(project.rglob(".cache/**/*.json")):
            raise KeyboardInterrupt
        return stub_scores(agent, *arguments)

    monkeypatch.setattr(scores, "evaluate", stopped)
    with pytest.raises(KeyboardInterrupt):
        scores.score_all(files)
    monkeypatch.setattr(scores, "evaluate", stub_scores)
    first, second = scores.score_all(files)
    assert (first.backend, second.backend) == ("", "reference")


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (KeyboardInterrupt(), "stopped; the same command goes on"),
        (InputError("x.mcap is empty; train again"), "x.mcap is empty; train again"),
        (OSError(28, "No space left on device", "table1.md"), "[Errno 28] No space left on device"),
    ],
)
@pytest.mark.parametrize(("module", "name"), [("build", "reproduce"), ("gallery", "gallery")])
def test_a_command_that_is_stopped_ends_with_a_sentence(
    project, monkeypatch, module, name, error, said
):
    def stopped(*_):
        raise error

    for used in ("folder", "representative"):
        monkeypatch.setattr(Sources, used, property(stopped))
    monkeypatch.setattr(sys, "argv", [module])
    monkeypatch.delitem(sys.modules, f"reproduce.{module}", raising=False)
    with pytest.raises(SystemExit) as end:
        runpy.run_module(f"reproduce.{module}", run_name="__main__")
    assert end.value.code.startswith(f"{name}: {said}")


@pytest.mark.parametrize(
    "change",
    [
        lambda kept, other: kept | {"returns": kept["returns"][:3]},
        lambda kept, other: kept | {"returns": [float("nan")] * 100},
        lambda kept, other: kept | {"returns": [9000.0, *kept["returns"][1:]]},
        lambda kept, other: other,
        lambda kept, other: {},
    ],
)
def test_a_kept_score_that_is_not_what_was_kept_is_played_again(project, capsys, change):
    files = [(pretrain(project, "biped", f"seed{k}", seed=k), "biped") for k in range(2)]
    entry, other = (scores.kept_at(scores.depends_on(s, "engine")) for s in scores.score_all(files))
    before = entry.read_text()
    entry.write_text(json.dumps(change(json.loads(before), json.loads(other.read_text()))))
    scores.score_all(files)
    assert entry.read_text() == before
    said = f"{paths.shown(entry)} is not what was kept there; pretrained/biped/seed0.safetensors is"
    assert capsys.readouterr().err.count(said) == 1


# ------------------------------------------------------------------------------- what is committed


@pytest.mark.parametrize("name", build.ITEMS)
def test_committed_output_belongs_to_its_inputs(name):
    kept = json.loads(build.manifest(name).read_text())
    mend = f"run `make reproduce-{name}` (or `make reproduce`) and commit paper/"
    assert kept["inputs"] == build.hashes(build.reads(build.load(name))), mend
    assert kept["outputs"] == build.hashes(ROOT / path for path in kept["outputs"]), mend


def committed(table: str) -> list[dict]:
    with (ROOT / "paper" / f"{table}.csv").open() as file:
        return list(csv.DictReader(file))


OURS = {r["sha256"]: r for r in committed("tables/table4") if r["source"].startswith("ours")}


def digits(mean, std) -> str:
    return f"{float(mean):.4f} ± {float(std):.4f}"


@pytest.mark.parametrize("name", table2.WALKERS)
def test_walkers_score_what_the_committed_table_says(name):
    path = pretrained(name)[-1]
    row = OURS[file_hash(path)]
    found = evaluate(load(path), scores.EPISODES, scores.SEED, backend="engine").scores
    assert digits(found.mean(), found.std()) == digits(row["mean"], row["std"])


def test_the_authors_walker_scores_what_the_committed_table_says(author_agent):
    [row] = [row for row in committed("author") if row["experiment"] == "biped-hardcore"]
    agent = author_agent("biped-hardcore")
    found = evaluate(agent, int(row["episodes"]), int(row["seed"]), backend="engine").scores
    assert digits(found.mean(), found.std()) == digits(row["mean"], row["std"])
    assert row["sha256"] == agent.metadata["source_sha256"]


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_committed_cards_say_what_their_checkpoints_score(name):
    for path in pretrained(name):
        card, row = path.with_suffix(".md").read_text(), OURS[file_hash(path)]
        assert f"sha256 {row['sha256']}" in card
        assert f"**Score** {float(row['mean']):.1f} ± {float(row['std']):.1f} over 100" in card


def test_readme_has_the_committed_results():
    text = (ROOT / "README.md").read_text()
    for start, content, end in (
        (readme.ANSWERS, readme.answers(), readme.ANSWERS_END),
        (readme.START, readme.table(), readme.END),
    ):
        assert f"{start}\n{content}\n{end}" in text, "run `make reproduce-readme`"


@pytest.mark.parametrize(
    "name",
    ["ant", "ant-morphology", "biped", "biped-morphology", "biped-morphology-smaller-leg"],
)
def test_one_run_has_many_distributions_and_its_whole_rollout(name):
    log = ROOT / "logs" / name / publish.most_recorded(get_experiment(name))
    assert read(log).topics["/distribution"] == publish.DISTRIBUTIONS
    [rollout] = log.glob("rollouts/*.mcap")
    assert read(rollout).topics["/action"] > 500


# ------------------------------------------------------------------------------------- dependency


def test_whatever_an_item_needs_makes_it_again_when_it_changes(project, monkeypatch):
    assert build.make("table1") and build.make("figure2") and build.make("table2")
    pretrain(project, "ant-morphology")
    assert build.make("table1")
    (project / "paper/tables/table1.tex").unlink()
    assert build.make("table1")
    assert [build.make(name) for name in ("table1", "figure2", "table2")] == [None] * 3
    pretrain(project, "ant-morphology", seed=1)
    before = (project / "paper/tables/table1.csv").read_text()
    assert build.make("table1")
    assert (project / "paper/tables/table1.csv").read_text() != before
    assert [build.make(name) for name in ("table1", "figure2", "table2")] == [None] * 3
    reference = Sources(backend="reference")
    assert build.make("table1", reference) and build.make("table1", reference) is None


def test_stopped_build_leaves_whole_files_and_is_made_again(project, monkeypatch):
    assert build.make("table1")
    old = (project / "paper/tables/table1.tex").read_text()
    pretrain(project, "ant-morphology")

    def killed(path, data):
        if path.suffix == ".tex":
            raise KeyboardInterrupt
        write_atomically(path, data)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(tables, "write_atomically", killed)
        build.make("table1")
    assert (project / "paper/tables/table1.tex").read_text() == old
    assert build.make("table1")
    assert (project / "paper/tables/table1.tex").read_text() != old


def test_other_code_makes_an_item_again_and_equal_inputs_give_equal_files(project, monkeypatch):
    build.make("figure2")
    files = [build.manifest("figure2"), *(project / "paper/figures").iterdir()]
    before = [path.read_bytes() for path in files]
    monkeypatch.setattr(build, "sources_hash", lambda: "other")
    assert build.make("figure2") and build.make("figure2") is None
    build.manifest("figure2").unlink()
    assert build.make("figure2")
    assert [path.read_bytes() for path in files] == before


def test_a_layout_that_differs_in_its_last_bits_gives_the_same_files(project):
    """Matplotlib's layouts depend on addresses, and clip paths are named by what comes out."""

    def files(shift):
        figure = Figure()
        axes = figure.add_axes((0.1 + shift, 0.1, 0.8, 0.8))
        axes.plot([0, 1])
        axes.add_patch(Circle((0.5, 0.5), 0.2))
        return [path.read_bytes() for path in drawing.save(project, "figure", figure)]

    assert files(0.0) == files(1e-15)


def test_readme_table_is_put_between_its_marks(project):
    pretrain(project, "biped")
    build.make("table3")
    assert build.make("readme") and build.make("readme") is None
    text = (project / "README.md").read_text()
    assert text.startswith("# Results\n") and text.endswith(f"{readme.END}\nmore\n")
    assert "| (c) | Biped " in text and "| 345 ± 1.3 " in text and "| 305 ± 2.9 *" in text
    assert "Flat ground: not known" in text
    (project / "README.md").write_text(text.replace("345", "999"))
    assert build.make("readme") and (project / "README.md").read_text() == text


def test_a_table_that_is_not_as_it_was_made_is_made_again_before_it_is_shown(project, capsys):
    pretrain(project, "biped")
    build.make("table3")
    table = project / "paper/tables/table3.csv"
    before = table.read_text()
    table.write_text(before.replace("345", "999"))
    build.make("readme")
    assert "readme reads what `make reproduce-table3` makes" in capsys.readouterr().err
    assert table.read_text() == before and "999" not in (project / "README.md").read_text()


def test_unknown_item_is_named():
    with pytest.raises(SystemExit, match="table9"):
        build.main(["table9"])


# ----------------------------------------------------------------------------------------- tables


def test_table3_explains_its_mark_of_a_single_run_where_it_has_one(project):
    build.make("table3")
    table = project / "paper/tables/table3.md"
    assert "*: one run" not in table.read_text()
    pretrain(project, "biped")
    build.make("table3")
    assert "*: one run" in table.read_text()


def row_of(project, table: str, start: str) -> list[str]:
    """The cells of a table's first row that starts so."""
    lines = (project / f"paper/tables/{table}.md").read_text().splitlines()
    line = next(line for line in lines if line.startswith(f"| {start}"))
    return [cell.strip() for cell in line.split("|")[1:-1]]


def test_runs_at_the_papers_settings_have_a_column_and_come_first_when_they_are_five(project):
    hardcore = "biped-hardcore-morphology"
    pretrain(project, hardcore)
    build.make("table3")
    assert row_of(project, "table3", "(g)")[5] == "–"
    for seed in range(5):
        pretrain(project, hardcore, f"paper-seed{seed}", seed + 1)
        build.make("table3")
        _, _, _, recipe, count, papers, said = row_of(project, "table3", "(g)")
        assert count == "1" and recipe.endswith("*") and papers.endswith(f"({seed + 1})")
        assert said.startswith("with the paper's settings") == (seed == 4)
    build.make("table4")
    first, second = (
        [
            row
            for row in csv.DictReader((project / "paper/tables/table4.csv").open())
            if row["experiment"] == hardcore and row["source"].startswith("ours")
        ][i]
        for i in (0, -1)
    )
    assert (first["source"], first["seed"]) == (AT_PAPERS, "0")
    assert second["source"] == "ours"
    for path in (project / "pretrained" / hardcore).glob("seed*"):
        path.unlink()  # the recipe's leave once there are as many
    for name in ("table1", "table2", "table3", "table4", "statistics", "readme"):
        assert build.make(name), name
    assert row_of(project, "table3", "(g)")[3] == "-"
    assert "| –" in (project / "README.md").read_text()


def test_statistics_at_the_papers_settings_need_two_runs_of_both(project):
    for seed in range(3):
        pretrain(project, "biped-hardcore-morphology", f"paper-seed{seed}", seed)
    pretrain(project, "biped-hardcore", "paper-seed1", 9)
    build.make("statistics")
    text = (project / "paper/tables/statistics.md").read_text()
    assert "(g) over (f): 3 and 1" in text and AT_PAPERS not in text
    pretrain(project, "biped-hardcore", "paper-seed2", 8)
    build.make("statistics")
    text = (project / "paper/tables/statistics.md").read_text()
    assert "(g) over (f): 3" not in text
    [line] = [line for line in text.splitlines() if AT_PAPERS in line]
    assert line.startswith("| (g) over (f)") and " 3, 2 " in line


def test_a_single_items_tables_come_last_without_hashes(project, capsys):
    path = pretrain(project, "biped")
    for _ in range(2):  # made, and up to date
        build.main(["table3"])
        out = capsys.readouterr().out
        assert out.rstrip().splitlines()[-1].startswith("The report: paper/report.md")
        assert out.startswith("table3: ") and out.count("| (c) | Biped ") == 1
        assert file_hash(path)[:16] not in out
    assert file_hash(path)[:16] in (project / "paper/tables/table3.md").read_text()


def test_tables_have_the_papers_experiments_whatever_else_is_registered(project, monkeypatch):
    mine = dataclasses.replace(EXPERIMENTS["biped"], name="my-biped")
    monkeypatch.setitem(EXPERIMENTS, mine.name, mine)
    assert all(build.make(name) for name in ("table3", "table4", "statistics"))


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
    printed = paper()
    mean, std = printed["table3"][name]
    runs = printed["table4"][name]
    assert np.mean(runs) == pytest.approx(mean, abs=1)  # printed runs are rounded
    assert table3.std_over_runs(runs) == pytest.approx(std, abs=0.2)


def test_tables_print_the_papers_bodies_from_the_authors_weights(author_agent):
    shown = table1.percentages(author_agent("ant-morphology").design).round()
    printed = paper()["table1"]
    assert shown.tolist() == [printed[part] for part in ("top", "middle", "bottom")]
    for name in table2.WALKERS:
        printed = paper()["table2"][name]
        area, sizes = table2.legs(author_agent(name).scales)
        assert round(area) == printed["leg_area"]
        assert round(area, 1) == paper()["leg_areas"].get(name, [100.0])[0]
        assert sizes.round(1).tolist() == printed["dimensions"]


def test_cells_lead_to_where_their_numbers_come_from():
    ours = tables.row(["(f)"], "ours, seed 0", ["281", ""], "biped-hardcore")
    assert list(map(report.linked, ours)) == ["(f)", "ours, seed 0", "[281](#origin-f)", ""]
    paper = tables.row(["(f)"], tables.PAPER, ["300", ""], "biped-hardcore")
    assert list(map(report.linked, paper)) == ["(f)", "[paper](paper.toml)", "300", ""]
    table = tables.Table("t", "T", ["", "", "", ""], [ours, None, paper], [], [{}])
    assert "[" not in table.markdown() + table.latex()


def test_zoo_adds_all_runs_that_are_there(project, author_agent):
    author_agent("biped")  # skips without the author's weights
    clone = project / "clones" / "estool" / "zoo"
    (clone / "more" / "biped").mkdir(parents=True)
    for name in ("biped.json", "more/biped/biped.7.json"):
        shutil.copyfile(author.file_of(author.zoo(), "biped"), clone / name)
    assert build.make("table4", Sources(str(project / "clones")))
    lines = (project / "paper/with-zoo/tables/table4.md").read_text().splitlines()
    row = next(line for line in lines if line.startswith("| (c) Biped ") and "author" in line)
    cells = [cell.strip() for cell in row.split("|")[3:-1]]
    assert [bool(cell) for cell in cells] == [i in (0, 6) for i in range(10)]
    assert not (project / "paper/tables").exists(), "the committed tables are without ZOO"


def test_wrong_zoo_says_what_was_looked_for(monkeypatch, tmp_path):
    monkeypatch.setenv("ZOO", str(tmp_path))
    with pytest.raises(InputError, match="looked in it.*robo_ant.json.*augmentbiped.json"):
        Sources.asked()


# ------------------------------------------------------------------------------------- statistics


def test_probability_of_improvement_counts_ties_half():
    a, b = np.array([1.0, 2.0]), np.array([2.0, 3.0])
    assert statistics.compare(a, b)["probability"] == (1 + 0.5 + 1 + 1) / 4


def test_of_few_runs_every_resample_is_counted_as_often_as_it_comes():
    values = np.array([1.0, 5.0, 6.0, 11.0])
    all_of_them = [np.mean(drawn) for drawn in itertools.product(values, repeat=4)]
    limits = np.percentile(all_of_them, statistics.LEVEL, method="inverted_cdf")
    assert statistics.mean_interval(values) == pytest.approx(tuple(limits))


def test_intervals_of_three_runs_against_five_are_exact():
    """As (f) and (g) had them: 20,000 drawn pairs gave 1/15 in place of 2/15."""
    original, learned = np.array([288, 263, 296]), np.array([316, 275, 252, 312, 265])
    found = statistics.compare(original, learned)
    assert found["probability_low"] == pytest.approx(2 / 15)
    assert found["probability_high"] == pytest.approx(14 / 15)


def test_many_runs_are_drawn_and_agree_with_all_resamples(monkeypatch):
    values = np.random.default_rng(3).normal(size=6)
    exact = statistics.compare(values, values + 1)
    monkeypatch.setattr(statistics, "EXACT", 0)
    drawn = statistics.compare(values, values + 1)
    for name in ("difference_low", "difference_high", "probability_low", "probability_high"):
        assert drawn[name] == pytest.approx(exact[name], abs=0.05)


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
    evaluation = evaluate(agent, episodes=1, seed=0)
    seed = int(drawing.episode_seeds(0, 1)[0])
    w = drawing.walk(agent, seed)
    assert w.score == evaluation.scores[0]
    assert len(w.moments) == len(w.x) == evaluation.steps[0] + 1


def test_strip_shows_moments_in_order_and_where_it_fell():
    body = [(np.zeros((3, 2)), (0, 0, 0), (0, 0, 0))]
    w = drawing.Walk(moments=[[(b[0] + i, *b[1:]) for b in body] for i in range(5)])
    w.x = [4.0, 5.0, 8.5, 9.0, 8.0]
    chosen = drawing.chosen_moments(w, spacing=4.0)
    assert [shapes[0][0][0, 0] for shapes in chosen] == [0, 2, 4]


@pytest.fixture(scope="module")
def short_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "seed0"
    settings = TrainSettings.of("biped", generations=5, population=4, rollouts=1, evaluate_every=2)
    TrainingRun(settings, folder).run()
    return folder


@pytest.fixture
def trained(short_run, project):
    """The folder of a short run."""
    return shutil.copytree(short_run, project / "runs" / "biped" / "seed0")


def test_learning_curve_is_the_recordings(trained, project):
    path = project / "logs" / "biped" / "seed0" / "generations.mcap"
    path.parent.mkdir(parents=True)
    shutil.copyfile(trained / "generations.mcap", path)
    run = runs.read_published(path)
    assert run.generation.tolist() == [0, 1, 2, 3, 4] and run.tested.tolist() == [1, 3, 4]
    assert (np.diff(run.steps) > 0).all() and (np.diff(run.core_hours) > 0).all()
    assert read(path).array("/evaluation", "scores").shape == (3, 4)
    assert run.solved_at() is None
    assert build.make("figure5") and build.make("figure5") is None
    assert build.make("curves")
    panels = curves.curves(("biped", "ant")).axes
    labels = tuple(panel.get_xlabel() for panel in panels[len(panels) // 2 :])
    assert labels == curves.AXES


def record(path: Path, experiment: str, seed: int = 0) -> None:
    """A short training's recording."""
    small = {"generations": 4, "population": 4, "rollouts": 1, "evaluate_every": 2}
    TrainingRun(TrainSettings.of(experiment, seed=seed, **small), path.parent).run()


def test_figure5_draws_published_runs_and_marks_those_that_are_unfinished(project):
    learned = "biped-hardcore-morphology"
    published = project / f"logs/{learned}/paper-seed1"
    record(published / "generations.mcap", learned, seed=1)
    shutil.copytree(published, project / f"logs/unfinished/{learned}/paper-seed1")
    left, right = figure5.figures(Sources())["figure5"].axes
    marks = [line.get_marker() for line in right.lines]
    texts = right.get_legend_handles_labels()[1]
    assert "o" not in marks and "ours, learned body: 1 run" in texts, "one of them is published"
    assert "ours, original body: no run yet" in texts
    record(project / f"logs/unfinished/{learned}/paper-seed2/generations.mcap", learned, seed=2)
    left, right = figure5.figures(Sources())["figure5"].axes
    assert [line.get_marker() for line in right.lines].count("o") == 1
    assert "ours, learned body: 2 runs (1 unfinished)" in right.get_legend_handles_labels()[1]
    [run] = map(runs.read_published, figure5.recorded(learned)[1:])
    drawn = [line.get_ydata().tolist() for line in left.lines]
    assert (run.mean - 100).tolist() in drawn, "less 100, as in the paper's"


def test_the_authors_log_is_compared_with_the_range_of_our_runs(project):
    assert studies.author_log_answer() == "There is no run with his settings yet."
    for seed in range(2):
        target = project / f"logs/studies/biped-author-settings/seed{seed}/generations.mcap"
        target.parent.mkdir(parents=True)
        shutil.copyfile(ROOT / target.relative_to(project), target)
    said = studies.author_log_answer()
    within = r"\d+ of the 33 points of his log that our runs reach lie within the range of our 2; "
    assert re.match(within, said)
    assert studies.listed(np.array([50, 600, 650, 700])) == "50, 600 to 700"


def test_committed_falls_are_of_the_agents_that_are_here():
    counted = {row["sha256"] for row in studies.fall_rows() if row["run"] != studies.AUTHOR}
    assert counted == {file_hash(path) for name in studies.HARDCORE for path in pretrained(name)}


@pytest.mark.parametrize("place", ["biped-hardcore/seed0", "biped/seed1", "biped/paper-seed2"])
def test_what_is_of_another_run_than_its_name_says_is_not_used(trained, project, place):
    experiment, name = place.split("/")
    checkpoint = project / "pretrained" / f"{place}.safetensors"
    recording = paths.recording_of(checkpoint)
    for path, file in ((checkpoint, "best.safetensors"), (recording, "generations.mcap")):
        path.parent.mkdir(parents=True)
        shutil.copyfile(trained / file, path)
    assert f"{name}.safetensors is of " in scores.score(checkpoint, experiment).problem
    with pytest.raises(InputError, match=f"is of biped, seed 0, not of {experiment}, seed .; put"):
        curves.curves((experiment,))


# ------------------------------------------------------------------------------------- publishing


@pytest.fixture(scope="module")
def publication(short_run, tmp_path_factory):
    """A project's folder with a short run and what was published from it."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        folder = empty_project(tmp_path_factory.mktemp("project"), monkeypatch)
        publish.publish(shutil.copytree(short_run, folder / "runs/biped/seed0"), "seed0")
    return folder


@pytest.fixture
def published_run(publication, project):
    """A run's folder and the checkpoint that was published from it."""
    shutil.copytree(publication, project, dirs_exist_ok=True)
    return project / "runs/biped/seed0", project / "pretrained/biped/seed0.safetensors"


def contents(project) -> dict[Path, bytes]:
    folders = (project / "pretrained", project / "logs")
    return {p: p.read_bytes() for f in folders for p in f.rglob("*") if p.is_file()}


def test_what_is_published_and_publishing_again_gives_the_same_files(published_run, project):
    run, checkpoint = published_run
    before = contents(project)
    files = sorted(str(path.relative_to(project)) for path in before)
    rollout = (
        f"logs/biped/seed0/rollouts/generation{load(checkpoint).metadata['generation']:05d}.mcap"
    )
    card_and_curve = [f"pretrained/biped/seed0.{kind}" for kind in ("md", "png", "safetensors")]
    made = ["logs/biped/seed0/generations.mcap", rollout, *card_and_curve]
    assert files == [*made, "pretrained/index.json"]
    card = checkpoint.with_suffix(".md").read_text()
    assert "designrl train biped --recipe paper --seed 0 --generations 5" in card
    assert f"sha256 {file_hash(checkpoint)}" in card and str(project) not in card
    publish.publish(run, "seed0")
    assert contents(project) == before


def test_card_says_the_body_that_was_found():
    agent, returns = random_agent("ant-morphology"), np.arange(100.0)
    agent.metadata |= {"seed": 0, "generation": 1, "score": 1.0, "score_episodes": 4}
    agent.metadata["settings"] = TrainSettings.of("ant-morphology").as_dict()
    s = scores.Score(Path("seed0.safetensors"), "", agent, returns)
    one = np.ones(1)
    run = runs.Run(0, False, "a machine", one, one, one, 2 * one, one, one, one, one)
    card = publish.card(s, run)
    assert "2.00 core-hours" in card
    assert re.search(r"\| front left top +\| \d+ % \(0.\d+\)", card)
    assert card.count(" % (") == 36 and len(card.splitlines()) < 40, "it fits a screen"


@pytest.mark.parametrize("name", ["best.safetensors", "generations.mcap"])
def test_a_damaged_run_leaves_what_is_published(published_run, project, name):
    run, _ = published_run
    before = contents(project)
    (run / name).write_bytes((run / name).read_bytes()[:20])
    with pytest.raises(InputError, match=name):
        publish.publish(run, "seed0")
    assert contents(project) == before


@pytest.mark.parametrize("name", ["thin", "record_rollout", "write_atomically"])
def test_a_publication_that_fails_leaves_what_is_published(published_run, project, name):
    run, _ = published_run
    before = contents(project)

    def fail(*_, **__):
        raise InputError("the disk is full")

    with pytest.MonkeyPatch.context() as patch, pytest.raises(InputError, match="is full"):
        patch.setattr(publish, name, fail)
        publish.publish(run, "seed0")
    assert contents(project) == before


def test_a_run_that_is_not_at_its_end_is_not_published(project):
    def stop(generation):
        if generation.index == 2:
            raise KeyboardInterrupt

    settings = TrainSettings.of("biped", generations=4, population=4, rollouts=1, evaluate_every=2)
    with pytest.raises(KeyboardInterrupt):
        TrainingRun(settings, project / "run", on_generation=stop).run()
    with pytest.raises(InputError, match="has 3 of 4 generations; train the rest"):
        publish.publish(project / "run", "paper-seed0")
    assert not contents(project)


@pytest.mark.parametrize("what", ["pretrained", "logs"])
def test_anothers_run_is_never_touched(published_run, project, what, capsys):
    run, checkpoint = published_run
    if what == "logs":
        checkpoint.unlink()
    else:
        other = load(checkpoint)
        other.metadata["score"] += 1
        save(other, checkpoint)
    before = contents(project)
    with pytest.raises(SystemExit):
        main(["publish", str(run), "--name", "seed0"])
    assert f"/{what}/biped/seed0" in (err := capsys.readouterr().err) and "which stays" in err
    assert contents(project) == before
    publish.publish(run, "seed0", replace=True)
    assert checkpoint.read_bytes() == (run / "best.safetensors").read_bytes()


def test_a_run_is_published_under_the_name_of_its_seed(trained, project):
    for name in ("seed1", "mine", "../seed0"):
        with pytest.raises(InputError, match="by its seed it is seed0 or paper-seed0"):
            publish.publish(trained, name)
    assert not contents(project)
    main(["publish", str(trained), "--name", "paper-seed0"])
    assert (project / "pretrained" / "biped" / "paper-seed0.safetensors").exists()


@pytest.mark.parametrize(
    ("name", "recipe", "changes", "wrong"),
    [
        ("seed0", "ours", {}, None),
        ("seed0", "ours", {"generations": 2}, "generations = 5000, by the recipe 'ours', .* 2"),
        ("seed0", "paper", {}, "by the recipe 'ours', and this one has"),
        ("paper-seed0", "paper", {}, None),
        ("paper-seed0", "paper", {"generations": 1}, "generations = 5000, by the recipe 'paper'"),
        ("paper-seed0", "paper", {"init": "biped-morphology/seed0"}, "init = None"),
        ("paper-seed0", "paper", {"reward_weights": {"energy": 2.0}}, "reward_weights = None"),
        ("blooper-seed0", "ours", {"design_form": "lognormal"}, None),
        ("blooper-seed0", "ours", {"design_limit": 0.5, "generations": 3}, "generations = 5000"),
    ],
)
def test_a_run_is_published_with_the_settings_of_its_name(name, recipe, changes, wrong):
    settings = TrainSettings.of("biped-morphology", recipe, **changes)
    with pytest.raises(InputError, match=wrong) if wrong else nullcontext():
        publish.check_name(name, Path("run"), settings)


def test_a_run_with_other_limits_is_a_blooper_and_in_no_table(project, monkeypatch):
    small = {"generations": 3, "population": 4, "rollouts": 1, "evaluate_every": 2}
    settings = TrainSettings.of("biped-morphology", design_form="lognormal", **small)
    TrainingRun(settings, project / "run").run()
    with pytest.raises(InputError, match="by its seed and its limits it is blooper-seed0"):
        publish.publish(project / "run", "seed0")
    monkeypatch.setattr(scores, "evaluate", evaluate)  # and the reference agrees on its limits
    publish.publish(project / "run", "blooper-seed0")
    assert not paths.pretrained("biped-morphology") and not paths.recordings("biped-morphology")
    [path] = paths.bloopers()
    assert "--design-form lognormal" in path.with_suffix(".md").read_text()
    run, s = runs.read_published(paths.recording_of(path)), scores.score(path, "biped-morphology")
    texts = publish.learning_curve(run, s).axes[1].get_legend_handles_labels()[1]
    assert not any("the paper" in text for text in texts), "that has other bodies"
    assert "biped-morphology/blooper-seed0" in publish.published_scores()


def test_an_index_that_names_another_experiment_leaves_what_is_published(published_run, project):
    run, _ = published_run
    index = project / "pretrained/index.json"
    index.write_text(json.dumps(json.loads(index.read_text()) | {"hopper/seed0": {}}))
    before = contents(project)
    with pytest.raises(InputError, match="index.json names hopper/seed0, .*; take it out"):
        publish.publish(run, "seed0")
    assert contents(project) == before


# ----------------------------------------------------------------------------------------- report


def test_report_of_a_project_with_a_run(project, capsys):
    for experiment in ("biped", "biped-hardcore"):
        pretrain(project, experiment)
        record(project / "logs" / experiment / "seed0/generations.mcap", experiment)
    for name in build.ITEMS:
        build.make(name)
    text = (project / "paper/report.md").read_text()
    assert "The 2 runs of Table 3 took 0 core-hours" in text
    assert re.search(r"\(f\) Biped Hardcore, seed 0\]\(#origin-f\) +\| 4 \(10,000\)", text)
    assert "{{" not in text and str(project) not in text
    assert "[305](#origin-c)" in text, "numbers link to their origin"
    assert build.make("report") is None
    for name in ("figure3", "figure4"):
        assert "no checkpoint yet" in (project / f"paper/figures/{name}.svg").read_text()
    pretrain(project, "biped-morphology")
    assert build.make("report"), "and what it shows"
    assert "report reads what `make reproduce-figure4` makes" in capsys.readouterr().err
    assert "no checkpoint yet" not in (project / "paper/figures/figure4.svg").read_text()


# ------------------------------------------------------------------------------------- PPO's curves


NO_ENGINE = "import designrl.engine as e; e._load = lambda: 'the engine is not there'; "


def write_curve(folder, task, body, seed, text):
    path = folder / "paper/transfer" / task / body / f"seed{seed}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_ppos_figure_shows_each_seed_their_mean_and_its_interval(project):
    for seed, last in enumerate((100, 200, 300)):
        text = f"# origin\nsteps,mean,sd,episodes\n0,-100,1,5\n1000000,{last},1,5\n"
        write_curve(project, "flat", "learned", seed, text)
    flat, hardcore = transfer.figures(Sources())["transfer"].axes
    assert [line.get_ydata().tolist() for line in flat.lines[:4]] == [
        *([-100, last] for last in (100, 200, 300)),
        [-100, 200],
    ]
    band = flat.collections[0].get_paths()[0].vertices
    assert band[band[:, 0] == 1, 1].min() < 200 < band[band[:, 0] == 1, 1].max()
    assert flat.get_legend_handles_labels()[1] == ["learned body (3 seeds)"]
    assert hardcore.get_title("left") == "Hardcore: no curve yet"


def test_ppos_answer_compares_the_bodies_at_the_end_and_over_the_training(project):
    for body, last in (("original", 100), ("learned", 300)):
        for seed in range(4):
            text = f"steps,mean\n0,-100\n1000000,{last + seed}\n"
            write_curve(project, "flat", body, seed, text)
    flat, hardcore = transfer.answer().splitlines()
    end, average = flat.split("; ")
    assert "at the end 302 points on the learned body, 102 on the original: +200 [" in end
    assert "101 points on the learned body, 1 on the original: +100 [" in average
    assert flat.endswith("(higher, p = 0.029).")
    assert hardcore == "- Hardcore: no curves of both bodies yet."


@pytest.mark.parametrize(
    "text, message",
    [
        ("steps,mean\n0,1\n7,2\n", "has other steps than .*original/seed0.csv; train both"),
        ("steps,mean\n0,high\n", "is not a curve of train_ppo.py"),
        ("a,b\n0,1\n", "is not a curve of train_ppo.py"),
    ],
)
def test_curves_that_do_not_fit_are_named(project, text, message):
    write_curve(project, "flat", "original", 0, "steps,mean\n0,1\n5,2\n")
    write_curve(project, "flat", "original", 1, text)
    with pytest.raises(InputError, match=f"seed1.csv {message}"):
        transfer.figures(Sources())


@pytest.mark.skipif(missing_reason() is not None, reason=str(missing_reason()))
def test_ppo_writes_a_curve_that_the_figure_reads(project, monkeypatch, capsys):
    from reproduce import train_ppo  # with Stable-Baselines3

    body = pretrain(project, "biped-hardcore-morphology")
    out = project / "paper/transfer/hardcore/learned/seed3.csv"
    command = [sys.executable, "-m", "reproduce.train_ppo", "--hardcore", "--seed", "3", "--design"]
    command += [body, "--steps", "256", "--episodes", "4", "--out", out]
    said = {"cwd": ROOT, "capture_output": True, "text": True, "timeout": 1800}
    subprocess.run(command, check=True, **said)
    steps, means = transfer.read_curves([out])
    assert steps.tolist() == [0, 256] and np.isfinite(means).all()
    assert file_hash(body) in out.read_text()
    transfer.figures(Sources())
    for change in ({body: out}, {body: pretrain(project, "ant")}, {out: project}):
        changed = [change.get(word, word) for word in command]
        monkeypatch.setattr(sys, "argv", ["train_ppo", *map(str, changed[3:])])
        with pytest.raises(SystemExit, match="2"):
            train_ppo.main()
        assert "train_ppo: error: " in capsys.readouterr().err


@pytest.mark.parametrize("before", ["", NO_ENGINE])
def test_ppos_example_runs_on_the_engine_and_without_it(before):
    code = (ROOT / "examples/ppo.py").read_text()
    for long, short in (
        ("100_000", "1"),
        ("n_steps=512", "n_steps=4"),
        ("episodes=20", "episodes=1"),
    ):
        assert long in code
        code = code.replace(long, short)
    command = [sys.executable, "-c", f"{before}exec({code!r})"]
    found = subprocess.run(command, check=True, capture_output=True, text=True, timeout=1800)
    assert re.search(r"-?\d+\.\d ± \d+\.\d points$", found.stdout.strip())
    assert ("the engine is not there" in found.stdout) == bool(before)
