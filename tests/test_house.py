"""A room stands above all that it uses: no import runs back up."""

import ast
import re
import shutil
from pathlib import Path

import pytest

import designrl
from designrl import provenance

PACKAGE = Path(designrl.__file__).parent
FLOORS = (  # from the ground up; the rooms of a package stand on its floor
    "errors",
    "numeric",
    "files",
    "provenance",
    "terminal",
    "design",
    "engine",
    "bodies",
    "envs",
    "experiments",
    "policy",
    "settings",
    "reinforce",
    "workers",
    "simulation",
    "checkpoint",
    "author",
    "names",
    "evaluation",
    "verify",
    "recording",
    "compare",
    "video",
    "run_folder",
    "train",
    "plan",
    "viewer",
    "cli",
    "__main__",
)
FACE = "__init__"  # hands on what stands below, and nothing imports it


def imported(nodes) -> set[str]:
    """All that some statements import, with its packages: "designrl.envs.walker.Walker"."""
    found = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def rooms():
    """(file, its room, the rooms that it imports) for every file but the face."""
    for path in sorted(PACKAGE.rglob("*.py")):
        inside = path.relative_to(PACKAGE)
        room = inside.parts[0].removesuffix(".py")
        if room != FACE:
            names = imported(ast.walk(ast.parse(path.read_text())))
            parts = [f"{name}.{FACE}".split(".") for name in names]
            yield inside, room, {other for package, other, *_ in parts if package == "designrl"}


def test_no_import_runs_back_up():
    for path, room, others in rooms():
        for other in others:
            assert other in FLOORS, f"{path} imports the face"
            above = FLOORS.index(other) > FLOORS.index(room)
            assert not above, f"{path} imports {other}, which stands above it"


def test_a_score_depends_on_all_that_evaluation_imports_and_on_nothing_else():
    found, new = set(), {"evaluation", "simulation"}
    while new:
        found |= new
        new = set().union(*(others for _, room, others in rooms() if room in found)) - found
    assert {name.removesuffix(".py") for name in provenance.SCORING_SOURCES} == found


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        (False, "viewer/drawing.py"),
        (False, "video.py"),
        (False, "recording/run.py"),
        (False, "cli.py"),
        (False, "plan.py"),
        (False, "verify/episodes.py"),
        (True, "design.py"),
        (True, "envs/walker.py"),
        (True, "engine/native/api.cpp"),
        (True, "evaluation.py"),
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


def test_the_ground_is_free_of_simulators_and_torch():
    heavy = {"torch", "Box2D", "pybullet", "rerun", "matplotlib"}
    light = ("files", "provenance", "design", "bodies", "envs", "experiments", "policy", "settings")
    for room in light:
        files = PACKAGE / f"{room}.py", PACKAGE / room / "__init__.py"
        path = next(filter(Path.exists, files))
        names = {name.split(".")[0] for name in imported(ast.parse(path.read_text()).body)}
        assert not names & heavy, f"{path} imports {names & heavy}"


def test_the_map_has_every_floor_in_its_order():
    page = (Path(__file__).resolve().parents[1] / "docs/architecture.md").read_text()
    floors = page.partition("From the ground up:")[2].partition("\n\nA new module")[0]
    assert tuple(re.findall(r"`(\w+)`", floors)) == FLOORS
