"""Recordings made by hand that would cost far more than their size, or that lie; see `check`."""

import os
import resource
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import zstandard
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk

from designrl.experiments import get_experiment
from designrl.recording import schema_pb2 as schema
from designrl.recording.mcap_file import ROLLOUT, RUN, McapFile
from designrl.recording.rollout import _cdr_string

CPU_SECONDS, MEMORY_BYTES = 10, 2 * 2**30
TEXT = "std_msgs/msg/String", "ros2msg", b"string data\n", {}
REWARD = schema.Reward(reward=1, total=1, terms=[1.0])
TORSO = [("world", "torso")]
LAUGHTER = "".join(f"<!ENTITY a{i} '{f'&a{i - 1};' * 10}'>" for i in range(1, 12))


def tf(frames, x=0.0) -> FrameTransforms:
    message = FrameTransforms()
    for parent, child in frames:
        transform = message.transforms.add(parent_frame_id=parent, child_frame_id=child)
        transform.translation.x, transform.rotation.w = x, 1.0
    return message


def links(frames) -> str:
    return "<robot>" + "".join(f"<link name='{child}'/>" for _, child in frames) + "</robot>"


def chain(length: int, name_length: int) -> list[tuple[str, str]]:
    names = ["world", *(f"{i}{os.urandom(name_length // 2).hex()}" for i in range(length))]
    return list(zip(names, names[1:], strict=False))


def rollout(path: Path, robot: str = "", messages=(), padding: int = 0) -> None:
    """A rollout of an ant with that description and those messages on /tf."""
    ant = get_experiment("ant").body
    file = McapFile(path)
    file.metadata(ROLLOUT, {"experiment": "ant", "padding": os.urandom(padding // 2).hex()})
    file.add_channel("/robot_description", *TEXT)
    text = robot or ant.urdf(np.ones(ant.design.size))
    file.message("/robot_description", 0, 0, _cdr_string(text))
    for i, message in enumerate(messages or [tf(TORSO)] * 3):
        file.write(message, i, i, topic="/tf")
        file.write(REWARD, i, i, names=["reward"])
    file.publish()
    file.close()


def summaries(path: Path, count: int, padding: int) -> None:
    """A run with so many empty messages in one chunk."""
    file = McapFile(path)
    file.metadata(RUN, {"experiment": "ant", "padding": os.urandom(padding // 2).hex()})
    file.write(schema.Summary(), 0, 0)
    file.publish()
    file.close()
    data, place, opcode = path.read_bytes(), 8, None
    while opcode != Opcode.CHUNK:
        opcode, length = struct.unpack_from("<BQ", data, place)
        place += 9 + length
    content = struct.pack("<BQHIQQ", Opcode.MESSAGE, 22, 1, 0, 0, 0) * count
    builder = RecordBuilder()
    Chunk("zstd", zstandard.compress(content), 0, 0, 0, len(content)).write(builder)
    path.write_bytes(data[:place] + builder.end() + data[place:])


def parts(count: int) -> list[tuple[str, str]]:
    return [("world", f"part {i}") for i in range(count)]


FILES = {
    "an ant a long way off": lambda p: rollout(p, messages=[tf(TORSO), tf(TORSO, 3e6)]),
    "an ant beyond all numbers": lambda p: rollout(p, messages=[tf(TORSO), tf(TORSO, 1e300)]),
    "an ant at no place": lambda p: rollout(p, messages=[tf(TORSO, float("nan"))]),
    "an ant outside of the world": lambda p: rollout(p, messages=[tf([("earth", "torso")])]),
    "another type on tf": lambda p: rollout(p, messages=[schema.Action(values=[1.0])]),
    "a million nested links": lambda p: rollout(
        p, "<robot>" + "<link name='a'>" * 10**6 + "</link>" * 10**6 + "</robot>"
    ),
    "nested links with much to draw": lambda p: rollout(
        p,
        f"<robot>{'<link>' * 20_000}{'<visual/>' * 20_000}{'</link>' * 20_000}</robot>",
        (),
        10**5,
    ),
    "a long description": lambda p: rollout(p, links(parts(10**5)), (), 10**6),
    "entities of entities": lambda p: rollout(
        p, f"<!DOCTYPE x [<!ENTITY a0 'ha'>{LAUGHTER}]><robot>&a11;</robot>"
    ),
    "a chain of frames": lambda p: (lambda frames: rollout(p, links(frames), [tf(frames)]))(
        chain(2000, 200)
    ),
    "long names": lambda p: (lambda frames: rollout(p, links(frames), [tf(frames)]))(
        chain(200, 3000)
    ),
    "many parts": lambda p: rollout(p, links(parts(20_000)), [tf(parts(20_000))]),
    "many places": lambda p: rollout(p, messages=[tf(TORSO * 10**5)] * 20, padding=10**6),
    "empty summaries": lambda p: summaries(p, 10**6, 0),
    "empty summaries in a larger file": lambda p: summaries(p, 10**5, 10**6),
}


def check(folder: Path, name: str) -> None:
    """Have a file told of and replayed, within limits, or refused with one sentence (after
    one more where it is not whole).

    Raises:
        AssertionError: it was not.
    """
    path = folder / f"{name}.mcap"
    FILES[name](path)
    for words in (["info", path], ["replay", path, "--save", folder / f"{name}.rrd"]):
        done = subprocess.run(
            [sys.executable, "-m", "designrl", *words],
            capture_output=True,
            text=True,
            preexec_fn=limit,
        )
        about = f"{name}, {words[0]}: exit {done.returncode}: {done.stderr[-300:]}"
        assert done.returncode in (0, 2) and done.stderr.count("\n") <= 2, about
        last = done.stderr.rpartition("\n")[0].rpartition("\n")[2]
        assert done.returncode == 0 or last.startswith("designrl: "), about


def limit() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS))
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
