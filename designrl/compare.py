"""Learning curves of several runs side by side: in words, as a picture, as a table.

runs = read_runs(["biped/seed0", "runs/biped/seed7"])
labels(runs)                       # what differs: ["seed 0", "seed 7"]
data = curves(runs)
picture(data, "curves.svg")
write_table(data, "curves.csv")
"""

import io
from pathlib import Path

import numpy as np

from designrl.columns import Table
from designrl.errors import InputError, optional
from designrl.files import require_new, write_atomically
from designrl.recording import Recording, read
from designrl.recording.table import table
from designrl.settings import TrainSettings

SUFFIXES = (".png", ".svg", ".pdf")
# Okabe and Ito's colors, which the color-blind can tell apart; black last.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#000000")
MAX_TEXT = 60  # characters of a stranger's setting
STYLES = ("-", "--", ":", "-.")  # of the first, the second, ... round of colors
WIDTH, HEIGHT, LINE = 8.0, 3.2, 0.18  # inches; of a line of the legend


def read_runs(paths) -> list[Recording]:
    """The recordings of training runs.

    Args:
        paths: of each its recording, its folder, or the name of a published run.

    Raises:
        InputError: one cannot be read, is of something else, has no generation, or is named twice.
    """
    found: list[Recording] = []
    for path in paths:
        recording = read(path)
        if not len(recording.generations):
            raise InputError(f"{path} holds no generation of a run; name a run's folder")
        if any(recording.path.samefile(other.path) for other in found):
            raise InputError(f"{path} is named twice; name each run once")
        found.append(recording)
    return found


def labels(runs: list[Recording]) -> list[str]:
    """For each run what its settings have that those of others have not: "population 96, seed 1".

    Where nothing differs, and for one alone, the experiment and the seed; runs of equal settings
    are told apart by their folders, and in one folder by their files.
    """
    chosen, values = zip(*map(_settings, runs), strict=True)
    keys = dict.fromkeys(key for each in chosen for key in each)
    differ = [key for key in keys if len({repr(each.get(key)) for each in chosen}) > 1]
    differ = differ or ["experiment", "seed"]
    plain = []
    for own, every in zip(chosen, values, strict=True):
        # Where the recipe is named, it says the rest.
        rest = {} if "recipe" in differ else every
        found = {key: own.get(key, rest.get(key)) for key in differ}
        words = [_words(key, value) for key, value in found.items() if value is not None]
        plain.append(", ".join(words) or "otherwise the same")
    texts = plain
    for place in (lambda path: path.parent, lambda path: path):
        texts = [
            text if texts.count(text) == 1 else f"{own} ({place(run.path)})"
            for text, own, run in zip(texts, plain, runs, strict=True)
        ]
    return texts


def _settings(run: Recording) -> tuple[dict, dict]:
    """What one has to say of a run's settings, its recipe and what differs from that; and all."""
    about, settings = {"experiment": run.metadata.get("experiment")}, run.about("settings")
    all_of_them = {**settings, **about}
    if not settings:
        return about, about
    try:
        recipe, changes = TrainSettings(**all_of_them).nearest()
    except (InputError, TypeError):  # another version's
        return all_of_them, all_of_them
    return {**about, "recipe": recipe, "seed": settings.get("seed", 0), **changes}, all_of_them


def _words(key: str, value) -> str:
    name = key.replace("_", " ")
    if isinstance(value, bool):
        return name if value else f"no {name}"
    if isinstance(value, dict):
        value = " ".join(f"{term}={x}" for term, x in value.items())
    text = str(value)[:MAX_TEXT]
    return text if key == "experiment" else f"{name} {text}"


def curves(runs: list[Recording]) -> Table:
    """The curves as columns, a row for each recorded generation of each run.

    Returns: the run's label; generation, counted from 0; environment steps and core-hours up to
        its end, interpolated where a thinned recording lacks them; the population's mean return in
        training; the evaluated agent's score and the best so far; NaN where there is none.
    """
    found: dict[str, list] = {}
    for label, run in zip(labels(runs), runs, strict=True):
        columns = table(run)
        count, at = len(columns["generation"]), columns["generation"]
        held = ~np.isnan(columns["mean"])  # thinned recordings have evaluations between
        steps, seconds = (
            np.interp(at, at[held], columns[name][held]) for name in ("total_steps", "cpu_seconds")
        )
        scores = columns.get("evaluation mean", np.full(count, np.nan))
        best = np.where(np.isnan(scores), np.nan, np.fmax.accumulate(scores))
        for name, values in (
            ("run", np.full(count, label)),
            ("generation", at),
            ("environment steps", steps),
            ("core-hours", seconds / 3600),
            ("mean return in training", columns["mean"]),
            ("evaluation", scores),
            ("best evaluation", best),
        ):
            found.setdefault(name, []).append(values)
    return {name: np.concatenate(parts) for name, parts in found.items()}


