"""Whose runs the tables and figures show: ours, and where it is asked for the author's."""

import os
from dataclasses import dataclass
from pathlib import Path

from designrl import author
from designrl.errors import InputError
from designrl.simulation import BACKENDS
from reproduce import paths, scores
from reproduce.paths import EIGHT, at_papers_settings, pretrained, seed_of
from reproduce.scores import Score, usable

OURS, AT_PAPERS = "ours", "ours, the paper's settings"
ENOUGH = 5  # runs at the paper's settings, to be shown before the recipe's


def our_runs(experiment: str) -> dict[str, dict[int, Path]]:
    """Our checkpoints by source, OURS and AT_PAPERS, and number, which is seed + 1.

    First come the recipe's, or those at the paper's settings once they are ENOUGH.
    """
    found: dict[str, dict[int, Path]] = {OURS: {}, AT_PAPERS: {}}
    for path in pretrained(experiment):
        found[AT_PAPERS if at_papers_settings(path) else OURS][seed_of(path.stem) + 1] = path
    first = AT_PAPERS if len(found[AT_PAPERS]) >= ENOUGH else OURS
    return {first: found[first]} | found


@dataclass(frozen=True)
class Sources:
    """What tables and figures are made from.

    Attributes:
        zoo: a folder of the author's weights, which are scored beside ours; None: ours alone.
        backend: what plays the episodes, "engine" or "reference".

    Raises:
        InputError: the folder has no known file, or another backend.
    """

    zoo: str | None = None
    backend: str = "engine"

    def __post_init__(self):
        if self.backend not in BACKENDS:
            raise InputError(f"BACKEND={self.backend}: it must be one of {', '.join(BACKENDS)}")
        if self.zoo and not any(author.runs(self.zoo, name) for name in EIGHT):
            raise InputError(
                f"ZOO={self.zoo} is not a folder of the author's weights: looked in it and in its "
                f"folders zoo and */zoo for {', '.join(map(author.file_name, EIGHT))}"
            )

    @classmethod
    def asked(cls) -> "Sources":
        """What `make ... ZOO=path BACKEND=reference` asks for."""
        return cls(os.environ.get("ZOO") or None, os.environ.get("BACKEND") or "engine")

    @property
    def folder(self) -> Path:
        """paper/, or paper/with-zoo/ (not committed) with the author's weights."""
        return paths.ROOT / "paper" / ("with-zoo" if self.zoo else "")

    def read_for(self, *names: str) -> list[Path]:
        """All files that scores of these experiments depend on: the paper's, ours, the author's."""
        ours = [path for name in names for path in pretrained(name)]
        theirs = [path for name in names for path in self._author_runs(name).values()]
        return [paths.ROOT / "paper" / "paper.toml", *ours, *theirs]

    def authors(self, experiment: str) -> dict[int, Path]:
        """The author's runs of an experiment, by number; a missing run 1 by its name."""
        return {1: Path(author.file_name(experiment))} | self._author_runs(experiment)

    def _author_runs(self, experiment: str) -> dict[int, Path]:
        return author.runs(self.zoo, experiment) if self.zoo else {}

    def by_source(self, *experiments: str) -> dict[str, dict[str, dict[int, Score]]]:
        """Of each experiment our runs as `our_runs` has them; and the "author's weights"."""
        found = {name: our_runs(name) for name in experiments}
        if self.zoo:
            for name, by_run in found.items():
                by_run["author's weights"] = self.authors(name)
        files = [
            (path, name)
            for name, sources in found.items()
            for runs in sources.values()
            for path in runs.values()
        ]
        scored = dict(zip(files, scores.score_all(files, self.backend), strict=True))
        return {
            name: {
                source: {run: scored[path, name] for run, path in runs.items()}
                for source, runs in sources.items()
            }
            for name, sources in found.items()
        }

    def by_label(self, experiment: str, scored: bool = True) -> dict[str, Score]:
        """Our runs, "ours, seed 0" for instance, and the author's run 1."""
        ours = pretrained(experiment)
        theirs = [self.authors(experiment)[1]] if self.zoo else []
        files = [(path, experiment) for path in ours + theirs]
        if scored:
            found = scores.score_all(files, self.backend)
        else:
            found = [scores.unscored(*file) for file in files]
        labels = [f"ours, {s.run}" for s in found[: len(ours)]] + ["author's weights"]
        return dict(zip(labels, found, strict=False))

    def representative(self, experiment: str, rank: int = 0) -> Score | None:
        """The run that a figure shows: our best (rank 0) or next best one; None where none is.

        With the author's weights: his run 1, or for rank 1 the run 9 of the paper's Figure 7.
        """
        shown = pretrained(experiment)
        if self.zoo:
            runs, rank = self.authors(experiment), (1, 9)[rank]
            shown, rank = [path for run, path in runs.items() if run == rank], 0
        found = usable(scores.score_all([(path, experiment) for path in shown], self.backend))
        found.sort(key=lambda s: -s.mean)
        return found[rank] if len(found) > rank else None
