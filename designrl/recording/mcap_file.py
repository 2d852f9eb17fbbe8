"""MCAP files that are whole at every moment, and a reader for those that are not.

`McapFile` puts a valid end (index and footer) behind the data at every seal, in the same write
call, and lets the next data overwrite it: a process that is killed leaves a file that any MCAP
reader opens, up to the last seal. `scan` reads a file of any origin front to back, checks each
size before it takes memory for it, and stops where the file stops making sense.
"""

import contextlib
import os
import signal
import struct
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema
from mcap.writer import MCAP0_MAGIC, Writer

import designrl
from designrl.errors import InputError

CHUNK_BYTES = 2**20  # uncompressed; what a chunk may hold before it is compressed and written
SEAL_SECONDS = 1.0  # between two seals at least; also the most that a kill can cost
SEAL_SHARE = 0.01  # of the time between two seals that a seal may take
MAX_RECORD_BYTES = 2**28  # of one record, and of one chunk when decompressed; ours are < 2 MB


class RecordingError(InputError):
    """A recording cannot be written or read; the message says which, why and what to do."""


# -------------------------------------------------------------------------------------- writing


@contextlib.contextmanager
def uninterrupted():
    """Ctrl-C and a polite kill wait until the block is done, lest they tear a record."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals reach the main thread only
        return
    held: list[int] = []
    handlers = {
        number: signal.signal(number, lambda number, frame: held.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if held:
            signal.raise_signal(held[0])


class _Tail:
    """What an `mcap.writer.Writer` has written since the last seal, before it is in the file."""

    def __init__(self):
        self.start, self.data = 0, bytearray()

    def tell(self) -> int:
        return self.start + len(self.data)

    def write(self, data: bytes) -> int:
        self.data += data
        return len(data)

    def flush(self) -> None:
        """Nothing: only a seal writes to the file."""


class McapFile:
    """An MCAP file under construction.

    It is built beside `path` and appears under that name with `publish()`; later seals go to the
    same file.

    Raises (every method):
        RecordingError: the file cannot be written, for instance because the disk is full; what was
            sealed before stays readable.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self._temporary = self.path.with_name(f".{self.path.name}.new")
        self._file = None
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(self._temporary, "wb", buffering=0)  # noqa: SIM115 (lives on)
        except OSError as error:
            raise self._failure(error) from None
        self._tail, self._end = _Tail(), b""
        self._sealed, self._seal_seconds = time.monotonic(), 0.0
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self.last_log_time = 0
        # Summary offsets are the one part of the end that a repeated finish() would write twice.
        self._writer = Writer(self._tail, chunk_size=CHUNK_BYTES, use_summary_offsets=False)
        self._writer.start(library=f"designrl {designrl.__version__}")

    def _failure(self, error: OSError) -> RecordingError:
        return RecordingError(
            f"{self.path} cannot be written ({error.strerror}); free some space or choose another "
            "place, what was recorded before is intact"
        )

    @property
    def is_open(self) -> bool:
        """More can be recorded."""
        return self._file is not None

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, values)

    def channel(
        self, topic: str, define: Callable[[], tuple[str, str, bytes, dict[str, str]]]
    ) -> int:
        """The id of a topic's channel.

        Args:
            define: gives name, encoding and definition of its messages and the channel's metadata;
                called the first time only.
        """
        if topic not in self._channels:
            name, encoding, definition, about = define()
            if name not in self._schemas:
                self._schemas[name] = self._writer.register_schema(name, encoding, definition)
            self._channels[topic] = self._writer.register_channel(
                topic, "cdr" if encoding == "ros2msg" else encoding, self._schemas[name], about
            )
        return self._channels[topic]

    def message(self, channel: int, log_time: int, sequence: int, data: bytes) -> None:
        """Add a message; log_time in ns."""
        self._writer.add_message(channel, log_time, data, log_time, sequence)
        self.last_log_time = max(log_time, self.last_log_time)

    def seal_if_due(self) -> None:
        """Seal unless that was done a moment ago, or took long compared with that moment."""
        passed = time.monotonic() - self._sealed
        if passed >= max(SEAL_SECONDS, self._seal_seconds / SEAL_SHARE):
            self.seal()

    def seal(self) -> None:
        """Write everything so far, with a valid end."""
        if self._file is None:
            raise RecordingError(f"{self.path} is closed; nothing more can be recorded in it")
        begin = time.monotonic()
        self._writer.flush()  # ends the chunk
        end = self._tail.tell()
        self._writer.finish()
        data, start = bytes(self._tail.data), self._tail.start
        try:
            # In one call: a kill finds the file with the old end or with the new one.
            written = os.pwrite(self._file.fileno(), data, start)
            while written < len(data):
                written += os.pwrite(self._file.fileno(), data[written:], start + written)
        except OSError as error:
            with contextlib.suppress(OSError):  # its space is still ours
                os.pwrite(self._file.fileno(), self._end, start)
                os.ftruncate(self._file.fileno(), start + len(self._end))
            self.abandon()
            raise self._failure(error) from None
        self._end = data[end - start :]
        self._tail.start = end
        self._tail.data.clear()
        self._sealed = time.monotonic()
        self._seal_seconds = self._sealed - begin

    def publish(self) -> None:
        """Seal, make it durable, and let it replace what `path` held."""
        self.seal()
        try:
            os.fsync(self._file.fileno())
            os.replace(self._temporary, self.path)
        except OSError as error:
            self.abandon()
            raise self._failure(error) from None

    def close(self) -> None:
        """Seal and close; does nothing the second time."""
        if self._file is not None:
            self.seal()
            self.abandon()

    def abandon(self) -> None:
        """Close without a seal, and remove the file if it was not published."""
        if self._file is not None:
            self._file.close()
            self._file = None
            self._temporary.unlink(missing_ok=True)


