"""The policy in a rollout: a small tanh network in reproducible arithmetic.

The flat parameter vector holds, layer by layer, the weight matrix (inputs, outputs) in row-major
order and the bias; then the outputs' log-stds where the network has noise; last the design's
parameters, which are not the network's business.

Rollouts compute in float32 in a fixed order, so that every backend and every machine gives the
same bits, in NumPy or, where the engine's library is there, in C++.
"""

import math
import threading
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import gymnasium
import numpy as np

from designrl import engine
from designrl.design import DesignSpace
from designrl.errors import InputError
from designrl.experiments import Experiment, Network
from designrl.numeric import real_numbers, whole_number

# tanh(x) = x P(x²) / Q(x²) on |x| <= 9: a minimax fit of ours, relative error 2.1e-8 in exact
# arithmetic and 3.8e-7 in float32. A rational function of basic operations because those give the
# same bits on every processor, which the vectorised tanh of NumPy, torch or libm do not.
TANH_LIMIT = np.float32(9.0)
TANH_COEFFICIENTS = np.array(
    [
        [1.3354668482179477e-08, 7.776561119499092e-07],
        [2.0609088096534833e-05, 0.00032856353209353983],
        [0.003495588432997465, 0.025876984000205994],
        [0.13381025195121765, 0.4671434164047241],
        [1.0, 1.0],
    ],
    dtype=np.float32,
)  # rows: falling powers of x²; columns: P, Q
_TANH_STEPS = [row[:, None] for row in TANH_COEFFICIENTS]
_ONE = np.float32(1.0)


def tanh32(x: np.ndarray) -> np.ndarray:
    """tanh of a float32 vector (n,) in reproducible arithmetic (each operation rounded once)."""
    x = x.clip(-TANH_LIMIT, TANH_LIMIT)
    square = x * x
    value = _TANH_STEPS[0] * square
    value += _TANH_STEPS[1]
    for coefficient in _TANH_STEPS[2:]:
        value *= square
        value += coefficient
    x *= value[0]
    x /= value[1]
    return x.clip(-_ONE, _ONE)


def noise_stds(log_stds: np.ndarray) -> np.ndarray:
    """Standard deviations (N, A) of the output noise, exp(log_std / 2), none of them infinite."""
    # NumPy's own exponential can have another last bit with AVX-512, and in short arrays.
    largest = math.log(np.finfo(np.float64).max)
    return np.vectorize(math.exp, otypes=[np.float64])(np.minimum(0.5 * log_stds, largest))


def split_layers(network: Network, parameters) -> list:
    """Views of a flat (P,) array or tensor: each layer's weights (in, out) and bias, log-stds."""
    views, start = [], 0
    for inputs, outputs in zip(network.sizes[:-1], network.sizes[1:], strict=True):
        views.append(parameters[start : start + inputs * outputs].reshape(inputs, outputs))
        start += inputs * outputs
        views.append(parameters[start : start + outputs])
        start += outputs
    if network.noise:
        views.append(parameters[start : start + network.sizes[-1]])
    return views


class Step(NamedTuple):
    """One step of an episode.

    Attributes:
        t: counted from 0.
        observation: (O,) what the agent saw before it.
        action: (A,) what it did.
        reward, terminated, truncated, info: what the environment answered.
    """

    t: int
    observation: np.ndarray
    action: np.ndarray
    reward: float
    terminated: bool
    truncated: bool
    info: dict


class _Noise(threading.local):
    """Where an episode's output noise comes from; each thread plays an episode of its own."""

    def __init__(self):
        self.rng = np.random.default_rng()


