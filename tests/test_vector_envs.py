"""The vector environments: SyncVectorEnv's bits in every output, or one clear error."""

import copy
import os
import pickle
import re
import signal
import threading
from contextlib import suppress
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

import designrl  # noqa: F401
from designrl import engine
from designrl.engine import stepper
from designrl.envs.sb3 import EngineVecEnv
from designrl.errors import InputError
from designrl.verify.vector import (
    ANT_ID,
    FLAT_ID,
    HARDCORE_ID,
    VECTOR_CASES,
    compare_vector,
    difference,
)

REASON = engine.missing_reason()
pytestmark = pytest.mark.skipif(REASON is not None, reason=str(REASON))
IDS = [FLAT_ID, HARDCORE_ID, ANT_ID]
SAME_STEP = AutoresetMode.SAME_STEP


def make(env_id=FLAT_ID, num_envs=3, **kwargs):
    return gymnasium.make_vec(env_id, num_envs, vectorization_mode="vector_entry_point", **kwargs)


def random_actions(env, steps, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (steps, *env.action_space.shape))


def arrays(info):
    """An environment's info with its numbers as arrays."""
    items = info.items()
    return {k: arrays(v) if isinstance(v, dict) else np.asarray(v) for k, v in items}


def pickled(thing):
    return pickle.loads(pickle.dumps(thing))


def run(env, steps=30, seed=5):
    """All outputs of some steps under actions that depend on the seed alone."""
    return [env.reset(seed=seed), *map(env.step, random_actions(env, steps, seed))]


@pytest.mark.parametrize("case", VECTOR_CASES, ids=str)
def test_every_output_equals_sync_vector_env(case):
    assert compare_vector(case, steps=2000) is None


@pytest.mark.parametrize("env_id", IDS)
def test_outputs_do_not_depend_on_threads_or_on_other_environments(env_id):
    kwargs = {"max_episode_steps": 20, "autoreset_mode": SAME_STEP}
    one = run(make(env_id, 37, threads=1, **kwargs))
    assert difference(one, run(make(env_id, 37, threads=3, **kwargs))) is None
    assert difference(one, run(make(env_id, 37, **kwargs), seed=6)) is not None
    few = make(env_id, 2, **kwargs)
    few.reset(seed=5 + 20)
    actions = random_actions(make(env_id, 37), 30, 5)[:, 20:22]
    for step, expected in zip(map(few.step, actions), one[1:], strict=True):
        for a, b in zip(step[:4], expected[:4], strict=True):
            np.testing.assert_array_equal(a, b[20:22])


@pytest.mark.parametrize("env_id", IDS)
def test_poses_are_those_of_the_reference(env_id):
    space = gymnasium.make(env_id).unwrapped.body.design
    designs = np.random.default_rng(0).uniform(0.5, 1.5, (3, space.size))
    env = make(env_id, 3, design=designs, autoreset_mode=SAME_STEP, max_episode_steps=90)
    sync = SyncVectorEnv(
        [
            lambda design=design: gymnasium.make(env_id, design=design, max_episode_steps=90)
            for design in designs
        ],
        autoreset_mode=SAME_STEP,
    )
    with pytest.raises(ResetNeeded, match="poses\\(\\) before reset"):
        env.poses()
    for each in (env, sync):
        each.reset(seed=5)
    for actions in [None, *random_actions(env, 200)]:
        if actions is not None:
            for each in (env, sync):
                each.step(actions)
        singles = [single.unwrapped for single in sync.envs]
        expected = np.array([np.concatenate(e.body.poses(e), axis=1) for e in singles])
        assert env.poses().tobytes() == expected.tobytes()


