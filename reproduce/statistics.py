"""Does learning the body help? Statistics that the paper leaves open, for its runs and for ours.

Per pair of experiments, without and with a learned body: the difference of the means over runs, the
probability of improvement (that a run with it beats one without, ties half), both with bootstrap
95 % intervals over runs, and a permutation test. Per experiment the interval of the mean over runs,
and per run of ours over its rollouts. Makes the tables statistics and intervals.
"""

import itertools

import numpy as np

from reproduce.paths import EIGHT, paper
from reproduce.scores import Score, title, usable
from reproduce.sources import Sources
from reproduce.tables import PAPER, Table, row

READS = tuple(EIGHT)
PAIRS = (
    ("ant", "ant-morphology"),
    ("biped", "biped-morphology"),
    ("biped", "biped-morphology-smaller-leg"),
    ("biped-hardcore", "biped-hardcore-morphology"),
    ("biped-hardcore", "biped-hardcore-morphology-smaller-leg"),
)
RESAMPLES = 20_000
SIGNIFICANT = 0.05  # a p below it decides
LEVEL = (2.5, 97.5)  # percentiles: a 95 % interval


def resampled(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(RESAMPLES, n): rows drawn with replacement from (n,) values."""
    return values[rng.integers(len(values), size=(RESAMPLES, len(values)))]


def mean_interval(values: np.ndarray) -> tuple[float, float]:
    """Bootstrap 95 % interval of the mean of (n,) values; (NaN, NaN) for fewer than two."""
    if len(values) < 2:
        return np.nan, np.nan
    means = resampled(values, np.random.default_rng(0)).mean(axis=1)
    return tuple(np.percentile(means, LEVEL).tolist())


def probability_of_improvement(without: np.ndarray, with_: np.ndarray) -> np.ndarray:
    """P(with > without) + P(equal) / 2 over all pairs, of values (..., n) and (..., m)."""
    difference = with_[..., :, None] - without[..., None, :]
    return ((np.sign(difference) + 1) / 2).mean(axis=(-2, -1))


def permutation_p(without: np.ndarray, with_: np.ndarray) -> float:
    """Two-sided p of the difference of means when runs are dealt out anew, in all ways."""
    together = np.concatenate([without, with_])
    n, m = len(without), len(with_)
    observed = abs(with_.mean() - without.mean()) - 1e-9
    first = together[np.array(list(itertools.combinations(range(n + m), n)))].sum(axis=1)
    as_far = np.abs((together.sum() - first) / m - first / n) >= observed
    return float(as_far.mean())


def compare(without: np.ndarray, with_: np.ndarray) -> dict:
    """The statistics of one pair, of means of runs (n,) and (m,); most need two runs each."""
    result = {
        "runs_without": len(without),
        "runs_with": len(with_),
        "difference": float(with_.mean() - without.mean()),
    }
    values = [np.nan] * 6
    if min(len(without), len(with_)) > 1:
        rng = np.random.default_rng(0)
        a, b = resampled(without, rng), resampled(with_, rng)
        values = [
            *np.percentile(b.mean(axis=1) - a.mean(axis=1), LEVEL).tolist(),
            float(probability_of_improvement(without, with_)),
            *np.percentile(probability_of_improvement(a, b), LEVEL).tolist(),
            permutation_p(without, with_),
        ]
    chances = ("probability", "probability_low", "probability_high")
    names = ("difference_low", "difference_high", *chances, "p")
    return result | dict(zip(names, values, strict=True))


def verdict(c: dict) -> str:
    """What a comparison says, in words; of few runs the bootstrap alone claims too much."""
    if np.isnan(c["p"]):
        return "too few runs to tell"
    if c["p"] >= SIGNIFICANT or c["difference_low"] <= 0 <= c["difference_high"]:
        return "undecided"
    return "higher" if c["difference"] > 0 else "lower"


def interval(low: float, high: float, shape: str = "{:.0f}") -> str:
    """An interval as text; empty where there is none."""
    return "" if np.isnan(low) else f"[{shape.format(low)}, {shape.format(high)}]"


Means = dict[str, dict[str, np.ndarray]]  # experiment -> source -> (n,) means of its runs


def pairs(means: Means, ours: list[Score]) -> Table:
    """The table of pairs."""
    rows, records = [], []
    for without, with_ in PAIRS:
        rows += [None] if rows else []
        letters = f"({EIGHT[with_].letter}) over ({EIGHT[without].letter})"
        head = [letters, EIGHT[with_].title]
        for source, b in means[with_].items():
            a = means[without][source]
            numbers, words = ["", "", ""], "no runs of both yet"
            if len(a) and len(b):
                c = compare(a, b)
                records.append({"without": without, "with": with_, "source": source} | c)
                limits = interval(c["difference_low"], c["difference_high"], "{:+.0f}")
                chances = interval(c["probability_low"], c["probability_high"], "{:.0%}")
                p = "" if np.isnan(c["p"]) else f"{c['p']:.4f}" if c["p"] >= 1e-4 else "< 0.0001"
                difference = f"{c['difference']:+.0f} {limits}".strip()
                chance = f"{c['probability']:.0%} {chances}" if chances else ""
                numbers = [difference, chance, p]
                words = verdict(c)
            cells = row(head, source, [f"{len(b)}, {len(a)}", *numbers], with_)
            rows.append([*cells, words])
    return Table(
        "statistics",
        "Does learning the body help? Pairs of experiments, the paper's runs and ours",
        header=[
            "Pair",
            "With a learned body",
            "Runs of",
            "Runs (with, without)",
            "Difference of means",
            "Probability of improvement",
            "p",
            "With it is",
        ],
        rows=rows,
        notes=[
            f"Brackets: bootstrap 95 % intervals over runs ({RESAMPLES:,} resamples, percentiles). "
            "Probability of improvement: that a run with a learned body scores above one without, "
            "ties counted half. p: two-sided permutation test of the difference. Where every run "
            "of one side beats every run of the other, the bootstrap cannot see beyond 100 %; p "
            "says how unlikely that is by chance. Higher or lower: the interval lies on one side "
            "of 0 and p is below 0.05. Small legs trade score for a smaller body, so for them the "
            "question is what that costs.",
            "The paper's runs are the printed ones of Table 4, rounded to whole points.",
        ],
        records=records,
        scores=ours,
    )


def intervals(means: Means, ours: list[Score]) -> Table:
    """The table of intervals of each experiment's mean, and of each run of ours."""
    rows, records = [], []
    for name, sources in means.items():
        lines = [(source, "runs", values) for source, values in sources.items()]
        mine = [s for s in usable(ours) if s.agent.experiment.name == name]
        lines += [(f"ours, {s.run}", "rollouts", s.returns) for s in mine]
        for source, unit, values in lines:
            count = f"{len(values)} {unit if len(values) != 1 else unit[:-1]}"
            if len(values) == 0:
                rows.append([title(name), source, count, "", "", ""])
                continue
            low, high = mean_interval(values)
            middle = np.median(values)
            texts = [count, f"{values.mean():.1f}", interval(low, high), f"{middle:.0f}"]
            rows.append(row([title(name)], source, texts, name))
            records.append(
                {"experiment": name, "source": source, "over": unit, "count": len(values)}
                | {"mean": values.mean(), "low": low, "high": high, "median": middle}
            )
    return Table(
        "intervals",
        "Average scores with 95 % intervals, over runs and over rollouts within a run",
        header=["Experiment", "", "Over", "Mean", "95 % interval", "Median"],
        rows=rows,
        notes=[
            f"Bootstrap 95 % intervals of the mean ({RESAMPLES:,} resamples, percentiles): over "
            "runs they say how well these runs tell the mean of many such (two or three hardly), "
            "over rollouts how well one agent's score is known."
        ],
        records=records,
        scores=ours,
    )


def tables(sources: Sources) -> list[Table]:
    """Both tables."""
    means, ours = {}, []
    for name, by_source in sources.by_source(*EIGHT).items():
        means[name] = {PAPER: np.array(paper()["table4"][name], dtype=float)}
        for source, runs in by_source.items():
            means[name][source] = np.array([s.mean for s in usable(runs.values())])
            ours += runs.values() if source == "ours" else ()
    return [pairs(means, ours), intervals(means, ours)]
