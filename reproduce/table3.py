"""Table 3: every experiment's average score, the paper's runs and ours.

Reads pretrained/ and paper/paper.toml; with ZOO=path also the author's weights. Writes
paper/tables/table3.md, .tex and .csv, and prints the table.

    make reproduce-table3
    make reproduce-table3 ZOO=path/to/the/2018/zoo
"""

from pathlib import Path

import numpy as np

from designrl.experiments import EXPERIMENTS
from reproduce import build, scores
from reproduce.scores import Score
from reproduce.tables import MISSING, origin_notes, scoring_note, write_table


def reads() -> list[Path]:
    """The files that the table depends on."""
    return scores.read_for(*EXPERIMENTS)


def in_words(ours: list[float], paper_mean: float, paper_runs: list[float]) -> str:
    """How the mean of our runs lies to the paper's runs."""
    mean = float(np.mean(ours))
    low, high = min(paper_runs), max(paper_runs)
    difference = mean - paper_mean
    size = f"{abs(difference):.0f} ({abs(difference) / paper_mean:.1%})"
    if abs(difference) < 0.5:
        words = "the paper's mean"
    else:
        words = f"{size} {'above' if difference > 0 else 'below'} the paper's mean"
    if mean > high + 0.5:
        return f"{words}, better than its best run ({high:.0f})"
    if mean < low - 0.5:
        return f"{words}, worse than its worst run ({low:.0f})"
    return f"{words}, within its runs ({low:.0f} to {high:.0f})"


def std_over_runs(means: list[float]) -> float:
    """Sample standard deviation, with which the paper's Table 3 follows from its Table 4."""
    return float(np.std(means, ddof=1))


def summary(found: list[Score]) -> str:
    """Mean ± std over runs as printed; of a single run, over its rollouts and with *."""
    if len(found) == 1:
        return f"{found[0].mean:.0f} ± {found[0].std:.1f} *"
    means = [s.mean for s in found]
    return f"{np.mean(means):.0f} ± {std_over_runs(means):.1f}"


def main() -> list[Path]:
    """Write the table; returns its files."""
    printed = scores.paper()
    zoo = scores.zoo_argument()
    ours = scores.pretrained_scores()
    authors = scores.published_scores(zoo)

    header = ["", "Experiment", "Paper (10 runs)", "Ours", "Our runs", "Ours is"]
    if zoo:
        header += ["Author's weights, here", "of runs (the paper's mean of these)"]
    rows, records = [], []
    for name, experiment in EXPERIMENTS.items():
        if experiment.letter in "cf":
            rows.append(None)
        paper_mean, paper_std = printed["table3"][name]
        good = [s for s in ours[name] if not s.problem]
        means = [s.mean for s in good]
        value, words = "-", "no usable checkpoint" if ours[name] else MISSING
        if good:
            value, words = summary(good), in_words(means, paper_mean, printed["table4"][name])
        for bad in (s for s in ours[name] if s.problem):
            words += f"; not used: {bad.problem}"
        row = [f"({experiment.letter})", experiment.title, f"{paper_mean} ± {paper_std}"]
        row += [value, str(len(good)), words]
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
        if zoo:
            theirs = {run: s for run, s in authors[name].items() if not s.problem}
            if theirs:
                same = np.mean([printed["table4"][name][run - 1] for run in theirs])
                row += [summary(list(theirs.values())), f"{_ranges(theirs)} ({same:.0f})"]
            else:
                row += [authors[name][1].problem, ""]
            record["author_means"] = " ".join(f"{s.mean:.4f}" for s in theirs.values())
            record["author_runs"] = " ".join(map(str, theirs))
        rows.append(row)
        records.append(record)

    notes = [
        "Mean ± sample standard deviation over runs of the average score of 100 rollouts. "
        "*: one run; the standard deviation is over its rollouts.",
        scoring_note(),
        *origin_notes(s for name in EXPERIMENTS for s in (*ours[name], *authors[name].values())),
    ]
    title = "Table 3: average scores of independent runs, paper and ours"
    return write_table("table3", title, header, rows, notes, records)


def _ranges(runs) -> str:
    numbers = sorted(runs)
    if len(numbers) > 2 and numbers == list(range(numbers[0], numbers[-1] + 1)):
        return f"{numbers[0]} to {numbers[-1]}"
    return ", ".join(map(str, numbers))


if __name__ == "__main__":
    build.command("table3")
