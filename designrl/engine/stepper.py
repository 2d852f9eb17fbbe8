"""Environments that a caller steps with its own actions, many side by side in the compiled engine.

    stepper = Stepper(Task("ant", (), max_steps=1000), count=64, autoreset=NEXT_STEP)
    observations = stepper.reset(designs, seeds=range(64))
    result = stepper.step(actions)

As `designrl.engine`, this module knows no task.
"""

import ctypes
import os
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from designrl.engine import Task, _find, _library, _Stepping, _term_weights, instruction_set
from designrl.errors import InputError
from designrl.provenance import core_count, sources_hash

DISABLED, NEXT_STEP, SAME_STEP = range(3)  # Gymnasium's autoreset modes
_GO_ON, _START, _START_SEEDED = range(3)


class Steps(NamedTuple):
    """One step of N environments; all arrays are the caller's own.

    Attributes:
        observations: (N, O) float32.
        rewards: (N,) float64.
        terminated, truncated: (N,) bool.
        terms: (T + 1, N) float64 of the rewards; the last is what the reward factors added.
        final_observations: (N, O) float32, the last of the episodes that ended in this step; the
            other rows have no meaning.
    """

    observations: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    terms: np.ndarray
    final_observations: np.ndarray


@dataclass(frozen=True)
class State:
    """An environment between two steps: where its episode is, and its random numbers.

    Attributes:
        code: `designrl.provenance.sources_hash` of what wrote it.
        task, flags: the task's.
        design: (D,) scales.
        data: the engine's own copy of it, 120 kB of a walker and 8 kB of an ant.
    """

    code: str
    task: str
    flags: tuple[str, ...]
    design: np.ndarray
    data: bytes


