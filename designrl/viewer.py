"""Recordings in Rerun, in a layout made for them.

    designrl replay rollout.mcap
    designrl replay runs/biped-morphology/seed0          # a run's folder: learning and rollouts
    designrl replay a.mcap b.mcap --save both.rrd
    designrl replay rollout.mcap --headless-screenshot picture.png

The layout (`blueprint`) and the data (`log_recording`) are made apart, and both without a window.
A run is on the timeline `generation`, a rollout on the timeline `time` (s of simulated time).
"""

import contextlib
import re
import socket
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun_cli
from rerun.experimental import ViewerClient

from designrl.design import ANT
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS
from designrl.recording import Recording, read
from designrl.recording.bodies import GROUND_COLOR, GROUND_HALF_WIDTH, OBSTACLE_COLOR
from designrl.recording.urdf import body_urdf

GENERATION, TIME = "generation", "time"
WINDOW_SIZE = "1600x1000"  # pixels
START_SECONDS = 30.0  # that a viewer without window may take to start
NOTICES_SECONDS = 6.0  # until the viewer's own notices are gone from a picture
NO_DRIVER = (
    "no picture: Rerun's viewer found no graphics driver; on Debian and Ubuntu, a software one "
    "comes with: apt-get install mesa-vulkan-drivers libxkbcommon-x11-0 libgl1 libegl1"
)
MAX_ROLLOUTS = 6  # of a run's folder that are opened; name files to open others
MAX_FIGURES = 300  # silhouettes of a run, evenly spaced over its generations
# rad: how a body stands where only its design is shown; other joints are in mid-range.
POSE = {"hip 1": -0.35, "knee 1": -0.2, "hip 2": 0.5, "knee 2": -0.5}
FIGURE_AT = {False: (-2.6, 0.0, 0.0), True: (0.0, 3.0, 0.0)}  # m: the original beside the mean; ant
SKY = (215, 215, 255)  # Gymnasium's
PALETTE = np.array(
    [  # eight colors that remain apart for the color-blind (after Okabe and Ito), lightened
        (86, 180, 233),
        (230, 159, 0),
        (0, 178, 135),
        (240, 228, 66),
        (204, 121, 167),
        (213, 94, 0),
        (120, 140, 255),
        (200, 200, 200),
    ],
    dtype=np.uint8,
)


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
    stream = rr.RecordingStream("designrl")
    layout = blueprint(recordings, names)
    with contextlib.ExitStack() as stack:
        if save is None and screenshot is None:
            stream.spawn(default_blueprint=layout)
        else:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            target = Path(save) if save is not None else Path(folder) / "replay.rrd"
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                target.open("ab").close()
            except OSError as error:
                raise InputError(
                    f"{target} cannot be written ({error.strerror}); choose another place"
                ) from None
            stream.save(target, default_blueprint=layout)
        for recording, name in zip(recordings, names, strict=True):
            log_recording(stream, recording, name)
        stream.flush()
        stream.disconnect()
        if screenshot is not None:
            take_screenshot(target, screenshot, recordings[0])


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


def _escape(name: str) -> str:
    return rr.escape_entity_path_part(name)


# ------------------------------------------------------------------------------------- layout


def blueprint(recordings: list[Recording], names: list[str]) -> rrb.Blueprint:
    """The layout: a tab per recording; the timeline is that of the first one."""
    makers = {"run": run_layout, "rollout": rollout_layout}
    tabs = []
    for recording, name in zip(recordings, names, strict=True):
        if recording.kind not in makers:
            raise InputError(f"{recording.path} is not a recording of designrl; name one of those")
        tabs.append(makers[recording.kind](recording, name))
    first_is_run = recordings[0].kind == "run"
    return rrb.Blueprint(
        tabs[0] if len(tabs) == 1 else rrb.Tabs(*tabs),
        rrb.TimePanel(
            state="collapsed",
            timeline=GENERATION if first_is_run else TIME,
            play_state="following" if first_is_run else "playing",
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def rollout_layout(recording: Recording, title: str) -> rrb.Container:
    """The body from its side, and below it what it gets, does and feels."""
    name = _escape(title)
    walker = "/terrain" in recording.topics
    eye, target = ((1.0, -7.6, 0.5), (1.0, 0.0, -0.8)) if walker else ((-1.8, -3.2, 1.6), (0.1, 0, 0.1))
    return rrb.Vertical(
        rrb.Spatial3DView(
            name="body",
            origin=f"{name}/world/follow",
            contents=f"{name}/world/**",
            background=SKY,
            line_grid=False,
            eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0, 0, 1)),
        ),
        rrb.Horizontal(
            _plot("score", f"{name}/score"),
            _plot("reward terms, points per step", f"{name}/reward", window=3.0),
            _plot("actions", f"{name}/action", window=3.0),
            _plot("joint angles, rad", f"{name}/joints", window=3.0),
        ),
        row_shares=[2, 1],
        name=title,
    )


