"""The compiled engine: whole episodes of many candidates, with the bits of the reference.

    task = Task("walker", ("hardcore",), max_steps=2000)
    returns, steps = rollout(task, (24, 40, 40, 4), weights, designs, reward_factors, seeds)

Environment, body, policy, physics and reward of a task run in C++ (`native/`), one episode in each
vector lane, on all threads asked for. Results do not depend on the number of threads, on the vector
width or on what else is in the batch. `python -m designrl.verify` compares them with the
reference environments. This module knows no task: their names, flags and sizes are the library's.
"""

import ctypes
import os
import threading
from collections.abc import Callable
from ctypes import c_bool, c_char_p, c_double, c_int, c_int32, c_int64, c_uint32, c_void_p
from dataclasses import dataclass
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import numpy as np

from designrl.errors import InputError
from designrl.numeric import real_numbers, whole_number, whole_numbers
from designrl.provenance import core_count, engine_hash

ISA_VARIABLE = "DESIGNRL_ENGINE_ISA"  # one of these; by default the best there is
INSTRUCTION_SETS = ("portable", "sse2", "avx2", "avx512")
_POLL_SECONDS = 0.1


@dataclass(frozen=True)
class Task:
    """A task of the compiled engine.

    Attributes:
        name: of the task ("walker", "ant").
        flags: what is chosen of it; the walker's are "hardcore" (the terrain with obstacles) and
            "closest_hits" (LIDAR v3), the ant has none.
        max_steps: time limit.
        reward_weights: of the reward's T terms and of what the reward factors add, which count as 1
            where they are left out; empty: the reward is the task's own. With any, it is the sum of
            the weighted terms in their order.
    """

    name: str
    flags: tuple[str, ...]
    max_steps: int
    reward_weights: tuple[float, ...] = ()


class _Batch(ctypes.Structure):
    """native/common/batch.h, field by field."""

    _fields_ = [
        *((name, c_void_p) for name in ("sizes", "weights", "noise_stds")),
        ("time_scale", c_double),
        *((name, c_void_p) for name in ("designs", "reward_factors", "reward_weights", "seeds")),
        *((name, c_int64) for name in ("candidates", "rollouts", "weight_count")),
        ("layers", c_int32),
        ("output_tanh", c_int32),
        ("flags", c_uint32),
        ("shaped", c_int32),
        ("max_steps", c_int64),
        *((name, c_void_p) for name in ("returns", "steps", "observations")),
        *((name, c_int64) for name in ("next_episode", "finished", "stop")),
    ]


class _Stepping(ctypes.Structure):
    """native/common/batch.h, field by field."""

    _fields_ = [
        ("environments", c_int64),
        ("flags", c_uint32),
        ("autoreset", c_int32),
        ("max_steps", c_int64),
        *(
            (name, c_void_p)
            for name in (
                "designs",
                "reward_factors",
                "reward_weights",
                "actions",
                "starts",
                "seeds",
                "observations",
                "final_observations",
                "rewards",
                "terminated",
                "truncated",
                "terms",
                "failed",
            )
        ),
    ]


_FUNCTIONS = {  # of native/api.cpp: result and arguments
    "engine_sources": (c_char_p, ()),
    "engine_batch_bytes": (c_int64, ()),
    "engine_isa": (c_char_p, (c_char_p,)),
    "engine_describe": (c_char_p, (c_char_p, c_void_p)),
    "engine_run": (c_int, (c_void_p, c_char_p, c_char_p, c_int)),
    "stepping_bytes": (c_int64, ()),
    "stepper_make": (None, (c_void_p, c_char_p, c_char_p, c_int64, c_int)),
    "stepper_run": (c_bool, (c_void_p, c_void_p)),
    "stepper_poses": (c_bool, (c_void_p, c_void_p)),
    "stepper_states": (c_int64, (c_void_p, c_void_p, c_bool)),
    "stepper_free": (None, (c_void_p,)),
    "policy_widest": (c_int32, ()),
    "policy_act": (None, (c_void_p, c_void_p, c_int32, c_int32, c_void_p, c_void_p, c_void_p)),
}


