"""What a rollout's pictures are made of: the body as a URDF, its poses, the ground near it.

`WalkerBody` and `AntBody` look at an environment and answer the same questions; nothing else in
the package of recordings knows one body from the other. Everything is in x forward, y left, z up;
Box2D's y is z here.
"""

import math
from functools import cached_property
from xml.sax.saxutils import quoteattr

import numpy as np

from designrl.design import WALKER

GROUND_COLOR = (112, 184, 96)
OBSTACLE_COLOR = (190, 190, 190)
GROUND_REACH = 7.0  # m to either side of the body: the ground that stock viewers are shown
GROUND_HALF_WIDTH = 1.0  # m; the ground of a two-dimensional world is drawn this wide
GROUND_SPACING = 0.06  # m between the points of a line
GROUND_ROWS = 9  # lines across that width
GROUND_REFRESH = 1.0  # m that the body moves before the ground near it is drawn again

Pose = tuple[np.ndarray, np.ndarray]  # position (3,) in m, rotation (4,) quaternion x, y, z, w


def make_body(env) -> "WalkerBody":
    """The view of a Gymnasium environment of ours that recordings need; reset it first."""
    return WalkerBody(env.unwrapped)


# ------------------------------------------------------------------------------ poses and URDF


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The vector v (3,) turned by the unit quaternion q (x, y, z, w)."""
    u = q[:3]
    return v + 2.0 * np.cross(u, np.cross(u, v) + q[3] * v)


def relative(parent: Pose, child: Pose) -> Pose:
    """The child's pose as its parent sees it; both are given in the world."""
    (p, q), (r, s) = parent, child
    inverse = np.array([-q[0], -q[1], -q[2], q[3]])
    vector = inverse[3] * s[:3] + s[3] * inverse[:3] + np.cross(inverse[:3], s[:3])
    return rotate(inverse, r - p), np.append(vector, inverse[3] * s[3] - inverse[:3] @ s[:3])


def _numbers(values) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)


def visual(shape: str, xyz, rpy, color) -> str:
    """A URDF visual; shape is its element ('box size="1 2 3"'), color (3,) in 0..255."""
    rgba = _numbers([*(channel / 255 for channel in color), 1])
    return (
        f'    <visual><origin xyz="{_numbers(xyz)}" rpy="{_numbers(rpy)}"/><geometry><{shape}/>'
        f'</geometry><material name="{rgba}"><color rgba="{rgba}"/></material></visual>'
    )


def box(size, xyz, rpy=(0, 0, 0), color=(128, 128, 128)) -> str:
    """A URDF box; size and xyz (3,) in m, rpy (3,) in rad."""
    return visual(f'box size="{_numbers(size)}"', xyz, rpy, color)


def urdf(name: str, comment: str, links: dict[str, list[str]], joints: list[str]) -> str:
    """A robot of links with their visuals, standing in a link called `world`."""
    text = ["<?xml version='1.0'?>", f"<!--\n{comment.replace('--', '- -')}\n-->"]
    text += [f"<robot name={quoteattr(name)}>", '  <link name="world"/>']
    for link, visuals in links.items():
        text += [f"  <link name={quoteattr(link)}>", *visuals, "  </link>"]
    return "\n".join([*text, *joints, "</robot>"])


def joint(name: str, kind: str, parent: str, child: str, xyz=(0, 0, 0), rest: str = "") -> str:
    """A URDF joint; `rest` holds its axis and limits."""
    return (
        f'  <joint name={quoteattr(name)} type="{kind}"><origin xyz="{_numbers(xyz)}"/>'
        f"<parent link={quoteattr(parent)}/><child link={quoteattr(child)}/>{rest}</joint>"
    )


# -------------------------------------------------------------------------------- the walker


