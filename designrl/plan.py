"""What a training run would take, before it is started: episodes, steps, time, disk."""

import math
import shutil
import tempfile
import time
from datetime import timedelta
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
from tqdm import tqdm

from designrl.errors import InputError, printable
from designrl.policy import Agent
from designrl.recording import read, record_rollout
from designrl.train import TrainingRun

CALIBRATION_SECONDS = 3.0  # of simulation, after the workers have started


def dry_run(run: TrainingRun) -> None:
    """Measure for some seconds what is left to do of a run, and print it; starts nothing.

    Raises:
        InputError: the run's recordings will be larger than what is free on their disk, or the
            environment sets no limit to an episode.
    """
    longest = gymnasium.spec(run.experiment.env_id).max_episode_steps
    if longest is None:
        raise InputError(
            f"{run.experiment.env_id} sets no limit to an episode, so what a run would take cannot "
            "be said; register it with max_episode_steps, or train without --dry-run"
        )
    settings, first, end = run.settings, run.progress.generation, run.settings.generations
    generation = settings.population * settings.rollouts
    evaluation = settings.evaluation_episodes or generation
    evaluations = math.ceil(end / settings.evaluate_every) - first // settings.evaluate_every
    training_episodes = (end - first) * generation
    episodes = training_episodes + evaluations * evaluation

    backend, speed, shortest = _simulation_speed(run)
    low, high = episodes * shortest, episodes * longest
    generation_bytes, rollout_bytes = recorded_bytes(run, longest)
    recording = generation_bytes * (end - first)
    disk = recording + evaluations * rollout_bytes
    existing = next(p for p in (run.out.absolute(), *run.out.absolute().parents) if p.exists())
    free = shutil.disk_usage(existing).free

    size = partial(tqdm.format_sizeof, suffix="B")
    chosen = {k: v for k, v in settings.as_dict().items() if v is not None and k != "experiment"}
    where = f"on Ray ({run.ray})" if run.ray else f"with --workers {run.workers}"
    print(
        f"{run.experiment.name}, in {printable(str(run.out))}; nothing was started\n"
        f"  settings  {', '.join(f'{k} {v}' for k, v in chosen.items())}\n"
        f"  to do     {end - first:,} generations, {training_episodes:,} episodes in training and "
        f"{evaluations * evaluation:,} in evaluations\n"
        f"  speed     {speed:,.0f} steps/s {where}, {backend} backend\n"
        f"  steps     {low:,.0f} if episodes stay as short as at the start ({shortest:.0f} steps), "
        f"{high:,} if all last {longest}\n"
        f"  time      {timedelta(seconds=round(low / speed))} to "
        f"{timedelta(seconds=round(high / speed))} (h:min:s)\n"
        f"  disk      {size(disk)} at most, {size(recording)} of it for generations.mcap (a "
        f"resume needs that once more, for a moment); {size(free)} are free"
    )
    if disk > free:
        raise InputError(
            f"the recordings in {run.out} will take {size(disk)} and {size(free)} are free; free "
            "some space, or choose another place with --out or fewer --generations"
        )


def _simulation_speed(run: TrainingRun) -> tuple[str, float, float]:
    """Backend, steps per second, and steps per episode of the first candidates."""
    candidates = run.candidates()
    episodes = steps = 0
    with run.simulator() as simulator:
        simulator.rollout(candidates[:2], np.zeros((2, 1), dtype=int))  # starts the workers
        count = max(run.workers, simulator.processes)
        start = time.perf_counter()
        while time.perf_counter() - start < CALIBRATION_SECONDS:
            seeds = np.arange(episodes, episodes + count)[:, None]
            began = time.perf_counter()
            found = simulator.rollout(candidates[seeds[:, 0] % len(candidates)], seeds).steps
            speed = found.sum() / (time.perf_counter() - began)
            episodes, steps = episodes + count, steps + int(found.sum())
            count *= 2  # a slow simulator gets few, a fast one as many as show its speed
    return simulator.backend, speed, steps / episodes


def recorded_bytes(run: TrainingRun, longest: int) -> tuple[float, float]:
    """Bytes of a generation in `generations.mcap`, and of a rollout that lasts so many steps."""
    # μ and σ in float32; some 15 bytes for an episode's return, length and seed, once compressed.
    episodes = run.settings.population * run.settings.rollouts
    generation = 8 * run.experiment.num_parameters + 15 * episodes + 2000
    with tempfile.TemporaryDirectory(prefix="designrl-") as folder:
        path = Path(folder) / "rollout.mcap"
        agent = Agent(run.experiment, run.candidates()[0], space=run.settings.space)
        record_rollout(agent, path, 0)
        return generation, path.stat().st_size / read(path).topics["/reward"] * longest
