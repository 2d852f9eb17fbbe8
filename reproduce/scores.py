"""Scores of our checkpoints and of the author's, each computed once and kept.

A score is kept in .cache/scores under a name made of all that it depends on: the file's hash, the
experiment, seed, episodes, the hash of the scoring sources and the libraries' versions.
"""

import hashlib
import json
import os
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from designrl.checkpoint import file_hash, load, versions, write_atomically
from designrl.errors import InputError
from designrl.evaluation import evaluate
from designrl.experiments import EXPERIMENTS
from designrl.policy import Agent

ROOT = Path(__file__).resolve().parents[1]
CACHE = ROOT / ".cache" / "scores"
EPISODES = 100  # as the paper's tables
SEED = 0
# What a score can change with; the other libraries only read and write files.
LIBRARIES = ("sources", "box2d-py", "gymnasium", "numpy", "pybullet")

# The author's representative run of each experiment, by its file's name in the 2018 repositories.
PUBLISHED_FILES = {
    "ant": "robo_ant.json",
    "ant-morphology": "augment_ant.json",
    "biped": "biped.json",
    "biped-morphology": "augmentbiped.json",
    "biped-morphology-smaller-leg": "augmentbipedsmalllegs.json",
    "biped-hardcore": "bipedhard.json",
    "biped-hardcore-morphology": "augmentbipedhard.json",
    "biped-hardcore-morphology-smaller-leg": "augmentbipedhardsmalllegs.json",
}


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


def paper() -> dict:
    """The paper's printed numbers."""
    return tomllib.loads((ROOT / "paper" / "paper.toml").read_text(encoding="utf-8"))


def pretrained(experiment: str) -> list[Path]:
    """Our checkpoints of an experiment, by seed."""
    return sorted((ROOT / "pretrained" / experiment).glob("*.safetensors"))


def published(zoo: str | Path, experiment: str) -> Path:
    """The author's file of an experiment in a clone of the 2018 repositories (or its zoo folder).

    Raises:
        InputError: it is not there; the message says what was looked for.
    """
    name = PUBLISHED_FILES[experiment]
    for folder in (Path(zoo), Path(zoo) / "zoo"):
        if (folder / name).is_file():
            return folder / name
    raise InputError(f"{zoo} has no {name}, nor has its folder zoo; name the 2018 zoo folder")


def score(path: Path, experiment: str, episodes: int = EPISODES, seed: int = SEED) -> Score:
    """The scores of a checkpoint, from the cache or from the reference environment.

    A checkpoint that cannot be used gives a Score with a `problem`; the rest goes on.
    """
    try:
        agent = load(path, experiment)
    except InputError as error:
        return Score(path, problem=str(error))
    sha256 = file_hash(path)
    key = json.dumps([sha256, experiment, episodes, seed, [versions()[name] for name in LIBRARIES]])
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


def pretrained_scores() -> dict[str, list[Score]]:
    """Scores of all our checkpoints, by experiment."""
    return {name: [score(path, name) for path in pretrained(name)] for name in EXPERIMENTS}


def published_scores(zoo: str | Path) -> dict[str, Score]:
    """Scores of the author's representative runs, by experiment; missing files are named."""
    found = {}
    for name in EXPERIMENTS:
        try:
            found[name] = score(published(zoo, name), name)
        except InputError as error:
            print(error, file=sys.stderr)
            found[name] = Score(Path(zoo) / PUBLISHED_FILES[name], problem=str(error))
    return found


def zoo_argument() -> str | None:
    """The folder that `make ... ZOO=path` names."""
    return os.environ.get("ZOO") or None
