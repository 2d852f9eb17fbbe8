"""Speeds of the engine, EnvPool and what else runs these bodies, as ratios to the reference.

    make bench

The walkers run the hardcore task from episode to episode, resets included, on random policies
(EnvPool and plain Gymnasium: random actions, no policy at all, which favours them). The ants run
whole episodes of a trained policy, in one thread. Beside them, for scale: Bullet's physics alone,
without observation, reward and policy; and EnvPool's Ant-v4 under random actions, which is another
ant in another simulator (MuJoCo, steps of 0.05 s). Before each round of a benchmark the reference
runs for a moment, and the ratio is the median over the rounds, so that a machine whose speed drifts
still gives the same ratio.
"""

from functools import partial
from itertools import count

import gymnasium
import numpy as np
import pytest
from test_environment_speed import AntEpisode, RandomActions

from designrl import engine
from designrl.envs.tasks import engine_task
from designrl.experiments import get_experiment
from designrl.names import PRETRAINED, load
from designrl.policy import Agent
from designrl.provenance import core_count
from designrl.simulation import Episodes, run_engine, run_episode

REASON = engine.missing_reason()
CORES = core_count()
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


def envpool(env_id):
    """One of EnvPool's C++ environments under random actions, in one thread."""
    reason = "EnvPool is not installed: pip install -c requirements-extras.lock envpool"
    module = pytest.importorskip("envpool", reason=reason)
    bodies, steps = 16, 400
    env = module.make(env_id, env_type="gymnasium", num_envs=bodies, num_threads=1)
    env.reset()
    space = env.action_space
    actions = np.random.default_rng(0).uniform(space.low, space.high, (steps, bodies, *space.shape))
    actions = actions.astype(space.dtype)

    def run():
        for each in actions:
            env.step(each)
        return bodies * steps

    return run


def reference_ant(name):
    """An episode of our trained ant in the PyBullet environment."""
    agent = load(PRETRAINED / name / "seed0.safetensors", name)
    env = gymnasium.make(agent.experiment.env_id, disable_env_checker=True)
    return lambda: run_episode(env, agent, seed=0)[1]


def compiled_ant(name, isa):
    """32 episodes of the same ant in the engine, in one thread."""
    agent = load(PRETRAINED / name / "seed0.safetensors", name)
    episodes = Episodes(agent.experiment, agent.network)
    batch = np.tile(agent.parameters, (32, 1)), np.arange(32)[:, None]
    return lambda: run_engine(episodes, *batch, threads=1, isa=isa)[1].sum()


@pytest.fixture(scope="module")
def beside():
    return reference()


@pytest.mark.benchmark(group="walker rollouts")
@pytest.mark.parametrize(
    "subject",
    [
        pytest.param(plain_walker, id="gymnasium, random actions"),
        pytest.param(
            partial(envpool, "BipedalWalkerHardcore-v3"), id="EnvPool, random actions, one thread"
        ),
        pytest.param(reference, id="reference"),
        pytest.param(partial(compiled, 1), id="engine, one thread", marks=needs_engine),
        pytest.param(partial(compiled, CORES), id=f"engine, {CORES} cores", marks=needs_engine),
    ],
)
def test_rollouts(benchmark, measure, subject, beside):
    measure(subject(), beside)
    benchmark.extra_info["instruction_set"] = engine.instruction_set()


@pytest.mark.benchmark(group="ant rollouts")
@pytest.mark.parametrize(
    "subject",
    [
        pytest.param(partial(envpool, "Ant-v4"), id="EnvPool's Ant-v4, random actions"),
        pytest.param(lambda: AntEpisode().bare, id="PyBullet's stepSimulation alone"),
        pytest.param(partial(reference_ant, "ant"), id="reference"),
    ],
)
def test_other_ants(measure, subject):
    measure(subject(), reference_ant("ant"))


@needs_engine
@pytest.mark.benchmark(group="ant rollouts")
@pytest.mark.parametrize("isa", engine.instruction_sets())
@pytest.mark.parametrize("name", ["ant", "ant-morphology"])
def test_compiled_ants(benchmark, measure, name, isa):
    ratio = measure(compiled_ant(name, isa), reference_ant(name))
    benchmark.extra_info["instruction_set"] = isa
    assert ratio >= {"avx512": 25.0, "avx2": 20.0}.get(isa, 0.0)
