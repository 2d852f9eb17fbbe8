"""All that decides a training run's result, as data; constant for a run."""

import dataclasses
import shlex
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from numbers import Integral, Real

from designrl.design import DesignSpace
from designrl.envs.tasks import WORLDS, checked_weights
from designrl.errors import InputError
from designrl.experiments import OLD_NAMES, RECIPES, Experiment, get_experiment, register

_KINDS = {  # of a setting: what it may be, and what that is called
    bool: (bool, "true or false"),
    int: (Integral, "a whole number"),
    float: (Real, "a number"),
    str: (str, "a text"),
    dict: (Mapping, "a mapping from reward terms to numbers"),
}
# What older files do not have: they stay as they were, and are gone on with, where it is not set.
LATER = ("design_limit", "design_form", "init", "reward_weights")
ADAM_ALONE = ("sigma_learning_rate", "sigma_change_max", "sigma_decay")  # not in the plain form
# Far beyond what any machine does in a generation; larger numbers are slips of the keyboard.
MAX_EPISODES = 10_000_000


def _setting(default, help: str):  # noqa: A002 (argparse's name)
    return field(default=default, metadata={"help": help})


@dataclass(frozen=True, kw_only=True)
class ReinforceSettings:
    """The optimiser's settings; each default is that of the author's code.

    Raises:
        InputError: a value of another type.
    """

    mirrored: bool = _setting(True, "sample in pairs μ + ε, μ - ε; otherwise independently")
    ranks: bool = _setting(True, "replace returns by centred ranks in [-0.5, 0.5]")
    weight_decay: float = _setting(
        0.005, "a candidate's mean squared weight, times this, is taken from its fitness"
    )
    adam: bool = _setting(
        True,
        "step μ with Adam (β 0.99, 0.999; ε 1e-8) on the pair-difference gradient; otherwise plain "
        "gradient ascent on μ and σ (equation 4)",
    )
    learning_rate: float = _setting(0.01, "α of equation 4, or Adam's step size, at the start")
    learning_rate_decay: float = _setting(1.0, "factor on the learning rate after each update")
    learning_rate_floor: float = _setting(0.0, "the learning rate does not fall below this")
    sigma_start: float = _setting(0.1, "σ of every parameter at the start")
    sigma_learning_rate: float = _setting(
        0.2, "step size of σ in the author's rule; the plain form has one step size for both"
    )
    sigma_change_max: float = _setting(
        0.2, "largest relative change of a σ by one update of the author's rule"
    )
    sigma_decay: float = _setting(0.9995, "factor on every σ above the floor after each update")
    sigma_floor: float = _setting(
        0.02, "σ below this does not decay; the plain form never goes below it"
    )

    def __post_init__(self):
        for name, hint in typing.get_type_hints(type(self)).items():
            value, (kind, *optional) = getattr(self, name), typing.get_args(hint) or (hint,)
            if value is None and types.NoneType in optional:
                continue
            wanted, words = _KINDS[typing.get_origin(kind) or kind]
            if not isinstance(value, wanted) or (kind is not bool and isinstance(value, bool)):
                raise InputError(f"{name.replace('_', '-')} is {value!r}; it must be {words}")
            if hasattr(value, "item"):  # NumPy's numbers are no JSON
                object.__setattr__(self, name, value.item())
        for name in () if self.adam else ADAM_ALONE:
            unset = getattr(ReinforceSettings, name), PLAIN_CHANGES.get(name)
            if getattr(self, name) not in unset:
                words = name.replace("_", "-")
                raise InputError(f"{words} is part of the author's rule; leave it out, or use adam")

    def learning_rate_at(self, generation: int) -> float:
        """The step size of an update, counted from 0."""
        rate = self.learning_rate
        # Not by a power: its last bit depends on the machine's C library.
        for _ in range(generation if self.learning_rate_decay != 1.0 else 0):
            rate *= self.learning_rate_decay
            if rate <= self.learning_rate_floor:
                break
        return max(rate, self.learning_rate_floor)


