"""The body, the experiment and the optimiser of docs/extending.md, in all parts of the house."""

import dataclasses
import importlib.util
import pickle
import sys
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from test_docs import ROOT, blocks

import designrl
from designrl.bodies.ant import ANT
from designrl.bodies.walker import WALKER
from designrl.checkpoint import save
from designrl.cli import main
from designrl.envs.walker import Walker
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS, Experiment, Network, Shaping, register
from designrl.files import file_hash
from designrl.policy import Agent
from designrl.recording import read, record_rollout
from designrl.settings import TrainSettings
from designrl.simulation import Simulator
from designrl.train import TrainingRun
from designrl.viewer import replay

# Where tensorboard is not installed: what its writer is told.
STAND_IN = """
import sys, types
class SummaryWriter(list):
    def __init__(self, folder): super().__init__()
    def __enter__(self): return self
    def __exit__(self, *exc_info): pass
    def add_scalar(self, *args): self.append(args)
sys.modules["torch.utils.tensorboard"] = types.ModuleType("tensorboard")
sys.modules["torch.utils.tensorboard"].SummaryWriter = SummaryWriter
"""


class WiderBody(type(WALKER)):
    name = "wider"


class UnnamedBody(type(WALKER)):
    name, joints = "unnamed", WALKER.joints[:3]


WIDER, UNNAMED = WiderBody(), UnnamedBody()
# The walker with a smaller network, on hardcore ground.
NINTH = Experiment(
    "biped-small-network",
    "i",
    "Biped, small network",
    "designrl/BipedalWalkerHardcore-v0",
    WALKER,
    Network((24, 10, 4)),
    learns_design=True,
    shaping=Shaping(),
)


