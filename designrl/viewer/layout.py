"""What goes where on the screen: a Rerun blueprint for a set of recordings."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from xml.etree.ElementTree import ParseError

import rerun as rr
import rerun.blueprint as rrb

from designrl.bodies import SKY_COLOR, Body
from designrl.design import changes_in_words
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS, get_experiment
from designrl.recording import Recording, RecordingError

COMPARED = "runs_compared"  # entity of what several runs have in one plot
GENERATION, TIME = "generation", "time"  # timelines: of runs, of rollouts (s of simulated time)
RUN_SECONDS = 30.0  # s of a viewer's time to play a whole run
NEAR_CURSOR = (-4.0, 1.0, 4.5)  # s from the cursor: first and last data shown, end of the axis
# Left free beside a plot's data, for its legend, as a share of the data: wide plots, narrow ones.
WIDE, NARROW = 0.25, 0.55
LEGEND = rrb.Corner2D.RightTop  # there
# All tabs have one timeline; of a tab that is on another one than the first, its title says so.
HINTS = {
    "run": f' (to see it, choose "{GENERATION}" instead of "{TIME}" below)',
    "rollout": f' (to play it, choose "{TIME}" instead of "{GENERATION}" below)',
}


def entity(*names: str) -> str:
    """An entity path of parts that may hold spaces."""
    return "/".join(rr.escape_entity_path_part(name) for name in names)


def body_of(recording: Recording) -> Body:
    """The body of the recording's experiment.

    Raises:
        RecordingError: the experiment is not known here.
    """
    name = recording.metadata.get("experiment")
    if name is None:
        raise RecordingError(
            f"{recording.path} names no experiment; record it with "
            'RolloutWriter(..., {"experiment": NAME}), one that has its body'
        )
    try:
        return get_experiment(name).body
    except InputError:
        raise RecordingError(
            f"{recording.path} is of the experiment {name!r}, which is not known here; name the "
            "module that registers it with --load MODULE"
        ) from None


@contextmanager
def fit(recording: Recording) -> Iterator[None]:
    """In here, what a recording raises that is sound as a file, but not what this package writes.

    Raises:
        RecordingError: for that, in one sentence.
    """
    try:
        yield
    except RecordingError:
        raise
    except (
        AttributeError,
        LookupError,
        OverflowError,
        ParseError,
        RecursionError,
        TypeError,
        ValueError,
    ):
        raise RecordingError(
            f"{recording.path} lacks some of what a {recording.kind} holds; record it again"
        ) from None


def blueprint(
    recordings: list[Recording], names: list[str], for_picture: bool = False
) -> rrb.Blueprint:
    """The layout: a tab per recording; the timeline is that of the first one, and plays.

    Args:
        names: of the recordings, each the root of its entities.
        for_picture: without the viewer's own bar at the top.

    Raises:
        InputError: a recording that is not ours, or of an unknown body.
    """
    makers = {"run": run_layout, "rollout": rollout_layout}
    for recording in recordings:
        if recording.kind not in makers:
            raise InputError(f"{recording.path} is not a recording of designrl; name one of those")
    first, titles = recordings[0], tab_titles(recordings)
    hints = ["" if r.kind == first.kind else HINTS[r.kind] for r in recordings]
    tabs = []
    for recording, *about in zip(recordings, names, titles, hints, strict=True):
        with fit(recording):
            tabs.append(makers[recording.kind](recording, *about))
    if len(runs := runs_of(recordings)) > 1:
        tabs.insert(0, comparison_layout(runs, "" if first.kind == "run" else HINTS["run"]))
    panel = {"timeline": TIME}
    if first.kind == "run":
        panel = {"timeline": GENERATION, "fps": max(1.0, last_generation(first) / RUN_SECONDS)}
    return rrb.Blueprint(
        tabs[0] if len(tabs) == 1 else rrb.Tabs(*tabs),
        rrb.TimePanel(state="collapsed", play_state="playing", loop_mode="all", **panel),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TopPanel(state="hidden" if for_picture else "expanded"),
    )


def runs_of(recordings: list[Recording]) -> list[Recording]:
    """Those of training runs."""
    return [recording for recording in recordings if len(recording.generations)]


def comparison_layout(runs: list[Recording], hint: str) -> rrb.Container:
    """The learning curves of several runs, one over the other."""
    axis = _whole(max(map(last_generation, runs)), WIDE)
    plots = [
        _plot(f"best evaluation so far, points{hint}", f"{COMPARED}/evaluation", axis),
        _plot("population's mean return in training", f"{COMPARED}/population", axis),
    ]
    if not any(run.topics.get("/evaluation") for run in runs):
        del plots[0]
    return rrb.Vertical(*plots, name=f"{len(runs)} runs compared")


def tab_titles(recordings: list[Recording]) -> list[str]:
    """What a recording is of, for each; of one run's, only the first names it, if that will do."""
    whole = [origin(recording) for recording in recordings]
    short, before = [], None
    for run, *rest in whole:
        named = run != before or not any(rest)
        short.append((run if named else "", *rest))
        before = run
    found = [y if short.count(y) == 1 else x for x, y in zip(whole, short, strict=True)]
    return [", ".join(filter(None, parts)) for parts in found]


def origin(recording: Recording) -> tuple[str, str, str]:
    """Experiment and seed of the run; the generation; the body, where it is not the agent's own."""
    about = recording.metadata
    agent = about if recording.kind == "run" else recording.about("agent")
    seed, generation = (agent.get(key) for key in ("seed", "generation"))
    run = str(about.get("experiment")) + (f" seed {seed}" if seed is not None else "")
    is_rollout = recording.kind == "rollout" and generation is not None
    changed = {k: v for k, v in recording.about("changed").items() if isinstance(v, float)}
    return run, f"generation {generation}" if is_rollout else "", changes_in_words(changed)


