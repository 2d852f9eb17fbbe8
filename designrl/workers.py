"""Where simulations run: in this process, in a pool of processes, or on a Ray cluster.

All three have one method, `run(function, candidates, tasks)`. A task is (rows, *arguments) and its
result `function(candidates[rows], *arguments)`; results come as they are ready, in any order, each
with its task's index. Which worker did a task never matters, so one that dies, hangs or fails is
replaced and its task done again elsewhere; a task that fails three times is at fault itself.
"""

import contextlib
import math
import multiprocessing
import os
import pickle
import signal
import socket
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import connection

import numpy as np

from designrl.errors import InputError
from designrl.provenance import sources_hash

MAX_FAILURES = 3  # of one task, before it is blamed and not its workers
START_SECONDS = 120.0  # for a worker to start, on a busy machine
TASK_SECONDS = 60.0  # a task that takes longer hangs, unless the caller knows better
PATIENCE_SECONDS = 30.0  # without a core on the cluster, before it is mentioned
GOODBYE_SECONDS = 2.0  # for a worker to end by itself
WORKER_NAME = "designrl worker"  # of a worker process


class TaskError(Exception):
    """A task that failed each time.

    Attributes:
        index: of the task.
        reason: what happened, as the end of a sentence.
    """

    def __init__(self, index: int, reason: str):
        super().__init__(index, reason)
        self.index, self.reason = index, reason


def run_here(
    function: Callable, candidates: np.ndarray, tasks: Sequence[tuple], seconds: float = 0
) -> Iterator[tuple[int, object]]:
    """Yield (index, result) of each task, computed in this process.

    Raises:
        TaskError: the function raised something other than InputError.
    """
    for index, (rows, *arguments) in enumerate(tasks):
        try:
            result = function(candidates[rows], *arguments)
        except InputError:
            raise
        except Exception as error:
            raise TaskError(index, _one_line(error)) from error
        yield index, result


def _one_line(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}".replace("\n", " ")[:300]


class _Workers:
    """Hands tasks to workers one by one, and does again what was lost.

    Subclasses say what a worker is: `_begin`, `_free`, `_send`, `_wait`, `_drop`.
    """

    def run(
        self,
        function: Callable,
        candidates: np.ndarray,
        tasks: Sequence[tuple],
        seconds: float = TASK_SECONDS,
    ) -> Iterator[tuple[int, object]]:
        """Yield (index, result) as tasks end, in any order.

        Args:
            function: of candidates[rows] and a task's arguments; a module's, or a partial of one.
            candidates: (N, P).
            tasks: (rows, *arguments) each.
            seconds: after which a task hangs.

        Raises:
            TaskError: a task failed three times, each time in another worker.
            InputError: the function raised it; no worker starts.
        """
        self._begin(candidates)
        waiting, failures = deque(range(len(tasks))), Counter()
        busy: dict[object, tuple[int, float]] = {}  # worker -> its task, and when that hangs
        try:
            while waiting or busy:
                for worker in self._free(len(waiting)):
                    index = waiting.popleft()
                    busy[worker] = index, time.monotonic() + seconds + START_SECONDS
                    self._send(worker, function, candidates, tasks[index])
                until = min((end for _, end in busy.values()), default=time.monotonic() + 1)
                for worker, outcome, value in self._wait(max(0.0, until - time.monotonic())):
                    index, _ = busy.pop(worker)
                    if outcome == "done":
                        yield index, value
                    else:
                        self._failed(worker, index, value, failures, waiting)
                now = time.monotonic()
                for worker in [w for w, (_, end) in busy.items() if end <= now]:
                    index, _ = busy.pop(worker)
                    reason = f"gave no answer for {seconds + START_SECONDS:.0f} s"
                    self._failed(worker, index, reason, failures, waiting)
        finally:
            for worker in busy:  # after an exception or an interrupt: nobody wants their results
                self._drop(worker)

    def _failed(self, worker, index: int, reason: str, failures: Counter, waiting: deque) -> None:
        self._drop(worker)
        failures[index] += 1
        if failures[index] == MAX_FAILURES:
            raise TaskError(index, f"{MAX_FAILURES} workers failed on it, the last one {reason}")
        waiting.append(index)  # last, when all that died unseen while idle have been found out
        print(
            f"designrl: {self._name(worker)} {reason}; it is replaced and its work done again",
            file=sys.stderr,
        )

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self.close()


# -------------------------------------------------------------------------- a pool of processes


