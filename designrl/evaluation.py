"""Scores of an agent: a number of episodes without any training-time change of the reward."""

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import gymnasium
import numpy as np

from designrl.design import changes_in_words
from designrl.errors import InputError
from designrl.names import agent_of
from designrl.numeric import whole_number
from designrl.policy import Agent
from designrl.settings import MAX_EPISODES
from designrl.simulation import Simulator


@dataclass(frozen=True, repr=False)
class Evaluation:
    """What an agent scored.

    Attributes:
        experiment: name.
        seed: of the whole evaluation; `episode_seeds(seed, episodes)` are those of the episodes.
        scores: (E,) float64 returns.
        steps: (E,) int64 lengths.
        design: (D,) scales of the body, or None where it is the original.
        seconds: wall time.
        backend: that played them, "engine" or "reference".
        changed: names of the dimensions in which that body is not the agent's own -> their scales.
        reward_weights: of reward terms that did not count as 1.
        file, sha256: the agent's, where it is from a file.
    """

    experiment: str
    seed: int
    scores: np.ndarray
    steps: np.ndarray
    design: np.ndarray | None
    seconds: float
    backend: str = "reference"
    changed: dict[str, float] = field(default_factory=dict)
    reward_weights: dict[str, float] = field(default_factory=dict)
    file: str | None = None
    sha256: str | None = None

    def __repr__(self) -> str:
        changed = f", not in its own body: {changes_in_words(self.changed)}" if self.changed else ""
        weights = f", reward weights {self.reward_weights}" if self.reward_weights else ""
        return (
            f"<Evaluation of {self.experiment}: {self.scores.mean():.1f} ± {self.scores.std():.1f} "
            f"over {len(self.scores)} episodes, seed {self.seed}, on the {self.backend}"
            f"{changed}{weights}>"
        )

    def summary(self) -> dict:
        """What `designrl evaluate --json` prints; std is over episodes, as in the paper."""
        return {
            "experiment": self.experiment,
            "episodes": len(self.scores),
            "seed": self.seed,
            "mean": float(self.scores.mean()),
            "std": float(self.scores.std()),
            "min": float(self.scores.min()),
            "max": float(self.scores.max()),
            "scores": self.scores.tolist(),
            "steps": int(self.steps.sum()),
            "lengths": self.steps.tolist(),
            "design": None if self.design is None else self.design.tolist(),
            "changed": self.changed,
            "seconds": self.seconds,
            "backend": self.backend,
            **({"reward_weights": self.reward_weights} if self.reward_weights else {}),
            "file": self.file,
            "sha256": self.sha256,
        }

    def table(self) -> dict[str, np.ndarray]:
        """The episodes as columns (E,), for `designrl.recording.write_table` or pandas."""
        count = len(self.scores)
        return {
            "episode": np.arange(count),
            "seed": episode_seeds(self.seed, count),
            "score": self.scores,
            "length": self.steps,
        }


class Ending(NamedTuple):
    """How an episode of an evaluation went.

    Attributes:
        episode: which, from 0.
        seed: its own.
        score, steps: as in the evaluation.
        ended: by what, in words ("fell").
        at: m that the body was from the origin then, forward.
    """

    episode: int
    seed: int
    score: float
    steps: int
    ended: str
    at: float


def worst(agent: Agent | str | Path, result: Evaluation, count: int, **env_kwargs) -> list[Ending]:
    """The episodes of the lowest scores, the lowest first, played again for what ended them.

    Args:
        agent: that `evaluate` scored.
        result: what it gave.
        count: of the episodes; all, where there are fewer.
        env_kwargs: as `evaluate` had them, but for design and reward_weights, which `result` has.

    Raises:
        InputError: a count that is no whole number from 1 on; an episode that has another score
            here, so that nobody knows what ended it.
    """
    agent = agent_of(agent)
    count = whole_number("the number of lowest scores", count, 1)
    seeds, found = episode_seeds(result.seed, len(result.scores)), []
    weights = {"reward_weights": result.reward_weights} if result.reward_weights else {}
    options = {"disable_env_checker": True, **agent.env_kwargs, **weights, **env_kwargs}
    design = result.design if result.changed else None
    with closing(gymnasium.make(agent.experiment.env_id, **options)) as env:
        for i in np.argsort(result.scores, kind="stable")[:count].tolist():
            score, seed = 0.0, int(seeds[i])
            for step in agent.play(env, seed, design):
                score += step.reward
            if score != result.scores[i]:
                raise InputError(
                    f"episode {i} has {result.scores[i]} points in the evaluation and {score} on "
                    "the reference, which alone tells what ended it; give this the evaluation's "
                    "agent and keywords, or evaluate with the backend reference"
                )
            body, world = agent.experiment.body, env.unwrapped
            ended = body.ending(world) if step.terminated else "reached the time limit"
            at = float(body.poses(world)[0][0][0])
            found.append(Ending(i, seed, score, step.t + 1, ended, at))
    return found


def episode_seeds(seed: int, count: int) -> np.ndarray:
    """(count,) int64 seeds of an evaluation's episodes; fewer episodes are the first of more."""
    return np.random.SeedSequence(seed).generate_state(count).astype(np.int64)


def evaluate(
    agent: Agent | str | Path,
    episodes: int = 100,
    seed: int = 0,
    workers: int = 1,
    backend: str = "engine",
    progress: Callable[[int], None] | None = None,
    design=None,
    **env_kwargs,
) -> Evaluation:
    """Score an agent over `episodes` episodes; the paper's scores are over 100.

    Args:
        agent: from `designrl.load`, or a checkpoint as that takes it.
        episodes: at least 1, at most MAX_EPISODES.
        seed: the same seed gives the same scores, for any number of workers.
        workers: threads of the engine, or processes of the reference, of which more than one need
            the usual `if __name__ == "__main__":`.
        backend, env_kwargs: as in `Simulator`.
        progress: called with the number of episodes that have ended since its last call.
        design: the body to walk with, as `Agent.body_with` takes it; None: the agent's own.

    Raises:
        InputError: episodes, seed, workers or backend out of range, no agent, or no design of its
            body.
    """
    episodes = whole_number("the number of episodes", episodes, 1, MAX_EPISODES)
    seed = whole_number("the seed", seed, 0)
    agent = agent_of(agent)
    scales = None if design is None else agent.body_with(design)
    start = time.perf_counter()
    about = agent.experiment, backend, agent.network, workers
    with Simulator(*about, space=agent.space, **env_kwargs) as simulator:
        result = simulator.rollout(
            agent.parameters[None],
            episode_seeds(seed, episodes)[None],
            progress=progress,
            design=scales,
        )
    return Evaluation(
        agent.experiment.name,
        seed,
        result.returns[0],
        result.steps[0],
        agent.design if scales is None else scales,
        time.perf_counter() - start,
        simulator.backend,
        {} if scales is None else agent.experiment.body.design.changes(agent.scales, scales),
        file=str(agent.file) if agent.file else None,
        sha256=agent.sha256,
        reward_weights=dict(env_kwargs.get("reward_weights") or {}),
    )