@pytest.fixture(autouse=True, scope="module")
def page(tmp_path_factory):
    """The names of the page, after it has run as a script in what is the folder of these tests.

    Its experiment "hopper-morphology" and NINTH are known in these tests alone.
    """
    names = {"__name__": "page"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("designrl.experiments.EXPERIMENTS", dict(EXPERIMENTS))
        patch.chdir(tmp_path_factory.mktemp("page"))
        if not importlib.util.find_spec("tensorboard"):
            patch.setitem(sys.modules, "torch.utils.tensorboard", None)  # and none, afterwards
            exec(STAND_IN, {})
        exec("\n".join(blocks(ROOT / "docs/extending.md", "python")), names)
        register(NINTH)
        yield SimpleNamespace(**names)


def test_a_body_of_ones_own_trains_evaluates_records_replays_and_resumes(page, tmp_path, capsys):
    out = Path("runs/hopper/seed0")
    recording = read(out / "generations.mcap")
    assert recording.names("/design") == ["leg length", "leg width"]
    assert recording.array("/design", "dimensions").shape == (5, 2)

    scores = designrl.evaluate(page.agent, episodes=3).scores
    assert len(scores) == 3 and np.ptp(scores) > 0
    score = record_rollout(page.agent, tmp_path / "rollout.mcap", seed=0)
    assert read(tmp_path / "rollout.mcap").array("/reward", "total")[-1] == score
    replay([out, tmp_path / "rollout.mcap", "mine.mcap"], save=tmp_path / "all.rrd")
    assert (tmp_path / "all.rrd").stat().st_size > 1000
    main(["evaluate", str(out / "best.safetensors"), "--episodes", "2", "--workers", "1"])
    assert "hopper-morphology: " in capsys.readouterr().out

    longer = TrainSettings.of("hopper-morphology", "ours", generations=7)
    TrainingRun(longer, out, resume=True).run()
    TrainingRun(longer, tmp_path).run()
    assert read(out / "generations.mcap").generations.tolist() == [0, 1, 2, 3, 4, 5, 6]
    resumed, straight = (TrainingRun(longer, f, resume=True).optimiser.mu for f in (out, tmp_path))
    assert (resumed == straight).all()


def test_tensorboard_is_told_of_each_generation(page):
    if importlib.util.find_spec("tensorboard"):
        [file] = Path("runs/hopper/board").glob("events.*")
        assert file.stat().st_size > 5 * 40
        return
    means = read("runs/hopper/seed1/generations.mcap").array("/summary", "mean")
    assert page.board == [("mean return", mean, i) for i, mean in enumerate(means)]


def test_a_ninth_experiment_on_the_walker_has_the_engine_and_its_bits_and_trains(tmp_path):
    candidates = 0.3 * np.random.default_rng(0).standard_normal((3, NINTH.num_parameters))
    seeds = np.arange(6).reshape(3, 2)
    with Simulator(NINTH, "engine") as fast, Simulator(NINTH, "reference") as slow:
        for shaped in (False, True):
            results = [s.rollout(candidates, seeds, shaped=shaped) for s in (fast, slow)]
            np.testing.assert_array_equal(results[0].returns, results[1].returns)
            np.testing.assert_array_equal(results[0].steps, results[1].steps)
    small = {"generations": 2, "population": 4, "rollouts": 1, "evaluation_episodes": 1}
    TrainingRun(TrainSettings.of(NINTH, shaped_rewards=True, **small), tmp_path).run()
    assert designrl.load(tmp_path / "best.safetensors").network.sizes == (24, 10, 4)


@pytest.mark.parametrize(
    "change", [{"network": Network((24, 300, 4))}, {"shaping": Shaping(solved_return=-1e3)}]
)
def test_what_the_engine_does_not_have_runs_on_the_reference(change, capsys):
    with Simulator(dataclasses.replace(NINTH, **change), "engine") as simulator:
        assert simulator.backend == "reference"
    assert "using the reference environment" in capsys.readouterr().err


def test_an_optimiser_of_ones_own_trains_and_resumes_to_the_same_bytes(page, tmp_path):
    def train(folder, generations, resume=False):
        changes = {"generations": generations, "population": 6, "evaluate_every": 2}
        settings = TrainSettings.of("hopper-morphology", "ours", mirrored=False, **changes)
        climber = page.HillClimber(parameters=35, population=6)
        run = TrainingRun(settings, folder, resume=resume, optimiser=climber)
        run.run()
        return run.optimiser

    straight = train(tmp_path / "straight", 4)
    assert straight.best > -np.inf and straight.mu.any()
    train(tmp_path / "resumed", 2)
    train(tmp_path / "resumed", 4, resume=True)
    names = [tmp_path / name / "best.safetensors" for name in ("straight", "resumed")]
    assert file_hash(names[0]) == file_hash(names[1])
    mu = read(tmp_path / "straight/generations.mcap").array("/distribution", "mu")
    np.testing.assert_array_equal(mu[0], np.zeros(35))


def test_two_experiments_cannot_share_a_name(tmp_path):
    other = Experiment("biped", "c", "x", "Any-v0", WALKER, Network((2, 1)), False)
    with pytest.raises(InputError, match="another experiment 'biped'"):
        register(other)
    with pytest.raises(InputError, match="another experiment 'biped'"):
        TrainSettings.of(other)
    with pytest.raises(InputError, match="another experiment 'biped'"):
        save(Agent(other, np.zeros(3)), tmp_path / "a.safetensors")


def test_settings_make_an_experiment_known_so_that_its_agents_are_read_back(tmp_path):
    tenth = dataclasses.replace(NINTH, name="biped-tenth")
    small = {"generations": 1, "population": 2, "rollouts": 1, "evaluation_episodes": 1}
    TrainingRun(TrainSettings.of(tenth, **small), tmp_path).run()
    assert designrl.load(tmp_path / "best.safetensors").experiment is tenth


class Deaf(Walker):
    def reset(self, *, seed=None, options=None):
        return super().reset(seed=seed)


class Unnamed(Walker):
    body = UNNAMED


gymnasium.register("Deaf-v0", entry_point=Deaf)
gymnasium.register("Unnamed-v0", entry_point=Unnamed)


@pytest.mark.parametrize("backend", ["engine", "reference"])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"env_id": "Nowhere-v0"}, "Nowhere-v0 of biped-small-network cannot be made: .* exist"),
        ({"env_id": "CartPole-v1"}, "cannot be made: .* unexpected keyword argument 'design'"),
        ({"body": ANT}, "cannot be made: a design for this body has 8 scales"),
        ({"body": WIDER}, "does not have the body of biped-small-network"),
        ({"env_id": "Deaf-v0"}, "Deaf-v0 does not have the design of a reset"),
        ({"body": UNNAMED, "env_id": "Unnamed-v0"}, "names 24 observations and 3 joints"),
        ({"network": Network((23, 4))}, r"observations \(24,\) .* network of .* takes \(23,\)"),
        ({"network": Network((24, 5))}, r"actions \(4,\); the network of .* gives \(5,\)"),
    ],
)
def test_parts_that_do_not_fit_each_other_are_refused_before_any_episode(change, words, backend):
    with pytest.raises(InputError, match=words):
        Simulator(dataclasses.replace(NINTH, **change), backend)


