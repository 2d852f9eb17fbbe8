import os
import subprocess
import sys
from functools import reduce
from operator import add
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.box2d import bipedal_walker
from test_envs import trajectory

import designrl  # noqa: F401
from designrl import bodies
from designrl.bodies.walker import WALKER
from designrl.envs.tasks import leg_area_reward_factor
from designrl.errors import InputError

IDS = ("designrl/BipedalWalker-v0", "designrl/BipedalWalkerHardcore-v0")
LONG_LEGS = np.array([0.3, 1.6, 0.25, 1.3, 0.3, 1.4, 0.25, 0.6])
SHORT_LEGS = np.full(8, 0.7)


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


def test_what_is_known_of_the_body_is_gymnasiums():
    assert WALKER.time_step == 1 / bipedal_walker.FPS
    assert bodies.walker.SCALE == bipedal_walker.SCALE
    assert list(bodies.walker.HULL) == bipedal_walker.HULL_POLY


def test_gymnasiums_own_walker_is_left_as_it_was():
    plain = gymnasium.make("BipedalWalker-v3")
    gymnasium.make(IDS[0], design=LONG_LEGS).reset(seed=5)
    plain.reset(seed=0)
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


def test_leg_area_reward_multiplies_every_reward_but_the_fall():
    rewards = []
    for leg_area_reward in (False, True):
        env = gymnasium.make(IDS[0], design=SHORT_LEGS, leg_area_reward=leg_area_reward)
        rng, terminated = np.random.default_rng(0), False
        env.reset(seed=0)
        rewards.append([])
        while not terminated:
            _, reward, terminated, _, info = env.step(rng.uniform(-1.5, 1.5, 4))
            assert sum(info["reward_terms"].values()) == pytest.approx(reward, abs=1e-9)
            rewards[-1].append(reward)
        assert info["reward_terms"]["fall"] == reward == -100
    plain, scaled = np.array(rewards)[:, :-1]
    np.testing.assert_allclose(scaled, leg_area_reward_factor(SHORT_LEGS) * plain, rtol=1e-12)


def test_the_part_of_smaller_legs_follows_the_weighted_terms_and_has_its_own_weight():
    weights = {"energy": 3.0, "fall": 0.5, "leg_area": 0.25}
    env = gymnasium.make(IDS[0], design=SHORT_LEGS, leg_area_reward=True, reward_weights=weights)
    env.reset(seed=0)
    rng, terminated = np.random.default_rng(0), False
    factor = leg_area_reward_factor(SHORT_LEGS)
    while not terminated:
        _, reward, terminated, _, info = env.step(rng.uniform(-1.5, 1.5, 4))
        *before, leg_area = info["reward_terms"].values()
        assert reward == reduce(add, before, 0.0) + leg_area
        if not terminated:
            assert leg_area == pytest.approx(0.25 * (factor - 1) * sum(before), abs=1e-12)
    assert reward == info["reward_terms"]["fall"] == -50


def test_rgb_array_shows_the_body():
    env = gymnasium.make(IDS[1], design=LONG_LEGS, render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (400, 600, 3)
    assert (np.abs(picture.astype(int) - (127, 51, 229)).sum(axis=2) < 10).sum() > 500  # the hull


def test_an_unknown_lidar_is_refused():
    with pytest.raises(InputError, match="lidar"):
        gymnasium.make(IDS[0], lidar="v4")


def test_box2d_and_box2d_py_give_the_same_bits():
    other = Path(__file__).parents[1] / "build/box2d"
    if not other.is_dir():
        pytest.skip("needs pip install --no-deps --target build/box2d box2d==2.3.10")
    code = """
import hashlib, Box2D, gymnasium, numpy as np, designrl
rng, played = np.random.default_rng(0), hashlib.sha256()
for name in ("biped-morphology", "biped-hardcore-morphology"):
    agent = designrl.load(f"{name}/seed0")
    env = gymnasium.make(agent.experiment.env_id)
    for seed in range(3):
        options = {"design": agent.scales if seed == 0 else rng.uniform(0.25, 1.75, 8)}
        observation, _ = env.reset(seed=seed, options=options)
        for t in range(300):
            observation, reward, terminated, *_ = env.step(agent.act(observation, t))
            played.update(observation.tobytes() + np.float64(reward).tobytes())
            if terminated:
                break
print(Box2D.__file__, t, played.hexdigest())
"""
    said = [
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for path in ("", str(other))
    ]
    (one, *bits), (another, *others) = said
    assert one != another and bits == others
