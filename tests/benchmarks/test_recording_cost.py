"""What recording a run costs, as a share of the time that its generations take.

    make bench

The generations are the paper's (192 candidates, 16 episodes each) at the start of a run, when
episodes are shortest, on the fastest simulation there is: later, or elsewhere, the share is less.
"""

import time
from itertools import count

import numpy as np
import pytest
from test_recording import generation

from designrl.experiments import get_experiment
from designrl.policy import Agent
from designrl.recording import Generation, RunWriter, read, record_rollout
from designrl.settings import TrainSettings
from designrl.simulation import Simulator

SAMPLE = 16  # candidates that are simulated to learn what a whole population takes
SIGMA = 0.1  # of the first generation


@pytest.mark.parametrize("name", ["biped-morphology", "biped-hardcore-morphology"])
@pytest.mark.benchmark(group="recording a generation")
def test_recording_a_generation(benchmark, name, tmp_path):
    experiment, settings = get_experiment(name), TrainSettings.of(name)
    rng, shape = np.random.default_rng(0), (settings.population, settings.rollouts)
    candidates = rng.normal(0, SIGMA, (SAMPLE, experiment.num_parameters))
    seeds = rng.integers(0, 2**32, (SAMPLE, settings.rollouts))
    with Simulator(experiment) as simulator:
        simulator.rollout(candidates[:2], seeds[:2])
        start = time.perf_counter()
        simulator.rollout(candidates, seeds)
        simulated = (time.perf_counter() - start) * settings.population / SAMPLE

    path = tmp_path / "generations.mcap"
    generations = (((), generation(index, *shape)) for index in count())
    with RunWriter(path, {"experiment": name}) as writer:

        def record(**values):
            writer.generation(Generation(**values))
            writer.flush()

        benchmark.pedantic(record, setup=generations.__next__, rounds=50, warmup_rounds=1)
    recorded, held = benchmark.stats.stats.median, len(read(path).generations)
    benchmark.extra_info["share_of_a_generation"] = f"{100 * recorded / simulated:.3f} %"
    benchmark.extra_info["engine"] = f"{simulator.backend}, 1 core"
    benchmark.extra_info["kB_per_generation"] = round(path.stat().st_size / held / 1000, 1)
    assert held > 50 and recorded < 0.02 * simulated


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
