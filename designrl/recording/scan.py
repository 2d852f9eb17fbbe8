"""Reading MCAP files of any origin, in any state: front to back, each size checked before memory is
taken for it, up to where the file stops making sense.
"""

import os
import struct
import zlib
from collections import Counter
from collections.abc import Container, Iterator
from io import BytesIO
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from designrl.recording.mcap_file import RecordingError

MAX_RECORD_BYTES = 2**25  # of one record, and of one chunk when decompressed; ours are < 2 MB
# What all chunks of a file may decompress to: ours grow up to tenfold, a bomb ten thousandfold. An
# empty message counts, too: it takes as long to read as one of some size.
MAX_GROWTH, FREE_BYTES, MESSAGE_BYTES = 30, 2**21, 256


class _DamageError(ValueError):
    """The file makes no sense from here on; the message says why."""


# What parsing a damaged record can raise; of numbers, a length of 2⁶³ or more.
_PARSE_ERRORS = (ValueError, struct.error, McapError, RuntimeError, OverflowError)
_IN_CHUNKS = (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL)
_READ = (*_IN_CHUNKS, Opcode.CHUNK, Opcode.METADATA)


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
        if opcode not in _IN_CHUNKS:
            raise _DamageError("a chunk holds a record that has no place there")
        if length > len(data) - position:
            raise _DamageError("a record ends outside of its chunk")
        yield opcode, data[position : position + length]
        position += length


def _message(body: bytes) -> Message:
    channel_id, sequence, log_time, publish_time = struct.unpack_from("<HIQQ", body)
    if log_time >= 2**63:
        raise _DamageError("a message has an absurd time")
    return Message(channel_id, log_time, body[22:], publish_time, sequence)


class Scan:
    """What an MCAP file holds, not decoded; one that was cut off or damaged is read up to there.

    Attributes:
        path: the file.
        problem: why it ends early, in words; None for a whole file.
        metadata_records: all metadata in the file's order: name and values of each record.
        channels, schemas: by id.
        counts: messages per channel id.
        times: smallest and largest log time in ns; None without messages.

    Raises:
        RecordingError: it cannot be opened or is not an MCAP file at all.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self.metadata_records: list[tuple[str, dict[str, str]]] = []
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.counts: Counter[int] = Counter()
        self.times: tuple[int, int] | None = None
        # Offset and length of each chunk, and of each message outside of a chunk.
        self._blocks: list[tuple[int, int]] = []
        try:
            if self.path.is_fifo():
                raise RecordingError(f"{path} is not a file; name a recording")
            with open(path, "rb") as file:
                if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                    raise RecordingError(f"{path} is not an MCAP file; name a recording")
                self.problem = self._read(file, os.fstat(file.fileno()).st_size)
        except OSError as error:
            raise RecordingError(
                f"{path} cannot be read ({error.strerror}); check its name and permissions"
            ) from None

    def _read(self, file, size: int) -> str | None:
        """Read from front to back; returns why the file ended early, or None."""
        room = FREE_BYTES + MAX_GROWTH * size  # for what chunks decompress to
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
                body = file.read(length)
                if opcode == Opcode.CHUNK:
                    room -= _parse(Chunk, body).uncompressed_size
                    if room < 0:
                        return "its chunks declare an absurd size"
                room -= MESSAGE_BYTES * self._add(opcode, body)
            except _PARSE_ERRORS as error:
                return str(error) if isinstance(error, _DamageError) else "a record is damaged"
            if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                self._blocks.append((offset, length + 9))

    def _add(self, opcode: int, body: bytes) -> int:
        """Note what a record holds; returns how many messages that is."""
        # All messages of a block or none: what is counted here is what `raw` will yield.
        counts, times = Counter(), self.times
        for inner, data in _inside(opcode, body):
            if inner == Opcode.MESSAGE:
                message = _message(data)
                counts[message.channel_id] += 1
                first, last = times or (message.log_time, message.log_time)
                times = min(first, message.log_time), max(last, message.log_time)
            elif inner == Opcode.SCHEMA:
                schema = _parse(Schema, data)
                self.schemas[schema.id] = schema
            elif inner == Opcode.CHANNEL:
                channel = _parse(Channel, data)
                self.channels[channel.id] = channel
            elif inner == Opcode.METADATA:
                record = _parse(Metadata, data)
                self.metadata_records.append((record.name, record.metadata))
        self.counts.update(counts)
        self.times = times
        return counts.total()

    def schema(self, channel: Channel) -> Schema:
        """What the channel's messages are; nameless where the file does not say."""
        return self.schemas.get(channel.schema_id) or Schema(0, b"", "", "")

    def raw(self, channels: Container[int]) -> Iterator[Message]:
        """The messages of some channels, by id, in the file's order, block by block."""
        try:
            with open(self.path, "rb") as file:
                for offset, length in self._blocks:
                    file.seek(offset)
                    record = file.read(length)
                    for opcode, body in _inside(record[0], record[9:]):
                        if opcode == Opcode.MESSAGE:
                            message = _message(body)
                            if message.channel_id in channels:
                                yield message
        except (OSError, IndexError, *_PARSE_ERRORS):
            raise RecordingError(f"{self.path} changed while it was read; open it again") from None
