"""Several runs side by side."""

import csv
import shutil

import numpy as np
import pytest
from matplotlib.image import imread

from designrl.cli import main
from designrl.compare import curves, labels, picture, read_runs, title
from designrl.errors import InputError
from designrl.recording import Generation, RunWriter
from designrl.settings import TrainSettings

STEPS = 1000  # of a generation


def write_run(folder, recipe="ours", experiment="biped", **changes):
    """A run of three generations, the second and the third evaluated; returns its folder."""
    settings = TrainSettings.of(experiment, recipe, **changes)
    about = {"experiment": experiment, "settings": settings.as_dict()}
    with RunWriter(folder / "generations.mcap", about) as writer:
        for i in range(3):
            zeros, ones = np.zeros(2804), np.ones((2, 1), int)
            returns = np.array([[i], [i + 2.0]])
            writer.generation(Generation(i, zeros, zeros, returns, ones, ones, STEPS * (i + 1), i))
            if i:
                writer.evaluation(i, np.array([30.0 / i]), ones[:1, 0], ones[:1, 0], kept=i == 1)
    return folder


def test_labels_say_what_differs_and_nothing_else(tmp_path):
    made = iter(range(99))

    def labels_of(*runs):
        folders = [write_run(tmp_path / str(next(made)), **run) for run in runs]
        return labels(read_runs(folders))

    assert labels_of({"seed": 3}, {"seed": 4}) == ["seed 3", "seed 4"]
    assert labels_of({}, {"population": 96}) == ["population 48", "population 96"]
    assert labels_of({}, {"recipe": "paper", "seed": 1}) == [
        "recipe ours, seed 0",
        "recipe paper, seed 1",
    ]
    assert labels_of({}, {"experiment": "biped-hardcore"}) == ["biped", "biped-hardcore"]
    assert labels_of({"adam": True}, {"recipe": "plain"}) == ["recipe ours", "recipe plain"]
    assert labels_of({"seed": 7}) == ["biped, seed 7"]
    weighted = ({"reward_weights": {"energy": x, "posture": 0.5}} for x in (2.0, 3.0))
    assert labels_of(*weighted) == [
        "reward weights posture=0.5 energy=2.0",
        "reward weights posture=0.5 energy=3.0",
    ]
    first, second = labels_of({}, {})
    assert first != second and first.startswith("biped, seed 0 (")
    folder = write_run(tmp_path / "copied")
    shutil.copyfile(folder / "generations.mcap", folder / "copy.mcap")
    of_one = labels(read_runs([folder, folder / "copy.mcap"]))
    assert of_one == [f"biped, seed 0 ({folder}/{name}.mcap)" for name in ("generations", "copy")]


@pytest.mark.parametrize("settings", ["[1", '{"seed": [1], "x": "$"}'])
def test_runs_of_other_programs_are_compared_as_they_are(settings, tmp_path):
    zeros, ones = np.zeros(2804), np.ones((2, 1), int)
    about = {"experiment": "biped", "settings": settings}
    with RunWriter(tmp_path / "$x_$" / "generations.mcap", about) as writer:
        writer.generation(Generation(0, zeros, zeros, ones, ones, ones, 2, 1.0))
    runs = read_runs([tmp_path / "$x_$", write_run(tmp_path / "ours")])
    assert len(set(labels(runs))) == 2
    picture(curves(runs), tmp_path / "curves.png", title(runs))


def test_curves_are_those_of_the_recordings(tmp_path):
    runs = read_runs([write_run(tmp_path / "a"), write_run(tmp_path / "b", seed=1)])
    found = curves(runs)
    assert found["run"].tolist() == ["seed 0"] * 3 + ["seed 1"] * 3
    assert found["environment steps"].tolist() == [1000, 2000, 3000] * 2
    assert found["mean return in training"].tolist() == [1, 2, 3] * 2
    np.testing.assert_array_equal(found["evaluation"], [np.nan, 30, 15] * 2)
    np.testing.assert_array_equal(found["best evaluation"], [np.nan, 30, 30] * 2)


def test_the_command_draws_tabulates_and_sums_up(tmp_path, capsys):
    folders = [str(write_run(tmp_path / str(seed), seed=seed)) for seed in range(2)]
    for name in ("curves.png", "curves.svg", "curves.csv"):
        main(["compare", *folders, "-o", str(tmp_path / name)])
    out = capsys.readouterr().out.splitlines()
    assert out[1].split() == ["seed", "0", "3", "0.0", "0.00", "30.0"]
    assert imread(tmp_path / "curves.png")[:, :, :3].std() > 0.05
    assert b"<svg" in (tmp_path / "curves.svg").read_bytes()[:1000]
    with open(tmp_path / "curves.csv") as file:
        assert [row["best evaluation"] for row in csv.DictReader(file)] == ["", "30.0", "30.0"] * 2


def test_what_is_no_run_or_named_twice_is_refused(tmp_path):
    folder = write_run(tmp_path / "a")
    with pytest.raises(InputError, match="named twice"):
        read_runs([folder, folder / "generations.mcap"])
    with pytest.raises(SystemExit):
        main(["compare", str(folder), "-o", str(tmp_path / "curves.txt")])
    with pytest.raises(InputError, match="there is no .*absent"):
        read_runs([tmp_path / "absent"])
