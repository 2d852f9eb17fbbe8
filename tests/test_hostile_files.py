import json
import os
import struct
import subprocess
import sys
import time
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from hostile import FILES, check
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC
from test_recording import write_others

from designrl import checkpoint, names
from designrl.cli import main
from designrl.errors import InputError
from designrl.experiments import get_experiment
from designrl.policy import Agent
from designrl.recording import describe, read, record_rollout


def test_hundreds_of_damaged_files_are_read_or_refused():
    command = [sys.executable, str(Path(__file__).with_name("fuzz.py")), "--files", "200"]
    result = subprocess.run([*command, "--seed", "1"], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "200 files" in result.stdout and "0 failures" in result.stdout


@pytest.mark.parametrize("name", ["a.safetensors", "a.json", "a.mcap"])
def test_what_is_no_file_is_refused_at_once(name, tmp_path, capsys):
    os.mkfifo(tmp_path / name)
    with pytest.raises(SystemExit):
        main(["info" if name != "a.json" else "evaluate", str(tmp_path / name)])
    assert capsys.readouterr().err.count("\n") == 1
    with pytest.raises(InputError, match="is not a file"):
        names.load("/dev/zero")


def test_a_large_file_is_not_read(tmp_path):
    for name in ("a.safetensors", "a.json"):
        with (tmp_path / name).open("wb") as file:
            file.truncate(2**40)  # takes no space
        with pytest.raises(InputError, match="1,099,511,627,776 bytes, too many"):
            names.load(tmp_path / name, "biped")


def chunk(content: bytes, compression="zstd", size: int | None = None) -> bytes:
    """A chunk record, which declares its true size unless another is given, and no checksum."""
    packed = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}[compression](content)
    builder = RecordBuilder()
    Chunk(compression, packed, 0, 0, 0, len(content) if size is None else size).write(builder)
    return builder.end()


MESSAGE = struct.pack("<BQHIQQ", 5, 22, 1, 0, 0, 0)
PADDING = struct.pack("<BQ", 200, 2**21) + bytes(2**21)  # a record of no known kind


@pytest.mark.parametrize(
    ("records", "problem"),
    [
        (chunk(bytes(9) * 10**5) * 100, "has no place there"),
        (chunk(struct.pack("<BQ", 6, 0)), "has no place there"),  # a chunk in a chunk
        (chunk(MESSAGE * 5 * 10**5) * 100, "chunks declare an absurd size"),
        (chunk(struct.pack("<BQ", 5, 2**63) * 10**5), "outside of its chunk"),
        *((chunk(bytes(2**26), way, 1000), "not match its checksum") for way in ("zstd", "lz4")),
        (PADDING + chunk(bytes(2**26), size=2**25 + 1), "a chunk declares an absurd size"),
        (chunk(bytes(2**26), size=2**40), "its chunks declare an absurd size"),
        # A length beyond all files, of what a chunk without compression holds.
        (struct.pack("<BQQQQIIQ", 6, 40, 0, 0, 0, 0, 0, 2**64 - 1), "a record is damaged"),
    ],
)
def test_a_bomb_does_not_go_off(records, problem, tmp_path):
    path = tmp_path / "bomb.mcap"
    path.write_bytes(MCAP0_MAGIC + struct.pack("<BQII", Opcode.HEADER, 8, 0, 0) + records)
    assert path.stat().st_size < 2**23
    begin = time.process_time()
    assert problem in read(path).problem
    with pytest.raises(InputError, match=problem):  # it holds nothing else
        describe(path)
    assert time.process_time() - begin < 20


@pytest.mark.parametrize("name", FILES)
def test_a_file_costs_no_more_than_its_size(name, tmp_path):
    check(tmp_path, name)


@pytest.mark.parametrize("names", ["{", '"ab"', "[1]", "[" * 100_000])
def test_damaged_names_are_refused(names, tmp_path):
    path = tmp_path / "a.mcap"
    write_others(path, about={"names": names})
    with pytest.raises(InputError, match=f"names on /thing in {path} are damaged"):
        read(path).names("/thing")


