import copy
import multiprocessing
import os
import pickle
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from designrl.bodies.walker import WALKER
from designrl.envs.tasks import leg_area_reward_factor
from designrl.envs.walker import Walker
from designrl.errors import InputError
from designrl.evaluation import episode_seeds, evaluate
from designrl.experiments import AUTHOR_ANT_NETWORK, get_experiment
from designrl.policy import Agent
from designrl.recording import read, record_rollout
from designrl.simulation import PIECES_PER_WORKER, CandidateError, Simulator, _pieces
from designrl.viewer.layout import tab_titles
from designrl.workers import ProcessWorkers, TaskError


def candidates(name, count, seed=0, scale=0.3):
    size = get_experiment(name).num_parameters
    return scale * np.random.default_rng(seed).standard_normal((count, size))


def test_rollout_is_the_episode_that_a_user_would_run():
    name = "biped-hardcore-morphology"
    parameters = candidates(name, 2)
    seeds = np.array([[3, 4], [5, 6]])
    with Simulator(name, backend="reference") as simulator:
        result = simulator.rollout(parameters, seeds)
    for i, j in np.ndindex(2, 2):
        agent = Agent(get_experiment(name), parameters[i])
        env = gymnasium.make(agent.experiment.env_id, design=agent.design)  # not our own loop
        observation, _ = env.reset(seed=int(seeds[i, j]))
        total, steps, ended = 0.0, 0, False
        while not ended:
            action = agent.act(observation, steps)
            observation, reward, terminated, truncated, _ = env.step(action)
            total, steps, ended = total + reward, steps + 1, terminated or truncated
        assert (result.returns[i, j], result.steps[i, j]) == (total, steps)


def test_results_do_not_depend_on_the_number_of_workers():
    parameters = candidates("biped-morphology", 3)
    seeds = np.arange(12).reshape(3, 4)
    one = Simulator("biped-morphology", "reference").rollout(parameters, seeds)
    with Simulator("biped-morphology", "reference", workers=3) as simulator:
        more = simulator.rollout(parameters, seeds)
    np.testing.assert_array_equal(more.returns, one.returns)
    np.testing.assert_array_equal(more.steps, one.steps)


def test_shaped_rewards_forgive_the_fall_and_add_a_hundred_to_a_solved_episode(author_agent):
    parameters = np.array([*candidates("biped", 4), author_agent("biped").parameters])
    seeds = np.arange(5)[:, None]
    with Simulator("biped", "reference") as simulator:
        plain = simulator.rollout(parameters, seeds)
        shaped = simulator.rollout(parameters, seeds, shaped=True)
    changed = plain.steps < 1600
    assert changed[:4].any() and plain.returns[4] > 300
    changed[4] = True
    np.testing.assert_allclose(shaped.returns - plain.returns, np.where(changed, 100.0, 0.0))
    np.testing.assert_array_equal(plain.steps, shaped.steps)


def test_smaller_legs_multiply_the_rewards_of_training_only():
    name = "biped-morphology-smaller-leg"
    parameters, seeds = candidates(name, 3, scale=0.5), np.arange(3)[:, None]
    with Simulator(name, "reference") as simulator:
        forgiven = simulator.rollout(parameters, seeds, shaped=True)
        scaled = simulator.rollout(parameters, seeds, training=True, shaped=True)
    design = get_experiment(name).design
    factor = leg_area_reward_factor(design.scales(parameters[:, -8:]))
    np.testing.assert_allclose(scaled.returns[:, 0], factor * forgiven.returns[:, 0])


@pytest.mark.parametrize(
    ("name", "weights"),
    [
        ("biped-hardcore-morphology-smaller-leg", {"energy": 2.0, "fall": 0.3, "leg_area": -1.5}),
        ("ant-morphology", {"progress": 0.7, "electricity": 3.0, "stall": 0.0}),
    ],
)
def test_weighted_rewards_have_the_same_bits_in_the_engine_and_in_the_reference(name, weights):
    parameters, seeds = candidates(name, 3), np.arange(6).reshape(3, 2)
    results = []
    for backend in ("engine", "reference"):
        with Simulator(name, backend, reward_weights=weights) as simulator:
            assert simulator.backend == backend
            results += [simulator.rollout(parameters, seeds, training=t) for t in (False, True)]
    with Simulator(name) as simulator:
        plain = simulator.rollout(parameters, seeds)
    for ours, theirs in (results[::2], results[1::2]):
        np.testing.assert_array_equal(ours.returns, theirs.returns)
        np.testing.assert_array_equal(ours.steps, plain.steps)
        assert (ours.returns != plain.returns).all()


