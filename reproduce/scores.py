"""Scores of our checkpoints and of the author's, each computed once and kept.

A score is kept in .cache/scores under a name made of all that it depends on: the file's hash, the
experiment, seed, episodes, the hash of the reference's sources and the libraries' versions.
"""

import contextlib
import hashlib
import json
import os
import sys
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from tqdm import tqdm

import designrl
from designrl.checkpoint import load
from designrl.errors import InputError
from designrl.evaluation import evaluate
from designrl.experiments import EXPERIMENTS
from designrl.files import file_hash, write_atomically
from designrl.policy import Agent
from designrl.provenance import versions

ROOT = Path(__file__).resolve().parents[1]
CACHE = ROOT / ".cache" / "scores"
EPISODES = 100  # as the paper's tables
SEED = 0
# What a score can change with; the other libraries only read and write files, and the compiled
# engine, which must give the same returns, is not asked.
LIBRARIES = ("box2d-py", "gymnasium", "numpy", "pybullet")
SOURCES = ("design.py", "experiments.py", "policy.py", "envs", "simulation/reference.py")

# The author's runs by their names in the 2018 repositories (astool and estool): run 1 of each
# experiment lies in zoo/, runs 2 to 10 in zoo/more/ under these names with the run's number.
PUBLISHED_FILES = {
    "ant": ("robo_ant", "more/robo_ant/robo_ant"),
    "ant-morphology": ("augment_ant", "more/augmentant/augment_ant"),
    "biped": ("biped", "more/biped/biped"),
    "biped-morphology": ("augmentbiped", "more/augmentbiped/augmentbiped"),
    "biped-morphology-smaller-leg": (
        "augmentbipedsmalllegs",
        "more/augmentbipedsmall/augmentbipedsmall",
    ),
    "biped-hardcore": ("bipedhard", "more/bipedhard/bipedhard"),
    "biped-hardcore-morphology": (
        "augmentbipedhard",
        "more/augmentbipedhard/augmentbipedhard",
    ),
    "biped-hardcore-morphology-smaller-leg": (
        "augmentbipedhardsmalllegs",
        "more/augmentbipedhardsmall/augmentbipedhardsmalllegs",
    ),
}
PUBLISHED_RUNS = 10


@dataclass(frozen=True)
class Score:
    """What one checkpoint scored, or why it could not be scored.

    Attributes:
        path: the checkpoint.
        sha256: of the file; empty where it could not be read.
        agent: None where the file cannot be used.
        returns: (E,) float64 of the episodes.
        problem: one sentence, or empty.
    """

    path: Path
    sha256: str = ""
    agent: Agent | None = None
    returns: np.ndarray | None = None
    problem: str = ""

    @property
    def mean(self) -> float:
        """Average score over the episodes."""
        return float(self.returns.mean())

    @property
    def std(self) -> float:
        """Standard deviation over the episodes."""
        return float(self.returns.std())


@cache
def used_versions() -> dict[str, str]:
    """What a score depends on: our version, the hash of the reference's sources, the libraries."""
    package = Path(designrl.__file__).parent
    files = [f for name in SOURCES for f in [package / name, *(package / name).rglob("*.py")]]
    digest = hashlib.sha256()
    for file in sorted(file for file in files if file.is_file()):
        digest.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes())
    found = {name: versions()[name] for name in ("designrl", *LIBRARIES)}
    return {**found, "sources": digest.hexdigest()[:16]}


def paper() -> dict:
    """The paper's printed numbers."""
    return tomllib.loads((ROOT / "paper" / "paper.toml").read_text(encoding="utf-8"))


def pretrained(experiment: str) -> list[Path]:
    """Our checkpoints of an experiment, by seed."""
    found = (ROOT / "pretrained" / experiment).glob("*.safetensors")
    return sorted(found, key=lambda path: (len(path.name), path.name))


def log_of(checkpoint: Path) -> Path:
    """Where the run of one of our checkpoints is published."""
    return ROOT / "logs" / checkpoint.parent.name / checkpoint.stem


def published_name(experiment: str, run: int = 1) -> str:
    """The file of one of the author's runs, seen from a zoo folder."""
    first, more = PUBLISHED_FILES[experiment]
    return f"{first}.json" if run == 1 else f"{more}.{run}.json"


def published(zoo: str | Path, experiment: str, run: int = 1) -> Path:
    """The author's file of a run in a zoo folder of 2018, a clone with one, or a folder of clones.

    Raises:
        InputError: it is not there; the message says what was looked for.
    """
    name = published_name(experiment, run)
    for folder in (Path(zoo), Path(zoo) / "zoo", *sorted(Path(zoo).glob("*/zoo"))):
        if (folder / name).is_file():
            return folder / name
    raise InputError(
        f"{zoo} has no {name}, nor have its folders zoo and */zoo; name the 2018 zoo folder"
    )


