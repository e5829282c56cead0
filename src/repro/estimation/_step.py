"""What the steps of the estimators share: readings in use, coordinates that are held, the count of freedoms."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from repro.errors import bad_input


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
    """The sensor model, if its kernel can be used: it is one of :func:`repro.kernels.compiled`; else none."""
    return sensing if getattr(sensing, "is_compiled", False) else None


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
