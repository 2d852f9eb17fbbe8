"""A module imports from lower layers only (docs/architecture.md)."""

import ast
import re
import shutil
from pathlib import Path

import pytest

import designrl
from designrl import provenance

PACKAGE = Path(designrl.__file__).parent
ROOT = Path(__file__).resolve().parents[1]
MAP = (ROOT / "docs/architecture.md").read_text()
# From the bottom up; the modules of a package are in its layer.
LAYERS = re.findall(r"`(\w+)`", MAP.partition("From the bottom up:")[2].partition("\n\nA new")[0])
FACE = "__init__"  # hands on what the layers have, and none imports it


def imported(nodes) -> set[str]:
    """All that some statements import, with its packages: "designrl.envs.walker.Walker"."""
    found = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def modules():
    """(file, its layer, the layers that it imports) for every file but the face."""
    for path in sorted(PACKAGE.rglob("*.py")):
        inside = path.relative_to(PACKAGE)
        layer = inside.parts[0].removesuffix(".py")
        if layer != FACE:
            names = imported(ast.walk(ast.parse(path.read_text())))
            parts = [f"{name}.{FACE}".split(".") for name in names]
            yield inside, layer, {other for package, other, *_ in parts if package == "designrl"}


def test_no_module_imports_from_a_higher_layer():
    for path, layer, others in modules():
        for other in others:
            assert other in LAYERS, f"{path} imports the face"
            above = LAYERS.index(other) > LAYERS.index(layer)
            assert not above, f"{path} imports {other}, a higher layer"


def test_a_score_depends_on_all_that_evaluation_imports_and_on_nothing_else():
    found, new = set(), {"evaluation", "simulation"}
    while new:
        found |= new
        new = set().union(*(others for _, layer, others in modules() if layer in found)) - found
    assert {name.removesuffix(".py") for name in provenance.SCORING_SOURCES} == found


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        (False, "viewer/drawing.py"),
        (False, "recording/run.py"),
        (True, "envs/walker.py"),
        (True, "engine/native/api.cpp"),
    ],
)
def test_the_hash_of_sources_changes_with_what_scores_and_not_with_what_draws(
    tmp_path, monkeypatch, changed, name
):
    copy = tmp_path / "designrl"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    monkeypatch.setattr(provenance, "__file__", str(copy / "provenance.py"))
    before = provenance.sources_hash.__wrapped__()
    with (copy / name).open("a") as file:
        file.write("\n")
    assert (provenance.sources_hash.__wrapped__() != before) == changed
