r"""A monitor asks of every row whether the readings fit the estimate.

Every row is tried with all its readings. With its squared residuals :math:`\chi^2` and their degrees of freedom
:math:`\nu` it does not fit if :math:`\chi^2 > \ell(\nu)`, where

.. math:: \ell(\nu) = \nu + 2\sqrt{\nu x} + 2x, \qquad
   P\Bigl(\sum_i w_i z_i^2 > \ell\bigl(\textstyle\sum_i w_i\bigr)\Bigr) \le e^{-x}

for standard normal :math:`z_i` and weights :math:`0 \le w_i \le 1` (Laurent and Massart 2000, lemma 1). So the bound
also holds for fading sums over about ten and about a hundred past rows, which show small errors that last.

Frames that came before, and readings that stay the same, are noticed bit for bit. When a row does not fit, the part
at fault is searched for. If none is found, the covariance grows by :math:`\chi^2/\nu`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from repro.common import Array
from repro.estimators.base import Estimate, Watched, chosen, grown, incoming, member, with_member
from repro.estimators.suspects import SPEED, WINDOW, Alarm, Case, Parts, Row, Search, Verdict

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
"""The bound of :func:`limit` is written out where every row passes."""
_FADE, _FADE_SLOWLY = 0.1, 0.01
"""What every row takes from the sums of the rows before it."""
_SWOLLEN = 1.1
"""Most that the slow sum is beyond what it holds on average, in units of its bound, so that an alarm ends soon."""
_CALM = 2
"""Rows that fit before all readings count again."""
_FROZEN_S, _FROZEN_ROWS = 0.5, 20
_FRAMES = 16
"""So many of the last frames are remembered: a board whose bus hangs may send its old buffers in turn."""
_LOOK = 8
"""Every so many rows we look whether a single reading stays the same."""
_NOWHERE = np.zeros(1, dtype=bool)
_FINE, _BARE = np.array(CONSISTENT, dtype=np.int8), np.array(UNCHECKED, dtype=np.int8)
_WIDER = 0.5
"""How far beyond its bounds a robot is looked for that touches one [widths of the bounds]."""
_made = tuple.__new__
"""Makes a named tuple twice as fast as its own name."""


Number: TypeAlias = float | Array
Flag: TypeAlias = bool | np.bool_ | Array
"""A number and a flag of one robot, or of each robot of a batch."""


def limit(dof: Any, x: float = _RARE) -> Any:
    """Return the chi-square that good readings exceed with a chance of less than exp(-x)."""
    return dof + 2 * x + 2 * x**0.5 * dof**0.5


class Frames(NamedTuple):
    """The last frames, and what the newest has in common with those before it."""

    bits: tuple[bytes, ...] | Array = ()
    """The last frames, bit for bit; the newest at the end."""
    same: Any = None
    """Whether one of the last frames came again, or nothing if none did."""
    old: int | Array = 0
    """How many rows in a row held one of the last frames, and the time of the last new one [s]."""
    since: Number = 0.0
    still: tuple[Array, Array] | None = None
    """How many rows a reading has not changed, and since when [s]; nothing while all of them change."""
    stuck: tuple[Array, Array] | None = None
    """Which parts, and which readings, stay the same for too long, if any."""


class Judgement(NamedTuple):
    """How readings fit their estimate."""

    bad: Flag
    """Whether the row, or a sum of rows, is above the bound."""
    few: Flag
    """Whether there are fewer readings than unknowns."""
    bare: Flag
    """Whether the fit uses up all readings."""
    pressed: Flag
    """Whether it fits worse than usual while it touches a bound of the robot."""
    sums: tuple[Any, ...]


class MonitorState(NamedTuple):
    """The state of the estimator, and what the monitor remembers."""

    inner: Any
    seed: int
    row: int = 0
    frames: Frames = Frames()
    sums: tuple[Any, ...] = (0.0, 0.0, 0.0, 0.0)
    """Sums of chi-square over ten rows and a hundred, and of their degrees of freedom."""
    recent: tuple[Row, ...] = ()
    good: tuple[Array | float, Number] = (np.nan, 0.0)
    """Configuration and time of the last row that fitted."""
    cases: Mapping[tuple[int, ...], Case] = MappingProxyType({})
    """What is known of each robot's alarm."""
    last: Any = None
    steps: int = 0


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

    def __init__(self, estimator: Watched) -> None:
        self.estimator, self._owner = estimator, type(estimator).__name__
        self.n_q, self.needs_time = estimator.n_q, estimator.needs_time
        self._wider = estimator.widened(_WIDER)
        self._blank: dict[str, Any] = {}

    def init(self, q0: ArrayLike | None = None, seed: int = 0) -> MonitorState:
        """Return the state of the estimator at ``q0``; nothing is held against any part."""
        return MonitorState(self.estimator.init(q0, seed=seed), seed)

    def step(
        self,
        state: MonitorState,
        u: ArrayLike,
        t: float = 0.0,
        mask: ArrayLike | None = None,
        known: ArrayLike | None = None,
    ) -> tuple[MonitorState, Estimate]:
        """Step the estimator, and say whether its estimate explains the readings.

        Raises
        ------
        InputError
            As the estimator.
        """
        if mask is not None or type(u) is not np.ndarray or u.dtype.char != "d":
            u = incoming(u, mask, self._owner)
        if not state.steps:
            state = self._begun(state, u)
        frames = self._compared(state, u, t, known)
        same, stuck = frames.same, frames.stuck
        if stuck is not None:
            u = np.where(stuck[1], np.nan, u)
        if stuck is not None or state.frames.stuck is not None:
            state = self._without_old_cases(state, stuck)
        used = u
        if same is not None and self.needs_time:  # a filter knows it already
            used = np.where(same[..., None], np.nan, u)
        inner, found = self.estimator.step(state.inner, used, t, known=known)
        test = self._tested(state, found, same, known)
        bad, few, bare, pressed, sums = test
        row = _made(Row, (state.inner, u, known, t))
        now = _made(MonitorState, (
            inner, state.seed, state.row + (same is None or not same.all()), frames, sums,
            (*state.recent[1 - WINDOW :], row) if self.needs_time else (row,), (found.q, t), state.cases, found,
            state.steps + 1,
        ))  # fmt: skip
        doubt = bad | few | pressed
        if same is None and stuck is None and not (doubt if type(doubt) is bool else doubt.any()):
            found.details["status"] = (
                (_BARE if bare else _FINE) if type(bare) is bool else np.where(bare, _BARE, _FINE)
            )
            return now, found
        return self._doubted(state, now, Judgement(*test))

    def _tested(
        self, state: MonitorState, found: Estimate, same: Any, known: ArrayLike | None
    ) -> tuple[Any, ...]:
        """Hold chi-square against its bound: that of the row, and fading sums over the rows before.

        Return what a :class:`Judgement` holds, which is made for rows in doubt only.
        """
        spare = self._spare if known is None else self._spare + np.isfinite(known).sum(-1)
        chi2, dof, missing = found.chi2, found.dof, found.missing
        touching = found.details.get("at_bound", _NOWHERE)
        if found.q.ndim == 1:  # plain numbers are much faster
            chi2, dof, missing, touching = float(chi2), float(dof), int(missing), True in touching.tolist()
        else:
            touching = touching.any(-1)
        few, bare = missing > spare, dof == 0
        if same is not None and self.needs_time:  # what is left out because it came before is not missing
            few, bare = few & ~same, bare & ~same
        # Without a reading to spare nothing can contradict.
        root = dof**0.5
        bad = (chi2 > dof + _TWICE + _ROOT * root) & (dof > 0)
        unfit = bad | bare | touching
        weight = 1.0 - (unfit if same is None else unfit | same)  # sums are over rows that fit by themselves
        fast, slow, free, freer = state.sums
        fast, slow = fast + weight * (chi2 - _FADE * fast), slow + weight * (chi2 - _FADE_SLOWLY * slow)
        free, freer = free + weight * (dof - _FADE * free), freer + weight * (dof - _FADE_SLOWLY * freer)
        bad = bad | (fast > free + _TWICE + _ROOT * free**0.5) | (slow > freer + _TWICE + _ROOT * freer**0.5)
        if state.cases:
            bad = self._not_calm(bad, state, found)
        pressed = touching is not False and touching & (chi2 > dof + 2.0 + 2.0 * root)
        bad = bad if same is None else bad & ~same
        return bad, few, bare, pressed, (fast, slow, free, freer)

    def _not_calm(self, bad: Any, state: MonitorState, found: Estimate) -> Array:
        """Return rows that do not fit, with those soon after an alarm that do not fit well."""
        bad = np.array(bad)
        for k, case in state.cases.items():
            if state.row - case.row <= WINDOW:
                again = case.failed - case.since >= _CALM and state.row - case.failed <= _CALM
                bad[k] |= again or found.chi2[k] > limit(found.dof[k], _STRICT)
        return bad

    def _compared(self, state: MonitorState, u: Array, t: float, known: ArrayLike | None) -> Frames:
        """Compare a frame with those before it, and now and then each reading with the last one."""
        alone, last, same, old, since = u.ndim == 1, state.frames, None, 0, t
        bits: Any = u.tobytes() if alone else u.view(np.int64)
        if not state.steps:
            return Frames((bits,) if alone else bits[None], None, 0, t)
        if known is None:
            again: Any = bits in last.bits if alone else (bits == last.bits).all(-1).any(0)
            if again if alone else again.any():
                same, old, since = self._again(last, u, bits, again, t)
        still, stuck = last.still, None
        if still is not None or state.steps % _LOOK == 0:
            still = self._still(state, u, t, same)
            stuck = None if still is None else self._stuck(still, u, t)
        before: Any = last.bits[1 - _FRAMES :]
        frames = (*before, bits) if alone else np.concatenate([before, bits[None]])
        return _made(Frames, (frames, same, old, since, still, stuck))

    def _again(
        self, last: Frames, u: Array, bits: bytes | Array, again: Any, t: float
    ) -> tuple[Array, Array, Array]:
        """Return which frames add nothing, how many rows in a row were old, and when the last new one came."""
        newest = bits == last.bits[-1] if u.ndim == 1 else np.all(bits == last.bits[-1], axis=-1)
        same = again & (newest | self._parts.jitters.any()) & ~np.isnan(u).all(-1)
        return same, np.where(same, last.old + 1, 0), np.where(same, last.since, t)

    def _without_old_cases(self, state: MonitorState, stuck: tuple[Array, Array] | None) -> MonitorState:
        """Forget alarms of robots of which another reading has begun or ceased to stay the same: it was the cause."""
        now, before = (np.zeros(1, dtype=bool) if x is None else x[1] for x in (stuck, state.frames.stuck))
        changed = now != before
        cases = {k: case for k, case in state.cases.items() if not np.any(changed[k] if k else changed)}
        return state._replace(cases=cases)

    def _still(
        self, state: MonitorState, u: Array, t: float, same: Flag | None
    ) -> tuple[Array, Array] | None:
        """Return for how many rows each reading has not changed and since when, or nothing if all of them change."""
        last, frame = state.frames.still, state.frames.bits[-1]
        stays = u == (np.frombuffer(frame) if isinstance(frame, bytes) else frame.view(np.float64))
        if last is None and not np.count_nonzero(stays):  # much faster than any
            return None
        rows, since = last or (np.zeros(u.shape, dtype=int), np.full(u.shape, t))
        stays = stays & self._parts.jitters & ((rows > 0) | (state.steps % _LOOK == 0))
        found = np.where(stays, rows + 1, 0), np.where(stays & (rows > 0), since, t)
        if same is not None:  # a frame that is sent again says nothing new
            again = np.asarray(same)[..., None]
            found = np.where(again, rows, found[0]), np.where(again, since, found[1])
        return found if found[0].any() else None

    def _stuck(self, still: tuple[Array, Array], u: Array, t: float) -> tuple[Array, Array] | None:
        """Return which parts, and which of their readings, have not changed for too long, or nothing."""
        rows, since = still
        there, parts = np.isfinite(u)[..., None, :], self._parts.without[1:]
        moves = there & ~((rows >= _FROZEN_ROWS) & (t - since > _FROZEN_S + 1e-9))[..., None, :]
        stuck = (there & parts).any(-1) & ~(moves & parts).any(-1)
        return (stuck, (stuck[..., None] & parts).any(-2)) if stuck.any() else None

    def _begun(self, state: MonitorState, u: Array) -> MonitorState:
        """Find out about the parts, and give every robot of a batch a state of its own."""
        self._parts = Parts(self.estimator, u.shape[-1])
        self._spare = u.shape[-1] - (1 if self.needs_time else self._parts.unknowns)
        q = state.inner.q
        if q is None or u.ndim == 1:
            return state
        q = np.broadcast_to(q[..., : self.n_q], (*np.broadcast_shapes(u.shape[:-1], q.shape[:-1]), self.n_q))
        return state._replace(inner=self.estimator.init(q, seed=state.seed))

    def stacked(self, details: Sequence[dict[str, Any]]) -> dict[str, Array]:
        """Return what was said of every row, with a leading dimension of time."""
        blank = self._nothing(details[0]["status"].shape)
        said = {name: np.repeat(x[None], len(details), axis=0) for name, x in blank.items()}
        said["status"] = np.array([row["status"] for row in details])
        for k, row in enumerate(details):
            if "suspects" in row:
                for name, values in said.items():
                    values[k] = row[name]
        return said

    def _nothing(self, batch: tuple[int, ...]) -> dict[str, Array]:
        """What is said of rows that fit; nobody changes it."""
        if not self._blank or self._blank["status"].shape != batch:
            n, s = len(self._parts.without) - 1, self._parts.without.shape[1]
            shapes = {"suspects": (*batch, n), "left_out": (*batch, s), "restarted": batch}
            flags = {name: np.zeros(shape, dtype=bool) for name, shape in shapes.items()}
            self._blank = {"status": np.zeros(batch, dtype=np.int8), "growth": np.ones(batch), **flags}
        return self._blank

    def _doubted(
        self, state: MonitorState, now: MonitorState, test: Judgement
    ) -> tuple[MonitorState, Estimate]:
        """Look at rows that do not fit, that came before, or that have too few readings."""
        batch, t, same, stuck = now.last.q.shape[:-1], now.good[1], now.frames.same, now.frames.stuck
        said = {name: x.copy() for name, x in self._nothing(batch).items()}
        if np.any(test.bad | test.pressed):
            now = self._searched(state, now, test, said)
        if same is not None:
            now = self._repeated(state, now, same, said)
        for which, status in ((test.few, UNDETERMINED), (test.bare, UNCHECKED)):
            said["status"][np.broadcast_to(which, batch) & (said["status"] == CONSISTENT)] = status
        if stuck is not None:
            parts, readings = stuck
            said["suspects"] |= parts
            said["left_out"] |= readings
            said["status"][parts.any(-1) & (said["status"] == CONSISTENT)] = LEFT_OUT
        fits = np.isin(said["status"], (*TRUSTED, BEYOND_BOUNDS))
        good = np.where(fits[..., None], now.last.q, state.good[0]), np.where(fits, t, state.good[1])
        found = now.last._replace(details=now.last.details | said)
        now = now._replace(sums=_subsided(now.sums, batch), good=good, last=found)
        if same is not None and not self.needs_time:  # nothing else knows that the robot goes on
            away = np.where(
                np.broadcast_to(same, batch) & self._parts.jitters.any(), SPEED * (t - now.frames.since), 0.0
            )
            moved = away[..., None] * self._parts.width
            found = grown(found, moved[..., None] ** 2 * np.eye(self.n_q))
        return now, found

    def _searched(
        self, state: MonitorState, now: MonitorState, test: Judgement, said: dict[str, Array]
    ) -> MonitorState:
        """Return the state after a search for each robot whose row does not fit, and write what is said of it."""
        inner, found, sums, cases = now.inner, now.last, now.sums, dict(state.cases)
        batch = found.q.shape[:-1]
        bad = np.broadcast_to(test.bad, batch)
        for k in map(tuple, np.argwhere(bad | test.pressed)):
            alarm, case = self._alarm(k, state, now), cases.get(k)
            blamed = case is not None and case.best > 0 and now.row - case.row <= WINDOW
            outside = None if blamed else self._beyond(alarm)
            if outside is not None:
                found = with_member(found, k, outside)
                said["status"][k] = BEYOND_BOUNDS if bad[k] else CONSISTENT
            elif bad[k]:
                verdict = Search(self._parts, alarm, case).verdict()
                inner, found = with_member(inner, k, verdict.state), with_member(found, k, verdict.estimate)
                cases[k] = verdict.case
                _say(verdict, k, said)
                if verdict.restarted:
                    zero = np.float64(0.0)
                    sums = tuple(with_member(np.broadcast_to(x, batch), k, zero) for x in sums)
        return now._replace(inner=inner, last=found, sums=sums, cases=cases)

    def _alarm(self, k: tuple[int, ...], state: MonitorState, now: MonitorState) -> Alarm:
        """Return what a search is told of one robot."""
        trial, batch = member(now.last, k), now.last.q.shape[:-1]
        fast, slow, free, freer = (float(np.broadcast_to(x, batch)[k]) for x in now.sums)
        chi2, dof = float(trial.chi2), max(int(trial.dof), 1)
        odd = chi2 > limit(dof, _STRICT)
        growth = max(chi2 / dof if odd else 1.0, fast / max(free, 1.0), slow / max(freer, 1.0))
        q, t = (np.broadcast_to(x, (*batch, *np.shape(x)[len(batch) :]))[k] for x in state.good)
        lasting = max(fast - limit(free), slow - limit(freer)) > 0
        rows = [_row_of(row, k, batch) for row in now.recent]
        return Alarm(state.row, rows, member(now.inner, k), trial, (q, t), odd, lasting, growth)

    def _beyond(self, alarm: Alarm) -> Estimate | None:
        """Return the estimate of a robot whose readings fit outside its bounds and not within, or nothing."""
        found, row, bounds = alarm.trial, alarm.rows[-1], self._parts.bounds
        if self._wider is None or bounds is None or not np.any(found.details.get("at_bound", False)):
            return None
        wider = self._wider.step(row.before, row.u, row.t, known=row.known)[1]
        inside = ((wider.q >= bounds[0]) & (wider.q <= bounds[1])).all()
        if inside or wider.details["at_bound"].any() or wider.chi2 > limit(wider.dof):
            return None
        off = self._parts.apart(wider.q, found.q)
        return grown(found, np.outer(off, off), max(float(found.chi2 / found.dof), 1.0))

    def _repeated(
        self, state: MonitorState, now: MonitorState, same: Any, said: dict[str, Array]
    ) -> MonitorState:
        """Return the state where frames that came before add nothing, and say where the board repeats itself."""
        batch, before, last = now.last.q.shape[:-1], state.last.details, now.last
        inner, since = now.inner, np.broadcast_to(now.frames.since, now.last.q.shape[:-1])
        same = np.broadcast_to(same, batch)
        for name in SAID[:-1] if "suspects" in before else ():
            said[name][same] = before[name][same]
        if self.needs_time:
            last = grown(last, 0.0, np.where(same, said["growth"], 1.0)[..., None, None])
        else:
            inner, last = chosen(same, state.inner, inner), chosen(same, state.last, last)
        silent = (now.frames.old >= _FROZEN_ROWS - 1) & (now.good[1] - since > _FROZEN_S + 1e-9)
        said["status"][same & self._parts.jitters.any() & silent] = FROZEN
        return now._replace(inner=inner, last=last)


def _row_of(row: Row, k: tuple[int, ...], batch: tuple[int, ...]) -> Row:
    """Return one of the last rows, of one robot."""
    u, known = (
        None if x is None else np.broadcast_to(x, (*batch, np.shape(x)[-1]))[k] for x in (row.u, row.known)
    )
    assert u is not None
    return Row(member(row.before, k), u, known, row.t)


def _say(verdict: Verdict, k: tuple[int, ...], said: dict[str, Array]) -> None:
    """Write what a search has found of one robot."""
    said["status"][k] = LEFT_OUT if verdict.decided else INCONSISTENT
    for name in SAID[1:]:
        said[name][k] = verdict._asdict()[name]


def _subsided(sums: tuple[Any, ...], batch: tuple[int, ...]) -> tuple[Any, ...]:
    """Return the sums, the slow one not far beyond its bound, so that an alarm ends soon after its cause."""
    fast, slow, free, freer = sums
    most = freer + _SWOLLEN * (limit(freer) - freer)
    return fast, np.minimum(slow, most) if batch else float(min(slow, most)), free, freer
