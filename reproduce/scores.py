"""Scores of our checkpoints and of the author's, each computed once and kept.

A score is kept in .cache/scores under a name made of all that it depends on: the file's hash, the
experiment, seed, episodes, and the versions of the code and of its libraries.
"""

import hashlib
import json
import os
import sys
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from designrl.checkpoint import load
from designrl.errors import InputError
from designrl.evaluation import evaluate
from designrl.experiments import EXPERIMENTS
from designrl.files import file_hash, write_atomically
from designrl.policy import Agent
from designrl.provenance import versions
from designrl.published import file_name, published_runs

ROOT = Path(__file__).resolve().parents[1]
EPISODES = 100  # as the paper's tables
SEED = 0


@dataclass(frozen=True)
class Score:
    """What one checkpoint scored, or why it could not be scored.

    Attributes:
        path: the checkpoint.
        sha256: of the file; empty where it could not be read.
        agent: None where the file cannot be used.
        returns: (E,) float64 of the episodes; None where none were asked for.
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

    @property
    def run(self) -> str:
        """How tables call one of our runs: its file's name, "seed 0" for instance."""
        return self.path.stem.replace("seed", "seed ")


def title(experiment: str) -> str:
    """An experiment as Table 3 names it, "(a) Ant" for instance."""
    return f"({EXPERIMENTS[experiment].letter}) {EXPERIMENTS[experiment].title}"


def rewards_small_legs(experiment: str) -> bool:
    """Whether an experiment's rewards are scaled by the leg area, in evaluations, too."""
    return "leg_area_reward" in EXPERIMENTS[experiment].training_kwargs


def used_versions() -> dict[str, str]:
    """Versions of this package and of the libraries that a score depends on."""
    names = ("designrl", "box2d-py", "gymnasium", "numpy", "pybullet")
    return {name: versions()[name] for name in names}


def scoring_note() -> str:
    """How scores were made, with versions."""
    used = ", ".join(f"{name} {version}" for name, version in used_versions().items())
    how = f"{EPISODES} episodes, evaluation seed {SEED}"
    return f"Scored on the reference environments, {how}; {used}."


def paper() -> dict:
    """The paper's printed numbers."""
    return tomllib.loads((ROOT / "paper" / "paper.toml").read_text(encoding="utf-8"))


def shown(path: Path) -> str:
    """A path as a reader of the repository would write it."""
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else path.name


def load_design(path: Path, experiment: str) -> Score:
    """A checkpoint with its design but without scores; a `problem` where it cannot be used."""
    try:
        agent = load(path, experiment)
    except InputError as error:
        return Score(path, problem=str(error).replace(str(path), shown(path)))
    return Score(path, file_hash(path), agent)


def score(path: Path, experiment: str) -> Score:
    """The scores of a checkpoint, from the cache or from the reference environment.

    A checkpoint that cannot be used gives a Score with a `problem`; the rest goes on.
    """
    s = load_design(path, experiment)
    if s.problem:
        return s
    key = json.dumps([s.sha256, experiment, EPISODES, SEED, versions()])
    name = hashlib.sha256(key.encode()).hexdigest()[:32]
    kept = ROOT / ".cache" / "scores" / f"{name}.json"
    try:
        returns = np.array(json.loads(kept.read_text())["returns"], dtype=np.float64)
        if returns.shape == (EPISODES,):
            return replace(s, returns=returns)
    except (OSError, ValueError, KeyError, TypeError):
        pass  # a missing or damaged entry is computed
    with tqdm(total=EPISODES, desc=shown(path), unit="episode", leave=False, disable=None) as bar:
        workers = len(os.sched_getaffinity(0))
        returns = evaluate(s.agent, EPISODES, SEED, workers, "reference", bar.update).scores
    write_atomically(kept, json.dumps({"key": key, "returns": returns.tolist()}).encode())
    return replace(s, returns=returns)


def usable(found: Iterable[Score]) -> list[Score]:
    """Those that could be scored."""
    return [s for s in found if not s.problem]


# ------------------------------------------------------------------------ which runs there are


def pretrained(experiment: str) -> list[Path]:
    """Our checkpoints of an experiment, by seed."""
    found = (ROOT / "pretrained" / experiment).glob("*.safetensors")
    return sorted(found, key=lambda path: (len(path.name), path.name))


def zoo() -> str | None:
    """The folder that `make ... ZOO=path` names; ends the program where it has no known file."""
    folder = os.environ.get("ZOO")
    if folder and not any(published_runs(folder, name) for name in EXPERIMENTS):
        sys.exit(
            f"ZOO={folder} is not a folder of the author's weights: looked in it and in its "
            f"folders zoo and */zoo for {', '.join(map(file_name, EXPERIMENTS))}"
        )
    return folder or None


def authors(experiment: str) -> dict[int, Path]:
    """The author's runs of an experiment, by number; a missing run 1 by its name. Needs ZOO."""
    return {1: Path(file_name(experiment))} | published_runs(zoo(), experiment)


def by_source(experiment: str) -> dict[str, dict[int, Score]]:
    """Our runs, numbered from 1, as "ours"; with ZOO also the "author's weights"."""
    found = {"ours": dict(enumerate(pretrained(experiment), 1))}
    if zoo():
        found["author's weights"] = authors(experiment)
    return {
        source: {run: score(path, experiment) for run, path in paths.items()}
        for source, paths in found.items()
    }


def by_label(experiment: str, read: Callable[[Path, str], Score] = score) -> dict[str, Score]:
    """Our runs, "ours, seed 0" for instance, and with ZOO the author's run 1; read by `read`."""
    ours = [read(path, experiment) for path in pretrained(experiment)]
    found = {f"ours, {s.run}": s for s in ours}
    if zoo():
        found["author's weights"] = read(authors(experiment)[1], experiment)
    return found


def representative(experiment: str, rank: int = 0) -> Score | None:
    """The run that a figure shows: our best (rank 0) or next best one; None where there is none.

    With ZOO: the author's run 1, or for rank 1 the run 9 of the paper's Figure 7.
    """
    paths = pretrained(experiment)
    if zoo():
        paths, rank = [p for run, p in authors(experiment).items() if run == (1, 9)[rank]], 0
    found = sorted(usable(score(path, experiment) for path in paths), key=lambda s: -s.mean)
    return found[rank] if len(found) > rank else None


def output_folder() -> Path:
    """paper/, or paper/with-zoo/ (not committed) where ZOO adds the author's weights."""
    return ROOT / "paper" / ("with-zoo" if zoo() else "")


def read_for(*names: str) -> list[Path]:
    """All files that scores of these experiments depend on: the paper's, ours, the author's."""
    theirs = [path for name in names if zoo() for path in published_runs(zoo(), name).values()]
    ours = [path for name in names for path in pretrained(name)]
    return [ROOT / "paper" / "paper.toml", *ours, *theirs]
