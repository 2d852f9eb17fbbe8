"""Does learning the body help? Statistics that the paper leaves open, for its runs and for ours.

Per pair of experiments, without and with a learned body: the difference of the means over runs, the
probability of improvement (that a run with it beats one without, ties half), both with bootstrap
95 % intervals over runs, and a permutation test. Per experiment the interval of the mean over runs,
and per run of ours over its rollouts. Makes the tables statistics and intervals.
"""

import functools
import itertools
import math

import numpy as np

from reproduce.paths import EIGHT, paper
from reproduce.scores import Score, title, usable
from reproduce.sources import AT_PAPERS, OURS, Sources
from reproduce.tables import PAPER, Table, row

READS = tuple(EIGHT)
PAIRS = (
    ("ant", "ant-morphology"),
    ("biped", "biped-morphology"),
    ("biped", "biped-morphology-smaller-leg"),
    ("biped-hardcore", "biped-hardcore-morphology"),
    ("biped-hardcore", "biped-hardcore-morphology-smaller-leg"),
)
RESAMPLES = 20_000  # drawn where there are too many to count
EXACT = 1_000_000  # resamples, or pairs of them, that are all counted
SIGNIFICANT = 0.05  # a p below it decides
COUNTED = (
    f"all resamples are counted, in proportion to their probability, where these are {EXACT:,} at "
    f"most; else {RESAMPLES:,} are drawn"
)
LEVEL = (2.5, 97.5)  # percentiles: a 95 % interval


Resamples = tuple[np.ndarray, np.ndarray]  # (R, n) how often each has each value; (R,) chances


@functools.cache
def all_resamples(n: int) -> Resamples:
    """Every resample of n values once."""
    drawn = itertools.combinations_with_replacement(range(n), n)
    counts = np.array([np.bincount(indices, minlength=n) for indices in drawn])
    ways = [math.factorial(n) / math.prod(map(math.factorial, row)) for row in counts.tolist()]
    return counts, np.array(ways) / n**n


@functools.cache
def drawn_resamples(*sizes: int) -> list[Resamples]:
    """RESAMPLES of each of several samples; the first of one belongs to the first of the others."""
    rng = np.random.default_rng(0)
    chances = np.full(RESAMPLES, 1 / RESAMPLES)
    return [(rng.multinomial(n, np.full(n, 1 / n), RESAMPLES), chances) for n in sizes]


def resamples(*sizes: int) -> list[Resamples]:
    """Resamples of samples of some sizes: all where they can be counted, else drawn ones."""
    return [all_resamples(n) for n in sizes] if exactly(*sizes) else drawn_resamples(*sizes)


def exactly(*sizes: int) -> bool:
    """Whether all combinations of resamples of samples of these sizes are counted."""
    return math.prod(math.comb(2 * n - 1, n) for n in sizes) <= EXACT


def interval_of(values: np.ndarray, chances: np.ndarray) -> tuple[float, float]:
    """LEVEL's percentiles of values with these probabilities."""
    found = np.percentile(values, LEVEL, weights=chances, method="inverted_cdf")
    return tuple(found.tolist())


def mean_interval(values: np.ndarray) -> tuple[float, float]:
    """Bootstrap 95 % interval of the mean of (n,) values; (NaN, NaN) for fewer than two."""
    if len(values) < 2:
        return np.nan, np.nan
    [(counts, chances)] = resamples(len(values))
    return interval_of(counts @ values / len(values), chances)


