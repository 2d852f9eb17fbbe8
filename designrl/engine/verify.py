"""Compares the compiled engine with Box2D, bit for bit.

    python -m designrl.engine.verify                 2,000 episodes; exit code 1 on a difference
    python -m designrl.engine.verify --episodes 200 --seed 5

Each episode is run in the Gymnasium environment and in the engine: every observation, the return
and the length must have the same bits. Designs, policies and seeds are random; policies are random
networks, some of other sizes than the experiments', and the author's trained ones where there is a
zoo (ZOO, DESIGNRL_ZOO or ../shared/zoo). All kinds of episode take turns: both terrains, both
LIDARs, with and without shaped rewards and those of smaller legs.
"""

import argparse
import json
import os
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import gymnasium
import numpy as np
from tqdm import tqdm

import designrl  # noqa: F401 (registers the environments)
from designrl import engine
from designrl.design import leg_area_reward_factor
from designrl.experiments import Network, get_experiment
from designrl.policy import Agent
from designrl.simulation import engine_task
from designrl.simulation.reference import run_episode

WEIGHT_STDS = (0.1, 0.5, 1.0)  # of random networks
NETWORK = get_experiment("biped-morphology").network
OTHER_NETWORKS = (Network((24, 16, 4)), Network((24, 4)), Network((24, 64, 32, 4), "linear"))
ZOO_FILES = {
    "biped": "biped",
    "biped-morphology": "augmentbiped",
    "biped-morphology-smaller-leg": "augmentbipedsmalllegs",
    "biped-hardcore": "bipedhard",
    "biped-hardcore-morphology": "augmentbipedhard",
    "biped-hardcore-morphology-smaller-leg": "augmentbipedhardsmalllegs",
}


@dataclass(frozen=True)
class Case:
    """One episode to compare.

    Attributes:
        kind: what the policy is, for the report.
        hardcore, lidar, shaped, leg_area_reward: the task and its rewards.
        parameters: (P,) flat vector of network and design.
        seed: of the episode.
        network: of the policy.
    """

    kind: str
    hardcore: bool
    lidar: str
    shaped: bool
    leg_area_reward: bool
    parameters: np.ndarray
    seed: int
    network: Network = NETWORK

    @property
    def agent(self) -> Agent:
        """The policy in its own body, as the reference runs it."""
        name = "biped-hardcore-morphology" if self.hardcore else "biped-morphology"
        experiment = replace(get_experiment(name), network=self.network)
        return Agent(experiment, self.parameters)


class _Recorder(gymnasium.Wrapper):
    """Keeps the observations of the last episode."""

    def reset(self, **kwargs):
        observation, info = self.env.reset(**kwargs)
        self.observations = [observation]
        return observation, info

    def step(self, action):
        step = self.env.step(action)
        self.observations.append(step[0])
        return step


def run_reference(case: Case) -> tuple[float, int, np.ndarray]:
    """(return, steps, observations (steps + 1, 24)) of one episode in Gymnasium's environment."""
    agent = case.agent
    env = gymnasium.make(
        agent.experiment.env_id,
        disable_env_checker=True,
        lidar=case.lidar,
        leg_area_reward=case.leg_area_reward,
    )
    env = _Recorder(env)
    total, steps = run_episode(env, agent, case.seed, case.shaped)
    return total, steps, np.array(env.observations)


def run_engine(case: Case, isa: str | None = None) -> tuple[float, int, np.ndarray]:
    """The same from the engine."""
    agent = case.agent
    scales = agent.design[None]
    factors = leg_area_reward_factor(scales) if case.leg_area_reward else np.ones(1)
    returns, steps, observations = engine.rollout(
        engine_task(agent.experiment, case.lidar),
        case.network.sizes,
        case.parameters[None, : case.network.num_parameters],
        scales,
        factors,
        np.array([[case.seed]]),
        output_tanh=case.network.output == "tanh",
        shaped=case.shaped,
        threads=1,
        isa=isa,
        observations=True,
    )
    return returns[0, 0], int(steps[0, 0]), observations[0][0]


