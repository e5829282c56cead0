"""The look of all figures, and the figures of the pages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from cycler import cycler

WIDTH = 5.6
"""Width of a figure [in]: letters of 10.2 points are 9 px high where a phone shows it 358 px wide."""
BLUE, ORANGE, GREEN, PINK, YELLOW, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
"""Okabe and Ito: safe for colour-blind readers, and read on a light and on a dark ground."""
PUBLISHED, OURS, BEST = "#767676", BLUE, ORANGE
TRUTH = {"color": "#767676", "lw": 4.0, "alpha": 0.55, "solid_capstyle": "round"}
"""Look of the truth where an estimate lies on it: wide and pale."""

STYLE: Any = {
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


def use_style() -> None:
    """Draw all figures of a notebook in the book's style, whatever the reader's matplotlibrc says."""
    mpl.rcdefaults()
    mpl.rcParams.update(STYLE)


@contextmanager
def style() -> Iterator[None]:
    """Draw in the book's style, whatever the reader's matplotlibrc says; also a decorator."""
    with mpl.rc_context():
        use_style()
        yield
