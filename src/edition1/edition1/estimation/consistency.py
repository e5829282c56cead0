r"""Do estimates explain the readings? The chi-square test of the last few.

An estimator reports :math:`\chi^2`, its squared residuals in units of their variances, and the degrees of freedom
:math:`\nu` that they have (:class:`edition1.estimation.base.Estimate`). Over the last :data:`WINDOW` readings

.. math:: \sum \chi^2 > F^{-1}_{\sum \nu}(1 - \alpha)

is an alarm, with :math:`F` the chi-square distribution. The residuals hold what readings state that no configuration
can (the *parity space* of the sensors): an error that looks like another configuration is not seen, and with as many
unknowns as readings none is.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool


class Status(IntEnum):
    """What ``status`` in the diagnostics says: of how little chance explains the readings."""

    CONSISTENT = 0
    SUSPICIOUS = 1
    WRONG = 2

    @property
    def word(self) -> str:
        """In one word."""
        return self.name.lower()


WINDOW = 10
"""Readings that are tested together."""


class Verdict(NamedTuple):
    """What a monitor says at a moment.

    Attributes
    ----------
    status
        Number of one of :class:`Status`.
    testable
        Whether there is redundancy: without it nothing can be told, and ``status`` means nothing.
    excess
        Root mean square of the residuals in units of their standard deviation: near one if all is well.
    cause
        ``""``; ``"sensors"``: one of ``suspects``, one or two; ``"several"``: no single sensor explains it;
        ``"untold"``: it cannot be told which, so far; ``"no redundancy"``: nor will it; ``"estimator"``: a fit
        nearby explains the readings; ``"anew"``: the estimator was started anew a moment ago; ``"too few"``: there
        are fewer readings than unknowns.
    suspects
        Numbers of the sensors, from 0.
    """

    status: int = Status.CONSISTENT
    testable: bool = False
    excess: float = 0.0
    cause: str = ""
    suspects: tuple[int, ...] = ()


def lasting(condition: Bool[np.ndarray, " n"], readings: int | float) -> Bool[np.ndarray, " n"]:
    """Where a condition has held for more than so many readings in a row, up to and with this one.

    Examples
    --------
    >>> lasting(np.array([True, True, False, True, True, True, True]), 2).nonzero()[0].tolist()
    [5, 6]
    """
    here = np.arange(len(condition))
    last_without = np.maximum.accumulate(np.where(condition, -1, here))
    return here - last_without > readings
