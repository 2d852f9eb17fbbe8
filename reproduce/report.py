"""The report: all tables and figures, what they rest on, where we differ, what it cost.

Reads report_template.md, the figures, pretrained/ and logs/. Writes paper/report.md.
"""

import re
from pathlib import Path

import numpy as np

from designrl.errors import InputError
from designrl.files import file_hash, write_atomically
from reproduce import build, figure5, paths, statistics, table2, transfer
from reproduce.paths import EIGHT, paper, recording_of, shown
from reproduce.runs import read_published
from reproduce.scores import EPISODES, SEED, Score, rewards_small_legs, title, usable
from reproduce.sources import Sources
from reproduce.tables import PAPER, Cell, Table

TEMPLATE = Path(__file__).with_name("report_template.md")
TO_PAPER = "paper.toml"  # beside the report
MODULES = {name: build.load(name) for name in build.ITEMS if name != "report"}
CAPTIONS = {
    name: (item, *about)
    for item, module in MODULES.items()
    for name, about in getattr(module, "CAPTIONS", {}).items()
}  # figure -> item, title, caption


def reads(sources: Sources) -> list[Path]:
    """The files that the report depends on."""
    drawn = (sources.folder / "figures" / f"{name}.png" for name in CAPTIONS)
    return [
        TEMPLATE,
        *drawn,
        *sources.read_for(*EIGHT),
        *figure5.reads(sources),
        *transfer.reads(sources),
    ]


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


def table_part(item: str, table: Table) -> str:
    """A table with its notes, its numbers linked, and its origin."""
    # How scores were made, and from which checkpoints, is under Origins, once for all.
    files = (f"[{kind}](tables/{table.name}.{kind})" for kind in ("md", "tex", "csv"))
    line = origin_line(item, ", ".join(files))
    return "\n\n".join([f"### {table.title}", table.markdown(linked), *table.notes, line])


def figure_part(name: str) -> str:
    """A figure with its caption and origin."""
    item, title, caption = CAPTIONS[name]
    line = origin_line(item, f"writes figures/{name}.svg and .pdf too")
    return "\n\n".join([f"### {title}", f"![{title}](figures/{name}.png)", caption, line])


def does_a_learned_body_help(comparisons: list[dict]) -> str:
    """The statistics' answer as a list, for the paper's runs and ours."""
    starts, lines = {PAPER: "The paper's runs", "ours": "Ours"}, {}
    for c in comparisons:
        if not rewards_small_legs(c["with"]):  # these trade score for smaller legs
            words = f"{c['difference']:+.0f} points ({statistics.verdict(c)})"
            said = f"{EIGHT[c['without']].title} {words}"
            lines.setdefault(c["source"], []).append(said)
    return "\n".join(f"- {starts.get(s, s)}: {'; '.join(said)}." for s, said in lines.items())


def costs(ours: dict[str, list[Score]]) -> str:
    """A table of what each run cost and when it had solved its task, beside the paper's."""

    def spent(steps: float, core_hours: float) -> list[str]:
        return [f"{steps / 1e6:,.0f} M", f"{core_hours:.2f}"]

    rows, totals = [], []
    for name, s in ((name, s) for name, found in ours.items() for s in usable(found)):
        e, solved, theirs = EIGHT[name], "", ""
        label = Cell(f"{title(name)}, {s.run}", name)
        log = recording_of(s.path)
        try:
            run = read_published(log)
        except InputError as error:
            said = str(error).replace(str(log), shown(log)) if log.exists() else "no recording"
            rows.append([label, said, *[""] * 5])
            continue
        totals.append((run.steps_with(s.agent), run.core_hours[-1]))
        if name in table2.WALKERS and not rewards_small_legs(name):
            at, solved = run.solved_at(), "no"
            if at is not None:  # a generation's number counts the updates by then, as a card does
                core_hours = np.interp(at, run.generation, run.core_hours)
                solved = f"{at + 1:,}; {core_hours:.2f}"
        if "hours" in (printed := paper()["text"].get(name, {})):
            core_hours = printed["hours"] * figure5.PAPER_CORES
            theirs = f"{printed['generations']:,}; {core_hours:,}"
        done = f"{run.generation[-1] + 1:,} ({e.paper['generations']:,})"
        rows.append([label, done, *spent(*totals[-1]), f"{run.hours[-1]:.2f}", solved, theirs])
    if not totals:
        return "No run is published yet."
    # Not the hours: some runs were trained side by side.
    rows.append([f"All {len(totals)} published runs", "", *spent(*np.sum(totals, 0)), "", "", ""])
    header = ["Run", "Generations (paper)", "Steps", "Core-hours", "Hours"]
    header += ["Solved: generation; core-hours", "In the paper"]
    return Table("costs", "", header, rows, [], []).markdown(linked)


def origins(ours: dict[str, list[Score]], sources: Sources) -> str:
    """Each checkpoint: file, hash, how it was scored and trained."""
    note = f"{sources.note()} Printed numbers are in [paper.toml]({TO_PAPER})."
    parts = [f"{note} `designrl info` has each agent's settings and libraries."]
    for name, found in ours.items():
        anchor = f'<a id="origin-{EIGHT[name].letter}"></a>'
        parts += [anchor, f"### {title(name)}"]
        parts += [origin(s) for s in found] or ["No checkpoint yet."]
    return "\n\n".join(parts)


def origin(s: Score) -> str:
    """One checkpoint's part of `origins`."""
    path = shown(s.path)
    if s.problem:
        return f"`{path}` is not used: {s.problem}."
    m, card = s.agent.metadata, shown(s.path.with_suffix(".md"))
    items = [
        f"**[{path}](../{path})**, sha256 `{s.sha256}`; [its card](../{card})",
        f"score {s.mean:.2f} ± {s.std:.2f} (median {np.median(s.returns):.1f}, "
        f"{s.returns.min():.1f} to {s.returns.max():.1f}); "
        f"`designrl evaluate {path} --episodes {EPISODES} --seed {SEED}`",
    ]
    if "score_episodes" in m:
        factor = " with the reward for smaller legs" * rewards_small_legs(s.agent.experiment.name)
        items.append(
            f"kept at generation {m['generation']:,} after {m['environment_steps']:,} "
            f"steps, with {m['score']:.1f} over {m['score_episodes']} episodes then{factor}"
        )
    log = recording_of(s.path)
    if log.exists():
        recording = shown(log)
        items.append(f"recording [{recording}](../{recording}), sha256 `{file_hash(log)}`")
    return "\n".join(f"- {item}" for item in items)


def main(sources: Sources) -> list[Path]:
    """Write the report; returns its file."""
    made = [(item, m.tables(sources)) for item, m in MODULES.items() if hasattr(m, "tables")]
    tables = {table.name: (item, table) for item, found in made for table in found}
    ours = {name: list(s["ours"].values()) for name, s in sources.by_source(*EIGHT).items()}
    parts = {
        "answer": does_a_learned_body_help(tables["statistics"][1].records),
        "costs": costs(ours),
        "transfer_answer": transfer.answer(),
        "origins": origins(ours, sources),
        **{name: figure_part(name) for name in CAPTIONS},
        **{name: table_part(*found) for name, found in tables.items()},
    }
    text = TEMPLATE.read_text(encoding="utf-8")
    text = re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], text)
    folder = sources.folder
    if folder != paths.ROOT / "paper":  # one folder deeper
        text = text.replace("](../", "](../../").replace(f"]({TO_PAPER})", f"](../{TO_PAPER})")
    path = folder / "report.md"
    write_atomically(path, text.encode())
    return [path]