@pytest.mark.parametrize("env_id", IDS)
def test_spaces_are_the_single_environments(env_id):
    engine_env = gymnasium.make_vec(env_id, 2)  # the engine is what make_vec takes by itself
    sync = gymnasium.make_vec(env_id, 2, vectorization_mode="sync")
    assert isinstance(sync, SyncVectorEnv) and not isinstance(engine_env, SyncVectorEnv)
    for name in ("observation_space", "action_space"):
        for space in (name, f"single_{name}"):
            assert getattr(engine_env, space) == getattr(sync, space)
    assert engine_env.spec.id == env_id
    assert all(row in engine_env.observation_space for row in [engine_env.reset(seed=0)[0]])


def test_the_time_limit_is_the_registered_one_or_the_one_asked_for():
    for kwargs, limit in (
        ({}, 1600),
        ({"max_episode_steps": 7}, 7),
        ({"max_episode_steps": -1}, 0),
    ):
        env = make(num_envs=1, **kwargs)
        env.reset(seed=2)
        actions = np.random.default_rng(2).uniform(-1, 1, (1700, 1, 4))  # it never falls with them
        truncated = [step for step, action in enumerate(actions, 1) if env.step(action)[3].any()]
        assert truncated[:1] == [limit][: limit > 0]


def test_designs_change_at_reset_and_only_where_asked_for():
    rng = np.random.default_rng(0)
    one, other = rng.uniform(0.25, 1.75, (2, 3, 8))
    env = make(design=one)
    env.reset(seed=1)
    mask = np.array([False, True, True])
    env.reset(seed=1, options={"design": other, "reset_mask": mask})
    np.testing.assert_array_equal(env.design, [one[0], other[1], other[2]])
    env.step(env.action_space.sample())
    fresh = make(design=env.design)
    assert difference(run(env), run(fresh)) is None
    env.reset(options={"design": other[0]})
    np.testing.assert_array_equal(env.design, np.tile(other[0], (3, 1)))


def test_what_it_returns_stays_as_it_was_returned():
    env = make()
    first = env.reset(seed=0)[0]
    kept = first.copy()
    results = [env.step(action) for action in random_actions(env, 5)]
    copies = [[np.copy(array) for array in result[:4]] for result in results]
    env.step(env.action_space.sample())
    np.testing.assert_array_equal(first, kept)
    for result, before in zip(results, copies, strict=True):
        for a, b in zip(result[:4], before, strict=True):
            np.testing.assert_array_equal(a, b)
    first[:] = np.nan  # nor does it see what is done to that
    mask = np.array([True, False, False])
    assert np.isfinite(env.reset(options={"reset_mask": mask})[0]).all()


def test_unseeded_episodes_differ_and_can_be_had_again_from_the_seeds_that_it_tells():
    env, other = make(HARDCORE_ID, 2), make(HARDCORE_ID, 2)
    observations, _ = env.reset()
    assert not np.array_equal(observations, other.reset()[0])
    np.testing.assert_array_equal(other.reset(seed=list(env.np_random_seed))[0], observations)
    assert other.np_random_seed == env.np_random_seed


def test_gymnasiums_vector_wrappers_work_as_around_sync_vector_env():
    results = []
    for mode in ("vector_entry_point", "sync"):
        env = gymnasium.make_vec(HARDCORE_ID, 4, vectorization_mode=mode, max_episode_steps=40)
        env = NormalizeObservation(RecordEpisodeStatistics(env))
        steps = run(env, steps=130)
        for *_, info in steps[1:]:
            if "episode" in info:
                del info["episode"]["t"]
        assert len(env.env.return_queue) >= 12
        results.append((steps, list(env.env.return_queue), list(env.env.length_queue)))
    # The wrapper's deques hold NumPy's numbers.
    (one, *queues), (other, *others) = results
    assert difference(one, other) is None
    assert queues == others


