"""Table 4: the average score of every run, the paper's and ours.

With ZOO=path also the author's: run 1 of each experiment, and runs 2 to 10 where the folder has
zoo/more.
"""

from designrl.author import RUNS
from reproduce.paths import EIGHT, paper
from reproduce.scores import MISSING, title
from reproduce.sources import AT_PAPERS, OURS, Sources
from reproduce.tables import PAPER, Table, row

READS = tuple(EIGHT)


def tables(sources: Sources) -> list[Table]:
    printed = paper()["table4"]
    found = sources.by_source(*EIGHT)
    runs = max(
        [RUNS, *(run for found_of in found.values() for of in found_of.values() for run in of)]
    )
    rows, records, used = [], [], []
    for name, by_source in found.items():
        rows += [None] if EIGHT[name].letter in "cf" else []
        first = {"experiment": name, "source": PAPER}
        records += [first | {"run": run, "mean": m} for run, m in enumerate(printed[name], 1)]
        texts = {PAPER: dict(enumerate(map(str, printed[name]), 1))}
        for source, by_run in by_source.items():
            used += by_run.values()
            texts[source] = {
                run: "not used" if s.problem else f"{s.mean:.0f}" for run, s in by_run.items()
            }
            records += [
                {"experiment": name, "source": source, "run": run, "mean": s.mean, "std": s.std}
                | {"sha256": s.sha256}
                | ({"seed": run - 1} if source.startswith(OURS) else {})
                for run, s in by_run.items()
                if not s.problem
            ]
        if not any(texts[source] for source in (OURS, AT_PAPERS)):
            texts[OURS] = {1: MISSING}
        for source, by_run in texts.items():
            if not by_run:
                continue
            cells = [by_run.get(run + 1, "") for run in range(runs)]
            rows.append(row([title(name)], source, cells, name))
    notes = [
        "Each number is the average score of the trained agent over 100 rollouts. Of ours #1 is "
        "seed 0, and so on."
    ]
    header = ["Experiment", "", *(f"#{run + 1}" for run in range(runs))]
    heading = "Table 4: average scores of all runs, paper and ours"
    return [Table("table4", heading, header, rows, notes, records, used)]
