"""The two-legged walker: a hull on two legs of two parts each, in the plane of x and z.

Box2D's y is z here. The names are the paper's. The parts have no depth; they are drawn with one.
"""

import math

import numpy as np

from designrl.bodies import (
    GROUND_COLOR,
    GROUND_HALF_WIDTH,
    OBSTACLE_COLOR,
    SKY_COLOR,
    Body,
    Poses,
    urdf,
)
from designrl.design import DesignSpace
from designrl.errors import optional

SCALE = 30.0  # Box2D units of the dimensions per m
HULL = ((-30, 9), (6, 9), (34, 1), (34, -8), (-30, -8))  # corners, in 1/30 m (Gymnasium's)
HIP = -8 / SCALE  # m, from the hull's origin
HULL_COLOR = (160, 105, 255)
LEG_COLORS = ((255, 190, 225), (225, 110, 180))  # leg 1, leg 2
LEG_SIDE = 0.3  # m: leg 1 is drawn that much to the left of the hull's plane, leg 2 to the right
LIDAR_RAYS = 10

PICTURE_SIZE = (640, 480)  # pixels
SMOOTHING = 2  # pictures are drawn so much larger and then reduced

GROUND_REACH = 7.0  # m to either side of the body: the ground that any viewer is shown
GROUND_SPACING = 0.06  # m between the points of a line
GROUND_ROWS = 7  # lines across the ground's width


