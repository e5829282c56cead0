"""The parts of a robot, made from the tables of its file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from repro.kinematics.affine_curvature import AffineCurvature
from repro.kinematics.constant_curvature import ConstantCurvature
from repro.kinematics.mounts import Mounts, magnet_mounts, sensor_mounts
from repro.kinematics.robot import Segment
from repro.live.robot.robot_checks import check_place
from repro.live.robot.robot_tables import MAGNET_KINDS, SEGMENT_KINDS, Document, imu_keys
from repro.sensing.magnets import Cube, Ring


@dataclass(frozen=True)
class Imu:
    """An IMU on a robot.

    Parameters
    ----------
    stream
        Stream of its frames.
    segment
        Segment, from 0.
    at_m
        Distance from the base of that segment along the unextended backbone [m].
    arc_m
        Distance from the base of the robot [m].
    """

    stream: int
    segment: int
    at_m: float
    arc_m: float


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
        row = document.checked_kind(SEGMENT_KINDS, "segments", k, placed=False)
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
            bounds.append((low, high))
    if not segments:
        raise document.error(("segments",), "given: at least one table [[segments]]", "nothing")
    return tuple(segments), bounds


def magnets_of(document: Document, lengths: Sequence[float]) -> tuple[Mounts, Ring | Cube | None]:
    """Mounts of the magnets, and the magnet that they all are; none without magnets.

    Raises
    ------
    InputError
        If a table does not describe a magnet, or magnets differ.
    """
    rows = [
        document.checked_kind(MAGNET_KINDS, "magnets", k, placed=True)
        for k in range(len(document.tables("magnets")))
    ]
    for k, row in enumerate(rows):
        check_place(document, "magnets", k, row, lengths)
        for key in rows[0].keys() | row.keys():
            if key not in ("segment", "at_mm") and row.get(key) != rows[0].get(key):
                expected = f"that of magnet 1, {rows[0].get(key)!r}: magnets of one robot are alike"
                raise document.error(("magnets", k, key), expected, row.get(key))
    mounts = magnet_mounts([row["segment"] - 1 for row in rows], [row["at_mm"] / 1e3 for row in rows])
    if not rows:
        return mounts, None
    row = rows[0]
    if row["kind"] == "cube":
        return mounts, Cube(row["edge_mm"] / 1e3, float(row["polarisation_mt"]))
    if not row["inner_diameter_mm"] < row["outer_diameter_mm"]:
        expected = f"below outer_diameter_mm, {row['outer_diameter_mm']!r}"
        raise document.error(("magnets", 0, "inner_diameter_mm"), expected, row["inner_diameter_mm"])
    outer, inner, height = (row[key] / 1e3 for key in ("outer_diameter_mm", "inner_diameter_mm", "height_mm"))
    return mounts, Ring(outer, inner, height, float(row["polarisation_mt"]))


def sensors_of(column: Mapping[str, Sequence[Any]]) -> Mounts:
    """Mounts of the sensors, from the columns of their tables."""
    if not column:
        return sensor_mounts([], [])
    return sensor_mounts(
        [int(k) - 1 for k in column["segment"]],
        [x / 1e3 for x in column["at_mm"]],
        [x / 1e3 for x in column["radial_mm"]],
        [math.radians(x) for x in column["azimuth_deg"]],
        [math.radians(x) for x in column["tilt_deg"]],
    )


def imus_of(document: Document, lengths: Sequence[float]) -> tuple[Imu, ...]:
    """IMUs from base to tip.

    Raises
    ------
    InputError
        If a table does not describe one, two share a stream, or they are not in order.
    """
    found, seen = [], {}
    for k in range(len(document.tables("imus"))):
        row = document.checked(imu_keys(), "imus", k)
        check_place(document, "imus", k, row, lengths)
        if row["stream"] in seen:
            line = document.line("imus", seen[row["stream"]], "stream")
            raise document.error(
                ("imus", k, "stream"), f"another stream than that of line {line}", row["stream"]
            )
        seen[row["stream"]] = k
        segment, at = row["segment"] - 1, row["at_mm"] / 1e3
        found.append(Imu(row["stream"], segment, at, sum(lengths[:segment]) + at))
    arcs = [imu.arc_m for imu in found]
    for k in range(1, len(arcs)):
        if not arcs[k] > arcs[k - 1]:
            raise document.error(
                ("imus", k, "at_mm"), "farther from the base than the IMU before it", arcs[k] * 1e3
            )
    return tuple(found)
