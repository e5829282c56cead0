"""Compiled kernels: the form in torch is the reference, the kernel its twin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import Tensor

from edition1.sensing.bend_sensor import BendSensor


def compiled(sensing: Callable[[Tensor], Tensor]) -> Any:
    """The same sensor model with a compiled kernel, which estimators use in place of torch: many times faster.

    Parameters
    ----------
    sensing
        :class:`~edition1.sensing.linearised.LinearisedSensing`;
        :class:`~edition1.sensing.magnetic.MagneticSensing` with a multipole field, or with networks of the paper or on
        cosines; one of them stacked with directions that IMUs see; or
        :class:`~edition1.sensing.bend_sensor.BendSensor`. Weights and mounts are copied.

    Returns
    -------
    CompiledSensing or CompiledBendSensor
        A callable like ``sensing``.

    Raises
    ------
    InputError
        If there is no kernel for the model; the message names the part.

    Examples
    --------
    >>> import torch
    >>> from edition1.sensing.bend_sensor import BendSensor
    >>> straight = torch.zeros(2, dtype=torch.float64)
    >>> compiled(BendSensor(15e-3))(straight)[2], BendSensor(15e-3)(straight)[2]
    (tensor(15.8308, dtype=torch.float64), tensor(15.8308, dtype=torch.float64))
    """
    if getattr(sensing, "is_compiled", False):
        return sensing
    if isinstance(sensing, BendSensor):  # numba takes a second to import: not before it is needed
        from edition1.kernels._bend import CompiledBendSensor

        return CompiledBendSensor(sensing.length, sensing.cube)
    from edition1.kernels._sensing import CompiledSensing

    return CompiledSensing(sensing)
