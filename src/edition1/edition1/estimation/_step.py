"""What filters and least squares share: motion between readings, and when iterations end."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor


def driven(
    tau: float, acceleration: Float[Tensor, " n"]
) -> tuple[Float[Tensor, "nn nn"], Float[Tensor, "nn nn"]]:
    """Transition of coordinates and their velocities over a time [s], and the covariance that white noise adds.

    Parameters
    ----------
    tau
        The time.
    acceleration
        Density of the acceleration of each coordinate [unit/s^1.5].
    """
    eye, density = torch.eye(len(acceleration)).to(acceleration), torch.diag(acceleration**2)
    move = torch.cat([torch.cat([eye, tau * eye], 1), torch.cat([0 * eye, eye], 1)])
    noise = torch.cat(
        [
            torch.cat([tau**3 / 3 * density, tau**2 / 2 * density], 1),
            torch.cat([tau**2 / 2 * density, tau * density], 1),
        ]
    )
    return move, noise


def matern(
    std: np.ndarray, rates: np.ndarray, lasting_std: np.ndarray, lasting_rates: np.ndarray, tau: float
) -> tuple[Float[Tensor, "n n"], Float[Tensor, "n n"]]:
    """Transition of Matern processes of smoothness 3/2 over a time [s], and the covariance that noise adds.

    States are the processes, then Ornstein-Uhlenbeck processes, then the velocities of the first.

    Parameters
    ----------
    std, rates
        Standard deviation and rate [1/s] of each Matern process.
    lasting_std, lasting_rates
        Of each Ornstein-Uhlenbeck process.
    tau
        The time.
    """
    n, m = len(std), len(std) + len(lasting_std)
    faded, stay = np.exp(-rates * tau), np.exp(-lasting_rates * tau)
    a, b = faded * (1 + rates * tau), faded * tau
    c, d = -(rates**2) * b, faded * (1 - rates * tau)
    move, noise = np.zeros((n + m, n + m)), np.zeros((n + m, n + m))
    i, j, k = np.arange(n), np.arange(n, m), np.arange(m, m + n)
    move[i, i], move[i, k], move[k, i], move[k, k], move[j, j] = a, b, c, d, stay
    v, w = std**2, (std * rates) ** 2
    noise[i, i], noise[k, k] = v - a * a * v - b * b * w, w - c * c * v - d * d * w
    noise[i, k] = noise[k, i] = -a * c * v - b * d * w
    noise[j, j] = lasting_std**2 * (1 - stay**2)
    return torch.from_numpy(move), torch.from_numpy(noise)


def conditioned(x: np.ndarray, P: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States and covariance, given that some coordinates have known values (NaN for the others)."""
    here = np.flatnonzero(~np.isnan(known))
    if not len(here):
        return x, P
    gain = np.linalg.lstsq(P[np.ix_(here, here)], P[here], rcond=None)[0].T
    x, P = x + gain @ (known[here] - x[here]), P - gain @ P[here]
    x[here], P[here], P[:, here] = known[here], 0.0, 0.0
    return x, P


TOLERANCE = 1e-12
"""A trial step below this share of the width of the bounds ends the iteration."""
