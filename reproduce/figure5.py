"""Figure 5: learning curves of hardcore, with the original and with a learned body.

Above the population's mean return, as training sees it; below the score of the best agent so far,
without training's changes of the reward. Over generations, environment steps and core-hours. The
best run of each experiment also has the population's ± 2 standard deviations and the score of each
evaluated agent; the others are pale. Reads logs/EXPERIMENT/seed*/ (recordings, and the
states for the processor time) and paper/paper.toml. Writes paper/figures/figure5.svg, .pdf and
.png; and in the same way those of the flat walkers, of the walkers that are rewarded for smaller
legs and of the ants: curves.*, curves_smaller_leg.* and curves_ant.*.

    make reproduce-figure5
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from designrl.checkpoint import read_tensors
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS
from designrl.recording import Recording, read
from designrl.train import STATE_FORMAT
from reproduce import build, drawing, scores

HARDCORE = {
    "biped-hardcore": ("Original body", drawing.ORIGINAL),
    "biped-hardcore-morphology": ("Learned body", drawing.LEARNED),
}
SOLVED = 300  # points
PAPER_CORES = 96
AXES = ("generation", "environment steps (millions)", "core-hours")


@dataclass(frozen=True)
class Curve:
    """A run's learning curve.

    Attributes:
        at: (3, G) where each generation lies on each of AXES.
        mean, sd: (G,) points, over the population, with training's changes of the reward.
        tested: (E,) which generations were evaluated, as indices into the others.
        scores: (E,) points, mean over each evaluation's episodes.
        episodes: of an evaluation, as text: "200", or "200–1000" where that changed.
        problem: why it ends early, or empty.
    """

    at: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    tested: np.ndarray
    scores: np.ndarray
    episodes: str
    problem: str


def recordings(experiment: str) -> list[Path]:
    """The recordings of our runs of an experiment, by seed."""
    return sorted((scores.ROOT / "logs" / experiment).glob("seed*/generations.mcap"))


def core_hours_per_second(folder: Path) -> float:
    """Core-hours of processor time for each second of wall time that a run took."""
    _, state = read_tensors(folder / "state.safetensors", STATE_FORMAT)
    progress = state["progress"]
    return progress["cpu_seconds"] / progress["seconds"] / 3600


def curve(recording: Recording) -> Curve:
    """The learning curve in the recording of a run, beside which the run's state lies.

    Raises:
        InputError: the recording holds no generation, or the state cannot be read.
    """
    summary = {
        name: recording.array("/summary", name)
        for name in ("generation", "mean", "sd", "total_steps", "seconds")
    }
    if len(summary["mean"]) == 0:
        raise InputError(f"{recording.path} holds no generation; train further")
    hours = summary["seconds"] * core_hours_per_second(recording.path.parent)
    has_tests = recording.topics.get("/evaluation")
    tested = recording.array("/evaluation", "generation") if has_tests else np.empty(0, np.uint32)
    episodes = {len(row) for row in recording.array("/evaluation", "scores")} if has_tests else {0}
    return Curve(
        np.array([summary["generation"], summary["total_steps"] / 1e6, hours]),
        summary["mean"],
        summary["sd"],
        np.searchsorted(summary["generation"], tested).clip(max=len(hours) - 1),
        recording.array("/evaluation", "mean") if has_tests else np.empty(0),
        "–".join(map(str, sorted({min(episodes), max(episodes)}))),
        recording.problem or "",
    )


def solved_at(c: Curve) -> int | None:
    """Index of the generation before the first evaluation of SOLVED; None where there is none."""
    reached = c.tested[c.scores >= SOLVED]
    return int(reached[0]) if len(reached) else None


def reads() -> list[Path]:
    """The files that the figure depends on."""
    found = [path for name in EXPERIMENTS for path in recordings(name)]
    states = [path.with_name("state.safetensors") for path in found]
    return [scores.ROOT / "paper" / "paper.toml", *found, *states]


def draw(panels, experiment: str, label: str, colour: str) -> list[str]:
    """Draw all runs of an experiment; returns what could not be drawn, in words."""
    missing = [] if recordings(experiment) else [f"{label}: no recording yet"]
    curves = []
    for path in recordings(experiment):
        try:
            curves.append(curve(read(path)))
        except (InputError, KeyError, ZeroDivisionError) as error:
            missing.append(f"{label}, {path.parent.name}: not drawn ({error})")
    # The best run last, over the others, and only it with its band: bands of many runs hide all.
    curves.sort(key=lambda c: c.scores.max(initial=-np.inf))
    for c in curves:
        chosen = c is curves[-1]
        name = f"{label} ({c.episodes} episodes an evaluation)" if chosen else None
        best = np.maximum.accumulate(c.scores)
        low, high = c.mean - 2 * c.sd, c.mean + 2 * c.sd
        strength = 1.0 if chosen else 0.35
        # Thousands of generations a run would be megabytes as vectors.
        pixels = {"color": colour, "rasterized": True}
        for column, at in enumerate(c.at):
            above, below = panels[0, column], panels[1, column]
            if chosen:
                above.fill_between(at, low, high, alpha=0.2, linewidth=0, **pixels)
                below.plot(at[c.tested], c.scores, ".", color=colour, markersize=2, alpha=0.6)
            above.plot(at, c.mean, linewidth=0.8, alpha=strength, label=name, **pixels)
            below.step(at[c.tested], best, where="post", color=colour, alpha=strength, label=name)
    return missing


def mark_paper(panels) -> None:
    """When the paper's runs had solved the task: on the axes of generations and core-hours."""
    for experiment, (label, colour) in HARDCORE.items():
        solved = scores.paper()["text"][experiment]
        marks = (solved["generations"], None, solved["hours"] * PAPER_CORES)
        panels[1, 2].set_xscale("log")  # hours of ours beside thousands of the paper's
        for axes, mark in zip(panels[1], marks, strict=True):
            if mark:
                name = f"the paper's: solved ({label.lower()})"
                axes.axvline(mark, color=colour, linestyle=":", linewidth=1, label=name)


