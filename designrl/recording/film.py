"""A recorded rollout as a film, drawn from its poses alone: what a notebook shows of it."""

import base64
import io

import numpy as np
from PIL import Image, ImageDraw

from designrl.bodies import (
    GROUND_COLOR,
    GROUND_HALF_WIDTH,
    OBSTACLE_COLOR,
    SKY_COLOR,
    multiply,
    rotate,
)
from designrl.bodies.robot import Robot

SIZE, NEAR, FAR = (480, 270), 75.0, 36.0  # pixels; pixels per m of a floor, of a course
PICTURES, SECONDS = 15, 10.0  # a second; s that are shown at most
ASLANT = np.array([0.3, 0.3])  # m to the right and up for a m into the depth
FLOOR_DEPTH = (-4.0, 6.0)  # m
SMOOTHER = 2  # drawn so many times larger


def html(recording) -> str:
    """An <img> with the first SECONDS of a rollout, in real time.

    Raises:
        RecordingError and what damaged recordings make Python raise.
    """
    robot = Robot(recording.first("/robot_description"))
    times = recording.array("/tf", "log_time") / 1e9
    shown = np.unique(np.searchsorted(times, np.arange(0, min(times[-1], SECONDS), 1 / PICTURES)))
    course = recording.first("/terrain") if recording.topics.get("/terrain") else None
    world = _world_poses(recording, shown)
    middle = next(iter(world.values()))[0]
    shapes = [
        (part, shape.points(), shape.color[:3])
        for part in world
        for shape in robot.shapes.get(part, ())
    ]
    pictures = [_picture(shapes, world, course, middle[i], i) for i in range(len(shown))]
    file = io.BytesIO()
    how = {"save_all": True, "append_images": pictures[1:], "loop": 0, "quality": 50}
    pictures[0].save(file, "WEBP", duration=round(1000 / PICTURES), **how)
    data = base64.b64encode(file.getvalue()).decode()
    return f'<img width="{SIZE[0]}" height="{SIZE[1]}" src="data:image/webp;base64,{data}">'


def _world_poses(recording, shown: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Part -> its (n, 3) positions and (n, 4) rotations in the world, the root first."""
    found = {}
    for part, (parent, positions, turns) in recording.transforms().items():
        position, turn = positions[shown], turns[shown]
        if parent in found:
            at, by = found[parent]
            position, turn = at + rotate(by, position), multiply(by, turn)
        found[part] = position, turn
    return found


def _picture(shapes, world, course, middle: np.ndarray, i: int) -> Image.Image:
    image = Image.new("RGB", tuple(SMOOTHER * size for size in SIZE), SKY_COLOR)
    draw, scale = ImageDraw.Draw(image), SMOOTHER * (FAR if course else NEAR)

    def place(points) -> np.ndarray:
        x, y, z = np.asarray(points, dtype=float).T
        across, up = x - middle[0] + ASLANT[0] * y, z - middle[2] + ASLANT[1] * y
        return np.stack(
            [image.width / 2 + scale * across, 0.35 * image.height - scale * up], axis=1
        )

    def fill(points, color, edge=None) -> None:
        draw.polygon([tuple(p) for p in _hull(place(points))], tuple(color), edge)

    _draw_ground(fill, course, middle[0])
    placed = []
    for part, points, color in shapes:
        position, turn = world[part]
        placed.append((position[i] + rotate(turn[i], points), color))
    for points, color in sorted(placed, key=lambda each: -each[0][:, 1].mean()):  # far ones first
        fill(points, color.tolist(), tuple((0.6 * color).astype(int).tolist()))
    return image.reduce(SMOOTHER)


def _draw_ground(fill, course, middle: float) -> None:
    reach = SIZE[0] / FAR / 2 + FLOOR_DEPTH[1] * ASLANT[0]  # m to both sides that may be seen
    dark = tuple(round(0.85 * c) for c in GROUND_COLOR)
    if course is None:
        for x in np.arange(np.floor(middle - reach), middle + reach):
            color = GROUND_COLOR if x % 2 else dark
            fill([(a, y, 0.0) for a in (x, x + 1) for y in FLOOR_DEPTH], color)
        return
    depth = (GROUND_HALF_WIDTH, -GROUND_HALF_WIDTH)
    x, z = np.array(course.x), np.array(course.z)
    near = np.flatnonzero(np.abs(x[:-1] - middle) < reach)
    low = z.min() - reach
    for i in near:
        ends = [(x[j], z[j]) for j in (i, i + 1)]
        fill([(a, -GROUND_HALF_WIDTH, b) for a, top in ends for b in (top, low)], dark, dark)
        fill([(a, y, b) for a, b in ends for y in depth], GROUND_COLOR, GROUND_COLOR)
    for o in course.obstacles:
        if abs(o.x_min - middle) < reach:
            corners = [(a, b) for a in (o.x_min, o.x_max) for b in (o.z_min, o.z_max)]
            side = tuple(round(0.85 * c) for c in OBSTACLE_COLOR)
            fill([(a, y, b) for a, b in corners for y in depth], OBSTACLE_COLOR, side)
            fill([(a, -GROUND_HALF_WIDTH, b) for a, b in corners], side, side)


def _hull(points: np.ndarray) -> list[np.ndarray]:
    """The convex hull of points (n, 2) in the plane, in turn (Andrew's monotone chain)."""
    ordered = points[np.lexsort(points.T[::-1])].tolist()

    def chain(rest) -> list:
        found: list = []
        for x, y in rest:
            while len(found) > 1:
                (a, b), (c, d) = found[-2:]
                if (c - a) * (y - b) - (d - b) * (x - a) > 0:
                    break
                found.pop()
            found.append((x, y))
        return found[:-1]

    return chain(ordered) + chain(ordered[::-1])