def summary(data: Table) -> str:
    """A line for each run of `curves`: how far it went, and the best that it reached."""
    named = list(dict.fromkeys(data["run"].tolist()))
    width = max(map(len, named))
    lines = [f"{'run':{width}}  generations  million steps  core-hours  best evaluation"]
    for label in named:
        own = {name: values[data["run"] == label] for name, values in data.items()}
        best = own["best evaluation"][~np.isnan(own["best evaluation"])]
        lines.append(
            f"{label:{width}}  {own['generation'][-1] + 1:11,}  "
            f"{own['environment steps'][-1] / 1e6:13,.1f}  {own['core-hours'][-1]:10,.2f}  "
            + (f"{best[-1]:15.1f}" if len(best) else f"{'none':>15}")
        )
    return "\n".join(lines)


def check_target(path: str | Path) -> None:
    """Raise InputError where no picture can be written under that name."""
    if Path(path).suffix not in SUFFIXES:
        raise InputError(f"{path} would be no picture; give it a name in {', '.join(SUFFIXES)}")
    require_new(path)
    _matplotlib()


def title(runs: list[Recording]) -> str:
    """What a picture of runs is of: their experiment, where it is one."""
    experiments = {run.metadata.get("experiment", "") for run in runs}
    return experiments.pop() if len(experiments) == 1 else ""


def picture(data: Table, path: str | Path, title: str = "") -> None:
    """Draw the curves over environment steps: the population's return, the best evaluation.

    Args:
        data: from `curves`.
        path: the file to write, .png, .svg or .pdf.
        title: stands above them.

    Raises:
        InputError: another suffix, a file that exists or cannot be written, or no Matplotlib.
    """
    check_target(path)
    figure_type = _matplotlib()
    named = list(dict.fromkeys(data["run"].tolist()))
    has_scores = not np.isnan(data["evaluation"]).all()
    panels = ["mean return in training", *(["best evaluation"] if has_scores else [])]
    columns = max(1, min(3, int(110 / (max(map(len, named)) + 8))))
    size = WIDTH, HEIGHT + LINE * -(-len(named) // columns)
    figure = figure_type(figsize=size, layout="constrained")
    each = figure.subplots(1, len(panels), squeeze=False)[0]
    for i, label in enumerate(named):
        at = data["run"] == label
        style = STYLES[i // len(COLORS) % len(STYLES)]
        for axes, panel in zip(each, panels, strict=True):
            drawn = at & ~np.isnan(data[panel])
            how = {"drawstyle": "steps-post"} if panel == "best evaluation" else {"alpha": 0.8}
            x, y = data["environment steps"][drawn] / 1e6, data[panel][drawn]
            axes.plot(
                x,
                y,
                style,
                color=COLORS[i % len(COLORS)],
                marker="." if drawn.sum() == 1 else None,
                linewidth=1.2,
                label=_plain(label),
                **how,
            )
    if title:
        figure.suptitle(_plain(title), fontsize=9)
    for axes, panel in zip(each, panels, strict=True):
        axes.set_xlabel("environment steps (millions)")
        axes.set_ylabel({"best evaluation": "best evaluation so far, points"}.get(panel, panel))
        axes.set_xlim(left=0)
        axes.grid(alpha=0.3, linewidth=0.5)
    handles, texts = each[0].get_legend_handles_labels()
    figure.legend(handles, texts, loc="outside lower center", ncols=columns, fontsize=8)
    write_atomically(path, rendered(figure, Path(path).suffix[1:], dpi=150))


def rendered(figure, kind: str, dpi: int) -> bytes:
    """A figure as a file's content, "svg", "pdf" or "png", without when and by what it was made."""
    file = io.BytesIO()
    changing = {"svg": "Date", "pdf": "CreationDate", "png": "Software"}[kind]
    figure.savefig(file, format=kind, dpi=dpi, metadata={changing: None})
    return file.getvalue()


def _plain(text: str) -> str:
    """A text as Matplotlib is to draw it, which otherwise reads formulas."""
    return text[: 4 * MAX_TEXT].replace("$", r"\$")


def _matplotlib():
    with optional("pictures of curves", "view"):
        from matplotlib.figure import Figure
    return Figure
