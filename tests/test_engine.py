"""The compiled walker engine gives the bits of the reference, whatever it runs on."""

import ctypes
import os
import signal
import threading

import numpy as np
import pytest

from designrl.design import WALKER, leg_area_reward_factor
from designrl.errors import InputError
from designrl.experiments import get_experiment
from designrl.policy import Agent
from designrl import engine
from designrl.simulation import EpisodeRules, Simulator
from designrl.engine import (
    INSTRUCTION_SETS,
    CompiledAgent,
    WalkerEngine,
    engine_missing_reason,
)
from designrl.engine.verify import (
    Case,
    compare,
    make_cases,
    zoo_policies,
)

NETWORK_SIZE = 2804
REASON = engine_missing_reason()
NETWORKS = [
    pytest.param(get_experiment(name), network, id=f"{name}-{network.sizes[1]}")
    for name in ("biped", "ant")
    for network in get_experiment(name).networks
]
needs_engine = pytest.mark.skipif(REASON is not None, reason=str(REASON))


def random_batch(candidates, rollouts, seed=0, std=0.3):
    rng = np.random.default_rng(seed)
    return {
        "parameters": std * rng.standard_normal((candidates, NETWORK_SIZE)),
        "scales": rng.uniform(0.25, 1.75, (candidates, WALKER.size)),
        "reward_factors": np.ones(candidates),
        "seeds": rng.integers(2**31, size=(candidates, rollouts)),
    }


def case_of(batch, i, hardcore, lidar="v2"):
    """Episode i of a random batch, for the reference."""
    design = np.arctanh((batch["scales"][i] - 1.0) / 0.75)
    parameters = np.r_[batch["parameters"][i], design]
    return Case("random", hardcore, lidar, False, False, parameters, int(batch["seeds"][i, 0]))


def supported_isas():
    if REASON:
        return []
    library = engine._library()
    return [isa for isa in INSTRUCTION_SETS if library.designrl_engine_isa(isa.encode())]


@needs_engine
@pytest.mark.parametrize("case", make_cases(32, seed=3), ids=lambda case: f"seed{case.seed}")
def test_every_observation_and_the_return_equal_box2d(case):
    assert compare(case)[1] is None


@needs_engine
@pytest.mark.parametrize("policy", zoo_policies() or [None], ids=lambda p: p[0] if p else "none")
def test_trained_policies_walk_the_same_course(policy):
    if policy is None:
        pytest.skip("no zoo of trained policies here")
    kind, hardcore, parameters = policy
    case = Case(kind, hardcore, "v2", False, "smaller" in kind, parameters, seed=17)
    assert compare(case)[1] is None


@needs_engine
@pytest.mark.parametrize("bound", [-30.0, 30.0])
@pytest.mark.parametrize("hardcore", [False, True])
def test_extreme_bodies_equal_box2d(hardcore, bound):
    rng = np.random.default_rng(5)
    parameters = np.r_[rng.standard_normal(NETWORK_SIZE), np.full(WALKER.size, bound)]
    for seed in (1, 2):
        assert compare(Case("random", hardcore, "v2", False, False, parameters, seed))[1] is None


@needs_engine
def test_the_two_lidars_differ_and_each_equals_box2d():
    batch = random_batch(24, 1, seed=9)
    seen = {
        lidar: WalkerEngine(True, lidar).rollout(**batch, observations=True)[2]
        for lidar in ("v2", "v3")
    }
    differs = [i for i in range(24) if not np.array_equal(seen["v2"][i][0], seen["v3"][i][0])]
    assert differs
    i = min(differs, key=lambda i: len(seen["v2"][i][0]))
    for lidar in seen:
        assert compare(case_of(batch, i, hardcore=True, lidar=lidar))[1] is None


@needs_engine
def test_a_motionless_walker_falls_asleep_as_in_box2d():
    # After half a second at rest Box2D stops all bodies: velocities are exactly zero.
    batch = random_batch(16, 1, std=0.1)
    seen = WalkerEngine(False).rollout(**batch, observations=True)[2]
    asleep = [i for i in range(16) if (seen[i][0][:, 1:4] == 0.0).all(axis=1).any()]
    assert asleep
    assert compare(case_of(batch, asleep[0], hardcore=False))[1] is None


