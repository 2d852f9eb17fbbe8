"""Steps per second of the walkers, as ratios to Gymnasium's plain BipedalWalker-v3."""

import gymnasium
import numpy as np
import pytest

import designrl  # noqa: F401
from designrl.experiments import get_experiment
from designrl.policy import Agent

STEPS = 1000


def random_actions(env, steps=STEPS):
    """Steps under fixed random actions, resets included."""
    actions = np.random.default_rng(0).uniform(-1, 1, (steps, *env.action_space.shape))
    env.reset(seed=0)
    for step, action in enumerate(actions):
        *_, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset(seed=step)


def with_policy(env, agent, steps=STEPS):
    """Steps under an agent's actions, resets included."""
    agent.reset(0)
    observation, _ = env.reset(seed=0)
    for step in range(steps):
        observation, _, terminated, truncated, _ = env.step(agent.act(observation, step))
        if terminated or truncated:
            observation, _ = env.reset(seed=step)


@pytest.fixture(scope="module")
def baseline_seconds():
    """Median seconds of the baseline, for the ratios."""
    return {}


def report(benchmark, baseline_seconds, steps=STEPS):
    seconds = benchmark.stats.stats.median
    benchmark.extra_info["steps_per_second"] = round(steps / seconds)
    if "gymnasium" in baseline_seconds:
        benchmark.extra_info["ratio_to_gymnasium"] = round(
            baseline_seconds["gymnasium"] / seconds, 2
        )


@pytest.mark.benchmark(group="walker environment")
def test_gymnasium_bipedal_walker_v3(benchmark, baseline_seconds):
    benchmark.pedantic(
        random_actions, (gymnasium.make("BipedalWalker-v3"),), rounds=7, warmup_rounds=1
    )
    baseline_seconds["gymnasium"] = benchmark.stats.stats.median
    report(benchmark, baseline_seconds)


@pytest.mark.benchmark(group="walker environment")
@pytest.mark.parametrize("name", ["BipedalWalker", "BipedalWalkerHardcore"])
def test_designrl_walker(benchmark, baseline_seconds, name):
    env = gymnasium.make(f"designrl/{name}-v0")
    benchmark.pedantic(random_actions, (env,), rounds=7, warmup_rounds=1)
    report(benchmark, baseline_seconds)


@pytest.mark.benchmark(group="walker environment")
def test_designrl_walker_with_policy(benchmark, baseline_seconds):
    experiment = get_experiment("biped")
    parameters = 0.3 * np.random.default_rng(0).standard_normal(experiment.num_parameters)
    agent = Agent(experiment, parameters)
    env = gymnasium.make(experiment.env_id)
    benchmark.pedantic(with_policy, (env, agent), rounds=7, warmup_rounds=1)
    report(benchmark, baseline_seconds)
