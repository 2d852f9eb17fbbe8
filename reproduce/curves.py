"""Learning curves of all published runs; CAPTIONS says what they show."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reproduce import drawing
from reproduce.paths import EIGHT, paper, recordings
from reproduce.runs import SOLVED, Run, read_published
from reproduce.scores import rewards_small_legs
from reproduce.sources import Sources

CAPTIONS = {
    "curves_hardcore": (
        "Curves on hardcore",
        "Hardcore learning curves, with the original and a learned body, over generations (the "
        "recipe's have 192 candidates with 4 rollouts, the paper's 192 with 16), environment steps "
        "and core-hours. Above, the population's return as training sees it: a fall costs nothing, "
        "success earns 100 more, so it does not compare with scores. Below, the best evaluated "
        "agent so far, by its score. A line for each run. Dashed: 300 points, solved. Dotted: when "
        "the paper's runs, with its settings, had solved it.",
    ),
    "curves": (
        "Curves on flat terrain",
        "The same curves for the walkers on flat terrain. What matters there is above 300 points, "
        "so the lower panels begin at 250.",
    ),
    "curves_smaller_leg": (
        "Curves of the walkers with smaller legs",
        "The same curves for the walkers that are rewarded for smaller legs; their points, below "
        "too, are those of training's reward, with the factor for the legs' area.",
    ),
    "curves_ant": ("Curves of the ants", "The same curves for the ants."),
}
HARDCORE = ("biped-hardcore", "biped-hardcore-morphology")
FLAT = ("biped", "biped-morphology")
EXPERIMENTS_OF = {
    "curves_hardcore": HARDCORE,
    "curves": FLAT,
    "curves_smaller_leg": ("biped-morphology-smaller-leg", "biped-hardcore-morphology-smaller-leg"),
    "curves_ant": ("ant", "ant-morphology"),
}
LABELS = {"biped-hardcore": "Original body", "biped-hardcore-morphology": "Learned body"}
COLOURS = (drawing.ORIGINAL, drawing.LEARNED)
CLOSE_FROM = 250  # points
PAPER_CORES = 96
STEPS = "environment steps (millions)"
AXES = ("generation", STEPS, "core-hours")


def axis_labels(experiment: str) -> tuple[str, str]:
    """What the panels above and below show."""
    small_legs = rewards_small_legs(experiment)
    unit = "with the factor for legs" if small_legs else "points"
    return "population's mean\nreturn in training", f"best evaluation so far\n({unit})"


def reads(sources: Sources) -> list[Path]:
    """The files that the figure depends on."""
    return [*sources.read_for(), *(path for name in EIGHT for path in recordings(name))]


def draw(above: Axes, below: Axes, axis: str, runs: list[Run], label: str, colour: str) -> None:
    """Draw an experiment's runs over one of AXES: the population above, evaluations below."""
    for run in runs:
        at = (run.generation, run.steps / 1e6, run.core_hours)[AXES.index(axis)]
        tested = np.interp(run.tested, run.generation, at)
        style = {"color": colour, "alpha": 0.6, "linewidth": 2 if run.papers else 0.8}
        style["label"] = f"{label}, the paper's settings" if run.papers else label
        # Thousands of generations a run would be megabytes as vectors.
        above.plot(at, run.mean, rasterized=True, **style)
        below.step(tested, np.maximum.accumulate(run.scores), where="post", **style)


def show_differences(axes: Axes, experiment: str) -> None:
    """On flat ground, where every good score is near 350, show only what is above CLOSE_FROM."""
    if experiment in FLAT and axes.lines and axes.get_ylim()[1] > SOLVED:
        axes.set_ylim(bottom=CLOSE_FROM)


def mark_paper(axes: Axes, axis: str, experiment: str, label: str, colour: str) -> None:
    """When the paper's run had solved the task, where it says so."""
    solved = paper()["text"].get(experiment, {})
    if axis == STEPS or "hours" not in solved:
        return
    at = solved["generations"]
    if axis == "core-hours":
        at = solved["hours"] * PAPER_CORES
        axes.set_xscale("log")  # hours of ours beside thousands of the paper's
    name = f"the paper's: solved ({label.lower()})"
    axes.axvline(at, color=colour, linestyle=":", linewidth=1, label=name)


def curves(experiments: tuple[str, ...]) -> Figure:
    """The learning curves of some experiments: two panels for each of AXES."""
    labels = {name: LABELS.get(name, EIGHT[name].title) for name in experiments}
    found = {name: [read_published(path) for path in recordings(name)] for name in experiments}
    figure = Figure(figsize=(drawing.WIDTH, 3.9), layout="constrained")
    panels = figure.subplots(2, len(AXES), sharex="col", sharey="row")
    for axis, (above, below) in zip(AXES, panels.T, strict=True):
        for (name, runs), colour in zip(found.items(), COLOURS, strict=True):
            draw(above, below, axis, runs, labels[name], colour)
        for axes in (above, below):
            if not axes.lines:
                axes.set_ylim(-150, 400)  # nothing to draw yet
            axes.margins(x=0.02)
        if "biped" in experiments or "biped-hardcore" in experiments:
            drawing.line_of_solved(below)
        show_differences(below, experiments[0])
        for name, colour in zip(experiments, COLOURS, strict=True):
            mark_paper(below, axis, name, labels[name], colour)
        below.set_xlabel(axis)
        if below.get_xscale() == "linear":
            below.set_xlim(left=0)
    for axes, label in zip(panels[:, 0], axis_labels(experiments[0]), strict=True):
        axes.set_ylabel(label)
    _, texts = panels[1, 0].get_legend_handles_labels()
    drawing.legend(figure, panels[1, 0], ncols=2 if max(map(len, texts), default=0) < 50 else 1)
    return figure


def figures(sources: Sources) -> dict[str, Figure]:
    """The figures."""
    return {name: curves(experiments) for name, experiments in EXPERIMENTS_OF.items()}
