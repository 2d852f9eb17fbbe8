"""The report: all tables and figures, what they rest on, where we differ, what it cost.

Reads report_template.md, the figures, pretrained/ and logs/. Writes paper/report.md.
"""

import re
from pathlib import Path

import numpy as np

from designrl.files import write_atomically
from reproduce import build, curves, readme, studies, table2, transfer
from reproduce.paths import EIGHT, paper, recording_of, shown
from reproduce.runs import Run, read_published
from reproduce.scores import MISSING, Score, rewards_small_legs, title, usable
from reproduce.sources import AT_PAPERS, OURS, Sources
from reproduce.tables import PAPER, Cell, Table

TEMPLATE = Path(__file__).with_name("report_template.md")
TO_PAPER = "paper.toml"  # beside the report
LONG = 12  # rows: a longer table is folded
MODULES = {name: build.load(name) for name in build.ITEMS if name != "report"}
CAPTIONS = {
    name: (item, *about)
    for item, module in MODULES.items()
    for name, about in getattr(module, "CAPTIONS", {}).items()
}  # figure -> item, title, caption


def reads(sources: Sources) -> list[Path]:
    """The files that the report depends on."""
    drawn = [sources.folder / "figures" / f"{name}.png" for name in CAPTIONS]
    return [TEMPLATE, *drawn, *(path for m in MODULES.values() for path in build.reads(m, sources))]


# ------------------------------------------------------------------------------------- contents


def linked(cell: str | Cell) -> str:
    """A cell's text, as a link to where its number comes from."""
    if isinstance(cell, str):
        return cell
    target = TO_PAPER if cell.origin == PAPER else f"#origin-{EIGHT[cell.origin].letter}"
    return f"[{cell}]({target})"


def origin_line(item: str, files: str) -> str:
    """Command, inputs and files of a table or figure, as one line under it."""
    return f"*`make reproduce-{item}`; [hashes of what it read](inputs/{item}.json); {files}*"


def folded(table: Table) -> str:
    """A table's Markdown with its numbers linked; a long one is closed until it is clicked."""
    text, rows = table.markdown(linked), len(list(filter(None, table.rows)))
    if rows <= LONG:
        return text
    return f"<details><summary>{rows} rows</summary>\n\n{text}\n\n</details>"


def table_part(item: str, table: Table) -> str:
    """A table with its notes, its numbers linked, and its origin."""
    files = (f"[{kind}](tables/{table.name}.{kind})" for kind in ("md", "tex", "csv"))
    line = origin_line(item, ", ".join(files))
    return "\n\n".join([f"### {table.title}", folded(table), *table.notes, line])


def figure_part(name: str) -> str:
    """A figure with its caption and origin."""
    item, title, caption = CAPTIONS[name]
    line = origin_line(item, f"writes figures/{name}.svg and .pdf too")
    return "\n\n".join([f"### {title}", f"![{title}](figures/{name}.png)", caption, line])


def answers() -> str:
    """README's answers, with links from the report's folder."""
    return readme.answers().replace("](docs/", "](../docs/")


def recorded(ours: dict[str, list[Score]]) -> list[tuple[Score, Run]]:
    """Our runs that have a recording, with that."""
    found = [s for runs in ours.values() for s in usable(runs)]
    logs = [(s, recording_of(s.path)) for s in found]
    return [(s, read_published(log)) for s, log in logs if log.exists()]


def total_cost(runs: list[tuple[Score, Run]]) -> str:
    """What all our runs cost, as a sentence."""
    if not runs:
        return "No run is published yet."
    steps, core_hours = total(runs)
    count = "run" if len(runs) == 1 else f"{len(runs)} runs"
    return (
        f"The {count} of Table 3 took {core_hours:,.0f} core-hours and {steps / 1e9:,.1f} G steps."
    )


def total(runs: list[tuple[Score, Run]]) -> tuple[int, float]:
    """Environment steps and core-hours of runs."""
    # Not the hours: some runs were trained side by side.
    steps = sum(run.steps_with(s.agent) for s, run in runs)
    return steps, sum(run.core_hours[-1] for _, run in runs)


def costs(runs: list[tuple[Score, Run]]) -> str:
    """A table of what each run cost and when it had solved its task, beside the paper's."""

    def spent(steps: float, core_hours: float) -> list[str]:
        return [f"{steps / 1e6:,.0f} M", f"{core_hours:.2f}"]

    rows = []
    for s, run in runs:
        e, solved, theirs = s.agent.experiment, "", ""
        label = Cell(f"{title(e.name)}, {s.run}", e.name)
        if e.name in table2.WALKERS and not rewards_small_legs(e.name):
            at, solved = run.solved_at(), "no"
            if at is not None:  # a generation's number counts the updates by then, as a card does
                core_hours = np.interp(at, run.generation, run.core_hours)
                solved = f"{at + 1:,}; {core_hours:.2f}"
        if "hours" in (printed := paper()["text"].get(e.name, {})):
            core_hours = printed["hours"] * curves.PAPER_CORES
            theirs = f"{printed['generations']:,}; {core_hours:,}"
        done = f"{run.generation[-1] + 1:,} ({e.paper['generations']:,})"
        cells = [*spent(*total([(s, run)])), f"{run.hours[-1]:.2f}", solved, theirs]
        rows.append([label, done, *cells])
    rows.append([f"All {len(runs)} runs", "", *spent(*total(runs)), "", "", ""])
    header = ["Run", "Generations (paper)", "Steps", "Core-hours", "Hours"]
    header += ["Solved: generation; core-hours", "In the paper"]
    return folded(Table("costs", "", header, rows, [], []))


def origins(ours: dict[str, list[Score]]) -> str:
    """A line for each experiment: the cards of its checkpoints, which say where they are from."""
    lines = []
    for name, found in ours.items():
        cards = [origin(s) for s in found]
        anchor = f'<a id="origin-{EIGHT[name].letter}"></a>'
        lines.append(f"- {anchor}{title(name)}: {', '.join(cards) or MISSING}")
    return "\n".join(lines)


def origin(s: Score) -> str:
    """A checkpoint's link to its card."""
    if s.problem:
        return f"`{shown(s.path)}` is not used ({s.problem})"
    return f"[{s.run}](../{shown(s.path.with_suffix('.md'))})"


def main(sources: Sources) -> list[Path]:
    """Write the report; returns its file."""
    made = [(item, m.tables(sources)) for item, m in MODULES.items() if hasattr(m, "tables")]
    tables = {table.name: (item, table) for item, found in made for table in found}
    ours = {
        name: [s for source in (OURS, AT_PAPERS) for s in found[source].values()]
        for name, found in sources.by_source(*EIGHT).items()
    }
    runs = recorded(ours)
    parts = {
        "answers": answers(),
        "total_cost": total_cost(runs),
        "costs": costs(runs),
        "author_log_answer": studies.author_log_answer(),
        "transfer_answer": transfer.answer(),
        "origins": origins(ours),
        **{name: figure_part(name) for name in CAPTIONS},
        **{name: table_part(*found) for name, found in tables.items()},
    }
    text = TEMPLATE.read_text(encoding="utf-8")
    text = re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], text)
    folder = sources.folder
    if sources.zoo:  # one folder deeper
        text = text.replace("](../", "](../../").replace(f"]({TO_PAPER})", f"](../{TO_PAPER})")
    path = folder / "report.md"
    write_atomically(path, text.encode())
    return [path]
