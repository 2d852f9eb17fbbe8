"""Makes the tables, figures and the report that are out of date.

    python -m reproduce.build                  all of them (`make reproduce`)
    python -m reproduce.build table3 figure1   these (`make reproduce-table3`, ...)

Each item is one module of this package with `reads()`, the files that it depends on, and `main()`,
which writes its files and returns their paths. What an item read and wrote is kept by SHA-256: in
paper/inputs/NAME.json, committed with the outputs, so that a test can tell whether they belong
together; and in .cache/reproduce/, which says what was made on this machine. An item is made again
when a file that it reads, its source, or the code that scores depend on has changed.
"""

import ast
import importlib
import importlib.metadata
import json
import sys
from pathlib import Path
from types import ModuleType

from tqdm import tqdm

from designrl.files import file_hash, write_atomically
from reproduce import scores

PACKAGE = Path(__file__).parent
ITEMS = (
    *("table1", "table2", "table3", "table4", "statistics"),
    *("figure1", "figure2", "figure3", "figure4", "figure5", "figure6", "figure7"),
    "report",  # last: it shows all the others
)


def load(name: str) -> ModuleType:
    """The module of an item."""
    return importlib.import_module(f"reproduce.{name}")


def sources(module: ModuleType) -> list[Path]:
    """The source of a module and of those of this package that it imports."""
    found, left = set(), [Path(module.__file__)]
    while left:
        path = left.pop()
        if path in found:
            continue
        found.add(path)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("reproduce"):
                names = [node.module, *(f"reproduce.{alias.name}" for alias in node.names)]
                files = (PACKAGE.parent / f"{name.replace('.', '/')}.py" for name in names)
                left += [file for file in files if file.is_file()]
    return sorted(found)


def hashes(paths: list[Path]) -> dict[str, str]:
    """Path as a reader of the repository would write it -> SHA-256; "missing" where it is not."""
    return {
        scores.shown(path): file_hash(path) if path.is_file() else "missing"
        for path in sorted(set(paths))
    }


def inputs(module: ModuleType) -> dict[str, str]:
    """Hashes of all that an item reads, its own source included."""
    return hashes([*module.reads(), *sources(module)])


def used_versions() -> dict[str, str]:
    """Versions of what an item's content can change with."""
    drawing = {name: importlib.metadata.version(name) for name in ("matplotlib", "pillow")}
    return scores.used_versions() | drawing


def manifest(name: str) -> Path:
    """Where it is kept what an item read and wrote."""
    return scores.output_folder() / "inputs" / f"{name}.json"


def make(name: str, always: bool = False) -> list[Path] | None:
    """Make an item; None where it is up to date (never with `always`), else what was written."""
    module = load(name)
    read = inputs(module)
    made_here = scores.ROOT / ".cache" / "reproduce" / scores.output_folder().name / f"{name}.json"
    if not always and made_here.exists():
        kept = json.loads(made_here.read_text(encoding="utf-8"))
        same = kept["inputs"] == read and kept["versions"] == used_versions()
        if same and hashes([scores.ROOT / path for path in kept["outputs"]]) == kept["outputs"]:
            return None
    written = module.main()
    state = {
        "command": f"make reproduce-{name}",
        "versions": used_versions(),
        "inputs": read,
        "outputs": hashes(written),
    }
    text = json.dumps(state, indent=1).encode() + b"\n"
    write_atomically(manifest(name), text)
    write_atomically(made_here, text)
    return written


def command(name: str) -> None:
    """What `python -m reproduce.NAME` does: make it, whether it is up to date or not."""
    show(make(name, always=True))


def show(paths: list[Path]) -> None:
    """Print the Markdown among the files, name the others."""
    for path in paths:
        if path.suffix == ".md" and path.parent.name == "tables":
            print(path.read_text(encoding="utf-8"))
    print("written:", ", ".join(scores.shown(path) for path in paths))


def main(names: list[str]) -> None:
    """Make the named items, or all."""
    unknown = [name for name in names if name not in ITEMS]
    if unknown:
        sys.exit(f"reproduce: there is no {unknown[0]!r}; there are {', '.join(ITEMS)}")
    made = 0
    with tqdm(names or ITEMS, unit="item", disable=len(names) == 1, dynamic_ncols=True) as bar:
        for name in bar:
            bar.set_postfix_str(name)
            written = make(name)
            made += written is not None
            if len(names) != 1:
                if written:
                    tqdm.write(f"{name}: {', '.join(scores.shown(path) for path in written)}")
            elif written is None:
                show([path for path in outputs(name) if path.suffix == ".md"])
                print(f"{name} is up to date")
            else:
                show(written)
    if len(names) != 1:
        print(f"{made} made, {len(names or ITEMS) - made} up to date")


def outputs(name: str) -> list[Path]:
    """The files of an item that is up to date."""
    return [scores.ROOT / path for path in json.loads(manifest(name).read_text())["outputs"]]


if __name__ == "__main__":
    main(sys.argv[1:])
