"""Table 4: the average score of every run, the paper's and ours.

Reads pretrained/ and paper/paper.toml; with ZOO=path also the author's weights: run 1 of each
experiment, and runs 2 to 10 where the folder has zoo/more. Writes paper/tables/table4.md, .tex and
.csv, and prints the table.

    make reproduce-table4
"""

from pathlib import Path

from designrl.experiments import EXPERIMENTS
from reproduce import build, scores
from reproduce.scores import Score
from reproduce.tables import MISSING, origin_notes, scoring_note, write_table


def reads() -> list[Path]:
    """The files that the table depends on."""
    return scores.read_for(*EXPERIMENTS)


def cell(s: Score) -> str:
    """The average score, or that it could not be had (the notes say why)."""
    return "not used" if s.problem else f"{s.mean:.0f}"


def main() -> list[Path]:
    """Write the table; returns its files."""
    printed = scores.paper()["table4"]
    ours = scores.pretrained_scores()
    zoo = scores.zoo_argument()
    authors = scores.published_scores(zoo)
    runs = max(scores.PUBLISHED_RUNS, *map(len, ours.values()))
    rows, records, seeds = [], [], []
    for name, experiment in EXPERIMENTS.items():
        if experiment.letter in "cf":
            rows.append(None)
        title = f"({experiment.letter}) {experiment.title}"
        values = [str(value) for value in printed[name]]
        rows.append([title, "paper", *values, *[""] * (runs - len(values))])
        records += [
            {"experiment": name, "source": "paper", "run": i + 1, "mean": value, "std": ""}
            | {"sha256": ""}
            for i, value in enumerate(printed[name])
        ]
        cells = [cell(s) for s in ours[name]] or [MISSING]
        rows.append([title, "ours", *cells, *[""] * (runs - len(cells))])
        if ours[name]:
            names = ", ".join(scores.seed_of(s.path) for s in ours[name])
            seeds.append(f"({experiment.letter}) {names}")
        if zoo:
            theirs = [authors[name].get(run + 1) for run in range(runs)]
            cells = [cell(s) if s else "" for s in theirs]
            rows.append([title, "author's weights", *cells])
        found = [("ours", i + 1, s) for i, s in enumerate(ours[name])]
        found += [("author's weights", run, s) for run, s in authors[name].items()]
        records += [
            {"experiment": name, "source": source, "run": run, "mean": s.mean, "std": s.std}
            | {"sha256": s.sha256}
            for source, run, s in found
            if not s.problem
        ]
    notes = ["Each number is the average score of the trained agent over 100 rollouts."]
    if seeds:
        notes.append(f"Our runs from #1 on: {'; '.join(seeds)}.")
    notes.append(scoring_note())
    notes += origin_notes(s for name in EXPERIMENTS for s in (*ours[name], *authors[name].values()))
    header = ["Experiment", "", *(f"#{run + 1}" for run in range(runs))]
    return write_table(
        "table4",
        "Table 4: average scores of all runs, paper and ours",
        header,
        rows,
        notes,
        records,
    )


if __name__ == "__main__":
    build.command("table4")
