"""Where simulations run: in this process, in processes beside it, or on a Ray cluster.

Each is a `run(function, candidates, tasks, seconds)`. A task is (rows, *arguments) and its result
`function(candidates[rows], *arguments)`; (index, result) come as they are ready. Which worker did a
task never matters: one that dies, fails or takes longer than `seconds` is replaced and its task
done again. A task that fails three times (here, once) is at fault itself (TaskError).
"""

import ipaddress
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
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import numpy as np
from gymnasium.vector.utils import CloudpickleWrapper

from designrl.errors import InputError, optional, remark
from designrl.provenance import sources_hash

MAX_FAILURES = 3  # of one task, before it is blamed and not its workers
PATIENCE_SECONDS = 30.0  # without a result from the cluster, before it is mentioned

Results = Iterator[tuple[int, Any]]


class TaskError(Exception):
    """A task that failed each time.

    Attributes:
        index: of the task.
        reason: what happened, as the end of a sentence.
    """

    def __init__(self, index: int, reason: str):
        super().__init__(f"task {index} failed: {reason}")
        self.index, self.reason = index, reason


def run_here(
    function: Callable, candidates: np.ndarray, tasks: Sequence[tuple], _seconds: float
) -> Results:
    """In this process: a task that fails, with an InputError too, is at fault at once."""
    for index, (rows, *arguments) in enumerate(tasks):
        try:
            result = function(candidates[rows], *arguments)
        except Exception as error:
            raise TaskError(index, _one_line(error)) from error
        yield index, result


def _one_line(error: BaseException) -> str:
    name = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
    return f"{name}{error}".replace("\n", " ")[:300]


def _in_time(seconds: float, function: Callable | bytes, *arguments):
    """The function's result, or the end of this process."""
    work = pickle.loads(function).fn if isinstance(function, bytes) else function
    signal.alarm(math.ceil(seconds))
    try:
        return work(*arguments)
    finally:
        signal.alarm(0)


# ------------------------------------------------------------------- processes on this machine

# A worker runs the script of its parent once more, as a module, to find the functions in it.
NO_START = (
    "the worker processes do not start; a script that uses several workers must be a file, with "
    'this call under `if __name__ == "__main__":`'
)


def _begin(lifeline) -> None:
    """In a new process: leave Ctrl-C to the parent; end when it closes the pipe, or dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end() -> None:
        lifeline.poll(None)
        os._exit(1)

    threading.Thread(target=end, daemon=True).start()


def _packed(function: Callable) -> Callable | bytes:
    """The function, or in bytes for workers that cannot run this process's script once more.

    Raises:
        InputError: it holds what cannot be sent.
    """
    if getattr(sys.modules["__main__"], "__file__", None):
        return function
    try:  # Gymnasium's wrapper sends the classes of a notebook as they are
        return pickle.dumps(CloudpickleWrapper(function))
    except Exception as error:
        raise InputError(
            f"what is defined here cannot be sent to worker processes ({_one_line(error)}); write "
            "it into a module, or use workers=1"
        ) from None


class ProcessWorkers:
    """So many processes on this machine; they start when there is work, and `close` ends them.

    Each is a pool of its own: when one breaks, it is known which task was in it.
    """

    def __init__(self, count: int):
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            sys.exit(1)  # this is a worker that runs an unguarded script; its parent says so
        main = sys.modules["__main__"]
        if getattr(main, "__file__", None) == "<stdin>":  # `python - < script`
            del main.__file__  # a worker would look for it
        self.count = count
        # Not "fork": a forked child shares PyBullet clients and the locks of torch's threads.
        self._context = multiprocessing.get_context("forkserver")
        self._pools: dict[ProcessPoolExecutor, Future] = {}  # the future tells if it has started
        self._idle: list[ProcessPoolExecutor] = []

    def run(
        self, function: Callable, candidates: np.ndarray, tasks: Sequence[tuple], seconds: float
    ) -> Results:
        """See above; InputError also where no process starts."""
        packed, waiting = _packed(function), deque(range(len(tasks)))
        failures: Counter[int | str] = Counter()
        running: dict[Future, tuple[int, ProcessPoolExecutor]] = {}
        try:
            while waiting or running:
                while waiting and len(running) < self.count:
                    pool = self._idle.pop() if self._idle else self._start()
                    rows, *arguments = tasks[waiting[0]]
                    work = seconds, packed, candidates[rows], *arguments
                    try:
                        future = pool.submit(_in_time, *work)
                    except BrokenProcessPool:  # it died while it was idle; the task still waits
                        del self._pools[pool]
                    else:
                        running[future] = waiting.popleft(), pool
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    index, pool = running.pop(future)
                    culprit: int | str = index
                    fault: InputError | TaskError
                    match future.exception():
                        case None:
                            self._idle.append(pool)
                            yield index, future.result()
                            continue
                        case InputError() as error:
                            raise error
                        case BrokenProcessPool():
                            fault = TaskError(index, f"its process died, or hung {seconds:.0f} s")
                            if self._pools.pop(pool).exception():
                                culprit, fault = NO_START, InputError(NO_START)
                        case error:
                            self._idle.append(pool)
                            fault = TaskError(index, _one_line(error))
                    failures[culprit] += 1
                    if failures[culprit] == MAX_FAILURES:
                        raise fault
                    if culprit is not NO_START:
                        remark(f"designrl: {fault}; it is done again")
                    waiting.append(index)  # last, when all that died while idle have been found
        except BaseException:
            self.close()  # nobody wants what still runs
            raise

    def _start(self) -> ProcessPoolExecutor:
        if not self._pools:
            self._theirs, self._lifeline = self._context.Pipe(duplex=False)
        for attempt in range(MAX_FAILURES):
            pool = ProcessPoolExecutor(1, self._context, _begin, (self._theirs,))
            try:
                self._pools[pool] = pool.submit(int)
                return pool
            except ConnectionError:  # what forks them was killed this moment; it starts again
                pool.shutdown()
                time.sleep(attempt)
        raise InputError(NO_START)

    def close(self) -> None:
        """End the processes, whatever they do."""
        if self._pools:
            self._lifeline.close()
        for pool in self._pools:
            pool.shutdown()
        self._pools.clear()
        self._idle.clear()


# -------------------------------------------------------------------------------- a Ray cluster


def _on_node(sources: str, candidates: np.ndarray, work: bytes):
    """A task's result, or the InputError that ends the run."""
    if sources_hash() != sources:  # before anything of ours is unpacked
        return InputError(
            f"a node of the Ray cluster has another version of designrl (sources {sources_hash()}, "
            f"here {sources}); install the same one everywhere"
        )
    seconds, function, (rows, *arguments) = pickle.loads(work)
    try:
        return _in_time(seconds, function, candidates[rows], *arguments)
    except InputError as error:
        return error


