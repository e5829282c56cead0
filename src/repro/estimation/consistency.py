r"""Do estimates explain the readings? The chi-square test of the last few.

An estimator reports :math:`\chi^2`, its squared residuals in units of their variances, and the degrees of freedom
:math:`\nu` that they have (:class:`repro.estimation.base.Estimate`). Over the last :data:`WINDOW` readings

.. math:: \sum \chi^2 > F^{-1}_{\sum \nu}(1 - \alpha)

is an alarm, with :math:`F` the chi-square distribution. The residuals hold what readings state that no configuration
can (the *parity space* of the sensors): an error that looks like another configuration is not seen, and with as many
unknowns as readings none is.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool
from scipy import stats
from torch import Tensor

from repro.estimation.base import Estimate

CONSISTENT, SUSPICIOUS, WRONG = 0, 1, 2
STATUS = ("consistent", "suspicious", "wrong")
"""In words, for ``status`` in the diagnostics."""
WINDOW = 10
"""Readings that are tested together."""
_WRONG_SHARE = 0.01
"""An alarm is *wrong*, not only *suspicious*, if chance explains it so many times more rarely."""


class Verdict(NamedTuple):
    """What a monitor says at a moment.

    Attributes
    ----------
    status
        Number of one of :data:`STATUS`.
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

    status: int = CONSISTENT
    testable: bool = False
    excess: float = 0.0
    cause: str = ""
    suspects: tuple[int, ...] = ()


class Seen(NamedTuple):
    """A reading, and how its estimate explains it."""

    u: Tensor
    use: Tensor
    chi2: float
    dof: int
    systematic: float


@lru_cache(maxsize=4096)
def limit(chance: float, dof: int | float) -> float:
    """Chi-square that chance exceeds so rarely; with less than one degree of freedom as with one.

    Examples
    --------
    >>> round(limit(0.05, 1), 3)
    3.841
    """
    return float(stats.chi2.isf(chance, max(dof, 1)))


def verdict_on(window: tuple[Seen, ...], chance: float) -> Verdict:
    """Return the verdict on readings, without a cause.

    Parameters
    ----------
    window
        The last readings.
    chance
        That of an alarm on consistent readings.

    Examples
    --------
    >>> u = torch.zeros(3)
    >>> verdict_on((Seen(u, u == 0, 32.0, 2, 0.0),), 1e-6)
    Verdict(status=1, testable=True, excess=4.0, cause='', suspects=())
    """
    chi2, dof = sum(seen.chi2 for seen in window), sum(seen.dof for seen in window)
    if not dof:
        return Verdict()
    # Errors that last are as good as one reading, however many there are.
    last = sum(seen.systematic for seen in window) / len(window)
    independent = 1 / (last**2 + (1 - last**2) / len(window))
    free = round(dof * independent / len(window), 2)
    value = chi2 / dof * free
    status = (value > limit(chance, free)) + (value > limit(_WRONG_SHARE * chance, free))
    return Verdict(status, True, (chi2 / dof) ** 0.5)


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


def frozen(window: tuple[Seen, ...]) -> Tensor:
    """Sensors whose readings in a whole window are the same to the last digit; none if all of them are."""
    u = torch.stack([seen.u for seen in window])
    same = (u == u[0]).all(0)
    return same & (len(window) == WINDOW) & ~same.all()


def seen_by(u: Tensor, use: Tensor, estimate: Estimate) -> Seen:
    """Return a reading with what its estimate reports."""
    said = estimate.diagnostics
    systematic = said.get("systematic")
    share = 0.0 if systematic is None else float(systematic)
    return Seen(u, use, float(said["chi2"]), int(said["dof"]), share)
