"""Rollouts of many candidates with many seeds, behind one interface.

    simulator = Simulator("biped-hardcore-morphology", backend="engine")
    result = simulator.rollout(candidates, seeds)   # (N, P) floats, (N, R) ints
    result.returns, result.steps                    # (N, R) float64, (N, R) int64

`backend="reference"` runs the Gymnasium environments, in this process or in a pool of processes;
`backend="engine"` runs the compiled engine, which gives the same bits. Either runs on a Ray
cluster, too.
"""

import inspect
import math
from collections.abc import Callable
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, field
from functools import partial

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec, load_env_creator

from designrl import engine
from designrl.design import DesignSpace
from designrl.envs import tasks
from designrl.envs.tasks import engine_task
from designrl.errors import InputError, remark
from designrl.experiments import PAPERS, Experiment, Network, Shaping, get_experiment
from designrl.numeric import real_numbers, whole_number, whole_numbers
from designrl.policy import Agent, bounds_kwargs, noise_stds
from designrl.workers import ProcessWorkers, RayWorkers, TaskError, run_here

BACKENDS = ("engine", "reference")
# At most, on a busy machine; an episode takes 0.4 s on an idle one.
START_SECONDS, EPISODE_SECONDS = 120.0, 30.0
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

    def __reduce__(self):  # from another process
        return CandidateError, (self.index, self.seeds, self.reason)


@dataclass(frozen=True)
class RolloutResult:
    """What N candidates reached with R seeds each.

    Attributes:
        returns: (N, R) float64, the sum of rewards of each episode.
        steps: (N, R) int64, the length of each episode in environment steps.
    """

    returns: np.ndarray
    steps: np.ndarray


@dataclass(frozen=True)
class Episodes:
    """What kind of episodes to run; travels to the workers."""

    experiment: Experiment
    network: Network
    env_kwargs: dict = field(default_factory=dict)  # of the environment
    shaping: Shaping | None = None  # changes of the rewards, if any
    design: np.ndarray | None = None  # (D,) scales of all bodies; None: the candidates' own
    space: DesignSpace | None = None  # of those, where its limits are not the experiment's
    spec: EnvSpec = field(init=False)  # of the environment, which a worker need not have registered

    def __post_init__(self):
        object.__setattr__(self, "spec", gymnasium.spec(self.experiment.env_id))


