import gc
import json
from functools import reduce
from operator import add
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pybullet
import pytest

import designrl  # noqa: F401
from designrl.bodies import rotate
from designrl.bodies.ant import ANT, leg_capsules
from designrl.envs import ant
from designrl.envs.ant import REWARD_TERMS, Ant
from designrl.simulation import Simulator

ID = "designrl/Ant-v0"
LONG_LEGS = np.tile([1.3, 1.5, 1.7, 1.6, 1.75, 1.7, 0.3, 0.4, 0.25], 4)
MIXED = np.random.default_rng(7).uniform(0.25, 1.75, ANT.design.size)


def test_an_ant_that_is_gone_leaves_no_world_behind():
    env = gymnasium.make(ID)
    env.reset(seed=0)
    client = env.unwrapped._client
    del env
    gc.collect()
    assert not pybullet.isConnected(client)


def test_no_room_for_another_world_is_said(monkeypatch):
    monkeypatch.setattr(pybullet, "connect", lambda *_: -1)
    with pytest.raises(ValueError, match="no room for another ant"):
        Ant().reset()


def test_no_room_for_the_bodys_file_is_said_and_none_is_left(monkeypatch, tmp_path):
    folder, env = tmp_path / "folder", Ant()
    monkeypatch.setattr(ant.tempfile, "tempdir", str(folder))
    with pytest.raises(ValueError, match="TMPDIR"):
        env.reset()
    folder.mkdir()
    env.reset()  # it is of use again
    assert not list(folder.iterdir())


@pytest.mark.parametrize("design", [np.ones(ANT.design.size), LONG_LEGS, MIXED])
def test_the_body_has_the_dimensions_of_the_design(design):
    env = Ant(design=design)
    env.reset(seed=0)
    client = {"physicsClientId": env._client}
    parts = leg_capsules(design)
    assert [part.name for part in parts] == list(ANT.tree)[1:]
    legs = ANT.design.dimensions(design).reshape(4, 9)
    ends, radii = legs[:, :6].reshape(-1, 2), legs[:, 6:].ravel()
    torso = pybullet.getDynamicsInfo(env._ant, -1, **client)
    assert torso[0] == pytest.approx(1000 * 4 / 3 * np.pi * 0.25**3)
    for part, link, end, radius in zip(parts, env._parts, ends, radii, strict=True):
        assert part.end == (*end, 0) and part.radius == radius
        info = pybullet.getDynamicsInfo(env._ant, link, **client)
        volume = np.pi * radius**2 * np.hypot(*end) + 4 / 3 * np.pi * radius**3
        assert info[0] == pytest.approx(1000 * volume, rel=1e-6)
        np.testing.assert_allclose(info[3], np.array(part.end) / 2, atol=1e-7)  # centre of mass
        assert (info[1], info[5]) == (1.5, 0.5)  # friction, restitution
    # The hips turn by 40° to either side, the ankles bend the feet down by 30° to 100°.
    limits = np.array([pybullet.getJointInfo(env._ant, j, **client)[8:10] for j in env._joints])
    np.testing.assert_allclose(limits[0::2], np.radians([[-40, 40]] * 4), atol=1e-6)
    np.testing.assert_allclose(np.abs(limits[1::2]).min(axis=1), np.radians(30), atol=1e-6)
    np.testing.assert_allclose(np.abs(limits[1::2]).max(axis=1), np.radians(100), atol=1e-6)


def test_poses_put_the_parts_of_a_leg_end_to_end():
    env = Ant(design=MIXED)
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(40):
        env.step(rng.uniform(-1, 1, 8))
    poses = dict(zip(ANT.tree, zip(*env.body_poses(), strict=True), strict=True))
    for part in leg_capsules(MIXED):
        position, orientation = poses[part.parent]
        np.testing.assert_allclose(
            poses[part.name][0], position + rotate(orientation, np.array(part.origin)), atol=1e-6
        )
        if part.joint:  # it has turned by the joint's angle about the joint's axis
            angle = env.joint_angles[ANT.joints.index(part.joint)]
            axis = np.array(part.axis) / np.linalg.norm(part.axis)
            end = np.array(part.end)
            turned = rotate(np.append(np.sin(angle / 2) * axis, np.cos(angle / 2)), end)
            np.testing.assert_allclose(
                rotate(poses[part.name][1], end), rotate(orientation, turned), atol=1e-6
            )


