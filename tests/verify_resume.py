"""Kills training runs at random moments and goes on with them, until nothing is left to do.

    python tests/verify_resume.py                 100 kills; exit code 1 if anything is different
    python tests/verify_resume.py --kills 1000 --seed 5

Each run ends with the bytes of an undisturbed one in best.safetensors; its recording opens after
every kill and holds each generation and evaluation once in the end; no process and no half-written
file remains. Killed are the trainer (SIGKILL, SIGTERM, SIGINT), one of its processes, or all.
"""

import argparse
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import psutil

ROOT = Path(__file__).resolve().parents[1]
GENERATIONS = 12
ARGUMENTS = ["biped-morphology", "--population", "4", "--rollouts", "1", "--workers", "2"]
ARGUMENTS += ["--evaluate-every", "3", "--evaluation-episodes", "2"]
ARGUMENTS += ["--generations", str(GENERATIONS)]
VICTIMS = {
    "reference": ("SIGKILL", "SIGTERM", "SIGINT", "all", "worker", "worker", "worker"),
    "engine": ("SIGKILL", "SIGTERM", "SIGINT", "all"),  # its workers are threads
}
EXIT_CODES = {  # that a trainer may end with after each; 0 where it was done before
    None: (0,),
    "worker": (0,),
    "SIGKILL": (0, -9),
    "all": (0, -9),
    "SIGTERM": (0, 130, -15),
    "SIGINT": (0, 130, -2, 1),
}
MOST_SECONDS = 1800.0  # for one run to end: a guard against one that hangs, on any machine


class DifferenceError(Exception):
    """An interrupted run is not what an undisturbed one is."""


def trainer(arguments: list[str]) -> None:
    """`designrl train`, but saving all the time, so that there are more moments to kill it in."""
    from designrl import cli, train
    from designrl.recording import mcap_file

    train.SAVE_SECONDS = mcap_file.SEAL_SECONDS = 0.05
    print("ready", flush=True)
    cli.main(["train", *arguments])


def start(out: Path, backend: str) -> subprocess.Popen:
    """A trainer that goes on with what the folder holds."""
    return subprocess.Popen(
        [sys.executable, __file__, "--trainer", *ARGUMENTS, "--backend", backend]
        + ["--out", str(out), "--resume"],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen) -> tuple[int, str]:
    """Exit code and last words."""
    try:
        _, errors = process.communicate(timeout=MOST_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        raise DifferenceError(f"it still runs after {MOST_SECONDS:.0f} s") from None
    return process.returncode, errors


def kill_something(
    process: subprocess.Popen, victim: str, rng: random.Random
) -> tuple[str, list[psutil.Process]]:
    """Send a signal; returns which, and the processes that must end if the trainer does."""
    family = psutil.Process(process.pid).children(recursive=True)
    if victim == "worker" and not family:
        victim = "SIGKILL"
    if victim == "worker":
        rng.choice(family).kill()
    elif victim == "all":
        for member in [process, *family]:
            member.send_signal(signal.SIGKILL)
    else:
        process.send_signal(getattr(signal, victim))
    return victim, family


def wait_for_workers(process: subprocess.Popen) -> None:
    """Until two of them run beside their fork server and resource tracker, or for some seconds."""
    deadline = time.monotonic() + 20
    while process.poll() is None and time.monotonic() < deadline:
        if len(psutil.Process(process.pid).children(recursive=True)) >= 4:
            return
        time.sleep(0.02)


def held(out: Path) -> tuple[list[int], list[int]]:
    """Generations and evaluations in the recording of a run."""
    from designrl.recording import read

    path = out / "generations.mcap"
    if not path.exists():
        return [], []
    recording = read(path)
    lists = [
        recording.array(topic, "generation").tolist() if topic in recording.topics else []
        for topic in ("/summary", "/design", "/distribution", "/returns", "/evaluation")
    ]
    if any(found != lists[0] for found in lists[1:4]):
        raise DifferenceError(f"the recording's topics hold different generations: {lists[:4]}")
    return lists[0], lists[4]


def check_end(out: Path, expected: Path) -> None:
    """A finished run is what an undisturbed one is."""
    if (out / "best.safetensors").read_bytes() != (expected / "best.safetensors").read_bytes():
        raise DifferenceError(f"{out}/best.safetensors has other bytes than {expected}'s")
    if held(out) != held(expected):
        raise DifferenceError(f"{out} holds {held(out)}, not {held(expected)}")
    names, wanted = ({p.relative_to(f) for p in f.rglob("*")} for f in (out, expected))
    if names != wanted:
        raise DifferenceError(f"{out} holds other files: {names ^ wanted}")


def run_with_kills(
    out: Path, expected: Path, backend: str, kills: int, rng: random.Random
) -> Counter:
    """One run from start to end with at most so many kills; returns how many of each kind."""
    done = Counter()
    while True:
        process, victim, family = start(out, backend), None, []
        if done.total() < kills:
            wanted = rng.choice(VICTIMS[backend])
            if rng.random() < 0.9:  # else kill it while it starts
                process.stdout.readline()
            if wanted == "worker":
                wait_for_workers(process)
            time.sleep(rng.uniform(0.0, 2.0))
            if process.poll() is None:
                victim, family = kill_something(process, wanted, rng)
                done[victim] += 1
        code, errors = finish(process)
        if code not in EXIT_CODES[victim]:
            raise DifferenceError(f"after killing {victim}: exit code {code}: {errors}")
        if left := psutil.wait_procs(family, timeout=MOST_SECONDS)[1]:
            raise DifferenceError(f"after killing {victim}, {left} outlived their trainer")
        generations, _ = held(out)
        if generations != list(range(len(generations))):
            raise DifferenceError(f"after {dict(done)}, the recording holds {generations}")
        if code == 0:
            check_end(out, expected)
            return done


def verify(folder: Path, kills: int, seed: int, backends=tuple(VICTIMS)) -> Counter:
    """Kill so many times; returns how many of each kind.

    Raises:
        DifferenceError: a run does not end as it should.
    """
    rng, done, runs = random.Random(seed), Counter(), 0
    for backend in backends:
        out = folder / f"undisturbed-{backend}"
        run_with_kills(out, out, backend, 0, rng)
    while done.total() < kills:
        backend = backends[runs % len(backends)]
        out, most = folder / f"run{runs}", min(8, kills - done.total())
        done += run_with_kills(out, folder / f"undisturbed-{backend}", backend, most, rng)
        runs += 1
        shutil.rmtree(out)
        print(f"{done.total()} kills, {runs} runs, all as they should be", flush=True)
    return done


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="designrl-"))
    try:
        done = verify(folder, options.kills, options.seed)
    except DifferenceError as difference:
        print(f"DIFFERENT {difference}\n(left in {folder})", file=sys.stderr)
        return 1
    shutil.rmtree(folder)
    print(", ".join(f"{count} {victim}" for victim, count in sorted(done.items())))
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--trainer"]:
        trainer(sys.argv[2:])
    else:
        sys.path.insert(0, str(ROOT))
        sys.exit(main())
