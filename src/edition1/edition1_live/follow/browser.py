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
from contextlib import suppress
from typing import Any

import numpy as np
import torch

from edition1.errors import bad_input, require
from edition1.robot_file.robot_file import RobotFile
from edition1_live.follow import live_text
from edition1_live.follow.live_state import LiveState
from edition1_live.follow.page_server import ALIVE_S, PageHandler, PageServer
from edition1_live.follow.robot_estimator import RobotEstimator
from edition1_live.view.robot_view import backbone_points, live_frame, live_scene

WAITING = 4
"""Updates that wait for one browser; one more is left out."""
MOST_CLIENTS = 8
"""Pages that are open at the same time."""
_DIFFERENCE = 1e-5
"""Step of a derivative, in widths of the bounds."""


class BrowserView:
    """A server for the pages of one session; use it in a ``with`` statement.

    Parameters
    ----------
    estimator
        Whose estimates are shown.
    port
        Number of a TCP port of this computer; 0 takes a free one.

    Raises
    ------
    InputError
        If it is no number of a port, or in use.
    """

    def __init__(self, estimator: RobotEstimator, port: int = 0) -> None:
        require(0 <= port <= 65535, "browser_socket", "repro live", "0 to 65535", port)
        self._estimator = estimator
        self._clients: list[queue.Queue[str | None]] = []
        self._lock = threading.Lock()
        self._latest: LiveState | None = None
        self._new, self._closing = threading.Event(), threading.Event()
        try:
            self._server = PageServer(("127.0.0.1", port), PageHandler)
        except OSError as error:
            received = f"{port}: {error.strerror}"
            raise bad_input("browser_socket", "repro live", "a free port", received) from error
        self._server.view = self
        self.port: int = self._server.server_address[1]
        at = "" if self.port == 80 else f":{self.port}"  # browsers leave out what is usual
        names = (f"127.0.0.1{at}", f"localhost{at}")
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
                if client.full():  # in the place of the oldest
                    with suppress(queue.Empty):
                        client.get_nowait()
                client.put_nowait(None)
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
        "since_s": state.since_s if math.isfinite(state.since_s) else None,
        "age_s": state.age_s,
        "mark": live_text.mark(state),
        "shape": None if state.estimate is None else _shape(estimator, state),
        "readings": shown,
        "quantities": [str(quantity) for quantity in live_text.quantities(estimator, state)],
        "head": f"{live_text.pace(estimator, state)}; {live_text.latency(state)}",
        "counters": live_text.counters(state),
        "troubles": live_text.troubles(estimator, state) + live_text.limits(estimator),
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
    steps = torch.diag(_DIFFERENCE * (robot.upper - robot.lower))
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
