"""Where simulations run: in this process, or in a pool of processes."""

import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from designrl.errors import InputError

MAX_POOL_FAILURES = 3  # in a row, before a task that kills its workers is blamed


def run_here(function: Callable, tasks: Sequence[tuple]) -> Iterator[tuple[int, object]]:
    """Yield (index, function(*task)) for each task, in this process."""
    for index, task in enumerate(tasks):
        yield index, function(*task)


def _start_worker() -> None:
    # Ctrl-C is the parent's to handle; it ends the workers in good order.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class ProcessWorkers:
    """A pool of processes that survives the death of its workers.

    Args:
        count: processes, at least 1.
    """

    def __init__(self, count: int):
        self._count = count
        self._pool: ProcessPoolExecutor | None = None

    def _executor(self) -> ProcessPoolExecutor:
        if self._pool is None:
            # Not "fork": a forked child shares PyBullet clients and the locks of torch's threads.
            self._pool = ProcessPoolExecutor(
                self._count,
                mp_context=multiprocessing.get_context("forkserver"),
                initializer=_start_worker,
            )
        return self._pool

    def run(self, function: Callable, tasks: Sequence[tuple]) -> Iterator[tuple[int, object]]:
        """Yield (index, function(*task)) as tasks end, in any order.

        A worker that dies is replaced and the unfinished tasks are done again.

        Raises:
            InputError: workers died three times in a row without finishing a task.
        """
        waiting = dict(enumerate(tasks))
        failures = 0
        while waiting:
            futures = {self._executor().submit(function, *t): i for i, t in waiting.items()}
            try:
                for future in as_completed(futures):
                    result = future.result()
                    failures = 0
                    del waiting[futures[future]]
                    yield futures[future], result
            except BrokenProcessPool:
                failures += 1
                self.close()
                if failures == MAX_POOL_FAILURES:
                    raise InputError(
                        f"worker processes died {failures} times in a row; look for a lack of "
                        "memory, or use fewer with --workers"
                    ) from None
                print(
                    f"designrl: a worker process died; {len(waiting)} tasks are done again",
                    file=sys.stderr,
                )

    def close(self) -> None:
        """End the processes; unfinished tasks are dropped."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None
