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
    runs = max(RUNS, *(len(sources["ours"]) for sources in found.values()))
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
            } or {1: scores.MISSING}
            records += [
                {"experiment": name, "source": source, "run": run, "mean": s.mean, "std": s.std}
                | {"sha256": s.sha256}
                | ({"seed": run - 1} if source == "ours" else {})
                for run, s in by_run.items()
                if not s.problem
            ]
        for source, by_run in texts.items():
            cells = [by_run.get(run + 1, "") for run in range(runs)]
            rows.append(row([scores.title(name)], source, cells, name))
    notes = [
        "Each number is the average score of the trained agent over 100 rollouts. Of ours #1 is "
        "seed 0, and so on."
    ]
    header = ["Experiment", "", *(f"#{run + 1}" for run in range(runs))]
    title = "Table 4: average scores of all runs, paper and ours"
    return [Table("table4", title, header, rows, notes, records, used)]
