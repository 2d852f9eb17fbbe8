"""Table 3: every experiment's average score, the paper's runs and ours."""

import numpy as np

from reproduce.paths import EIGHT, paper
from reproduce.scores import MISSING, Score, usable
from reproduce.sources import AT_PAPERS, ENOUGH, OURS, Sources
from reproduce.tables import PAPER, Cell, Table

READS = tuple(EIGHT)


def verdict(name: str, mean: float) -> str:
    """How the mean of our runs of an experiment lies to the mean and the range of the paper's."""
    difference = mean - paper()["table3"][name][0]
    runs, place = paper()["table4"][name], "within"  # whole points
    if mean > max(runs) + 0.5:
        place = "above"
    elif mean < min(runs) - 0.5:
        place = "below"
    return f"{difference:+.0f}, {place} its runs"


def summary(prefix: str, runs: list[Score]) -> dict:
    """What the CSV says of the runs of one source; its columns begin with `prefix`."""
    means, stds = [s.mean for s in runs], [s.std for s in runs]
    return {
        f"{prefix}_mean": np.mean(means) if means else "",
        f"{prefix}_std_over_runs": std_over_runs(means) if len(means) > 1 else "",
        f"{prefix}_runs": len(means),
        f"{prefix}_means": " ".join(f"{mean:.4f}" for mean in means),
        f"{prefix}_stds_over_rollouts": " ".join(f"{std:.4f}" for std in stds),
        f"{prefix}_checkpoints": " ".join(s.sha256 for s in runs),
    }


def std_over_runs(means: list[float]) -> float:
    """Sample standard deviation, with which the paper's Table 3 follows from its Table 4."""
    return float(np.std(means, ddof=1))


def of_runs(runs: list[Score]) -> str:
    """Mean ± std over runs as printed; of a single run, over its rollouts and with *."""
    means = [s.mean for s in runs]
    if len(means) == 1:
        return f"{means[0]:.0f} ± {runs[0].std:.1f} *"
    return f"{np.mean(means):.0f} ± {std_over_runs(means):.1f}"


def tables(sources: Sources) -> list[Table]:
    printed = paper()
    header = ["", "Experiment", "Paper (10 runs)", "Ours", "Runs"]
    header += ["Ours, the paper's settings (runs)", "Ours less the paper's"]
    if sources.zoo:
        header += ["Author's weights, here", "of runs (the paper's mean of these)"]
    rows, records, used, mine = [], [], [], (OURS, AT_PAPERS)
    runs_of = sources.by_source(*EIGHT)
    for name, experiment in EIGHT.items():
        rows += [None] if experiment.letter in "cf" else []
        found = runs_of[name]
        used += [s for runs in found.values() for s in runs.values()]
        ours = {source: usable(of.values()) for source, of in found.items() if source in mine}
        recipe, papers = ours[OURS], ours[AT_PAPERS]
        # A row's verdict is on what it shows first.
        first = next((source for source, runs in ours.items() if runs), None)
        words = verdict(name, np.mean([s.mean for s in ours[first]])) if first else ""
        if first == AT_PAPERS:
            words = f"with the paper's settings {words}"
        problems = [s.problem for source in ours for s in found[source].values() if s.problem]
        nothing = "no usable checkpoint" if problems else MISSING
        words = "; ".join([words or nothing, *(f"not used: {problem}" for problem in problems)])
        paper_mean, paper_std = printed["table3"][name]
        cells = [f"({experiment.letter})", experiment.title]
        cells += [Cell(f"{paper_mean} ± {paper_std}", PAPER)]
        cells += [Cell(of_runs(recipe), name) if recipe else "-", str(len(recipe))]
        cells += [Cell(f"{of_runs(papers)} ({len(papers)})", name) if papers else "–", words]
        record = {"experiment": name, "paper_mean": paper_mean, "paper_std_over_runs": paper_std}
        record |= summary("our", recipe) | summary("papers_settings", papers)
        if sources.zoo:
            theirs = found["author's weights"]
            good = {run: s for run, s in theirs.items() if not s.problem}
            if good:
                same = np.mean([printed["table4"][name][run - 1] for run in good])
                cells += [of_runs(list(good.values())), f"{', '.join(map(str, good))} ({same:.0f})"]
            else:
                cells += [theirs[1].problem, ""]
            record["author_means"] = " ".join(f"{s.mean:.4f}" for s in good.values())
            record["author_runs"] = " ".join(map(str, good))
        rows.append(cells)
        records.append(record)
    note = (
        "Mean ± sample standard deviation over runs of the average score of 100 rollouts. Ours are "
        "of our recipe. The last column has the difference of the means, and how ours lies to the "
        "range of the paper's ten runs; where there are at least "
        f"{ENOUGH} runs at the paper's settings, they are compared."
    )
    if any("*" in str(cell) for cells in filter(None, rows) for cell in cells):
        note += " *: one run; the standard deviation is over its rollouts."
    table = Table(
        "table3",
        "Table 3: average scores of independent runs, paper and ours",
        header=header,
        rows=rows,
        notes=[note],
        records=records,
        scores=used,
    )
    return [table]
