"""Rerun's viewer in a browser: its page and the recordings, from one port of this machine.

Rerun's own server answers whatever Host it is asked as, and any page of this machine; the page
that it serves may report its use. Ours answers to this machine's names alone, and lets the page
speak with nobody else.
"""

import http.server
import ipaddress
import socket
import socketserver
import urllib.request
from urllib.parse import quote, urlsplit

from designrl.errors import InputError
from designrl.terminal import heed_signals
from designrl.viewer.executable import Rerun

ADDRESS, PORT = "127.0.0.1", 9090
RECORDING = "replay.rrd"
PAGE = {
    "": "text/html",
    "favicon.ico": "image/x-icon",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
}
ONLY_US = "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'"


def serve(rrd: bytes, address: str = ADDRESS, port: int = PORT) -> None:
    """Serve an .rrd file's bytes to browsers, say where, and go on until Ctrl-C.

    Args:
        address: to listen at; anyone who reaches it sees the recordings.
        port: to listen at; 0 for a free one.

    Raises:
        InputError: not an address of this machine, or a port that is not free.
    """
    heed_signals()  # they end the server
    try:
        ip = ipaddress.ip_address(address)
        server = _Server(ip, port)
    except (OSError, OverflowError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"{address}:{port} cannot be listened at ({reason}); choose others with --bind "
            "ADDRESS and --port N"
        ) from None
    with server:
        server.files = {**_rerun_page(), RECORDING: ("application/octet-stream", rrd)}
        port = server.server_address[1]
        name = f"[{ip}]" if ip.version == 6 else address
        where = socket.gethostname() if ip.is_unspecified else name
        print(f"open http://{where}:{port}/\nin a browser; Ctrl-C ends the server", flush=True)
        if ip.is_loopback:
            tunnel = f"ssh -L {port}:{name}:{port} {socket.gethostname()}"
            print(f"from another machine, first: {tunnel}", flush=True)
        server.serve_forever()


def _rerun_page() -> dict[str, tuple[str, bytes]]:
    """Path -> type and content of the files that are the viewer, from Rerun's own server."""
    with Rerun("--serve-web", "--web-viewer-port", "0") as rerun:
        try:
            url = rerun.wait_for(lambda: rerun.says(r"Hosting a web-viewer at (http://[\d.:]+)"))
            open_url = urllib.request.build_opener(urllib.request.ProxyHandler({})).open
            return {path: (kind, open_url(f"{url}/{path}").read()) for path, kind in PAGE.items()}
        except (RuntimeError, OSError) as error:
            raise InputError(f"Rerun's page cannot be read: {error}") from None


def is_ours(host: str) -> bool:
    """Whether a Host header means this machine: by address, or by a name that nobody else gives.

    A page of another name, which its owner lets mean this machine, could read the recordings.
    """
    try:
        name = urlsplit(f"//{host}").hostname or ""
        if name in ("localhost", socket.gethostname().lower()):
            return True
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = daemon_threads = True
    files: dict[str, tuple[str, bytes]]

    def __init__(self, ip: ipaddress.IPv4Address | ipaddress.IPv6Address, port: int):
        self.address_family = socket.AF_INET6 if ip.version == 6 else socket.AF_INET
        super().__init__((str(ip), port), _Handler)

    def handle_error(self, *_) -> None:
        """A browser that leaves early is nothing to speak of."""


class _Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        host = self.headers.get("Host", "")
        path = self.path.removeprefix("/").partition("?")[0]
        if not is_ours(host):
            self.send_error(403, f"open it by its address, or as {socket.gethostname()}")
        elif self.path == "/":
            self.send_response(302)
            url = quote(f"http://{host}/{RECORDING}", safe="")
            self._finish(b"", Location=f"/?url={url}")
        elif path in self.server.files:
            kind, content = self.server.files[path]
            self.send_response(200)
            self._finish(content, **{"Content-Type": kind, "Content-Security-Policy": ONLY_US})
        else:
            self.send_error(404)

    def _finish(self, content: bytes, **headers: str) -> None:
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_) -> None:
        """The terminal is for what the command says."""
