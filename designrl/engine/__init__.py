"""The compiled walker engine: whole episodes of many candidates, with the bits of the reference.

    engine = WalkerEngine(hardcore=True)
    returns, steps = engine.rollout(parameters, scales, reward_factors, seeds)

Terrain, body, policy, physics, LIDAR and reward run in C++ (`native/`), one walker in each vector
lane, on all threads asked for. Results do not depend on the number of threads, on the vector width
or on what else is in the batch. `python -m designrl.engine.verify` compares it with Box2D.
"""

import ctypes
import os
import threading
from collections.abc import Callable
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import gymnasium
import numpy as np

import designrl  # noqa: F401 (registers the environments, whose time limits hold here too)
from designrl.design import WALKER
from designrl.errors import InputError
from designrl.experiments import get_experiment
from designrl.policy import Agent

ISA_VARIABLE = "DESIGNRL_ENGINE_ISA"  # sse2, avx2 or avx512; by default the best there is
INSTRUCTION_SETS = ("sse2", "avx2", "avx512")
OBSERVATION_SIZE = 24
_NETWORK = get_experiment("biped").network  # the only shape that the engine is compiled for
_POLL_SECONDS = 0.1


class _Batch(ctypes.Structure):
    """native/common/batch.h, field by field."""

    _fields_ = [
        ("weights", ctypes.c_void_p),
        ("scales", ctypes.c_void_p),
        ("reward_factors", ctypes.c_void_p),
        ("seeds", ctypes.c_void_p),
        ("candidates", ctypes.c_int64),
        ("rollouts", ctypes.c_int64),
        ("weight_count", ctypes.c_int64),
        ("hardcore", ctypes.c_int32),
        ("closest_hits", ctypes.c_int32),
        ("training", ctypes.c_int32),
        ("max_steps", ctypes.c_int32),
        ("returns", ctypes.c_void_p),
        ("steps", ctypes.c_void_p),
        ("observations", ctypes.c_void_p),
        ("next_episode", ctypes.c_int64),
        ("finished", ctypes.c_int64),
        ("stop", ctypes.c_int64),
    ]


@cache
def _library() -> ctypes.CDLL | str:
    """The loaded library, or the reason why there is none."""
    folder = Path(__file__).parent
    paths = [folder / f"_native{suffix}" for suffix in EXTENSION_SUFFIXES]
    path = next((path for path in paths if path.exists()), None)
    if path is None:
        return (
            "the compiled walker engine is missing (it is built by `pip install .` with a C++ "
            "compiler, on Linux x86-64)"
        )
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        return f"the compiled walker engine does not load ({error})"
    library.designrl_engine_batch_bytes.restype = ctypes.c_int64
    library.designrl_engine_isa.restype = ctypes.c_char_p
    library.designrl_engine_isa.argtypes = [ctypes.c_char_p]
    library.designrl_engine_run.argtypes = [ctypes.POINTER(_Batch), ctypes.c_char_p, ctypes.c_int]
    library.designrl_policy_act.restype = None
    library.designrl_policy_act.argtypes = [
        *(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int32, ctypes.c_int32),
        *(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p),
    ]
    if library.designrl_engine_batch_bytes() != ctypes.sizeof(_Batch):
        return "the compiled walker engine is of another version (install designrl again)"
    return library


def engine_missing_reason() -> str | None:
    """Why the engine cannot run here, as a clause; None if it can."""
    library = _library()
    return library if isinstance(library, str) else None


def engine_isa(name: str | None = None) -> str:
    """The instruction set in use: `name`, else $DESIGNRL_ENGINE_ISA, else the processor's best.

    Raises:
        InputError: unknown, or this processor does not have it.
    """
    name = name or os.environ.get(ISA_VARIABLE, "")
    library = _library()
    if isinstance(library, str):
        raise InputError(library)
    isa = library.designrl_engine_isa(name.encode())
    if isa is None:
        raise InputError(
            f"{ISA_VARIABLE} is {name!r}; this processor has "
            f"{', '.join(i for i in INSTRUCTION_SETS if library.designrl_engine_isa(i.encode()))}"
        )
    return isa.decode()


class CompiledAgent(Agent):
    """An Agent whose actions are computed by the compiled library, with the same bits.

    For episodes outside the engine, the ant's: beside 0.1 ms of physics, NumPy's twenty small
    operations per action cost a third as much again.

    Raises:
        InputError: as Agent; the library cannot run here; a layer wider than it can take.
    """

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        library = _library()
        if isinstance(library, str):
            raise InputError(library)
        sizes = self.network.sizes
        if max(sizes) > library.designrl_policy_widest():
            raise InputError(
                f"the compiled policy takes layers of {library.designrl_policy_widest()} values at "
                f"most, not {max(sizes)}"
            )
        self._act = library.designrl_policy_act
        weights = self.parameters[: self.network.num_parameters].astype(np.float32)
        self._held = weights, np.array(sizes, dtype=np.int32)  # what the pointers point to
        self._fixed = (
            *(array.ctypes.data for array in self._held),
            len(sizes) - 1,
            self.network.output == "tanh",
        )

    def _forward(self, x, noise):
        x = np.ascontiguousarray(x)
        action = np.empty(self.network.sizes[-1], dtype=np.float32)
        self._act(
            *self._fixed,
            x.ctypes.data,
            None if noise is None else noise.ctypes.data,
            action.ctypes.data,
        )
        return action


