"""Shapes in 3-D with a slider for time: what the viewer of the book and of the live view is given.

A :class:`ShapeView` displays itself where it is the result of a notebook's cell: as HTML with its data inline, which
``shape_viewer.js`` of the board brings to life on the book's pages, with a picture for readers without that script or
without WebGL.
"""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from edition1.errors import bad_input, require
from edition1_live.view.symbols import plain_symbol

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROLES = {"truth": "#000000", "estimate": "#D55E00"}
"""What a shape may be, and its colour on white."""


@dataclass(frozen=True)
class Shape:
    """A backbone over time.

    Parameters
    ----------
    name
        As it stands in the legend.
    points_m
        Points from base to tip [m], evenly spaced along the backbone; nine per segment look smooth.
    deviation_m
        Standard deviation of each point [m]; two of them are drawn as a tube.
    role
        ``truth`` or ``estimate``.
    """

    name: str
    points_m: Float[np.ndarray, "t k 3"]
    deviation_m: Float[np.ndarray, "t k"] | None = None
    role: str = "truth"


@dataclass(frozen=True)
class Markers:
    """Magnets or sensors over time: positions [m], and unit vectors along their axes.

    Parameters
    ----------
    points_m, directions
        As said.
    name
        As it stands in the legend; "magnets" or "sensors" when empty.
    """

    points_m: Float[np.ndarray, "t n 3"]
    directions: Float[np.ndarray, "t n 3"]
    name: str = ""


@dataclass(frozen=True)
class Traces:
    """One panel of lines over time below the picture.

    Parameters
    ----------
    title, unit
        What is drawn.
    values
        One line per name; a value that is not a number leaves a gap.
    estimates
        Dashed lines in the colours of the lines of the same names.
    """

    title: str
    unit: str
    values: Mapping[str, Float[np.ndarray, " t"]]
    estimates: Mapping[str, Float[np.ndarray, " t"]] = field(default_factory=dict)


VIEWER = Path(str(resources.files("repro_board"))) / "page" / "vendor" / "shape_viewer.js"
"""The script of the viewer, for any page that shows shapes; it asks no other file."""
_MOST_FRAMES = 300
_LENGTH_QUANTUM_M = 1e-4
_DEVIATION_QUANTUM_M = 1e-5
_DIRECTION_QUANTUM = 1e-4
_DIGITS_OF_A_TRACE = 4


