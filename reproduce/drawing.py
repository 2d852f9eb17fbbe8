"""What the figures share: style, saving, and walkers drawn from their environment's own shapes."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import gymnasium
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from designrl.bodies import GROUND_COLOR, SKY_COLOR
from designrl.compare import rendered
from designrl.evaluation import episode_seeds
from designrl.files import write_atomically
from designrl.policy import Agent
from reproduce.paths import EIGHT, is_authors
from reproduce.runs import SOLVED
from reproduce.scores import EPISODES, MISSING, SEED, Score
from reproduce.sources import Sources
from reproduce.tables import mean_and_std

WIDTH = 5.5  # inches: the paper's column
START, SPAN = 2.0, 36.0  # m: what a strip shows of the course
# Okabe and Ito's colours, which the colour-blind can tell apart; ours by role.
ORIGINAL, LEARNED, THIRD, GREY = "#0072B2", "#D55E00", "#009E73", "#666666"
SKY, GRASS = (tuple(np.array(color) / 255) for color in (SKY_COLOR, GROUND_COLOR))
BOTTOM = -9.0  # m: below any picture

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


def save(folder: Path, name: str, figure: Figure) -> list[Path]:
    """Write NAME.svg, .pdf and .png to a folder; returns their paths."""
    paths = []
    # A layout moves a little at each drawing: another order would change the committed PNG.
    for suffix in ("svg", "pdf", "png"):
        content = rendered(figure, suffix, dpi=200)
        # Matplotlib names what clips by a layout's last bits, which differ from time to time.
        for number, clip in enumerate(re.findall(rb'<clipPath id="(\w+)"', content)):
            content = content.replace(clip, b"clip%d" % number)
        paths.append(folder / f"{name}.{suffix}")
        write_atomically(paths[-1], content)
    return paths


def source_of(s: Score) -> str:
    """Whose run it is, as a figure says it."""
    whose = "author's weights" if is_authors(s.path) else "ours"
    return f"{whose}, {s.run}"


def legend(figure: Figure, axes: Axes, **how) -> None:
    """Below a figure, each label of a panel once, however many lines have it; none without any."""
    handles, texts = axes.get_legend_handles_labels()
    if named := dict(zip(texts, handles, strict=True)):
        figure.legend(named.values(), named, loc="outside lower center", **how)


def line_of_solved(axes: Axes) -> None:
    """A thin line at the points of a solved task."""
    axes.axhline(SOLVED, color=GREY, linewidth=0.6, linestyle="--", zorder=0)


def typical_seed(*found: Score | None) -> int:
    """The evaluation's seed whose returns are together closest to each agent's median."""
    returns = [s.returns for s in found if s is not None]
    ranks = [values.argsort(kind="stable").argsort(kind="stable") for values in returns]
    away = np.sum([np.abs(rank - (EPISODES - 1) / 2) for rank in ranks], axis=0)
    return int(episode_seeds(SEED, EPISODES)[np.argmin(away)])


# ------------------------------------------------------------------------------------- walkers

Shape = tuple[np.ndarray, tuple, tuple]  # vertices (V, 2) in m, colours of face and edge


@dataclass
class Walk:
    """One rollout of a walker, as shapes in m."""

    ground: list[Shape] = field(default_factory=list)
    moments: list[list[Shape]] = field(default_factory=list)  # the body at first and after steps
    x: list[float] = field(default_factory=list)  # m: the hull's centre, of each moment
    score: float = 0.0
    fell: bool = False


def _shapes(bodies) -> list[Shape]:
    return [
        (
            np.array([body.transform * vertex for vertex in fixture.shape.vertices]),
            tuple(np.array(body.color1) / 255),
            tuple(np.array(body.color2) / 255),
        )
        for body in bodies
        for fixture in body.fixtures
        if len(fixture.shape.vertices) > 2
    ]


def walk(agent: Agent, seed: int) -> Walk:
    """Roll a walker out in its environment."""
    env = gymnasium.make(agent.experiment.env_id, disable_env_checker=True)
    observation = agent.start(env, seed)
    world, result = env.unwrapped, Walk()

    def look() -> None:
        result.moments.append(_shapes([*world.legs, world.hull]))
        result.x.append(world.hull.position[0])

    profile, _ = world.body.terrain(world)
    # One piece: the environment's own stripes leave seams where they meet.
    corners = np.array([(profile[-1, 0], BOTTOM), (profile[0, 0], BOTTOM)])
    result.ground.append((np.concatenate([profile, corners]), GRASS, GRASS))
    result.ground += _shapes(world.terrain)
    look()
    for step in agent.steps(env, observation):
        look()
        result.score += step.reward
        result.fell = step.info["reward_terms"]["fall"] < 0
    env.close()
    return result


def draw_shapes(axes: Axes, shapes: list[Shape], outline: float = 0.4) -> None:
    """Draw shapes in the environment's colours."""
    vertices, faces, edges = zip(*shapes, strict=True)
    axes.add_collection(
        PolyCollection(vertices, facecolors=faces, edgecolors=edges, linewidths=outline)
    )