@cache
def _load() -> ctypes.CDLL | str:
    """The loaded library, or the reason why there is none."""
    paths = [Path(__file__).with_name(f"_native{suffix}") for suffix in EXTENSION_SUFFIXES]
    path = next(filter(Path.exists, paths), None)
    if path is None:
        return "the compiled engine is missing (it is built by `pip install .` with a C++ compiler)"
    try:
        library = ctypes.CDLL(str(path))
        for name, (result, arguments) in _FUNCTIONS.items():
            function = getattr(library, f"designrl_{name}")
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        return f"the compiled engine does not load ({error})"
    if library.designrl_engine_sources().decode() != engine_hash():
        return (
            f"{path} was compiled from other sources than are beside it (build it again with "
            "`make setup`, or install designrl again)"
        )
    found = library.designrl_engine_batch_bytes(), library.designrl_stepping_bytes()
    if found != (ctypes.sizeof(_Batch), ctypes.sizeof(_Stepping)):
        return "the compiled engine is of another version (install designrl again)"
    return library


def _library() -> ctypes.CDLL:
    library = _load()
    if isinstance(library, str):
        raise InputError(library)
    return library


def missing_reason() -> str | None:
    """Why the engine cannot run here, as a clause; None if it can."""
    library = _load()
    return library if isinstance(library, str) else None


def widest_layer() -> int:
    """How many values a layer of the policy may have."""
    return _library().designrl_policy_widest()


def instruction_sets() -> list[str]:
    """Those that this processor has; empty where the engine cannot run."""
    library = _load()
    if isinstance(library, str):
        return []
    return [isa for isa in INSTRUCTION_SETS if library.designrl_engine_isa(isa.encode())]


def instruction_set(name: str | None = None) -> str:
    """The instruction set in use: `name`, else $DESIGNRL_ENGINE_ISA, else the processor's best.

    Raises:
        InputError: unknown, or this processor does not have it.
    """
    name = name or os.environ.get(ISA_VARIABLE, "")
    isa = _library().designrl_engine_isa(name.encode())
    if isa is None:
        raise InputError(
            f"{name!r} (isa= or {ISA_VARIABLE}) is no instruction set of this processor; it has "
            f"{', '.join(instruction_sets())}"
        )
    return isa.decode()


