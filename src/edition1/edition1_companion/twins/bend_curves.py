r"""The simulated curves of Mitchell et al. 2021 (section II-D) and the module that follows them."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.kinematics.bend import Bend, bend_vector
from edition1.kinematics.mounts import Mounts, magnet_mounts
from edition1.kinematics.robot import Robot
from edition1.sensing.magnetic import field_at_sensors
from edition1.sensing.magnets import B444B

LENGTH_M = 15e-3
"""Distance of sensor and magnet along the arc, section III-A [m]."""
SENSOR_NOISE_MT = 0.025
"""Noise of the real sensor per axis [mT]: 0.021-0.026 mT in the recordings at rest."""
TIME_STEP = 0.01
"""Increment of the curves' parameter t, section II-D; it has no unit."""
CURVES = ("spiral", "flower", "seagull")
"""Names of the curves, eqs (5)-(7)."""


def curve_times() -> Float[Tensor, " steps"]:
    """Parameter of the curves from 0 to 10 pi: 3142 values."""
    return torch.arange(0, 10 * math.pi, TIME_STEP, dtype=torch.float64)


def bend_curve(name: str) -> Float[Tensor, "steps 2"]:
    r"""Bend vectors of a curve [rad].

    Spiral: :math:`\theta = t,\ \varphi = 0.03 t`. Flower: :math:`\theta = (0.1 t)^2,\ \varphi = \sin t`. Seagull:
    :math:`\theta = \sin t + \pi/2,\ \varphi = |\sin t|`. A negative angle is folded to the opposite direction,
    so the flower is smooth; the seagull turns round at every :math:`\sin t = 0`.

    Parameters
    ----------
    name
        One of :data:`CURVES`.

    Examples
    --------
    >>> float(torch.linalg.vector_norm(bend_curve("spiral"), dim=-1).max())  # doctest: +ELLIPSIS
    0.942...
    """
    t = curve_times()
    angle_and_direction = {
        "spiral": (0.03 * t, t),
        "flower": (t.sin(), (0.1 * t) ** 2),
        "seagull": (t.sin().abs(), t.sin() + math.pi / 2),
    }
    return bend_vector(*angle_and_direction[name])


def bend_robot(length_m: float = LENGTH_M) -> Robot:
    """Module of section III: a cube at the end of an arc, magnetised along it; a sensor at the base, aligned with it.

    Parameters
    ----------
    length_m
        Distance of sensor and magnet along the arc [m].
    """
    at_base = Mounts((0,), torch.zeros(1, dtype=torch.float64), torch.eye(4, dtype=torch.float64)[None])
    return Robot((Bend(length_m),), magnet_mounts([0], length_m), at_base)


def bend_readings(
    q: Float[Tensor, "*batch 2"], length_m: float = LENGTH_M, *, noise_mt: float = 0.0, seed: int = 0
) -> Float[Tensor, "*batch 3"]:
    """Synthetic readings [mT] of the three-axis sensor at bend ``q``, by magpylib, with white noise.

    Parameters
    ----------
    q
        Bend vectors [rad].
    length_m
        Distance of sensor and magnet along the arc [m].
    noise_mt
        Standard deviation of the noise on every axis [mT].
    seed
        Of the noise.
    """
    u = field_at_sensors(bend_robot(length_m), q, B444B)[..., 0, :]
    generator = torch.Generator().manual_seed(seed)
    return u + noise_mt * torch.randn(u.shape, generator=generator, dtype=u.dtype)
