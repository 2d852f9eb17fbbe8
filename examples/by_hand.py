"""The paper's algorithm in one sitting: section 3, with its equations' numbers and its words.

    python examples/by_hand.py            (with PyTorch: make setup-train)

Learns a walker's policy and its body for two generations, without anything that makes it fast or
safe: no engine, workers, recordings or files. `designrl train` computes the same bits
(`tests/test_by_hand.py`). Two things are left out: which candidate is evaluated and kept as the
agent, and the bonuses that the author's code pays in training, which the paper does not mention
(docs/fidelity.md).
"""

import gymnasium
import numpy as np
import torch

from designrl.experiments import get_experiment
from designrl.policy import Agent
from designrl.reinforce import Reinforce
from designrl.settings import TrainSettings
from designrl.train import CANDIDATE_DECIMALS, training_seeds


def cumulative_reward(env: gymnasium.Env, agent: Agent, seed: int) -> float:
    """R(w) of one rollout: the agent alters its environment before it, then acts to its end."""
    observation = agent.start(env, seed)  # resets the environment with the agent's own body
    total, ended, t = 0.0, False, 0
    while not ended:
        action = agent.act(observation, t)
        observation, reward, terminated, truncated, _ = env.step(action)
        total, ended, t = total + reward, terminated or truncated, t + 1
    return total


def learn(settings: TrainSettings) -> Reinforce:
    """Maximise J(θ) = E[R(w)] (equation 1); returns θ, the means μ and deviations σ of w."""
    torch.set_num_threads(1)  # sums must not depend on the number of cores
    experiment = get_experiment(settings.experiment)
    env = gymnasium.make(experiment.env_id, **experiment.training_kwargs)
    theta = Reinforce(experiment.num_parameters, settings.population, settings, settings.seed)
    for generation in range(settings.generations):
        # Sample the population w¹ ... wᴺ, each element from w_j ~ N(μ_j, σ_j). The last elements
        # of w decide the body's scales, the others the weights of the policy's network.
        population = np.asarray(theta.ask()).round(CANDIDATE_DECIMALS)
        agents = [Agent(experiment, w) for w in population]
        # Equation 1 has an expectation: a candidate's R(w) is the mean over several rollouts.
        seeds = training_seeds(settings, generation).tolist()
        rollouts = [
            [cumulative_reward(env, agent, seed) for seed in own]
            for agent, own in zip(agents, seeds, strict=True)
        ]
        returns = np.array(rollouts).mean(axis=1)
        # Estimate ∇J(θ) (equation 3, by the log-likelihood trick of equation 2) with the closed
        # forms of ∇ log N (equation 5), and ascend it (equation 4). `designrl.reinforce` has them,
        # as the paper writes them (recipe "plain") and as the author's code does (the others).
        theta.tell(returns)
        print(f"generation {generation}: mean {returns.mean():.1f}, best {returns.max():.1f}")
    env.close()
    return theta


if __name__ == "__main__":
    small = {"generations": 2, "population": 8, "rollouts": 2}  # the paper's: 5000, 192 and 16
    learn(TrainSettings.of("biped-morphology", shaped_rewards=False, **small))
