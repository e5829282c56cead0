"""Sensors of a rod, and the errors of their readings."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.kernels._rod_filter import GYROSCOPE, MODEL, ORIENTATION, POSE, Layout
from edition1.kinematics.strain_series import StrainSeries

_READINGS = {"pose": 6, "orientation": 3, "gyroscope": 3}
_KINDS = {"pose": POSE, "orientation": ORIENTATION, "gyroscope": GYROSCOPE, "model": MODEL}


@dataclass(frozen=True)
class RodSensor:
    r"""A sensor of a rod, and the errors of its readings.

    =========== ======================================================= =====================================
    kind        readings                                                errors
    =========== ======================================================= =====================================
    pose        twist (m, rad) of its pose in the world, as             a twist in the sensor's frame
                :func:`edition1.se3.logarithm` gives it
    orientation rotation vector [rad] of its frame in the world         a rotation vector in its frame
    gyroscope   angular velocity in its own frame [rad/s]               added
    model       what ``sensing`` makes of the terms of the strain       added
    =========== ======================================================= =====================================

    Parameters
    ----------
    kind
        One of the table.
    std
        Standard deviation of the white error of each reading.
    arc_m
        Where the sensor sits along the rod; without a meaning for a model.
    lasting_std
        Standard deviation of the part of each error that lasts (a frame or a mounting that is off, a bias); empty
        for none.
    lasting_time_s
        How long it lasts: the correlation time [s]; infinite for a constant.
    outliers
        Degrees of freedom of Student's t for the white errors: a surprising reading then counts less; infinite for
        the normal distribution.
    sensing
        For a model: terms of the strain to readings, batched and differentiable.

    Raises
    ------
    InputError
        If the kind is another one, numbers do not fit it, or a value is not positive.

    Examples
    --------
    >>> RodSensor("gyroscope", (0.1, 0.1, 0.1), arc_m=0.2).lasting_time_s
    inf
    """

    kind: str
    std: tuple[float, ...]
    arc_m: float = 0.0
    lasting_std: tuple[float, ...] = ()
    lasting_time_s: float = math.inf
    outliers: float = math.inf
    sensing: Callable[[Tensor], Tensor] | None = None

    def __post_init__(self) -> None:
        if self.kind != "model" and self.kind not in _READINGS:
            raise bad_input(
                "kind", "RodSensor", "one of pose, orientation, gyroscope, model", repr(self.kind)
            )
        if (self.sensing is None) == (self.kind == "model"):
            raise bad_input("sensing", "RodSensor", "given for a model, and for a model only", self.sensing)
        count = _READINGS.get(self.kind, len(self.std))
        if len(self.std) != count or not count or not all(x > 0 for x in self.std):
            raise bad_input("std", "RodSensor", f"positive, one for each of {count} readings", self.std)
        if self.lasting_std and (len(self.lasting_std) != count or not all(x > 0 for x in self.lasting_std)):
            raise bad_input(
                "lasting_std", "RodSensor", f"empty, or {count} positive numbers", self.lasting_std
            )
        for name in ("lasting_time_s", "outliers"):
            require(getattr(self, name) > 0, name, "RodSensor", "positive", getattr(self, name))


def layout(rod: StrainSeries, sensors: Sequence[RodSensor], *, base: bool) -> Layout:
    """Tables of a rod and its sensors for the kernels; lasting errors are the states behind the configuration."""
    lasting = [len(sensor.lasting_std) for sensor in sensors]
    first = rod.n_q + 6 * base + np.cumsum([0, *lasting])[:-1]
    stations, station = np.unique([float(sensor.arc_m) for sensor in sensors], return_inverse=True)
    return Layout(
        basis=rod.basis,
        piece=rod.length / rod.parts,
        base=base,
        kind=np.array([_KINDS[sensor.kind] for sensor in sensors]),
        stations=stations,
        station=station,
        row=np.cumsum([0, *(len(sensor.std) for sensor in sensors)]),
        error=np.where(np.array(lasting) > 0, first, -1),
        variance=np.concatenate([np.square(sensor.std, dtype=float) for sensor in sensors]),
        outliers=np.array([float(sensor.outliers) for sensor in sensors]),
    )
