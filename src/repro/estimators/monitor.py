r"""A monitor: do the readings fit the estimates? If not, it looks for the part at fault, or for another start.

Every row is tried with all its readings. With its squared residuals :math:`\chi^2` and their degrees of freedom
:math:`\nu` it does not fit if :math:`\chi^2 > \ell(\nu)`, where

.. math:: \ell(\nu) = \nu + 2\sqrt{\nu x} + 2x, \qquad
   P\Bigl(\sum_i w_i z_i^2 > \ell\bigl(\textstyle\sum_i w_i\bigr)\Bigr) \le e^{-x}

for standard normal :math:`z_i` and weights :math:`0 \le w_i \le 1` (Laurent and Massart 2000, lemma 1). So the bound
also holds for fading sums over about ten and about a hundred past rows, which show small errors that last.

When a row does not fit, the estimator is stepped again without each part in turn (a sensor, a chip, an IMU), all as
one batch. These fits go on from row to row while the alarm lasts, and what speaks against each adds up. If the rest
fits without one part, and the fault is large or its proof has added up, its readings are left out, and the part is
named once that is decided. If nothing fits, a fit from another start may. Otherwise the covariance grows by
:math:`\chi^2/\nu`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri

from repro.common import Array
from repro.estimators.base import Estimate, evenly, incoming

STATUS = (
    "consistent", "left out", "inconsistent", "frozen", "undetermined", "unchecked", "beyond bounds",
)  # fmt: skip
"""Names of what the monitor says of a row."""
SAID = ("status", "suspects", "left_out", "growth", "restarted")
CONSISTENT, LEFT_OUT, INCONSISTENT, FROZEN, UNDETERMINED, UNCHECKED, BEYOND_BOUNDS = range(7)
TRUSTED = (CONSISTENT, LEFT_OUT, UNCHECKED)
"""The numbers of what is said of a row whose readings speak for its estimate, or at least not against it."""
_RARE, _STRICT = 18.4, 4.6
"""Good readings do not fit once in 1e8 rows; after an alarm a part comes back where chance is above 1e-2."""
_TWICE, _ROOT = 2 * _RARE, 2 * _RARE**0.5
_FADE, _FADE_SLOWLY = 0.1, 0.01
"""What every row takes from the sums of the rows before it."""
_SWOLLEN = 1.1
"""Most that the slow sum is beyond what it holds on average, in units of its bound, so that an alarm ends soon."""
_WINDOW, _FORGOTTEN, _LONGEST = 10, 1000, 160
"""Rows that are gone through again when an alarm begins; that an alarm is remembered; between two looks elsewhere."""
_CALM = 2
"""Rows that fit before all readings count again."""
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
_SPEED = 0.5
"""Standard deviation of a velocity where no motion model says another one [widths of the bounds per second]."""
_FROZEN_S, _FROZEN_ROWS = 0.5, 20
_FRAMES = 16
"""So many of the last frames are remembered: a board whose bus hangs may send its old buffers in turn."""
_LOOK = 8
"""Every so many rows we look whether a single reading stays the same."""
_STARTS = 8
_NOWHERE, _BARE = np.zeros(1, dtype=bool), np.array(UNCHECKED, dtype=np.int8)
_WIDER = 0.5
"""How far beyond its bounds a robot is looked for that touches one [widths of the bounds]."""


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


class MonitorState(NamedTuple):
    """The state of the estimator, and what the monitor remembers."""

    inner: Any
    seed: int
    row: int = 0
    frames: Any = ()
    """The last frames, bit for bit."""
    old: Any = 0
    """How many rows in a row held one of the last frames, and the time of the last new one [s]."""
    since: Any = 0.0
    sums: tuple[Any, ...] = (0.0, 0.0, 0.0, 0.0)
    """Sums of chi-square over ten rows and a hundred, and of their degrees of freedom."""
    recent: tuple[Any, ...] = ()
    """State before, readings, time and known coordinates of the last rows."""
    good: tuple[Any, Any] = (np.nan, 0.0)
    """Configuration and time of the last row that fitted."""
    cases: Any = None
    last: Any = None
    steps: int = 0
    still: Any = None
    """How many rows a reading has not changed, and since when [s]; nothing while all of them change."""
    stuck: Any = None
    """Which readings stay the same for too long, if any."""


class Monitor:
    r"""An estimator with a monitor: an estimator, too.

    The details of its estimates hold ``status``, the number of a name in ``STATUS``, and where that is not zero
    ``suspects`` ``[..., parts]``, the parts that are named; ``left_out`` ``[..., s]``, readings that were left out,
    which count as missing; ``growth``, the factor by which the covariance grew; ``restarted``. The parts are those of
    the robot. Where there is none, every reading is its own.

    A part whose readings stay the same, bit for bit, for more than 0.5 s and at least 20 rows, is named and left out,
    unless their noise is below their resolution. A frame that equals one of the last sixteen, bit for bit, adds
    nothing: its covariance grows with the time since the last new frame. If there was none for so long, the board
    repeats itself and the row is *frozen*. A row is *undetermined* if it has fewer readings than unknowns and no
    motion model helps, or none at all. It is *unchecked* if the fit uses up all of its readings, so that none is left
    to contradict. It is *beyond bounds* if its readings fit outside the bounds of the robot and not within: the
    estimate stays within, and its covariance holds the difference.

    Parameters
    ----------
    estimator
        It reports ``chi2`` and ``dof``, takes batches, and leaves out readings that are NaN.

    Examples
    --------
    Four sensors read one coordinate, and the last one is unplugged:

    >>> from repro import LevenbergMarquardt
    >>> watched = Monitor(LevenbergMarquardt(lambda q: q * np.ones(4), [-1.0], [1.0], noise=0.001))
    >>> state = watched.init([0.5])
    >>> for k in range(30):
    ...     e = 1e-5 * k
    ...     state, found = watched.step(state, [0.5 + e, 0.501 - e, 0.499 + e, 0.0], 0.1 * k)
    >>> STATUS[found.details["status"]], found.details["suspects"].tolist(), found.q.round(3)
    ('left out', [False, False, False, True], array([0.5]))
    """

    parts: Array
    """Which part every reading belongs to."""

    def __init__(self, estimator: Any) -> None:
        self.estimator, self._owner = estimator, type(estimator).__name__
        self.n_q, self.needs_time = estimator.n_q, getattr(estimator, "needs_time", False)
        self._fit = getattr(estimator, "_update", estimator)  # least squares, in a Kalman filter
        self._wider = estimator.widened(_WIDER) if hasattr(estimator, "widened") else None
        self._bounds, self._width, self._unknowns = None, np.ones(self.n_q), self.n_q
        if hasattr(self._fit, "lower"):
            low, high = self._bounds = self._fit.lower[: self.n_q], self._fit.upper[: self.n_q]
            self._width, self._unknowns = np.where(low < high, high - low, 1.0), int((low < high).sum())
        self._turns = estimator.angles.free[: self.n_q] if hasattr(estimator, "angles") else False
        self._blank: dict[str, Any] = {}

    def init(self, q0: Any = None, seed: int = 0) -> MonitorState:
        """Return the state of the estimator at ``q0``; nothing is held against any part."""
        return MonitorState(self.estimator.init(q0, seed=seed), seed, cases={})

    def step(
        self, state: MonitorState, u: Any, t: float = 0.0, mask: Any = None, known: Any = None
    ) -> tuple[MonitorState, Estimate]:
        """Step the estimator, and say whether its estimate explains the readings.

        Raises
        ------
        InputError
            As the estimator.
        """
        if mask is not None or type(u) is not np.ndarray or u.dtype.char != "d":
            u = incoming(u, mask, self._owner)
        used = u
        if not state.steps:
            state = self._begun(state, u)
        alone, same, old, since = u.ndim == 1, None, 0, t
        bits: Any = u.tobytes() if alone else u.view(np.int64)
        if state.steps and known is None:
            again: Any = bits in state.frames if alone else (bits == state.frames).all(-1).any(0)
            if again if alone else again.any():
                same, old, since = self._again(state, u, bits, again, t)
        still, stuck = state.still, None
        if state.steps and (still is not None or state.steps % _LOOK == 0):
            still = self._still(state, u, t, same)
            stuck = None if still is None else self._stuck(still, u, t)
            used = u = u if stuck is None else np.where(stuck[1], np.nan, u)
            state = self._without_old_cases(state, None if stuck is None else stuck[1])
        if same is not None and self.needs_time:
            used = np.where(same[..., None], np.nan, u)
        inner, found = self.estimator.step(state.inner, used, t, known=known)
        least = self._spare if known is None else self._spare + np.isfinite(known).sum(-1)
        chi2, dof, missing = found.chi2, found.dof, found.missing
        one = type(chi2) is not np.ndarray
        if one:  # plain numbers are much faster
            chi2, dof, missing = float(chi2), float(dof), int(missing)
        few, bare = missing > least, dof == 0
        touching = found.details.get("at_bound", _NOWHERE)
        touching = bool(touching.any()) if one else touching.any(-1)
        if same is not None and self.needs_time:  # what is left out because it came before is not missing
            few, bare = few & ~same, bare & ~same
        # The bound, written out for speed. Without a reading to spare nothing can contradict.
        bad = (chi2 > dof + _TWICE + _ROOT * dof**0.5) & (not bare if one else ~bare)
        unfit = bad | bare | touching
        weight = 1.0 - (unfit if same is None else unfit | same)  # sums are over rows that fit by themselves
        fast, slow, free, freer = state.sums
        fast, slow = fast + weight * (chi2 - _FADE * fast), slow + weight * (chi2 - _FADE_SLOWLY * slow)
        free, freer = free + weight * (dof - _FADE * free), freer + weight * (dof - _FADE_SLOWLY * freer)
        bad = bad | (fast > free + _TWICE + _ROOT * free**0.5) | (slow > freer + _TWICE + _ROOT * freer**0.5)
        for k, case in state.cases.items() if state.cases else ():
            if state.row - case.row <= _WINDOW:
                again = case.failed - case.since >= _CALM and state.row - case.failed <= _CALM
                bad = np.array(bad)
                bad[k] |= again or found.chi2[k] > _limit(found.dof[k], _STRICT)
        bad = bad if same is None else bad & ~same
        row = (state.inner, u, known, t)
        frames = (*state.frames[1 - _FRAMES :], bits) if alone else bits[None]
        if not alone and state.steps:
            frames = np.concatenate([state.frames[1 - _FRAMES :], frames])
        now = tuple.__new__(MonitorState, (  # twice as fast as by its name
            inner, state.seed, state.row + (same is None or not same.all()), frames, old, since,
            (fast, slow, free, freer), (*state.recent[1 - _WINDOW :], row) if self.needs_time else (row,),
            (found.q, t), state.cases, found, state.steps + 1, still, state.stuck,
        ))  # fmt: skip
        pressed = touching & (chi2 > dof + 2.0 + 2.0 * dof**0.5)
        doubt = bad | few | pressed
        if same is None and stuck is None and not (doubt if one else doubt.any()):
            fine = (self._blank if one else self._nothing(found.q.shape[:-1]))["status"]
            if one:
                found.details["status"] = _BARE if bare else fine
            else:
                found.details["status"] = np.where(bare, _BARE, fine)
            return now, found
        return self._doubted(state, now, u, bad, pressed, same, few, bare, stuck)

    def _again(self, state: MonitorState, u: Array, bits: Any, again: Any, t: float) -> tuple[Any, Any, Any]:
        """Return which frames add nothing, how many rows in a row were old, and when the last new one came."""
        last = bits == state.frames[-1] if u.ndim == 1 else (bits == state.frames[-1]).all(-1)
        same = again & (last | self._jitters.any()) & ~np.isnan(u).all(-1)
        return same, np.where(same, state.old + 1, 0), np.where(same, state.since, t)

    def _without_old_cases(self, state: MonitorState, stuck: Any) -> MonitorState:
        """Forget alarms of robots of which another reading has begun or ceased to stay the same: it was the cause."""
        if stuck is None and state.stuck is None:
            return state
        none = np.zeros(1, dtype=bool)
        changed = (none if stuck is None else stuck) != (none if state.stuck is None else state.stuck)
        cases = {k: case for k, case in state.cases.items() if not np.any(changed[k] if k else changed)}
        return state._replace(cases=cases, stuck=stuck)

    def _still(self, state: MonitorState, u: Array, t: float, same: Any) -> Any:
        """Return for how many rows each reading has not changed and since when, or nothing if all of them change."""
        frame = state.frames[-1]
        before = np.frombuffer(frame) if isinstance(frame, bytes) else frame.view(np.float64)
        stays = u == before
        if state.still is None and not stays.any():
            return None
        rows, since = state.still or (np.zeros(u.shape, dtype=int), np.full(u.shape, t))
        stays = stays & self._jitters & ((rows > 0) | (state.steps % _LOOK == 0))
        found = np.where(stays, rows + 1, 0), np.where(stays & (rows > 0), since, t)
        if same is not None:  # a frame that is sent again says nothing new
            found = np.where(same[..., None], rows, found[0]), np.where(same[..., None], since, found[1])
        return found if found[0].any() else None

    def _stuck(self, still: Any, u: Array, t: float) -> tuple[Array, Array] | None:
        """Return which parts, and which of their readings, have not changed for too long, or nothing."""
        rows, since = still
        there, parts = np.isfinite(u)[..., None, :], self._without[1:]
        moves = there & ~((rows >= _FROZEN_ROWS) & (t - since > _FROZEN_S + 1e-9))[..., None, :]
        stuck = (there & parts).any(-1) & ~(moves & parts).any(-1)
        return (stuck, (stuck[..., None] & parts).any(-2)) if stuck.any() else None

    def _begun(self, state: MonitorState, u: Array) -> MonitorState:
        """Find out about the parts, and give every robot of a batch a state of its own."""
        s, robot = u.shape[-1], getattr(self.estimator, "robot", None)
        rows = getattr(self.estimator, "_rows", np.arange(s + 1))  # first readings of the sensors of a rod
        self.parts, resolution = np.repeat(np.arange(len(rows) - 1), np.diff(rows)), 0.0
        if robot is not None and robot.n_readings == s:
            self.parts, resolution = robot.parts, robot.resolution
        noise = getattr(self._fit, "noise", np.inf) if robot is None or robot.noise is None else robot.noise
        self._jitters = np.broadcast_to(noise >= np.asarray(resolution), (s,))
        self._without = np.arange(self.parts.max() + 2)[:, None] == self.parts + 1
        self._largest = int(np.bincount(self.parts).max())
        self._nothing(())
        self._spare = s - 1 if self.needs_time else s - self._unknowns
        q = state.inner.q
        if q is None or u.ndim == 1:
            return state
        q = np.broadcast_to(q[..., : self.n_q], (*np.broadcast_shapes(u.shape[:-1], q.shape[:-1]), self.n_q))
        return state._replace(inner=self.estimator.init(q, seed=state.seed))

    def stacked(self, details: Sequence[dict[str, Any]]) -> dict[str, Array]:
        """Return what was said of every row, with a leading dimension of time."""
        said = {name: np.repeat(x[None], len(details), axis=0) for name, x in self._blank.items()}
        said["status"] = np.array([row["status"] for row in details])
        for k, row in enumerate(details):
            if "suspects" in row:
                for name, values in said.items():
                    values[k] = row[name]
        return said

    def _nothing(self, batch: tuple[int, ...]) -> dict[str, Array]:
        """What is said of rows that fit; nobody changes it."""
        if not self._blank or self._blank["status"].shape != batch:
            n, s = len(self._without) - 1, self._without.shape[1]
            shapes = {"suspects": (*batch, n), "left_out": (*batch, s), "restarted": batch}
            flags = {name: np.zeros(shape, dtype=bool) for name, shape in shapes.items()}
            self._blank = {"status": np.zeros(batch, dtype=np.int8), "growth": np.ones(batch), **flags}
        return self._blank

    def _doubted(
        self,
        state: MonitorState,
        now: MonitorState,
        u: Array,
        bad: Any,
        pressed: Any,
        same: Any,
        few: Any,
        bare: Any,
        stuck: Any,
    ) -> tuple[MonitorState, Estimate]:
        """Look at rows that do not fit, that came before, or that have too few readings."""
        found, inner, cases, sums, t = now.last, now.inner, dict(state.cases), now.sums, now.good[1]
        batch = found.q.shape[:-1]
        said = {name: x.copy() for name, x in self._nothing(batch).items()}
        bad = np.broadcast_to(bad, batch)
        for k in map(tuple, np.argwhere(bad | pressed)):
            outside = self._beyond(k, now)
            if outside is not None:
                found = _put(found, k, outside)
                said["status"][k] = BEYOND_BOUNDS if bad[k] else CONSISTENT
            if outside is not None or not bad[k]:
                continue
            inner_k, found_k, cases[k], words = self._alarm(k, state, now)
            inner, found = _put(inner, k, inner_k), _put(found, k, found_k)
            for name, value in words.items():
                said[name][k] = value
            if "restarted" in words:
                sums = tuple(_put(np.broadcast_to(x, batch), k, np.float64(0.0)) for x in sums)
        since: Any = np.broadcast_to(now.since, batch)
        if same is not None:
            before, same = state.last.details, np.broadcast_to(same, batch)
            for name in SAID[:-1] if "suspects" in before else ():
                said[name][same] = before[name][same]
            if self.needs_time:
                found = _grown(found, 0.0, np.where(same, said["growth"], 1.0)[..., None, None])
            else:
                inner, found = _chosen(same, state.inner, inner), _chosen(same, state.last, found)
            same = same & self._jitters.any()
            said["status"][same & (now.old >= _FROZEN_ROWS - 1) & (t - since > _FROZEN_S + 1e-9)] = FROZEN
        for which, status in ((few, UNDETERMINED), (bare, UNCHECKED)):
            said["status"][np.broadcast_to(which, batch) & (said["status"] == CONSISTENT)] = status
        if stuck is not None:
            said["suspects"] |= stuck[0]
            said["left_out"] |= stuck[1]
            said["status"][stuck[0].any(-1) & (said["status"] == CONSISTENT)] = LEFT_OUT
        most = sums[3] + _SWOLLEN * (_limit(sums[3]) - sums[3])
        sums = (sums[0], np.minimum(sums[1], most) if batch else float(min(sums[1], most)), *sums[2:])
        fits = np.isin(said["status"], (*TRUSTED, BEYOND_BOUNDS))
        q = np.where(fits[..., None], found.q, state.good[0])
        found = found._replace(details=found.details | said)
        good = q, np.where(fits, t, state.good[1])
        now = now._replace(inner=inner, cases=cases, sums=sums, good=good, last=found)
        if same is not None and not self.needs_time:  # nothing else knows that the robot goes on
            moved = np.where(same, _SPEED * (t - since), 0.0)[..., None] * self._width
            found = _grown(found, moved[..., None] ** 2 * np.eye(self.n_q))
        return now, found

    def _beyond(self, k: tuple[int, ...], now: MonitorState) -> Estimate | None:
        """Return the estimate of a robot whose readings fit outside its bounds and not within, or nothing."""
        found, case = _pick(now.last, k), now.cases.get(k)
        blamed = case is not None and case.best > 0 and now.row - case.row <= _WINDOW
        if self._wider is None or blamed or not np.any(found.details.get("at_bound", False)):
            return None
        before, u, known, t = _row_of(now, k, -1)
        wider = self._wider.step(before, u, t, known=known)[1]
        inside = ((wider.q >= self._fit.lower[: self.n_q]) & (wider.q <= self._fit.upper[: self.n_q])).all()
        if inside or wider.details["at_bound"].any() or wider.chi2 > _limit(wider.dof):
            return None
        off = self._apart(wider.q, found.q)
        return _grown(found, np.outer(off, off), max(float(found.chi2 / found.dof), 1.0))

    def _alarm(
        self, k: tuple[int, ...], state: MonitorState, now: MonitorState
    ) -> tuple[Any, Estimate, Case, dict[str, Any]]:
        """Return state, estimate, what is known and what is said of one robot whose readings do not fit."""
        trial, batch, nan = _pick(now.last, k), now.last.q.shape[:-1], np.nan
        rows = [_row_of(now, k, j) for j in range(len(now.recent))]
        before, u, known, t = rows[-1]
        fast, slow, free, freer = (float(np.broadcast_to(x, batch)[k]) for x in now.sums)
        chi2, dof = float(trial.chi2), max(int(trial.dof), 1)
        odd = chi2 > _limit(dof, _STRICT)
        growth = max(chi2 / dof if odd else 1.0, fast / max(free, 1.0), slow / max(freer, 1.0))
        row, none, case = state.row, np.zeros(len(self._without)), state.cases.get(k)
        new = case is None or row - case.row > _FORGOTTEN
        if case is None or new:
            case = Case(None, none, none, none, row, row + _WINDOW, _WINDOW, row, row)
        began, lasts = not case.dof.any(), row - case.row <= _WINDOW
        good, good_t = (np.broadcast_to(x, (*batch, *np.shape(x)[len(batch) :]))[k] for x in state.good)
        spare = max(int(np.isfinite(u).sum()) - self._largest - self._unknowns, 1)
        strong = growth * dof * spare >= _STRONG or (lasts and case.best > 0)
        without, fits, bank = self._without, trial, case.bank if case.row == row - 1 else None
        against, freedom = case.against, case.dof
        # A filter that has followed a fault does not forget it at once: it starts some rows earlier.
        for x, v, kn, at in rows if began and not odd else rows[-1:]:
            x = x if bank is None else bank
            bank, fits = self.estimator.step(x, np.where(without, nan, v), at, known=kn)
            against = _KEEP * against + np.minimum(fits.chi2, _HEAVIEST)
            freedom = _KEEP * freedom + fits.dof
        case = case._replace(bank=bank, against=against, dof=freedom)
        ok = self._explain(case, u)
        proof = case.against[0] - case.against[1:][ok].min(initial=case.against[0])
        strong = strong or (case.since >= _FITTED and proof >= _PROOF)
        fresh = np.full(len(none), began and not self.needs_time)
        if odd and not ok.any() and (new or row >= case.look):
            case = case._replace(look=row + case.wait, wait=min(2 * case.wait, _LONGEST))
            states = self._elsewhere(before, good)
            there, again = self.estimator.step(states, np.where(without, nan, u)[:, None], t, known=known)
            explains = again.chi2 <= chdtri(np.maximum(again.dof, 1), _EXPLAINED)
            better = explains[0] & (again.chi2[0] < chi2 - _MUCH_BETTER)
            if better.any():
                away = np.abs(self._apart(again.q[0], np.nan_to_num(good)) / self._width).max(-1)
                j = 0, int(np.where(better, away, np.inf).argmin())
                case = case._replace(bank=None, against=none, dof=none, jump=none, row=row)
                words = {"status": INCONSISTENT, "restarted": True}
                return _pick(there, j), _pick(again, j), case, words
            for h in 1 + np.flatnonzero(explains[1:].any(-1)):
                j = h, again.chi2[h].argmin()
                share = 1.0 if new else 0.5  # what spoke against a fit that was lost counts half
                case.against[h] += share * (again.chi2[j] - case.against[h])
                case.dof[h] += share * (again.dof[j] - case.dof[h])
                fresh[h] = True
                case = case._replace(bank=_put(case.bank, (h,), _pick(there, j)))
                fits = _put(fits, (h,), _pick(again, j))
            ok = self._explain(case, u)
        case = case._replace(
            row=row, failed=row if odd or max(fast - _limit(free), slow - _limit(freer)) > 0 else case.failed
        )
        if not strong or not ok.any():
            inner, words = _pick(now.inner, k), {"status": INCONSISTENT, "growth": growth}
            if self.needs_time and strong and odd and row - case.since < _WINDOW:  # a glitch of all: wait
                inner, trial = self.estimator.step(before, np.full(len(u), np.nan), t, known=known)
                words, growth = {"status": INCONSISTENT, "left_out": np.isfinite(u)}, 1.0
            return inner, _grown(trial, 0.0, growth), case, words
        if fresh.any() and np.isfinite(good).all():  # how far the robot would have jumped
            moved = np.where(self._turns, 1e3, self._width * (_SPEED * (t - good_t) + 1e-6))
            away, C = self._apart(fits.q, good), fits.covariance + np.diag(moved**2)
            jump = (away * np.linalg.solve(C, away[..., None])[..., 0]).sum(-1)
            case = case._replace(jump=np.where(fresh, jump, case.jump))
        total = np.where(
            ok, (case.against + case.jump - _MUCH_BETTER * (np.arange(len(none)) == case.best))[1:], np.inf
        )
        left = total <= total.min() + _DECISIVE
        best = 1 + int(total.argmin())
        off = self._apart(fits.q[1:], fits.q[best])[left]  # what is not decided, the covariance holds
        found = _grown(_pick(fits, best), off.T @ off / len(off))
        enough = case.dof[best] / max(fits.dof[best], 1) * spare >= _ENOUGH
        status = LEFT_OUT if enough and left.sum() == 1 else INCONSISTENT
        words = {"status": status, "suspects": left & (enough and left.sum() <= 1 + (proof >= _PROOF_OF_TWO))}
        words["left_out"] = self._without[best] & np.isfinite(u)
        return _pick(case.bank, best), found, case._replace(best=best), words

    def _apart(self, q: Array, other: Array) -> Array:
        """Return the difference of configurations, of angles the shorter way round."""
        angles = getattr(self.estimator, "angles", None)
        return angles.difference(q, other) if angles else q - other

    def _explain(self, case: Case, u: Array) -> Array:
        """Which parts the rest fits without."""
        used = np.bincount(self.parts, np.isfinite(u)) > 0
        return (case.against <= chdtri(np.maximum(case.dof, 1), _FITS))[1:] & used & (used.sum() > 1)

    def _elsewhere(self, before: Any, good: Any) -> Any:
        """States to start anew from: where the robot was, and everywhere within the bounds."""
        if self._bounds is None:
            return self.estimator.init(np.zeros((1, self.n_q)))
        low, high = self._bounds
        points: Any = (x[: self.n_q] for x in (good, before.q) if np.ndim(x) and np.isfinite(x).all())
        starts = np.clip([*points, *evenly(low, high, _STARTS)], low, high)
        states, n, m = self.estimator.init(starts), self.n_q, np.size(before.q)
        if m > n:  # errors of sensors stay as they are known
            q, P = states.q.copy(), states.covariance.copy()
            q[:, n:], P[:, n:m, n:m] = before.q[n:], before.covariance[n:m, n:m]
            states = states._replace(q=q, covariance=P)
        return states


def _limit(dof: Any, x: float = _RARE) -> Any:
    """Chi-square that good readings exceed with a chance of less than exp(-x)."""
    return dof + 2 * x + 2 * x**0.5 * dof**0.5


def _each(function: Any, x: Any, *others: Any) -> Any:
    """Apply a function to all arrays and numbers of states or estimates of one kind."""
    if isinstance(x, dict):
        return {name: _each(function, y, *(other[name] for other in others)) for name, y in x.items()}
    if isinstance(x, tuple):
        return type(x)(*(_each(function, *values) for values in zip(x, *others, strict=True)))
    return function(x, *others)


def _pick(x: Any, k: Any) -> Any:
    """Return one robot of a batch of states or estimates."""
    return _each(lambda y: y[k] if isinstance(y, np.ndarray) else y, x)


def _row_of(now: MonitorState, k: tuple[int, ...], j: int) -> Any:
    """Return state before, readings, known coordinates and time of one of the last rows, of one robot."""
    before, *values, t = now.recent[j]
    batch = now.last.q.shape[:-1]
    u, known = (v if v is None else np.broadcast_to(v, (*batch, v.shape[-1]))[k] for v in values)
    return _pick(before, k), u, known, t


def _put(x: Any, k: Any, y: Any) -> Any:
    """Return a batch with one robot exchanged."""

    def exchanged(old: Any, new: Any) -> Any:
        if not isinstance(old, np.ndarray):
            return new
        old = old.copy()
        old[k] = new
        return old

    return y if k == () else _each(exchanged, x, y)


def _chosen(condition: Array, x: Any, y: Any) -> Any:
    """Return a batch of the robots of one where a condition holds, else of another."""

    def where(old: Any, new: Any) -> Any:
        return np.where(condition[(...,) + (None,) * (np.ndim(old) - condition.ndim)], new, old)[()]

    return _each(where, y, x)


def _grown(estimate: Estimate, added: Any, factor: Any = 1.0) -> Estimate:
    C: Any = estimate.covariance
    return estimate._replace(covariance=factor * C + added)