def published_runs(zoo: str | Path, experiment: str) -> dict[int, Path]:
    """Those of the author's runs 1 to 10 that are there."""
    found = {}
    for run in range(1, PUBLISHED_RUNS + 1):
        with contextlib.suppress(InputError):
            found[run] = published(zoo, experiment, run)
    return found


def load_design(path: Path, experiment: str) -> Score:
    """A checkpoint with its design but without scores; a `problem` where it cannot be used."""
    try:
        return Score(path, file_hash(path), load(path, experiment))
    except InputError as error:
        return Score(path, problem=str(error).replace(str(path), shown(path)))


def score(path: Path, experiment: str, episodes: int = EPISODES, seed: int = SEED) -> Score:
    """The scores of a checkpoint, from the cache or from the reference environment.

    A checkpoint that cannot be used gives a Score with a `problem`; the rest goes on.
    """
    try:
        agent = load(path, experiment)
    except InputError as error:
        return Score(path, problem=str(error).replace(str(path), shown(path)))
    sha256 = file_hash(path)
    key = json.dumps([sha256, experiment, episodes, seed, used_versions()])
    kept = CACHE / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.json"
    if kept.exists():
        try:
            returns = np.array(json.loads(kept.read_text())["returns"], dtype=np.float64)
            if returns.shape == (episodes,):
                return Score(path, sha256, agent, returns)
        except (ValueError, KeyError, TypeError):
            pass  # a damaged entry is computed again
    with tqdm(total=episodes, desc=shown(path), unit="episode", leave=False, disable=None) as bar:
        workers = len(os.sched_getaffinity(0))
        returns = evaluate(agent, episodes, seed, workers, progress=bar.update).scores
    write_atomically(kept, json.dumps({"key": key, "returns": returns.tolist()}).encode())
    return Score(path, sha256, agent, returns)


def shown(path: Path) -> str:
    """A path as a reader of the repository would write it."""
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else path.name


def seed_of(path: Path) -> str:
    """How a table calls one of our runs: its file's name, seed0 for instance."""
    return path.stem.replace("seed", "seed ")


def pretrained_scores(names=EXPERIMENTS) -> dict[str, list[Score]]:
    """Scores of our checkpoints, by experiment."""
    return {name: [score(path, name) for path in pretrained(name)] for name in names}


def published_scores(zoo: str | None, names=EXPERIMENTS) -> dict[str, dict[int, Score]]:
    """Scores of the author's runs, by experiment and run; a missing run 1 is named.

    Empty without a zoo.
    """
    found: dict[str, dict[int, Score]] = {name: {} for name in names}
    for name in names if zoo else ():
        found[name] = {run: score(p, name) for run, p in published_runs(zoo, name).items()}
        if 1 not in found[name]:
            try:
                published(zoo, name)
            except InputError as error:
                problem = str(error)
            found[name] = {1: Score(Path(published_name(name)), problem=problem), **found[name]}
    return found


def zoo_argument() -> str | None:
    """The folder that `make ... ZOO=path` names; ends the program where it has no known file."""
    zoo = os.environ.get("ZOO")
    if not zoo:
        return None
    if not any(published_runs(zoo, name) for name in EXPERIMENTS):
        sys.exit(
            f"ZOO={zoo} is not a folder of the author's weights: looked in it and in its folders "
            f"zoo and */zoo for {', '.join(published_name(name) for name in EXPERIMENTS)}"
        )
    return zoo


def output_folder() -> Path:
    """paper/, or paper/with-zoo/ (not committed) where ZOO adds the author's weights."""
    return ROOT / "paper" / ("with-zoo" if zoo_argument() else "")


def read_for(*names: str) -> list[Path]:
    """All files that scores of these experiments depend on: the paper's, ours, the author's."""
    zoo = zoo_argument()
    return [
        ROOT / "paper" / "paper.toml",
        *(path for name in names for path in pretrained(name)),
        *(path for name in names if zoo for path in published_runs(zoo, name).values()),
    ]


def best_first(found: list[Score]) -> list[Score]:
    """The usable ones, by their mean score."""
    return sorted((s for s in found if not s.problem), key=lambda s: -s.mean)


def representative(experiment: str, rank: int = 0) -> Score | None:
    """The run that a figure shows: our best (rank 0) or next best one; None where there is none.

    With ZOO: the author's run 1, or for rank 1 the run 9 of the paper's Figure 7.
    """
    if zoo := zoo_argument():
        path = published_runs(zoo, experiment).get((1, 9)[rank])
        found = [score(path, experiment)] if path else []
        return next(iter(best_first(found)), None)
    found = best_first([score(path, experiment) for path in pretrained(experiment)])
    return found[rank] if len(found) > rank else None
