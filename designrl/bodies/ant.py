"""The four-legged ant: a ball on four legs of three capsules each.

x is forward (the direction of the task), y left, z up. The names are the paper's, which follow the
2016 MuJoCo file, whose ant faces y: in a walk along x, the "front left" and "back right" legs lead.
"""

from typing import NamedTuple

import numpy as np

from designrl.bodies import Body, Poses, urdf
from designrl.design import DesignSpace

ANT_LEGS = ("front left", "front right", "back left", "back right")
ANT_PARTS = ("top", "middle", "bottom")  # of a leg
_DIRECTIONS = ((1, 1), (-1, 1), (-1, -1), (1, -1))
_LEG = (0.2, 0.2, 0.2, 0.2, 0.4, 0.4, 0.08, 0.08, 0.08)  # m, signs left out

TORSO_RADIUS = 0.25  # m
TORSO_HEIGHT = 0.75  # m, of its centre at the start
COLORS = {  # of each part, where it is drawn
    "torso": (90, 90, 107),
    "top": (90, 90, 107),
    "middle": (217, 140, 51),
    "bottom": (242, 191, 89),
}
FRICTION = 1.5  # of the body; Bullet multiplies it with that of the floor
MOTOR_TORQUE = 2.5 * 100.0  # N m at action ±1: power of the ant · power of a joint

HIP_RANGE = (-40, 40)  # degrees
ANKLE_RANGE = (30, 100)  # degrees; mirrored, with the axis, where a leg points the other way
_ANKLE_AXES = ((-1, 1, 0), (1, 1, 0), (-1, 1, 0), (1, 1, 0))  # per leg
_ANKLE_SIGNS = (1, -1, -1, 1)

_JOINTS = tuple(f"{leg} {joint}" for leg in ANT_LEGS for joint in ("hip", "ankle"))
_FEET = tuple(f"{leg} bottom" for leg in ANT_LEGS)


class AntBody(Body):
    """The ant, on a flat floor."""

    name = "ant"
    design = DesignSpace(
        # Per leg: dx, dy of the three parts, then the three radii.
        names=tuple(
            name
            for leg in ANT_LEGS
            for name in (
                *(f"{leg} {part} {axis}" for part in ANT_PARTS for axis in ("dx", "dy")),
                *(f"{leg} {part} radius" for part in ANT_PARTS),
            )
        ),
        originals=np.concatenate([np.multiply(_LEG, [x, y] * 3 + [1] * 3) for x, y in _DIRECTIONS]),
        unit="m",
    )
    tree = {
        "torso": "world",
        **{
            f"{leg} {part}": f"{leg} {parent}" if parent else "torso"
            for leg in ANT_LEGS
            for part, parent in zip(ANT_PARTS, (None, *ANT_PARTS), strict=False)
        },
    }
    joints = _JOINTS
    observations = (
        "height above the start",
        "sine of the angle to the target",
        "cosine of the angle to the target",
        "forward speed",
        "sideways speed",
        "vertical speed",
        "roll",
        "pitch",
        *(f"{joint} {quantity}" for joint in _JOINTS for quantity in ("position", "speed")),
        *(f"{foot} ground contact" for foot in _FEET),
    )
    contact_names = _FEET
    action_seconds = 1.0  # from one end to the other at almost every step
    time_step = 0.0165
    limbs = {leg: list(range(9 * i, 9 * i + 9)) for i, leg in enumerate(ANT_LEGS)}

    def urdf(self, scales: np.ndarray, caption: str = "") -> str:
        """The ant of a design of scales (36,)."""
        torso = [urdf.sphere(TORSO_RADIUS, (0, 0, 0), COLORS["torso"])]
        links, joints = {"torso": torso}, [urdf.joint("torso", "world", "torso")]
        for part in leg_capsules(scales):
            links[part.name] = urdf.capsule(part.end, part.radius, COLORS[part.kind])
            axis = part.axis if part.joint else None
            limits = (*np.radians(part.limits), MOTOR_TORQUE, 100)  # no limit of speed, in truth
            name = part.joint or f"{part.name} weld"
            joints.append(urdf.joint(name, part.parent, part.name, part.origin, axis, limits))
        return urdf.robot(self.name, caption, links, joints)

    def poses(self, env) -> Poses:
        """Poses of the parts' frames."""
        return env.body_poses()

    def ending(self, env) -> str:
        return "fell"

    def joint_states(self, env) -> tuple[list[float], list[float], list[float]]:
        """Angle, speed and torque of each joint."""
        return list(env.joint_angles), list(env.joint_speeds), list(env.torques)

    def contacts(self, env) -> list[bool]:
        """Whether each foot touches the floor."""
        return [bool(touching) for touching in env.foot_contacts]


