"""Reads damaged and hostile files: checkpoints, 2018 weights, training states, recordings.

    python tests/fuzz.py                          100,000 files; exit code 1 if anything is wrong
    python tests/fuzz.py --files 5000 --seed 3

Each file is read as far as the library can, or refused with one sentence (InputError) that names
it. Anything else is a failure: another exception, a crash, more than 10 s, more than 1 GB of
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
import time
import zlib
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import zstandard

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from designrl import checkpoint  # noqa: E402
from designrl.errors import InputError  # noqa: E402
from designrl.experiments import get_experiment  # noqa: E402
from designrl.policy import Agent  # noqa: E402
from designrl.provenance import versions  # noqa: E402
from designrl.recording import RunWriter, describe, read, record_rollout, schema_pb2  # noqa: E402
from designrl.settings import TrainSettings  # noqa: E402
from designrl.train import TrainingRun  # noqa: E402

MEMORY_BYTES = 2**30  # beyond what the process has at the start
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
    experiment, rng = get_experiment(EXPERIMENT), np.random.default_rng(0)
    parameters = 0.1 * rng.standard_normal(experiment.num_parameters).round(4)
    about = {"seed": 0, "generation": 3, "score": 1.5, "settings": {"population": 4}}
    agent = Agent(experiment, parameters, metadata={**about, "versions": versions()})
    checkpoint.save(agent, folder / "agent.safetensors")
    run = TrainingRun(TrainSettings.of(EXPERIMENT), folder / "run")
    run._save_state()
    with RunWriter(folder / "run.mcap", {"experiment": EXPERIMENT, "seed": "0"}) as writer:
        for index in range(3):
            writer.generation(
                index=index,
                mu=parameters,
                sigma=np.full(parameters.size, 0.1),
                returns=rng.normal(size=(4, 2)),
                steps=rng.integers(1, 2000, (4, 2)),
                seeds=rng.integers(0, 2**63, (4, 2)),
                seconds=1.0,
                total_steps=100,
            )
            writer.evaluation(index, rng.normal(size=3), np.ones(3, int), np.ones(3, int), True)
            writer.flush()
    record_rollout(agent, folder / "rollout.mcap", seed=0)
    return {
        "checkpoint": (folder / "agent.safetensors").read_bytes(),
        "state": (folder / "run/state.safetensors").read_bytes(),
        "2018": json.dumps([parameters.tolist(), 12.5]).encode(),
        "run": (folder / "run.mcap").read_bytes(),
        "rollout": (folder / "rollout.mcap").read_bytes(),
    }


KINDS = ["checkpoint", "checkpoint", "state", "2018", "2018", "run", "run", "rollout"]


# ------------------------------------------------------------------------------- damage

ODD_TEXTS = ["NaN", "Infinity", "1e999", "-1", "9" * 5000, "null", "true", '"x"', "[]", "{}"]
ODD_TEXTS += ["[" * 3000, '{"a":' * 3000, '"\\u001b[2J"', '"\\ud800"', '"\\n\\n"', "0.5", "1e-400"]
ODD_VALUES = [None, True, -1, 2**31, 2**63, 2**64, 10**400, 1e308, float("nan"), "", "x\n\x1b[2J"]
ODD_VALUES += [[], {}, [[]], [1.0] * 50, {"a": {}}, "biped", "F32", "BF16", "F8_E4M3", "I64", 0]
ODD_VALUES += ["__reduce__", "os.system('true')", [0, 8], [8, 0], [2**62, 2]]
ODD_NUMBERS = [0, 1, 7, 255, 2**16, 2**28, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1]


def damage_bytes(data: bytes, rng: random.Random) -> bytes:
    """Change, cut, repeat or insert bytes, anywhere or near the beginning."""
    data = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 5, 20])):
        reach = rng.choice([16, 300, len(data), len(data)])
        place = rng.randrange(max(1, min(reach, len(data))))
        what = rng.randrange(7)
        if what <= 1 and data:
            data[place : place + 1] = bytes([rng.randrange(256)])
        elif what == 2:
            number = rng.choice(ODD_NUMBERS)
            data[place : place + 8] = struct.pack("<Q", number)
        elif what == 3:
            del data[place : place + rng.choice([1, 8, 100, 5000])]
        elif what == 4:
            data[place:place] = data[place : place + rng.choice([1, 8, 100, 5000])]
        elif what == 5:
            data[place:place] = rng.randbytes(rng.choice([1, 8, 100]))
        else:
            del data[rng.randrange(len(data) + 1) :]
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
    """Damage inside of a chunk, which then has the right size and checksum, or lies about them."""
    places, position = [], 8
    while position + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, position)
        places.append((opcode, position, length))
        position += 9 + length
    opcode, position, length = rng.choice([p for p in places if p[0] in (6, 12)] or places)
    body = data[position + 9 : position + 9 + length]
    if opcode != 6:
        body = damage_bytes(body, rng)
    else:
        (name_length,) = struct.unpack_from("<I", body, 28)
        content = body[32 + name_length + 8 :]
        content = zstandard.ZstdDecompressor().stream_reader(content).read()
        content = _damage_records(content, rng)
        size, crc = len(content), zlib.crc32(content)
        if rng.random() < 0.1:
            size = rng.choice(ODD_NUMBERS)
        if rng.random() < 0.3:
            crc = 0  # not to be checked
        name, packed = rng.choice([(b"zstd", zstandard.compress(content)), (b"", content)])
        if rng.random() < 0.02:
            packed = zstandard.compress(bytes(rng.choice([2**20, 2**25])))  # a bomb
        body = body[:16] + struct.pack("<QII", size, crc, len(name)) + name
        body += struct.pack("<Q", len(packed)) + packed
    return (
        data[:position]
        + struct.pack("<BQ", opcode, len(body))
        + body
        + data[position + 9 + length :]
    )


def _damage_records(content: bytes, rng: random.Random) -> bytes:
    """Change a record of a chunk's, mostly with the length that fits it."""
    if rng.random() < 0.2:
        return damage_bytes(content, rng)
    records, position = [], 0
    while position < len(content):
        opcode, length = struct.unpack_from("<BQ", content, position)
        records.append((opcode, content[position + 9 : position + 9 + length]))
        position += 9 + length
    for _ in range(rng.choice([1, 1, 3])):
        place = rng.randrange(len(records))
        opcode, body = records[place]
        records[place] = (
            opcode if rng.random() < 0.9 else rng.randrange(20),
            damage_bytes(body, rng),
        )
        if rng.random() < 0.2:
            del records[place]
        if not records:
            break
    return b"".join(struct.pack("<BQ", opcode, len(body)) + body for opcode, body in records)