class Simulator(AbstractContextManager):
    """Runs episodes of one experiment.

    Args:
        experiment: name or Experiment.
        backend: "engine" (falls back to the reference, with one sentence, where it cannot run) or
            "reference".
        network: where it differs from the experiment's (the author's original ant).
        workers: processes (reference) or threads (engine), at least 1.
        ray: run the episodes on a Ray cluster, "local" or its address, on all its cores; `workers`
            has no meaning then.
        space: limits of the candidates' bodies, where they are not the experiment's or those of a
            `design_bounds=`.
        env_kwargs: keywords of the environment, `lidar="v3"` or `reward_weights={"energy": 2.0}`
            for instance.

    Attributes:
        backend: that runs.

    Raises:
        InputError: an argument that is not one of these, or that the environment does not take; an
            experiment whose environment, body and network do not fit each other.

    Use it as a context manager, or `close()` it, to end its worker processes.
    """

    def __init__(
        self,
        experiment: str | Experiment,
        backend: str = "engine",
        network: Network | None = None,
        workers: int = 1,
        ray: str | None = None,
        space: DesignSpace | None = None,
        **env_kwargs,
    ):
        if backend not in BACKENDS:
            raise InputError(f"backend is {backend!r}; it must be one of {', '.join(BACKENDS)}")
        self.experiment = get_experiment(experiment)
        self.network = network or self.experiment.network
        self.workers = whole_number("the number of workers", workers, 1)
        own = self.experiment.body.design
        self.space = space or own.within(env_kwargs.get("design_bounds"))
        self._env_kwargs = env_kwargs = bounds_kwargs(self.experiment, self.space) | env_kwargs
        self._parameters = self.experiment.parameters_with(self.network)
        if self.experiment not in PAPERS:
            check_world(self.experiment, self.network)
        if "design" in env_kwargs:
            raise InputError("candidates walk in their own bodies; give design to rollout()")
        if env_kwargs:  # otherwise the environment's module need not be loaded for what it takes
            entry = gymnasium.spec(self.experiment.env_id).entry_point
            creator = entry if callable(entry) else load_env_creator(str(entry))
            if unknown := sorted(set(env_kwargs) - set(inspect.signature(creator).parameters)):
                others = " or other limits of its body" if unknown[0] == "design_bounds" else ""
                raise InputError(
                    f"{self.experiment.name} takes no {unknown[0]}{others}; leave it out"
                )
        kwargs = {**self.experiment.training_kwargs, **env_kwargs}
        self._bodies = self.space.within(kwargs.get("design_bounds"))
        task = engine_task(self.experiment.env_id, **kwargs)  # or refuses a value
        asked = backend == "engine" and task is not None
        reason = engine_reason(self.experiment, self.network, self._bodies) if asked else None
        if reason:
            remark(f"designrl: {reason}; using the reference environment")
        self.backend = backend = "engine" if asked and not reason else "reference"
        if backend == "reference" and ray is None:  # what it lacks is no candidate's fault
            gymnasium.make(self.experiment.env_id, disable_env_checker=True).close()
        self._pool: RayWorkers | ProcessWorkers | None = None
        if ray is not None:
            self._pool = RayWorkers(ray)
        elif self.workers > 1 and backend == "reference":
            self._pool = ProcessWorkers(self.workers)

    @property
    def processes(self) -> int:
        """How many processes simulate beside this one; on a cluster, its cores at the moment."""
        return self._pool.count if self._pool else 0

    def rollout(
        self,
        candidates: np.ndarray,
        seeds: np.ndarray,
        training: bool = False,
        shaped: bool = False,
        progress: Callable[[int], None] | None = None,
        design=None,
    ) -> RolloutResult:
        """Run each candidate once with each of its seeds.

        Args:
            candidates: (N, P) flat parameter vectors, float64.
            seeds: (N, R) seeds of the episodes, 0 <= seed < 2**63.
            training: in the environment as training has it (`Experiment.training_kwargs`).
            shaped: with the rewards that the author's code changes in training.
            progress: called with the number of episodes that have ended since its last call.
            design: (D,) scales of the body that all walk in; None: each in its own.

        Raises:
            InputError: shapes that do not fit the experiment or each other; parameters that are
                not finite float32 numbers; seeds that are not whole numbers of at least 0; no
                design of the body.
            CandidateError: a candidate crashes the simulation each time, or its return is no number
                (an in-process simulation that crashes takes this process with it).
        """
        candidates, seeds = self._checked(candidates, seeds)
        kwargs = {**(self.experiment.training_kwargs if training else {}), **self._env_kwargs}
        shaping = self.experiment.shaping if shaped else None
        if design is not None:
            design = self._bodies.validate(design)
        elif self.experiment.design and self._bodies is not self.space:
            for scales in self.space.scales(candidates[:, self.network.num_parameters :]):
                self._bodies.validate(scales)
        if shaping:
            shaping.check(self._env_kwargs.get("reward_weights"))
        episodes = Episodes(self.experiment, self.network, kwargs, shaping, design, self.space)
        result = self._run(episodes, candidates, seeds, progress)
        finite = np.isfinite(result.returns).all(axis=1)
        if not finite.all():
            index = int(np.argmin(finite))
            raise CandidateError(index, seeds[index], "its return is not a finite number")
        return result

    def _checked(self, candidates, seeds) -> tuple[np.ndarray, np.ndarray]:
        try:
            candidates = real_numbers(candidates)
        except ValueError as error:
            raise InputError(f"candidates must be an array of real numbers ({error})") from None
        if candidates.ndim != 2 or candidates.shape[1] != self._parameters:
            raise InputError(
                f"candidates of {self.experiment.name} must have shape (N, {self._parameters}), "
                f"got {candidates.shape}"
            )
        wrong_seed = "each candidate needs a seed at least, a whole number from 0 to 2**63 - 1"
        try:
            seeds = whole_numbers(seeds)
        except ValueError as error:
            raise InputError(f"{wrong_seed} ({error})") from None
        if seeds.ndim != 2 or len(seeds) != len(candidates):
            raise InputError(
                f"seeds must have shape ({len(candidates)}, R), one row per candidate, "
                f"got {seeds.shape}"
            )
        usable = np.abs(candidates) <= np.finfo(np.float32).max  # false for NaN
        if not usable.all():
            i, j = np.argwhere(~usable)[0]
            raise InputError(f"candidate {i}: parameter {j} is not a finite float32 number")
        within = seeds.min(initial=0) >= 0 and seeds.max(initial=0) <= np.iinfo(np.int64).max
        if seeds.shape[1] == 0 or not within:
            raise InputError(wrong_seed)
        return candidates, seeds.astype(np.int64)

    def _run(self, episodes, candidates, seeds, progress) -> RolloutResult:
        n, r = seeds.shape
        run = self._pool.run if self._pool else run_here
        count = self._pool.count if self._pool else 1
        if self.backend == "reference":
            function, places = partial(run_reference, episodes), _pieces(n, r, count, 1)
        elif self._pool:
            function, places = partial(run_engine, episodes), _pieces(n, r, count, ENGINE_LANES)
        else:  # the engine has threads of its own, and tells its progress
            function = partial(run_engine, episodes, threads=self.workers, progress=progress)
            places, progress = [(slice(0, n), slice(0, r))], None
        returns, steps = np.full((n, r), np.nan), np.zeros((n, r), dtype=np.int64)
        while places:
            tasks = [(rows, seeds[rows, columns]) for rows, columns in places]
            longest = START_SECONDS + EPISODE_SECONDS * max(piece.size for _, piece in tasks)
            done: set[int] = set()
            try:
                for index, result in run(function, candidates, tasks, longest):
                    returns[places[index]], steps[places[index]] = result
                    done.add(index)
                    if progress:
                        progress(result[0].size)
            except TaskError as error:
                rows, columns = places[error.index]
                if rows.stop - rows.start == 1:
                    failed = seeds[rows.start, columns]
                    raise CandidateError(rows.start, failed, error.reason) from error
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


