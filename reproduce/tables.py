"""A table whose cells know whose numbers they hold, written as Markdown, LaTeX and CSV."""

import csv
import io
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from tabulate import SEPARATING_LINE, tabulate

from designrl.files import write_atomically
from reproduce import paths
from reproduce.paths import shown
from reproduce.scores import Score, scoring_note
from reproduce.sources import Sources

PAPER = "paper"
ORIGINS = "## Where the numbers come from"  # a heading, in a table's Markdown


@dataclass(frozen=True)
class Cell:
    """A cell with a number.

    Attributes:
        text: as it is printed.
        origin: PAPER, or the experiment that our number is of.
    """

    text: str
    origin: str

    def __str__(self) -> str:
        return self.text


Row = list[str | Cell]


def row(head: Row, source: str, values: list[str], experiment: str) -> Row:
    """The row of one source: PAPER, "ours...", or the author's weights."""
    if source == PAPER:
        return [*head, Cell(source, PAPER), *values]
    if source.startswith("ours"):
        return [*head, source, *(Cell(text, experiment) if text else "" for text in values)]
    return [*head, source, *values]


@dataclass(frozen=True)
class Table:
    """A table with all that is said of it.

    Attributes:
        name: stem of the files.
        title: one line above the table.
        header: names of the columns.
        rows: the cells; None is a rule.
        notes: paragraphs under the table.
        records: the CSV's rows, unrounded; their keys are the columns, a missing one is empty.
        scores: the checkpoints behind it.
        groups: headings above the header and how many columns each spans.
    """

    name: str
    title: str
    header: list[str]
    rows: list[Row | None]
    notes: list[str]
    records: list[dict]
    scores: Iterable[Score] = ()
    groups: list[tuple[str, int]] | None = None

    def markdown(self, show: Callable[[str | Cell], str] = str) -> str:
        """The table alone, each cell as `show` gives it."""
        above = [group for group, span in self.groups or () for _ in range(span)]
        names = [f"{a}: {h}" if a else h for a, h in zip(above, self.header, strict=False)]
        cells = [[show(cell) for cell in row] for row in self.rows if row is not None]
        return tabulate(cells, names or self.header, tablefmt="github", disable_numparse=True)

    def latex(self) -> str:
        """A booktabs tabular."""
        rows = [SEPARATING_LINE if row is None else list(map(str, row)) for row in self.rows]
        text = tabulate(rows, self.header, tablefmt="latex_booktabs", disable_numparse=True)
        if self.groups:
            heads = (rf"\multicolumn{{{span}}}{{l}}{{{group}}}" for group, span in self.groups)
            text = text.replace("\\toprule\n", f"\\toprule\n{' & '.join(heads)} \\\\\n", 1)
        return text + "\n"

    def origins(self, sources: Sources) -> list[str]:
        """How its scores were made, and the checkpoints, with those that cannot be used."""
        lines = []
        for s in self.scores:
            if s.problem:
                lines.append(f"- not used: {s.problem}")
                continue
            steps = s.agent.metadata.get("environment_steps")
            score = "" if s.returns is None else f", {s.mean:.1f} ± {s.std:.1f}"
            trained = f", kept after {steps:,} steps of training" if steps else ""
            lines.append(f"- `{shown(s.path)}`, sha256 `{s.sha256[:16]}`{score}{trained}")
        scored = any(s.returns is not None for s in self.scores)
        note = [scoring_note(sources.backend)] if scored else []
        return [ORIGINS, *note, "\n".join(lines)] if lines else []

    def write(self, sources: Sources) -> list[Path]:
        """Write NAME.md, .tex and .csv to the tables' folder; returns their paths."""
        text = "\n\n".join(
            [f"# {self.title}", self.markdown(), *self.notes, *self.origins(sources)]
        )
        contents = {"md": text + "\n", "tex": self.latex(), "csv": as_csv(self.records)}
        files = [sources.folder / "tables" / f"{self.name}.{kind}" for kind in contents]
        for file, content in zip(files, contents.values(), strict=True):
            write_atomically(file, content.encode())
        return files


def mean_and_std(mean: float, std: float) -> str:
    """A score as the paper prints it: the std with one decimal where it is below 10."""
    return f"{mean:.0f} ± {std:.1f}" if std < 10 else f"{mean:.0f} ± {std:.0f}"


def csv_file(name: str) -> Path:
    """Where the numbers of one of our tables stand."""
    return paths.ROOT / "paper" / "tables" / f"{name}.csv"


def read_csv(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV; none where there is no file."""
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return list(csv.DictReader(text.splitlines()))


def as_csv(records: Iterable[dict]) -> str:
    """Records as CSV; its columns are their keys. What is missing or no number is empty."""
    text = io.StringIO()
    columns = dict.fromkeys(key for record in records for key in record)
    writer = csv.DictWriter(text, list(columns), lineterminator="\n")
    writer.writeheader()
    for record in records:
        writer.writerow({key: "" if value != value else value for key, value in record.items()})
    return text.getvalue()
