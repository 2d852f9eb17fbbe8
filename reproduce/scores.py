"""Scores of our checkpoints and of the author's, each computed once and kept.

The engines play the episodes and the reference environments some of them again; a difference ends
the program. Where it is asked for, the reference plays them all. A score is kept in .cache/scores
under a name made of all that it depends on: the file's hash, the experiment, seed, episodes,
backend, and the versions of the code and of its libraries. What is not as it was kept is played
again.
"""

import hashlib
import json
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from designrl.errors import InputError, remark
from designrl.evaluation import episode_seeds, evaluate
from designrl.files import write_atomically
from designrl.names import load
from designrl.policy import Agent
from designrl.provenance import core_count, sources_hash, versions
from designrl.simulation import Simulator
from designrl.workers import ProcessWorkers
from reproduce import paths
from reproduce.paths import EIGHT, seed_of, shown

EPISODES = 100  # as the paper's tables
SEED = 0
MISSING = "no checkpoint yet"  # in place of a score
ON_REFERENCE = slice(0, None, 20)  # of the episodes, those that the reference plays, too
AT_ONCE = 8  # agents that are played before their scores are compared and kept
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
        """How tables call a run, ours "seed 0" for instance, the author's "run 1"."""
        if paths.is_authors(self.path):
            number = self.path.stem.rpartition(".")[2]
            return f"run {number if number.isdigit() else 1}"
        settings = "the paper's settings, " * paths.at_papers_settings(self.path)
        limits = "a blooper, " * paths.is_blooper(self.path)
        return f"{settings}{limits}seed {seed_of(self.path.stem)}"


def title(experiment: str) -> str:
    """An experiment as Table 3 names it, "(a) Ant" for instance."""
    return f"({EIGHT[experiment].letter}) {EIGHT[experiment].title}"


def rewards_small_legs(experiment: str) -> bool:
    """Whether training and a run's own evaluations scale its rewards by leg area; scores do not."""
    return "leg_area_reward" in EIGHT[experiment].training_kwargs


def used_versions() -> dict[str, str]:
    """Versions of this package and of the libraries that a score depends on."""
    names = ("designrl", "box2d-py", "box2d", "gymnasium", "numpy", "pybullet")
    found = versions()  # of Box2D one package or the other
    return {name: found[name] for name in names if name in found}


def scoring_note(backend: str) -> str:
    """How scores were made, with versions."""
    used = ", ".join(f"{name} {version}" for name, version in used_versions().items())
    how = f"{EPISODES} episodes, evaluation seed {SEED}"
    where = "reference environments"
    if backend == "engine":
        again = len(range(EPISODES)[ON_REFERENCE])
        where = f"engines; {again} of each {EPISODES} episodes on the reference, too, to the bit"
    return f"Scored on the {where}; {how}; {used}."


def unscored(path: Path, experiment: str) -> Score:
    """A checkpoint without scores; a `problem` where it cannot be used."""
    try:
        agent = load(path, experiment)
        seed = agent.metadata.get("seed")
        if not paths.is_authors(path) and seed != seed_of(path.stem):
            raise InputError(f"{path} is of seed {seed}; put back the one of its name")
    except InputError as error:
        return Score(path, problem=str(error).replace(str(path), shown(path)))
    return Score(path, agent.sha256, agent)


def score(path: Path, experiment: str, backend: str = "engine") -> Score:
    """The scores of one checkpoint; see `score_all`."""
    return score_all([(path, experiment)], backend)[0]