@pytest.mark.parametrize("backend", ["engine", "reference"])
def test_shaped_rewards_have_weights_but_of_what_costs_nothing(backend):
    parameters, seeds = candidates("biped", 2), np.zeros((2, 1), dtype=int)
    with Simulator("biped", backend, reward_weights={"energy": 0.0}) as simulator:
        simulator.rollout(parameters, seeds, shaped=True)
    with Simulator("biped", backend, reward_weights={"fall": 0.0}) as simulator:
        simulator.rollout(parameters, seeds)
        with pytest.raises(InputError, match="a fall costs nothing; leave its weight out"):
            simulator.rollout(parameters, seeds, shaped=True)


def test_an_evaluation_says_which_weights_it_had():
    agent = Agent(get_experiment("biped"), candidates("biped", 1)[0])
    weighted = evaluate(agent, 2, reward_weights={"energy": 2.0})
    assert weighted.summary()["reward_weights"] == {"energy": 2.0}
    assert "reward_weights" not in evaluate(agent, 2).summary()


@pytest.mark.parametrize(
    ("name", "dimension"),
    [("biped-hardcore-morphology", "bottom leg 2 height"), ("ant", "back left bottom radius")],
)
def test_a_changed_body_scores_the_same_in_every_way(name, dimension, tmp_path):
    agent = Agent(get_experiment(name), candidates(name, 1)[0])
    body, change = agent.experiment.body, {dimension: 0.6}
    scales = agent.scales.copy()
    scales[body.design.names.index(dimension)] = 0.6
    engine = evaluate(agent, episodes=4, seed=1, design=change)
    assert engine.changed == change and engine.summary()["design"] == scales.tolist()
    own = evaluate(agent, episodes=4, seed=1)
    assert own.changed == {} and not np.array_equal(own.scores, engine.scores)
    reference = evaluate(agent, episodes=4, seed=1, design=scales, backend="reference")
    assert (engine.backend, reference.backend) == ("engine", "reference")
    np.testing.assert_array_equal(engine.scores, reference.scores)
    np.testing.assert_array_equal(engine.steps, reference.steps)

    seed, path = int(episode_seeds(1, 1)[0]), tmp_path / "rollout.mcap"
    env = gymnasium.make(agent.experiment.env_id, design=scales)
    for design in (change, scales):
        played = agent.play(env, seed, design)
        assert sum(step.reward for step in played) == pytest.approx(engine.scores[0], rel=1e-12)
    assert record_rollout(agent, path, seed, design=change) == engine.scores[0]
    recording = read(path)
    assert recording.about("changed") == change
    assert (
        recording.about("body")[dimension] == body.design.dimensions(scales)[scales != agent.scales]
    )
    assert f"{dimension} = 0.6" in tab_titles([recording])[0]
    assert f"{dimension} = 0.6" in recording.first("/robot_description")
    record_rollout(agent, tmp_path / "own.mcap", seed)
    assert tab_titles([read(tmp_path / "own.mcap")]) == [name]


def test_an_agent_passes_over_no_design_that_was_chosen():
    agent = Agent(get_experiment("biped-morphology"), candidates("biped-morphology", 1)[0])
    other = agent.body_with({"top leg 1 width": 0.5})
    make = partial(gymnasium.make, agent.experiment.env_id)
    changed = make()
    changed.unwrapped.design = other
    refusing = [make(design=other), Walker(design=other), changed]
    refusing += [copy.deepcopy(env) for env in refusing]
    for env in refusing:
        with pytest.raises(InputError, match=r"give its design here, too .* without design"):
            agent.start(env, 0)
        agent.start(env, 0, other)
        np.testing.assert_array_equal(env.unwrapped.design, other)
        agent.start(env, 0, agent.scales)
    env = make()
    accepting = [env, make(design=agent.scales.tolist()), copy.deepcopy(env)]
    for env in accepting:  # also after an episode of another agent
        env.reset(options={"design": other})
        agent.start(env, 0)
        np.testing.assert_array_equal(env.unwrapped.design, agent.scales)
    for wrong in ([1.0] * 7, {"top leg 1 widht": 1.0}, {"top leg 1 width": 2.0}):
        for use in (partial(agent.start, env, 0), partial(evaluate, agent, 1)):
            with pytest.raises(InputError, match="8 scales|did you mean 'top leg 1 width'|is 2.0"):
                use(design=wrong)


