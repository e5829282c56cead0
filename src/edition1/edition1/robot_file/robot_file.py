"""A robot in a TOML file: read, checked, and made into the objects that estimators take.

Lengths are millimetres and angles degrees in the file, which says so in the names of its keys; SI and radians in what
is made of it. Segments, magnets and sensors count from 1 at the base, in the file and in messages.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.kinematics.robot import Robot
from edition1.robot_file._reading_errors import CalibrationError, network_of_sensor
from edition1.robot_file.calibration_file import RobotCalibration
from edition1.robot_file.columns import channel_columns
from edition1.robot_file.imu_readings import Imu
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import MagneticSensing
from edition1.sensing.magnets import Cube, Ring
from edition1.sensing.network import PerSensor
from edition1.sensing.own_model import Given, OwnModel
from edition1.sensing.placement import placed
from edition1.sensing.relations import relations
from edition1.sensing.weights import load_paper_network


@dataclass(frozen=True)
class RobotFile:
    """A robot, its sensors and its stream.

    Parameters
    ----------
    name, sha256
        Name of the file, and the hash of its content.
    robot
        Segments with the mounts of magnets and sensors; after calibration, as calibrated.
    format, rate_hz
        Of the stream.
    unit
        Unit of the readings of the magnetic sensors: ``"mT"``, ``"mV"`` or ``"raw"`` (whole numbers of a converter).
    channels
        Values of a frame that are readings.
    channel
        For every sensor, which of them is its own, from 0.
    gain, offset
        Readings per flux density [unit/mT], and readings without field [unit], of every sensor.
    noise
        Standard deviation of a reading [unit].
    moments
        Multipole moments [mT m^(l+2)]: those that the magnets share, or a row for each magnet where they are not
        alike; none without magnets.
    magnets
        The magnets as described, from the file.
    earth_mt
        Earth field in the base frame [mT].
    lower, upper
        Bounds of the configuration.
    imus
        From base to tip.
    imu_noise
        Standard deviation of an orientation about each axis [rad].
    base_orientation
        Unit quaternion XYZW from the frame of the base to the world of the IMUs.
    networks
        Files of trained networks that say what the sensors read, instead of the field of the magnets: one for all
        sensors, one per segment, or one per sensor.
    notes
        Warnings: what is allowed but probably not meant.
    network_inputs
        What networks in TorchScript take: ``"angles"`` or ``"cosines"``.
    error
        Covariance of the readings at a configuration that comes from an imperfect model [unit^2]: of what a
        calibration left uncertain, or of trained networks; none for a robot taken exactly as described.

    Examples
    --------
    >>> import edition1 as repro
    >>> robot = repro.load_robot("data/example/robot.toml")
    >>> robot.robot.coordinates, robot.unit, robot.noise
    (('delta_x_1', 'delta_y_1', 'delta_L_1'), 'mT', 0.00071)
    """

    name: str
    sha256: str
    robot: Robot
    format: str
    rate_hz: float
    unit: str
    channels: int
    channel: tuple[int, ...]
    gain: Float[Tensor, " s"]
    offset: Float[Tensor, " s"]
    noise: float
    moments: Float[Tensor, "*m terms"] | None
    magnets: tuple[Ring | Cube, ...]
    earth_mt: Float[Tensor, " 3"]
    lower: Float[Tensor, " n_q"]
    upper: Float[Tensor, " n_q"]
    imus: tuple[Imu, ...]
    imu_noise: float
    base_orientation: tuple[float, ...]
    networks: tuple[Path, ...]
    notes: tuple[str, ...]
    network_inputs: str = "angles"
    error: Callable[[Tensor], Tensor] | None = None

    @property
    def magnet(self) -> Ring | Cube | None:
        """The magnet that all of them are; none without magnets, or where they are not alike."""
        return self.magnets[0] if len(set(self.magnets)) == 1 else None

    @property
    def start(self) -> Float[Tensor, " n_q"]:
        """Straight, in the middle of the bounds of every elongation (and of an azimuth): where estimators start."""
        middle = (self.lower + self.upper) / 2
        bends = torch.tensor([not name.startswith(("delta_L", "phi")) for name in self.robot.coordinates])
        return torch.where(bends, torch.zeros_like(middle).clamp(self.lower, self.upper), middle)

    def sensing(
        self, model: Given | Sequence[Given] | None = None, *, inputs: str = "cosines"
    ) -> LinearisedSensing | MagneticSensing:
        """Sensor model of an estimator: configuration to :meth:`signal` [unit].

        :func:`edition1.kernels.compiled` takes it, unless ``model`` is a callable of which it knows nothing.

        Parameters
        ----------
        model
            A sensor model of your own, from relations (:mod:`edition1.sensing.relations`) to readings [unit]: a module
            of torch, TorchScript or the path of its file, or any callable; a list for one per segment or per sensor.
            See :meth:`edition1.sensing.own_model.OwnModel.of`.
        inputs
            Whether your model takes the relations as ``"cosines"`` or as ``"angles"`` [rad].

        Raises
        ------
        InputError
            If the robot has no magnetic sensors, or the model does not fit it.
        """
        if not len(self.robot.sensors) or self.moments is None:
            expected = "a robot with magnets and magnetic sensors"
            raise bad_input("robot", self.name, expected, f"one with {len(self.imus)} IMUs")
        size = float(torch.linalg.vector_norm(self.earth_mt))
        axis = self.earth_mt / size if size else None
        if model is None and self.networks:
            of_sensor = network_of_sensor(self.robot, len(self.networks))
            network = PerSensor([load_paper_network(path) for path in self.networks], of_sensor).double()
            return MagneticSensing(self.robot, network, "angles", axis)
        if model is not None:
            if inputs not in ("angles", "cosines"):
                raise bad_input("inputs", "sensing", "'angles' or 'cosines'", repr(inputs))
            at_start = relations(self.robot, self.start, axis)
            xi = at_start.cosines() if inputs == "cosines" else at_start.angles()
            own = OwnModel.of(model, xi, self.robot.sensors.segment, inputs)
            return MagneticSensing(self.robot, own, inputs, axis)
        return LinearisedSensing(self.robot, self.moments, self.gain, self.earth_mt, self.moments.ndim == 2)

    def signal(self, values: Sequence[float]) -> Float[Tensor, " s"]:
        """Part of a frame that depends on the configuration [unit]: readings of the sensors without their offsets.

        Raises
        ------
        InputError
            If the frame has another number of values than the file says.
        """
        if len(values) != self.channels:
            expected = f"of {self.channels} channels, as described in {self.name}"
            raise bad_input("frame", "the stream", expected, f"{len(values)} values")
        u = torch.tensor([values[k] for k in self.channel], dtype=torch.float64)
        return u - self.offset

    def readings(self, table: Any) -> Float[Tensor, "t s"]:
        """Readings of the magnetic sensors in a table, a row for each time step: what estimators take.

        Parameters
        ----------
        table
            A data frame of pandas. A reading of channel 2 is in the column ``u2``, ``ch2``, ``channel_2``, or under
            the number of its sensor, ``sensor_2``; each with the unit behind it, as ``u2_mT`` or ``u2 [mT]``, or
            without. Other columns are not used. A missing reading is NaN.

        Raises
        ------
        InputError
            If a column is missing, ambiguous, of another unit, or holds something else than numbers, or the robot has
            no magnetic sensors.

        Examples
        --------
        >>> import pandas as pd, edition1 as repro
        >>> robot = repro.load_robot("data/robots/one_segment.toml")
        >>> robot.readings(pd.DataFrame({"u1_mT": [1.0], "u2_mT": [2.0], "u3_mT": [3.0], "room [C]": [20.0]}))
        tensor([[1., 2., 3.]], dtype=torch.float64)
        """
        if not self.channel:
            expected = "a robot with magnetic sensors"
            raise bad_input("robot", self.name, expected, f"one with {len(self.imus)} IMUs")
        columns = channel_columns("the table", list(table), self.unit, self.name, self.channels, self.channel)
        for name in (columns[k] for k in self.channel):
            # pandas calls the second column of a name "u1.1"
            once = list(table).count(name) == 1 and f"{name}.1" not in list(table)
            require(once, f"column {name}", "the table", "there once", "two of them")
        return torch.stack(
            [_numbers(table, columns[k]) - self.offset[sensor] for sensor, k in enumerate(self.channel)], -1
        )

    def tip(self, q: Float[Tensor, "*batch n_q"]) -> Float[Tensor, "*batch 4 4"]:
        """Pose of the tip in the frame of the base [m]."""
        return self.robot.tip(q)

    def values(self, q: Float[Tensor, "*q n_q"]) -> Float[Tensor, "*q channels"]:
        """Values of the frames that a board would send at ``q`` [unit], without noise; unused channels are zero."""
        u = self.sensing()(q) + self.offset
        frame = u.new_zeros(*u.shape[:-1], self.channels)
        frame[..., list(self.channel)] = u
        return frame

    def calibrated(self, calibration: RobotCalibration) -> RobotFile:
        """Return the robot as calibrated.

        Raises
        ------
        InputError
            If the calibration belongs to another file, or to another content of this one.
        """
        if calibration.robot_sha256 != self.sha256:
            expected = f"made with {self.name} as it is now (sha256 {self.sha256[:12]})"
            received = f"one made with {calibration.robot} of sha256 {calibration.robot_sha256[:12]}"
            raise bad_input("calibration", self.name, expected, received)
        if self.moments is None or self.networks:
            raise bad_input(
                "calibration", self.name, "of a robot whose sensors read the field of magnets", self.name
            )
        sizes = (len(calibration.offset), len(calibration.earth_mt))
        if sizes != (len(self.robot.sensors), 3):
            expected = f"of {len(self.robot.sensors)} offsets and 3 components of the Earth field"
            raise bad_input("calibration", self.name, expected, f"{sizes[0]} and {sizes[1]}")
        parts = placed(self.robot, self.moments, calibration.parameters)
        return replace(
            self,
            robot=replace(self.robot, magnets=parts.magnets, sensors=parts.sensors),
            moments=parts.moments,
            gain=self.gain * parts.gain,
            offset=self.offset + calibration.offset,
            earth_mt=calibration.earth_mt,
            error=CalibrationError(self.robot, self.moments, self.gain, calibration),
        )


def _numbers(table: Any, column: str | None) -> Float[Tensor, " t"]:
    """Values of a column of a data frame.

    Raises
    ------
    InputError
        If one is not a number; NaN, where a reading is missing, is one.
    """
    values = table[column].to_numpy()
    if values.dtype.kind in "cMm":  # complex numbers, dates and spans of time would be taken for numbers
        raise bad_input(f"column {column}", "the table", "numbers", values.dtype)
    try:
        return torch.from_numpy(np.array(values, dtype=float))
    except (TypeError, ValueError) as error:
        row = next(k for k, value in enumerate(values) if not _is_number(value))
        raise bad_input(
            f"column {column}", "the table", "numbers", f"{values[row]!r} in row {row}"
        ) from error


def _is_number(value: Any) -> bool:
    try:
        float(value)
    except (TypeError, ValueError):
        return False
    return True
