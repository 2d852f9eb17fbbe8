"""The training loop: ask, simulate, tell, record, evaluate, checkpoint; resumable.

A run's folder holds `best.safetensors` (the agent to evaluate), `state.safetensors` (all that a
resume needs), `generations.mcap` and `rollouts/*.mcap` (see `designrl.recording`). Everything
random is a function of the seed and the generation, so a run that was interrupted, or executed
elsewhere, ends with the same bytes in `best.safetensors` (on processors with AVX2, that is nearly
all since 2013: without it, PyTorch adds in another order).
"""

import dataclasses
import json
import math
import os
import platform
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import gymnasium
import numpy as np

from designrl.errors import InputError, optional

with optional("training", "train", "make setup-train"):
    import torch
    from tqdm import tqdm

from designrl import checkpoint
from designrl.experiments import EXPERIMENTS, Experiment, get_experiment
from designrl.names import find, load
from designrl.policy import Agent
from designrl.provenance import processor, sources_hash, versions
from designrl.recording import Generation, RunWriter, record_rollout
from designrl.recording.mcap_file import uninterrupted
from designrl.reinforce import Reinforce
from designrl.run_folder import Progress, RunFolder
from designrl.settings import TrainSettings
from designrl.simulation import CandidateError, Simulator

SAVE_SECONDS = 10.0  # between two saves of the state; a killed run repeats at most this much
CANDIDATE_DECIMALS = 4  # the author's code sends candidates to its workers in fixed point

# Spawn keys of the run's SeedSequence; `designrl.reinforce` has (generation, 0) for the samples.
_EPISODE_STREAM = 1
_EVALUATION_KEY = (2**31,)