@pytest.mark.parametrize("env_id", ["BipedalWalker-v3", "designrl/Ant-v0"])
def test_an_agent_walks_in_no_environment_without_its_body(env_id):
    agent = Agent(get_experiment("biped-morphology"), candidates("biped-morphology", 1)[0])
    with pytest.raises(InputError, match="does not have the body .* make designrl/BipedalWalker"):
        agent.start(gymnasium.make(env_id), 0)
    agent.start(gymnasium.make("designrl/BipedalWalkerHardcore-v0"), 0)


@pytest.mark.parametrize("backend", ["engine", "reference"])
def test_design_bounds_are_limits_of_the_candidates_bodies(backend):
    name, bounds = "biped-morphology", (0.25, 4.0)
    parameters, results = candidates(name, 1), []
    parameters[:, -8:] = 0.9
    for limits in ({}, {"design_bounds": bounds}, {"space": WALKER.design.within(bounds)}):
        with Simulator(name, backend, **limits) as simulator:
            results.append(float(simulator.rollout(parameters, [[0]]).returns[0, 0]))
    assert results[0] != results[1] == results[2]
    agent = Agent(get_experiment(name), parameters[0])
    with pytest.raises(InputError, match=r"is 1.53.*; each must be in \[0.5, 1.5\]"):
        evaluate(agent, 1, backend=backend, design_bounds=(0.5, 1.5))


def test_bodies_beyond_the_engines_run_on_the_reference(capsys):
    experiment = get_experiment("biped-morphology")
    space = replace(experiment.body.design, form="lognormal", limit=8.0)
    with Simulator(experiment, space=space) as simulator:
        assert simulator.backend == "reference"
    said = capsys.readouterr().err
    assert said.startswith(
        "designrl: the compiled engine is verified for bodies of 0.05 to 5 times"
    )
    with Simulator(experiment, space=replace(space, limit=4.0)) as simulator:
        assert simulator.backend == "engine"
        parameters = candidates(experiment.name, 1)
        with pytest.raises(InputError, match=r"is 4.5; each must be in \[0.25, 4.0\]"):
            simulator.rollout(parameters, [[0]], design=[4.5] * 8)
        found = simulator.rollout(parameters, [[0]], design=[3.5] * 8)
    agent = Agent(experiment, parameters[0])
    wide = {"design": [3.5] * 8, "design_bounds": (0.25, 4.0)}
    env = gymnasium.make(experiment.env_id, design_bounds=(0.25, 4.0))
    played = sum(step.reward for step in agent.play(env, 0, [3.5] * 8))
    assert played == pytest.approx(found.returns[0, 0])
    for backend in ("engine", "reference"):
        assert evaluate(agent, 1, backend=backend, **wide).design[0] == 3.5
    with pytest.raises(InputError, match=r"is 3.5; each must be in \[0.25, 1.75\]"):
        evaluate(agent, 1, design=[3.5] * 8)


def test_fewer_episodes_are_the_first_of_more():
    np.testing.assert_array_equal(episode_seeds(3, 10), episode_seeds(3, 100)[:10])
    assert len(set(episode_seeds(0, 1000))) == 1000


TASKS = [(slice(i, i + 1),) for i in range(6)]
CANDIDATES = np.arange(6.0)[:, None]


def square_but(what, marker, candidates):
    """The square of candidate 3 after something else has happened, once or every time."""
    if candidates[0, 0] == 3 and not Path(marker).exists():
        if marker.endswith("once"):
            Path(marker).touch()
        if what == "dies":
            os._exit(1)
        elif what == "hangs":
            time.sleep(1000)
        raise RuntimeError("something\nhappened")
    return candidates[0, 0] ** 2


