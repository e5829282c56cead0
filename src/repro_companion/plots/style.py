"""The look of all figures, and what they share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.ticker import MultipleLocator

from repro import Ring

WIDTH = 5.5
"""Width of a figure [in]: letters of 10.2 points are 9 px high where a phone shows it and its margin 358 px wide."""
BLUE, ORANGE, GREEN, PINK, YELLOW, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
"""Okabe and Ito: safe for colour-blind readers, and read on a light and on a dark ground."""
BODY = ("#222222", "#8A2BE2")
"""Segments from base to tip, black to violet as in the paper."""
FOUR = (BLUE, GREEN, PINK, ORANGE)
PUBLISHED, OURS, BEST = "#767676", BLUE, ORANGE
TRUTH = {"color": "#767676", "lw": 4.0, "alpha": 0.55, "solid_capstyle": "round"}
"""Look of the truth where an estimate lies on it: wide and pale."""

Look = Mapping[str, Any]
"""How something is drawn: options of matplotlib."""
STYLE: Look = {
    "figure.facecolor": "none",  # a page shows its own ground, and inverts figures in dark mode
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "figure.figsize": (WIDTH, 3.6),
    "figure.dpi": 120,
    "savefig.dpi": 120,
    "figure.constrained_layout.use": True,
    "font.size": 10.2,
    "axes.titlesize": 10.2,
    "axes.labelsize": 10.2,
    "figure.labelsize": 10.2,
    "xtick.labelsize": 10.2,
    "ytick.labelsize": 10.2,
    "legend.fontsize": 10.2,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "lines.linewidth": 1.6,
    "axes.prop_cycle": cycler(color=[BLUE, ORANGE, GREEN, PINK, YELLOW, SKY, "#000000"]),
    "image.cmap": "viridis",
    "svg.hashsalt": "repro",
}
GREY_INK = dict.fromkeys(
    ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), "#767676"
)
"""Letters of a figure that is not inverted in dark mode: they are read on both grounds."""
NO_GRID, LEVELS = {"axes.grid": False}, {"axes.grid.axis": "y"}
"""Grids of figures that are no curves: none, or lines of the same height."""


def use_style() -> None:
    """Draw all figures of a notebook in the book's style, whatever the reader's matplotlibrc says."""
    mpl.rcdefaults()
    mpl.rcParams.update(STYLE)


@contextmanager
def style(**more: str | bool) -> Iterator[None]:
    """Draw one figure in the book's style, for a notebook to show once, as the result of its cell; a decorator."""
    with mpl.rc_context():
        use_style()
        mpl.rcParams.update(more)
        yield
    plt.close()


BESIDE = {"handlelength": 1.0, "handletextpad": 0.4, "columnspacing": 0.9, "labelspacing": 0.3}
"""Spaces of a legend that has little room."""


def row_of_panels(count: int, height: float, ylabel: str, **grid: object) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure and its panels side by side; the label of the vertical axis stands once."""
    figure, (panels,) = plt.subplots(1, count, figsize=(WIDTH, height), squeeze=False, **grid)
    panels[0].set_ylabel(ylabel)
    return figure, panels


def column_of_panels(count: int, height: float, xlabel: str, **grid: object) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure and its panels below each other, with one horizontal axis whose label stands once."""
    figure, panels = plt.subplots(count, 1, figsize=(WIDTH, height), squeeze=False, sharex=True, **grid)
    panels[-1, 0].set_xlabel(xlabel)
    return figure, panels[:, 0]


def marks(looks: Mapping[str, Look]) -> list[Line2D]:
    """Return entries of a legend from what they say and how it is drawn."""
    return [Line2D([], [], label=label, **look) for label, look in looks.items()]


def with_legend(
    figure: Figure, of: Axes | Mapping[str, Look] | None = None, columns: int = 2, **look: object
) -> Figure:
    """Return a figure for its cell with a legend above all panels: of one panel, of given looks, or of everything."""
    lines = of.get_legend_handles_labels()[0] if isinstance(of, Axes) else marks(of) if of else None
    figure.legend(handles=lines, ncols=columns, **({"loc": "outside upper center"} | BESIDE | look))
    return figure


def curves(
    panel: Axes,
    table: pd.DataFrame,
    by: str,
    x: str,
    y: str,
    looks: Mapping[Any, Look],
    **more: Any,
) -> None:
    """Draw a line for each group of a table, in the order of the table, and name it."""
    for name, part in table.groupby(by, sort=False):
        panel.plot(part[x], part[y], label=name, **more, **looks[name])


def plain_numbers(*axes: Axis) -> None:
    """Write numbers along logarithmic axes as they are typed, and none between the main ticks."""
    for axis in axes:
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")


def to_scale(panel: Axes, x: Sequence[float], z: Sequence[float], every_mm: float, **more: str) -> None:
    """Give a panel the same scale [mm] along x and z, with even ticks."""
    panel.set(**({"xlabel": "x [mm]", "ylabel": "z [mm]"} | more), aspect="equal", xlim=x, ylim=z)
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(MultipleLocator(every_mm))


def halves_of_rings(centres: np.ndarray, axes: np.ndarray, ring: Ring) -> list[Polygon]:
    """Return the two halves of each ring, cut along its axis."""
    inner, outer, h = (500 * size for size in (ring.inner_diameter, ring.outer_diameter, ring.height))
    across, along = np.array([inner, outer, outer, inner]), np.array([-h, -h, h, h])
    return [
        Polygon(centre + np.outer(side * across, [axis[1], -axis[0]]) + np.outer(along, axis))
        for centre, axis in zip(centres, axes, strict=True)
        for side in (-1, 1)
    ]


TRUTH_ESTIMATE: dict[str, dict[str, Any]] = {
    "truth": {"color": "0.4", "lw": 3.6, "alpha": 0.45},
    "estimate": {"color": "0.4", "lw": 1.2, "ls": (0, (4, 2))},
}
"""Looks of curves over time."""


def over_time(
    panel: Axes, part: pd.DataFrame, colour: str, works: pd.Series | None = None, label: str = ""
) -> None:
    """Draw the truth, paler where nothing works, the mean of the estimates and their deviation."""
    t, truth, mean, deviation = (part[name] for name in ("time_s", "truth", "mean", "std"))
    valid = truth.notna() if works is None else works
    wide, dashed = (look | {"color": colour} for look in TRUTH_ESTIMATE.values())
    panel.plot(t, truth.where(valid), label=label, **wide)
    panel.plot(t, truth.mask(valid), **wide | {"alpha": 0.15})
    panel.plot(t, mean, **dashed)
    panel.fill_between(t, mean - deviation, mean + deviation, color=colour, alpha=0.3, lw=0)


def with_spread(mean: float, std: float, places: int, between: str = " ± ") -> str:
    """Return a mean with its deviation, if there is one, to so many places; a dash where there is no mean."""
    spread = f"{between}{std:.{places}f}" if np.isfinite(std) else ""
    return f"{mean:.{places}f}{spread}" if np.isfinite(mean) else "–"
