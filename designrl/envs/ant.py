"""The four-legged ant with learnable legs: RoboschoolAnt-v1 on PyBullet."""

import contextlib
import ctypes
import math
import os
import sys
import tempfile
from collections.abc import Mapping
from functools import reduce
from operator import add, mul

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from gymnasium.vector import VectorEnv

from designrl.bodies import Poses
from designrl.bodies.ant import (
    ANT,
    ANT_LEGS,
    ANT_PARTS,
    COLORS,
    MOTOR_TORQUE,
    TORSO_HEIGHT,
    leg_capsules,
    mjcf,
)
from designrl.envs import tasks
from designrl.envs.inputs import HasDesign
from designrl.envs.tasks import checked_weights
from designrl.envs.vector import EngineVectorEnv
from designrl.errors import InputError, MissingPartError


def _sum(values) -> float:
    # One after the other: from Python 3.12 on, sum() rounds otherwise.
    return reduce(add, values, 0.0)


def _flush_c() -> None:
    with contextlib.suppress(OSError, TypeError):
        ctypes.CDLL(None).fflush(None)  # all of C's own buffers


@contextlib.contextmanager
def _silence():
    """Keep what PyBullet prints when it is loaded, its build time, off the terminal."""
    try:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        saved = os.dup(1), os.dup(2)
    except (AttributeError, OSError, ValueError):  # no streams: there is nothing to print to
        yield
        return
    _flush_c()
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 1)
        os.dup2(sink, 2)
        yield
    finally:
        _flush_c()  # while it still goes nowhere
        for stream, copy in zip((1, 2), saved, strict=True):
            os.dup2(copy, stream)
            os.close(copy)
        os.close(sink)


try:
    with _silence():
        import pybullet
except ImportError:  # `VectorAnt` needs none, and `Ant` says so
    pybullet = None

REWARD_TERMS = tasks.ANT.reward_terms

# The world of RoboschoolAnt-v1 (gym_forward_walker.py, scene_stadium.py, physics-bullet.cpp).
GRAVITY = 9.8  # m/s²
SUBSTEPS = 4  # of Bullet, per step
SOLVER_ITERATIONS = 5
CONTACT_ERP = 0.9  # share of a penetration that is taken back per substep
FLOOR_FRICTION = 0.8
# Bullet of 2017 gave every body read from MJCF a restitution of 0.5, had no speed below which
# nothing bounces, and a friction pyramid; PyBullet's defaults today are 0, 0.2 m/s and the cone.
RESTITUTION = 0.5
RESTITUTION_SPEED = 0.0  # m/s
START_ANGLE = 0.1  # rad; joints start at U(-0.1, 0.1)
TARGET_X = 1000.0  # m; the target is at (1000, 0)

FALLEN_HEIGHT = 0.26  # m of the torso's centre: its sphere all but scrapes the ground
JOINT_LIMIT = 0.99  # share of a joint's range from its middle beyond which it counts as stuck
SPEED_SCALE = 0.3  # per m/s, observed velocity
JOINT_SPEED_SCALE = 0.1  # per rad/s, observed joint speed
OBSERVATION_LIMIT = 5.0

ELECTRICITY_COST = -2.0
STALL_COST = -0.1
JOINT_LIMIT_COST = -0.2
FOOT_COLLISION_COST = -1.0

_MAX_CLIENTS = 1024  # PyBullet's MAX_PHYSICS_CLIENTS

_PICTURE_SIZE = 640, 480  # pixels


def ant_spaces() -> tuple[spaces.Box, spaces.Box]:
    """Of observations and of actions."""
    high = np.full(len(ANT.observations), OBSERVATION_LIMIT, dtype=np.float32)
    high[1:3], high[6:8] = 1.0, np.pi
    low = -high
    high[-len(ANT.contact_names) :], low[-len(ANT.contact_names) :] = 1.0, 0.0
    return spaces.Box(low, high), spaces.Box(-1.0, 1.0, (len(ANT.joints),), np.float32)


