"""The compiled engine gives the bits of the reference, whatever it runs on."""

import ctypes
import os
import signal
import threading

import numpy as np
import pytest

from designrl import engine
from designrl.bodies.walker import WALKER, leg_area_reward_factor
from designrl.engine import INSTRUCTION_SETS, Task, act_function, instruction_set, rollout
from designrl.engine.verify import (
    TERRAINS,
    compare,
    difference,
    make_case,
    make_cases,
    run_engine,
    run_reference,
    zoo_policies,
)
from designrl.envs import engine_task
from designrl.errors import InputError
from designrl.experiments import Network, get_experiment
from designrl.policy import Agent, forward_function
from designrl.simulation import Simulator

NETWORK = Network((24, 40, 40, 4))  # the walkers' own
REASON = engine.missing_reason()
FLAT, HARDCORE = (engine_task(get_experiment(name).env_id)[0] for name in TERRAINS)
NETWORKS = [
    pytest.param(get_experiment(name), network, id=f"{name}-{network.sizes[1]}")
    for name in ("biped", "ant")
    for network in get_experiment(name).networks
]
needs_engine = pytest.mark.skipif(REASON is not None, reason=str(REASON))


def random_batch(candidates, rollouts, seed=0, std=0.3, network=NETWORK):
    rng = np.random.default_rng(seed)
    return {
        "sizes": network.sizes,
        "weights": std * rng.standard_normal((candidates, network.num_parameters)),
        "designs": rng.uniform(0.25, 1.75, (candidates, WALKER.design.size)),
        "reward_factors": np.ones(candidates),
        "seeds": rng.integers(2**31, size=(candidates, rollouts)),
    }


def case_of(batch, i, experiment, lidar="v2"):
    """Episode i of a random batch, for the reference."""
    design = np.arctanh((batch["designs"][i] - 1.0) / 0.75)
    parameters = np.r_[batch["weights"][i], design]
    seed, network = int(batch["seeds"][i, 0]), Network(batch["sizes"])
    return make_case("random", experiment, parameters, seed, network, lidar=lidar)


def part_of(batch, rows):
    return {name: value if name == "sizes" else value[rows] for name, value in batch.items()}


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
    kind, parameters = policy
    case = make_case(kind, TERRAINS["hardcore" in kind], parameters, seed=17)
    assert compare(case)[1] is None


@needs_engine
@pytest.mark.parametrize("bound", [-30.0, 30.0])
@pytest.mark.parametrize("experiment", TERRAINS)
def test_extreme_bodies_equal_box2d(experiment, bound):
    rng = np.random.default_rng(5)
    weights = rng.standard_normal(NETWORK.num_parameters)
    parameters = np.r_[weights, np.full(WALKER.design.size, bound)]
    for seed in (1, 2):
        assert compare(make_case("random", experiment, parameters, seed))[1] is None


@needs_engine
def test_the_two_lidars_differ_and_each_equals_box2d():
    batch = random_batch(24, 1, seed=9)
    seen = {
        lidar: rollout(task, **batch, observations=True)[2]
        for lidar in ("v2", "v3")
        for task, _ in [engine_task("designrl/BipedalWalkerHardcore-v0", lidar=lidar)]
    }
    differs = [i for i in range(24) if not np.array_equal(seen["v2"][i][0], seen["v3"][i][0])]
    assert differs
    i = min(differs, key=lambda i: len(seen["v2"][i][0]))
    for lidar in seen:
        assert compare(case_of(batch, i, TERRAINS[1], lidar=lidar))[1] is None


@needs_engine
def test_a_motionless_walker_falls_asleep_as_in_box2d():
    # After half a second at rest Box2D stops all bodies: velocities are exactly zero.
    batch = random_batch(16, 1, std=0.1)
    seen = rollout(FLAT, **batch, observations=True)[2]
    asleep = [i for i in range(16) if (seen[i][0][:, 1:4] == 0.0).all(axis=1).any()]
    assert asleep
    assert compare(case_of(batch, asleep[0], TERRAINS[0]))[1] is None


@needs_engine
def test_the_simulator_gives_the_same_result_with_either_backend():
    results = []
    for backend in ("engine", "reference"):
        with Simulator("biped-hardcore-morphology-smaller-leg", backend) as simulator:
            assert simulator.backend == backend
            rng = np.random.default_rng(2)
            candidates = rng.standard_normal((3, simulator.experiment.num_parameters))
            seeds = rng.integers(1000, size=(3, 2))
            results.append(simulator.rollout(candidates, seeds, training=True, shaped=True))
    assert np.array_equal(results[0].returns, results[1].returns)
    assert np.array_equal(results[0].steps, results[1].steps)