# ------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    "kwargs, message",
    [
        ({"design": np.ones((3, 7))}, r"environment 0: .* 8 scales .*\(7,\)"),
        ({"design": np.ones((4, 8))}, "4 designs for 3 environments"),
        ({"design": np.ones(7)}, "8 scales"),
        ({"design": [[1] * 8, [1] * 8, [1] * 5]}, r"environment 2: .* 8 scales"),
        ({"design": np.array([[1] * 8, [1, 1, 9, 1, 1, 1, 1, 1], [1] * 8])}, r"environment 1: "
         r"design scale 2 \(bottom leg 1 width\) is 9.0"),
        ({"lidar": "v4"}, "lidar is 'v4'"),
        ({"num_envs": 0}, "num_envs is 0"),
        ({"num_envs": 2**70}, r"num_envs is .* to 2\*\*31 - 1"),
        ({"num_envs": 2**31 - 1}, "no memory for 2147483647 environments"),
        ({"threads": 1.5}, "threads is 1.5"),
        ({"autoreset_mode": "Never"}, "must be one of NextStep, SameStep, Disabled"),
        ({"max_episode_steps": 2**64 + 5}, r"max_episode_steps is .* to 2\*\*63 - 1"),
        ({"max_episode_steps": 7.0}, "max_episode_steps is 7.0"),
        ({"threads": 0}, "threads is 0"),
        ({"max_episode_steps": 0}, "max_episode_steps is 0"),
        ({"max_episode_steps": None}, "max_episode_steps is None"),
        ({"render_mode": "rgb_array"}, 'does not render; vectorization_mode="sync" does'),
    ],
    ids=str,
)  # fmt: skip
def test_wrong_arguments_are_refused(kwargs, message):
    with pytest.raises(InputError, match=message):
        make(**kwargs)


@pytest.mark.parametrize(
    "seed, options, message",
    [
        (None, {"desing": np.ones(8)}, "'desing'; there is 'design' and 'reset_mask'"),
        (None, {"design": np.full((3, 8), np.nan)}, "environment 0: design scale 0"),
        (None, {"reset_mask": np.ones(2, dtype=bool)}, "reset_mask must be"),
        (None, {"reset_mask": np.zeros(3, dtype=bool)}, "reset_mask must be"),
        (None, {"reset_mask": [True, True, False]}, "reset_mask must be"),
        ([1, 2], None, "2 seeds for 3 environments"),
        ([1, -2, 3], None, "environment 1: a seed is -2; it must be"),
        (0.5, None, "a seed must be"),
        (2**64 - 2, None, r"environment 2: a seed is .* to 2\*\*64 - 1"),
        (10**400, None, "environment 0: a seed is 1000"),
        (np.zeros((3, 2), dtype=int), None, "environment 0: a seed is array"),
        (np.ma.masked_array([1, 2, 3], mask=[0, 1, 0]), None, "environment 1: a seed is masked"),
        ("123", None, "a seed must be"),
        (None, {"design": [[[1, 2], 3]] * 3}, "8 numbers"),
        (None, {"design": [[1] * 8, [1j] * 8, [1] * 8]}, "environment 1: .* 8 numbers"),
        (None, {"design": np.ma.masked_array(np.ones(8), mask=True)}, "8 numbers"),
        (None, {"design": [10**400] * 8}, "8 numbers"),
    ],
    ids=str,
)
def test_a_wrong_reset_is_refused_and_changes_nothing(seed, options, message):
    env, other = make(), make()
    for each in (env, other):
        each.reset(seed=0)
    with pytest.raises(InputError, match=message):
        env.reset(seed=seed, options=options)
    for action in random_actions(env, 3):
        assert difference(env.step(action), other.step(action)) is None


