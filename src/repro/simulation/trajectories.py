r"""The simulated trajectories of Baaij et al. 2023 (sections 3.4 and 4.3): 400 steps at 40 Hz."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from repro.errors import bad_input

STEPS = 400
RATE_HZ = 40.0
AMPLITUDE_M = 22e-3 * math.pi / 4
"""Bending amplitude D = 17.28 mm: 45 degrees (section 3.4) at a radius of 22 mm."""
ELONGATION_M = 2.75e-3


def lemniscate(
    n_segments: int, *, half: bool = False, steps: int = STEPS, amplitude_m: float = AMPLITUDE_M
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
