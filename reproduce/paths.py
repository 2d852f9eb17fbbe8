"""Where the project keeps what its tables and figures are made of."""

import tomllib
from pathlib import Path

from designrl.experiments import PAPERS
from designrl.names import RUN

ROOT = Path(__file__).resolve().parents[1]
EIGHT = {experiment.name: experiment for experiment in PAPERS}  # whatever else is registered


def paper() -> dict:
    """The paper's printed numbers."""
    return tomllib.loads((ROOT / "paper" / "paper.toml").read_text(encoding="utf-8"))


def shown(path: Path) -> str:
    """A path as a reader of the repository would write it."""
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else path.name


def pretrained(experiment: str) -> list[Path]:
    """Our checkpoints of an experiment, by seed; those at the paper's settings last."""
    found = (ROOT / "pretrained" / experiment).glob("*seed*.safetensors")
    runs = [path for path in found if seed_of(path.stem) is not None and not is_blooper(path)]
    return sorted(runs, key=lambda path: (at_papers_settings(path), seed_of(path.stem)))


def bloopers() -> list[Path]:
    """Our checkpoints whose bodies have other limits than the paper's."""
    return sorted((ROOT / "pretrained").glob("*/blooper-seed*.safetensors"))


def at_papers_settings(path: Path) -> bool:
    """Whether a checkpoint, or a recording's folder, is of a run at the paper's settings."""
    return path.name.startswith("paper-")


def is_blooper(path: Path) -> bool:
    """Whether a checkpoint, or a recording's folder, is of a run with other limits of its body."""
    return path.name.startswith("blooper-")


def is_authors(path: Path) -> bool:
    """Whether a checkpoint is one of the author's files."""
    return path.suffix == ".json"


def seed_of(name: str) -> int | None:
    """The seed of a published run ("seed3", "paper-seed3", "blooper-seed3"), or None."""
    found = RUN.fullmatch(name)
    return int(found[2]) if found else None


def recordings(experiment: str) -> list[Path]:
    """The recordings of an experiment in Table 3, those at the paper's settings first."""
    found = (ROOT / "logs" / experiment).glob("*seed*/generations.mcap")
    return sorted(path for path in found if not is_blooper(path.parent))


def unfinished(experiment: str) -> list[Path]:
    """The recordings of runs at the paper's settings that are still being trained."""
    found = (ROOT / "logs" / "unfinished" / experiment).glob("paper-*/generations.mcap")
    published = {path.parent.name for path in recordings(experiment)}
    return sorted(path for path in found if path.parent.name not in published)


def recording_of(checkpoint: Path) -> Path:
    """The recording of the run that one of our checkpoints is of."""
    return ROOT / "logs" / checkpoint.parent.name / checkpoint.stem / "generations.mcap"