# -------------------------------------------------------------------------------------- reading


@dataclass
class Scan:
    """What a file holds.

    Attributes:
        metadata: name and values of each metadata record.
        channels, schemas: by id.
        counts: messages per channel id.
        blocks: offset and length of each chunk, and of each message outside of a chunk.
        times: smallest and largest log time in ns; None without messages.
        problem: why reading ended early; None for a complete file.
    """

    path: Path
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    blocks: list[tuple[int, int]] = field(default_factory=list)
    times: tuple[int, int] | None = None
    problem: str | None = None

    def schema(self, channel: Channel) -> Schema:
        """What the channel's messages are; nameless where the file does not say."""
        return self.schemas.get(channel.schema_id) or Schema(0, b"", "", "")


@dataclass(frozen=True)
class Message:
    """A message as it is in the file; times in ns."""

    channel_id: int
    sequence: int
    log_time: int
    data: bytes


class _DamageError(Exception):
    """The file makes no sense from here on; the message says why."""


# What parsing a damaged record can raise.
_PARSE_ERRORS = (_DamageError, struct.error, McapError, UnicodeDecodeError, RuntimeError)


def _parse(kind, body: bytes):
    return kind.read(ReadDataStream(BytesIO(body)))


def _decompress(chunk: Chunk) -> bytes:
    """A chunk's records; never takes more memory than the chunk declares, nor than is allowed."""
    size = chunk.uncompressed_size
    if size > MAX_RECORD_BYTES:
        raise _DamageError("a chunk declares an absurd size")
    try:
        if chunk.compression == "zstd":
            data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
        elif chunk.compression == "":
            data = chunk.data
        else:
            raise _DamageError(f"a chunk has the unknown compression {chunk.compression!r}")
    except (zstandard.ZstdError, RuntimeError):  # the latter is what lz4 raises
        raise _DamageError("a chunk cannot be decompressed") from None
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise _DamageError("a chunk does not match its checksum")
    return data


def _inside(opcode: int, body: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of a record, or of all records in it where it is a chunk."""
    if opcode != Opcode.CHUNK:
        yield opcode, body
        return
    data = _decompress(_parse(Chunk, body))
    position = 0
    while position < len(data):
        opcode, length = struct.unpack_from("<BQ", data, position)
        position += 9
        if length > len(data) - position:
            raise _DamageError("a record ends outside of its chunk")
        yield opcode, data[position : position + length]
        position += length


def _message(body: bytes) -> Message:
    channel_id, sequence, log_time, _ = struct.unpack_from("<HIQQ", body)
    return Message(channel_id, sequence, log_time, body[22:])


def scan(path: str | Path) -> Scan:
    """Read a file from front to back and say what is in it.

    A file that was cut off or damaged is read up to there; `problem` says why it ended.

    Raises:
        RecordingError: it cannot be opened or is not an MCAP file at all.
    """
    found = Scan(Path(path))
    try:
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise RecordingError(f"{path} is not an MCAP file; name a recording")
            found.problem = _scan_records(file, size, found)
    except OSError as error:
        raise RecordingError(f"{path} cannot be read ({error.strerror}); check the name") from None
    return found


_READ = (Opcode.CHUNK, Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)


def _scan_records(file, size: int, found: Scan) -> str | None:
    """Fill in `found`; returns why the file ended early, or None."""
    while True:
        offset = file.tell()
        head = file.read(9)
        if len(head) < 9:
            return "the file ends before its index"
        opcode, length = struct.unpack("<BQ", head)
        if length > size - offset - 9:
            return "the file ends in the middle of a record"
        if opcode == Opcode.FOOTER:
            file.seek(length, os.SEEK_CUR)
            whole = file.read(len(MCAP0_MAGIC) + 1) == MCAP0_MAGIC
            return None if whole else "the file does not end where it should"
        if opcode not in _READ:
            file.seek(length, os.SEEK_CUR)
            continue
        if length > MAX_RECORD_BYTES:
            return "a record declares an absurd size"
        try:
            _scan_block(opcode, file.read(length), (offset, length + 9), found)
        except _PARSE_ERRORS as error:
            return str(error) if isinstance(error, _DamageError) else "a record is damaged"


def _scan_block(opcode: int, body: bytes, place: tuple[int, int], found: Scan) -> None:
    # All of a block or none of it: what is counted here is what `messages` will yield.
    counts, times = dict(found.counts), list(found.times or ())
    for inner, data in _inside(opcode, body):
        if inner == Opcode.MESSAGE:
            message = _message(data)
            counts[message.channel_id] = counts.get(message.channel_id, 0) + 1
            times.append(message.log_time)
        elif inner == Opcode.SCHEMA:
            schema = _parse(Schema, data)
            found.schemas[schema.id] = schema
        elif inner == Opcode.CHANNEL:
            channel = _parse(Channel, data)
            found.channels[channel.id] = channel
        elif inner == Opcode.METADATA:
            record = _parse(Metadata, data)
            found.metadata.append((record.name, record.metadata))
    if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
        found.blocks.append(place)
    found.counts = counts
    found.times = (min(times), max(times)) if times else None


def messages(found: Scan, channel_ids: set[int]) -> Iterator[Message]:
    """The messages of some channels of a scanned file, in the file's order, block by block."""
    try:
        with open(found.path, "rb") as file:
            for offset, length in found.blocks:
                file.seek(offset)
                record = file.read(length)
                for opcode, body in _inside(record[0], record[9:]):
                    if opcode == Opcode.MESSAGE:
                        message = _message(body)
                        if message.channel_id in channel_ids:
                            yield message
    except (OSError, IndexError, *_PARSE_ERRORS):
        raise RecordingError(f"{found.path} changed while it was read; open it again") from None
