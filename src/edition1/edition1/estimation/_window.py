"""The chi-square test over the last few readings, behind :mod:`edition1.estimation.consistency`."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import torch
from scipy.special import chdtri  # scipy.stats gives the same and takes longer to load than all else here
from torch import Tensor

from edition1.errors import bad_input
from edition1.estimation.base import Estimate
from edition1.estimation.consistency import WINDOW, Verdict

_WRONG_SHARE = 0.01
"""An alarm is *wrong*, not only *suspicious*, if chance explains it so many times more rarely."""


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
    return float(chdtri(max(dof, 1), chance))


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


def frozen(window: tuple[Seen, ...]) -> Tensor:
    """Sensors whose readings in a whole window are the same to the last digit; none if all of them are."""
    u = torch.stack([seen.u for seen in window])
    same = (u == u[0]).all(0)
    return same & (len(window) == WINDOW) & ~same.all()


def seen_by(u: Tensor, use: Tensor, estimate: Estimate) -> Seen:
    """Return a reading with what its estimate reports.

    Raises
    ------
    InputError
        If it does not say how well it explains the reading.
    """
    said = estimate.diagnostics
    if bool(torch.isnan(said["chi2"]).any()):
        raise bad_input("estimator", "Monitored", "one that knows its noise", "a chi2 that is not a number")
    systematic = said.get("systematic")
    share = 0.0 if systematic is None else float(systematic)
    return Seen(u, use, float(said["chi2"]), int(said["dof"]), share)
