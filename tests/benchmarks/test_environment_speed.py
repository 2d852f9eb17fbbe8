"""Steps per second of the environments, as ratios to what they build on in the same run.

    make bench

The walkers are beside Gymnasium's plain BipedalWalker-v3. The ant is beside bare stepSimulation,
which applies the torques of the very same episode and steps (4 substeps of Bullet), but reads
nothing: it goes through the same states, to the bit. 1 is as fast as Bullet alone.
"""

import gymnasium
import numpy as np
import pybullet
import pytest

import designrl  # noqa: F401
from designrl.envs.ant import Ant

STEPS = 1000


class RandomActions:
    """Steps of a walker under fixed random actions, resets included."""

    def __init__(self, env_id: str):
        self.env = gymnasium.make(env_id)
        self.actions = np.random.default_rng(0).uniform(-1, 1, (STEPS, 4))

    def __call__(self) -> int:
        self.env.reset(seed=0)
        for step, action in enumerate(self.actions):
            *_, terminated, truncated, _ = self.env.step(action)
            if terminated or truncated:
                self.env.reset(seed=step)
        return STEPS


@pytest.fixture(scope="module")
def plain_walker():
    return RandomActions("BipedalWalker-v3")


@pytest.mark.benchmark(group="walker environment")
@pytest.mark.parametrize("name", ["BipedalWalker", "BipedalWalkerHardcore"])
def test_walker(measure, plain_walker, name):
    measure(RandomActions(f"designrl/{name}-v0"), plain_walker)


class AntEpisode:
    """An episode of an ant on its feet: random actions around the joints' middles."""

    def __init__(self):
        self.env, rng = Ant(), np.random.default_rng(0)
        observation, _ = self.env.reset(seed=0)
        self.actions, self.torques = [], []
        for _ in range(STEPS):
            noise = rng.uniform(-1, 1, 8)
            self.actions.append(noise - observation[8:24:2] - observation[9:24:2])
            observation, _, terminated, _, _ = self.env.step(self.actions[-1])
            self.torques.append(self.env.torques)
            assert not terminated
        assert sum(self.env.foot_contacts) > 0

    def bare(self) -> int:
        """Bullet alone on the episode's torques."""
        self.env.reset(seed=0)
        ant, joints, client = self.env._ant, self.env._joints, self.env._client
        for forces in self.torques:
            pybullet.setJointMotorControlArray(
                ant, joints, pybullet.TORQUE_CONTROL, forces=forces, physicsClientId=client
            )
            pybullet.stepSimulation(physicsClientId=client)
        return STEPS


@pytest.fixture(scope="module")
def episode():
    return AntEpisode()


@pytest.mark.benchmark(group="ant environment")
def test_ant(measure, episode):
    env = gymnasium.make("designrl/Ant-v0").unwrapped

    def steps() -> int:
        env.reset(seed=0)
        for action in episode.actions:
            env.step(action)
        return STEPS

    assert measure(steps, episode.bare) >= 0.7  # the aim is 0.75
