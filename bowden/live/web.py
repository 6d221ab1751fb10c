"""Server of the live page: the page, a stream of its content (Server-Sent Events), and the stop button's request.

A client without access receives the reason and nothing else. The server listens at loopback by default. Host and
Origin are checked (a page of another site, or a name that points here, gets nothing); anywhere but loopback the
address carries a random token. A stop needs the token and the page's own origin, always.
"""

import contextlib
import hmac
import ipaddress
import json
import math
import secrets
import socket
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from bowden.live.state import LiveState
from parameters import InputError
from trial.playback import PlayerControl
from trial.report.page import asset

LOOPBACK: Final = "127.0.0.1"
TICK_S: Final = 0.1
"""Period of the messages of the event stream."""
PATIENCE_S: Final = 10.0
"""Time limit for a client to send its request, or to accept the answer."""
MOST_WATCHERS: Final = 8
MOST_PENDING: Final = 32
"""Connections without a complete request; one more closes the oldest of them."""
BACKLOG: Final = 128
"""Connections that the kernel holds until the server accepts them."""
TOKEN_HEADER: Final = "X-Bowden-Token"
Request = Callable[[PlayerControl, float | None, float | None], None]
"""Commands the player of a recorded trial: control, speed over real time, position in s; None leaves it unchanged."""


def address(text: str) -> tuple[str, int]:
    """Return host and port of `[HOST:]PORT`; raises `InputError`."""
    host, colon, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]") if colon else LOOPBACK
    if not port.isdecimal() or int(port) > 65535 or not host:
        raise InputError(f"--web {text}: expected [HOST:]PORT with a port of 0 … 65535; write for instance --web 8080.")
    return host, int(port)


