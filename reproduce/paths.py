"""Where the project keeps what its tables and figures are made of."""

import re
import tomllib
from pathlib import Path

from designrl.experiments import PAPERS

ROOT = Path(__file__).resolve().parents[1]
EIGHT = {experiment.name: experiment for experiment in PAPERS}  # whatever else is registered


def paper() -> dict:
    """The paper's printed numbers."""
    return tomllib.loads((ROOT / "paper" / "paper.toml").read_text(encoding="utf-8"))


def shown(path: Path) -> str:
    """A path as a reader of the repository would write it."""
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else path.name


def pretrained(experiment: str) -> list[Path]:
    """Our checkpoints of an experiment by its recipe, by seed."""
    found = (ROOT / "pretrained" / experiment).glob("seed*.safetensors")
    return sorted(found, key=lambda path: (len(path.name), path.name))


def seed_of(name: str) -> int | None:
    """The seed of a published run, "seed3" or "paper-seed3"; None where that is no such name."""
    found = re.fullmatch(r"(?:paper-)?seed(\d+)", name)
    return int(found[1]) if found else None


def recordings(experiment: str) -> list[Path]:
    """The recordings of our runs of an experiment, that with the paper's own settings first."""
    return sorted((ROOT / "logs" / experiment).glob("*seed*/generations.mcap"))


def recording_of(checkpoint: Path) -> Path:
    """The recording of the run that one of our checkpoints is of."""
    return ROOT / "logs" / checkpoint.parent.name / checkpoint.stem / "generations.mcap"