@needs_engine
def test_the_simulator_gives_the_same_result_with_either_backend():
    rules = EpisodeRules(training=True, leg_area_reward=True)
    results = []
    for backend in ("engine", "reference"):
        with Simulator("biped-hardcore-morphology-smaller-leg", backend) as simulator:
            assert simulator.backend == backend
            rng = np.random.default_rng(2)
            candidates = rng.standard_normal((3, simulator.experiment.num_parameters))
            seeds = rng.integers(1000, size=(3, 2))
            results.append(simulator.rollout(candidates, seeds, rules))
    assert np.array_equal(results[0].returns, results[1].returns)
    assert np.array_equal(results[0].steps, results[1].steps)


@needs_engine
@pytest.mark.parametrize("experiment, network", NETWORKS)
def test_the_compiled_policy_has_the_bits_of_the_policy(experiment, network):
    rng = np.random.default_rng(5)
    body = experiment.design.size if experiment.design else 0
    for std in (0.1, 10.0):  # the latter saturates
        parameters = std * rng.standard_normal(network.num_parameters + body)
        agents = [kind(experiment, parameters, network) for kind in (Agent, CompiledAgent)]
        size = network.sizes[0] - (network.time_scale is not None)
        for t, x in enumerate(rng.standard_normal((50, size))):
            for agent in agents:
                agent.reset(t)
            expected, found = [agent.act(x, t) for agent in agents]
            assert expected.tobytes() == found.tobytes()
    for agent in agents:
        with pytest.raises(InputError, match=rf"this agent takes \({size},\)"):
            agent.act(np.zeros(3))


@needs_engine
def test_ants_run_with_the_compiled_policy_unless_the_reference_is_asked_for(monkeypatch):
    used, act = [], CompiledAgent._forward
    monkeypatch.setattr(CompiledAgent, "_forward", lambda *a: used.append(1) or act(*a))
    results = []
    for backend in ("engine", "reference"):
        with Simulator("ant-morphology", backend) as simulator:
            candidates = np.zeros((1, simulator.experiment.num_parameters))
            candidates[:] = 0.5 * np.random.default_rng(3).standard_normal(candidates.shape)
            results.append(simulator.rollout(candidates, np.array([[7]])))
        assert len(used) == results[0].steps.sum()  # and none by the reference
    assert np.array_equal(results[0].returns, results[1].returns)
    assert np.array_equal(results[0].steps, results[1].steps)


@needs_engine
def test_training_rewards_change_only_falls_and_finished_courses():
    batch = random_batch(24, 2, std=1.0)
    walker = WalkerEngine(False)
    plain, steps = walker.rollout(**batch)
    training, training_steps = walker.rollout(**batch, training=True)
    assert np.array_equal(steps, training_steps)
    fell = steps < walker.max_steps  # nobody finishes the course with random weights
    assert fell.any()
    assert np.allclose(training[fell], plain[fell] + 100.0)
    assert np.array_equal(training[~fell], plain[~fell])


@needs_engine
def test_the_reward_factor_spares_the_fall():
    batch = random_batch(8, 1, std=1.0)
    walker = WalkerEngine(False)
    plain, steps = walker.rollout(**batch)
    batch["reward_factors"] = leg_area_reward_factor(batch["scales"])
    scaled, _ = walker.rollout(**batch)
    fall = np.where(steps < walker.max_steps, -100.0, 0.0)
    expected = (plain - fall) * batch["reward_factors"][:, None] + fall
    assert np.allclose(scaled, expected)


@needs_engine
@pytest.mark.parametrize("hardcore", [False, True])
def test_results_do_not_depend_on_threads_or_on_the_rest_of_the_batch(hardcore):
    batch = random_batch(36, 1)  # more than one group of vectors
    one = WalkerEngine(hardcore, threads=1).rollout(**batch)
    three = WalkerEngine(hardcore, threads=3).rollout(**batch)
    for a, b in zip(one, three, strict=True):
        assert np.array_equal(a, b)
    alone = {name: value[7:8] for name, value in batch.items()}
    for a, b in zip(one, WalkerEngine(hardcore, threads=1).rollout(**alone), strict=True):
        assert np.array_equal(a[7:8], b)


