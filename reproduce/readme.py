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
from designrl.experiments import EXPERIMENTS
from designrl.files import write_atomically
from reproduce import scores, statistics
from reproduce.runs import read_run, recording_of
from reproduce.table3 import over_runs, verdict
from reproduce.tables import as_csv

START, END = "<!-- table3 -->", "<!-- /table3 -->"
ANSWERS, ANSWERS_END = "<!-- answers -->", "<!-- /answers -->"
OURS, AT_PAPERS = "our", "papers_settings"  # how the columns of table3.csv begin
AT_SETTINGS = {OURS: "", AT_PAPERS: ", at the paper's settings"}
HARDCORE = ("biped-hardcore", "biped-hardcore-morphology")
QUESTIONS = (
    ("Ant", "ant", "ant-morphology"),
    ("Flat ground", "biped", "biped-morphology"),
    ("Hardcore, scores", *HARDCORE),
)


def paths() -> tuple[Path, Path]:
    """The scores of the author's run 1 of each experiment, and of our runs."""
    paper = scores.ROOT / "paper"
    return paper / "author.csv", paper / "tables" / "table3.csv"


def reads() -> list[Path]:
    """The files that the table depends on."""
    read = [
        path for name in HARDCORE for source in AT_SETTINGS for path in recordings(name, source)
    ]
    return [*scores.read_for(), paths()[1], *read]


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


def our_means(source: str = "our") -> dict[str, list[float]]:
    """The average score of each of our runs, by experiment; of OURS or AT_PAPERS alone."""
    ours = by_experiment(paths()[1])
    return {name: [float(n) for n in ours[name][f"{source}_means"].split()] for name in EXPERIMENTS}


def table() -> str:
    """The table as Markdown."""
    printed, ours = scores.paper(), by_experiment(paths()[1])
    found = {source: our_means(source) for source in (OURS, AT_PAPERS)}
    rows = []
    for name, experiment in EXPERIMENTS.items():
        recipe, papers = (
            over_runs(means, [float(n) for n in ours[name][f"{source}_stds_over_rollouts"].split()])
            if (means := found[source][name])
            else "–"
            for source in (OURS, AT_PAPERS)
        )
        count = len(found[AT_PAPERS][name])
        # A row's verdict is on what it shows first, as in Table 3.
        first = found[AT_PAPERS if count >= scores.ENOUGH or recipe == "–" else OURS][name]
        cells = [f"({experiment.letter})", experiment.title]
        cells += ["{} ± {}".format(*printed["table3"][name]), recipe, len(found[OURS][name])]
        cells += [f"{papers} ({count})" if count else papers]
        said = f"{verdict(name, np.mean(first))} the paper's runs" if first else ""
        rows.append([*cells, said])
    header = ["", "Experiment", "Paper (10 runs)", "Ours", "Runs"]
    header += ["Ours, the paper's settings (runs)", "Ours is"]
    return tabulate(rows, header, tablefmt="github", disable_numparse=True)


def answers() -> str:
    """Does it hold? A list of four sentences."""
    lines = [score_answer(*asked) for asked in QUESTIONS]
    return "\n".join(f"- {line}" for line in [*lines, speed_answer()])


def score_answer(topic: str, without: str, with_: str) -> str:
    """Whether a learned body scores higher in our runs, as it does in the paper's."""
    table4 = scores.paper()["table4"]
    theirs = np.mean(table4[with_]) - np.mean(table4[without])
    parts = []
    for source in (OURS, AT_PAPERS):
        found = our_means(source)
        before, after = np.array(found[without]), np.array(found[with_])
        if min(len(before), len(after)) < (1 if source == OURS else 2):
            continue
        said = statistics.compare(before, after)
        answer = {"higher": "yes", "lower": "no"}.get(statistics.verdict(said), "not decided")
        parts.append(
            f"**{topic}{AT_SETTINGS[source]}: {answer}.** With a learned body, "
            f"{said['difference']:+,.0f} points in our runs ({len(before)} without it, "
            f"{len(after)} with it) and {theirs:+,.0f} in the paper's."
        )
    return " ".join(parts) or f"**{topic}: not known.** There are no runs of both yet."


def speed_answer() -> str:
    """Whether a learned body solves rough ground (300 points) in fewer generations."""
    said = [speed(source) for source in (OURS, AT_PAPERS)]
    if not any(said):
        return "**Hardcore, speed: not known.** There are no runs of both yet."
    printed = scores.paper()["text"]
    theirs = " and ".join(f"{printed[name]['generations']:,}" for name in HARDCORE)
    return (
        f"{' '.join(filter(None, said))} "
        f"The paper's took {theirs} generations. Solved is 300 points; "
        "[for 250 see the study](docs/studies.md"
        "#does-a-learned-body-learn-rough-ground-faster)."
    )


def speed(source: str) -> str:
    """What our runs of one source say of that; empty where there are too few."""
    parts, solved_at = [], []
    for name, words in zip(HARDCORE, ("the original body", "a learned body"), strict=True):
        runs = [read_run(path) for path in recordings(name, source) if path.exists()]
        if len(runs) < (1 if source == OURS else 2):
            return ""
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
    return f"**Hardcore, speed{AT_SETTINGS[source]}: {answer}.** {', '.join(parts)}."


def recordings(experiment: str, source: str) -> list[Path]:
    """Those of our runs of an experiment, of one source."""
    paths = scores.our_runs(experiment)[scores.OURS if source == OURS else scores.AT_PAPERS]
    return [recording_of(path) for path in paths.values()]


def put(text: str, start: str, content: str, end: str) -> str:
    """A text with other content between two of its lines."""
    before, _, rest = text.partition(start)
    _, found, after = rest.partition(end)
    if not found:
        raise InputError(f"README.md lacks the lines {start} and {end}; put them back")
    return f"{before}{start}\n{content}\n{end}{after}"


def main() -> list[Path]:
    """Put answers and table into README.md; returns its path."""
    if scores.zoo():
        score_author()
    readme = scores.ROOT / "README.md"
    text = put(readme.read_text(encoding="utf-8"), ANSWERS, answers(), ANSWERS_END)
    write_atomically(readme, put(text, START, table(), END).encode())
    return [readme]
