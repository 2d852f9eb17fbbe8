"""Train the published runs, or those of them that are missing.

    make train-all              one run on each core; each is published when it is done
    make train-all ONLY=biped   those of one experiment, or of several: ONLY="biped ant"
    make verify-runs            train the first generations of every published run again and compare

Which runs there are, and with which settings each is trained, is decided by `plan`.
Ctrl-C saves all; the next call goes on. What is not done yet is in runs/all.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from designrl.checkpoint import STATE_FORMAT, load, read_tensors
from designrl.errors import InputError
from designrl.experiments import get_experiment
from designrl.files import write_atomically
from designrl.numeric import whole_number
from designrl.provenance import core_count
from designrl.recording import read, thin
from designrl.settings import TrainSettings
from designrl.train import TrainingRun
from reproduce import paths
from reproduce.paths import EIGHT, shown
from reproduce.program import program
from reproduce.publish import messages_kept, publish, settings_of

# How many seeds, from 0 on, of each experiment are trained first; then up to how many. By letters.
FIRST = {"c": 10, "d": 10, "e": 10, "g": 5, "b": 5, "a": 5, "f": 3, "h": 3}
LATER = {"f": 5, "h": 5, "b": 10, "a": 10}
# Runs with the paper's own settings, by letter and seed, in the order in which they are trained.
# Fixed before they start, and every one that is begun is published.
PAPER = ["g1", "g2", "f1", "g0", "g3", "h0", "f0", "h1", "g4", "f2", "h2", "d0", "c0", "b0", "a0"]
# Those of the paper's web page: bodies with other limits, which no table has.
BLOOPERS = "eg"
LOOK_SECONDS = 2.0  # between two looks at the runs
SAY_SECONDS = 600.0  # between two lines of a run where the output is no terminal
COMPARED_GENERATIONS = 3  # of a recording, by verify
COMPARED_FIELDS = ("mean", "sd", "best", "worst", "sigma_mean", "sigma_min", "sigma_max", "steps")


@dataclass(frozen=True)
class Planned:
    """A run that is to be published.

    Attributes:
        settings: of a recipe of its experiment, with a seed.
        name: of its files.
    """

    settings: TrainSettings
    name: str

    @property
    def place(self) -> Path:
        """EXPERIMENT/NAME, under pretrained/, logs/ and the folder of unfinished runs."""
        return Path(self.settings.experiment, self.name)

    @property
    def published(self) -> bool:
        """It is done: its checkpoint is there and says that it was trained so."""
        path = (paths.ROOT / "pretrained" / self.place).with_suffix(".safetensors")
        return path.exists() and load(path).metadata.get("settings") == self.settings.as_dict()


def plan() -> Iterator[Planned]:
    """All runs, those that make every row of Table 3 useful first."""
    names = {experiment.letter: name for name, experiment in EIGHT.items()}

    def seeds(counts: dict[str, int], start: dict[str, int]) -> Iterator[Planned]:
        for seed in range(max(counts.values())):
            for letter, count in counts.items():
                if start.get(letter, 0) <= seed < count:
                    settings = TrainSettings.of(names[letter], "ours", seed=seed)
                    yield Planned(settings, f"seed{seed}")

    first = list(seeds(FIRST, {}))
    yield from first[: len(FIRST)]
    for letter, seed in PAPER:
        yield Planned(settings_of(names[letter], "paper", int(seed)), f"paper-seed{seed}")
    yield from first[len(FIRST) :]
    for letter in BLOOPERS:
        settings = TrainSettings.of(names[letter], "ours", design_form="lognormal")
        yield Planned(settings, "blooper-seed0")
    yield from seeds(LATER, FIRST)


def unfinished(run: Planned) -> Path:
    """Where the state of a run that was left unfinished is committed."""
    return paths.ROOT / "logs" / "unfinished" / run.place


@dataclass
class Training:
    """A run that is being trained in a process of its own."""

    run: Planned
    folder: Path
    process: subprocess.Popen
    bar: tqdm
    position: int  # of its line
    said: float = 0.0

    def look(self) -> None:
        """Show how far it is."""
        with suppress(InputError, KeyError):  # it has not saved yet
            _, about = read_tensors(self.folder / "state.safetensors", STATE_FORMAT)
            progress = about["progress"]
            self.bar.n = progress["generation"]
            if (best := progress["best_score"]) is not None:
                self.bar.set_postfix_str(f"best {best:.1f}", refresh=False)
            if not self.bar.disable:
                self.bar.refresh()
            elif time.monotonic() - self.said > SAY_SECONDS:
                self.said = time.monotonic()
                best = "" if best is None else f", best evaluation {best:.1f}"
                of = f"{self.bar.n} of {self.bar.total} generations"
                print(f"{self.run.place}: {of}{best}", flush=True)


def start(run: Planned, folder: Path, position: int) -> Training:
    """Start or go on with a run, on one core."""
    left = unfinished(run)
    if left.exists() and not folder.exists():
        shutil.copytree(left, folder)
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", *run.settings.command().split()]
    command += ["--workers", "1", "--out", str(folder)]
    command += ["--resume"] * (folder / "state.safetensors").exists()
    with (folder / "log.txt").open("w") as log:
        process = subprocess.Popen(
            command, cwd=paths.ROOT, stdin=subprocess.DEVNULL, stdout=log, stderr=log
        )
    bar = tqdm(
        total=run.settings.generations, desc=str(run.place), position=position, leave=False,
        unit="gen", disable=None,
    )  # fmt: skip
    return Training(run, folder, process, bar, position)


def finish(training: Training) -> str | None:
    """Publish a run whose process has ended; what is wrong with it, if anything."""
    training.bar.close()
    place = training.run.place
    if code := training.process.returncode:
        lines = (training.folder / "log.txt").read_text(errors="replace").strip().splitlines()
        return f"{place} stopped with exit code {code}: {lines[-1] if lines else 'no word'}"
    try:
        tqdm.write(publish(training.folder, training.run.name, replace=True))
    except (InputError, OSError) as error:
        return f"{place} is trained and could not be published: {error}"
    shutil.rmtree(unfinished(training.run), ignore_errors=True)
    return None


def train(waiting: list[Planned], folder: Path, cores: int) -> None:
    """Train runs in so many processes; ends the program with a sentence where one fails."""
    active: list[Training] = []
    failures: list[str] = []
    try:
        while waiting or active:
            free = [i for i in range(cores) if i not in {training.position for training in active}]
            while waiting and len(active) < cores:
                active.append(start(run := waiting.pop(0), folder / run.place, free.pop(0)))
            for training in list(active):
                training.look()
                if training.process.poll() is not None:
                    active.remove(training)
                    failures += filter(None, [finish(training)])
            time.sleep(LOOK_SECONDS)
    except BaseException as error:
        for training in active:
            training.process.terminate()  # saves, too; in the background Ctrl-C is ignored
        for training in active:
            training.process.wait()
            training.bar.close()
        if not isinstance(error, KeyboardInterrupt):
            raise
        failures.append(f"stopped, all is saved in {folder}; the same command goes on")
    if failures:
        sys.exit("\n".join(f"train-all: {failure}" for failure in failures))


def save(left: list[Planned], folder: Path) -> None:
    """Copy what a resume of each unfinished run needs to logs/unfinished, in a small form."""
    for run in left:
        source, target = folder / run.place, unfinished(run)
        if (source / "state.safetensors").exists():
            target.mkdir(parents=True, exist_ok=True)
            # A resume says which generations have no summary, so these are complete.
            keep = messages_kept(get_experiment(run.settings.experiment), run.name)
            del keep["/summary"]
            thin(source / "generations.mcap", target / "generations.mcap", keep)
            # The state last: with an older one, what is there goes on from an earlier generation.
            for name in ("best.safetensors", "state.safetensors"):
                with suppress(FileNotFoundError):
                    write_atomically(target / name, (source / name).read_bytes())
            print(f"{shown(target)} written")


def compare(run: Planned) -> int:
    """Train the first generations of a published run again; returns how many were compared.

    Raises:
        InputError: they differ from the run's recording.
    """
    recording = read(paths.ROOT / "logs" / run.place / "generations.mcap")
    held = recording.generations[:COMPARED_GENERATIONS]
    with tempfile.TemporaryDirectory() as folder:
        again = TrainingRun(replace(run.settings, generations=int(held[-1]) + 1), folder)
        again.run()
        ours = read(Path(folder, "generations.mcap"))
        for field in COMPARED_FIELDS:
            now = ours.array("/summary", field)[held]
            then = recording.array("/summary", field)[:COMPARED_GENERATIONS]
            if not np.array_equal(now, then):
                raise InputError(f"{run.place}: {field} of generations {held} is {now}, not {then}")
    return len(held)


def verify(runs: list[Planned]) -> None:
    """Compare published runs; ends the program with a sentence for each that differs."""
    differences: list[str] = []
    for run in runs:
        try:
            print(f"{run.place}: {compare(run)} generations again, to the bit", flush=True)
        except InputError as error:
            differences.append(f"train-all: {error}")
    if differences:
        sys.exit("\n".join(differences))


def main() -> None:
    """Train, save or verify the runs of the plan."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", metavar="EXPERIMENT", help="runs of these alone")
    parser.add_argument("--folder", type=Path, default=paths.ROOT / "runs" / "all")
    parser.add_argument("--cores", type=int, default=core_count())
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--save", action="store_true", help="unfinished runs to logs/unfinished")
    what.add_argument("--verify", action="store_true", help="the first generations once more")
    args = parser.parse_args()
    only = {get_experiment(name).name for name in args.only or EIGHT}
    planned = [run for run in plan() if run.settings.experiment in only]
    left = [run for run in planned if not run.published]
    if args.verify:
        verify([run for run in planned if run.published])
    elif args.save:
        save(left, args.folder)
    else:
        print(f"{len(planned) - len(left)} of {len(planned)} runs are published", flush=True)
        train(left, args.folder.absolute(), whole_number("--cores", args.cores, 1))


if __name__ == "__main__":
    with program("train-all"):
        main()
