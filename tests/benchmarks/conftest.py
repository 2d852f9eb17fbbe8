"""Prints what the benchmarks put into `extra_info`: the ratios, not the milliseconds, travel."""

from tabulate import tabulate


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
