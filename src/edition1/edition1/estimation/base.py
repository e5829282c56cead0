"""One interface for all estimators: explicit state in, explicit state out, and the one loop that drives them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from tqdm import tqdm

from edition1.errors import bad_input

_S = TypeVar("_S")


@dataclass(frozen=True)
class Estimate:
    """What an estimator believes after a step.

    Parameters
    ----------
    q
        Configuration.
    covariance
        Covariance of ``q``, for estimators that have one.
    u_hat
        Readings predicted at ``q``.
    diagnostics
        Named tensors with the batch of ``q``. Every estimator reports ``masked``, the number of sensors left out
        (by the mask, or because their reading was NaN); ``chi2``, its squared residuals in units of their
        variances; and ``dof``, how many of these the estimate could not adapt itself to. If model and noise
        are right, ``chi2`` has a chi-square distribution with ``dof`` degrees of freedom; with none of them the
        readings say nothing about that. :class:`edition1.estimation.monitor.Monitored` tests it.

    Examples
    --------
    >>> estimate = Estimate(torch.zeros(3), None, torch.zeros(8))
    >>> estimate.u_hat.shape
    torch.Size([8])
    """

    q: Float[Tensor, "*batch n_q"]
    covariance: Float[Tensor, "*batch n_q n_q"] | None
    u_hat: Float[Tensor, "*batch s"]
    diagnostics: Mapping[str, Tensor] = field(default_factory=dict)


@runtime_checkable
class Estimator(Protocol[_S]):
    """Readings to configuration, one time step after the other, batched over trajectories.

    Ground truth never enters :meth:`step`, except as ``known`` in an experiment that declares it.

    Examples
    --------
    >>> class AlwaysStraight:
    ...     def init(self, q0, *, seed=0):
    ...         return None
    ...
    ...     def step(self, state, u, t, *, mask=None, known=None):
    ...         return state, Estimate(torch.zeros(3), None, u)
    >>> isinstance(AlwaysStraight(), Estimator)
    True
    """

    def init(self, q0: Tensor, *, seed: int) -> _S:
        """State before the first step, at configuration ``q0`` ``[*batch, n_q]``."""
        ...

    def step(
        self, state: _S, u: Tensor, t: float, *, mask: Tensor | None = None, known: Tensor | None = None
    ) -> tuple[_S, Estimate]:
        """Take in the readings ``u`` ``[*batch, s]`` at time ``t`` [s].

        ``mask`` is true for sensors in use (all when not given); a reading that is NaN masks its sensor.
        ``known`` ``[*batch, n_q]`` holds coordinates at given values; NaN leaves a coordinate to be estimated.
        """
        ...


@runtime_checkable
class _HasTip(Protocol):
    """A robot: its configuration says where its tip is."""

    def tip(self, q: Tensor) -> Tensor:
        """Pose of the tip ``[*batch, 4, 4]``."""
        ...


@dataclass(frozen=True)
class Trajectory:
    """Estimates over time: the fields of :class:`Estimate` with a leading time dimension.

    Examples
    --------
    >>> Trajectory(torch.zeros(7, 3), None, torch.zeros(7, 8), {}).q.shape
    torch.Size([7, 3])
    """

    q: Float[Tensor, "t *batch n_q"]
    covariance: Float[Tensor, "t *batch n_q n_q"] | None
    u_hat: Float[Tensor, "t *batch s"]
    diagnostics: Mapping[str, Tensor]

    def tip(self, robot: _HasTip) -> Float[Tensor, "t *batch 4 4"]:
        """Poses of the tip of a robot in the frame of its base [m]; of a `repro.Robot` or a `repro.RobotFile`."""
        return robot.tip(self.q)


def track(
    estimator: Estimator[_S],
    readings: Float[Tensor, "t *batch s"],
    q0: Float[Tensor, "*batch n_q"],
    *,
    rate_hz: float = 40.0,
    times_s: Sequence[float] | None = None,
    seed: int = 0,
    mask: Bool[Tensor, "t *m"] | None = None,
    known: Float[Tensor, "t *k"] | None = None,
    progress: str | None = None,
) -> Trajectory:
    """Run an estimator over recorded readings.

    Parameters
    ----------
    estimator
        Any estimator.
    readings
        One row per time step.
    q0
        Where the estimator starts.
    rate_hz
        Steps per second.
    times_s
        Time of each row [s], increasing, in place of a rate.
    seed
        For estimators that draw random numbers.
    mask, known
        As in :meth:`Estimator.step`, with a leading time dimension.
    progress
        Label of a progress bar; none when not given.

    Raises
    ------
    InputError
        If there are no readings, not one time, mask or known configuration for each row, or the rate is not positive.

    Examples
    --------
    >>> from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
    >>> one = torch.ones(1, dtype=torch.float64)
    >>> square_root = LevenbergMarquardt(lambda q: q**2, 0 * one, 2 * one)
    >>> u = torch.tensor([[0.25], [1.0], [2.25]], dtype=torch.float64)
    >>> track(square_root, u, one).q.flatten().round(decimals=6)
    tensor([0.5000, 1.0000, 1.5000], dtype=torch.float64)
    """
    if not len(readings):
        raise bad_input("readings", "track", "at least one time step", f"shape {tuple(readings.shape)}")
    if not rate_hz > 0:
        raise bad_input("rate_hz", "track", "positive", rate_hz)
    for name, rows in (("mask", mask), ("known", known)):
        if rows is not None and len(rows) != len(readings):
            raise bad_input(name, "track", f"one row for each of {len(readings)} time steps", len(rows))
    times = [k / rate_hz for k in range(len(readings))] if times_s is None else [float(t) for t in times_s]
    if len(times) != len(readings):
        raise bad_input("times_s", "track", f"one for each of {len(readings)} rows", len(times))
    state = estimator.init(q0, seed=seed)
    estimates = []
    for k, u in enumerate(tqdm(readings, desc=progress, disable=progress is None)):
        state, estimate = estimator.step(
            state,
            u,
            times[k],
            mask=None if mask is None else mask[k],
            known=None if known is None else known[k],
        )
        estimates.append(estimate)
    return stacked(estimates)


def stacked(parts: Sequence[Estimate | Trajectory], dim: int = 0) -> Trajectory:
    """Estimates one behind the other, in a new dimension: time steps, or members that were tracked one by one."""
    covariances = [part.covariance for part in parts if part.covariance is not None]
    return Trajectory(
        q=torch.stack([part.q for part in parts], dim),
        covariance=torch.stack(covariances, dim) if covariances else None,
        u_hat=torch.stack([part.u_hat for part in parts], dim),
        diagnostics={k: torch.stack([p.diagnostics[k] for p in parts], dim) for k in parts[0].diagnostics},
    )


def usable(u: Float[Tensor, "*batch s"], mask: Tensor | None, owner: str) -> Bool[Tensor, "*batch s"]:
    """Sensors to use: those of the mask whose reading is a number.

    Raises
    ------
    InputError
        If the mask does not fit, a reading is infinite, or no sensor is left.
    """
    if mask is not None and (mask.dtype != torch.bool or mask.shape[-1:] != u.shape[-1:]):
        expected = f"boolean, one for each of {u.shape[-1]} sensors"
        raise bad_input("mask", owner, expected, f"{mask.dtype} of shape {tuple(mask.shape)}")
    if math.isfinite(u.detach().sum()):  # the usual case, at a fifth of the time
        use = torch.ones_like(u, dtype=torch.bool)
    elif bool(torch.isinf(u).any()):
        raise bad_input("u", owner, "finite, or NaN for a missing reading", "infinite readings")
    else:
        use = ~torch.isnan(u)
    use = use if mask is None else use & mask
    if not (u.shape[-1] and (bool(use.all()) or bool(use.any(-1).all()))):
        raise bad_input("u", owner, "at least one reading that is a number and not masked", "none")
    return use


def redundancy(used: Tensor, free: Tensor) -> Tensor:
    """Degrees of freedom of the residuals: those there are, less the coordinates that were free to follow them.

    Parameters
    ----------
    used
        Number of residuals, of every member of a batch.
    free
        Coordinates ``[*batch, n_q]`` that could follow: neither held nor at a bound.
    """
    return (used - free.sum(-1)).clamp_min(0)


def held(q: Tensor, known: Tensor | None) -> tuple[Tensor, Tensor]:
    """Configuration with the coordinates that are ``known`` at their values, and which ones are free."""
    if known is None:
        return q, torch.ones_like(q, dtype=torch.bool)
    free = torch.isnan(known).expand_as(q)
    return torch.where(free, q, known), free


def kernel(sensing: Callable[[Tensor], Tensor]) -> Any:
    """The sensor model, if its kernel can be used: it is one of :func:`edition1.kernels.compiled`; else none.

    Raises
    ------
    InputError
        If the kernel has no derivatives.
    """
    if not getattr(sensing, "is_compiled", False):
        return None
    if not hasattr(sensing, "linearise"):
        expected = "one with derivatives, such as the model that was compiled"
        raise bad_input("sensing", "an estimator that follows slopes", expected, type(sensing).__name__)
    return sensing


def check_start(
    q0: Tensor, bounds: tuple[Tensor, Tensor] | None, owner: str, *, n_q: int | None = None
) -> None:
    """Refuse a start that is not finite, of the wrong width, or outside the bounds.

    Raises
    ------
    InputError
        As said.
    """
    if n_q is not None and q0.shape[-1:] != (n_q,):
        raise bad_input("q0", owner, f"of last dimension {n_q}", f"shape {tuple(q0.shape)}")
    if not bool(torch.isfinite(q0).all()):
        raise bad_input("q0", owner, "finite", q0.tolist())
    if bounds is not None and bool(((q0 < bounds[0].to(q0)) | (q0 > bounds[1].to(q0))).any()):
        expected = f"within the bounds {bounds[0].tolist()} to {bounds[1].tolist()}"
        raise bad_input("q0", owner, expected, q0.tolist())