def run_layout(recording: Recording, title: str) -> rrb.Container:
    """Learning curve and sigma; the design's dimensions and the body that they make."""
    name = _escape(title)
    learning = rrb.Vertical(
        _plot("return: population mean ± 2 sd, best, evaluations", f"{name}/learning"),
        _plot("sigma: mean, smallest, largest parameter", f"{name}/sigma"),
        row_shares=[2, 1],
    )
    if not recording.topics.get("/design"):
        return rrb.Vertical(learning, name=title)
    unit = recording.unit("/design")
    plots = [
        _plot(f"{limb}, {unit} ± sigma", f"{name}/design/{_escape(limb)}")
        for limb in limbs(recording.names("/design"))
    ]
    is_ant = len(recording.names("/design")) == ANT.size
    eye, target = ((0, 1.49, 7.5), (0, 1.5, 0)) if is_ant else ((-1.3, -6.5, -0.9), (-1.3, 0, -1.3))
    body = rrb.Spatial3DView(
        name="body at the mean design; gray: original",
        origin=f"{name}/figure",
        background=SKY,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0, 0, 1)),
    )
    return rrb.Horizontal(
        learning,
        rrb.Vertical(body, rrb.Grid(*plots, grid_columns=2), row_shares=[1, 1]),
        name=title,
    )


def _plot(title: str, origin: str, window: float | None = None) -> rrb.TimeSeriesView:
    """A plot of everything, or of `window` s to either side of the cursor."""
    cursor = rrb.TimeRangeBoundary.cursor_relative
    x = window and rrb.TimeAxis(
        view_range=rrb.TimeRange(start=cursor(seconds=-window), end=cursor(seconds=window))
    )
    return rrb.TimeSeriesView(
        name=title, origin=origin, plot_legend=rrb.Corner2D.LeftTop, axis_x=x or None
    )


def limbs(names: list[str]) -> dict[str, list[int]]:
    """Limb -> indices of the dimensions that belong to it; a limb is one of the paper's legs."""
    found: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        leg = re.search(r"leg \d+", name)
        found.setdefault(leg[0] if leg else " ".join(name.split()[:2]), []).append(i)
    return found


# --------------------------------------------------------------------------------------- data


def log_recording(stream: rr.RecordingStream, recording: Recording, name: str) -> None:
    """Log a recording under the entity `name`.

    Raises:
        RecordingError: it cannot be read.
    """
    log = log_run if recording.kind == "run" else log_rollout
    log(stream, recording, _escape(name))


def _series(stream, path: str, when: rr.TimeColumn, values, names, styles=None) -> None:
    """Log (T, K) values as K lines, named and in the palette's colors."""
    values = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    styles = {"colors": PALETTE[np.arange(values.shape[1]) % len(PALETTE)], **(styles or {})}
    stream.log(path, rr.SeriesLines(names=list(names), **styles), static=True)
    stream.send_columns(path, [when], rr.Scalars.columns(scalars=values))


