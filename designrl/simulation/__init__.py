"""Rollouts of many candidates with many seeds, behind one interface.

    simulator = Simulator("biped-hardcore-morphology", backend="engine")
    result = simulator.rollout(candidates, seeds)   # (N, P) floats, (N, R) ints
    result.returns, result.steps                    # (N, R) float64, (N, R) int64

`backend="reference"` runs the Gymnasium environments, in this process or in a pool of processes;
`backend="engine"` runs the compiled walker engine, which gives the same bits.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from designrl.design import leg_area_reward_factor
from designrl.errors import InputError
from designrl.experiments import Experiment, Network, get_experiment
from designrl.simulation.reference import EpisodeRules, run_episodes
from designrl.workers import ProcessWorkers, run_here

__all__ = ["EVALUATION", "EpisodeRules", "RolloutResult", "Simulator"]

EVALUATION = EpisodeRules()
BACKENDS = ("engine", "reference")


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
            run; the ant has no engine) or "reference".
        network: where it differs from the experiment's (the published original ant).
        lidar: "v2", the paper's, or "v3"; walkers only.
        workers: processes (reference) or threads (engine), at least 1.

    Use it as a context manager, or `close()` it, to end its worker processes.
    """

    def __init__(
        self,
        experiment: str | Experiment,
        backend: str = "engine",
        network: Network | None = None,
        lidar: str = "v2",
        workers: int = 1,
    ):
        if backend not in BACKENDS:
            raise InputError(f"backend is {backend!r}; it must be one of {', '.join(BACKENDS)}")
        if workers < 1:
            raise InputError(f"the number of workers is {workers}; it must be at least 1")
        self.experiment = get_experiment(experiment)
        self.network = network or self.experiment.network
        self.lidar = lidar
        self._engine = None
        if backend == "engine" and self.experiment.is_walker:
            from designrl.simulation.engine import WalkerEngine, engine_missing_reason

            reason = engine_missing_reason()
            if reason is None:
                self._engine = WalkerEngine(self.experiment.hardcore, lidar, threads=workers)
            else:
                print(f"designrl: {reason}; using the reference environment", file=sys.stderr)
        self.backend = "engine" if self._engine else "reference"
        self._pool = ProcessWorkers(workers) if workers > 1 and not self._engine else None
        self._workers = workers

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
            InputError: shapes that do not fit the experiment or each other.
        """
        candidates = np.asarray(candidates, dtype=np.float64)
        seeds = np.asarray(seeds, dtype=np.int64)
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
        if self._engine:
            return self._rollout_engine(candidates, seeds, rules, progress)
        return self._rollout_reference(candidates, seeds, rules, progress)

    def _rollout_engine(self, candidates, seeds, rules, progress) -> RolloutResult:
        split = self.network.num_parameters
        design = self.experiment.design
        size = self.experiment.body.size
        scales = design.scales(candidates[:, split:]) if design else np.ones((len(seeds), size))
        factors = leg_area_reward_factor(scales) if rules.leg_area_reward else np.ones(len(seeds))
        returns, steps = self._engine.rollout(
            candidates[:, :split],
            scales,
            factors,
            seeds,
            training=rules.training,
            progress=progress,
        )
        return RolloutResult(returns, steps)

    def _rollout_reference(self, candidates, seeds, rules, progress) -> RolloutResult:
        n, r = seeds.shape
        # Pieces small enough to keep all workers busy to the end, large enough to be worth sending.
        piece = max(1, min(r, n * r // (self._workers * 8)))
        places = [(i, j) for i in range(n) for j in range(0, r, piece)]
        tasks = [
            (
                self.experiment.name,
                self.network,
                rules,
                self.lidar,
                candidates[i],
                seeds[i, j : j + piece],
            )
            for i, j in places
        ]
        returns, steps = np.empty((n, r)), np.empty((n, r), dtype=np.int64)
        run = self._pool.run if self._pool else run_here
        for index, (piece_returns, piece_steps) in run(run_episodes, tasks):
            i, j = places[index]
            returns[i, j : j + piece] = piece_returns
            steps[i, j : j + piece] = piece_steps
            if progress:
                progress(len(piece_returns))
        return RolloutResult(returns, steps)

    def close(self) -> None:
        """End the worker processes."""
        if self._pool:
            self._pool.close()

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self.close()
