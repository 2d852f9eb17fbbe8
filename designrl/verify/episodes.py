"""Episodes to compare between the compiled engine and Box2D or PyBullet, bit for bit.

Every observation, the return and the length must have the same bits. Designs, policies and seeds
are random; policies are random networks, some of other sizes than the experiments', and the
author's trained ones where AUTHOR_ZOO names their folder. All kinds of episode take turns: both
terrains, both LIDARs, with and without shaped rewards and those of smaller legs. Ants have random
and trained policies (ours, too), on bodies from the original one to some at all bounds. A fifth of
the episodes has random weights of the reward's terms.
"""

from dataclasses import dataclass, field, replace
from itertools import product

import gymnasium
import numpy as np
from gymnasium.wrappers import TransformObservation

from designrl import author
from designrl.bodies.walker import WALKER
from designrl.design import DesignSpace
from designrl.envs.tasks import ENGINE_SCALES, WORLDS
from designrl.experiments import EXPERIMENTS, Network, get_experiment
from designrl.names import PRETRAINED, load
from designrl.policy import Agent, bounds_kwargs
from designrl.simulation import Episodes, run_engine, run_episode

WEIGHT_STDS = (0.1, 0.5, 1.0)  # of random networks
ANT_WEIGHT_STDS = (0.05, 0.2, 0.6)
TERRAINS = "biped-morphology", "biped-hardcore-morphology"
OTHER_NETWORKS = (Network((24, 16, 4)), Network((24, 4)), Network((24, 64, 32, 4), "linear"))
ANTS = "ant", "ant-morphology"
OTHER_ANT_NETWORKS = (
    Network((28, 64, 32, 8)),  # the paper's text
    Network((29, 16, 8), time_scale=300.0),
    Network((28, 20, 8), "linear", noise=True),
)
WEIGHTED_EVERY = 5  # of the cases; prime to the numbers of kinds, so that each kind has some
# Bodies at their bounds: of short, thick legs and of long, thin ones; per leg 6 lengths, 3 radii.
CORNERS = np.tile([[-1.0] * 6 + [1.0] * 3, [1.0] * 6 + [-1.0] * 3], 4)


@dataclass(frozen=True)
class Case:
    """One episode to compare.

    Attributes:
        kind: what the policy is, for the report.
        experiment: its name.
        parameters: (P,) flat vector of network and design.
        seed: of the episode.
        network: where it is another than the experiment's.
        shaped: with shaped rewards.
        env_kwargs: keywords of the environment.
        space: limits of the body, where they are not the experiment's.
    """

    kind: str
    experiment: str
    parameters: np.ndarray
    seed: int
    network: Network | None = None
    shaped: bool = False
    env_kwargs: dict = field(default_factory=dict)
    space: DesignSpace | None = None

    @property
    def episodes(self) -> Episodes:
        """The kind of episode, as a simulator has it."""
        found = get_experiment(self.experiment)
        network = self.network or found.network
        shaping = found.shaping if self.shaped else None
        kwargs = bounds_kwargs(found, self.space or found.body.design) | self.env_kwargs
        experiment = replace(found, network=network)
        return Episodes(experiment, network, kwargs, shaping, space=self.space)


def on_reference(case: Case) -> tuple[float, int, np.ndarray]:
    """(return, steps, observations (steps + 1, O)) of one episode in Gymnasium's environment."""
    episodes, seen = case.episodes, []

    def keep(observation):
        seen.append(observation)
        return observation

    env_id = episodes.experiment.env_id
    env = gymnasium.make(env_id, disable_env_checker=True, **episodes.env_kwargs)
    agent = Agent(episodes.experiment, case.parameters, episodes.network, space=case.space)
    env = TransformObservation(env, keep, env.observation_space)
    total, steps = run_episode(env, agent, case.seed, episodes.shaping)
    return total, steps, np.array(seen)


