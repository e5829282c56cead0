r"""The simulated trajectories of Baaij et al. 2023 (sections 3.4 and 4.3): 400 steps at 40 Hz."""

from __future__ import annotations

import math

import torch
from edition1.errors import bad_input, require
from jaxtyping import Float
from torch import Tensor

STEPS = 400
RATE_HZ = 40.0
_AMPLITUDE_M = 22e-3 * math.pi / 4
"""Bending amplitude D = 17.28 mm: 45 degrees (section 3.4) at a radius of 22 mm."""
ELONGATION_M = 2.75e-3


TRAJECTORIES = ("T0", "T1", "T2", "T3")
"""T0: random motion, synthetic; T1: bending; T2: half lemniscate; T3: lemniscate."""


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


def trajectory(name: str, n_segments: int, *, steps: int = STEPS) -> Float[Tensor, "t n_q"]:
    r"""Trajectory of every segment, 400 steps at 40 Hz.

    T0 is smooth random motion: each coordinate a sum of five sines of random phase, 0.1 to 0.5 Hz, scaled to three
    quarters of the lemniscate's range. T1 bends in a plane, :math:`\Delta_x = D s`, at mid elongation.

    Parameters
    ----------
    name
        One of :data:`TRAJECTORIES`.
    n_segments
        Number of segments.
    steps
        Number of first steps of it.

    Raises
    ------
    InputError
        If there is no trajectory of that name.
    """
    if name not in TRAJECTORIES:
        raise bad_input("name", "trajectory", f"one of {', '.join(map(repr, TRAJECTORIES))}", repr(name))
    s = torch.linspace(0, 1, STEPS, dtype=torch.float64)
    if name == "T0":
        generator = torch.Generator().manual_seed(0)
        periods = torch.arange(1, 6).double()  # in 10 s
        phase = (
            2 * math.pi * torch.rand(3 * n_segments, len(periods), generator=generator, dtype=torch.float64)
        )
        waves = torch.sin(2 * math.pi * periods * s[:, None, None] + phase).sum(-1)
        unit = 0.75 * waves / waves.abs().amax(0)
        middle = torch.tensor([0.0, 0.0, ELONGATION_M] * n_segments, dtype=torch.float64)
        size = torch.tensor([_AMPLITUDE_M, _AMPLITUDE_M, ELONGATION_M] * n_segments, dtype=torch.float64)
        q = middle + size * unit
    elif name == "T1":
        q = torch.stack([_AMPLITUDE_M * s, 0 * s, ELONGATION_M + 0 * s], dim=-1).repeat(1, n_segments)
    else:
        q = lemniscate(n_segments, half=name == "T2")
    return q[:steps]
