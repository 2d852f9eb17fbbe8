"""All that decides a training run's result, as data."""

import dataclasses
import json
from dataclasses import dataclass, field

from designrl.errors import InputError
from designrl.experiments import get_experiment


@dataclass(frozen=True)
class ReinforceSettings:
    """What distinguishes the forms of the algorithm; each field's default is the published form."""

    mirrored: bool = True
    """Sample in pairs μ + ε, μ - ε; otherwise independently."""
    ranks: bool = True
    """Replace returns by centred ranks in [-0.5, 0.5]."""
    weight_decay: float = 0.005
    """Subtracted from a candidate's fitness: weight_decay · mean(w²)."""
    decoupled_weight_decay: float = 0.0
    """An update first multiplies μ by 1 - learning_rate · this, as AdamW does (Loshchilov and
    Hutter 2019): unlike weight_decay it adds no noise and shrinks all weights alike."""
    adam: bool = True
    """Step μ with Adam (β 0.99, 0.999; ε 1e-8) on the pair-difference gradient; otherwise plain
    gradient ascent on μ and σ (equation 4)."""
    learning_rate: float = 0.01
    """α of equation 4, or Adam's step size."""
    sigma_start: float = 0.1
    """σ of every parameter at the start."""
    sigma_learning_rate: float = 0.2
    """Step size of σ in the published rule; the plain form uses learning_rate for both."""
    sigma_change_max: float = 0.2
    """Largest relative change of a σ by one update of the published rule."""
    sigma_decay: float = 0.9995
    """Factor on every σ above sigma_floor after each update."""
    sigma_floor: float = 0.02
    """σ below this does not decay; the plain form never goes below it."""


PUBLISHED = ReinforceSettings()
PAPER = ReinforceSettings(
    mirrored=False,
    ranks=False,
    weight_decay=0.0,
    adam=False,
    learning_rate=1e-4,  # the paper names α but gives no value
    sigma_decay=1.0,
)
PRESETS = {"published": PUBLISHED, "paper": PAPER}


# Far beyond what any machine does in a generation; larger numbers are slips of the keyboard.
MAX_EPISODES = 10_000_000

Schedule = tuple[tuple[int, float], ...]
"""A number for each generation: ((0, 1), (600, 4)) is 1 from generation 0 on and 4 from 600 on."""

COUNTS = ("population", "rollouts")
RATES = ("learning_rate", "sigma_decay", "weight_decay", "decoupled_weight_decay")
SCHEDULES = (*COUNTS, *RATES, "shaped_rewards")  # the settings that are schedules


