"""Table 4: the average score of every run, the paper's and ours.

With ZOO=path also the author's: run 1 of each experiment, and runs 2 to 10 where the folder has
zoo/more.
"""

from designrl.author import RUNS
from designrl.experiments import EXPERIMENTS
from reproduce import scores
from reproduce.tables import PAPER, Table, row

READS = tuple(EXPERIMENTS)


def tables() -> list[Table]:
    """The table."""
    printed = scores.paper()["table4"]
    found = scores.by_source(*EXPERIMENTS)
    runs = max(
        [RUNS, *(run for found_of in found.values() for of in found_of.values() for run in of)]
    )
    rows, records, used = [], [], []
    for name, sources in found.items():
        rows += [None] if EXPERIMENTS[name].letter in "cf" else []
        first = {"experiment": name, "source": PAPER}
        records += [first | {"run": run, "mean": m} for run, m in enumerate(printed[name], 1)]
        texts = {PAPER: dict(enumerate(map(str, printed[name]), 1))}
        for source, by_run in sources.items():
            used += by_run.values()
            texts[source] = {
                run: "not used" if s.problem else f"{s.mean:.0f}" for run, s in by_run.items()
            }
            records += [
                {"experiment": name, "source": source, "run": run, "mean": s.mean, "std": s.std}
                | {"sha256": s.sha256}
                | ({"seed": run - 1} if source.startswith(scores.OURS) else {})
                for run, s in by_run.items()
                if not s.problem
            ]
        if not any(texts[source] for source in (scores.OURS, scores.AT_PAPERS)):
            texts[scores.OURS] = {1: scores.MISSING}
        for source, by_run in texts.items():
            if not by_run:
                continue
            cells = [by_run.get(run + 1, "") for run in range(runs)]
            rows.append(row([scores.title(name)], source, cells, name))
    notes = [
        "Each number is the average score of the trained agent over 100 rollouts. Of ours #1 is "
        "seed 0, and so on."
    ]
    header = ["Experiment", "", *(f"#{run + 1}" for run in range(runs))]
    title = "Table 4: average scores of all runs, paper and ours"
    return [Table("table4", title, header, rows, notes, records, used)]