# Read when Ray is imported: a cluster that no other machine is to join, and no reports of its use.
LOCAL_RAY = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}


def _check_reachable(address: str) -> None:
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except (OSError, ValueError, OverflowError) as error:
        raise InputError(
            f"no Ray cluster at {address} ({_one_line(error)}); write HOST:PORT, or auto"
        ) from None


class RayWorkers:
    """All cores of a Ray cluster, of which nodes may leave and join; `close` leaves it.

    The candidates travel once per generation to each node, tasks and results are small.

    Args:
        address: "local", for a cluster on this machine that ends with this process and listens on
            127.0.0.1 alone, or that of an existing cluster, as Ray takes it. Its nodes need this
            package and its libraries. Where this process is in a cluster already, "local" and
            "auto" are that one, and `close` leaves it as it is.

    Raises:
        InputError: Ray is not installed; there is no cluster at that address, or this process is in
            another one.
    """

    def __init__(self, address: str):
        if address == "local":
            os.environ |= LOCAL_RAY
        with optional("Ray", "ray", "pip install -c requirements-extras.lock ray"):
            import ray
        self._ray, self._is_ours = ray, not ray.is_initialized()
        if self._is_ours:
            self._join(address)
        elif address not in ("local", "auto", ray.get_runtime_context().gcs_address):
            raise InputError(
                f"this process is in the Ray cluster at {ray.get_runtime_context().gcs_address} "
                f"already; use that, or leave it with ray.shutdown() to use {address}"
            )
        retries: dict[str, Any] = {"max_retries": MAX_FAILURES - 1, "retry_exceptions": True}
        self._task = ray.remote(num_cpus=1, **retries)(_on_node)
        self._said_to_wait = False

    def _join(self, address: str) -> None:
        ray = self._ray
        if address not in ("local", "auto") and "://" not in address:
            _check_reachable(address)  # Ray itself would try for minutes
        polite_kill = signal.getsignal(signal.SIGTERM)
        # Without an address, Ray would join a cluster that runs on this machine, or did.
        alone = {"include_dashboard": False} if address == "local" else {}
        try:
            ray.init(address, **alone, log_to_driver=False, logging_level="ERROR")
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise InputError(f"no Ray cluster at {address} ({_one_line(error)})") from None
        finally:
            if threading.current_thread() is threading.main_thread():
                signal.signal(signal.SIGTERM, polite_kill)  # Ray has put its own in place
        here = ray.util.get_node_ip_address()
        if address == "local" and not ipaddress.ip_address(here).is_loopback:
            ray.shutdown()
            raise InputError(
                "Ray was imported before and would listen on every interface; let designrl import "
                'it, or set RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0 before "import ray"'
            )

    @property
    def count(self) -> int:
        """Cores of the cluster as it is now, at least 1."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 0)))

    def run(
        self, function: Callable, candidates: np.ndarray, tasks: Sequence[tuple], seconds: float
    ) -> Results:
        """See above; InputError also where a node has no designrl, or another version."""
        ray = self._ray
        candidates = ray.put(candidates)
        running = {}
        for index, task in enumerate(tasks):
            work = ray.cloudpickle.dumps((seconds, function, task))
            running[self._task.remote(sources_hash(), candidates, work)] = index
        last = time.monotonic()
        try:
            while running:
                done, _ = ray.wait(list(running), num_returns=len(running), timeout=0.1)
                for answer in done:
                    index, last = running.pop(answer), time.monotonic()
                    try:
                        result = ray.get(answer)
                    except ray.exceptions.RayError as error:
                        reason = _one_line(getattr(error, "cause", error))
                        if "failed to import" in reason:
                            raise InputError(
                                f"a node of the Ray cluster cannot load designrl ({reason}); "
                                "install this version there"
                            ) from None
                        raise TaskError(index, reason) from None
                    if isinstance(result, InputError):
                        raise result
                    yield index, result
                if time.monotonic() - last > PATIENCE_SECONDS and not self._said_to_wait:
                    self._said_to_wait = True
                    remark(
                        f"designrl: no result from the Ray cluster for {PATIENCE_SECONDS:.0f} s; "
                        "where it has no free core (see `ray status`), the run waits for one"
                    )
        finally:
            for answer in running:  # after an exception or an interrupt
                ray.cancel(answer, force=True)

    def close(self) -> None:
        """Leave the cluster."""
        if self._is_ours:
            self._ray.shutdown()
