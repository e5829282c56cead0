"""Compiled kernels: the form in torch is the reference, the kernel its twin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import Tensor

from repro.sensing.bend_sensor import BendSensor


def compiled(sensing: Callable[[Tensor], Tensor]) -> Any:
    """The same sensor model with a compiled kernel, which estimators use in place of torch: many times faster.

    Parameters
    ----------
    sensing
        :class:`~repro.sensing.linearised.LinearisedSensing`;
        :class:`~repro.sensing.magnetic.MagneticSensing` with a multipole field, or with networks of the paper or on
        cosines; one of them stacked with directions that IMUs see; or
        :class:`~repro.sensing.bend_sensor.BendSensor`. Weights and mounts are copied.

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
    >>> from repro.sensing.bend_sensor import BendSensor
    >>> straight = torch.zeros(2, dtype=torch.float64)
    >>> compiled(BendSensor(15e-3))(straight)[2], BendSensor(15e-3)(straight)[2]
    (tensor(15.8308, dtype=torch.float64), tensor(15.8308, dtype=torch.float64))
    """
    if getattr(sensing, "is_compiled", False):
        return sensing
    if isinstance(sensing, BendSensor):  # numba takes a second to import: not before it is needed
        from repro.kernels._bend import CompiledBendSensor

        return CompiledBendSensor(sensing.length, sensing.cube)
    from repro.kernels._sensing import CompiledSensing

    return CompiledSensing(sensing)
