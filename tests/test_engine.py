"""The compiled engine gives the bits of the reference, whatever it runs on."""

import ctypes
import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from designrl import engine
from designrl.bodies.walker import WALKER
from designrl.engine import Task, act_function, instruction_set, rollout, stepper
from designrl.envs.tasks import engine_task
from designrl.errors import InputError
from designrl.experiments import Network, get_experiment
from designrl.policy import Agent, forward_function
from designrl.simulation import Simulator
from designrl.verify.episodes import (
    TERRAINS,
    Case,
    author_policies,
    compare,
    difference,
    make_cases,
    on_engine,
    on_reference,
    with_other_limits,
)

NETWORK = Network((24, 40, 40, 4))  # the walkers' own
REASON = engine.missing_reason()
FLAT, HARDCORE = (engine_task(get_experiment(name).env_id)[0] for name in TERRAINS)
NETWORKS = [
    pytest.param(get_experiment(name), network, id=f"{name}-{network.sizes[1]}")
    for name in ("biped", "ant")
    for network in get_experiment(name).networks
]
pytestmark = pytest.mark.skipif(REASON is not None, reason=str(REASON))


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
    seed = int(batch["seeds"][i, 0])
    return Case("random", experiment, parameters, seed, env_kwargs={"lidar": lidar})


def assert_same(one, other):
    """Two results of `rollout`, or parts of them."""
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("case", make_cases(32, seed=3), ids=lambda case: f"seed{case.seed}")
def test_every_observation_and_the_return_equal_box2d(case):
    assert compare(case)[1] is None


@pytest.mark.parametrize(
    "case", with_other_limits(make_cases(24, seed=4)), ids=lambda case: f"seed{case.seed}"
)
def test_bodies_of_other_limits_equal_box2d(case):
    assert compare(case)[1] is None


@pytest.mark.parametrize("policy", author_policies() or [None], ids=lambda p: p[0] if p else "none")
def test_trained_policies_walk_the_same_course_and_earn_the_bonus_of_shaped_rewards(policy):
    if policy is None:
        pytest.skip("the author's weights are not here; set AUTHOR_ZOO to their folder")
    kind, parameters = policy
    case = Case(kind, TERRAINS["hardcore" in kind], parameters, seed=17, shaped=True)
    assert compare(case)[1] is None


def test_the_two_lidars_differ_and_each_equals_box2d():
    batch = random_batch(24, 1, seed=9)
    seen = {}
    for lidar in ("v2", "v3"):
        task, _ = engine_task("designrl/BipedalWalkerHardcore-v0", lidar=lidar)
        seen[lidar] = rollout(task, **batch, observations=True)[2]
    differs = [i for i in range(24) if not np.array_equal(seen["v2"][i][0], seen["v3"][i][0])]
    i = min(differs, key=lambda i: len(seen["v2"][i][0]))
    for lidar in seen:
        assert compare(case_of(batch, i, TERRAINS[1], lidar=lidar))[1] is None


def test_a_motionless_walker_falls_asleep_as_in_box2d():
    # After half a second at rest Box2D stops all bodies: velocities are exactly zero.
    batch = random_batch(16, 1, std=0.1)
    seen = rollout(FLAT, **batch, observations=True)[2]
    asleep = [i for i in range(16) if (seen[i][0][:, 1:4] == 0.0).all(axis=1).any()]
    assert asleep
    assert compare(case_of(batch, asleep[0], TERRAINS[0]))[1] is None


def test_the_widest_network_equals_box2d():
    network = Network((24, 8, 256, 4), "linear")
    rng = np.random.default_rng(8)
    for experiment in TERRAINS:
        parameters = 0.5 * rng.standard_normal(network.num_parameters + WALKER.design.size)
        assert compare(Case("random", experiment, parameters, 4, network))[1] is None


@pytest.mark.parametrize("experiment, network", NETWORKS)
def test_the_compiled_policy_has_the_bits_of_the_policy(experiment, network):
    rng = np.random.default_rng(5)
    size, outputs = experiment.parameters_with(network), network.sizes[-1]
    for std in (0.1, 10.0):  # the latter saturates
        agent = Agent(experiment, std * rng.standard_normal(size), network)
        weights = agent.parameters[: network.num_weights]
        act = act_function(network.sizes, network.output == "tanh", weights)
        in_numpy = forward_function(network, weights)
        for x in rng.standard_normal((50, network.sizes[0])).astype(np.float32):
            for noise in (None, rng.standard_normal(outputs).astype(np.float32)):
                assert in_numpy(x, noise).tobytes() == act(x, noise).tobytes()
    for wrong in ((x[1:], None), (x, np.zeros(outputs + 1))):
        with pytest.raises(InputError, match=f"takes {network.sizes[0]} values"):
            act(*wrong)


