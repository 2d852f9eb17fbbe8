import pickle

import numpy as np
import pytest

from designrl.errors import InputError
from designrl.experiments import AUTHOR_ANT_NETWORK, EXPERIMENTS, get_experiment
from designrl.policy import Agent, tanh32


def random_agent(name, seed=0, network=None, scale=0.5):
    experiment = get_experiment(name)
    size = experiment.parameters_with(network or experiment.network)
    return Agent(experiment, scale * np.random.default_rng(seed).standard_normal(size), network)


def test_tanh32_is_tanh_to_four_units_in_the_last_place():
    x = np.concatenate([np.linspace(-12, 12, 100_001), np.logspace(-30, 1, 1000)])
    x = x.astype(np.float32)
    np.testing.assert_allclose(tanh32(x), np.tanh(x.astype(np.float64)), rtol=4.8e-7)
    assert abs(tanh32(x)).max() <= 1.0


@pytest.mark.parametrize(
    ("name", "network"),
    [*((name, None) for name in EXPERIMENTS), ("ant", AUTHOR_ANT_NETWORK)],
    ids=[*EXPERIMENTS, "the author's ant"],
)
def test_act_sums_inputs_in_order_in_float32(name, network):
    agent = random_agent(name, network=network)
    agent._noise_std = None
    sizes, timed = agent.network.sizes, agent.network.time_scale is not None
    x = np.random.default_rng(1).standard_normal(sizes[0] - timed).astype(np.float32)
    weights = agent.parameters.astype(np.float32)
    expected, start = np.append(x, np.float32(0.123)) if timed else x, 0
    for inputs, outputs in zip(sizes, sizes[1:], strict=False):
        w = weights[start : start + inputs * outputs].reshape(inputs, outputs)
        start += inputs * outputs
        total = expected[0] * w[0]
        for i in range(1, inputs):
            total = total + expected[i] * w[i]
        expected = total + weights[start : start + outputs]
        start += outputs
        if start < agent.network.num_parameters - outputs or agent.network.output == "tanh":
            expected = tanh32(expected)
    np.testing.assert_array_equal(agent.act(x, t=123), expected)


def test_an_agent_survives_pickling():
    agent = random_agent("ant-morphology")
    agent.act(np.zeros(28))
    again = pickle.loads(pickle.dumps(agent))
    for each in (agent, again):
        each.reset(3)
    np.testing.assert_array_equal(again.act(np.ones(28), 5), agent.act(np.ones(28), 5))


def test_the_authors_ant_has_a_linear_output_and_10176_numbers():
    agent = random_agent("ant", network=AUTHOR_ANT_NETWORK, scale=2.0)
    assert len(agent.parameters) == 10176
    actions = [agent.act(np.ones(28), t) for t in range(20)]
    assert np.abs(actions).max() > 1.0


def test_output_noise_is_a_function_of_the_episodes_seed():
    agent = random_agent("ant-morphology")

    def actions(seed):
        agent.reset(seed)
        return np.array([agent.act(np.zeros(28), t) for t in range(5)])

    np.testing.assert_array_equal(actions(1), actions(1))
    assert (actions(1) != actions(2)).any()
    assert np.ptp(actions(1), axis=0).min() > 0


@pytest.mark.parametrize(
    ("name", "count"),
    [("biped", 2804), ("biped-morphology", 2812), ("ant-morphology", 4308), ("ant", 4272)],
)
def test_parameter_counts_are_the_published_ones(name, count):
    assert get_experiment(name).num_parameters == count


def test_the_body_cannot_be_changed_by_accident():
    with pytest.raises(ValueError, match="read-only"):
        random_agent("biped-morphology").design[0] = 1.0


def test_wrong_parameters_are_refused():
    with pytest.raises(InputError, match="2812 parameters"):
        Agent(get_experiment("biped-morphology"), np.zeros(2804))
    bad = np.zeros(2804)
    bad[17] = np.inf
    with pytest.raises(InputError, match="parameter 17"):
        Agent(get_experiment("biped"), bad)
    for strange in (bad + 1j, np.ma.masked_invalid(bad), [10**400] * 2804, [[1], [2, 3]]):
        with pytest.raises(InputError, match="parameters must be real numbers"):
            Agent(get_experiment("biped"), strange)


def test_an_unknown_experiment_is_answered_with_the_nearest_name():
    with pytest.raises(InputError, match="did you mean 'biped-hardcore'"):
        get_experiment("biped-hardcor")
    with pytest.raises(InputError, match="unknown experiment 'xx'; `designrl experiments`"):
        get_experiment("xx")


def test_an_observation_of_another_environment_is_refused():
    for name, wrong in (("biped", 23), ("ant", 29)):
        agent = Agent(get_experiment(name), np.zeros(get_experiment(name).num_parameters))
        agent.reset(0)
        with pytest.raises(InputError, match=rf"shape \({wrong},\)"):
            agent.act(np.zeros(wrong))
        for strange in (np.zeros(24) + 1j, [[1], [2, 3]]):
            with pytest.raises(InputError, match="an observation must be real numbers"):
                agent.act(strange)
        for seed in (1.5, np.array([3])):
            with pytest.raises(InputError, match="the seed is .* whole number"):
                agent.start(None, seed)