class Agent:
    """A policy with the body that it learned; threads may share it.

    Args:
        experiment: what it was trained for.
        parameters: (P,) the flat vector, network first, then the design's parameters.
        network: where it differs from the experiment's (the author's original ant).
        metadata: where it came from.
        space: the limits of its body, where they are not the experiment's.

    Attributes:
        file, sha256: that `designrl.load` read it from, and its hash then; None: no file.

    Raises:
        InputError: a network that the experiment does not have, a wrong number of parameters, or
            some that are not finite.
    """

    def __init__(
        self,
        experiment: Experiment,
        parameters: np.ndarray,
        network: Network | None = None,
        metadata: dict | None = None,
        space: DesignSpace | None = None,
    ):
        self.experiment = experiment
        self.space = space or experiment.body.design
        self.network = network or experiment.network
        try:
            self.parameters = real_numbers(parameters)
        except ValueError as error:
            raise InputError(f"parameters must be real numbers ({error})") from None
        self.metadata = metadata or {}
        expected = experiment.parameters_with(self.network)
        if self.parameters.shape != (expected,):
            raise InputError(
                f"{experiment.name} has {expected} parameters, got an array of shape "
                f"{self.parameters.shape}"
            )
        usable = np.abs(self.parameters) <= np.finfo(np.float32).max  # false for NaN
        if not usable.all():
            raise InputError(f"parameter {int(np.argmin(usable))} is not a finite float32 number")
        self._observations = self.network.sizes[0] - (self.network.time_scale is not None)
        self._noise_std = None
        if self.network.noise:
            log_stds = self.parameters[self.network.num_weights : self.network.num_parameters]
            (self._noise_std,) = noise_stds(log_stds[None])
        self._noise = _Noise()

    file: Path | None = None
    sha256: str | None = None

    def __repr__(self) -> str:
        where = f", from {self.file}" if self.file else ""
        return f"<Agent of {self.experiment.name}, {self.parameters.size} parameters{where}>"

    def __reduce__(self):  # the compiled forward pass cannot be pickled
        about = self.experiment, self.parameters, self.network, self.metadata, self.space
        return Agent, about

    @cached_property
    def design(self) -> np.ndarray | None:
        """(D,) scales of the learned body, read-only; None where the experiment learns none."""
        if self.experiment.design is None:
            return None
        scales = self.space.scales(self.parameters[self.network.num_parameters :])
        scales.setflags(write=False)
        return scales

    @property
    def scales(self) -> np.ndarray:
        """(D,) scales of the body it walks with: its design, or ones for the original body."""
        return np.ones(self.experiment.body.design.size) if self.design is None else self.design

    @property
    def env_kwargs(self) -> dict:
        """What `gymnasium.make` needs for its body: nothing, or other `design_bounds`."""
        return bounds_kwargs(self.experiment, self.space)

    def reset(self, seed: int) -> None:
        """Start an episode: the output noise, if any, is a function of the seed alone."""
        if self._noise_std is not None:
            # A stream of its own, apart from the environment's, which starts from the same seed.
            self._noise.rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))

    def act(self, observation: np.ndarray, t: int = 0) -> np.ndarray:
        """Action (A,) float32 for an observation (O,) at step t, counted from 0.

        Sums run over the inputs in order, in float32; see the module's text for why.

        Raises:
            InputError: an observation of another environment, or of no real numbers.
        """
        try:
            x = real_numbers(observation).astype(np.float32)
        except ValueError as error:
            raise InputError(f"an observation must be real numbers ({error})") from None
        if x.shape != (self._observations,):
            raise InputError(
                f"the observation has shape {x.shape}, this agent takes ({self._observations},); "
                f"step {self.experiment.env_id}"
            )
        if self.network.time_scale is not None:
            x = np.append(x, np.float32(t / self.network.time_scale))
        noise = None
        if self._noise_std is not None:
            noise = self._noise.rng.standard_normal(self.network.sizes[-1]) * self._noise_std
            noise = noise.astype(np.float32)
        return self._forward(x, noise)

    def body_with(self, design=None) -> np.ndarray:
        """(D,) scales of the body to walk with.

        Args:
            design: (D,) scales; or a mapping from names to scales, of dimensions that are to differ
                from the agent's own ("bottom leg 2 height": 0.6, of the original size); None: its
                own body.

        Raises:
            InputError: a name or a number of scales that the body does not have. An environment
                refuses what is out of its bounds.
        """
        if design is None:
            return self.scales
        return self.space.changed(self.scales, design)

    def start(self, env: gymnasium.Env, seed: int, design=None) -> np.ndarray:
        """Reset the agent and an environment of its experiment.

        Args:
            design: the body to walk with, as `body_with` takes it; None: its own.

        Returns: the first observation (O,).

        Raises:
            InputError: a seed that is no whole number from 0 on; an environment without the body;
                no design of the body; no design at all, where the environment was made with another
                body than the agent's own.
        """
        seed = whole_number("the seed", seed, 0)
        scales = self.body_with(design)
        given = given_design(env, scales)
        world = env.unwrapped
        body, own = getattr(world, "body", None), self.experiment.body
        another = body is None and world.spec and world.spec.id != self.experiment.env_id
        if another or body not in (None, own):  # it would be walked in without the design
            raise InputError(
                f"{world} does not have the body of {self.experiment.name}; make "
                f"{self.experiment.env_id}"
            )
        if design is None and not np.array_equal(given, scales):
            raise InputError(
                "the environment was made with another body than the agent's own; to walk in that "
                "one, give its design here, too (design=), to walk in its own, make the "
                "environment without design"
            )
        self.reset(seed)
        observation, _ = env.reset(seed=seed, options={"design": scales})
        return observation

    def steps(self, env: gymnasium.Env, observation: np.ndarray) -> Iterator[Step]:
        """Act from a first observation to the episode's end, one `Step` at a time."""
        t, done = 0, False
        while not done:
            action = self.act(observation, t)
            seen = observation
            observation, reward, terminated, truncated, info = env.step(action)
            # Gymnasium promises a number, of any type; environments have floats.
            yield Step(t, seen, action, reward, terminated, truncated, info)  # type: ignore[arg-type]
            done, t = terminated or truncated, t + 1

    def play(self, env: gymnasium.Env, seed: int, design=None) -> Iterator[Step]:
        """A whole episode: `start`, then `steps`."""
        return self.steps(env, self.start(env, seed, design))

    @cached_property
    def _forward(self):
        # (inputs,) and (A,) or None, float32 -> (A,) float32
        network = self.network
        weights = self.parameters[: network.num_weights]
        try:
            return engine.act_function(network.sizes, network.output == "tanh", weights)
        except InputError:  # no library here, or a layer wider than it takes
            return forward_function(network, weights)


