"""A URDF robot of this package's building blocks, read from its text to be drawn.

Lengths are in m, angles in rad.
"""

import math
from itertools import product
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from designrl.bodies import multiply, rotate

OUTLINE_SPACING = 0.1  # m, at most, between the points along an edge; twice that of circles
CIRCLE_POINTS = 8
MAX_URDF = 2**20  # characters; ours have some 20,000


class Shape(NamedTuple):
    """What is drawn of a link: kind is "box", "cylinder" (about z) or "sphere".

    Attributes:
        kind: of the shape.
        size: m: (3,) edges; radius and length; radius.
        xyz: (3,) its middle in the link's frame, m.
        quaternion: (4,) how it is turned there.
        color: (4,) uint8, the last is the opacity.
    """

    kind: str
    size: np.ndarray
    xyz: np.ndarray
    quaternion: np.ndarray
    color: np.ndarray

    def points(self) -> np.ndarray:
        """(n, 3) points on its edges or circles, in the link's frame, m."""
        return self.xyz + rotate(self.quaternion, _outline(self))


class Joint(NamedTuple):
    """How a link hangs on its parent: at xyz (3,) there, turned by `angle` about `axis` (3,)."""

    parent: str
    xyz: np.ndarray
    axis: np.ndarray
    angle: float


class Robot:
    """A robot of `designrl.bodies.urdf`'s building blocks, read from its text.

    Args:
        text: the URDF.
        pose: joint -> rad; joints that are not named are in mid-range.

    Attributes:
        shapes: link -> its shapes.
        joints: child -> its joint, parents before children.
    """

    def __init__(self, text: str, pose: dict[str, float] | None = None):
        if len(text) > MAX_URDF:
            raise ValueError("the description of the robot is too long")
        root = ElementTree.fromstring(text)
        self.shapes = {
            link.get("name"): [_shape(visual) for visual in link.findall("visual")]
            for link in root.findall("link")
        }
        self.joints = {
            joint.find("child").get("link"): _joint(joint, pose or {})  # type: ignore[union-attr]
            for joint in root.findall("joint")
        }

    def outline(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) points on its edges and circles, m, with the root at 0; (n, 3) uint8 colors."""
        places: dict[str | None, tuple[np.ndarray, np.ndarray]] = {}
        places["world"] = np.zeros(3), np.array([0, 0, 0, 1.0])
        points, colors = [], []
        for link, joint in self.joints.items():
            position, turn = places[joint.parent]
            position = position + rotate(turn, joint.xyz)
            half = joint.angle / 2
            axis = joint.axis / np.linalg.norm(joint.axis)
            turn = multiply(turn, np.append(np.sin(half) * axis, np.cos(half)))
            places[link] = position, turn
            for shape in self.shapes[link]:
                own = shape.points()
                points.append(position + rotate(turn, own))
                colors.append(np.tile(shape.color[:3], (len(own), 1)))
        return np.concatenate(points), np.concatenate(colors)


def _outline(shape: Shape) -> np.ndarray:
    """(n, 3) points on a shape's edges or circles, around its middle."""
    if shape.kind == "box":
        lines = []
        for along, *across in ((0, 1, 2), (1, 0, 2), (2, 0, 1)):
            count = math.ceil(shape.size[along] / OUTLINE_SPACING) + 1
            for sides in product((-0.5, 0.5), repeat=2):
                line = np.empty((count, 3))
                line[:, along] = np.linspace(-0.5, 0.5, count)
                line[:, across] = sides
                lines.append(line * shape.size)
        return np.concatenate(lines)
    radius = shape.size[0]
    angle = np.linspace(0, 2 * np.pi, CIRCLE_POINTS, endpoint=False)
    circle = radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    if shape.kind == "sphere":
        return np.concatenate([np.roll(circle, i, axis=1) for i in range(3)])
    heights = np.linspace(-0.5, 0.5, math.ceil(shape.size[1] / OUTLINE_SPACING / 2) + 1)
    return np.concatenate([circle + (0, 0, height * shape.size[1]) for height in heights])


def _shape(visual) -> Shape:
    shape, origin = visual.find("geometry")[0], visual.find("origin")
    size = np.concatenate([_floats(shape, key) for key in shape.attrib])
    color = np.round(255 * _floats(visual.find("material/color"), "rgba")).astype(np.uint8)
    turn = _quaternion(*_floats(origin, "rpy"))
    return Shape(shape.tag, size, _floats(origin, "xyz"), turn, color)


def _joint(joint, pose: dict[str, float]) -> Joint:
    place, axis, limit = _floats(joint.find("origin"), "xyz"), np.array([0, 0, 1.0]), (0.0, 0.0)
    if joint.get("type") == "revolute":
        axis = _floats(joint.find("axis"), "xyz")
        low, high = (float(joint.find("limit").get(side)) for side in ("lower", "upper"))
        limit = low, high
    angle = pose.get(joint.get("name"), sum(limit) / 2)
    return Joint(joint.find("parent").get("link"), place, axis, angle)


def _floats(element, key: str) -> np.ndarray:
    return np.array([float(value) for value in element.get(key).split()])


def _quaternion(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """x, y, z, w of URDF's angles: about x, then y, then z, all fixed."""
    (sr, sp, sy), (cr, cp, cy) = (f(np.array([roll, pitch, yaw]) / 2) for f in (np.sin, np.cos))
    return np.array(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )
