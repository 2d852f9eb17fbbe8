"""The environments of this package: one record of each, for Gymnasium and the compiled engine."""

import hashlib
import inspect
import math
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from numbers import Real

import gymnasium
import numpy as np

from designrl import engine
from designrl.bodies.walker import WALKER, leg_area
from designrl.design import DesignSpace
from designrl.engine import Task
from designrl.engine.stepper import DISABLED, Stepper
from designrl.errors import InputError

TRIAL_STEPS = 100
MAX_WEIGHT = 1e6  # of a reward's term; larger ones are slips of the keyboard
# Bodies that `designrl.verify` compares. Of larger ones, a part can touch more pieces of ground at
# once than the engine holds.
ENGINE_SCALES = 0.05, 5.0
# From scales (N, D) to factors (N,) of all rewards but a fall's.
RewardFactor = Callable[[np.ndarray], np.ndarray]


def leg_area_reward_factor(scales: np.ndarray) -> np.ndarray:
    """1 + ln(original leg area / leg area): the reward's factor for smaller legs (section 4.2)."""
    ratio = leg_area(np.ones(WALKER.design.size)) / leg_area(scales)
    # NumPy's own logarithm can have another last bit with AVX-512 than without.
    return 1.0 + np.vectorize(math.log, otypes=[np.float64])(ratio)


def is_closest_lidar(version: str) -> bool:
    """Whether a ray ends at the closest hit ("v3") or at the first that is reported ("v2").

    Raises:
        InputError: neither of the two.
    """
    if version not in ("v2", "v3"):
        raise InputError(f'lidar is {version!r}; it must be "v2" (the paper\'s) or "v3"')
    return version == "v3"


def checked_weights(reward_weights: Mapping | None, terms: tuple[str, ...]) -> dict[str, float]:
    """The weights of a reward's terms that are not 1, in the terms' order.

    Raises:
        InputError: no mapping; a term that there is not; a weight that is no number.
    """
    if not isinstance(reward_weights, Mapping | None):
        raise InputError(
            f"reward_weights is {reward_weights!r}; it must name terms and their weights, as "
            f"{{{terms[0]!r}: 2.0}}"
        )
    found = dict(reward_weights or {})
    for name, weight in found.items():
        if name not in terms:
            raise InputError(f"there is no reward term {name!r}; there are {', '.join(terms)}")
        if not isinstance(weight, Real) or not abs(weight) <= MAX_WEIGHT:  # type: ignore[operator]
            raise InputError(
                f"the weight of {name} is {weight!r}; it must be a number from {-MAX_WEIGHT:g} to "
                f"{MAX_WEIGHT:g}"
            )
    return {name: float(found[name]) for name in terms if found.get(name, 1.0) != 1.0}


Choice = tuple[tuple[str, ...], RewardFactor | None]  # flags of the engine's task, and a factor
EngineTask = tuple[Task, RewardFactor | None]


def _walker(hardcore: bool, lidar: str = "v2", leg_area_reward: bool = False) -> Choice:
    flags = {"hardcore": hardcore, "closest_hits": is_closest_lidar(lidar)}
    factor = leg_area_reward_factor if leg_area_reward else None
    return tuple(name for name, on in flags.items() if on), factor


def _ant() -> Choice:
    return (), None


