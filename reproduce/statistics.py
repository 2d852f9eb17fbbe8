"""Does learning the body help? Statistics that the paper leaves open, for its runs and for ours.

Per pair of experiments, without and with a learned body: the difference of the means over runs, the
probability of improvement (that a run with it beats one without, ties half), both with bootstrap
95 % intervals over runs, and a permutation test. Per experiment the interval of the mean over runs,
and per run of ours over its rollouts. Reads pretrained/ and Table 4 in paper/paper.toml; with
ZOO=path also the author's weights. Writes paper/tables/statistics.* and intervals.*, and prints
them.

    make reproduce-statistics
"""

import itertools
import math
from pathlib import Path

import numpy as np

from designrl.experiments import EXPERIMENTS
from reproduce import build, scores
from reproduce.tables import origin_notes, scoring_note, write_table

PAIRS = (
    ("ant", "ant-morphology"),
    ("biped", "biped-morphology"),
    ("biped", "biped-morphology-smaller-leg"),
    ("biped-hardcore", "biped-hardcore-morphology"),
    ("biped-hardcore", "biped-hardcore-morphology-smaller-leg"),
)
RESAMPLES = 20_000
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
    """Two-sided p of the difference of means when runs are dealt out anew.

    Of all ways to deal them, or where these are more than RESAMPLES, of so many by chance.
    """
    together = np.concatenate([without, with_])
    n, m = len(without), len(with_)
    observed = abs(with_.mean() - without.mean()) - 1e-9
    if math.comb(n + m, n) <= RESAMPLES:
        first = together[np.array(list(itertools.combinations(range(n + m), n)))].sum(axis=1)
        differences = np.abs((together.sum() - first) / m - first / n)
        return float((differences >= observed).mean())
    rng = np.random.default_rng(0)
    dealt = rng.permuted(np.broadcast_to(together, (RESAMPLES, n + m)), axis=1)
    differences = np.abs(dealt[:, n:].mean(axis=1) - dealt[:, :n].mean(axis=1))
    return float((1 + (differences >= observed).sum()) / (1 + RESAMPLES))


def compare(without: np.ndarray, with_: np.ndarray) -> dict:
    """The statistics of one pair, of means of runs (n,) and (m,); intervals need two runs each."""
    result = {
        "runs_without": len(without),
        "runs_with": len(with_),
        "difference": float(with_.mean() - without.mean()),
        "probability": float(probability_of_improvement(without, with_)),
    }
    names = ("difference_low", "difference_high", "probability_low", "probability_high", "p")
    if min(len(without), len(with_)) < 2:
        return result | dict.fromkeys(names, np.nan)
    rng = np.random.default_rng(0)
    a, b = resampled(without, rng), resampled(with_, rng)
    intervals = [
        *np.percentile(b.mean(axis=1) - a.mean(axis=1), LEVEL).tolist(),
        *np.percentile(probability_of_improvement(a, b), LEVEL).tolist(),
    ]
    return result | dict(zip(names, [*intervals, permutation_p(without, with_)], strict=True))


def verdict(c: dict) -> str:
    """What a comparison says, in words; of few runs the bootstrap alone claims too much."""
    if np.isnan(c["p"]):
        return "too few runs to tell"
    if c["p"] >= 0.05 or c["difference_low"] <= 0 <= c["difference_high"]:
        return "undecided"
    return "higher" if c["difference"] > 0 else "lower"


def interval(low: float, high: float, shape: str = "{:.0f}") -> str:
    """An interval as text; empty where there is none."""
    return "" if np.isnan(low) else f"[{shape.format(low)}, {shape.format(high)}]"


def reads() -> list[Path]:
    """The files that the statistics depend on."""
    return scores.read_for(*EXPERIMENTS)


def run_means() -> tuple[dict[str, dict[str, np.ndarray]], list[scores.Score]]:
    """Source -> experiment -> (n,) means of its runs, and the scores of ours behind them."""
    printed = scores.paper()["table4"]
    ours = scores.pretrained_scores()
    means = {
        "paper": {name: np.array(printed[name], dtype=float) for name in EXPERIMENTS},
        "ours": {n: np.array([s.mean for s in ours[n] if not s.problem]) for n in EXPERIMENTS},
    }
    if zoo := scores.zoo_argument():
        found = scores.published_scores(zoo)
        means["author's weights"] = {
            n: np.array([s.mean for s in found[n].values() if not s.problem]) for n in EXPERIMENTS
        }
    return means, [s for name in EXPERIMENTS for s in ours[name]]


