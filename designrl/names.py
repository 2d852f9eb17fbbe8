"""Agents and runs by name: a file, a run's folder, or a published one, "biped-morphology/seed0"."""

import json
import re
from pathlib import Path

from designrl import checkpoint
from designrl.author import load_author
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS, get_experiment
from designrl.files import file_hash
from designrl.policy import Agent

PRETRAINED = Path(__file__).resolve().parent / "pretrained"  # there, if installed from a wheel
if not PRETRAINED.is_dir():
    PRETRAINED = PRETRAINED.parents[1] / "pretrained"  # in a clone, beside the package
# A published run: of our recipe, at the paper's settings, in a body of other limits; and its name.
RUN = re.compile(r"(paper-|blooper-)?seed(\d+)")
NAME = re.compile(rf"[\w-]+/{RUN.pattern}")


def find(name: str | Path) -> Path:
    """The file that is meant: itself, a run's best agent, or a published agent.

    Args:
        name: a file, the folder of a run, or "biped-morphology/seed0" for the published agent.

    Raises:
        InputError: there is nothing of that name; a folder that holds no run, or one without an
            agent.
    """
    path = Path(name)
    if (path / "best.safetensors").is_file():
        return path / "best.safetensors"
    run = path.parent if path.name == "best.safetensors" else path
    if (run / "generations.mcap").is_file() and not path.is_file():
        raise InputError(
            f"{run} has no agent; a run keeps its first one at its first evaluation (go on with "
            "--resume), and those of published runs are in pretrained/"
        )
    if path.is_dir():
        raise nothing_at(path)
    if path.exists():
        return path
    published = PRETRAINED / f"{path}.safetensors"
    if not NAME.fullmatch(str(path)) or not published.is_file():
        raise nothing_at(path)
    return published


def nothing_at(path: Path) -> InputError:
    """What to say where a path is no file, run or published name."""
    if path.is_dir():
        return InputError(f"{path} holds no run; name the folder of one, as runs/biped/seed0")
    if str(path) in EXPERIMENTS:
        return InputError(f"{path} is an experiment; name one of its runs, as {path}/seed0")
    return InputError(
        f"there is no {path}; name a file, the folder of a run or, as biped/seed0, one that "
        "`designrl checkpoints` lists"
    )


def find_run(name: str | Path) -> Path:
    """The run or recording that is meant: itself, or in a clone the published run of that name.

    Raises:
        InputError: there is nothing of that name, or a published run, which an installation does
            not have.
    """
    path, published = Path(name), PRETRAINED.parent / "logs" / name
    if path.exists():
        return path
    if not NAME.fullmatch(str(path)):
        raise nothing_at(path)
    if published.is_dir():
        return published
    if (PRETRAINED / f"{path}.safetensors").is_file():
        raise InputError(f"the recordings of {name} are in designrl's repository alone, in logs")
    raise nothing_at(path)


def load(name: str | Path, experiment: str | None = None) -> Agent:
    """An agent by its name or file.

    Args:
        name: what `find` takes, or a `.json` file of the 2018 repositories.
        experiment: needed for the latter; otherwise what it must be of, if anything.

    Raises:
        InputError: missing, damaged, of another experiment, or with numbers that are not finite.
    """
    path = find(name)
    if path.suffix != ".json":
        agent = checkpoint.load(path, experiment)
    elif experiment is None:
        raise InputError(
            f"{path} does not say what it was trained for; give designrl.load the name of its "
            "experiment, too"
        )
    else:
        agent = load_author(path, get_experiment(experiment))
    agent.file, agent.sha256 = path.absolute(), file_hash(path)
    return agent


def agent_of(agent: Agent | str | Path) -> Agent:
    """An agent, or what `load` takes, as one.

    Raises:
        InputError: neither, or as `load`.
    """
    if isinstance(agent, str | Path):
        agent = load(agent)
    if not isinstance(agent, Agent):
        raise InputError(f"the agent is {agent!r}; give one from designrl.load, or its file")
    return agent


def our_agents() -> dict[str, dict]:
    """Names of our published agents -> what the index says of each; see `reproduce.publish`.

    Raises:
        InputError: they are not beside the package.
    """
    path = PRETRAINED / "index.json"
    if not path.is_file():
        raise InputError(
            "the published agents are not installed with the package; get designrl's repository "
            "and look into its folder pretrained"
        )
    return json.loads(path.read_text(encoding="utf-8"))
