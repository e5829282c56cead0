"""What a view of shapes is made of: backbones, magnets or sensors, and lines over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

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
