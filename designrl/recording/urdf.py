"""A design as a URDF robot, which any viewer can draw.

x is forward, y left, z up, in m; the walker's two-dimensional parts get a depth. A link's frame is
at the joint that it hangs on. The links have the paper's names. Inertias are left out: the robot is
for looking at and for its kinematics.
"""

import math
from xml.sax.saxutils import quoteattr

import numpy as np

from designrl.design import WALKER, DesignSpace
from designrl.envs import ant_body

SCALE = 30.0  # Box2D units of the walker's dimensions per m
HULL = ((-30, 9), (6, 9), (34, 1), (34, -8), (-30, -8))  # corners, in 1/30 m (Gymnasium's)
HIP = -8 / SCALE  # m, from the hull's origin
WALKER_TREE = {
    "hull": "world",
    "top leg 1": "hull",
    "bottom leg 1": "top leg 1",
    "top leg 2": "hull",
    "bottom leg 2": "top leg 2",
}
HULL_COLOR = (160, 105, 255)
LEG_COLORS = ((255, 190, 225), (225, 110, 180))  # leg 1, leg 2
LEG_SIDE = 0.4  # m: leg 1 is drawn that much to the left of the hull's plane, leg 2 to the right


def _numbers(values) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)


def _visual(shape: str, xyz, color, rpy=(0, 0, 0)) -> str:
    rgba = _numbers([*(channel / 255 for channel in color), 1])
    return (
        f'<visual><origin xyz="{_numbers(xyz)}" rpy="{_numbers(rpy)}"/><geometry><{shape}/>'
        f'</geometry><material name="{rgba}"><color rgba="{rgba}"/></material></visual>'
    )


def _box(size, xyz, color, rpy=(0, 0, 0)) -> str:
    return _visual(f'box size="{_numbers(size)}"', xyz, color, rpy)


def _sphere(radius: float, xyz, color) -> str:
    return _visual(f'sphere radius="{_numbers([radius])}"', xyz, color)


def _joint(name: str, parent: str, child: str, xyz=(0, 0, 0), axis=None, limits=()) -> str:
    kind = "floating" if parent == "world" else "fixed" if axis is None else "revolute"
    rest = ""
    if axis is not None:
        low, high, effort, speed = limits
        rest = (
            f'<axis xyz="{_numbers(axis)}"/><limit lower="{low:.6g}" upper="{high:.6g}" '
            f'effort="{effort:.6g}" velocity="{speed:.6g}"/>'
        )
    return (
        f'<joint name={quoteattr(name)} type="{kind}"><origin xyz="{_numbers(xyz)}"/>'
        f"<parent link={quoteattr(parent)}/><child link={quoteattr(child)}/>{rest}</joint>"
    )


def _robot(name: str, caption: str, links: dict[str, list[str]], joints: list[str]) -> str:
    text = ["<?xml version='1.0'?>", f"<!--\n{caption.replace('--', '- -')}\n-->"]
    text += [f"<robot name={quoteattr(name)}>", '  <link name="world"/>']
    for link, visuals in links.items():
        text.append("\n    ".join([f"  <link name={quoteattr(link)}>", *visuals]) + "\n  </link>")
    return "\n".join([*text, *(f"  {joint}" for joint in joints), "</robot>"])


def walker_urdf(scales: np.ndarray, caption: str = "") -> str:
    """The walker of a design of scales (8,); `caption` becomes a comment at the top."""
    size = (WALKER.dimensions(scales) / SCALE).reshape(4, 2).tolist()  # width, height
    links, joints = {"hull": _hull()}, [_joint("hull", "world", "hull")]
    for i, (part, parent) in enumerate(list(WALKER_TREE.items())[1:]):
        (width, height), leg, top = size[i], i // 2, i % 2 == 0
        side = LEG_SIDE * (1 - 2 * leg)
        links[part] = [_box((width, 0.2, height), (0, side, -height / 2), LEG_COLORS[leg])]
        origin = (0, 0, HIP if top else -size[i - 1][1])
        limits = (-0.8, 1.1, 80, 4) if top else (-1.6, -0.1, 80, 6)  # rad, N m, rad/s
        name = f"{'hip' if top else 'knee'} {leg + 1}"
        joints.append(_joint(name, parent, part, origin, (0, -1, 0), limits))
    return _robot("walker", caption, links, joints)


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
        _box((x1 - x0, 0.5, y1 - y0), ((x0 + x1) / 2, 0, (y0 + y1) / 2), HULL_COLOR),
        _box((x2 - x1, 0.5, y2 - y0), ((x1 + x2) / 2, 0, (y0 + y2) / 2), HULL_COLOR),
        _box((length, 0.5, thick), middle, HULL_COLOR, (0, slope, 0)),
    ]


def ant_urdf(scales: np.ndarray, caption: str = "") -> str:
    """The ant of a design of scales (36,); a capsule is a cylinder and two spheres."""
    torso = [_sphere(ant_body.TORSO_RADIUS, (0, 0, 0), ant_body.COLORS["torso"])]
    links, joints = {"torso": torso}, [_joint("torso", "world", "torso")]
    for part in ant_body.leg_capsules(scales):
        color, (x, y, z) = ant_body.COLORS[part.name.split()[-1]], part.end
        cylinder = f'cylinder radius="{_numbers([part.radius])}" length="{math.hypot(x, y):.9g}"'
        turn = (0, math.pi / 2, math.atan2(y, x))  # a URDF cylinder stands on z; the legs lie flat
        links[part.name] = [
            _visual(cylinder, (x / 2, y / 2, z / 2), color, turn),
            _sphere(part.radius, (0, 0, 0), color),
            _sphere(part.radius, part.end, color),
        ]
        axis = part.axis if part.joint else None
        limits = (*np.radians(part.limits), 250, 100)  # rad; 2.5 · 100 N m; no limit of speed
        name = part.joint or f"{part.name} weld"
        joints.append(_joint(name, part.parent, part.name, part.origin, axis, limits))
    return _robot("ant", caption, links, joints)


def body_urdf(space: DesignSpace, scales: np.ndarray, caption: str = "") -> str:
    """The walker or the ant, whichever the design space is of."""
    return (walker_urdf if space is WALKER else ant_urdf)(scales, caption)
