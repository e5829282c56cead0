"""A live session in the browser: shape, readings and numbers, on a page that only this computer can see.

The server binds the loopback address on a free port, answers only requests that name it (a page elsewhere cannot
reach it by a name of its own, nor read it from another origin), and serves only the files of this package. Updates
are server-sent events. Every browser has a short queue of its own: a slow one misses updates, and nobody waits.
"""

from __future__ import annotations

import json
import math
import queue
import threading
import time
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import torch

from repro.live.follow import live_text
from repro.live.follow.robot_estimator import RobotEstimator
from repro.live.follow.session import LiveState
from repro.live.robot.robot_file import RobotFile
from repro.report.robot_view import backbone_points, live_frame, live_scene
from repro.report.shape_view import VIEWER

PAGE = Path(__file__).with_name("page")
FILES = {
    "/": (PAGE / "index.html", "text/html; charset=utf-8"),
    "/page.css": (PAGE / "page.css", "text/css; charset=utf-8"),
    "/page.js": (PAGE / "page.js", "text/javascript; charset=utf-8"),
    "/viewer.js": (VIEWER, "text/javascript; charset=utf-8"),
}
"""All files that are served."""
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
WAITING = 4
"""Updates that wait for one browser; one more is left out."""
MOST_CLIENTS = 8
"""Pages that are open at the same time."""
ALIVE_S = 1.0
"""Without an update for this long an empty one tells whether the page is still there [s]."""
DIFFERENCE = 1e-5
"""Step of a derivative, in widths of the bounds."""
STALLED_S = 10.0
"""A browser that takes nothing for this long is given up [s]."""


class BrowserView:
    """A server for the pages of one session; use it in a ``with`` statement.

    Parameters
    ----------
    estimator
        Whose estimates are shown.
    """

    def __init__(self, estimator: RobotEstimator) -> None:
        self._estimator = estimator
        self._clients: list[queue.Queue[str | None]] = []
        self._lock = threading.Lock()
        self._latest: LiveState | None = None
        self._new, self._closing = threading.Event(), threading.Event()
        self._server = _Server(("127.0.0.1", 0), _Handler)
        self._server.view = self
        self.port: int = self._server.server_address[1]
        names = (f"127.0.0.1:{self.port}", f"localhost:{self.port}")
        self.hosts = frozenset(names)
        self.origins = frozenset(f"http://{name}" for name in names)
        self._threads = [
            threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True),
            threading.Thread(target=self._send, daemon=True),
        ]

    @property
    def address(self) -> str:
        """What to open in a browser."""
        return f"http://127.0.0.1:{self.port}/"

    def publish(self, state: LiveState) -> None:
        """Show a state as soon as there is time for it; returns at once."""
        self._latest = state
        self._new.set()

    def __enter__(self) -> BrowserView:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._new.set()
        self._threads[1].join()
        with self._lock:
            for client in self._clients:
                _put(client, None)
        deadline = time.monotonic() + ALIVE_S
        while self._clients and time.monotonic() < deadline:  # they are told that it is over
            time.sleep(0.01)
        self._server.shutdown()
        self._server.server_close()

    def scene(self) -> str:
        """What the page needs once, as JSON."""
        robot = self._estimator.robot
        known = self._estimator.name not in ("gradient_descent",)
        label = f"The shape of {robot.name} as estimated at the moment."
        shape = live_scene(robot.robot, label=label, covariance=known)
        unit = "deg from upright" if self._estimator.positions else robot.unit
        about = {"robot": robot.name, "unit": unit, "traces": self._estimator.sensors}
        return json.dumps({"shape": shape} | about)

    def join(self) -> queue.Queue[str | None] | None:
        """Return the queue of a new page, or None if there are too many."""
        with self._lock:
            if len(self._clients) >= MOST_CLIENTS or self._closing.is_set():
                return None
            client: queue.Queue[str | None] = queue.Queue(WAITING)
            self._clients.append(client)
        self._new.set()
        return client

    def leave(self, client: queue.Queue[str | None]) -> None:
        """Forget a page."""
        with self._lock:
            self._clients.remove(client)

    def _send(self) -> None:
        while not self._closing.is_set():
            self._new.wait()
            self._new.clear()
            if self._latest is None or not self._clients:
                continue
            text = json.dumps(message(self._estimator, self._latest), separators=(",", ":"))
            with self._lock:
                for client in self._clients:
                    if not client.full():
                        client.put_nowait(text)


