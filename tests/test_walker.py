import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import PPO

import designrl  # noqa: F401
from designrl.bodies.walker import WALKER, leg_area_reward_factor
from designrl.errors import InputError

IDS = ("designrl/BipedalWalker-v0", "designrl/BipedalWalkerHardcore-v0")
LONG_LEGS = np.array([0.3, 1.6, 0.25, 1.3, 0.3, 1.4, 0.25, 0.6])
SHORT_LEGS = np.full(8, 0.7)


def trajectory(env, seed, steps=200, reset_options=None):
    """Observations and rewards under actions that depend on the seed alone."""
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed, options=reset_options)
    rows = [np.append(observation, 0.0)]
    for _ in range(steps):
        observation, reward, terminated, truncated, _ = env.step(rng.uniform(-1, 1, 4))
        rows.append(np.append(observation.astype(np.float64), reward))
        if terminated or truncated:
            break
    return np.array(rows)


@pytest.mark.parametrize("env_id", IDS)
def test_gymnasiums_checker_accepts_it(env_id):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it also wishes for bounded observations
        check_env(gymnasium.make(env_id, design=LONG_LEGS).unwrapped, skip_render_check=False)


@pytest.mark.parametrize("env_id", IDS)
def test_stable_baselines3_trains_on_it(env_id):
    model = PPO("MlpPolicy", gymnasium.make(env_id, design=LONG_LEGS), n_steps=512, seed=0)
    model.learn(total_timesteps=2048)
    assert model.num_timesteps == 2048


@pytest.mark.parametrize("hardcore", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_original_body_with_v3_lidar_is_gymnasiums_walker_to_the_bit(seed, hardcore):
    ours = gymnasium.make(IDS[hardcore], lidar="v3")
    theirs = gymnasium.make("BipedalWalker-v3", hardcore=hardcore)
    np.testing.assert_array_equal(trajectory(ours, seed), trajectory(theirs, seed))


def test_v3_lidar_sees_the_closest_ground_and_v2_sometimes_a_farther_one():
    rays = []
    for lidar in ("v2", "v3"):
        env = gymnasium.make(IDS[1], lidar=lidar).unwrapped
        env.reset(seed=2)
        seen = []
        for _ in range(80):  # carry the walker over pits, stumps and stairs
            for body in (env.hull, *env.legs):
                body.position += (1.0, 0.0)
            seen.append(env.step(np.zeros(4))[0][14:])
        rays.append(np.array(seen))
    v2, v3 = rays
    assert (v2 >= v3).all()
    assert 0 < (v2 != v3).mean() < 0.5


@pytest.mark.parametrize("env_id", IDS)
def test_an_episode_does_not_depend_on_earlier_ones(env_id):
    env = gymnasium.make(env_id, design=LONG_LEGS)
    first = trajectory(env, 3)
    for seed in range(4):
        trajectory(env, seed, steps=50)
    np.testing.assert_array_equal(trajectory(env, 3), first)
    np.testing.assert_array_equal(trajectory(gymnasium.make(env_id, design=LONG_LEGS), 3), first)


def test_many_walkers_live_in_one_process():
    alone = trajectory(gymnasium.make(IDS[0], design=LONG_LEGS), 1)
    envs = [gymnasium.make(IDS[0], design=LONG_LEGS) for _ in range(30)]
    plain = gymnasium.make("BipedalWalker-v3")
    plain.reset(seed=0)
    for env in envs:
        env.reset(seed=5)
    np.testing.assert_array_equal(trajectory(envs[7], 1), alone)
    # Gymnasium's own definitions of the legs are left as they were.
    assert plain.unwrapped.legs[0].fixtures[0].shape.vertices[0][1] == pytest.approx(-17 / 30)


def test_the_body_has_the_dimensions_of_the_design():
    env = gymnasium.make(IDS[0])
    env.reset(seed=0, options={"design": LONG_LEGS})
    sizes = WALKER.design.dimensions(LONG_LEGS).reshape(4, 2) / 30
    assert len(WALKER.tree) == 1 + len(env.unwrapped.legs)
    for leg, (width, height) in zip(env.unwrapped.legs, sizes, strict=True):
        vertices = np.array(leg.fixtures[0].shape.vertices)
        np.testing.assert_allclose(np.ptp(vertices, axis=0), [width, height], rtol=1e-6)
        assert leg.mass == pytest.approx(width * height, rel=1e-5)  # density 1 kg/m²


def test_a_design_at_make_and_at_reset_is_the_same_body_and_stays():
    made = gymnasium.make(IDS[0], design=LONG_LEGS)
    reset = gymnasium.make(IDS[0])
    first = trajectory(reset, 4, reset_options={"design": LONG_LEGS})
    np.testing.assert_array_equal(first, trajectory(made, 4))
    np.testing.assert_array_equal(first, trajectory(reset, 4))


@pytest.mark.parametrize("leg_area_reward", [False, True])
def test_reward_terms_add_up_to_the_reward(leg_area_reward):
    env = gymnasium.make(IDS[0], design=SHORT_LEGS, leg_area_reward=leg_area_reward)
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    terminated = False
    while not terminated:
        _, reward, terminated, _, info = env.step(rng.uniform(-1.5, 1.5, 4))
        assert sum(info["reward_terms"].values()) == pytest.approx(reward, abs=1e-9)
    assert info["reward_terms"]["fall"] == reward == -100


def test_leg_area_reward_multiplies_every_reward_but_the_fall():
    plain = trajectory(gymnasium.make(IDS[0], design=SHORT_LEGS), 1, steps=1600)
    factor = leg_area_reward_factor(SHORT_LEGS)
    env = gymnasium.make(IDS[0], design=SHORT_LEGS, leg_area_reward=True)
    scaled = trajectory(env, 1, steps=1600)
    np.testing.assert_allclose(scaled[1:-1, -1], factor * plain[1:-1, -1], rtol=1e-12)
    assert scaled[-1, -1] == plain[-1, -1] == -100


@pytest.mark.parametrize(("env_id", "limit"), [(IDS[0], 1600), (IDS[1], 2000)])
def test_an_episode_is_truncated_at_the_time_limit(env_id, limit):
    rows = trajectory(gymnasium.make(env_id), seed=2, steps=limit + 100)  # one that never falls
    assert len(rows) == 1 + limit
    assert rows[-1, -1] > -100


def test_rgb_array_shows_the_body():
    env = gymnasium.make(IDS[1], design=LONG_LEGS, render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (400, 600, 3)
    assert (np.abs(picture.astype(int) - (127, 51, 229)).sum(axis=2) < 10).sum() > 500  # the hull


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match="top leg 1 width"):
        gymnasium.make(IDS[0], design=[2.0] * 8)
    with pytest.raises(ValueError, match="lidar"):
        gymnasium.make(IDS[0], lidar="v4")
    env = gymnasium.make(IDS[0])
    env.reset(seed=0)
    wrong = (np.zeros(2), np.zeros(12), np.float64(0.0), [0, 0, np.nan, 0], None, ["a"] * 4)
    for action in wrong:
        with pytest.raises(InputError, match="4 finite numbers"):
            env.unwrapped.step(action)
    with pytest.raises(ValueError, match="'desing'"):
        env.reset(options={"desing": np.ones(8)})
    with pytest.raises(ValueError, match="8 scales"):
        env.reset(options={"design": np.ones(36)})
