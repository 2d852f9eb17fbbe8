"""A picture of Rerun's own viewer, without a window."""

import io
import time

from PIL import Image
from rerun.experimental import ViewerClient

from designrl.errors import InputError
from designrl.viewer.executable import Rerun

WINDOW_SIZE, BAR_HEIGHT = "1600x1000", 36  # pixels
NOTICES_SECONDS = 6.0  # at least, until the viewer's own notices are gone from a picture
STILL_SECONDS = 60.0  # at most, until two pictures in a row are the same
NO_DRIVER_MESSAGE = r"(No graphics adapter|render context)"  # what it says without a driver
NO_DRIVER = (
    "no picture: Rerun's viewer found no Vulkan driver; on Debian and Ubuntu, a software one "
    "comes with: apt-get install mesa-vulkan-drivers"
)


def take_picture(rrd: bytes, timeline: str, at: int | float) -> bytes:
    """The picture (PNG) of a viewer that shows an .rrd file, at a generation or s of a timeline.

    Raises:
        InputError: there is no graphics driver, not even a software one.
    """
    with Rerun("--headless", "--window-size", WINDOW_SIZE, rrd=rrd) as rerun:
        try:
            viewer = rerun.viewer()
            _go_to(viewer, timeline, {"sequence" if isinstance(at, int) else "duration": at})
            return _without_bar(_still_picture(viewer))
        except RuntimeError as error:
            reason = NO_DRIVER if rerun.says(NO_DRIVER_MESSAGE) else f"no picture: {error}"
            raise InputError(reason) from None


def _go_to(viewer: ViewerClient, timeline: str, place: dict) -> None:
    start = time.monotonic()
    while True:
        try:
            viewer.set_time(timeline, play_state="paused", **place)
            return
        except ConnectionError as error:  # it has not read the data yet
            if time.monotonic() - start > STILL_SECONDS:
                raise RuntimeError(str(error)) from None
        time.sleep(0.1)


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
