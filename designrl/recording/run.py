"""Recording a training run, and thinning such a recording."""

import sys
import time
from bisect import bisect_left
from pathlib import Path

import numpy as np

from designrl.experiments import get_experiment
from designrl.recording import schema_pb2 as schema
from designrl.recording.mcap_file import (
    END,
    RESUMED,
    RUN,
    THINNED,
    McapFile,
    RecordingError,
    uninterrupted,
)
from designrl.recording.scan import messages, scan

# Nearly all of a run's bytes, and of how many times as many generations a thinned copy has them.
HEAVY_TOPICS = {"/distribution": 1, "/returns": 1, "/design": 10}


class RunWriter:
    """Records a training run in `generations.mcap`; a context manager.

    The file is whole at every moment: a process that is killed loses what it recorded in the last
    second or, where writing is slow, in the last hundred times as long as a write takes.

    Args:
        path: the file; replaced if it exists, unless `resume_generation` is given.
        metadata: what to say of the run; "experiment" names it and the body's dimensions.
        resume_generation: keep what an existing file holds of the generations before this one,
            drop the rest, and go on. Where some of them are missing, because the file was cut or
            removed, a line on stderr and the metadata record "resumed" say so. The metadata stays.

    Raises (every method):
        RecordingError: the file cannot be written, or the one to go on with is no recording.
    """

    def __init__(
        self,
        path: str | Path,
        metadata: dict[str, str],
        resume_generation: int | None = None,
    ):
        name = metadata.get("experiment")
        experiment = get_experiment(name) if name else None
        self._design = experiment.design if experiment else None
        old = Path(path)
        resumed = resume_generation is not None
        held: set[int] = set()

        def keep(topic: str, index: int) -> bool:
            if topic == "/summary":
                held.add(index)
            return index < resume_generation

        self._file = McapFile(path)
        try:
            known = _copy(self._file, old, keep) if resumed and old.exists() else set()
            self._log_time = self._file.last_log_time
            if RUN not in known:
                self._file.metadata(RUN, metadata)
            if resumed:
                gap = _gap(held, resume_generation)
                about = {"generation": resume_generation} | ({"missing": gap} if gap else {})
                self._file.metadata(RESUMED, about)
            self._file.publish()
            if resumed and gap:
                print(f"{path}: {gap} (the file was cut or removed); going on", file=sys.stderr)
        except BaseException:
            self._file.abandon()
            raise

    def _write(self, topic: str, message, names=(), unit: str = "") -> None:
        # A wall clock may be set back; readers want times that never decrease.
        self._log_time = max(time.time_ns(), self._log_time)
        self._file.write(topic, message, self._log_time, message.generation, names, unit)

    @uninterrupted()
    def generation(
        self,
        index: int,
        mu: np.ndarray,
        sigma: np.ndarray,
        returns: np.ndarray,
        steps: np.ndarray,
        seeds: np.ndarray,
        seconds: float,
        total_steps: int,
        cpu_seconds: float = 0.0,
    ) -> None:
        """Record a generation.

        Args:
            index: of the generation, from 0.
            mu, sigma: (P,) the distribution that it was sampled from; stored as float32.
            returns: (N, R) float64, return of each episode of each candidate.
            steps: (N, R) their lengths.
            seeds: (N, R) their seeds.
            seconds: s of wall time that the run has taken so far.
            total_steps: environment steps of the run so far.
            cpu_seconds: s of processor time that the run has taken so far; 0: not known.
        """
        mu, sigma = np.asarray(mu, dtype=np.float32), np.asarray(sigma, dtype=np.float32)
        fitness = np.mean(returns, axis=1)
        self._write(
            "/summary",
            schema.Summary(
                generation=index,
                mean=fitness.mean(),
                sd=fitness.std(),
                best=fitness.max(),
                worst=fitness.min(),
                sigma_mean=sigma.mean(dtype=np.float64),
                sigma_min=sigma.min(),
                sigma_max=sigma.max(),
                steps=int(np.sum(steps)),
                total_steps=total_steps,
                seconds=seconds,
                cpu_seconds=cpu_seconds,
            ),
        )
        if self._design is not None:
            size = self._design.size
            m, s = mu[-size:].astype(np.float64), sigma[-size:].astype(np.float64)
            mean, one, other = (
                self._design.dimensions(self._design.scales(p)) for p in (m, m - s, m + s)
            )
            self._write(
                "/design",
                schema.Design(
                    generation=index,
                    mu=mu[-size:].tolist(),
                    sigma=sigma[-size:].tolist(),
                    dimensions=mean.tolist(),
                    lower=one.tolist(),
                    upper=other.tolist(),
                ),
                self._design.names,
                self._design.unit,
            )
        self._write(
            "/distribution",
            schema.Distribution(generation=index, mu=mu.tolist(), sigma=sigma.tolist()),
        )
        self._write(
            "/returns",
            schema.Returns(
                generation=index,
                rollouts=np.shape(returns)[1],
                returns=np.ravel(returns).tolist(),
                steps=np.ravel(steps).tolist(),
                seeds=np.ravel(seeds).tolist(),
            ),
        )
        self._file.seal_if_due()

    @uninterrupted()
    def evaluation(
        self, index: int, scores: np.ndarray, steps: np.ndarray, seeds: np.ndarray, kept: bool
    ) -> None:
        """Record the evaluation of an agent after generation `index`.

        Args:
            scores, steps, seeds: (E,) return, length and seed of each episode.
            kept: it is the best so far.
        """
        self._write(
            "/evaluation",
            schema.Evaluation(
                generation=index,
                kept=bool(kept),
                mean=np.mean(scores),
                sd=np.std(scores),
                scores=np.ravel(scores).tolist(),
                steps=np.ravel(steps).tolist(),
                seeds=np.ravel(seeds).tolist(),
            ),
        )
        self._file.seal_if_due()

    @uninterrupted()
    def flush(self) -> None:
        """Put everything so far into the file, where a power cut spares it."""
        self._file.seal(durable=True)

    @uninterrupted()
    def close(self, finished: bool = True) -> None:
        """Put everything into the file and end it; a second call does nothing."""
        if self._file.is_open:
            self._file.metadata(END, {"finished": str(finished).lower()})
            self._file.close()

    def __enter__(self) -> "RunWriter":
        return self

    def __exit__(self, kind, error, traceback) -> None:
        if kind is not None and issubclass(kind, RecordingError):
            self._file.abandon()  # it has said what is wrong, and the file is as good as it gets
        else:
            self.close(finished=kind is None)


