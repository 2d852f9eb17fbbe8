"""A further body and its environment, as a user would write them: a ball that hops on one leg."""

import gymnasium
import numpy as np

from designrl.bodies import Body, Poses, urdf
from designrl.design import DesignSpace

COLOR = (240, 150, 60)


class HopperBody(Body):
    name = "hopper"
    design = DesignSpace(("ball radius", "leg length"), np.array([0.3, 0.6]), "m")
    tree = {"ball": "world", "leg": "ball"}
    joints = ("hip",)
    observations = ("height", "vertical speed", "hip angle")
    time_step = 0.02

    def urdf(self, scales: np.ndarray, caption: str = "") -> str:
        radius, length = self.design.dimensions(scales)
        links = {
            "ball": [urdf.sphere(radius, (0, 0, 0), COLOR)],
            "leg": urdf.capsule((0, 0, -length), 0.05, COLOR),
        }
        hip = urdf.joint("hip", "ball", "leg", (0, 0, -radius), (0, 1, 0), (-0.5, 0.5, 10, 10))
        return urdf.robot(self.name, caption, links, [urdf.joint("ball", "world", "ball"), hip])

    def poses(self, env) -> Poses:
        radius, _ = self.design.dimensions(env.design)
        ball = np.array([env.x, 0.0, env.z])
        turn = [0.0, np.sin(env.angle / 2), 0.0, np.cos(env.angle / 2)]
        return np.array([ball, ball - (0, 0, radius)]), np.array([[0.0, 0, 0, 1], turn])


HOPPER = HopperBody()


class Hopper(gymnasium.Env):
    body = HOPPER
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.design = HOPPER.design.validate((options or {}).get("design", np.ones(2)))
        self.x, self.z, self.speed, self.angle = 0.0, 1.0 + self.np_random.uniform(), 0.0, 0.0
        return self._observe(), {}

    def step(self, action):
        self.angle = 0.5 * float(np.clip(action[0], -1, 1))
        self.speed -= 9.81 * HOPPER.time_step
        self.z += self.speed * HOPPER.time_step
        if self.z < HOPPER.design.dimensions(self.design).sum() and self.speed < 0:
            self.speed = 4.0
        before, self.x = self.x, self.x + self.angle * HOPPER.time_step
        return self._observe(), self.x - before, False, False, {}

    def _observe(self):
        return np.array([self.z, self.speed, self.angle], dtype=np.float32)


gymnasium.register("test/Hopper-v0", entry_point=Hopper, max_episode_steps=100)