def rollout(
    task: Task,
    sizes: tuple[int, ...],
    weights: np.ndarray,
    designs: np.ndarray,
    reward_factors: np.ndarray,
    seeds: np.ndarray,
    *,
    output_tanh: bool = True,
    time_scale: float | None = None,
    noise_stds: np.ndarray | None = None,
    shaped: bool = False,
    threads: int | None = None,
    isa: str | None = None,
    observations: bool = False,
    progress: Callable[[int], None] | None = None,
):
    """Run each of N candidates once with each of its R seeds.

    Args:
        task: with O observations, A actions and D dimensions of its body.
        sizes: of the tanh network: O (with a time scale O + 1), the hidden layers', A.
        weights: (N, P) of the networks, layer by layer the matrix (inputs, outputs) in row-major
            order and the bias, as in `designrl.policy`.
        designs: (N, D) scales.
        reward_factors: (N,) multiplies every reward but that of a fall.
        seeds: (N, R), 0 <= seed < 2**63.
        output_tanh: whether the last layer has tanh, too.
        time_scale: steps; the network's last input is t / time_scale. None: it sees no time.
        noise_stds: (N, A) of Gaussian noise on the last layer before its activation, a function of
            the episode's seed (`designrl.policy.Agent.reset`). None: no noise.
        shaped: the published training code's rewards: a fall costs nothing, and a solved episode
            (the walkers': no fall, more than 300 points) gets 100 more. The ant has none such.
        threads: operating system threads; None: one per processor.
        isa: see `instruction_set`.
        observations: return them too; 154 to 192 kB per episode of the walker, 112 of the ant.
        progress: called with the number of episodes that have ended since its last call.

    Returns:
        returns (N, R) float64 and steps (N, R) int64; with `observations` also a list of N lists of
        R arrays (steps + 1, O) float32, the first row being reset's.

    Raises:
        InputError: the engine cannot run here; an unknown task, flag or instruction set; arrays
            that do not fit the task or each other, or that are not finite; an episode beyond the
            engine's capacities (it is never simulated differently instead), or an action that is
            no finite number.
        KeyboardInterrupt: within a step or two of Ctrl-C.
    """
    inputs, outputs, dimensions, terms, _, flags = _find(task)
    sizes = _checked_sizes(sizes)
    if (sizes[0], sizes[-1]) != (inputs + (time_scale is not None), outputs):
        raise InputError(
            f"the engine's {task.name} has {inputs} observations and {outputs} actions, a network "
            f"{'-'.join(map(str, sizes))} does not fit"
        )
    if time_scale is not None and not 0 < time_scale < float("inf"):
        raise InputError(f"time_scale is {time_scale}; it must be a finite number above 0")
    try:
        seeds = whole_numbers(seeds)
    except ValueError:
        seeds = np.empty(0)
    if seeds.ndim != 2 or seeds.min(initial=0) < 0 or seeds.max(initial=0) >= 2**63:
        raise InputError("seeds must be an (N, R) array of integers from 0 to 2**63 - 1")
    n, r = seeds.shape
    returns, steps = np.zeros((n, r)), np.zeros((n, r), dtype=np.int64)
    arrays = {
        "sizes": sizes,
        "weights": _checked("weights", weights, np.float32, (n, _weight_count(sizes))),
        "designs": _checked("designs", designs, np.float64, (n, dimensions)),
        "reward_factors": _checked("reward_factors", reward_factors, np.float64, (n,)),
        "seeds": np.ascontiguousarray(seeds, dtype=np.uint64),
        "returns": returns,
        "steps": steps,
    }
    if task.reward_weights:
        arrays["reward_weights"] = _term_weights(task, terms)
    if noise_stds is not None:
        arrays["noise_stds"] = _checked("noise_stds", noise_stds, np.float64, (n, outputs))
    if observations:
        seen = np.empty((n, r, task.max_steps + 1, inputs), dtype=np.float32)
        arrays["observations"] = seen
    batch = _Batch(
        time_scale=time_scale or 0.0,
        candidates=n,
        rollouts=r,
        weight_count=_weight_count(sizes),
        layers=len(sizes) - 1,
        output_tanh=output_tanh,
        flags=flags,
        shaped=shaped,
        max_steps=task.max_steps,
        **{name: array.ctypes.data for name, array in arrays.items()},
    )
    batch.arrays = arrays  # which so live as long as what points to them
    threads = whole_number("threads", threads or core_count(), 1)
    threads = max(1, min(threads, n * r))
    _run(batch, task.name.encode(), instruction_set(isa).encode(), threads, progress)
    if (steps < 0).any():
        i, j = (int(k) for k in np.argwhere(steps < 0)[0])
        raise InputError(
            f"the episode of candidate {i} with seed {int(seeds[i, j])} has more contacts than "
            'the engine holds, or an action that is no finite number; use backend="reference"'
        )
    if not observations:
        return returns, steps
    return returns, steps, [[seen[i, j, : steps[i, j] + 1] for j in range(r)] for i in range(n)]


def act_function(
    sizes: tuple[int, ...], output_tanh: bool, weights: np.ndarray
) -> Callable[[np.ndarray, np.ndarray | None], np.ndarray]:
    """The compiled policy of one network, with the bits of `designrl.policy`.

    For episodes outside the engine: beside 0.1 ms of the ant's physics, NumPy's twenty small
    operations per action cost a third as much again.

    Args:
        sizes, output_tanh: as for `rollout`.
        weights: (P,) as a row of `rollout`'s.

    Returns: act(x, noise=None): the inputs (O,) and what is added to the last layer before its
        activation (A,), if anything, to an action (A,), all float32.

    Raises:
        InputError: the library cannot run here; weights that do not fit, or a layer wider than it
            can take.
    """
    act = _library().designrl_policy_act
    sizes = _checked_sizes(sizes)
    weights = _checked("weights", weights, np.float32, (_weight_count(sizes),))
    inputs, outputs = int(sizes[0]), int(sizes[-1])
    fixed = weights.ctypes.data, sizes.ctypes.data, len(sizes) - 1, bool(output_tanh)

    def compiled(x: np.ndarray, noise: np.ndarray | None = None, held=(weights, sizes)):
        # held: what the pointers point to
        x = np.ascontiguousarray(x, dtype=np.float32)
        if noise is not None:
            noise = np.ascontiguousarray(noise, dtype=np.float32)
        if x.size != inputs or (noise is not None and noise.size != outputs):
            raise InputError(f"the policy takes {inputs} values and noise of {outputs}")
        action = np.empty(outputs, dtype=np.float32)
        noise_data = None if noise is None else noise.ctypes.data
        act(*fixed, x.ctypes.data, noise_data, action.ctypes.data)
        return action

    return compiled


