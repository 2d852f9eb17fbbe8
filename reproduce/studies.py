"""The figures of docs/studies.md, which explains them; CAPTIONS is of the one in the report, too.

ZOO=path python -m reproduce.studies    count falls anew, the author's too, in paper/falls.csv
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from designrl.evaluation import evaluate
from designrl.files import write_atomically
from designrl.names import load
from designrl.provenance import core_count
from reproduce import drawing, figure5, paths, table2
from reproduce.curves import STEPS
from reproduce.paths import EIGHT, paper, pretrained, recordings, seed_of, unfinished
from reproduce.program import program
from reproduce.runs import Run, read_published, read_run
from reproduce.sources import Sources
from reproduce.tables import as_csv, csv_file, read_csv

CAPTIONS = {
    "author_log": (
        "Does our training learn as the author's did?",
        "The author's own training log of Biped (c), every 50 generations, over ours with his "
        "settings: 96 candidates, one rollout each, σ × 0.999 a generation. The population's mean "
        "return in training, averaged over 11 generations; a line for each of our seeds.",
    ),
}
AUTHOR_LOG = "biped-author-settings"  # under logs/studies
AVERAGED = 11  # generations, of a point of the author's log in paper.toml
LEARNER = "biped-hardcore-morphology"
FAST = "biped-hardcore-morphology-rate-0.03"
FEWER = f"{LEARNER}-4-rollouts"
FEWER_FAST, FEWER_WIDE = f"{FEWER}-rate-0.02", f"{FEWER}-sigma-0.9998"
TRIED = 1000  # generations of these
HARDCORE = [name for name, experiment in EIGHT.items() if experiment.letter in "fgh"]
FALL = 250.0  # points: an episode with fewer ends with a fall, or nowhere
EPISODES, SEED = 1000, 1  # not those of the tables
AUTHOR = "author's"


def recorded(study: str) -> list[Path]:
    """The recordings of a study's runs, by seed."""
    return sorted((paths.ROOT / "logs" / "studies" / study).glob("seed*/generations.mcap"))


def study(name: str, experiment: str) -> list[Run]:
    """A study's runs, of an experiment."""
    return [read_run(path, experiment, seed_of(path.parent.name)) for path in recorded(name)]


def falls_file() -> Path:
    """Where the counted falls are kept."""
    return paths.ROOT / "paper" / "falls.csv"


def fall_rows() -> list[dict]:
    """The counted falls."""
    return read_csv(falls_file())


def reads(sources: Sources) -> list[Path]:
    """The files that the figures depend on."""
    found = [*recordings(LEARNER), *unfinished(LEARNER)]
    for name in (AUTHOR_LOG, FAST, FEWER, FEWER_FAST, FEWER_WIDE):
        found += recorded(name)
    return [*sources.read_for(), falls_file(), csv_file("table2"), *found]


# ---------------------------------------------------------------------------- the author's log


def running_mean(run: Run) -> np.ndarray:
    """The population's mean over AVERAGED generations around each, over fewer at the ends."""
    apart = run.generation[-1] / max(1, len(run.generation) - 1)  # more than 1 where it is thinned
    ones = np.ones(max(1, round(AVERAGED / max(1.0, apart))))
    return np.convolve(run.mean, ones, "same") / np.convolve(np.ones(len(run.mean)), ones, "same")


def author_log() -> Figure:
    """The author's log over our runs with his settings."""
    figure = Figure(figsize=(drawing.WIDTH, 2.6), layout="constrained")
    axes = figure.subplots()
    runs = study(AUTHOR_LOG, "biped")
    label = f"ours, {len(runs)} seeds"
    for run in runs:
        axes.plot(
            run.generation,
            running_mean(run),
            color=drawing.ORIGINAL,
            linewidth=0.8,
            rasterized=True,
            label=label,
        )
        label = None  # once for all
    at, mean = np.transpose(paper()["author_log"]["population"])
    axes.plot(at, mean, color="black", marker=".", markersize=4, label="the author's log")
    axes.set_xlabel("generation")
    axes.set_ylabel("population's mean\nreturn in training (points)")
    axes.set_xlim(left=0)
    axes.legend(loc="lower right")
    return figure


