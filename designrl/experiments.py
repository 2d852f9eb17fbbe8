"""The eight experiments of the paper as data: body, network, training settings."""

import difflib
from dataclasses import dataclass
from functools import cached_property

from designrl.bodies import Body
from designrl.bodies.ant import ANT
from designrl.bodies.walker import WALKER
from designrl.design import DesignSpace
from designrl.errors import InputError


@dataclass(frozen=True)
class Network:
    """A fully connected tanh network.

    Attributes:
        sizes: inputs, hidden layers, outputs. The inputs include the time input, if any.
        output: "tanh" or "linear" activation of the last layer.
        time_scale: steps; the last input is t / time_scale. None: no time input.
        noise: Gaussian noise with std exp(log_std / 2) on the last layer before its activation,
            with one learned log_std per output.
    """

    sizes: tuple[int, ...]
    output: str = "tanh"
    time_scale: float | None = None
    noise: bool = False

    @cached_property
    def num_parameters(self) -> int:
        """Length of the flat vector: weights and biases layer by layer, then the log-stds."""
        layers = zip(self.sizes[:-1], self.sizes[1:], strict=True)
        return sum((n + 1) * m for n, m in layers) + self.noise * self.sizes[-1]


@dataclass(frozen=True)
class Experiment:
    """One of the paper's eight experiments (rows (a) to (h) of Table 3).

    Attributes:
        name: as the commands take it.
        letter, title: row of Table 3.
        env_id: Gymnasium environment.
        body: what it moves.
        network: the policy, as the paper's text gives it.
        learns_design: the body is learned, too.
        leg_area_reward: training reward grows as the legs shrink (section 4.2).
        generations: the paper's number of generations.
        population: candidates per generation (section 4).
        rollouts: episodes per candidate and generation (section 4).
    """

    name: str
    letter: str
    title: str
    env_id: str
    body: Body
    network: Network
    learns_design: bool
    leg_area_reward: bool
    generations: int
    population: int = 192
    rollouts: int = 16

    @property
    def is_walker(self) -> bool:
        """Box2D walker (True) or PyBullet ant (False)."""
        return "Walker" in self.env_id

    @property
    def hardcore(self) -> bool:
        """The walker's terrain has pits, stumps and stairs."""
        return "Hardcore" in self.env_id

    @property
    def networks(self) -> tuple[Network, ...]:
        """Networks that its agents may have: its own, and the published ant's for the ant."""
        return (self.network, PUBLISHED_ANT_NETWORK) if self.name == "ant" else (self.network,)

    @property
    def design(self) -> DesignSpace | None:
        """The dimensions that are learned; None where the body is fixed."""
        return self.body.design if self.learns_design else None

    @property
    def num_parameters(self) -> int:
        """P: network parameters, then design parameters."""
        return self.network.num_parameters + (self.design.size if self.design else 0)


_WALKER_NETWORK = Network((24, 40, 40, 4))
# The paper's text: 28 inputs, hidden layers of 64 and 32. The published code adds a time input and
# learned output noise, and so does every published ant.
_ANT_NETWORK = Network((29, 64, 32, 8), time_scale=1000.0, noise=True)

# The published original ant has wider layers and no output activation, unlike the paper's text.
PUBLISHED_ANT_NETWORK = Network((29, 140, 40, 8), "linear", time_scale=1000.0, noise=True)

_ANT, _BIPED, _HARDCORE = (
    "designrl/Ant-v0",
    "designrl/BipedalWalker-v0",
    "designrl/BipedalWalkerHardcore-v0",
)

EXPERIMENTS: dict[str, Experiment] = {
    experiment.name: experiment
    for experiment in (
        Experiment("ant", "a", "Ant", _ANT, ANT, _ANT_NETWORK, False, False, 3000),
        Experiment(
            "ant-morphology", "b", "Ant + Morphology", _ANT, ANT, _ANT_NETWORK, True, False, 3000
        ),
        Experiment("biped", "c", "Biped", _BIPED, WALKER, _WALKER_NETWORK, False, False, 5000),
        Experiment(
            "biped-morphology",
            "d",
            "Biped + Morphology",
            _BIPED,
            WALKER,
            _WALKER_NETWORK,
            True,
            False,
            5000,
        ),
        Experiment(
            "biped-morphology-smaller-leg",
            "e",
            "Biped + Morphology + Smaller Leg",
            _BIPED,
            WALKER,
            _WALKER_NETWORK,
            True,
            True,
            5000,
        ),
        Experiment(
            "biped-hardcore",
            "f",
            "Biped Hardcore",
            _HARDCORE,
            WALKER,
            _WALKER_NETWORK,
            False,
            False,
            10000,
        ),
        Experiment(
            "biped-hardcore-morphology",
            "g",
            "Biped Hardcore + Morphology",
            _HARDCORE,
            WALKER,
            _WALKER_NETWORK,
            True,
            False,
            10000,
        ),
        Experiment(
            "biped-hardcore-morphology-smaller-leg",
            "h",
            "Biped Hardcore + Morphology + Smaller Leg",
            _HARDCORE,
            WALKER,
            _WALKER_NETWORK,
            True,
            True,
            10000,
        ),
    )
}


def register(experiment: Experiment) -> None:
    """Add an experiment, which commands and recordings then know by its name."""
    EXPERIMENTS[experiment.name] = experiment


def get_experiment(name: str | Experiment) -> Experiment:
    """The experiment of that name.

    Raises:
        InputError: unknown name; the message suggests one of a like name, if any.
    """
    if isinstance(name, Experiment):
        return name
    if name in EXPERIMENTS:
        return EXPERIMENTS[name]
    near = difflib.get_close_matches(str(name), EXPERIMENTS, n=1)
    guess = f"did you mean {near[0]!r}? " if near else ""
    raise InputError(f"unknown experiment {name!r}; {guess}`designrl experiments` lists all")
