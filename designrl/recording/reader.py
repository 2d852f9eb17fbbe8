"""Recordings as NumPy arrays, topic by topic; also those that were cut off."""

import json
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.records import Channel

from designrl.errors import printable
from designrl.names import find_run, nothing_at
from designrl.recording import schema_pb2 as schema
from designrl.recording.mcap_file import END, ROLLOUT, RUN, THINNED, RecordingError
from designrl.recording.scan import Scan

# Only messages that we know are decoded: definitions in a stranger's file are not followed.
_CLASSES = {
    kind.DESCRIPTOR.full_name: kind
    for kind in (
        FrameTransforms,
        Log,
        PointCloud,
        *(getattr(schema, name) for name in schema.DESCRIPTOR.message_types_by_name),
    )
}
_DTYPES = {
    FieldDescriptor.TYPE_DOUBLE: np.float64,
    FieldDescriptor.TYPE_FLOAT: np.float32,
    FieldDescriptor.TYPE_UINT32: np.uint32,
    FieldDescriptor.TYPE_UINT64: np.uint64,
    FieldDescriptor.TYPE_BOOL: np.bool_,
}
# Ours have up to 13 parts, and 13,000 places of them.
MAX_PARTS, MAX_PLACES, MAX_NAME = 256, 500_000, 256
_KINDS = {
    RUN: "recording of a training run",
    ROLLOUT: "recording of a rollout",
    "unknown": "not a recording of designrl but an MCAP file of another program",
}