class WalkerBody:
    """The walker and its course.

    Attributes:
        dt: s of simulated time per step.
        parents: part -> the part that it hangs on, from the root down.
        observations, joint_names, contact_names: names of what is recorded per step.
    """

    def __init__(self, env):
        from gymnasium.envs.box2d.bipedal_walker import FPS, HULL_POLY, LEG_DOWN, SCALE

        from designrl.envs import walker  # here: reading a recording needs no simulator

        self.env = env
        self.dt = 1.0 / FPS
        self.parents = dict(
            zip(walker.PARTS, ("world", "hull", "top leg 1", "hull", "top leg 2"), strict=True)
        )
        self.observations, self.joint_names = walker.OBSERVATIONS, walker.JOINTS
        self.contact_names = ("bottom leg 1", "bottom leg 2")
        self._scale, self._leg_down = SCALE, LEG_DOWN
        self._hull = HULL_POLY
        self._size = (WALKER.dimensions(env.design) / SCALE).reshape(4, 2)  # m

    def urdf(self, comment: str) -> str:
        """The body with its joints; a part's frame is at the joint that it hangs on."""
        (x0, y1), (x1, _), (x2, y2), (_, y0), _ = (
            (x / self._scale, y / self._scale) for x, y in self._hull
        )
        color = (127, 51, 229)
        # The hull is a polygon with five corners: two boxes, and a third that is turned so that its
        # upper face is the slope between them, thick enough to fill the gap, inside of the rest.
        slope, length = math.atan2(y1 - y2, x2 - x1), math.hypot(x2 - x1, y1 - y2)
        thick = (y1 - y2) * math.cos(slope)
        links = {
            "hull": [
                box((x1 - x0, 0.5, y1 - y0), ((x0 + x1) / 2, 0, (y0 + y1) / 2), color=color),
                box((x2 - x1, 0.5, y2 - y0), ((x1 + x2) / 2, 0, (y0 + y2) / 2), color=color),
                box(
                    (length, 0.5, thick),
                    (
                        (x1 + x2) / 2 - thick / 2 * math.sin(slope),
                        0,
                        (y1 + y2) / 2 - thick / 2 * math.cos(slope),
                    ),
                    (0, slope, 0),
                    color,
                ),
            ]
        }
        joints = [joint("root", "floating", "world", "hull")]
        parts = list(self.parents)[1:]
        for i, (part, (width, height)) in enumerate(zip(parts, self._size, strict=True)):
            leg, top = i // 2, i % 2 == 0
            side = 0.4 if leg == 0 else -0.4  # m; the two legs share a plane, seen apart here
            color = (178, 101, 152) if leg == 0 else (128, 51, 102)  # Gymnasium's
            links[part] = [box((width, 0.2, height), (0, side, -height / 2), color=color)]
            low, high, speed = (-0.8, 1.1, 4) if top else (-1.6, -0.1, 6)
            joints.append(
                joint(
                    self.joint_names[i],
                    "revolute",
                    self.parents[part],
                    part,
                    (0, 0, self._leg_down if top else -self._size[i - 1, 1]),
                    '<axis xyz="0 -1 0"/>'
                    f'<limit lower="{low}" upper="{high}" effort="80" velocity="{speed}"/>',
                )
            )
        return urdf("walker", comment, links, joints)

    def poses(self) -> dict[str, Pose]:
        """Part -> the pose of its frame in the world."""
        heights = [0.0, *self._size[:, 1]]
        found = {}
        for part, body, height in zip(
            self.parents, [self.env.hull, *self.env.legs], heights, strict=True
        ):
            (x, z), angle = body.position, body.angle
            found[part] = (
                np.array([x - math.sin(angle) * height / 2, 0.0, z + math.cos(angle) * height / 2]),
                np.array([0.0, -math.sin(angle / 2), 0.0, math.cos(angle / 2)]),
            )
        return found

    def joints(self) -> np.ndarray:
        """(3, 4) angle in rad, speed in rad/s, motor torque in N m of each joint."""
        return np.array(
            [(j.angle, j.speed, j.GetMotorTorque(1 / self.dt)) for j in self.env.joints]
        ).T

    def contacts(self) -> list[bool]:
        """Whether each lower leg touches the ground."""
        return [bool(self.env.legs[i].ground_contact) for i in (1, 3)]

    def lidar(self) -> np.ndarray | None:
        """(10, 2, 2) start and end (x, z) of each ray, in m; None for a body without eyes."""
        return self.env.lidar_rays()

    def center(self) -> np.ndarray:
        """(2,) x and y of the body, in m."""
        return np.array([self.env.hull.position[0], 0.0])

    def terrain(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, 2) x and z of the ground's profile; (m, 4) x_min, x_max, z_min, z_max of obstacles.

        Pits are dips in the profile between two obstacles that are their walls.
        """
        profile = np.stack([self.env.terrain_x, self.env.terrain_y], axis=1)
        shapes = [np.array(body.fixtures[0].shape.vertices) for body in self.env.terrain]
        boxes = [(*c.min(axis=0), *c.max(axis=0)) for c in shapes if len(c) > 2]
        return profile, np.array(boxes, dtype=np.float64).reshape(-1, 4)[:, [0, 2, 1, 3]]

    def ground_near(self, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) points of the ground within GROUND_REACH of the body, (n, 3) their colors."""
        points, colors = self._ground
        near = np.abs(points[:, 0] - center[0]) < GROUND_REACH
        return points[near], colors[near]

    @cached_property
    def _ground(self) -> tuple[np.ndarray, np.ndarray]:
        # Points of all the ground and obstacles, and their colors.
        profile, obstacles = self.terrain()
        # A steep piece of the profile is the inside of a pit's wall, which is drawn as such.
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