@pytest.mark.parametrize("env_id", IDS)
def test_wrong_actions_are_refused_and_change_nothing(env_id):
    env, other = make(env_id), make(env_id)
    for each in (env, other):
        each.reset(seed=0)
    shape = env.action_space.shape
    nan = np.zeros(shape)
    nan[1, 2] = np.nan
    wrong = {f"environment 1: an action must be {shape[1]} finite numbers": nan}
    wrong[r"actions must be \(3, "] = np.zeros((3, shape[1] + 1))
    for message, actions in wrong.items():
        with pytest.raises(InputError, match=message):
            env.step(actions)
    masked = np.ma.masked_array(np.zeros(shape), mask=True)
    huge, ragged = [[10**400] * shape[1]] * 3, [[0.0], [0.0, 0.0], []]
    strange = (np.zeros(shape) + 1j, masked, huge, ragged, np.full(shape, "0"))
    for actions in (np.zeros(shape[1]), None, "left", np.full(shape, "a"), *strange):
        with pytest.raises(InputError, match="actions must be"):
            env.step(actions)
    action = other.action_space.sample()
    assert difference(env.step(action), other.step(action)) is None


def test_steps_out_of_order_are_refused():
    env = make(autoreset_mode="Disabled", max_episode_steps=1)
    still = np.zeros(env.action_space.shape)
    with pytest.raises(ResetNeeded, match=r"step\(\) before reset\(\)"):
        env.step(still)
    mask = np.array([True, False, False])
    with pytest.raises(ResetNeeded, match="the first reset must be of all"):
        env.reset(options={"reset_mask": mask})
    env.reset(seed=0)
    env.step(still)
    env.reset(options={"reset_mask": mask})
    with pytest.raises(ResetNeeded, match="the episode of environment 1 has ended"):
        env.step(still)
    env.close()
    env.close()
    for call in (env.reset, lambda: env.step(still)):
        with pytest.raises(ClosedEnvironmentError, match=r"\(\) after close\(\)"):
            call()


def test_a_forks_environments_are_not_stepped_and_its_end_is_no_hang():
    env = make(threads=2)
    env.reset(seed=0)
    child = os.fork()
    if child == 0:
        with suppress(InputError):
            env.step(env.action_space.sample())
            os._exit(1)
        env.close()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    env.step(env.action_space.sample())


def test_an_episode_beyond_the_capacities_is_an_error_and_no_result():
    env = make(num_envs=70)
    wide = np.ones((70, 8))
    wide[66, ::2] = 1000.0  # no design within the bounds was ever seen to get there
    env._design[:] = wide
    with pytest.raises(InputError, match="environment 66 has more contacts than"):
        run(env, 200)
    with pytest.raises(ResetNeeded):
        env.step(env.action_space.sample())
    env.reset(seed=0, options={"design": np.ones(8)})
    fresh = make(num_envs=70)
    assert difference(run(env), run(fresh)) is None


@pytest.mark.filterwarnings("ignore:.*ERROR")
def test_sub_processes_pass_the_sentence_on():
    env = gymnasium.make_vec(FLAT_ID, 2, vectorization_mode="async")
    with pytest.raises(InputError, match="design scale 0"):
        env.reset(options={"design": np.full(8, 3.0)})
    env.close(terminate=True)


def test_numpys_numbers_are_seeds():
    assert difference(make().reset(seed=np.arange(4, 7)), make().reset(seed=4)) is None
    for seed in (np.int64(4), np.array(4)):
        assert difference(make().reset(seed=seed), make().reset(seed=4)) is None
    last = np.uint8(254)  # whose sums wrap around
    env = make()
    assert difference(env.reset(seed=last), make().reset(seed=254)) is None
    assert env.np_random_seed == (254, 255, 256)
    wrapped = EngineVecEnv(FLAT_ID, 3, seed=last)
    assert difference(wrapped.reset(), env.reset(seed=254)[0]) is None


