import dataclasses
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import designrl
from designrl import author, cli, plan, simulation
from designrl import train as train_module
from designrl.author import load_author
from designrl.checkpoint import STATE_FORMAT, describe, load, read_tensors, save, write_tensors
from designrl.envs.tasks import leg_area_reward_factor
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS, get_experiment
from designrl.files import file_hash
from designrl.policy import Agent
from designrl.recording import RunWriter, read
from designrl.reinforce import Reinforce
from designrl.run_folder import RunFolder
from designrl.settings import ReinforceSettings, TrainSettings
from designrl.simulation import Simulator
from designrl.train import TrainingRun, training_seeds

SMALL = {"generations": 5, "population": 4, "rollouts": 2, "evaluate_every": 2}


def settings(experiment="biped-morphology", **changes):
    return TrainSettings.of(experiment, **{**SMALL, "evaluation_episodes": 3, **changes})


def train(folder, experiment="biped-morphology", resume=False, **changes):
    run = TrainingRun(settings(experiment, **changes), folder, resume=resume)
    run.run()
    return run


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The folder of a run that nothing happened to."""
    folder = tmp_path_factory.mktemp("run")
    train(folder)
    return folder


def test_what_recorded_rollouts_lack_is_said_before_anything_is_trained(tmp_path, monkeypatch):
    monkeypatch.setattr("designrl.envs.ant.pybullet", None)
    with pytest.raises(InputError, match="single ants need PyBullet"):
        train(tmp_path / "run", "ant")
    assert not (tmp_path / "run").exists()


def test_a_runs_folder_holds_what_the_design_says(undisturbed):
    names = {path.name for path in undisturbed.iterdir()} - {".lock"}
    assert names == {"best.safetensors", "state.safetensors", "generations.mcap", "rollouts"}
    agent = load(undisturbed / "best.safetensors")
    assert agent.metadata["seed"] == 0
    assert agent.metadata["settings"]["population"] == 4
    assert agent.metadata["generation"] in (2, 4, 5)
    versions = agent.metadata["versions"].keys()
    assert "designrl" in versions and {"box2d-py", "box2d"} & versions
    np.testing.assert_array_equal(agent.parameters, agent.parameters.round(4))
    text = describe(undisturbed / "state.safetensors")
    assert "biped-morphology" in text and "generation       5\n" in text


def test_a_run_ends_with_the_evaluation_that_reaches_the_stop_score(tmp_path):
    settings = TrainSettings.of(
        "biped", population=4, rollouts=1, generations=6, evaluate_every=2, stop_score=-1000
    )
    run = TrainingRun(settings, tmp_path / "run")
    run.run()
    assert (run.finished, run.progress.generation) == (True, 2)
    assert "--stop-score -1000" in settings.command()


def test_the_kept_score_is_that_of_the_checkpoint(undisturbed):
    agent = load(undisturbed / "best.safetensors")
    recording = read(undisturbed / "generations.mcap")
    last = agent.metadata["generation"] - 1
    [evaluation] = [e for e in recording.messages("/evaluation") if e.generation == last]
    with Simulator("biped-morphology", "reference") as simulator:
        again = simulator.rollout(agent.parameters[None], np.array([list(evaluation.seeds)]))
    np.testing.assert_array_equal(again.returns[0], evaluation.scores)
    assert agent.metadata["score"] == again.returns.mean()


def test_the_same_seed_gives_the_same_bytes_for_any_number_of_workers(undisturbed, tmp_path):
    TrainingRun(settings(), tmp_path / "two", workers=2, backend="reference").run()
    one, two = (file_hash(f / "best.safetensors") for f in (undisturbed, tmp_path / "two"))
    assert one == two
    train(tmp_path / "other", seed=1)
    other = load(tmp_path / "other/best.safetensors")
    assert (other.parameters != load(undisturbed / "best.safetensors").parameters).any()


@pytest.mark.parametrize("generations", [1, 2, 3])
def test_an_interrupted_run_ends_with_the_same_bytes(
    undisturbed, tmp_path, monkeypatch, generations
):
    left, original = iter(range(generations)), Simulator.rollout

    def interrupt(self, *args, **kwargs):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return original(self, *args, **kwargs)

    monkeypatch.setattr(Simulator, "rollout", interrupt)
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path)
    monkeypatch.undo()
    train(tmp_path, resume=True)
    name = "best.safetensors"
    assert file_hash(tmp_path / name) == file_hash(undisturbed / name)
    for field in ("mu", "sigma"):
        found, expected = (
            read(folder / "generations.mcap").array("/distribution", field)
            for folder in (tmp_path, undisturbed)
        )
        np.testing.assert_array_equal(found, expected)


def test_ctrl_c_saves_and_says_how_to_go_on(tmp_path):
    command = [sys.executable, "-m", "designrl", "train", "biped", "--out", str(tmp_path)]
    command += ["--population", "4", "--rollouts", "1", "--backend", "reference"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    while not (tmp_path / "generations.mcap").exists() and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=1800)
    assert process.returncode == 130
    assert f"designrl train biped --out {tmp_path}" in errors
    assert "--resume" in errors
    _, metadata = read_tensors(tmp_path / "state.safetensors", STATE_FORMAT)
    assert metadata["experiment"] == "biped"


def test_what_is_said_after_ctrl_c_is_what_is_saved(tmp_path):
    def generation(folder: str, signals: int) -> int:
        def interrupt(*_):
            raise KeyboardInterrupt

        flush = RunWriter.flush
        run = TrainingRun(settings(evaluate_every=3), tmp_path / folder)
        with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(run, "_evaluate", interrupt)  # of generation 3, which is not whole then
            if signals > 1:
                patch.setattr(
                    RunWriter, "flush", lambda w: (signal.raise_signal(signal.SIGINT), flush(w))
                )
            run.run()
        _, about = read_tensors(tmp_path / folder / "state.safetensors", STATE_FORMAT)
        assert about["progress"]["generation"] == run.progress.generation
        return run.progress.generation

    assert generation("once", 1) == generation("twice", 2) == 2


def test_a_pair_of_candidates_meets_the_same_episodes(tmp_path):
    run = TrainingRun(settings(population=6), tmp_path)
    seeds = training_seeds(run.settings, 3)
    assert seeds.shape == (6, 2)
    np.testing.assert_array_equal(seeds[:3], seeds[3:])
    assert len(set(seeds[:3].ravel())) == 6
    assert (training_seeds(run.settings, 4) != seeds).any()


def test_evaluations_have_the_environments_rewards_with_the_factor_for_smaller_legs(tmp_path):
    train(tmp_path, "biped-morphology-smaller-leg", generations=2)
    recording = read(tmp_path / "generations.mcap")
    experiment = get_experiment("biped-morphology-smaller-leg")
    agent = load(tmp_path / "best.safetensors")
    factor = leg_area_reward_factor(agent.scales)
    evaluation = recording.first("/evaluation")
    with Simulator(experiment, "reference") as simulator:
        plain = simulator.rollout(agent.parameters[None], np.array([list(evaluation.seeds)]))
    fell = plain.steps[0] < 1600
    assert fell.any()
    expected = np.where(fell, factor * (plain.returns[0] + 100) - 100, factor * plain.returns[0])
    np.testing.assert_allclose(evaluation.scores, expected)


def test_the_kept_agent_is_the_best_candidate_or_the_mean(tmp_path):
    for keep in ("best", "mean"):
        run = train(tmp_path / keep, generations=2, keep=keep)
        kept = load(tmp_path / keep / "best.safetensors").parameters
        is_mean = (kept == run.optimiser.mu.numpy().round(4)).all()
        assert is_mean == (keep == "mean")


def test_the_recorded_command_gives_the_run_again():
    ours = settings(shaped_rewards=False, seed=3)
    assert ours.command() == (
        "designrl train biped-morphology --recipe paper --seed 3 --generations 5 --population 4 "
        "--rollouts 2 --no-shaped-rewards --evaluate-every 2 --evaluation-episodes 3"
    )
    assert cli.settings_of(cli.parser().parse_args(ours.command().split()[1:])) == ours
    assert TrainSettings.of("ant", "ours", seed=1).command() == (
        "designrl train ant --recipe ours --seed 1"
    )


def lose(name):
    return lambda folder: (folder / name).unlink()


def cut_state(folder):
    path = folder / "state.safetensors"
    path.write_bytes(path.read_bytes()[:-100])


@pytest.mark.parametrize(
    ("spoil", "changes", "words"),
    [
        (None, {"resume": False}, "already holds a run"),
        (None, {"population": 6}, "population = 4, not 6"),
        (None, {"experiment": "biped"}, "a run of biped-morphology, not biped"),
        (None, {"learning_rate": 0.02, "generations": 9}, "learning_rate = 0.01, not 0.02"),
        (None, {"generations": 1}, "generations = 5, not 1"),
        (lose("state.safetensors"), {}, r"no state\.safetensors"),
        (lose("state.safetensors"), {"resume": False}, r"no state\.safetensors"),
        (lose("best.safetensors"), {"generations": 6}, "lost its best.safetensors, kept at gen"),
        (
            cut_state,
            {},
            "is not a whole designrl training state 1 .* start again in another folder",
        ),
    ],
)
def test_a_run_that_cannot_be_gone_on_with_is_left_alone(
    undisturbed, tmp_path, spoil, changes, words
):
    folder = shutil.copytree(undisturbed, tmp_path / "run")
    if spoil:
        spoil(folder)
    before = {path: file_hash(path) for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match=words):
        train(folder, **{"resume": True, **changes})
    assert {path: file_hash(path) for path in folder.rglob("*") if path.is_file()} == before


def test_a_lengthened_runs_recording_says_how_long_it_is(undisturbed, tmp_path):
    folder = shutil.copytree(undisturbed, tmp_path / "run")
    train(folder, resume=True, generations=6)
    before, about = (read(run / "generations.mcap").metadata for run in (undisturbed, folder))
    assert json.loads(about["settings"])["generations"] == 6
    assert "--generations 6" in about["command"] and "--generations 5" in before["command"]
    assert about["host"] == before["host"]
    assert (np.diff(read(folder / "generations.mcap").array("/summary", "cpu_seconds")) > 0).all()


def swap(name, make):
    """What puts something else in the place of a file or folder of a run."""

    def spoil(folder):
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        make(path)

    return spoil


@pytest.mark.parametrize("name", [".lock", "best.safetensors", "generations.mcap", "rollouts"])
@pytest.mark.parametrize("make", ["link", "fifo", "folder"])
def test_a_runs_folder_does_not_lead_elsewhere(undisturbed, tmp_path, name, make):
    folder, elsewhere = shutil.copytree(undisturbed, tmp_path / "run"), tmp_path / "elsewhere"
    if name == "rollouts":
        elsewhere.mkdir()
        before = elsewhere / ".new-generation00005.mcap-0123456789abcdef"
        before.write_text("precious")
        make = {"folder": "file"}.get(make, make)
    else:
        before = elsewhere
        elsewhere.write_text("precious")
    how = {"link": lambda path: path.symlink_to(elsewhere), "fifo": os.mkfifo}
    swap(name, {**how, "folder": os.mkdir, "file": Path.touch}[make])(folder)
    with pytest.raises(InputError, match=f"{name} is not a plain fi|rollouts is not a plain fo"):
        train(folder, resume=True, generations=6)
    assert before.read_text() == "precious"


def test_only_what_a_kill_has_left_is_removed(undisturbed, tmp_path):
    folder = shutil.copytree(undisturbed, tmp_path / "run")
    left = ["best.safetensors", "state.safetensors", "generations.mcap"]
    left += ["rollouts/generation00005.mcap"]
    left = [Path(name).parent / f".new-{Path(name).name}-0123456789abcdef" for name in left]
    mine = [Path(".new-notes"), Path("rollouts/.new-other.mcap-0123456789abcdef")]
    for name in left + mine:
        (folder / name).touch()
    (folder / ".new-x").mkdir()
    train(folder, resume=True, generations=6)
    assert [name for name in left + mine if (folder / name).exists()] == mine
    assert (folder / ".new-x").is_dir()


def lose_ground(change, monkeypatch):
    """Do something in the middle of a run."""
    left, original = iter([lambda: None] * 2 + [change]), Simulator.rollout

    def rollout(self, *args, **kwargs):
        next(left, lambda: None)()
        return original(self, *args, **kwargs)

    monkeypatch.setattr(Simulator, "rollout", rollout)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda run: run.rename(run.with_name("other")),
            "run(/generations.mcap)? was removed, renamed",
        ),
        (shutil.rmtree, "run(/generations.mcap)? was removed, renamed"),
        (lambda run: (run / "generations.mcap").unlink(), "generations.mcap was removed"),
        (
            lambda run: shutil.copy(run / "state.safetensors", run / "x").replace(
                run / "generations.mcap"
            ),
            "generations.mcap was removed, renamed or replaced",
        ),
    ],
)
def test_a_folder_or_recording_that_is_removed_during_a_run_is_said(
    change, words, tmp_path, monkeypatch
):
    lose_ground(lambda: change(tmp_path / "run"), monkeypatch)
    with pytest.raises(InputError, match=words):
        train(tmp_path / "run")
    left = {path.name for path in (tmp_path / "run").glob("*")}
    assert "best.safetensors" not in left or "state.safetensors" in left


@pytest.mark.parametrize("name", ["best.safetensors", "generations.mcap"])
def test_a_file_of_another_run_is_not_gone_on_with(undisturbed, tmp_path, name):
    folder = shutil.copytree(undisturbed, tmp_path / "run")
    train(tmp_path / "other", seed=1)
    shutil.copy(tmp_path / "other" / name, folder / name)
    before = file_hash(folder / name)
    with pytest.raises(InputError, match=f"{name} is (not what this run kept|of a run with)"):
        train(folder, resume=True, generations=6)
    assert file_hash(folder / name) == before
    [rollout, *_] = (folder / "rollouts").iterdir()
    shutil.copy(rollout, folder / "generations.mcap")
    shutil.copy(undisturbed / "best.safetensors", folder)
    with pytest.raises(InputError, match="is not a recording of a training run"):
        train(folder, resume=True, generations=6)


def test_what_fails_between_two_savings_leaves_a_run_that_goes_on(tmp_path, monkeypatch):
    class Bar(train_module.tqdm):
        def update(self, n=1):
            if self.n == 2 and n:
                raise OSError
            return super().update(n)

    run = TrainSettings.of("biped", population=2, rollouts=1, evaluation_episodes=1, generations=4)
    monkeypatch.setattr(train_module, "tqdm", Bar)
    with pytest.raises(OSError):
        TrainingRun(run, tmp_path).run()
    monkeypatch.undo()
    _, metadata = read_tensors(tmp_path / "state.safetensors", STATE_FORMAT)
    recorded = read(tmp_path / "generations.mcap").generations
    # What the bar was to show of the third one is not saved: it was not whole.
    assert metadata["progress"]["generation"] == 2 and recorded.tolist() == [0, 1, 2]
    TrainingRun(run, tmp_path, resume=True).run()
    assert read(tmp_path / "generations.mcap").generations.tolist() == [0, 1, 2, 3]


def test_two_runs_cannot_share_a_folder(tmp_path):
    first, second = (TrainingRun(settings(generations=2), tmp_path) for _ in range(2))
    with RunFolder(tmp_path).locked(), pytest.raises(InputError, match="in use by another run"):
        second.run()
    first.run()
    before = file_hash(tmp_path / "state.safetensors")
    with pytest.raises(InputError, match="already holds a run"):
        second.run()
    with pytest.raises(InputError, match="holds a run of biped-morphology, not ant; choose"):
        train(tmp_path, "ant", resume=True, generations=2)
    assert file_hash(tmp_path / "state.safetensors") == before


def test_the_papers_recipe_has_the_papers_numbers():
    walker, ant = TrainSettings.of("biped-hardcore"), TrainSettings.of("ant")
    assert (walker.generations, walker.population, walker.rollouts) == (10000, 192, 16)
    assert (walker.sigma_start, ant.generations) == (0.1, 3000)
    assert walker.shaped_rewards and not ant.shaped_rewards


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_recipe_is_valid_and_the_same_for_every_seed(name):
    for recipe in ("paper", "ours", "plain"):
        one, other = (TrainSettings.of(name, recipe, seed=seed) for seed in (0, 7))
        assert dataclasses.replace(one, seed=7) == other
        Reinforce(3, one.population, one)
    with pytest.raises(InputError, match="recipe is 'zo'; it must be one of paper, ours, plain"):
        TrainSettings.of(name, "zo")


def test_a_runs_reward_weights_are_in_its_evaluations_checkpoint_and_recordings(
    tmp_path,
):
    weights = {"posture": 0.5, "energy": 2.0}
    run = train(tmp_path, generations=2, shaped_rewards=False, reward_weights=weights)
    agent = load(tmp_path / "best.safetensors")
    assert agent.metadata["settings"]["reward_weights"] == weights
    assert "score is that of the settings' reward_weights" in describe(
        tmp_path / "best.safetensors"
    )
    recording = read(tmp_path / "generations.mcap")
    assert recording.about("settings")["reward_weights"] == weights
    [evaluation] = recording.messages("/evaluation")
    with Simulator("biped-morphology", reward_weights=weights) as simulator:
        again = simulator.rollout(agent.parameters[None], np.array([list(evaluation.seeds)]))
        candidates = TrainingRun(run.settings, tmp_path / "again").candidates()
        returns = simulator.rollout(candidates, training_seeds(run.settings, 0)).returns
    np.testing.assert_array_equal(again.returns[0], evaluation.scores)
    np.testing.assert_array_equal(next(recording.messages("/returns")).returns, returns.ravel())
    rollout = read(next((tmp_path / "rollouts").iterdir()))
    assert rollout.about("reward_weights") == weights
    with pytest.raises(InputError, match="with reward_weights = .*'energy': 2.0.*, not None"):
        train(tmp_path, resume=True, generations=3, shaped_rewards=False)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_the_plain_step_goes_with_every_recipe_and_every_command_can_run(name):
    for recipe in ("paper", "ours"):
        plain = TrainSettings.of(name, recipe, adam=False)
        assert "--no-adam" in plain.command() or "--recipe plain" in plain.command()
        assert " None" not in TrainSettings.of(name, recipe, evaluation_episodes=None).command()


def test_the_command_has_each_reward_weight_and_those_of_one_are_none():
    ours = settings("ant", reward_weights={"stall": 0.0, "progress": np.float32(1.5)})
    assert " --reward-weight progress=1.5 --reward-weight stall=0.0 " in ours.command()
    assert cli.settings_of(cli.parser().parse_args(ours.command().split()[1:])) == ours
    assert settings("ant", reward_weights={"stall": 1}) == settings("ant")
    assert "reward_weights" not in settings("ant").as_dict()


@pytest.mark.parametrize(
    ("name", "weights", "words"),
    [
        ("ant", {"energy": 2.0}, "no reward term 'energy'; there are alive, progress, electricity"),
        ("biped", {"fall": 0.5}, "a fall costs nothing; .* --no-shaped-rewards"),
        ("biped-morphology", {"leg_area": 2.0}, "biped-morphology earns nothing with leg_area"),
        ("biped", [2.0], "reward-weights is .* must be a mapping"),
    ],
)
def test_reward_weights_that_do_not_fit_are_refused(name, weights, words):
    with pytest.raises(InputError, match=words):
        settings(name, shaped_rewards=name == "biped", reward_weights=weights)


def agent_file(path):
    """An agent of biped-morphology with random parameters, saved there."""
    parameters = np.random.default_rng(0).normal(0, 0.3, 2812)
    agent = Agent(get_experiment("biped-morphology"), parameters)
    save(agent, path)
    return agent


def test_a_run_starts_from_an_agents_parameters_and_resumes_to_the_same_bytes(tmp_path):
    file = tmp_path / "first.safetensors"
    first = agent_file(file)
    train(tmp_path / "straight", init=str(file))
    recording = read(tmp_path / "straight/generations.mcap")
    mu, sigma = (recording.array("/distribution", name)[0] for name in ("mu", "sigma"))
    np.testing.assert_array_equal(mu, first.parameters.astype(np.float32))
    assert (sigma == np.float32(0.1)).all()

    def stop(generation):
        raise KeyboardInterrupt

    cut = settings(init=str(file)), tmp_path / "resumed"
    with pytest.raises(KeyboardInterrupt):
        TrainingRun(*cut, on_generation=stop).run()
    digest = file_hash(file)
    file.unlink()  # it has done its work
    train(tmp_path / "resumed", resume=True, init=str(file))
    names = [tmp_path / name / "best.safetensors" for name in ("straight", "resumed")]
    assert file_hash(names[0]) == file_hash(names[1])
    about = load(names[1]).metadata
    assert about["settings"]["init"] == str(file)
    assert about["init_sha256"] == recording.metadata["init_sha256"] == digest
    for other in ({}, {"init": "another.safetensors"}):
        with pytest.raises(InputError, match="holds a run with init = '.*', not"):
            train(tmp_path / "resumed", resume=True, generations=7, **other)


def test_a_run_without_a_first_agent_says_nothing_of_one():
    assert "init" not in settings().as_dict()
    ours = settings(init="its agent.safetensors")
    assert ours.command().endswith("--init 'its agent.safetensors'")
    assert cli.settings_of(cli.parser().parse_args(shlex.split(ours.command())[1:])) == ours


@pytest.mark.parametrize("content", [lambda mu: [mu], lambda mu: [mu, 300.0]])
def test_a_run_starts_from_weights_of_2018_with_and_without_a_score(content, tmp_path):
    mu = (np.arange(2812) / 1e4).round(4)
    (tmp_path / "a.json").write_text(json.dumps(content(mu.tolist())))
    run = TrainingRun(settings(init=str(tmp_path / "a.json")), tmp_path / "run")
    np.testing.assert_array_equal(run.optimiser.state()["mu"], mu)


@pytest.mark.skipif(author.zoo() is None, reason="AUTHOR_ZOO does not name the author's weights")
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_a_run_starts_from_the_authors_weights(name, tmp_path):
    file = author.file_of(author.zoo(), name)
    if name == "ant":  # its network is not the paper's
        with pytest.raises(InputError, match="140-40-8, linear .*; ant trains 29-64-32-8, tanh"):
            TrainingRun(settings(name, init=str(file)), tmp_path)
        return
    run = TrainingRun(settings(name, init=str(file)), tmp_path)
    np.testing.assert_array_equal(
        run.optimiser.mu, load_author(file, get_experiment(name)).parameters
    )


def test_the_flat_walker_may_start_the_one_on_hardcore(tmp_path):
    first = agent_file(tmp_path / "a.safetensors")
    hardcore = settings("biped-hardcore-morphology", init=str(tmp_path / "a.safetensors"))
    run = TrainingRun(hardcore, tmp_path / "run")
    np.testing.assert_array_equal(run.optimiser.mu, first.parameters)


def test_a_body_within_other_limits_does_not_start_a_run(tmp_path):
    agent_file(tmp_path / "a.safetensors")
    other = settings(init=str(tmp_path / "a.safetensors"), design_limit=0.5)
    with pytest.raises(InputError, match="0.25 to 1.75 .* than this run .0.5 to 1.5 .*same limits"):
        TrainingRun(other, tmp_path / "run")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("ant", "whose parameters are not those of ant; name an agent of ant"),
        ("biped", "whose parameters are not those of biped; name an agent of biped or biped-h"),
    ],
)
def test_what_a_run_cannot_start_from_is_refused_before_anything_is_written(name, words, tmp_path):
    agent_file(tmp_path / "a.safetensors")
    with pytest.raises(InputError, match=words):
        TrainingRun(settings(name, init=str(tmp_path / "a.safetensors")), tmp_path / "run")
    (tmp_path / "short.json").write_text("[[1.0, 2.0]]")
    with pytest.raises(InputError, match="short.json cannot be used as .* has .* parameters"):
        TrainingRun(settings(name, init=str(tmp_path / "short.json")), tmp_path / "run")
    with pytest.raises(InputError, match="nowhere.safetensors"):
        TrainingRun(settings(name, init="nowhere.safetensors"), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_on_generation_gets_each_record_and_can_end_the_run(tmp_path):
    seen = []

    def see(generation):
        seen.append(generation)
        if generation.index == 2:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        TrainingRun(settings(), tmp_path, on_generation=see).run()
    TrainingRun(settings(), tmp_path, resume=True, on_generation=see).run()
    assert [generation.index for generation in seen] == [0, 1, 2, 3, 4]
    recorded = read(tmp_path / "generations.mcap").array("/summary", "mean")
    np.testing.assert_array_equal([g.returns.mean(axis=1).mean() for g in seen], recorded)


def test_the_learning_rate_falls_to_its_floor(tmp_path):
    falling = {"learning_rate_decay": 0.5, "learning_rate_floor": 0.004}
    run = train(tmp_path, **falling)
    mu = read(tmp_path / "generations.mcap").array("/distribution", "mu")
    steps = np.abs(np.diff([*mu, run.optimiser.mu.numpy()], axis=0)).max(axis=1)
    np.testing.assert_allclose(steps[0], 0.01, rtol=1e-3)  # Adam's first step is the rate
    assert [run.settings.learning_rate_at(g) for g in range(4)] == [0.01, 0.005, 0.004, 0.004]
    assert steps[4] < 0.006


@pytest.mark.parametrize("shaped", [True, False])
def test_training_takes_the_environments_rewards_where_they_are_not_shaped(shaped, tmp_path):
    train(tmp_path, shaped_rewards=shaped, generations=2)
    lowest = read(tmp_path / "generations.mcap").array("/returns", "returns").min()
    # Walkers that have learned nothing yet stand or fall, and a fall is -100.
    assert lowest > -60 if shaped else lowest < -90


def test_wrong_settings_are_refused():
    with pytest.raises(InputError, match="population is 3; .* even"):
        TrainingRun(settings(population=3), "unused")
    for value in (0.0, -1.0, float("nan"), float("inf"), 1e300):
        for name in ("sigma_start", "sigma_decay", "learning_rate", "learning_rate_decay"):
            with pytest.raises(InputError, match=name.replace("_", "-")):
                settings(**{name: value})
    for value in (-1.0, float("nan"), 1e300):
        with pytest.raises(InputError, match="weight-decay is .* at least 0 and at most 10000"):
            settings(weight_decay=value)
    with pytest.raises(InputError, match="ant has no shaped rewards"):
        settings("ant", shaped_rewards=True)
    huge = 10**20
    for wrong in ({"population": huge}, {"rollouts": huge}):
        with pytest.raises(InputError, match="a generation .* can be at most"):
            settings(**wrong)
    with pytest.raises(InputError, match="an evaluation .* can be at most"):
        settings(evaluation_episodes=huge)
    for wrong in ({"generations": 0}, {"seed": -1}, {"keep": "x"}, {"rollouts": 0}):
        with pytest.raises(InputError, match=f"{next(iter(wrong))} is"):
            settings(**wrong)


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("generations", ["5", 5.0, True, None], "a whole number"),
        ("seed", [1.5, "1"], "a whole number"),
        ("evaluation_episodes", [2.5], "a whole number"),
        ("learning_rate", ["0.1", None, [0.1]], "a number"),
        ("adam", [1, "no"], "true or false"),
    ],
)
def test_a_setting_of_another_type_is_refused(name, values, words):
    for value in values:
        with pytest.raises(InputError, match=f"{name.replace('_', '-')} is .* must be {words}"):
            settings(**{name: value})
    if name in ReinforceSettings.__dataclass_fields__:
        with pytest.raises(InputError, match=words):
            ReinforceSettings(**{name: values[0]})


def test_numpys_numbers_are_settings_too(tmp_path):
    ours = settings(seed=np.int64(3), learning_rate=np.float64(0.02))
    assert ours == settings(seed=3, learning_rate=0.02)
    json.dumps(ours.as_dict())


def test_a_refused_run_leaves_its_folder_to_the_next_one(tmp_path):
    with pytest.raises(InputError, match="backend"):
        TrainingRun(settings(), tmp_path, backend="enginee").run()
    with pytest.raises(InputError, match="workers"):
        TrainingRun(settings(), tmp_path, workers=0).run()
    train(tmp_path, generations=1)
    with pytest.raises(InputError, match="cannot be used as the run's folder"):
        train(tmp_path / "best.safetensors" / "run")


def test_a_candidate_that_cannot_be_simulated_stops_the_run_and_is_kept(tmp_path, monkeypatch):
    def break_down(env, agent, seed, *others):
        if seed == bad:
            raise RuntimeError("the simulator is broken")
        return original(env, agent, seed, *others)

    original = simulation.run_episode
    bad = training_seeds(settings(), 2)[1, 0]
    monkeypatch.setattr(simulation, "run_episode", break_down)
    with pytest.raises(InputError, match="candidate 1 of generation 2") as caught:
        TrainingRun(settings(), tmp_path, backend="reference").run()
    path = tmp_path / "failed-generation00002-candidate1.safetensors"
    assert str(path) in str(caught.value) and "the simulator is broken" in str(caught.value)
    agent = load(path)
    assert agent.metadata["episode_seeds"] == [bad]
    assert read(tmp_path / "generations.mcap").generations.tolist() == [0, 1]
    monkeypatch.undo()
    run = TrainingRun(settings(), tmp_path, resume=True)
    assert run.progress.generation == 2
    np.testing.assert_array_equal(run.candidates()[1], agent.parameters)
    run.run()
    assert run.finished


@pytest.mark.parametrize(
    ("tensor", "value"), [("sigma", -1.0), ("adam_v", -1.0), ("generation", -1), ("mu", np.nan)]
)
def test_a_state_with_impossible_numbers_is_refused(tensor, value, tmp_path):
    run = TrainingRun(settings(), tmp_path)
    run._save_state()
    tensors, metadata = read_tensors(tmp_path / "state.safetensors", STATE_FORMAT)
    tensors[tensor] = np.full_like(tensors[tensor], value)
    write_tensors(tmp_path / "state.safetensors", tensors, metadata, STATE_FORMAT)
    with pytest.raises(InputError, match=r"state\.safetensors"):
        TrainingRun(settings(), tmp_path, resume=True)


def test_a_few_kills_change_nothing(tmp_path):
    from verify_resume import verify

    done = verify(tmp_path, kills=1, seed=3, backends=("reference",))
    assert done.total() == 1


def test_a_dry_run_says_what_the_run_then_takes(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(plan, "CALIBRATION_SECONDS", 0.1)
    out = tmp_path / "run"
    run = TrainingRun(settings(generations=7), out, backend="reference")
    plan.dry_run(run)
    assert not out.exists()
    lines = capsys.readouterr().out.splitlines()
    assert "population 4" in lines[1] and "steps/s with --workers 1, reference backend" in lines[3]
    assert "7 generations, 56 episodes in training and 12 in evaluations" in lines[2]
    assert f"{(56 + 12) * 1600:,} if all last 1600" in lines[4]
    generation, rollout = plan.recorded_bytes(run, 1600)
    run.run()
    assert 0.5 < (out / "generations.mcap").stat().st_size / (7 * generation) < 1.5
    assert sum(p.stat().st_size for p in (out / "rollouts").iterdir()) < 1.5 * 4 * rollout


def test_a_dry_run_asks_for_a_limit_where_an_episode_has_none(tmp_path, monkeypatch):
    run = TrainingRun(settings(), tmp_path)
    monkeypatch.setattr(gymnasium.spec(run.experiment.env_id), "max_episode_steps", None)
    with pytest.raises(InputError, match="register it with max_episode_steps"):
        plan.dry_run(run)


def test_a_dry_run_refuses_what_does_not_fit_on_the_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(plan, "CALIBRATION_SECONDS", 0.01)
    usage = shutil.disk_usage(tmp_path)._replace(free=2 * 10**9)
    monkeypatch.setattr(plan.shutil, "disk_usage", lambda _: usage)
    plan.dry_run(TrainingRun(settings(), tmp_path))
    run = TrainingRun(settings(generations=10**6), tmp_path)
    with pytest.raises(InputError, match=r"will take .*GB and 2\.00GB are free"):
        plan.dry_run(run)


@pytest.mark.parametrize(
    ("name", "form"), [("biped-morphology-smaller-leg", "bounded"), ("ant-morphology", "lognormal")]
)
def test_other_limits_train_to_the_same_bytes_on_engine_and_reference(name, form, tmp_path):
    limits = {"design_form": form, "design_limit": 0.5 if form == "bounded" else None}
    changes = {**limits, "generations": 2, "sigma_start": 2.0}
    for backend in ("engine", "reference"):
        TrainingRun(settings(name, **changes), tmp_path / backend, 1, backend).run()
    one, two = (tmp_path / backend / "best.safetensors" for backend in ("engine", "reference"))
    assert file_hash(one) == file_hash(two)
    agent, recording = load(one), read(tmp_path / "engine/generations.mcap")
    bounds = [0.5, 1.5] if form == "bounded" else [0.25, 4.0]
    assert agent.env_kwargs == {"design_bounds": bounds}
    assert recording.about("limits") == {"form": form, "bounds": bounds}
    sizes = recording.array("/design", "upper") / agent.experiment.body.design.originals
    assert 1.75 * (form == "lognormal") < sizes.max() <= bounds[1]
    assert f"--design-form {form}" in agent_command(agent)
    with pytest.raises(InputError, match="with design_(limit|form) = .*, not None"):
        train(tmp_path / "engine", name, resume=True, generations=2, sigma_start=2.0)
    scores = [designrl.evaluate(one, 2, backend=b).scores.tolist() for b in ("engine", "reference")]
    assert scores[0] == scores[1]


def agent_command(agent):
    return TrainSettings(**agent.metadata["settings"]).command()


def test_limits_that_a_body_cannot_have_are_refused():
    for experiment, changes, words in (
        ("biped", {"design_limit": 0.5}, "biped learns no body"),
        ("ant", {"design_form": "lognormal"}, "ant learns no body"),
        ("ant-morphology", {"design_limit": 1.5}, "above 0 and at most 0.99"),
        ("biped-morphology", {"design_form": "cubic"}, "one of bounded, lognormal"),
        ("biped-morphology", {"design_limit": "wide"}, "design-limit is 'wide'; it must be a num"),
    ):
        with pytest.raises(InputError, match=words):
            TrainSettings.of(experiment, **changes)
    plain = TrainSettings.of("biped-morphology")
    assert "design_limit" not in plain.as_dict() and "design_form" not in plain.as_dict()