@pytest.fixture
def pool():
    with closing(ProcessWorkers(2)) as workers:
        yield workers
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("what", ["dies", "hangs", "raises"])
def test_a_task_is_done_again_and_named_where_it_fails_each_time(what, pool, tmp_path, capsys):
    seconds = 1 if what == "hangs" else 600
    run = partial(pool.run, candidates=CANDIDATES, tasks=TASKS, seconds=seconds)
    once, always = (partial(square_but, what, str(tmp_path / n)) for n in ("once", "always"))
    assert dict(run(once)) == {i: i * i for i in range(6)}
    assert capsys.readouterr().err.count("it is done again\n") == 1
    with pytest.raises(TaskError, match="something" if what == "raises" else "died") as caught:
        dict(run(always))
    assert caught.value.index == 3
    assert capsys.readouterr().err.count("\n") == 2


@pytest.mark.parametrize("noticed", [False, True])
def test_workers_that_were_killed_while_idle_are_replaced_and_no_task_is_lost(pool, noticed):
    for _ in range(2):
        assert dict(pool.run(np.sum, CANDIDATES, TASKS, 60)) == dict(enumerate(range(6)))
        for process in multiprocessing.active_children():
            process.kill()
        if noticed:  # the pools know before they get the next task
            while not all(executor._broken for executor in pool._pools):
                time.sleep(0.01)


