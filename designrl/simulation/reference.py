"""The reference: episodes in the Gymnasium environments themselves."""

from dataclasses import dataclass
from functools import lru_cache

import gymnasium
import numpy as np

import designrl  # noqa: F401 (registers the environments)
from designrl import engine
from designrl.experiments import Network, get_experiment
from designrl.policy import Agent

SOLVED_RETURN = 300.0  # points; the walkers' tasks count as solved above
SOLVED_BONUS = 100.0  # points


@dataclass(frozen=True)
class EpisodeRules:
    """Changes of the reward that the published training code makes; evaluation has none.

    Attributes:
        training: walkers: the -100 of a fall counts 0, and an episode that ends without a fall and
            with more than 300 gets 100 more.
        leg_area_reward: walkers: each reward but that of a fall is multiplied by
            1 + ln(original leg area / leg area) (section 4.2).
    """

    training: bool = False
    leg_area_reward: bool = False


@lru_cache(maxsize=4)
def _environment(env_id: str, **kwargs) -> gymnasium.Env:
    # Episodes do not depend on earlier ones, so one environment serves a process for all of them.
    return gymnasium.make(env_id, disable_env_checker=True, **kwargs)


def run_episode(
    env: gymnasium.Env, agent: Agent, seed: int, training: bool = False
) -> tuple[float, int]:
    """One episode of an agent, in its own body, in an environment of its experiment.

    Returns: (return, steps): the sum of rewards in float64, the number of environment steps.
    """
    agent.reset(seed)
    observation, _ = env.reset(seed=seed, options={"design": agent.body})
    total, steps, fell = 0.0, 0, False
    while True:
        observation, reward, terminated, truncated, info = env.step(agent.act(observation, steps))
        steps += 1
        if training and info["reward_terms"]["fall"]:
            fell, reward = True, 0.0
        total += reward
        if terminated or truncated:
            break
    if training and not fell and total > SOLVED_RETURN:
        total += SOLVED_BONUS
    return total, steps


def run_episodes(
    experiment_name: str,
    network: Network,
    rules: EpisodeRules,
    lidar: str,
    compiled_policy: bool,
    parameters: np.ndarray,
    seeds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """(R,) returns and (R,) steps of one candidate with R seeds.

    `compiled_policy` asks for the compiled policy, which gives the same bits, where there is one.
    """
    experiment = get_experiment(experiment_name)
    agent = Agent(experiment, parameters, network)
    if compiled_policy and engine.missing_reason() is None:
        count = network.num_parameters - network.noise * network.sizes[-1]
        agent._forward = engine.act_function(
            network.sizes, network.output == "tanh", agent.parameters[:count]
        )
    kwargs = {}
    if experiment.is_walker:
        kwargs = {"lidar": lidar, "leg_area_reward": rules.leg_area_reward}
    env = _environment(experiment.env_id, **kwargs)
    training = rules.training and experiment.is_walker
    results = [run_episode(env, agent, int(seed), training) for seed in seeds]
    returns, steps = zip(*results, strict=True)
    return np.array(returns), np.array(steps, dtype=np.int64)
