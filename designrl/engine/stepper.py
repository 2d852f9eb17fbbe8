"""Environments that a caller steps with its own actions, many side by side in the compiled engine.

    stepper = Stepper(Task("ant", (), max_steps=1000), count=64, autoreset=NEXT_STEP)
    observations = stepper.reset(designs, seeds=range(64))
    result = stepper.step(actions)

As `designrl.engine`, this module knows no task.
"""

import ctypes
import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import NamedTuple

import numpy as np

from designrl.engine import Task, _find, _library, _Stepping, instruction_set
from designrl.errors import InputError
from designrl.provenance import core_count

DISABLED, NEXT_STEP, SAME_STEP = range(3)  # Gymnasium's autoreset modes
_GO_ON, _START, _START_SEEDED = range(3)


class Steps(NamedTuple):
    """One step of N environments; all arrays are the caller's own.

    Attributes:
        observations: (N, O) float32.
        rewards: (N,) float64.
        terminated, truncated: (N,) bool.
        terms: (T + 1, N) float64 of the rewards; the last is what the reward factors added.
    """

    observations: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    terms: np.ndarray


class Stepper(AbstractContextManager):
    """N environments of a task.

    Args:
        task: with O observations, A actions, D dimensions of its body and T terms of its rewards.
        count: N.
        autoreset: what follows the end of an episode: NEXT_STEP, the next step is its reset;
            SAME_STEP, the same step resets it, too; DISABLED, nothing.
        reward_factor: from scales (N, D) to factors (N,) of all rewards but a fall's.
        threads: operating system threads; None: one per processor.
        isa: as for `designrl.engine.rollout`.

    Attributes:
        count, observations, actions, dimensions, terms: N, O, A, D and T.
        parts: B, of the body.
        designs: (N, D) scales, each as of its environment's last reset.
        final_observations: (N, O), the last of each environment's latest episode that has ended.

    Raises:
        InputError: the engine cannot run here, or does not have the task.
        MemoryError: 120 kB of a walker and 40 kB of an ant are not to be had so often.
    """

    _stepper = None  # until it is made, and in a copy that could not be

    def __init__(
        self,
        task: Task,
        count: int,
        autoreset: int = NEXT_STEP,
        reward_factor: Callable[[np.ndarray], np.ndarray] | None = None,
        threads: int | None = None,
        isa: str | None = None,
    ):
        self._process = os.getpid()
        library = _library()
        *counts, flags = _find(task)
        self.count = count
        self.observations, self.actions, self.dimensions, self.terms, self.parts = counts
        self.designs = np.ones((count, self.dimensions))
        self.final_observations = np.zeros((count, self.observations), dtype=np.float32)
        self._reward_factor = reward_factor
        self._factors = np.ones(count)
        self._failed = np.zeros(count, dtype=bool)
        self._fields = _Stepping(
            environments=count,
            flags=flags,
            autoreset=autoreset,
            max_steps=task.max_steps,
            designs=self.designs.ctypes.data,
            reward_factors=self._factors.ctypes.data if reward_factor else None,
            final_observations=self.final_observations.ctypes.data,
            failed=self._failed.ctypes.data,
        )
        threads = max(1, min(threads or core_count(), count))
        isa = instruction_set(isa).encode()
        self._free = library.designrl_stepper_free
        self._call = library.designrl_stepper_run
        self._write_poses = library.designrl_stepper_poses
        self._stepper = library.designrl_stepper_make(task.name.encode(), isa, count, threads)
        if not self._stepper:
            raise MemoryError(f"there is no memory for {count} environments")

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
        self.designs[mask] = designs[mask]
        if self._reward_factor:
            self._factors[mask] = self._reward_factor(self.designs[mask])
        observations = np.empty((self.count, self.observations), dtype=np.float32)
        fields = self._fields
        fields.actions = None
        fields.starts, fields.seeds = starts.ctypes.data, words.ctypes.data
        fields.observations = observations.ctypes.data
        self._run()
        return observations

    def step(self, actions: np.ndarray) -> Steps:
        """A step of all, or the reset of those whose episode ended in the step before.

        Args:
            actions: (N, A) float64, contiguous, finite.

        Raises:
            InputError: an episode beyond the engine's capacities (it is never simulated
                differently instead).
        """
        n, fields = self.count, self._fields
        steps = Steps(
            np.empty((n, self.observations), dtype=np.float32),
            np.zeros(n),
            np.zeros(n, dtype=bool),
            np.zeros(n, dtype=bool),
            np.zeros((self.terms + 1, n)),
        )
        fields.actions = actions.ctypes.data
        fields.observations, fields.rewards = steps[0].ctypes.data, steps[1].ctypes.data
        fields.terminated, fields.truncated = steps[2].ctypes.data, steps[3].ctypes.data
        fields.terms = steps[4].ctypes.data
        self._run()
        return steps

    def poses(self) -> np.ndarray:
        """(N, B, 7) position in m and quaternion x, y, z, w of each part, see `Body.poses`."""
        self._check_process()
        poses = np.empty((self.count, self.parts, 7))
        self._write_poses(self._stepper, poses.ctypes.data)
        return poses

    def _check_process(self) -> None:
        if os.getpid() != self._process:  # a fork has not its threads
            raise InputError("these environments are another process's; make them in this one")

    def _run(self) -> None:
        self._check_process()
        self._call(self._stepper, ctypes.byref(self._fields))
        if self._failed.any():
            index = int(np.argmax(self._failed))
            self._failed[:] = False
            raise InputError(
                f"the episode of environment {index} has more contacts than the engine holds; "
                "reset all environments, or step the reference"
            )

    def close(self) -> None:
        """Free the environments; they are not to be used any more."""
        if self._stepper and os.getpid() == self._process:
            self._free(self._stepper)
        self._stepper = None

    __del__ = close

    def __exit__(self, *exc_info):
        self.close()
