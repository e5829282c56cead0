r"""Conventions of Mitchell et al. that are not the library's: the axes of their files, the sigma of eq. (1)."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

MODEL_FROM_FILE = torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]], dtype=torch.float64)
"""Components in the model's axes from those in the recordings of Mitchell et al. 2021, the one place that does it.

In the files x is along the body, in the model z is: (x, y, z) of the model are (y, z, x) of the files. The magnet
points the other way, so all components change sign; y is mirrored, so that it keeps its sign. The matrix is
orthogonal: its transpose leads back.
"""


def model_axes(field: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Field of the recordings in the axes of :class:`~edition1.sensing.bend_sensor.BendSensor`.

    Examples
    --------
    >>> model_axes(torch.tensor([-22.0, 1.0, 0.5], dtype=torch.float64))
    tensor([ 1.0000, -0.5000, 22.0000], dtype=torch.float64)
    """
    return field @ MODEL_FROM_FILE.T.to(field)


def file_axes(u: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Field of the model in the axes of the recordings: the inverse of :func:`model_axes`."""
    return u @ MODEL_FROM_FILE.to(u)


def noise_of_sigma(sigma_mt: float) -> float:
    r"""Noise of a reading [mT] for the :math:`\sigma` of eq. (1) of the paper: :math:`\sigma/\sqrt 2`.

    Examples
    --------
    >>> round(noise_of_sigma(0.01), 5)
    0.00707
    """
    return sigma_mt / math.sqrt(2)
