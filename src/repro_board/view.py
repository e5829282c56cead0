"""What is shown of a live session: its shape, words, numbers and a page.

What a live session lets others see of it is a :class:`Moment`. The server of its page is for the browser of this
computer alone. It binds the loopback address. The address that it prints holds a secret, which becomes a cookie;
requests that name another host, come from another site or do not know the secret are refused. All files are in
memory. A request must come soon and be small. Every page takes updates at its own pace: a slow one delays no other.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import queue
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable, MutableSequence
from typing import Any, NamedTuple

import numpy as np
from tornado import httpserver, iostream, web

from repro.common import Array, bad_input, require
from repro.estimators.base import Estimate, evenly
from repro.robot import Robot
from repro_board.shape_view import PAGE, Json, cells, view

SILENT_S = 1.0
"""After this time nothing comes, or what is shown is old [s]."""
Row = tuple[float, Array, Estimate]
"""Time [s], readings and estimate of a time step."""


class Moment(NamedTuple):
    """What is shown of a session."""

    made_s: float
    """When, by the clock of the session [s]."""
    numbers: tuple[str, ...]
    summary: tuple[tuple[str, str], ...]
    alarms: tuple[str, ...]
    notes: tuple[str, ...]
    trusted: bool
    doubt: str
    """Why the shape is not to be trusted; empty if it is."""
    suspects: tuple[int, ...]
    """Readings of the parts that the monitor names."""
    age_s: float
    last: tuple[float, Array, Array] | None
    """Time [s], readings, and these less what the estimate predicts, in units of the noise."""
    shape: Json | None
    """What the viewer of the page draws; None where there is no page."""
    raw: str = ""
    """The last bytes as text and in hex, where they are no readings."""


UNKNOWN = Moment(0.0, ("not known",), (), (), (), False, "old", (), 0.0, None, None)
"""What is shown where that cannot be made."""


class Shared:
    """All that the threads of a session share: what they tell it, what they may show of it, and when it shall end."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.stop = robot, threading.Event()
        self.inbox = queue.SimpleQueue[tuple[float, object]]()
        """When and what: bytes, a state of the port, which view has failed, or an error that ends the session."""
        self.moment = UNKNOWN
        self.rows: MutableSequence[Row] = deque(maxlen=0)
        """Estimates, for who writes them."""

    def guarded(self, work: Callable[[], Any], view: str = "") -> Any:
        """Work in another thread. What fails there ends the session, and ``run`` raises it.

        If a view fails the session goes on, because it may be recording.
        """
        try:
            return work()
        except BaseException as error:
            if view:
                return self.blinded(view, error)
            self.inbox.put((time.monotonic(), error))
            self.stop.set()
            return None

    def blinded(self, view: str, error: BaseException) -> str:
        """Say that a view has failed and why, in another thread; it is among the notes from then on."""
        why = f"{type(error).__name__}: {error}"
        text = f"The {view} has failed, and the session goes on without it ({why})."
        self.inbox.put((time.monotonic(), text))
        return text


# ------------------------------------------------------------------------------------------------------- its page
_SCRIPT = "text/javascript; charset=utf-8"
FILES = {
    "/": ("live.html", "text/html; charset=utf-8"),
    "/live.css": ("live.css", "text/css; charset=utf-8"),
    "/traces.js": ("traces.js", _SCRIPT),
    "/live.js": ("live.js", _SCRIPT),
    "/viewer.js": ("vendor/shape_viewer.js", _SCRIPT),
}
"""All files that are served."""
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Server": "repro",
}
UPDATE_S, STALLED_S, ASK_S = 0.05, 10.0, 2.0
"""Time between two updates; that a page may take nothing; within which a request must be there [s]."""
RETRY_S = 1.0
"""After this time a page that has lost its connection asks again [s]."""
LEFT_S = 5.0
"""After this time a server that does not end is left alone: no recording waits for a page [s]."""
MOST_PAGES = 5
"""A browser has six connections to an address; by the sixth it hears that there is no room."""


class PageServer:
    """A server for the pages of one session; use it in a ``with`` statement. ``address`` is what to open."""

    def __init__(self, session: Shared, port: int = 0) -> None:
        require(0 <= port <= 65535, "browser_socket", "live", "0 to 65535", port)
        try:
            self._socket = socket.create_server(("127.0.0.1", port), backlog=128)
        except OSError as error:
            raise bad_input(
                "browser_socket", "live", "a free port, or 0", f"{port}: {error.strerror}"
            ) from error
        self.port: int = self._socket.getsockname()[1]
        self.token = secrets.token_urlsafe(24)
        self.address = f"http://127.0.0.1:{self.port}/?token={self.token}"
        at = "" if self.port == 80 else f":{self.port}"  # browsers leave out what is usual
        self.hosts = (f"127.0.0.1{at}", f"localhost{at}")
        self.contents = {path: ((PAGE / name).read_bytes(), kind) for path, (name, kind) in FILES.items()}
        self.contents["/scene.json"] = json.dumps(scene(session.robot)).encode(), "application/json"
        self.session, self.pages, self.latest = session, set[_Events](), ""
        self._loop, self.over = asyncio.new_event_loop(), asyncio.Event()
        self._thread = threading.Thread(target=session.guarded, args=(self._run, "page"), daemon=True)

    def __enter__(self) -> PageServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(RuntimeError):  # it has failed before, and its loop is closed
            self._loop.call_soon_threadsafe(self.over.set)
        self._thread.join(LEFT_S)

    def _run(self) -> None:
        with contextlib.closing(self._loop):
            self._loop.run_until_complete(self._serve())

    async def _serve(self) -> None:
        routes = [("/events", _Events, {"server": self}), ("/.*", _File, {"server": self})]
        application = web.Application(routes, log_function=lambda _: None)
        limits: Json = {"max_header_size": 8192, "max_body_size": 1024}
        server = httpserver.HTTPServer(
            application, idle_connection_timeout=ASK_S, body_timeout=ASK_S, **limits
        )
        self._socket.setblocking(False)
        server.add_socket(self._socket)
        while not self.over.is_set():
            if self.pages:
                self.latest = self._told()
            self._wake()
            await _within(self.over.wait(), UPDATE_S)
        server.stop()
        self._wake()
        for _ in range(20):  # they are told that it is over; a computer that stops meanwhile costs no turn
            await asyncio.sleep(0.01 * bool(self.pages))
        await server.close_all_connections()

    def _told(self) -> str:
        try:
            return _json(message(self.session.moment))
        except Exception as error:
            unknown = UNKNOWN._replace(alarms=(self.session.blinded("page", error),))
            return _json(_fields(unknown))

    def _wake(self) -> None:
        for page in self.pages:
            page.new.set()