def test_without_the_engine_the_error_names_the_other_way(monkeypatch):
    monkeypatch.setattr(engine, "_load", lambda: "the engine is not there")
    for env_id in IDS:
        with pytest.raises(InputError, match='^the engine is not there; vectorization_mode="sync"'):
            make(env_id, threads=1)
        env = gymnasium.make_vec(
            env_id, 1, "sync", vector_kwargs={"autoreset_mode": SAME_STEP}, design=None
        )
        assert env.autoreset_mode == SAME_STEP
        env.close()
        with pytest.raises(InputError, match="^the engine is not there; .*DummyVecEnv") as error:
            EngineVecEnv(env_id, 2)
        advice = re.search(r"DummyVecEnv\(.*\* 2\)", str(error.value))[0]
        assert eval(advice).reset().shape[0] == 2


def test_stable_baselines3s_environment_refuses_others_and_reset_modes():
    for wrong in ({"env_id": "CartPole-v1"}, {"autoreset_mode": "Disabled"}):
        with pytest.raises(InputError, match="EngineVecEnv is for designrl/BipedalWalker-v0, "):
            EngineVecEnv(**{"env_id": FLAT_ID, "num_envs": 2, **wrong})


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, SAME_STEP])
def test_flat_infos_are_the_nested_ones(mode):
    kwargs = {"max_episode_steps": 7, "autoreset_mode": mode}
    nested, flat = run(make(**kwargs)), run(make(**kwargs, flat_info=True))
    for (*one, one_info), (*other, other_info) in zip(nested, flat, strict=True):
        assert difference(one, other) is None
        for info in (one_info, one_info.get("final_info", {})):
            info.pop("_reward_terms", None)
            terms = info.pop("reward_terms", {}).items()
            info |= {f"_reward{k}" if k[0] == "_" else f"reward_{k}": v for k, v in terms}
        assert difference(one_info, other_info) is None
    assert len(nested) == 31 and "reward_progress" in flat[1][-1]


def test_its_autoreset_mode_and_base_class_are_gymnasiums():
    for env_id in IDS:
        env = make(env_id, autoreset_mode="SameStep")
        assert env.autoreset_mode == env.metadata["autoreset_mode"] == SAME_STEP
        assert VectorEnv in type(env).__bases__  # some libraries look no further


# -------------------------------------------------------------------- memory, threads, interrupts


class Interrupting:
    """The library, with a Ctrl-C while one of its functions runs."""

    def __init__(self, name):
        self.library, self.name, self.owners = stepper._library(), name, []

    def __getattr__(self, name):
        function = getattr(self.library, name)
        if name != f"designrl_stepper_{self.name}":
            return function

        def interrupted(owner, *arguments):
            function(owner, *arguments)
            self.owners.append(owner._obj)
            signal.raise_signal(signal.SIGINT)

        return interrupted


@pytest.mark.parametrize("env_id", [FLAT_ID, ANT_ID])
def test_ctrl_c_while_it_closes_frees_once(env_id):
    env = make(env_id, threads=2)
    env.reset(seed=0)
    env._stepper._library = library = Interrupting("free")
    with pytest.raises(KeyboardInterrupt):
        env.close()
    env._stepper._library = library.library
    env.close()
    with pytest.raises(InputError, match="closed"):
        env._stepper.get_states()
    with pytest.raises(ClosedEnvironmentError):
        env.step(env.action_space.sample())


def test_ctrl_c_while_it_is_made_leaks_nothing(monkeypatch):
    library = Interrupting("make")
    with monkeypatch.context() as patch:
        patch.setattr(stepper, "_library", lambda: library)
        with pytest.raises(KeyboardInterrupt):
            make(num_envs=3, threads=2)
    (owner,) = library.owners
    assert not owner  # it was made, and was freed