# What the paper's text writes, in place of the form in the author's code (`--recipe plain`).
PLAIN_CHANGES: dict[str, typing.Any] = {
    "mirrored": False,
    "ranks": False,
    "weight_decay": 0.0,
    "adam": False,
    "learning_rate": 1e-4,  # the paper names α but gives no value
    "sigma_decay": 1.0,
}
AUTHORS = ReinforceSettings()
PLAIN = ReinforceSettings(**PLAIN_CHANGES)


@dataclass(frozen=True, kw_only=True)
class TrainSettings(ReinforceSettings):
    """All that decides a run's result.

    Raises:
        InputError: a value of another type, or out of its range.
    """

    experiment: str
    seed: int = _setting(0, "of everything random")
    generations: int = _setting(
        1000, "updates of the distribution; the last one is always evaluated"
    )
    population: int = _setting(192, "candidates per generation")
    rollouts: int = _setting(16, "episodes per candidate")
    shaped_rewards: bool = _setting(
        False,
        "walkers, in training only: a fall costs nothing and a solved episode earns 100 more, as "
        "in the author's code",
    )
    reward_weights: dict[str, float] | None = _setting(
        None,
        "factors of the reward's terms (default: 1 each), in training and in its evaluations, as "
        "energy=2.0; several are allowed",
    )
    evaluate_every: int = _setting(25, "generations between evaluations")
    evaluation_episodes: int | None = _setting(
        None, "episodes of an evaluation (default: population times rollouts)"
    )
    keep: str = _setting(
        "best",
        "what is evaluated and kept: the generation's best candidate ('best', the author's) or the "
        "distribution's mean ('mean')",
    )
    stop_score: float | None = _setting(
        None, "end the run when an evaluation has this mean, in points (default: never)"
    )
    init: str | None = _setting(
        None,
        "start μ from this agent, a file or a name as `designrl evaluate` takes it (default: from "
        "zeros); σ starts as set",
    )
    design_limit: float | None = _setting(
        None,
        "how far a learned body's dimension may go from its original size: ± so much of it "
        "(default: 0.75, the paper's); with lognormal ones, times or divided by so much "
        "(default: 4)",
    )
    design_form: str | None = _setting(
        None,
        "of a learned body's scales: bounded, 1 ± limit × tanh(p) (default, the paper's), or "
        "lognormal, exp(p) between 1 / limit and limit",
    )

    @classmethod
    def of(cls, experiment: str | Experiment, recipe: str = "paper", **changes) -> "TrainSettings":
        """The settings of an experiment's recipe, with some changed.

        Args:
            experiment: name, or an Experiment, which becomes known by its name.
            recipe: "paper": the paper's numbers, the algorithm of the author's code; "ours": ours,
                one for every seed; "plain": the paper's numbers and equations 3 to 5 as written.

        Raises:
            InputError: unknown experiment or recipe, an experiment with another's name, or a value
                out of its range.
        """
        found = get_experiment(experiment)
        register(found)
        recipe = OLD_NAMES.get(recipe, recipe)
        if recipe not in RECIPES:
            raise InputError(f"recipe is {recipe!r}; it must be one of {', '.join(RECIPES)}")
        base = {**found.paper, **PLAIN_CHANGES} if recipe == "plain" else getattr(found, recipe)
        if changes.get("adam") is False:  # the recipe's settings of what is left out go with it
            base = {name: value for name, value in base.items() if name not in ADAM_ALONE}
        return cls(experiment=found.name, **{**base, **changes})

    def __post_init__(self):
        super().__post_init__()
        experiment = get_experiment(self.experiment)
        if self.keep not in ("best", "mean"):
            raise InputError(f"keep is {self.keep!r}; it must be 'best' or 'mean'")
        if self.shaped_rewards and experiment.shaping is None:
            raise InputError(f"{experiment.name} has no shaped rewards; leave out shaped-rewards")
        self._check_weights(experiment)
        if experiment.design is None and (self.design_limit, self.design_form) != (None, None):
            raise InputError(f"{experiment.name} learns no body; leave out its limit and its form")
        self.space  # noqa: B018 (refuses other limits)
        self._check("seed", 0)
        for name in ("generations", "population", "rollouts", "evaluate_every"):
            self._check(name, 1)
        if self.evaluation_episodes is not None:
            self._check("evaluation_episodes", 1)
        if self.stop_score is not None:
            self._check("stop_score", -1e9, 1e9)
        self._check("weight_decay", 0, 10_000)
        for name in ("learning_rate_floor", "sigma_floor", "sigma_change_max"):
            self._check(name, 0, 10)
        self._check("sigma_learning_rate", 0, 1000)
        for name in ("sigma_start", "sigma_decay", "learning_rate", "learning_rate_decay"):
            self._check(name, 0, 10, above=True)
        for episodes, what in (
            (self.population * self.rollouts, "a generation (population times rollouts)"),
            (self.evaluation_episodes or 1, "an evaluation"),
        ):
            if episodes > MAX_EPISODES:
                raise InputError(
                    f"{what} would be {episodes:,} episodes; it can be at most {MAX_EPISODES:,}"
                )

    def _check_weights(self, experiment: Experiment) -> None:
        if self.reward_weights is None:
            return
        world = WORLDS.get(experiment.env_id)  # an environment of one's own knows its terms itself
        terms = world.reward_terms if world else tuple(self.reward_weights)
        weights = checked_weights(self.reward_weights, terms)
        earns = experiment.training_kwargs.get("leg_area_reward")
        if world and "leg_area" in weights and not earns:
            name = experiment.name
            raise InputError(f"{name} earns nothing with leg_area; leave its weight out")
        if self.shaped_rewards and experiment.shaping:
            experiment.shaping.check(weights)
        object.__setattr__(self, "reward_weights", weights or None)

    def _check(self, name: str, low: float, high: float | None = None, above: bool = False) -> None:
        value = getattr(self, name)
        # Written so that NaN is refused, too.
        if (value > low if above else value >= low) and (high is None or value <= high):
            return
        least = f"above {low}" if above else f"at least {low}"
        most = "" if high is None else f" and at most {high}"
        raise InputError(f"{name.replace('_', '-')} is {value}; it must be {least}{most}")

    def as_dict(self) -> dict:
        """JSON-ready, the same after a round trip."""
        found = dataclasses.asdict(self).items()
        return {name: value for name, value in found if value is not None or name not in LATER}

    @property
    def space(self) -> DesignSpace:
        """The body's dimensions with their limits."""
        own = get_experiment(self.experiment).body.design
        if (self.design_limit, self.design_form) == (None, None):
            return own
        form = self.design_form or own.form
        return replace(own, limit=self.design_limit, form=form, bounds=None)

    def command(self) -> str:
        """The shortest command that gives this run's result."""
        recipe, changes = self.nearest()
        start = f"designrl train {self.experiment} --recipe {recipe} --seed {self.seed}"
        return " ".join([start, *(option(name, x) for name, x in changes.items())])

    def nearest(self) -> tuple[str, dict]:
        """The recipe from which the fewest settings differ, and these."""
        found = []
        for recipe in RECIPES:
            base = vars(TrainSettings.of(self.experiment, recipe, seed=self.seed))
            found.append((recipe, {name: x for name, x in vars(self).items() if x != base[name]}))
        # No option says None.
        return min(found, key=lambda each: (None in each[1].values(), len(each[1])))


def option(name: str, value) -> str:
    """A setting as the command line takes it: "--rollouts 4", "--no-adam"."""
    name = name.replace("_", "-")
    if isinstance(value, bool):
        return f"--{name}" if value else f"--no-{name}"
    if isinstance(value, dict):
        return " ".join(f"--{name.removesuffix('s')} {key}={x!r}" for key, x in value.items())
    return f"--{name} {shlex.quote(str(value))}"
