"""What several 3-D views have in common: which frames they show, and the readings beside the shape."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from edition1.errors import require
from edition1_live.view.shape_view import Traces


def every_nth(samples: int, most: int) -> slice:
    """Take every n-th of some samples, evenly from the first, such that at most so many are left.

    Parameters
    ----------
    samples
        How many there are.
    most
        How many frames a view may have.

    Raises
    ------
    InputError
        If there is no sample, or no frame is allowed.

    Examples
    --------
    >>> every_nth(400, 100), every_nth(401, 100), every_nth(40, 100)
    (slice(0, 400, 4), slice(0, 401, 5), slice(0, 40, 1))
    """
    require(samples >= 1 and most >= 1, "samples, most", "every_nth", "at least 1", (samples, most))
    return slice(0, samples, -(-samples // most))


def readings(
    values: Float[np.ndarray, "t s"], unit: str, expected: Float[np.ndarray, "t s"] | None = None
) -> Traces:
    """One panel with a line for each sensor, ``u_1`` and so on.

    Parameters
    ----------
    values
        What the sensors read.
    unit
        Of the readings.
    expected
        What the sensor model reads at the estimate: dashed.
    """
    solid, dashed = (
        {} if x is None else {f"u_{j}": column for j, column in enumerate(x.T, start=1)}
        for x in (values, expected)
    )
    return Traces("readings", unit, solid, dashed)