def test_a_script_without_a_guard_is_told_so(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import numpy as np\nfrom designrl.workers import ProcessWorkers\n"
        "print(dict(ProcessWorkers(2).run(np.sum, np.ones((2, 1)), [(slice(2),)] * 4, 60)))"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert done.returncode == 1 and done.stderr.count("Traceback") == 1
    last = done.stderr.splitlines()[-1]
    assert "processes do not start" in last and 'if __name__ == "__main__":' in last


@pytest.mark.parametrize("way", ["-c", "-"], ids=["notebook", "stdin"])
def test_an_environment_of_a_notebook_runs_in_worker_processes_too(way):
    code = (  # whose classes no other process can import
        "import dataclasses, gymnasium, numpy as np\n"
        "from designrl.envs.walker import Walker\n"
        "from designrl.experiments import get_experiment\n"
        "from designrl.simulation import Simulator\n"
        "class Mine(Walker): pass\n"
        "gymnasium.register('Mine-v0', entry_point=Mine, max_episode_steps=20)\n"
        "mine = dataclasses.replace(get_experiment('biped'), name='mine', env_id='Mine-v0')\n"
        "candidates, seeds = np.zeros((2, 2804)), np.arange(4).reshape(2, 2)\n"
        "for workers in (1, 2):\n"
        "    with Simulator(mine, 'reference', workers=workers) as simulator:\n"
        "        print(simulator.rollout(candidates, seeds).returns.tolist())\n"
    )
    command = [sys.executable, way, *([code] if way == "-c" else [])]
    done = subprocess.run(command, input=code, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    alone, beside = done.stdout.splitlines()
    assert alone == beside


def test_workers_end_when_their_parent_is_killed(tmp_path):
    code = (
        "import sys; sys.path.insert(0, 'tests'); from test_simulation import *\n"
        "workers = ProcessWorkers(2); run = workers.run(np.sum, CANDIDATES, TASKS, 60); next(run)\n"
        "print(*[p.pid for p in multiprocessing.active_children()], flush=True); time.sleep(1000)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    children = [int(pid) for pid in parent.stdout.readline().split()]
    assert len(children) == 2
    parent.kill()
    parent.communicate()
    end = time.monotonic() + 1800
    while any(map(alive, children)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(map(alive, children))


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_a_candidate_that_cannot_be_simulated_is_named(monkeypatch):
    pieces = [(slice(0, 2), slice(0, 1)), (slice(2, 3), slice(0, 1))]
    monkeypatch.setattr("designrl.simulation._pieces", lambda *_: pieces)
    monkeypatch.setattr("designrl.simulation.run_episode", fail_for_seed_eight)
    with (
        Simulator("biped", "reference") as simulator,
        pytest.raises(CandidateError, match="candidate 1 cannot be simulated: Runtime") as caught,
    ):
        simulator.rollout(candidates("biped", 3), np.array([[7], [8], [9]]))
    for error in (caught.value, pickle.loads(pickle.dumps(caught.value))):
        assert (error.index, error.seeds) == (1, [8])


def fail_for_seed_eight(env, agent, seed, shaping, design):
    if seed == 8:
        raise RuntimeError("the simulator is broken")
    return 0.0, 1


@pytest.mark.parametrize(
    ("n", "r", "workers", "least"),
    [(192, 16, 2, 1), (192, 16, 96, 16), (192, 16, 10_000, 16), (1, 100, 8, 16), (3, 5, 1, 1)],
)
def test_pieces_cover_every_episode_once(n, r, workers, least):
    count = np.zeros((n, r), dtype=int)
    pieces = _pieces(n, r, workers, least)
    for rows, columns in pieces:
        count[rows, columns] += 1
    assert (count == 1).all()
    assert len(pieces) >= min(workers, n * r)
    assert len(pieces) <= 3 * PIECES_PER_WORKER * workers


def test_wrong_input_is_refused():
    for words, arguments in (
        ("backend", {"backend": "gpu"}),
        ("lidar is 'v9'", {"lidar": "v9"}),
        ("biped takes no speed; leave it out", {"speed": 3}),
        ("no reward term 'speed'", {"reward_weights": {"speed": 2.0}}),
        (r"give design to rollout\(\)", {"design": np.ones(8)}),
        *(("workers is .* whole number", {"workers": n}) for n in (0, 1.5, "2", None)),
        ("does not have the network", {"network": AUTHOR_ANT_NETWORK}),
    ):
        for backend in ("engine", "reference"):
            with pytest.raises(InputError, match=words):
                Simulator("biped", **{"backend": backend, **arguments})
    nans = [[0.0] * 2804, [np.nan] * 2804]
    for words, parameters, seeds in (
        ("array of real numbers", np.full((1, 2804), 1j), [[0]]),
        (r"\(N, 2804\)", np.zeros((2, 2812)), [[0], [0]]),
        ("one row per candidate", np.zeros((2, 2804)), [[0], [0], [0]]),
        ("candidate 1: parameter 0 is not a finite", nans, [[0], [0]]),
        *(
            ("a whole number from 0", np.zeros((1, 2804)), seeds)
            for seeds in (
                *([[0.5]], [["a"]], [[-1]], [[2**63]], [[2**70]], [[1, 2], [3]]),
                *(np.zeros((1, 0), dtype=int), np.ma.masked_array([[1]], mask=True)),
            )
        ),
    ):
        with pytest.raises(InputError, match=words):
            Simulator("biped", "reference").rollout(parameters, seeds)
    for wrong in ({"episodes": 0}, {"episodes": 1.5}, {"seed": "1"}):
        with pytest.raises(InputError, match="must be a whole number from"):
            evaluate(Agent(get_experiment("biped"), np.zeros(2804)), **wrong)


@pytest.mark.parametrize("backend", ["engine", "reference"])
@pytest.mark.parametrize("index", [0, 2811])  # a weight, a dimension
def test_both_backends_refuse_what_is_beyond_float32(backend, index):
    parameters = np.zeros((2, 2812))
    parameters[1, index] = 1e39
    with pytest.raises(InputError, match=f"candidate 1: parameter {index} is not a finite float32"):
        Simulator("biped-morphology", backend).rollout(parameters, np.array([[0], [0]]))
    big = np.array([[1], [2**64 - 1]], dtype=np.uint64)
    with pytest.raises(InputError, match="whole number from 0"):
        Simulator("biped-morphology", backend).rollout(np.zeros((2, 2812)), big)


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
def test_the_authors_weights_score_what_the_paper_printed(author_agent, name, mean, std):
    """The proof of the walkers: 100 rollouts, within the sampling error of both means."""
    result = evaluate(author_agent(name), episodes=100, workers=2)
    # Two means of 100 rollouts each, three standard errors, and the paper's rounding to integers.
    tolerance = 3 * np.sqrt((std**2 + result.scores.std() ** 2) / 100) + 1.0
    assert abs(result.scores.mean() - mean) < tolerance