class Ant(HasDesign, gymnasium.Env):
    """A four-legged ant that walks forward, with legs of a given design.

    ## Description
    The task RoboschoolAnt-v1 with the altered body of the paper (section 4): each of the four legs
    has three capsules, of which the top one is fixed to the torso, a sphere of radius 0.25 m; a hip
    turns the middle part about the vertical, an ankle raises and lowers the bottom part. The design
    scales the capsules' ends and radii; density (1000 kg/m³), motors and joint ranges stay.

    The physics is Bullet, through PyBullet, set to what Roboschool ran in 2018. An episode depends
    on its seed, design and actions alone. Every environment has a Bullet world of its own (about
    30 MB; a process can have 1024). One step is 0.0165 s: 4 substeps with 5 solver iterations.

    **Fidelity.** From equal starts and with equal actions, this environment and Roboschool 1.0.49
    (its last release, on Bullet 2.87) agree to 1e-5 until several contacts act in one substep; from
    there on Roboschool does not repeat itself any better, since the order of its contacts varies
    from run to run. Three settings of that Bullet are not PyBullet's: a restitution of 0.5 of body
    and floor (what its MJCF reader gave to everything), at any speed, and pyramidal friction.
    Without the restitution, the author's learned ant scores 5905 instead of 5781 (400 episodes);
    the original one changes by 5 points. Contacts are taken in a fixed order here (Bullet's
    `deterministicOverlappingPairs`), for episodes that repeat to the bit. What Bullet does not read
    in the ant's MJCF file, then as now: density 5 (it takes 1000 kg/m³), the joints' armature and
    damping. A capsule's inertia is that of a box around it, 0.04 m larger to every side.

    ## Action space
    `Box(-1, 1, (8,), float32)`: torque of each joint in units of 250 N m, in the order of
    `ANT.joints`: hip and ankle of the front left, front right, back left and back right leg. The
    torque is clipped at ±1; the costs of electricity and stall are not.

    ## Observation space
    `Box((28,), float32)`, everything clipped to [-5, 5]; names in `ANT.observations`.

    | index      | observation                                      | range   | unit               |
    |------------|--------------------------------------------------|---------|--------------------|
    | 0          | height of the torso's centre above its start     | [-5, 5] | m                  |
    | 1, 2       | sine and cosine of the angle from the heading    | [-1, 1] | 1                  |
    |            | (yaw) to the target at x = 1000 m, y = 0         |         |                    |
    | 3, 4, 5    | velocity of the torso: along the heading, to its | [-5, 5] | 1 / 0.3 m/s        |
    |            | left, up                                         |         |                    |
    | 6, 7       | roll, pitch of the torso                         | [-π, π] | rad                |
    | 8, 10 … 22 | position of each joint: -1 and 1 at its limits   | [-5, 5] | half its range     |
    |            | (hips ±40°, ankles 30° to 100°, on the front     |         |                    |
    |            | right and back left leg -100° to -30°)           |         |                    |
    | 9, 11 … 23 | speed of each joint                              | [-5, 5] | 10 rad/s           |
    | 24 - 27    | foot touched the ground in the previous step     | 0 or 1  |                    |

    The angle is seen, and the distance below measured, from the mean position of Bullet's 20 links
    (three parts and two joints per leg) in the plane, as it was one substep ago. Source:
    Roboschool, `gym_forward_walker.py`, `calc_state`.

    ## Rewards
    `info["reward_terms"]` has each term of the step; their sum is the reward. θ̇ is a joint's speed
    in rad/s, a the action; the mean is over the 8 joints.

    | term           | value per step                           | unit and source                  |
    |----------------|------------------------------------------|----------------------------------|
    | alive          | 1; -1 where the torso is at z ≤ 0.26 m   | points (`gym_mujoco_walkers.py`) |
    | progress       | decrease of the distance to the target   | points; distance in m: one point |
    |                | / 0.0165                                 | per m/s                          |
    | electricity    | -2.0 · mean of |a · 0.1 θ̇|               | points                           |
    | stall          | -0.1 · mean of a²                        | points                           |
    | joint_limits   | -0.2 per joint beyond 99 % of its range  | points (-0.1 before Roboschool   |
    |                | to either side                           | 1.1 and in PyBullet's ant)       |
    | foot_collision | -1.0 per foot that touches anything but  | points; always 0, here as in     |
    |                | the floor                                | Roboschool: the ant's parts pass |
    |                |                                          | through each other               |

    Source: Roboschool, `gym_forward_walker.py`, `_step`, on which the paper's section 4 builds.

    ## Start
    The torso's centre at (0, 0, 0.75) m, level, all at rest; each joint at a random angle of
    U(-0.1, 0.1) rad. The ankles are then outside of their range, which swings the feet down.

    ## End of episode
    Terminated when the torso's centre is at z ≤ 0.26 m.
    Truncated by the registered time limit: 1000 steps.

    ## Arguments
    - `design`: (36,) scales between the bounds, in the order of
      `designrl.bodies.ant.ANT.design.names`; None is the original body.
      `reset(options={"design": scales})` changes it from then on.
    - `design_bounds`: the lowest and the highest scale, two numbers or two of (36,); None is
      [0.25, 1.75], the paper's.
    - `reward_weights`: factors of the terms, by name: {"progress": 2.0, "stall": 0.0}. `info` has
      the weighted terms; their sum, in the order of the table, is the reward.
    - `render_mode`: "rgb_array" (PyBullet's software renderer, 640 x 480) or None.

    ## Besides Gymnasium
    `body_poses()`, `joint_angles`, `joint_speeds`, `torques`, `foot_contacts` tell the state of the
    last step; `leg_capsules(scales)` is the geometry.

    Raises:
        InputError (a ValueError): a design of wrong length, not finite or out of bounds; an unknown
            render mode; an unknown reward term; unknown reset options; too many environments in one
            process; an action that is not 8 finite numbers; a seed that is no whole number from 0
            on.

    ## Version history
    - v0: the 2018 task on PyBullet 3.2.7.
    """

    body = ANT
    metadata = {"render_modes": ["rgb_array"], "render_fps": 60}

    def __init__(
        self,
        design=None,
        design_bounds: tuple | None = None,
        reward_weights: Mapping[str, float] | None = None,
        render_mode: str | None = None,
    ):
        self._client = -1  # before anything that can fail: close() looks at it
        self.reward_weights = checked_weights(reward_weights, REWARD_TERMS)
        EzPickle.__init__(self, design, design_bounds, self.reward_weights, render_mode)
        if pybullet is None:
            raise MissingPartError(
                "single ants need PyBullet, which is not installed; install designrl[reference] "
                "(from Python 3.12 on pybullet, too; it is compiled), or in a clone run make setup"
            )
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f'render_mode is {render_mode!r}; it must be "rgb_array" or None')
        self.render_mode = render_mode
        self._set_design(design, design_bounds)
        self.observation_space, self.action_space = ant_spaces()
        self._loaded: np.ndarray | None = None  # the design that the Bullet world holds

    # ------------------------------------------------------------------------------- episodes

    def _start_episode(self) -> np.ndarray:
        if self._client < 0:
            self._connect()
        if self._loaded is None or not np.array_equal(self._loaded, self.design):
            self._load()
        else:
            # Empties the contacts' caches too, so that nothing is left of the episode before.
            pybullet.restoreState(self._start, physicsClientId=self._client)
        angles = self.np_random.uniform(-START_ANGLE, START_ANGLE, len(ANT.joints))
        pybullet.resetJointStatesMultiDof(
            self._ant,
            self._joints,
            targetValues=[[angle] for angle in angles.tolist()],
            targetVelocities=[[0.0]] * len(ANT.joints),
            physicsClientId=self._client,
        )
        self.torques = (0.0,) * len(ANT.joints)
        self.foot_contacts = (0.0,) * len(ANT.contact_names)
        return self._observe()

    def _advance(self, action: np.ndarray):
        actions = action.tolist()
        self.torques = tuple([MOTOR_TORQUE * min(max(a, -1.0), 1.0) for a in actions])
        pybullet.setJointMotorControlArray(
            self._ant,
            self._joints,
            pybullet.TORQUE_CONTROL,
            forces=self.torques,
            physicsClientId=self._client,
        )
        pybullet.stepSimulation(physicsClientId=self._client)
        distance = self._distance
        observation = self._observe()
        foot_collisions = self._touch()

        power = _sum(map(abs, map(mul, actions, self.joint_speeds)))
        effort = _sum(map(mul, actions, actions))
        alive = self._height > FALLEN_HEIGHT
        terms = {
            "alive": 1.0 if alive else -1.0,
            "progress": (distance - self._distance) / ANT.time_step,
            "electricity": ELECTRICITY_COST * JOINT_SPEED_SCALE * power / len(ANT.joints),
            "stall": STALL_COST * effort / len(ANT.joints),
            "joint_limits": JOINT_LIMIT_COST * self._joints_at_limit,
            "foot_collision": FOOT_COLLISION_COST * foot_collisions,
        }
        reward = self._weigh(terms) if self.reward_weights else _sum(terms.values())
        return observation, reward, not alive, False, {"reward_terms": terms}

    def _observe(self) -> np.ndarray:
        # Few calls for many numbers, and plain floats: both matter beside 0.1 ms of physics.
        client, ant = self._client, self._ant
        states = pybullet.getJointStates(ant, self._joints, physicsClientId=client)
        links = pybullet.getLinkStates(ant, self._mean_links, physicsClientId=client)
        (_, _, z), orientation = pybullet.getBasePositionAndOrientation(ant, physicsClientId=client)
        (vx, vy, vz), _ = pybullet.getBaseVelocity(ant, physicsClientId=client)
        roll, pitch, yaw = pybullet.getEulerFromQuaternion(orientation)

        # The mean position of Bullet's 20 links, which the torso is not one of. A leg has five: the
        # top part and the hip, fixed to the torso; the middle part; the ankle; the bottom part. Hip
        # and ankle are the ends of the middle part, so a leg's sum is top + 3 middle + bottom. The
        # tops follow from the first of them. (Not from the torso: Bullet's links are where they
        # were a substep ago, the torso is not.)
        (x, y, _), (i, j, k, w), *_ = links[0]
        others_x, others_y = self._tops
        x = 4 * x + (1 - 2 * (j * j + k * k)) * others_x + 2 * (i * j - k * w) * others_y
        y = 4 * y + 2 * (i * j + k * w) * others_x + (1 - 2 * (i * i + k * k)) * others_y
        for middle, bottom in zip(links[1::2], links[2::2], strict=True):
            (middle_x, middle_y, _), (bottom_x, bottom_y, _) = middle[0], bottom[0]
            x += 3 * middle_x + bottom_x
            y += 3 * middle_y + bottom_y
        ahead, aside = TARGET_X - x / 20, y / 20
        self._distance = math.hypot(ahead, aside)
        self._height = z
        angle = math.atan2(-aside, ahead) - yaw
        cosine, sine = math.cos(yaw), math.sin(yaw)
        values = [
            z - TORSO_HEIGHT,
            math.sin(angle),
            math.cos(angle),
            SPEED_SCALE * (cosine * vx + sine * vy),
            SPEED_SCALE * (cosine * vy - sine * vx),
            SPEED_SCALE * vz,
            roll,
            pitch,
        ]
        self.joint_angles, self.joint_speeds, _, _ = zip(*states, strict=True)
        at_limit = 0
        for angle, speed, (middle, scale) in zip(
            self.joint_angles, self.joint_speeds, self._ranges, strict=True
        ):
            position = (angle - middle) * scale
            if not -JOINT_LIMIT <= position <= JOINT_LIMIT:
                at_limit += 1
            values += position, JOINT_SPEED_SCALE * speed
        self._joints_at_limit = at_limit
        values += self.foot_contacts
        observation = np.array(values, dtype=np.float32)
        np.maximum(observation, -OBSERVATION_LIMIT, out=observation)
        return np.minimum(observation, OBSERVATION_LIMIT, out=observation)

    def _touch(self) -> int:
        # Notes which feet touch the floor; returns how many touch anything else.
        floored, collided = set(), set()
        for contact in pybullet.getContactPoints(self._ant, physicsClientId=self._client):
            if contact[2] == self._floor:
                floored.add(contact[3])
            else:
                collided.update(contact[3:5])
        self.foot_contacts = tuple([1.0 if foot in floored else 0.0 for foot in self._feet])
        return len(collided.intersection(self._feet)) if collided else 0

    # ------------------------------------------------------------------------------ the world

    def _connect(self) -> None:
        with contextlib.suppress(pybullet.error):
            self._client = pybullet.connect(pybullet.DIRECT)
        if self._client < 0:
            raise InputError(
                f"PyBullet has no room for another ant in this process (it holds {_MAX_CLIENTS} "
                "worlds); close() environments that are no longer needed"
            )

    def _load(self) -> None:
        """A fresh world with this design's body, in its pose at the start."""
        c = {"physicsClientId": self._client}
        self._loaded = None
        pybullet.resetSimulation(**c)
        pybullet.setGravity(0.0, 0.0, -GRAVITY, **c)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=ANT.time_step,
            numSubSteps=SUBSTEPS,
            numSolverIterations=SOLVER_ITERATIONS,
            contactERP=CONTACT_ERP,
            enableConeFriction=0,
            restitutionVelocityThreshold=RESTITUTION_SPEED,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,  # it would keep every body ever loaded
            **c,
        )
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=(0, 0, 1), **c)
        self._floor = pybullet.createMultiBody(0, plane, **c)
        pybullet.changeDynamics(
            self._floor, -1, lateralFriction=FLOOR_FRICTION, restitution=RESTITUTION, **c
        )
        self._ant = self._load_mjcf(mjcf(self.design))
        names = []
        self._joints, self._ranges = [], []
        for link in range(pybullet.getNumJoints(self._ant, **c)):
            info = pybullet.getJointInfo(self._ant, link, **c)
            names.append(info[12].decode())
            if info[2] == pybullet.JOINT_REVOLUTE:
                self._joints.append(link)
                self._ranges.append(((info[8] + info[9]) / 2, 2 / (info[9] - info[8])))
        parts = leg_capsules(self.design)
        self._parts = [names.index(part.name) for part in parts]
        self._mean_links = self._parts[:1] + [
            link for part, link in zip(parts, self._parts, strict=True) if part.kind != ANT_PARTS[0]
        ]
        self._feet = tuple([names.index(foot) for foot in ANT.contact_names])
        tops = np.array([part.end for part in parts[:: len(ANT_PARTS)]])[:, :2] / 2
        # m, from the first top part to all of them, summed, as the torso sees it
        self._tops = tuple((tops - tops[0]).sum(axis=0).tolist())
        for link in range(-1, len(names)):
            pybullet.changeDynamics(self._ant, link, restitution=RESTITUTION, **c)
        pybullet.setJointMotorControlArray(  # Bullet's joints come with a motor that holds them
            self._ant, self._joints, pybullet.POSITION_CONTROL, forces=[0.0] * len(ANT.joints), **c
        )
        if self.render_mode:
            kinds = ["torso", *(part.kind for part in parts)]
            for link, kind in zip((-1, *self._parts), kinds, strict=True):
                rgb = (channel / 255 for channel in COLORS[kind])
                pybullet.changeVisualShape(self._ant, link, rgbaColor=(*rgb, 1.0), **c)
        self._start = pybullet.saveState(**c)
        self._loaded = self.design.copy()

    def _load_mjcf(self, text: str) -> int:
        # Bullet reads MJCF from files only.
        flags = pybullet.URDF_USE_SELF_COLLISION
        flags |= pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_ALL_PARENTS
        try:
            with tempfile.NamedTemporaryFile("w", prefix="designrl-ant-", suffix=".xml") as file:
                file.write(text)
                file.flush()
                (ant,) = pybullet.loadMJCF(file.name, flags=flags, physicsClientId=self._client)
            return ant
        except OSError as error:
            raise InputError(
                f"cannot write the ant's body to the temporary folder {tempfile.gettempdir()} "
                f"({error.strerror}); set TMPDIR to one with space"
            ) from None

    def close(self) -> None:
        """End the Bullet world; the next reset makes a new one."""
        if self._client >= 0:
            client, self._client, self._loaded = self._client, -1, None
            self._episode = None
            with contextlib.suppress(pybullet.error):
                pybullet.disconnect(client)

    def __del__(self):
        # At the interpreter's end, modules may be gone before the last environments are.
        with contextlib.suppress(Exception):
            self.close()

    # ------------------------------------------------------------------------ state and pictures

    def body_poses(self) -> Poses:
        """Positions (13, 3) in m and quaternions (13, 4) of the parts, in the order of `ANT.tree`.

        A leg part's position is that of its frame, which sits where it hangs on its parent (see
        `leg_capsules`); the torso's is its centre.
        """
        c = {"physicsClientId": self._client}
        torso = pybullet.getBasePositionAndOrientation(self._ant, **c)
        links = pybullet.getLinkStates(self._ant, self._parts, computeForwardKinematics=1, **c)
        positions, rotations = zip(torso, *(link[4:6] for link in links), strict=True)
        return np.array(positions), np.array(rotations)

    def render(self):
        """(480, 640, 3) uint8: the ant from its right side, on chequers of 1 m."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() needs gymnasium.make(..., render_mode="rgb_array")')
            return None
        c = {"physicsClientId": self._client}
        (x, y, _), _ = pybullet.getBasePositionAndOrientation(self._ant, **c)
        legs = ANT.design.dimensions(self.design).reshape(len(ANT_LEGS), 9)[:, :6].reshape(-1, 3, 2)
        reach = np.hypot(*legs.sum(axis=1).T).max()  # m, of the longest leg, stretched out
        away = 0.7 + 1.1 * reach
        view = pybullet.computeViewMatrix(
            (x + 0.7 * away, y - 1.3 * away, 0.3 + 0.7 * away), (x, y, 0.3), (0, 0, 1)
        )
        width, height = _PICTURE_SIZE
        lens = pybullet.computeProjectionMatrixFOV(45.0, width / height, 0.1, 100.0)
        _, _, pixels, _, _ = pybullet.getCameraImage(
            width,
            height,
            view,
            lens,
            lightDirection=(-1.0, -2.0, 4.0),
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
            **c,
        )
        return np.asarray(pixels, dtype=np.uint8).reshape(height, width, 4)[:, :, :3].copy()


class VectorAnt(EngineVectorEnv, VectorEnv):
    """Many ants in the compiled engine, with the arguments of `Ant` and `EngineVectorEnv`.

    Raises:
        InputError: the engine has not the bits of the PyBullet that is installed.
    """

    def __init__(
        self, num_envs: int = 1, reward_weights: Mapping[str, float] | None = None, **kwargs
    ):
        choice = {"reward_weights": reward_weights}
        super().__init__(tasks.ANT, choice, num_envs, ANT, ant_spaces(), **kwargs)
