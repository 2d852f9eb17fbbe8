"""What works with the base installation alone, and one sentence for what it lacks."""

import ast
import json
import os
import re
import shlex
import subprocess
import sys
import sysconfig
import tomllib
from importlib.metadata import distribution, packages_distributions
from pathlib import Path

import pytest
from test_house import imported

import designrl
from designrl.engine import missing_reason

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# What pip installs with the base: its dependencies, and theirs.
BASE = ("numpy", "gymnasium", "safetensors", "cloudpickle", "farama-notifications")
BASE += ("typing-extensions",)
NAME = "biped-morphology/seed0"
# What the base does not run -> the extra that it names.
COMMANDS = {
    "train biped": "train",
    f"evaluate {NAME} --backend reference": "reference",
    "evaluate ant/seed0 --backend reference": "reference",
    f"evaluate {NAME} --episodes 1 -o a.parquet": "view",
    f"record {NAME} -o a.mcap": "view",
    f"record {NAME} --video a.webp": "view",
    "replay there.mcap": "view",
    "replay there.mcap --video a.mp4": "view",
    "export there.mcap -o a.csv": "view",
    "info there.mcap": "view",
    "compare there.mcap b.mcap": "view",
}
IMPORTS = {
    "import gymnasium; gymnasium.make('designrl/BipedalWalker-v0')": "reference",
    "import gymnasium; gymnasium.make('designrl/Ant-v0')": "reference",
    "import designrl.reinforce": "train",
    "import designrl.train": "train",
    "import designrl.recording": "view",
    "import designrl.viewer": "view",
    "import designrl.video": "view",
    "import designrl.envs.sb3": "sb3",
    "from designrl.simulation import Simulator; Simulator('biped', ray='local')": "ray",
    "import sys, designrl.verify.__main__ as v; sys.exit(v.main([]) - 1)": "train",
}


def plain(name):
    """A distribution's name as all of its spellings are."""
    return re.sub(r"[-_.]+", "-", name).lower()