@dataclass(frozen=True, repr=False)
class ShapeView:
    """Shapes, magnets, sensors and traces over time; displays itself in a notebook and in the book.

    Parameters
    ----------
    label
        What there is to see, in words and numbers: for readers who do not see it.
    time_s
        Time of every frame [s]; at most 300 of them.
    shapes
        Drawn from the first, which has the body around it, to the last.
    radius_m
        Radius of the body [m]; sizes of magnets and sensors follow from it, not to scale.
    magnets, sensors
        Where they are, and how they point.
    traces
        Panels below the picture.

    Raises
    ------
    InputError
        If there is no shape, a role is unknown, times do not increase, something has another number of frames, a
        position is not finite or 3.2 m or more from the base, a deviation is negative or 0.32 m or more, or a dashed
        line has no other.

    Examples
    --------
    >>> straight = Shape("arm", np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]]))
    >>> ShapeView("A straight arm.", np.array([0.0]), (straight,), radius_m=0.01)
    ShapeView of 1 frame, 0 to 0 s: A straight arm.
    """

    label: str
    time_s: Float[np.ndarray, " t"]
    shapes: tuple[Shape, ...]
    radius_m: float
    magnets: Markers | None = None
    sensors: Markers | None = None
    traces: tuple[Traces, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.time_s)
        require(self.shapes, "shapes", "ShapeView", "at least one", "none")
        for shape in self.shapes:
            require(
                shape.role in ROLES, "role", f"shape {shape.name}", f"one of {', '.join(ROLES)}", shape.role
            )
        if not 1 <= n <= _MOST_FRAMES or not bool(np.isfinite(self.time_s).all()):
            raise bad_input("time_s", "ShapeView", f"1 to {_MOST_FRAMES} finite times", f"{n} times")
        late = "a time that is not later than the one before"
        require((np.diff(self.time_s) > 0).all(), "time_s", "ShapeView", "increasing", late)
        for name, values, limit in self._numbers():
            require(len(values) == n, name, "ShapeView", f"given for each of {n} frames", f"{len(values)}")
            if limit is not None and not bool((np.abs(values) < limit).all()):
                raise bad_input(name, "ShapeView", f"finite and below {limit}", np.abs(values).max())
        for shape in self.shapes:
            name = f"deviation_m of {shape.name}"
            if shape.deviation_m is not None and bool((shape.deviation_m < 0).any()):
                raise bad_input(name, "ShapeView", "not negative", shape.deviation_m.min())
        for panel in self.traces:
            if unknown := [name for name in panel.estimates if name not in panel.values]:
                raise bad_input("estimates", f"traces {panel.title}", "named like values", ", ".join(unknown))

    def _numbers(self) -> Iterator[tuple[str, np.ndarray, float | None]]:
        """All that has one entry per frame, with the largest amount that can be packed."""
        for shape in self.shapes:
            yield f"points_m of {shape.name}", shape.points_m, 3.2
            if shape.deviation_m is not None:
                yield f"deviation_m of {shape.name}", shape.deviation_m, 0.32
        for name, markers in (("magnets", self.magnets), ("sensors", self.sensors)):
            if markers is not None:
                yield f"points_m of {name}", markers.points_m, 3.2
                yield f"directions of {name}", markers.directions, 1.001
        for panel in self.traces:
            for name, values in (*panel.values.items(), *panel.estimates.items()):
                yield f"{name} of {panel.title}", values, None

    def data(self) -> dict[str, Any]:
        """What the viewer takes: positions to 0.1 mm, deviations to 0.01 mm, directions to 1e-4, packed."""
        shapes = []
        for shape in self.shapes:
            points = _packed(shape.points_m, _LENGTH_QUANTUM_M)
            shapes.append({"name": shape.name, "role": shape.role, "points": points})
            if shape.deviation_m is not None:
                shapes[-1]["deviation"] = _packed(shape.deviation_m, _DEVIATION_QUANTUM_M)
        markers = {
            name: {
                "points": _packed(given.points_m, _LENGTH_QUANTUM_M),
                "directions": _packed(given.directions, _DIRECTION_QUANTUM),
                **({"name": given.name} if given.name else {}),
            }
            for name, given in (("magnets", self.magnets), ("sensors", self.sensors))
            if given is not None and given.points_m.size
        }
        low, high = self._box_m()
        return {
            "label": self.label,
            "box": [np.round(1e3 * low, 1).tolist(), np.round(1e3 * high, 1).tolist()],
            "radius": round(1e3 * self.radius_m, 2),
            "time_s": [float(f"{t:.6g}") for t in self.time_s],
            "shapes": shapes,
            **markers,
            "traces": [_panel(panel) for panel in self.traces],
        }

    def _box_m(self) -> tuple[np.ndarray, np.ndarray]:
        """Two corners around the base and all that is drawn."""
        points = [np.zeros((1, 3)), *(shape.points_m.reshape(-1, 3) for shape in self.shapes)]
        points += [m.points_m.reshape(-1, 3) for m in (self.magnets, self.sensors) if m is not None]
        every = np.concatenate(points)
        padding = self.radius_m * np.array([1.0, 1.0, 0.0])  # bodies mostly point upwards
        return every.min(0) - padding, every.max(0) + padding

    def figure(self) -> Figure:
        """Draw up to five of the shapes, the later the darker, with magnets and sensors of the last."""
        # Matplotlib takes long to load, and a live view draws nothing
        from edition1_live.view.still import still_picture

        return still_picture(self)

    def to_html(self) -> str:
        """Return a picture with the data beside it; the viewer puts itself in the place of the picture."""
        from edition1_live.view.still import small_png

        picture = base64.b64encode(small_png(self.figure())).decode("ascii")
        # "</script>" within a name must not end the element
        data = json.dumps(self.data(), separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")
        return (
            '<div class="shape-view">'
            f'<img src="data:image/png;base64,{picture}" alt="{html.escape(self.label)}">'
            f'<script type="application/json">{data}</script></div>'
        )

    def _repr_html_(self) -> str:
        return self.to_html()

    def __repr__(self) -> str:
        n, first, last = len(self.time_s), self.time_s[0], self.time_s[-1]
        return f"ShapeView of {n} frame{'s' * (n > 1)}, {first:g} to {last:g} s: {self.label}"


def _packed(values: np.ndarray, quantum: float) -> str:
    """Integers of 16 bits, low byte first, as base64."""
    return base64.b64encode(np.rint(values / quantum).astype("<i2").tobytes()).decode("ascii")


def _panel(panel: Traces) -> dict[str, Any]:
    series = []
    for name, values in panel.values.items():
        entry: dict[str, Any] = {"name": plain_symbol(name), "values": _rounded(values)}
        if name in panel.estimates:
            entry["estimate"] = _rounded(panel.estimates[name])
        series.append(entry)
    return {"title": panel.title, "unit": panel.unit, "series": series}


def _rounded(values: np.ndarray) -> list[float | None]:
    return [float(f"{x:.{_DIGITS_OF_A_TRACE}g}") if math.isfinite(x) else None for x in values.tolist()]
