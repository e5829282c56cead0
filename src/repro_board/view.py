"""What is shown of a robot: its shape over time in 3-D, and of a live session words, numbers and a page.

A :class:`View` shows itself where it is the result of a notebook's cell. It brings its data and a picture;
``page/vendor/shape_viewer.js`` puts itself in the place of the picture, and asks no other file or host.

What a live session lets others see of it is a :class:`Moment`. The server of its page is for the browser of this
computer alone. It binds the loopback address. The address that it prints holds a secret, which becomes a cookie;
requests that name another host, come from another site or do not know the secret are refused. All files are in
memory. A request must come soon and be small. Every page takes updates at its own pace: a slow one delays no other.
"""

from __future__ import annotations

import asyncio
import base64
import hmac
import html
import io
import json
import queue
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable, MutableSequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from tornado import httpserver, iostream, web

from repro.chain import ConstantCurvature, Place, point_on
from repro.common import Array, bad_input, numbers, require
from repro.estimators.base import Estimate, evenly
from repro.robot import Robot

VIEWER = Path(__file__).with_name("page") / "vendor" / "shape_viewer.js"
MOST_FRAMES, POINTS = 300, 9
COLOURS = {"truth": "#1A1A1A", "estimate": "#D55E00", "magnets": "#009E73", "sensors": "#0072B2"}


Json = dict[str, Any]


@dataclass(frozen=True, repr=False)
class View:
    """What the viewer takes; lengths in mm. See ``page/viewer.js`` for its fields."""

    data: Json
    curves: dict[str, Array]
    """Backbones [mm] of the frame that is shown first, for the picture."""

    def to_html(self) -> str:
        """Return a picture with the data beside it."""
        # An end of a script in a name must not end the element.
        data = json.dumps(self.data, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")
        image = f'<img src="data:image/png;base64,{_encoded(self._png())}" alt="{html.escape(self.data["label"])}">'
        return f'<div class="shape-view">{image}<script type="application/json">{data}</script></div>'

    _repr_html_ = to_html

    def __repr__(self) -> str:
        """Say how many frames it has, and what there is to see."""
        return f"View of {len(self.data['time_s'])} frames: {self.data['label']}"

    def _png(self) -> bytes:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(5.6, 4.2))
        panel: Any = figure.add_subplot(projection="3d")
        for name, curve in self.curves.items():
            panel.plot(*curve.T, color=COLOURS[name], lw=2.5, label=name)
        low, high = self.data["box"]
        reach = max(map(abs, (*low[:2], *high[:2])))
        panel.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(low[2], high[2]))
        panel.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
        panel.legend()
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=80, facecolor="white")
        return stream.getvalue()


