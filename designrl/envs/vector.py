"""Vector environments whose steps run in the compiled engine.

    envs = gymnasium.make_vec("designrl/BipedalWalker-v0", num_envs=64, design=scales)

`designrl.envs.walker` and `designrl.envs.ant` have them beside the single environments that they
give the bits of.
"""

import operator
import secrets
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from numbers import Integral

import gymnasium
import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from designrl.bodies import Body
from designrl.engine import Task, missing_reason
from designrl.engine.stepper import DISABLED, NEXT_STEP, SAME_STEP, Stepper
from designrl.envs.inputs import checked_options
from designrl.errors import InputError

NO_LIMIT = 2**63 - 1  # steps
_MODES = {
    AutoresetMode.DISABLED: DISABLED,
    AutoresetMode.NEXT_STEP: NEXT_STEP,
    AutoresetMode.SAME_STEP: SAME_STEP,
}


def no_engine(reason: str) -> InputError:
    """To be raised where the engine cannot run."""
    return InputError(f'{reason}; vectorization_mode="sync" runs single ones, of one design')


def _count(name: str, value) -> int:
    with suppress(TypeError):
        if (count := operator.index(value)) > 0:
            return count
    raise InputError(f"{name} is {value!r}; it must be a whole number from 1 on")


class EngineVectorEnv(VectorEnv):
    """N environments of one kind, side by side in the compiled engine.

    Every output has the bits of `gymnasium.vector.SyncVectorEnv` over N single environments:
    observations, rewards, ends of episodes, and infos with their masks. Arrays that it returns are
    the caller's own, as SyncVectorEnv's copies are. It does not render.

    Args of `gymnasium.make_vec`, besides those of the single environment:
        num_envs: N.
        design: (D,) scales of all bodies, or (N, D) of each.
        threads: operating system threads; None: one per processor. Results do not depend on it.
        autoreset_mode: a `gymnasium.vector.AutoresetMode`, or its name.
        max_episode_steps: another time limit; -1: none.

    `reset(seed=, options=)` takes one seed (environment i gets seed + i) or a list; and the options
    "design", (D,) or (N, D), which holds from then on, and "reset_mask", (N,) bool, which
    environments are reset and get their design (the others stay in their episodes).

    Attributes:
        design: (N, D) scales of the bodies; a copy.
        np_random_seed: tuple of each environment's latest seed.

    Raises:
        InputError (a ValueError): what a single environment refuses, naming the environment; wrong
            shapes; actions that are not finite; no engine here; an episode beyond the engine's
            capacities, of which nothing is returned.
        gymnasium.error.ResetNeeded: a step before the first reset.
        gymnasium.error.ClosedEnvironmentError: after close().
    """

    def __init__(
        self,
        task: Task,
        num_envs: int,
        body: Body,
        spaces: tuple[gymnasium.Space, gymnasium.Space],
        reward_terms: tuple[str, ...],
        reward_factor: Callable[[np.ndarray], np.ndarray] | None = None,
        design=None,
        threads: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: None = None,
    ):
        if reason := missing_reason():
            raise no_engine(reason)
        if render_mode is not None:
            raise InputError('the engine does not render; vectorization_mode="sync" does')
        num_envs = _count("num_envs", num_envs)
        threads = None if threads is None else _count("threads", threads)
        limit = task.max_steps
        limit = NO_LIMIT if limit == -1 else _count("max_episode_steps", limit)
        self.num_envs = num_envs
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode(autoreset_mode)}
        self.single_observation_space, self.single_action_space = spaces
        self.observation_space, self.action_space = (batch_space(s, num_envs) for s in spaces)
        self._mode = self.metadata["autoreset_mode"]
        self._design_space, self._reward_terms = body.design, reward_terms
        self._design = self._checked_designs(np.ones(body.design.size))
        if design is not None:
            self._design = self._checked_designs(design)
        self._seeds: list[int | None] = [None] * num_envs
        self._ended: np.ndarray | None = None  # (N,) in the last step; None before the first reset
        task = replace(task, max_steps=limit)
        self._stepper = Stepper(task, num_envs, _MODES[self._mode], reward_factor, threads)

    @property
    def design(self) -> np.ndarray:
        return self._design.copy()

    @property
    def np_random_seed(self) -> tuple[int | None, ...]:
        return tuple(self._seeds)

    def reset(self, *, seed: int | list[int | None] | None = None, options: dict | None = None):
        """Start episodes of all environments, or of those in the options' "reset_mask".

        Returns: (N, O) float32 observations and {}.
        """
        if self.closed:
            raise ClosedEnvironmentError("reset() after close()")
        options = checked_options(options, "design", "reset_mask")
        mask = self._checked_mask(options.get("reset_mask"))
        seeds = self._checked_seeds(seed)
        design = self._design
        if options.get("design") is not None:
            changed = self._checked_designs(options["design"])
            design = np.where(mask[:, None], changed, design)
        for i in np.flatnonzero(mask):
            if seeds[i] is None and self._seeds[i] is None:
                seeds[i] = secrets.randbits(64)
        ended, self._ended = self._ended, None  # should it fail, all are to be reset
        observations = self._stepper.reset(design, seeds, mask)
        self._design = design
        self._seeds = [
            old if new is None or not started else new
            for old, new, started in zip(self._seeds, seeds, mask, strict=True)
        ]
        self._ended = ~mask if ended is None else ended & ~mask
        return observations, {}

    def step(self, actions):
        """One step of every environment; after an episode's end, what the autoreset mode says.

        Args:
            actions: (N, A).

        Returns:
            observations (N, O) float32, rewards (N,) float64, terminated and truncated (N,) bool,
            and infos: "reward_terms"; with SAME_STEP, "final_obs" and "final_info" of episodes that
            have ended.
        """
        if self.closed:
            raise ClosedEnvironmentError("step() after close()")
        if self._ended is None:
            raise ResetNeeded("step() before reset()")
        if self._mode == AutoresetMode.DISABLED and self._ended.any():
            raise ResetNeeded(
                f"the episode of environment {np.argmax(self._ended)} has ended: reset it (with "
                'options={"reset_mask": ...}), or choose an autoreset_mode'
            )
        actions = self._checked_actions(actions)
        before, self._ended = self._ended, None  # should it fail, all are to be reset
        observations, rewards, terminated, truncated, terms = self._stepper.step(actions)
        ended = terminated | truncated
        infos, live = {}, ~before  # the others were reset
        if self._mode == AutoresetMode.SAME_STEP:
            live = ~ended
            if ended.any():
                infos = self._final_infos(ended, terms)
                terms = np.where(ended, 0.0, terms)
        self._add_terms(infos, terms, live)
        self._ended = ended
        return observations, rewards, terminated, truncated, infos

    def poses(self) -> np.ndarray:
        """(N, parts, 7) where every part of every body is, in the order of its body's `tree`.

        A position in m, then a quaternion x, y, z, w: those of `designrl.bodies.Body.poses`, as
        they are after the last step, or the reset that followed in it.
        """
        if self.closed:
            raise ClosedEnvironmentError("poses() after close()")
        if self._ended is None:
            raise ResetNeeded("poses() before reset()")
        return self._stepper.poses()

    def _add_terms(self, infos: dict, terms: np.ndarray, mask: np.ndarray) -> None:
        """Terms (T, N) of the environments in the mask (N,), as `VectorEnv._add_info` has them."""
        if not mask.any():
            return
        named = {}
        for name, values in zip(self._reward_terms, terms, strict=False):
            named[name], named[f"_{name}"] = values, mask.copy()
        infos["reward_terms"], infos["_reward_terms"] = named, mask

    def _final_infos(self, ended: np.ndarray, terms: np.ndarray) -> dict:
        final_obs = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(ended):
            final_obs[i] = self._stepper.final_observations[i].copy()
        final_info = {}
        self._add_terms(final_info, np.where(ended, terms, 0.0), ended.copy())
        return {
            "final_obs": final_obs,
            "_final_obs": ended.copy(),
            "final_info": final_info,
            "_final_info": ended.copy(),
        }

    def close_extras(self, **kwargs) -> None:
        """Free the engine's memory."""
        self._stepper.close()

    def _checked_actions(self, actions) -> np.ndarray:
        shape = self.num_envs, self._stepper.actions
        try:
            found = np.ascontiguousarray(actions, dtype=np.float64)
        except (TypeError, ValueError):
            found = np.empty(0)
        if found.shape != shape:
            raise InputError(f"actions must be {shape} numbers, one row for each environment")
        if not np.isfinite(found).all():
            i = int(np.argmin(np.isfinite(found).all(axis=1)))
            raise InputError(
                f"environment {i}: an action must be {shape[1]} finite numbers, got {found[i]}"
            )
        return found

    def _checked_designs(self, design) -> np.ndarray:
        """(N, D) scales."""
        space, count = self._design_space, self.num_envs
        try:
            each = np.ndim(design[0]) > 0
        except (TypeError, IndexError, KeyError):
            each = False
        if not each:
            return np.tile(space.validate(design), (count, 1))
        if len(design) != count:
            raise InputError(f"there are {len(design)} designs for {count} environments")
        designs = np.empty((count, space.size))
        for i, scales in enumerate(design):
            try:
                designs[i] = space.validate(scales)
            except InputError as error:
                raise InputError(f"environment {i}: {error}") from None
        return designs

    def _checked_seeds(self, seed) -> list[int | None]:
        count = self.num_envs
        if isinstance(seed, list | tuple | np.ndarray):
            seeds = list(seed)
        else:
            seeds = [seed + i if isinstance(seed, Integral) else seed for i in range(count)]
        if len(seeds) != count:
            raise InputError(f"there are {len(seeds)} seeds for {count} environments")
        for i, found in enumerate(seeds):
            if found is not None and not (isinstance(found, Integral) and 0 <= found < 2**64):
                raise InputError(
                    f"environment {i}: a seed must be a whole number from 0 to 2**64 - 1 or None, "
                    f"got {found!r}"
                )
        return [seed if seed is None else int(seed) for seed in seeds]

    def _checked_mask(self, mask) -> np.ndarray:
        if mask is None:
            return np.ones(self.num_envs, dtype=bool)
        usable = isinstance(mask, np.ndarray) and mask.dtype == bool
        if not usable or mask.shape != (self.num_envs,) or not mask.any():
            raise InputError(
                f"reset_mask must be an array of {self.num_envs} booleans, one of them True"
            )
        if self._ended is None and not mask.all():
            raise ResetNeeded("the first reset must be of all environments, without reset_mask")
        return mask