def improvements(without: np.ndarray, with_: np.ndarray) -> np.ndarray:
    """(n, m): 1 where the run with a learned body is better, 0 where worse, 1/2 where equal."""
    return (np.sign(with_[None, :] - without[:, None]) + 1) / 2


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
        (a, chances), (b, chances_b) = resamples(len(without), len(with_))
        means, means_b = a @ without / len(without), b @ with_ / len(with_)
        better = improvements(without, with_)
        if exactly(len(without), len(with_)):  # each resample of one side with each of the other
            differences = np.subtract.outer(means_b, means).T
            probabilities = a @ better @ b.T
            chances = np.outer(chances, chances_b)
        else:
            differences = means_b - means
            probabilities = np.einsum("ri,ij,rj->r", a, better, b, optimize=True)
        values = [
            *interval_of(differences.ravel(), chances.ravel()),
            float(better.mean()),
            *interval_of(probabilities.ravel() / better.size, chances.ravel()),
            permutation_p(without, with_),
        ]
    limits = ("probability", "probability_low", "probability_high")
    names = ("difference_low", "difference_high", *limits, "p")
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


def difference(c: dict, shape: str = "{:+.0f}", unit: str = "") -> str:
    """A comparison's difference of means as text, with its interval where there is one."""
    limits = interval(c["difference_low"], c["difference_high"], shape)
    return f"{shape.format(c['difference'])}{unit} {limits}".strip()


Means = dict[str, dict[str, np.ndarray]]  # experiment -> source -> (n,) means of its runs


def pairs(means: Means, ours: list[Score]) -> Table:
    """The table of pairs."""
    rows, records, short = [], [], []
    for without, with_ in PAIRS:
        rows += [None] if rows else []
        letters = f"({EIGHT[with_].letter}) over ({EIGHT[without].letter})"
        head = [letters, EIGHT[with_].title]
        for source, b in means[with_].items():
            a = means[without][source]
            if source == AT_PAPERS and min(len(a), len(b)) < 2:
                short.append(f"{letters}: {len(b)} and {len(a)}" if len(a) + len(b) else "")
                continue
            numbers, words = ["", "", ""], "no runs of both yet"
            if len(a) and len(b):
                c = compare(a, b)
                records.append({"without": without, "with": with_, "source": source} | c)
                chances = interval(c["probability_low"], c["probability_high"], "{:.0%}")
                p = "" if np.isnan(c["p"]) else f"{c['p']:.4f}" if c["p"] >= 1e-4 else "< 0.0001"
                chance = f"{c['probability']:.0%} {chances}" if chances else ""
                numbers = [difference(c), chance, p]
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
            f"Brackets: bootstrap 95 % intervals over runs (percentiles; {COUNTED}). "
            "Probability of improvement: that a run with a learned body scores above one without, "
            "ties counted half. p: two-sided permutation test of the difference. Where every run "
            "of one side beats every run of the other, the bootstrap cannot see beyond 100 %; p "
            "says how unlikely that is by chance. Higher or lower: the interval lies on one side "
            "of 0 and p is below 0.05. Small legs trade score for a smaller body, so for them the "
            "question is what that costs.",
            "The paper's runs are the printed ones of Table 4, rounded to whole points.",
            *too_few(short),
        ],
        records=records,
        scores=ours,
    )


def too_few(short: list[str]) -> list[str]:
    """A sentence on the pairs that have too few runs at the paper's settings."""
    if not short:
        return []
    found = "; ".join(filter(None, short))
    there = f"There are, with and without, for {found}." if found else "None is finished yet."
    return [
        "At the paper's settings a comparison needs two of our runs with a learned body and two "
        f"without. {there}"
    ]


def intervals(means: Means, ours: list[Score]) -> Table:
    """The table of intervals of each experiment's mean, and of each run of ours."""
    rows, records = [], []
    for name, sources in means.items():
        lines = [(source, "runs", values) for source, values in sources.items()]
        mine = [s for s in usable(ours) if s.agent.experiment.name == name]
        lines += [(f"ours, {s.run}", "rollouts", s.returns) for s in mine]
        for source, unit, values in lines:
            if len(values) == 0 and source == AT_PAPERS:
                continue
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
            f"Bootstrap 95 % intervals of the mean (percentiles; {COUNTED}). Over runs they say "
            "how well these runs tell the mean of many such (two or three hardly), over rollouts "
            "how well one agent's score is known."
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
            ours += runs.values() if source.startswith(OURS) else ()
    return [pairs(means, ours), intervals(means, ours)]
