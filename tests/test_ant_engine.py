"""The compiled engine's ant has the bits of the reference, whatever it runs on."""

import math

import numpy as np
import pytest

from designrl import engine
from designrl.bodies.ant import ANT
from designrl.engine import rollout
from designrl.envs import tasks
from designrl.envs.tasks import engine_task
from designrl.errors import InputError
from designrl.experiments import ANT_NETWORK, AUTHOR_ANT_NETWORK, Network, get_experiment
from designrl.policy import noise_stds
from designrl.simulation import Simulator
from designrl.verify.episodes import (
    OTHER_ANT_NETWORKS,
    Case,
    compare,
    difference,
    full_manifold_case,
    make_ant_cases,
    on_engine,
    on_reference,
    with_other_limits,
)

REASON = engine.missing_reason()
pytestmark = pytest.mark.skipif(REASON is not None, reason=str(REASON))
TASK, _ = engine_task(get_experiment("ant").env_id)
SHORT, _ = engine_task(get_experiment("ant").env_id, max_episode_steps=60)


def random_batch(candidates, rollouts, seed=0, std=0.3, network=ANT_NETWORK):
    rng = np.random.default_rng(seed)
    return {
        "sizes": network.sizes,
        "output_tanh": network.output == "tanh",
        "time_scale": network.time_scale,
        "weights": std * rng.standard_normal((candidates, network.num_weights)),
        "noise_stds": rng.uniform(0.0, 1.0, (candidates, 8)) if network.noise else None,
        "designs": rng.uniform(0.25, 1.75, (candidates, ANT.design.size)),
        "reward_factors": np.ones(candidates),
        "seeds": rng.integers(2**63, size=(candidates, rollouts)),
    }


def rows_of(batch, rows):
    return {
        name: value[rows] if isinstance(value, np.ndarray) else value
        for name, value in batch.items()
    }


@pytest.mark.parametrize("case", make_ant_cases(40, seed=3), ids=lambda c: f"{c.kind}-{c.seed}")
def test_every_observation_and_the_return_equal_pybullet(case):
    assert compare(case)[1] is None


@pytest.mark.parametrize(
    "case", with_other_limits(make_ant_cases(16, seed=4)), ids=lambda c: f"{c.kind}-{c.seed}"
)
def test_bodies_of_other_limits_equal_pybullet(case):
    assert compare(case)[1] is None


def test_a_fifth_contact_point_takes_the_place_of_the_same_one():
    assert compare(full_manifold_case())[1] is None


@pytest.mark.parametrize("isa", engine.instruction_sets())
def test_every_instruction_set_equals_pybullet(isa):
    for case in make_ant_cases(48, seed=6)[1::12]:
        assert difference(on_reference(case), on_engine(case, isa)) is None


@pytest.mark.parametrize(
    "network",
    [ANT_NETWORK, AUTHOR_ANT_NETWORK, *OTHER_ANT_NETWORKS],
    ids=lambda network: "-".join(map(str, network.sizes)),
)
def test_an_episode_does_not_depend_on_what_runs_beside_it(network):
    batch = random_batch(21, 2, network=network)  # more than two vectors full
    expected = rollout(SHORT, **batch, threads=1)
    for isa in engine.instruction_sets():
        for threads in (1, 3):
            for a, b in zip(
                expected, rollout(SHORT, **batch, threads=threads, isa=isa), strict=True
            ):
                assert np.array_equal(a, b)
    alone = rollout(SHORT, **rows_of(batch, slice(13, 14)), threads=1)
    for a, b in zip(expected, alone, strict=True):
        assert np.array_equal(a[13:14], b)


def test_lanes_are_filled_again_as_episodes_end():
    # Some fall at once, some stand: in whichever lane and after whomever, each is as if alone.
    batch = random_batch(40, 1, std=1.0)
    returns, steps = rollout(TASK, **batch, threads=1)
    assert len(set(steps.ravel().tolist())) > 10
    for i in (0, 9, 23, 39):
        alone = rollout(TASK, **rows_of(batch, slice(i, i + 1)))
        assert (returns[i], steps[i]) == (alone[0][0], alone[1][0])


