"""Where a result comes from: versions of the code and its libraries, and the processor."""

import hashlib
import importlib.metadata
import os
import platform
from contextlib import suppress
from functools import cache
from pathlib import Path

VERSION = "0.1.0"
# Those that are installed count; of the two names of Box2D, one is.
LIBRARIES = ("box2d-py", "box2d", "gymnasium", "numpy", "pybullet", "safetensors", "torch")
# All that evaluation imports: what a score depends on. The rest (training, recordings, viewer,
# command line) may change without it.
SCORING_SOURCES = (
    "errors.py",
    "numeric.py",
    "files.py",
    "provenance.py",
    "design.py",
    "engine",
    "bodies",
    "envs",
    "experiments.py",
    "policy.py",
    "settings.py",
    "workers.py",
    "simulation.py",
    "checkpoint.py",
    "author.py",
    "names.py",
    "evaluation.py",
)


@cache
def versions() -> dict[str, str]:
    """Versions of this package and of the libraries that scores depend on."""
    found = {"designrl": VERSION}
    for name in LIBRARIES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


@cache
def sources_hash() -> str:
    """Hash of the sources that a score depends on (16 hex digits): names the code without git."""
    return _hash_of([Path(__file__).parent / name for name in SCORING_SOURCES])


@cache
def engine_hash() -> str:
    """Hash of the compiled engine's sources, which is compiled into it, too (setup.py)."""
    return _hash_of([Path(__file__).parent / "engine" / "native"])


def _hash_of(files: list[Path]) -> str:
    """Hash of sources (16 hex digits), with all that are in folders."""
    root, digest = Path(__file__).parent, hashlib.sha256()
    files = files + [path for folder in files if folder.is_dir() for path in folder.rglob("*")]
    for path in sorted(files):
        if path.suffix in (".py", ".cpp", ".h"):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def core_count() -> int:
    """How many processors this process may use; where the system does not tell (macOS), all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processor() -> str:
    """The processor, with its name where Linux tells it: core-hours mean little without."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return f"{platform.machine()} {line.partition(':')[2].strip()}"
    return platform.machine()
