"""Steps per second of the ant, as ratios to bare stepSimulation in the same run.

    make bench

The bare baseline applies the torques of the very same episode and steps (4 substeps of Bullet), but
reads nothing: it goes through the same states, to the bit. Each round of a benchmark runs the
baseline just before, and the ratio is the median over the rounds, so that a machine whose speed
drifts still gives the same ratio. 1 is as fast as Bullet alone.
"""

import statistics
import time

import gymnasium
import numpy as np
import pybullet
import pytest

import designrl  # noqa: F401
from designrl import engine
from designrl.checkpoint import load
from designrl.engine.verify import PRETRAINED
from designrl.envs.ant import Ant
from designrl.experiments import get_experiment
from designrl.policy import Agent, forward_function
from designrl.simulation import Episodes, run_engine, run_episode

STEPS = 1000
ROUNDS = 9


def hold(observation, rng):
    """Random actions of an ant that stands: the joints' middles, and noise."""
    return rng.uniform(-1, 1, 8) - observation[8:24:2] - observation[9:24:2]


@pytest.fixture(scope="module")
def episode():
    """(actions, torques) of STEPS steps on its feet."""
    env, rng = Ant(), np.random.default_rng(0)
    observation, _ = env.reset(seed=0)
    actions, torques = [], []
    for _ in range(STEPS):
        actions.append(hold(observation, rng))
        observation, _, terminated, _, _ = env.step(actions[-1])
        torques.append(env.torques)
        assert not terminated
    assert sum(env.foot_contacts) > 0
    return actions, torques


def bare(env, torques):
    """Bullet alone on the episode's torques."""
    ant, joints, client = env._ant, env._joints, env._client
    for forces in torques:
        pybullet.setJointMotorControlArray(
            ant, joints, pybullet.TORQUE_CONTROL, forces=forces, physicsClientId=client
        )
        pybullet.stepSimulation(physicsClientId=client)


def step(env, actions):
    for action in actions:
        env.step(action)


def measure(benchmark, function, env, argument, torques):
    """Benchmark `function(env, argument)`, with bare Bullet beside each round."""
    world = Ant()
    bare_seconds = []

    def before():
        world.reset(seed=0)
        start = time.perf_counter()
        bare(world, torques)
        bare_seconds.append(time.perf_counter() - start)
        env.reset(seed=0)
        return (env, argument), {}

    benchmark.pedantic(function, setup=before, rounds=ROUNDS, warmup_rounds=1)
    ratios = [
        alone / ours
        for alone, ours in zip(bare_seconds[1:], benchmark.stats.stats.data, strict=True)
    ]
    benchmark.extra_info["steps_per_second"] = round(len(torques) / benchmark.stats.stats.median)
    benchmark.extra_info["of_bare_stepping"] = round(statistics.median(ratios), 3)


@pytest.mark.benchmark(group="ant environment")
def test_bare_step_simulation(benchmark, episode):
    measure(benchmark, bare, Ant(), episode[1], episode[1])


@pytest.mark.benchmark(group="ant environment")
def test_ant(benchmark, episode):
    actions, torques = episode
    measure(benchmark, step, gymnasium.make("designrl/Ant-v0").unwrapped, actions, torques)
    assert benchmark.extra_info["of_bare_stepping"] >= 0.7  # the aim is 0.75


@pytest.mark.benchmark(group="ant environment")
@pytest.mark.parametrize("policy", ["NumPy", "compiled"])
def test_ant_with_policy(benchmark, episode, policy):
    class StandingAgent(Agent):
        """Pays for a policy, and acts as in the recorded episode."""

        def act(self, observation, t=0):
            super().act(observation, t)
            return actions[t]

    actions, torques = episode
    experiment = get_experiment("ant")
    parameters = 0.1 * np.random.default_rng(0).standard_normal(experiment.num_parameters)
    agent = StandingAgent(experiment, parameters)
    if policy == "NumPy":
        count = experiment.network.num_parameters - experiment.network.sizes[-1]  # no log-stds
        agent._forward = forward_function(experiment.network, parameters[:count])
    env = gymnasium.make(experiment.env_id, disable_env_checker=True)

    def whole_episode(env, agent):
        assert run_episode(env, agent, seed=0)[1] == STEPS

    measure(benchmark, whole_episode, env, agent, torques)


@pytest.mark.benchmark(group="ant reset")
@pytest.mark.parametrize("body", ["the same", "another"])
def test_ant_reset(benchmark, body):
    env, rng = Ant(), np.random.default_rng(0)
    designs = rng.uniform(0.25, 1.75, (20, 36)) if body == "another" else np.ones((20, 36))

    def resets():
        for design in designs:
            env.reset(seed=0, options={"design": design})

    benchmark.pedantic(resets, rounds=ROUNDS, warmup_rounds=1)
    benchmark.extra_info["milliseconds"] = round(1e3 * benchmark.stats.stats.median / 20, 2)


def isas():
    if engine.missing_reason():
        return []
    library = engine._library()
    return [isa for isa in engine.INSTRUCTION_SETS if library.designrl_engine_isa(isa.encode())]


@pytest.mark.benchmark(group="ant rollouts")
@pytest.mark.parametrize("isa", isas())
@pytest.mark.parametrize("name", ["ant", "ant-morphology"])
def test_engine_one_thread(benchmark, name, isa):
    """Whole episodes of a trained policy, against the PyBullet environment before each round.

    In processor time: what else a busy machine does is not counted.
    """
    agent = load(PRETRAINED / name / "seed0.safetensors", name)
    env = gymnasium.make(agent.experiment.env_id, disable_env_checker=True)
    episodes = Episodes(agent.experiment, agent.network)
    candidates, seeds = np.tile(agent.parameters, (32, 1)), np.arange(32)[:, None]
    reference_rates, rates = [], []

    def rate(run):
        start = time.process_time()
        steps = run()
        return steps / (time.process_time() - start)

    benchmark.pedantic(
        lambda: rates.append(
            rate(lambda: run_engine(episodes, candidates, seeds, threads=1, isa=isa)[1].sum())
        ),
        setup=lambda: reference_rates.append(rate(lambda: run_episode(env, agent, seed=0)[1])),
        rounds=ROUNDS,
        warmup_rounds=1,
    )
    ratios = [a / b for a, b in zip(rates[1:], reference_rates[1:], strict=True)]
    benchmark.extra_info["steps_per_second"] = round(statistics.median(rates[1:]))
    benchmark.extra_info["ratio_to_reference"] = round(statistics.median(ratios), 1)
    aim = {"avx512": 25.0, "avx2": 20.0}.get(isa, 0.0)
    assert benchmark.extra_info["ratio_to_reference"] >= aim
