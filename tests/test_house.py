"""A room stands above all that it uses: no import runs back up."""

import ast
from pathlib import Path

import designrl

PACKAGE = Path(designrl.__file__).parent
FLOORS = (  # from the ground up; the rooms of a package stand on its floor
    "errors",
    "files",
    "provenance",
    "design",
    "engine",
    "bodies",
    "envs",
    "experiments",
    "policy",
    "network",
    "settings",
    "reinforce",
    "workers",
    "simulation",
    "published",
    "checkpoint",
    "evaluation",
    "recording",
    "train",
    "plan",
    "viewer",
    "cli",
    "__main__",
)
FACE = "__init__"  # hands on what stands below, and nothing imports it
SCRIPTS = {"engine/verify.py"}  # run by hand, stand at the top


def rooms_imported(path: Path) -> set[str]:
    """The rooms that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "designrl":
            room = node.module.split(".")[1:2]
            found |= set(room) if room else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
            found |= {(name + [FACE])[1] for name in names if name[0] == "designrl"}
    return found


def test_no_import_runs_back_up():
    for path in sorted(PACKAGE.rglob("*.py")):
        inside = path.relative_to(PACKAGE)
        room = inside.parts[0].removesuffix(".py")
        if room == FACE or inside.as_posix() in SCRIPTS:
            continue
        height = FLOORS.index(room)
        for other in rooms_imported(path):
            assert other != FACE, f"{inside} imports the face"
            assert FLOORS.index(other) <= height, f"{inside} imports {other}, which stands above it"


def test_the_ground_is_free_of_simulators_and_torch():
    heavy = {"torch", "Box2D", "pybullet", "rerun", "matplotlib"}
    light = ("files", "provenance", "design", "bodies", "envs", "experiments", "policy", "settings")
    for room in light:
        for path in sorted([PACKAGE / f"{room}.py", *(PACKAGE / room).glob("__init__.py")]):
            if path.exists():
                names = {n.split(".")[0] for n in imported_at_the_top(path)}
                assert not names & heavy, f"{path.name} imports {names & heavy}"


def imported_at_the_top(path: Path) -> list[str]:
    found = []
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found.append(node.module or "")
    return found