class WalkerEngine:
    """Rollouts of the 24-40-40-4 policy in the walker's two tasks.

    Args:
        hardcore: the terrain with obstacles, and 2000 instead of 1600 steps at most.
        lidar: "v2" (the paper's) or "v3" (closest hit).
        threads: operating system threads; None: one per processor.

    Raises:
        InputError: the engine cannot run here; an unknown `lidar` or instruction set.
    """

    def __init__(self, hardcore: bool, lidar: str = "v2", threads: int | None = None):
        if lidar not in ("v2", "v3"):
            raise InputError(f'lidar is {lidar!r}; it must be "v2" (the paper\'s) or "v3"')
        self.isa = engine_isa()
        self.hardcore = hardcore
        self.lidar = lidar
        self.threads = threads or len(os.sched_getaffinity(0))
        name = "biped-hardcore" if hardcore else "biped"
        self.max_steps = gymnasium.spec(get_experiment(name).env_id).max_episode_steps

    def rollout(
        self,
        parameters: np.ndarray,
        scales: np.ndarray,
        reward_factors: np.ndarray,
        seeds: np.ndarray,
        training: bool = False,
        observations: bool = False,
        progress: Callable[[int], None] | None = None,
    ):
        """Run each candidate once with each of its seeds.

        Args:
            parameters: (N, 2804) of the networks, in the order of `designrl.policy`.
            scales: (N, 8) designs.
            reward_factors: (N,) multiplies every reward but that of a fall.
            seeds: (N, R), 0 <= seed < 2**63.
            training: the -100 of a fall counts 0; an episode that ends without one and with more
                than 300 points gets 100.
            observations: return them too; 154 to 192 kB per episode.
            progress: called with the number of episodes that have ended since its last call.

        Returns:
            returns (N, R) float64 and steps (N, R) int64; with `observations` also a list of N
            lists of R arrays (steps + 1, 24) float32, the first row being reset's.

        Raises:
            InputError: shapes that do not fit each other; numbers that are not finite; an episode
                beyond the engine's capacities (it is never simulated differently instead).
            KeyboardInterrupt: within a step or two of Ctrl-C.
        """
        weights = np.ascontiguousarray(np.asarray(parameters), dtype=np.float32)
        scales = np.ascontiguousarray(scales, dtype=np.float64)
        factors = np.ascontiguousarray(reward_factors, dtype=np.float64)
        seeds = np.asarray(seeds)
        if seeds.ndim != 2 or seeds.dtype.kind not in "iu" or (seeds < 0).any():
            raise InputError("seeds must be an (N, R) array of integers from 0 on")
        seeds = np.ascontiguousarray(seeds, dtype=np.uint64)
        n, r = seeds.shape
        expected = {
            "parameters": (weights.shape, (n, _NETWORK.num_parameters)),
            "scales": (scales.shape, (n, WALKER.size)),
            "reward_factors": (factors.shape, (n,)),
        }
        for name, (shape, needed) in expected.items():
            if shape != needed:
                raise InputError(f"{name} must have shape {needed}, got {shape}")

        broken = ~(np.isfinite(weights).all(axis=1) & np.isfinite(scales).all(axis=1))
        if broken.any():
            raise InputError(
                f"candidate {int(np.argmax(broken))} has parameters that are not finite"
            )

        returns = np.zeros((n, r))
        steps = np.zeros((n, r), dtype=np.int64)
        seen = None
        if observations:
            seen = np.empty((n, r, self.max_steps + 1, OBSERVATION_SIZE), dtype=np.float32)
        batch = _Batch(
            weights=weights.ctypes.data,
            scales=scales.ctypes.data,
            reward_factors=factors.ctypes.data,
            seeds=seeds.ctypes.data,
            candidates=n,
            rollouts=r,
            weight_count=weights.shape[1],
            hardcore=self.hardcore,
            closest_hits=self.lidar == "v3",
            training=training,
            max_steps=self.max_steps,
            returns=returns.ctypes.data,
            steps=steps.ctypes.data,
            observations=None if seen is None else seen.ctypes.data,
        )
        self._run(batch, (weights, scales, factors, seeds, returns, steps, seen), progress)
        if (steps < 0).any():
            i, j = (int(k) for k in np.argwhere(steps < 0)[0])
            raise InputError(
                f"the episode of candidate {i} with seed {int(seeds[i, j])} has more contacts than "
                'the engine holds; use backend="reference"'
            )
        if seen is None:
            return returns, steps
        return returns, steps, [[seen[i, j, : steps[i, j] + 1] for j in range(r)] for i in range(n)]

    def _run(self, batch: _Batch, arrays: tuple, progress: Callable[[int], None] | None) -> None:
        """The native call, in a thread of its own so that Ctrl-C and progress get through."""
        threads = max(1, min(self.threads, batch.candidates * batch.rollouts))
        run = _library().designrl_engine_run
        status, done = [], threading.Event()

        def call(arrays=arrays):
            # Holds the arrays: after a Ctrl-C at the wrong moment the caller may be gone before the
            # call is. (Thread.join() of Python 3.11 is no help, an interrupt ends it for good.)
            try:
                status.append(run(ctypes.byref(batch), self.isa.encode(), threads))
            finally:
                done.set()

        thread = threading.Thread(target=call, daemon=True)
        reported = 0
        try:
            thread.start()
            while not done.wait(_POLL_SECONDS) or batch.finished > reported:
                finished = batch.finished
                if progress and finished > reported:
                    progress(finished - reported)
                reported = finished
        finally:
            batch.stop = 1  # after an exception; otherwise all is done
            if thread.ident is not None:
                done.wait()
        if status != [0]:
            raise MemoryError("the walker engine got no memory for its episodes")
