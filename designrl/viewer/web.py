"""Rerun's viewer in a browser, from its own server on two ports of this machine."""

import ipaddress
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path
from urllib.parse import quote

from designrl.errors import InputError
from designrl.viewer.picture import EXECUTABLE

ADDRESS, PORT = "127.0.0.1", 9090  # of the page; the data come from the next port
START_SECONDS = 30.0  # that the server may take to start


def serve(rrd: Path, address: str = ADDRESS, port: int = PORT) -> None:
    """Serve an .rrd file to browsers, say where, and go on until Ctrl-C.

    Args:
        address: to listen at; anyone who reaches it sees the recordings.
        port: of the page; the data come from the next one.

    Raises:
        InputError: not an address of this machine, or a port that is not free.
    """
    for each in (port, port + 1):
        _check_free(address, each)
    command = [EXECUTABLE, rrd, "--serve-web", "--bind", address, "--web-viewer-port", str(port)]
    command += ["--port", str(port + 1)]
    local = ipaddress.ip_address(address).is_loopback
    if not local:  # Rerun's server answers pages from elsewhere only if told to
        command += ["--cors-allow-origin", f"http://*:{port}"]
    for polite in (signal.SIGTERM, signal.SIGHUP):  # they end the server, too
        signal.signal(polite, signal.default_int_handler)
    with (
        tempfile.TemporaryFile() as log,
        subprocess.Popen(command, stdout=log, stderr=log) as process,
    ):
        try:
            if not _wait_for(address, port, process) or not _wait_for(address, port + 1, process):
                log.seek(0)
                said = log.read().decode(errors="replace").strip().rpartition("\n")[2]
                raise InputError(f"Rerun's server did not start ({said})")
            _say(page(address, port), port, local)
            process.wait()
        finally:
            process.terminate()


def page(address: str, port: int) -> str:
    """What to open in a browser."""
    ip = ipaddress.ip_address(address)
    host = socket.gethostname() if ip.is_unspecified else f"[{ip}]" if ip.version == 6 else address
    data = quote(f"rerun+http://{host}:{port + 1}/proxy", safe="")
    return f"http://{host}:{port}/?url={data}"


def _say(url: str, port: int, local: bool) -> None:
    print(f"open {url}\nin a browser; Ctrl-C ends the server", flush=True)
    if local:
        ports = " ".join(f"-L {each}:127.0.0.1:{each}" for each in (port, port + 1))
        print(f"from another machine, first: ssh {ports} {socket.gethostname()}", flush=True)


def _check_free(address: str, port: int) -> None:
    try:
        family = socket.AF_INET6 if ipaddress.ip_address(address).version == 6 else socket.AF_INET
        with socket.socket(family) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((address, port))
    except (OSError, OverflowError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"{address}:{port} cannot be listened at ({reason}); choose others with --bind "
            "ADDRESS and --port N"
        ) from None


def is_listening(address: str, port: int) -> bool:
    """Something takes connections there."""
    try:
        socket.create_connection((address, port), 1).close()
    except OSError:
        return False
    return True


def _wait_for(address: str, port: int, process: subprocess.Popen) -> bool:
    """Whether the process listens there, within START_SECONDS."""
    deadline = time.monotonic() + START_SECONDS
    while process.poll() is None and time.monotonic() < deadline:
        if is_listening(address, port):
            return True
        time.sleep(0.1)
    return False