def on_engine(case: Case, isa: str | None = None) -> tuple[float, int, np.ndarray]:
    """The same from the engine."""
    returns, steps, observations = run_engine(
        case.episodes,
        case.parameters[None],
        np.array([[case.seed]]),
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
            return (
                f"step {step}, observation {i}: {a[i]!r} in the reference, {b[i]!r} in the engine"
            )
    if steps != compiled[1]:
        return f"{steps} steps in the reference, {compiled[1]} in the engine"
    if total != compiled[0]:
        return f"return {total!r} in the reference, {compiled[0]!r} in the engine"
    return None


def compare(case: Case) -> tuple[int, str | None]:
    """(steps of the reference, difference or None) of one case."""
    reference = on_reference(case)
    return reference[1], difference(reference, on_engine(case))


def author_policies() -> list[tuple[str, np.ndarray]]:
    """(experiment, (2812,) parameters) of the author's walkers; empty without AUTHOR_ZOO."""
    folder, policies = author.zoo(), []
    size = get_experiment(TERRAINS[0]).num_parameters
    for name, experiment in EXPERIMENTS.items():
        if folder and experiment.body is WALKER:
            for path in author.runs(folder, name).values():
                parameters = load(path, name).parameters
                # A design parameter of 0 is the original size.
                policies.append((name, np.pad(parameters, (0, size - parameters.size))))
    return policies


def ant_policies() -> list[tuple[str, np.ndarray, Network]]:
    """(experiment, parameters, network) of the author's ants (AUTHOR_ZOO) and of ours."""
    folder, files = author.zoo(), []
    for name in ANTS:
        files += [(name, path) for path in author.runs(folder, name).values()] if folder else []
        files += [(name, path) for path in sorted((PRETRAINED / name).glob("*.safetensors"))]
    agents = [(name, load(path, name)) for name, path in files]
    return [(name, agent.parameters, agent.network) for name, agent in agents]


def full_manifold_case() -> Case:
    """A short episode in which a part has four contact points, and a fifth takes the place of one.

    Bullet keeps four. That it has to choose is rare, about once in a million steps; here it does so
    twice, and every wrong choice would show.
    """
    seed, experiment = 13954, get_experiment(ANTS[1])
    rng = np.random.default_rng(seed)
    parameters = 0.2 * rng.standard_normal(experiment.num_parameters)
    dimensions = experiment.design.size
    parameters[-dimensions:] = rng.choice([-30.0, 30.0], dimensions)
    return Case("random", experiment.name, parameters, seed)


def make_ant_cases(episodes: int, seed: int = 0) -> list[Case]:
    """Episodes of ants of all kinds in turn; the same ones for the same seed."""
    rng = np.random.default_rng(seed)
    dimensions = get_experiment(ANTS[1]).design.size
    policies, cases = ant_policies(), []
    for i in range(episodes):
        # In turn: two random policies, the second with another network, on bodies from the original
        # to one at its bounds; a trained policy; the same with other noise and, perhaps, body.
        turn = i % 4
        name, trained, network = policies[i // 4 % len(policies)] if policies else (None,) * 3
        kind = f"trained {name}"
        if turn < 2 or not policies:
            kind, name = "random", ANTS[1]
            network = get_experiment(name).network
            if turn == 1:
                network = OTHER_ANT_NETWORKS[i // 4 % len(OTHER_ANT_NETWORKS)]
            trained = rng.choice(ANT_WEIGHT_STDS) * rng.standard_normal(
                network.num_parameters + dimensions
            )
        parameters = trained.copy()
        if turn != 2:
            if network.noise:
                parameters[network.num_weights : network.num_parameters] += rng.choice([-9.0, 3.0])
            # At 30, tanh is 1.
            designs = np.zeros(dimensions), rng.standard_normal(dimensions), *CORNERS * 30.0
            bounds = rng.choice([-30.0, 30.0], dimensions)
            other = (*designs, bounds)[rng.integers(len(designs) + 1)]
            if name == ANTS[1] and (turn < 2 or rng.random() < 0.5):
                parameters[network.num_parameters :] = other
        episode = int(rng.integers(2 ** int(rng.choice([10, 31, 63]))))
        cases.append(Case(kind, name, parameters, episode, network))
    return _weighted(cases, seed)


def with_other_limits(cases: list[Case], seed: int = 0) -> list[Case]:
    """Cases on bodies of other limits: of the author's second form, and of all that the engine has.

    In turn: within the limits, at them, at them or original, and as thin or as thick as they go.
    """
    rng = np.random.default_rng(seed)
    limits = {"form": "lognormal"}, {"bounds": ENGINE_SCALES}
    changed = []
    for i, case in enumerate(cases):
        found = get_experiment(case.experiment)
        if not found.learns_design:
            found = next(
                e for e in EXPERIMENTS.values() if e.learns_design and e.body is found.body
            )
        network = case.network or found.network
        space = replace(found.body.design, **limits[i % 2])
        designs = (
            rng.uniform(-1.4, 1.4, space.size),
            rng.choice([-30.0, 30.0], space.size),
            rng.choice([-30.0, 0.0, 30.0], space.size),
            np.full(space.size, rng.choice([-30.0, 30.0])),
        )
        parameters = np.concatenate(
            [case.parameters[: network.num_parameters], designs[i // 2 % len(designs)]]
        )
        changed.append(
            replace(
                case, experiment=found.name, parameters=parameters, network=network, space=space
            )
        )
    return changed


def make_cases(episodes: int, seed: int = 0) -> list[Case]:
    """Episodes of walkers of all kinds in turn; the same ones for the same seed."""
    rng = np.random.default_rng(seed)
    kinds = list(product(TERRAINS, ("v2", "v3"), (False, True), (False, True)))
    policies = author_policies()
    cases = []
    for i in range(episodes):
        experiment, lidar, shaped, smaller = kinds[i % len(kinds)]
        # In turn: a random policy, one with another network, a trained one with its own design or
        # another one.
        turn = i // len(kinds) % 3
        own = get_experiment(experiment).network
        network = OTHER_NETWORKS[i % len(OTHER_NETWORKS)] if turn == 1 else own
        split = network.num_parameters
        parameters = rng.standard_normal(split + WALKER.design.size)
        parameters[:split] *= rng.choice(WEIGHT_STDS)
        kind = "random"
        if policies and turn == 2:
            kind, trained = policies[i % len(policies)]
            experiment = TERRAINS["hardcore" in kind]
            if rng.random() < 0.5:
                parameters = trained
            else:
                parameters[:split] = trained[:split]
        episode = int(rng.integers(2 ** int(rng.choice([10, 31, 63]))))
        about = {"lidar": lidar, "leg_area_reward": smaller}
        cases.append(Case(kind, experiment, parameters, episode, network, shaped, about))
    return _weighted(cases, seed)


def _weighted(cases: list[Case], seed: int) -> list[Case]:
    """The cases, every fifth with weights of some of the reward's terms."""
    rng, cases = np.random.default_rng([seed, WEIGHTED_EVERY]), list(cases)
    for i in range(WEIGHTED_EVERY - 1, len(cases), WEIGHTED_EVERY):
        case = cases[i]
        terms = WORLDS[get_experiment(case.experiment).env_id].reward_terms
        chosen = {name: rng.normal(1.0, 2.0) for name in terms if rng.random() < 0.6}
        if case.shaped:
            chosen.pop("fall", None)  # it costs nothing there
        cases[i] = replace(case, env_kwargs={**case.env_kwargs, "reward_weights": chosen})
    return cases