def author_log_answer() -> str:
    """How the author's log lies to our runs, in a sentence."""
    runs = study(AUTHOR_LOG, "biped")
    if not runs:
        return "There is no run with his settings yet."
    at, mean = np.transpose(paper()["author_log"]["population"])
    within = at <= min(run.generation[-1] for run in runs)
    at, mean = at[within], mean[within]
    ours = np.array([np.interp(at, run.generation, running_mean(run)) for run in runs])
    below, above = at[mean < ours.min(axis=0)], at[mean > ours.max(axis=0)]
    said = f"{len(at) - len(below) - len(above)} of the {len(at)} points of his log that our runs "
    said += f"reach lie within the range of our {len(runs)}"
    for outside, words in ((below, "below"), (above, "above")):
        if len(outside):
            said += f"; {len(outside)} lie {words} all of ours (generations {listed(outside)})"
    return f"{said}."


def listed(generations: np.ndarray) -> str:
    """Generations, 50 apart, as a list in which neighbours are one item: "50, 600 to 750"."""
    parts = np.split(generations, np.flatnonzero(np.diff(generations) > 50) + 1)
    return ", ".join(f"{part[0]:,.0f}" + f" to {part[-1]:,.0f}" * (len(part) > 1) for part in parts)


def hardcore_settings() -> Figure:
    """The paper's curve over ours, with its settings and with others."""
    figure = Figure(figsize=(drawing.WIDTH, 3.0), layout="constrained")
    axes = figure.subplots()
    at, mean = np.transpose(paper()["figure5"][LEARNER]["population"])
    axes.plot(at, mean - figure5.OFFSET, color="black", linewidth=2, alpha=0.8, label="the paper's")
    papers = [read_published(path) for path in figure5.recorded(LEARNER)]
    for runs, label, colour in (
        (papers, "ours, the paper's settings", drawing.ORIGINAL),
        (study(FEWER, LEARNER), "4 rollouts", drawing.LEARNED),
        (study(FEWER_FAST, LEARNER), "4 rollouts, learning rate 0.02", drawing.THIRD),
        (study(FEWER_WIDE, LEARNER), "4 rollouts, σ × 0.9998", drawing.GREY),
    ):
        for run in runs:
            style = {"color": colour, "linewidth": 0.8, "linestyle": "-" if run.seed else "--"}
            axes.plot(run.generation, running_mean(run), label=label, **style)
    axes.set_xlabel("generation")
    axes.set_ylabel("population's mean\nreturn in training (points)")
    axes.set_xlim(0, TRIED)
    axes.set_ylim(-25, 300)
    drawing.legend(figure, axes)
    return figure


# ------------------------------------------------------------------------------ learning rates


def learning_rates() -> Figure:
    """Evaluations over steps, for each learning rate."""
    figure = Figure(figsize=(drawing.WIDTH, 3.0), layout="constrained")
    axes = figure.subplots()
    runs = [read_published(path) for path in [*recordings(LEARNER), *unfinished(LEARNER)]]

    def draw(runs: list[Run], label: str, colour: str) -> None:
        for run in runs:
            steps = np.interp(run.tested, run.generation, run.steps) / 1e6
            style = {"color": colour, "linewidth": 0.8}
            axes.plot(steps, run.scores, label=f"{label} ({len(runs)})", **style)

    draw([run for run in runs if not run.papers], "0.01, falling slowly", drawing.LEARNED)
    draw(study(FAST, LEARNER), "0.03, falling fast", drawing.THIRD)
    papers = [run for run in runs if run.papers]
    draw(papers, "0.01, constant, four times the rollouts: the paper's", drawing.ORIGINAL)
    drawing.line_of_solved(axes)
    axes.set_xlabel(STEPS)
    axes.set_ylabel("evaluation (points)")
    axes.set_xlim(left=0)
    drawing.legend(figure, axes, title="learning rate (runs)")
    return figure


