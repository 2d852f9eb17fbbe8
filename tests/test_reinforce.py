import os
import subprocess
import sys

import numpy as np
import pytest
import torch

from designrl.errors import InputError
from designrl.reinforce import (
    ADAM_BETAS,
    ADAM_EPSILON,
    AUTHORS,
    PLAIN,
    Reinforce,
    ReinforceSettings,
    adam_step,
    centred_ranks,
    reinforce_gradients,
)


def random_gaussian(parameters=7, candidates=5, seed=0):
    rng = np.random.default_rng(seed)
    mu = torch.tensor(rng.normal(size=parameters), requires_grad=True)
    sigma = torch.tensor(rng.uniform(0.1, 2.0, parameters), requires_grad=True)
    w = torch.tensor(rng.normal(size=(candidates, parameters)))
    return w, mu, sigma


def log_density(w, mu, sigma):
    return torch.distributions.Normal(mu, sigma).log_prob(w).sum(dim=-1)


def test_population_gradient_equals_autograd_of_the_weighted_log_density():
    w, mu, sigma = random_gaussian(candidates=50)
    returns = torch.tensor(np.random.default_rng(1).normal(size=50))
    expected = torch.autograd.grad((returns * log_density(w, mu, sigma)).mean(), (mu, sigma))
    found = reinforce_gradients(returns, w, mu.detach(), sigma.detach())
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)


def test_centred_ranks_are_evenly_spread_and_keep_the_order():
    ranks = centred_ranks(torch.tensor([3.0, -1.0, 10.0, 2.0, 2.0]).double())
    assert ranks.tolist() == [0.25, -0.5, 0.5, -0.25, 0.0]


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("settings", [AUTHORS, PLAIN], ids=["authors", "plain"])
def test_a_quadratic_is_solved(settings, noise):
    rng = np.random.default_rng(3)
    target = np.array([1.0, -0.5, 0.3])
    if settings is PLAIN:
        settings = ReinforceSettings(**{**vars(PLAIN), "learning_rate": 5e-3})
    else:
        settings = ReinforceSettings(weight_decay=0.0)
    optimiser = Reinforce(3, population=64, settings=settings, seed=0)
    start = np.linalg.norm(optimiser.mu.numpy() - target)
    for _ in range(800):
        candidates = optimiser.ask().numpy()
        returns = -((candidates - target) ** 2).sum(axis=1)
        optimiser.tell(returns + noise * 0.1 * rng.standard_normal(64))
    assert np.linalg.norm(optimiser.mu.numpy() - target) < 0.1 * start


def test_weight_decay_pulls_towards_zero_where_returns_say_nothing():
    optimiser = Reinforce(2, population=32, settings=ReinforceSettings(weight_decay=10.0))
    optimiser.mu += 3.0
    for generation in range(200):
        optimiser.tell(np.random.default_rng(generation).standard_normal(32))
    assert abs(optimiser.mu).max() < 2.0


def test_mirrored_candidates_lie_around_the_mean_in_pairs():
    optimiser = Reinforce(4, population=6)
    optimiser.mu += 2.0
    plus, minus = optimiser.ask().chunk(2)
    torch.testing.assert_close((plus + minus) / 2, optimiser.mu.expand(3, 4))


def test_the_step_of_mu_is_adams():
    rng, t = np.random.default_rng(0), torch.zeros(4, dtype=torch.float64)
    adam = torch.optim.Adam([t], lr=0.01, betas=ADAM_BETAS, eps=ADAM_EPSILON, maximize=True)
    moments, ours = np.zeros((2, 4)), np.zeros(4)
    for k in range(1, 50):
        gradient = rng.standard_normal(4)
        t.grad = torch.from_numpy(gradient)
        adam.step()
        step, moments = adam_step(gradient, moments, k)
        ours += 0.01 * step
        np.testing.assert_allclose(ours, t.numpy(), rtol=1e-12)


