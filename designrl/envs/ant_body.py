"""The ant's body as data: the capsules of its legs, its joints, its description for Bullet.

x is forward (the direction of the task), y left, z up. The names are the paper's, which follow the
2016 MuJoCo file, whose ant faces y: in a walk along x, the "front left" and "back right" legs lead.
"""

from typing import NamedTuple

import numpy as np

from designrl.design import ANT, ANT_LEGS, ANT_PARTS

TORSO_RADIUS = 0.25  # m
TORSO_HEIGHT = 0.75  # m, of its centre at the start
COLORS = {  # of each part, where it is drawn
    "torso": (90, 90, 107),
    "top": (90, 90, 107),
    "middle": (217, 140, 51),
    "bottom": (242, 191, 89),
}
FRICTION = 1.5  # of the body; Bullet multiplies it with that of the floor

HIP_RANGE = (-40, 40)  # degrees
ANKLE_RANGE = (30, 100)  # degrees; mirrored, with the axis, where a leg points the other way
_ANKLE_AXES = ((-1, 1, 0), (1, 1, 0), (-1, 1, 0), (1, 1, 0))  # per leg
_ANKLE_SIGNS = (1, -1, -1, 1)

PARTS = ("torso", *(f"{leg} {part}" for leg in ANT_LEGS for part in ANT_PARTS))
JOINTS = tuple(f"{leg} {joint}" for leg in ANT_LEGS for joint in ("hip", "ankle"))


class LegPart(NamedTuple):
    """A capsule of a leg, in its own frame, which sits where it hangs on its parent.

    Attributes:
        name, parent: of `PARTS`.
        origin: (3,) of this frame in the parent's, m; all frames are parallel at zero angles.
        end: (3,) centre of the capsule's far cap, m; the near one is at 0.
        radius: m.
        joint: of `JOINTS`; None where the part is fixed to its parent (the top part).
        axis: (3,) the joint's axis, not normalised.
        limits: the joint's range, degrees.
    """

    name: str
    parent: str
    origin: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float
    joint: str | None
    axis: tuple[int, int, int]
    limits: tuple[int, int]


def leg_capsules(scales: np.ndarray) -> list[LegPart]:
    """The 12 parts of the legs of a design of scales (36,), in the order of `PARTS` after it."""
    parts = []
    legs = ANT.dimensions(scales).reshape(len(ANT_LEGS), 9).tolist()
    for leg, axis, sign, (*ends, top, middle, bottom) in zip(
        ANT_LEGS, _ANKLE_AXES, _ANKLE_SIGNS, legs, strict=True
    ):
        ankle = (ANKLE_RANGE[0], ANKLE_RANGE[1]) if sign > 0 else (-ANKLE_RANGE[1], -ANKLE_RANGE[0])
        origin, parent = (0.0, 0.0, 0.0), "torso"
        for i, (radius, joint, joint_axis, limits) in enumerate(
            (
                (top, None, (0, 0, 0), (0, 0)),
                (middle, f"{leg} hip", (0, 0, 1), HIP_RANGE),
                (bottom, f"{leg} ankle", axis, ankle),
            )
        ):
            end = (ends[2 * i], ends[2 * i + 1], 0.0)
            name = f"{leg} {ANT_PARTS[i]}"
            parts.append(LegPart(name, parent, origin, end, radius, joint, joint_axis, limits))
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
        if part.name.endswith(ANT_PARTS[-1]):
            text.append("</body>" * len(ANT_PARTS))
    text.append("</body></worldbody></mujoco>")
    return "\n".join(text)
