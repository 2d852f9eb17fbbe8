"""Returns are those recorded, whatever Python runs and whoever compiled Box2D and PyBullet.

Recorded with Python 3.11, Debian 12's C library and PyBullet's wheel. Other tests compare two paths
of one installation; only this one sees that both have changed.
"""

import platform

import numpy as np
import pytest

from designrl import engine
from designrl.experiments import get_experiment
from designrl.simulation import Simulator

RECORDED = {  # of each candidate: return, steps
    "biped-morphology": [
        (-97.24120940489236, 1600),
        (-136.66729580948757, 194),
        (-104.57068578424436, 65),
    ],
    "biped-hardcore-morphology": [
        (-120.1156488360389, 2000),
        (-115.11766848106946, 211),
        (-104.18084742718112, 69),
    ],
    "ant-morphology": [
        (41.77998549937543, 157),
        (-48.426533025673564, 161),
        (166.72208170206136, 1000),
    ],
}
SEEDS = np.arange(3)[:, None]


def candidates(name: str) -> np.ndarray:
    experiment = get_experiment(name)
    parameters = 0.3 * np.random.default_rng(1).standard_normal((3, experiment.num_parameters))
    # Original bodies, and output noise of standard deviation 1: the last bits of NumPy's tanh and
    # exp, but at 0, differ from processor to processor.
    parameters[:, experiment.network.num_weights :] = 0.0
    return parameters


@pytest.mark.parametrize("backend", ["reference", "engine"])
@pytest.mark.parametrize("name", RECORDED)
def test_returns_are_the_recorded_ones_to_the_bit(name, backend):
    if backend == "reference" and platform.machine() != "x86_64":
        pytest.skip("Box2D and PyBullet were recorded on x86-64")
    if backend == "engine" and (reason := engine.missing_reason()):
        pytest.skip(reason)
    with Simulator(name, backend) as simulator:
        assert simulator.backend == backend
        result = simulator.rollout(candidates(name), SEEDS)
    found = zip(result.returns.ravel().tolist(), result.steps.ravel().tolist(), strict=True)
    assert list(found) == RECORDED[name]