def frame(panels, solved: bool) -> None:
    """Labels, and the line of a solved task."""
    for row in panels:
        for axes in row:
            if solved:
                axes.axhline(SOLVED, color=drawing.GREY, linewidth=0.6, linestyle="--", zorder=0)
            axes.margins(x=0.02)
    for axes, label in zip(panels[1], AXES, strict=True):
        axes.set_xlabel(label)
        if axes.get_xscale() == "linear":
            axes.set_xlim(left=0)
    panels[0, 0].set_ylabel("population's return\n(points, mean ± 2 sd)")
    panels[1, 0].set_ylabel("evaluated agent's score\n(points; line: best so far)")


def figure_of(rows: dict[str, tuple[str, str]], paper_marks: bool, solved: bool = True) -> Figure:
    """The six panels for some experiments: name -> label and colour."""
    figure = Figure(figsize=(drawing.WIDTH, 3.9), layout="constrained")
    panels = figure.subplots(2, 3, sharex="col", sharey="row")
    notes = [note for name, about in rows.items() for note in draw(panels, name, *about)]
    for axes in panels.flat:
        if not axes.lines:
            axes.set_ylim(-150, 400)  # nothing to draw yet
    if paper_marks:
        mark_paper(panels)
    frame(panels, solved)
    handles, labels = panels[1, 0].get_legend_handles_labels()
    if handles:
        columns = 2 if max(map(len, labels)) < 50 else 1
        figure.legend(handles, labels, loc="outside lower center", ncols=columns)
    if notes:
        figure.suptitle("; ".join(notes), fontsize=7, color="#B00000")
    return figure


def main() -> list[Path]:
    """Draw the figures; returns their files."""
    flat, small, ants = {}, {}, {}
    colours = (drawing.ORIGINAL, drawing.LEARNED)
    for name, experiment in EXPERIMENTS.items():
        if not experiment.is_walker:
            group = ants
        elif experiment.leg_area_reward:  # evaluated, as in 2018, with their reward factor
            group = small
        elif not experiment.hardcore:
            group = flat
        else:
            continue
        group[name] = (experiment.title, colours[len(group)])
    return [
        *drawing.save(figure_of(HARDCORE, paper_marks=True), "figure5"),
        *drawing.save(figure_of(flat, paper_marks=False), "curves"),
        *drawing.save(figure_of(small, paper_marks=False, solved=False), "curves_smaller_leg"),
        *drawing.save(figure_of(ants, paper_marks=False, solved=False), "curves_ant"),
    ]


if __name__ == "__main__":
    build.command("figure5")
