"""README's first screen: does it hold, in four sentences, and the table of results.

Reads paper/tables/table3.csv, paper/paper.toml and hardcore's recordings, and writes the lines
between <!-- answers --> and <!-- /answers -->, and between <!-- table3 --> and <!-- /table3 -->, in
README.md. The scores of the author's weights, which docs/fidelity.md shows, stand in
paper/author.csv, which ZOO=path makes anew: his files are not ours to publish.
"""

import csv
from pathlib import Path

import numpy as np
from tabulate import tabulate

from designrl.errors import InputError
from designrl.files import write_atomically
from reproduce import paths, statistics
from reproduce.paths import EIGHT, paper, pretrained, recording_of
from reproduce.runs import read_published
from reproduce.scores import EPISODES, SEED
from reproduce.sources import Sources
from reproduce.table3 import over_runs, verdict
from reproduce.tables import as_csv

START, END = "<!-- table3 -->", "<!-- /table3 -->"
ANSWERS, ANSWERS_END = "<!-- answers -->", "<!-- /answers -->"
HARDCORE = ("biped-hardcore", "biped-hardcore-morphology")
QUESTIONS = (
    ("Ant", "ant", "ant-morphology"),
    ("Flat ground", "biped", "biped-morphology"),
    ("Hardcore, scores", *HARDCORE),
)


def files() -> tuple[Path, Path]:
    """The scores of the author's run 1 of each experiment, and of our runs."""
    folder = paths.ROOT / "paper"
    return folder / "author.csv", folder / "tables" / "table3.csv"


def reads(sources: Sources) -> list[Path]:
    """The files that the table depends on."""
    read = [path for name in HARDCORE for path in recordings(name)]
    return [*sources.read_for(), files()[1], *read]


def by_experiment(path: Path) -> dict[str, dict]:
    """The rows of a CSV."""
    with path.open(encoding="utf-8") as file:
        return {record["experiment"]: record for record in csv.DictReader(file)}


def score_author(sources: Sources) -> None:
    """Score those of the author's weights that are there, and keep the results."""
    path, _ = files()
    kept = by_experiment(path) if path.exists() else {}
    for name in EIGHT:
        s = sources.score(sources.authors(name)[1], name)
        if not s.problem:
            kept[name] = {"experiment": name, "mean": s.mean, "std": s.std}
            kept[name] |= {"episodes": EPISODES, "seed": SEED, "sha256": s.sha256}
    write_atomically(path, as_csv([kept[name] for name in EIGHT if name in kept]).encode())


def our_means() -> dict[str, list[float]]:
    """The average score of each of our runs, by experiment."""
    ours = by_experiment(files()[1])
    return {name: [float(n) for n in ours[name]["our_means"].split()] for name in EIGHT}


def table() -> str:
    """The table as Markdown."""
    printed, ours, found = paper(), by_experiment(files()[1]), our_means()
    rows = []
    for name, experiment in EIGHT.items():
        means = found[name]
        stds = [float(n) for n in ours[name]["our_stds_over_rollouts"].split()]
        cells = [f"({experiment.letter})", experiment.title]
        cells += ["{} ± {}".format(*printed["table3"][name])]
        cells += [over_runs(means, stds) if means else "-", len(means)]
        said = f"{verdict(name, np.mean(means))} the paper's runs" if means else ""
        rows.append([*cells, said])
    header = ["", "Experiment", "Paper (10 runs)", "Ours", "Runs", "Ours is"]
    return tabulate(rows, header, tablefmt="github", disable_numparse=True)


def answers() -> str:
    """Does it hold? A list of four sentences."""
    found = our_means()
    lines = [score_answer(*asked, found) for asked in QUESTIONS]
    return "\n".join(f"- {line}" for line in [*lines, speed_answer()])


def score_answer(topic: str, without: str, with_: str, found: dict[str, list[float]]) -> str:
    """Whether a learned body scores higher in our runs, as it does in the paper's."""
    before, after = np.array(found[without]), np.array(found[with_])
    if not (len(before) and len(after)):
        return f"**{topic}: not known.** There are no runs of both yet."
    said = statistics.compare(before, after)
    answer = {"higher": "yes", "lower": "no"}.get(statistics.verdict(said), "not decided")
    table4 = paper()["table4"]
    theirs = np.mean(table4[with_]) - np.mean(table4[without])
    return (
        f"**{topic}: {answer}.** With a learned body, {said['difference']:+,.0f} points in our "
        f"runs ({len(before)} without it, {len(after)} with it) and {theirs:+,.0f} in the paper's."
    )


def speed_answer() -> str:
    """Whether a learned body solves rough ground (300 points) in fewer generations."""
    parts, solved_at = [], []
    for name, words in zip(HARDCORE, ("the original body", "a learned body"), strict=True):
        runs = [read_published(path) for path in recordings(name) if path.exists()]
        if not runs:
            return "**Hardcore, speed: not known.** There are no runs of both yet."
        at = [np.inf if run.solved_at() is None else run.solved_at() + 1 for run in runs]
        solved_at.append(at)
        solved = sorted(n for n in at if n < np.inf)
        when = " to ".join(f"{n:,.0f}" for n in dict.fromkeys(solved[:1] + solved[-1:]))
        parts.append(
            f"{len(solved)} of {len(runs)} runs with {words} solved it"
            + (f" (generation {when} of {int(runs[0].generation[-1]) + 1:,})" if solved else "")
        )
    # By ranks: a run that never solved it is the slowest, however long it was.
    order = np.unique(np.concatenate(solved_at))
    original, learned = (np.searchsorted(order, at) for at in solved_at)
    answer = "yes" if learned.mean() < original.mean() else "no"
    if statistics.permutation_p(original, learned) >= statistics.SIGNIFICANT:
        answer = "not decided"
    printed = paper()["text"]
    theirs = " and ".join(f"{printed[name]['generations']:,}" for name in HARDCORE)
    return (
        f"**Hardcore, speed: {answer}.** {', '.join(parts)}. "
        f"The paper's took {theirs} generations. Solved is 300 points; "
        "[for 250 see the study](docs/studies.md"
        "#does-a-learned-body-learn-rough-ground-faster)."
    )


def recordings(experiment: str) -> list[Path]:
    """Those of our runs of an experiment."""
    return [recording_of(path) for path in pretrained(experiment)]


def put(text: str, start: str, content: str, end: str) -> str:
    """A text with other content between two of its lines."""
    before, _, rest = text.partition(start)
    _, found, after = rest.partition(end)
    if not found:
        raise InputError(f"README.md lacks the lines {start} and {end}; put them back")
    return f"{before}{start}\n{content}\n{end}{after}"


def main(sources: Sources) -> list[Path]:
    """Put answers and table into README.md; returns its path."""
    if sources.zoo:
        score_author(sources)
    readme = paths.ROOT / "README.md"
    text = put(readme.read_text(encoding="utf-8"), ANSWERS, answers(), ANSWERS_END)
    write_atomically(readme, put(text, START, table(), END).encode())
    return [readme]
