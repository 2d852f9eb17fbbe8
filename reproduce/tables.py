"""Writes a table three times: Markdown, LaTeX (booktabs) and CSV."""

import csv
import io
from pathlib import Path

from tabulate import tabulate

from designrl.checkpoint import write_atomically

TABLES = Path(__file__).resolve().parents[1] / "paper" / "tables"


def write_table(
    name: str,
    title: str,
    header: list[str],
    rows: list[list[str]],
    notes: list[str],
    records: list[dict],
) -> str:
    """Write paper/tables/NAME.md, .tex and .csv and return the Markdown.

    Args:
        name: stem of the files.
        title: one line above the table.
        header, rows: the cells as text; the same in Markdown and LaTeX.
        notes: sentences under the table.
        records: the CSV's rows, unrounded, all with the same keys.
    """
    table = tabulate(rows, header, tablefmt="github", disable_numparse=True)
    markdown = "\n\n".join([f"# {title}", table, *notes]) + "\n"
    latex = tabulate(rows, header, tablefmt="latex_booktabs", disable_numparse=True)
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    write_atomically(TABLES / f"{name}.md", markdown.encode())
    write_atomically(TABLES / f"{name}.tex", latex.replace("±", r"$\pm$").encode())
    write_atomically(TABLES / f"{name}.csv", text.getvalue().encode())
    return markdown