@needs_engine
@pytest.mark.parametrize("experiment, network", NETWORKS)
def test_the_compiled_policy_has_the_bits_of_the_policy(experiment, network):
    rng = np.random.default_rng(5)
    body = experiment.design.size if experiment.design else 0
    outputs = network.sizes[-1]
    count = network.num_parameters - network.noise * outputs
    for std in (0.1, 10.0):  # the latter saturates
        agent = Agent(experiment, std * rng.standard_normal(network.num_parameters + body), network)
        act = act_function(network.sizes, network.output == "tanh", agent.parameters[:count])
        in_numpy = forward_function(network, agent.parameters[:count])
        for x in rng.standard_normal((50, network.sizes[0])).astype(np.float32):
            for noise in (None, rng.standard_normal(outputs).astype(np.float32)):
                assert in_numpy(x, noise).tobytes() == act(x, noise).tobytes()
    for wrong in ((x[1:], None), (x, np.zeros(outputs + 1))):
        with pytest.raises(InputError, match=f"takes {network.sizes[0]} values"):
            act(*wrong)


@needs_engine
def test_the_compiled_policy_refuses_weights_that_do_not_fit():
    act_function((4, 3, 2), True, np.zeros(23))
    with pytest.raises(InputError, match=r"weights must have shape \(23,\)"):
        act_function((4, 3, 2), True, np.zeros(22))
    with pytest.raises(InputError, match="1 to 256 values"):
        act_function((4, 257, 2), True, np.zeros(5 * 257 + 258 * 2))


@needs_engine
@pytest.mark.parametrize(
    "network",
    [Network((24, 16, 4)), Network((24, 4)), Network((24, 8, 256, 4), "linear")],
    ids=lambda network: "-".join(map(str, network.sizes)),
)
def test_walkers_with_other_networks_equal_box2d(network):
    rng = np.random.default_rng(8)
    for experiment in TERRAINS:
        parameters = 0.5 * rng.standard_normal(network.num_parameters + WALKER.design.size)
        assert compare(make_case("random", experiment, parameters, 4, network))[1] is None


@needs_engine
def test_ants_have_the_same_episodes_without_the_library(monkeypatch):
    results = []
    for missing in (False, True):
        if missing:
            monkeypatch.setattr(engine, "_load", lambda: "the engine is not there")
        with Simulator("ant-morphology", "reference") as simulator:
            candidates = np.zeros((1, simulator.experiment.num_parameters))
            candidates[:] = 0.5 * np.random.default_rng(3).standard_normal(candidates.shape)
            results.append(simulator.rollout(candidates, np.array([[7]])))
    assert np.array_equal(results[0].returns, results[1].returns)
    assert np.array_equal(results[0].steps, results[1].steps)


@needs_engine
def test_shaped_rewards_change_only_falls_and_finished_courses():
    batch = random_batch(24, 2, std=1.0)
    plain, steps = rollout(FLAT, **batch)
    shaped, shaped_steps = rollout(FLAT, **batch, shaped=True)
    assert np.array_equal(steps, shaped_steps)
    fell = steps < FLAT.max_steps  # nobody finishes the course with random weights
    assert fell.any()
    assert np.allclose(shaped[fell], plain[fell] + 100.0)
    assert np.array_equal(shaped[~fell], plain[~fell])


@needs_engine
def test_the_reward_factor_spares_the_fall():
    batch = random_batch(8, 1, std=1.0)
    plain, steps = rollout(FLAT, **batch)
    batch["reward_factors"] = leg_area_reward_factor(batch["designs"])
    scaled, _ = rollout(FLAT, **batch)
    fall = np.where(steps < FLAT.max_steps, -100.0, 0.0)
    expected = (plain - fall) * batch["reward_factors"][:, None] + fall
    assert np.allclose(scaled, expected)


@needs_engine
@pytest.mark.parametrize("task", [FLAT, HARDCORE], ids=["flat", "hardcore"])
def test_results_do_not_depend_on_threads_or_on_the_rest_of_the_batch(task):
    batch = random_batch(36, 1)  # more than one group of vectors
    one = rollout(task, **batch, threads=1)
    three = rollout(task, **batch, threads=3)
    for a, b in zip(one, three, strict=True):
        assert np.array_equal(a, b)
    alone = rollout(task, **part_of(batch, slice(7, 8)), threads=1)
    for a, b in zip(one, alone, strict=True):
        assert np.array_equal(a[7:8], b)