@pytest.mark.parametrize("call", ["run", "states"])
def test_ctrl_c_in_a_call_asks_for_a_reset(call):
    env = make(threads=2)
    env.reset(seed=0)
    states = env.get_state()
    env._stepper._library = Interrupting(call)
    action = env.action_space.sample()
    with pytest.raises(KeyboardInterrupt):
        env.step(action) if call == "run" else env.set_state(states)
    env._stepper._library = env._stepper._library.library
    with pytest.raises(ResetNeeded):
        env.step(action)
    assert difference(run(env), run(make())) is None


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickled])
@pytest.mark.parametrize("env_id", [FLAT_ID, ANT_ID])
def test_a_copy_is_an_environment_of_its_own_that_goes_on_alike(env_id, copied):
    env = make(env_id, num_envs=5, max_episode_steps=20, autoreset_mode=SAME_STEP)
    fresh = copied(env)
    with pytest.raises(ResetNeeded):
        fresh.step(env.action_space.sample())
    assert difference(run(fresh), run(env)) is None
    other = copied(env)
    for action in random_actions(env, 25, 1):
        expected = env.step(action)
        assert difference(expected, other.step(action)) is None
    assert difference(env.reset(), other.reset()) is None  # their random numbers, too
    env.close()
    other.step(action)
    twin = copied(other._stepper)
    other.close()
    twin.step(np.zeros(env.action_space.shape))
    twin.close()
    with pytest.raises(InputError, match="closed"):
        copied(twin)


def test_two_threads_take_turns():
    env, alone = (make(num_envs=9, threads=2) for _ in range(2))
    for each in (env, alone):
        each.reset(seed=0)
    still = np.zeros(env.action_space.shape)

    def work():
        for _ in range(40):
            env.step(still)

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for _ in range(120):
        alone.step(still)
    assert difference(env.step(still), alone.step(still)) is None


def test_close_waits_for_the_step_of_another_thread():
    for _ in range(10):
        env, stepped, errors = make(num_envs=9, threads=2), threading.Event(), []
        env.reset(seed=0)
        still = np.zeros(env.action_space.shape)

        def work(env=env, stepped=stepped, errors=errors, still=still):
            try:
                while True:
                    env.step(still)
                    stepped.set()
            except ClosedEnvironmentError as error:
                errors.append(error)

        thread = threading.Thread(target=work)
        thread.start()
        stepped.wait()
        env.close()
        thread.join()
        assert errors


# ------------------------------------------------------------------------------- save and restore


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("env_id", IDS)
def test_what_follows_a_restore_has_the_bits_of_what_followed_the_save(env_id, mode):
    limit = None if mode == AutoresetMode.DISABLED else 45
    kwargs = {"autoreset_mode": mode, **({"max_episode_steps": limit} if limit else {})}
    size = make(env_id).design.shape[1]
    designs = np.random.default_rng(1).uniform(0.75, 1.25, (5, size))
    env = make(env_id, 5, design=designs, threads=2, **kwargs)
    run(env, 37)  # touching the ground, and one step before some of them are reset
    states = pickled(env.get_state())
    actions = 0.3 * random_actions(env, 20, 1)

    def follow(env):
        found = []
        for action in actions:
            if mode == AutoresetMode.DISABLED and env._ended.any():
                found.append(env.reset(options={"reset_mask": env._ended.copy()}))
            found.append(env.step(action))
        return [*found, [env.np_random_seed, env.design.tolist()]]

    expected = follow(env)
    assert difference(expected[:-1], follow(copy.copy(env))[:-1]) is not None
    others = [make(env_id, 5, threads=threads, **kwargs) for threads in (1, 3)]
    others[1].reset(seed=9)
    for other in (env, *others):
        other.set_state(states)
        found = follow(other)
        assert difference(expected[:-1], found[:-1]) is None
        assert expected[-1] == found[-1]


