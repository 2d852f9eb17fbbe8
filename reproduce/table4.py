"""Table 4: the average score of every run, the paper's and ours.

Reads pretrained/ and paper/paper.toml; with ZOO=path also the author's weights: run 1 of each
experiment, and runs 2 to 10 where the folder has zoo/more.

    make reproduce-table4
"""

from designrl.experiments import EXPERIMENTS
from designrl.published import RUNS
from reproduce import scores
from reproduce.tables import MISSING, PAPER, Table, row

READS = tuple(EXPERIMENTS)


def tables() -> list[Table]:
    """The table."""
    printed = scores.paper()["table4"]
    ours, authors = scores.pretrained_scores(), scores.authors_scores()
    runs = max(RUNS, *map(len, ours.values()))
    rows, records, seeds = [], [], []

    def add(name: str, source: str, texts: dict[int, str]) -> None:
        title = f"({EXPERIMENTS[name].letter}) {EXPERIMENTS[name].title}"
        rows.append(row([title], source, [texts.get(run + 1, "") for run in range(runs)], name))

    for name, experiment in EXPERIMENTS.items():
        rows += [None] if experiment.letter in "cf" else []
        add(name, PAPER, {run: str(value) for run, value in enumerate(printed[name], 1)})
        records += [
            {"experiment": name, "source": PAPER, "run": run, "mean": value}
            for run, value in enumerate(printed[name], 1)
        ]
        found = {"ours": dict(enumerate(ours[name], 1)), "author's weights": authors[name]}
        for source, by_run in found.items():
            if not by_run and source != "ours":
                continue
            texts = {run: "not used" if s.problem else f"{s.mean:.0f}" for run, s in by_run.items()}
            add(name, source, texts or {1: MISSING})
            records += [
                {"experiment": name, "source": source, "run": run, "mean": s.mean, "std": s.std}
                | {"sha256": s.sha256}
                for run, s in by_run.items()
                if not s.problem
            ]
        if ours[name]:
            seeds.append(f"({experiment.letter}) {', '.join(s.run for s in ours[name])}")
    notes = ["Each number is the average score of the trained agent over 100 rollouts."]
    if seeds:
        notes.append(f"Our runs from #1 on: {'; '.join(seeds)}.")
    return [
        Table(
            "table4",
            "Table 4: average scores of all runs, paper and ours",
            ["Experiment", "", *(f"#{run + 1}" for run in range(runs))],
            rows,
            notes,
            records,
            [s for name in EXPERIMENTS for s in (*ours[name], *authors[name].values())],
        )
    ]
