"""Recordings in Rerun, in a layout made for them.

    designrl replay rollout.mcap
    designrl replay runs/biped-morphology/seed0          # a run's folder: learning and rollouts
    designrl replay a.mcap b.mcap --save both.rrd
    designrl replay rollout.mcap --headless-screenshot picture.png
    designrl replay biped/seed0 biped/seed1              # their learning curves in one plot, too
    designrl replay rollout.mcap --web                   # in a browser, also through ssh

The layout (`viewer.layout`) and the data (`viewer.data`) are made apart, both without a window.
A run is on the timeline `generation`, a rollout on the timeline `time` (s of simulated time).
"""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from designrl.errors import InputError, optional, remark

with optional("the viewer", "view"):
    import rerun as rr
    import rerun.experimental  # noqa: F401

from designrl.files import require_new, write_atomically
from designrl.recording import Recording, read
from designrl.recording.reader import how_far
from designrl.viewer.data import log_comparison, log_recording
from designrl.viewer.executable import Rerun
from designrl.viewer.layout import GENERATION, TIME, blueprint, last_generation, runs_of
from designrl.viewer.picture import take_picture
from designrl.viewer.web import serve

MAX_ROLLOUTS = 6  # of a run's folder that are opened; name files to open others


def replay(
    paths,
    save: str | Path | None = None,
    screenshot: str | Path | None = None,
    at: float | None = None,
    web: tuple[str, int] | None = None,
    say: Callable[[Path], None] = lambda path: None,
) -> None:
    """Open recordings in Rerun, or write them as an .rrd file or a picture, or serve them.

    Args:
        paths: recordings, or folders of runs.
        save: .rrd file to write instead of opening a viewer.
        screenshot: PNG file to write instead of opening a viewer, through a viewer without window.
        at: what the picture shows: of a run the generation, as an index, of a rollout s of its
            time; else a run's last generation, or the middle of a rollout.
        web: address and port to serve them at to browsers, until Ctrl-C, instead of opening a
            viewer.
        say: called with the file of each recording that is shown.

    Raises:
        InputError: a file that cannot be read or written or that exists already,
            no display, no graphics driver, a port that is not free.
    """
    paths = [Path(path) for path in paths]
    targets = [Path(path) for path in (save, screenshot) if path is not None]
    _check_targets(targets, paths)
    recordings = _read_usable(paths)
    moment = _moment(recordings[0], at)  # refuses it before anything is written
    if save is not None:
        write_atomically(save, _as_rrd(recordings))
    if screenshot is not None:
        picture = take_picture(_as_rrd(recordings, for_picture=True), *moment)
        write_atomically(screenshot, picture)
    rrd = b"" if targets and web is None else _as_rrd(recordings)
    for recording in recordings:
        say(recording.path)
    if web is not None:
        serve(rrd, *web)
    elif not targets:
        _open_window(rrd)


def _open_window(rrd: bytes) -> None:
    rerun = Rerun(rrd=rrd, stays=True)
    with suppress(RuntimeError):  # slow, but there
        rerun.viewer()
    if rerun.has_failed():
        raise InputError(
            f"Rerun's viewer did not start ({rerun.last_words()}); where there is no display, add "
            "--web, --save FILE.rrd or --headless-screenshot FILE.png"
        )


def _as_rrd(recordings: list[Recording], for_picture: bool = False) -> bytes:
    names = unique_names([recording.path for recording in recordings])
    layout = blueprint(recordings, names, for_picture)
    # Not straight to a file: Rerun would leave a torn one where the disk is full.
    stream = rr.RecordingStream("designrl")
    memory = stream.memory_recording()
    # The web viewer takes no notice of a layout that is only the default.
    stream.send_blueprint(layout, make_active=True, make_default=True)
    try:
        for recording, name in zip(recordings, names, strict=True):
            log_recording(stream, recording, name)
        if len(runs := runs_of(recordings)) > 1:
            log_comparison(stream, runs)
        stream.flush()
    finally:
        data = memory.drain_as_bytes()  # after an error, too: Rerun would warn of what it drops
        stream.disconnect()
    return data


def _moment(recording: Recording, at: float | None) -> tuple[str, int | float]:
    """The timeline and the place on it that a picture of a recording shows.

    Raises:
        InputError: `at` is not within the recording.
    """
    if recording.kind == "run":
        timeline, end, default = GENERATION, last_generation(recording), last_generation(recording)
    else:
        timeline, end, default = TIME, recording.seconds, recording.seconds / 2
    at = default if at is None else at
    if not 0 <= at <= end:
        unit = "generations" if timeline == GENERATION else "s"
        raise InputError(f"{recording.path} goes from 0 to {end:g} {unit}, --at is {at:g}")
    return timeline, int(at) if timeline == GENERATION else float(at)


def _read_usable(paths: list[Path]) -> list[Recording]:
    """The recordings; of a folder's, those that can be read, and a sentence for each other."""
    recordings, last = [], None
    for path in find_recordings(paths):
        try:
            recording = read(path)
            if not any(recording.topics.values()):
                reason = recording.problem or "it has no messages"
                mend = "get it again, or record it anew"
                raise InputError(f"{path} holds nothing to show ({reason}); {mend}")
        except InputError as error:
            if path in paths:
                raise
            remark(f"not shown: {error}")
            last = error
        else:
            if recording.problem:
                what = f"{path} is not whole ({recording.problem}): {how_far(recording)}"
                remark(f"{what}; get it again, or record it anew, for the rest")
            recordings.append(recording)
    if last and not recordings:
        raise last
    return recordings


def _check_targets(targets: list[Path], sources: list[Path]) -> None:
    inputs = {source.resolve() for source in sources}
    for target in targets:
        if target.resolve() in inputs:
            raise InputError(f"{target} is what is to be replayed; choose another name to write")
        require_new(target)
    if len({target.resolve() for target in targets}) < len(targets):
        raise InputError(f"{targets[0]} cannot be both; choose another name for the picture")


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
            remark(f"{path}: showing {MAX_ROLLOUTS} of {len(rollouts)} rollouts")
            rollouts = [rollouts[i] for i in chosen]
        found += runs + rollouts
    return found


def unique_names(paths: list[Path]) -> list[str]:
    """A short name for each file, no two the same."""
    names = [path.stem.encode(errors="replace").decode() for path in paths]  # Rerun takes UTF-8
    return [
        name if names.count(name) == 1 else f"{path.resolve().parent.name} {name} {i}"
        for i, (path, name) in enumerate(zip(paths, names, strict=True))
    ]