class Recording(Scan):
    """A recording; use `read` to open one. Messages are decoded when they are asked for."""

    @cached_property
    def _channels(self) -> dict[str, Channel]:
        return {channel.topic: channel for channel in self.channels.values()}

    @property
    def kind(self) -> str:
        """ "run", "rollout", or "unknown" for files that are not ours."""
        # Topics and names of metadata are too plain to tell: others use the same.
        types = {self.schema(channel).name for channel in self._channels.values()}
        about = {name for name, values in self.metadata_records if "experiment" in values}
        for kind, message in ((RUN, schema.Summary), (ROLLOUT, schema.Observation)):
            if message.DESCRIPTOR.full_name in types or kind in about:
                return kind
        return "unknown"

    def __repr__(self) -> str:
        about = self.metadata.get("experiment", "nothing that we know")[:MAX_NAME]
        nothing = self.kind == ROLLOUT and not self.topics.get("/reward")
        without = " without steps" if nothing else ""
        return printable(f"<{_KINDS[self.kind].capitalize()} of {about}{without}, {self.path}>")

    def _repr_html_(self) -> str | None:
        """What a notebook shows: a rollout's film."""
        if self.kind != ROLLOUT or not self.topics.get("/reward"):
            return None
        from designrl.recording.film import html

        return html(self)

    @property
    def metadata(self) -> dict[str, str]:
        """What the file says of its run or rollout."""
        kind, found = self.kind, {}
        for name, values in self.metadata_records:
            if name == kind:
                found |= values  # of a rollout, the score comes at the end
        return found

    def about(self, key: str) -> dict:
        """A JSON object of the metadata; an empty one where there is none, or a damaged one."""
        try:
            found = json.loads(self.metadata.get(key, "{}"))
        except (ValueError, RecursionError):
            return {}
        return found if isinstance(found, dict) else {}

    @property
    def complete(self) -> bool:
        """The file is whole, and so is the run or rollout in it."""
        finished = dict(self.metadata_records).get(END, {}).get("finished") == "true"
        return self.problem is None and (finished or self.kind == "unknown")

    @property
    def topics(self) -> dict[str, int]:
        """Topic -> number of messages."""
        return {
            topic: self.counts.get(channel.id, 0)
            for topic, channel in sorted(self._channels.items())
        }

    @property
    def seconds(self) -> float:
        """s between the first and the last message."""
        first, last = self.times or (0, 0)
        return (last - first) / 1e9

    def names(self, topic: str) -> list[str]:
        """Names of the elements of the topic's arrays; empty where they have none.

        Raises:
            RecordingError: no such topic, or its names are damaged.
        """
        about = self._channel(topic).metadata
        try:
            names = json.loads(about.get("names", "[]"))
        except (ValueError, RecursionError):
            names = None
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise RecordingError(
                f"the names on {topic} in {self.path} are damaged; get the file again"
            )
        return names

    def unit(self, topic: str) -> str:
        """Unit of the topic's dimensions, where it depends on the body."""
        return self._channel(topic).metadata.get("unit", "")

    def messages(self, topic: str) -> Iterator:
        """The topic's messages, decoded (protobuf objects; text for /robot_description).

        Raises:
            RecordingError: no such topic, or messages that are not of this package's kinds.
        """
        channel = self._channel(topic)
        name = self.schema(channel).name
        kind = _CLASSES.get(name)
        if kind is None and name != "std_msgs/msg/String":
            raise RecordingError(f"{topic} in {self.path} has messages of unknown type {name!r}")
        for message in self.raw({channel.id}):
            try:
                yield kind.FromString(message.data) if kind else message.data[8:-1].decode()
            except (DecodeError, UnicodeDecodeError):
                raise self._damaged(topic) from None

    def first(self, topic: str):
        """The topic's first message, decoded.

        Raises:
            RecordingError: there is none.
        """
        for message in self.messages(topic):
            return message
        raise RecordingError(f"{self.path} has no message on {topic}; record it again")

    def array(self, topic: str, field: str) -> np.ndarray:
        """One field of all messages of a topic.

        Args:
            topic: one of `topics`.
            field: of its message, see `schema.proto`; "log_time" is the messages' times in ns,
                "sequence" their generation or step.

        Returns: (M,) for a field with one number, (M, K) for an array, (M, N, R) for the fields of
            /returns, in the field's own type. Where the length changes from message to message:
            (M,) of dtype object, an array each.

        Raises:
            RecordingError: no such topic or field.
        """
        channel = self._channel(topic)
        if field in ("log_time", "sequence"):
            return np.array([getattr(m, field) for m in self.raw({channel.id})], dtype=np.int64)
        kind = _CLASSES.get(self.schema(channel).name)
        found = kind.DESCRIPTOR.fields_by_name.get(field) if kind else None
        if found is None or found.type not in _DTYPES:
            fields = kind.DESCRIPTOR.fields if kind else ()
            known = ", ".join(
                [f.name for f in fields if f.type in _DTYPES] + ["log_time", "sequence"]
            )
            raise RecordingError(
                f"{topic} in {self.path} has no field {field!r} of numbers; it has {known}"
            )
        rows = []
        for message in self.messages(topic):
            row = np.array(getattr(message, field), dtype=_DTYPES[found.type])
            if kind is schema.Returns and row.ndim:
                if not message.rollouts or row.size % message.rollouts:
                    raise self._damaged(topic)
                row = row.reshape(-1, message.rollouts)
            rows.append(row)
        if len({row.shape for row in rows}) > 1:
            ragged = np.empty(len(rows), dtype=object)
            ragged[:] = rows
            return ragged
        return np.array(rows, dtype=_DTYPES[found.type])

    @cached_property
    def generations(self) -> np.ndarray:
        """(G,) indices of a run's generations."""
        is_run = self.kind == RUN and "/summary" in self._channels
        return self.array("/summary", "generation") if is_run else np.empty(0, dtype=np.uint32)

    def transforms(self) -> dict[str, tuple[str, np.ndarray, np.ndarray]]:
        """Part -> the part it hangs on, (T, 3) positions in m and (T, 4) quaternions x, y, z, w.

        Both as seen from the part it hangs on; all have the times of /tf.

        Raises:
            RecordingError: there is no /tf, or it holds something else, or more than a body has.
        """
        found: dict[str, tuple[str, list]] = {}
        places = 0
        for message in self.messages("/tf"):
            places += len(message.transforms) if isinstance(message, FrameTransforms) else np.inf
            if places > MAX_PLACES:
                raise self._damaged("/tf")
            for t in message.transforms:
                if len(found) > MAX_PARTS or len(t.child_frame_id) > MAX_NAME:
                    raise self._damaged("/tf")
                p, q = t.translation, t.rotation
                _, rows = found.setdefault(t.child_frame_id, (t.parent_frame_id, []))
                rows.append((p.x, p.y, p.z, q.x, q.y, q.z, q.w))
        return {part: (on, *np.split(np.array(rows), [3], 1)) for part, (on, rows) in found.items()}

    def _damaged(self, topic: str) -> RecordingError:
        return RecordingError(f"a message on {topic} in {self.path} is damaged; get the file again")

    def _channel(self, topic: str):
        if topic not in self._channels:
            if self.kind == ROLLOUT and not self.topics.get("/reward"):
                raise RecordingError(f"{self.path} is a rollout without a step; record one anew")
            raise RecordingError(
                f"{self.path} has no topic {topic!r}; it has {', '.join(self.topics) or 'none'}"
            )
        return self._channels[topic]


