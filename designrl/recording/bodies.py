"""What a recording asks of an environment at each step, the same for the walker and the ant.

Everything is in m, rad and N m, with x forward, y left, z up; Box2D's y is z here.
"""

import math
from functools import cached_property

import numpy as np

from designrl.design import WALKER
from designrl.recording.urdf import SCALE, WALKER_TREE, ant_urdf, walker_urdf

GROUND_COLOR = (112, 184, 96)
OBSTACLE_COLOR = (190, 190, 190)
GROUND_REACH = 7.0  # m to either side of the body: the ground that any viewer is shown
GROUND_SPACING = 0.06  # m between the points of a line
GROUND_HALF_WIDTH = 1.0  # m; the ground of a two-dimensional world is drawn this wide
GROUND_ROWS = 9  # lines across that width
GROUND_REFRESH = 1.0  # m that a body moves before the ground near it is recorded again

# Positions (n, 3) in m and rotations (n, 4), quaternions x, y, z, w, of n parts.
Poses = tuple[np.ndarray, np.ndarray]


def make_body(env) -> "WalkerBody | AntBody":
    """What recordings ask of one of this package's environments; reset it first."""
    inner = env.unwrapped
    return WalkerBody(inner) if hasattr(inner, "hull") else AntBody(inner)


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The vectors v (..., 3) turned by the unit quaternions q (..., 4)."""
    u = q[..., :3]
    return v + 2.0 * _cross(u, _cross(u, v) + q[..., 3:] * v)


def relative(parents: Poses, children: Poses) -> Poses:
    """Each child's pose as its parent sees it; both are given in the world."""
    (p, q), (r, s) = parents, children
    inverse = q * (-1, -1, -1, 1)
    a, b, x, y = inverse[..., :3], s[..., :3], inverse[..., 3:], s[..., 3:]
    vector = x * b + y * a + _cross(a, b)
    scalar = x * y - (a * b).sum(axis=-1, keepdims=True)
    return rotate(inverse, r - p), np.concatenate([vector, scalar], axis=-1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    # np.cross takes five times as long on arrays this small.
    (x, y, z), (u, v, w) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


class WalkerBody:
    """The walker and its course.

    Attributes:
        dt: s of simulated time per step.
        parents: part -> the part that it hangs on, from the root down.
        observation_names, joint_names, contact_names: names of what is recorded per step.
    """

    def __init__(self, env):
        # Here, so that reading a recording loads no simulator.
        from gymnasium.envs.box2d.bipedal_walker import FPS

        from designrl.envs.walker import JOINTS, OBSERVATIONS

        self.env = env
        self.dt = 1.0 / FPS
        self.parents = WALKER_TREE
        self.observation_names, self.joint_names = OBSERVATIONS, JOINTS
        self.contact_names = ("bottom leg 1", "bottom leg 2")
        self._heights = np.append(0.0, WALKER.dimensions(env.design)[1::2] / SCALE)  # m

    def urdf(self, caption: str) -> str:
        """The body as a URDF robot."""
        return walker_urdf(self.env.design, caption)

    def poses(self) -> Poses:
        """Poses of the parts' frames, which are where each hangs on its parent."""
        bodies = [self.env.hull, *self.env.legs]
        x, z, angle = np.array([(*body.position, body.angle) for body in bodies]).T
        positions, rotations = np.zeros((len(bodies), 3)), np.zeros((len(bodies), 4))
        # Box2D has its origin in the middle of a leg's part.
        positions[:, 0] = x - np.sin(angle) * self._heights / 2
        positions[:, 2] = z + np.cos(angle) * self._heights / 2
        rotations[:, 1], rotations[:, 3] = -np.sin(angle / 2), np.cos(angle / 2)
        return positions, rotations

    def joints(self) -> tuple[list[float], list[float], list[float]]:
        """Angle, speed and motor torque of each joint."""
        joints = self.env.joints
        torques = [joint.GetMotorTorque(1.0 / self.dt) for joint in joints]
        return [joint.angle for joint in joints], [joint.speed for joint in joints], torques

    def contacts(self) -> list[bool]:
        """Whether each lower leg touches the ground."""
        return [bool(self.env.legs[i].ground_contact) for i in (1, 3)]

    def lidar(self) -> np.ndarray:
        """(10, 2, 2) start and end of each ray, x and z."""
        return self.env.lidar_rays()

    def terrain(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, 2) x and z of the ground's profile; (m, 4) x_min, x_max, z_min, z_max of obstacles.

        Pits are dips in the profile between two obstacles that are their walls.
        """
        profile = np.stack([self.env.terrain_x, self.env.terrain_y], axis=1)
        shapes = [np.array(body.fixtures[0].shape.vertices) for body in self.env.terrain]
        boxes = [(*c.min(axis=0), *c.max(axis=0)) for c in shapes if len(c) > 2]
        return profile, np.array(boxes, dtype=np.float64).reshape(-1, 4)[:, [0, 2, 1, 3]]

    def ground_near(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) points of the ground within GROUND_REACH of a place, (n, 3) their colors."""
        points, colors = self._ground
        near = np.abs(points[:, 0] - position[0]) < GROUND_REACH
        return points[near], colors[near]

    @cached_property
    def _ground(self) -> tuple[np.ndarray, np.ndarray]:
        profile, obstacles = self.terrain()
        # A steep piece of the profile is inside of a pit's wall, which is drawn as such.
        lines = [
            (a, b, GROUND_COLOR)
            for a, b in zip(profile[:-1], profile[1:], strict=True)
            if abs(a[1] - b[1]) < 1.0
        ]
        for x0, x1, z0, z1 in obstacles:
            corners = [(x0, z0), (x1, z0), (x1, z1), (x0, z1)]
            lines += [(corners[i - 1], corners[i], OBSTACLE_COLOR) for i in range(4)]
        points, colors = [], []
        for a, b, color in lines:
            count = math.ceil(math.dist(a, b) / GROUND_SPACING)
            x, z = np.linspace(a, b, count, endpoint=False).T
            for y in np.linspace(-GROUND_HALF_WIDTH, GROUND_HALF_WIDTH, GROUND_ROWS):
                points.append(np.stack([x, np.full(count, y), z], axis=1))
                colors.append(np.tile(np.uint8(color), (count, 1)))
        return np.concatenate(points), np.concatenate(colors)


class AntBody:
    """The ant on its endless floor; answers as `WalkerBody` does."""

    def __init__(self, env):
        from designrl.envs.ant import FEET, JOINTS, OBSERVATIONS, TIME_STEP, leg_capsules

        self.env = env
        self.dt = TIME_STEP
        parts = leg_capsules(env.design)
        self.parents = {"torso": "world", **{part.name: part.parent for part in parts}}
        self.observation_names, self.joint_names, self.contact_names = OBSERVATIONS, JOINTS, FEET

    def urdf(self, caption: str) -> str:
        """The body as a URDF robot."""
        return ant_urdf(self.env.design, caption)

    def poses(self) -> Poses:
        """Poses of the parts' frames, which are where each hangs on its parent."""
        _, positions, rotations = zip(*self.env.body_poses(), strict=True)
        return np.array(positions), np.array(rotations)

    def joints(self) -> tuple[list[float], list[float], list[float]]:
        """Angle, speed and torque of each joint."""
        return list(self.env.joint_angles), list(self.env.joint_speeds), list(self.env.torques)

    def contacts(self) -> list[bool]:
        """Whether each foot touches the floor."""
        return [bool(touching) for touching in self.env.foot_contacts]

    def lidar(self) -> None:
        """The ant has none."""

    def terrain(self) -> None:
        """The ant's floor has no features."""

    def ground_near(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) points of a grid on the floor around a place, (n, 3) their colors."""
        middle = np.round(position[:2])
        fine, coarse = np.arange(-3.0, 3.001, 0.1), np.arange(-3.0, 3.001, 1.0)
        x, y = (
            np.concatenate([a.ravel() for a in pair])
            for pair in zip(np.meshgrid(fine, coarse), np.meshgrid(coarse, fine), strict=True)
        )
        points = np.stack([x + middle[0], y + middle[1], np.zeros_like(x)], axis=1)
        return points, np.tile(np.uint8(GROUND_COLOR), (len(points), 1))