def difference(reference, compiled) -> str | None:
    """The first difference between two results of a case in words; None if they are equal."""
    total, steps, observations = reference
    for step in range(min(steps, compiled[1]) + 1):
        a, b = observations[step], compiled[2][step]
        wrong = np.flatnonzero(a.view(np.uint32) != b.view(np.uint32))
        if wrong.size:
            i = int(wrong[0])
            return f"step {step}, observation {i}: {a[i]!r} in Box2D, {b[i]!r} in the engine"
    if steps != compiled[1]:
        return f"{steps} steps in Box2D, {compiled[1]} in the engine"
    if total != compiled[0]:
        return f"return {total!r} in Box2D, {compiled[0]!r} in the engine"
    return None


def compare(case: Case) -> tuple[int, str | None]:
    """(steps of the reference, difference or None) of one case."""
    reference = run_reference(case)
    return reference[1], difference(reference, run_engine(case))


def zoo_folder() -> Path | None:
    """Where the author's weights are, if they are here."""
    folder = Path(os.environ.get("ZOO") or os.environ.get("DESIGNRL_ZOO") or "../shared/zoo")
    return folder if folder.is_dir() else None


def zoo_policies() -> list[tuple[str, bool, np.ndarray]]:
    """(name, hardcore, (2812,) parameters) of the author's walkers; empty without a zoo."""
    folder, policies = zoo_folder(), []
    for name, file in ZOO_FILES.items() if folder else ():
        path = folder / f"{file}.json"
        if not path.exists():
            continue
        parameters = np.array(json.loads(path.read_text())[0], dtype=np.float64)
        full = np.zeros(get_experiment("biped-morphology").num_parameters)
        full[: parameters.size] = parameters  # a design parameter of 0 is the original size
        policies.append((name, get_experiment(name).hardcore, full))
    return policies


def make_cases(episodes: int, seed: int = 0) -> list[Case]:
    """Episodes of all kinds in turn; the same ones for the same seed."""
    rng = np.random.default_rng(seed)
    dimensions = get_experiment("biped-morphology").design.size
    kinds = list(product((False, True), ("v2", "v3"), (False, True), (False, True)))
    policies = zoo_policies()
    cases = []
    for i in range(episodes):
        hardcore, lidar, shaped, smaller = kinds[i % len(kinds)]
        # In turn: a random policy, one with another network, a trained one with its own design or
        # another one.
        turn = i // len(kinds) % 3
        network = OTHER_NETWORKS[i % len(OTHER_NETWORKS)] if turn == 1 else NETWORK
        split = network.num_parameters
        parameters = rng.standard_normal(split + dimensions)
        parameters[:split] *= rng.choice(WEIGHT_STDS)
        kind = "random"
        if policies and turn == 2:
            kind, hardcore, trained = policies[i % len(policies)]
            if rng.random() < 0.5:
                parameters = trained
            else:
                parameters[:split] = trained[:split]
        seed = int(rng.integers(2 ** int(rng.choice([10, 31, 63]))))
        cases.append(Case(kind, hardcore, lidar, shaped, smaller, parameters, seed, network))
    return cases


def main(arguments: list[str] | None = None) -> int:
    """The command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m designrl.engine.verify", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--episodes", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0, help="of the designs, policies and seeds")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args(arguments)
    reason = engine.missing_reason()
    if reason:
        print(f"nothing to verify: {reason}", file=sys.stderr)
        return 2
    cases = make_cases(options.episodes, options.seed)
    if zoo_folder() is None:
        print("no zoo of trained policies found: random policies only (set ZOO=folder)")
    isa = engine.instruction_set()
    steps, counts, differences = 0, Counter(), []
    with ProcessPoolExecutor(options.workers) as pool:
        results = pool.map(compare, cases, chunksize=4)
        for case, (length, found) in zip(tqdm(cases, unit="episode"), results, strict=True):
            steps += length
            counts["trained" if case.kind != "random" else "random", case.hardcore] += 1
            if found:
                differences.append((case, found))
    for (kind, hardcore), count in sorted(counts.items()):
        print(f"{count:6d} episodes, {kind} policies, {'hardcore' if hardcore else 'normal'}")
    print(
        f"{len(cases)} episodes, {steps} steps ({isa}): "
        f"{len(cases) - len(differences)} equal in every bit, {len(differences)} different"
    )
    for case, found in differences[:10]:
        case = replace(case, parameters=None)
        print(f"DIFFERENT {found}\n    {case}", file=sys.stderr)
    return 1 if differences else 0


if __name__ == "__main__":
    sys.exit(main())
