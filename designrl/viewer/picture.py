"""A picture of Rerun's own viewer, without a window."""

import contextlib
import io
import re
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import rerun_cli
from PIL import Image
from rerun.experimental import ViewerClient

from designrl.errors import InputError

# `rerun` in an environment is a script that starts this one and waits.
EXECUTABLE = Path(rerun_cli.__file__).with_name("rerun")
WINDOW_SIZE, BAR_HEIGHT = "1600x1000", 36  # pixels
START_SECONDS = 30.0  # that a viewer without window may take to start
NOTICES_SECONDS = 6.0  # at least, until the viewer's own notices are gone from a picture
STILL_SECONDS = 60.0  # at most, until two pictures in a row are the same
NO_DRIVER_MESSAGE = r"No graphics adapter|render context"  # what the viewer says without a driver
NO_DRIVER = (
    "no picture: Rerun's viewer found no Vulkan driver; on Debian and Ubuntu, a software one "
    "comes with: apt-get install mesa-vulkan-drivers"
)


def take_picture(rrd: Path, timeline: str, at: int | float) -> bytes:
    """The picture (PNG) of a viewer that shows an .rrd file, at a generation or s of a timeline.

    Raises:
        InputError: there is no graphics driver, not even a software one.
    """
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    command = [EXECUTABLE, rrd, "--headless", "--window-size", WINDOW_SIZE]
    command += ["--bind", "127.0.0.1", "--port", port]
    with (
        tempfile.TemporaryFile() as log,
        subprocess.Popen(command, stdout=log, stderr=log) as process,
    ):
        try:
            viewer = _connect(process, f"rerun+http://127.0.0.1:{port}/proxy")
            place = {"sequence" if isinstance(at, int) else "duration": at}
            viewer.set_time(timeline, play_state="paused", **place)
            return _without_bar(_still_picture(viewer))
        except RuntimeError as error:
            log.seek(0)
            no_driver = re.search(NO_DRIVER_MESSAGE.encode(), log.read())
            raise InputError(NO_DRIVER if no_driver else f"no picture: {error}") from None
        finally:
            process.kill()


def _still_picture(viewer: ViewerClient) -> bytes:
    """The picture, once it has stopped changing."""
    start, last = time.monotonic(), b""
    while True:
        # From the start on: the notices' time passes with the pictures that are drawn.
        picture = viewer.take_screenshot()
        passed = time.monotonic() - start
        if (passed > NOTICES_SECONDS and picture == last) or passed > STILL_SECONDS:
            return picture
        last = picture
        time.sleep(0.5)


def _without_bar(picture: bytes) -> bytes:
    """The picture without the strip at the top that the layout's hidden bar leaves."""
    image, data = Image.open(io.BytesIO(picture)), io.BytesIO()
    image.crop((0, BAR_HEIGHT, *image.size)).save(data, "PNG", optimize=True)
    return data.getvalue()


def _connect(process: subprocess.Popen, url: str) -> ViewerClient:
    """The viewer of a process, once it has opened its recording.

    Raises:
        RuntimeError: the process has ended, or is not ready within START_SECONDS.
    """
    deadline = time.monotonic() + START_SECONDS
    while process.poll() is None and time.monotonic() < deadline:
        with contextlib.suppress(RuntimeError, ConnectionError):
            viewer = ViewerClient.connect(url)
            state = viewer.get_state()
            if state.recordings and not state.loading:
                return viewer
        time.sleep(0.1)
    raise RuntimeError("Rerun's viewer did not start")