def last_generation(recording: Recording) -> int:
    """Index of a run's last generation; 0 without one."""
    return int(recording.generations.max(initial=0))


def rollout_layout(recording: Recording, name: str, title: str, hint: str) -> rrb.Container:
    """The body from its side, and below it what it gets, does and feels."""
    root = entity(name)
    body = body_of(recording)
    plots = [
        _plot_near_cursor(about, f"{root}{topic}", share)
        for topic, about, share in (
            ("/reward", "reward terms, points per step", 1.0),
            ("/action", "actions", body.action_seconds / Body.action_seconds),
            ("/joints", "joint angles, rad", 1.0),
        )
        if recording.topics.get(topic)
    ]
    about = ", ".join(filter(None, origin(recording)))
    if score := recording.metadata.get("score"):
        about += f": {float(score):.1f} points"
    score = rrb.TimeSeriesView(
        name="score, the sum of rewards",
        origin=f"{root}/score",
        plot_legend=rrb.PlotLegend(visible=False),
        axis_x=_whole(recording.seconds, 0.0),
    )
    return rrb.Vertical(
        _scene(about + hint, f"{root}/world/follow", f"{root}/world/**", body.rollout_eye),
        rrb.Horizontal(score, *plots),
        row_shares=[2, 1],
        name=title,
    )


def run_layout(recording: Recording, name: str, title: str, hint: str) -> rrb.Container:
    """Learning curves and sigma; the design's dimensions and the body that they make."""
    root, end = entity(name), last_generation(recording)
    axis = _whole(end, WIDE)
    training = ", ".join(training_changes(recording)) or "the environment's own"
    rewards = training_rewards(recording)  # evaluations have them, too
    evaluated = " with ".join(["score of evaluated agents", *rewards])
    learning = [
        _plot(f"{evaluated}, points{hint}", f"{root}/evaluation", axis),
        _plot(f"population's return in training ({training})", f"{root}/population", axis),
        _plot("sigma of the parameters", f"{root}/sigma", axis),
    ]
    if not recording.topics.get("/evaluation"):
        del learning[0]
    curves = rrb.Vertical(*learning, row_shares=[2] * (len(learning) - 1) + [1], name=title)
    if not recording.topics.get("/design"):
        return curves
    body, unit = body_of(recording), recording.unit("/design")
    plots = [
        _plot(f"{limb}, {unit} ± sigma", f"{root}/design/{entity(limb)}", _whole(end, NARROW))
        for limb in body.limbs
    ]
    figure = f"{root}/figure"
    about = "body at the mean design; gray: original"
    view = _scene(about, figure, f"{figure}/**", body.design_eye)
    columns = min(2, len(plots))
    shares = [2, 2 * math.ceil(len(plots) / columns)]
    return rrb.Horizontal(
        curves,
        rrb.Vertical(view, rrb.Grid(*plots, grid_columns=columns), row_shares=shares),
        name=title,
    )


def training_changes(recording: Recording) -> list[str]:
    """What a run's training changes of the environment's rewards, in words."""
    experiment = EXPERIMENTS.get(recording.metadata.get("experiment"))
    if experiment is None:
        return []
    words = training_rewards(recording)
    if (shaping := experiment.shaping) and recording.about("settings").get("shaped_rewards", True):
        words.append(f"a {shaping.free_term} costs nothing")
        words.append(f"over {shaping.solved_return:g} earns {shaping.solved_bonus:g} more")
    return words


def training_rewards(recording: Recording) -> list[str]:
    """The rewards that only a run's training and its evaluations have, in words."""
    experiment = EXPERIMENTS.get(recording.metadata.get("experiment"))
    words = [name.replace("_", " ") for name in experiment.training_kwargs] if experiment else []
    weights = recording.about("settings").get("reward_weights") or {}
    return words + [f"{term} × {weight:g}" for term, weight in weights.items()]


def _scene(title: str, origin: str, contents: str, eye) -> rrb.Spatial3DView:
    position, target = eye
    return rrb.Spatial3DView(
        name=title,
        origin=origin,
        contents=contents,
        background=SKY_COLOR,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=position, look_target=target, eye_up=(0, 0, 1)),
    )


def _plot(title: str, origin: str, axis: rrb.TimeAxis) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name=title, origin=origin, plot_legend=LEGEND, axis_x=axis)


def _plot_near_cursor(title: str, origin: str, share: float) -> rrb.TimeSeriesView:
    at = rrb.TimeRangeBoundary.cursor_relative
    before, after, end = (at(seconds=share * seconds) for seconds in NEAR_CURSOR)
    return rrb.TimeSeriesView(
        name=title,
        origin=origin,
        plot_legend=LEGEND,
        axis_x=rrb.TimeAxis(view_range=rrb.TimeRange(start=before, end=end)),
        time_ranges=rrb.VisibleTimeRange(TIME, start=before, end=after),
    )


def _whole(end: float, room: float) -> rrb.TimeAxis:
    """From the start to `end` (generations if an integer, else s), and room beside it."""
    at = rrb.TimeRangeBoundary.absolute
    stop = max(end, 1) * (1 + room)
    stop = at(seq=math.ceil(stop)) if isinstance(end, int) else at(seconds=stop)
    start = at(seq=0) if isinstance(end, int) else at(seconds=0)
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=start, end=stop))
