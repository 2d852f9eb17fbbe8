"""Population-based REINFORCE (Williams 1992, section 6) over a factored Gaussian.

    optimiser = Reinforce(num_parameters, population=192, settings=AUTHORS, seed=0)
    while True:
        candidates = optimiser.ask()       # (N, P), drawn from N(μ, σ²)
        optimiser.tell(returns)            # (N,), one per candidate

Two forms of one class: `PLAIN` is what the paper writes (equations 3 to 5), `AUTHORS` what the
author's code does. The mathematics is in free functions on tensors; the class keeps the state.
"""

import math

import numpy as np

from designrl.errors import InputError, optional
from designrl.numeric import real_numbers
from designrl.settings import AUTHORS, PLAIN, ReinforceSettings

with optional("training", "train", "make setup-train"):
    import torch

__all__ = ["PLAIN", "AUTHORS", "Reinforce", "ReinforceSettings"]

ADAM_BETAS, ADAM_EPSILON = (0.99, 0.999), 1e-8  # the author's code
_NOISE_STREAM = 0  # spawn key of the samples; training's episode seeds have another


def log_density_gradients(
    w: torch.Tensor, mu: torch.Tensor, sigma: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Gradients of log N(w; μ, σ²) by μ and σ, in closed form (equation 5): (N, P) each."""
    deviation = w - mu
    return deviation / sigma**2, (deviation**2 - sigma**2) / sigma**3


def weighted_sum(weights: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
    """Σ over i of weights[i] rows[i], added one after the other; (N,), (N, P) -> (P,)."""
    # A matrix product adds in an order that depends on the processor. In some thousand generations
    # its last bit comes to change the last decimal of a candidate, and with it all that follows.
    return torch.from_numpy((weights.numpy()[:, None] * rows.numpy()).sum(axis=0))


def reinforce_gradients(
    returns: torch.Tensor, w: torch.Tensor, mu: torch.Tensor, sigma: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Estimated gradients of J by μ and σ (equation 3): means of R(w) ∇ log N(w), (P,) each."""
    by_mu, by_sigma = log_density_gradients(w, mu, sigma)
    return weighted_sum(returns, by_mu) / len(w), weighted_sum(returns, by_sigma) / len(w)


def centred_ranks(values: torch.Tensor) -> torch.Tensor:
    """Ranks of (N,) values, spread evenly over [-0.5, 0.5]; equal values rank in their order."""
    ranks = torch.empty_like(values)
    ranks[torch.argsort(values, stable=True)] = torch.arange(len(values), dtype=values.dtype)
    return ranks / (len(values) - 1) - 0.5


def pair_gradient(fitness: torch.Tensor, epsilon: torch.Tensor) -> torch.Tensor:
    """The author's direction for μ: Σ over pairs of (r⁺ - r⁻) ε; (N,), (N/2, P) -> (P,)."""
    plus, minus = fitness.chunk(2)
    return weighted_sum(plus - minus, epsilon)


def pair_sigma_change(
    fitness: torch.Tensor, epsilon: torch.Tensor, sigma: torch.Tensor
) -> torch.Tensor:
    """The author's direction for σ, from pair means against the mean of all; (P,).

    Σ over pairs of ((r⁺ + r⁻)/2 - mean r) (ε² - σ²)/σ, divided by N.
    """
    plus, minus = fitness.chunk(2)
    advantage = (plus + minus) / 2 - fitness.mean()
    return weighted_sum(advantage, (epsilon**2 - sigma**2) / sigma) / len(fitness)


def adam_step(gradient: np.ndarray, moments: np.ndarray, t: int) -> tuple[np.ndarray, np.ndarray]:
    """Step t, from 1, of Adam (Kingma and Ba 2015) at rate 1, (P,), and its moments (2, P)."""
    # Not torch's: the last bit of its square root depends on the processor, see `weighted_sum`.
    (m, v), (b1, b2) = moments, ADAM_BETAS
    m = m + (1 - b1) * (gradient - m)
    v = v * b2 + (1 - b2) * gradient * gradient
    step = m / (np.sqrt(v) / math.sqrt(1 - b2**t) + ADAM_EPSILON) / (1 - b1**t)
    return step, np.stack([m, v])


class Reinforce:
    """The distribution N(μ, σ²) over candidates and its updates.

    Args:
        num_parameters: P.
        population: N, candidates per generation; at least 2, and even where pairs are mirrored.
        settings: AUTHORS, PLAIN or settings of one's own.
        seed: every generation's samples are a function of the seed and the generation.

    Attributes:
        mu, sigma: (P,) float64 tensors.
        generation: updates so far.

    Raises:
        InputError: no parameters, or a population that the settings cannot use.
    """

    def __init__(
        self,
        num_parameters: int,
        population: int = 192,
        settings: ReinforceSettings = AUTHORS,
        seed: int = 0,
    ):
        if num_parameters < 1:
            raise InputError(f"there are {num_parameters} parameters to learn; give at least 1")
        if population < 2 or (settings.mirrored and population % 2):
            raise InputError(
                f"the population is {population}; it must be at least 2"
                + (" and even, for mirrored pairs" if settings.mirrored else "")
            )
        self.settings = settings
        self.seed = seed
        self.population = population
        self.generation = 0
        self._candidates: torch.Tensor | None = None
        self.mu = torch.zeros(num_parameters, dtype=torch.float64)
        self.sigma = torch.full_like(self.mu, settings.sigma_start)
        self._adam = np.zeros((2, num_parameters))

    def ask(self) -> torch.Tensor:
        """(N, P) candidates of this generation; asking again gives the same ones."""
        if self._candidates is None:
            key = (self.generation, _NOISE_STREAM)
            rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))
            count = self.population // 2 if self.settings.mirrored else self.population
            noise = torch.from_numpy(rng.standard_normal((count, len(self.mu))))
            self._epsilon = self.sigma * noise
            both = (self._epsilon, -self._epsilon) if self.settings.mirrored else (self._epsilon,)
            self._candidates = self.mu + torch.cat(both)
        return self._candidates

    def tell(self, returns) -> None:
        """Update μ and σ with the (N,) returns of the candidates of `ask()`.

        Raises:
            InputError: not N finite numbers, or μ or σ have grown out of all bounds.
        """
        try:
            returns = torch.as_tensor(real_numbers(returns))
        except ValueError:
            returns = torch.empty(0)
        if returns.shape != (self.population,) or not torch.isfinite(returns).all():
            raise InputError(f"tell() needs {self.population} finite returns")
        w, s = self.ask(), self.settings
        fitness = centred_ranks(returns) if s.ranks else returns
        fitness = fitness - s.weight_decay * (w**2).mean(dim=1)
        if s.mirrored:
            by_mu = pair_gradient(fitness, self._epsilon)
            by_sigma = pair_sigma_change(fitness, self._epsilon, self.sigma)
        else:
            by_mu, by_sigma = reinforce_gradients(fitness, w, self.mu, self.sigma)
        learning_rate = s.learning_rate_at(self.generation)
        if s.adam:
            step, self._adam = adam_step(by_mu.numpy(), self._adam, self.generation + 1)
            self.mu = self.mu + learning_rate * torch.from_numpy(step)
            limit = s.sigma_change_max * self.sigma
            change = s.sigma_learning_rate * by_sigma
            self.sigma = self.sigma + torch.clamp(change, -limit, limit)
            decayed = s.sigma_decay * self.sigma
            self.sigma = torch.where(self.sigma > s.sigma_floor, decayed, self.sigma)
        else:
            self.mu = self.mu + learning_rate * by_mu
            # The paper does not say what keeps σ positive; a floor is the least that does.
            self.sigma = torch.clamp(self.sigma + learning_rate * by_sigma, min=s.sigma_floor)
        if not torch.isfinite(torch.stack([self.mu, self.sigma])).all():
            raise InputError(
                f"the distribution is no longer finite after generation {self.generation}; use a "
                "smaller learning rate"
            )
        self.generation += 1
        self._candidates = None

    def state(self) -> dict[str, np.ndarray]:
        """All that `restore` needs, as arrays; the two together lose no bit."""
        return {
            "mu": self.mu.numpy().copy(),
            "sigma": self.sigma.numpy().copy(),
            "adam_m": self._adam[0].copy(),
            "adam_v": self._adam[1].copy(),
            "generation": np.array(self.generation, dtype=np.int64),
        }

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on from a `state()`.

        Raises:
            InputError: arrays missing, of other shapes or types, or out of all bounds.
        """
        for name, array in self.state().items():
            found = np.asarray(state.get(name))
            alike = found.shape == array.shape and found.dtype == array.dtype
            if not (alike and np.isfinite(found).all()):
                raise InputError(f"the optimiser's state {name!r} is missing or damaged")
        if state["generation"] < 0 or state["sigma"].min() <= 0 or state["adam_v"].min() < 0:
            raise InputError("the optimiser's state is damaged")
        self.generation = int(state["generation"])
        self.mu = torch.from_numpy(state["mu"].copy())
        self.sigma = torch.from_numpy(state["sigma"].copy())
        self._adam = np.stack([state["adam_m"], state["adam_v"]])
        self._candidates = None