@needs_engine
@pytest.mark.skipif(len(supported_isas()) < 2, reason="this processor has only one of them")
def test_results_do_not_depend_on_the_instruction_set(monkeypatch):
    batch = random_batch(20, 1)
    results = {}
    for isa in supported_isas():
        monkeypatch.setenv(engine.ISA_VARIABLE, isa)
        walker = WalkerEngine(True)
        assert walker.isa == isa
        results[isa] = walker.rollout(**batch, observations=True)
    first, *others = results.values()
    for other in others:
        assert np.array_equal(first[0], other[0])
        assert np.array_equal(first[1], other[1])
        for a, b in zip(first[2], other[2], strict=True):
            assert np.array_equal(a[0], b[0])


@needs_engine
def test_an_unknown_instruction_set_is_refused(monkeypatch):
    monkeypatch.setenv(engine.ISA_VARIABLE, "mmx")
    with pytest.raises(InputError, match="mmx"):
        WalkerEngine(False)


@needs_engine
@pytest.mark.parametrize(
    "change",
    [
        {"parameters": np.zeros((4, 5))},
        {"scales": np.ones((3, 8))},
        {"reward_factors": np.ones(3)},
        {"seeds": np.zeros(4, dtype=int)},
        {"seeds": np.full((4, 1), -1)},
        {"seeds": np.full((4, 1), 0.5)},
    ],
    ids=lambda change: next(iter(change)),
)
def test_arrays_that_do_not_fit_are_refused(change):
    with pytest.raises(InputError, match=next(iter(change))):
        WalkerEngine(False).rollout(**{**random_batch(4, 1), **change})


@needs_engine
def test_a_candidate_that_is_not_finite_is_named():
    batch = random_batch(4, 1)
    batch["parameters"][2, 7] = np.nan
    with pytest.raises(InputError, match="candidate 2"):
        WalkerEngine(False).rollout(**batch)


@needs_engine
def test_progress_counts_every_episode_once():
    counted = []
    WalkerEngine(False).rollout(**random_batch(30, 2), progress=counted.append)
    assert sum(counted) == 60


@needs_engine
def test_ctrl_c_stops_a_long_rollout_at_once():
    batch = random_batch(2000, 50, std=0.05)  # minutes of work
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    progress = []
    with pytest.raises(KeyboardInterrupt):
        WalkerEngine(False).rollout(**batch, progress=progress.append)
    assert sum(progress) < 2000 * 50


def test_without_the_engine_training_falls_back_with_one_sentence(monkeypatch, capsys):
    monkeypatch.setattr(engine, "_library", lambda: "the engine is not there")
    with Simulator("biped", "engine") as simulator:
        assert simulator.backend == "reference"
        network = np.zeros((1, simulator.experiment.num_parameters))
        assert simulator.rollout(network, np.array([[1]])).steps.shape == (1, 1)
    said = capsys.readouterr().err.strip()
    assert "the engine is not there" in said
    assert "reference" in said
    assert len(said.splitlines()) == 1


@needs_engine
def test_interrupts_at_any_moment_leave_a_working_engine():
    batch = random_batch(200, 20, std=0.05)
    walker = WalkerEngine(False, threads=2)
    for delay in (0.0, 0.001, 0.002, 0.005, 0.01, 0.02):
        timer = threading.Timer(delay, os.kill, (os.getpid(), signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            timer.start()
            walker.rollout(**batch)
    assert walker.rollout(**random_batch(2, 1, std=1.0))[0].shape == (2, 1)


def test_the_batch_structure_is_that_of_the_library():
    if REASON:
        pytest.skip(REASON)
    assert engine._library().designrl_engine_batch_bytes() == ctypes.sizeof(engine._Batch)
