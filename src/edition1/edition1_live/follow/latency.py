"""How long things took: a histogram of fixed size, however many there were."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

_BINS_PER_DECADE = 50
"""A quantile is at most 4.7 % too large."""
_LEAST_S, _DECADES = 1e-6, 8
"""Shortest time that is told apart [s], and decades above it."""
STAGES = ("parse", "queue", "estimate", "total")
"""From the arrival of the last bytes to their frames; waiting for the estimator; estimating; all of it."""


class Latencies:
    """Times [s], counted in bins of equal ratio.

    Examples
    --------
    >>> times = Latencies()
    >>> for k in range(1, 101):
    ...     times.add(k * 1e-4)
    >>> 5.0e-3 <= times.quantile(0.5) <= 5.24e-3, 9.9e-3 <= times.quantile(0.99) <= 10.37e-3
    (True, True)
    """

    def __init__(self) -> None:
        self.counts = np.zeros(_BINS_PER_DECADE * _DECADES + 1, np.int64)

    @property
    def count(self) -> int:
        """How many."""
        return int(self.counts.sum())

    @staticmethod
    def edges_s() -> Float[np.ndarray, " bins"]:
        """Upper ends of the bins [s]; the last one holds everything above."""
        return _LEAST_S * 10 ** (np.arange(_BINS_PER_DECADE * _DECADES + 1) / _BINS_PER_DECADE)

    def add(self, seconds: float) -> None:
        """Count one."""
        k = math.ceil(_BINS_PER_DECADE * math.log10(max(seconds, _LEAST_S) / _LEAST_S))
        self.counts[min(k, len(self.counts) - 1)] += 1

    def quantile(self, share: float) -> float:
        """Time that this share stayed within [s]; NaN if there was none."""
        total = self.counts.cumsum()
        if not total[-1]:
            return float("nan")
        return float(self.edges_s()[np.searchsorted(total, share * total[-1])])
