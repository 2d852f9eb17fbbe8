"""Steps per second of the vector environments beside EnvPool, and beside the single environments.

    make bench

All take random actions from one array and begin again where an episode ends. EnvPool's walker is
Gymnasium's task in C++; its Ant-v4 is MuJoCo's, another ant in another simulator, which people
train on. EnvPool is not one of the pinned libraries: pip install envpool==1.2.5.
"""

from functools import partial

import gymnasium
import numpy as np
import pytest
from test_engine_speed import CORES, needs_engine

from designrl.verify.vector import ANT_ID, HARDCORE_ID

ENVPOOL = {HARDCORE_ID: "BipedalWalkerHardcore-v3", ANT_ID: "Ant-v4"}
AT_LEAST = {HARDCORE_ID: 5.0, ANT_ID: 4.0}  # times EnvPool
ROUND_STEPS = {"vector_entry_point": 16384, "sync": 1024, "async": 1024, "EnvPool": 4096}
NUMBERS = [1, 4, 16, 64, 256, 1024, 4096]
pytestmark = needs_engine
both = pytest.mark.parametrize("env_id", ENVPOOL, ids=["walker", "ant"])


class RandomSteps:
    """Steps of N environments, from episode to episode; a call returns how many."""

    def __init__(self, mode: str, env_id: str, num_envs: int, threads: int = 1):
        steps = max(2, ROUND_STEPS[mode] // num_envs)
        if mode == "EnvPool":
            reason = "EnvPool is not installed: pip install envpool==1.2.5"
            envpool = pytest.importorskip("envpool", reason=reason)
            options = {"env_type": "gymnasium", "num_threads": threads}
            self.env = envpool.make(ENVPOOL[env_id], num_envs=num_envs, **options)
            space = self.env.action_space
        else:
            options = {"threads": threads} if mode == "vector_entry_point" else {}
            self.env = gymnasium.make_vec(env_id, num_envs, vectorization_mode=mode, **options)
            space = self.env.single_action_space
        self.env.reset()
        actions = np.random.default_rng(0).uniform(-1, 1, (steps, num_envs, *space.shape))
        self.actions = actions.astype(space.dtype)

    def __call__(self) -> int:
        for actions in self.actions:
            self.env.step(actions)
        return len(self.actions) * self.actions.shape[1]


@both
@pytest.mark.benchmark(group="vector environments beside EnvPool")
@pytest.mark.parametrize("threads", sorted({1, CORES}))
@pytest.mark.parametrize("num_envs", [16, 64, 256])
def test_beside_envpool(measure, env_id, num_envs, threads):
    about = env_id, num_envs, threads
    ratio = measure(RandomSteps("vector_entry_point", *about), RandomSteps("EnvPool", *about))
    if num_envs >= 64:
        assert ratio >= AT_LEAST[env_id]


@pytest.fixture(scope="module")
def beside():
    return {env_id: RandomSteps("sync", env_id, 16) for env_id in ENVPOOL}


@both
@pytest.mark.benchmark(group="16 environments beside Gymnasium's SyncVectorEnv")
@pytest.mark.parametrize(
    "make",
    [
        pytest.param(partial(RandomSteps, "async"), id="AsyncVectorEnv, 16 processes"),
        pytest.param(partial(RandomSteps, "vector_entry_point"), id="engine, one thread"),
    ],
)
def test_beside_gymnasium(measure, beside, env_id, make):
    subject = make(env_id, 16)
    measure(subject, beside[env_id])
    subject.env.close()


@both
@pytest.mark.benchmark(group="N environments on one thread beside 16 in SyncVectorEnv")
@pytest.mark.parametrize("num_envs", NUMBERS)
def test_growth(measure, beside, env_id, num_envs):
    measure(RandomSteps("vector_entry_point", env_id, num_envs), beside[env_id])
