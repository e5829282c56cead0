"""Which sensor is wrong? Fits that each leave one out follow the readings, and collect what speaks against them."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edition1.estimation._window import limit
from edition1.estimation.base import Estimate, Estimator

EXPLAINED = 1e-3
"""A fit explains a reading unless chance exceeds its residual more rarely than this."""
_EXCLUDED = 3e-3
"""A sensor is not the one that is wrong if chance exceeds the residuals without it more rarely than this."""
MUCH_BETTER = 25.0
"""A fit is much better if its chi-square is lower by so much: five standard deviations."""
_DECISIVE = 100.0
"""A sensor is not the one either if chi-square without it exceeds that without another one by so much."""
_ENOUGH = 20.0
"""Degrees of freedom before a sensor is named."""
_STRONG = 20.0
"""Root mean square of the residuals with all sensors from which one is named [standard deviations]. With two more
readings than unknowns, what all sensors share looks like one of them in half of the cases if it is weaker."""
HEAVIEST = 100.0
"""No single reading speaks more against a sensor, so that a fit that was lost for a moment can recover."""


class LeftOut(NamedTuple):
    """For every sensor, the fit without it, and what speaks against it.

    Attributes
    ----------
    q
        Fits of the last reading.
    chi2, dof
        Squared residuals in units of their variances since the alarm began, and their degrees of freedom.
    jump
        Squared distance of the first fit from where the robot was just before the alarm, in units of its variance.
        A sensor that fails in an instant moves every fit that uses it; the robot itself cannot.
    whole
        Squared residuals with all sensors since the alarm began, and the number of readings.
    """

    q: Float[Tensor, "s n_q"]
    chi2: Float[Tensor, " s"]
    dof: Float[Tensor, " s"]
    jump: Float[Tensor, " s"]
    whole: tuple[float, int]

    def added(self, before: LeftOut) -> LeftOut:
        """These fits, with what spoke against them in an alarm before."""
        chi2, dof, jump = self.chi2 + before.chi2, self.dof + before.dof, self.jump + before.jump
        whole = (self.whole[0] + before.whole[0], self.whole[1] + before.whole[1])
        return LeftOut(self.q, chi2, dof, jump, whole)

    def wrong(self, used: Bool[Tensor, " s"], frozen: Bool[Tensor, " s"]) -> tuple[str, tuple[int, ...]]:
        """Return the cause as in :class:`~edition1.estimation.consistency.Verdict`, and the sensors named, one or two.

        Parameters
        ----------
        used
            Sensors in use.
        frozen
            Sensors whose last readings are the same to the last digit, while those of others are not.
        """
        chi2, dof = self.chi2.tolist(), self.dof.tolist()
        candidates = [k for k, is_used in enumerate(used.tolist()) if is_used]
        if not max(dof):
            return "no redundancy", ()
        if max(dof) < _ENOUGH:
            return "untold", ()
        left = [k for k in candidates if chi2[k] <= limit(_EXCLUDED, round(dof[k], 1))]
        if not left:
            return "several", ()
        against = (self.chi2 + self.jump).tolist()
        least = min(against[k] for k in left)
        left = [k for k in left if against[k] <= least + _DECISIVE]
        if len(left) > 2:
            left = [k for k in left if frozen[k]]
        if self.whole[0] < _STRONG**2 * self.whole[1]:
            return "untold", ()
        return ("sensors", tuple(left)) if 1 <= len(left) <= 2 else ("untold", ())


def begun(
    solver: Estimator[Any],
    sensors: Tensor,
    u: Tensor,
    use: Tensor,
    starts: Tensor,
    known: Tensor | None,
    before: tuple[Tensor, Tensor] | None = None,
) -> LeftOut:
    """Fit a reading without each sensor, from all starts ``[k, n_q]``; the first start that explains it counts.

    ``sensors`` ``[sensors, s]`` says which readings are those of each.

    ``before`` says where the robot was, and the standard deviation of how far it may have moved since.
    """
    every = torch.arange(len(sensors))
    found = _fitted(solver, sensors, starts.expand(len(sensors), -1, -1), u, use, known)
    chi2, dof = (found.diagnostics[name].to(u) for name in ("chi2", "dof"))
    explains = chi2 <= torch.tensor([[limit(EXPLAINED, d) for d in row] for row in dof.tolist()])
    first = torch.where(explains.any(-1), explains.int().argmax(-1), chi2.argmin(-1))
    q, jump = found.q[every, first], torch.zeros_like(chi2[:, 0])
    if before is not None and found.covariance is not None:
        C = found.covariance[every, first] + torch.diag(before[1] ** 2)
        away = (q - before[0]).unsqueeze(-1)
        jump = (away.mT @ torch.linalg.solve(C, away)).flatten()
    return LeftOut(q, chi2[every, first].clamp_max(HEAVIEST), dof[every, first], jump, (0.0, 0))


def followed(
    solver: Estimator[Any],
    sensors: Tensor,
    left: LeftOut,
    u: Tensor,
    use: Tensor,
    known: Tensor | None,
    *,
    whole: float,
    weight: float,
) -> LeftOut:
    """Fits of the next reading from the last ones; their residuals count with a weight, ``whole`` those of all."""
    found = _fitted(solver, sensors, left.q[:, None], u, use, known)
    chi2, dof = (found.diagnostics[name][:, 0].to(u) for name in ("chi2", "dof"))
    total = left.chi2 + weight * chi2.clamp_max(HEAVIEST), left.dof + weight * dof
    return LeftOut(found.q[:, 0], *total, left.jump, (left.whole[0] + whole, left.whole[1] + 1))


def recovered(
    solver: Estimator[Any],
    sensors: Tensor,
    left: LeftOut,
    u: Tensor,
    use: Tensor,
    starts: Tensor,
    known: Tensor | None,
) -> LeftOut:
    """Try other starts for the fits that are excluded; what spoke against those that then explain is halved."""
    fresh = begun(solver, sensors, u, use, starts, known)
    out = [
        c > limit(_EXCLUDED, round(d, 1)) for c, d in zip(left.chi2.tolist(), left.dof.tolist(), strict=True)
    ]
    good = [c <= limit(EXPLAINED, d) for c, d in zip(fresh.chi2.tolist(), fresh.dof.tolist(), strict=True)]
    again = torch.tensor(out) & torch.tensor(good)
    share = torch.where(again, 0.5, 1.0).to(left.chi2)
    q = torch.where(again[:, None], fresh.q, left.q)
    return LeftOut(q, share * left.chi2, share * left.dof, left.jump, left.whole)


def _fitted(
    solver: Estimator[Any], sensors: Tensor, starts: Tensor, u: Tensor, use: Tensor, known: Tensor | None
) -> Estimate:
    """Fits without each sensor, ``[s, k, ...]``."""
    without = use & ~sensors[:, None]
    # The only one in use cannot be left out.
    without = torch.where(without.any(-1, keepdim=True), without, use)
    without = without.expand(*starts.shape[:-1], -1)
    readings = u.expand(without.shape)
    return solver.step(solver.init(starts, seed=0), readings, 0.0, mask=without, known=known)[1]