def score_all(files: list[tuple[Path, str]], backend: str = "engine") -> list[Score]:
    """The scores of checkpoints of experiments, from the cache or played on that backend.

    A checkpoint that cannot be used gives a Score with a `problem`; the rest goes on.

    Raises:
        InputError: engine and reference differ.
    """
    found = [unscored(path, experiment) for path, experiment in files]
    missing = []
    for i, s in enumerate(found):
        if not s.problem:
            found[i] = replace(s, returns=kept(s, backend))
            if found[i].returns is None:
                missing.append(i)
    if not missing:
        return found
    cores = core_count()
    with (
        tqdm(total=len(missing) * EPISODES, unit="episode", leave=False, disable=None) as bar,
        closing(ProcessWorkers(min(cores, len(missing)))) as workers,
    ):
        if bar.disable and len(missing) > AT_ONCE:
            remark(f"playing {EPISODES} episodes of each of {len(missing)} agents, some minutes")
        for first in range(0, len(missing), AT_ONCE):
            part = missing[first : first + AT_ONCE]
            for i in part:
                bar.set_postfix_str(shown(found[i].path))
                result = evaluate(found[i].agent, EPISODES, SEED, cores, backend, bar.update)
                found[i] = replace(found[i], returns=result.scores, backend=result.backend)
                if result.backend != "engine":
                    keep(found[i], backend)  # at once: the reference is slow
            of_engine = [found[i] for i in part if found[i].backend == "engine"]
            compare_with_reference(of_engine, workers)
            for s in of_engine:
                keep(s, backend)
    return found


def keep(s: Score, backend: str) -> None:
    """Keep the scores of a checkpoint, under all that they depend on and with a digest of both."""
    about, returns = depends_on(s, backend), s.returns.tolist()
    content = {"about": about, "returns": returns, "sha256": digest([about, returns])}
    write_atomically(kept_at(about), json.dumps(content).encode())


def kept(s: Score, backend: str) -> np.ndarray | None:
    """The kept scores of a checkpoint; None where there are none, or they are not what was kept."""
    about = depends_on(s, backend)
    path = kept_at(about)
    if not path.exists():
        return None
    try:
        content = json.loads(path.read_text())
        if content["sha256"] == digest([about, content["returns"]]):
            return np.array(content["returns"], dtype=np.float64)
    except (OSError, ValueError, KeyError, TypeError):
        pass
    remark(f"{shown(path)} is not what was kept there; {shown(s.path)} is played again")
    return None


def depends_on(s: Score, backend: str) -> list:
    """All that the scores of a checkpoint depend on."""
    about = [s.sha256, s.agent.experiment.name, EPISODES, SEED, backend]
    return [*about, used_versions(), sources_hash()]


def kept_at(about: list) -> Path:
    """Where scores are kept that depend on this."""
    return paths.ROOT / ".cache" / "scores" / f"{digest(about)[:32]}.json"


def digest(value: list) -> str:
    """SHA-256 of a value of JSON."""
    return hashlib.sha256(json.dumps(value).encode()).hexdigest()


def compare_with_reference(played: list[Score], workers: ProcessWorkers) -> None:
    """Play some of each checkpoint's episodes on the reference, and compare.

    Raises:
        InputError: a return differs.
    """
    tasks = [(i,) for i in range(len(played))]
    agents = [s.agent for s in played]
    for i, returns in workers.run(on_reference, agents, tasks, REFERENCE_SECONDS):
        ours = played[i].returns[ON_REFERENCE]
        for at in np.flatnonzero(ours != returns):
            raise InputError(
                f"{shown(played[i].path)}: episode {range(EPISODES)[ON_REFERENCE][at]} of "
                f"evaluation seed {SEED} has {ours[at]!r} on the engine and {returns[at]!r} on "
                "the reference; score with BACKEND=reference, and report it"
            )


def on_reference(agent: Agent) -> np.ndarray:
    """The returns of some episodes of an agent in the reference environment."""
    about = agent.experiment, "reference", agent.network
    with Simulator(*about, space=agent.space) as simulator:
        seeds = episode_seeds(SEED, EPISODES)[ON_REFERENCE]
        return simulator.rollout(agent.parameters[None], seeds[None]).returns[0]


def usable(found: Iterable[Score]) -> list[Score]:
    """Those that could be scored."""
    return [s for s in found if not s.problem]
