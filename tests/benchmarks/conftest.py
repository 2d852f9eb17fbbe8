"""Speeds as ratios within a run: these travel from machine to machine, milliseconds do not."""

import statistics
import time

import pytest
from tabulate import tabulate


@pytest.fixture
def measure(benchmark):
    """Benchmarks `subject()` beside `reference()`; each returns the number of its steps.

    The reference runs just before each round, and the ratio of the speeds, which is returned, is
    the median over the rounds: a machine whose speed drifts still gives the same ratio.
    """

    def rate(run) -> float:
        start = time.perf_counter()
        steps = run()
        return steps / (time.perf_counter() - start)

    def measure(subject, reference) -> float:
        rates, reference_rates = [], []
        benchmark.pedantic(
            lambda: rates.append(rate(subject)),
            setup=lambda: reference_rates.append(rate(reference)),
            rounds=9,
            warmup_rounds=1,
        )
        ratios = [a / b for a, b in zip(rates[1:], reference_rates[1:], strict=True)]
        benchmark.extra_info["steps_per_second"] = round(statistics.median(rates[1:]))
        benchmark.extra_info["of_the_reference"] = round(statistics.median(reference_rates[1:]))
        benchmark.extra_info["ratio"] = round(statistics.median(ratios), 3)
        return benchmark.extra_info["ratio"]

    return measure


def pytest_terminal_summary(terminalreporter, config):
    session = getattr(config, "_benchmarksession", None)
    groups: dict[str, list[dict]] = {}
    for benchmark in session.benchmarks if session else []:
        if benchmark.extra_info:
            row = {"": benchmark.name.removeprefix("test_"), **benchmark.extra_info}
            groups.setdefault(benchmark.group or "", []).append(row)
    for group, rows in groups.items():
        terminalreporter.section(f"{group}: ratios within this run")
        terminalreporter.write_line(tabulate(rows, headers="keys", tablefmt="github"))
