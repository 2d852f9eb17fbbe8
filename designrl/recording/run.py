"""Recording a training run, and thinning such a recording."""

import json
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log

from designrl.bodies import ORIGINAL_AT, ORIGINAL_COLOR
from designrl.bodies.robot import Robot
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
from designrl.recording.points import point_cloud
from designrl.recording.reader import Recording, read

# Messages of a topic that a thinned copy has at most, or, of evaluations, those with episodes.
KEPT = dict.fromkeys(("/distribution", "/returns", "/evaluation"), 3)
KEPT |= {"/body": 8, "/design": 30, "/summary": 400}
LENGTH = ("settings", "command")  # of a run: what a resume for more generations changes


@dataclass(frozen=True)
class Generation:
    """What a run records of one generation: N candidates, R episodes each, P parameters.

    Attributes:
        index: from 0.
        mu, sigma: (P,) the distribution that it was sampled from; stored as float32.
        returns: (N, R) float64, return of each episode of each candidate.
        steps: (N, R) their lengths.
        seeds: (N, R) their seeds.
        total_steps: environment steps of the run so far.
        seconds: s of wall time that the run has taken so far.
        cpu_seconds: s of processor time that the run has taken so far; 0: not known.
    """

    index: int
    mu: np.ndarray
    sigma: np.ndarray
    returns: np.ndarray
    steps: np.ndarray
    seeds: np.ndarray
    total_steps: int
    seconds: float
    cpu_seconds: float = 0.0