def test_the_compiled_policy_refuses_weights_that_do_not_fit():
    act_function((4, 3, 2), True, np.zeros(23))
    with pytest.raises(InputError, match=r"weights must have shape \(23,\)"):
        act_function((4, 3, 2), True, np.zeros(22))
    with pytest.raises(InputError, match="1 to 256 values"):
        act_function((4, 257, 2), True, np.zeros(5 * 257 + 258 * 2))


@pytest.mark.parametrize("name", ["biped", "ant-morphology"])
def test_without_the_library_episodes_are_the_same(name, monkeypatch, capsys):
    results = []
    for missing in (False, True):
        if missing:
            monkeypatch.setattr(engine, "_load", lambda: "the engine is not there")
        with Simulator(name, "engine") as simulator:
            size = simulator.experiment.num_parameters
            candidates = 0.5 * np.random.default_rng(3).standard_normal((1, size))
            result = simulator.rollout(candidates, np.array([[7]]))
            results.append((result.returns, result.steps))
    assert simulator.backend == "reference"
    assert_same(*results)
    sentence = "designrl: the engine is not there; using the reference environment\n"
    assert capsys.readouterr().err == sentence


def test_a_library_of_another_version_is_refused(monkeypatch):
    monkeypatch.setattr(engine, "_load", engine._load.__wrapped__)
    with monkeypatch.context() as patch:
        patch.setattr(engine, "_Batch", ctypes.c_int64)
        assert "of another version" in engine._load()
    monkeypatch.setattr(engine, "_Stepping", ctypes.c_int64)
    with pytest.raises(InputError, match="of another version"):
        stepper.Stepper(FLAT, 1)


@pytest.mark.parametrize(
    "keywords, backend",
    [
        ({"hardcore": True}, "engine"),
        ({"lidar": "v3"}, "engine"),
        ({"render_mode": None}, "reference"),
    ],
)
def test_keywords_of_the_environment_mean_the_same_on_the_engine(keywords, backend):
    candidates = np.random.default_rng(3).standard_normal((1, 2804))
    results = []
    for asked in ("engine", "reference"):
        with Simulator("biped", asked, **keywords) as simulator:
            assert simulator.backend == (backend if asked == "engine" else asked)
            result = simulator.rollout(candidates, np.array([[7]]))
            results.append((result.returns, result.steps))
    assert_same(*results)


@pytest.mark.parametrize("task", [FLAT, HARDCORE], ids=["flat", "hardcore"])
def test_results_do_not_depend_on_threads_or_on_the_rest_of_the_batch(task):
    batch = random_batch(36, 1)  # more than one group of vectors
    one = rollout(task, **batch, threads=1)
    assert_same(one, rollout(task, **batch, threads=3))
    only = {name: value if name == "sizes" else value[7:8] for name, value in batch.items()}
    assert_same([result[7:8] for result in one], rollout(task, **only, threads=1))


@pytest.mark.parametrize("isa", engine.instruction_sets())
def test_every_instruction_set_equals_box2d(isa, monkeypatch):
    monkeypatch.setenv(engine.ISA_VARIABLE, isa)
    assert instruction_set() == isa
    for case in make_cases(48, seed=6)[::12]:
        assert difference(on_reference(case), on_engine(case, isa)) is None


