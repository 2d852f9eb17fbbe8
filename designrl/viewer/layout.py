"""What goes where on the screen: a Rerun blueprint for a set of recordings."""

import rerun as rr
import rerun.blueprint as rrb

from designrl.bodies import Body
from designrl.errors import InputError
from designrl.experiments import get_experiment
from designrl.recording import Recording

GENERATION, TIME = "generation", "time"  # timelines: of runs, of rollouts (s of simulated time)
PLOT_SECONDS = 3.0  # to either side of the cursor
SKY = (215, 215, 255)  # Gymnasium's


def entity(*names: str) -> str:
    """An entity path of parts that may hold spaces."""
    return "/".join(rr.escape_entity_path_part(name) for name in names)


def body_of(recording: Recording) -> Body:
    """The body of the recording's experiment.

    Raises:
        InputError: the experiment is not known here.
    """
    name = recording.metadata.get("experiment")
    try:
        return get_experiment(name).body
    except InputError:
        raise InputError(
            f"{recording.path} is of the experiment {name!r}, which is not known here; register "
            "it first (designrl.experiments.register)"
        ) from None


def blueprint(recordings: list[Recording], names: list[str]) -> rrb.Blueprint:
    """The layout: a tab per recording; the timeline is that of the first one.

    Args:
        names: of the recordings, each the root of its entities.

    Raises:
        InputError: a recording that is not ours, or of an unknown body.
    """
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
    name = entity(title)
    plots = [
        _plot(about, f"{name}{topic}", seconds=PLOT_SECONDS)
        for topic, about in (
            ("/reward", "reward terms, points per step"),
            ("/action", "actions"),
            ("/joints", "joint angles, rad"),
        )
        if recording.topics.get(topic)
    ]
    eye = body_of(recording).rollout_eye
    return rrb.Vertical(
        _scene("body", f"{name}/world/follow", f"{name}/world/**", eye),
        rrb.Horizontal(_plot("score", f"{name}/score"), *plots),
        row_shares=[2, 1],
        name=title,
    )


def run_layout(recording: Recording, title: str) -> rrb.Container:
    """Learning curve and sigma; the design's dimensions and the body that they make."""
    name = entity(title)
    learning = rrb.Vertical(
        _plot("return: population mean ± 2 sd, best, evaluations", f"{name}/learning"),
        _plot("sigma: mean, smallest, largest parameter", f"{name}/sigma"),
        row_shares=[2, 1],
    )
    if not recording.topics.get("/design"):
        return rrb.Vertical(learning, name=title)
    body, unit = body_of(recording), recording.unit("/design")
    plots = [
        _plot(f"{limb}, {unit} ± sigma", f"{name}/design/{entity(limb)}") for limb in body.limbs
    ]
    figure = f"{name}/figure"
    title_of_view = "body at the mean design; gray: original"
    view = _scene(title_of_view, figure, f"{figure}/**", body.design_eye)
    return rrb.Horizontal(
        learning,
        rrb.Vertical(view, rrb.Grid(*plots, grid_columns=min(2, len(plots))), row_shares=[1, 1]),
        name=title,
    )


def _scene(title: str, origin: str, contents: str, eye) -> rrb.Spatial3DView:
    position, target = eye
    return rrb.Spatial3DView(
        name=title,
        origin=origin,
        contents=contents,
        background=SKY,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=position, look_target=target, eye_up=(0, 0, 1)),
    )


def _plot(title: str, origin: str, seconds: float | None = None) -> rrb.TimeSeriesView:
    """A plot of everything, or of some seconds to either side of the cursor."""
    axis = None
    if seconds:
        cursor = rrb.TimeRangeBoundary.cursor_relative
        view = rrb.TimeRange(start=cursor(seconds=-seconds), end=cursor(seconds=seconds))
        axis = rrb.TimeAxis(view_range=view)
    legend = rrb.Corner2D.LeftTop
    return rrb.TimeSeriesView(name=title, origin=origin, plot_legend=legend, axis_x=axis)
