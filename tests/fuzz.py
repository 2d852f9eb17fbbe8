"""Reads damaged and hostile files: checkpoints, 2018 weights, training states, recordings.

    python tests/fuzz.py                          100,000 files; exit code 1 if anything is wrong
    python tests/fuzz.py --files 5000 --seed 3

Each file is read as far as the library can, or refused with one sentence (InputError) that names
it. Anything else is a failure: another exception, a crash, more than 10 s, more than 2 GB of
memory, code that runs. File number i of a seed is always the same; a failure tells how to read it
again with --only.
"""

import argparse
import contextlib
import io
import json
import os
import random
import resource
import signal
import struct
import sys
import tempfile
import zlib
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import rerun as rr
import safetensors.numpy
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from test_recording import write_run  # noqa: E402

from designrl import checkpoint, names  # noqa: E402
from designrl.errors import InputError  # noqa: E402
from designrl.provenance import core_count  # noqa: E402
from designrl.recording import (  # noqa: E402
    RunWriter,
    describe,
    read,
    record_rollout,
    schema_pb2,
    table,
)
from designrl.settings import TrainSettings  # noqa: E402
from designrl.train import TrainingRun  # noqa: E402
from designrl.viewer.data import log_recording  # noqa: E402
from designrl.viewer.layout import blueprint  # noqa: E402

MEMORY_BYTES = 2**31  # beyond what the process has at the start
SECONDS = 10
BATCH = 1000
EXPERIMENT = "biped-morphology"
FORBIDDEN = ("os.system", "os.exec", "os.posix_spawn", "os.fork", "subprocess.Popen", "pickle.")
FORBIDDEN += ("socket.", "exec", "compile", "import", "ctypes.")


class FuzzError(Exception):
    """A file was not read as it should be."""


# ------------------------------------------------------------------------------- whole files


def originals(folder: Path) -> dict[str, bytes]:
    """A whole file of each kind; the same bytes wherever it matters."""
    agent = checkpoint.load(ROOT / "pretrained" / EXPERIMENT / "seed0.safetensors")
    checkpoint.save(agent, folder / "f.safetensors")
    TrainingRun(TrainSettings.of(EXPERIMENT), folder / "run")._save_state()
    (folder / "f.json").write_text(json.dumps([agent.parameters.round(4).tolist(), 12.5]))
    write_run(folder / "f.mcap", range(5))
    record_rollout(agent, folder / "r.mcap", seed=0)
    return {kind: (folder / name).read_bytes() for kind, (name, *_) in KINDS.items()}


# ------------------------------------------------------------------------------- damage

ODD_TEXTS = ["NaN", "Infinity", "1e999", "-1", "9" * 5000, "null", "true", '"x"', "[]", "{}"]
ODD_TEXTS += ["[" * 3000, '{"a":' * 3000, '"\\u001b[2J"', '"\\ud800"', '"\\n\\n"', "0.5", "1e-400"]
ODD_VALUES = [None, True, -1, 2**31, 2**63, 2**64, 10**400, 1e308, float("nan"), "", "x\n\x1b[2J"]
ODD_VALUES += [[], {}, [[]], [1.0] * 50, {"a": {}}, "biped", "F32", "BF16", "F8_E4M3", "I64", 0]
ODD_VALUES += [json.loads("[" * 200 + "]" * 200), {"a": "x\nsha256  0"}, "x" * 50_000]
ODD_VALUES += ["__reduce__", "os.system('true')", [0, 8], [8, 0], [2**62, 2]]
ODD_NUMBERS = [0, 1, 7, 255, 2**16, 2**28, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1]


def damage_bytes(data: bytes, rng: random.Random) -> bytes:
    """Change, cut, repeat or insert bytes, anywhere or near the beginning."""
    data = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 5, 20])):
        place = rng.randrange(max(1, min(rng.choice([16, 300, len(data), len(data)]), len(data))))
        size, one = rng.choice([1, 8, 100, 5000]), rng.randbytes(1)
        removed, added = rng.choice(
            [
                (1, one),
                (1, one),
                (8, struct.pack("<Q", rng.choice(ODD_NUMBERS))),
                (size, b""),
                (0, data[place : place + size]),
                (0, rng.randbytes(min(size, 100))),
                (len(data), b""),
            ]
        )
        data[place : place + removed] = added
    return bytes(data)


