import fcntl
import json
import re
import subprocess
import sys

import numpy as np
import pytest

import designrl
from designrl.checkpoint import save
from designrl.cli import main
from designrl.errors import InputError
from designrl.evaluation import episode_seeds, worst
from designrl.experiments import EXPERIMENTS, get_experiment
from designrl.files import file_hash
from designrl.names import PRETRAINED, load
from designrl.policy import Agent
from designrl.recording import read, record_rollout
from designrl.settings import TrainSettings


@pytest.fixture
def checkpoint(tmp_path):
    experiment = get_experiment("biped-morphology")
    parameters = 0.3 * np.random.default_rng(0).standard_normal(experiment.num_parameters)
    save(Agent(experiment, parameters), tmp_path / "agent.safetensors")
    return tmp_path / "agent.safetensors"


def refused(capsys, *argv):
    """The sentence with which a command refuses its input."""
    with pytest.raises(SystemExit) as caught:
        main([str(word) for word in argv])
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("designrl: ")
    assert err.count("\n") == 1
    return err


def test_experiments_lists_all_eight(capsys):
    main(["experiments"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:] if line[0] != " "] == list(EXPERIMENTS)
    assert "paper: 192 × 16, 10,000 generations" in lines[-2]
    ours = TrainSettings.of(list(EXPERIMENTS)[-1], "ours")
    size = f"{ours.population} × {ours.rollouts}, {ours.generations:,} generations"
    size += f", σ × {ours.sigma_decay}"
    rate = f"learning-rate-decay {ours.learning_rate_decay}"
    floor = f"learning-rate-floor {ours.learning_rate_floor}"
    assert f"ours:  {size}, {rate}, {floor}" in lines[-1]


def test_evaluate_prints_one_json_object_with_the_scores_that_python_gives(checkpoint, capsys):
    main(["evaluate", str(checkpoint), "--episodes", "3", "--seed", "7", "--json", "--workers=2"])
    result = json.loads(capsys.readouterr().out)
    expected = designrl.evaluate(designrl.load(checkpoint), episodes=3, seed=7)
    assert result["scores"] == expected.scores.tolist() and len(set(result["scores"])) == 3
    assert result["mean"] == pytest.approx(np.mean(result["scores"]))
    assert (result["experiment"], result["episodes"], result["seed"]) == ("biped-morphology", 3, 7)
    assert len(result["design"]) == 8
    assert result["lengths"] == expected.steps.tolist() and sum(result["lengths"]) > 3
    assert result.keys() == expected.summary().keys()
    assert result.keys() > {"std", "min", "max", "steps", "seconds"}


def test_a_body_can_be_changed_by_name(checkpoint, tmp_path, capsys):
    changes = ["bottom leg 2 height=0.6", "top leg 1 width=1.5"]
    words = ["--seed", "7", "--design", *changes]
    main(["evaluate", str(checkpoint), "--episodes", "2", "--json", *words])
    result = json.loads(capsys.readouterr().out)
    named = {"bottom leg 2 height": 0.6, "top leg 1 width": 1.5}
    assert result["changed"] == named and result["design"][0] == 1.5
    expected = designrl.evaluate(checkpoint, episodes=2, seed=7, design=named)
    assert result["scores"] == expected.scores.tolist()
    main(["evaluate", str(checkpoint), "--episodes", "1", "--design", "top leg 1 width=1.5"])
    assert "not in its own body: top leg 1 width = 1.5" in capsys.readouterr().out
    recording = str(tmp_path / "r.mcap")
    main(["record", str(checkpoint), "-o", recording, *words[:2], *("--design", changes[0])])
    score = designrl.evaluate(checkpoint, episodes=1, seed=7, design={changes[0][:-4]: 0.6}).scores
    assert f"{score[0]:.1f} points" in capsys.readouterr().out
    main(["info", recording])
    assert 'changed: {"bottom leg 2 height": 0.6}' in capsys.readouterr().out


def test_import_writes_a_checkpoint_and_never_overwrites(tmp_path, capsys):
    parameters = np.arange(2804) / 1e4
    (tmp_path / "a.json").write_text(json.dumps([parameters.tolist(), 1.0]))
    words = ("import", str(tmp_path / "a.json"), "--experiment", "biped", "-o")
    main([*words, str(tmp_path / "b.safetensors")])
    np.testing.assert_array_equal(load(tmp_path / "b.safetensors").parameters, parameters)
    assert "could as well be of biped-hardcore\n" in capsys.readouterr().out
    assert "exists already" in refused(capsys, *words, tmp_path / "b.safetensors")