def message(estimator: RobotEstimator, state: LiveState) -> dict[str, Any]:
    """What a page is told of a state."""
    shown = None if state.readings is None else _traces(estimator, state.readings)
    return {
        "time_s": state.time_s if math.isfinite(state.time_s) else None,
        "shape": None if state.estimate is None else _shape(estimator, state),
        "readings": shown,
        "quantities": [str(quantity) for quantity in live_text.quantities(estimator, state)],
        "head": f"{state.rate_hz:.1f} estimates/s by {estimator.name}; {live_text.latency(state)}",
        "counters": live_text.counters(state),
        "troubles": live_text.troubles(estimator, state),
        "alerts": live_text.alerts(estimator, state),
    }


def _shape(estimator: RobotEstimator, state: LiveState) -> dict[str, Any]:
    assert state.estimate is not None
    q, covariance, robot = state.estimate.q, state.estimate.covariance, estimator.robot
    if not estimator.positions:
        frame = live_frame(robot.robot, q)
        if covariance is not None:
            frame["shapes"][0]["deviation"] = _deviation_mm(robot, q, covariance)
        return frame
    points = torch.cat([torch.zeros(3), q])  # the base first
    shape: dict[str, Any] = {"points": np.round(1e3 * points.numpy(), 2).tolist()}
    if covariance is not None:
        blocks = torch.stack([covariance[k : k + 3, k : k + 3] for k in range(0, len(q), 3)])
        shape["deviation"] = [0.0, *_largest_mm(blocks, robot)]
    return {"shapes": [shape]}


def _deviation_mm(robot: RobotFile, q: torch.Tensor, covariance: torch.Tensor) -> list[float]:
    """Largest deviation of each point of the backbone [mm].

    By differences: torch's forward derivatives are of the whole process, and the estimator's thread may take some.
    """
    steps = torch.diag(DIFFERENCE * (robot.upper - robot.lower))
    points = torch.from_numpy(backbone_points(robot.robot, q + torch.cat([steps, -steps])))
    up, down = points.unflatten(0, (2, -1))
    J = ((up - down) / (2 * steps.diagonal())[:, None, None]).permute(1, 2, 0)
    return _largest_mm(J @ covariance @ J.mT, robot)


def _largest_mm(blocks: torch.Tensor, robot: RobotFile) -> list[float]:
    """Roots of the largest eigenvalues [mm]; wide where nothing is determined, but on the screen."""
    deviation = torch.linalg.eigvalsh(blocks)[:, -1].clamp_min(0).sqrt().clamp_max(robot.robot.length)
    return np.round(1e3 * deviation.numpy(), 3).tolist()


def _traces(estimator: RobotEstimator, u: torch.Tensor) -> list[float | None]:
    """Readings, or of IMUs how far the arm leans there [deg]."""
    return [float(f"{x:.6g}") if math.isfinite(x) else None for x in estimator.shown(u).tolist()]


def _put(client: queue.Queue[str | None], text: str | None) -> None:
    """Put it in, in place of the oldest if there is no room."""
    while True:
        try:
            return client.put_nowait(text)
        except queue.Full:
            try:
                client.get_nowait()
            except queue.Empty:
                continue


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    view: BrowserView

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: a browser that leaves is no error."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server  # pyright: ignore[reportIncompatibleVariableOverride]
    server_version = "repro"
    sys_version = ""
    timeout = STALLED_S

    def do_GET(self) -> None:
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
        for name, value in ({"Content-Type": kind} | more | HEADERS).items():
            self.send_header(name, value)
        self.end_headers()

    def _events(self, view: BrowserView) -> None:
        client = view.join()
        if client is None:
            self._answer(HTTPStatus.SERVICE_UNAVAILABLE, b"Too many pages are open.\n")
            return
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