def test_a_strangers_text_does_not_command_the_terminal(tmp_path, capsys):
    metadata = {"format": checkpoint.FORMAT, "experiment": "\x1b[2Jbiped\nline two"}
    checkpoint.write_tensors(tmp_path / "a.safetensors", {}, metadata, checkpoint.FORMAT)
    with pytest.raises(SystemExit):
        main(["info", str(tmp_path / "a.safetensors")])
    errors = capsys.readouterr().err
    assert "\x1b" not in errors and errors.count("\n") == 1


def test_a_strangers_text_does_not_forge_lines(tmp_path):
    source = "x\nparameters   9"
    agent = Agent(get_experiment("biped"), np.zeros(2804), metadata={"source": source})
    checkpoint.save(agent, tmp_path / "a.safetensors")
    assert checkpoint.describe(tmp_path / "a.safetensors").count("\nparameters") == 1
    about = {"progress": ["x\ny"], "experiment": "a\nb"}
    checkpoint.write_tensors(tmp_path / "s.safetensors", {}, about, checkpoint.STATE_FORMAT)
    assert checkpoint.describe(tmp_path / "s.safetensors").count("\n") == 2
    write_others(tmp_path / "a.mcap", about={"names": "[]"}, metadata={"a": "b\nc"})
    assert "a: b\\nc" in describe(tmp_path / "a.mcap")


@pytest.mark.parametrize("name", [b"\xff.mcap", b"\x1b[2J.mcap"])
def test_odd_file_names_are_told_in_a_line(name, tmp_path):
    path = os.fsencode(tmp_path) + b"/" + name
    record_rollout(Agent(get_experiment("biped"), np.zeros(2804)), Path(os.fsdecode(path)), 0)
    (tmp_path / os.fsdecode(b"bad" + name)).write_text("x")
    saved = os.fsencode(tmp_path) + b"/" + name + b".rrd"
    for words in (["info", path], ["replay", tmp_path, "--save", saved], ["info", name]):
        command = [sys.executable, "-m", "designrl", *words]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == (2 if words[1] == name else 0), done.stderr
        assert "Traceback" not in done.stderr and "\x1b" not in done.stdout + done.stderr
        lines = {"info": 0 if words[1] == path else 1, "replay": 2}[words[0]]  # not shown; from
        assert done.stderr.count("\n") == lines


def test_a_refusal_is_not_longer_than_it_has_to_be(tmp_path, capsys):
    metadata = {"format": checkpoint.FORMAT, "experiment": "x" * 50_000, "network": {"sizes": []}}
    checkpoint.write_tensors(tmp_path / "a.safetensors", {}, metadata, checkpoint.FORMAT)
    with pytest.raises(SystemExit):
        main(["info", str(tmp_path / "a.safetensors")])
    assert 100 < len(capsys.readouterr().err) < 2100


@pytest.mark.parametrize("command", ["record", "import"])
def test_a_link_that_leads_nowhere_is_not_replaced(command, tmp_path, capsys):
    path = tmp_path / ("a.mcap" if command == "record" else "a.safetensors")
    path.symlink_to(tmp_path / "nowhere")
    more = ["--experiment", "biped"] if command == "import" else []
    with pytest.raises(SystemExit):
        main([command, "absent.json", *more, "-o", str(path)])
    assert "exists already" in capsys.readouterr().err and path.is_symlink()


def test_deep_metadata_is_refused(tmp_path):
    deep = json.loads("[" * 100 + "]" * 100)
    checkpoint.write_tensors(tmp_path / "a.safetensors", {}, {"a": deep}, checkpoint.FORMAT)
    with pytest.raises(InputError, match="not a whole"):
        names.load(tmp_path / "a.safetensors")


@pytest.mark.parametrize("deep", ["[" * 10**6, '{"a":' * 10**5, "1" * 10**6])
def test_nested_or_huge_json_is_refused(deep, tmp_path):
    (tmp_path / "a.json").write_text(deep)
    with pytest.raises(InputError, match="not a 2018 weights file"):
        names.load(tmp_path / "a.json", "biped")
    header = json.dumps({"__metadata__": {"designrl": deep}}).encode()
    data = len(header).to_bytes(8, "little") + header
    (tmp_path / "a.safetensors").write_bytes(data)
    with pytest.raises(InputError, match="not a whole"):
        names.load(tmp_path / "a.safetensors")
