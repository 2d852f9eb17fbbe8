"""Makes the tables, figures and the report that are out of date.

    python -m reproduce.build                  all of them (`make reproduce`)
    python -m reproduce.build table3 figure1   these (`make reproduce-table3`, ...)

Each item is one module of this package. READS names the experiments whose scores it shows, or
`reads()` the files that it depends on; `tables()`, `figures()` (name -> figure) or `main()` (which
writes its files itself and returns their paths) makes it. What an item read and wrote stands, by
SHA-256, in paper/inputs/NAME.json, committed with the outputs, so that a test can tell whether they
belong together. An item is made again when one of these files has changed, or on this machine
(.cache/reproduce/) the code, a library or the backend.
"""

import importlib
import importlib.metadata
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

from tqdm import tqdm

from designrl.errors import remark
from designrl.files import file_hash, write_atomically
from designrl.provenance import sources_hash
from reproduce import drawing, paths, scores
from reproduce.paths import shown
from reproduce.program import program
from reproduce.sources import Sources
from reproduce.tables import ORIGINS

ITEMS = (
    "table1",
    "table2",
    "table3",
    "table4",
    "statistics",
    "figure1",
    "figure2",
    "figure3",
    "figure4",
    "figure5",
    "figure6",
    "figure7",
    "curves",
    "studies",
    "transfer",
    "readme",  # the last two show the others
    "report",
)
# People write in the first, git does not keep the others: none belongs to a committed manifest.
NOT_COMMITTED = ("README.md", ".svg", ".pdf")
OURS = Sources()


def load(name: str) -> ModuleType:
    """The module of an item."""
    return importlib.import_module(f"reproduce.{name}")


def reads(module: ModuleType, sources: Sources = OURS) -> list[Path]:
    """The files that an item depends on."""
    return module.reads(sources) if hasattr(module, "reads") else sources.read_for(*module.READS)


def hashes(paths: Iterable[Path]) -> dict[str, str]:
    """Path as a reader of the repository would write it -> SHA-256; "missing" where it is not."""
    return {
        shown(path): file_hash(path) if path.is_file() else "missing" for path in sorted(set(paths))
    }


def code() -> dict[str, str]:
    """Hashes of the code that makes the items."""
    return hashes(Path(__file__).parent.glob("*.py")) | {"designrl": sources_hash()}


def used_versions() -> dict[str, str]:
    """Versions of what an item's content can change with."""
    drawn = {name: importlib.metadata.version(name) for name in ("matplotlib", "pillow")}
    return scores.used_versions() | drawn


def manifest(name: str, sources: Sources = OURS) -> Path:
    """Where it is kept what an item read and wrote."""
    return sources.folder / "inputs" / f"{name}.json"


def write(module: ModuleType, sources: Sources) -> list[Path]:
    """Make an item; returns its files."""
    if hasattr(module, "tables"):
        return [path for table in module.tables(sources) for path in table.write(sources)]
    if hasattr(module, "figures"):
        folder, drawn = sources.folder / "figures", module.figures(sources)
        return [path for each in drawn.items() for path in drawing.save(folder, *each)]
    return module.main(sources)


def changed(inputs: dict[str, str], sources: Sources) -> list[tuple[str, Sources]]:
    """The items that made some of an item's inputs, where these or what they read have changed."""
    found = []
    for by in {s.folder: s for s in (OURS, sources)}.values():  # one a folder
        for name in ITEMS:
            made = kept_in(manifest(name, by))
            outputs = {p: h for p, h in made.get("outputs", {}).items() if p in inputs}
            if outputs and (
                any(inputs[path] != sha256 for path, sha256 in outputs.items())
                or made["inputs"] != hashes(reads(load(name), by))
            ):
                found.append((name, by))
    return found


def kept_in(path: Path) -> dict:
    """What stands in a file of JSON; nothing where there is none."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def make(name: str, sources: Sources = OURS) -> list[Path] | None:
    """Make an item; None where it is up to date, else what was written."""
    module = load(name)
    inputs = hashes(reads(module, sources))
    for other, by in changed(inputs, sources):
        remark(f"{name} reads what `make reproduce-{other}` makes, which is made again first")
        make(other, by)
        inputs = hashes(reads(module, sources))
    state = {"versions": used_versions(), "inputs": inputs}
    local = state | {"code": code(), "backend": sources.backend}

    def committed(outputs: dict[str, str]) -> dict:
        kept = {p: sha256 for p, sha256 in outputs.items() if not p.endswith(NOT_COMMITTED)}
        return {"command": f"make reproduce-{name}"} | state | {"outputs": kept}

    here = paths.ROOT / ".cache" / "reproduce" / sources.folder.name / f"{name}.json"
    outputs = kept_in(here).get("outputs", {})
    now = local | {"outputs": hashes(paths.ROOT / path for path in outputs)}
    if kept_in(here) == now and kept_in(manifest(name, sources)) == committed(outputs):
        return None
    written = write(module, sources)
    outputs = hashes(written)
    said = {manifest(name, sources): committed(outputs), here: local | {"outputs": outputs}}
    for path, content in said.items():
        write_atomically(path, json.dumps(content, indent=1).encode() + b"\n")
    return written


def main(names: list[str]) -> None:
    """Make the named items, or all; of a single one, print its tables last."""
    unknown = [name for name in names if name not in ITEMS]
    if unknown:
        sys.exit(f"reproduce: there is no {unknown[0]!r}; there are {', '.join(ITEMS)}")
    sources = Sources.asked()
    with tqdm(names or ITEMS, unit="item", disable=len(names) == 1, dynamic_ncols=True) as bar:
        for name in bar:
            bar.set_postfix_str(name)
            files = ", ".join(shown(path) for path in make(name, sources) or ())
            tqdm.write(f"{name}: {files or 'up to date'}")
    if len(names) == 1:
        print_tables(names[0], sources)
    report = shown(sources.folder / "report.md")
    print(f"\nThe report: {report} (make reproduce brings it up to date)")


def print_tables(name: str, sources: Sources) -> None:
    """Print an item's tables, without the hashes that stand below them in their files."""
    for path in kept_in(manifest(name, sources))["outputs"]:
        if "tables/" in path and path.endswith(".md"):
            text = (paths.ROOT / path).read_text(encoding="utf-8")
            print(f"\n{text.partition(ORIGINS)[0].strip()}")


if __name__ == "__main__":
    with program("reproduce"):
        main(sys.argv[1:])
