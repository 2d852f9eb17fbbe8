"""What a training run would take, before it is started: episodes, steps, time, disk."""

import shutil
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import gymnasium
import numpy as np

from designrl.errors import InputError
from designrl.policy import Agent
from designrl.recording import RunWriter, read, record_rollout
from designrl.train import TrainingRun

CALIBRATION_SECONDS = 3.0  # of simulation, after the workers have started
_SAMPLE_GENERATIONS = 3  # recorded to see what one takes


@dataclass(frozen=True)
class Plan:
    """What is left to do of a run, and what that takes.

    Attributes:
        generations: still to do.
        training_episodes, evaluation_episodes: in all of them.
        backend: that runs here.
        steps_per_second: of all workers together, measured.
        steps_at_start, steps_at_most: length of an untrained agent's episodes, measured, and of
            those that last to the time limit.
        recording_bytes: of `generations.mcap`.
        rollouts, rollout_bytes: number of recorded rollouts, and of one that lasts to the limit.
        free_bytes: on the folder's disk.
    """

    generations: int
    training_episodes: int
    evaluation_episodes: int
    backend: str
    steps_per_second: float
    steps_at_start: float
    steps_at_most: int
    recording_bytes: int
    rollouts: int
    rollout_bytes: int
    free_bytes: int

    @property
    def episodes(self) -> int:
        return self.training_episodes + self.evaluation_episodes

    @property
    def steps(self) -> tuple[float, int]:
        """Environment steps if episodes stay as short as at the start, and if all are longest."""
        return self.episodes * self.steps_at_start, self.episodes * self.steps_at_most

    @property
    def disk_bytes(self) -> int:
        return self.recording_bytes + self.rollouts * self.rollout_bytes


def plan(run: TrainingRun) -> Plan:
    """Measure for some seconds what a run would take; leaves its folder as it is."""
    settings, first = run.settings, run.progress.generation
    episodes = settings.population * settings.rollouts
    every, end = settings.evaluate_every, settings.generations
    evaluations = end // every - first // every + (first < end and end % every != 0)
    candidates = run.candidates()
    backend, speed, length = _simulation_speed(run, candidates)
    longest = gymnasium.spec(run.experiment.env_id).max_episode_steps
    with tempfile.TemporaryDirectory(prefix="designrl-") as folder:
        generation = _generation_bytes(run, Path(folder))
        rollout = _rollout_bytes(run, candidates[0], longest, Path(folder))
    existing = next(p for p in (run.out.absolute(), *run.out.absolute().parents) if p.exists())
    return Plan(
        generations=end - first,
        training_episodes=(end - first) * episodes,
        evaluation_episodes=evaluations * (settings.evaluation_episodes or episodes),
        backend=backend,
        steps_per_second=speed,
        steps_at_start=length,
        steps_at_most=longest,
        recording_bytes=round(generation * (end - first)),
        rollouts=evaluations,
        rollout_bytes=rollout,
        free_bytes=shutil.disk_usage(existing).free,
    )


def _simulation_speed(run: TrainingRun, candidates: np.ndarray) -> tuple[str, float, float]:
    """Backend, steps per second, and steps per episode of the first candidates."""
    episodes = steps = 0
    count = len(candidates)
    with run.simulator() as simulator:
        simulator.rollout(candidates[:2], np.zeros((2, 1), dtype=int))  # starts the workers
        start = time.perf_counter()
        while (seconds := time.perf_counter() - start) < CALIBRATION_SECONDS:
            seeds = np.arange(episodes, episodes + count)[:, None]
            steps += int(simulator.rollout(candidates, seeds).steps.sum())
            episodes += count
    return simulator.backend, steps / seconds, steps / episodes


def _generation_bytes(run: TrainingRun, folder: Path) -> float:
    """Bytes that a generation takes in `generations.mcap`."""
    rng = np.random.default_rng(0)
    shape = run.settings.population, run.settings.rollouts
    size = run.experiment.num_parameters
    path = folder / "generations.mcap"
    with RunWriter(path, {"experiment": run.experiment.name}) as writer:
        before = path.stat().st_size
        for index in range(_SAMPLE_GENERATIONS):
            writer.generation(
                index=index,
                mu=rng.standard_normal(size),
                sigma=rng.uniform(0.02, 0.1, size),
                returns=rng.normal(0, 300, shape),
                steps=rng.integers(1, 2000, shape),
                seeds=rng.integers(0, 2**32, shape),
                seconds=rng.random(),
                cpu_seconds=rng.random(),
                total_steps=2**40,
            )
    return (path.stat().st_size - before) / _SAMPLE_GENERATIONS


def _rollout_bytes(run: TrainingRun, parameters: np.ndarray, longest: int, folder: Path) -> int:
    """Bytes of a recorded rollout that lasts to the time limit."""
    path = folder / "rollout.mcap"
    record_rollout(Agent(run.experiment, parameters), path, 0)
    return round(path.stat().st_size / read(path).topics["/reward"] * longest)


def describe(run: TrainingRun, found: Plan) -> str:
    """A plan in lines of text."""
    settings = {k: v for k, v in run.settings.as_dict().items() if v is not None}
    settings.pop("experiment")
    workers = "1 worker" if run.workers == 1 else f"{run.workers} workers"
    where = f"on Ray ({run.ray})" if run.ray else f"with {workers}"
    low, high = found.steps
    speed = found.steps_per_second
    return "\n".join(
        [
            f"{run.experiment.name}, in {run.out}; nothing was started",
            "  settings  " + ", ".join(f"{k} {v}" for k, v in settings.items()),
            f"  to do     {found.generations:,} generations, {found.training_episodes:,} episodes "
            f"in training and {found.evaluation_episodes:,} in evaluations",
            f"  speed     {speed:,.0f} steps/s {where}, {found.backend} backend",
            f"  steps     {low:,.0f} if episodes stay as short as at the start "
            f"({found.steps_at_start:.0f} steps), {high:,} if all last {found.steps_at_most}",
            f"  time      {_duration(low / speed)} to {_duration(high / speed)}",
            f"  disk      {_size(found.disk_bytes)} at most, {_size(found.recording_bytes)} of it "
            "for generations.mcap (a resume needs that once more, for a moment); "
            f"{_size(found.free_bytes)} are free",
        ]
    )


def check_disk(run: TrainingRun, found: Plan) -> None:
    """Refuse what cannot fit.

    Raises:
        InputError: the run's recordings are larger than what is free.
    """
    if found.disk_bytes > found.free_bytes:
        raise InputError(
            f"the recordings in {run.out} will take {_size(found.disk_bytes)} and "
            f"{_size(found.free_bytes)} are free; free some space, or choose another place with "
            "--out or fewer --generations"
        )


def _size(count: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:,.3g} TB"


def _duration(seconds: float) -> str:
    for unit, limit, length in (("s", 120, 1), ("min", 7200, 60), ("h", 172_800, 3600)):
        if seconds < limit:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds / 86400:,.1f} days"