def test_an_update_has_the_same_bits_whatever_the_processor():
    """MKL, of which torch's products and roots are, adds and rounds otherwise on each."""
    code = """
import hashlib, numpy as np
from designrl.reinforce import AUTHORS, PLAIN, Reinforce
for settings in AUTHORS, PLAIN:
    optimiser = Reinforce(2812, 48, settings)
    for generation in range(20):
        optimiser.tell(np.random.default_rng(generation).standard_normal(48))
    print(hashlib.sha256(b"".join(x.tobytes() for x in optimiser.state().values())).hexdigest())
"""
    kinds = {}, {"MKL_CBWR": "AVX2"}, {"MKL_CBWR": "COMPATIBLE"}, {"ATEN_CPU_CAPABILITY": "avx2"}
    found = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, **kind},
            capture_output=True,
            check=True,
        ).stdout
        for kind in kinds
    }
    assert len(found) == 1


def test_sigma_stops_decaying_at_its_floor():
    settings = ReinforceSettings(sigma_start=0.0201, sigma_learning_rate=0.0)
    optimiser = Reinforce(5, population=8, settings=settings)
    for _ in range(50):
        optimiser.tell(np.zeros(8))
    assert (optimiser.sigma > 0.9995 * 0.02).all()
    assert (optimiser.sigma <= 0.02).all()


def test_sigma_changes_by_a_fifth_at_most():
    optimiser = Reinforce(5, population=8, seed=1)
    before = optimiser.sigma.clone()
    for generation in range(30):
        optimiser.tell(np.random.default_rng(generation).standard_normal(8) * 1e6)
        ratio = optimiser.sigma / before
        assert ((ratio <= 1.2) & (ratio >= 0.8 * AUTHORS.sigma_decay - 1e-12)).all()
        before = optimiser.sigma.clone()


@pytest.mark.parametrize("settings", [AUTHORS, PLAIN], ids=["authors", "plain"])
def test_a_restored_optimiser_goes_on_with_the_same_bits(settings):
    def run(optimiser, generations):
        for _ in range(generations):
            optimiser.tell(-(optimiser.ask().numpy() ** 2).sum(axis=1) * 0.01)

    straight = Reinforce(6, population=10, settings=settings, seed=4)
    run(straight, 20)
    first = Reinforce(6, population=10, settings=settings, seed=4)
    run(first, 11)
    second = Reinforce(6, population=10, settings=settings, seed=4)
    second.restore(first.state())
    run(second, 9)
    for name, array in straight.state().items():
        np.testing.assert_array_equal(array, second.state()[name], err_msg=name)


def test_a_generation_is_a_function_of_seed_and_generation():
    a, b, c = (Reinforce(3, population=4, seed=seed) for seed in (5, 5, 6))
    assert torch.equal(a.ask(), b.ask())
    assert torch.equal(a.ask(), a.ask())
    assert not torch.equal(a.ask(), c.ask())
    first = a.ask()
    a.tell(np.zeros(4))
    assert not torch.equal(first, a.ask())


def test_wrong_input_is_refused():
    with pytest.raises(InputError, match="0 parameters"):
        Reinforce(0)
    with pytest.raises(InputError, match="even"):
        Reinforce(3, population=5)
    optimiser = Reinforce(3, population=4)
    with pytest.raises(InputError, match="4 finite returns"):
        optimiser.tell([1.0, 2.0, 3.0, float("nan")])
    masked = np.ma.masked_array([1.0, 2, 3, 4], mask=[0, 0, 0, 1])
    for returns in ([1.0, 2.0], [1j] * 4, masked, [[1], [2, 3]], [10**400] * 4):
        with pytest.raises(InputError, match="4 finite returns"):
            optimiser.tell(returns)
    with pytest.raises(InputError, match="no longer finite after generation 0"):
        Reinforce(3, 4, settings=ReinforceSettings(sigma_start=1e200, ranks=False)).tell(
            [1, 2, 3, 4]
        )
    with pytest.raises(InputError, match="sigma"):
        optimiser.restore({**optimiser.state(), "sigma": np.ones(2)})
