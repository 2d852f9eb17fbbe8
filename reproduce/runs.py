"""What the recordings of our published runs say: how they learned and what that cost."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from designrl.errors import InputError
from designrl.policy import Agent
from designrl.recording import read
from designrl.recording.mcap_file import RESUMED
from reproduce.paths import at_papers_settings, seed_of

SOLVED = 300.0  # points, for the walkers


@dataclass(frozen=True)
class Run:
    """A recorded run.

    Attributes:
        seed: of the run.
        papers: it has the paper's own settings.
        host: the machine that it ran or began on, in words, with the preposition.
        generation: (G,) the recorded ones.
        steps, hours, core_hours: (G,) environment steps, wall time and processor time from the
            run's start to a generation's end.
        mean, sd: (G,) points, mean and standard deviation over the population, with training's
            changes of the reward.
        tested: (E,) the evaluated generations; a thinned recording need not hold them.
        scores: (E,) points, mean over each evaluation's episodes.
    """

    seed: int
    papers: bool
    host: str
    generation: np.ndarray
    steps: np.ndarray
    hours: np.ndarray
    core_hours: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    tested: np.ndarray
    scores: np.ndarray

    def steps_with(self, agent: Agent) -> int:
        """Environment steps of the run, of which `agent` is the kept one.

        The record of a last generation does not count the evaluation after it; its agent's does.
        """
        return max(int(self.steps[-1]), agent.metadata.get("environment_steps", 0))

    def solved_at(self) -> int | None:
        """The first generation, from 0, whose evaluation reached SOLVED; None without one."""
        reached = self.tested[self.scores >= SOLVED]
        return int(reached[0]) if len(reached) else None


def read_published(path: Path) -> Run:
    """The run in the recording of a published run.

    Raises:
        InputError: as `read_run`; it is of another experiment or seed than its folders say.
    """
    return read_run(path, path.parent.parent.name, seed_of(path.parent.name))


def read_run(path: Path, experiment: str, seed: int) -> Run:
    """The run in a recording.

    Raises:
        InputError: it cannot be read, holds no generation, or is of another experiment or seed.
    """
    recording = read(path)
    found = [recording.metadata.get(name) for name in ("experiment", "seed")]
    if found != [experiment, str(seed)]:
        raise InputError(
            f"{path} is of {found[0]}, seed {found[1]}, not of {experiment}, seed {seed}; put back "
            "the one of that run"
        )
    generation = recording.generations
    if len(generation) == 0:
        raise InputError(f"{path} holds no generation; train further")
    names = ("total_steps", "seconds", "cpu_seconds", "mean", "sd")
    steps, seconds, cpu_seconds, mean, sd = (recording.array("/summary", name) for name in names)
    tested, means = np.empty(0, np.uint32), np.empty(0)
    host = recording.metadata.get("host", "an unknown machine")
    resumed = any(name.startswith(RESUMED) for name, _ in recording.metadata_records)
    if recording.topics.get("/evaluation"):
        tested, means = (recording.array("/evaluation", name) for name in ("generation", "mean"))
    return Run(
        seed=seed,
        papers=at_papers_settings(path.parent),
        host=f"begun on {host}" if resumed else f"on {host}",
        generation=generation,
        steps=steps,
        hours=seconds / 3600,
        core_hours=cpu_seconds / 3600,
        mean=mean,
        sd=sd,
        tested=tested,
        scores=means,
    )
