"""The vector environments: SyncVectorEnv's bits in every output, or one clear error."""

import os
from contextlib import suppress

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

import designrl  # noqa: F401
from designrl import engine, envs
from designrl.envs import ant
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
    for result, copy in zip(results, copies, strict=True):
        for a, b in zip(result[:4], copy, strict=True):
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
        ([1, -2, 3], None, "environment 1: a seed must be"),
        (0.5, None, "a seed must be"),
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
    for actions in (np.zeros(shape[1]), None, "left", np.full(shape, "a")):
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
    assert difference(make().reset(seed=np.int64(4)), make().reset(seed=4)) is None


def test_without_the_engine_the_error_names_the_other_way(monkeypatch):
    monkeypatch.setattr(engine, "_load", lambda: "the engine is not there")
    for env_id in IDS:
        with pytest.raises(InputError, match='^the engine is not there; vectorization_mode="sync"'):
            make(env_id)
        gymnasium.make_vec(env_id, 1, vectorization_mode="sync").close()


def test_an_ant_of_other_bits_is_not_simulated(monkeypatch):
    monkeypatch.setattr(envs, "_trials", {})
    monkeypatch.setattr(ant, "GRAVITY", np.nextafter(9.8, 9))
    with pytest.raises(InputError, match='not the reference.s to the bit .*"sync"'):
        make(ANT_ID)


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
        for one, other, ended in zip(expected[3], found[3], found[2], strict=True):
            keys = ("terminal_observation", "TimeLimit.truncated") if ended else ()
            assert set(other) == set(keys)
            for key in keys:
                assert np.array_equal(one[key], other[key])
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
