"""Rollouts of many candidates with many seeds, behind one interface.

    simulator = Simulator("biped-hardcore-morphology", backend="engine")
    result = simulator.rollout(candidates, seeds)   # (N, P) floats, (N, R) ints
    result.returns, result.steps                    # (N, R) float64, (N, R) int64

`backend="reference"` runs the Gymnasium environments, in this process or in a pool of processes;
`backend="engine"` runs the compiled walker engine, which gives the same bits. Either runs on a Ray
cluster, too.
"""

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import gymnasium
import numpy as np

from designrl import engine
from designrl.design import leg_area_reward_factor
from designrl.errors import InputError
from designrl.experiments import Experiment, Network, get_experiment
from designrl.simulation.reference import EpisodeRules, run_episodes
from designrl.workers import ProcessWorkers, RayWorkers, TaskError, run_here

__all__ = ["EVALUATION", "CandidateError", "EpisodeRules", "RolloutResult", "Simulator"]

EVALUATION = EpisodeRules()
BACKENDS = ("engine", "reference")
EPISODE_SECONDS = 30.0  # at most, on a busy machine; an episode takes 0.4 s on an idle one
PIECES_PER_WORKER = 8  # of a generation: enough to keep all workers busy to the end of it
ENGINE_LANES = 16  # episodes that the engine runs side by side in one thread


class CandidateError(InputError):
    """A candidate whose episodes cannot be simulated.

    Attributes:
        index: its row.
        seeds: of the episodes, one of which fails.
        reason: what happened, as the end of a sentence.
    """

    def __init__(self, index: int, seeds: np.ndarray, reason: str):
        super().__init__(f"candidate {index} cannot be simulated: {reason}")
        self.index, self.seeds, self.reason = index, seeds, reason


@dataclass(frozen=True)
class RolloutResult:
    """What N candidates reached with R seeds each.

    Attributes:
        returns: (N, R) float64, the sum of rewards of each episode.
        steps: (N, R) int64, the length of each episode in environment steps.
    """

    returns: np.ndarray
    steps: np.ndarray


class Simulator:
    """Runs episodes of one experiment.

    Args:
        experiment: name or Experiment.
        backend: "engine" (walkers; falls back to the reference, with one sentence, where it cannot
            run; the ant has no engine, only its policy is compiled) or "reference".
        network: where it differs from the experiment's (the published original ant).
        lidar: "v2", the paper's, or "v3"; walkers only.
        workers: processes (reference) or threads (engine), at least 1.
        ray: run the episodes on a Ray cluster, "local" or its address, on all its cores; `workers`
            has no meaning then.

    Use it as a context manager, or `close()` it, to end its worker processes.
    """

    def __init__(
        self,
        experiment: str | Experiment,
        backend: str = "engine",
        network: Network | None = None,
        lidar: str = "v2",
        workers: int = 1,
        ray: str | None = None,
    ):
        if backend not in BACKENDS:
            raise InputError(f"backend is {backend!r}; it must be one of {', '.join(BACKENDS)}")
        if workers < 1:
            raise InputError(f"the number of workers is {workers}; it must be at least 1")
        if lidar not in ("v2", "v3"):
            raise InputError(f'lidar is {lidar!r}; it must be "v2" (the paper\'s) or "v3"')
        self.experiment = get_experiment(experiment)
        if lidar != "v2" and not self.experiment.is_walker:
            raise InputError(f"{self.experiment.name} has no LIDAR; leave out lidar={lidar!r}")
        self.network = network or self.experiment.network
        if self.network not in self.experiment.networks:
            raise InputError(f"{self.experiment.name} does not have the network {self.network}")
        self.lidar = lidar
        self._engine = None
        if backend == "engine" and self.experiment.is_walker:
            reason = engine.missing_reason()
            if reason is None:
                engine.instruction_set()  # raises InputError for an unknown one
                self._engine = partial(_run_engine, self.experiment, lidar, workers)
            else:
                print(f"designrl: {reason}; using the reference environment", file=sys.stderr)
        self.backend = "engine" if self._engine else "reference"
        self._compiled_policy = backend == "engine" and not self.experiment.is_walker
        self._pool = None
        if ray is not None:
            self._pool = RayWorkers(ray)
        elif workers > 1 and not self._engine:
            self._pool = ProcessWorkers(workers)

    @property
    def processes(self) -> int:
        """How many processes simulate beside this one; on a cluster, its cores at the moment."""
        return self._pool.count if self._pool else 0

    def rollout(
        self,
        candidates: np.ndarray,
        seeds: np.ndarray,
        rules: EpisodeRules = EVALUATION,
        progress: Callable[[int], None] | None = None,
    ) -> RolloutResult:
        """Run each candidate once with each of its seeds.

        Args:
            candidates: (N, P) flat parameter vectors, float64.
            seeds: (N, R) seeds of the episodes, 0 <= seed < 2**63.
            rules: training-time changes of the reward; by default none.
            progress: called with the number of episodes that have ended since its last call.

        Raises:
            InputError: shapes that do not fit the experiment or each other; parameters that are not
                finite; seeds that are not whole numbers of at least 0.
            CandidateError: a candidate crashes the simulation each time, or its return is no number
                (an in-process simulation that crashes takes this process with it).
        """
        candidates = np.asarray(candidates, dtype=np.float64)
        seeds = np.asarray(seeds)
        design_size = self.experiment.design.size if self.experiment.design else 0
        expected = self.network.num_parameters + design_size
        if candidates.ndim != 2 or candidates.shape[1] != expected:
            raise InputError(
                f"candidates of {self.experiment.name} must have shape (N, {expected}), "
                f"got {candidates.shape}"
            )
        if seeds.ndim != 2 or len(seeds) != len(candidates):
            raise InputError(
                f"seeds must have shape ({len(candidates)}, R), one row per candidate, "
                f"got {seeds.shape}"
            )
        if not np.isfinite(candidates).all():
            i, j = np.argwhere(~np.isfinite(candidates))[0]
            raise InputError(f"candidate {i}: parameter {j} is not a finite number")
        if seeds.shape[1] < 1 or seeds.dtype.kind not in "iu" or seeds.min(initial=0) < 0:
            raise InputError("each candidate needs a seed at least, a whole number from 0")
        seeds = seeds.astype(np.int64)
        if self._engine and not self._pool:
            result = self._rollout_engine(candidates, seeds, rules, progress)
        else:
            result = self._rollout_pieces(candidates, seeds, rules, progress)
        finite = np.isfinite(result.returns).all(axis=1)
        if not finite.all():
            index = int(np.argmin(finite))
            raise CandidateError(index, seeds[index], "its return is not a finite number")
        return result

    def _rollout_engine(self, candidates, seeds, rules, progress) -> RolloutResult:
        run = partial(self._engine, rules)
        try:
            return RolloutResult(*run(candidates, seeds, progress))
        except InputError:
            for index in range(len(seeds)):  # which one was it?
                try:
                    run(candidates[index : index + 1], seeds[index : index + 1])
                except InputError as error:
                    raise CandidateError(index, seeds[index], str(error)) from None
            raise

    def _rollout_pieces(self, candidates, seeds, rules, progress) -> RolloutResult:
        if self._engine:
            function = partial(_run_cached_engine, self.experiment.name, self.lidar, rules)
            least = ENGINE_LANES
        else:
            function = partial(
                _run_reference,
                self.experiment.name,
                self.network,
                rules,
                self.lidar,
                self._compiled_policy,
            )
            least = 1
        run = self._pool.run if self._pool else run_here
        count = self._pool.count if self._pool else 1
        returns, steps = np.empty(seeds.shape), np.empty(seeds.shape, dtype=np.int64)

        places = _pieces(*seeds.shape, count, least)
        while places:
            tasks = [(rows, seeds[rows, columns]) for rows, columns in places]
            longest = EPISODE_SECONDS * max(piece.size for _, piece in tasks)
            done = set()
            try:
                for index, result in run(function, candidates, tasks, longest):
                    returns[places[index]], steps[places[index]] = result
                    done.add(index)
                    if progress:
                        progress(result[0].size)
            except TaskError as error:
                rows, columns = places[error.index]
                if rows.stop - rows.start == 1:
                    seeds = seeds[rows.start, columns]
                    raise CandidateError(rows.start, seeds, error.reason) from error
                done.add(error.index)  # one of several: each alone will tell which
                alone = [(slice(i, i + 1), columns) for i in range(rows.start, rows.stop)]
                places = alone + [place for i, place in enumerate(places) if i not in done]
            else:
                places = []
        return RolloutResult(returns, steps)

    def close(self) -> None:
        """End the worker processes."""
        if self._pool:
            self._pool.close()

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self.close()


