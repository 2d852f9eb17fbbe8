"""What a command owes to where it was started: streams, signals, and no connection to anywhere."""

import os
import platform
import shlex
import subprocess
import sys

import pytest

from designrl.names import load
from designrl.recording import read

DESIGNRL = shlex.join([sys.executable, "-m", "designrl"])
SMALL = "--population 2 --rollouts 1 --generations 2 --evaluation-episodes 1 --workers 2"


def shell(command: str, **kwargs) -> subprocess.CompletedProcess:
    """What a shell's command comes to."""
    return subprocess.run(["sh", "-c", command], capture_output=True, text=True, **kwargs)


@pytest.mark.parametrize("streams", ["2>&-", "<&- >&- 2>&-", ">/dev/full 2>&1"])
def test_words_that_cannot_be_said_do_not_stop_the_work(streams, tmp_path):
    run = tmp_path / "run"
    done = shell(f"{DESIGNRL} train biped {SMALL} --out {run} {streams}")
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert load(run).experiment.name == "biped" and read(run / "generations.mcap").complete
    assert shell(f"{DESIGNRL} train biped --population 2 --out {run} {streams}").returncode == 2


@pytest.mark.parametrize(("streams", "code"), [(">/dev/full", 2), (">&-", 0)])
def test_an_answer_is_not_lost_in_silence(streams, code):
    done = shell(f"{DESIGNRL} checkpoints {streams}")
    said = "designrl: the output cannot be written (No space left on device); send it elsewhere\n"
    assert (done.returncode, done.stderr) == (code, said if code else "")


@pytest.mark.parametrize(
    ("command", "code"), [("checkpoints", 141), ("train biped {} --out {}", 0)]
)
def test_a_reader_who_has_left_ends_an_answer_and_no_work(command, code, tmp_path):
    reader, writer = os.pipe()
    os.close(reader)
    words = [sys.executable, "-m", "designrl", *command.format(SMALL, tmp_path / "r").split()]
    done = subprocess.run(words, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert done.returncode == code and "Traceback" not in done.stderr


def test_characters_that_the_terminal_lacks_are_replaced():
    done = shell(f"{DESIGNRL} checkpoints", env=os.environ | {"PYTHONIOENCODING": "ascii"})
    assert (done.returncode, done.stderr) == (0, "") and "?" in done.stdout


def test_a_signal_that_was_ignored_at_the_start_stays_ignored():
    code = (
        "import signal\n"
        "from signal import SIGHUP, SIGINT, SIGTERM, raise_signal\n"
        "from designrl.recording.mcap_file import uninterrupted\n"
        "from designrl.terminal import heed_signals\n"
        "heed_signals()\n"
        "raise_signal(SIGHUP)\n"
        "try:\n"
        "    with uninterrupted():\n"
        "        raise_signal(SIGHUP), raise_signal({})\n"
        "        print('whole')\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted')\n"
    )
    for number, ignored, words in (
        ("SIGTERM", "HUP", ["whole", "interrupted"]),
        ("SIGINT", "HUP TERM", ["whole", "interrupted"]),
        ("SIGTERM", "HUP TERM", ["whole"]),
        ("SIGINT", "HUP INT", ["whole"]),
    ):
        python = shlex.join([sys.executable, "-c", code.format(number)])
        assert shell(f"trap '' {ignored}; exec {python}").stdout.split() == words


# A system call filter of Linux (seccomp): socket() ends the process, and those that it starts,
# but for local ones, by which the C library asks for a user's name.
NO_SOCKETS = """
import ctypes, os, sys
number = int(sys.argv[1])
load, equal, end, go_on = 0x20, 0x15, (0x06, 0, 0, 0x80000000), (0x06, 0, 0, 0x7FFF0000)
rules = [(load, 0, 0, 0), (equal, 0, 3, number), (load, 0, 0, 16), (equal, 1, 0, 1), end, go_on]
class Rule(ctypes.Structure):
    _fields_ = [("code", ctypes.c_uint16), ("then", ctypes.c_uint8), ("other", ctypes.c_uint8),
                ("value", ctypes.c_uint32)]
class Filter(ctypes.Structure):
    _fields_ = [("length", ctypes.c_uint16), ("rules", ctypes.POINTER(Rule))]
filter = Filter(len(rules), (Rule * len(rules))(*(Rule(*rule) for rule in rules)))
prctl = ctypes.CDLL(None).prctl
if prctl(38, 1, 0, 0, 0) or prctl(22, 2, ctypes.byref(filter)):
    sys.exit(77)
os.execv(sys.executable, [sys.executable, *sys.argv[2:]])
"""
SOCKET = {"x86_64": 41, "aarch64": 198}.get(platform.machine())  # the system call's number


def without_sockets(*words) -> int:
    """Exit code of a Python that is ended, by SIGSYS, when it opens a socket to a network."""
    if not sys.platform.startswith("linux") or SOCKET is None:
        pytest.skip("needs Linux's seccomp")
    command = [sys.executable, "-c", NO_SOCKETS, str(SOCKET), *map(str, words)]
    code = subprocess.run(command, stdout=subprocess.DEVNULL).returncode
    if code == 77:
        pytest.skip("seccomp is not allowed here")
    return code


def test_training_evaluation_and_recordings_open_no_network_socket(tmp_path):
    assert without_sockets("-c", "import socket; socket.socket()") == -31  # SIGSYS
    run = tmp_path / "run"
    commands = (
        f"train ant {SMALL} --out {run}",
        f"evaluate {run} --episodes 2",
        f"record {run} -o {tmp_path}/a.mcap",
        f"record biped/seed0 --video {tmp_path}/a.gif",  # an ant's takes minutes
        f"export {run} -o {tmp_path}/a.csv",
        f"info {run}",
        f"replay {run} --save {tmp_path}/a.rrd",
    )
    every = f"""
import sys
from designrl.cli import main
for command in {commands}:
    print(command, file=sys.stderr)
    main(command.split())
"""
    assert without_sockets("-c", every) == 0