def _serve(pipe: connection.Connection) -> None:
    """A worker process: answer tasks until the other end of the pipe is closed."""
    # Ctrl-C is the parent's to handle; it ends the workers in good order.
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_parent() -> None:
        multiprocessing.parent_process().join()  # the fork server, which ends with the trainer
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
    pipe.send(("ready", None))
    while True:
        try:
            function, candidates, arguments = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            answer = "done", function(candidates, *arguments)
        except InputError as error:
            answer = "refused", error
        except Exception as error:
            answer = "failed", f"raised {_one_line(error)}"
        pipe.send(answer)


# A worker runs the script of its parent once more, as a module, to find the functions in it.
NO_START = (
    "the worker processes do not start; a script that uses several workers must be a file, with "
    'this call under `if __name__ == "__main__":`'
)


class _Process:
    """A worker process and the pipe to it."""

    def __init__(self, context):
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), name=WORKER_NAME, daemon=True)
        self.process.start()
        theirs.close()  # else it would not read as closed when the worker dies

    def death(self) -> str:
        """How it ended, once its pipe has closed."""
        self.process.join(GOODBYE_SECONDS)
        code = self.process.exitcode
        return f"died of signal {-code}" if code and code < 0 else f"ended with exit code {code}"

    def end(self) -> None:
        """Let it end by itself, or else make it."""
        self.pipe.close()
        self.process.join(GOODBYE_SECONDS)
        if self.process.exitcode is None:
            self.process.kill()
            self.process.join()
        self.process.close()


class ProcessWorkers(_Workers):
    """A pool of processes on this machine; a context manager.

    Args:
        count: processes, at least 1; they start when there is work.
    """

    def __init__(self, count: int):
        if multiprocessing.current_process().name == WORKER_NAME:
            sys.exit(1)  # this is a worker that runs an unguarded script; its parent says so
        self.count = count
        self._started = False  # a worker has been ready
        # Not "fork": a forked child shares PyBullet clients and the locks of torch's threads.
        self._context = multiprocessing.get_context("forkserver")
        self._idle: list[_Process] = []
        self._busy: dict[connection.Connection, _Process] = {}

    def _begin(self, candidates: np.ndarray) -> None:
        pass

    def _free(self, wanted: int) -> Iterator[_Process]:
        for _ in range(min(wanted, self.count - len(self._busy))):
            yield self._idle.pop() if self._idle else _Process(self._context)

    def _send(self, worker: _Process, function, candidates, task) -> None:
        self._busy[worker.pipe] = worker
        rows, *arguments = task
        with contextlib.suppress(OSError):  # died while it was idle; `_wait` will see that
            worker.pipe.send((function, candidates[rows], arguments))

    def _wait(self, seconds: float) -> Iterator[tuple[_Process, str, object]]:
        for pipe in connection.wait(list(self._busy), seconds):
            worker = self._busy[pipe]
            try:
                outcome, value = pipe.recv()
            except (EOFError, OSError, pickle.UnpicklingError):
                outcome, value = "failed", worker.death()
                if not self._started and worker.process.exitcode == 1:  # and not of a signal
                    raise InputError(NO_START) from None
            if outcome == "ready":
                self._started = True
                continue
            if outcome == "refused":
                raise value
            if outcome == "done":
                self._idle.append(self._busy.pop(pipe))
            yield worker, outcome, value

    def _drop(self, worker: _Process) -> None:
        self._busy.pop(worker.pipe, None)
        worker.process.kill()
        worker.end()

    def _name(self, worker: _Process) -> str:
        return "a worker process"

    def close(self) -> None:
        """End the processes; unfinished tasks are dropped."""
        for worker in list(self._busy.values()):
            self._drop(worker)
        for worker in self._idle:
            worker.pipe.close()  # all at once, then wait for each
        while self._idle:
            self._idle.pop().end()


# -------------------------------------------------------------------------------- a Ray cluster


class _RayWorker:
    """What runs on the cluster, as an actor: it keeps its environments between tasks."""

    def sources(self) -> str:
        return sources_hash()

    def work(self, function, candidates, rows, arguments):
        try:
            return "done", function(candidates[rows], *arguments)
        except InputError as error:
            return "refused", str(error)
        except Exception as error:
            return "failed", f"raised {_one_line(error)}"


def _check_reachable(address: str) -> None:
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except (OSError, ValueError, OverflowError) as error:
        raise InputError(
            f"no Ray cluster at {address} ({_one_line(error)}); write HOST:PORT, or auto"
        ) from None


