"""One style for all figures."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import ParamSpec

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

STYLE = str(Path(__file__).with_name("style.mplstyle"))
MAGNET, SENSOR = "#009E73", "#0072B2"

P = ParamSpec("P")


def page_figure(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Draw in the companion's style, and close the figure so that a notebook shows it once: as the result."""

    @wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with plt.style.context(STYLE):
            figure = draw(*args, **kwargs)
        plt.close(figure)
        return figure

    return styled