# -------------------------------------------------------------------------------------- bodies


def leg_areas() -> Figure:
    """The leg areas of the author's runs and ours, a point for each."""
    figure = Figure(figsize=(drawing.WIDTH, 2.6), layout="constrained")
    axes = figure.subplots()
    printed = paper()["leg_areas"]
    for at, (name, theirs) in enumerate(printed.items()):
        ours = table2.our_leg_areas(name)
        for x, areas, colour, label in (
            (at - 0.12, theirs, drawing.GREY, "the author's runs"),
            (at + 0.12, ours, drawing.LEARNED, "ours"),
        ):
            style = {"color": colour, "alpha": 0.6, "marker": "o", "markersize": 4}
            axes.plot([x] * len(areas), areas, linestyle="", label=label, **style)
    titles = [EIGHT[name].title.replace(" + ", "\n+ ") for name in printed]
    axes.set_xticks(range(len(printed)), titles)
    axes.axhline(100, color=drawing.GREY, linewidth=0.6, linestyle="--", zorder=0)
    axes.set_ylabel("leg area (% of the original)")
    axes.set_ylim(bottom=0)
    drawing.legend(figure, axes, ncols=2)
    return figure


# --------------------------------------------------------------------------------------- falls


def falls() -> Figure:
    """The counted falls as bars."""
    figure = Figure(figsize=(drawing.WIDTH, 2.4), layout="constrained")
    panels = figure.subplots(1, len(HARDCORE), sharey=True)
    rows = fall_rows()
    for axes, name in zip(panels, HARDCORE, strict=True):
        mine = [row for row in rows if row["experiment"] == name]
        shares = np.array([int(row["falls"]) / int(row["episodes"]) for row in mine])
        errors = 1.96 * np.sqrt(shares * (1 - shares) / EPISODES)
        colours = [drawing.GREY if row["run"] == AUTHOR else drawing.LEARNED for row in mine]
        texts = [row["run"] for row in mine]
        axes.bar(texts, 100 * shares, color=colours)
        error = {"fmt": "none", "ecolor": "black", "elinewidth": 0.8}
        axes.errorbar(texts, 100 * shares, 100 * errors, **error)
        axes.tick_params(axis="x", rotation=90)
        title = EIGHT[name].title.rpartition("+ ")[2]
        axes.set_title(f"{title} ({EIGHT[name].letter})")
    panels[0].set_ylabel("episodes below 250 points (%)")
    return figure


def count_falls(sources: Sources) -> None:
    """Play each hardcore agent's episodes and keep what came out; the author's need ZOO."""
    rows, old = [], [row for row in fall_rows() if row["run"] == AUTHOR]
    for name in HARDCORE:
        theirs = {AUTHOR: sources.authors(name)[1]} if sources.zoo else {}
        if not sources.zoo:
            rows += [row for row in old if row["experiment"] == name]
        ours = {path.stem: path for path in pretrained(name)}
        for run, path in (theirs | ours).items():
            agent = load(path, name)
            found = evaluate(agent, EPISODES, SEED, core_count()).scores
            row = {"experiment": name, "run": run, "sha256": agent.sha256}
            row |= {"episodes": EPISODES, "seed": SEED, "falls": int((found < FALL).sum())}
            upright = found[found >= FALL].mean()
            row |= {"mean": found.mean(), "median": np.median(found), "mean_without": upright}
            rows.append(row)
            print(row, flush=True)
    write_atomically(falls_file(), as_csv(rows).encode())


def figures(sources: Sources) -> dict[str, Figure]:
    """The figures."""
    return {
        "author_log": author_log(),
        "hardcore_settings": hardcore_settings(),
        "learning_rates": learning_rates(),
        "leg_areas": leg_areas(),
        "falls": falls(),
    }


if __name__ == "__main__":
    with program("studies"):
        count_falls(Sources.asked())
