"""One style for all figures."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import Any, ParamSpec

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from mpl_toolkits.mplot3d.axes3d import Axes3D

STYLE = str(Path(__file__).with_name("style.mplstyle"))
MAGNET, SENSOR = "#009E73", "#0072B2"
WIDTH_IN = 6.4
"""Width of a figure [in]: its text of 10 points is still read where a telephone shows the page 358 px wide."""
TRUTH = {"lw": 3.4, "alpha": 0.4}
"""Look of the truth where an estimate of the same colour lies on it: wide and pale."""
ESTIMATE = {"lw": 1.3, "ls": (0, (4, 2))}
TIMES = ListedColormap(colormaps["viridis"](np.linspace(0.0, 0.7, 256)), name="times")
"""Colours of lines by time, early to late: without the yellow end, which neither a white nor a dark page shows."""
INK_OF_MAPS = dict.fromkeys(
    ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), "#767676"
)
"""Read on a light and on a dark ground: a map of colours is not inverted in dark mode, where its dark stays low."""
VECTOR_LIMIT_BYTES = 1_000_000
"""A vector version that is larger is not kept: SVG up to this size, else PDF up to this size, else none."""

P = ParamSpec("P")


def wrapped_panels(count: int, columns: int, row_in: float, **options: Any) -> tuple[Figure, list[Axes]]:
    """Return a figure as wide as a page with panels in rows of so many columns.

    Parameters
    ----------
    count
        How many panels.
    columns
        The most beside each other.
    row_in
        Height of a row [in].
    options
        As for :func:`matplotlib.pyplot.subplots`.
    """
    columns = min(columns, count)
    rows = -(-count // columns)
    figure, panels = plt.subplots(rows, columns, figsize=(WIDTH_IN, row_in * rows), squeeze=False, **options)
    for panel, above in zip(panels.flat[count:], panels.flat[count - columns :], strict=False):
        panel.remove()
        above.xaxis.set_tick_params(labelbottom=True)
    return figure, list(panels.flat[:count])


def plain_ticks(axis: Axis, *, subs: tuple[int, ...] = (1, 2, 5)) -> None:
    """Put plain numbers on a logarithmic axis, at these multiples of the powers of ten alone."""
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def label_in_mm(axes: Axes3D, *, fontsize: float, labelpad: float) -> None:
    """Name the axes of a small 3-D picture, with their unit.

    Parameters
    ----------
    axes
        3-D axes in mm.
    fontsize
        Size of the names [pt].
    labelpad
        Distance from the numbers [pt]; negative where these lie close to the axes.
    """
    axes.patch.set_visible(False)  # it would cover the names of the panel on its left
    for name in "xyz":
        getattr(axes, f"set_{name}label")(f"{name} [mm]", fontsize=fontsize, labelpad=labelpad)


def page_figure(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Draw in the companion's style, and close the figure so that a notebook shows it once: as the result.

    The executed notebook keeps a vector version beside the picture, for readers to download.
    """

    @wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with plt.style.context(STYLE):
            figure = draw(*args, **kwargs)
        plt.close(figure)
        figure._repr_mimebundle_ = partial(_vector_version, figure)  # pyright: ignore[reportAttributeAccessIssue]
        return figure

    return styled


def _vector_version(figure: Figure, include: Any = None, exclude: Any = None) -> dict[str, str]:
    """Return SVG or PDF by MIME type, as IPython asks for it; the same figure gives the same bytes."""
    # a hundredth of a point is less than is seen
    written = _written(figure, "svg", {"Date": None})
    svg = re.sub(rb' [dxy]="[^"]*"', lambda path: re.sub(rb"(\.\d\d)\d+", rb"\1", path[0]), written)
    if len(svg) <= VECTOR_LIMIT_BYTES:
        return {"image/svg+xml": svg.decode()}
    pdf = _written(figure, "pdf", {"CreationDate": None})
    if len(pdf) <= VECTOR_LIMIT_BYTES:
        return {"application/pdf": base64.b64encode(pdf).decode()}
    return {}


def _written(figure: Figure, form: str, metadata: dict[str, None]) -> bytes:
    stream = io.BytesIO()
    # the style also fixes the names inside an SVG, which are random otherwise
    with plt.style.context(STYLE):
        figure.savefig(stream, format=form, metadata=metadata, bbox_inches="tight")
    return stream.getvalue()
