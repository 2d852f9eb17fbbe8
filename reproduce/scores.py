"""Scores of our checkpoints and of the author's, each computed once and kept.

The engines play the episodes and the reference environments some of them again; a difference ends
the program. With BACKEND=reference the reference plays them all. A score is kept in .cache/scores
under a name made of all that it depends on: the file's hash, the experiment, seed, episodes,
backend, and the versions of the code and of its libraries.
"""

import hashlib
import json
import os
import sys
import tomllib
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from designrl import author
from designrl.errors import InputError
from designrl.evaluation import episode_seeds, evaluate
from designrl.experiments import EXPERIMENTS
from designrl.files import file_hash, write_atomically
from designrl.names import load
from designrl.policy import Agent
from designrl.provenance import core_count, sources_hash, versions
from designrl.simulation import BACKENDS, Simulator
from designrl.workers import ProcessWorkers

ROOT = Path(__file__).resolve().parents[1]
EPISODES = 100  # as the paper's tables
SEED = 0
MISSING = "no checkpoint yet"  # in place of a score
OURS, AT_PAPERS = "ours", "ours, the paper's settings"  # sources of scores
ENOUGH = 5  # runs at the paper's settings, to be shown before the recipe's
ON_REFERENCE = slice(0, None, 20)  # of the episodes, those that the reference plays, too
REFERENCE_SECONDS = 600.0  # that these may take; they take a few


@dataclass(frozen=True)
class Score:
    """What one checkpoint scored, or why it could not be scored.

    Attributes:
        path: the checkpoint.
        sha256: of the file; empty where it could not be read.
        agent: None where the file cannot be used.
        returns: (E,) float64 of the episodes; None where none were asked for.
        backend: that played them, where they were played now.
        problem: one sentence, or empty.
    """

    path: Path
    sha256: str = ""
    agent: Agent | None = None
    returns: np.ndarray | None = None
    backend: str = ""
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
        """How tables call one of our runs, "seed 0" for instance."""
        return ("the paper's settings, " if papers(self.path) else "") + f"seed {seed(self.path)}"


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


def backend() -> str:
    """What plays the episodes: BACKEND, by default the engines."""
    name = os.environ.get("BACKEND") or "engine"
    if name not in BACKENDS:
        sys.exit(f"BACKEND={name}: it must be one of {', '.join(BACKENDS)}")
    return name


def scoring_note() -> str:
    """How scores were made, with versions."""
    used = ", ".join(f"{name} {version}" for name, version in used_versions().items())
    how = f"{EPISODES} episodes, evaluation seed {SEED}"
    where = "reference environments"
    if backend() == "engine":
        again = len(range(EPISODES)[ON_REFERENCE])
        where = f"engines; {again} of each {EPISODES} episodes on the reference, too, to the bit"
    return f"Scored on the {where}; {how}; {used}."


def paper() -> dict:
    """The paper's printed numbers."""
    return tomllib.loads((ROOT / "paper" / "paper.toml").read_text(encoding="utf-8"))


def shown(path: Path) -> str:
    """A path as a reader of the repository would write it."""
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else path.name


def unscored(path: Path, experiment: str) -> Score:
    """A checkpoint without scores; a `problem` where it cannot be used."""
    try:
        agent = load(path, experiment)
    except InputError as error:
        return Score(path, problem=str(error).replace(str(path), shown(path)))
    return Score(path, file_hash(path), agent)


def score(path: Path, experiment: str) -> Score:
    """The scores of one checkpoint; see `score_all`."""
    return score_all([(path, experiment)])[0]


def score_all(files: list[tuple[Path, str]]) -> list[Score]:
    """The scores of checkpoints of experiments, from the cache or played.

    A checkpoint that cannot be used gives a Score with a `problem`; the rest goes on.

    Raises:
        InputError: engine and reference differ.
    """
    found = [unscored(path, experiment) for path, experiment in files]
    missing = []
    for i, s in enumerate(found):
        if not s.problem:
            try:
                kept = json.loads(kept_at(s).read_text())
                found[i] = replace(s, returns=np.array(kept["returns"], dtype=np.float64))
            except (OSError, ValueError, KeyError, TypeError):
                missing.append(i)  # a missing or damaged entry is computed
    total = len(missing) * EPISODES
    with tqdm(total=total, unit="episode", leave=False, disable=None if missing else True) as bar:
        workers = core_count()
        for i in missing:
            bar.set_postfix_str(shown(found[i].path))
            result = evaluate(found[i].agent, EPISODES, SEED, workers, backend(), bar.update)
            found[i] = replace(found[i], returns=result.scores, backend=result.backend)
            if result.backend != "engine":
                keep(found[i])  # at once: the reference is slow
    of_engine = [found[i] for i in missing if found[i].backend == "engine"]
    compare_with_reference(of_engine)
    for s in of_engine:
        keep(s)
    return found


def keep(s: Score) -> None:
    """Keep the scores of a checkpoint."""
    content = {"sha256": s.sha256, "returns": s.returns.tolist()}
    write_atomically(kept_at(s), json.dumps(content).encode())


def kept_at(s: Score) -> Path:
    """Where the scores of a checkpoint are kept."""
    about = [s.sha256, s.agent.experiment.name, EPISODES, SEED, backend()]
    key = json.dumps([*about, versions(), sources_hash()])
    return ROOT / ".cache" / "scores" / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.json"


