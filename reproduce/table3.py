"""Table 3: every experiment's average score, the paper's runs and ours.

Reads pretrained/ and paper/paper.toml; with ZOO=path also the author's weights. Writes
paper/tables/table3.md, .tex and .csv, and prints the table.

    make reproduce-table3
    make reproduce-table3 ZOO=path/to/the/2018/zoo
"""

import numpy as np

from designrl.checkpoint import versions
from designrl.experiments import EXPERIMENTS
from reproduce import scores
from reproduce.tables import write_table


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


def mean_and_std(values: list[float]) -> str:
    """As the paper prints it."""
    return f"{np.mean(values):.0f} ± {np.std(values):.1f}"


def main() -> None:
    """Print and write the table."""
    printed = scores.paper()
    zoo = scores.zoo_argument()
    ours = scores.pretrained_scores()
    authors = scores.published_scores(zoo) if zoo else {}

    header = ["", "Experiment", "Paper (10 runs)", "Ours", "Our runs", "Ours is"]
    if zoo:
        header.append("Author's weights, here (paper's run 1)")
    rows, records, origins = [], [], []
    for name, experiment in EXPERIMENTS.items():
        paper_mean, paper_std = printed["table3"][name]
        good = [s for s in ours[name] if not s.problem]
        means = [s.mean for s in good]
        if not good:
            value, words = "-", "no checkpoint yet"
        elif len(good) == 1:
            value = f"{good[0].mean:.0f} ± {good[0].std:.1f} *"
            words = in_words(means, paper_mean, printed["table4"][name])
        else:
            value = mean_and_std(means)
            words = in_words(means, paper_mean, printed["table4"][name])
        for bad in (s for s in ours[name] if s.problem):
            words += f"; not used: {bad.problem}"
        row = [
            f"({experiment.letter})",
            experiment.title,
            f"{paper_mean} ± {paper_std}",
            value,
            str(len(good)),
            words,
        ]
        if zoo:
            theirs = authors[name]
            row.append(
                theirs.problem
                or f"{theirs.mean:.0f} ± {theirs.std:.1f} ({printed['table4'][name][0]})"
            )
        rows.append(row)
        records.append(
            {
                "experiment": name,
                "paper_mean": paper_mean,
                "paper_std_over_runs": paper_std,
                "our_mean": np.mean(means) if good else "",
                "our_std_over_runs": np.std(means) if len(good) > 1 else "",
                "our_runs": len(good),
                "our_means": " ".join(f"{m:.4f}" for m in means),
                "our_stds_over_rollouts": " ".join(f"{s.std:.4f}" for s in good),
                "checkpoints": " ".join(s.sha256 for s in good),
            }
        )
        if zoo:
            records[-1]["author_mean"] = "" if theirs.problem else theirs.mean
            records[-1]["author_std_over_rollouts"] = "" if theirs.problem else theirs.std
        origins += [
            f"- `{scores.shown(s.path)}` (sha256 {s.sha256[:16]}): {s.mean:.1f} ± {s.std:.1f}, "
            f"{s.agent.metadata.get('environment_steps', 0):,} training steps"
            for s in good
        ]

    used = versions()
    notes = [
        "Mean ± standard deviation over runs of the average score of 100 rollouts. "
        "*: one run; the standard deviation is over its rollouts.",
        f"Scored on the reference environments, {scores.EPISODES} episodes, evaluation seed "
        f"{scores.SEED}; designrl {used['designrl']} (sources {used['sources']}), "
        f"Gymnasium {used['gymnasium']}, box2d-py {used['box2d-py']}, "
        f"PyBullet {used['pybullet']}.",
    ]
    if origins:
        notes.append("Our runs:\n\n" + "\n".join(origins))
    title = "Table 3: average scores of independent runs, paper and ours"
    print(write_table("table3", title, header, rows, notes, records))


if __name__ == "__main__":
    main()