def bounds_kwargs(experiment: Experiment, space: DesignSpace) -> dict:
    """The environment's keyword for a body's limits, where they are not the experiment's."""
    bounds = space.limits["bounds"]
    return {} if bounds == experiment.body.design.limits["bounds"] else {"design_bounds": bounds}


def given_design(env: gymnasium.Env, otherwise: np.ndarray):
    """The design that an environment was made with, or was set to; `otherwise` where none was."""
    if not isinstance(env, gymnasium.Env):
        raise InputError(f"the environment is {env!r}; make one with gymnasium.make")
    world = env.unwrapped
    made_with = world.spec.kwargs.get("design") if world.spec else None
    given = getattr(world, "given_design", made_with)  # an environment of one's own has not that
    return otherwise if given is None else given


def forward_function(network: Network, weights: np.ndarray):
    """The network in NumPy: a function of (inputs,) and noise (A,) or None, float32 -> (A,).

    Args:
        weights: (W,) of the layers, without log-stds.
    """
    layers = split_layers(network, weights.astype(np.float32))
    last = len(network.sizes) - 2

    def forward(x: np.ndarray, noise: np.ndarray | None) -> np.ndarray:
        for i in range(last + 1):
            # A reduction over the slow axis adds row after row: the order is fixed.
            x = np.add.reduce(x[:, None] * layers[2 * i], axis=0)
            x += layers[2 * i + 1]
            if i < last:
                x = tanh32(x)
        if noise is not None:
            x += noise
        return tanh32(x) if network.output == "tanh" else x

    return forward
