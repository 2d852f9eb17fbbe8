"""PPO on the original body and on learned ones: does a learned body help another learner, too?

Reads paper/transfer/TASK/BODY/seedN.csv, which `make transfer` trains (train_ppo.py): steps of
training, and the mean of an evaluation's episodes. CAPTIONS says what is drawn, `answer` what
comes out.
"""

import csv
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from designrl.errors import InputError
from reproduce import drawing, paths
from reproduce.curves import STEPS
from reproduce.sources import Sources
from reproduce.statistics import compare, difference, mean_interval, verdict

CAPTIONS = {
    "transfer": (
        "A learned body and another learner",
        "PPO (Stable-Baselines3, with RL Baselines3 Zoo's settings for this walker but larger "
        "minibatches, and on hardcore more environments and a larger learning rate) on the "
        "original body and on one that our training had learned. The score of an evaluation over "
        "steps of training: thin, of each seed; thick, the mean over seeds, with a bootstrap 95 % "
        "interval. Dashed: 300 points, solved.",
    )
}
TASKS = {"flat": "Flat ground", "hardcore": "Hardcore"}
BODIES = {"original": drawing.ORIGINAL, "learned": drawing.LEARNED}


def curves(task: str, body: str) -> list[Path]:
    """The curves of a body, by seed."""
    return sorted((paths.ROOT / "paper" / "transfer" / task / body).glob("seed*.csv"))


def reads(sources: Sources) -> list[Path]:
    """The files that the figure depends on."""
    return [path for task in TASKS for body in BODIES for path in curves(task, body)]


def read_curves(files: list[Path]) -> tuple[np.ndarray, np.ndarray]:
    """(E,) steps and (S, E) scores of S seeds.

    Raises:
        InputError: a file that is no curve, or whose steps are not those of the first.
    """
    found = []
    for path in files:
        lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
        try:
            rows = [(int(row["steps"]), float(row["mean"])) for row in csv.DictReader(lines)]
        except (KeyError, TypeError, ValueError):
            raise InputError(f"{path} is not a curve of train_ppo.py; make it anew") from None
        found.append(np.array(rows, dtype=np.float64).reshape(-1, 2).T)
        if not np.array_equal(found[0][0], found[-1][0]):
            raise InputError(f"{path} has other steps than {files[0]}; train both for as long")
    return found[0][0], np.array([means for _, means in found])


def draw(axes: Axes, task: str, body: str) -> None:
    """Draw the curves of a body on a task."""
    files = curves(task, body)
    if not files:
        return
    steps, means = read_curves(files)
    at, colour = steps / 1e6, BODIES[body]
    label = f"{body} body ({len(files)} {'seeds' if len(files) > 1 else 'seed'})"
    axes.plot(at, means.T, color=colour, linewidth=0.4, alpha=0.5)
    axes.plot(at, means.mean(axis=0), color=colour, label=label)
    low, high = np.transpose([mean_interval(values) for values in means.T])
    axes.fill_between(at, low, high, color=colour, alpha=0.2, linewidth=0)


def answer() -> str:
    """What the learned body changes for PPO, a line for each task."""
    lines = []
    for task, title in TASKS.items():
        original, learned = (curves(task, body) for body in BODIES)
        if not (original and learned):
            lines.append(f"- {title}: no curves of both bodies yet.")
            continue
        steps, means = read_curves(original + learned)
        of_bodies, last = np.split(means, [len(original)]), -(-len(steps) // 10)
        parts = {"at the end": slice(-last, None), "on average over the training": slice(None)}
        said = [
            in_words(*(of_body[:, part].mean(axis=1) for of_body in of_bodies), when)
            for when, part in parts.items()
        ]
        lines.append(f"- {title}: {'; '.join(said)}.")
    return "\n".join(lines)


def in_words(original: np.ndarray, learned: np.ndarray, when: str) -> str:
    """The scores (S,) of each body's seeds as words: means, their difference, a verdict."""
    c = compare(original, learned)
    means = (
        f"{learned.mean():.0f} points on the learned body, {original.mean():.0f} on the original"
    )
    chance = "" if np.isnan(c["p"]) else f", p = {c['p']:.2g}"
    return f"{when} {means}: {difference(c)} ({verdict(c)}{chance})"


def figures(sources: Sources) -> dict[str, Figure]:
    figure = Figure(figsize=(drawing.WIDTH, 2.3), layout="constrained")
    for axes, (task, title) in zip(figure.subplots(1, len(TASKS)), TASKS.items(), strict=True):
        for body in BODIES:
            draw(axes, task, body)
        axes.set_title(title if axes.lines else f"{title}: no curve yet")
        drawing.line_of_solved(axes)
        axes.set_ylim(-150, 360)
        axes.set_xlabel(STEPS)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="lower right")
    figure.axes[0].set_ylabel("score (points)")
    return {"transfer": figure}
