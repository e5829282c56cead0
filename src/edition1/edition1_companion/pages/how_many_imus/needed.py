"""How many IMUs an arm needs: the fewest whose bound of the error at the tip is within a tolerance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from edition1.errors import bad_input, require
from edition1.estimation.imu_selection import Selection
from edition1_companion.pages.how_many_imus.bounds import rigid_bound

MOST_IMUS = 1000
"""Where :func:`imus_needed` gives up."""


def imus_needed(
    bound: Callable[..., np.ndarray],
    length_m: float,
    tolerance_m: float,
    *,
    curvature: float,
    slope: float,
    sub_links: int = 2,
) -> int:
    """Smallest number of evenly spaced IMUs with which a bound at the tip is within a tolerance.

    Martin et al. 2022 ask for "a method to compute this number for any soft arm as a function of its maximum
    curvature and some tolerated error threshold" (section V). The bound is sufficient, not necessary: fewer
    may do.

    Parameters
    ----------
    bound
        One of the bounds of `edition1_companion.pages.how_many_imus.bounds`. For
        :func:`~edition1_companion.pages.how_many_imus.bounds.rigid_bound` IMUs are in the middle of their links, for the
        others at the ends, and the base is known.
    length_m, tolerance_m
        Length of the arm and largest error of the position of its tip [m].
    curvature, slope
        As :func:`~edition1_companion.pages.how_many_imus.bounds.rigid_bound`.
    sub_links
        Sub-segments per link, for the bounds of chains.

    Raises
    ------
    InputError
        If length, tolerance or sub-segments are not positive, 1000 IMUs are not enough, or as the bound does.

    Examples
    --------
    >>> from edition1_companion.pages.how_many_imus.bounds import pcc_bound
    >>> imus_needed(pcc_bound, 0.64, 0.01, curvature=4.0, slope=20.0)
    8
    """
    for name, value in (("length_m", length_m), ("tolerance_m", tolerance_m), ("sub_links", sub_links)):
        require(value > 0, name, "imus_needed", "positive", value)
    for n in range(1, MOST_IMUS + 1):
        h, numbers = length_m / n, tuple(range(n + 1))
        if bound is rigid_bound:
            middles = tuple(h * (i + 0.5) for i in range(n))
            arm = Selection(numbers[1:], middles, (h,) * n)
        else:
            arm = Selection(numbers, tuple(h * i for i in numbers), (h,) * n, sub_links=sub_links)
        tip = sum(arm.link_lengths)
        if bound(arm, tip, curvature=curvature, slope=slope)[0] <= tolerance_m:
            return n
    raise bad_input("tolerance_m", "imus_needed", f"within reach of {MOST_IMUS} IMUs [m]", tolerance_m)