def read(path: str | Path) -> Recording:
    """Open a recording; one that was cut off is opened as far as it goes.

    Args:
        path: a file; or a run, by its folder or as "biped-morphology/seed0" for the published one.

    Raises:
        InputError: there is nothing of that name.
        RecordingError: it cannot be read, or is not an MCAP file.
    """
    found = find_run(path)
    recording = found / "generations.mcap" if found.is_dir() else found
    if not recording.exists():
        raise nothing_at(found)
    return Recording(recording)


def how_far(recording: Recording) -> str:
    """How far a recording goes, as half a sentence."""
    if recording.kind == RUN:
        last = recording.generations[-1:]
        return f"it goes up to generation {last[0]}" if len(last) else "it has no generation"
    if recording.kind == ROLLOUT:
        return f"it goes up to {recording.seconds:.2f} s"
    return f"it has {sum(recording.topics.values())} messages"


def describe(path: str | Path) -> str:
    """What a recording holds, how far it goes and where it came from, in lines of text.

    Raises:
        RecordingError: it cannot be read, is not an MCAP file, or is damaged before all it held.
    """
    recording = read(path)
    topics, records = recording.topics, recording.metadata_records
    if recording.problem and not records and not topics:
        raise RecordingError(
            f"{path} holds nothing to tell of ({recording.problem}); get it again, or record it "
            "anew"
        )
    lines = [f"{path}: {_KINDS[recording.kind]}, {recording.path.stat().st_size:,} bytes"]
    generations = recording.generations
    if len(generations):
        mean, steps = (recording.array("/summary", field)[-1] for field in ("mean", "total_steps"))
        lines.append(
            f"  generations {generations[0]} to {generations[-1]} ({len(generations)}); "
            f"population mean {mean:.1f} in the last, {steps:,} environment steps"
        )
        missing = int(generations.max()) + 1 - len(np.unique(generations))
        if missing and THINNED not in dict(records):
            lines.append(f"  {missing} generations are missing")
    if recording.kind == RUN and topics.get("/evaluation"):
        scores = recording.array("/evaluation", "mean")
        lines.append(f"  {len(scores)} evaluations, best {scores.max():.1f}")
    if recording.kind == ROLLOUT:
        total = recording.array("/reward", "total") if topics.get("/reward") else ()
        points = f", {recording.seconds:.2f} s, {total[-1]:.1f} points" if len(total) else ""
        lines.append(f"  {len(total)} steps{points}")
    if not recording.complete:
        stopped = "was stopped" if END in dict(records) else "has not ended, or was killed"
        reason = recording.problem or f"the run {stopped}"
        lines.append(f"  incomplete ({reason}): {how_far(recording)}")
    lines += [f"  {topic}: {count} messages" for topic, count in topics.items()]
    for name, values in records:
        lines += [f"  {name}:", *(f"    {key}: {value}" for key, value in values.items())]
    return "\n".join(map(printable, lines))
