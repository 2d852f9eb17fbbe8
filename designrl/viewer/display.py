"""Whether there is a display to open a window on, found out without a window."""

import os
import socket
import sys
from pathlib import Path

from designrl.errors import InputError

TIMEOUT = 1.0  # s, of a display on another machine


def require_display() -> None:
    """Raise InputError where no display can be opened.

    Rerun's viewer would end at once, and Rerun wait for it in vain, with pages of warnings.
    """
    if sys.platform != "linux" or os.environ.get("WAYLAND_SOCKET"):
        return
    wayland, x11 = os.environ.get("WAYLAND_DISPLAY"), os.environ.get("DISPLAY")
    if (wayland and _opens_wayland(wayland)) or (x11 and _opens_x11(x11)):
        return
    what = "there is no display to open Rerun on"
    if wayland or x11:
        what = f"the display {wayland or x11} cannot be opened"
    raise InputError(f"{what}; add --web, --save FILE.rrd or --headless-screenshot FILE.png")


def _opens_wayland(name: str) -> bool:
    return _connects(str(Path(os.environ.get("XDG_RUNTIME_DIR", ""), name)))


def _opens_x11(name: str) -> bool:
    """Of "HOST:DISPLAY.SCREEN": without a host, by a socket in /tmp or its abstract twin."""
    host, _, display = name.rpartition(":")
    display = display.partition(".")[0]
    if not display.isdigit():
        return False
    if host in ("", "unix"):
        path = f"/tmp/.X11-unix/X{display}"
        return _connects(path) or _connects(f"\0{path}")
    try:
        socket.create_connection((host, 6000 + int(display)), TIMEOUT).close()
    except (OSError, OverflowError):
        return False
    return True


def _connects(path: str) -> bool:
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(TIMEOUT)
        try:
            client.connect(path)
        except OSError:
            return False
    return True
