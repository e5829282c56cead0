"""A search for the part at fault: without its readings the rest fits.

The estimator is stepped again without each part in turn (a sensor, a chip, an IMU), all as one batch. These fits go
on from row to row while the alarm lasts, and what speaks against each adds up: its squared residuals, and how far the
robot would have jumped. If the rest fits without one part, and the fault is large or its proof has added up, its
readings are left out, and the part is named once that is decided. If nothing fits, a fit from another start may.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri

from repro.common import Array
from repro.estimators.base import Estimate, Watched, evenly, grown, member, with_member

WINDOW, FORGOTTEN, LONGEST = 10, 1000, 160
"""Rows that are gone through again when an alarm begins; that an alarm is remembered; between two looks elsewhere."""
_EXPLAINED, _FITS = 1e-3, 3e-3
"""A fit explains a row, or a sum of rows, unless chance exceeds its residuals more rarely than this."""
_MUCH_BETTER, _DECISIVE = 25.0, 40.0
"""How much lower chi-square is from a better start, or in favour of the part that was left out before; and how much
lower it is without the part at fault than without another one."""
_HEAVIEST, _KEEP = 300.0, 0.99
"""Most that a row says against a fit, so that one that was lost recovers; what is left of it one row later."""
_ENOUGH, _STRONG = 40.0, 400.0
"""Degrees of freedom before a part is named; least chi-square of a row, times the degrees of freedom that are left
without the part, before readings are left out. What all sensors share looks like one of them if it is smaller."""
_PROOF, _PROOF_OF_TWO, _FITTED = 3000.0, 10000.0, 50
"""By how much leaving a part out lowers the sum of chi-square before a small fault is believed, too: what all sensors
share then changes as the robot moves, and no longer looks like one of them. And before one of two parts is named. And
after how many rows without an alarm: errors of a model are there from the start, also where the robot is at rest."""
SPEED = 0.5
"""Standard deviation of a velocity where no motion model says another one [widths of the bounds per second]."""
_STARTS = 8


class Case(NamedTuple):
    """What is known of an alarm: fits with all parts, then without each, and what speaks against them."""

    bank: Any
    against: Array
    dof: Array
    jump: Array
    """Squared distance of the first fits from the last good one, in units of its variance."""
    row: int
    look: int
    """Row from which other starts are tried again, and how many rows later once more."""
    wait: int
    since: int
    """Row at which it began, and the last one that did not fit."""
    failed: int
    best: int = 0
    """What was left out last, 0 for nothing."""


class Row(NamedTuple):
    """One of the last rows of a robot: the state before it, readings, known coordinates and time."""

    before: Any
    u: Array
    known: Any
    t: float


class Alarm(NamedTuple):
    """A row of one robot that does not fit."""

    number: int
    rows: Sequence[Row]
    """The last rows, this one at the end."""
    state: Any
    """Of the estimator after this row, and its estimate."""
    trial: Estimate
    good: tuple[Array, float]
    """Configuration and time of the last row that fitted."""
    odd: bool
    """Whether the row by itself does not fit, or a sum of rows."""
    lasting: bool
    growth: float
    """By how much the residuals are too large."""


class Verdict(NamedTuple):
    """State and estimate of a robot whose readings do not fit, what is known of its alarm, and what is said."""

    state: Any
    estimate: Estimate
    case: Case
    decided: bool = False
    suspects: Any = False
    left_out: Any = False
    growth: float = 1.0
    restarted: bool = False


class Parts:
    """What of a robot may fail, and what its estimator can say without it.

    Parameters
    ----------
    estimator
        What is watched.
    n_readings
        Number of readings in a row.
    """

    def __init__(self, estimator: Watched, n_readings: int) -> None:
        self.estimator, self.bounds = estimator, estimator.bounds
        self.of_reading, self.jitters = estimator.parts_of(n_readings)
        """Which part every reading belongs to, and which of them never stay the same."""
        self.without = np.arange(self.of_reading.max() + 2)[:, None] == self.of_reading + 1
        """Which readings are left out: none, then those of each part ``[1 + parts, s]``."""
        self.largest = int(np.bincount(self.of_reading).max())
        self.width, self.unknowns = np.ones(estimator.n_q), estimator.n_q
        if self.bounds is not None:
            low, high = self.bounds
            self.width, self.unknowns = np.where(low < high, high - low, 1.0), int((low < high).sum())
        self.turns = estimator.angles.free[: estimator.n_q]

    def apart(self, q: Array, other: Array) -> Array:
        """Return the difference of configurations, of angles the shorter way round."""
        return self.estimator.angles.difference(q, other)

    def elsewhere(self, before: Any, good: Any) -> Any:
        """Return states to start anew from: where the robot was, and everywhere within the bounds."""
        n = self.estimator.n_q
        if self.bounds is None:
            return self.estimator.init(np.zeros((1, n)))
        points: Any = (x[:n] for x in (good, before.q) if np.ndim(x) and np.isfinite(x).all())
        starts = np.clip([*points, *evenly(*self.bounds, _STARTS)], *self.bounds)
        states, m = self.estimator.init(starts), np.size(before.q)
        if m > n:  # errors of sensors stay as they are known
            q, P = states.q.copy(), states.covariance.copy()
            q[:, n:], P[:, n:m, n:m] = before.q[n:], before.covariance[n:m, n:m]
            states = states._replace(q=q, covariance=P)
        return states


class Search:
    """The search in one row that does not fit."""

    def __init__(self, parts: Parts, alarm: Alarm, case: Case | None) -> None:
        self.parts, self.alarm, self.estimator = parts, alarm, parts.estimator
        self.now, row = alarm.rows[-1], alarm.number
        self.new = case is None or row - case.row > FORGOTTEN
        if case is None or self.new:
            none = np.zeros(len(parts.without))
            case = Case(None, none, none, none, row, row + WINDOW, WINDOW, row, row)
        self.case, self.fits = case, alarm.trial
        self.spare = max(int(np.isfinite(self.now.u).sum()) - parts.largest - parts.unknowns, 1)
        """Readings that no part and no unknown uses up."""
        self.fresh = np.full(len(parts.without), not case.dof.any() and not self.estimator.needs_time)
        """Which of the fits have just begun."""

    def verdict(self) -> Verdict:
        """Step without each part, look elsewhere where nothing fits, and say what is left out."""
        alarm, lasts = self.alarm, self.alarm.number - self.case.row <= WINDOW
        strong = alarm.growth * max(int(alarm.trial.dof), 1) * self.spare >= _STRONG
        strong = strong or (lasts and self.case.best > 0)
        self.step_without_each()
        explained = self.explained()
        against = self.case.against
        proof = against[0] - against[1:][explained].min(initial=against[0])
        strong = strong or (self.case.since >= _FITTED and proof >= _PROOF)
        if alarm.odd and not explained.any() and (self.new or alarm.number >= self.case.look):
            restarted = self.look_elsewhere()
            if restarted is not None:
                return restarted
            explained = self.explained()
        failed = alarm.number if alarm.odd or alarm.lasting else self.case.failed
        self.case = self.case._replace(row=alarm.number, failed=failed)
        if not strong or not explained.any():
            return self.undecided(strong)
        return self.without_the_best(explained, proof)

    def step_without_each(self) -> None:
        """Go on with the fits of the row before, or begin them, and add up what speaks against each.

        A filter that has followed a fault does not forget it at once: it starts some rows earlier.
        """
        case, alarm = self.case, self.alarm
        began, bank = not case.dof.any(), case.bank if case.row == alarm.number - 1 else None
        against, freedom = case.against, case.dof
        for before, u, known, t in alarm.rows if began and not alarm.odd else alarm.rows[-1:]:
            readings = np.where(self.parts.without, np.nan, u)
            bank, self.fits = self.estimator.step(before if bank is None else bank, readings, t, known=known)
            against = _KEEP * against + np.minimum(self.fits.chi2, _HEAVIEST)
            freedom = _KEEP * freedom + self.fits.dof
        self.case = case._replace(bank=bank, against=against, dof=freedom)

    def explained(self) -> Array:
        """Return which parts the rest fits without."""
        case, used = self.case, np.bincount(self.parts.of_reading, np.isfinite(self.now.u)) > 0
        return (case.against <= chdtri(np.maximum(case.dof, 1), _FITS))[1:] & used & (used.sum() > 1)

    def look_elsewhere(self) -> Verdict | None:
        """Try other starts: return a restart where one explains the row, else keep the better fits of each part."""
        row, (before, u, known, t), good = self.alarm.number, self.now, self.alarm.good[0]
        case = self.case._replace(look=row + self.case.wait, wait=min(2 * self.case.wait, LONGEST))
        readings = np.where(self.parts.without, np.nan, u)[:, None]
        there, again = self.estimator.step(self.parts.elsewhere(before, good), readings, t, known=known)
        explains = again.chi2 <= chdtri(np.maximum(again.dof, 1), _EXPLAINED)
        better = explains[0] & (again.chi2[0] < float(self.alarm.trial.chi2) - _MUCH_BETTER)
        if better.any():
            away = np.abs(self.parts.apart(again.q[0], np.nan_to_num(good)) / self.parts.width).max(-1)
            start = 0, int(np.where(better, away, np.inf).argmin())
            none = np.zeros(len(self.parts.without))
            case = case._replace(bank=None, against=none, dof=none, jump=none, row=row)
            return Verdict(member(there, start), member(again, start), case, restarted=True)
        share = 1.0 if self.new else 0.5  # what spoke against a fit that was lost counts half
        for part in 1 + np.flatnonzero(explains[1:].any(-1)):
            start = part, again.chi2[part].argmin()
            case.against[part] += share * (again.chi2[start] - case.against[part])
            case.dof[part] += share * (again.dof[start] - case.dof[part])
            case = case._replace(bank=with_member(case.bank, (part,), member(there, start)))
            self.fits = with_member(self.fits, (part,), member(again, start))
            self.fresh[part] = True
        self.case = case
        return None

    def undecided(self, strong: bool) -> Verdict:
        """Keep all readings, with a larger covariance; a filter waits for the end of a glitch of all of them."""
        alarm, (before, u, known, t) = self.alarm, self.now
        if self.estimator.needs_time and strong and alarm.odd and alarm.number - self.case.since < WINDOW:
            state, waiting = self.estimator.step(before, np.full(len(u), np.nan), t, known=known)
            return Verdict(state, grown(waiting, 0.0, 1.0), self.case, left_out=np.isfinite(u))
        return Verdict(alarm.state, grown(alarm.trial, 0.0, alarm.growth), self.case, growth=alarm.growth)

    def without_the_best(self, explained: Array, proof: float) -> Verdict:
        """Leave out the part that most speaks for; name it, or one of two, if that is decided."""
        fits, none = self.fits, np.zeros(len(self.parts.without))
        case = self._with_jumps()
        favoured = _MUCH_BETTER * (np.arange(len(none)) == case.best)
        total = np.where(explained, (case.against + case.jump - favoured)[1:], np.inf)
        left = total <= total.min() + _DECISIVE
        best = 1 + int(total.argmin())
        off = self.parts.apart(fits.q[1:], fits.q[best])[left]  # what is not decided, the covariance holds
        estimate = grown(member(fits, best), off.T @ off / len(off))
        enough = case.dof[best] / max(fits.dof[best], 1) * self.spare >= _ENOUGH
        few = left.sum() <= 1 + (proof >= _PROOF_OF_TWO)
        left_out = self.parts.without[best] & np.isfinite(self.now.u)
        decided = bool(enough and left.sum() == 1)
        case = case._replace(best=best)
        return Verdict(member(case.bank, best), estimate, case, decided, left & (enough and few), left_out)

    def _with_jumps(self) -> Case:
        """Return the case with how far the robot would have jumped by each fit that has just begun."""
        good, good_t = self.alarm.good
        if not (self.fresh.any() and np.isfinite(good).all()):
            return self.case
        parts, fits = self.parts, self.fits
        moved = np.where(parts.turns, 1e3, parts.width * (SPEED * (self.now.t - good_t) + 1e-6))
        away, C = parts.apart(fits.q, good), fits.covariance + np.diag(moved**2)
        jump = (away * np.linalg.solve(C, away[..., None])[..., 0]).sum(-1)
        return self.case._replace(jump=np.where(self.fresh, jump, self.case.jump))
