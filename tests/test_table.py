"""Recordings and scores as tables."""

import csv
import json
import re

import numpy as np
import pyarrow.parquet
import pytest

import designrl
from designrl.cli import main
from designrl.recording import Generation, RecordingError, RunWriter, read, table, thin
from designrl.settings import TrainSettings
from designrl.train import TrainingRun


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    small = {"generations": 3, "population": 4, "rollouts": 1}
    changes = {**small, "evaluate_every": 2, "evaluation_episodes": 2}
    TrainingRun(TrainSettings.of("biped-morphology", "ours", **changes), folder).run()
    return folder


def test_a_run_is_exported_with_a_row_for_each_generation(run, tmp_path, capsys):
    main(["export", str(run), "-o", str(tmp_path / "curve.csv")])
    assert re.search("3 rows, .* 3 of the generations 0 to 2$", capsys.readouterr().out)
    with open(tmp_path / "curve.csv") as file:
        rows = list(csv.DictReader(file))
    recording = read(run / "generations.mcap")
    assert [row["generation"] for row in rows] == ["0", "1", "2"]
    assert [float(row["mean"]) for row in rows] == recording.array("/summary", "mean").tolist()
    scores = recording.array("/evaluation", "mean").tolist()
    assert [row["evaluation mean"] for row in rows] == ["", *map(str, scores)]
    length = recording.array("/design", "dimensions")[:, 1]
    assert [float(row["top leg 1 height"]) for row in rows] == length.tolist()
    upper = recording.array("/design", "upper")[:, 1]
    assert [float(row["top leg 1 height upper"]) for row in rows] == upper.tolist()


def test_of_a_thinned_run_every_evaluation_and_body_is_exported(run, tmp_path):
    thin(run / "generations.mcap", tmp_path / "thin.mcap", {"/summary": 1, "/design": 2})
    found = table(tmp_path / "thin.mcap")
    assert found["generation"].tolist() == [0, 1, 2]
    assert np.isnan(found["mean"]).tolist() == [False, True, True]
    assert np.isnan(found["evaluation mean"]).tolist() == [True, False, False]
    assert np.isnan(found["top leg 1 height"]).tolist() == [False, True, False]
    whole, shown = table(run / "generations.mcap"), [1, 2]
    assert np.array_equal(found["evaluation mean"][shown], whole["evaluation mean"][shown])


def test_the_episodes_of_a_runs_evaluations_are_exported(run, tmp_path):
    main(["export", str(run), "--episodes", "-o", str(tmp_path / "episodes.parquet")])
    found = pyarrow.parquet.read_table(tmp_path / "episodes.parquet").to_pydict()
    recording = read(run / "generations.mcap")
    assert found["generation"] == [1, 1, 2, 2] and found["episode"] == [0, 1, 0, 1]
    assert found["score"] == recording.array("/evaluation", "scores").ravel().tolist()
    assert found["length"] == recording.array("/evaluation", "steps").ravel().tolist()


def test_a_rollout_is_a_row_for_each_step(run):
    path = run / "rollouts" / "generation00002.mcap"
    found = table(path)
    assert found["total"][-1] == float(read(path).metadata["score"])
    values = read(path).array("/observation", "values")
    np.testing.assert_array_equal(found["observation: hull angle"], values[:, 0])
    assert {"action: knee 1", "reward: energy", "contact: bottom leg 2"} < found.keys()


def test_the_scores_of_an_evaluation_are_written_with_their_lengths(run, tmp_path, capsys):
    main(["evaluate", str(run), "--episodes", "3", "--json", "-o", str(tmp_path / "scores.csv")])
    said = json.loads(capsys.readouterr().out)
    with open(tmp_path / "scores.csv") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["score"]) for row in rows] == said["scores"]
    assert [int(row["length"]) for row in rows] == said["lengths"]
    expected = designrl.evaluate(run, episodes=3).table()["seed"].tolist()
    assert [int(row["seed"]) for row in rows] == expected


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("export {run} -o x.xls", "x.xls would be no table; give it a name in .csv or .parquet"),
        ("export {run} -o there.csv", "exists already"),
        ("evaluate {run} -o there.csv", "exists already"),
        ("export {run}/best.safetensors -o x.csv", "is not an MCAP file"),
        ("export {run}/rollouts/generation00002.mcap --episodes -o x.csv", "no recording of a run"),
    ],
)
def test_what_cannot_be_exported_is_refused(words, sentence, run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.csv").write_text("precious")
    with pytest.raises(SystemExit, match="2"):
        main(words.format(run=run).split())
    assert sentence in capsys.readouterr().err
    assert (tmp_path / "there.csv").read_text() == "precious"
    assert not (tmp_path / "x.csv").exists()


def test_a_run_without_evaluations_says_so(tmp_path):
    numbers = np.zeros(2812), np.ones(2812), *(np.ones((2, 1), int) for _ in range(3))
    with RunWriter(tmp_path / "g.mcap", {"experiment": "biped-morphology"}) as writer:
        writer.generation(Generation(0, *numbers, 2, 1.0))
    assert table(tmp_path / "g.mcap")["generation"].tolist() == [0]
    with pytest.raises(RecordingError, match="/evaluation"):
        table(tmp_path / "g.mcap", episodes=True)
