"""MCAP files that are whole at every moment.

`McapFile` puts a valid end (index and footer) behind the data at every seal, in the same write
call, and lets the next data overwrite it: a process that is killed leaves a file that any MCAP
reader opens, up to the last seal.
"""

import contextlib
import io
import json
import os
import signal
import threading
import time
from pathlib import Path

from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from designrl.errors import InputError
from designrl.files import cannot_write, create_beside, replace
from designrl.provenance import VERSION

CHUNK_BYTES = 2**20  # uncompressed; what a chunk may hold before it is compressed and written
SEAL_SECONDS = 1.0  # between two seals at least; also the most that a kill can cost
SEAL_SHARE = 0.01  # of the time between two seals that a seal may take

# Names of metadata records.
RUN, ROLLOUT, END, RESUMED, THINNED = "run", "rollout", "end", "resumed", "thinned"


class RecordingError(InputError):
    """A recording cannot be written or read; the message says which, why and what to do."""


@contextlib.contextmanager
def uninterrupted():
    """Ctrl-C, a polite kill and a closed terminal wait for the block, lest they tear a record."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals reach the main thread only
        return
    held: list[int] = []
    handlers = {
        number: signal.signal(number, lambda number, frame: held.append(number))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) is not signal.SIG_IGN  # as under `nohup`
    }
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if held:
            signal.raise_signal(held[0])


class _Tail(io.BytesIO):
    """What an `mcap.writer.Writer` has written since the last seal, before it is in the file."""

    start = 0  # of it in the file

    def tell(self) -> int:
        return self.start + super().tell()


class McapFile:
    """An MCAP file under construction.

    From the first seal on it is built beside `path`, and it appears under that name with
    `publish()`; later seals go to the same file.

    Raises (every method):
        RecordingError: the file cannot be written, for instance because the disk is full; what was
            sealed before stays readable.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self._file, self._published, self.is_open = None, False, True
        with self._refusing():  # before there is anything to lose
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._create()
            self._remove()  # one that is never sealed leaves nothing
        self._tail, self._end = _Tail(), b""
        self._sealed, self._seal_seconds = time.monotonic(), 0.0
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._metadata_keys: dict[str, set[str]] = {}
        self.last_log_time = 0
        # Summary offsets are the one part of the end that a repeated finish() would write twice.
        self._writer = Writer(self._tail, chunk_size=CHUNK_BYTES, use_summary_offsets=False)
        self._writer.start(library=f"designrl {VERSION}")

    @contextlib.contextmanager
    def _refusing(self):
        """Say in one sentence why the system does not write it, and close the file."""
        try:
            yield
        except OSError as error:
            self.close()
            # Neither a file of before nor what was sealed of this one is harmed.
            intact = ", what was recorded before is intact" if os.path.exists(self.path) else ""
            raise RecordingError(f"{cannot_write(self.path, error)}{intact}") from None

    def _create(self) -> None:
        descriptor, self._temporary = create_beside(self.path)
        self._file = open(descriptor, "wb", buffering=0)  # noqa: SIM115 (lives on)

    def _remove(self) -> None:
        self._file.close()
        self._file = None
        self._temporary.unlink(missing_ok=True)

    def metadata(self, name: str, values: dict) -> None:
        """Add a metadata record; what is not text becomes JSON.

        Where one of this name has a key of it already, a number is added to the name ("resumed 2"):
        viewers take such keys for a mistake.
        """
        try:
            texts = {k: v if isinstance(v, str) else json.dumps(v) for k, v in values.items()}
            "".join([*texts, *texts.values()]).encode()  # as the file has them
        except (AttributeError, TypeError, ValueError, RecursionError) as error:
            raise RecordingError(
                f"the metadata for {self.path} cannot be recorded ({error}); give a dictionary of "
                "texts, and of numbers, lists and dictionaries that JSON can hold"
            ) from None
        unique, count = name, 1
        while self._metadata_keys.setdefault(unique, set()) & texts.keys():
            count += 1
            unique = f"{name} {count}"
        self._metadata_keys[unique] |= texts.keys()
        self._writer.add_metadata(unique, texts)

    def write(
        self, message, log_time: int, sequence: int, names=(), unit: str = "", topic: str = ""
    ) -> None:
        """Add a protobuf message; log_time in ns.

        Args:
            names: of the elements of its arrays.
            unit: of their values, where it is not always the same.
            topic: in the place of the message's name.
        """
        topic = topic or f"/{message.DESCRIPTOR.name.lower()}"
        if topic not in self._channels:
            kind = type(message)
            definition = build_file_descriptor_set(kind).SerializeToString()
            about = {"names": json.dumps(list(names))} if names else {}
            about |= {"unit": unit} if unit else {}
            self.add_channel(topic, kind.DESCRIPTOR.full_name, "protobuf", definition, about)
        self.message(topic, log_time, sequence, message.SerializeToString())

    def add_channel(
        self, topic: str, name: str, encoding: str, definition: bytes, about: dict[str, str]
    ) -> None:
        """Declare a topic; a second time does nothing.

        Args:
            name, encoding, definition: of the schema of its messages.
            about: its metadata.
        """
        if topic in self._channels:
            return
        if name not in self._schemas:
            self._schemas[name] = self._writer.register_schema(name, encoding, definition)
        self._channels[topic] = self._writer.register_channel(
            topic, "cdr" if encoding == "ros2msg" else encoding, self._schemas[name], about
        )

    def message(self, topic: str, log_time: int, sequence: int, data: bytes) -> None:
        """Add a message on a declared topic; log_time in ns."""
        self._writer.add_message(self._channels[topic], log_time, data, log_time, sequence)
        self.last_log_time = max(log_time, self.last_log_time)

    def seal_if_due(self) -> None:
        """Seal unless that was done a moment ago, or took long compared with that moment."""
        passed = time.monotonic() - self._sealed
        if passed >= max(SEAL_SECONDS, self._seal_seconds / SEAL_SHARE):
            self.seal()

    def seal(self, durable: bool = False) -> None:
        """Write everything so far, with a valid end; `durable`: so that a power cut spares it."""
        if not self.is_open:
            raise RecordingError(f"{self.path} is closed; nothing more can be recorded in it")
        if self._published and not self._is_in_place():
            self.close()
            raise RecordingError(
                f"{self.path} was removed, renamed or replaced while it was recorded; put it back, "
                "or record it anew"
            )
        begin = time.monotonic()
        self._writer.flush()  # ends the chunk
        end = self._tail.tell()
        self._writer.finish()
        data, start, written = self._tail.getvalue(), self._tail.start, 0
        with self._refusing():
            if self._file is None:
                self._create()
            descriptor = self._file.fileno()
            try:
                # In one call: a kill finds the file with the old end or with the new one.
                while written < len(data):  # where the disk is full, less is written at first
                    written += os.pwrite(descriptor, data[written:], start + written)
                if durable:
                    os.fsync(descriptor)
            except OSError:
                with contextlib.suppress(OSError):  # its space is still ours
                    os.pwrite(descriptor, self._end, start)
                    os.ftruncate(descriptor, start + len(self._end))
                raise
        self._end = data[end - start :]
        self._tail.start = end
        self._tail.seek(0)
        self._tail.truncate()
        self._sealed = time.monotonic()
        self._seal_seconds = self._sealed - begin

    def publish(self) -> None:
        """Seal, make it durable, and let it replace what `path` held."""
        self.seal(durable=True)
        with self._refusing():
            replace(self._temporary, self.path)
        self._published = True

    def _is_in_place(self) -> bool:
        try:
            return os.path.samestat(os.lstat(self.path), os.fstat(self._file.fileno()))
        except OSError:
            return False

    def close(self) -> None:
        """Close without a seal, and remove the file if it was not published."""
        self.is_open = False
        if self._file is not None:
            self._remove()
