"""Figure 5: learning curves of hardcore, the paper's and ours at the paper's settings.

CAPTIONS says what it shows. Runs that are still being trained are drawn as far as they are.
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reproduce import drawing
from reproduce.curves import COLOURS, HARDCORE, LABELS
from reproduce.paths import at_papers_settings, paper, recordings, unfinished
from reproduce.runs import read_published
from reproduce.sources import Sources

CAPTIONS = {
    "figure5": (
        "Figure 5",
        "Hardcore learning curves at the paper's settings, 192 candidates with 16 rollouts each, "
        "with the original body and a learned one, as far as the paper's figure goes. Thick: the "
        "paper's curves, read from its figure. Thin: ours, a line for each run; a circle marks how "
        "far an unfinished run has come. Left, the population's mean ± 2 standard deviations (the "
        "paper's: dashed, where they were read). These are points of training, where a fall costs "
        "nothing and success earns 100 more, less 100, as in the paper's figure. Right, the score "
        "of the generation's best agent over 100 rollouts (ours over 3,072). The grey line is at "
        "300 points: solved.",
    )
}
OFFSET = -100.0  # points, of the paper's left panel
BAND = 2  # standard deviations


def recorded(experiment: str) -> list[Path]:
    """The recordings of our runs at the paper's settings, those of unfinished ones last."""
    done = [path for path in recordings(experiment) if at_papers_settings(path.parent)]
    return done + unfinished(experiment)


def reads(sources: Sources) -> list[Path]:
    """The files that the figure depends on."""
    return [*sources.read_for(), *(path for name in HARDCORE for path in recorded(name))]


def draw_paper(left: Axes, right: Axes, experiment: str, colour: str) -> None:
    """Draw the paper's curves."""
    printed = paper()["figure5"][experiment]
    label = f"the paper's, {LABELS[experiment].lower()}"
    style = {"color": colour, "linewidth": 2, "alpha": 0.8, "label": label}
    generation, mean = np.transpose(printed["population"])
    gaps = np.flatnonzero(np.diff(generation) > 2 * np.median(np.diff(generation)))
    for part in np.split(np.arange(len(mean)), gaps + 1):
        left.plot(generation[part], mean[part], **style)
    if "spread" in printed:
        at, sd = np.transpose(printed["spread"])
        middle = np.interp(at, generation, mean)
        for edge in (middle - BAND * sd, middle + BAND * sd):
            left.plot(at, edge, color=colour, linewidth=1, linestyle="--")
    right.plot(*np.transpose(printed["best"]), **style)


def draw_ours(left: Axes, right: Axes, experiment: str, colour: str) -> None:
    """Draw our runs."""
    found = recorded(experiment)
    going_on = len(unfinished(experiment))
    body = LABELS[experiment].lower()
    label = f"ours, {body}: {len(found)} run{'s' * (len(found) != 1)}"
    label += f" ({going_on} unfinished)" if going_on else ""
    style = {"color": colour, "linewidth": 0.8, "label": label}
    if not found:
        right.plot([], [], color=colour, linewidth=0.8, label=f"ours, {body}: no run yet")
    for path in found:
        run = read_published(path)
        mean = run.mean + OFFSET
        left.plot(run.generation, mean, rasterized=True, **style)
        low, high = mean - BAND * run.sd, mean + BAND * run.sd
        band = {"color": colour, "alpha": 0.15, "linewidth": 0, "rasterized": True}
        left.fill_between(run.generation, low, high, **band)
        right.plot(run.tested, run.scores, **style)
        if path.parents[2].name == "unfinished":
            end = {"color": colour, "marker": "o", "markersize": 3, "markerfacecolor": "white"}
            left.plot(run.generation[-1], mean[-1], **end)
            right.plot(run.tested[-1:], run.scores[-1:], **end)


def figures(sources: Sources) -> dict[str, Figure]:
    figure = Figure(figsize=(drawing.WIDTH, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for experiment, colour in zip(HARDCORE, COLOURS, strict=True):
        draw_paper(left, right, experiment, colour)
        draw_ours(left, right, experiment, colour)
    drawing.line_of_solved(right)
    left.set_ylabel("population's mean return\nin training, less 100 (points)")
    right.set_ylabel("best agent's score (points)")
    right.tick_params(labelleft=True)
    for axes in (left, right):
        axes.set_xlabel("generation")
        axes.set_xlim(left=0)
        axes.set_ylim(-170, 400)
    drawing.legend(figure, right, ncols=2)
    return {"figure5": figure}