def _gap(held: set[int], stop: int) -> str:
    """Which of the generations before `stop` are missing, in words; empty where none is."""
    missing = sorted(set(range(stop)) - held)
    if not missing:
        return ""
    return f"{len(missing)} of the generations {missing[0]} to {missing[-1]} are missing"


def _every_nth(held: list[int], step: int) -> set[int]:
    """Of generations in order, the first at or after each multiple of `step`, and the last."""
    if not held:
        return set()
    return {held[bisect_left(held, g)] for g in range(0, held[-1] + 1, step)} | {held[-1]}


def _copy(target: McapFile, source: Path, keep) -> set[str]:
    """Copy metadata and the messages for which keep(topic, generation) holds.

    Returns: the names of its metadata records.
    """
    found = scan(source)
    for name, values in found.metadata:
        if name != END:
            target.metadata(name, values)
    for channel in found.channels.values():
        old = found.schema(channel)
        target.add_channel(channel.topic, old.name, old.encoding, old.data, channel.metadata)
    for message in messages(found, set(found.channels)):
        topic = found.channels[message.channel_id].topic
        if keep(topic, message.sequence):
            target.message(topic, message.log_time, message.sequence, message.data)
            target.seal_if_due()
    return {name for name, _ in found.metadata}


def thin(source: str | Path, target: str | Path, every: int) -> None:
    """Copy a run's recording with the distributions, returns and designs of only some generations.

    Kept are the distributions and returns of every `every`-th generation (where that is missing, of
    the next) and of the last, ten times as many designs, and summaries and evaluations of all
    generations. Nothing is rounded. The metadata record "thinned" says what was done.

    Raises:
        RecordingError: a file cannot be read or written, or is not of a run; `every` is under 1.
    """
    if every < 1:
        raise RecordingError(f"every is {every}; keep every 1st generation or fewer")
    found = scan(source)
    topics = {number: channel.topic for number, channel in found.channels.items()}
    held: dict[str, set[int]] = {topic: set() for topic in ("/summary", *HEAVY_TOPICS)}
    for message in messages(found, {n for n, topic in topics.items() if topic in held}):
        held[topics[message.channel_id]].add(message.sequence)
    if not held["/summary"]:
        raise RecordingError(f"{source} holds no generations; name a run's generations.mcap")
    kept = {
        topic: _every_nth(sorted(held[topic]), max(1, every // times))
        for topic, times in HEAVY_TOPICS.items()
    }
    file = McapFile(target)
    try:
        _copy(file, Path(source), lambda topic, g: topic not in kept or g in kept[topic])
        values = {
            "every": every,
            "topics": list(HEAVY_TOPICS),
            "kept_generations": len(kept["/distribution"]),
            "kept_designs": len(kept["/design"]),
            "of_generations": len(held["/summary"]),
            "note": "these topics have the first, the last and every Nth generation, /design ten "
            "times as many; the other topics are complete, and nothing is rounded",
        }
        file.metadata(THINNED, values)
        for name, end in found.metadata:
            if name == END:
                file.metadata(END, end)
        file.publish()
    finally:
        file.abandon()
