"""A body, an experiment and an optimiser of one's own, without touching the library."""

import gymnasium
import numpy as np
import pytest

import designrl
from designrl.bodies import Body, urdf
from designrl.bodies.walker import WALKER
from designrl.cli import main
from designrl.design import DesignSpace
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS, Experiment, Network, Shaping, register
from designrl.files import file_hash
from designrl.recording import read, record_rollout
from designrl.settings import TrainSettings
from designrl.simulation import Simulator
from designrl.train import TrainingRun
from designrl.viewer import replay


class SliderBody(Body):
    """A block on a line; its length is learned."""

    name = "slider"
    design = DesignSpace(("length",), np.array([0.5]), "m")
    tree = {"block": "world"}
    joints = ("motor",)
    observations = ("place", "speed")
    time_step = 0.1

    def urdf(self, scales, caption=""):
        size = (self.design.dimensions(scales)[0], 0.2, 0.2)
        links = {"block": [urdf.box(size, (0, 0, 0.1), (200, 0, 0))]}
        return urdf.robot(self.name, caption, links, [urdf.joint("root", "world", "block")])

    def poses(self, env):
        return np.array([[env.x, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.0, 1.0]])


SLIDER = SliderBody()


class Slider(gymnasium.Env):
    """Go right; a shorter block is faster."""

    body = SLIDER
    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, design=None):
        self.design = np.ones(1) if design is None else design

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.design = (options or {}).get("design", self.design)
        self.x, self.v = self.np_random.uniform(-0.1, 0.1), 0.0
        return np.float32([self.x, self.v]), {}

    def step(self, action):
        self.v += 0.1 * float(action[0]) / self.design[0] - 0.1 * self.v
        self.x += 0.1 * self.v
        terms = {"speed": self.v}
        return np.float32([self.x, self.v]), self.v, False, False, {"reward_terms": terms}


gymnasium.register("TestSlider-v0", entry_point=Slider, max_episode_steps=30)
SLIDING = Experiment(
    "slider-morphology",
    "s",
    "Slider + Morphology",
    "TestSlider-v0",
    SLIDER,
    Network((2, 3, 1)),
    learns_design=True,
    zoo={"generations": 3, "population": 6, "rollouts": 2, "evaluation_episodes": 2},
)
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


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """The two experiments, for one test."""
    monkeypatch.setattr("designrl.experiments.EXPERIMENTS", dict(EXPERIMENTS))
    for experiment in (SLIDING, NINTH):
        register(experiment)


def test_a_body_of_ones_own_trains_evaluates_records_replays_and_resumes(tmp_path, capsys):
    out = tmp_path / "run"
    run = TrainingRun(TrainSettings.of(SLIDING, "zoo"), out)
    run.run()
    assert run.finished
    recording = read(out / "generations.mcap")
    assert recording.names("/design") == ["length"]
    assert recording.array("/design", "dimensions").shape == (3, 1)

    agent = designrl.load(out / "best.safetensors")
    scores = designrl.evaluate(agent, episodes=3).scores
    assert len(scores) == 3 and np.ptp(scores) > 0
    score = record_rollout(agent, tmp_path / "rollout.mcap", seed=0)
    assert read(tmp_path / "rollout.mcap").array("/reward", "total")[-1] == score
    replay([out, tmp_path / "rollout.mcap"], save=tmp_path / "all.rrd")
    assert (tmp_path / "all.rrd").stat().st_size > 1000
    main(["evaluate", str(out / "best.safetensors"), "--episodes", "2", "--workers", "1"])
    assert "slider-morphology: " in capsys.readouterr().out

    longer = TrainSettings.of(SLIDING, "zoo", generations=5)
    TrainingRun(longer, out, resume=True).run()
    TrainingRun(longer, tmp_path / "straight").run()
    assert read(out / "generations.mcap").generations.tolist() == [0, 1, 2, 3, 4]
    states = [
        TrainingRun(longer, f, resume=True).optimiser.mu for f in (out, tmp_path / "straight")
    ]
    assert (states[0] == states[1]).all()


def test_a_ninth_experiment_on_the_walker_has_the_engine_and_its_bits():
    candidates = 0.3 * np.random.default_rng(0).standard_normal((3, NINTH.num_parameters))
    seeds = np.arange(6).reshape(3, 2)
    with Simulator(NINTH, "engine") as fast, Simulator(NINTH, "reference") as slow:
        for shaped in (False, True):
            results = [s.rollout(candidates, seeds, shaped=shaped) for s in (fast, slow)]
            np.testing.assert_array_equal(results[0].returns, results[1].returns)
            np.testing.assert_array_equal(results[0].steps, results[1].steps)


def test_a_ninth_experiment_trains(tmp_path):
    settings = TrainSettings.of(
        NINTH, generations=2, population=4, rollouts=1, shaped_rewards=True, evaluation_episodes=1
    )
    TrainingRun(settings, tmp_path).run()
    assert designrl.load(tmp_path / "best.safetensors").network.sizes == (24, 10, 4)


class HillClimber:
    """Gaussian steps from the best candidate so far."""

    def __init__(self, parameters, population):
        self.mu, self.sigma = np.zeros(parameters), np.full(parameters, 0.1)
        self.population, self.best, self.generation = population, -np.inf, 0

    def ask(self):
        rng = np.random.default_rng(self.generation)
        return self.mu + self.sigma * rng.standard_normal((self.population, len(self.mu)))

    def tell(self, returns):
        if returns.max() > self.best:
            self.mu, self.best = self.ask()[returns.argmax()], returns.max()
        self.generation += 1

    def state(self):
        numbers = {"best": np.array(self.best), "generation": np.array(self.generation)}
        return {"mu": self.mu, "sigma": self.sigma, **numbers}

    def restore(self, state):
        self.mu, self.sigma, self.best = state["mu"], state["sigma"], float(state["best"])
        self.generation = int(state["generation"])


def test_an_optimiser_of_ones_own_trains_and_resumes_to_the_same_bytes(tmp_path):
    def train(folder, generations, resume=False):
        changes = {"mirrored": False, "evaluate_every": 2}
        settings = TrainSettings.of(SLIDING, "zoo", generations=generations, **changes)
        climber = HillClimber(SLIDING.num_parameters, settings.population)
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
    np.testing.assert_array_equal(mu[0], np.zeros(SLIDING.num_parameters))


def test_two_experiments_cannot_share_a_name():
    with pytest.raises(InputError, match="another experiment 'biped'"):
        register(Experiment("biped", "c", "x", "TestSlider-v0", SLIDER, Network((2, 1)), False))