def _find(task: Task) -> tuple[int, int, int, int, int, int]:
    """How many observations, actions, dimensions, terms, parts a task has; its flags' bits."""
    counts = (c_int32 * 5)()
    known = _library().designrl_engine_describe(task.name.encode(), counts)
    if known is None:
        raise InputError(f"the engine does not have the task {task.name!r}")
    known = known.decode().split()
    unknown = [flag for flag in task.flags if flag not in known]
    if unknown:
        raise InputError(
            f"the engine's {task.name} does not have the flag {unknown[0]!r}; it has "
            f"{', '.join(known) or 'none'}"
        )
    whole_number("max_steps", task.max_steps, 1, 2**63 - 1)
    return *counts, sum(1 << i for i, flag in enumerate(known) if flag in task.flags)


def _term_weights(task: Task, terms: int) -> np.ndarray:
    """(T + 1,) weights of a task that has some."""
    weights = np.ones(terms + 1)
    if len(task.reward_weights) > len(weights):
        raise InputError(f"the engine's {task.name} has {terms} terms of its reward")
    weights[: len(task.reward_weights)] = task.reward_weights
    return weights


def _checked_sizes(sizes: tuple[int, ...]) -> np.ndarray:
    """The layers' sizes as the library takes them."""
    widest = widest_layer()
    if len(sizes) < 2 or min(sizes) < 1 or max(sizes) > widest:
        raise InputError(
            f"the compiled policy takes layers of 1 to {widest} values, not {tuple(sizes)}"
        )
    return np.array(sizes, dtype=np.int32)


def _weight_count(sizes: np.ndarray) -> int:
    return int(((sizes[:-1] + 1) * sizes[1:]).sum())


def _checked(name: str, values: np.ndarray, dtype: type, shape: tuple[int, ...]) -> np.ndarray:
    """A contiguous array of finite numbers of that type and shape."""
    try:
        with np.errstate(over="ignore"):  # of float32: found below
            array = real_numbers(values).astype(dtype, copy=False)
    except ValueError as error:
        raise InputError(f"{name} must be an array of real numbers ({error})") from None
    if array.shape != shape:
        raise InputError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        index = np.argwhere(~np.isfinite(array))[0].tolist()
        raise InputError(f"{name}{index} is not a finite number")
    return array


def _run(
    batch: _Batch, task: bytes, isa: bytes, threads: int, progress: Callable[[int], None] | None
) -> None:
    """The native call, in a thread of its own so that Ctrl-C and progress get through."""
    run = _library().designrl_engine_run
    status, ended = [], []
    # A bare lock: a second Ctrl-C in threading.Event's wait() comes out of it as a RuntimeError.
    done = threading.Lock()
    done.acquire()

    def target():
        # Holds the batch: after a Ctrl-C at the wrong moment the caller may be gone before the
        # call is. (Thread.join() of Python 3.11 is no help, an interrupt ends it for good.)
        try:
            status.append(run(ctypes.byref(batch), task, isa, threads))
        finally:
            ended.append(True)
            done.release()

    thread = threading.Thread(target=target, daemon=True)
    reported = 0
    try:
        thread.start()
        while not ended or batch.finished > reported:
            done.acquire(timeout=_POLL_SECONDS)
            finished = batch.finished
            if progress and finished > reported:
                progress(finished - reported)
            reported = finished
    finally:
        batch.stop = 1  # after an exception; otherwise all is done
        while thread.ident is not None and not ended:
            done.acquire(timeout=_POLL_SECONDS)
    if status != [0]:
        raise MemoryError("the engine got no memory for its episodes")
