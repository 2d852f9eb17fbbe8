"""Recording a training run, and thinning such a recording."""

import json
import time
from contextlib import suppress
from pathlib import Path

import numpy as np

from designrl.errors import remark
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
from designrl.recording.reader import Recording, read

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
        RecordingError: the file cannot be written, or has gone from its place; the one to go on
            with is no recording, or that of another run.
    """

    def __init__(self, path: str | Path, metadata: dict, resume_generation: int | None = None):
        self._design = get_experiment(metadata["experiment"]).design
        old = read(path) if resume_generation is not None and Path(path).exists() else None
        if old:
            _require_same_run(old, metadata)
        records = [record for record in old.metadata_records if record[0] != END] if old else []
        if RUN not in dict(records):
            records.append((RUN, metadata))
        gap = _gap(old.generations if old else (), resume_generation or 0)
        if resume_generation:
            about = {"generation": resume_generation} | ({"missing": gap} if gap else {})
            records.append((RESUMED, about))
        self._file = McapFile(path)
        try:
            for name, values in records:
                self._file.metadata(name, values)
            if old:
                _copy(self._file, old, lambda topic, generation: generation < resume_generation)
            self._log_time = self._file.last_log_time
            self._file.publish()
        except BaseException:
            self._file.close()
            raise
        if gap:
            remark(f"{path}: {gap} (the file was cut or removed); going on")

    def _write(self, message, names=(), unit: str = "") -> None:
        # A wall clock may be set back; readers want times that never decrease.
        self._log_time = max(time.time_ns(), self._log_time)
        self._file.write(message, self._log_time, message.generation, names, unit)

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
        summary = schema.Summary(
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
        )
        self._write(summary)
        if self._design is not None:
            size = self._design.size
            m, s = mu[-size:].astype(np.float64), sigma[-size:].astype(np.float64)
            sizes, lower, upper = (
                self._design.dimensions(self._design.scales(p)) for p in (m, m - s, m + s)
            )
            design = schema.Design(
                generation=index, mu=m, sigma=s, dimensions=sizes, lower=lower, upper=upper
            )
            self._write(design, self._design.names, self._design.unit)
        distribution = schema.Distribution(generation=index, mu=mu.tolist(), sigma=sigma.tolist())
        self._write(distribution)
        episodes = schema.Returns(
            generation=index,
            rollouts=np.shape(returns)[1],
            returns=np.ravel(returns).tolist(),
            steps=np.ravel(steps).tolist(),
            seeds=np.ravel(seeds).tolist(),
        )
        self._write(episodes)
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
        evaluation = schema.Evaluation(
            generation=index,
            kept=bool(kept),
            mean=np.mean(scores),
            sd=np.std(scores),
            scores=np.ravel(scores).tolist(),
            steps=np.ravel(steps).tolist(),
            seeds=np.ravel(seeds).tolist(),
        )
        self._write(evaluation)
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
            self._file.seal()
            self._file.close()

    def __enter__(self) -> "RunWriter":
        return self

    def __exit__(self, kind, error, traceback) -> None:
        if kind is not None and issubclass(kind, RecordingError):
            self._file.close()  # it has said what is wrong, and the file is as good as it gets
        else:
            self.close(finished=kind is None)


def _require_same_run(recording: Recording, metadata: dict) -> None:
    """Refuse to go on with a recording that says it is of something else."""
    mend = "put this run's own in its place, or move it away"
    if recording.kind != RUN and recording.topics:
        raise RecordingError(f"{recording.path} is not a recording of a training run; {mend}")
    for key in ("experiment", "seed", "settings"):
        theirs, ours = (_comparable(about.get(key)) for about in (recording.metadata, metadata))
        if theirs not in (None, ours):
            raise RecordingError(f"{recording.path} is of a run with another {key}; {mend}")


def _comparable(value):
    with suppress(TypeError, ValueError, RecursionError):
        value = json.loads(value)
    # A run that goes on may have more generations than before.
    return {**value, "generations": None} if isinstance(value, dict) else value


def _gap(held, stop: int) -> str:
    """Which of the generations before `stop` are missing, in words; empty where none is."""
    missing = np.setdiff1d(np.arange(stop), held)
    if not len(missing):
        return ""
    return f"{len(missing)} of the generations {missing[0]} to {missing[-1]} are missing"


def _copy(target: McapFile, source: Recording, keep) -> None:
    """Copy the messages for which keep(topic, generation) holds."""
    for channel in source.channels.values():
        old = source.schema(channel)
        target.add_channel(channel.topic, old.name, old.encoding, old.data, channel.metadata)
    for message in source.raw(source.channels):
        topic = source.channels[message.channel_id].topic
        if keep(topic, message.sequence):
            target.message(topic, message.log_time, message.sequence, message.data)
            target.seal_if_due()


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
    recording = read(source)
    if not len(recording.generations):
        raise RecordingError(f"{source} holds no generations; name a run's generations.mcap")
    kept: dict[str, set[int]] = {topic: set() for topic in HEAVY_TOPICS}
    for topic in filter(recording.topics.get, kept):
        held, step = recording.array(topic, "generation"), max(1, every // HEAVY_TOPICS[topic])
        first_of_each_step = np.unique(held // step, return_index=True)[1]
        kept[topic] = {*held[first_of_each_step].tolist(), int(held[-1])}
    done = {
        "every": every,
        "topics": list(HEAVY_TOPICS),
        "kept_generations": len(kept["/distribution"]),
        "kept_designs": len(kept["/design"]),
        "of_generations": len(recording.generations),
        "note": "these topics have the first, the last and every Nth generation, /design ten "
        "times as many; the other topics are complete, and nothing is rounded",
    }
    file = McapFile(target)
    try:
        for name, values in [*recording.metadata_records, (THINNED, done)]:
            file.metadata(name, values)
        _copy(file, recording, lambda topic, g: topic not in kept or g in kept[topic])
        file.publish()
    finally:
        file.close()
