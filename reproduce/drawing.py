"""What the figures share: style, saving, and walkers drawn from their environment's own shapes."""

import io
from dataclasses import dataclass, field
from pathlib import Path

import gymnasium
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

import designrl  # noqa: F401 (registers the environments)
from designrl.bodies.walker import WALKER
from designrl.design import SCALE_MAX, SCALE_MIN
from designrl.evaluation import episode_seeds
from designrl.experiments import EXPERIMENTS, Experiment
from designrl.files import write_atomically
from designrl.policy import Agent
from reproduce import scores
from reproduce.scores import Score

WIDTH = 5.5  # inches: the paper's column
# Okabe and Ito's colours, which the colour-blind can tell apart; ours by role.
ORIGINAL, LEARNED, THIRD, GREY = "#0072B2", "#D55E00", "#009E73", "#666666"
SKY = np.array([215, 215, 255]) / 255  # as the environment paints it

matplotlib.rcParams.update(
    {
        "font.size": 8,
        "axes.titlesize": 8,
        "axes.labelsize": 8,
        "xtick.labelsize": 7,
        "ytick.labelsize": 7,
        "legend.fontsize": 7,
        "axes.titlelocation": "left",
        "axes.linewidth": 0.6,
        "lines.linewidth": 1.2,
        "svg.hashsalt": "designrl",  # equal figures give equal files
        "pdf.fonttype": 42,
    }
)


def save(figure: Figure, name: str) -> list[Path]:
    """Write NAME.svg, .pdf and .png to the figures' folder; returns their paths."""
    folder = scores.output_folder() / "figures"
    paths = []
    for suffix, metadata in (
        ("svg", {"Date": None}),
        ("pdf", {"CreationDate": None}),
        ("png", {"Software": None}),
    ):
        data = io.BytesIO()
        figure.savefig(data, format=suffix, dpi=200, metadata=metadata)
        paths.append(folder / f"{name}.{suffix}")
        write_atomically(paths[-1], data.getvalue())
    return paths


def source_of(s: Score) -> str:
    """Whose run it is, as a figure says it."""
    if s.path.suffix == ".json":
        run = s.path.stem.rpartition(".")[2]
        return f"author's weights, run {run if run.isdigit() else 1}"
    return f"ours, {scores.seed_of(s.path)}"


def typical_seed(*found: Score | None) -> int:
    """The evaluation's seed whose returns are together closest to each agent's median."""
    usable = [s for s in found if s is not None]
    seeds = episode_seeds(scores.SEED, scores.EPISODES)
    if not usable:
        return int(seeds[0])
    ranks = [s.returns.argsort(kind="stable").argsort(kind="stable") for s in usable]
    away = np.sum([np.abs(rank - (scores.EPISODES - 1) / 2) for rank in ranks], axis=0)
    return int(seeds[np.argmin(away)])


# ------------------------------------------------------------------------------------- walkers

Shape = tuple[np.ndarray, tuple, tuple]  # vertices (V, 2) in m, colours of face and edge


@dataclass
class Walk:
    """One rollout of a walker, as shapes in m; or, without an agent, its body at rest."""

    ground: list[Shape] = field(default_factory=list)
    moments: list[list[Shape]] = field(default_factory=list)  # the body after each step
    x: list[float] = field(default_factory=list)  # m: the hull's centre, of each moment
    score: float = 0.0
    steps: int = 0
    fell: bool = False


def _colour(rgb) -> tuple:
    return tuple(np.array(rgb) / 255)


def _shapes(bodies) -> list[Shape]:
    return [
        (
            np.array([body.transform * vertex for vertex in fixture.shape.vertices]),
            _colour(body.color1),
            _colour(body.color2),
        )
        for body in bodies
        for fixture in body.fixtures
        if len(fixture.shape.vertices) > 2
    ]


def walk(experiment: Experiment, body: np.ndarray, agent: Agent | None, seed: int) -> Walk:
    """Roll an agent out in its environment; without an agent, the body stands at the start.

    Args:
        body: (8,) scales.
    """
    env = gymnasium.make(experiment.env_id, design=body, disable_env_checker=True)
    observation, _ = env.reset(seed=seed)
    world = env.unwrapped
    result = Walk([(np.array(poly), _colour(c), _colour(c)) for poly, c in world.terrain_poly])
    result.ground += _shapes(world.terrain)
    done = False
    if agent is not None:
        agent.reset(seed)
    while not done:
        result.moments.append(_shapes([*world.legs, world.hull]))
        result.x.append(world.hull.position[0])
        if agent is None:
            break
        action = agent.act(observation, result.steps)
        observation, reward, terminated, truncated, info = env.step(action)
        result.score += reward
        result.fell = info["reward_terms"]["fall"] < 0
        result.steps += 1
        done = terminated or truncated
    env.close()
    return result


