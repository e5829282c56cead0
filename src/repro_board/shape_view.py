"""A shape over time in 3-D, for pages.

A :class:`View` shows itself where it is the result of a notebook's cell. It brings its data and a picture;
``page/vendor/shape_viewer.js`` puts itself in the place of the picture, and asks no other file or host.
"""

from __future__ import annotations

import base64
import html
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from repro.chain import ConstantCurvature, Place, point_on
from repro.common import Array, numbers, require
from repro.robot import Robot

PAGE = Path(__file__).with_name("page")
VIEWER = PAGE / "vendor" / "shape_viewer.js"
MOST_FRAMES, POINTS = 3000, 9
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
    estimated: bool = False,
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
        Most frames that are shown, at most 3000.
    estimated
        Whether ``q`` is an estimate although no covariance is given.

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
    if estimate is None and (estimated or covariance is not None):
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


def cells(values: Array) -> list[float | None]:
    """Return numbers as JSON takes them, with five digits; None where there is none."""
    return [float(f"{x:.5g}") if np.isfinite(x) else None for x in values]
