import gc
import json
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import gymnasium
import numpy as np
import pybullet
import pytest
from test_envs import trajectory

import designrl  # noqa: F401
from designrl.bodies import rotate
from designrl.bodies.ant import ANT, leg_capsules, mjcf
from designrl.envs import ant
from designrl.envs.ant import REWARD_TERMS, Ant
from designrl.simulation import Simulator

ID = "designrl/Ant-v0"
LONG_LEGS = np.tile([1.3, 1.5, 1.7, 1.6, 1.75, 1.7, 0.3, 0.4, 0.25], 4)
MIXED = np.random.default_rng(7).uniform(0.25, 1.75, ANT.design.size)


def test_importing_and_connecting_prints_nothing():
    code = (
        "import gymnasium, designrl; env = gymnasium.make('designrl/Ant-v0'); env.reset(seed=0);"
        "env.step(env.action_space.sample())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_looking_at_it_changes_nothing():
    seen = gymnasium.make(ID, design=MIXED, render_mode="rgb_array").unwrapped
    rng = np.random.default_rng(1)
    seen.reset(seed=1)
    for step in range(150):
        if step % 15 == 0:
            seen.render()
        seen.body_poses()
        last, _, terminated, _, _ = seen.step(rng.uniform(-1, 1, 8))
        if terminated:
            break
    unseen = trajectory(gymnasium.make(ID, design=MIXED), 1)
    assert len(unseen) == step + 2
    np.testing.assert_array_equal(last, unseen[-1, :-1].astype(np.float32))


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


def test_no_room_for_the_bodys_file_is_said(monkeypatch, tmp_path):
    monkeypatch.setattr(ant.tempfile, "tempdir", str(tmp_path / "missing"))
    env = Ant()
    with pytest.raises(ValueError, match="TMPDIR"):
        env.reset()
    monkeypatch.undo()
    env.reset()  # and it is of use again


def test_reset_leaves_no_file(monkeypatch, tmp_path):
    monkeypatch.setattr(ant.tempfile, "tempdir", str(tmp_path))
    Ant().reset()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("design", [np.ones(ANT.design.size), LONG_LEGS, MIXED])
def test_the_body_has_the_dimensions_of_the_design(design):
    env = Ant(design=design)
    env.reset(seed=0)
    client = {"physicsClientId": env._client}
    parts = leg_capsules(design)
    assert [part.name for part in parts] == list(ANT.tree)[1:]
    lengths = np.hypot(*ANT.design.dimensions(design).reshape(4, 9)[:, :6].reshape(-1, 2).T)
    radii = ANT.design.dimensions(design).reshape(4, 9)[:, 6:].ravel()
    torso = pybullet.getDynamicsInfo(env._ant, -1, **client)
    assert torso[0] == pytest.approx(1000 * 4 / 3 * np.pi * 0.25**3)
    for part, link, length, radius in zip(parts, env._parts, lengths, radii, strict=True):
        assert np.linalg.norm(part.end) == pytest.approx(length)
        assert part.radius == pytest.approx(radius)
        info = pybullet.getDynamicsInfo(env._ant, link, **client)
        volume = np.pi * radius**2 * length + 4 / 3 * np.pi * radius**3
        assert info[0] == pytest.approx(1000 * volume, rel=1e-6)
        np.testing.assert_allclose(info[3], np.array(part.end) / 2, atol=1e-7)  # centre of mass
        assert (info[1], info[5]) == (1.5, 0.5)  # friction, restitution
    # The hips turn by 40° to either side, the ankles bend the feet down by 30° to 100°.
    limits = np.array([pybullet.getJointInfo(env._ant, j, **client)[8:10] for j in env._joints])
    np.testing.assert_allclose(limits[0::2], np.radians([[-40, 40]] * 4), atol=1e-6)
    np.testing.assert_allclose(np.abs(limits[1::2]).min(axis=1), np.radians(30), atol=1e-6)
    np.testing.assert_allclose(np.abs(limits[1::2]).max(axis=1), np.radians(100), atol=1e-6)


def test_the_original_body_is_that_of_the_mujoco_file():
    bodies = {body.get("name"): body for body in ElementTree.fromstring(mjcf(np.ones(36))).iter()}
    for (sx, sy), leg in zip(
        ((1, 1), (-1, 1), (-1, -1), (1, -1)),
        ("front left", "front right", "back left", "back right"),
        strict=True,
    ):
        for part, end in (("top", 0.2), ("middle", 0.2), ("bottom", 0.4)):
            geom = bodies[f"{leg} {part}"].find("geom")
            ends = [float(value) for value in geom.get("fromto").split()]
            assert ends == pytest.approx([0, 0, 0, sx * end, sy * end, 0])
            assert float(geom.get("size")) == 0.08


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


def test_the_progress_is_that_of_the_mean_of_all_links():
    env = Ant(design=MIXED)
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    distances = []
    for _ in range(60):
        *_, info = env.step(rng.uniform(-1, 1, 8))
        links = pybullet.getLinkStates(env._ant, range(20), physicsClientId=env._client)
        x, y, _ = np.mean([link[0] for link in links], axis=0)
        distances.append(np.hypot(1000 - x, y))
    progress = info["reward_terms"]["progress"]
    assert progress == pytest.approx((distances[-2] - distances[-1]) / 0.0165, abs=1e-6)


def test_reward_terms_add_up_to_the_reward_and_are_what_the_observation_shows():
    env = gymnasium.make(ID, design=LONG_LEGS)
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    seen = []
    for _ in range(300):
        action = rng.uniform(-1.5, 1.5, 8)
        observation, reward, terminated, _, info = env.step(action)
        terms = info["reward_terms"]
        assert tuple(terms) == REWARD_TERMS
        assert sum(terms.values()) == reward
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
        if terminated:
            break
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


def test_an_ant_that_falls_is_done():
    env = Ant()
    env.reset(seed=0)
    pybullet.resetBasePositionAndOrientation(
        env._ant, (0, 0, 0.75), (1, 0, 0, 0), physicsClientId=env._client
    )  # on its back: the legs give way
    for _ in range(200):
        _, _, terminated, _, info = env.step(np.zeros(8))
        if terminated:
            break
    assert terminated
    assert info["reward_terms"]["alive"] == -1


def test_an_episode_is_truncated_after_1000_steps():
    env = gymnasium.make(ID)
    observation, _ = env.reset(seed=0)
    for step in range(1, 1001):  # it stands, every joint held in the middle of its range
        hold = -observation[8:24:2] - observation[9:24:2]
        observation, _, terminated, truncated, _ = env.step(hold)
        assert not terminated
        assert truncated == (step == 1000)


def test_rgb_array_shows_the_whole_body_on_a_pattern_that_passes_by():
    env = gymnasium.make(ID, design=LONG_LEGS, render_mode="rgb_array").unwrapped
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (480, 640, 3)
    assert picture.dtype == np.uint8
    body = picture[:, :, 0].astype(int) - picture[:, :, 2] > 40  # the legs are amber
    assert body.sum() > 1000
    rows, columns = np.nonzero(body)
    assert rows.min() > 20
    assert rows.max() < 460
    assert columns.min() > 20
    assert columns.max() < 620
    pybullet.resetBasePositionAndOrientation(
        env._ant, (50.5, 0, 0.75), (0, 0, 0, 1), physicsClientId=env._client
    )
    moved = env.render()
    assert (np.abs(moved.astype(int) - picture).sum(axis=2) > 30).mean() > 0.2  # the floor
    assert (body == (moved[:, :, 0].astype(int) - moved[:, :, 2] > 40)).mean() > 0.999


def test_an_unknown_render_mode_is_refused():
    with pytest.raises(ValueError, match="render_mode"):
        Ant(render_mode="human")


class Angles:
    """Stands in for the environment's random numbers: the angles at the start."""

    def __init__(self, angles):
        self.angles = np.array(angles)

    def uniform(self, low, high, size):
        return self.angles


def test_the_first_steps_are_those_of_roboschool():
    # Made by tests/data/make_roboschool_ant.py, on bodies original, thin and of mixed sizes; each
    # episode has feet that touch the ground, one at a time.
    path = Path(__file__).parent / "data" / "roboschool_ant.json"
    worst = []
    for episode in json.loads(path.read_text()):
        env = Ant(design=episode["scales"])
        env._np_random = Angles(episode["angles"])
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
    zoo_agent, experiment, published, tolerance
):
    agent = zoo_agent(experiment)
    with Simulator(experiment, "reference", network=agent.network) as simulator:
        result = simulator.rollout(agent.parameters[None], np.arange(10)[None])
    upright = result.returns[result.steps == 1000]
    assert len(upright) >= 8  # about one learned ant in a hundred falls early
    assert np.mean(upright) == pytest.approx(published, rel=tolerance)