def test_record_takes_an_episode_of_an_evaluation_and_info_tells_of_both(
    checkpoint, tmp_path, capsys
):
    recording = str(tmp_path / "r.mcap")
    main(["evaluate", str(checkpoint), "--episodes", "3", "--seed", "5", "--json"])
    scores = json.loads(capsys.readouterr().out)["scores"]
    words = ["record", str(checkpoint), "--seed", "5", "-o", recording, "--episode"]
    main([*words, "2"])
    assert f"one episode, {scores[2]:.1f} points" in capsys.readouterr().out
    assert "exists already" in refused(capsys, *words, "2")
    main(["info", recording])
    assert "recording of a rollout" in capsys.readouterr().out
    main(["info", str(checkpoint)])
    out = capsys.readouterr().out
    assert "biped-morphology" in out and "top leg 1 width" in out


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("evaluate cut.safetensors", "cut.safetensors is not a whole"),
        ("evaluate absent.safetensors", "there is no absent.safetensors; name a file"),
        ("evaluate agent.safetensors --experiment biped", "not biped"),
        ("evaluate agent.safetensors --episodes 0", "number of episodes is 0; it must be"),
        (
            "evaluate agent.safetensors --seed x",
            "--seed: invalid int value: 'x'; `designrl evaluate -",
        ),
        ("", "required: COMMAND; `designrl --help`"),
        (
            "evaluate agent.safetensors --reward-weight energy",
            "--reward-weight takes NAME=X, as 'energy=2.0'; 'energy' is not that",
        ),
        ("evaluate agent.safetensors --reward-weight energi=2", "no reward term 'energi'"),
        ("train biped-hard", "did you mean 'biped-hardcore'"),
        ("train biped --workers 0 --out r", "from 1 on"),
        ("info absent.mcap", "absent.mcap"),
        ("info empty.mcap", "not an MCAP file"),
        (
            "record agent.safetensors -o r.txt",
            "r.txt must end in .mcap",
        ),
        (
            "record agent.safetensors -o r.mcap --episode -1",
            "--episode is -1; it must be",
        ),
        ("import weights.json --experiment biped -o r.json", "must end in .safetensors"),
        ("replay biped/seed0 --save r.png", "r.png must end in .rrd"),
        ("replay biped/seed0 --headless-screenshot r.jpg", "must end in .png"),
        ("evaluate biped/seed99", "`designrl checkpoints` lists"),
        ("evaluate agent.safetensors --design height", "'height' is not that"),
        ("evaluate agent.safetensors --design 0.6", "'0.6' is not that"),
        (
            "evaluate --design height=1 agent.safetensors",
            "Put files and names before --design",
        ),
        ("evaluate agent.safetensors --reward-weight fall=1 fall=2", "has 'fall' twice"),
        ("record agent.safetensors -o r.mcap --design height=1", "no dimension 'height'"),
        ("evaluate biped", "biped is an experiment; name one of its runs, as biped/seed0"),
        ("compare biped", "biped is an experiment; name one of its runs, as biped/seed0"),
        ("replay biped/seed77 --save b.rrd", "there is no biped/seed77; name a file"),
        ("export . -o a.csv", ". holds no run; name the folder of one"),
        ("evaluate agent.safetensors --episode 3", "`designrl evaluate --help` says"),
        ("train biped --recipe plain --sigma-change-max 0.1", "sigma-change-max is part of"),
        ("evaluate agent.safetensors --worst 0", "--worst is 0; it must be a whole number from 1"),
        ("record agent.safetensors", "-o FILE.mcap, --video FILE.mp4, or both"),
        ("record agent.safetensors -o r.mcap --video r.avi", "no video; give it a name in .mp4"),
        ("replay biped/seed0 --at 3", "--headless-screenshot"),
        ("replay biped/seed0 --port 80", "those of --web"),
        ("replay biped/seed0 biped/seed1 --video r.gif", "films one run"),
        ("replay biped/seed0 --video r.gif --at 3", "does nothing else"),
        (f"info {300 * 'a'}", "cannot be used (File name too long)"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(
    command, words, checkpoint, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cut.safetensors").write_bytes(checkpoint.read_bytes()[:1000])
    (tmp_path / "empty.mcap").touch()
    assert words in refused(capsys, *command.split())
    assert not (tmp_path / "r.mcap").exists()


def test_a_dry_run_starts_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("designrl.plan.CALIBRATION_SECONDS", 0.1)
    words = "train biped --population 4 --dry-run --workers 1 --generations 50 --out"
    main([*words.split(), str(tmp_path / "r")])
    assert "are free" in capsys.readouterr().out
    assert not (tmp_path / "r").exists()


def test_resume_says_where_there_is_nothing_to_go_on_with(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    small = ["--population", "2", "--rollouts", "1", "--workers", "1", "--evaluation-episodes", "1"]
    main(["train", "biped", "--seed", "2", "--generations", "1", *small])
    assert "new run" not in capsys.readouterr().err
    main(["train", "biped", "--generations", "1", "--resume", *small])
    said = "runs/biped/seed0 holds no generations to go on with; this is a new run"
    assert f"{said} (runs/biped has seed2)\n" in capsys.readouterr().err
    main(["train", "biped", "--generations", "1", "--resume", *small])
    assert "seed0 has 1 generations; give --generations more" in capsys.readouterr().out


def test_without_ray_the_message_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    err = refused(capsys, "train", "biped", "--ray", "local", "--out", tmp_path / "r")
    assert "pip install -c requirements-extras.lock ray" in err


def test_help_needs_no_heavy_import():
    code = (
        "import sys, designrl.evaluation; from designrl.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "assert not {'torch', 'pybullet', 'rerun', 'Box2D', 'matplotlib'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


def test_a_published_agent_and_a_run_are_found_by_name(checkpoint, tmp_path, capsys, monkeypatch):
    main(["checkpoints"])
    lines = capsys.readouterr().out.splitlines()
    assert all(
        re.search(r" \([a-h]\) .* episodes; (the paper's runs \d+ ± |a body of other limits)", line)
        for line in lines
    )
    names = [line.split()[0] for line in lines]
    published = {path.relative_to(PRETRAINED) for path in PRETRAINED.glob("*/*.safetensors")}
    assert {f"{name}.safetensors" for name in names} == set(map(str, published))
    expected = load(PRETRAINED / f"{names[0]}.safetensors").parameters
    np.testing.assert_array_equal(designrl.load(names[0]).parameters, expected)
    monkeypatch.chdir(tmp_path)
    (tmp_path / names[0]).mkdir(parents=True)  # a run without an agent, yet
    with pytest.raises(InputError, match=f"{names[0]} holds no run"):
        designrl.load(names[0])
    (tmp_path / "run").mkdir()
    checkpoint.rename(tmp_path / "run" / "best.safetensors")
    assert designrl.load(tmp_path / "run").experiment.name == "biped-morphology"
    main(["info", str(tmp_path / "run")])
    assert "best.safetensors: checkpoint of biped-morphology" in capsys.readouterr().out


def test_what_hides_a_published_agent_is_named(checkpoint, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "biped").mkdir()
    hiding = checkpoint.rename(tmp_path / "biped" / "seed0")
    main(["evaluate", "biped/seed0", "--episodes", "1"])
    assert capsys.readouterr().err == f"from {hiding}, sha256 {file_hash(hiding)}\n"
    main(["evaluate", "biped/seed0", "--episodes", "1", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert (found["file"], found["sha256"]) == (str(hiding), file_hash(hiding))
    agent = designrl.load("biped/seed0")
    hiding.unlink()
    assert designrl.evaluate(agent, episodes=1).sha256 == found["sha256"], "of what was read"


def test_replay_and_export_find_a_published_run_by_name(tmp_path, capsys, monkeypatch):
    name = next(path.relative_to(PRETRAINED).with_suffix("") for path in PRETRAINED.glob("*/*.md"))
    monkeypatch.chdir(tmp_path)
    main(["replay", str(name), "--save", "run.rrd"])
    out, err = capsys.readouterr()
    recording = PRETRAINED.parent / "logs" / name / "generations.mcap"
    assert err.splitlines()[0] == f"from {recording}, sha256 {file_hash(recording)}"
    assert out == "run.rrd written\n"
    main(["export", str(name), "-o", "run.csv"])
    assert capsys.readouterr().out.startswith("run.csv: ")


def test_without_a_clone_is_said_where_the_published_runs_are(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("designrl.names.PRETRAINED", tmp_path / "pretrained")
    assert "its folder pretrained" in refused(capsys, "checkpoints")
    (tmp_path / "pretrained/biped").mkdir(parents=True)
    (tmp_path / "pretrained/biped/seed0.safetensors").touch()
    for command in (["replay"], ["export", "-o", tmp_path / "a.csv"]):
        assert "in designrl's repository alone" in refused(capsys, *command, "biped/seed0")


def test_evaluate_and_record_take_a_file_and_say_what_they_want(checkpoint, tmp_path):
    scores = designrl.evaluate(str(checkpoint), episodes=1).scores
    assert scores == designrl.evaluate(load(checkpoint), episodes=1).scores
    seed = int(episode_seeds(0, 1)[0])
    assert scores == record_rollout(str(checkpoint), tmp_path / "r.mcap", seed)
    with pytest.raises(InputError, match="the agent is None; give one from designrl.load"):
        designrl.evaluate(None)


def test_the_lowest_scores_are_listed_with_what_ended_them_and_filmed(tmp_path, capsys):
    name = "biped-hardcore/seed0"
    main(["evaluate", name, "--worst", "3", "--json"])
    found = json.loads(capsys.readouterr().out)
    lowest = np.argsort(found["scores"])[:3].tolist()
    assert [e["episode"] for e in found["worst"]] == lowest
    for ending in found["worst"]:
        i = ending["episode"]
        assert (ending["score"], ending["steps"]) == (found["scores"][i], found["lengths"][i])
        assert ending["seed"] == episode_seeds(0, 100)[i]
    assert found["worst"][0]["ended"] == "fell"
    main(["record", name, "--worst", "-o", str(tmp_path / "r.mcap")])
    assert f"episode {lowest[0]} has the lowest of 100 scores\n" in capsys.readouterr().out
    assert float(read(tmp_path / "r.mcap").metadata["score"]) == min(found["scores"])


def test_what_ends_an_episode_is_told_apart():
    agent = load("biped/seed0")
    parameters = np.zeros(agent.parameters.size)
    for policy, ended in (
        (agent, "reached the end"),
        (Agent(agent.experiment, parameters), "fell"),
    ):
        (ending,) = worst(policy, designrl.evaluate(policy, episodes=1), 1)
        assert ending.ended == ended
    other = {"design": {"bottom leg 2 height": 0.6}, "reward_weights": {"energy": 2.0}}
    result = designrl.evaluate("biped-morphology/seed0", episodes=2, **other)
    assert worst("biped-morphology/seed0", result, 1)[0].score == result.scores.min()
    said = "not in its own body: bottom leg 2 height = 0.6, reward weights {'energy': 2.0}>"
    assert said in repr(result)
    with pytest.raises(InputError, match="give this the evaluation's agent and keywords"):
        worst("biped-morphology/seed1", result, 1)
    (ending,) = worst("ant/seed0", designrl.evaluate("ant/seed0", episodes=1), 1)
    assert ending.ended == "reached the time limit" and ending.steps == 1000 and ending.at > 10


def test_the_other_ant_of_2018_is_told_apart(tmp_path, capsys):
    other, ours = tmp_path / "other.json", tmp_path / "ours.json"
    for path, network in zip((other, ours), get_experiment("ant").networks, strict=True):
        path.write_text(json.dumps([[0.0] * get_experiment("ant").parameters_with(network), 1.0]))
        main(["import", str(path), "--experiment", "ant", "-o", f"{path}.safetensors"])
        doubted = "bullet_ant" in capsys.readouterr().err
        main(["info", str(path)])
        assert doubted == ("bullet_ant" in capsys.readouterr().out) == (path == other)


def test_things_say_what_they_are(tmp_path):
    agent = load("biped/seed0")
    assert repr(agent) == f"<Agent of biped, 2804 parameters, from {agent.file}>"
    said = repr(designrl.evaluate(agent, episodes=2))
    assert re.fullmatch(
        r"<Evaluation of biped: 34\d\.\d ± \d\.\d over 2 episodes, seed 0, on the \w+>", said
    )
    recording = read("biped/seed0")
    assert read("biped/seed0/").path == recording.path
    assert repr(recording) == f"<Recording of a training run of biped, {recording.path}>"


def test_without_an_experiment_a_command_asks_for_its_option_and_python_for_a_name(
    tmp_path, capsys
):
    (tmp_path / "a.json").write_text(json.dumps([[0.0] * 2804, 1.0]))
    for command in (["evaluate"], ["record", "-o", tmp_path / "a.mcap"]):
        assert "add --experiment NAME" in refused(capsys, *command, tmp_path / "a.json")
    with pytest.raises(InputError, match="give designrl.load the name") as caught:
        load(tmp_path / "a.json")
    assert "--" not in str(caught.value)


def test_a_busy_folder_is_said_at_once(tmp_path, capsys):
    with (tmp_path / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        (tmp_path / "state.safetensors").touch()
        assert "is in use by another run" in refused(capsys, "train", "biped", "--out", tmp_path)


def test_ctrl_c_while_the_package_is_imported_is_no_traceback():
    pressed = (
        "import sys\n"
        "class Finder:\n"
        "    def find_spec(name, *_):\n"
        "        if name.startswith('designrl.'): raise KeyboardInterrupt\n"
        "import designrl_command\n"
        "sys.meta_path.insert(0, Finder)\n"
        "designrl_command.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", pressed], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "")