def damage_tree(value, rng: random.Random):
    """Replace, drop or add something somewhere in a JSON value."""
    if isinstance(value, dict) and value and rng.random() < 0.85:
        key = rng.choice(list(value))
        if rng.random() < 0.15:
            return {k: v for k, v in value.items() if k != key}
        return {**value, key: damage_tree(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.7:
        place = rng.randrange(len(value))
        changed = [] if rng.random() < 0.2 else [damage_tree(value[place], rng)]
        return value[:place] + changed + value[place + 1 :]
    return rng.choice(ODD_VALUES)


def damage_safetensors(data: bytes, rng: random.Random) -> bytes:
    """Lies in the header, with a length that fits it."""
    size = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + size])
    if rng.random() < 0.6:
        about = json.loads(header["__metadata__"]["designrl"])
        for _ in range(rng.choice([1, 1, 2])):
            about = damage_tree(about, rng)
        if isinstance(about, dict) and rng.random() < 0.8:
            about.pop("sha256", None)  # that of before would show all of it
            about["sha256"] = checkpoint.content_hash(safetensors.numpy.load(data), about)
        header["__metadata__"]["designrl"] = json.dumps(about)
    else:
        header = damage_tree(header, rng)
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data[8 + size :]


def damage_json(data: bytes, rng: random.Random) -> bytes:
    """Odd texts in the place of numbers and brackets, or odd values."""
    if rng.random() < 0.3:
        return json.dumps(damage_tree(json.loads(data), rng)).encode()
    place = rng.choice([0, 1, 2, rng.randrange(len(data)), data.rindex(b",") + 1, len(data)])
    return data[:place] + rng.choice(ODD_TEXTS).encode() + data[place + rng.choice([0, 1, 6]) :]


def damage_mcap(data: bytes, rng: random.Random) -> bytes:
    """Damage inside of a record of the file's, which is a chunk or metadata if it has these."""
    return damage_records(data, rng, 8, (Opcode.CHUNK, Opcode.METADATA), 1)


def damage_records(data: bytes, rng, start: int, wanted: tuple[int, ...], most: int) -> bytes:
    """Change, rename or drop some records, mostly with the length that fits them."""
    records, position = [], start
    while position + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, position)
        records.append((opcode, data[position + 9 : position + 9 + length]))
        position += 9 + length
    packed = [struct.pack("<BQ", opcode, len(body)) + body for opcode, body in records]
    places = [i for i, (opcode, _) in enumerate(records) if opcode in wanted] or range(len(records))
    for place in rng.sample(places, min(len(places), rng.randint(1, most))):
        opcode, body = records[place]
        body = (damage_chunk if opcode == Opcode.CHUNK else damage_bytes)(body, rng)
        if rng.random() < 0.1:
            opcode = rng.randrange(20)
        packed[place] = struct.pack("<BQ", opcode, len(body)) + body
        if rng.random() < 0.2:
            packed[place] = b""
    return data[:start] + b"".join(packed) + data[position:]


def damage_chunk(body: bytes, rng: random.Random) -> bytes:
    """Damage inside of a chunk, which then has the right size and checksum, or lies about them."""
    data = Chunk.read(ReadDataStream(io.BytesIO(body))).data
    content = zstandard.ZstdDecompressor().stream_reader(data).read()
    if rng.random() < 0.2:
        content = damage_bytes(content, rng)
    else:
        content = damage_records(content, rng, 0, (), 3)
    name, packed = rng.choice([("zstd", zstandard.compress(content)), ("", content)])
    if rng.random() < 0.02:
        packed = zstandard.compress(bytes(rng.choice([2**20, 2**25])))  # a bomb
    crc = zlib.crc32(content) if rng.random() < 0.7 else 0  # 0: not to be checked
    size = len(content) if rng.random() < 0.9 else rng.choice(ODD_NUMBERS)
    builder = RecordBuilder()
    Chunk(name, packed, 0, 0, crc, size).write(builder)
    return builder.end()[9:]


def damaged(files: dict[str, bytes], seed: int, index: int) -> tuple[str, bytes]:
    """Kind and content of a file; a function of the seed and the index."""
    rng = random.Random(f"{seed}/{index}")
    [kind] = rng.choices(list(KINDS), [weight for _, weight, *_ in KINDS.values()])
    data = files[kind]
    if rng.random() < 0.6:
        data = KINDS[kind][2](data, rng)
    if rng.random() < 0.5 or data == files[kind]:
        data = damage_bytes(data, rng)
    return kind, data


# ------------------------------------------------------------------------------- reading


def refused(function, *arguments) -> str:
    """Call a function; returns the sentence it refuses with, or nothing."""
    try:
        function(*arguments)
    except InputError as error:
        text = str(error)
        if not 10 < len(text) < 3000:
            raise FuzzError(f"a refusal of {len(text)} characters: {text[:200]}") from None
        return text
    return ""


def read_checkpoint(path: Path) -> None:
    checkpoint.load(path).act(np.zeros(24))
    checkpoint.describe(path)


def read_state(path: Path) -> None:
    checkpoint.describe(path)
    run = TrainingRun(TrainSettings.of(EXPERIMENT), path.parent, resume=True)
    if not np.isfinite(run.optimiser.ask().numpy()).all():
        raise FuzzError("a state gives candidates that are not finite")


