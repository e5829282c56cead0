"""The server behind the page of a live session: its own files, the scene and the events, for this computer alone.

It binds the loopback address, answers only requests that name it, and bounds what a request may cost: how long it may
take to come, and how many are open at once.
"""

from __future__ import annotations

import io
import os
import queue
import socket
import threading
import time
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edition1_live.view.shape_view import VIEWER

if TYPE_CHECKING:
    from edition1_live.follow.browser import BrowserView

_PAGE = Path(__file__).with_name("page")
_SCRIPT = "text/javascript; charset=utf-8"
FILES = {
    "/": (_PAGE / "index.html", "text/html; charset=utf-8"),
    "/page.css": (_PAGE / "page.css", "text/css; charset=utf-8"),
    "/page.js": (_PAGE / "page.js", _SCRIPT),
    "/traces.js": (_PAGE / "traces.js", _SCRIPT),
    "/viewer.js": (VIEWER, _SCRIPT),
}
"""All files that are served."""
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
ALIVE_S = 1.0
"""Without an update for this long an empty one tells whether the page is still there [s]."""
_STALLED_S = 10.0
"""A browser that takes nothing for this long is given up [s]."""
ASK_S = 2.0
"""A request must be there as a whole within this time [s]."""
MOST_CONNECTIONS = 32
"""Requests that are open at the same time, besides pages: with one more the oldest is closed."""


class PageServer(ThreadingHTTPServer):
    """Threads that answer, not more than a few.

    Attributes
    ----------
    view
        Whose page it is.
    """

    daemon_threads = True
    allow_reuse_address = os.name == "posix"  # elsewhere this would let two listen to one port
    view: BrowserView

    def __init__(self, *options: Any) -> None:
        self._open: dict[socket.socket, None] = {}  # the oldest first
        self._lock = threading.Lock()
        super().__init__(*options)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread; close the oldest of too many."""
        with self._lock:
            if len(self._open) >= MOST_CONNECTIONS:
                with suppress(OSError):  # it has left
                    next(iter(self._open)).shutdown(socket.SHUT_RDWR)
                del self._open[next(iter(self._open))]
            self._open[request] = None
        super().process_request(request, client_address)

    def keep(self, request: Any) -> None:
        """Take one out of those that may be closed: it became a page, which are counted elsewhere."""
        with self._lock:
            self._open.pop(request, None)

    def shutdown_request(self, request: Any) -> None:
        """Close it."""
        self.keep(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: a browser that leaves is no error."""


class _Request(io.RawIOBase):
    """Bytes of a request until a time, however slowly they come."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._end = connection, time.monotonic() + ASK_S

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        left_s = self._end - time.monotonic()
        if left_s <= 0:
            raise TimeoutError("The request took too long.")
        self._connection.settimeout(left_s)
        try:
            return self._connection.recv_into(buffer)
        finally:
            self._connection.settimeout(_STALLED_S)


class PageHandler(BaseHTTPRequestHandler):
    """Answers one request."""

    server: PageServer  # pyright: ignore[reportIncompatibleVariableOverride]
    server_version = "repro"
    sys_version = ""
    timeout = _STALLED_S

    def setup(self) -> None:
        """Let the request come within :data:`ASK_S`."""
        super().setup()
        self.rfile.close()
        self.rfile = io.BufferedReader(_Request(self.connection))

    def do_GET(self) -> None:
        """Answer what is there."""
        view = self.server.view
        if not self._from_here(view):
            self._answer(HTTPStatus.FORBIDDEN, b"Only for pages of this address.\n")
        elif self.path in FILES:
            path, kind = FILES[self.path]
            self._answer(HTTPStatus.OK, path.read_bytes(), kind)
        elif self.path == "/scene.json":
            self._answer(HTTPStatus.OK, view.scene().encode(), "application/json")
        elif self.path == "/events":
            self._events(view)
        else:
            self._answer(HTTPStatus.NOT_FOUND, b"There is no such file.\n")

    def _from_here(self, view: BrowserView) -> bool:
        hosts, origins = self.headers.get_all("Host", []), self.headers.get_all("Origin", [])
        return len(hosts) == 1 and hosts[0].lower() in view.hosts and all(o in view.origins for o in origins)

    def _answer(self, status: HTTPStatus, content: bytes, kind: str = "text/plain; charset=utf-8") -> None:
        self._head(status, kind, {"Content-Length": str(len(content))})
        self.wfile.write(content)

    def _head(self, status: HTTPStatus, kind: str, more: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in ({"Content-Type": kind} | more | _HEADERS).items():
            self.send_header(name, value)
        self.end_headers()

    def _events(self, view: BrowserView) -> None:
        client = view.join()
        if client is None:
            self._answer(HTTPStatus.SERVICE_UNAVAILABLE, b"Too many pages are open.\n")
            return
        self.server.keep(self.connection)
        try:
            self._head(HTTPStatus.OK, "text/event-stream", {})
            while (text := _next(client)) is not None:
                self.wfile.write(f"data: {text}\n\n".encode() if text else b":\n\n")
                self.wfile.flush()
            self.wfile.write(b"event: end\ndata:\n\n")
        except OSError:  # the page was closed, or takes nothing
            pass
        finally:
            view.leave(client)

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: the terminal shows the session."""


def _next(client: queue.Queue[str | None]) -> str | None:
    """Next update, empty if there is none for a while; None at the end."""
    try:
        return client.get(timeout=ALIVE_S)
    except queue.Empty:
        return ""
