"""What all environments hold to: Gymnasium's rules, and episodes that repeat to the bit."""

import copy
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import designrl  # noqa: F401

STEPS = {
    "designrl/BipedalWalker-v0": 1600,
    "designrl/BipedalWalkerHardcore-v0": 2000,
    "designrl/Ant-v0": 1000,
}
pytestmark = pytest.mark.parametrize("env_id", STEPS)


def make(env_id, **kwargs):
    return gymnasium.make(env_id, disable_env_checker=True, **kwargs)


def designs(env_id) -> np.ndarray:
    """(2, D) two bodies."""
    size = make(env_id).unwrapped.body.design.size
    return np.random.default_rng(7).uniform(0.25, 1.75, (2, size))


def trajectory(env, seed, steps=150, **options):
    """Observations and rewards under actions that depend on the seed alone."""
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed, options=options)
    rows = [np.append(observation, 0.0)]
    for _ in range(steps):
        action = rng.uniform(-1, 1, env.action_space.shape)
        observation, reward, terminated, truncated, _ = env.step(action)
        rows.append(np.append(observation.astype(np.float64), reward))
        if terminated or truncated:
            break
    return np.array(rows)


def test_gymnasiums_checker_accepts_it(env_id):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it also wishes for bounded observations
        env = make(env_id, design=designs(env_id)[0], render_mode="rgb_array")
        check_env(env.unwrapped, skip_render_check=False)


def test_an_episode_does_not_depend_on_earlier_ones(env_id):
    body, other = designs(env_id)
    first = trajectory(make(env_id, design=body), 3)
    env = make(env_id, design=other)
    trajectory(env, 5)
    np.testing.assert_array_equal(trajectory(env, 3, design=body), first)
    for seed in range(4):
        trajectory(env, seed, steps=50)
    np.testing.assert_array_equal(trajectory(env, 3), first)  # the body was kept
    env.close()
    np.testing.assert_array_equal(trajectory(env, 3), first)
    trajectory(env, 5, design=other)
    np.testing.assert_array_equal(trajectory(env, 3, design=body), first)  # and made again


def test_looking_at_it_changes_nothing(env_id):
    class Looked(gymnasium.Wrapper):
        steps = 0

        def step(self, action):
            self.steps += 1
            if self.steps % 15 == 0:
                self.render()
            env, body = self.unwrapped, self.unwrapped.body
            poses = body.poses(env)
            for look in (body.joint_states, body.contacts, body.lidar, body.terrain):
                look(env)
            body.ground_near(env, poses[0][0])
            return super().step(action)

    body, _ = designs(env_id)
    looked = Looked(make(env_id, design=body, render_mode="rgb_array"))
    np.testing.assert_array_equal(trajectory(looked, 1), trajectory(make(env_id, design=body), 1))


def test_an_episode_is_truncated_at_the_time_limit(env_id):
    rows = trajectory(make(env_id), seed=2, steps=STEPS[env_id] + 100)  # one that never falls
    assert len(rows) == 1 + STEPS[env_id]
    assert rows[-1, -1] > -100


def test_many_live_in_one_process(env_id):
    body, _ = designs(env_id)
    alone = trajectory(make(env_id, design=body), 1)
    envs = [make(env_id, design=body) for _ in range(20)]
    for env in envs:
        env.reset(seed=5)
    np.testing.assert_array_equal(trajectory(envs[7], 1), alone)


def test_a_copy_by_pickle_is_the_same_environment(env_id):
    env = make(env_id, design=designs(env_id)[0]).unwrapped
    copy = pickle.loads(pickle.dumps(env))
    np.testing.assert_array_equal(trajectory(copy, 2), trajectory(env, 2))


def test_wrong_arguments_are_refused(env_id):
    env = make(env_id)
    space, size = env.unwrapped.body.design, env.action_space.shape[0]
    wrong = np.ones(space.size)
    for value in (1.8, np.nan):
        wrong[3] = value
        with pytest.raises(ValueError, match=rf"{space.names[3]}.*\[0.25, 1.75\]"):
            make(env_id, design=wrong)
        with pytest.raises(ValueError, match=space.names[3]):
            env.reset(options={"design": wrong})
        with pytest.raises(ValueError, match=space.names[3]):
            env.unwrapped.design = wrong
    with pytest.raises(ValueError, match="read-only"):
        env.unwrapped.design[0] = 9.0
    with pytest.raises(ValueError, match="reset options are a dict"):
        env.unwrapped.reset(options=list(wrong))
    with pytest.raises(ValueError, match=f"{space.size} scales"):
        env.reset(options={"design": np.ones(space.size + 1)})
    with pytest.raises(ValueError, match="'desing'"):
        env.reset(options={"desing": np.ones(space.size)})
    env.reset(seed=0)
    nan = np.full(size, np.nan)
    for action in (np.zeros(size - 1), nan, np.zeros((size, 1)), 0.0, None, ["a"] * size):
        with pytest.raises(ValueError, match=f"{size} finite numbers"):
            env.unwrapped.step(action)


@pytest.mark.parametrize("set_by", ["reset", "attribute"])
def test_a_copy_has_the_design_that_was_set(env_id, set_by):
    env = gymnasium.make(env_id).unwrapped
    design = np.full(env.body.design.size, 1.25)
    if set_by == "reset":
        env.reset(seed=0, options={"design": design})
    else:
        env.design = design
    for copied in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        np.testing.assert_array_equal(copied.reset(seed=1)[0], env.reset(seed=1)[0])
        np.testing.assert_array_equal(copied.design, design)
