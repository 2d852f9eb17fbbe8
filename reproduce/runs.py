"""What the recordings of our published runs say: how they learned and what that cost."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from designrl.errors import InputError
from designrl.recording import Recording, read
from reproduce import scores

SOLVED = 300  # points, for the walkers


def recordings(experiment: str) -> list[Path]:
    """The recordings of our runs of an experiment, by seed."""
    return sorted((scores.ROOT / "logs" / experiment).glob("seed*/generations.mcap"))


def recording_of(checkpoint: Path) -> Path:
    """The recording of the run that one of our checkpoints is of."""
    return scores.ROOT / "logs" / checkpoint.parent.name / checkpoint.stem / "generations.mcap"


@dataclass(frozen=True)
class Run:
    """A recorded run.

    Attributes:
        host: the machine, in words.
        generation, steps, seconds: (G,) of each generation; environment steps and s of wall time
            from the run's start to its end.
        cpu_seconds: (G,) s of processor time, likewise; None where it was not recorded.
        mean, sd: (G,) points, over the population, with training's changes of the reward.
        tested: (E,) which generations were evaluated, as indices into the others.
        scores: (E,) points, mean over each evaluation's episodes.
        episodes: of an evaluation, as text: "200", or "200–1000" where that changed.
    """

    host: str
    generation: np.ndarray
    steps: np.ndarray
    seconds: np.ndarray
    cpu_seconds: np.ndarray | None
    mean: np.ndarray
    sd: np.ndarray
    tested: np.ndarray
    scores: np.ndarray
    episodes: str

    @property
    def core_hours(self) -> np.ndarray:
        """(G,) hours of processor time; NaN where it was not recorded."""
        if self.cpu_seconds is None:
            return np.full(len(self.seconds), np.nan)
        return self.cpu_seconds / 3600

    def solved_at(self) -> int | None:
        """Index of the generation before the first evaluation of SOLVED; None without one."""
        reached = self.tested[self.scores >= SOLVED]
        return int(reached[0]) if len(reached) else None


def cpu_seconds(recording: Recording) -> np.ndarray | None:
    """(G,) s of processor time up to each generation; None where it was not recorded."""
    try:
        found = recording.array("/summary", "cpu_seconds")
    except InputError:  # no such field
        return None
    return found if found.any() else None


def read_run(path: Path) -> Run:
    """The run in a recording.

    Raises:
        InputError: it cannot be read or holds no generation.
    """
    recording = read(path)
    if len(recording.generations) == 0:
        raise InputError(f"{path} holds no generation; train further")
    steps, seconds, mean, sd = (
        recording.array("/summary", name) for name in ("total_steps", "seconds", "mean", "sd")
    )
    tested, means, counts = np.empty(0, np.uint32), np.empty(0), {0}
    if recording.topics.get("/evaluation"):
        tested, means = (recording.array("/evaluation", name) for name in ("generation", "mean"))
        counts = {len(row) for row in recording.array("/evaluation", "scores")}
    return Run(
        recording.metadata.get("host", "an unknown machine"),
        recording.generations,
        steps,
        seconds,
        cpu_seconds(recording),
        mean,
        sd,
        np.searchsorted(recording.generations, tested).clip(max=len(mean) - 1),
        means,
        "–".join(map(str, sorted({min(counts), max(counts)}))),
    )
