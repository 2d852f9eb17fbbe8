"""Table 3: every experiment's average score, the paper's runs and ours.

Reads pretrained/ and paper/paper.toml; with ZOO=path also the author's weights.

    make reproduce-table3
    make reproduce-table3 ZOO=path/to/the/2018/zoo
"""

import numpy as np

from designrl.experiments import EXPERIMENTS
from reproduce import scores
from reproduce.scores import Score, usable
from reproduce.tables import MISSING, PAPER, Cell, Table

READS = tuple(EXPERIMENTS)


def in_words(name: str, means: list[float]) -> str:
    """How the mean of our runs of an experiment lies to the paper's runs."""
    printed = scores.paper()
    paper_mean, runs = printed["table3"][name][0], printed["table4"][name]
    mean = float(np.mean(means))
    difference = mean - paper_mean
    size = f"{abs(difference):.0f} ({abs(difference) / paper_mean:.1%})"
    words = f"{size} {'above' if difference > 0 else 'below'} the paper's mean"
    if abs(difference) < 0.5:
        words = "the paper's mean"
    if mean > max(runs) + 0.5:
        return f"{words}, better than its best run ({max(runs):.0f})"
    if mean < min(runs) - 0.5:
        return f"{words}, worse than its worst run ({min(runs):.0f})"
    return f"{words}, within its runs ({min(runs):.0f} to {max(runs):.0f})"


def std_over_runs(means: list[float]) -> float:
    """Sample standard deviation, with which the paper's Table 3 follows from its Table 4."""
    return float(np.std(means, ddof=1))


def over_runs(means: list[float], stds: list[float]) -> str:
    """Mean ± std over runs as printed; of a single run, over its rollouts and with *."""
    if len(means) == 1:
        return f"{means[0]:.0f} ± {stds[0]:.1f} *"
    return f"{np.mean(means):.0f} ± {std_over_runs(means):.1f}"


def _summary(found: list[Score]) -> str:
    return over_runs([s.mean for s in found], [s.std for s in found])


def tables() -> list[Table]:
    """The table."""
    printed = scores.paper()
    ours, authors = scores.pretrained_scores(), scores.authors_scores()
    header = ["", "Experiment", "Paper (10 runs)", "Ours", "Our runs", "Ours is"]
    if scores.zoo():
        header += ["Author's weights, here", "of runs (the paper's mean of these)"]
    rows, records = [], []
    for name, experiment in EXPERIMENTS.items():
        rows += [None] if experiment.letter in "cf" else []
        paper_mean, paper_std = printed["table3"][name]
        good = usable(ours[name])
        means = [s.mean for s in good]
        value, words = "-", "no usable checkpoint" if ours[name] else MISSING
        if good:
            value, words = Cell(_summary(good), name), in_words(name, means)
        words += "".join(f"; not used: {s.problem}" for s in ours[name] if s.problem)
        cells = [f"({experiment.letter})", experiment.title]
        cells += [Cell(f"{paper_mean} ± {paper_std}", PAPER), value, str(len(good)), words]
        record = {
            "experiment": name,
            "paper_mean": paper_mean,
            "paper_std_over_runs": paper_std,
            "our_mean": np.mean(means) if good else "",
            "our_std_over_runs": std_over_runs(means) if len(good) > 1 else "",
            "our_runs": len(good),
            "our_means": " ".join(f"{m:.4f}" for m in means),
            "our_stds_over_rollouts": " ".join(f"{s.std:.4f}" for s in good),
            "checkpoints": " ".join(s.sha256 for s in good),
        }
        if scores.zoo():
            theirs = {run: s for run, s in authors[name].items() if not s.problem}
            if theirs:
                same = np.mean([printed["table4"][name][run - 1] for run in theirs])
                runs = ", ".join(map(str, theirs))
                cells += [_summary(list(theirs.values())), f"{runs} ({same:.0f})"]
            else:
                cells += [authors[name][1].problem, ""]
            record["author_means"] = " ".join(f"{s.mean:.4f}" for s in theirs.values())
            record["author_runs"] = " ".join(map(str, theirs))
        rows.append(cells)
        records.append(record)
    return [
        Table(
            "table3",
            "Table 3: average scores of independent runs, paper and ours",
            header,
            rows,
            [
                "Mean ± sample standard deviation over runs of the average score of 100 rollouts. "
                "*: one run; the standard deviation is over its rollouts."
            ],
            records,
            [s for name in EXPERIMENTS for s in (*ours[name], *authors[name].values())],
        )
    ]
