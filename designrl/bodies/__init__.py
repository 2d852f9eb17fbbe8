"""Bodies: everything known of a kind of body, behind one record.

A module here holds one body: its design space, parts, joints and observations, its look as a URDF
robot, and how its state is read from an environment. An environment class names its record in the
attribute `body`; recordings and the viewer ask the record and nothing else. A further body is a
subclass of `Body` in a module of its own.

Everything is in m, rad, N m and s, with x forward, y left, z up.
"""

import numpy as np

from designrl.design import DesignSpace

GROUND_COLOR = (112, 184, 96)
OBSTACLE_COLOR = (190, 190, 190)
SKY_COLOR = (215, 215, 255)  # Gymnasium's
ORIGINAL_COLOR = (150, 150, 150)  # of an original body beside a learned one
ORIGINAL_AT = (-2.5, 0.0, 0.0)  # m: there it stands, seen from the learned one
GROUND_HALF_WIDTH = 0.6  # m; the ground of a two-dimensional world is drawn this wide

# Positions (n, 3) in m and rotations (n, 4), quaternions x, y, z, w, of n parts.
Poses = tuple[np.ndarray, np.ndarray]
# Where the eye is and what it looks at, in m.
Eye = tuple[tuple[float, float, float], tuple[float, float, float]]


class Body:
    """One kind of body. What has a default here may be left out.

    Attributes:
        name: what to call it ("walker").
        design: its dimensions.
        tree: part -> the part that it hangs on, the root first, which hangs on "world".
        joints, observations, contact_names: names of what is recorded per step; an action has the
            names of the joints.
        time_step: s of simulated time per step.
        rest_pose: joint -> rad, how it stands where only its design is drawn; joints that are not
            named are in mid-range.
        rollout_eye: seen from the body's root, how a rollout is looked at.
        design_eye: how a design is looked at, whose root is at 0, with the original body at
            ORIGINAL_AT.
        action_seconds: s of its actions that a replay shows at once.
        limbs: limb -> indices of its dimensions; each limb gets a plot of its own.
    """

    name: str
    design: DesignSpace
    tree: dict[str, str]
    joints: tuple[str, ...]
    observations: tuple[str, ...]
    contact_names: tuple[str, ...] = ()
    time_step: float
    rest_pose: dict[str, float] = {}
    rollout_eye: Eye = ((-1.5, -2.7, 1.4), (0.1, 0, -0.1))
    action_seconds = 5.0
    design_eye: Eye = ((-1.2, -1.9, 1.9), (-1.2, -0.1, -0.1))

    def __eq__(self, other):  # a copy that comes from another process is the same body
        return type(self) is type(other) and self.name == other.name

    def __hash__(self):
        return hash(self.name)

    @property
    def limbs(self) -> dict[str, list[int]]:
        return {self.name: list(range(self.design.size))}

    def urdf(self, scales: np.ndarray, caption: str = "") -> str:
        """A design of scales (D,) as a URDF robot whose links are the parts.

        A link's frame is where the part hangs on its parent. `caption` becomes a comment at the
        top. `designrl.bodies.urdf` has the blocks to build it of.
        """
        raise NotImplementedError

    # `env` is an environment of this body, unwrapped and reset.

    def poses(self, env) -> Poses:
        """Poses in the world of the parts' frames, in the order of `tree`."""
        raise NotImplementedError

    def joint_states(self, env) -> tuple[list[float], list[float], list[float]] | None:
        """Angle, speed and torque of each joint; None: not recorded."""
        return None

    def contacts(self, env) -> list[bool] | None:
        """Whether each of `contact_names` touches the ground; None: not recorded."""
        return None

    def lidar(self, env) -> np.ndarray | None:
        """(n, 2, 2) start and end of each ray, x and z; None: it has no LIDAR."""
        return None

    def terrain(self, env) -> tuple[np.ndarray, np.ndarray] | None:
        """(n, 2) x and z of the ground's profile; (m, 4) x_min, x_max, z_min, z_max of obstacles.

        None: a flat floor at z = 0.
        """
        return None

    def ending(self, env) -> str:
        """What ended an episode that the environment has terminated, in words. Here: unknown."""
        return "ended by its environment"

    def picture(self, env) -> np.ndarray:
        """(H, W, 3) uint8: the body from near by, as videos show it; H and W are even.

        `env` has the render mode "rgb_array". Here: what it renders.
        """
        return env.render()

    def ground_near(self, env, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) points of the ground around a place (3,), (n, 3) uint8 their colors.

        Stock viewers, which know of no terrain, draw these. Here: a grid on a flat floor.
        """
        middle = np.round(position[:2])
        fine, coarse = np.arange(-3.0, 3.001, 0.1), np.arange(-3.0, 3.001, 1.0)
        x, y = (
            np.concatenate([a.ravel() for a in pair])
            for pair in zip(np.meshgrid(fine, coarse), np.meshgrid(coarse, fine), strict=True)
        )
        points = np.stack([x + middle[0], y + middle[1], np.zeros_like(x)], axis=1)
        return points, np.tile(np.array(GROUND_COLOR, np.uint8), (len(points), 1))


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The vectors v (..., 3) turned by the unit quaternions q (..., 4)."""
    u = q[..., :3]
    return v + 2.0 * _cross(u, _cross(u, v) + q[..., 3:] * v)


def relative(parents: Poses, children: Poses) -> Poses:
    """Each child's pose as its parent sees it; both are given in the world."""
    (p, q), (r, s) = parents, children
    inverse = q * (-1, -1, -1, 1)
    return rotate(inverse, r - p), multiply(inverse, s)


def multiply(q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """The quaternions (..., 4) that turn by r, then by q."""
    a, b, x, y = q[..., :3], r[..., :3], q[..., 3:], r[..., 3:]
    vector = x * b + y * a + _cross(a, b)
    scalar = x * y - (a * b).sum(axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    # np.cross takes five times as long on arrays this small.
    (x, y, z), (u, v, w) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