def _pieces(n: int, r: int, workers: int, least: int) -> list[tuple[slice, slice]]:
    """Cut (N, R) episodes into the tasks of so many workers: rows and columns of each.

    Of at least `least` episodes each where that leaves no worker without work; of one candidate
    each, or of some with all their episodes.
    """
    share = n * r / workers
    size = max(share / PIECES_PER_WORKER, min(least, share))
    rows = max(1, int(size // r))
    columns = max(1, min(r, math.ceil(size)))
    return [
        (slice(i, min(i + rows, n)), slice(j, min(j + columns, r)))
        for i in range(0, n, rows)
        for j in range(0, r, columns)
    ]


def _run_reference(experiment_name, network, rules, lidar, compiled_policy, candidates, seeds):
    """(n, r) returns and steps of some candidates in the Gymnasium environments."""
    results = [
        run_episodes(experiment_name, network, rules, lidar, compiled_policy, parameters, row)
        for parameters, row in zip(candidates, seeds, strict=True)
    ]
    returns, steps = zip(*results, strict=True)
    return np.array(returns), np.array(steps)


def engine_task(experiment: Experiment, lidar: str = "v2") -> engine.Task:
    """A walker's task in the engine."""
    flags = ("hardcore",) * experiment.hardcore + ("closest_hits",) * (lidar == "v3")
    return engine.Task("walker", flags, gymnasium.spec(experiment.env_id).max_episode_steps)


def _run_engine(experiment, lidar, threads, rules, candidates, seeds, progress=None):
    """(n, r) returns and steps of some candidates in the compiled engine."""
    split, design = experiment.network.num_parameters, experiment.design
    size = experiment.body.size
    scales = design.scales(candidates[:, split:]) if design else np.ones((len(seeds), size))
    factors = leg_area_reward_factor(scales) if rules.leg_area_reward else np.ones(len(seeds))
    return engine.rollout(
        engine_task(experiment, lidar),
        experiment.network.sizes,
        candidates[:, :split],
        scales,
        factors,
        seeds,
        shaped=rules.training,
        threads=threads,
        progress=progress,
    )


def _run_cached_engine(experiment_name, lidar, rules, candidates, seeds):
    experiment = get_experiment(experiment_name)
    if engine.missing_reason():  # the reference gives the same bits
        network = experiment.network
        return _run_reference(experiment_name, network, rules, lidar, False, candidates, seeds)
    return _run_engine(experiment, lidar, 1, rules, candidates, seeds)