def view(
    robot: Robot,
    q: ArrayLike,
    times: ArrayLike,
    label: str,
    *,
    estimate: ArrayLike | None = None,
    covariance: ArrayLike | None = None,
    frames: int = 75,
) -> View:
    """Show a robot over time, beginning at the frame where the tip of the estimate is farthest off.

    Parameters
    ----------
    robot
        With its magnets and sensors, which are drawn at ``q``.
    q
        True configurations ``[t, n_q]``, or estimated ones if there is no truth.
    times
        Their times [s], increasing.
    label
        What there is to see, in words: for readers who do not see it.
    estimate
        Estimated configurations ``[t, n_q]``, drawn beside ``q``.
    covariance
        Covariance ``[t, n_q, n_q]`` of the estimate, or of ``q`` if there is none: two standard deviations are drawn
        as a tube.
    frames
        Most frames that are shown, at most 300.

    Raises
    ------
    InputError
        If there is nothing to show, something has another number of rows, or times do not increase.

    Examples
    --------
    >>> from repro import ConstantCurvature, Robot
    >>> robot = Robot([ConstantCurvature(0.11, 0.022)])
    >>> view(robot, [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]], times=[0.0, 1.0], label="A bend.")
    View of 2 frames: A bend.
    """
    owner = "view"
    t = numbers(times, "times", owner, (None,))
    require(
        len(t) and (np.diff(t) > 0).all(), "times", owner, "increasing [s], at least one", f"{len(t)} times"
    )
    require(1 <= frames <= MOST_FRAMES, "frames", owner, f"1 to {MOST_FRAMES}", frames)
    given = {"q": q, "estimate": estimate, "covariance": covariance}
    every = -(-len(t) // frames)
    kept = {name: _rows(x, name, len(t))[::every] for name, x in given.items() if x is not None}
    names = {"truth": "q", "estimate": "estimate"} if estimate is not None else {"truth": "q"}
    if covariance is not None and estimate is None:
        names = {"estimate": "q"}
    curves = {role: 1e3 * robot.poses(kept[key], _along(robot))[..., :3, 3] for role, key in names.items()}
    shapes: list[Json] = [
        {"name": role, "role": role, "points": _packed(curve, 0.1)} for role, curve in curves.items()
    ]
    if covariance is not None:
        shapes[-1]["deviation"] = _deviations(robot, kept[names["estimate"]], kept["covariance"])
    ends = [curve[:, -1] for curve in curves.values()]
    start = int(np.linalg.norm(ends[-1] - ends[0], axis=-1).argmax())
    parts = {"magnets": robot.magnets, "sensors": robot.sensors}
    poses = {name: robot.poses(kept["q"], [part.place for part in x]) for name, x in parts.items() if x}
    radius = 1e3 * max(
        [0.05 * robot.length, *(x.radius for x in robot.segments if isinstance(x, ConstantCurvature))]
    )
    data = {
        "label": label,
        "box": _box([*curves.values(), *(1e3 * T[..., :3, 3] for T in poses.values())], radius),
        "radius": round(radius, 2),
        "time_s": [float(f"{x:.6g}") for x in t[::every]],
        "start": start,
        "shapes": shapes,
        **{
            name: {"points": _packed(1e3 * T[..., :3, 3], 0.1), "directions": _packed(T[..., :3, 2], 1e-4)}
            for name, T in poses.items()
        },
    }
    return View(data, {role: curve[start] for role, curve in curves.items()})


def _rows(value: ArrayLike, name: str, n: int) -> Array:
    rows = numbers(value, name, "view")
    require(len(rows) == n, name, "view", f"one row for each of {n} times", f"{len(rows)} rows")
    return rows


def _box(places: list[Array], radius: float) -> list[list[float]]:
    """Return the corners of what is drawn, the base among it."""
    points = np.concatenate([np.zeros((1, 3)), *(x.reshape(-1, 3) for x in places)])
    around = radius * np.array([1.0, 1.0, 0.0])
    return [(points.min(0) - around).round(1).tolist(), (points.max(0) + around).round(1).tolist()]


def _along(robot: Robot) -> list[Place]:
    """Places along the backbone; where segments meet only one of the two."""
    return [
        point_on(k, share * segment.length)
        for k, segment in enumerate(robot.segments, 1)
        for share in np.linspace(0, 1, POINTS)[k > 1 :]
    ]


def _deviations(robot: Robot, q: Array, covariance: Array) -> str:
    """Largest standard deviation in any direction of the points along the backbone ``[t, k]``."""
    T, twists = robot.motion(q, _along(robot))
    slopes = twists[..., 3:] + np.cross(twists[..., :3], T[..., None, :3, 3])
    spread = np.einsum("tkci,tcd,tkdj->tkij", slopes, covariance, slopes)
    return _packed(1e3 * np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[..., -1], 0.0)), 0.01)


def _packed(values: Array, quantum: float) -> str:
    """Integers of 16 bits, low byte first, as base64; what is too large stays at the end of their range."""
    return _encoded(np.clip(np.rint(values / quantum), -32767, 32767).astype("<i2").tobytes())


def _encoded(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")


# ------------------------------------------------------------------------------------------------- a live session
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
_PAGE = Path(__file__).with_name("page")
_SCRIPT = "text/javascript; charset=utf-8"
FILES = {
    "/": ("live.html", "text/html; charset=utf-8"),
    "/live.css": ("live.css", "text/css; charset=utf-8"),
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
        self.contents = {path: ((_PAGE / name).read_bytes(), kind) for path, (name, kind) in FILES.items()}
        self.contents["/scene.json"] = json.dumps(scene(session.robot)).encode(), "application/json"
        self.session, self.pages, self.latest = session, set[_Events](), ""
        self._loop, self.over = asyncio.new_event_loop(), asyncio.Event()
        self._thread = threading.Thread(target=session.guarded, args=(self._run, "page"), daemon=True)

    def __enter__(self) -> PageServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self.over.set)
        self._thread.join()
        self._loop.close()

    def _run(self) -> None:
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
        await asyncio.sleep(0.2 * bool(self.pages))  # they are told that it is over
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
                self.write(f"data: {server.latest}\n\n" if server.latest else ":\n\n")
                if not await _within(self.flush(), STALLED_S):
                    self.detach().close()
                    return
                self.new.clear()
                await self.new.wait()
            self.finish("event: end\ndata:\n\n")
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
            "readings": _cells(u),
            "residuals": _cells(residuals),
            "shape": seen.shape,
        }
    return told


def _json(told: Json) -> str:
    return json.dumps(told, separators=(",", ":"), allow_nan=False)  # a browser reads no NaN


def _cells(values: Array) -> list[float | None]:
    return [float(f"{x:.5g}") if np.isfinite(x) else None for x in values]