ANT = AntBody()


class LegPart(NamedTuple):
    """A capsule of a leg, in its own frame, which sits where it hangs on its parent.

    Attributes:
        name, parent: in `AntBody.tree`.
        kind: of `ANT_PARTS`.
        origin: (3,) of this frame in the parent's, m; all frames are parallel at zero angles.
        end: (3,) centre of the capsule's far cap, m; the near one is at 0.
        radius: m.
        joint: of `AntBody.joints`; None where the part is fixed to its parent (the top part).
        axis: (3,) the joint's axis, not normalised.
        limits: the joint's range, degrees.
    """

    name: str
    kind: str
    parent: str
    origin: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float
    joint: str | None
    axis: tuple[int, int, int]
    limits: tuple[int, int]


def leg_capsules(scales: np.ndarray) -> list[LegPart]:
    """The 12 parts of the legs of a design of scales (36,), in the order of `AntBody.tree`."""
    parts = []
    legs = ANT.design.dimensions(scales).reshape(len(ANT_LEGS), 9).tolist()
    for leg, axis, sign, (*ends, top, middle, bottom) in zip(
        ANT_LEGS, _ANKLE_AXES, _ANKLE_SIGNS, legs, strict=True
    ):
        ankle = ANKLE_RANGE if sign > 0 else (-ANKLE_RANGE[1], -ANKLE_RANGE[0])
        origin, parent = (0.0, 0.0, 0.0), "torso"
        for i, (radius, joint, joint_axis, limits) in enumerate(
            (
                (top, None, (0, 0, 0), (0, 0)),
                (middle, f"{leg} hip", (0, 0, 1), HIP_RANGE),
                (bottom, f"{leg} ankle", axis, ankle),
            )
        ):
            end = (ends[2 * i], ends[2 * i + 1], 0.0)
            kind, name = ANT_PARTS[i], f"{leg} {ANT_PARTS[i]}"
            parts.append(
                LegPart(name, kind, parent, origin, end, radius, joint, joint_axis, limits)
            )
            origin, parent = end, name
    return parts


def mjcf(scales: np.ndarray) -> str:
    """The body as MJCF text for Bullet's loader; links and joints have the names above.

    What Bullet does not read is left out: the density (it takes 1000 kg/m³), the joints' armature
    and damping. A geometry of contype 1 and conaffinity 0 meets the floor, but never another part
    of the body: legs pass through each other.
    """

    def numbers(values) -> str:
        return " ".join(repr(float(value)) for value in values)

    text = [
        '<mujoco model="ant"><compiler angle="degree" coordinate="local" inertiafromgeom="true"/>',
        '<default><joint limited="true"/>',
        f'<geom contype="1" conaffinity="0" condim="3" friction="{FRICTION} 0.1 0.1"/></default>',
        f'<worldbody><body name="torso" pos="0 0 {TORSO_HEIGHT}">',
        f'<geom type="sphere" size="{TORSO_RADIUS}"/>',
    ]
    for part in leg_capsules(scales):
        text.append(f'<body name="{part.name}" pos="{numbers(part.origin)}">')
        if part.joint:
            text.append(
                f'<joint name="{part.joint}" type="hinge" pos="0 0 0" '
                f'axis="{numbers(part.axis)}" range="{numbers(part.limits)}"/>'
            )
        text.append(
            f'<geom type="capsule" fromto="0 0 0 {numbers(part.end)}" '
            f'size="{numbers([part.radius])}"/>'
        )
        if part.kind == ANT_PARTS[-1]:
            text.append("</body>" * len(ANT_PARTS))
    text.append("</body></worldbody></mujoco>")
    return "\n".join(text)
