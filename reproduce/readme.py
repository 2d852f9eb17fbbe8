"""README's first screen: does it hold, in five answers, and the table of results.

Reads tables 2 and 3, paper/paper.toml and hardcore's recordings, and writes the lines
between <!-- answers --> and <!-- /answers -->, and between <!-- table3 --> and <!-- /table3 -->, in
README.md. The scores of the author's weights, which docs/fidelity.md shows, stand in
paper/author.csv, which ZOO=path makes anew: his files are not ours to publish.
"""

from functools import partial
from pathlib import Path

import numpy as np

from designrl.errors import InputError
from designrl.files import write_atomically
from designrl.settings import TrainSettings
from reproduce import paths, statistics
from reproduce.curves import HARDCORE
from reproduce.paths import EIGHT, paper, recording_of
from reproduce.runs import SOLVED, read_published
from reproduce.scores import EPISODES, SEED, score
from reproduce.sources import AT_PAPERS, OURS, Sources, our_runs
from reproduce.table2 import our_leg_areas
from reproduce.tables import as_csv, csv_file, read_csv

START, END = "<!-- table3 -->", "<!-- /table3 -->"
ANSWERS, ANSWERS_END = "<!-- answers -->", "<!-- /answers -->"
COLUMNS = {OURS: "our", AT_PAPERS: "papers_settings"}  # how those of table3.csv begin
AT_SETTINGS = {OURS: "", AT_PAPERS: ", at the paper's settings"}
QUESTIONS = (
    ("Ant", "ant", "ant-morphology"),
    ("Flat ground", "biped", "biped-morphology"),
    ("Hardcore (rough ground), scores", *HARDCORE),
)


def reads(sources: Sources) -> list[Path]:
    """The files that the table depends on."""
    read = [path for name in HARDCORE for source in COLUMNS for path in recordings_of(name, source)]
    table3 = csv_file("table3")
    return [*sources.read_for(), csv_file("table2"), table3, table3.with_suffix(".md"), *read]


def by_experiment(path: Path) -> dict[str, dict]:
    """The rows of a CSV."""
    return {row["experiment"]: row for row in read_csv(path)}


def score_author(sources: Sources) -> None:
    """Score those of the author's weights that are there, and keep the results."""
    path = paths.ROOT / "paper" / "author.csv"
    kept = by_experiment(path)
    for name in EIGHT:
        s = score(sources.authors(name)[1], name, sources.backend)
        if not s.problem:
            kept[name] = {"experiment": name, "mean": s.mean, "std": s.std}
            kept[name] |= {"episodes": EPISODES, "seed": SEED, "sha256": s.sha256}
    write_atomically(path, as_csv([kept[name] for name in EIGHT if name in kept]).encode())


def our_means(source: str) -> dict[str, list[float]]:
    """By experiment the means of our runs, of OURS or AT_PAPERS: a column of Table 3."""
    column, ours = f"{COLUMNS[source]}_means", by_experiment(csv_file("table3"))
    return {name: [float(number) for number in ours[name][column].split()] for name in EIGHT}


def table() -> str:
    """Table 3, without the columns that only ZOO=path adds."""
    lines = csv_file("table3").with_suffix(".md").read_text(encoding="utf-8").splitlines()
    return "\n".join("|".join(line.split("|")[:8]) + "|" for line in lines if line.startswith("|"))


def answers() -> str:
    """Does it hold? A list."""
    lines = [score_answer(*asked) for asked in QUESTIONS]
    return "\n".join(f"- {line}" for line in [*lines, speed_answer(), bodies_answer()])


def score_answer(topic: str, without: str, with_: str) -> str:
    """Whether a learned body scores higher in our runs, as it does in the paper's."""
    points = partial(statistics.difference, shape="{:+,.0f}", unit=" points")
    table4, parts = paper()["table4"], []
    theirs = statistics.compare(*(np.array(table4[name], float) for name in (without, with_)))
    for source in (OURS, AT_PAPERS):
        found = our_means(source)
        before, after = np.array(found[without]), np.array(found[with_])
        if min(len(before), len(after)) < (1 if source == OURS else 2):
            continue
        said = statistics.compare(before, after)
        answer = {"higher": "yes", "lower": "no"}.get(statistics.verdict(said), "not decided")
        if answer == "yes" and said["difference_high"] < theirs["difference_low"]:
            answer = "yes, by less"
        parts.append(
            f"**{topic}{AT_SETTINGS[source]}: {answer}.** With a learned body, {points(said)} in "
            f"our runs ({len(before)} without it, {len(after)} with it), {points(theirs)} in the "
            "paper's."
        )
    of_each = (TrainSettings.of(name, "ours").generations for name in (without, with_))
    if parts and (longer := np.divide(*of_each)) != 1:
        parts.append(
            f"Ours with the original body trained for {longer:.2g} times as many generations."
        )
    return " ".join(parts) or f"**{topic}: not known.** There are no runs of both yet."