MODULE = """
import gymnasium
from designrl.bodies.walker import WALKER
from designrl.envs.walker import Walker
from designrl.experiments import Experiment, Network, register

class Heavy(Walker):
    pass

gymnasium.register("HeavyWalker-v0", entry_point=Heavy, max_episode_steps=20)
register(Experiment("heavy", "j", "Heavy", "HeavyWalker-v0", WALKER, Network((24, 4)), True))
"""


def test_an_experiment_from_another_process_is_the_same(capfd):
    agent = pickle.loads(pickle.dumps(Agent(NINTH, np.zeros(NINTH.num_parameters))))
    assert agent.experiment == NINTH and TrainSettings.of(agent.experiment)
    assert len(designrl.evaluate(agent, episodes=1).scores) == 1


def test_commands_know_the_experiments_of_a_loaded_module_in_all_processes(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    Path("my_experiments.py").write_text(MODULE)
    small = "--generations 1 --population 4 --rollouts 1 --evaluation-episodes 1 --out run"
    main(f"--load my_experiments.py train heavy --workers 2 {small}".split())
    words = ["--workers", "2", "--episodes", "3"]
    main(["--load", "my_experiments", "evaluate", "run/best.safetensors", *words])
    assert "heavy: " in capsys.readouterr().out
    main(["--load", "my_experiments", "evaluate", "run", "--episodes", "1", "--lidar", "v3"])


def test_what_an_environment_does_not_do_is_said_in_one_sentence(page, tmp_path, capsys):
    out = Path("runs/hopper/seed0")
    for words, sentence in (
        (["evaluate", out, "--lidar", "v3"], "hopper-morphology takes no lidar; leave it out"),
        (["record", out, "--video", tmp_path / "a.webp"], "SpringHopper-v0 draws no pictures"),
        (["replay", out, "--video", tmp_path / "a.webp"], "SpringHopper-v0 draws no pictures"),
    ):
        with pytest.raises(SystemExit, match="2"):
            main([str(word) for word in words])
        assert sentence in capsys.readouterr().err
    assert not (tmp_path / "a.webp").exists()


@pytest.mark.parametrize(
    ("module", "words"),
    [
        ("no_such_module", "no_such_module cannot be loaded: No module named"),
        ("no_such_file.py", "no_such_file.py is not a file"),
        ("json.py", "json.py has the name of a module that is in use"),
    ],
)
def test_a_module_that_cannot_be_loaded_is_refused(module, words, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    Path("json.py").write_text(MODULE)
    with pytest.raises(SystemExit, match="2"):
        main(["--load", module, "experiments"])
    assert words in capsys.readouterr().err