def test_reward_terms_add_up_to_the_reward_and_are_what_the_observation_shows():
    env = gymnasium.make(ID, design=MIXED)
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    seen, terminated, truncated = [], False, False
    while not (terminated or truncated):
        action = rng.uniform(-1.5, 1.5, 8)
        observation, reward, terminated, truncated, info = env.step(action)
        terms = info["reward_terms"]
        assert tuple(terms) == REWARD_TERMS
        assert reduce(add, terms.values()) == reward
        positions, speeds = observation[8:24:2], observation[9:24:2]
        if np.abs(observation).max() < 5:
            assert terms["electricity"] == pytest.approx(-2 * np.abs(action * speeds).mean(), 1e-5)
            assert terms["joint_limits"] == pytest.approx(-0.2 * (np.abs(positions) > 0.99).sum())
        assert terms["stall"] == pytest.approx(-0.1 * (action**2).mean())
        assert terms["alive"] == (-1 if terminated else 1)
        assert terminated == (observation[0] + 0.75 <= 0.26)
        assert terms["foot_collision"] == 0
        np.testing.assert_array_equal(np.clip(250 * action, -250, 250), env.unwrapped.torques)
        seen.append(observation)
    assert terminated  # it fell
    seen = np.array(seen)
    assert len(ANT.observations) == seen.shape[1] == 28
    assert set(np.unique(seen[:, -len(ANT.contact_names) :])) == {0.0, 1.0}
    np.testing.assert_allclose(np.hypot(seen[:, 1], seen[:, 2]), 1, rtol=1e-6)


def test_feet_are_seen_to_touch_one_step_later():
    env = Ant()
    env.reset(seed=0)
    before = env.foot_contacts
    for _ in range(60):
        observation, *_ = env.step(np.zeros(8))
        assert tuple(observation[-4:]) == before
        before = env.foot_contacts
    assert sum(before) == 4  # without torque it sinks down on all fours


def test_rgb_array_shows_the_whole_body_on_a_pattern_that_passes_by():
    env = gymnasium.make(ID, design=LONG_LEGS, render_mode="rgb_array").unwrapped
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (480, 640, 3)
    assert picture.dtype == np.uint8
    body = picture[:, :, 0].astype(int) - picture[:, :, 2] > 40  # the legs are amber
    assert body.sum() == body[21:460, 21:620].sum() > 1000
    pybullet.resetBasePositionAndOrientation(
        env._ant, (50.5, 0, 0.75), (0, 0, 0, 1), physicsClientId=env._client
    )
    moved = env.render()
    assert (np.abs(moved.astype(int) - picture).sum(axis=2) > 30).mean() > 0.2  # the floor
    assert (body == (moved[:, :, 0].astype(int) - moved[:, :, 2] > 40)).mean() > 0.999


def test_an_unknown_render_mode_is_refused():
    with pytest.raises(ValueError, match="render_mode"):
        Ant(render_mode="human")


def test_the_first_steps_are_those_of_roboschool():
    # Made by tests/data/make_roboschool_ant.py, on bodies original, thin and of mixed sizes; each
    # episode has feet that touch the ground, one at a time.
    path = Path(__file__).parent / "data" / "roboschool_ant.json"
    worst = []
    for episode in json.loads(path.read_text()):
        env = Ant(design=episode["scales"])
        start = np.array(episode["angles"])
        env._np_random = SimpleNamespace(uniform=lambda low, high, size, start=start: start)
        observations, rewards = [env.reset()[0]], []
        for action in episode["actions"]:
            observation, reward, *_ = env.step(action)
            observations.append(observation)
            rewards.append(reward)
        error = np.abs(np.array(observations) - episode["observations"]).max()
        worst.append(max(error, np.abs(np.array(rewards) - episode["rewards"]).max()))
        assert np.array(observations)[:, -len(ANT.contact_names) :].any()
    assert len(worst) == 12
    assert np.median(worst) < 1e-5
    assert max(worst) < 1e-3  # a speed right after a contact; rounding has grown by then


@pytest.mark.parametrize(
    ("experiment", "published", "tolerance"),
    # Row (a) and (b) of Table 4, run 1; the mean over 100 rollouts that include early falls.
    [("ant", 3447, 0.02), ("ant-morphology", 5789, 0.05)],
)
def test_the_authors_weights_score_what_the_paper_prints(
    author_agent, experiment, published, tolerance
):
    agent = author_agent(experiment)
    with Simulator(experiment, "reference", network=agent.network) as simulator:
        result = simulator.rollout(agent.parameters[None], np.arange(10)[None])
    upright = result.returns[result.steps == 1000]
    assert len(upright) >= 8  # about one learned ant in a hundred falls early
    assert np.mean(upright) == pytest.approx(published, rel=tolerance)
