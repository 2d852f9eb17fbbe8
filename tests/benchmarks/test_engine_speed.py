"""Steps per second of the engine's walker, EnvPool and Gymnasium, as ratios to the reference.

    make bench

All run the hardcore task from episode to episode, resets included, on random policies (EnvPool and
plain Gymnasium: random actions, no policy at all, which favours them). Before each round of a
benchmark the reference runs for a moment, and the ratio is the median over the rounds, so that a
machine whose speed drifts still gives the same ratio.
"""

import os
from functools import partial
from itertools import count

import gymnasium
import numpy as np
import pytest
from test_environment_speed import RandomActions

from designrl import engine
from designrl.checkpoint import load
from designrl.engine.verify import PRETRAINED
from designrl.envs import engine_task
from designrl.experiments import get_experiment
from designrl.policy import Agent
from designrl.simulation import Episodes, run_engine, run_episode

REASON = engine.missing_reason()
CORES = len(os.sched_getaffinity(0))
CANDIDATES, ROLLOUTS = 192, 2  # the paper's population
EXPERIMENT = get_experiment("biped-hardcore")
POLICIES = 0.3 * np.random.default_rng(0).standard_normal((CANDIDATES, EXPERIMENT.num_parameters))
REFERENCE_STEPS = 1500
plain_walker = partial(RandomActions, "BipedalWalkerHardcore-v3")
needs_engine = pytest.mark.skipif(REASON is not None, reason=str(REASON))


# Each of these sets up something to measure, and returns a function that runs some steps of it and
# returns how many.


def reference():
    """Whole episodes of the random policies in turn, in the Gymnasium environment."""
    env = gymnasium.make(EXPERIMENT.env_id, disable_env_checker=True)
    agents = [Agent(EXPERIMENT, parameters) for parameters in POLICIES]
    episodes = count()

    def run():
        steps = 0
        while steps < REFERENCE_STEPS:
            episode = next(episodes)
            steps += run_episode(env, agents[episode % CANDIDATES], seed=episode)[1]
        return steps

    return run


def compiled(threads):
    """One generation of the random policies."""
    task, _ = engine_task(EXPERIMENT.env_id)
    seeds = np.arange(CANDIDATES * ROLLOUTS).reshape(CANDIDATES, ROLLOUTS)
    batch = POLICIES, np.ones((CANDIDATES, 8)), np.ones(CANDIDATES), seeds
    return lambda: engine.rollout(task, EXPERIMENT.network.sizes, *batch, threads=threads)[1].sum()


def envpool():
    """EnvPool's C++ walker under random actions, in one thread."""
    reason = "EnvPool is not installed: pip install -c requirements-extras.lock envpool"
    module = pytest.importorskip("envpool", reason=reason)
    walkers, steps = 16, 400
    env = module.make(
        "BipedalWalkerHardcore-v3", env_type="gymnasium", num_envs=walkers, num_threads=1
    )
    env.reset()
    actions = np.random.default_rng(0).uniform(-1, 1, (steps, walkers, 4)).astype(np.float32)

    def run():
        for each in actions:
            env.step(each)
        return walkers * steps

    return run


@pytest.fixture(scope="module")
def beside():
    return reference()


@pytest.mark.benchmark(group="walker rollouts")
@pytest.mark.parametrize(
    "subject",
    [
        pytest.param(plain_walker, id="gymnasium, random actions"),
        pytest.param(envpool, id="EnvPool, random actions, one thread"),
        pytest.param(reference, id="reference"),
        pytest.param(partial(compiled, 1), id="engine, one thread", marks=needs_engine),
        pytest.param(partial(compiled, CORES), id=f"engine, {CORES} cores", marks=needs_engine),
    ],
)
def test_rollouts(benchmark, measure, subject, beside):
    measure(subject(), beside)
    benchmark.extra_info["instruction_set"] = engine.instruction_set()


@needs_engine
@pytest.mark.benchmark(group="ant rollouts")
@pytest.mark.parametrize("isa", engine.instruction_sets())
@pytest.mark.parametrize("name", ["ant", "ant-morphology"])
def test_ants_on_one_thread(benchmark, measure, name, isa):
    """Whole episodes of a trained policy, beside the PyBullet environment."""
    agent = load(PRETRAINED / name / "seed0.safetensors", name)
    env = gymnasium.make(agent.experiment.env_id, disable_env_checker=True)
    episodes = Episodes(agent.experiment, agent.network)
    candidates, seeds = np.tile(agent.parameters, (32, 1)), np.arange(32)[:, None]
    options = {"threads": 1, "isa": isa}
    ratio = measure(
        lambda: run_engine(episodes, candidates, seeds, **options)[1].sum(),
        lambda: run_episode(env, agent, seed=0)[1],
    )
    benchmark.extra_info["instruction_set"] = isa
    assert ratio >= {"avx512": 25.0, "avx2": 20.0}.get(isa, 0.0)
