r"""Damped Gauss-Newton for few parameters with Gaussian priors, where many other unknowns may be eliminated.

The parameters :math:`z` minimise :math:`c(z) + z^T \Lambda z`, the squared residuals in units of their variances and
a prior around zero. With the information :math:`A` and the gradient :math:`g` of the residuals a step is

.. math:: (H + \lambda\, \mathrm{diag} H)\, \delta = g - \Lambda z, \qquad H = A + \Lambda .

If every residual also depends on unknowns of its own, such as the shape of its row, these are at their best for every
:math:`z`, and only the Schur complement of their information counts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from repro.common import Array


class Trial(NamedTuple):
    """Parameters that were tried."""

    cost: float
    """Squared residuals in units of their variances."""
    equations: Callable[[], tuple[float, Array, Array]]
    """Cost, information and gradient once the trial is taken: its residuals may have new weights then."""
    details: Any = None


class Fit(NamedTuple):
    """The parameters that fit best, the inverse of their covariance, the last trial that was taken, and the first."""

    z: Array
    information: Array
    last: Trial
    first: Trial


def gauss_newton(
    trial_of: Callable[[Array], Trial],
    prior: Array,
    *,
    iterations: int = 50,
    tolerance: float = 1e-6,
    slack: float = 1.0,
    damping: float = 1e-3,
    start: Array | None = None,
) -> Fit:
    """Minimise the residuals and a prior around zero.

    Parameters
    ----------
    trial_of
        From parameters ``[k]`` to a :class:`Trial`.
    prior
        Inverse variance of every parameter before the first residual ``[k]``.
    iterations
        Largest number of steps.
    tolerance
        The iteration ends when a step is below this share of every prior standard deviation.
    slack
        By what factor the cost may grow, where the variances of the residuals depend on the parameters.
    damping
        The least damping, where a step leads to something worse; in a narrow valley that bends more would only creep.
    start
        Where the iteration starts ``[k]``; at zero if not given.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the information is singular or not finite.

    Examples
    --------
    Ten readings of a parameter, each as uncertain as the prior:

    >>> def trial_of(z):
    ...     r = 1.1 - z * np.ones(10)
    ...     return Trial(r @ r, lambda: (r @ r, np.array([[10.0]]), np.array([r.sum()])))
    >>> gauss_newton(trial_of, np.ones(1)).z.round(6)
    array([1.])
    """
    z, damped = np.zeros(len(prior)) if start is None else start, 0.0
    first = last = trial_of(z)
    cost, A, g = last.equations()
    for _ in range(iterations):
        H = A + np.diag(prior)
        step = np.linalg.solve(H + damped * np.diag(np.diag(H)), g - prior * z)
        trial, moved = trial_of(z + step), z + step
        if trial.cost + prior @ moved**2 <= slack * (cost + prior @ z**2) + 1e-6:
            z, last = moved, trial
            cost, A, g = last.equations()
            damped = damped / 10 if damped > damping else 0.0
        else:
            damped = max(10 * damped, damping)
        if (np.abs(step) * np.sqrt(prior)).max() < tolerance:
            break
    return Fit(z, A + np.diag(prior), last, first)


def eliminated(K: Array, J: Array, r: Array, rcond: float | None = None) -> tuple[Array, Array]:
    """Return information and gradient of parameters where every row has unknowns of its own.

    Parameters
    ----------
    K
        Slopes of the predictions by the parameters ``[t, s, k]``, in units of the residuals' deviations.
    J
        Slopes by the unknowns of each row ``[t, s, n]``; zero where one stays.
    r
        Residuals ``[t, s]``, zero where nothing was read.
    rcond
        Singular values below this share of the largest are none; that of NumPy if not given.

    Examples
    --------
    Two readings of an unknown, of which the second one has an offset: their difference alone tells it, with twice
    the variance.

    >>> A, g = eliminated(np.array([[[0.0], [1.0]]]), np.ones((1, 2, 1)), np.array([[0.3, 0.5]]))
    >>> A.round(3), (g / A[0]).round(3)
    (array([[0.5]]), array([0.2]))
    """
    by_row = np.linalg.pinv(J.mT @ J, rcond, hermitian=True)
    left = K - J @ (by_row @ (J.mT @ K))  # what the unknowns of the rows cannot take over
    return np.einsum("tsk,tsl->kl", K, left), np.einsum("tsk,ts->k", left, r)
