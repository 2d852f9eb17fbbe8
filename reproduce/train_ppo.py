"""PPO on the original body, or on one that a run here has learned.

    python -m reproduce.train_ppo --out curve.csv
    python -m reproduce.train_ppo --design biped-morphology/seed0 --out curve.csv
    python -m reproduce.train_ppo --hardcore --seed 3 --steps 20_000_000 --out curve.csv

Trains Stable-Baselines3's PPO (of `make setup-train`) on a walker and writes its learning
curve. The settings are RL Baselines3 Zoo's for BipedalWalker-v3 and BipedalWalkerHardcore-v3
(hyperparams/ppo.yml) with larger minibatches, which take several times as many steps a second, and
on hardcore more environments and a larger learning rate. They were chosen on the original body and
are the same for every body. `make transfer` runs it for all curves that `make reproduce-transfer`
draws.
"""

import argparse
import importlib.metadata
import shlex
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

import designrl
from designrl.bodies.walker import WALKER
from designrl.envs.sb3 import EngineVecEnv
from designrl.errors import InputError
from designrl.files import file_hash, write_atomically
from designrl.names import find
from designrl.provenance import VERSION, processor
from reproduce.tables import as_csv

FLAT = {
    "n_steps": 2048,
    "batch_size": 512,  # RL Baselines3 Zoo: 64
    "gae_lambda": 0.95,
    "gamma": 0.999,
    "n_epochs": 10,
    "ent_coef": 0.0,
    "learning_rate": 3e-4,
    "clip_range": 0.18,
}
HARDCORE = FLAT | {
    "n_steps": 512,  # of 64 environments; RL Baselines3 Zoo: 2048 of 16
    "batch_size": 2048,  # RL Baselines3 Zoo: 64
    "gamma": 0.99,
    "ent_coef": 0.001,
    # By the share of the training that is left. RL Baselines3 Zoo: 2.5e-4
    "learning_rate": lambda left: 6e-4 * left,
    "clip_range": lambda left: 0.2 * left,
}
TASKS = {  # hardcore or not -> environment, how many of them, settings
    False: ("designrl/BipedalWalker-v0", 32, FLAT),
    True: ("designrl/BipedalWalkerHardcore-v0", 64, HARDCORE),
}
EVALUATIONS = 50  # spread over the training, besides the one before it


class Evaluations(BaseCallback):
    """Scores the policy's mean action now and then, in fresh episodes of a second environment."""

    def __init__(self, env: VecNormalize, every: int):
        super().__init__()
        self.env, self.every, self.rows = env, every, []
        self.start = time.perf_counter()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if not self.rows or self.num_timesteps >= self.rows[-1][0] + self.every:
            self.evaluate()

    def _on_training_end(self) -> None:
        if self.rows[-1][0] < self.num_timesteps:
            self.evaluate()

    def evaluate(self) -> None:
        self.env.obs_rms = self.training_env.obs_rms
        returns, _ = evaluate_policy(
            self.model, self.env, self.env.num_envs, return_episode_rewards=True
        )
        mean, sd = np.mean(returns), np.std(returns)
        self.rows.append((self.num_timesteps, mean, sd, len(returns)))
        seconds = time.perf_counter() - self.start
        print(
            f"{self.num_timesteps:11,d} steps {seconds:7.0f} s  {mean:6.1f} ± {sd:.1f}", flush=True
        )


def train(
    design: np.ndarray | None, hardcore: bool, seed: int, steps: int, episodes: int, threads: int
) -> list[tuple[int, float, float, int]]:
    """Rows of (steps, mean return, standard deviation over episodes, episodes)."""
    torch.set_num_threads(threads)
    env_id, num_envs, settings = TASKS[hardcore]
    make = partial(EngineVecEnv, env_id, design=design, threads=threads)
    env = VecNormalize(VecMonitor(make(num_envs)), gamma=settings["gamma"])
    # Its episodes have seeds that training has not.
    tests = VecMonitor(make(episodes, seed=2**32 + seed * episodes))
    tests = VecNormalize(tests, training=False, norm_reward=False)
    # A training shorter than one rollout gets a shorter rollout.
    settings = settings | {"n_steps": max(2, min(settings["n_steps"], steps // num_envs))}
    adam = {"optimizer_kwargs": {"eps": 1e-5, "fused": True}}  # the usual one, in fewer calls
    model = PPO("MlpPolicy", env, seed=seed, device="cpu", policy_kwargs=adam, **settings)
    evaluations = Evaluations(tests, steps // EVALUATIONS)
    model.learn(steps, callback=evaluations)
    return evaluations.rows


def origin(options: argparse.Namespace) -> str:
    """Where a curve comes from: the command, the body, what it ran on."""
    body = "original"
    if options.design:
        body = f"{options.design} (sha256 {file_hash(find(options.design))})"
    libraries = ("stable_baselines3", "torch", "gymnasium", "numpy")
    versions = [f"{name} {importlib.metadata.version(name)}" for name in libraries]
    command = f"python -m reproduce.train_ppo {shlex.join(sys.argv[1:])}"
    return "; ".join([command, f"body: {body}", f"designrl {VERSION}", *versions, processor()])


def main() -> None:
    parser = argparse.ArgumentParser("train_ppo", description=__doc__.splitlines()[0])
    parser.add_argument("--design", type=Path, help="a checkpoint: its body; else the original one")
    parser.add_argument("--hardcore", action="store_true", help="rough ground instead of flat")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=4_000_000, help="of training")
    parser.add_argument("--episodes", type=int, default=100, help="of an evaluation")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="the curve, a CSV file")
    options = parser.parse_args()
    try:
        write(options)
    except InputError as error:
        parser.error(str(error))


def write(options: argparse.Namespace) -> None:
    """Train, and write the curve."""
    if options.out.is_dir():
        raise InputError(f"{options.out} is a folder; name a file in it")
    if min(options.steps, options.episodes, options.threads) < 1:
        raise InputError("--steps, --episodes and --threads count from 1")
    design = None
    if options.design:
        agent = designrl.load(options.design)
        if agent.experiment.body != WALKER:
            raise InputError(f"{options.design} has the body of {agent.experiment.name}, no walker")
        design = agent.scales
    rows = train(
        design, options.hardcore, options.seed, options.steps, options.episodes, options.threads
    )
    table = as_csv(
        [
            {"steps": steps, "mean": f"{mean:.3f}", "sd": f"{sd:.3f}", "episodes": count}
            for steps, mean, sd, count in rows
        ]
    )
    write_atomically(options.out, f"# {origin(options)}\n{table}".encode())


if __name__ == "__main__":
    main()
