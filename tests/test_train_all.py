"""The published runs: planned by recipe, trained, interrupted, resumed, published, verified."""

import json
import shutil
from pathlib import Path

import pytest

from designrl.checkpoint import STATE_FORMAT, read_tensors
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS
from designrl.files import file_hash
from designrl.recording import read
from designrl.settings import TrainSettings
from designrl.train import TrainingRun
from reproduce import paths, publish, train_all
from reproduce.paths import ROOT

SETTINGS = {"population": 4, "rollouts": 1, "evaluate_every": 2, "evaluation_episodes": 4}


@pytest.fixture
def project(tmp_path, monkeypatch):
    """An empty project folder."""
    (tmp_path / "paper").mkdir()
    shutil.copyfile(ROOT / "paper" / "paper.toml", tmp_path / "paper" / "paper.toml")
    monkeypatch.setattr(paths, "ROOT", tmp_path)
    monkeypatch.setattr(train_all, "LOOK_SECONDS", 0.05)
    monkeypatch.setattr(publish, "check_settings", lambda *_: None)  # smaller than the recipe's
    return tmp_path


def planned(seed: int = 0, generations: int = 4) -> train_all.Planned:
    settings = TrainSettings.of("biped", "ours", seed=seed, generations=generations, **SETTINGS)
    return train_all.Planned(settings, f"seed{seed}")


def test_the_plan_has_every_row_early_and_every_seed_once_by_its_recipe():
    found = list(train_all.plan())
    assert {run.settings.experiment for run in found[: len(EXPERIMENTS)]} == set(EXPERIMENTS)
    assert len({run.place for run in found}) == len(found)
    for name in EXPERIMENTS:
        seeds = sorted(
            run.settings.seed
            for run in found
            if run.settings.experiment == name and run.name.startswith("seed")
        )
        assert seeds == list(range(len(seeds))) and len(seeds) >= 5
    for run in found:
        recipe = "paper" if run.name.startswith("paper") else "ours"
        assert f"--recipe {recipe} --seed {run.settings.seed}" in run.settings.command()
        publish.check_name(run.name, Path(run.place), run.settings)


def test_runs_are_trained_side_by_side_published_and_verified(project, capsys):
    runs = [planned(0), planned(1)]
    train_all.train(list(runs), project / "runs", cores=2)
    assert all(run.published for run in runs)
    train_all.verify(runs)
    again = [f"biped/seed{seed}: 3 generations again, to the bit" for seed in (0, 1)]
    assert capsys.readouterr().out.splitlines()[-2:] == again
    shutil.copytree(project / "logs/biped/seed1", project / "logs/biped/seed0", dirs_exist_ok=True)
    with pytest.raises(
        SystemExit, match="train-all: biped/seed0: mean of generations .* is .*, not"
    ):
        train_all.verify(runs)
    assert capsys.readouterr().out.splitlines() == again[1:]
    assert not planned(1, generations=5).published, "that one was trained otherwise"


def test_a_run_left_unfinished_goes_on_elsewhere_to_the_same_bytes(project):
    def stop(generation):
        if generation.index == 2:
            raise KeyboardInterrupt

    run = planned()
    TrainingRun(run.settings, project / "whole").run()
    with pytest.raises(KeyboardInterrupt):
        TrainingRun(run.settings, project / "runs/biped/seed0", on_generation=stop).run()
    train_all.save([run], project / "runs")
    assert sorted(path.name for path in train_all.unfinished(run).iterdir()) == [
        "best.safetensors",
        "generations.mcap",
        "state.safetensors",
    ]
    train_all.train([run], project / "another place", cores=1)
    assert not train_all.unfinished(run).exists()
    published = (project / "pretrained/biped/seed0").with_suffix(".safetensors")
    assert file_hash(published) == file_hash(project / "whole/best.safetensors")


def test_committed_states_are_of_planned_runs_and_can_go_on():
    plan = {str(run.place): run.settings for run in train_all.plan()}
    folder = ROOT / "logs" / "unfinished"
    for state in folder.glob("*/*/state.safetensors"):
        _, about = read_tensors(state, STATE_FORMAT)
        settings = plan[str(state.parent.relative_to(folder))].as_dict()
        recording = read(state.with_name("generations.mcap"))
        assert about["settings"] == settings
        assert json.loads(recording.metadata["settings"]) == settings
        assert recording.generations[-1] + 1 >= about["progress"]["generation"]


def test_no_core_trains_nothing(project, monkeypatch):
    monkeypatch.setattr("sys.argv", ["train_all", "--cores", "0"])
    with pytest.raises(InputError, match="--cores is 0; it must be a whole number from 1 on"):
        train_all.main()


def test_a_run_that_fails_is_named_and_the_others_are_published(project):
    bad, good = planned(0), planned(1)
    (project / "runs/biped/seed0").mkdir(parents=True)
    Path(project, "runs/biped/seed0/state.safetensors").write_text("rubbish")
    with pytest.raises(
        SystemExit, match="train-all: biped/seed0 stopped with exit code 2: .*state.safe"
    ):
        train_all.train([bad, good], project / "runs", cores=1)
    assert good.published and not bad.published