@needs_engine
@pytest.mark.skipif(len(supported_isas()) < 2, reason="this processor has only one of them")
@pytest.mark.parametrize("network", [NETWORK, Network((24, 16, 4))], ids=["own", "other"])
def test_results_do_not_depend_on_the_instruction_set(monkeypatch, network):
    batch = random_batch(20, 1, network=network)
    results = {}
    for isa in supported_isas():
        results[isa] = rollout(HARDCORE, **batch, observations=True, isa=isa)
        monkeypatch.setenv(engine.ISA_VARIABLE, isa)
        assert instruction_set() == isa
    first, *others = results.values()
    for other in others:
        assert np.array_equal(first[0], other[0])
        assert np.array_equal(first[1], other[1])
        for a, b in zip(first[2], other[2], strict=True):
            assert np.array_equal(a[0], b[0])


@needs_engine
@pytest.mark.parametrize("isa", supported_isas())
def test_every_instruction_set_equals_box2d(isa):
    for case in make_cases(48, seed=6)[::12]:
        assert difference(run_reference(case), run_engine(case, isa)) is None


@needs_engine
def test_an_unknown_instruction_set_is_refused(monkeypatch):
    with pytest.raises(InputError, match="mmx"):
        rollout(FLAT, **random_batch(1, 1), isa="mmx")
    monkeypatch.setenv(engine.ISA_VARIABLE, "mmx")
    with pytest.raises(InputError, match="mmx"):
        instruction_set()


@needs_engine
def test_an_unknown_task_or_flag_is_refused():
    batch = random_batch(1, 1)
    with pytest.raises(InputError, match="the task 'swimmer'"):
        rollout(Task("swimmer", (), 100), **batch)
    with pytest.raises(InputError, match="flag 'icy'; it has hardcore, closest_hits"):
        rollout(Task("walker", ("hardcore", "icy"), 100), **batch)


@needs_engine
@pytest.mark.parametrize(
    "change",
    [
        {"sizes": (23, 40, 40, 4)},
        {"sizes": (24, 40, 40, 3)},
        {"sizes": (24, 257, 4)},
        {"weights": np.zeros((4, 5))},
        {"designs": np.ones((3, 8))},
        {"reward_factors": np.ones(3)},
        {"seeds": np.zeros(4, dtype=int)},
        {"seeds": np.full((4, 1), -1)},
        {"seeds": np.full((4, 1), 0.5)},
        {"weights": np.full((4, 2804), 1e300)},
        {"designs": np.full((4, 8), np.nan)},
    ],
    ids=lambda change: next(iter(change)),
)
def test_arrays_that_would_leave_the_librarys_memory_are_refused(change):
    name = next(iter(change))
    with pytest.raises(InputError, match="network|layers" if name == "sizes" else name):
        rollout(FLAT, **{**random_batch(4, 1), **change})


@needs_engine
@pytest.mark.parametrize("widths", [300.0, 1000.0])
def test_an_episode_beyond_the_capacities_is_an_error_and_no_result(widths):
    # No design within the bounds was ever seen to get there: these legs are wider than the course.
    batch = random_batch(4, 2, std=1.0)
    batch["designs"][2, ::2] = widths
    with pytest.raises(InputError, match="candidate 2 with seed .* has more contacts") as error:
        rollout(FLAT, **batch)
    assert any(str(seed) in str(error.value) for seed in batch["seeds"][2])


@needs_engine
def test_progress_counts_every_episode_once():
    counted = []
    rollout(FLAT, **random_batch(30, 2), progress=counted.append)
    assert sum(counted) == 60


@needs_engine
def test_ctrl_c_stops_a_long_rollout_at_once():
    batch = random_batch(2000, 50, std=0.05)  # minutes of work
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    progress = []
    with pytest.raises(KeyboardInterrupt):
        rollout(FLAT, **batch, progress=progress.append)
    assert sum(progress) < 2000 * 50


def test_without_the_engine_training_falls_back_with_one_sentence(monkeypatch, capsys):
    monkeypatch.setattr(engine, "_load", lambda: "the engine is not there")
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
    for delay in (0.0, 0.001, 0.002, 0.005, 0.01, 0.02):
        timer = threading.Timer(delay, os.kill, (os.getpid(), signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            timer.start()
            rollout(FLAT, **batch, threads=2)
    assert rollout(FLAT, **random_batch(2, 1, std=1.0), threads=2)[0].shape == (2, 1)


@needs_engine
def test_the_structures_are_those_of_the_library():
    library = engine._library()
    assert library.designrl_engine_batch_bytes() == ctypes.sizeof(engine._Batch)
    assert library.designrl_engine_task_bytes() == ctypes.sizeof(engine._TaskEntry)
