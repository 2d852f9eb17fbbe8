import json
import subprocess
import sys

import numpy as np
import pytest

from designrl.checkpoint import load, save
from designrl.cli import main
from designrl.experiments import EXPERIMENTS, get_experiment
from designrl.policy import Agent


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
    assert "zoo:   192 × 4, 2,500 generations, learning-rate-decay 0.9995" in lines[-1]


def test_evaluate_prints_one_json_object(checkpoint, capsys):
    main(["evaluate", str(checkpoint), "--episodes", "3", "--seed", "7", "--json", "--workers=1"])
    result = json.loads(capsys.readouterr().out)
    assert list(result) == [
        "experiment",
        "episodes",
        "seed",
        "mean",
        "std",
        "min",
        "max",
        "scores",
        "steps",
        "design",
        "seconds",
    ]
    assert result["experiment"] == "biped-morphology"
    assert (result["episodes"], result["seed"]) == (3, 7)
    assert len(result["scores"]) == 3
    assert result["mean"] == pytest.approx(np.mean(result["scores"]))
    assert len(result["design"]) == 8


def test_python_and_command_give_the_same_scores(checkpoint, capsys):
    import designrl

    main(["evaluate", str(checkpoint), "--episodes", "3", "--json", "--workers=2"])
    printed = json.loads(capsys.readouterr().out)["scores"]
    agent = designrl.load(checkpoint)
    assert designrl.evaluate(agent, episodes=3, seed=0).scores.tolist() == printed


def test_import_writes_a_checkpoint_and_never_overwrites(tmp_path, capsys):
    parameters = np.arange(2804) / 1e4
    (tmp_path / "a.json").write_text(json.dumps([parameters.tolist(), 1.0]))
    words = ("import", str(tmp_path / "a.json"), "--experiment", "biped", "-o")
    main([*words, str(tmp_path / "b.safetensors")])
    np.testing.assert_array_equal(load(tmp_path / "b.safetensors").parameters, parameters)
    capsys.readouterr()
    assert "exists already" in refused(capsys, *words, tmp_path / "b.safetensors")


def test_info_tells_what_a_checkpoint_holds(checkpoint, capsys):
    main(["info", str(checkpoint)])
    out = capsys.readouterr().out
    assert "biped-morphology" in out
    assert "top leg 1 width" in out


def test_record_and_info_of_a_rollout(checkpoint, tmp_path, capsys):
    main(["record", str(checkpoint), "-o", str(tmp_path / "r.mcap")])
    main(["info", str(tmp_path / "r.mcap")])
    assert "recording of a rollout" in capsys.readouterr().out
    assert "exists already" in refused(capsys, "record", checkpoint, "-o", tmp_path / "r.mcap")


def test_record_takes_an_episode_of_an_evaluation(checkpoint, tmp_path, capsys):
    main(["evaluate", str(checkpoint), "--episodes", "3", "--seed", "5", "--json"])
    scores = json.loads(capsys.readouterr().out)["scores"]
    words = ["record", str(checkpoint), "--seed", "5", "-o", str(tmp_path / "r.mcap"), "--episode"]
    main([*words, "2"])
    assert f"one episode, {scores[2]:.1f} points" in capsys.readouterr().out
    (tmp_path / "r.mcap").unlink()
    assert "--episode counts from 0" in refused(capsys, *words, "-1")


def test_bad_input_is_one_sentence_and_exit_code_2(checkpoint, tmp_path, capsys):
    (tmp_path / "cut.safetensors").write_bytes(checkpoint.read_bytes()[:1000])
    (tmp_path / "text.safetensors").write_text("hello")
    (tmp_path / "nan.json").write_text(json.dumps([[float("nan")] * 2804, 0]))
    evaluate = "evaluate"
    assert "cut.safetensors" in refused(capsys, evaluate, tmp_path / "cut.safetensors")
    assert "text.safetensors" in refused(capsys, evaluate, tmp_path / "text.safetensors")
    assert "cannot be read" in refused(capsys, evaluate, tmp_path / "absent.safetensors")
    assert "not biped" in refused(capsys, evaluate, checkpoint, "--experiment", "biped")
    assert "not a finite" in refused(
        capsys, evaluate, tmp_path / "nan.json", "--experiment", "biped"
    )
    assert "needs 1 to" in refused(capsys, evaluate, checkpoint, "--episodes", 0)
    assert "did you mean 'biped-hardcore'" in refused(capsys, "train", "biped-hard")
    assert "at least 1" in refused(
        capsys, "train", "biped", "--workers", 0, "--out", tmp_path / "r"
    )
    assert "absent.mcap" in refused(capsys, "info", tmp_path / "absent.mcap")
    (tmp_path / "empty.mcap").touch()
    assert "not an MCAP file" in refused(capsys, "info", tmp_path / "empty.mcap")
    record = "record", checkpoint, "-o"
    assert "name in .mcap" in refused(capsys, *record, tmp_path / "r.txt")


def test_a_dry_run_starts_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("designrl.plan.CALIBRATION_SECONDS", 0.1)
    words = ["train", "biped", "--population", "4", "--dry-run", "--out", str(tmp_path / "r")]
    main([*words, "--workers", "1", "--generations", "50"])
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
    assert 'pip install -e ".[ray]"' in err


def test_help_needs_no_heavy_import():
    code = (
        "import sys; from designrl.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "assert not {'torch', 'pybullet', 'rerun', 'Box2D'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)