class WalkerBody(Body):
    """The walker and its course."""

    name = "walker"
    design = DesignSpace(
        # Order of the author's weights; dimensions of the original walker (Table 2, first row).
        names=tuple(
            f"{part} leg {leg} {side}"
            for leg in (1, 2)
            for part in ("top", "bottom")
            for side in ("width", "height")
        ),
        originals=np.array([8.0, 34.0, 6.4, 34.0] * 2),
        unit="1/30 m",  # Box2D units as Table 2 prints them: the simulation divides by SCALE
    )
    tree = {
        "hull": "world",
        "top leg 1": "hull",
        "bottom leg 1": "top leg 1",
        "top leg 2": "hull",
        "bottom leg 2": "top leg 2",
    }
    joints = ("hip 1", "knee 1", "hip 2", "knee 2")
    observations = (
        "hull angle",
        "hull angular velocity",
        "horizontal speed",
        "vertical speed",
        *(
            name
            for leg in (1, 2)
            for name in (
                f"hip {leg} angle",
                f"hip {leg} speed",
                f"knee {leg} angle",
                f"knee {leg} speed",
                f"leg {leg} ground contact",
            )
        ),
        *(f"lidar {ray}" for ray in range(LIDAR_RAYS)),
    )
    contact_names = ("bottom leg 1", "bottom leg 2")
    time_step = 1 / 50
    rest_pose = {"hip 1": -0.35, "knee 1": -0.2, "hip 2": 0.5, "knee 2": -0.5}
    rollout_eye = ((1.0, -7.6, 0.5), (1.0, 0, -0.8))
    design_eye = ((-1.3, -6.5, -0.9), (-1.3, 0, -1.3))
    limbs = {"leg 1": [0, 1, 2, 3], "leg 2": [4, 5, 6, 7]}

    def urdf(self, scales: np.ndarray, caption: str = "") -> str:
        """The walker of a design of scales (8,)."""
        size = (self.design.dimensions(scales) / SCALE).reshape(4, 2).tolist()  # width, height
        links, joints = {"hull": _hull()}, [urdf.joint("hull", "world", "hull")]
        for i, (part, parent) in enumerate(list(self.tree.items())[1:]):
            (width, height), leg, top = size[i], i // 2, i % 2 == 0
            middle = (0, LEG_SIDE * (1 - 2 * leg), -height / 2)
            links[part] = [urdf.box((width, 0.2, height), middle, LEG_COLORS[leg])]
            origin = (0, 0, HIP if top else -size[i - 1][1])
            limits = (-0.8, 1.1, 80, 4) if top else (-1.6, -0.1, 80, 6)  # rad, N m, rad/s
            joints.append(urdf.joint(self.joints[i], parent, part, origin, (0, -1, 0), limits))
        return urdf.robot(self.name, caption, links, joints)

    def poses(self, env) -> Poses:
        """Poses of the parts' frames."""
        bodies = [env.hull, *env.legs]
        x, z, angle = np.array([(*body.position, body.angle) for body in bodies]).T
        # Box2D has its origin in the middle of a leg's part.
        up = np.append(0.0, self.design.dimensions(env.design)[1::2] / SCALE) / 2  # m
        positions, rotations = np.zeros((len(bodies), 3)), np.zeros((len(bodies), 4))
        # NumPy's own sine can have another last bit, depending on the processor.
        sin, cos = (np.array([f(a) for a in angle]) for f in (math.sin, math.cos))
        positions[:, 0], positions[:, 2] = x - sin * up, z + cos * up
        rotations[:, 1] = [-math.sin(a / 2) for a in angle]
        rotations[:, 3] = [math.cos(a / 2) for a in angle]
        return positions, rotations

    def joint_states(self, env) -> tuple[list[float], list[float], list[float]]:
        """Angle, speed and motor torque of each joint."""
        joints = env.joints
        torques = [joint.GetMotorTorque(1 / self.time_step) for joint in joints]
        return [joint.angle for joint in joints], [joint.speed for joint in joints], torques

    def contacts(self, env) -> list[bool]:
        """Whether each lower leg touches the ground."""
        return [bool(env.legs[i].ground_contact) for i in (1, 3)]

    def lidar(self, env) -> np.ndarray:
        """(10, 2, 2) start and end of each ray of the last step, x and z."""
        return np.array([[ray.p1, ray.p2] for ray in env.lidar])

    def terrain(self, env) -> tuple[np.ndarray, np.ndarray]:
        """Pits are dips in the profile between two obstacles that are their walls."""
        profile = np.stack([env.terrain_x, env.terrain_y], axis=1)
        shapes = [np.array(body.fixtures[0].shape.vertices) for body in env.terrain]
        boxes = [(*c.min(axis=0), *c.max(axis=0)) for c in shapes if len(c) > 2]
        return profile, np.array(boxes, dtype=np.float64).reshape(-1, 4)[:, [0, 2, 1, 3]]

    def picture(self, env) -> np.ndarray:
        """The body from its side, as large as its legs allow; the eye follows it."""
        with optional("the walker's picture", "reference"):
            from PIL import Image, ImageDraw
        profile, obstacles = self.terrain(env)
        legs = self.design.dimensions(env.design)[1::2].reshape(2, 2).sum(axis=1).max() / SCALE
        width, height = np.multiply(PICTURE_SIZE, SMOOTHING)
        pixels = 0.68 * height / (legs + (HULL[0][1] - HULL[3][1]) / SCALE)  # per m
        x = env.hull.position[0]
        near = np.abs(profile[:, 0] - x) < 3.0  # the mean of so much ground moves smoothly
        corner = np.array(
            [x - width / pixels * 0.45, profile[near, 1].mean() + 0.8 * height / pixels]
        )

        def polygon(points, face, edge=None) -> None:
            at = (np.asarray(points) - corner) * (pixels, -pixels)
            draw.polygon([tuple(p) for p in at.tolist()], face, edge, SMOOTHING if edge else 1)

        image = Image.new("RGB", (width, height), SKY_COLOR)
        draw = ImageDraw.Draw(image)
        depth = profile[:, 1].min() - 10
        ends = [(profile[-1, 0], depth), (profile[0, 0], depth)]
        polygon([*profile.tolist(), *ends], GROUND_COLOR)
        for x0, x1, z0, z1 in obstacles.tolist():
            polygon([(x0, z0), (x1, z0), (x1, z1), (x0, z1)], OBSTACLE_COLOR)
        for body in (*env.legs, env.hull):
            for fixture in body.fixtures:
                corners = [body.transform * vertex for vertex in fixture.shape.vertices]
                polygon(corners, body.color1, body.color2)
        return np.asarray(image.reduce(SMOOTHING))

    def ending(self, env) -> str:
        if env.game_over:
            return "fell"
        return "left the course at its start" if env.hull.position[0] < 0 else "reached the end"

    def ground_near(self, env, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) points of the course within GROUND_REACH of a place, (n, 3) their colors."""
        profile, obstacles = self.terrain(env)
        # A steep piece of the profile is inside of a pit's wall, which is drawn as such.
        flat = np.abs(np.diff(profile[:, 1])) < 1.0
        corners = obstacles[:, [0, 2, 1, 2, 1, 3, 0, 3]].reshape(-1, 4, 2)  # of each, in turn
        start = np.concatenate([profile[:-1][flat], corners.reshape(-1, 2)])
        end = np.concatenate([profile[1:][flat], np.roll(corners, -1, axis=1).reshape(-1, 2)])
        colors = np.full((len(start), 3), OBSTACLE_COLOR, dtype=np.uint8)
        colors[: flat.sum()] = GROUND_COLOR

        count = np.ceil(np.hypot(*(end - start).T) / GROUND_SPACING).astype(int)
        line = np.repeat(np.arange(len(start)), count)
        step = np.arange(len(line)) - np.repeat(np.cumsum(count) - count, count)
        points = start[line] + ((end - start) / count[:, None])[line] * step[:, None]
        near = np.abs(points[:, 0] - position[0]) < GROUND_REACH
        x, z = np.tile(points[near], (GROUND_ROWS, 1)).T
        y = np.linspace(-GROUND_HALF_WIDTH, GROUND_HALF_WIDTH, GROUND_ROWS).repeat(near.sum())
        return np.stack([x, y, z], axis=1), np.tile(colors[line[near]], (GROUND_ROWS, 1))


def _hull() -> list[str]:
    """The five-cornered hull as boxes: back, front, and between their tops the slope.

    The third one is turned so that its upper face is the slope; it is just thick enough to fill
    the gap, and otherwise lies within the other two.
    """
    (x0, y1), (x1, _), (x2, y2), (_, y0), _ = ((x / SCALE, y / SCALE) for x, y in HULL)
    slope, length = math.atan2(y1 - y2, x2 - x1), math.hypot(x2 - x1, y1 - y2)
    thick = (y1 - y2) * math.cos(slope)
    middle = (
        (x1 + x2) / 2 - thick / 2 * math.sin(slope),
        0,
        (y1 + y2) / 2 - thick / 2 * math.cos(slope),
    )
    return [
        urdf.box((x1 - x0, 0.5, y1 - y0), ((x0 + x1) / 2, 0, (y0 + y1) / 2), HULL_COLOR),
        urdf.box((x2 - x1, 0.5, y2 - y0), ((x1 + x2) / 2, 0, (y0 + y2) / 2), HULL_COLOR),
        urdf.box((length, 0.5, thick), middle, HULL_COLOR, (0, slope, 0)),
    ]


WALKER = WalkerBody()


def leg_area(scales: np.ndarray) -> np.ndarray:
    """Total area of a walker's four leg parts, in (1/30 m)², for scales of shape (..., 8)."""
    size = WALKER.design.dimensions(scales)
    return (size[..., 0::2] * size[..., 1::2]).sum(axis=-1)
