"""Compares the vector environments with SyncVectorEnv over single ones, in every output.

`python -m designrl.verify` runs it.
"""

from dataclasses import dataclass, field
from functools import partial

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from designrl.bodies.ant import ANT
from designrl.bodies.walker import WALKER
from designrl.envs.tasks import ENGINE_SCALES

ANT_ID, FLAT_ID, HARDCORE_ID = (
    f"designrl/{name}-v0" for name in ("Ant", "BipedalWalker", "BipedalWalkerHardcore")
)
RESET_EVERY = 97  # steps; then some environments are reset, some with seeds, some to other bodies


@dataclass(frozen=True)
class VectorCase:
    """Environments to compare under random actions.

    Attributes:
        env_id: of the environment.
        mode: autoreset mode.
        num_envs: N.
        bodies: "original"; "one" random design for all; "each": N of them; within the bounds of the
            keywords.
        dtype: of the actions.
        kwargs: keywords of the environment.
        seed: of designs, actions, and episodes.
    """

    env_id: str
    mode: AutoresetMode
    num_envs: int = 20
    bodies: str = "each"
    dtype: type = np.float32
    kwargs: dict = field(default_factory=dict)
    seed: int = 0

    @property
    def bounds(self) -> tuple[float, float]:
        """The lowest and the highest scale of its bodies."""
        return self.kwargs.get("design_bounds", (0.25, 1.75))

    def __str__(self) -> str:
        about = " ".join(f"{name}={value}" for name, value in self.kwargs.items())
        name, dtype = self.env_id.split("/")[1], self.dtype.__name__
        return f"{self.num_envs} {name} {self.mode.value} {self.bodies} {dtype} {about}".strip()


NEXT, SAME, DISABLED = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED
SMALL_LEGS = {"leg_area_reward": True, "lidar": "v3"}
WALKER_WEIGHTS = {"progress": 0.3, "posture": -1.7, "energy": 2.9, "fall": 0.7}
ANT_WEIGHTS = {"alive": 0.3, "progress": -1.7, "electricity": 2.9, "stall": 0.0}
VECTOR_CASES = (
    VectorCase(FLAT_ID, NEXT, bodies="original"),
    VectorCase(FLAT_ID, SAME, kwargs={"max_episode_steps": 60}),
    VectorCase(FLAT_ID, DISABLED, 3, "one", np.float64, SMALL_LEGS),
    VectorCase(HARDCORE_ID, NEXT, 70, dtype=np.float64),
    VectorCase(HARDCORE_ID, SAME, kwargs=SMALL_LEGS),
    VectorCase(HARDCORE_ID, NEXT, 1, "one", np.float64, SMALL_LEGS),
    VectorCase(ANT_ID, NEXT, bodies="original", dtype=np.float64),
    VectorCase(ANT_ID, SAME),
    VectorCase(ANT_ID, NEXT, 9, "one", kwargs={"max_episode_steps": 50}),
    VectorCase(ANT_ID, DISABLED, 3, dtype=np.float64),
    VectorCase(FLAT_ID, SAME, kwargs={"design_bounds": (0.25, 4.0)}),
    VectorCase(HARDCORE_ID, NEXT, 9, kwargs={"design_bounds": ENGINE_SCALES, **SMALL_LEGS}),
    VectorCase(ANT_ID, NEXT, kwargs={"design_bounds": (0.25, 4.0)}),
    VectorCase(FLAT_ID, SAME, kwargs={"reward_weights": WALKER_WEIGHTS}),
    VectorCase(
        HARDCORE_ID,
        NEXT,
        kwargs={**SMALL_LEGS, "reward_weights": {**WALKER_WEIGHTS, "leg_area": 1.3}},
    ),
    VectorCase(ANT_ID, SAME, kwargs={"reward_weights": ANT_WEIGHTS}),
)


def compare_vector(case: VectorCase, steps: int) -> str | None:
    """The first difference in `steps` steps of all environments together; None if there is none."""
    rng = np.random.default_rng(case.seed)
    n, size = case.num_envs, (ANT if case.env_id == ANT_ID else WALKER).design.size
    designs = np.ones((n, size))
    if case.bodies != "original":
        designs[:] = rng.uniform(*case.bounds, (n if case.bodies == "each" else 1, size))
    make = partial(gymnasium.make, case.env_id, disable_env_checker=True, **case.kwargs)
    singles = SyncVectorEnv(
        [partial(make, design=design) for design in designs], autoreset_mode=case.mode
    )
    engine = gymnasium.make_vec(
        case.env_id,
        n,
        "vector_entry_point",
        design=designs if case.bodies == "each" else designs[0],
        autoreset_mode=case.mode,
        **case.kwargs,
    )
    try:
        return _compare((singles, engine), case, steps, rng)
    finally:
        singles.close()
        engine.close()


def _compare(envs: tuple[VectorEnv, VectorEnv], case: VectorCase, steps: int, rng) -> str | None:
    n, shape = case.num_envs, envs[0].action_space.shape
    seed = int(rng.integers(2**40))
    first, second = (env.reset(seed=seed) for env in envs)
    ended = np.zeros(n, dtype=bool)
    for step in range(steps // n):
        if found := difference(first, second):
            return f"{case}, step {step}: {found}"
        mask = ended.copy() if case.mode == DISABLED else np.zeros(n, dtype=bool)
        if step % RESET_EVERY == RESET_EVERY - 1:
            mask |= rng.random(n) < 0.3
        if mask.any():
            seeds = [int(s) if s % 2 else None for s in rng.integers(2**63, size=n)]
            options = {}
            if rng.random() < 0.5:
                options["design"] = rng.uniform(*case.bounds, envs[1].design.shape[1])
            first, second = (
                env.reset(seed=seeds, options={**options, "reset_mask": mask}) for env in envs
            )
            if found := difference(first, second):
                return f"{case}, reset before step {step}: {found}"
        # Of several sizes, some beyond the bounds, some nothing at all.
        scale = rng.choice([0.0, 0.3, 1.0, 2.0], (n, 1))
        actions = (scale * rng.uniform(-1, 1, shape)).astype(case.dtype)
        first, second = (env.step(actions) for env in envs)
        ended = first[2] | first[3]
    return difference(first, second)


def difference(one, other, name: str = "output") -> str | None:
    """What differs between two results of a step or reset, in words; None: all bits are equal."""
    if isinstance(one, tuple | list):
        one, other = (dict(enumerate(values)) for values in (one, other))
    if isinstance(one, dict):
        if one.keys() != other.keys():
            return f"{name} has {sorted(one)} in the reference, {sorted(other)} in the engine"
        pairs = ((one[key], other[key], f"{name}[{key!r}]") for key in one)
        return next(filter(None, (difference(*pair) for pair in pairs)), None)
    if one is None or other is None:
        return None if one is other else f"{name}: {one} in the reference, {other} in the engine"
    if (one.dtype, one.shape) != (other.dtype, other.shape):
        return f"{name}: {one.dtype}{one.shape} in the reference, {other.dtype}{other.shape}"
    if one.dtype == object:
        return difference(list(one), list(other), name)
    if one.tobytes() == other.tobytes():
        return None
    differs = [a.tobytes() != b.tobytes() for a, b in zip(one.ravel(), other.ravel(), strict=True)]
    i = int(np.argmax(differs))
    return f"{name}.flat[{i}]: {one.ravel()[i]!r} in the reference, {other.ravel()[i]!r}"
