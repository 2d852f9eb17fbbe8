"""Rerun's executable: as we start it, it listens on 127.0.0.1 alone and reports nothing."""

import contextlib
import ctypes
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import rerun_cli
from rerun.experimental import ViewerClient

from designrl.errors import InputError

# `rerun` in an environment is a script that starts this one and waits.
EXECUTABLE = Path(rerun_cli.__file__).with_name("rerun")
START_SECONDS = 30.0  # that it may take to start
# Rerun sends no telemetry from where CI is set, unless FORCE_RERUN_ANALYTICS is, too; its window
# asks GitHub for a newer Rerun, unless its settings forbid it. At "info", it says where it listens.
ENVIRONMENT = {"CI": "true", "RUST_LOG": "info", "NO_COLOR": "1"}
LISTENING = r"Listening for gRPC connections on (127\.0\.0\.1:\d+)"
_C = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1


def _end_with_parent() -> None:
    _C.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


class Rerun:
    """A process of Rerun's; it ends with the `with` block, or when this process is killed.

    Args:
        options: of its command line.
        rrd: what it shows. It comes through a file without a name: nobody else can answer for the
            viewer and get it, and a kill leaves nothing behind.
        stays: it goes on when this process ends.

    Raises:
        InputError: it cannot be started.
    """

    def __init__(self, *options: str, rrd: bytes | None = None, stays: bool = False):
        command = [EXECUTABLE, *options, "--bind", "127.0.0.1", "--port", "0"]
        tied = sys.platform == "linux" and not stays
        try:
            self._log = tempfile.TemporaryFile()  # noqa: SIM115
            with tempfile.TemporaryFile() as data:
                if rrd is not None:
                    command.append("-")
                    data.write(rrd)
                    data.seek(0)
                self._process = subprocess.Popen(
                    command,
                    stdin=data,
                    stdout=self._log,
                    stderr=self._log,
                    env=os.environ | ENVIRONMENT,
                    start_new_session=stays,
                    preexec_fn=_end_with_parent if tied else None,
                )
        except OSError as error:
            raise InputError(f"Rerun cannot be started ({error.strerror})") from None

    def __enter__(self):
        return self

    def __exit__(self, *_) -> None:
        self._process.kill()
        self._process.wait()
        self._log.close()

    def has_failed(self) -> bool:
        """It has ended, and not because its window was closed."""
        return bool(self._process.poll())

    def says(self, pattern: str) -> str | None:
        """What matches the pattern's group in all that it has said."""
        # Not by seek and read: the process writes where the file is read.
        log = os.pread(self._log.fileno(), 2**20, 0).decode(errors="replace")
        found = re.search(pattern, log)
        return found and found[1]

    def last_words(self) -> str:
        """The last line that it has said, without the place in Rerun's sources."""
        said = self.says(r"(.*)\s*\Z") or "it says nothing"
        return re.sub(r" at /\S+:\d+", "", said)

    def wait_for(self, what: Callable):
        """The first true result of a function.

        Raises:
            RuntimeError: the process has ended, or there is none within START_SECONDS.
        """
        deadline = time.monotonic() + START_SECONDS
        while self._process.poll() is None and time.monotonic() < deadline:
            if result := what():
                return result
            time.sleep(0.1)
        raise RuntimeError(f"Rerun did not start ({self.last_words()})")

    def viewer(self) -> ViewerClient:
        """A connection to the viewer, once it has opened what it is to show.

        Raises:
            RuntimeError: as above.
        """
        return self.wait_for(self._open_viewer)

    def _open_viewer(self) -> ViewerClient | None:
        address = self.says(LISTENING)
        if address:
            with contextlib.suppress(RuntimeError, ConnectionError):
                viewer = ViewerClient.connect(f"rerun+http://{address}/proxy")
                state = viewer.get_state()
                if state.recordings and not state.loading:
                    return viewer
        return None
