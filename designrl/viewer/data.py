"""What a recording holds, as Rerun entities: curves, poses, rays."""

import numpy as np
import rerun as rr

from designrl.bodies import ORIGINAL_AT, ORIGINAL_COLOR
from designrl.bodies.robot import Robot
from designrl.compare import labels
from designrl.recording import Recording
from designrl.viewer.drawing import log_floor, log_part, log_robot, log_terrain
from designrl.viewer.layout import COMPARED, GENERATION, TIME, body_of, entity, fit

MAX_FIGURES = 300  # bodies of a run that are drawn, evenly spaced over its generations
RED = (255, 60, 60)
PALETTE = np.array(
    [  # nine colors that remain apart for the color-blind (after Okabe and Ito), lightened
        (86, 180, 233),
        (230, 159, 0),
        (0, 178, 135),
        (240, 228, 66),
        (204, 121, 167),
        (213, 94, 0),
        (120, 140, 255),
        (200, 200, 200),
        (150, 100, 80),
    ],
    dtype=np.uint8,
)


def log_recording(stream: rr.RecordingStream, recording: Recording, name: str) -> None:
    """Log a recording under the entity `name`.

    Raises:
        RecordingError: it cannot be read, or lacks what its kind of recording holds.
    """
    log = log_run if recording.kind == "run" else log_rollout
    with fit(recording), np.errstate(over="ignore"):  # beyond the float32 that Rerun draws in
        log(stream, recording, entity(name))


def _series(stream, path: str, times: list[rr.TimeColumn], values, names, styles=None) -> None:
    """Log (T, K) values as K lines, named and in the palette's colors."""
    values = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    styles = {"colors": PALETTE[np.arange(values.shape[1]) % len(PALETTE)], **(styles or {})}
    stream.log(path, rr.SeriesLines(names=list(names), **styles), static=True)
    stream.send_columns(path, times, rr.Scalars.columns(scalars=values))


