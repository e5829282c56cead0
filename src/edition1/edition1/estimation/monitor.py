"""A monitor for any estimator: do its estimates explain the readings? If not, a new start, or the sensor at fault.

The test is that of :mod:`edition1.estimation.consistency`, with so small a chance that consistent data raise a stated
number of alarms in an hour. While there is an alarm, fits of the readings from several starts say whether a new start
explains them; if none does, fits that leave one sensor out say which sensor is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Generic, TypeVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edition1.errors import require
from edition1.estimation._leave_one_out import EXPLAINED, MUCH_BETTER, LeftOut, begun, followed, recovered
from edition1.estimation._window import Seen, frozen, limit, seen_by, verdict_on
from edition1.estimation.base import Estimate, Estimator
from edition1.estimation.consistency import WINDOW, Status, Verdict

_S = TypeVar("_S")

_ELSEWHERE = 0.02
"""A new start lies elsewhere if it differs by this share of the width of the starts. Nearer, the estimator lags."""
_USUAL_SPEED = 0.5
"""Standard deviation of a velocity, in widths of the starts per second."""
_FOLLOWED_HZ = 100.0
"""Readings per second, at most, that fits without each sensor follow."""
_FORGOTTEN_S = 10.0
"""What was found out about the sensors counts if an alarm comes back within this time [s]."""


@dataclass(frozen=True)
class _MonitorState(Generic[_S]):
    """State of the estimator, what was seen of late, and what is held of it."""

    inner: _S
    good: Tensor
    seed: int
    good_at: float | None = None
    steps: int = 0
    anew: int = 0
    anew_at: int = -WINDOW
    look_at: int = 0
    window: tuple[Seen, ...] = ()
    left: LeftOut | None = None
    left_at: tuple[int, float] = (0, 0.0)
    verdict: Verdict = field(default_factory=Verdict)


@dataclass(frozen=True)
class Monitored(Generic[_S]):
    r"""Estimator that tests whether its estimates explain the readings: one trajectory, no batch.

    Its estimates are those of ``estimator``, with ``status`` (:class:`~edition1.estimation.consistency.Status`),
    ``suspects`` (true for sensors that are named) and ``anew`` (how often it was started anew) in the diagnostics.
    While there is an alarm the covariance is multiplied by :math:`\sum \chi^2/\sum \nu`.

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
    sensors
        Readings of each sensor; each is one of its own when not given.
    unknowns
        Fewer readings than this do not determine the configuration: that is an alarm, too.

    Raises
    ------
    InputError
        If there is no start, or a rate or a time is not positive.

    Examples
    --------
    Three sensors read one coordinate; from the fourth reading on the last one has failed:

    >>> from edition1.estimation.base import track
    >>> from edition1.estimation.consistency import Status
    >>> from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
    >>> one = torch.ones(1, dtype=torch.float64)
    >>> fit = LevenbergMarquardt(lambda q: q.expand(*q.shape[:-1], 3), -one, one, noise_mt=0.01)
    >>> u = torch.full((24, 3), 0.5, dtype=torch.float64)
    >>> u[3:, 2] = 0.0
    >>> found = track(Monitored(fit, fit, 0 * one[None], rate_hz=40.0), u, 0 * one)
    >>> [Status(k).word for k in found.diagnostics["status"][2:4].tolist()]
    ['consistent', 'wrong']
    >>> found.diagnostics["suspects"][-1].tolist()
    [False, False, True]
    """

    estimator: Estimator[_S]
    solver: Estimator[Any]
    starts: Float[Tensor, "k n_q"]
    rate_hz: float
    false_alarms_per_hour: float = 0.1
    look_s: float = 0.25
    unknowns: int = 0
    sensors: Bool[Tensor, "sensors s"] | None = None

    def __post_init__(self) -> None:
        shape = f"shape {tuple(self.starts.shape)}"
        require(
            self.starts.ndim == 2 and len(self.starts),
            "starts",
            "Monitored",
            "at least one configuration, [k, n_q]",
            shape,
        )
        for name in ("rate_hz", "false_alarms_per_hour", "look_s"):
            require(getattr(self, name) > 0, name, "Monitored", "positive", getattr(self, name))

    def init(self, q0: Float[Tensor, "*batch n_q"], *, seed: int = 0) -> _MonitorState[_S]:
        """State of the estimator at ``q0``; nothing is held against it.

        Raises
        ------
        InputError
            For a batch, or as the estimator.
        """
        require(q0.ndim == 1, "q0", "Monitored", "one configuration, no batch", f"shape {tuple(q0.shape)}")
        return _MonitorState(self.estimator.init(q0, seed=seed), q0, seed)

    def step(
        self,
        state: _MonitorState[_S],
        u: Float[Tensor, " s"],
        t: float,
        *,
        mask: Tensor | None = None,
        known: Tensor | None = None,
    ) -> tuple[_MonitorState[_S], Estimate]:
        """Step the estimator, test what it says, and start it anew if that explains the readings much better."""
        inner, estimate = self.estimator.step(state.inner, u, t, mask=mask, known=known)
        seen = seen_by(u, ~torch.isnan(u) if mask is None else ~torch.isnan(u) & mask, estimate)
        state = self._tested((*state.window, seen)[-WINDOW:], state, inner, state.steps + 1)
        if state.verdict.status and state.steps >= state.look_at:
            state = replace(state, look_at=state.steps + max(1, round(self.look_s * self.rate_hz)))
            start, lags = self._start(state, estimate, known)
            if start is not None:
                again = self.estimator.init(start, seed=state.seed + state.anew + 1)
                inner, estimate = self.estimator.step(again, u, t, mask=mask, known=known)
                fresh = {"anew": state.anew + 1, "anew_at": state.steps, "verdict": Verdict(), "left": None}
                window = (seen_by(u, seen.use, estimate),)
                state = self._tested(window, replace(state, **fresh), inner, state.steps)
            elif lags:
                state = replace(
                    state, verdict=state.verdict._replace(cause="estimator", suspects=()), left=None
                )
            else:
                state = self._blamed(state, estimate.q, t, known)
        elif state.verdict.status and state.left is not None:
            state = self._followed(state, t, known)
        if state.verdict.status == Status.CONSISTENT and int(seen.use.sum()) < self.unknowns:
            state = replace(state, verdict=state.verdict._replace(status=Status.SUSPICIOUS, cause="too few"))
        elif state.verdict.status == Status.CONSISTENT or state.verdict.cause == "anew":
            state = replace(state, good=estimate.q, good_at=t, look_at=0)
        return state, _said(estimate, state, len(u) if self.sensors is None else len(self.sensors))

    def _tested(
        self, window: tuple[Seen, ...], state: _MonitorState[_S], inner: _S, steps: int
    ) -> _MonitorState[_S]:
        """State after a step with the verdict on a window; what was found out about an alarm that lasts is kept."""
        verdict = verdict_on(window, self.false_alarms_per_hour / (3600 * self.rate_hz))
        if verdict.status and state.verdict.status and state.verdict.cause != "too few":
            verdict = verdict._replace(cause=state.verdict.cause, suspects=state.verdict.suspects)
        elif not verdict.status and state.anew and steps - state.anew_at < WINDOW:
            verdict = verdict._replace(status=Status.SUSPICIOUS, cause="anew")
        return replace(state, inner=inner, steps=steps, window=window, verdict=verdict)

    def _start(
        self, state: _MonitorState[_S], estimate: Estimate, known: Tensor | None
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
        if float(((nearest - q).abs() / width).amax()) > _ELSEWHERE:
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

    def _sensors(self, seen: Seen) -> Tensor:
        return torch.eye(len(seen.u), dtype=torch.bool) if self.sensors is None else self.sensors

    def _starts(self, state: _MonitorState[_S], q: Tensor) -> Tensor:
        return torch.cat([state.good[None], q[None], self.starts.to(q)])

    def _blamed(
        self, state: _MonitorState[_S], q: Tensor, t: float, known: Tensor | None
    ) -> _MonitorState[_S]:
        """State with the fits without each sensor, begun, or looked after."""
        seen, starts = state.window[-1], self._starts(state, q)
        sensors = self._sensors(seen)
        old = state.left if t - state.left_at[1] < _FORGOTTEN_S else None
        if old is not None and state.left_at[0] >= state.steps - 2 * max(
            1, round(self.rate_hz / _FOLLOWED_HZ)
        ):
            left = recovered(self.solver, sensors, old, seen.u, seen.use, starts, known)
        else:
            moved = None if state.good_at is None else _USUAL_SPEED * (t - state.good_at) * self._width.to(q)
            before = None if moved is None else (state.good, moved)
            left = begun(self.solver, sensors, seen.u, seen.use, starts, known, before)
            left = left if old is None else left.added(old)
        return self._followed(replace(state, left=left), t, known, at_once=True)

    def _followed(
        self, state: _MonitorState[_S], t: float, known: Tensor | None, *, at_once: bool = False
    ) -> _MonitorState[_S]:
        """State after the fits without each sensor have followed the last reading."""
        assert state.left is not None
        if not at_once and state.steps % max(1, round(self.rate_hz / _FOLLOWED_HZ)):
            return state
        seen, n = state.window[-1], 1.0 + float(state.left.dof.max())
        weight = 1 - seen.systematic**2 + seen.systematic**2 / n
        sensors = self._sensors(seen)
        evidence = {"whole": seen.chi2, "weight": weight}
        left = followed(self.solver, sensors, state.left, seen.u, seen.use, known, **evidence)
        cause, suspects = left.wrong((seen.use & sensors).any(-1), (frozen(state.window) | ~sensors).all(-1))
        good = left.q[int(left.chi2.argmin())] if cause == "sensors" else state.good
        verdict = state.verdict._replace(cause=cause, suspects=suspects)
        return replace(state, left=left, left_at=(state.steps, t), verdict=verdict, good=good)


def _said(estimate: Estimate, state: _MonitorState[Any], sensors: int) -> Estimate:
    """Return the estimate with the verdict on it."""
    verdict, C = state.verdict, estimate.covariance
    said = _words(verdict.status, verdict.suspects, state.anew, sensors)
    if C is not None and verdict.status and verdict.excess > 1:
        C = verdict.excess**2 * C
    return Estimate(estimate.q, C, estimate.u_hat, {**estimate.diagnostics, **said})


@lru_cache(maxsize=64)
def _words(status: int, suspects: tuple[int, ...], anew: int, sensors: int) -> dict[str, Tensor]:
    flags = torch.zeros(sensors, dtype=torch.bool)
    flags[list(suspects)] = True
    return {"status": torch.tensor(status), "suspects": flags, "anew": torch.tensor(anew)}