class RayWorkers(_Workers):
    """An actor for each core of a Ray cluster; a context manager.

    The candidates travel once per generation to each node, tasks and results are small. Nodes may
    leave, with their work done again elsewhere, and join: actors follow at the next generation.

    Args:
        address: "local", for a cluster on this machine that ends with this process, or that of an
            existing cluster, as Ray takes it. Its nodes need this package and its libraries.

    Raises:
        InputError: Ray is not installed; there is no cluster at that address.
    """

    def __init__(self, address: str):
        try:
            import ray
        except ImportError:
            raise InputError(
                "Ray is not installed; install it in designrl's checkout with: "
                'pip install -e ".[ray]"'
            ) from None
        self._ray = ray
        if address not in ("local", "auto") and "://" not in address:
            _check_reachable(address)  # Ray itself would try for minutes
        polite_kill = signal.getsignal(signal.SIGTERM)
        where = {"include_dashboard": False} if address == "local" else {"address": address}
        try:
            ray.init(**where, log_to_driver=False, logging_level="ERROR")
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise InputError(f"no Ray cluster at {address} ({_one_line(error)})") from None
        finally:
            if threading.current_thread() is threading.main_thread():
                signal.signal(signal.SIGTERM, polite_kill)  # Ray has put its own in place
        self._actor = ray.remote(num_cpus=1, max_restarts=0)(_RayWorker)
        self._starting: dict[object, object] = {}  # answer awaited -> actor
        self._idle: list[object] = []
        self._busy: dict[object, object] = {}  # answer awaited -> actor
        self._failed_starts = 0
        self._without_core: float | None = None  # since when nothing runs; infinite: and said so
        self._candidates = None

    @property
    def count(self) -> int:
        """Cores of the cluster as it is now, at least 1."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 0)))

    def _begin(self, candidates: np.ndarray) -> None:
        self._candidates = self._ray.put(candidates)
        for _ in range(self.count - len(self._idle) - len(self._busy) - len(self._starting)):
            self._start()

    def _start(self) -> None:
        actor = self._actor.remote()
        self._starting[actor.sources.remote()] = actor

    def _free(self, wanted: int) -> Iterator[object]:
        for _ in range(min(wanted, len(self._idle))):
            yield self._idle.pop()

    def _send(self, worker, function, candidates, task) -> None:
        rows, *arguments = task
        self._busy[worker.work.remote(function, self._candidates, rows, arguments)] = worker

    def _wait(self, seconds: float) -> Iterator[tuple[object, str, object]]:
        awaited = [*self._busy, *self._starting]
        if not awaited:
            self._start()  # all have died
            return
        ready, _ = self._ray.wait(awaited, num_returns=len(awaited), timeout=0)
        if not ready:
            ready, _ = self._ray.wait(awaited, timeout=seconds)
        self._mention_waiting(bool(ready or self._busy))
        for answer in ready:
            if answer in self._starting:
                self._started(answer)
                continue
            worker = self._busy[answer]
            try:
                outcome, value = self._ray.get(answer)
            except self._ray.exceptions.RayError as error:
                outcome, value = "failed", f"was lost ({type(error).__name__})"
            if outcome == "refused":
                raise InputError(value)
            if outcome == "done":
                self._idle.append(self._busy.pop(answer))
            yield worker, outcome, value

    def _mention_waiting(self, works: bool) -> None:
        if works or self._without_core is None:
            self._without_core = None if works else time.monotonic()
        elif time.monotonic() - self._without_core > PATIENCE_SECONDS:
            self._without_core = math.inf
            print(
                f"designrl: the Ray cluster has no free core (it has {self.count}); the run waits "
                "for one, `ray status` shows who holds them",
                file=sys.stderr,
            )

    def _started(self, answer) -> None:
        actor = self._starting.pop(answer)
        try:
            sources = self._ray.get(answer)
        except self._ray.exceptions.RayError as error:
            self._failed_starts += 1
            if self._failed_starts >= MAX_FAILURES and not self._idle and not self._busy:
                raise InputError(
                    f"no worker starts on the Ray cluster ({_one_line(error)}); install this "
                    "version of designrl on its nodes"
                ) from None
            return
        if sources != sources_hash():
            raise InputError(
                f"a node of the Ray cluster has another version of designrl (sources {sources}, "
                f"here {sources_hash()}); install the same one everywhere"
            )
        self._failed_starts = 0
        self._idle.append(actor)

    def _drop(self, worker) -> None:
        for answer in [a for a, w in self._busy.items() if w is worker]:
            del self._busy[answer]
        self._ray.kill(worker)

    def _name(self, worker) -> str:
        return "a Ray worker"

    def close(self) -> None:
        """End the actors and leave the cluster."""
        if self._ray.is_initialized():
            self._ray.shutdown()