def write_pairs(means: dict[str, dict[str, np.ndarray]]) -> list[Path]:
    """The table of pairs."""
    rows, records = [], []
    for without, with_ in PAIRS:
        rows.append(None) if rows else None
        for source, values in means.items():
            a, b = values[without], values[with_]
            pair = f"({EXPERIMENTS[with_].letter}) over ({EXPERIMENTS[without].letter})"
            head = [pair, EXPERIMENTS[with_].title, source, f"{len(b)}, {len(a)}"]
            if not (len(a) and len(b)):
                rows.append([*head, "", "", "", "no runs of both yet"])
                continue
            c = compare(a, b)
            limits = interval(c["difference_low"], c["difference_high"], "{:+.0f}")
            chances = interval(c["probability_low"], c["probability_high"], "{:.0%}")
            p = "" if np.isnan(c["p"]) else f"{c['p']:.4f}" if c["p"] >= 1e-4 else "< 0.0001"
            rows.append(
                [
                    *head,
                    f"{c['difference']:+.0f} {limits}".strip(),
                    f"{c['probability']:.0%} {chances}".strip(),
                    p,
                    verdict(c),
                ]
            )
            records.append({"without": without, "with": with_, "source": source} | c)
    return write_table(
        "statistics",
        "Does learning the body help? Pairs of experiments, the paper's runs and ours",
        [
            "Pair",
            "With a learned body",
            "Runs of",
            "Runs (with, without)",
            "Difference of means",
            "Probability of improvement",
            "p",
            "With it is",
        ],
        rows,
        [
            f"Brackets: bootstrap 95 % intervals over runs ({RESAMPLES:,} resamples, percentiles). "
            "Probability of improvement: that a run with a learned body scores above one without, "
            "ties counted half. p: two-sided permutation test of the difference. Where every run "
            "of one side beats every run of the other, the bootstrap cannot see beyond 100 %; p "
            "says how unlikely that is by chance. Higher or lower: the interval lies on one side "
            "of 0 and p is below 0.05, out of reach for three runs against three. Small legs trade "
            "score for a smaller body, so for them the question is what that costs.",
            "The paper's runs are the printed ones of Table 4, rounded to whole points.",
            scoring_note(),
        ],
        records,
    )


def write_intervals(means: dict[str, dict[str, np.ndarray]], ours: list) -> list[Path]:
    """The table of intervals of each experiment's mean, and of each run of ours."""
    rows, records = [], []
    for name, experiment in EXPERIMENTS.items():
        title = f"({experiment.letter}) {experiment.title}"
        mine = [s for s in ours if s.agent is not None and s.agent.experiment is experiment]
        lines = [(source, "runs", values[name]) for source, values in means.items()]
        lines += [(f"ours, {scores.seed_of(s.path)}", "rollouts", s.returns) for s in mine]
        for source, unit, values in lines:
            if len(values) == 0:
                rows.append([title, source, f"0 {unit}", "", "", ""])
                continue
            low, high = mean_interval(values)
            middle = f"{np.median(values):.0f}"
            count = f"{len(values)} {unit if len(values) > 1 else unit[:-1]}"
            rows.append([title, source, count, f"{values.mean():.1f}", interval(low, high), middle])
            records.append(
                {"experiment": name, "source": source, "over": unit, "count": len(values)}
                | {"mean": values.mean(), "low": low, "high": high, "median": np.median(values)}
            )
    return write_table(
        "intervals",
        "Average scores with 95 % intervals, over runs and over rollouts within a run",
        ["Experiment", "", "Over", "Mean", "95 % interval", "Median"],
        rows,
        [
            f"Bootstrap 95 % intervals of the mean ({RESAMPLES:,} resamples, percentiles): over "
            "runs they say how well these runs tell the mean of many such (two or three hardly), "
            "over rollouts how well one agent's score is known.",
            scoring_note(),
            *origin_notes(ours),
        ],
        records,
    )


def main() -> list[Path]:
    """Write both tables; returns their files."""
    means, ours = run_means()
    return [*write_pairs(means), *write_intervals(means, ours)]


if __name__ == "__main__":
    build.command("statistics")