def run(base, *words, code=0):
    """What a Python with the base installation says, on stdout and on stderr."""
    command = [sys.executable, "-S", *map(str, words)]
    env = os.environ | {"PYTHONPATH": str(base)}
    done = subprocess.run(command, cwd=base, env=env, capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    return done.stdout, done.stderr


needs_engine = pytest.mark.skipif(missing_reason() is not None, reason=str(missing_reason()))


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """A folder that has the packages of the base installation alone."""
    folder, packages = tmp_path_factory.mktemp("base"), sysconfig.get_path("purelib")
    (folder / "designrl").symlink_to(Path(designrl.__file__).parent)
    for name in BASE:
        for top in {file.parts[0] for file in distribution(name).files} - {"..", "__pycache__"}:
            (folder / top).symlink_to(Path(packages) / top)
    return folder


def test_the_base_is_what_pyproject_declares():
    named = {re.match(r"[\w-]+", each)[0] for each in PROJECT["dependencies"]}
    needed = {
        re.match(r"[\w-]+", each)[0].lower()
        for name in named
        for each in distribution(name).requires or ()
        if "extra ==" not in each
    }
    assert named | needed == set(BASE)


@needs_engine
def test_the_base_runs_commands_and_scores_as_all_does(base, tmp_path):
    assert run(base, "-m", "designrl", "--version")[0].startswith("designrl ")
    assert "biped-hardcore " in run(base, "-m", "designrl", "experiments")[0]
    assert NAME in run(base, "-m", "designrl", "checkpoints")[0]
    assert "sha256" in run(base, "-m", "designrl", "info", NAME)[0]
    run(base, "-m", "designrl", "evaluate", NAME, "--episodes", "2", "-o", tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text().startswith("episode,seed,score,length\n0,")
    for name in (NAME, "ant-morphology/seed0"):
        said, warned = run(base, "-m", "designrl", "evaluate", name, "--episodes", "2", "--json")
        found = json.loads(said)
        assert not warned and found["backend"] == "engine"
        assert found["scores"] == designrl.evaluate(name, episodes=2).scores.tolist()


@needs_engine
@pytest.mark.parametrize("task", ["BipedalWalker", "BipedalWalkerHardcore", "Ant"])
def test_the_base_steps_vector_environments(base, task):
    code = f"""
import gymnasium, designrl
envs = gymnasium.make_vec("designrl/{task}-v0", 3, "vector_entry_point")
envs.reset(seed=0)
envs.step(envs.action_space.sample())
"""
    assert run(base, "-c", code) == ("", "")


@pytest.mark.parametrize(("command", "extra"), COMMANDS.items())
def test_a_command_names_the_extra_that_it_lacks(base, command, extra):
    (base / "there.mcap").touch()
    said, error = run(base, "-m", "designrl", *shlex.split(command), code=2)
    assert said == "" and error.startswith("designrl: ") and error.count("\n") == 1
    assert f"install designrl[{extra}]" in error


@pytest.mark.parametrize(("code", "extra"), IMPORTS.items())
def test_an_import_that_fails_names_the_extra(base, code, extra):
    _, error = run(base, "-c", f"import designrl\n{code}", code=1)
    assert f"install designrl[{extra}]" in error.splitlines()[-1]
    assert extra in PROJECT["optional-dependencies"]


def test_a_protobuf_that_is_too_old_is_said_in_one_sentence():
    code = """
import google.protobuf.runtime_version as runtime
runtime.MAJOR, runtime.MINOR = 5, 28
from designrl.cli import main
main(["info", "logs/biped/seed0/generations.mcap"])
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "runtime 5.28" in done.stderr and "install designrl[view]" in done.stderr


def test_tables_and_figures_need_no_torch():
    code = """
import importlib, sys
sys.modules |= dict.fromkeys(("torch", "stable_baselines3"))
from reproduce import build, gallery, page, publish
for name in build.ITEMS: build.load(name)
"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


# ------------------------------------------------------------------------------ what is declared


def test_the_floors_that_are_declared_are_those_that_are_tested():
    lines = (ROOT / "requirements-floors.lock").read_text().splitlines()
    tested = dict(line.split("==") for line in lines if not line.startswith("#"))
    declared = {}
    for each in (*PROJECT["dependencies"], *sum(PROJECT["optional-dependencies"].values(), [])):
        name, floor = re.match(r"([\w-]+)(.*)", each.partition(";")[0]).groups()
        declared[name] = floor.strip().lstrip(">=")
    # Another extra; what is pinned and what has no test here.
    assert declared.keys() - tested.keys() == {"designrl", "ray", "envpool", "ruff"}
    declared = {name: floor for name, floor in declared.items() if name in tested}
    assert declared == tested
    module = Path(designrl.__file__).parent / "recording/schema_pb2.py"
    made_for = re.search(r"Protobuf Python Version: ([\d.]+)", module.read_text())[1]
    assert [*map(int, made_for.split("."))] <= [*map(int, tested["protobuf"].split("."))]


def test_all_that_is_imported_is_declared():
    extras = sum(PROJECT["optional-dependencies"].values(), PROJECT["dependencies"])
    declared = {plain(re.match(r"[\w-]+", each)[0]) for each in extras}
    lock = (ROOT / "requirements-extras.lock").read_text()
    declared |= {plain(name) for name in re.findall(r"^([\w-]+)==", lock, re.MULTILINE)}
    declared |= {"box2d-py", "setuptools"}  # in the place of box2d; of setup.py
    found, distributions = set(), packages_distributions()
    for folder in ("designrl", "reproduce", "examples", "tests"):
        files = (ROOT / folder).rglob("*.py")
        found |= imported(node for file in files for node in ast.walk(ast.parse(file.read_text())))
    for name in {name.partition(".")[0] for name in found} - sys.stdlib_module_names:
        here = {plain(each) for each in distributions.get(name, ())}
        assert not here or here & declared, f"{name} is imported, of {here}"