class LivePage:
    """The server of one page, in separate threads, from construction until `close`.

    `stop` requests the safe stop from any thread; None if this process cannot stop the bench, and `no_stop` is then
    the reason and the remedy. `play` applies a request to the player of a recorded trial. Raises `InputError` if
    `where` (`[HOST:]PORT`) cannot be used.
    """

    def __init__(
        self, state: LiveState, where: str, stop: Callable[[], None] | None = None, no_stop: str = "",
        play: Request | None = None,
    ) -> None:
        host, port = address(where)
        self.state, self.stop, self.no_stop, self.play = state, stop, no_stop, play
        self.token, self.stop_asked, self.closing = secrets.token_urlsafe(24), False, False
        try:
            self._server = _Server(host, port, self)
        except (OSError, UnicodeError) as error:
            raise InputError(f"--web {where}: cannot listen there ({error}); give another address or port.") from None
        bound, self.port = self._server.bound
        self.loopback = ipaddress.ip_address(bound).is_loopback
        shown = f"[{host}]" if ":" in host else host
        if host in ("0.0.0.0", "::"):
            shown = socket.gethostname()
        self.url = f"http://{shown}:{self.port}/" + ("" if self.loopback else f"?token={self.token}")
        self._names = {host.lower(), socket.gethostname().lower(), *(["localhost"] if self.loopback else [])}
        self._threads = [threading.Thread(target=target, name="live page", daemon=True)
                         for target in (self._server.serve_forever, self._tick)]
        for thread in self._threads:
            thread.start()

    def _tick(self) -> None:
        pause = threading.Event()
        while not self.closing:
            self.state.digest()
            pause.wait(TICK_S)

    def close(self) -> None:
        """Send the last state and stop listening."""
        self.state.digest()
        self.closing = True
        with self.state.changed:
            self.state.changed.notify_all()
            self.state.changed.wait_for(lambda: self.state.watchers == 0, timeout=1.0)
        self._server.shutdown()
        self._server.server_close()

    def trusts_host(self, given: str | None) -> bool:
        """Whether a Host header names this server: its address, or any numeric one where it listens beyond loopback."""
        try:
            split = urlsplit(f"//{given or ''}")
            name, port = (split.hostname or "").lower(), split.port or 80
        except ValueError:
            return False
        if port != self.port or split.username is not None:
            return False
        try:
            return ipaddress.ip_address(name).is_loopback or not self.loopback
        except ValueError:
            return name in self._names

    def knows(self, token: str) -> bool:
        """Return whether a token is this page's, compared in constant time."""
        return hmac.compare_digest(token.encode(), self.token.encode())


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    allow_reuse_address = False
    request_queue_size = BACKLOG

    def __init__(self, host: str, port: int, page: LivePage) -> None:
        self.page = page
        self._pending: dict[Any, None] = {}
        self._lock = threading.Lock()
        self.address_family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        super().__init__((host, port), _Handler)

    def server_bind(self) -> None:
        """Bind without a name look-up of this computer, which `HTTPServer` would do."""
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.bound = str(self.server_address[0]), int(self.server_address[1])

    def process_request(self, request: Any, client_address: Any) -> None:
        """Accept a connection; if `MOST_PENDING` connections have sent no request yet, the oldest is closed."""
        with self._lock:
            self._pending[request] = None
            oldest = next(iter(self._pending)) if len(self._pending) > MOST_PENDING else None
            if oldest is not None:
                del self._pending[oldest]
                with contextlib.suppress(OSError):
                    oldest.shutdown(socket.SHUT_RDWR)
        super().process_request(request, client_address)

    def heard(self, request: Any) -> None:
        """Count a connection no longer as silent: its request is here, or it is over."""
        with self._lock:
            self._pending.pop(request, None)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        self.heard(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a client that closed its connection."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = PATIENCE_S
    server_version, sys_version = "bowden", ""

    def log_message(self, format: str, *args: Any) -> None:
        """Print no log lines."""

    def do_GET(self) -> None:
        self.server.heard(self.request)
        page, split = self.server.page, urlsplit(self.path)
        token = "".join(parse_qs(split.query).get("token", []))
        if not self._is_ours():
            return
        if not page.loopback and not page.knows(token):
            self._refuse(403, "This page needs the token that bowden printed with its address.")
        elif split.path == "/":
            nonce = secrets.token_urlsafe(16)
            self._answer(200, html(page.token, nonce), "text/html; charset=utf-8", nonce)
        elif split.path == "/stream":
            self._stream()
        else:
            self._refuse(404, "There is one page here: /.")

    def do_POST(self) -> None:
        self.server.heard(self.request)
        page, split = self.server.page, urlsplit(self.path)
        if not self._is_ours():
            return
        if split.path not in ("/stop", "/player"):
            self._refuse(404, "Only /stop and /player take a POST.")
        elif self.headers.get("Origin") is None or not page.knows(self.headers.get(TOKEN_HEADER, "")):
            self._refuse(403, "A stop needs the page's token and its origin.")
        elif split.path == "/player":
            self._play(page, parse_qs(split.query))
        elif page.stop is None:
            self._refuse(409, page.no_stop)
        else:
            page.stop()
            page.stop_asked = True
            self._answer(202, "The safe stop was requested.\n", "text/plain; charset=utf-8")

    def _play(self, page: LivePage, query: dict[str, list[str]]) -> None:
        try:
            control = PlayerControl(query["control"][-1])
            speed, at_s = (float(query[name][-1]) if name in query else None for name in ("speed", "at"))
            known = control in (PlayerControl.PLAY, PlayerControl.PAUSE, PlayerControl.SEEK)
            if page.play is None or not known or not math.isfinite((speed or 0.0) + (at_s or 0.0)):
                raise ValueError
        except (KeyError, ValueError):
            self._refuse(400, "A recorded trial takes control=play, pause or seek, with a speed and a position, s.")
            return
        page.play(control, speed, at_s)
        self._answer(202, "Done.\n", "text/plain; charset=utf-8")

    def _is_ours(self) -> bool:
        """Whether the request is addressed to this server and comes from no other site; refused if not."""
        if not self.server.page.trusts_host(self.headers.get("Host")):
            self._refuse(403, "The Host header does not name this server; use the address that bowden printed.")
            return False
        origin, site = self.headers.get("Origin"), self.headers.get("Sec-Fetch-Site", "none")
        if origin not in (None, f"http://{self.headers.get('Host')}") or (
                site not in ("same-origin", "none") and urlsplit(self.path).path != "/"):
            self._refuse(403, "Another site's page may not read this one.")
            return False
        return True

    def _refuse(self, status: int, sentence: str) -> None:
        self._answer(status, sentence + "\n", "text/plain; charset=utf-8")

    def _answer(self, status: int, text: str, kind: str, nonce: str = "") -> None:
        body = text.encode()
        self._head(status, kind, nonce)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _head(self, status: int, kind: str, nonce: str = "") -> None:
        script = (f"script-src 'nonce-{nonce}'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'; "
                  if nonce else "")
        self.send_response(status)
        for name, value in (
                ("Content-Type", kind), ("Cache-Control", "no-store"), ("Referrer-Policy", "no-referrer"),
                ("X-Content-Type-Options", "nosniff"), ("Cross-Origin-Resource-Policy", "same-origin"),
                ("Content-Security-Policy", f"default-src 'none'; {script}base-uri 'none'; form-action 'none'; "
                                            "frame-ancestors 'none'")):
            self.send_header(name, value)

    def _stream(self) -> None:
        page, state = self.server.page, self.server.page.state
        with state.changed:
            crowded = state.watchers >= MOST_WATCHERS
            state.watchers += not crowded
        if crowded:
            self._refuse(503, f"{MOST_WATCHERS} pages are open already; close one.")
            return
        try:
            self._head(200, "text/event-stream")
            self.end_headers()
            with contextlib.suppress(OSError):
                self._send_all(page, state)
        finally:
            with state.changed:
                state.watchers -= 1
                state.changed.notify_all()

    def _send_all(self, page: LivePage, state: LiveState) -> None:
        seen, last = (-1, 0, 0), False
        while not last:
            with state.changed:
                last = page.closing
                told, seen = state.message(seen)
            told["stop"] = {"can": page.stop is not None, "why": page.no_stop, "asked": page.stop_asked}
            self.wfile.write(f"data: {json.dumps(told, allow_nan=False)}\n\n".encode())
            self.wfile.flush()
            if not last:
                with state.changed:
                    state.changed.wait(5 * TICK_S)


def html(token: str, nonce: str) -> str:
    """Return the page: `token` goes with its requests, `nonce` marks the scripts that may run."""
    return (_own("live.html")
            .replace("/*STYLE*/", asset("uPlot.min.css") + asset("page.css") + _own("live.css"))
            .replace("<!--LICENSE-->", f"<!-- With uPlot:\n{asset('uPlot.LICENSE')}-->")
            .replace("NONCE", nonce).replace('"TOKEN"', json.dumps(token))
            .replace("/*UPLOT*/", asset("uPlot.iife.min.js"))
            .replace("/*SCRIPT*/", _own("live.js")))


def _own(name: str) -> str:
    return resources.files("bowden.live").joinpath("assets", name).read_text(encoding="utf-8")
