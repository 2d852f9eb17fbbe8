"""Writes a table as Markdown, LaTeX (booktabs) and CSV; and what the tables have in common."""

import csv
import io
from collections.abc import Iterable
from pathlib import Path

from tabulate import tabulate

from designrl.files import write_atomically
from reproduce import scores
from reproduce.scores import Score

_LATEX = {"%": r"\%", "&": r"\&", "#": r"\#", "_": r"\_", "±": r"$\pm$", "–": "--"}

MISSING = "no checkpoint yet"


def write_table(
    name: str,
    title: str,
    header: list[str],
    rows: list[list[str] | None],
    notes: list[str],
    records: list[dict],
    groups: list[tuple[str, int]] | None = None,
) -> list[Path]:
    """Write NAME.md, .tex and .csv to the tables' folder; returns their paths.

    Args:
        name: stem of the files.
        title: one line above the table.
        header, rows: the cells as text; the same in Markdown and LaTeX. None is a rule.
        notes: sentences under the table.
        records: the CSV's rows, unrounded, all with the same keys.
        groups: headings above the header and how many columns each spans.
    """
    plain = header
    if groups:
        above = [group for group, span in groups for _ in range(span)]
        plain = [f"{a}: {h}" if a else h for a, h in zip(above, header, strict=True)]
    cells = [row for row in rows if row is not None]
    table = tabulate(cells, plain, tablefmt="github", disable_numparse=True)
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    contents = {
        "md": "\n\n".join([f"# {title}", table, *notes]) + "\n",
        "tex": _latex(header, rows, groups),
        "csv": text.getvalue(),
    }
    folder = scores.output_folder() / "tables"
    for suffix, content in contents.items():
        write_atomically(folder / f"{name}.{suffix}", content.encode())
    return [folder / f"{name}.{suffix}" for suffix in contents]


def _latex(header: list[str], rows: list, groups: list[tuple[str, int]] | None) -> str:
    def line(cells: list[str]) -> str:
        escaped = ("".join(_LATEX.get(letter, letter) for letter in cell) for cell in cells)
        return " & ".join(escaped) + r" \\"

    lines = [rf"\begin{{tabular}}{{{'l' * len(header)}}}", r"\toprule"]
    if groups:
        heads = (rf"\multicolumn{{{span}}}{{l}}{{{group}}}" for group, span in groups)
        lines.append(" & ".join(heads) + r" \\")
    lines += [line(header), r"\midrule"]
    lines += [r"\midrule" if row is None else line(row) for row in rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


def mean_and_std(mean: float, std: float) -> str:
    """A score as the paper prints it: the std with one decimal where it is below 10."""
    return f"{mean:.0f} ± {std:.1f}" if std < 10 else f"{mean:.0f} ± {std:.0f}"


def scoring_note() -> str:
    """How scores were made, with versions."""
    used = scores.used_versions()
    return (
        f"Scored on the reference environments, {scores.EPISODES} episodes, evaluation seed "
        f"{scores.SEED}; designrl {used['designrl']} (sources {used['sources']}), "
        f"Gymnasium {used['gymnasium']}, box2d-py {used['box2d-py']}, "
        f"PyBullet {used['pybullet']}."
    )


def origin_notes(found: Iterable[Score]) -> list[str]:
    """One paragraph that lists the checkpoints behind a table, and those that cannot be used."""
    lines = []
    for s in found:
        if s.problem:
            lines.append(f"- not used: {s.problem}")
            continue
        steps = s.agent.metadata.get("environment_steps")
        score = "" if s.returns is None else f", {s.mean:.1f} ± {s.std:.1f}"
        trained = f", {steps:,} training steps" if steps else ""
        lines.append(f"- `{scores.shown(s.path)}`, sha256 `{s.sha256[:16]}`{score}{trained}")
    return ["Checkpoints:\n\n" + "\n".join(lines)] if lines else []