DAMAGE = {
    "checkpoint": damage_safetensors,
    "state": damage_safetensors,
    "2018": damage_json,
    "run": damage_mcap,
    "rollout": damage_mcap,
}


def damaged(files: dict[str, bytes], seed: int, index: int) -> tuple[str, bytes]:
    """Kind and content of a file; a function of the seed and the index."""
    rng = random.Random(f"{seed}/{index}")
    kind = rng.choice(KINDS)
    data = files[kind]
    if rng.random() < 0.6:
        data = DAMAGE[kind](data, rng)
    if rng.random() < 0.5 or data == files[kind]:
        data = damage_bytes(data, rng)
    return kind, data


# ------------------------------------------------------------------------------- reading


def read_all(path: Path) -> None:
    """All that can be read of a recording."""
    recording = read(path)
    _or_refuse(describe, path)
    for topic in recording.topics:
        for message in schema_pb2.DESCRIPTOR.message_types_by_name.values():
            if topic.strip("/") == message.name.lower():
                for field in [*message.fields_by_name, "log_time"]:
                    _or_refuse(recording.array, topic, field)
        _or_refuse(recording.names, topic)
        _or_refuse(lambda topic: list(recording.messages(topic)), topic)
    _or_refuse(recording.transforms)
    if path.stat().st_size % 4 == 0:  # slow, and most of it is what is done above
        metadata = {"experiment": EXPERIMENT}
        _or_refuse(lambda: RunWriter(path, metadata, resume_generation=2).close())