def log_run(stream: rr.RecordingStream, recording: Recording, name: str) -> None:
    """Learning curve, sigma, design and silhouettes of a run, on the timeline `generation`."""
    when = rr.TimeColumn(GENERATION, sequence=recording.generations.astype(np.int64))
    mean, sd, best, *sigma = (
        recording.array("/summary", field)
        for field in ("mean", "sd", "best", "sigma_mean", "sigma_min", "sigma_max")
    )
    blue, orange = PALETTE[0], PALETTE[1]
    _series(
        stream,
        f"{name}/learning/population",
        when,
        np.stack([mean, mean - 2 * sd, mean + 2 * sd, best], axis=1),
        ("population mean", "mean - 2 sd", "mean + 2 sd", "best of the population"),
        {"colors": [blue, blue // 2, blue // 2, PALETTE[7] // 2 + 30], "widths": [3, 1, 1, 1]},
    )
    _series(stream, f"{name}/sigma", when, np.stack(sigma, axis=1), ("mean", "smallest", "largest"))
    if recording.topics.get("/evaluation"):
        path = f"{name}/learning/evaluation"
        stream.log(
            path,
            rr.SeriesPoints(names="evaluation", colors=orange, marker_sizes=4, markers="diamond"),
            static=True,
        )
        at = recording.array("/evaluation", "generation").astype(np.int64)
        stream.send_columns(
            path,
            [rr.TimeColumn(GENERATION, sequence=at)],
            rr.Scalars.columns(scalars=recording.array("/evaluation", "mean")),
        )
    if recording.topics.get("/design"):
        _log_design(stream, recording, name)


def _log_design(stream, recording: Recording, name: str) -> None:
    generation = recording.array("/design", "generation").astype(np.int64)
    when = rr.TimeColumn(GENERATION, sequence=generation)
    sizes, lower, upper = (
        recording.array("/design", field) for field in ("dimensions", "lower", "upper")
    )
    names = recording.names("/design")
    for limb, indices in limbs(names).items():
        colors = PALETTE[np.arange(len(indices)) % len(PALETTE)]
        _series(
            stream,
            f"{name}/design/{_escape(limb)}",
            when,
            np.concatenate([sizes[:, indices], lower[:, indices], upper[:, indices]], axis=1),
            [names[i] for _ in range(3) for i in indices],
            {
                "colors": np.concatenate([colors, colors // 2, colors // 2]),
                "widths": [2.5] * len(indices) + [0.8] * 2 * len(indices),
            },
        )
    space = EXPERIMENTS[recording.metadata["experiment"]].body
    gray = _Robot(body_urdf(space, np.ones(space.size)), color=(150, 150, 150))
    gray.log(stream, f"{name}/figure/original", FIGURE_AT[space is ANT], static=True)
    for i in np.unique(np.linspace(0, len(sizes) - 1, MAX_FIGURES).round().astype(int)):
        stream.set_time(GENERATION, sequence=int(generation[i]))
        robot = _Robot(body_urdf(space, sizes[i] / space.originals))
        robot.log(stream, f"{name}/figure/mean", (0, 0, 0))
    stream.reset_time()


def log_rollout(stream: rr.RecordingStream, recording: Recording, name: str) -> None:
    """Body, ground, LIDAR and plots of a rollout, on the timeline `time`."""
    world = f"{name}/world"
    stream.log(world, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    when = _seconds(recording, "/tf")
    places = {"world": world}
    robot = _Robot(next(recording.messages("/robot_description")))
    for part, (parent, positions, quaternions) in recording.transforms().items():
        places[part] = path = f"{places[parent]}/{_escape(part)}"
        columns = rr.Transform3D.columns(translation=positions, quaternion=quaternions)
        stream.send_columns(path, [when], columns)
        robot.log_shapes(stream, part, path, static=True)
        if parent == "world":
            # Bumps of single steps would shake the picture: the eye follows a mean over a second.
            kernel = np.ones(51) / 51
            height = np.convolve(np.pad(positions[:, 2], 25, mode="edge"), kernel, mode="valid")
            eye = np.stack([positions[:, 0], positions[:, 1], height], axis=1)
            columns = rr.Transform3D.columns(translation=eye)
            stream.send_columns(f"{world}/follow", [when], columns)
    _log_ground(stream, recording, world)
    if recording.topics.get("/lidar"):
        x, z, end_x, end_z = (
            recording.array("/lidar", field) for field in ("origin_x", "origin_z", "end_x", "end_z")
        )
        rays = np.zeros((*end_x.shape, 2, 3), dtype=np.float32)
        rays[:, :, 0, 0], rays[:, :, 0, 2] = x[:, None], z[:, None]
        rays[:, :, 1, 0], rays[:, :, 1, 2] = end_x, end_z
        rays[..., 1] = -GROUND_HALF_WIDTH  # in front of the body
        lines = rr.LineStrips3D.columns(strips=rays.reshape(-1, 2, 3))
        columns = lines.partition(np.full(len(rays), rays.shape[1]))
        stream.send_columns(f"{world}/lidar", [_seconds(recording, "/lidar")], columns)
        style = rr.LineStrips3D.from_fields(colors=(255, 60, 60), radii=rr.Radius.ui_points(0.7))
        stream.log(f"{world}/lidar", style, static=True)
    for topic, field, path in (
        ("/reward", "terms", "reward"),
        ("/action", "values", "action"),
        ("/joints", "angles", "joints"),
    ):
        values, names = recording.array(topic, field), recording.names(topic)
        used = [i for i in range(len(names)) if values[:, i].any() and names[i] != "fall"]
        series = values[:, used], [names[i] for i in used]
        _series(stream, f"{name}/{path}", _seconds(recording, topic), *series)
    total = recording.array("/reward", "total")
    _series(stream, f"{name}/score", _seconds(recording, "/reward"), total, ["sum of rewards"])


def _seconds(recording: Recording, topic: str) -> rr.TimeColumn:
    return rr.TimeColumn(TIME, duration=recording.array(topic, "log_time") / 1e9)


class _Robot:
    """A URDF robot made of boxes, cylinders and spheres, as far as it takes to draw it.

    Attributes:
        shapes: link -> kind -> what to draw.
        joints: child -> parent, place in the parent's frame, axis, angle in `POSE` or mid-range.

    Raises:
        InputError: the text is not such a robot.
    """

    def __init__(self, text: str, color=None):
        try:
            root = ElementTree.fromstring(text)
            self.shapes = {
                link.get("name"): self._shapes(link, color) for link in root.iter("link")
            }
            self.joints = {
                joint.find("child").get("link"): self._joint(joint) for joint in root.iter("joint")
            }
        except (
            ElementTree.ParseError,
            AttributeError,
            IndexError,
            KeyError,
            TypeError,
            ValueError,
        ):
            raise InputError(
                "the recording's /robot_description is damaged; record it again"
            ) from None

    @staticmethod
    def _shapes(link, color) -> dict[str, rr.AsComponents]:
        kinds: dict[str, list] = {}
        for visual in link.iter("visual"):
            shape, origin = visual.find("geometry")[0], visual.find("origin")
            rgba = color or 255 * _floats(visual.find("material/color"), "rgba")
            sizes = np.concatenate([_floats(shape, key) for key in shape.attrib])
            row = sizes, _floats(origin, "xyz"), _quaternion(*_floats(origin, "rpy"))
            kinds.setdefault(shape.tag, []).append((*row, np.round(rgba).astype(np.uint8)))
        return {
            kind: _solid(kind, *map(np.array, zip(*rows, strict=True)))
            for kind, rows in kinds.items()
        }

    @staticmethod
    def _joint(joint) -> tuple[str, np.ndarray, np.ndarray, float]:
        place, axis, limit = _floats(joint.find("origin"), "xyz"), np.array([0, 0, 1.0]), (0.0, 0.0)
        if joint.get("type") == "revolute":
            axis = _floats(joint.find("axis"), "xyz")
            limit = [float(joint.find("limit").get(side)) for side in ("lower", "upper")]
        angle = POSE.get(joint.get("name"), sum(limit) / 2)
        return joint.find("parent").get("link"), place, axis, angle

    def log(self, stream: rr.RecordingStream, path: str, at, static: bool = False) -> None:
        """Log the robot in its pose, with its root at `at` (3,) in m."""
        paths = {"world": path}
        for part, (parent, place, axis, angle) in self.joints.items():
            paths[part] = f"{paths[parent]}/{_escape(part)}"
            pose = rr.Transform3D(
                translation=at if parent == "world" else place,
                rotation=rr.RotationAxisAngle(axis=axis, radians=angle),
            )
            stream.log(paths[part], pose, static=static)
            self.log_shapes(stream, part, paths[part], static)

    def log_shapes(self, stream: rr.RecordingStream, part: str, path: str, static: bool) -> None:
        """Log what is to be drawn of a part under its entity."""
        for kind, shape in self.shapes[part].items():
            stream.log(f"{path}/{kind}", shape, static=static)


def _floats(element, key: str) -> np.ndarray:
    return np.array([float(value) for value in element.get(key).split()])


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """x, y, z, w of URDF's angles: about x, then y, then z, all fixed."""
    (sr, sp, sy), (cr, cp, cy) = (f(np.array([roll, pitch, yaw]) / 2) for f in (np.sin, np.cos))
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _solid(kind: str, sizes, centers, quaternions, colors) -> rr.AsComponents:
    solid = {"colors": colors, "fill_mode": rr.components.FillMode.Solid}
    if kind == "box":
        return rr.Boxes3D(sizes=sizes, centers=centers, quaternions=quaternions, **solid)
    if kind == "cylinder":
        radii, lengths = sizes.T
        return rr.Cylinders3D(
            radii=radii, lengths=lengths, centers=centers, quaternions=quaternions, **solid
        )
    return rr.Ellipsoids3D(radii=sizes[:, 0], centers=centers, **solid)


def _log_ground(stream: rr.RecordingStream, recording: Recording, world: str) -> None:
    solid = {"fill_mode": rr.components.FillMode.Solid}
    if not recording.topics.get("/terrain"):
        low, high = (f(recording.transforms()["torso"][1], axis=0) for f in (np.min, np.max))
        (x0, y0), (x1, y1) = np.floor(low[:2]) - 6, np.ceil(high[:2]) + 6
        floor = rr.Boxes3D(
            mins=[(x0, y0, -0.1)], sizes=[(x1 - x0, y1 - y0, 0.095)], colors=GROUND_COLOR, **solid
        )
        stream.log(f"{world}/ground", floor, static=True)
        lines = [[(x, y0, 0), (x, y1, 0)] for x in np.arange(x0, x1 + 1)]
        lines += [[(x0, y, 0), (x1, y, 0)] for y in np.arange(y0, y1 + 1)]
        grid = rr.LineStrips3D(lines, colors=(90, 150, 78), radii=0.01)
        stream.log(f"{world}/meters", grid, static=True)
        return
    terrain = next(recording.messages("/terrain"))
    x, z = np.array(terrain.x), np.array(terrain.z)
    n, side, bottom = len(x), np.full(len(x), GROUND_HALF_WIDTH), np.full(len(x), z.min() - 4.0)
    # Three rows of points: the far edge, the near edge, and below it the foot of the front.
    points = np.concatenate(
        [np.stack(row, axis=1) for row in ((x, side, z), (x, -side, z), (x, -side, bottom))]
    )
    i = np.arange(n - 1)
    triangles = [
        [a + i, b + i, c + i]
        for row in (0, n)
        for a, b, c in ((row, row + n, row + 1), (row + 1, row + n, row + n + 1))
    ]
    shade = np.repeat([1.0, 1.0, 0.7], n)[:, None]
    mesh = rr.Mesh3D(
        vertex_positions=points,
        triangle_indices=np.concatenate([np.stack(t, axis=1) for t in triangles]),
        vertex_colors=np.uint8(np.array(GROUND_COLOR) * shade),
    )
    stream.log(f"{world}/ground", mesh, static=True)
    if terrain.obstacles:
        edge = GROUND_HALF_WIDTH + 0.02  # in front of the ground's face, so that both are seen
        boxes = np.array([(o.x_min, o.x_max, o.z_min, o.z_max) for o in terrain.obstacles])
        low = np.stack([boxes[:, 0], np.full(len(boxes), -edge), boxes[:, 2]], axis=1)
        high = np.stack([boxes[:, 1], np.full(len(boxes), edge), boxes[:, 3]], axis=1)
        shapes = rr.Boxes3D(mins=low, sizes=high - low, colors=OBSTACLE_COLOR, **solid)
        stream.log(f"{world}/obstacles", shapes, static=True)


# ------------------------------------------------------------------------------------ picture


def take_screenshot(rrd: Path, target: str | Path, recording: Recording) -> None:
    """Write a picture of a viewer that shows an .rrd file, at the middle of a rollout.

    Raises:
        InputError: there is no graphics driver, not even a software one, or the picture cannot be
            written.
    """
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    # Rerun's own executable: `rerun` in the environment is a script that starts it and waits.
    executable = Path(rerun_cli.__file__).with_name("rerun")
    command = [executable, "--headless", "--bind", "127.0.0.1", "--port", port, rrd.resolve()]
    with (
        tempfile.TemporaryFile() as log,
        subprocess.Popen(
            [*command, "--window-size", WINDOW_SIZE], stdout=log, stderr=log
        ) as process,
    ):
        try:
            viewer = _connect(process, f"rerun+http://127.0.0.1:{port}/proxy")
            if recording.kind == "rollout":
                viewer.set_time(TIME, duration=recording.seconds / 2, play_state="paused")
            time.sleep(NOTICES_SECONDS)
            picture = viewer.take_screenshot()
        except RuntimeError as error:
            log.seek(0)
            driver = b"adapter" in log.read() and process.poll() is not None
            raise InputError(NO_DRIVER if driver else f"no picture: {error}") from None
        finally:
            process.kill()
    try:
        Path(target).write_bytes(picture)
    except OSError as error:
        raise InputError(
            f"{target} cannot be written ({error.strerror}); choose another place"
        ) from None


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
