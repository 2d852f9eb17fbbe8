"""Compares the compiled engine with Box2D and PyBullet, bit for bit.

    python -m designrl.verify                 exit code 1 on a difference
    python -m designrl.verify --episodes 200 --steps 5000 --seed 5

Each episode is run in the Gymnasium environment and in the engine (`designrl.verify.episodes`); a
third are ants' episodes, and a third of all is run again on bodies of other limits. Then the vector
environments run beside SyncVectorEnv over single ones (`designrl.verify.vector`).
"""

import argparse
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial

from designrl import author, engine
from designrl.errors import MissingPartError, optional
from designrl.experiments import get_experiment
from designrl.provenance import core_count
from designrl.verify.episodes import (
    compare,
    full_manifold_case,
    make_ant_cases,
    make_cases,
    with_other_limits,
)
from designrl.verify.vector import VECTOR_CASES, compare_vector


def main(arguments: list[str] | None = None) -> int:
    """The command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m designrl.verify", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--episodes", type=int, default=3000)
    parser.add_argument("--steps", type=int, default=100_000, help="of each vector environment")
    parser.add_argument("--seed", type=int, default=0, help="of the designs, policies and seeds")
    parser.add_argument("--workers", type=int, default=core_count())
    options = parser.parse_args(arguments)
    try:
        if reason := engine.missing_reason():
            raise MissingPartError(f"nothing to verify: {reason}")
        with optional("the comparison", "train"):
            import Box2D  # noqa: F401
            import pybullet  # noqa: F401
            from tqdm import tqdm
    except MissingPartError as error:
        print(error, file=sys.stderr)
        return 2
    ants = options.episodes // 3
    cases = make_cases(options.episodes - ants, options.seed)
    cases += make_ant_cases(ants, options.seed)
    # A third of both again, with bodies of other limits than the paper's.
    cases += with_other_limits(cases[::3], options.seed)
    cases.append(full_manifold_case())
    if author.zoo() is None:
        print("random policies and our ants only; AUTHOR_ZOO=folder adds the author's")
    weighted = sum(bool(case.env_kwargs.get("reward_weights")) for case in cases)
    isa = engine.instruction_set()
    steps, counts, differences = 0, Counter(), []
    with ProcessPoolExecutor(options.workers) as pool:
        results = pool.map(compare, cases, chunksize=4)
        for case, (length, found) in zip(tqdm(cases, unit="episode"), results, strict=True):
            steps += length
            kind = "random" if case.kind == "random" else "trained"
            space = case.space or get_experiment(case.experiment).body.design
            counts[kind, case.experiment, space.in_words] += 1
            if found:
                differences.append((case, found))
    for (kind, experiment, limits), count in sorted(counts.items()):
        print(f"{count:6d} episodes, {kind} policies, {experiment}, bodies {limits}")
    print(
        f"{len(cases)} episodes, {weighted} of them with reward weights, {steps} steps ({isa}): "
        f"{len(cases) - len(differences)} equal in every bit, {len(differences)} different"
    )
    for case, found in differences[:10]:
        print(f"DIFFERENT {found}\n    {replace(case, parameters=None)}", file=sys.stderr)
    wrong = verify_vectors(options.steps, options.seed, options.workers)
    return 1 if differences or wrong else 0


def verify_vectors(steps: int, seed: int, workers: int) -> int:
    """Compare all vector environments and print what came out; the number that differ."""
    cases, wrong = [replace(case, seed=seed) for case in VECTOR_CASES], 0
    with ProcessPoolExecutor(workers) as pool:
        results = pool.map(partial(compare_vector, steps=steps), cases)
        for case, found in zip(cases, results, strict=True):
            print(
                f"{case}, {steps} steps: {f'DIFFERENT {found}' if found else 'equal'}", flush=True
            )
            wrong += found is not None
    print(f"{len(cases)} vector environments: {len(cases) - wrong} equal in every bit")
    return wrong


if __name__ == "__main__":
    sys.exit(main())
