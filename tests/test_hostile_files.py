import json
import os
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
import zstandard
from mcap.writer import Writer

from designrl import checkpoint
from designrl.cli import main
from designrl.errors import InputError
from designrl.recording import describe, read


def test_thousands_of_damaged_files_are_read_or_refused():
    command = [sys.executable, str(Path(__file__).with_name("fuzz.py")), "--files", "2000"]
    result = subprocess.run([*command, "--seed", "1"], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "2000 files" in result.stdout and "0 failures" in result.stdout


@pytest.mark.parametrize("name", ["a.safetensors", "a.json", "a.mcap"])
def test_what_is_no_file_is_refused_at_once(name, tmp_path, capsys):
    os.mkfifo(tmp_path / name)
    with pytest.raises(SystemExit):
        main(["info" if name != "a.json" else "evaluate", str(tmp_path / name)])
    assert capsys.readouterr().err.count("\n") == 1
    with pytest.raises(InputError, match="is not a file"):
        checkpoint.load("/dev/zero")


def test_a_large_file_is_not_read(tmp_path):
    for name in ("a.safetensors", "a.json"):
        with (tmp_path / name).open("wb") as file:
            file.truncate(2**40)  # takes no space
        with pytest.raises(InputError, match="1,099,511,627,776 bytes, too many"):
            checkpoint.load(tmp_path / name, "biped")


def mcap(*chunks: bytes) -> bytes:
    """An MCAP file with these zstd chunks, which declare their true size and no checksum."""
    data = b"\x89MCAP0\r\n" + struct.pack("<BQII", 1, 8, 0, 0)
    for content in chunks:
        packed = zstandard.compress(content)
        body = struct.pack("<QQQII", 0, 0, len(content), 0, 4) + b"zstd"
        body += struct.pack("<Q", len(packed)) + packed
        data += struct.pack("<BQ", 6, len(body)) + body
    return data


@pytest.mark.parametrize(
    ("record", "count", "chunks", "problem"),
    [
        (bytes(9), 10**6, 100, "has no place there"),
        (struct.pack("<BQHIQQ", 5, 22, 1, 0, 0, 0), 5 * 10**5, 100, "absurd size"),
        (struct.pack("<BQ", 5, 2**63), 10**5, 1, "outside of its chunk"),
        (struct.pack("<BQ", 6, 0), 1, 1, "has no place there"),
    ],
)
def test_a_bomb_does_not_go_off(record, count, chunks, problem, tmp_path):
    path = tmp_path / "bomb.mcap"
    path.write_bytes(mcap(*[record * count] * chunks))
    assert path.stat().st_size < 2**23
    begin = time.process_time()
    assert problem in read(path).problem
    with pytest.raises(InputError, match=problem):  # it holds nothing else
        describe(path)
    assert time.process_time() - begin < 20


@pytest.mark.parametrize("names", ["{", '"ab"', "[1]", "[" * 100_000])
def test_damaged_names_are_refused(names, tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/x", "json", 0, {"names": names})
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    with pytest.raises(InputError, match=f"names on /x in {path} are damaged"):
        read(path).names("/x")


def test_a_length_beyond_all_files_is_refused(tmp_path):
    path = tmp_path / "a.mcap"
    fields = struct.pack("<QQQI", 0, 0, 0, 0) + struct.pack("<I", 0) + struct.pack("<Q", 2**64 - 1)
    chunk = struct.pack("<BQ", 6, len(fields)) + fields
    path.write_bytes(b"\x89MCAP0\r\n" + chunk)
    assert "damaged" in read(path).problem


def test_a_strangers_text_does_not_command_the_terminal(tmp_path, capsys):
    metadata = {"format": checkpoint.FORMAT, "experiment": "\x1b[2Jbiped\nline two"}
    checkpoint.write_tensors(tmp_path / "a.safetensors", {}, metadata, checkpoint.FORMAT)
    with pytest.raises(SystemExit):
        main(["info", str(tmp_path / "a.safetensors")])
    errors = capsys.readouterr().err
    assert "\x1b" not in errors and errors.count("\n") == 1


@pytest.mark.parametrize("deep", ["[" * 10**6, '{"a":' * 10**5, "1" * 10**6])
def test_nested_or_huge_json_is_refused(deep, tmp_path):
    (tmp_path / "a.json").write_text(deep)
    with pytest.raises(InputError, match="not a 2018 weights file"):
        checkpoint.load(tmp_path / "a.json", "biped")
    header = json.dumps({"__metadata__": {"designrl": deep}}).encode()
    data = len(header).to_bytes(8, "little") + header
    (tmp_path / "a.safetensors").write_bytes(data)
    with pytest.raises(InputError, match="not a whole"):
        checkpoint.load(tmp_path / "a.safetensors")
