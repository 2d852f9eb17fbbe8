"""A room stands above all that it uses: no import runs back up."""

import ast
from pathlib import Path

import designrl

PACKAGE = Path(designrl.__file__).parent
FLOORS = (  # from the ground up; the rooms of a package stand on its floor
    "errors",
    "files",
    "provenance",
    "terminal",
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
    "video",
    "train",
    "plan",
    "viewer",
    "cli",
    "__main__",
)
FACE = "__init__"  # hands on what stands below, and nothing imports it
SCRIPTS = {"engine/verify.py", "engine/verify_vector.py"}  # run by hand, stand at the top


def imported(nodes) -> set[str]:
    """All that some statements import, with its packages: "designrl.envs.walker.Walker"."""
    found = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def test_no_import_runs_back_up():
    for path in sorted(PACKAGE.rglob("*.py")):
        inside = path.relative_to(PACKAGE)
        room = inside.parts[0].removesuffix(".py")
        if room == FACE or inside.as_posix() in SCRIPTS:
            continue
        for name in imported(ast.walk(ast.parse(path.read_text()))):
            package, other = f"{name}.{FACE}".split(".")[:2]
            if package == "designrl":
                assert other in FLOORS, f"{inside} imports the face"
                above = FLOORS.index(other) > FLOORS.index(room)
                assert not above, f"{inside} imports {other}, which stands above it"


def test_the_ground_is_free_of_simulators_and_torch():
    heavy = {"torch", "Box2D", "pybullet", "rerun", "matplotlib"}
    light = ("files", "provenance", "design", "bodies", "envs", "experiments", "policy", "settings")
    for room in light:
        files = PACKAGE / f"{room}.py", PACKAGE / room / "__init__.py"
        path = next(filter(Path.exists, files))
        names = {name.split(".")[0] for name in imported(ast.parse(path.read_text()).body)}
        assert not names & heavy, f"{path} imports {names & heavy}"
