import gymnasium
import numpy as np
import pytest

from designrl.design import leg_area_reward_factor
from designrl.errors import InputError
from designrl.evaluation import episode_seeds, evaluate
from designrl.experiments import get_experiment
from designrl.policy import Agent
from designrl.simulation import EpisodeRules, Simulator


def candidates(name, count, seed=0, scale=0.3):
    size = get_experiment(name).num_parameters
    return scale * np.random.default_rng(seed).standard_normal((count, size))


def test_rollout_is_the_episode_that_a_user_would_run():
    name = "biped-hardcore-morphology"
    parameters = candidates(name, 2)
    seeds = np.array([[3, 4], [5, 6]])
    with Simulator(name, backend="reference") as simulator:
        result = simulator.rollout(parameters, seeds)
    for i in range(2):
        agent = Agent(get_experiment(name), parameters[i])
        for j in range(2):
            env = gymnasium.make(agent.experiment.env_id, design=agent.design)
            observation, _ = env.reset(seed=int(seeds[i, j]))
            total, steps, ended = 0.0, 0, False
            while not ended:
                observation, reward, terminated, truncated, _ = env.step(
                    agent.act(observation, steps)
                )
                total, steps, ended = total + reward, steps + 1, terminated or truncated
            assert (result.returns[i, j], result.steps[i, j]) == (total, steps)


def test_results_do_not_depend_on_the_number_of_workers():
    parameters = candidates("biped-morphology", 3)
    seeds = np.arange(12).reshape(3, 4)
    results = []
    for workers in (1, 2, 3):
        with Simulator("biped-morphology", "reference", workers=workers) as simulator:
            results.append(simulator.rollout(parameters, seeds))
    for other in results[1:]:
        np.testing.assert_array_equal(other.returns, results[0].returns)
        np.testing.assert_array_equal(other.steps, results[0].steps)


def test_training_forgives_the_fall():
    parameters, seeds = candidates("biped", 4), np.arange(4)[:, None]
    with Simulator("biped", "reference") as simulator:
        plain = simulator.rollout(parameters, seeds)
        training = simulator.rollout(parameters, seeds, EpisodeRules(training=True))
    fell = plain.steps < 1600
    assert fell.any()
    np.testing.assert_allclose((training.returns - plain.returns)[fell], 100.0)
    np.testing.assert_array_equal(plain.steps, training.steps)


def test_training_rewards_a_solved_episode_and_evaluation_does_not(zoo_agent):
    agent = zoo_agent("biped-morphology")
    with Simulator("biped-morphology", "reference") as simulator:
        plain = simulator.rollout(agent.parameters[None], np.array([[0]]))
        training = simulator.rollout(agent.parameters[None], [[0]], EpisodeRules(training=True))
    assert plain.returns[0, 0] > 300
    assert training.returns[0, 0] == pytest.approx(plain.returns[0, 0] + 100)


def test_smaller_legs_multiply_the_rewards_of_training_only():
    name = "biped-morphology-smaller-leg"
    parameters, seeds = candidates(name, 3, scale=0.5), np.arange(3)[:, None]
    with Simulator(name, "reference") as simulator:
        forgiven = simulator.rollout(parameters, seeds, EpisodeRules(training=True))
        scaled = simulator.rollout(parameters, seeds, EpisodeRules(True, leg_area_reward=True))
    design = get_experiment(name).design
    factor = leg_area_reward_factor(design.scales(parameters[:, -8:]))
    np.testing.assert_allclose(scaled.returns[:, 0], factor * forgiven.returns[:, 0])


def test_fewer_episodes_are_the_first_of_more():
    np.testing.assert_array_equal(episode_seeds(3, 10), episode_seeds(3, 100)[:10])
    assert len(set(episode_seeds(0, 1000))) == 1000


def test_a_worker_that_dies_is_replaced_and_its_work_done_again(tmp_path, capsys):
    from designrl.workers import ProcessWorkers

    workers = ProcessWorkers(2)
    tasks = [(str(tmp_path / "died"), i) for i in range(6)]
    assert dict(workers.run(die_once, tasks)) == {i: i * i for i in range(6)}
    assert "done again" in capsys.readouterr().err
    workers.close()


def die_once(marker, i):
    import os
    from pathlib import Path

    if i == 3 and not Path(marker).exists():
        Path(marker).touch()
        os._exit(1)
    return i * i


def test_wrong_input_is_refused():
    with pytest.raises(InputError, match="backend"):
        Simulator("biped", backend="gpu")
    with Simulator("biped", "reference") as simulator:
        with pytest.raises(InputError, match=r"\(N, 2804\)"):
            simulator.rollout(np.zeros((2, 2812)), np.zeros((2, 1)))
        with pytest.raises(InputError, match="one row per candidate"):
            simulator.rollout(np.zeros((2, 2804)), np.zeros((3, 1)))
    agent = Agent(get_experiment("biped"), np.zeros(2804))
    with pytest.raises(InputError, match="at least 1 episode"):
        evaluate(agent, episodes=0)


# The paper's mean ± std over 100 rollouts of the runs whose weights are published (section 4).
@pytest.mark.parametrize(
    ("name", "mean", "std"),
    [
        ("biped", 347, 0.9),
        ("biped-morphology", 359, 0.2),
        ("biped-morphology-smaller-leg", 323, 68),
        ("biped-hardcore", 313, 53),
        ("biped-hardcore-morphology", 335, 37),
        ("biped-hardcore-morphology-smaller-leg", 312, 69),
    ],
)
def test_the_authors_weights_score_what_the_paper_printed(zoo_agent, name, mean, std):
    """The proof of the walkers: 100 rollouts, within the sampling error of both means."""
    result = evaluate(zoo_agent(name), episodes=100, workers=2)
    # Two means of 100 rollouts each, three standard errors, and the paper's rounding to integers.
    tolerance = 3 * np.sqrt((std**2 + result.scores.std() ** 2) / 100) + 1.0
    assert abs(result.scores.mean() - mean) < tolerance
