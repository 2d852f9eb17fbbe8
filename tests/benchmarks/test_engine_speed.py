"""Steps per second of the engine's walker, EnvPool and Gymnasium, as ratios to the reference.

    make bench

All run the hardcore task from episode to episode, resets included, on random policies (EnvPool and
plain Gymnasium: random actions, no policy at all, which favours them).
"""

import os

import gymnasium
import numpy as np
import pytest
from test_environment_speed import RandomActions

from designrl import engine
from designrl.envs import engine_task
from designrl.experiments import get_experiment
from designrl.policy import Agent
from designrl.simulation import run_episode

REASON = engine.missing_reason()
CANDIDATES, ROLLOUTS = 192, 2  # the paper's population
WEIGHT_STD = 0.3
EXPERIMENT = get_experiment("biped-hardcore")
REFERENCE_STEPS = 1500
GROUP = pytest.mark.benchmark(group="walker rollouts")


def random_policies():
    rng = np.random.default_rng(0)
    return WEIGHT_STD * rng.standard_normal((CANDIDATES, EXPERIMENT.num_parameters))


class Reference:
    """Whole episodes of the random policies in turn, in the Gymnasium environment."""

    def __init__(self):
        self.env = gymnasium.make(EXPERIMENT.env_id, disable_env_checker=True)
        self.agents = [Agent(EXPERIMENT, parameters) for parameters in random_policies()]
        self.episode = 0

    def __call__(self) -> int:
        steps = 0
        while steps < REFERENCE_STEPS:
            agent = self.agents[self.episode % CANDIDATES]
            steps += run_episode(self.env, agent, seed=self.episode)[1]
            self.episode += 1
        return steps


class Engine:
    """One generation of the random policies."""

    def __init__(self, threads):
        self.batch = {
            "task": engine_task(EXPERIMENT.env_id)[0],
            "sizes": EXPERIMENT.network.sizes,
            "weights": random_policies(),
            "designs": np.ones((CANDIDATES, 8)),
            "reward_factors": np.ones(CANDIDATES),
            "seeds": np.arange(CANDIDATES * ROLLOUTS).reshape(CANDIDATES, ROLLOUTS),
            "threads": threads,
        }

    def __call__(self) -> int:
        return int(engine.rollout(**self.batch)[1].sum())


class EnvPool:
    """EnvPool's C++ walker under random actions, in one thread."""

    COUNT, STEPS = 16, 400

    def __init__(self):
        reason = "EnvPool is not installed: pip install envpool==1.2.5"
        envpool = pytest.importorskip("envpool", reason=reason)
        self.env = envpool.make(
            "BipedalWalkerHardcore-v3", env_type="gymnasium", num_envs=self.COUNT, num_threads=1
        )
        self.env.reset()
        rng = np.random.default_rng(0)
        self.actions = rng.uniform(-1, 1, (self.STEPS, self.COUNT, 4)).astype(np.float32)

    def __call__(self) -> int:
        for actions in self.actions:
            self.env.step(actions)
        return self.COUNT * self.STEPS


@pytest.fixture(scope="module")
def reference():
    return Reference()


@GROUP
def test_gymnasium_random_actions(measure, reference):
    measure(RandomActions("BipedalWalkerHardcore-v3"), reference)


@GROUP
def test_envpool_random_actions_one_thread(measure, reference):
    measure(EnvPool(), reference)


@GROUP
def test_reference(measure, reference):
    measure(Reference(), reference)


@GROUP
@pytest.mark.skipif(REASON is not None, reason=str(REASON))
def test_engine_one_thread(benchmark, measure, reference):
    measure(Engine(threads=1), reference)
    benchmark.extra_info["instruction_set"] = engine.instruction_set()


@GROUP
@pytest.mark.skipif(REASON is not None, reason=str(REASON))
def test_engine_all_cores(benchmark, measure, reference):
    measure(Engine(threads=None), reference)
    benchmark.extra_info["cores"] = len(os.sched_getaffinity(0))
    benchmark.extra_info["instruction_set"] = engine.instruction_set()
