"""The parts of a robot, made from the tables of its file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from edition1.kinematics.affine_curvature import AffineCurvature
from edition1.kinematics.constant_curvature import ConstantCurvature
from edition1.kinematics.mounts import Mounts, directed_sensors, magnet_mounts, sensor_mounts
from edition1.kinematics.robot import Segment
from edition1.robot_file._checks import check_direction, check_place
from edition1.robot_file._document import Document, Key
from edition1.robot_file._tables import MAGNET_KEYS, MAGNET_KINDS, SEGMENT_KINDS, imu_keys, model_keys
from edition1.robot_file.columns import MAGNETIC_STREAM
from edition1.robot_file.imu_readings import Imu
from edition1.sensing.magnets import Cube, Ring


def segments_of(document: Document) -> tuple[tuple[Segment, ...], list[tuple[float, float]]]:
    """Segments from base to tip, and the bounds of their coordinates, those left out at their defaults.

    Without bounds a segment bends by up to 90 degrees (an affine one by its ``kappa_0`` up to that, by its
    ``kappa_1`` up to twice that) and stretches by up to 10 % either way.

    Raises
    ------
    InputError
        If there is no segment, or a table does not describe one.
    """
    segments, bounds = [], []
    for k in range(len(document.tables("segments"))):
        row = document.checked_kind(SEGMENT_KINDS, {}, "segments", k)
        length = row["length_mm"] / 1e3
        stretch = (-0.1 * length, 0.1 * length)
        if row["kind"] == "constant_curvature":
            segment = ConstantCurvature(length, row["radius_mm"] / 1e3)
            bend = math.pi / 2 * segment.radius
            usual = {"delta_x_mm": (-bend, bend), "delta_y_mm": (-bend, bend), "delta_L_mm": stretch}
        else:
            segment, pi = AffineCurvature(length), math.pi
            usual = {"kappa_0_rad": (-pi / 2, pi / 2), "kappa_1_rad": (-pi, pi), "phi_deg": (-pi, pi)}
            usual["delta_L_mm"] = stretch
        segments.append(segment)
        to_si = {"mm": lambda x: x / 1e3, "deg": math.radians, "rad": float}
        for key, standard in usual.items():
            convert = to_si[key.rsplit("_", 1)[1]]
            low, high = map(convert, row[key]) if row[key] else standard
            if key == "delta_L_mm" and not low > -length:
                line = document.line("segments", k, "length_mm")
                expected = f"above {-row['length_mm']:g}: a segment is longer than 0 (line {line}) [mm]"
                raise document.error(("segments", k, key), expected, row[key])
            bounds.append((low, high))
    if not segments:
        raise document.error(("segments",), "given: at least one table [[segments]]", "nothing")
    return tuple(segments), bounds


def magnets_of(document: Document, lengths: Sequence[float]) -> tuple[Mounts, tuple[Ring | Cube, ...]]:
    """Mounts of the magnets, and what each of them is.

    Raises
    ------
    InputError
        If a table does not describe a magnet.
    """
    rows = [
        document.checked_kind(MAGNET_KINDS, MAGNET_KEYS, "magnets", k)
        for k in range(len(document.tables("magnets")))
    ]
    for k, row in enumerate(rows):
        check_place(document, "magnets", k, row, lengths)
    segment, axial = [row["segment"] - 1 for row in rows], [row["at_mm"] / 1e3 for row in rows]
    turned = any(row["direction"] for row in rows)
    direction = [[float(x) for x in row["direction"] or (0, 0, 1)] for row in rows] if turned else None
    magnets = tuple(_magnet(document, k, row) for k, row in enumerate(rows))
    return magnet_mounts(segment, axial, direction), magnets


def networks_of(
    document: Document, folder: Path, segments: int, sensors: int
) -> tuple[tuple[Path, ...], str]:
    """Files of trained networks in the folder of the robot file, and what they take; no files without any.

    They are safetensors, which hold numbers only: TorchScript is a program, and reading a robot runs none.

    Raises
    ------
    InputError
        If ``[model]`` does not name one for all sensors, one per segment or one per sensor, or a file is missing, in
        another folder, or no safetensors file.
    """
    given = document.table("model")
    model = document.checked(model_keys(segments, sensors), "model") if given else {}
    for name in model.get("networks", ()):
        if not name.endswith(".safetensors"):
            expected = (
                "safetensors files: TorchScript is a program, which a file cannot start; load it in Python"
            )
            raise document.error(("model", "networks"), expected, name)
        if not (folder / name).resolve().is_relative_to(folder.resolve()):
            raise document.error(("model", "networks"), "files in the folder of the robot file", name)
    networks = tuple(folder / name for name in model.get("networks", ()))
    if missing := [str(path) for path in networks if not path.is_file()]:
        raise document.error(("model", "networks"), "files beside this one", f"no {missing[0]}")
    return networks, model.get("inputs", "angles")


def _magnet(document: Document, k: int, row: Mapping[str, Any]) -> Ring | Cube:
    if row["kind"] == "cube":
        return Cube(row["edge_mm"] / 1e3, float(row["polarisation_mt"]))
    if not row["inner_diameter_mm"] < row["outer_diameter_mm"]:
        expected = f"below outer_diameter_mm, {row['outer_diameter_mm']!r}"
        raise document.error(("magnets", k, "inner_diameter_mm"), expected, row["inner_diameter_mm"])
    outer, inner, height = (row[key] / 1e3 for key in ("outer_diameter_mm", "inner_diameter_mm", "height_mm"))
    return Ring(outer, inner, height, float(row["polarisation_mt"]))


def sensors_of(
    document: Document, lengths: Sequence[float], keys: Mapping[str, Key]
) -> tuple[Mounts, dict[str, list[Any]]]:
    """Mounts of the sensors, and the columns of their tables; none without sensors.

    Raises
    ------
    InputError
        If a table does not describe a sensor.
    """
    rows = [document.checked(keys, "sensors", k) for k in range(len(document.tables("sensors")))]
    for k, row in enumerate(rows):
        check_place(document, "sensors", k, row, lengths)
        check_direction(document, k)
    if not rows:
        return sensor_mounts([], []), {}
    column = {name: [row[name] for row in rows] for name in keys}
    segment = [int(k) - 1 for k in column["segment"]]
    axial, radial = ([x / 1e3 for x in column[key]] for key in ("at_mm", "radial_mm"))
    azimuth, tilt = ([math.radians(x) for x in column[key]] for key in ("azimuth_deg", "tilt_deg"))
    mounts = sensor_mounts(segment, axial, radial, azimuth, tilt)
    if directed := [k for k, direction in enumerate(column["direction"]) if direction]:
        direction = torch.tensor([x or [1.0, 0.0, 0.0] for x in column["direction"]], dtype=torch.float64)
        turned = directed_sensors(segment, axial, radial, azimuth, direction)
        local = mounts.local.clone()
        local[directed] = turned.local[directed]
        mounts = replace(mounts, local=local)
    return mounts, column


def imus_of(document: Document, lengths: Sequence[float]) -> tuple[Imu, ...]:
    """IMUs from base to tip.

    Raises
    ------
    InputError
        If a table does not describe one, two share a stream or one has that of the magnetic sensors, they are not
        in order, or one has no heading on a robot of IMUs alone.
    """
    found, seen, sensors = [], {}, bool(document.tables("sensors"))
    for k in range(len(document.tables("imus"))):
        row = document.checked(imu_keys(), "imus", k)
        check_place(document, "imus", k, row, lengths)
        if row["stream"] in seen:
            line = document.line("imus", seen[row["stream"]], "stream")
            raise document.error(
                ("imus", k, "stream"), f"another stream than that of line {line}", row["stream"]
            )
        seen[row["stream"]] = k
        if sensors and row["stream"] == MAGNETIC_STREAM:
            expected = f"another than {MAGNETIC_STREAM}, the stream of the magnetic sensors"
            raise document.error(("imus", k, "stream"), expected, row["stream"])
        free = row["heading"] == "free"
        if free and not sensors:
            expected = "'absolute' without magnetic sensors: a chain of IMUs takes their headings as they are"
            raise document.error(("imus", k, "heading"), expected, "'free'")
        segment, at, mounted = row["segment"] - 1, row["at_mm"] / 1e3, tuple(map(float, row["mounted"]))
        found.append(Imu(row["stream"], segment, at, sum(lengths[:segment]) + at, mounted, free))
    arcs = [imu.arc_m for imu in found]
    for k in range(1, len(arcs)):
        if not arcs[k] > arcs[k - 1]:
            raise document.error(
                ("imus", k, "at_mm"), "farther from the base than the IMU before it", arcs[k] * 1e3
            )
    return tuple(found)