def log_run(stream: rr.RecordingStream, recording: Recording, name: str) -> None:
    """Learning curve, sigma, design and bodies of a run, on the timeline `generation`."""
    times = _generations(recording, "/summary")
    mean, sd, best, *sigma = (
        recording.array("/summary", field)
        for field in ("mean", "sd", "best", "sigma_mean", "sigma_min", "sigma_max")
    )
    blue, orange, green, white = PALETTE[[0, 1, 2, 7]]
    _series(
        stream,
        f"{name}/population",
        times,
        np.stack([mean, mean - 2 * sd, mean + 2 * sd, best], axis=1),
        ("mean", "± 2 sd", "± 2 sd", "best"),
        {"colors": [blue, blue // 2, blue // 2, white // 3 * 2], "widths": [3, 1, 1, 1]},
    )
    names = ("mean", "smallest", "largest")
    _series(stream, f"{name}/sigma", times, np.stack(sigma, axis=1), names)
    if recording.topics.get("/evaluation"):
        times, scores = (
            _generations(recording, "/evaluation"),
            recording.array("/evaluation", "mean"),
        )
        path, style = f"{name}/evaluation/each", {"markers": "diamond", "marker_sizes": 4}
        stream.log(path, rr.SeriesPoints(names="evaluation", colors=orange, **style), static=True)
        stream.send_columns(path, times, rr.Scalars.columns(scalars=scores))
        best = np.maximum.accumulate(scores)
        _series(stream, f"{name}/evaluation/best", times, best, ["best so far"], {"colors": green})
        _count_from_0(stream, f"{name}/evaluation/best")
    if recording.topics.get("/design"):
        _log_design(stream, recording, name)


def log_comparison(stream: rr.RecordingStream, runs: list[Recording]) -> None:
    """Log the learning curves of several runs under one entity, by what differs between them."""
    for i, (run, label) in enumerate(zip(runs, labels(runs), strict=True)):
        color = {"colors": PALETTE[[i % len(PALETTE)]]}
        for topic, plot in (("/summary", "population"), ("/evaluation", "evaluation")):
            if not run.topics.get(topic):
                continue
            with fit(run):
                means, times = run.array(topic, "mean"), _generations(run, topic)
            if topic == "/evaluation":
                means = np.maximum.accumulate(means)  # the best so far
            _series(stream, f"{COMPARED}/{plot}/{i}", times, means, [label], color)
            _count_from_0(stream, f"{COMPARED}/{plot}/{i}")


def _count_from_0(stream: rr.RecordingStream, path: str) -> None:
    # Rerun counts an axis from its first value on: without this, in 99, 1099, 2099.
    start = [rr.TimeColumn(GENERATION, sequence=[0])]
    stream.send_columns(path, start, rr.Scalars.columns(scalars=[np.nan]))


def _generations(recording: Recording, topic: str) -> list[rr.TimeColumn]:
    generations = recording.array(topic, "generation").astype(np.int64)
    return [rr.TimeColumn(GENERATION, sequence=generations)]


def _log_design(stream, recording: Recording, name: str) -> None:
    sizes, lower, upper = (
        recording.array("/design", field) for field in ("dimensions", "lower", "upper")
    )
    names, body = recording.names("/design"), body_of(recording)
    for limb, indices in body.limbs.items():
        colors = PALETTE[np.arange(len(indices)) % len(PALETTE)]
        _series(
            stream,
            f"{name}/design/{entity(limb)}",
            _generations(recording, "/design"),
            np.concatenate([sizes[:, indices], lower[:, indices], upper[:, indices]], axis=1),
            [_within(limb, names[i]) for _ in range(3) for i in indices],
            {
                "colors": np.concatenate([colors, colors // 2, colors // 2]),
                "widths": [2.5] * len(indices) + [0.8] * 2 * len(indices),
            },
        )
    original = Robot(body.urdf(np.ones(body.design.size)), body.rest_pose)
    log_robot(stream, original, f"{name}/figure/original", ORIGINAL_AT, ORIGINAL_COLOR)
    generations = recording.array("/design", "generation").tolist()
    for i in np.unique(np.linspace(0, len(sizes) - 1, MAX_FIGURES).round().astype(int)):
        stream.set_time(GENERATION, sequence=generations[i])
        robot = Robot(body.urdf(sizes[i] / body.design.originals), body.rest_pose)
        log_robot(stream, robot, f"{name}/figure/mean", (0, 0, 0))
    stream.reset_time()


def _within(limb: str, name: str) -> str:
    """A dimension's name in its limb's plot: "top width" of "top leg 1 width"."""
    return " ".join(name.replace(limb, "").split()) or name


def log_rollout(stream: rr.RecordingStream, recording: Recording, name: str) -> None:
    """Body, ground, LIDAR and plots of a rollout, on the timeline `time`.

    The body is on the timeline `generation`, too: beside a run, which is on that one, it stands
    where its rollout ended.
    """
    world = f"{name}/world"
    stream.log(world, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    times, paths = _times(recording, "/tf"), {"world": world}
    times.append(rr.TimeColumn(GENERATION, sequence=np.zeros(recording.topics["/tf"], np.int64)))
    robot = Robot(recording.first("/robot_description"))
    courses = []
    for part, (parent, positions, quaternions) in recording.transforms().items():
        paths[part] = path = f"{paths[parent]}/{entity(part)}"
        columns = rr.Transform3D.columns(translation=positions, quaternion=quaternions)
        stream.send_columns(path, times, columns)
        log_part(stream, robot.shapes[part], path, static=True)
        if parent == "world":
            columns = rr.Transform3D.columns(translation=_smooth_height(positions))
            stream.send_columns(f"{world}/follow", times, columns)
            courses.append(positions)
    if recording.topics.get("/terrain"):
        log_terrain(stream, recording.first("/terrain"), world)
    else:
        log_floor(stream, courses[-1], world)
    if recording.topics.get("/lidar"):
        _log_lidar(stream, recording, f"{world}/lidar")
    for topic, field in (("/reward", "terms"), ("/action", "values"), ("/joints", "angles")):
        if recording.topics.get(topic):
            values, names = recording.array(topic, field), recording.names(topic)
            # What the last step alone brings, as a fall, would dwarf the rest; the score shows it.
            used = [i for i in range(len(names)) if values[: max(1, len(values) - 1), i].any()]
            series = values[:, used], [names[i] for i in used]
            _series(stream, f"{name}{topic}", _times(recording, topic), *series)
    total = recording.array("/reward", "total")
    _series(stream, f"{name}/score", _times(recording, "/reward"), total, ["sum of rewards"])


def _times(recording: Recording, topic: str) -> list[rr.TimeColumn]:
    return [rr.TimeColumn(TIME, duration=recording.array(topic, "log_time") / 1e9)]


def _smooth_height(positions: np.ndarray) -> np.ndarray:
    """Positions (T, 3) for the eye: the bumps of single steps, a second long, would shake it."""
    half = 25
    padded = np.pad(positions[:, 2], half, mode="edge")
    height = np.convolve(padded, np.ones(2 * half + 1) / (2 * half + 1), mode="valid")
    return np.column_stack([positions[:, :2], height])


def _log_lidar(stream: rr.RecordingStream, recording: Recording, path: str) -> None:
    x, z, end_x, end_z = (
        recording.array("/lidar", field) for field in ("origin_x", "origin_z", "end_x", "end_z")
    )
    rays = np.zeros((*end_x.shape, 2, 3))  # y: in the body's plane, as its feet are
    rays[:, :, 0, 0], rays[:, :, 0, 2] = x[:, None], z[:, None]
    rays[:, :, 1, 0], rays[:, :, 1, 2] = end_x, end_z
    columns = rr.LineStrips3D.columns(strips=rays.reshape(-1, 2, 3))
    columns = columns.partition(np.full(len(rays), rays.shape[1]))
    stream.send_columns(path, _times(recording, "/lidar"), columns)
    style = rr.LineStrips3D.from_fields(colors=RED, radii=rr.Radius.ui_points(0.7))
    stream.log(path, style, static=True)