def run_reference(
    episodes: Episodes, candidates: np.ndarray, seeds: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(n, r) returns and (n, r) steps of some candidates in the Gymnasium environment."""
    returns, steps = np.empty(seeds.shape), np.empty(seeds.shape, dtype=np.int64)
    options = {"disable_env_checker": True, **episodes.env_kwargs}
    with closing(gymnasium.make(episodes.spec, **options)) as env:
        for i, parameters in enumerate(candidates):
            agent = Agent(episodes.experiment, parameters, episodes.network, space=episodes.space)
            for j, seed in enumerate(seeds[i].tolist()):
                returns[i, j], steps[i, j] = run_episode(
                    env, agent, seed, episodes.shaping, episodes.design
                )
    return returns, steps


def run_episode(
    env: gymnasium.Env, agent: Agent, seed: int, shaping: Shaping | None = None, design=None
) -> tuple[float, int]:
    """Return (the sum of rewards in float64) and number of steps of one episode."""
    total, steps, free = 0.0, 0, False
    for step in agent.play(env, seed, design):
        steps += 1
        if shaping and step.info["reward_terms"][shaping.free_term]:
            free = True
        else:
            total += step.reward
    if shaping and not free and total > shaping.solved_return:
        total += shaping.solved_bonus
    return total, steps


def check_world(experiment: Experiment, network: Network) -> None:
    """See that an experiment's environment has its body and what its network takes and gives.

    Raises:
        InputError: it does not, or it cannot be made.
    """
    name, env_id = experiment.name, experiment.env_id
    design, other = np.ones(experiment.body.design.size), np.full(experiment.body.design.size, 1.25)
    try:
        env = gymnasium.make(env_id, disable_env_checker=True, design=design)
    except (InputError, gymnasium.error.Error, ImportError, TypeError) as error:
        words = " ".join(str(error).split())
        raise InputError(f"the environment {env_id} of {name} cannot be made: {words}") from None
    with closing(env):
        if getattr(env.unwrapped, "body", None) != experiment.body:
            raise InputError(f"the environment {env_id} does not have the body of {name}")
        env.reset(seed=0, options={"design": other})
        if not np.array_equal(getattr(env.unwrapped, "design", ()), other):
            raise InputError(
                f"{env_id} does not have the design of a reset as its attribute design"
            )
        inputs = network.sizes[0] - (network.time_scale is not None)
        shapes = env.observation_space.shape, env.action_space.shape
    if shapes != ((inputs,), (network.sizes[-1],)):
        raise InputError(
            f"{env_id} has observations {shapes[0]} and actions {shapes[1]}; the network of {name} "
            f"takes ({inputs},) and gives ({network.sizes[-1]},)"
        )
    named = len(experiment.body.observations), len(experiment.body.joints)
    if named != (inputs, network.sizes[-1]):
        raise InputError(
            f"the body of {name} names {named[0]} observations and {named[1]} joints; {env_id} has "
            f"{inputs} observations and {network.sizes[-1]} actions"
        )


def engine_reason(
    experiment: Experiment, network: Network, space: DesignSpace | None = None
) -> str | None:
    """Why the engine, which has its environment, cannot run it here, as a clause; None if it can.

    Args:
        space: limits of the bodies; None: the paper's.
    """
    if reason := tasks.engine_reason(experiment.env_id, space):
        return reason
    if max(network.sizes) > engine.widest_layer():
        return f"the compiled engine has layers of at most {engine.widest_layer()} values"
    if experiment.shaping not in (None, Shaping()):
        return "the compiled engine has the shaped rewards of the author's code alone"
    return None


def run_engine(episodes: Episodes, candidates: np.ndarray, seeds: np.ndarray, **options):
    """`run_reference` from the compiled engine; where a worker has none, from the reference.

    Args:
        options: `threads`, `progress` and others of `designrl.engine.rollout`.
    """
    experiment, network = episodes.experiment, episodes.network
    found = engine_task(experiment.env_id, **episodes.env_kwargs)
    if found is None or engine_reason(experiment, network):
        return run_reference(episodes, candidates, seeds)
    task, reward_factor = found
    own, rest = np.split(candidates, [network.num_parameters], axis=1)
    weights, log_stds = np.split(own, [network.num_weights], axis=1)
    scales = np.ones((len(seeds), experiment.body.design.size))
    if episodes.design is not None:
        scales *= episodes.design
    elif experiment.design:
        scales = (episodes.space or experiment.design).scales(rest)
    return engine.rollout(
        task,
        network.sizes,
        weights,
        scales,
        reward_factor(scales) if reward_factor else np.ones(len(scales)),
        seeds,
        output_tanh=network.output == "tanh",
        time_scale=network.time_scale,
        noise_stds=noise_stds(log_stds) if network.noise else None,
        shaped=episodes.shaping is not None,
        **options,
    )
