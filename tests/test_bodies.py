"""Bodies: their dimensions, their look, their poses."""

import dataclasses
import xml.etree.ElementTree as ElementTree

import gymnasium
import numpy as np
import pytest

from designrl import viewer
from designrl.bodies import relative, rotate
from designrl.bodies.ant import ANT
from designrl.bodies.robot import Robot
from designrl.bodies.walker import WALKER
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS
from designrl.policy import Agent
from designrl.recording import record_rollout


@pytest.mark.parametrize("body", [WALKER, ANT])
def test_each_dimension_belongs_to_the_limb_that_it_names(body):
    assert sum(body.limbs.values(), []) == list(range(body.design.size))
    for limb, indices in body.limbs.items():
        assert all(limb in body.design.names[i] for i in indices)


@pytest.mark.parametrize("body", [WALKER, ANT])
def test_the_body_is_an_urdf_with_the_papers_names(body):
    space = body.design
    scales = np.linspace(0.3, 1.7, space.size)
    robot = ElementTree.fromstring(body.urdf(scales, "caption -- with dashes"))
    links = {link.get("name") for link in robot.iter("link")}
    parts = {name.rsplit(" ", 1)[0] for name in space.names}
    assert parts <= links
    children = [joint.find("child").get("link") for joint in robot.iter("joint")]
    assert sorted(children) == sorted(links - {"world"})  # a tree that hangs on the world
    if body is WALKER:
        size = robot.find("link[@name='bottom leg 2']/visual/geometry/box").get("size").split()
        expected = space.dimensions(scales)[6:] / 30
        assert np.allclose([float(size[0]), float(size[2])], expected)


def test_an_outline_has_the_size_of_its_body():
    scales = np.linspace(0.4, 1.6, 8)
    points, colors = Robot(WALKER.urdf(scales), dict.fromkeys(WALKER.joints, 0.0)).outline()
    legs = (WALKER.design.dimensions(scales)[1::2] / 30).reshape(2, 2).sum(axis=1)
    assert np.isclose(points[:, 2].min(), -8 / 30 - legs.max())  # straight down from the hip
    assert len(points) == len(colors) < 1000
    bent, _ = Robot(WALKER.urdf(scales), {"hip 1": np.pi / 2, "hip 2": 0, "knee 1": 0}).outline()
    assert np.isclose(bent[:, 0].max(), legs[0])  # forward


def test_poses_put_the_body_where_it_is():
    scales = np.linspace(0.4, 1.6, 8)
    env = gymnasium.make("designrl/BipedalWalker-v0", design=scales)
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(30):
        env.step(env.action_space.sample())
    inner = env.unwrapped
    poses = dict(zip(WALKER.tree, zip(*WALKER.poses(inner), strict=True), strict=True))
    heights = WALKER.design.dimensions(scales)[1::2] / 30
    for part, leg, height in zip(list(poses)[1:], inner.legs, heights, strict=True):
        place, turn = poses[part]
        middle = place + rotate(turn, np.array([0, 0, -height / 2]))
        assert np.allclose(middle[[0, 2]], leg.position, atol=1e-6)
    place, turn = relative(poses["hull"], poses["top leg 1"])
    assert np.allclose(place, [0, 0, -8 / 30], atol=0.02)  # Box2D's joints give way a little
    assert np.isclose(2 * np.arctan2(-turn[1], turn[3]), inner.legs[0].angle - inner.hull.angle)


def test_a_recording_of_an_unknown_experiment_says_to_name_its_module(tmp_path):
    experiment = dataclasses.replace(EXPERIMENTS["biped"], name="my-biped")
    agent = Agent(experiment, np.zeros(experiment.num_parameters))
    record_rollout(agent, tmp_path / "a.mcap", seed=0)
    with pytest.raises(InputError, match="'my-biped', which is not known here; name the module"):
        viewer.replay([tmp_path / "a.mcap"], save=tmp_path / "a.rrd")