@pytest.mark.parametrize("env_id", IDS)
def test_one_state_has_many_futures_in_any_place_and_on_any_processor(env_id, monkeypatch):
    env = make(env_id, 11)
    run(env, 40)
    state = env.get_state()[7]
    actions = random_actions(env, 10, 2)[:, :1]
    results = []
    for isa in engine.instruction_sets():
        monkeypatch.setenv(engine.ISA_VARIABLE, isa)
        many = make(env_id, 40)
        many.set_state([state] * 40)
        steps = [many.step(np.repeat(action, 40, axis=0)) for action in actions]
        results.append([each[:4] for each in steps])
        for output in results[-1][-1]:
            assert (output == output[0]).all()
    for result in results:
        assert difference(result, results[0]) is None
    env.set_state([state] * 11)
    steps = [env.step(np.repeat(action, 11, axis=0)) for action in actions]
    np.testing.assert_array_equal(steps[-1][0][0], results[0][-1][0][0])


def test_states_of_another_kind_are_refused_and_change_nothing():
    env, other = make(), make()
    with pytest.raises(ResetNeeded, match=r"get_state\(\) before reset"):
        env.get_state()
    for each in (env, other):
        each.reset(seed=0)
    hardcore, ants = make(HARDCORE_ID), make(ANT_ID)
    for each in (hardcore, ants):
        each.reset(seed=0)
    (state, *rest) = env.get_state()
    old, cut = (
        [state._replace(engine=replace(state.engine, **change)), *rest]
        for change in ({"code": "of long ago"}, {"data": b""})
    )
    for states, message in (
        (hardcore.get_state(), "state 0 is not one of these"),
        (ants.get_state(), "state 0 is not one of these"),
        ([state, state], "2 states for 3"),
        ([], "0 states for 3"),
        (None, "what get_state"),
        ([state, state, 1], "what get_state"),
        (old, "another version"),
        (cut, "another version"),
    ):
        with pytest.raises(InputError, match=message):
            env.set_state(states)
    wide = make(design=3.0 * np.ones(8), design_bounds=(0.25, 4.0))
    wide.reset(seed=0)
    with pytest.raises(InputError, match="is 3.0; each must be in"):
        env.set_state(wide.get_state())
    action = env.action_space.sample()
    assert difference(env.step(action), other.step(action)) is None
    env.close()
    with pytest.raises(ClosedEnvironmentError):
        env.set_state([state] * 3)


# ------------------------------------------------------------------------------ Stable-Baselines3


@pytest.mark.parametrize("env_id", [FLAT_ID, ANT_ID])
def test_stable_baselines3_gets_what_its_own_vec_env_gives(env_id):
    kwargs = {"max_episode_steps": 25}
    singles = DummyVecEnv([lambda: gymnasium.make(env_id, **kwargs)] * 3)
    ours = EngineVecEnv(env_id, 3, **kwargs)
    for env in (singles, ours):
        env.seed(4)
    assert difference(singles.reset(), ours.reset()) is None
    for actions in random_actions(ours.env, 60):
        expected, found = singles.step(actions), ours.step(actions)
        assert difference(expected[:3], found[:3]) is None
        for one, other in zip(expected[3], found[3], strict=True):
            assert difference(arrays(one), arrays(other)) is None
    body = np.full(ours.env.design.shape[1], 1.2)
    for options in ([{"design": body}, {}, {}], {"design": None}):
        for env in (singles, ours):
            env.set_options(options)
        assert difference(singles.reset(), ours.reset()) is None
        assert np.array_equal(ours.get_attr("design"), singles.get_attr("design"))


def test_stable_baselines3_trains_on_it():
    env = VecNormalize(VecMonitor(EngineVecEnv(HARDCORE_ID, 8, seed=0, max_episode_steps=50)))
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=64, n_epochs=2, seed=0)
    model.learn(total_timesteps=1024)
    assert model.num_timesteps == 1024
    assert len(model.ep_info_buffer) >= 8
    off_policy = SAC("MlpPolicy", EngineVecEnv(ANT_ID, 4), learning_starts=64, seed=0)
    off_policy.learn(total_timesteps=200)
    assert off_policy.num_timesteps == 200
    for call in (lambda: env.env_method("fly"), lambda: env.set_attr("wings", 2)):
        with pytest.raises(InputError, match="in the engine"):
            call()
