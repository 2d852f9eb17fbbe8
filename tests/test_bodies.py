"""Bodies: their look, their poses, and a further one through the defaults."""

import dataclasses
import xml.etree.ElementTree as ElementTree

import gymnasium
import numpy as np
import pytest
from hopper import HOPPER

from designrl import viewer
from designrl.bodies import relative, rotate
from designrl.bodies.ant import ANT
from designrl.bodies.walker import WALKER
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS, Network, register
from designrl.policy import Agent
from designrl.recording import RunWriter, read, record_rollout


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


def test_poses_put_the_body_where_it_is():
    scales = np.linspace(0.4, 1.6, 8)
    env = gymnasium.make("designrl/BipedalWalker-v0", design=scales)
    env.reset(seed=0)
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


@pytest.fixture
def hopper(monkeypatch):
    monkeypatch.setattr("designrl.experiments.EXPERIMENTS", dict(EXPERIMENTS))
    experiment = dataclasses.replace(
        EXPERIMENTS["biped-morphology"],
        name="hopper",
        env_id="test/Hopper-v0",
        body=HOPPER,
        network=Network((3, 4, 1)),
    )
    register(experiment)
    return experiment


def test_a_further_body_is_recorded_and_drawn(hopper, tmp_path):
    run, rollout = tmp_path / "generations.mcap", tmp_path / "rollouts" / "a.mcap"
    mu = np.random.default_rng(0).normal(size=hopper.num_parameters)
    with RunWriter(run, {"experiment": hopper.name}) as writer:
        ones = np.ones((2, 1), dtype=int)
        writer.generation(0, mu, 0.1 * np.ones_like(mu), 1.0 * ones, ones, ones, 1.0, 2)
    agent = Agent(hopper, mu)
    score = record_rollout(agent, rollout, seed=1)

    recording = read(rollout)
    assert recording.array("/reward", "total")[-1] == score
    assert recording.topics["/tf"] == 101 and recording.names("/observation")[0] == "height"
    assert not {"/joints", "/contacts", "/lidar", "/terrain"} & set(recording.topics)
    parent, places, _ = recording.transforms()["leg"]
    radius, _ = HOPPER.design.dimensions(agent.scales)
    assert parent == "ball" and np.allclose(places, [0, 0, -radius])
    viewer.replay([tmp_path], save=tmp_path / "all.rrd")
    assert (tmp_path / "all.rrd").stat().st_size > 10_000


def test_a_recording_of_an_unknown_experiment_says_to_register_it(hopper, tmp_path):
    record_rollout(Agent(hopper, np.zeros(hopper.num_parameters)), tmp_path / "a.mcap", seed=0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("designrl.experiments.EXPERIMENTS", EXPERIMENTS)
        with pytest.raises(InputError, match="'hopper', which is not known here; register it"):
            viewer.replay([tmp_path / "a.mcap"], save=tmp_path / "a.rrd")
