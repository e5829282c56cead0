r"""Do the estimates explain the readings? A monitor for any estimator, which also starts it anew where it is lost.

An estimator reports :math:`\chi^2`, its squared residuals in units of their variances, and the degrees of freedom
:math:`\nu` that they have (:class:`repro.estimation.base.Estimate`). Over the last :data:`WINDOW` readings

.. math:: \sum \chi^2 > F^{-1}_{\sum \nu}(1 - \alpha)

is an alarm, with :math:`F` the chi-square distribution and :math:`\alpha` so small that consistent data raise a stated
number of alarms in an hour. The residuals say what readings state that no configuration can (the *parity space* of
the sensors): an error that looks like another configuration is not seen, and with as many unknowns as readings none is.

While there is an alarm, fits of the readings from several starts say whether a new start explains them; if none does,
fits that leave one sensor out say which sensor is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Generic, NamedTuple, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from repro.errors import bad_input
from repro.estimation.base import Estimate, Estimator, usable
from repro.estimation.leave_one_out import EXPLAINED, MUCH_BETTER, LeftOut, begun, followed, limit, recovered

S = TypeVar("S")

CONSISTENT, SUSPICIOUS, WRONG = 0, 1, 2
STATUS = ("consistent", "suspicious", "wrong")
"""In words, for ``status`` in the diagnostics."""
WINDOW = 10
"""Readings that are tested together."""
WRONG_SHARE = 0.01
"""An alarm is *wrong*, not only *suspicious*, if chance explains it so many times more rarely."""
ELSEWHERE = 0.02
"""A new start lies elsewhere if it differs by this share of the width of the starts. Nearer, the estimator lags."""
USUAL_SPEED = 0.5
"""Standard deviation of a velocity, in widths of the starts per second."""
FOLLOWED_HZ = 100.0
"""Readings per second, at most, that fits without each sensor follow."""


class Verdict(NamedTuple):
    """What a monitor says at a moment.

    Attributes
    ----------
    status
        :data:`CONSISTENT`, :data:`SUSPICIOUS` or :data:`WRONG`.
    testable
        Whether there is redundancy: without it nothing can be told, and ``status`` means nothing.
    excess
        Root mean square of the residuals in units of their standard deviation: near one if all is well.
    cause
        ``""``; ``"sensors"``: one of ``suspects``, one or two; ``"several"``: no single sensor explains it;
        ``"untold"``: it cannot be told which, so far; ``"no redundancy"``: nor will it; ``"estimator"``: a fit
        nearby explains the readings; ``"anew"``: the estimator was started anew a moment ago.
    suspects
        Numbers of the sensors, from 0.
    """

    status: int = CONSISTENT
    testable: bool = False
    excess: float = 0.0
    cause: str = ""
    suspects: tuple[int, ...] = ()


class _Seen(NamedTuple):
    """A reading, and how its estimate explains it."""

    u: Tensor
    use: Tensor
    chi2: float
    dof: int
    systematic: float


@dataclass(frozen=True)
class MonitorState(Generic[S]):
    """State of the estimator, what was seen of late, and what is held of it."""

    inner: S
    good: Tensor
    seed: int
    good_at: float | None = None
    steps: int = 0
    anew: int = 0
    anew_at: int = -WINDOW
    look_at: int = 0
    window: tuple[_Seen, ...] = ()
    left: LeftOut | None = None
    verdict: Verdict = field(default_factory=Verdict)


@dataclass(frozen=True)
class Monitored(Generic[S]):
    r"""Estimator that tests whether its estimates explain the readings: one trajectory, no batch.

    Its estimates are those of ``estimator``, with ``status`` (:data:`STATUS`), ``suspects`` (true for sensors that
    are named) and ``anew`` (how often it was started anew) in the diagnostics. While there is an alarm the covariance
    is multiplied by :math:`\sum \chi^2/\sum \nu`.

    Parameters
    ----------
    estimator
        Reports ``chi2`` and ``dof``, and may report ``systematic``: the share of the variance of a residual that does
        not change from one reading to the next.
    solver
        Least squares without memory, batched, that reports the same: for other starts, and without a sensor.
    starts
        Configurations ``[k, n_q]`` from which it looks for a new start.
    rate_hz
        Readings per second.
    false_alarms_per_hour
        At most, of consistent data.
    look_s
        Time between two looks for what is wrong, while there is an alarm [s].

    Raises
    ------
    InputError
        If there is no start, or a rate or a time is not positive.

    Examples
    --------
    Three sensors read one coordinate; from the fourth reading on the last one has failed:

    >>> from repro.estimation.base import track
    >>> from repro.estimation.levenberg_marquardt import LevenbergMarquardt
    >>> one = torch.ones(1, dtype=torch.float64)
    >>> fit = LevenbergMarquardt(lambda q: q.expand(*q.shape[:-1], 3), -one, one, noise_mt=0.01)
    >>> u = torch.full((8, 3), 0.5, dtype=torch.float64)
    >>> u[3:, 2] = 0.0
    >>> found = track(Monitored(fit, fit, 0 * one[None], rate_hz=40.0), u, 0 * one)
    >>> [STATUS[k] for k in found.diagnostics["status"][2:4].tolist()], found.diagnostics["suspects"][-1].tolist()
    (['consistent', 'wrong'], [False, False, True])
    """

    estimator: Estimator[S]
    solver: Estimator[Any]
    starts: Float[Tensor, "k n_q"]
    rate_hz: float
    false_alarms_per_hour: float = 0.1
    look_s: float = 0.25

    def __post_init__(self) -> None:
        if not len(self.starts):
            raise bad_input("starts", "Monitored", "at least one configuration", "none")
        for name in ("rate_hz", "false_alarms_per_hour", "look_s"):
            if not getattr(self, name) > 0:
                raise bad_input(name, "Monitored", "positive", getattr(self, name))

    def init(self, q0: Float[Tensor, " n_q"], *, seed: int = 0) -> MonitorState[S]:
        """State of the estimator at ``q0``; nothing is held against it.

        Raises
        ------
        InputError
            For a batch, or as the estimator.
        """
        if q0.ndim != 1:
            raise bad_input("q0", "Monitored", "one configuration, no batch", f"shape {tuple(q0.shape)}")
        return MonitorState(self.estimator.init(q0, seed=seed), q0, seed)

    def step(
        self,
        state: MonitorState[S],
        u: Float[Tensor, " s"],
        t: float,
        *,
        mask: Tensor | None = None,
        known: Tensor | None = None,
    ) -> tuple[MonitorState[S], Estimate]:
        """Step the estimator, test what it says, and start it anew if that explains the readings much better."""
        inner, estimate = self.estimator.step(state.inner, u, t, mask=mask, known=known)
        use = usable(u, mask, "Monitored")
        state = replace(state, inner=inner, steps=state.steps + 1)
        state = self._tested((*state.window, _seen(u, use, estimate))[-WINDOW:], state)
        if state.verdict.status and state.steps >= state.look_at:
            state = replace(state, look_at=state.steps + max(1, round(self.look_s * self.rate_hz)))
            start, lags = self._start(state, estimate, known)
            if start is not None:
                again = self.estimator.init(start, seed=state.seed + state.anew + 1)
                inner, estimate = self.estimator.step(again, u, t, mask=mask, known=known)
                fresh = {"anew": state.anew + 1, "anew_at": state.steps, "verdict": Verdict()}
                state = self._tested((_seen(u, use, estimate),), replace(state, inner=inner, **fresh))
            elif lags:
                state = replace(state, verdict=state.verdict._replace(cause="estimator", suspects=()), left=None)
            else:
                state = self._blamed(state, estimate.q, t, known)
        elif state.left is not None:
            state = self._followed(state, known)
        if state.verdict.status == CONSISTENT or state.verdict.cause == "anew":
            state = replace(state, good=estimate.q, good_at=t, left=None, look_at=0)
        return state, _said(estimate, state)

    def _tested(self, window: tuple[_Seen, ...], state: MonitorState[S]) -> MonitorState[S]:
        """State with the verdict on a window; what was found out before about an alarm that lasts is kept."""
        chi2, dof = sum(seen.chi2 for seen in window), sum(seen.dof for seen in window)
        if not dof:
            return replace(state, window=window, verdict=Verdict())
        # Errors that last are as good as one reading, however many there are.
        last = sum(seen.systematic for seen in window) / len(window)
        independent = 1 / (last**2 + (1 - last**2) / len(window))
        free = dof * independent / len(window)
        alpha = self.false_alarms_per_hour / (3600 * self.rate_hz)
        free = round(free, 2)
        value = chi2 / dof * free
        status = (value > limit(alpha, free)) + (value > limit(WRONG_SHARE * alpha, free))
        verdict = Verdict(status, True, (chi2 / dof) ** 0.5)
        if status and state.verdict.status:
            verdict = verdict._replace(cause=state.verdict.cause, suspects=state.verdict.suspects)
        elif not status and state.anew and state.steps - state.anew_at < WINDOW:
            verdict = verdict._replace(status=SUSPICIOUS, cause="anew")
        return replace(state, window=window, verdict=verdict)

    def _start(
        self, state: MonitorState[S], estimate: Estimate, known: Tensor | None
    ) -> tuple[Tensor | None, bool]:
        """Where to start anew, if that explains the last reading, or whether the estimator only lags behind it."""
        seen, q = state.window[-1], estimate.q
        starts = self._starts(state, q)
        u, use = (x.expand(len(starts), -1) for x in (seen.u, seen.use))
        _, found = self.solver.step(self.solver.init(starts, seed=0), u, 0.0, mask=use, known=known)
        chi2, dof = found.diagnostics["chi2"], found.diagnostics["dof"]
        explains = [c <= limit(EXPLAINED, d) for c, d in zip(chi2.tolist(), dof.tolist(), strict=True)]
        better = torch.tensor(explains) & (chi2 < seen.chi2 - MUCH_BETTER)
        if not bool(better.any()):
            return None, False
        width = self._width.to(q)
        nearest = found.q[better]
        nearest = nearest[((nearest - state.good).abs() / width).amax(-1).argmin()]
        if float(((nearest - q).abs() / width).amax()) > ELSEWHERE:
            return nearest, False
        # The estimate itself explains the reading, if nothing but the past of the estimator is against it.
        _, here = self.solver.step(self.solver.init(q, seed=0), seen.u, 0.0, mask=seen.use, known=q)
        here = here.diagnostics
        memory = float(here["chi2"]) <= limit(EXPLAINED, int(here["dof"]))
        return (nearest, False) if memory else (None, True)

    @cached_property
    def _width(self) -> Tensor:
        width = self.starts.amax(0) - self.starts.amin(0)
        return torch.where(width > 0, width, 1.0)

    def _starts(self, state: MonitorState[S], q: Tensor) -> Tensor:
        return torch.cat([state.good[None], q[None], self.starts.to(q)])

    def _blamed(
        self, state: MonitorState[S], q: Tensor, t: float, known: Tensor | None
    ) -> MonitorState[S]:
        """State with the fits without each sensor, begun, or looked after."""
        seen, starts = state.window[-1], self._starts(state, q)
        if state.left is None:
            moved = None if state.good_at is None else USUAL_SPEED * (t - state.good_at) * self._width.to(q)
            before = None if moved is None else (state.good, moved)
            left = begun(self.solver, seen.u, seen.use, starts, known, before)
        else:
            left = recovered(self.solver, state.left, seen.u, seen.use, starts, known)
        return self._followed(replace(state, left=left), known, at_once=True)

    def _followed(
        self, state: MonitorState[S], known: Tensor | None, *, at_once: bool = False
    ) -> MonitorState[S]:
        """State after the fits without each sensor have followed the last reading."""
        assert state.left is not None
        if not at_once and state.steps % max(1, round(self.rate_hz / FOLLOWED_HZ)):
            return state
        seen, n = state.window[-1], 1.0 + float(state.left.dof.max())
        weight = 1 - seen.systematic**2 + seen.systematic**2 / n
        left = followed(self.solver, state.left, seen.u, seen.use, known, weight=weight)
        cause, suspects = left.wrong(seen.use, _frozen(state.window))
        good = left.q[int(left.chi2.argmin())] if cause == "sensors" else state.good
        verdict = state.verdict._replace(cause=cause, suspects=suspects)
        return replace(state, left=left, verdict=verdict, good=good)


def _frozen(window: tuple[_Seen, ...]) -> Tensor:
    """Sensors whose readings in a whole window are the same to the last digit; none if all of them are."""
    u = torch.stack([seen.u for seen in window])
    same = (u == u[0]).all(0)
    return same & (len(window) == WINDOW) & ~same.all()


def _seen(u: Tensor, use: Tensor, estimate: Estimate) -> _Seen:
    said = estimate.diagnostics
    systematic = said.get("systematic")
    share = 0.0 if systematic is None else float(systematic)
    return _Seen(u, use, float(said["chi2"]), int(said["dof"]), share)


def _said(estimate: Estimate, state: MonitorState[Any]) -> Estimate:
    """Return the estimate with the verdict on it."""
    verdict, C = state.verdict, estimate.covariance
    suspects = torch.zeros(state.window[-1].u.shape[-1], dtype=torch.bool)
    suspects[list(verdict.suspects)] = True
    said = {"status": torch.tensor(verdict.status), "suspects": suspects, "anew": torch.tensor(state.anew)}
    if C is not None and verdict.status and verdict.excess > 1:
        C = verdict.excess**2 * C
    return replace(estimate, covariance=C, diagnostics={**estimate.diagnostics, **said})