class RunWriter:
    """Records a training run in `generations.mcap`; a context manager.

    The file is whole at every moment: a process that is killed loses what it recorded in the last
    second or, where writing is slow, in the last hundred times as long as a write takes.

    Args:
        path: the file; replaced if it exists, unless `resume_generation` is given.
        metadata: what to say of the run; "experiment" names it and the body's dimensions, "limits"
            are theirs, as JSON, where they are not the body's own.
        resume_generation: keep what an existing file holds of the generations before this one,
            drop the rest, and go on. Where some of them are missing, because the file was cut or
            removed, a line on stderr and the metadata record "resumed" say so. The metadata stays,
            but for what tells the run's length.

    Raises (every method):
        RecordingError: the file cannot be written, or has gone from its place; the one to go on
            with is no recording, or that of another run.
    """

    def __init__(self, path: str | Path, metadata: dict, resume_generation: int | None = None):
        experiment = get_experiment(metadata["experiment"])
        limits = json.loads(metadata.get("limits", "null"))
        self._body = experiment.body
        self._design = experiment.space(limits) if experiment.learns_design else None
        self._scales = None  # of the last generation's mean body
        old = read(path) if resume_generation is not None and Path(path).exists() else None
        if old:
            _require_same_run(old, metadata)
        records = [record for record in old.metadata_records if record[0] != END] if old else []
        if RUN in dict(records):
            length = {key: metadata[key] for key in LENGTH if key in metadata}
            records = [(n, {**about, **length} if n == RUN else about) for n, about in records]
        else:
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
                _copy(self._file, old, lambda _, g, data: data if g < resume_generation else None)
            self._log_time = self._file.last_log_time
            drawn = old.array("/original", "sequence") if old and "/original" in old.topics else ()
            self._drawn = any(generation < resume_generation for generation in drawn)
            self._file.publish()
        except BaseException:
            self._file.close()
            raise
        if gap:
            remark(f"{path}: {gap} (the file was cut or removed); going on")

    def _write(self, message, names=(), unit: str = "") -> None:
        self._file.write(message, self._now(), message.generation, names, unit)

    def _now(self) -> int:
        # A wall clock may be set back; readers want times that never decrease.
        self._log_time = max(time.time_ns(), self._log_time)
        return self._log_time

    def _draw(self, topic: str, generation: int, scales: np.ndarray, at=(0, 0, 0), color=None):
        points, colors = Robot(self._body.urdf(scales), self._body.rest_pose).outline()
        now = self._now()
        cloud = point_cloud(points + at, colors if color is None else color, now)
        self._file.write(cloud, now, generation, topic=topic)

    @uninterrupted()
    def generation(self, of: Generation) -> None:
        """Record a generation."""
        mu, sigma = (np.asarray(values, dtype=np.float32) for values in (of.mu, of.sigma))
        fitness = np.mean(of.returns, axis=1)
        summary = schema.Summary(
            generation=of.index,
            mean=fitness.mean(),
            sd=fitness.std(),
            best=fitness.max(),
            worst=fitness.min(),
            sigma_mean=sigma.mean(dtype=np.float64),
            sigma_min=sigma.min(),
            sigma_max=sigma.max(),
            steps=int(np.sum(of.steps)),
            total_steps=of.total_steps,
            seconds=of.seconds,
            cpu_seconds=of.cpu_seconds,
        )
        self._write(summary)
        if self._design is not None:
            size = self._design.size
            m, s = mu[-size:].astype(np.float64), sigma[-size:].astype(np.float64)
            scales = [self._design.scales(p) for p in (m, m - s, m + s)]
            sizes, lower, upper = map(self._design.dimensions, scales)
            self._scales = scales[0]
            if not self._drawn:
                self._drawn, original = True, np.ones(size)
                self._draw("/original", of.index, original, ORIGINAL_AT, ORIGINAL_COLOR)
                self._draw("/body", of.index, self._scales)
            design = schema.Design(
                generation=of.index, mu=m, sigma=s, dimensions=sizes, lower=lower, upper=upper
            )
            self._write(design, self._design.names, self._design.unit)
        distribution = schema.Distribution(
            generation=of.index, mu=mu.tolist(), sigma=sigma.tolist()
        )
        self._write(distribution)
        episodes = schema.Returns(
            generation=of.index,
            rollouts=np.shape(of.returns)[1],
            returns=np.ravel(of.returns).tolist(),
            steps=np.ravel(of.steps).tolist(),
            seeds=np.ravel(of.seeds).tolist(),
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
        line = Log(level=Log.INFO, name="evaluation", message=_in_words(evaluation))
        line.timestamp.FromNanoseconds(self._log_time)
        self._file.write(line, self._log_time, index)
        if self._scales is not None:
            self._draw("/body", index, self._scales)
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


def _in_words(e: schema.Evaluation) -> str:
    best = ", the best so far" if e.kept else ""
    episodes = f"{len(e.scores)} episode{'s' if len(e.scores) > 1 else ''}"
    return f"generation {e.generation}: {e.mean:.1f} ± {e.sd:.1f} over {episodes}{best}"


def _gap(held, stop: int) -> str:
    """Which of the generations before `stop` are missing, in words; empty where none is."""
    missing = np.setdiff1d(np.arange(stop), held)
    if not len(missing):
        return ""
    return f"{len(missing)} of the generations {missing[0]} to {missing[-1]} are missing"


def _copy(target: McapFile, source: Recording, copied) -> None:
    """Copy each message as copied(topic, generation, data) has it; where that is None, not."""
    for channel in source.channels.values():
        old = source.schema(channel)
        target.add_channel(channel.topic, old.name, old.encoding, old.data, channel.metadata)
    for message in source.raw(source.channels):
        topic = source.channels[message.channel_id].topic
        data = copied(topic, message.sequence, message.data)
        if data is not None:
            target.message(topic, message.log_time, message.sequence, data)
            target.seal_if_due()


def _spread(held: np.ndarray, most: int) -> np.ndarray:
    """Of more than `most` generations so many at most, spread as evenly as they lie."""
    middles = (held[1:] + held[:-1]) / 2
    chosen = held[:0]
    # Several of the even generations have the same nearest one where others are missing: the finest
    # spacing that does not take too many makes up for those.
    for count in range(most, len(held)):
        even = np.linspace(held[0], held[-1], count)
        nearest = np.unique(held[np.searchsorted(middles, even, side="right")])
        if len(nearest) > most:
            break
        if len(nearest) >= len(chosen):
            chosen = nearest
    return chosen


def thin(source: str | Path, target: str | Path, keep: Mapping[str, int] = KEPT) -> None:
    """Copy a run's recording with fewer messages.

    Of each topic in `keep` it has so many at most: the first, the last and others, spread as evenly
    between as the source has them. Evaluations beyond that number stay without their episodes.
    Other topics are complete. Nothing is rounded. The metadata record "thinned" says what was done.

    Raises:
        RecordingError: a file cannot be read or written, or is not of a run.
    """
    recording = read(source)
    if not len(recording.generations):
        raise RecordingError(f"{source} holds no generations; name a run's generations.mcap")
    kept = {}
    for topic in filter(recording.topics.get, keep):
        held = recording.array(topic, "sequence").astype(int)
        if len(held) > keep[topic]:
            held = _spread(held, keep[topic])
        kept[topic] = set(held.tolist())
    done = {
        "of_generations": len(recording.generations),
        "kept": {topic: len(generations) for topic, generations in kept.items()},
        "note": "of each topic under `kept` there are so many messages, the first, the last and "
        "others evenly spread (of /evaluation: so many have their episodes); the other topics are "
        "complete, and nothing is rounded",
    }
    file = McapFile(target)

    def copied(topic: str, generation: int, data: bytes) -> bytes | None:
        if topic not in kept or generation in kept[topic]:
            return data
        return _without_episodes(data) if topic == "/evaluation" else None

    try:
        records = [record for record in recording.metadata_records if record[0] != THINNED]
        for name, values in [*records, (THINNED, done)]:
            file.metadata(name, values)
        _copy(file, recording, copied)
        file.publish()
    finally:
        file.close()


def _without_episodes(data: bytes) -> bytes:
    evaluation = schema.Evaluation.FromString(data)
    for name in ("scores", "steps", "seeds"):
        evaluation.ClearField(name)
    return evaluation.SerializeToString()
