r"""The simulated trajectories of Baaij et al. 2023 (sections 3.4 and 4.3): 400 steps at 40 Hz."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require

STEPS = 400
RATE_HZ = 40.0
_AMPLITUDE_M = 22e-3 * math.pi / 4
"""Bending amplitude D = 17.28 mm: 45 degrees (section 3.4) at a radius of 22 mm."""
ELONGATION_M = 2.75e-3


def lemniscate(
    n_segments: int, *, half: bool = False, steps: int = STEPS, amplitude_m: float = _AMPLITUDE_M
) -> Float[Tensor, "steps n_q"]:
    r"""Lemniscate of every segment, each shifted in phase by :math:`p = 2\pi (i - 1)/n_b`.

    With :math:`s \in [0, 1]`, full: :math:`\Delta_x = D \sin(4\pi s + p)`,
    :math:`\Delta_y = D \sin(2\pi s + p)`; half: :math:`\Delta_x = D \sin(2\pi s + p)`,
    :math:`\Delta_y = D \sin(\pi s + p)`; :math:`\delta L = 2.75\,\mathrm{mm}\,(1 + \sin(2\pi s + p))`.

    Parameters
    ----------
    n_segments
        Number of segments.
    half
        The half lemniscate T2 instead of the full one T3.
    steps
        Number of time steps.
    amplitude_m
        Bending amplitude D [m].

    Returns
    -------
    Tensor
        Configurations ``(delta_x, delta_y, delta_L)`` of each segment [m].

    Raises
    ------
    InputError
        If there is no segment or no step.

    Examples
    --------
    >>> q = lemniscate(1)
    >>> float(q[:, 0].max() * 1e3), float(q[:, 2].max() * 1e3)  # doctest: +ELLIPSIS
    (17.278..., 5.499...)
    """
    if n_segments < 1 or steps < 1:
        raise bad_input("n_segments, steps", "lemniscate", "at least 1", (n_segments, steps))
    s = torch.linspace(0, 1, steps, dtype=torch.float64)
    turns = math.pi if half else 2 * math.pi
    columns = []
    for i in range(n_segments):
        p = 2 * math.pi * i / n_segments
        columns += [
            amplitude_m * torch.sin(2 * turns * s + p),
            amplitude_m * torch.sin(turns * s + p),
            ELONGATION_M * (1 + torch.sin(2 * math.pi * s + p)),
        ]
    return torch.stack(columns, dim=-1)


def flower(*, steps: int = STEPS) -> Float[Tensor, "steps 4"]:
    r"""Flower of the affine segment (section 4.3): three petals in one turn.

    With :math:`s \in [0, 1]` and :math:`c = (1 - \cos 6\pi s)/2`: :math:`\kappa_0 = c\,\pi/4`,
    :math:`\kappa_1 = \pi (0.1 + 0.9 c)`, :math:`\phi = 2\pi s`,
    :math:`\delta L = 2.75\,\mathrm{mm}\,(1 + \sin 2\pi s)`. The azimuth is continuous and ends at a full turn.

    Parameters
    ----------
    steps
        Number of time steps.

    Returns
    -------
    Tensor
        Configurations ``(kappa_0, kappa_1, phi, delta_L)`` [rad, rad, rad, m].

    Raises
    ------
    InputError
        If there is no step.

    Examples
    --------
    >>> flower(steps=7)[1, :2] / torch.pi  # the outermost point of the first petal
    tensor([0.2500, 1.0000], dtype=torch.float64)
    """
    require(steps >= 1, "steps", "flower", "at least 1", steps)
    s = torch.linspace(0, 1, steps, dtype=torch.float64)
    petal = (1 - torch.cos(6 * math.pi * s)) / 2
    dL = ELONGATION_M * (1 + torch.sin(2 * math.pi * s))
    return torch.stack([math.pi / 4 * petal, math.pi * (0.1 + 0.9 * petal), 2 * math.pi * s, dL], dim=-1)