@dataclass(frozen=True, eq=False)
class World:
    """An environment of this package.

    Attributes:
        env_id: its name in Gymnasium.
        entry_point, vector_entry_point: its class and that of many on the engine, "module:Class".
        task: name of the engine's task.
        max_steps: time limit, that of 2018.
        reward_terms: their names, in the order in which they are added.
        choose: what keywords of its class choose in the engine; with others the engine cannot run.
        kwargs: keywords that hold where nothing else is said.
        on_trial: its bits in the engine hang on what is installed: the ant's on the version of
            Bullet and on the C library's sine. Before the engine is used, it has to show that they
            are the reference's; where it has the portable lanes alone, they are x86-64's, whatever
            is installed. (package, hash): compared with the package's environment where it is
            installed, else with the hash of what that has given elsewhere.
    """

    env_id: str
    entry_point: str
    vector_entry_point: str
    task: str
    max_steps: int
    reward_terms: tuple[str, ...]
    choose: Callable[..., Choice]
    kwargs: dict = field(default_factory=dict)
    on_trial: tuple[str, str] | None = None

    def register(self) -> None:
        """Make it known to Gymnasium."""
        gymnasium.register(
            self.env_id,
            entry_point=self.entry_point,
            vector_entry_point=self.vector_entry_point,
            kwargs=self.kwargs,
            max_episode_steps=self.max_steps,
        )

    def engine_task(
        self, max_episode_steps: int | None = None, reward_weights: Mapping | None = None, **kwargs
    ) -> EngineTask | None:
        """What the compiled engine runs for it with these keywords.

        Returns: the engine's `Task` and the reward's factor, if any; None where the engine has no
            such task.

        Raises:
            InputError: a keyword's value that the environment would refuse.
        """
        kwargs = self.kwargs | kwargs
        kwargs.pop("design_bounds", None)  # `engine_reason` looks at them
        if not kwargs.keys() <= inspect.signature(self.choose).parameters.keys():
            return None
        flags, factor = self.choose(**kwargs)
        limit = self.max_steps if max_episode_steps is None else max_episode_steps
        weights = checked_weights(reward_weights, self.reward_terms)
        every = tuple(weights.get(name, 1.0) for name in self.reward_terms) if weights else ()
        return Task(self.task, flags, limit, every), factor

    def engine_reason(self, space: DesignSpace | None = None) -> str | None:
        """Why the engine cannot run it here, as a clause, or None.

        Args:
            space: the limits of its bodies; None: the paper's.
        """
        reason = engine.missing_reason()
        low, high = ENGINE_SCALES
        if not reason and space and (space.low.min() < low or space.high.max() > high):
            reason = (
                f"the compiled engine is verified for bodies of {low} to {high:g} times the "
                f"original size, not of {space.low.min():.4g} to {space.high.max():.4g} times"
            )
        if reason or not self.on_trial or engine.instruction_sets() == ["portable"]:
            return reason
        return trial(self)


@cache
def trial(world: World) -> str | None:
    """Why the engine's environment is not the reference's here, as a clause; None where it is."""
    # Contacts carry a difference in the last bit of anything into the rewards within a few steps.
    task, _ = world.engine_task()  # type: ignore[misc]  # nothing that the engine lacks was asked
    package, elsewhere = world.on_trial  # type: ignore[misc]  # only such a world has a trial
    rng = np.random.default_rng(0)
    with Stepper(task, 1, DISABLED) as stepper:
        design = rng.uniform(0.75, 1.25, (1, stepper.dimensions))
        actions = rng.uniform(-1.0, 1.0, (TRIAL_STEPS, stepper.actions))
        played = stepper.reset(design, [0]).tobytes()
        for action in actions:
            observation, reward, *_ = stepper.step(action[None])
            played += observation.tobytes() + reward.tobytes()
    if find_spec(package):
        with closing(gymnasium.make(world.env_id, disable_env_checker=True)) as env:
            expected = env.reset(seed=0, options={"design": design[0]})[0].tobytes()
            for action in actions:
                observation, reward, *_ = env.step(action)
                expected += observation.tobytes() + np.float64(reward).tobytes()
        same, here = played == expected, "is installed here"
    else:
        same, here = hashlib.sha256(played).hexdigest() == elsewhere, "is here"
    if same:
        return None
    return (
        f"the compiled engine's {world.env_id} is not the reference's to the bit with what {here} "
        "(it was written for PyBullet 3.2.7 on glibc)"
    )


_WALKERS = "designrl.envs.walker:Walker", "designrl.envs.walker:VectorWalker", "walker"
_WALKER_TERMS = "progress", "posture", "energy", "fall", "leg_area"
FLAT, HARDCORE = (
    World(env_id, *_WALKERS, steps, _WALKER_TERMS, _walker, {"hardcore": hardcore})
    for env_id, steps, hardcore in (
        ("designrl/BipedalWalker-v0", 1600, False),
        ("designrl/BipedalWalkerHardcore-v0", 2000, True),
    )
)
_ANTS = "designrl.envs.ant:Ant", "designrl.envs.ant:VectorAnt", "ant"
_ANT_TERMS = "alive", "progress", "electricity", "stall", "joint_limits", "foot_collision"
_ANT_TRIAL = "pybullet", "4c9e030df25cb2f0073338a679b37cdb7b574d8ac47f2bbda71ba1149b45323a"
ANT = World("designrl/Ant-v0", *_ANTS, 1000, _ANT_TERMS, _ant, on_trial=_ANT_TRIAL)
WORLDS = {world.env_id: world for world in (FLAT, HARDCORE, ANT)}


def engine_task(env_id: str, **kwargs) -> EngineTask | None:
    """`World.engine_task` of an environment; None for one of another package."""
    return WORLDS[env_id].engine_task(**kwargs) if env_id in WORLDS else None


def engine_reason(env_id: str, space: DesignSpace | None = None) -> str | None:
    """`World.engine_reason` of an environment; of another package's, whether there is an engine."""
    return WORLDS[env_id].engine_reason(space) if env_id in WORLDS else engine.missing_reason()
