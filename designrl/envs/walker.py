"""BipedalWalker with learnable legs: Gymnasium's walker on legs of any size."""

from collections.abc import Mapping
from functools import reduce
from operator import add

import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from gymnasium.vector import VectorEnv

from designrl.bodies.walker import WALKER
from designrl.envs.inputs import HasDesign
from designrl.envs.tasks import (
    FLAT,
    checked_weights,
    is_closest_lidar,
    leg_area_reward_factor,
)
from designrl.envs.vector import EngineVectorEnv
from designrl.errors import optional

try:
    from Box2D import b2FixtureDef, b2PolygonShape, b2RayCastCallback, b2World
    from gymnasium.envs.box2d.bipedal_walker import (
        HULL_FD,
        LEG_DOWN,
        MOTORS_TORQUE,
        SCALE,
        TERRAIN_HEIGHT,
        BipedalWalker,
    )
except ImportError:  # `VectorWalker` needs none of it, and `Walker` says so
    b2RayCastCallback = b2World = BipedalWalker = object  # noqa: N816

REWARD_TERMS = FLAT.reward_terms


def walker_spaces() -> tuple[spaces.Box, spaces.Box]:
    """Of observations and of actions."""
    high = np.full(len(WALKER.observations), np.inf, dtype=np.float32)
    low = -high
    bounded = [i for i, n in enumerate(WALKER.observations) if "lidar" in n or "contact" in n]
    low[bounded], high[bounded] = 0.0, 1.0
    return spaces.Box(low, high), spaces.Box(-1.0, 1.0, (len(WALKER.joints),), np.float32)


class _FirstHit(b2RayCastCallback):
    """The LIDAR of 2018: the first ground fixture that Box2D reports ends the ray."""

    def ReportFixture(self, fixture, point, normal, fraction):  # noqa: N802 (Box2D's name)
        if not fixture.filterData.categoryBits & 1:
            return 1.0  # the walker's own body: go on, the ray keeps its length
        self.point, self.fraction = point, fraction
        return 0.0


class _World(b2World):
    """Answers the requests of Gymnasium's reset() with the parts of another body.

    Gymnasium asks for the hull, then per leg for its top, the hip, its bottom and the knee. Only
    sizes and places are replaced; materials, motors and joint limits stay as asked for.
    """

    def __init__(self, scales: np.ndarray, first_hit: bool):
        super().__init__()
        w1, h1, w2, h2, w3, h3, w4, h4 = (WALKER.design.dimensions(scales) / SCALE).tolist()
        self._hull_y = y = TERRAIN_HEIGHT + max(h1 + h2, h3 + h4)  # m
        self._parts = [  # width, height, y of the centre, all in m; popped from the end
            (w4, h4, y - h3 - h4 / 2 - LEG_DOWN),
            (w3, h3, y - h3 / 2 - LEG_DOWN),
            (w2, h2, y - h1 - h2 / 2 - LEG_DOWN),
            (w1, h1, y - h1 / 2 - LEG_DOWN),
        ]
        self._height: dict = {}  # of the bodies made so far, m
        self._first_hit = _FirstHit() if first_hit else None

    def CreateDynamicBody(self, *, position, fixtures, **kwargs):  # noqa: N802 (Box2D's name)
        if fixtures is HULL_FD:
            position = (position[0], self._hull_y)
            return super().CreateDynamicBody(position=position, fixtures=fixtures, **kwargs)
        width, height, y = self._parts.pop()
        resized = b2FixtureDef(
            shape=b2PolygonShape(box=(width / 2, height / 2)),
            density=fixtures.density,
            friction=fixtures.friction,
            restitution=fixtures.restitution,
            categoryBits=fixtures.categoryBits,
            maskBits=fixtures.maskBits,
        )
        body = super().CreateDynamicBody(position=(position[0], y), fixtures=resized, **kwargs)
        self._height[body] = height
        return body

    def CreateJoint(self, definition):  # noqa: N802 (Box2D's name)
        if definition.bodyA in self._height:  # a knee; a hip stays where it is on the hull
            definition.localAnchorA = (0, -self._height[definition.bodyA] / 2)
        definition.localAnchorB = (0, self._height[definition.bodyB] / 2)
        return super().CreateJoint(definition)

    def RayCast(self, callback, p1, p2):  # noqa: N802 (Box2D's name)
        if self._first_hit is None:
            return super().RayCast(callback, p1, p2)
        hit = self._first_hit
        hit.fraction = None
        super().RayCast(hit, p1, p2)
        if hit.fraction is not None:
            callback.p2, callback.fraction = hit.point, hit.fraction
        return None