def read_recording(path: Path) -> None:
    """All that can be read of it, whatever else of it is refused."""
    recording = read(path)
    refused(describe, path)
    refused(table, path)
    refused(table, path, True)
    for topic in recording.topics:
        kind = schema_pb2.DESCRIPTOR.message_types_by_name.get(topic.strip("/").capitalize())
        for field in [*(kind.fields_by_name if kind else ()), "log_time"]:
            refused(recording.array, topic, field)
        refused(recording.names, topic)
        refused(lambda topic: list(recording.messages(topic)), topic)
    refused(recording.transforms)
    if path.stat().st_size % 4 == 0:  # slow, and most of it is what is done above
        metadata = {"experiment": EXPERIMENT}
        refused(lambda: RunWriter(path, metadata, resume_generation=2).close())
        refused(show, recording)


def show(recording) -> None:
    """What `designrl replay` does without a window."""
    blueprint([recording], ["name"])
    stream = rr.RecordingStream("fuzz")
    memory = stream.memory_recording()
    try:
        log_recording(stream, recording, "name")
    finally:
        memory.drain_as_bytes()
        stream.disconnect()


# Kind -> its file, how often there is one, what damages it, knowing the format, and what reads it.
KINDS = {
    "checkpoint": ("f.safetensors", 2, damage_safetensors, read_checkpoint),
    "state": ("run/state.safetensors", 1, damage_safetensors, read_state),
    "2018": ("f.json", 2, damage_json, lambda path: names.load(path, EXPERIMENT)),
    "run": ("f.mcap", 2, damage_mcap, read_recording),
    "rollout": ("r.mcap", 1, damage_mcap, read_recording),
}


def read_file(folder: Path, kind: str, data: bytes) -> bool:
    """Read a file; False if it is refused.

    Raises:
        FuzzError, or what the library raised that it should not have.
    """
    name, _, _, reader = KINDS[kind]
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    refusal = refused(reader, path)
    if refusal and str(folder) not in refusal:
        raise FuzzError(f"a refusal that does not name the file: {refusal}")
    return not refusal


class Guard:
    """In a process of its own: limits memory and time, and forbids to run code."""

    def __init__(self):
        self._armed = False
        used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, resource.RLIM_INFINITY))
        signal.signal(signal.SIGPROF, self._late)
        sys.addaudithook(self._audit)

    def _late(self, *_):
        raise FuzzError(f"it takes more than {SECONDS} s of processor time")

    def _audit(self, event, arguments):
        if self._armed and event.startswith(FORBIDDEN):
            self._armed = False
            raise FuzzError(f"it does {event} {str(arguments)[:200]}")

    def __enter__(self):
        signal.setitimer(signal.ITIMER_PROF, SECONDS)  # a busy machine is no fault
        self._armed = True

    def __exit__(self, *_):
        self._armed = False
        signal.setitimer(signal.ITIMER_PROF, 0)


def read_batch(files: dict[str, bytes], seed: int, indices: range) -> tuple[Counter, list[str]]:
    """Read some files; returns how many of which kind were refused or read, and what went wrong."""
    counts, wrong = Counter(), []
    with tempfile.TemporaryDirectory(prefix="designrl-") as name:
        folder = Path(name)
        for kind, data in files.items():  # imports what there is to import
            read_file(folder, kind, data)
        guard = Guard()
        for index in indices:
            kind, data = damaged(files, seed, index)
            try:
                # The library's remarks on what it mends would be 100,000 lines.
                with guard, contextlib.redirect_stderr(io.StringIO()):
                    fine = read_file(folder, kind, data)
                counts[kind, "read" if fine else "refused"] += 1
            except BaseException as error:
                counts[kind, "WRONG"] += 1
                wrong.append(f"file {index} ({kind}): {error!r}")
    return counts, wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, metavar="I", help="read this file, with a traceback")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="designrl-") as name:
        files = originals(Path(name))
        if options.only is not None:
            kind, data = damaged(files, options.seed, options.only)
            print(kind, "read" if read_file(Path(name), kind, data) else "refused")
            return 0
    counts, wrong = Counter(), []
    starts = range(0, options.files, BATCH)
    batches = [range(start, min(start + BATCH, options.files)) for start in starts]
    # A fresh process for each batch: what one file leaves behind must not hide what another does.
    with ProcessPoolExecutor(core_count(), max_tasks_per_child=1) as pool:
        futures = {batch: pool.submit(read_batch, files, options.seed, batch) for batch in batches}
        for batch, future in futures.items():
            try:
                found, failures = future.result()
            except Exception as error:  # the process has crashed
                found, failures = Counter(), [f"one of files {batch}: {error!r}"]
            counts += found
            wrong += failures
    for (kind, outcome), count in sorted(counts.items()):
        print(f"{count:8d} {kind} files {outcome}")
    print(f"{counts.total()} files, {len(wrong)} failures")
    for line in wrong[:20]:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
