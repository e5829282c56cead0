"""Errors of magnets, Hall sensors and IMUs that wander while the robot moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from edition1.errors import bad_input, require
from edition1.estimation.undetermined import not_determined

KINDS = {"moment": (0,), "gain": (1,), "offset": (2,), "heading": (3,), "tilt": (4, 5)}
"""Kinds of errors, and their numbers in ``edition1.kernels._self_calibration``."""
_FAST_S = 60.0
"""Errors that fade within this time [s] are forgotten at a flag; the others hold the calibration."""


@dataclass(frozen=True)
class Wander:
    """Errors of one kind that wander, one for each magnet (``moment``), Hall sensor or IMU (two for ``tilt``).

    Parameters
    ----------
    kind
        ``moment`` or ``gain``, relative; ``offset`` [mT]; ``heading`` or ``tilt`` [rad]. A kind may occur twice, as
        errors that fade fast and slowly.
    start
        Standard deviation before the first reading: the prior.
    walk
        Standard deviation that a second adds [unit/s^0.5].
    time_s
        Time within which it fades [s]; infinite for a random walk.
    shared
        Whether it is one error of all of them, as that of magnets that warm up together.

    Raises
    ------
    InputError
        If the kind is another one, or a number is negative.

    Examples
    --------
    >>> Wander.fading("tilt", 0.02, 3.0).start
    0.02
    """

    kind: str
    start: float
    walk: float = 0.0
    time_s: float = math.inf
    shared: bool = False

    def __post_init__(self) -> None:
        require(self.kind in KINDS, "kind", "Wander", f"one of {', '.join(KINDS)}", repr(self.kind))
        for name in ("start", "walk"):
            if not 0 <= getattr(self, name) < math.inf:
                raise bad_input(name, "Wander", "finite and not negative", getattr(self, name))
        require(self.time_s > 0, "time_s", "Wander", "positive", self.time_s)

    @classmethod
    def fading(cls, kind: str, std: float, time_s: float) -> Wander:
        """Errors that have the same standard deviation at all times, and fade within ``time_s`` [s]."""
        require(time_s > 0, "time_s", "Wander", "positive", time_s)
        return cls(kind, std, std * math.sqrt(2 / time_s), time_s)


@dataclass(frozen=True)
class Errors:
    """Every error of a robot's sensors as arrays.

    Parameters
    ----------
    names
        Numbered from 1, as "gain 2".
    kind, part
        Number of its kind, and of its magnet, Hall sensor or IMU; -1 for all.
    start, walk, rate
        Standard deviation before the first reading, what a second adds, and how fast it fades [1/s].
    """

    names: tuple[str, ...]
    kind: Int[np.ndarray, " n"]
    part: Int[np.ndarray, " n"]
    start: Float[np.ndarray, " n"]
    walk: Float[np.ndarray, " n"]
    rate: Float[np.ndarray, " n"]

    @property
    def fast_std(self) -> Float[np.ndarray, " n"]:
        """Standard deviation for good of those that fade within a minute; infinite for the others."""
        fast = self.rate * _FAST_S >= 1
        return np.where(fast, self.walk / np.sqrt(2 * np.where(fast, self.rate, 1.0)), np.inf)

    def prior_std(self, elapsed_s: float) -> Float[np.ndarray, " n"]:
        """Standard deviation after a time [s] without a reading."""
        rate = np.where(self.rate > 0, self.rate, 1.0)
        stay = np.exp(-2 * self.rate * elapsed_s)
        grown = np.where(self.rate > 0, (1 - stay) / (2 * rate), elapsed_s)
        return np.sqrt(stay * self.start**2 + self.walk**2 * grown)

    def undetermined(
        self, covariance: Float[np.ndarray, "n n"], elapsed_s: float, threshold: float = 0.9
    ) -> list[str]:
        r"""What readings did not determine, in sentences.

        With the information :math:`\Lambda` that they hold about the errors, and the prior's standard deviations D,
        the posterior in units of the prior is :math:`(1 + D \Lambda D)^{-1}`: the identity where they hold none.

        Parameters
        ----------
        covariance
            Of the errors after the readings.
        elapsed_s
            Time since the start [s].
        threshold
            Ratio of posterior to prior standard deviation from which a combination counts as not determined.
        """
        std = self.prior_std(elapsed_s)
        free = np.flatnonzero(std)
        relative = covariance[np.ix_(free, free)] / np.outer(std[free], std[free])
        return not_determined([self.names[k] for k in free], relative, threshold)


def errors(wanders: Sequence[Wander], magnets: int, hall: int, imus: int) -> Errors:
    """Errors of so many magnets, Hall sensors and IMUs.

    Examples
    --------
    >>> errors([Wander("moment", 0.01), Wander("tilt", 0.02)], magnets=2, hall=6, imus=1).names
    ('moment 1', 'moment 2', 'tilt 1 about x', 'tilt 1 about y')
    >>> errors([Wander("moment", 0.01, shared=True)], magnets=2, hall=6, imus=0).names
    ('moment of all',)
    """
    counts = {"moment": magnets, "gain": hall, "offset": hall}
    rows = []
    for wander in wanders:
        parts = range(counts.get(wander.kind, imus))
        for part in ([-1] if wander.shared else parts) if len(parts) else []:
            for axis, kind in enumerate(KINDS[wander.kind]):
                about = f" about {'xy'[axis]}" if wander.kind == "tilt" else ""
                fading = f", fading in {wander.time_s:g} s" if wander.time_s < math.inf else ""
                name = f"{wander.kind} {'of all' if wander.shared else part + 1}{about}{fading}"
                rows.append((name, kind, part, wander.start, wander.walk, 1 / wander.time_s))
    names, *columns = zip(*rows, strict=True) if rows else [()] * 6
    kind, part = (np.array(column, dtype=np.int64) for column in columns[:2])
    return Errors(tuple(names), kind, part, *(np.array(column, dtype=float) for column in columns[2:]))
