"""Table 3: every experiment's average score, the paper's runs and ours."""

import numpy as np

from reproduce.paths import EIGHT, paper
from reproduce.scores import MISSING, usable
from reproduce.sources import Sources
from reproduce.tables import PAPER, Cell, Table

READS = tuple(EIGHT)


def in_words(name: str, mean: float) -> str:
    """How the mean of our runs of an experiment lies to the paper's runs."""
    paper_mean, runs = paper()["table3"][name][0], paper()["table4"][name]
    difference = mean - paper_mean
    size = f"{abs(difference):.0f} ({abs(difference) / paper_mean:.1%})"
    words = f"{size} {'above' if difference > 0 else 'below'} the paper's mean"
    if abs(difference) < 0.5:
        words = "the paper's mean"
    return {
        "above": f"{words}, better than its best run ({max(runs):.0f})",
        "below": f"{words}, worse than its worst run ({min(runs):.0f})",
        "within": f"{words}, within its runs ({min(runs):.0f} to {max(runs):.0f})",
    }[verdict(name, mean)]


def verdict(name: str, mean: float) -> str:
    """ "within" the range of the paper's runs of an experiment, "above" or "below" it."""
    runs = paper()["table4"][name]  # whole points
    if mean > max(runs) + 0.5:
        return "above"
    return "below" if mean < min(runs) - 0.5 else "within"


def std_over_runs(means: list[float]) -> float:
    """Sample standard deviation, with which the paper's Table 3 follows from its Table 4."""
    return float(np.std(means, ddof=1))


def over_runs(means: list[float], stds: list[float]) -> str:
    """Mean ± std over runs as printed; of a single run, over its rollouts and with *."""
    if len(means) == 1:
        return f"{means[0]:.0f} ± {stds[0]:.1f} *"
    return f"{np.mean(means):.0f} ± {std_over_runs(means):.1f}"


def tables(sources: Sources) -> list[Table]:
    """The table."""
    printed = paper()
    header = ["", "Experiment", "Paper (10 runs)", "Ours", "Our runs", "Ours is"]
    if sources.zoo:
        header += ["Author's weights, here", "of runs (the paper's mean of these)"]
    rows, records, used = [], [], []
    runs_of = sources.by_source(*EIGHT)
    for name, experiment in EIGHT.items():
        rows += [None] if experiment.letter in "cf" else []
        found = runs_of[name]
        used += [s for runs in found.values() for s in runs.values()]
        ours = found["ours"].values()
        means, stds = [s.mean for s in usable(ours)], [s.std for s in usable(ours)]
        value, words = "-", "no usable checkpoint" if ours else MISSING
        if means:
            value, words = Cell(over_runs(means, stds), name), in_words(name, np.mean(means))
        words += "".join(f"; not used: {s.problem}" for s in ours if s.problem)
        paper_mean, paper_std = printed["table3"][name]
        cells = [f"({experiment.letter})", experiment.title]
        cells += [Cell(f"{paper_mean} ± {paper_std}", PAPER), value, str(len(means)), words]
        record = {
            "experiment": name,
            "paper_mean": paper_mean,
            "paper_std_over_runs": paper_std,
            "our_mean": np.mean(means) if means else "",
            "our_std_over_runs": std_over_runs(means) if len(means) > 1 else "",
            "our_runs": len(means),
            "our_means": " ".join(f"{mean:.4f}" for mean in means),
            "our_stds_over_rollouts": " ".join(f"{std:.4f}" for std in stds),
            "checkpoints": " ".join(s.sha256 for s in usable(ours)),
        }
        if sources.zoo:
            theirs = found["author's weights"]
            good = {run: s for run, s in theirs.items() if not s.problem}
            means, stds = [s.mean for s in good.values()], [s.std for s in good.values()]
            if good:
                same = np.mean([printed["table4"][name][run - 1] for run in good])
                cells += [over_runs(means, stds), f"{', '.join(map(str, good))} ({same:.0f})"]
            else:
                cells += [theirs[1].problem, ""]
            record["author_means"] = " ".join(f"{mean:.4f}" for mean in means)
            record["author_runs"] = " ".join(map(str, good))
        rows.append(cells)
        records.append(record)
    note = "Mean ± sample standard deviation over runs of the average score of 100 rollouts."
    if any(str(cell).endswith("*") for cells in filter(None, rows) for cell in cells):
        note += " *: one run; the standard deviation is over its rollouts."
    table = Table(
        "table3",
        "Table 3: average scores of independent runs, paper and ours",
        header=header,
        rows=rows,
        notes=[note],
        records=records,
        scores=used,
    )
    return [table]
