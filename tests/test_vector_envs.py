"""The vector environments on the engine: the bits of SyncVectorEnv, and one clear error else."""

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics

import designrl  # noqa: F401
from designrl import engine, envs
from designrl.engine.verify_vector import VECTOR_CASES, compare_vector, difference
from designrl.envs import ant

REASON = engine.missing_reason()
pytestmark = pytest.mark.skipif(REASON is not None, reason=str(REASON))
IDS = ["designrl/BipedalWalker-v0", "designrl/BipedalWalkerHardcore-v0", "designrl/Ant-v0"]
WALKER = IDS[0]
MODES = [mode.value for mode in AutoresetMode]


def make(env_id, num_envs=3, **kwargs):
    return gymnasium.make_vec(
        env_id, num_envs, vectorization_mode="vector_entry_point", **kwargs
    )


def actions_of(env, steps, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.2, 1.2, (steps, *env.action_space.shape))


@pytest.mark.parametrize("case", VECTOR_CASES, ids=str)
def test_every_output_equals_sync_vector_env(case):
    assert compare_vector(case, steps=400) is None
