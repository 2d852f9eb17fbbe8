"""What is public gives the same in several threads at once as alone."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import designrl
from designrl.recording import read, record_rollout
from designrl.simulation import Simulator

ROOT = Path(__file__).resolve().parents[1]
THREADS = 4


def play(agent, seed):
    """All that an agent does in an episode, step by step."""
    env = gymnasium.make(agent.experiment.env_id)
    return np.concatenate([step.action for step in agent.play(env, seed)]).tolist()


def evaluate(agent, seed, backend):
    return designrl.evaluate(agent, episodes=1, seed=seed, backend=backend).scores.tolist()


def simulate(agent, seed, backend):
    with Simulator(agent.experiment, backend) as simulator:
        return simulator.rollout(agent.parameters[None], np.array([[seed]])).returns.tolist()


def record(folder, agent, seed):
    path = folder / f"{agent.experiment.name}{seed}.mcap"
    score = record_rollout(agent, path, seed)
    return score, read(path).array("/action", "values").tolist()


# The ant's action depends on noise that belongs to the agent and the episode.
@pytest.mark.parametrize("name", ["biped-morphology", "ant-morphology"])
def test_threads_do_not_disturb_each_other(name, tmp_path, monkeypatch):
    path = next((ROOT / "pretrained" / name).glob("*.safetensors"))
    agent = designrl.load(path)
    monkeypatch.setattr(gymnasium.spec(agent.experiment.env_id), "max_episode_steps", 200)
    calls = [play, partial(record, tmp_path)]
    calls += [partial(f, backend=b) for f in (evaluate, simulate) for b in ("engine", "reference")]
    work = [(call, seed) for call in calls for seed in range(THREADS)]
    alone = [call(agent, seed) for call, seed in work]
    with ThreadPoolExecutor(THREADS) as pool:
        loaded = pool.map(designrl.load, [path] * THREADS)
        together = [pool.submit(call, agent, seed) for call, seed in work]
        assert [future.result() for future in together] == alone
        assert all((found.parameters == designrl.load(path).parameters).all() for found in loaded)


def test_ants_in_threads_leave_the_terminal_as_it_was():
    code = (
        "import gymnasium, designrl; from concurrent.futures import ThreadPoolExecutor\n"
        "make = lambda seed: gymnasium.make('designrl/Ant-v0').reset(seed=seed)\n"
        "for _ in range(3):\n"
        "    with ThreadPoolExecutor(8) as pool: list(pool.map(make, range(16)))\n"
        "print('still here')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("still here\n", "")
