"""Recordings in Rerun, in a layout made for them.

    designrl replay rollout.mcap
    designrl replay runs/biped-morphology/seed0          # a run's folder: learning and rollouts
    designrl replay a.mcap b.mcap --save both.rrd
    designrl replay rollout.mcap --headless-screenshot picture.png

The layout (`viewer.layout`) and the data (`viewer.data`) are made apart, both without a window.
A run is on the timeline `generation`, a rollout on the timeline `time` (s of simulated time).
"""

import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import rerun as rr

from designrl.errors import InputError
from designrl.recording import read
from designrl.viewer.data import log_recording
from designrl.viewer.layout import blueprint
from designrl.viewer.picture import EXECUTABLE, take_picture

MAX_ROLLOUTS = 6  # of a run's folder that are opened; name files to open others


def replay(paths, save: str | Path | None = None, screenshot: str | Path | None = None) -> None:
    """Open recordings in Rerun, or write them as an .rrd file, or as a picture, or both.

    Args:
        paths: recordings, or folders of runs.
        save: .rrd file to write instead of opening a viewer.
        screenshot: PNG file to write instead of opening a viewer, through a viewer without window.

    Raises:
        InputError: nothing to open, a file that cannot be read or written, no graphics driver.
    """
    recordings = [read(path) for path in find_recordings(paths)]
    names = unique_names([recording.path for recording in recordings])
    layout = blueprint(recordings, names)
    stream = rr.RecordingStream("designrl")
    with tempfile.TemporaryDirectory() as folder:
        if save is None and screenshot is None:
            # Where the environment is not activated, Rerun would not find its own viewer.
            os.environ["PATH"] = f"{EXECUTABLE.parent}{os.pathsep}{os.environ.get('PATH', '')}"
            stream.spawn(default_blueprint=layout)
        else:
            target = Path(save) if save is not None else Path(folder) / "replay.rrd"
            _write(target, b"")  # Rerun itself would say nothing
            stream.save(target, default_blueprint=layout)
        for recording, name in zip(recordings, names, strict=True):
            log_recording(stream, recording, name)
        stream.flush()
        stream.disconnect()
        if screenshot is not None:
            middle = recordings[0].seconds / 2 if recordings[0].kind == "rollout" else None
            _write(Path(screenshot), take_picture(target, middle))


def _write(path: Path, data: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    except OSError as error:
        raise InputError(
            f"{path} cannot be written ({error.strerror}); choose another place"
        ) from None


def find_recordings(paths) -> list[Path]:
    """The recordings that some paths mean: themselves, or what the folders of runs hold.

    Raises:
        InputError: a folder without recordings.
    """
    found = []
    for path in map(Path, paths):
        if not path.is_dir():
            found.append(path)
            continue
        runs = sorted(path.glob("generations.mcap"))
        rollouts = sorted([*path.glob("rollouts/*.mcap"), *(set(path.glob("*.mcap")) - set(runs))])
        if not runs + rollouts:
            raise InputError(f"{path} holds no recordings; name a .mcap file or a run's folder")
        if len(rollouts) > MAX_ROLLOUTS:
            chosen = np.linspace(0, len(rollouts) - 1, MAX_ROLLOUTS).round().astype(int)
            print(f"{path}: showing {MAX_ROLLOUTS} of {len(rollouts)} rollouts", file=sys.stderr)
            rollouts = [rollouts[i] for i in chosen]
        found += runs + rollouts
    return found


def unique_names(paths: list[Path]) -> list[str]:
    """A short name for each file, no two the same."""
    names = [path.stem for path in paths]
    return [
        name if names.count(name) == 1 else f"{path.resolve().parent.name} {name} {i}"
        for i, (path, name) in enumerate(zip(paths, names, strict=True))
    ]