def _or_refuse(function, *arguments) -> None:
    try:
        function(*arguments)
    except InputError as error:
        one_sentence(error)


def one_sentence(error: InputError) -> None:
    """Refusals are short and name what is wrong."""
    text = str(error)
    if not 10 < len(text) < 3000:
        raise FuzzError(f"a refusal of {len(text)} characters: {text[:200]}")


def read_file(folder: Path, kind: str, data: bytes) -> bool:
    """Read a file; False if it is refused.

    Raises:
        FuzzError, or what the library raised that it should not have.
    """
    names = {"checkpoint": "f.safetensors", "state": "run/state.safetensors", "2018": "f.json"}
    path = folder / names.get(kind, "f.mcap")
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    try:
        if kind == "checkpoint":
            agent = checkpoint.load(path)
            agent.act(np.zeros(24))
            checkpoint.describe(path)
        elif kind == "2018":
            checkpoint.load(path, EXPERIMENT)
        elif kind == "state":
            run = TrainingRun(TrainSettings.of(EXPERIMENT), path.parent, resume=True)
            if not np.isfinite(run.optimiser.ask().numpy()).all():
                raise FuzzError("a state gives candidates that are not finite")
        else:
            read_all(path)
    except InputError as error:
        one_sentence(error)
        if str(folder) not in str(error):
            raise FuzzError(f"a refusal that does not name the file: {error}") from None
        return False
    return True


class Guard:
    """In a process of its own: limits memory and time, and forbids to run code."""

    def __init__(self):
        self._armed = False
        used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, resource.RLIM_INFINITY))
        signal.signal(signal.SIGALRM, self._late)
        sys.addaudithook(self._audit)

    def _late(self, *_):
        raise FuzzError(f"it takes more than {SECONDS} s")

    def _audit(self, event, arguments):
        if self._armed and event.startswith(FORBIDDEN):
            self._armed = False
            raise FuzzError(f"it does {event} {str(arguments)[:200]}")

    def __enter__(self):
        signal.alarm(SECONDS)
        self._armed = True

    def __exit__(self, *_):
        self._armed = False
        signal.alarm(0)


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
            begin = time.perf_counter()
            try:
                # The library's remarks on what it mends would be 100,000 lines.
                with guard, contextlib.redirect_stderr(io.StringIO()):
                    fine = read_file(folder, kind, data)
                counts[kind, "read" if fine else "refused"] += 1
            except BaseException as error:
                counts[kind, "WRONG"] += 1
                where = error.__traceback__
                while where.tb_next:
                    where = where.tb_next
                place = f"{Path(where.tb_frame.f_code.co_filename).name}:{where.tb_lineno}"
                wrong.append(f"file {index} ({kind}): {type(error).__name__} at {place}: {error}")
            counts["slowest"] = max(counts["slowest"], round(1000 * (time.perf_counter() - begin)))
    return counts, wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--only", type=int, metavar="I", help="read this file, with a traceback")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="designrl-") as name:
        files = originals(Path(name))
        if options.only is not None:
            kind, data = damaged(files, options.seed, options.only)
            print(kind, "read" if read_file(Path(name), kind, data) else "refused")
            return 0
    counts, wrong, slowest = Counter(), [], 0
    batches = [
        range(start, min(start + BATCH, options.files)) for start in range(0, options.files, BATCH)
    ]
    # A fresh process for each batch: what one file leaves behind must not hide what another does.
    with ProcessPoolExecutor(options.workers, max_tasks_per_child=1) as pool:
        futures = [pool.submit(read_batch, files, options.seed, batch) for batch in batches]
        for batch, future in zip(batches, futures, strict=True):
            try:
                found, failures = future.result()
            except Exception as error:  # the process has crashed
                found, failures = Counter(), [f"one of files {batch}: {error}"]
            slowest = max(slowest, found.pop("slowest", 0))
            counts += found
            wrong += failures
    for (kind, outcome), count in sorted(counts.items()):
        print(f"{count:8d} {kind} files {outcome}")
    print(f"{counts.total()} files, the slowest took {slowest} ms, {len(wrong)} failures")
    for line in wrong[:20]:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
