"""A disk that fails at each write in turn, or loses its power there."""

import errno
import os
import stat
from pathlib import Path

import numpy as np
import pytest

from designrl.errors import InputError
from designrl.recording import read
from designrl.recording.mcap_file import McapFile
from designrl.settings import TrainSettings
from designrl.simulation import RolloutResult, Simulator
from designrl.train import TrainingRun

GENERATIONS = 3
SETTINGS = TrainSettings.of(
    "biped-morphology",
    generations=GENERATIONS,
    population=2,
    rollouts=1,
    evaluate_every=2,
    evaluation_episodes=1,
)


class PowerCutError(BaseException):
    """Nothing more happens."""


class Disk:
    """Counts what is done to a folder and ends it at one point.

    Args:
        folder: the run's.
        end_at: index of the write, sync or rename that fails; None: none does.
        how: "error" (it fails, later ones do not), "full" (it fails, and all after it), "cut" (the
            power goes before it), "torn" (in the middle of it).
    """

    def __init__(self, folder: Path, end_at: int | None, how: str, monkeypatch):
        self.folder, self.end_at, self.how = folder, end_at, how
        self.count, self.dead = 0, False
        self.synced: dict[int, bytes] = {}  # inode -> content that survives a power cut
        self.names: dict[Path, int] = {}  # path -> inode, likewise
        self.real = {name: getattr(os, name) for name in ("write", "pwrite", "fsync", "replace")}
        for name in self.real:
            monkeypatch.setattr(os, name, lambda *a, name=name: self.do(name, *a))
        unlink = Path.unlink
        monkeypatch.setattr(Path, "unlink", lambda p, **k: self.dead or unlink(p, **k))

    def do(self, name, *arguments):
        if self.dead:
            raise PowerCutError
        index, self.count = self.count, self.count + 1
        due = self.end_at is not None and index >= self.end_at
        if due and self.how in ("cut", "torn"):
            self.dead = True
            if self.how == "torn" and name in ("write", "pwrite"):
                descriptor, data, *place = arguments
                self.real[name](descriptor, bytes(data)[: len(data) // 2], *place)
            raise PowerCutError
        if due and (index == self.end_at or self.how == "full"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        result = self.real[name](*arguments)
        if name == "fsync":
            self.sync(arguments[0])
        return result

    def sync(self, descriptor: int) -> None:
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            self.names = {p: i for p, i in self.names.items() if p.parent != path}
            self.names |= {p: p.stat().st_ino for p in path.iterdir() if p.is_file()}
        else:
            self.synced[os.fstat(descriptor).st_ino] = path.read_bytes()

    def forget(self) -> None:
        """What was not synced is lost."""
        contents = {path: self.synced.get(inode, b"") for path, inode in self.names.items()}
        for path in self.folder.rglob("*"):
            if path.is_file():
                path.unlink()
        for path, content in contents.items():
            path.write_bytes(content)


@pytest.fixture
def quick(monkeypatch):
    """Simulations that take no time, and a state that is saved after every generation."""

    def rollout(self, candidates, seeds, *_):
        returns = np.sin(candidates.sum(axis=1)[:, None] * 1000 + seeds)
        return RolloutResult(returns, np.ones(seeds.shape, dtype=np.int64))

    def record(agent, path, seed, **_):
        file = McapFile(path)
        file.publish()
        file.close()

    monkeypatch.setattr(Simulator, "rollout", rollout)
    monkeypatch.setattr("designrl.train.record_rollout", record)
    monkeypatch.setattr("designrl.train.SAVE_SECONDS", 0.0)
    monkeypatch.setattr("designrl.recording.mcap_file.SEAL_SECONDS", np.inf)  # none between


def train(folder: Path) -> None:
    TrainingRun(SETTINGS, folder, backend="reference", resume=True).run()


def contents(folder: Path) -> tuple[bytes, list, list]:
    recording = read(folder / "generations.mcap")
    topics = ("/summary", "/distribution", "/returns", "/evaluation")
    generations = [recording.array(topic, "generation").tolist() for topic in topics]
    files = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    return (folder / "best.safetensors").read_bytes(), generations, files


@pytest.mark.parametrize("how", ["error", "full", "cut", "cut, unsynced lost", "torn"])
def test_a_write_that_fails_costs_nothing(how, quick, tmp_path):
    undisturbed, everything = tmp_path / "undisturbed", list(range(GENERATIONS))
    with pytest.MonkeyPatch.context() as patch:
        disk = Disk(undisturbed, None, "", patch)
        train(undisturbed)
    expected = contents(undisturbed)
    assert expected[1] == [everything, everything, everything, [1, 2]]
    assert disk.count > 20
    error = InputError if how in ("error", "full") else PowerCutError
    for end_at in range(disk.count):
        folder = tmp_path / f"{end_at}"
        with pytest.MonkeyPatch.context() as patch, pytest.raises(error) as caught:
            disk = Disk(folder, end_at, how.split(",")[0], patch)
            train(folder)
        if error is InputError:
            assert str(folder) in str(caught.value)
            assert "No space left on device" in str(caught.value)
        if "lost" in how:
            disk.forget()
        if (folder / "generations.mcap").exists():
            held = read(folder / "generations.mcap").generations.tolist()
            assert held == everything[: len(held)]
        train(folder)
        assert contents(folder) == expected, f"operation {end_at}"
