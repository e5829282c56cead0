"""Rigid bodies of a file exported by OptiTrack Motive, in the axes of a robot that stands upright."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from repro.errors import bad_input
from repro_live.own.optitrack import read_header
from repro_live.robot.number_table import check_times, read_rows

LENGTH_UNITS = {"Meters": 1.0, "Centimeters": 1e-2, "Millimeters": 1e-3}
_KEYS = [("Position", axis) for axis in "XYZ"] + [("Rotation", axis) for axis in "XYZW"]


def is_motive(path: Path) -> bool:
    """Whether a file starts as Motive's exports do."""
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        return stream.read(64).removeprefix(b"\xef\xbb\xbf").startswith(b"Format Version")


def read_bodies(
    path: Path, names: Sequence[str]
) -> tuple[Float[np.ndarray, " frames"], Float[np.ndarray, "frames bodies 7"]]:
    """Read times [s], and of every named body position [m] and quaternion (x, y, z, w); NaN where it was not seen.

    Motive's y axis points up and a body's axes are the world's when it is defined, so with a robot that stands
    straight up :math:`(x, y, z) = (X, -Z, Y)` are axes with z towards its tip, for world and bodies.

    Parameters
    ----------
    path
        CSV export with quaternions, global coordinates; versions 1.2x.
    names
        Of the bodies.

    Raises
    ------
    InputError
        Another version, rotation type or unit; a body that is not there; numbers that are none; fewer frames than
        the header says.
    """
    rows = read_rows(path)
    axes = next((k for k, (_, row) in enumerate(rows) if row[0] == "Frame"), 0)
    heads = {row[1]: row for _, row in rows[:axes] if len(row) > 1}
    if axes < 2 or "Name" not in heads:
        raise bad_input("header", path.name, "one of Motive: lines with Name and Frame", "none")
    first = rows[0][1]
    version = dict(zip(first[0::2], first[1::2], strict=False)).get("Format Version", "")
    if not version.startswith("1.2"):
        raise bad_input("Format Version", path.name, "1.20 to 1.29", version or "nothing")
    header = read_header([first], path.name, version=version, frames=len(rows) - axes - 1)
    for name, accepted in (("Length Units", list(LENGTH_UNITS)), ("Coordinate Space", ["Global"])):
        if header.get(name) not in accepted:
            raise bad_input(name, path.name, " or ".join(accepted), header.get(name, "nothing"))
    columns = list(zip(heads["Name"], rows[axes - 1][1], rows[axes][1], strict=False))
    there = sorted({name for name, kind, _ in columns if kind == "Rotation"})
    if missing := [name for name in names if any((name, *key) not in columns for key in _KEYS)]:
        expected = f"rigid bodies of the file ({', '.join(there) or 'there is none'})"
        raise bad_input("body", path.name, expected, ", ".join(missing))
    picked = [columns.index((name, *key)) for name in names for key in _KEYS]
    try:
        table = np.array([[float(row[k] or "nan") for k in (1, *picked)] for _, row in rows[axes + 1 :]])
    except (ValueError, IndexError) as error:
        raise bad_input("frames", path.name, "rows of numbers", error) from error
    lines = [line for line, _ in rows[axes + 1 :]]
    check_times(path.name, "Time (Seconds)", table[:, 0], lines, apart=True)
    bodies = table[:, 1:].reshape(len(table), len(names), 7)
    bodies[..., :3] *= LENGTH_UNITS[header["Length Units"]]
    x, y, z = (bodies[..., [k, k + 3]].copy() for k in range(3))
    bodies[..., [0, 3]], bodies[..., [1, 4]], bodies[..., [2, 5]] = x, -z, y
    return table[:, 0], bodies