class Walker(HasDesign, BipedalWalker):
    """A two-legged walker over random terrain, with legs of a given design.

    ## Description
    The tasks BipedalWalker-v2 and BipedalWalkerHardcore-v2 of 2018 with the altered body of the
    paper (section 4). Terrain, physics (Box2D), rewards and rendering are those of Gymnasium's
    `BipedalWalker-v3`, on which this class builds; the legs and the LIDAR are its own. Every reset
    makes a new Box2D world, so an episode depends on its seed, design and actions alone. 50 steps
    are one second of simulated time.

    ## Action space
    `Box(-1, 1, (4,), float32)`: hip 1, knee 1, hip 2, knee 2. The sign is the direction of the
    motor (4 rad/s at the hips, 6 rad/s at the knees), the size its torque in units of 80 N m;
    beyond [-1, 1] it is clipped.

    ## Observation space
    `Box((24,), float32)`. Leg 1 is created first (and drawn behind leg 2).

    | index   | observation                    | range     | unit                                |
    |---------|--------------------------------|-----------|-------------------------------------|
    | 0       | hull angle                     | unbounded | rad                                 |
    | 1       | hull angular velocity          | unbounded | 25 rad/s (velocity · 2 / 50)        |
    | 2       | horizontal speed of the hull   | unbounded | 8.33 m/s (velocity · 0.3 · 20 / 50) |
    | 3       | vertical speed of the hull     | unbounded | 12.5 m/s (velocity · 0.3 · 13.3/50) |
    | 4, 9    | hip angle of leg 1, 2          | unbounded | rad, from the leg's start tilt; the |
    |         |                                |           | limits -0.8 and 1.1 are soft        |
    | 5, 10   | hip speed of leg 1, 2          | unbounded | 4 rad/s (the motor's speed)         |
    | 6, 11   | knee angle + 1 of leg 1, 2     | unbounded | rad; soft limits -0.6 and 0.9       |
    | 7, 12   | knee speed of leg 1, 2         | unbounded | 6 rad/s (the motor's speed)         |
    | 8, 13   | lower part touches the ground  | 0 or 1    |                                     |
    | 14 - 23 | LIDAR: distance from the hull's| [0, 1]    | 5.33 m; ray i points 0.15·i rad     |
    |         | centre along ten rays          |           | ahead of straight down              |

    Source: Gymnasium 1.4 `bipedal_walker.py`; unbounded where impulses exceed any nominal range.

    ## Rewards
    `info["reward_terms"]` has each term of the step; their sum is the reward.

    | term     | value per step                                         | unit and source       |
    |----------|--------------------------------------------------------|-----------------------|
    | progress | 130 / 30 · (x - x of the step before)                  | points, x in m; the   |
    |          |                                                        | whole course gives    |
    |          |                                                        | 364 (Gymnasium)       |
    | posture  | -5 · (|hull angle| - |hull angle of the step before|)  | points, angle in rad  |
    | energy   | -0.028 · sum of min(|action|, 1)                       | points (v2: "count    |
    |          |                                                        | energy spent")        |
    | fall     | -100 where the hull touches the ground or passes the   | points; replaces all  |
    |          | left end                                               | other terms           |
    | leg_area | (progress + posture + energy) · ln(original leg area / | only with             |
    |          | leg area)                                              | `leg_area_reward`     |
    |          |                                                        | (paper, section 4.2)  |

    ## Start
    The hull stands at terrain height + the longer leg's height, 4.67 m from the left end, legs
    tilted by ∓0.05 rad, pushed sideways by a random force of up to 5 N during the first step.
    Reset takes that step, with zero action, so the first observation is one step old.

    ## End of episode
    Terminated when the hull touches the ground, x < 0, or x > 88.67 m (the course is done).
    Truncated by the registered time limit: 1600 steps, hardcore 2000.

    ## Arguments
    - `design`: (8,) scales between the bounds, in the order of
      `designrl.bodies.walker.WALKER.design.names`; None is the original body.
      `reset(options={"design": scales})` changes it from then on.
    - `design_bounds`: the lowest and the highest scale, two numbers or two of (8,); None is
      [0.25, 1.75], the paper's.
    - `lidar`: "v2", the task of the paper: a ray stops at the first ground fixture that Box2D
      reports, which is not always the closest one. "v3": at the closest, as in Gymnasium.
    - `leg_area_reward`: multiply the rewards, except that of a fall, by 1 + ln(original leg area /
      leg area).
    - `reward_weights`: factors of the terms, by name: {"energy": 2.0, "fall": 0.5}. Then the reward
      is the sum of the weighted terms, which `info` has, in the order of the table; `leg_area` is
      that of the weighted ones before it, times its own weight.
    - `hardcore`, `render_mode` ("human", "rgb_array"): as in Gymnasium.

    Raises:
        InputError (a ValueError): a design of wrong length, not finite or out of bounds; an
            unknown `lidar`; an unknown reward term; unknown reset options; an action that is not
            four finite numbers; a seed that is no whole number from 0 on.

    ## Version history
    - v0: the 2018 task on Gymnasium 1.4 and box2d-py 2.3.8.
    """

    body = WALKER

    def __init__(
        self,
        design=None,
        lidar: str = "v2",
        leg_area_reward: bool = False,
        hardcore: bool = False,
        design_bounds: tuple | None = None,
        reward_weights: Mapping[str, float] | None = None,
        render_mode: str | None = None,
    ):
        with optional("single walkers", "reference"):
            import Box2D  # noqa: F401
        self.reward_weights = checked_weights(reward_weights, REWARD_TERMS)
        self._closest_hits = is_closest_lidar(lidar)
        super().__init__(render_mode=render_mode, hardcore=hardcore)
        settings = lidar, leg_area_reward, hardcore, design_bounds, self.reward_weights
        EzPickle.__init__(self, design, *settings, render_mode)
        self.leg_area_reward = leg_area_reward
        self._set_design(design, design_bounds)

        self.observation_space, self.action_space = walker_spaces()

    def _start_episode(self) -> np.ndarray:
        self._reward_factor = float(leg_area_reward_factor(self.design))
        # The old world goes as a whole: a world that is used again keeps the order in which its
        # free list hands out contacts and tree nodes, and with it another rounding.
        self.terrain = []
        self.world = _World(self.design, first_hit=not self._closest_hits)
        self._x = self._tilt = 0.0
        return BipedalWalker.reset(self)[0]

    def _advance(self, action: np.ndarray):
        observation, reward, terminated, truncated, info = BipedalWalker.step(self, action)
        x, tilt = self.hull.position[0], abs(self.hull.angle)
        terms = dict.fromkeys(REWARD_TERMS[:-1], 0.0)
        leg_area, fell = 0.0, self.game_over or x < 0
        if fell:
            terms["fall"] = float(reward)
        else:
            terms["progress"] = 130 / SCALE * (x - self._x)
            terms["posture"] = -5.0 * (tilt - self._tilt)
            # Not sum(): from Python 3.12 on it rounds otherwise.
            work = reduce(add, (min(abs(a), 1.0) for a in action))
            terms["energy"] = -0.00035 * MOTORS_TORQUE * work
        if weights := self.reward_weights:
            reward = self._weigh(terms)
        if self.leg_area_reward and not fell:
            leg_area = reward * (self._reward_factor - 1.0)
            if weights:
                leg_area *= weights.get("leg_area", 1.0)
                reward += leg_area
            else:
                reward *= self._reward_factor
        self._x, self._tilt = x, tilt
        info["reward_terms"] = {**terms, "leg_area": leg_area}
        return observation, float(reward), terminated, truncated, info


# VectorEnv is named for libraries that look at a class's own bases only (skrl).
class VectorWalker(EngineVectorEnv, VectorEnv):
    """Many walkers in the compiled engine, with the arguments of `Walker` and `EngineVectorEnv`."""

    def __init__(
        self,
        num_envs: int = 1,
        lidar: str = "v2",
        leg_area_reward: bool = False,
        hardcore: bool = False,
        reward_weights: Mapping[str, float] | None = None,
        **kwargs,
    ):
        choice = {"hardcore": hardcore, "lidar": lidar, "leg_area_reward": leg_area_reward}
        choice["reward_weights"] = reward_weights
        super().__init__(FLAT, choice, num_envs, WALKER, walker_spaces(), **kwargs)
