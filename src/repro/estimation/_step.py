"""What filters and least squares share: motion between readings, and when iterations end."""

from __future__ import annotations

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


TOLERANCE = 1e-12
"""A trial step below this share of the width of the bounds ends the iteration."""
