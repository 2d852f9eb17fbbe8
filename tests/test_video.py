"""Videos: real time, the body large, the score in the picture, and a whole run's evolution."""

import shutil
import sys

import gymnasium
import numpy as np
import pytest
from PIL import Image, ImageSequence
from test_recording import random_agent, write_run

from designrl import video
from designrl.bodies.walker import WALKER
from designrl.errors import InputError
from designrl.recording import read, record_rollout


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    write_run(folder / "generations.mcap", range(12))
    return folder


def frames_of(path) -> list[Image.Image]:
    if path.suffix == ".mp4":
        av = pytest.importorskip("av", reason="an .mp4 needs PyAV: pip install av")
        with av.open(path) as container:
            return [frame.to_image() for frame in container.decode(video=0)]
    return [frame.convert("RGB") for frame in ImageSequence.Iterator(Image.open(path))]


@pytest.mark.parametrize("suffix", video.SUFFIXES)
def test_an_episode_is_filmed_in_real_time(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    if suffix == ".mp4":
        pytest.importorskip("av", reason="an .mp4 needs PyAV: pip install av")
    agent = random_agent("biped-morphology")
    score = video.record_video(agent, path, seed=5)
    assert score == record_rollout(agent, tmp_path / "a.mcap", seed=5)
    steps = read(tmp_path / "a.mcap").topics["/action"]
    frames = frames_of(path)
    assert len(frames) in (steps // 2 + 1, (steps + 1) // 2)
    if suffix != ".mp4":
        image = Image.open(path)
        image.load()
        assert image.info["duration"] == 40  # ms: two steps of a 50th of a second
    first, last = (np.asarray(frame, dtype=int) for frame in (frames[0], frames[-1]))
    assert first.shape[0] % 2 == first.shape[1] % 2 == 0  # as videos want it
    assert np.abs(first[60:] - last[60:]).mean() > 1  # it moves
    assert np.abs(first[:30, 320:] - last[:30, 320:]).mean() > 1  # so does the score above it


@pytest.mark.parametrize("scale", [0.4, 1.0, 1.7])
def test_a_walker_fills_the_picture_whatever_its_legs(scale):
    env = gymnasium.make("designrl/BipedalWalker-v0", design=np.full(8, scale))
    env.reset(seed=0)
    picture = WALKER.picture(env.unwrapped)
    body = np.abs(picture.astype(int) - (127, 51, 229)).sum(axis=2) < 12  # the hull's color
    body |= (picture[:, :, 0] > picture[:, :, 1] + 40) & (picture[:, :, 2] > picture[:, :, 1] + 20)
    rows = np.flatnonzero(body.any(axis=1))
    assert 0.5 < np.ptp(rows) / len(picture) < 0.9
    assert rows[0] > 10  # none of it is cut off


def test_an_evolution_goes_from_the_first_generation_to_the_last(run, tmp_path, monkeypatch):
    monkeypatch.setattr(video, "STAGE_SECONDS", 0.1)
    agents, done = [], []
    film = video.film
    monkeypatch.setattr(
        video, "film", lambda agent, seed: agents.append(agent) or film(agent, seed)
    )
    video.evolution_video(run, tmp_path / "a.gif", progress=done.append)
    mu = read(run / "generations.mcap").array("/distribution", "mu")
    assert np.array_equal(agents[0].parameters, mu[0])
    assert np.array_equal(agents[-1].parameters, mu[-1])
    assert 2 < len(agents) == sum(done) <= video.STAGES
    assert video._strip(600, np.arange(2), np.arange(2.0), 1).height % 2 == 0  # as .mp4 wants it
    assert len(frames_of(tmp_path / "a.gif")) == 3 * len(agents)  # steps 1, 3 and 5 of 0.02 s


def test_letters_keep_their_size_as_numbers_grow():
    blank = np.zeros((480, 640, 3), np.uint8)
    name = "biped-hardcore-morphology-smaller-leg seed 15"
    for before, after in (
        ("0.1 s: 0.0 points", "17.2 s: -350.7 points"),
        ("generation 0: -0.1 points", "generation 9999: 350.7 points"),
    ):
        bars = [np.asarray(video.captioned(blank, name, text))[:42] for text in (before, after)]
        assert np.array_equal(bars[0][:, :300], bars[1][:, :300])


def test_stages_divide_generations_and_scores_alike():
    held = np.arange(1000)
    scores = np.clip(held - 100, 0, 100)  # all is learned in generations 100 to 200
    stages = video._stages(held, held, scores)
    assert len(stages) == video.STAGES and {stages[0], stages[-1]} == {0, 999}
    assert 4 <= ((stages > 100) & (stages < 200)).sum() <= 6


def test_what_cannot_be_filmed_is_one_sentence(run, tmp_path, monkeypatch):
    agent = random_agent("biped")
    (tmp_path / "a.gif").write_bytes(b"precious")
    for name, problem in (("a.avi", "no video; give it a name in .mp4"), ("a.gif", "exists")):
        with pytest.raises(InputError, match=problem):
            video.record_video(agent, tmp_path / name, seed=0)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(InputError, match=r"PyAV \(for .mp4.*designrl\[video\]"):
        video.record_video(agent, tmp_path / "a.mp4", seed=0)
    record_rollout(agent, tmp_path / "a.mcap", seed=0)
    for source in (tmp_path / "a.mcap", tmp_path):
        shutil.copy(tmp_path / "a.mcap", tmp_path / "generations.mcap")
        with pytest.raises(InputError, match="holds no distributions of a run"):
            video.evolution_video(source, tmp_path / "b.gif")
    assert (tmp_path / "a.gif").read_bytes() == b"precious"
