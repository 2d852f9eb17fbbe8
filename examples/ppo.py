"""PPO on a body of your choice, with Stable-Baselines3: a start to copy and change.

    python examples/ppo.py    # after make setup-train

Trains briefly and prints the score. `reproduce/train_ppo.py` has settings that learn to
walk, and what they score is in paper/report.md.
"""

from functools import partial

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from designrl.envs.sb3 import EngineVecEnv
from designrl.errors import InputError

ENV_ID, ENVIRONMENTS, STEPS = "designrl/BipedalWalker-v0", 32, 100_000
DESIGN = np.full(8, 0.8)  # scales; a learned body: designrl.load("biped-morphology/seed0").scales

try:
    env = EngineVecEnv(ENV_ID, ENVIRONMENTS, design=DESIGN)
except InputError as error:  # no engine here: the same results, many times as slowly
    print(error)
    env = DummyVecEnv([partial(gymnasium.make, ENV_ID, design=DESIGN)] * ENVIRONMENTS)

model = PPO("MlpPolicy", VecMonitor(env), n_steps=512, batch_size=512, gamma=0.999, device="cpu")
model.learn(STEPS)
mean, std = evaluate_policy(model, model.get_env(), n_eval_episodes=20)
print(f"{mean:.1f} ± {std:.1f} points")
