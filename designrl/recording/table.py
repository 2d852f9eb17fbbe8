"""Recordings as plain columns: for `designrl.columns`, pandas or a spreadsheet."""

from pathlib import Path

import numpy as np

from designrl.columns import Table
from designrl.recording import schema_pb2 as schema
from designrl.recording.mcap_file import ROLLOUT, RUN, RecordingError
from designrl.recording.reader import Recording, read


def table(path: str | Path | Recording, episodes: bool = False) -> Table:
    """A recording as columns of one length, which `pandas.DataFrame` takes as they are.

    Args:
        path: a recording, or what `read` takes.
        episodes: of a run, a row for each episode of its evaluations.

    Returns: of a run, a row for each generation: the fields of Summary (see `schema.proto`), the
        mean, deviation and keeping of its evaluation, and each dimension of the body at μ, μ - σ
        ("lower") and μ + σ ("upper"); NaN where a generation has none recorded. Of a rollout, a
        row for each step: what was seen, done and earned.

    Raises:
        RecordingError: no such recording, or one with nothing of this or damaged.
    """
    recording = path if isinstance(path, Recording) else read(path)
    if recording.kind == RUN:
        found = _evaluation_episodes(recording) if episodes else _generations(recording)
    elif recording.kind == ROLLOUT and not episodes:
        found = _steps(recording)
    else:
        kind = "a run, and has no evaluations" if episodes else "ours"
        raise RecordingError(f"{recording.path} is no recording of {kind}")
    if len({column.shape for column in found.values()}) != 1:
        raise RecordingError(
            f"{recording.path} has messages that do not fit each other; get it again"
        )
    return found


def _generations(recording: Recording) -> Table:
    # A published recording has some topics at generations that others lack.
    topics = ["/summary", *filter(recording.topics.get, ("/evaluation", "/design"))]
    held = {topic: recording.array(topic, "generation") for topic in topics}
    found = {"generation": np.unique(np.concatenate(list(held.values())))}

    def add(topic: str, columns: Table) -> None:
        rows = np.searchsorted(found["generation"], held[topic])
        for name, values in columns.items():
            found[name] = np.full(len(found["generation"]), np.nan)
            found[name][rows] = values

    names = [field.name for field in schema.Summary.DESCRIPTOR.fields]
    summary = {name: recording.array("/summary", name) for name in names if name != "generation"}
    if len(held["/summary"]) == len(found["generation"]):
        found |= summary  # whole numbers stay such
    else:
        add("/summary", summary)
    if recording.topics.get("/evaluation"):
        fields = {name: recording.array("/evaluation", name) for name in ("mean", "sd", "kept")}
        add("/evaluation", {f"evaluation {name}": values for name, values in fields.items()})
    if recording.topics.get("/design"):
        for field, suffix in (("dimensions", ""), ("lower", " lower"), ("upper", " upper")):
            columns = _named(recording, "/design", field)
            add("/design", {f"{name}{suffix}": column for name, column in columns.items()})
    return found


def _evaluation_episodes(recording: Recording) -> Table:
    fields = ("scores", "steps", "seeds")
    scores, steps, seeds = (list(recording.array("/evaluation", name)) for name in fields)
    sizes = [len(row) for row in scores]
    if not sizes:
        raise RecordingError(f"{recording.path} has no evaluation; export it without episodes")
    return {
        "generation": np.repeat(recording.array("/evaluation", "generation"), sizes),
        "episode": np.concatenate([np.arange(size) for size in sizes]),
        "seed": np.concatenate(seeds),
        "score": np.concatenate(scores),
        "length": np.concatenate(steps),
    }


def _steps(recording: Recording) -> Table:
    found = {"step": recording.array("/reward", "step")}
    found |= {name: recording.array("/reward", name) for name in ("reward", "total")}
    for topic, field, prefix in (
        ("/reward", "terms", "reward"),
        ("/observation", "values", "observation"),
        ("/action", "values", "action"),
        ("/joints", "angles", "angle"),
        ("/joints", "speeds", "speed"),
        ("/joints", "torques", "torque"),
        ("/contacts", "touching", "contact"),
    ):
        if recording.topics.get(topic):
            columns = _named(recording, topic, field)
            found |= {f"{prefix}: {name}": column for name, column in columns.items()}
    return found


def _named(recording: Recording, topic: str, field: str) -> Table:
    """A column for each element of an array."""
    names, values = recording.names(topic), recording.array(topic, field)
    if values.ndim != 2 or values.shape[1] != len(names):
        raise RecordingError(f"{topic} in {recording.path} does not fit its names; get it again")
    return dict(zip(names, values.T, strict=True))