def test_the_noise_is_that_of_the_seed_and_the_log_stds():
    batch = random_batch(3, 1)
    quiet = rollout(SHORT, **{**batch, "noise_stds": np.zeros((3, 8))})[0]
    assert np.array_equal(quiet, rollout(SHORT, **{**batch, "noise_stds": None})[0])
    assert not np.array_equal(quiet, rollout(SHORT, **batch)[0])
    log_stds = np.random.default_rng(0).standard_normal((5, 8))
    assert noise_stds(log_stds)[2].tolist() == [math.exp(0.5 * x) for x in log_stds[2]]


@pytest.mark.filterwarnings("ignore:overflow")  # of the reference's noise in single precision
def test_noise_without_bounds_equals_the_references():
    experiment = get_experiment("ant")
    parameters = 0.1 * np.random.default_rng(0).standard_normal(experiment.num_parameters)
    parameters[-8:] = 1e30
    assert compare(Case("loud", "ant", parameters, 5))[1] is None


@pytest.mark.parametrize(
    "change",
    [
        {"sizes": (28, 64, 32, 8)},
        {"time_scale": None},
        {"time_scale": 0.0},
        {"noise_stds": np.zeros((4, 7))},
        {"noise_stds": np.full((4, 8), np.inf)},
        {"designs": np.ones((4, 8))},
    ],
    ids=lambda change: next(iter(change)),
)
def test_arguments_that_do_not_fit_are_refused(change):
    name = next(iter(change))
    wrong = "network" if name == "sizes" or change == {"time_scale": None} else name
    with pytest.raises(InputError, match=wrong):
        rollout(SHORT, **{**random_batch(4, 1), **change})


def test_an_action_that_is_no_number_is_an_error_as_in_the_reference():
    network = Network((29, 8, 8), "linear", time_scale=1000.0)
    batch = random_batch(3, 1, network=network)
    batch["weights"][1, -80:] = 3e38
    with pytest.raises(InputError, match="candidate 1 .* no finite number"):
        rollout(SHORT, **batch)


def test_bits_that_are_not_the_references_are_noticed(monkeypatch, capsys):
    # Another C library or Bullet: here, a gravity that is smaller by its last bit.
    from designrl.envs import ant

    monkeypatch.setattr(tasks, "trial", tasks.trial.__wrapped__)
    monkeypatch.setattr(ant, "GRAVITY", np.nextafter(9.8, 9))
    with Simulator("ant", "engine") as simulator:
        assert simulator.backend == "reference"
    said = capsys.readouterr().err.strip()
    assert "not the reference's to the bit" in said
    assert len(said.splitlines()) == 1
    monkeypatch.undo()
    assert tasks.engine_reason("designrl/Ant-v0") is None


def test_without_pybullet_bits_are_compared_with_those_that_it_gave_elsewhere(monkeypatch):
    monkeypatch.setattr(tasks, "trial", tasks.trial.__wrapped__)
    monkeypatch.setattr(tasks, "find_spec", lambda name: None)
    assert tasks.engine_reason("designrl/Ant-v0") is None
    monkeypatch.setattr(tasks, "TRIAL_STEPS", tasks.TRIAL_STEPS - 1)  # other bits
    assert "not the reference's to the bit" in tasks.engine_reason("designrl/Ant-v0")


def test_workers_without_the_engine_use_the_reference(monkeypatch):
    with Simulator("ant-morphology", "engine") as simulator:
        candidates = 0.5 * np.random.default_rng(3).standard_normal(
            (1, simulator.experiment.num_parameters)
        )
        compiled = simulator.rollout(candidates, np.array([[7]]))
        monkeypatch.setattr(engine, "_load", lambda: "the engine is not there")
        reference = simulator.rollout(candidates, np.array([[7]]))
    assert np.array_equal(compiled.returns, reference.returns)
    assert np.array_equal(compiled.steps, reference.steps)