class Stepper(AbstractContextManager):
    """N environments of a task.

    Two threads may call it: one after the other has its turn. Copies, by `copy` or by pickle, are
    environments of their own, which go on as these do.

    Args:
        task: with O observations, A actions, D dimensions of its body and T terms of its rewards.
        count: N.
        autoreset: what follows the end of an episode: NEXT_STEP, the next step is its reset;
            SAME_STEP, the same step resets it, too; DISABLED, nothing.
        reward_factor: from scales (N, D) to factors (N,) of all rewards but a fall's.
        threads: operating system threads; None: one per processor.

    Attributes:
        count, observations, actions, dimensions, terms: N, O, A, D and T.
        parts: B, of the body.
        designs: (N, D) scales, each as of its environment's last reset.

    Raises:
        InputError: the engine cannot run here, or does not have the task; in any method: after
            close(), or in a fork of the process that made it.
        MemoryError: 120 kB of a walker and 40 kB of an ant are not to be had so often.
    """

    _process = None  # until it is made

    def __init__(
        self,
        task: Task,
        count: int,
        autoreset: int = NEXT_STEP,
        reward_factor: Callable[[np.ndarray], np.ndarray] | None = None,
        threads: int | None = None,
    ):
        self._library = library = _library()
        *counts, self._flags = _find(task)
        self._task, self.count, self._autoreset = task, count, autoreset
        self._factor, self._threads = reward_factor, threads
        self.observations, self.actions, self.dimensions, self.terms, self.parts = counts
        self.designs = np.ones((count, self.dimensions))
        self._factors = np.ones(count) if reward_factor else None
        self._weights = _term_weights(task, self.terms) if task.reward_weights else None
        threads = max(1, min(threads or core_count(), count))
        isa = instruction_set().encode()
        self._turn = threading.RLock()
        self._owner = ctypes.c_void_p()  # the library's own; it puts them there, and takes them out
        self._process = os.getpid()
        library.designrl_stepper_make(
            ctypes.byref(self._owner), task.name.encode(), isa, count, threads
        )
        if not self._owner:
            raise MemoryError(f"there is no memory for {count} environments")

    @property
    def turn(self) -> AbstractContextManager:
        """The lock that a call holds; `with stepper.turn:` keeps others out for longer."""
        if os.getpid() != self._process:  # a fork has not its threads
            raise InputError("these environments are another process's; make them in this one")
        return self._turn

    def reset(
        self,
        designs: np.ndarray,
        seeds: Sequence[int | None],
        mask: np.ndarray | None = None,
    ) -> np.ndarray:
        """Start episodes.

        Args:
            designs: (N, D) scales.
            seeds: one each, 0 <= seed < 2**64. None: the environment's random numbers go on, which
                they can only after it had a seed.
            mask: (N,) bool, which are to start; None: all. The first time it must be all.

        Returns: (N, O) float32 the latest observations, also of those that were not to start.

        Raises:
            InputError: an episode beyond the engine's capacities.
        """
        mask = np.ones(self.count, dtype=bool) if mask is None else mask
        starts = np.where([seed is None for seed in seeds], _START, _START_SEEDED)
        starts = np.where(mask, starts, _GO_ON).astype(np.uint8)
        words = np.array([seed or 0 for seed in seeds], dtype=np.uint64)
        observations = np.empty((self.count, self.observations), dtype=np.float32)
        with self.turn:
            self._take_designs(np.where(mask[:, None], designs, self.designs))
            self._run(starts=starts, seeds=words, observations=observations)
        return observations

    def step(self, actions: np.ndarray) -> Steps:
        """A step of all, or the reset of those whose episode ended in the step before.

        Args:
            actions: (N, A) float64, contiguous, finite.

        Raises:
            InputError: an episode beyond the engine's capacities (it is never simulated
                differently instead).
        """
        n = self.count
        steps = Steps(
            np.empty((n, self.observations), dtype=np.float32),
            np.zeros(n),
            np.zeros(n, dtype=bool),
            np.zeros(n, dtype=bool),
            np.zeros((self.terms + 1, n)),
            np.empty((n, self.observations), dtype=np.float32),
        )
        with self.turn:
            self._run(actions=actions, **steps._asdict())
        return steps

    def poses(self) -> np.ndarray:
        """(N, B, 7) position in m and quaternion x, y, z, w of each part, see `Body.poses`."""
        poses = np.empty((self.count, self.parts, 7))
        with self.turn:
            if not self._library.designrl_stepper_poses(
                ctypes.byref(self._owner), poses.ctypes.data
            ):
                self._refuse()
        return poses

    def get_states(self) -> list[State]:
        """The N environments' states, to go on from with `set_states`, as often as wanted.

        Nothing but what `reset` and `step` are given makes what follows differ: not the number of
        threads, not the instruction set, not the place among the N.
        """
        with self.turn:
            data = np.empty((self.count, self._state_bytes()), dtype=np.uint8)
            self._library.designrl_stepper_states(
                ctypes.byref(self._owner), data.ctypes.data, False
            )
            about, designs = self._about, self.designs.copy()
        return [State(*about, *each) for each in zip(designs, map(bytes, data), strict=True)]

    def set_states(self, states: Sequence[State]) -> None:
        """Go on from these N states, which may come from another stepper of the same task.

        Their bytes are believed, as a pickle's are: take none from a stranger.

        Raises:
            InputError: another number of them, or of another task or version of this package.
        """
        if len(states) != self.count:
            raise InputError(f"there are {len(states)} states for {self.count} environments")
        with self.turn:
            size = self._state_bytes()
            for i, state in enumerate(states):
                code, *about = self._about
                if not isinstance(state, State) or [state.task, state.flags] != about:
                    raise InputError(f"state {i} is not one of these environments' kind")
                if (state.code, len(state.data)) != (code, size):
                    raise InputError(f"state {i} was saved by another version of designrl")
            data = np.frombuffer(b"".join(state.data for state in states), dtype=np.uint8)
            self._take_designs(np.array([state.design for state in states]))
            self._library.designrl_stepper_states(ctypes.byref(self._owner), data.ctypes.data, True)

    @property
    def _about(self) -> tuple:
        return sources_hash(), self._task.name, self._task.flags

    def _state_bytes(self) -> int:
        size = self._library.designrl_stepper_states(ctypes.byref(self._owner), None, False)
        return size or self._refuse()

    def _take_designs(self, designs: np.ndarray) -> None:
        # New arrays: a call that is under way may read the old ones.
        self.designs, self._factors = designs, self._factor(designs) if self._factor else None

    def _run(self, **arrays: np.ndarray) -> None:
        """The library's call; arrays are its fields."""
        failed = np.zeros(self.count, dtype=bool)
        arrays |= {"designs": self.designs, "failed": failed}
        if self._factors is not None:
            arrays["reward_factors"] = self._factors
        if self._weights is not None:
            arrays["reward_weights"] = self._weights
        stepping = _Stepping(
            environments=self.count,
            flags=self._flags,
            autoreset=self._autoreset,
            max_steps=self._task.max_steps,
            **{name: array.ctypes.data for name, array in arrays.items()},
        )
        if not self._library.designrl_stepper_run(
            ctypes.byref(self._owner), ctypes.byref(stepping)
        ):
            self._refuse()
        if failed.any():
            raise InputError(
                f"the episode of environment {np.argmax(failed)} has more contacts than the engine "
                "holds; reset all environments, or step the reference"
            )

    @staticmethod
    def _refuse():
        raise InputError("these environments are closed; make new ones")

    def close(self) -> None:
        """Free the environments, after a call that is under way; no call follows."""
        if self._process == os.getpid():
            with self._turn:
                self._library.designrl_stepper_free(ctypes.byref(self._owner))

    __del__ = close

    def __exit__(self, *exc_info):
        self.close()

    def __reduce__(self):
        made_with = self._task, self.count, self._autoreset, self._factor, self._threads
        return _restored, (made_with, self.get_states())


def _restored(made_with: tuple, states: list[State]) -> Stepper:
    stepper = Stepper(*made_with)
    stepper.set_states(states)
    return stepper
