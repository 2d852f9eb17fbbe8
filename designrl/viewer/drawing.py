"""Solid things: robots, terrain, a flat floor."""

import numpy as np
import rerun as rr

from designrl.bodies import GROUND_COLOR, GROUND_HALF_WIDTH, OBSTACLE_COLOR
from designrl.bodies.robot import Robot, Shape
from designrl.viewer.layout import entity

SOLID = rr.components.FillMode.Solid
GRID_COLOR = (90, 150, 78)
EDGE_COLOR = (50, 96, 42)
MAX_FLOOR = 500.0  # m from the origin, where a floor ends at the latest


def log_robot(stream: rr.RecordingStream, robot: Robot, path: str, at, color=None) -> None:
    """Log a robot in its pose, with its root at `at` (3,) in m.

    Args:
        color: of all of it, instead of its own; such a robot does not change with time.
    """
    paths = {"world": path}
    for part, joint in robot.joints.items():
        paths[part] = f"{paths[joint.parent]}/{entity(part)}"
        pose = rr.Transform3D(
            translation=at if joint.parent == "world" else joint.xyz,
            rotation=rr.RotationAxisAngle(axis=joint.axis, radians=joint.angle),
        )
        stream.log(paths[part], pose, static=color is not None)
        log_part(stream, robot.shapes[part], paths[part], color is not None, color)


def log_part(stream, shapes: list[Shape], path: str, static: bool, color=None) -> None:
    """Log the shapes of a part under its entity."""
    for kind in dict.fromkeys(shape.kind for shape in shapes):
        _, sizes, centers, quaternions, colors = map(
            np.array, zip(*(shape for shape in shapes if shape.kind == kind), strict=True)
        )
        solid = {"colors": color or colors, "fill_mode": SOLID, "centers": centers}
        if kind == "box":
            drawn = rr.Boxes3D(sizes=sizes, quaternions=quaternions, **solid)
        elif kind == "cylinder":
            radii, lengths = sizes.T
            drawn = rr.Cylinders3D(radii=radii, lengths=lengths, quaternions=quaternions, **solid)
        else:
            drawn = rr.Ellipsoids3D(radii=sizes[:, 0], **solid)
        stream.log(f"{path}/{kind}", drawn, static=static)


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
