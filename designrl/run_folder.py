"""The folder of a training run: what lies in it, that it is the run's own, and its lock."""

import fcntl
import math
import os
import stat
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from designrl import checkpoint
from designrl.errors import InputError
from designrl.files import remove_unfinished
from designrl.settings import TrainSettings

RESULTS = ("best.safetensors", "generations.mcap", "rollouts")
# Names of all files that a run writes, as a regular expression.
WRITTEN = r"(best|state|failed-generation\d+-candidate\d+)\.safetensors|generation(s|\d+)\.mcap"


@dataclass
class Progress:
    """What a run has reached; with the optimiser's state, all that a resume needs."""

    generation: int = 0  # updates so far
    best_score: float | None = None
    best_generation: int | None = None
    total_steps: int = 0  # environment steps, evaluations included
    seconds: float = 0.0  # wall time
    cpu_seconds: float = 0.0  # processor time; for a pool of processes, wall time times workers


class RunFolder:
    """A run's folder, existing or not.

    Attributes:
        path: of the folder.
        state, best, recording, rollouts: what a run writes there.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self.state = self.path / "state.safetensors"
        self.best = self.path / "best.safetensors"
        self.recording = self.path / "generations.mcap"
        self.rollouts = self.path / "rollouts"
        self._lock: int | None = None  # the open file, while a run holds it

    @property
    def has_results(self) -> bool:
        """Whether a run has left something there."""
        return any((self.path / name).exists() for name in RESULTS)

    def failed(self, generation: int, candidate: int) -> Path:
        """Where a candidate that cannot be simulated is kept."""
        name = f"failed-generation{generation:05d}-candidate{candidate}.safetensors"
        return self.path / name

    def rollout(self, generation: int) -> Path:
        """Where the rollout of a generation's agent is recorded."""
        return self.rollouts / f"generation{generation:05d}.mcap"

    def check(self) -> None:
        """Refuse a folder in which something leads elsewhere, or that is not the locked one.

        Raises:
            InputError: it is so.
        """
        for name in (*RESULTS, "state.safetensors", ".lock"):
            path = self.path / name
            is_fine, kind = (
                (stat.S_ISDIR, "folder") if name == "rollouts" else (stat.S_ISREG, "file")
            )
            try:
                if not is_fine(path.lstat().st_mode):
                    raise InputError(
                        f"{path} is not a plain {kind}; remove it, or choose another folder with "
                        "--out"
                    )
            except FileNotFoundError:
                pass
            except OSError as error:
                raise self._unusable(error) from None
        if self._lock is None:
            return
        try:
            ours = os.path.samestat((self.path / ".lock").lstat(), os.fstat(self._lock))
        except OSError:
            ours = False
        if not ours:
            raise InputError(
                f"{self.path} was removed, renamed or replaced under the run; put it back, or name "
                "it as it is now with --out, and add --resume"
            )

    def clean(self) -> None:
        """Remove what a killed run left unfinished; `check` first."""
        for folder in (self.path, self.rollouts):
            remove_unfinished(folder, WRITTEN)

    def _unusable(self, error: OSError) -> InputError:
        return InputError(
            f"{self.path} cannot be used as the run's folder ({error.strerror}); choose another "
            "with --out"
        )

    @contextmanager
    def locked(self):
        """Hold the folder for one run, made where it is missing.

        Raises:
            InputError: it cannot be used, or another run holds it.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
            self._lock = os.open(self.path / ".lock", flags, 0o666)
        except OSError as error:
            raise self._unusable(error) from None
        try:
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(f"{self.path} is in use by another run; wait for it") from None
            yield
        finally:
            os.close(self._lock)
            self._lock = None

    def write_state(self, tensors: dict, about: dict) -> None:
        """Save what a resume needs: the optimiser's state; settings and progress, among others."""
        checkpoint.write_tensors(self.state, tensors, about, checkpoint.STATE_FORMAT)

    def read_state(self, settings: TrainSettings) -> tuple[dict, Progress, dict]:
        """What `write_state` saved, the progress for itself, too.

        Raises:
            InputError: it is damaged, of a run with other settings (but for fewer generations), or
                the agent beside it is not the one that this run kept.
        """
        tensors, about = checkpoint.read_tensors(self.state, checkpoint.STATE_FORMAT)
        damaged = InputError(f"{self.state} is damaged; start again in another folder")
        try:
            theirs = about["settings"].get("experiment")
            if theirs != settings.experiment:
                raise InputError(
                    f"{self.path} holds a run of {theirs}, not {settings.experiment}; choose "
                    "another folder with --out"
                )
            for name, ours in vars(settings).items():
                theirs = about["settings"].get(name)
                if theirs != ours and not (name == "generations" and theirs < ours):
                    raise InputError(
                        f"{self.path} holds a run with {name} = {theirs!r}, not {ours!r}; resume "
                        "with the same settings, or choose another folder with --out"
                    )
            progress = Progress(**about["progress"])
            numbers = [value for value in vars(progress).values() if value is not None]
            whole = isinstance(progress.generation, int) and isinstance(progress.total_steps, int)
            if not whole or progress.generation < 0 or not all(map(math.isfinite, numbers)):
                raise damaged
        except (AttributeError, KeyError, TypeError, OverflowError):
            raise damaged from None
        self._check_best(settings, progress)
        return tensors, progress, about

    def _check_best(self, settings: TrainSettings, progress: Progress) -> None:
        """The kept agent is this run's, and not older than the state."""
        kept, mend = progress.best_generation, "put it back, or start again in another folder"
        if not self.best.exists():
            if kept is not None:
                raise InputError(
                    f"{self.path} has lost its {self.best.name}, kept at generation {kept}; {mend}"
                )
            return
        found = checkpoint.load(self.best, settings.experiment).metadata
        theirs, generation = found.get("settings"), found.get("generation")
        if isinstance(theirs, dict):
            theirs = {**theirs, "generations": settings.generations}
        # A killed run may have kept a better one since it saved its state.
        of_now = generation == kept and found.get("score") == progress.best_score
        later = isinstance(generation, int) and generation > progress.generation
        if theirs != settings.as_dict() or not (of_now or later):
            raise InputError(f"{self.best} is not what this run kept at generation {kept}; {mend}")
