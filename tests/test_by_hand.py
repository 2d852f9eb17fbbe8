"""examples/by_hand.py is the algorithm that the library trains with."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from designrl.settings import TrainSettings
from designrl.train import TrainingRun

EXAMPLE = Path(__file__).resolve().parents[1] / "examples/by_hand.py"


@pytest.mark.parametrize("recipe", ["paper", "plain"])
def test_the_algorithm_by_hand_is_the_training_runs_to_the_bit(recipe, tmp_path):
    small = {"generations": 2, "population": 4, "rollouts": 2, "evaluation_episodes": 1}
    settings = TrainSettings.of("biped-morphology", recipe, shaped_rewards=False, **small)
    run = TrainingRun(settings, tmp_path)
    run.run()
    theirs = run.optimiser.state()
    ours = runpy.run_path(str(EXAMPLE))["learn"](settings).state()
    assert ours.keys() == theirs.keys() and ours["generation"] == 2
    assert ours["mu"].any()
    for name, array in ours.items():
        assert np.array_equal(array, theirs[name]), name