def speed_answer() -> str:
    """Whether a learned body solves rough ground (300 points) in fewer generations."""
    said = [speed(source) for source in (OURS, AT_PAPERS)]
    if not any(said):
        return "**Hardcore, speed: not known.** There are no runs of both yet."
    printed = paper()["text"]
    original, learned = (f"{printed[name]['generations']:,}" for name in HARDCORE)
    seen = [
        next(at for at, score in paper()["figure5"][name]["best"] if score >= SOLVED)
        for name in HARDCORE
    ]
    recipes = (TrainSettings.of(HARDCORE[1], recipe) for recipe in ("paper", "ours"))
    more = np.divide(*(settings.population * settings.rollouts for settings in recipes))
    return (
        f"{' '.join(filter(None, said))} The paper names generation {original} with the original "
        f"body and {learned} with a learned one (its Figure 5 first has 300 points at "
        f"{seen[0]:,} and {seen[1]:,}); its generations have {more:.2g} times the episodes. [For "
        "250 points see the study](docs/studies.md#does-a-learned-body-learn-rough-ground-faster)."
    )


def bodies_answer() -> str:
    """Whether our runs learn legs as large as the author's ten runs."""
    lies: dict[str, list[str]] = {"larger": [], "smaller": [], "not decided": []}
    parts = []
    for name, theirs in paper()["leg_areas"].items():
        ours, letter = our_leg_areas(name), f"({EIGHT[name].letter})"
        if not ours:
            return "**Learned bodies: not known.** There are no runs of all four yet."
        said = statistics.verdict(statistics.compare(np.array(theirs), np.array(ours)))
        how = {"higher": "larger", "lower": "smaller"}.get(said, "not decided")
        lies[how].append(letter)
        limits = (f"{min(areas):.0f} to {max(areas):.0f}" for areas in (ours, theirs))
        parts.append(f"{letter} {' and '.join(limits)}")
    answer = "; ".join(f"{', '.join(letters)} {how}" for how, letters in lies.items() if letters)
    return (
        f"**Learned legs beside the author's: {answer}** (letters: the table below). Areas in % of "
        f"the original, of our recipe's runs and his: {'; '.join(parts)}. [Shapes](docs/studies.md"
        "#are-the-learned-bodies-the-papers)."
    )


def speed(source: str) -> str:
    """What our runs of one source say of that; empty where there are too few."""
    parts, solved_at = [], []
    for name, words in zip(HARDCORE, ("the original body", "a learned body"), strict=True):
        runs = [read_published(path) for path in recordings_of(name, source) if path.exists()]
        if len(runs) < (1 if source == OURS else 2):
            return ""
        at = [np.inf if run.solved_at() is None else run.solved_at() + 1 for run in runs]
        solved_at.append(at)
        solved = sorted(n for n in at if n < np.inf)
        when = " to ".join(f"{n:,.0f}" for n in dict.fromkeys(solved[:1] + solved[-1:]))
        parts.append(
            f"in {len(solved)} of {len(runs)} runs with {words}"
            + (f" (generation {when} of {int(runs[0].generation[-1]) + 1:,})" if solved else "")
        )
    # By ranks: a run that never solved it is the slowest, however long it was.
    order = np.unique(np.concatenate(solved_at))
    original, learned = (np.searchsorted(order, at) for at in solved_at)
    answer = "yes" if learned.mean() < original.mean() else "no"
    if statistics.permutation_p(original, learned) >= statistics.SIGNIFICANT:
        answer = "not decided"
    reached = "An evaluation in training reached 300 points, which the paper calls solved, "
    reached += f"{' and '.join(parts)}."
    return f"**Hardcore, speed{AT_SETTINGS[source]}: {answer}.** {reached}"


def recordings_of(experiment: str, source: str) -> list[Path]:
    """Those of our runs of an experiment, of one source."""
    return [recording_of(path) for path in our_runs(experiment)[source].values()]


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
