"""Tables of plain columns, as CSV or Parquet."""

import csv
import io
from pathlib import Path

import numpy as np

from designrl.errors import InputError, optional
from designrl.files import require_new, write_atomically

SUFFIXES = (".csv", ".parquet")
Table = dict[str, np.ndarray]


def check_target(path: str | Path) -> None:
    """Raise InputError where no table can be written under that name, or not here."""
    if Path(path).suffix not in SUFFIXES:
        raise InputError(f"{path} would be no table; give it a name in {' or '.join(SUFFIXES)}")
    require_new(path)
    if Path(path).suffix == ".parquet":
        _pyarrow()


def write_table(columns: Table, path: str | Path) -> None:
    """Write columns as .csv (UTF-8, a header, nothing where a number is NaN) or as .parquet.

    Raises:
        InputError: another suffix, a file that exists, or that cannot be written.
    """
    check_target(path)
    if Path(path).suffix == ".parquet":
        pyarrow = _pyarrow()
        file = pyarrow.BufferOutputStream()
        pyarrow.parquet.write_table(pyarrow.table(columns), file)
        write_atomically(path, file.getvalue())
        return
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    lists = (column.tolist() for column in columns.values())
    writer.writerows(
        ["" if value != value else value for value in row] for row in zip(*lists, strict=True)
    )
    write_atomically(path, text.getvalue().encode())


def _pyarrow():
    with optional("Parquet", "view"):
        import pyarrow
        import pyarrow.parquet
    return pyarrow
