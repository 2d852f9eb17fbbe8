"""What recording a run costs, as a share of the time that its generations take.

    make bench

The generations are the paper's (192 candidates, 16 episodes each) at the start of a run, when
episodes are shortest, on the fastest simulation there is: later, or elsewhere, the share is less.
"""

import time

import numpy as np
import pytest

from designrl.experiments import get_experiment
from designrl.policy import Agent
from designrl.recording import RunWriter, read, record_rollout
from designrl.simulation import Simulator

SAMPLE = 16  # candidates that are simulated to learn what a whole population takes
SIGMA = 0.1  # of the first generation


def first_generation(experiment, candidates: int):
    rng = np.random.default_rng(0)
    mu, sigma = np.zeros(experiment.num_parameters), np.full(experiment.num_parameters, SIGMA)
    half = rng.normal(size=(candidates // 2, mu.size)) * sigma
    seeds = rng.integers(0, 2**32, (candidates // 2, experiment.rollouts))
    return mu, sigma, np.concatenate([half, -half]), np.concatenate([seeds, seeds])


@pytest.mark.parametrize("name", ["biped-morphology", "biped-hardcore-morphology"])
@pytest.mark.benchmark(group="recording a generation")
def test_recording_a_generation(benchmark, name, tmp_path):
    experiment = get_experiment(name)
    _, _, candidates, seeds = first_generation(experiment, SAMPLE)
    with Simulator(experiment) as simulator:
        simulator.rollout(candidates[:2], seeds[:2])
        start = time.perf_counter()
        simulator.rollout(candidates, seeds)
        simulated = (time.perf_counter() - start) * experiment.population / SAMPLE

    mu, sigma, _, seeds = first_generation(experiment, experiment.population)
    rng, path = np.random.default_rng(1), tmp_path / "generations.mcap"
    returns, steps = rng.normal(size=seeds.shape) * 100, rng.integers(50, 1600, seeds.shape)
    with RunWriter(path, {"experiment": name}) as writer:
        count = 0

        def record():
            nonlocal count
            # As in a run, no two generations have an equal bit pattern.
            noise = rng.normal(size=mu.size) * 1e-3
            writer.generation(count, mu + noise, sigma + noise, returns, steps, seeds, 0.0, 0)
            writer.flush()
            count += 1

        benchmark.pedantic(record, rounds=50, warmup_rounds=1)
    recorded = benchmark.stats.stats.median
    benchmark.extra_info["share_of_a_generation"] = f"{100 * recorded / simulated:.3f} %"
    benchmark.extra_info["engine"] = f"{simulator.backend}, 1 core"
    benchmark.extra_info["kB_per_generation"] = round(path.stat().st_size / count / 1000, 1)
    assert len(read(path).generations) == count
    assert recorded < 0.02 * simulated


@pytest.mark.parametrize("name", ["biped-hardcore-morphology", "ant-morphology"])
@pytest.mark.benchmark(group="recording a rollout")
def test_recording_a_rollout(benchmark, name, tmp_path):
    experiment = get_experiment(name)
    parameters = 0.1 * np.random.default_rng(0).normal(size=experiment.num_parameters)
    agent, path = Agent(experiment, parameters), tmp_path / "rollout.mcap"
    benchmark.pedantic(record_rollout, (agent, path, 0), rounds=5, warmup_rounds=1)
    steps = read(path).topics["/reward"]
    benchmark.extra_info["kB_per_100_steps"] = round(path.stat().st_size / steps / 10, 1)
    benchmark.extra_info["ms_per_step"] = round(1000 * benchmark.stats.stats.median / steps, 2)