def chosen_moments(w: Walk, spacing: float) -> list[list[Shape]]:
    """The body at the start and each `spacing` m of its way; where it fell, as it lies there."""
    x, chosen = np.array(w.x), []
    for mark in np.arange(w.x[0], START + SPAN - spacing / 2, spacing):  # whole within the strip
        reached = np.flatnonzero(x >= mark)
        chosen.append(w.moments[reached[0] if len(reached) else -1])
        if len(reached) == 0:
            break
    return chosen


def draw_walk(axes: Axes, w: Walk) -> None:
    """Draw the ground of the strip and the body's moments on it."""
    axes.set_facecolor(SKY)
    end = START + SPAN
    draw_shapes(axes, w.ground, 0.2)
    moments = chosen_moments(w, spacing=3.0)
    for shapes in moments:
        draw_shapes(axes, shapes)
    corners = np.concatenate([v for v, *_ in w.ground])
    inside = (corners[:, 0] > START) & (corners[:, 0] < end) & (corners[:, 1] > BOTTOM)
    surface = corners[inside, 1]
    tops = [v[:, 1].max() for shapes in moments for v, *_ in shapes]
    axes.set_xlim(START, end)
    axes.set_ylim(surface.min() - 0.6, max(tops) + 0.6)
    axes.set_aspect("equal")
    axes.yaxis.set_major_locator(MultipleLocator(2))
    axes.set_ylabel("height (m)")


def strips(
    sources: Sources, experiments: tuple[str, ...], labels: tuple[str, ...], rank: int = 0
) -> Figure:
    """A strip per experiment: moments of one rollout, of our best run (rank 0) or the next one."""
    found = [sources.representative(name, rank) for name in experiments]
    same_task = len({EIGHT[name].env_id for name in experiments}) == 1
    figure = Figure(figsize=(WIDTH, 1), layout="constrained")
    # Of a missing run only a title is there.
    rows = [1.0 if s else 0.01 for s in found]
    panels = figure.subplots(len(found), 1, squeeze=False, sharex=True, height_ratios=rows)[:, 0]
    for axes, label, s in zip(panels, labels, found, strict=True):
        if s is None:
            axes.set_title(f"{label}: {MISSING}")
            axes.set_axis_off()
            continue
        w = walk(s.agent, typical_seed(*(found if same_task else [s])))
        fell = ", fell" if w.fell else ""
        axes.set_title(
            f"{label}: {mean_and_std(s.mean, s.std)} over {EPISODES} rollouts "
            f"({source_of(s)}); this one {w.score:.0f}{fell}"
        )
        draw_walk(axes, w)
    panels = [axes for axes, s in zip(panels, found, strict=True) if s] or panels
    panels[-1].set_xlabel("distance from the left end of the course (m)")
    panels[-1].tick_params(labelbottom=True)
    # Equal heights and scales in all rows, with the height that fills the width.
    middles = [np.mean(axes.get_ylim()) for axes in panels]
    height = max(np.ptp(axes.get_ylim()) for axes in panels)
    for axes, middle in zip(panels, middles, strict=True):
        axes.set_ylim(middle - height / 2, middle + height / 2)
    figure.set_figheight(sum(rows) * height / SPAN * (WIDTH - 0.55) + len(rows) * 0.27 + 0.33)
    return figure