@pytest.mark.parametrize(
    "change, message",
    [
        ({"task": Task("swimmer", (), 100)}, "the task 'swimmer'"),
        ({"task": Task("walker", ("icy",), 100)}, "the flag 'icy'; it has hardcore, closest_hits"),
        ({"task": Task("walker", (), 0)}, "max_steps is 0"),
        ({"task": Task("walker", (), 2**64 + 5)}, r"max_steps is .* to 2\*\*63 - 1"),
        ({"threads": 1.5}, "threads is 1.5"),
        ({"isa": "mmx"}, "'mmx' .* is no instruction set of this processor"),
        ({"sizes": (23, 40, 40, 4)}, "a network 23-40-40-4 does not fit"),
        ({"sizes": (24, 40, 40, 3)}, "a network 24-40-40-3 does not fit"),
        ({"sizes": (24, 257, 4)}, "layers of 1 to 256 values"),
        ({"weights": np.zeros((4, 5))}, "weights must have shape"),
        ({"designs": np.ones((3, 8))}, "designs must have shape"),
        ({"reward_factors": np.ones(3)}, "reward_factors must have shape"),
        ({"seeds": np.zeros(4, dtype=int)}, "seeds must be"),
        ({"seeds": np.full((4, 1), -1)}, "seeds must be"),
        ({"seeds": np.full((4, 1), 0.5)}, "seeds must be"),
        ({"seeds": np.full((4, 1), 2**63, dtype=np.uint64)}, "seeds must be"),
        ({"seeds": np.ma.masked_array(np.ones((4, 1), dtype=int), mask=True)}, "seeds must be"),
        ({"seeds": [[1], [2, 3], [4], [5]]}, "seeds must be"),
        ({"designs": np.ones((4, 8)) + 1j}, "designs must be an array of real numbers"),
        ({"weights": np.full((4, 2804), 1e300)}, "weights.* is not a finite number"),
        ({"designs": np.full((4, 8), np.nan)}, "designs.* is not a finite number"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_what_the_library_does_not_have_or_would_leave_its_memory_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        rollout(**{"task": FLAT, **random_batch(4, 1), **change})


@pytest.mark.parametrize("widths", [300.0, 1000.0])
def test_an_episode_beyond_the_capacities_is_an_error_and_no_result(widths):
    # No design within the bounds was ever seen to get there: these legs are wider than the course.
    batch = random_batch(4, 2, std=1.0)
    batch["designs"][2, ::2] = widths
    with pytest.raises(InputError, match="candidate 2 with seed .* has more contacts") as error:
        rollout(FLAT, **batch)
    assert any(str(seed) in str(error.value) for seed in batch["seeds"][2])


def test_an_action_that_is_no_number_is_an_error_and_no_result():
    network = Network((24, 4), "linear")
    batch = random_batch(2, 2, network=network)
    batch["weights"][1] = 3e38  # sums are infinite, and the noise on them has both signs
    noise_stds = np.array([[0.0], [1e308]]) * np.ones(4)
    with pytest.raises(InputError, match="candidate 1 with seed .* no finite number"):
        rollout(FLAT, **batch, output_tanh=False, noise_stds=noise_stds)


# As a libm of another make: the last bit of every sine is another.
OTHER_LIBM = """
#include <math.h>
void sincosf(float x, float *s, float *c) { *s = nextafterf(sinf(x), 2.0f); *c = cosf(x); }
"""
WALK = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_engine import HARDCORE, random_batch, rollout
for isa in sys.argv[1:]:
    print(rollout(HARDCORE, **random_batch(20, 1), isa=isa)[0].ravel().tolist())
"""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_a_libm_with_other_sines_is_asked_instead(tmp_path):
    source, library = tmp_path / "libm.c", tmp_path / "libm.so"
    source.write_text(OTHER_LIBM)
    subprocess.run(
        ["gcc", "-shared", "-fPIC", "-O1", "-fno-builtin", source, "-o", library, "-lm"], check=True
    )
    seen = []
    already = os.environ.get("LD_PRELOAD", "")
    for preload in (already, f"{already} {library}"):
        asking = [isa for isa in engine.instruction_sets() if isa != "portable"]
        command = [sys.executable, "-c", WALK, *asking]
        environment = {**os.environ, "LD_PRELOAD": preload}
        output = subprocess.run(
            command, env=environment, check=True, capture_output=True, text=True
        )
        seen.append(set(output.stdout.splitlines()))
    assert [len(results) for results in seen] == [1, 1]  # of all that ask it
    assert seen[0] != seen[1]


def test_progress_counts_every_episode_once():
    counted = []
    rollout(FLAT, **random_batch(30, 2), progress=counted.append)
    assert sum(counted) == 60


def interrupt_after(seconds, *signals):
    def send():
        for number in signals or (signal.SIGINT,):
            os.kill(os.getpid(), number)

    threading.Timer(seconds, send).start()


def test_two_signals_at_once_are_one_interrupt():
    # `make train-all` sends SIGTERM while the terminal's Ctrl-C has not been handled yet.
    batch = random_batch(2000, 50, std=0.05)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        for _ in range(5):
            with pytest.raises(KeyboardInterrupt):
                interrupt_after(0.3, signal.SIGINT, signal.SIGTERM)
                rollout(FLAT, **batch)
    finally:
        signal.signal(signal.SIGTERM, before)


def test_interrupts_at_any_moment_leave_a_working_engine():
    batch = random_batch(200, 20, std=0.05)
    for delay in (0.0, 0.001, 0.002, 0.005, 0.01, 0.02):
        with pytest.raises(KeyboardInterrupt):
            interrupt_after(delay)
            rollout(FLAT, **batch, threads=2)
    assert rollout(FLAT, **random_batch(2, 1, std=1.0), threads=2)[0].shape == (2, 1)


def test_an_engine_of_other_sources_than_are_beside_it_is_not_used(monkeypatch):
    monkeypatch.setattr(engine, "engine_hash", lambda: "of edited sources")
    assert "compiled from other sources" in engine._load.__wrapped__()