async def _within(work: Awaitable[object], seconds: float) -> bool:
    """Return whether something was done in time."""
    try:
        await asyncio.wait_for(work, seconds)
    except TimeoutError:
        return False
    return True


class _File(web.RequestHandler):
    """Answers with a file, if the request comes from a page of this address that knows the secret."""

    def initialize(self, server: PageServer) -> None:
        self.server = server

    def set_default_headers(self) -> None:
        for name, value in _HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        server, headers = self.server, self.request.headers
        origins = [f"http://{host}" for host in server.hosts]
        here = headers.get("Host", "").lower() in server.hosts  # two of them arrive as one text with a comma
        here = here and headers.get("Origin", origins[0]) in origins
        if not here or headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            raise web.HTTPError(403)
        cookie = f"repro_{server.port}"  # all ports of a host share their cookies
        if self.request.path == "/" and self._is_token(self.get_query_argument("token", "")):
            self.set_cookie(cookie, server.token, httponly=True, samesite="Strict")
            self.redirect("/")
        elif not self._is_token(self.get_cookie(cookie, "") or ""):
            raise web.HTTPError(403)

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self.server.token.encode())

    def get(self) -> Awaitable[None] | None:
        """Answer."""
        content, kind = self.server.contents.get(self.request.uri or "", (None, ""))
        if content is None:
            raise web.HTTPError(404)
        self.set_header("Content-Type", kind)
        self.finish(content)


class _Events(_File):
    """Sends the newest state whenever there is one and the page has taken the one before."""

    async def get(self) -> None:
        """Answer until the page leaves, or the session is over."""
        server, self.new = self.server, asyncio.Event()
        if len(server.pages) >= MOST_PAGES:
            raise web.HTTPError(503)
        self.set_header("Content-Type", "text/event-stream")
        server.pages.add(self)
        self.write(f"retry: {round(1e3 * RETRY_S)}\n")
        try:
            while not server.over.is_set():
                self.new.clear()  # what comes while this one is sent is not missed
                self.write(f"data: {server.latest}\n\n" if server.latest else ":\n\n")
                if not await _within(self.flush(), STALLED_S):
                    self.detach().close()
                    return
                await self.new.wait()
            await self.finish("event: end\ndata:\n\n")
        except iostream.StreamClosedError:  # the page has left
            pass
        finally:
            server.pages.discard(self)


def scene(robot: Robot) -> Json:
    """Return what the page needs once: names of the readings, and what the viewer draws in."""
    name, q = robot.source.name if robot.source else "robot", np.zeros((1, robot.n_q))
    if robot.lower is not None and robot.upper is not None:
        middle = (robot.lower + robot.upper) / 2
        q = middle + 0.6 * (evenly(robot.lower, robot.upper, 200) - middle)  # nearly all that it does
    C = np.zeros((len(q), robot.n_q, robot.n_q))
    label = f"The estimated shape of {name} at the moment."
    shape = view(robot, q, np.arange(len(q)), label, covariance=C, frames=200).data
    more = {
        "time_s": [],
        "tallest": 640,
        "zoom": 1.25,
        "suspects": {"name": "suspected"},
        "widest": 2 * shape["radius"],
    }
    unit = "mT, rad" if robot.imus else "mT"
    return {"robot": name, "readings": robot.names, "unit": unit, "shape": shape | more}


def message(seen: Moment) -> Json:
    """Return what a page is told of a moment. One that nothing takes the place of is old."""
    old = time.monotonic() - seen.made_s > SILENT_S
    return _fields(seen._replace(doubt="old" if old else seen.doubt))


def _fields(seen: Moment) -> Json:
    told: Json = {
        "doubt": seen.doubt,
        "numbers": seen.numbers,
        "summary": dict(seen.summary),
        "alarms": seen.alarms,
        "raw": seen.raw,
        "notes": seen.notes,
        "suspects": seen.suspects,
    }
    if seen.last is not None:
        t, u, residuals = seen.last
        told |= {
            "time_s": t,
            "age_s": seen.age_s,
            "readings": cells(u),
            "residuals": cells(residuals),
            "shape": seen.shape,
        }
    return told


def _json(told: Json) -> str:
    return json.dumps(told, separators=(",", ":"), allow_nan=False)  # a browser reads no NaN