def compare_with_reference(played: list[Score]) -> None:
    """Play some of each checkpoint's episodes on the reference, and compare.

    Raises:
        InputError: a return differs.
    """
    tasks = [(i,) for i in range(len(played))]
    workers = ProcessWorkers(min(core_count(), len(played)))
    agents = [(s.agent.experiment.name, s.agent.network, s.agent.parameters) for s in played]
    with (
        closing(workers),
        tqdm(tasks, "on the reference, too", leave=False, disable=None if tasks else True) as bar,
    ):
        for i, returns in workers.run(on_reference, agents, tasks, REFERENCE_SECONDS):
            bar.update()
            ours = played[i].returns[ON_REFERENCE]
            for at in np.flatnonzero(ours != returns):
                raise InputError(
                    f"{shown(played[i].path)}: episode {range(EPISODES)[ON_REFERENCE][at]} of "
                    f"evaluation seed {SEED} has {ours[at]!r} on the engine and {returns[at]!r} on "
                    "the reference; score with BACKEND=reference, and report it"
                )


def on_reference(about: tuple) -> np.ndarray:
    """The returns of some episodes of an agent in the reference environment."""
    experiment, network, parameters = about
    with Simulator(experiment, "reference", network) as simulator:
        seeds = episode_seeds(SEED, EPISODES)[ON_REFERENCE]
        return simulator.rollout(parameters[None], seeds[None]).returns[0]


def usable(found: Iterable[Score]) -> list[Score]:
    """Those that could be scored."""
    return [s for s in found if not s.problem]


# ------------------------------------------------------------------------ which runs there are


def pretrained(experiment: str) -> list[Path]:
    """Our checkpoints of an experiment, by seed; those at the paper's settings last."""
    found = (ROOT / "pretrained" / experiment).glob("*seed*.safetensors")
    return sorted(found, key=lambda path: (papers(path), seed(path)))


def papers(path: Path) -> bool:
    """Whether a checkpoint, or the folder of a recording, is of a run at the paper's settings."""
    return path.name.startswith("paper-")


def seed(path: Path) -> int:
    """The seed of one of our runs, from the name of its file or folder."""
    return int(path.stem.rpartition("seed")[2])


def our_runs(experiment: str) -> dict[str, dict[int, Path]]:
    """Our checkpoints by source, OURS and AT_PAPERS, and number, which is seed + 1.

    First come the recipe's, or those at the paper's settings once they are ENOUGH.
    """
    found = {
        source: {seed(path) + 1: path for path in pretrained(experiment) if papers(path) == at}
        for source, at in ((OURS, False), (AT_PAPERS, True))
    }
    if len(found[AT_PAPERS]) >= ENOUGH:
        return {AT_PAPERS: found[AT_PAPERS], OURS: found[OURS]}
    return found


def zoo() -> str | None:
    """The folder that `make ... ZOO=path` names; ends the program where it has no known file."""
    folder = os.environ.get("ZOO")
    if folder and not any(author.runs(folder, name) for name in EXPERIMENTS):
        sys.exit(
            f"ZOO={folder} is not a folder of the author's weights: looked in it and in its "
            f"folders zoo and */zoo for {', '.join(map(author.file_name, EXPERIMENTS))}"
        )
    return folder or None


def authors(experiment: str) -> dict[int, Path]:
    """The author's runs of an experiment, by number; a missing run 1 by its name. Needs ZOO."""
    return {1: Path(author.file_name(experiment))} | author.runs(zoo(), experiment)


def by_source(*experiments: str) -> dict[str, dict[str, dict[int, Score]]]:
    """Of each experiment our runs as `our_runs` has them; with ZOO the "author's weights"."""
    paths = {name: our_runs(name) for name in experiments}
    if zoo():
        for name, sources in paths.items():
            sources["author's weights"] = authors(name)
    files = [
        (path, name)
        for name, sources in paths.items()
        for runs in sources.values()
        for path in runs.values()
    ]
    found = dict(zip(files, score_all(files), strict=True))
    return {
        name: {
            source: {run: found[path, name] for run, path in runs.items()}
            for source, runs in sources.items()
        }
        for name, sources in paths.items()
    }


def by_label(experiment: str, scored: bool = True) -> dict[str, Score]:
    """Our runs, "ours, seed 0" for instance, and with ZOO the author's run 1."""
    paths = pretrained(experiment) + ([authors(experiment)[1]] if zoo() else [])
    files = [(path, experiment) for path in paths]
    found = score_all(files) if scored else [unscored(*file) for file in files]
    ours = len(pretrained(experiment))
    labels = [f"ours, {s.run}" for s in found[:ours]] + ["author's weights"]
    return dict(zip(labels, found, strict=False))


def representative(experiment: str, rank: int = 0) -> Score | None:
    """The run that a figure shows: our best (rank 0) or next best one; None where there is none.

    With ZOO: the author's run 1, or for rank 1 the run 9 of the paper's Figure 7.
    """
    paths = pretrained(experiment)
    if zoo():
        paths, rank = [p for run, p in authors(experiment).items() if run == (1, 9)[rank]], 0
    found = usable(score_all([(path, experiment) for path in paths]))
    found.sort(key=lambda s: -s.mean)
    return found[rank] if len(found) > rank else None


def output_folder() -> Path:
    """paper/, or paper/with-zoo/ (not committed) where ZOO adds the author's weights."""
    return ROOT / "paper" / ("with-zoo" if zoo() else "")


def read_for(*names: str) -> list[Path]:
    """All files that scores of these experiments depend on: the paper's, ours, the author's."""
    theirs = [path for name in names if zoo() for path in author.runs(zoo(), name).values()]
    ours = [path for name in names for path in pretrained(name)]
    return [ROOT / "paper" / "paper.toml", *ours, *theirs]
