"""README's table of results: the paper, the author's weights scored here, and our runs.

Reads paper/tables/table3.csv, paper/author.csv and paper/paper.toml, and writes the lines between
<!-- table3 --> and <!-- /table3 --> in README.md. The author's files are not ours to publish, so
their scores stand in paper/author.csv, which ZOO=path makes anew.
"""

import csv
from pathlib import Path

from tabulate import tabulate

from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS
from designrl.files import write_atomically
from reproduce import scores
from reproduce.table3 import over_runs
from reproduce.tables import as_csv, mean_and_std

START, END = "<!-- table3 -->", "<!-- /table3 -->"


def paths() -> tuple[Path, Path]:
    """The scores of the author's run 1 of each experiment, and of our runs."""
    paper = scores.ROOT / "paper"
    return paper / "author.csv", paper / "tables" / "table3.csv"


def reads() -> list[Path]:
    """The files that the table depends on."""
    return [*scores.read_for(), *paths()]


def by_experiment(path: Path) -> dict[str, dict]:
    """The rows of a CSV."""
    with path.open(encoding="utf-8") as file:
        return {record["experiment"]: record for record in csv.DictReader(file)}


def score_author() -> None:
    """Score those of the author's weights that are there, and keep the results."""
    path, _ = paths()
    kept = by_experiment(path) if path.exists() else {}
    for name in EXPERIMENTS:
        s = scores.score(scores.authors(name)[1], name)
        if not s.problem:
            kept[name] = {"experiment": name, "mean": s.mean, "std": s.std}
            kept[name] |= {"episodes": scores.EPISODES, "seed": scores.SEED, "sha256": s.sha256}
    write_atomically(path, as_csv([kept[name] for name in EXPERIMENTS if name in kept]).encode())


def table() -> str:
    """The table as Markdown."""
    printed = scores.paper()
    authors, ours = map(by_experiment, paths())
    rows = []
    for name, experiment in EXPERIMENTS.items():
        here = mean_and_std(float(authors[name]["mean"]), float(authors[name]["std"]))
        columns = ("our_means", "our_stds_over_rollouts")
        means, stds = ([float(n) for n in ours[name][column].split()] for column in columns)
        rows.append(
            [
                f"({experiment.letter})",
                experiment.title,
                "{} ± {}".format(*printed["table3"][name]),
                here,
                over_runs(means, stds) if means else "-",
                len(means),
            ]
        )
    header = ["", "Experiment", "Paper (10 runs)", "Author's run 1, here", "Ours", "Runs"]
    return tabulate(rows, header, tablefmt="github", disable_numparse=True)


def main() -> list[Path]:
    """Put the table into README.md; returns its path."""
    if scores.zoo():
        score_author()
    readme = scores.ROOT / "README.md"
    before, _, rest = readme.read_text(encoding="utf-8").partition(START)
    _, end, after = rest.partition(END)
    if not end:
        raise InputError(f"{readme} lacks the lines {START} and {END}; put them back")
    text = f"{before}{START}\n{table()}\n{END}{after}"
    write_atomically(readme, text.encode())
    return [readme]
