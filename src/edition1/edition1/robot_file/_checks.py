"""What a robot file must not say although every key by itself is fine."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from edition1.errors import InputError
from edition1.kinematics.robot import Robot
from edition1.robot_file._document import Document
from edition1.robot_file._tables import MOST_CHANNELS, MOST_VALUES
from edition1.sensing.magnets import Cube, Ring

_OWN_UNIT = {"hall": "raw", "millivolts": "mV"}
"""Formats whose values have a unit by themselves."""
_IN_RANGE = 10.0
"""A magnet is in range of a sensor if it can change the reading by this many standard deviations of its noise."""


@runtime_checkable
class _Sensed(Protocol):
    @property
    def robot(self) -> Robot: ...
    @property
    def start(self) -> Tensor: ...
    @property
    def magnets(self) -> tuple[Ring | Cube, ...]: ...
    @property
    def moments(self) -> Tensor | None: ...
    @property
    def gain(self) -> Tensor: ...
    @property
    def noise(self) -> float: ...
    @property
    def networks(self) -> tuple[Path, ...]: ...
    @property
    def unit(self) -> str: ...
    @property
    def network_inputs(self) -> str: ...
    def sensing(self) -> Any: ...


def check_place(
    document: Document, name: str, k: int, row: Mapping[str, Any], lengths: Sequence[float]
) -> None:
    """Refuse a part on a segment that does not exist, or beyond its ends.

    Raises
    ------
    InputError
        As said.
    """
    n = len(lengths)
    if row["segment"] > n:
        raise document.error(
            (name, k, "segment"), f"between 1 and {n}, the number of segments", row["segment"]
        )
    length = lengths[row["segment"] - 1] * 1e3
    if row["at_mm"] > length * (1 + 1e-12):
        line = document.line("segments", row["segment"] - 1, "length_mm")
        expected = f"at most {length:g}, the length of segment {row['segment']} (line {line}) [mm]"
        raise document.error((name, k, "at_mm"), expected, row["at_mm"])


def check_channels(document: Document, used: Sequence[int], stream: Mapping[str, Any]) -> int:
    """Refuse two sensors on one channel, and channels that the stream does not have; return how many it has.

    Raises
    ------
    InputError
        As said.
    """
    given, exact = stream.get("channels", 0), stream["format"] == "hall"
    most = MOST_VALUES.get(stream["format"], MOST_CHANNELS)
    if given and (given > most or (exact and given != most)):
        expected = f"{'' if exact else 'at most '}{most}, the values of a frame of this format"
        raise document.error(("stream", "channels"), expected, given)
    channels = most if exact else given or max(used, default=0)
    line = document.line("stream", "channels" if given else "format")
    first: dict[int, int] = {}
    for k, channel in enumerate(used):
        if channel in first:
            before = document.line("sensors", first[channel], "channel")
            expected = f"another channel than that of sensor {first[channel] + 1} (line {before})"
            raise document.error(("sensors", k, "channel"), expected, channel)
        if channel > min(channels, most):
            expected = f"at most {min(channels, most)} (line {line})"
            raise document.error(("sensors", k, "channel"), expected, channel)
        first[channel] = k
    return channels


def check_format(document: Document, format: str, unit: str, sensors: bool, imus: bool) -> None:
    """Refuse a format that cannot carry what the robot has, or not in that unit.

    Raises
    ------
    InputError
        As said.
    """
    if sensors and imus and format != "frames":
        expected = "'frames' for magnetic sensors and IMUs together"
        raise document.error(("stream", "format"), expected, repr(format))
    if sensors and format == "quaternions":
        raise document.error(
            ("stream", "format"), "of magnetic sensors: quaternions are of IMUs", repr(format)
        )
    if imus and format in _OWN_UNIT:
        raise document.error(("stream", "format"), "'frames' or 'quaternions' for IMUs", repr(format))
    if sensors and unit != _OWN_UNIT.get(format, unit):
        expected = f"{_OWN_UNIT[format]!r}, the unit of {format} (line {document.line('stream', 'format')})"
        raise document.error(("stream", "unit"), expected, repr(unit))


def check_direction(document: Document, k: int) -> None:
    """Refuse a sensor with a direction and what else would say where it points.

    Raises
    ------
    InputError
        As said.
    """
    table = document.tables("sensors")[k]
    if "direction" not in table:
        return
    line = document.line("sensors", k, "direction")
    if "tilt_deg" in table:
        expected = f"left out: direction (line {line}) says where the sensor points"
        raise document.error(("sensors", k, "tilt_deg"), expected, table["tilt_deg"])
    if "azimuth_deg" in table and not table.get("radial_mm"):
        expected = f"left out on the backbone: direction (line {line}) does not turn with it"
        raise document.error(("sensors", k, "azimuth_deg"), expected, table["azimuth_deg"])


def check_observed(document: Document, robot: Robot, imus: Sequence[tuple[int, float]], earth: bool) -> None:
    """Refuse a segment that lies between no sensor and a magnet (or the base, for IMUs and in an Earth field).

    Raises
    ------
    InputError
        If there is such a segment.
    """
    ends = [(0, 0.0)]
    pairs = [(ends[0], imu) for imu in imus]
    magnets, sensors = (
        list(zip(mounts.segment, mounts.axial.tolist(), strict=True))
        for mounts in (robot.magnets, robot.sensors)
    )
    pairs += [(m, s) for s in sensors for m in [*magnets, *(ends if earth else [])]]
    for i, segment in enumerate(robot.segments):
        bottom, top = (i, 0.0), (i, segment.length)
        if not any(min(pair) < top and max(pair) > bottom and pair[0] != pair[1] for pair in pairs):
            expected = (
                "of a segment between a magnet and a sensor, or below an IMU: nothing observes this one"
            )
            raise document.error(("segments", i, "kind"), expected, document.tables("segments")[i]["kind"])


def check_networks(document: Document, found: _Sensed) -> None:
    """Refuse networks that do not fit, now and not when they are first used.

    Raises
    ------
    InputError
        As said.
    """
    if not found.networks:
        return
    if found.network_inputs != "angles":
        expected = "'angles', which networks of the paper's recipe take"
        raise document.error(("model", "inputs"), expected, repr(found.network_inputs))
    try:
        found.sensing()
    except InputError as error:
        line = f"{document.name}, line {document.line('model', 'networks')}"
        raise InputError(f"{line}, [model]: {error}") from error


def out_of_range(document: Document, found: _Sensed) -> tuple[str, ...]:
    """Return warnings about sensors that no magnet reaches, with the distances where estimators start.

    A magnet reaches a sensor if its dipole, :math:`2 A_1/d^3` at most, is ``_IN_RANGE`` times the noise.

    Raises
    ------
    InputError
        If a sensor is so close to a magnet that the series of its field has no meaning.
    """
    if found.moments is None:
        return ()
    T_m, T_s = found.robot.magnet_and_sensor_poses(found.start)
    distance = torch.linalg.vector_norm(T_s[:, None, :3, 3] - T_m[None, :, :3, 3], dim=-1)
    signal = (2 * found.moments[..., 0] / distance**3).abs() * found.gain.abs().unsqueeze(-1)
    notes = []
    for j, row in enumerate(distance.tolist()):
        near = min(range(len(row)), key=row.__getitem__)
        for k in sorted(range(len(row)), key=row.__getitem__):
            reach = _radius(found.magnets[k])
            if not row[k] > reach:
                expected = f"farther than {reach * 1e3:.1f} mm from the centre of magnet {k + 1}"
                raise document.error(("sensors", j, "at_mm"), expected, f"{row[k] * 1e3:.1f} mm from it")
        strong = int(signal[j].argmax())
        if not found.networks and float(signal[j, strong]) < _IN_RANGE * found.noise:
            distances = ", ".join(f"magnet {k + 1} at {d * 1e3:.0f} mm" for k, d in enumerate(row))
            who = "the nearest" if strong == near else f"magnet {strong + 1}"
            notes.append(
                f"{document.name}, line {document.line('sensors', j)}: no magnet is in range of sensor {j + 1} "
                f"({distances}): {who} gives it {float(signal[j, strong]):.2g} {found.unit} at most, "
                f"with a noise of {found.noise:.2g}."
            )
    return tuple(notes)


def _radius(magnet: Ring | Cube) -> float:
    """Radius of the sphere around a magnet [m]."""
    if isinstance(magnet, Ring):
        return math.hypot(magnet.outer_diameter, magnet.height) / 2
    return math.sqrt(3) / 2 * magnet.edge