class Optimiser(Protocol):
    """What the training loop asks of an optimiser; `Reinforce` is one."""

    def ask(self):
        """(N, P) candidates; the same state gives the same ones."""

    def tell(self, returns: np.ndarray) -> None:
        """Update with the candidates' (N,) returns."""

    def state(self) -> dict[str, np.ndarray]:
        """All that `restore` needs; "mu" and "sigma" (P,) are recorded as the distribution's."""

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on from a `state()`; InputError where it does not fit."""


def training_seeds(settings: TrainSettings, generation: int) -> np.ndarray:
    """(N, R) seeds of a generation; both candidates of a mirrored pair meet the same episodes."""
    times = 2 if settings.mirrored else 1
    shape = settings.population // times, settings.rollouts
    sequence = np.random.SeedSequence(settings.seed, spawn_key=(generation, _EPISODE_STREAM))
    state = sequence.generate_state(math.prod(shape))
    return np.tile(state.astype(np.int64).reshape(shape), (times, 1))


class TrainingRun:
    """One run in one folder; `run()` goes on from wherever the folder is.

    Args:
        settings: what decides the result.
        out: the run's folder.
        workers: processes or threads; they do not change the result.
        backend: "engine" or "reference".
        resume: go on with the run that the folder holds; only `generations` may be larger than
            before.
        ray: "local" or the address of a Ray cluster, to simulate there instead.
        optimiser: one of your own, for as many candidates as `settings.population`; by default
            `Reinforce` with the settings.
        on_generation: called with each `designrl.recording.Generation` when it is recorded. What
            it raises ends the run, saved, after that generation.

    Raises:
        InputError: the folder holds a run and `resume` is not set; or holds another run, or one
            with other settings, or is in use; the settings' `init` cannot be used.
    """

    def __init__(
        self,
        settings: TrainSettings,
        out: str | Path,
        workers: int = 1,
        backend: str = "engine",
        resume: bool = False,
        ray: str | None = None,
        optimiser: Optimiser | None = None,
        on_generation: Callable[[Generation], None] | None = None,
    ):
        if on_generation is not None and not callable(on_generation):
            raise InputError(f"on_generation is {on_generation!r}; it must be a function")
        self.settings = settings
        self.experiment: Experiment = get_experiment(settings.experiment)
        self.out = Path(out)
        self.workers = workers
        self.backend = backend
        self.ray = ray
        self._resume = resume
        self._on_generation = on_generation
        self._init_hash: str | None = None  # of the file that μ started from
        self.optimiser = optimiser or Reinforce(
            self.experiment.num_parameters, settings.population, settings, settings.seed
        )
        self.progress = Progress()
        self._status = ""  # what the bar says of the last generation
        self._folder = RunFolder(out)
        self._open()

    def _open(self) -> None:
        self._folder.check()
        if self._resume and self._folder.state.exists():
            self._load_state()
        elif self._folder.state.exists():
            raise InputError(
                f"{self.out} already holds a run; add --resume to go on with it, or choose another "
                "folder with --out"
            )
        elif self._folder.has_results:
            raise InputError(
                f"{self.out} holds results of a run but no state.safetensors to go on with; choose "
                "another folder with --out"
            )
        elif self.settings.init is not None:
            self._start_from(find(self.settings.init))
        self._take_snapshot()

    def _start_from(self, path: Path) -> None:
        name, ours = self.experiment.name, self.experiment
        agent = load(path, name if path.suffix == ".json" else None)
        theirs = agent.experiment
        if (theirs.body, theirs.learns_design) != (ours.body, ours.learns_design):
            alike = [
                e.name
                for e in EXPERIMENTS.values()
                if (e.body, e.learns_design) == (ours.body, ours.learns_design)
            ]
            raise InputError(
                f"{path} is of {theirs.name}, whose parameters are not those of {name}; name an "
                f"agent of {' or '.join(alike)}"
            )
        if agent.network != ours.network:
            raise InputError(
                f"{path} has the network {agent.network}; {name} trains {ours.network}; name "
                "another agent"
            )
        space = self.settings.space
        if ours.learns_design and agent.space.limits != space.limits:
            raise InputError(
                f"{path} has a body within other limits ({agent.space.in_words}) than this run "
                f"({space.in_words}); give it the same limits"
            )
        self._init_hash = agent.sha256
        self.optimiser.restore({**self.optimiser.state(), "mu": agent.parameters.copy()})

    @property
    def finished(self) -> bool:
        """All generations are done, or an evaluation has reached the settings' `stop_score`."""
        best, stop = self.progress.best_score, self.settings.stop_score
        solved = stop is not None and best is not None and best >= stop
        return solved or self.progress.generation >= self.settings.generations

    def candidates(self) -> np.ndarray:
        """(N, P) candidates of the next generation."""
        return np.asarray(self.optimiser.ask()).round(CANDIDATE_DECIMALS)

    def simulator(self) -> Simulator:
        """What simulates them, where this run is to be executed."""
        weights = self.settings.reward_weights
        return Simulator(
            self.experiment,
            self.backend,
            workers=self.workers,
            ray=self.ray,
            space=self.settings.space,
            # An environment of one's own need not take any.
            **({"reward_weights": weights} if weights else {}),  # type: ignore[arg-type]
        )

    def run(self) -> None:
        """Train to the last generation.

        Raises:
            KeyboardInterrupt: after saving the state, at the last whole generation.
            InputError: something could not be written; the last saved state is intact.
        """
        # Sums over candidates must not depend on the machine's number of cores.
        torch.set_num_threads(1)
        # Rollouts are recorded in a single environment: what that lacks is said now.
        gymnasium.make(self.experiment.env_id, disable_env_checker=True).close()
        with self._folder.locked():
            self._open()  # another run may have used the folder until now
            self._folder.clean()
            with self.simulator() as simulator:  # refuses what it must before anything is written
                self._save_state()  # before the recording, so that whatever a kill leaves can go on
                self._resume = True
                self._train(simulator)

    def _train(self, simulator: Simulator) -> None:
        generation = self.progress.generation
        with (
            RunWriter(
                self._folder.recording,
                self._metadata(),
                resume_generation=generation,
            ) as recorder,
            tqdm(
                total=self.settings.generations,
                initial=generation,
                unit="gen",
                dynamic_ncols=True,
                mininterval=0.1 if sys.stderr.isatty() else 30.0,
                smoothing=0.05,
            ) as bar,
        ):
            saved_at = time.perf_counter()
            try:
                while not self.finished:
                    recorded = self._generation(simulator, recorder, bar)
                    self._take_snapshot()
                    if self._on_generation:
                        self._on_generation(recorded)
                    if time.perf_counter() - saved_at > SAVE_SECONDS or self.finished:
                        self._save_state(recorder)
                        saved_at = time.perf_counter()
            except KeyboardInterrupt:
                with uninterrupted():  # a second one waits
                    self._save_state(recorder)
                    self.progress = Progress(**self._snapshot[1]["progress"])  # what is saved
                raise
            except Exception:
                with suppress(InputError):  # if it cannot be written, the last save must do
                    self._save_state(recorder)
                raise

    def _generation(self, simulator: Simulator, recorder: RunWriter, bar: tqdm) -> Generation:
        start = time.perf_counter(), time.process_time()
        settings, optimiser, progress = self.settings, self.optimiser, self.progress
        index = progress.generation
        before, _ = self._snapshot
        candidates = self.candidates()
        seeds = training_seeds(settings, index)
        done = 0

        def show(count: int) -> None:
            nonlocal done
            done += count
            bar.set_postfix_str(f"{self._status} {done}/{seeds.size} episodes", refresh=False)
            bar.update(0)

        result = self._rollout(simulator, candidates, seeds, settings.shaped_rewards, show)
        returns = result.returns.mean(axis=1)
        optimiser.tell(returns)
        progress.generation += 1
        steps = int(result.steps.sum())
        seconds = self._account(simulator, start, steps)
        recorded = Generation(
            index=index,
            mu=before["mu"],
            sigma=before["sigma"],
            returns=result.returns,
            steps=result.steps,
            seeds=seeds,
            total_steps=progress.total_steps,
            seconds=progress.seconds,
            cpu_seconds=progress.cpu_seconds,
        )
        recorder.generation(recorded)
        if progress.generation % settings.evaluate_every == 0 or self.finished:
            mean = optimiser.state()["mu"].round(CANDIDATE_DECIMALS)
            best = candidates[np.argmax(returns)]
            self._evaluate(simulator, recorder, mean if settings.keep == "mean" else best)
        best = "-" if progress.best_score is None else f"{progress.best_score:.1f}"
        self._status = (
            f"mean {returns.mean():.1f} max {returns.max():.1f} best {best} "
            f"{steps / seconds:,.0f} steps/s"
        )
        bar.set_postfix_str(self._status, refresh=False)
        bar.update()
        return recorded

    def _evaluate(self, simulator: Simulator, recorder: RunWriter, parameters: np.ndarray) -> None:
        """Score an agent as the author did; keep it if it is the best so far.

        With the environment's rewards, and where training has them the factor for smaller legs and
        the weights of the rewards' terms.
        """
        start = time.perf_counter(), time.process_time()
        settings, progress = self.settings, self.progress
        generation = progress.generation
        episodes = settings.evaluation_episodes or settings.population * settings.rollouts
        sequence = np.random.SeedSequence(settings.seed, spawn_key=_EVALUATION_KEY)
        seeds = sequence.generate_state(episodes).astype(np.int64)[None]
        result = self._rollout(simulator, parameters[None], seeds)
        score = float(result.returns.mean())
        kept = progress.best_score is None or score > progress.best_score
        self._account(simulator, start, int(result.steps.sum()))
        agent = self._agent(
            parameters,
            settings=settings.as_dict(),
            score=score,
            score_std=float(result.returns.std()),
            score_episodes=episodes,
            environment_steps=progress.total_steps,
        )
        self._folder.check()
        recorder.evaluation(
            index=generation - 1,
            scores=result.returns[0],
            steps=result.steps[0],
            seeds=seeds[0],
            kept=kept,
        )
        weights = settings.reward_weights
        record_rollout(agent, self._folder.rollout(generation), 0, reward_weights=weights)
        if kept:
            progress.best_score, progress.best_generation = score, generation
            checkpoint.save(agent, self._folder.best)

    def _agent(self, parameters: np.ndarray, **about) -> Agent:
        about |= {"seed": self.settings.seed, "generation": self.progress.generation}
        about |= {**self._init_about, "versions": versions()}
        return Agent(self.experiment, parameters, metadata=about, space=self.settings.space)

    @property
    def _init_about(self) -> dict[str, str]:
        return {"init_sha256": self._init_hash} if self._init_hash else {}

    def _rollout(self, simulator: Simulator, candidates, seeds, shaped=False, progress=None):
        try:
            return simulator.rollout(candidates, seeds, True, shaped, progress)
        except CandidateError as error:
            generation = self.progress.generation
            path = self._folder.failed(generation, error.index)
            about = {"failure": error.reason, "episode_seeds": error.seeds.tolist()}
            checkpoint.save(self._agent(candidates[error.index], **about), path)
            raise InputError(
                f"candidate {error.index} of generation {generation} cannot be simulated "
                f"({error.reason}); its parameters are in {path}, look there and add --resume"
            ) from error

    def _account(self, simulator: Simulator, start: tuple[float, float], steps: int) -> float:
        seconds = time.perf_counter() - start[0]
        self.progress.total_steps += steps
        self.progress.seconds += seconds
        # The processor time of a pool's processes is not known before they end.
        self.progress.cpu_seconds += seconds * simulator.processes or time.process_time() - start[1]
        return seconds

    def _metadata(self) -> dict[str, str]:
        """What a recording says of its run."""
        return {
            "experiment": self.experiment.name,
            "seed": str(self.settings.seed),
            "settings": json.dumps(self.settings.as_dict(), sort_keys=True),
            **self._init_about,
            **self._limits,
            # Not in the checkpoint: its bytes stay those of any code that computes the same.
            "versions": json.dumps({**versions(), "sources": sources_hash()}, sort_keys=True),
            "host": f"{platform.system()} {processor()}, {os.cpu_count()} cores",
            "python": platform.python_version(),
            "command": self.settings.command(),
            "workers": f"Ray {self.ray}" if self.ray else str(self.workers),
        }

    @property
    def _limits(self) -> dict[str, str]:
        limits = self.experiment.limits_of(self.settings.space)
        return {"limits": json.dumps(limits)} if limits else {}

    def _take_snapshot(self) -> None:
        # Of whole generations only: an interrupt can come in the middle of an update.
        metadata: dict[str, Any] = {
            "experiment": self.experiment.name,
            "settings": self.settings.as_dict(),
            **self._init_about,
            "progress": dataclasses.asdict(self.progress),
            "versions": versions(),
        }
        self._snapshot = self.optimiser.state(), metadata

    def _save_state(self, recorder: RunWriter | None = None) -> None:
        self._folder.check()
        if recorder:
            recorder.flush()
        self._folder.write_state(*self._snapshot)

    def _load_state(self) -> None:
        tensors, self.progress, about = self._folder.read_state(self.settings)
        try:
            self.optimiser.restore(tensors)
        except InputError as error:
            raise InputError(f"{self._folder.state} cannot be used: {error}") from None
        self._init_hash = about.get("init_sha256")