@dataclass(frozen=True)
class TrainSettings:
    """All that decides a run's result; the defaults are the paper's (section 4).

    Those in SCHEDULES are schedules; a plain number is taken for all generations.
    """

    experiment: str
    seed: int = field(default=0, metadata={"help": "of everything random"})
    generations: int | None = field(
        default=None,
        metadata={
            "help": "updates of the distribution; the last one is always evaluated (default: the "
            "paper's)"
        },
    )
    population: Schedule = field(
        default=((0, 192),),
        metadata={
            "help": "candidates per generation; or, to change it on the way, "
            "FIRST,GENERATION:NEXT,... as in 16,600:64 (64 from generation 600 on, counted from 0)"
        },
    )
    rollouts: Schedule = field(
        default=((0, 16),),
        metadata={"help": "episodes per candidate; or a schedule, likewise"},
    )
    preset: str = field(
        default="published",
        metadata={
            "type": str,
            "help": "form of REINFORCE: the published code's, or the paper's plain one ('paper')",
        },
    )
    sigma_start: float | None = field(
        default=None, metadata={"type": float, "help": "σ at the start (default: the preset's)"}
    )
    sigma_decay: Schedule | None = field(
        default=None,
        metadata={
            "help": "factor on σ per update, above 1 to widen it; or a schedule, likewise "
            "(default: the preset's)"
        },
    )
    learning_rate: Schedule | None = field(
        default=None,
        metadata={"help": "step size of μ; or a schedule, likewise (default: the preset's)"},
    )
    weight_decay: Schedule | None = field(
        default=None,
        metadata={
            "help": "a candidate's mean squared weight, times this, is taken from its fitness; or "
            "a schedule, likewise (default: the preset's)"
        },
    )
    decoupled_weight_decay: Schedule | None = field(
        default=None,
        metadata={
            "help": "every update first multiplies μ by 1 - learning rate × this, as AdamW does; "
            "or a schedule, likewise (default: 0, the published code has none)"
        },
    )
    shaped_rewards: Schedule = field(
        default=((0, 1),),
        metadata={
            "help": "walkers, in training only: 1, a fall costs nothing and a solved episode earns "
            "100 more, as in the published code; 0, the environment's rewards, as in the paper's "
            "text; or a schedule, likewise"
        },
    )
    evaluate_every: int = field(default=25, metadata={"help": "generations between evaluations"})
    keep: str = field(
        default="best",
        metadata={
            "type": str,
            "help": "what is evaluated and kept: the generation's best candidate ('best', as "
            "published) or the distribution's mean ('mean')",
        },
    )
    evaluation_episodes: int | None = field(
        default=None,
        metadata={"help": "episodes of an evaluation (default: population times rollouts)"},
    )

    def __post_init__(self):
        experiment = get_experiment(self.experiment)
        if self.generations is None:
            object.__setattr__(self, "generations", experiment.generations)
        if self.preset not in PRESETS:
            raise InputError(f"preset is {self.preset!r}; it must be one of {', '.join(PRESETS)}")
        if self.keep not in ("best", "mean"):
            raise InputError(f"keep is {self.keep!r}; it must be 'best' or 'mean'")
        for name in RATES:
            if getattr(self, name) is None:
                object.__setattr__(self, name, getattr(PRESETS[self.preset], name))
        for name in SCHEDULES:
            schedule = as_schedule(getattr(self, name))
            object.__setattr__(self, name, schedule)
            starts = [start for start, _ in schedule]
            if not starts or starts[0] != 0 or starts != sorted(set(starts)):
                raise InputError(f"the schedule of {name} must start at generation 0 and go up")
        for name, value in (
            ("generations", self.generations),
            ("population", min(count for _, count in self.population)),
            ("rollouts", min(count for _, count in self.rollouts)),
            ("evaluate-every", self.evaluate_every),
            ("evaluation-episodes", self.evaluation_episodes),
        ):
            if value is not None and value < 1:
                raise InputError(f"{name} is {value}; it must be at least 1")
        population, rollouts = (max(n for _, n in getattr(self, name)) for name in COUNTS)
        for episodes, what in (
            (population * rollouts, "a generation (population times rollouts)"),
            (self.evaluation_episodes or 1, "an evaluation"),
        ):
            if episodes > MAX_EPISODES:
                raise InputError(
                    f"{what} would be {episodes:,} episodes; it can be at most {MAX_EPISODES:,}"
                )
        for name, value in (
            ("sigma_start", self.sigma_start),
            *(("sigma_decay", value) for _, value in self.sigma_decay),
            *(("learning_rate", value) for _, value in self.learning_rate),
        ):
            if value is not None and not 0 < value <= 10:  # false for NaN, too
                raise InputError(
                    f"{name.replace('_', '-')} is {value}; it must be above 0 and at most 10"
                )
        for _, value in self.weight_decay:
            if not 0 <= value <= 10_000:
                raise InputError(f"weight-decay is {value}; it must be from 0 to 10000")
        fastest = max(value for _, value in self.learning_rate)
        for _, value in self.decoupled_weight_decay:
            if not 0 <= value * fastest <= 1:
                raise InputError(
                    f"decoupled-weight-decay is {value}; times the learning rate ({fastest:g}) it "
                    "must be from 0 to 1"
                )
        for _, value in self.shaped_rewards:
            if value not in (0, 1):
                raise InputError(f"shaped-rewards is {value}; it must be 0 or 1")
        if self.seed < 0:
            raise InputError(f"the seed is {self.seed}; it must be at least 0")

    @property
    def reinforce(self) -> ReinforceSettings:
        """The preset with this run's changes."""
        changes = {name: self.at(name, 0) for name in RATES}
        if self.sigma_start is not None:
            changes["sigma_start"] = self.sigma_start
        return dataclasses.replace(PRESETS[self.preset], **changes)

    def at(self, name: str, generation: int) -> int | float:
        """What one of the SCHEDULES says of a generation, counted from 0."""
        return _at(getattr(self, name), generation)

    def as_dict(self) -> dict:
        """JSON-ready, the same after a round trip."""
        return json.loads(json.dumps(dataclasses.asdict(self)))

    def command(self, with_defaults: bool = True) -> str:
        """A command that gives this run's result, with a folder and workers of one's own."""
        words = [f"designrl train {self.experiment}", f"--seed {self.seed}"]
        default = TrainSettings(self.experiment)
        for name, value in vars(self).items():
            if name in ("experiment", "seed") or value is None:
                continue
            if with_defaults or value != getattr(default, name):
                text = format_schedule(value) if name in SCHEDULES else value
                words.append(f"--{name.replace('_', '-')} {text}")
        return " ".join(words)


def as_schedule(value) -> Schedule:
    """A plain number, or pairs as JSON gives them, as a schedule."""
    pairs = ((0, value),) if isinstance(value, int | float) else value
    return tuple((int(start), n if isinstance(n, float) else int(n)) for start, n in pairs)


def _at(schedule: Schedule, generation: int) -> int | float:
    return [n for start, n in schedule if start <= generation][-1]


def same_until(one: Schedule, other: Schedule, generation: int) -> bool:
    """Whether two schedules agree in all generations before this one."""
    changes = {start for start, _ in (*one, *other) if start < generation}
    return all(_at(one, start) == _at(other, start) for start in changes)


def format_schedule(schedule) -> str:
    """((0, 1), (600, 4)) -> "1,600:4", as the command line takes it."""
    return ",".join(
        str(count) if start == 0 else f"{start}:{count}" for start, count in as_schedule(schedule)
    )


def describe_schedule(schedule, generations: int) -> str:
    """((0, 1), (600, 4)) -> "1, 4 from generation 600"; what comes after so many is left out."""
    return ", ".join(
        f"{count} from generation {start}" if start else str(count)
        for start, count in as_schedule(schedule)
        if start == 0 or start < generations
    )


def parse_schedule(name: str, text: str) -> Schedule:
    """ "16" -> ((0, 16),); "1,600:4" -> ((0, 1), (600, 4)).

    Raises:
        InputError: not of that form; it names the setting.
    """
    try:
        first, *later = text.split(",")
        number = float if name in RATES else int
        pairs = [item.split(":") for item in later]
        return ((0, number(first)), *((int(start), number(n)) for start, n in pairs))
    except ValueError:
        option, example = name.replace("_", "-"), "0.01,600:0.003" if name in RATES else "1,600:4"
        raise InputError(
            f"{option} is {text!r}; write a number, or FIRST,GENERATION:NEXT as in {example}"
        ) from None
