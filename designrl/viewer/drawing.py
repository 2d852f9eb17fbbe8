"""Solid things: robots from their URDF text, terrain, a flat floor."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import rerun as rr

from designrl.bodies import GROUND_COLOR, GROUND_HALF_WIDTH, OBSTACLE_COLOR
from designrl.viewer.layout import entity

SOLID = rr.components.FillMode.Solid
GRID_COLOR = (90, 150, 78)
EDGE_COLOR = (50, 96, 42)
MAX_URDF = 2**20  # characters; ours have some 20,000
MAX_FLOOR = 500.0  # m from the origin, where a floor ends at the latest


class Robot:
    """A URDF robot made of boxes, cylinders and spheres, as far as it takes to draw it.

    Args:
        text: the URDF.
        pose: joint -> rad; joints that are not named are in mid-range.
        color: of all of it, instead of its own.

    Attributes:
        shapes: link -> kind -> what to draw.
        joints: child -> parent, place in the parent's frame, axis, angle.
    """

    def __init__(self, text: str, pose: dict[str, float] | None = None, color=None):
        if len(text) > MAX_URDF:
            raise ValueError("the description of the robot is too long")
        root = ElementTree.fromstring(text)
        self.shapes = {link.get("name"): self._shapes(link, color) for link in root.findall("link")}
        self.joints = {
            joint.find("child").get("link"): self._joint(joint, pose or {})
            for joint in root.findall("joint")
        }

    @staticmethod
    def _shapes(link, color) -> dict[str, rr.AsComponents]:
        kinds: dict[str, list] = {}
        for visual in link.findall("visual"):
            shape, origin = visual.find("geometry")[0], visual.find("origin")
            rgba = color or 255 * _floats(visual.find("material/color"), "rgba")
            sizes = np.concatenate([_floats(shape, key) for key in shape.attrib])
            row = sizes, _floats(origin, "xyz"), _quaternion(*_floats(origin, "rpy"))
            kinds.setdefault(shape.tag, []).append((*row, np.round(rgba).astype(np.uint8)))
        return {
            kind: _solid(kind, *map(np.array, zip(*rows, strict=True)))
            for kind, rows in kinds.items()
        }

    @staticmethod
    def _joint(joint, pose: dict[str, float]) -> tuple[str, np.ndarray, np.ndarray, float]:
        place, axis, limit = _floats(joint.find("origin"), "xyz"), np.array([0, 0, 1.0]), (0.0, 0.0)
        if joint.get("type") == "revolute":
            axis = _floats(joint.find("axis"), "xyz")
            limit = [float(joint.find("limit").get(side)) for side in ("lower", "upper")]
        angle = pose.get(joint.get("name"), sum(limit) / 2)
        return joint.find("parent").get("link"), place, axis, angle

    def log(self, stream: rr.RecordingStream, path: str, at, static: bool = False) -> None:
        """Log the robot in its pose, with its root at `at` (3,) in m."""
        paths = {"world": path}
        for part, (parent, place, axis, angle) in self.joints.items():
            paths[part] = f"{paths[parent]}/{entity(part)}"
            pose = rr.Transform3D(
                translation=at if parent == "world" else place,
                rotation=rr.RotationAxisAngle(axis=axis, radians=angle),
            )
            stream.log(paths[part], pose, static=static)
            self.log_shapes(stream, part, paths[part], static)

    def log_shapes(self, stream: rr.RecordingStream, part: str, path: str, static: bool) -> None:
        """Log what is to be drawn of a part under its entity."""
        for kind, shape in self.shapes[part].items():
            stream.log(f"{path}/{kind}", shape, static=static)


def _floats(element, key: str) -> np.ndarray:
    return np.array([float(value) for value in element.get(key).split()])


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """x, y, z, w of URDF's angles: about x, then y, then z, all fixed."""
    (sr, sp, sy), (cr, cp, cy) = (f(np.array([roll, pitch, yaw]) / 2) for f in (np.sin, np.cos))
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _solid(kind: str, sizes, centers, quaternions, colors) -> rr.AsComponents:
    solid = {"colors": colors, "fill_mode": SOLID}
    if kind == "box":
        return rr.Boxes3D(sizes=sizes, centers=centers, quaternions=quaternions, **solid)
    if kind == "cylinder":
        radii, lengths = sizes.T
        return rr.Cylinders3D(
            radii=radii, lengths=lengths, centers=centers, quaternions=quaternions, **solid
        )
    return rr.Ellipsoids3D(radii=sizes[:, 0], centers=centers, **solid)


def log_floor(stream: rr.RecordingStream, course: np.ndarray, world: str) -> None:
    """A floor with lines at every meter, wherever a body (positions (T, 3) in m) has been."""
    course = np.clip(course[:, :2], -MAX_FLOOR, MAX_FLOOR)
    x0, y0 = np.floor(course.min(axis=0)) - 6
    x1, y1 = np.ceil(course.max(axis=0)) + 6
    floor = rr.Boxes3D(
        mins=[(x0, y0, -0.1)],
        sizes=[(x1 - x0, y1 - y0, 0.095)],
        colors=GROUND_COLOR,
        fill_mode=SOLID,
    )
    stream.log(f"{world}/ground", floor, static=True)
    lines = [[(x, y0, 0), (x, y1, 0)] for x in np.arange(x0, x1 + 1)]
    lines += [[(x0, y, 0), (x1, y, 0)] for y in np.arange(y0, y1 + 1)]
    grid = rr.LineStrips3D(lines, colors=GRID_COLOR, radii=0.01)
    stream.log(f"{world}/meters", grid, static=True)


def log_terrain(stream: rr.RecordingStream, terrain, world: str) -> None:
    """The ground of a `Terrain` message as a strip with a front, and its obstacles as boxes."""
    x, z = np.array(terrain.x), np.array(terrain.z)
    n, side, foot = len(x), np.full(len(x), GROUND_HALF_WIDTH), np.full(len(x), z.min() - 4.0)
    # Four rows of points: the far and the near edge of the top, then head and foot of the front,
    # which is darker: in one color, feet near the far edge would seem to sink into the ground.
    rows = (x, side, z), (x, -side, z), (x, -side, z), (x, -side, foot)
    i = np.arange(n - 1)[:, None]
    triangles = [
        i + (row + corner)
        for row in (0, 2 * n)
        for corner in (np.array([0, n, 1]), np.array([1, n, n + 1]))
    ]
    shades = np.repeat([1.0, 1.0, 0.72, 0.5], n)[:, None]
    mesh = rr.Mesh3D(
        vertex_positions=np.concatenate([np.column_stack(row) for row in rows]),
        triangle_indices=np.concatenate(triangles),
        vertex_colors=np.uint8(np.array(GROUND_COLOR) * shades),
    )
    stream.log(f"{world}/ground", mesh, static=True)
    edge = rr.LineStrips3D([np.column_stack(rows[1])], colors=EDGE_COLOR, radii=0.02)
    stream.log(f"{world}/edge", edge, static=True)
    # A little larger than they are, so that their faces do not fight with the ground's.
    grow, side = 0.01, GROUND_HALF_WIDTH + 0.02
    obstacles = rr.Boxes3D(
        mins=[(o.x_min, -side, o.z_min) for o in terrain.obstacles],
        sizes=[(o.x_max - o.x_min, 2 * side, o.z_max - o.z_min + grow) for o in terrain.obstacles],
        colors=OBSTACLE_COLOR,
        fill_mode=SOLID,
    )
    stream.log(f"{world}/obstacles", obstacles, static=True)
