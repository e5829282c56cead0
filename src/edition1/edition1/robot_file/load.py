"""Reading a robot file: its tables, checked, become a `edition1.robot_file.robot_file.RobotFile`."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from pathlib import Path

import torch

from edition1.errors import bad_input, require
from edition1.kinematics.robot import Robot
from edition1.robot_file import _checks as robot_checks
from edition1.robot_file._document import Document
from edition1.robot_file._magnet_moments import shared_moments
from edition1.robot_file._parts import imus_of, magnets_of, networks_of, segments_of, sensors_of
from edition1.robot_file._reading_errors import network_error
from edition1.robot_file._tables import UNITS, sensor_keys, stream_keys, top_keys
from edition1.robot_file._unobserved import unobserved
from edition1.robot_file.calibration_file import RobotCalibration
from edition1.robot_file.robot_file import RobotFile


def load_robot(path: Path | str, calibration: Path | str | None = None) -> RobotFile:
    """Read a robot file, and apply a calibration if there is one.

    Raises
    ------
    InputError
        If the file does not describe a robot; the message names file, line and key.

    Examples
    --------
    >>> load_robot("data/example/robot.toml").tip(torch.zeros(3, dtype=torch.float64))[:3, 3]  # straight [m]
    tensor([0.0000, 0.0000, 0.1100], dtype=torch.float64)
    """
    path = Path(path)
    require(path.is_file(), "path", "load_robot", "a robot file", path)
    content = path.read_bytes()
    try:
        text = content.decode("utf-8-sig")  # some editors of Windows begin with a byte-order mark
    except UnicodeDecodeError as error:
        raise bad_input("file", path.name, "text in UTF-8", error) from error
    document = Document.of(path.name, text.replace("\r\n", "\n"))
    described = _described(document, hashlib.sha256(content).hexdigest(), path.parent)
    return (
        described if calibration is None else described.calibrated(RobotCalibration.read(Path(calibration)))
    )


def _described(document: Document, sha256: str, folder: Path) -> RobotFile:
    top = document.checked(top_keys())
    segments, bounds = segments_of(document)
    lengths = tuple(segment.length for segment in segments)
    mounts, magnets = magnets_of(document, lengths)
    stream = document.table("stream")
    sensors = document.tables("sensors")
    imus = imus_of(document, lengths)
    values = document.checked(stream_keys(bool(sensors), bool(imus), stream.get("unit")), "stream")
    unit = values.get("unit", UNITS[0])
    robot_checks.check_format(document, values["format"], unit, bool(sensors), bool(imus))
    networks, network_inputs = networks_of(document, folder, len(segments), len(sensors))
    places, column = sensors_of(document, lengths, sensor_keys(unit, bool(networks)))
    used = column.get("channel", [])
    channels = robot_checks.check_channels(document, used, values)
    gain = column.get("gain", column.get(f"gain_{unit.lower()}_per_mt", [1.0] * len(used)))
    earth = torch.tensor(top["earth_mt"], dtype=torch.float64)
    robot = Robot(segments, mounts, places)
    found = RobotFile(
        name=document.name,
        sha256=sha256,
        robot=robot,
        format=values["format"],
        rate_hz=float(values["rate_hz"]),
        unit=unit,
        channels=channels,
        channel=tuple(k - 1 for k in used),
        gain=torch.tensor(gain, dtype=torch.float64),
        offset=torch.tensor(column.get(f"offset_{unit.lower()}", []), dtype=torch.float64),
        noise=float(values.get(f"noise_{unit.lower()}", 1.0)),
        moments=shared_moments(magnets),
        magnets=magnets,
        earth_mt=earth,
        lower=torch.tensor([low for low, _ in bounds], dtype=torch.float64),
        upper=torch.tensor([high for _, high in bounds], dtype=torch.float64),
        imus=imus,
        imu_noise=math.radians(values.get("noise_deg", 0.0)),
        base_orientation=tuple(map(float, top["base_orientation"])),
        networks=networks,
        notes=(),
        network_inputs=network_inputs,
    )
    robot_checks.check_observed(document, robot, [(imu.segment, imu.at_m) for imu in imus], bool(earth.any()))
    if sensors and not magnets:
        raise document.error(("sensors", 0, "channel"), "of a robot with [[magnets]]", "one without")
    notes = robot_checks.out_of_range(document, found) + unobserved(found)
    robot_checks.check_networks(document, found)
    error = network_error(networks, robot, unit)
    if networks and error is None:
        notes += (
            f"{found.name}: no error of the networks is known; what estimates state holds the noise alone.",
        )
    return replace(found, notes=notes, error=error)
