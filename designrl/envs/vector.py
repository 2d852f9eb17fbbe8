"""Vector environments whose steps run in the compiled engine.

    envs = gymnasium.make_vec("designrl/BipedalWalker-v0", num_envs=64, design=scales)

`designrl.envs.walker` and `designrl.envs.ant` have them beside the single environments that they
give the bits of.
"""

import copy
import operator
import secrets
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import gymnasium
import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from designrl.bodies import Body
from designrl.engine.stepper import DISABLED, NEXT_STEP, SAME_STEP, State, Stepper
from designrl.envs.inputs import checked_options
from designrl.envs.tasks import World
from designrl.errors import InputError
from designrl.numeric import real_numbers, whole_number

NO_LIMIT = 2**63 - 1  # steps
MOST_ENVS = 2**31 - 1  # beyond what any machine has memory for
MAX_SEED = 2**64 - 1
_MODES = {
    AutoresetMode.DISABLED: DISABLED,
    AutoresetMode.NEXT_STEP: NEXT_STEP,
    AutoresetMode.SAME_STEP: SAME_STEP,
}


class EnvironmentState(NamedTuple):
    """One environment of an `EngineVectorEnv` between two steps.

    Attributes:
        engine: the episode, its body and random numbers.
        seed: the latest.
        ended: whether the episode ended in the last step.
    """

    engine: State
    seed: int | None
    ended: bool


