"""Building blocks of a URDF robot, which any viewer can draw.

Lengths are in m, angles in rad, colors in 0..255. Inertias are left out: the robot is for looking
at and for its kinematics.
"""

import math
from xml.sax.saxutils import quoteattr


def numbers(values) -> str:
    """Numbers as URDF writes a vector."""
    return " ".join(f"{float(value):.9g}" for value in values)


def _visual(shape: str, xyz, color, rpy=(0, 0, 0)) -> str:
    rgba = numbers([*(channel / 255 for channel in color), 1])
    return (
        f'<visual><origin xyz="{numbers(xyz)}" rpy="{numbers(rpy)}"/><geometry><{shape}/>'
        f'</geometry><material name="{rgba}"><color rgba="{rgba}"/></material></visual>'
    )


def box(size, xyz, color, rpy=(0, 0, 0)) -> str:
    """A box of a size (3,) with its middle at xyz, turned by roll, pitch, yaw."""
    return _visual(f'box size="{numbers(size)}"', xyz, color, rpy)


def sphere(radius: float, xyz, color) -> str:
    """A ball with its middle at xyz."""
    return _visual(f'sphere radius="{numbers([radius])}"', xyz, color)


def capsule(end, radius: float, color) -> list[str]:
    """A capsule from the frame's origin to `end` (3,): a cylinder and two balls."""
    x, y, z = end
    flat = math.hypot(x, y)
    cylinder = f'cylinder radius="{numbers([radius])}" length="{math.hypot(flat, z):.9g}"'
    turn = (0, math.atan2(flat, z), math.atan2(y, x))  # a URDF cylinder stands on z
    return [
        _visual(cylinder, (x / 2, y / 2, z / 2), color, turn),
        sphere(radius, (0, 0, 0), color),
        sphere(radius, end, color),
    ]


def joint(name: str, parent: str, child: str, xyz=(0, 0, 0), axis=None, limits=()) -> str:
    """What hangs `child` on `parent` at xyz: free in the world, else fixed or about an axis.

    Args:
        axis: (3,) that it turns about; None: it is fixed.
        limits: lower and upper angle, N m, rad/s.
    """
    kind = "floating" if parent == "world" else "fixed" if axis is None else "revolute"
    rest = ""
    if axis is not None:
        low, high, effort, speed = limits
        rest = (
            f'<axis xyz="{numbers(axis)}"/><limit lower="{low:.6g}" upper="{high:.6g}" '
            f'effort="{effort:.6g}" velocity="{speed:.6g}"/>'
        )
    return (
        f'<joint name={quoteattr(name)} type="{kind}"><origin xyz="{numbers(xyz)}"/>'
        f"<parent link={quoteattr(parent)}/><child link={quoteattr(child)}/>{rest}</joint>"
    )


def robot(name: str, caption: str, links: dict[str, list[str]], joints: list[str]) -> str:
    """The whole: what is drawn of each link, and the joints, of which the first hangs on "world".

    Args:
        caption: a comment at the top.
    """
    text = ["<?xml version='1.0'?>", f"<!--\n{caption.replace('--', '- -')}\n-->"]
    text += [f"<robot name={quoteattr(name)}>", '  <link name="world"/>']
    for link, visuals in links.items():
        text.append("\n    ".join([f"  <link name={quoteattr(link)}>", *visuals]) + "\n  </link>")
    return "\n".join([*text, *(f"  {line}" for line in joints), "</robot>"])