def draw_shapes(axes: Axes, shapes: list[Shape], outline: float = 0.4) -> None:
    """Draw shapes in the environment's colours."""
    vertices, faces, edges = zip(*shapes, strict=True)
    axes.add_collection(
        PolyCollection(vertices, facecolors=faces, edgecolors=edges, linewidths=outline)
    )


def chosen_moments(w: Walk, start: float, span: float, spacing: float) -> list[list[Shape]]:
    """The body at the start and each `spacing` m of its way; where it fell, as it lies there."""
    x, chosen = np.array(w.x), []
    for mark in np.arange(w.x[0], start + span, spacing) if w.moments else ():
        reached = np.flatnonzero(x >= mark)
        chosen.append(w.moments[reached[0] if len(reached) else -1])
        if len(reached) == 0:
            break
    return chosen


def draw_walk(axes: Axes, w: Walk, start: float, span: float, spacing: float) -> None:
    """Draw the ground from `start` to `start + span` m and the body's moments on it."""
    axes.set_facecolor(SKY)
    ground = [s for s in w.ground if s[0][:, 0].max() > start and s[0][:, 0].min() < start + span]
    draw_shapes(axes, ground, 0.2)
    axes.axhspan(-9, 0, color=ground[0][1])  # the environment's ground ends at 0
    moments = chosen_moments(w, start, span, spacing)
    for shapes in moments:
        draw_shapes(axes, shapes)
    surface = np.concatenate([v[v[:, 1] > 0, 1] for v, *_ in ground])  # 0: below the picture
    tops = [v[:, 1].max() for shapes in moments for v, *_ in shapes]
    axes.set_xlim(start, start + span)
    axes.set_ylim(surface.min() - 0.6, max(tops, default=surface.max()) + 0.6)
    axes.set_aspect("equal")
    axes.yaxis.set_major_locator(MultipleLocator(2))
    axes.set_ylabel("height (m)")


def resting_body(experiment: str) -> np.ndarray:
    """(8,) scales of a walker's body as the paper's Table 2 prints it."""
    printed = np.array(scores.paper()["table2"][experiment]["dimensions"])
    return np.clip(printed / WALKER.design.originals, SCALE_MIN, SCALE_MAX)


# What a strip shows: a name for the row, the experiment, and which of its runs (0 = the best).
Row = tuple[str, str, int]


def strips(name: str, rows: list[Row], start: float = 2.0, span: float = 36.0) -> list[Path]:
    """A figure of one strip per row: several moments of one rollout on its terrain.

    Where we have no checkpoint, the paper's printed body stands at the start.
    """
    found = [scores.representative(experiment, rank) for _, experiment, rank in rows]
    same_task = len({EXPERIMENTS[experiment].env_id for _, experiment, _ in rows}) == 1
    seeds = [typical_seed(*found)] * len(rows) if same_task else [typical_seed(s) for s in found]
    figure = Figure(figsize=(WIDTH, 1), layout="constrained")
    panels = figure.subplots(len(rows), 1, squeeze=False, sharex=True)[:, 0]
    for axes, (label, experiment_name, rank), s, seed in zip(
        panels, rows, found, seeds, strict=True
    ):
        experiment = EXPERIMENTS[experiment_name]
        if s is not None:
            w = walk(experiment, s.agent.body, s.agent, seed)
            fell = ", fell" if w.fell else ""
            axes.set_title(
                f"{label}: {s.mean:.0f} ± {s.std:.0f} over {scores.EPISODES} rollouts "
                f"({source_of(s)}); this one {w.score:.0f}{fell}"
            )
        else:
            w = walk(experiment, resting_body(experiment_name), None, seed)
            if rank:
                axes.set_title(f"{label}: no checkpoint of a second run yet")
                w.moments = []
            else:
                axes.set_title(f"{label}: no checkpoint of ours yet; the paper's design, at rest")
        draw_walk(axes, w, start, span, spacing=3.0)
    panels[-1].set_xlabel("distance from the left end of the course (m)")
    # Equal heights and scales in all rows, with the height that fills the width.
    middles = [np.mean(axes.get_ylim()) for axes in panels]
    height = max(np.ptp(axes.get_ylim()) for axes in panels)
    for axes, middle in zip(panels, middles, strict=True):
        axes.set_ylim(middle - height / 2, middle + height / 2)
    figure.set_figheight(len(rows) * (height / span * (WIDTH - 0.55) + 0.27) + 0.33)
    return save(figure, name)