class EngineVectorEnv(VectorEnv):
    """N environments of one kind, side by side in the compiled engine.

    Every output has the bits of `gymnasium.vector.SyncVectorEnv` over N single environments:
    observations, rewards, ends of episodes, and infos with their masks. Arrays that it returns are
    the caller's own, as SyncVectorEnv's copies are. It does not render.

    Args of `gymnasium.make_vec`, besides those of the single environment:
        num_envs: N.
        design: (D,) scales of all bodies, or (N, D) of each.
        design_bounds: as of a single environment.
        threads: operating system threads; None: one per processor. Results do not depend on it.
        autoreset_mode: a `gymnasium.vector.AutoresetMode`, or its name.
        max_episode_steps: another time limit; -1: none.
        flat_info: whether infos have each reward term under its own key, as "reward_progress",
            instead of all in a dict "reward_terms".

    `reset(seed=, options=)` takes one seed (environment i gets seed + i) or a list; and the options
    "design", (D,) or (N, D), which holds from then on, and "reset_mask", (N,) bool, which
    environments are reset and get their design (the others stay in their episodes).

    `get_state` and `set_state` save and restore. Copies, by `copy` or by pickle, are environments
    of their own, which go on as these do. Two threads may share one: each call waits for the other.

    Attributes:
        design: (N, D) scales of the bodies; a copy.
        np_random_seed: tuple of each environment's latest seed.
        autoreset_mode: a `gymnasium.vector.AutoresetMode`.
        reward_terms: their names, in the order of the infos.

    Raises:
        InputError (a ValueError): what a single environment refuses, naming the environment; wrong
            shapes; actions that are not finite; no engine here; no memory for so many; an episode
            beyond the engine's capacities, of which nothing is returned.
        gymnasium.error.ResetNeeded: a step before the first reset.
        gymnasium.error.ClosedEnvironmentError: after close().
    """

    _stepper: Stepper | None = None  # until it is made

    def __init__(
        self,
        world: World,
        choice: dict,
        num_envs: int,
        body: Body,
        spaces: tuple[gymnasium.Space, gymnasium.Space],
        max_episode_steps: int = -1,
        design=None,
        design_bounds: tuple | None = None,
        threads: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: None = None,
        flat_info: bool = False,
    ):
        space = body.design.within(design_bounds)
        if reason := world.engine_reason(space):
            raise InputError(
                f'{reason}; vectorization_mode="sync" runs single ones, of one design, without '
                "threads= and with autoreset_mode in vector_kwargs"
            )
        if render_mode is not None:
            raise InputError('the engine does not render; vectorization_mode="sync" does')
        num_envs = whole_number("num_envs", num_envs, 1, MOST_ENVS)
        threads = None if threads is None else whole_number("threads", threads, 1)
        if isinstance(max_episode_steps, int) and max_episode_steps == -1:
            max_episode_steps = NO_LIMIT
        limit = whole_number("max_episode_steps", max_episode_steps, 1, NO_LIMIT)
        task, reward_factor = world.engine_task(limit, **choice)
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            modes = ", ".join(mode.value for mode in AutoresetMode)
            raise InputError(
                f"autoreset_mode is {autoreset_mode!r}; it must be one of {modes}"
            ) from None
        self.num_envs, self.flat_info = num_envs, bool(flat_info)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = spaces
        self._design_space, self.reward_terms = space, world.reward_terms
        try:
            self.observation_space, self.action_space = (batch_space(s, num_envs) for s in spaces)
            original = np.ones(body.design.size)
            self._design = self._checked_designs(original if design is None else design)
            self._seeds: list[int | None] = [None] * num_envs
            self._ended: np.ndarray | None = None  # (N,) in the last step; None: reset comes first
            mode = _MODES[self.autoreset_mode]
            self._stepper = Stepper(task, num_envs, mode, reward_factor, threads)
        except MemoryError:
            raise InputError(f"there is no memory for {num_envs} environments") from None

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
        with self._stepper.turn:
            self._check_open("reset()")
            options = checked_options(options, "design", "reset_mask")
            mask = self._checked_mask(options.get("reset_mask"))
            seeds = self._checked_seeds(seed)
            design = self._design
            if options.get("design") is not None:
                changed = self._checked_designs(options["design"])
                design = np.where(mask[:, None], changed, design)
            known, ended = self._seeds, self._ended
            for i in np.flatnonzero(mask):
                if seeds[i] is None and known[i] is None:
                    seeds[i] = secrets.randbits(64)
            self._forget()
            observations = self._stepper.reset(design, seeds, mask)
            self._design = design
            self._seeds = [
                old if new is None or not started else new
                for old, new, started in zip(known, seeds, mask, strict=True)
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
        with self._stepper.turn:
            self._check_open("step()")
            ended = self._running("step()")
            if self.autoreset_mode == AutoresetMode.DISABLED and ended.any():
                raise ResetNeeded(
                    f"the episode of environment {np.argmax(ended)} has ended: reset it (with "
                    'options={"reset_mask": ...}), or choose an autoreset_mode'
                )
            actions = self._checked_actions(actions)
            live, seeds = ~ended, self._seeds  # the others are reset
            self._forget()
            observations, rewards, terminated, truncated, terms, final = self._stepper.step(actions)
            ended, infos = terminated | truncated, {}
            if self.autoreset_mode == AutoresetMode.SAME_STEP:
                live = ~ended
                if ended.any():
                    infos = self._final_infos(ended, terms, final)
                    terms = np.where(ended, 0.0, terms)
            self._add_terms(infos, terms, live)
            self._seeds, self._ended = seeds, ended
            return observations, rewards, terminated, truncated, infos

    def get_state(self) -> list[EnvironmentState]:
        """The N environments as they are, for `set_state` here or in an environment of this kind.

        120 kB of each walker and 8 kB of each ant are copied, and with them the random numbers of
        the episodes to come. It can be pickled.
        """
        with self._stepper.turn:
            self._check_open("get_state()")
            ended = self._running("get_state()").tolist()
            states = self._stepper.get_states()
            return list(map(EnvironmentState._make, zip(states, self._seeds, ended, strict=True)))

    def set_state(self, state: Sequence[EnvironmentState]) -> None:
        """Go on from N saved environments: what follows has the bits of what followed them.

        They may be in any order, and the same one several times: `[state[3]] * num_envs` is N
        futures of one. Time limit, autoreset mode and reward are this environment's own. What is
        set is believed, as a pickle is: take none from a stranger.

        Raises:
            InputError: another number of states, of another kind of environment, of a body out of
                bounds here, or of another version of this package.
        """
        with self._stepper.turn:
            self._check_open("set_state()")
            known = isinstance(state, list | tuple)
            if not known or not all(isinstance(each, EnvironmentState) for each in state):
                raise InputError("a state is what get_state() of such environments has returned")
            engine, seeds, ended = zip(*state, strict=True) if state else ((), (), ())
            for each in engine:
                if np.shape(each.design) == self._design.shape[1:]:  # or it is of another body
                    self._design_space.validate(each.design)
            before = self._seeds, self._ended
            self._forget()
            try:
                self._stepper.set_states(engine)
            except InputError:
                self._seeds, self._ended = before
                raise
            self._design = self._stepper.designs.copy()
            self._seeds, self._ended = list(seeds), np.array(ended)

    def __copy__(self):
        return copy.deepcopy(self)  # two owners of one memory would not do

    def _check_open(self, call: str) -> None:
        if self.closed:
            raise ClosedEnvironmentError(f"{call} after close()")

    def _running(self, call: str) -> np.ndarray:
        """(N,) which episodes ended in the last step."""
        if self._ended is None:
            raise ResetNeeded(f"{call} before reset()")
        return self._ended

    def _forget(self) -> None:
        # Should what follows fail, or be interrupted, all are to be reset.
        self._seeds, self._ended = [None] * self.num_envs, None

    def poses(self) -> np.ndarray:
        """(N, parts, 7) where every part of every body is, in the order of its body's `tree`.

        A position in m, then a quaternion x, y, z, w: those of `designrl.bodies.Body.poses`, as
        they are after the last step, or the reset that followed in it.
        """
        with self._stepper.turn:
            self._check_open("poses()")
            self._running("poses()")
            return self._stepper.poses()

    def _add_terms(self, infos: dict, terms: np.ndarray, mask: np.ndarray) -> None:
        """Terms (T, N) of the environments in the mask (N,), as `VectorEnv._add_info` has them."""
        if not mask.any():
            return
        named = infos if self.flat_info else {}
        for name, values in zip(self.reward_terms, terms, strict=False):
            name = f"reward_{name}" if self.flat_info else name
            named[name], named[f"_{name}"] = values, mask.copy()
        if not self.flat_info:
            infos["reward_terms"], infos["_reward_terms"] = named, mask

    def _final_infos(self, ended: np.ndarray, terms: np.ndarray, final: np.ndarray) -> dict:
        final_obs = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(ended):
            final_obs[i] = final[i].copy()
        final_info = {}
        self._add_terms(final_info, np.where(ended, terms, 0.0), ended.copy())
        return {
            "final_obs": final_obs,
            "_final_obs": ended.copy(),
            "final_info": final_info,
            "_final_info": ended.copy(),
        }

    def close_extras(self, **kwargs) -> None:
        """Free the engine's memory, after a call that is under way."""
        self.closed = True
        if self._stepper:
            self._stepper.close()

    def _checked_actions(self, actions) -> np.ndarray:
        shape = self.num_envs, self._stepper.actions
        try:
            found = real_numbers(actions)
        except ValueError:
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
        except (TypeError, ValueError, IndexError, KeyError):
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
        with suppress(TypeError):
            seed = range(first := operator.index(seed), first + count)
        if seed is None:
            return [None] * count
        if isinstance(seed, np.ndarray) and seed.ndim > 0:
            seed = list(seed)
        if not isinstance(seed, list | tuple | range):
            raise InputError(f"a seed must be a whole number, or a list of {count}, got {seed!r}")
        if len(seed) != count:
            raise InputError(f"there are {len(seed)} seeds for {count} environments")
        return [
            None if each is None else whole_number(f"environment {i}: a seed", each, 0, MAX_SEED)
            for i, each in enumerate(seed)
        ]

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
