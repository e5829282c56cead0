"""The released files of the trial of Martin et al. (2022): what their models gave, and the motion capture.

The tables of the models stand in the authors' repository below ``data analysis/data`` and are read as they are. A row
has the time of its replay and eight points; the origin is 17.8 mm above the base. Points that a model did not give
have the number 0 and are at 0, 0, 0. The time column is the clock of a replay (249 s in one file, 1242 s in another,
for one trial), so tables are aligned by row.

The file of the motion capture is found, verified, and read by a layout that the user names: it is listed in
``data/sources.json`` but was not available when this was written, so its columns are not known here. Nothing is
guessed: whoever has the file says which columns hold what.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from edition1.errors import bad_input, require
from edition1_companion.recordings.released import verified
from edition1_companion.recordings.sources import data_dir

OUTPUT_FOLDER = "martin2022/data analysis/data"
OUTPUTS = {
    "elephant/rigid/rigid.csv": "0ef61cda3505ebece0b4a497cf776100c09fd98450a1921d56fd9c9b283b8345",
    "elephant/pcc/pcc1.csv": "235230efe41ae8f8da27dcad62069a0eb04fba9a86968e7364685aa31ef5de31",
    "elephant/pcc/pcc2.csv": "e3cbff8ea919cdd106d85290eeee3ca732e71ba70a911071ec3ee98bfd5fc241",
    "elephant/pcc/pcc4.csv": "2db575fc5ff5959865120fa4d65c80969fc9c82ec4d1f8fac984e167ce46fd66",
    "elephant/pcc/pcc8.csv": "f51b7715b3504a80d955d98b71398137aa6438e5a531b877e4efde857d78be3d",
    "fly/less_imu/less_imu_2.csv": "f2d57ecf6017947ef3a1d44f34346b2cc1564fe58951f77c91182ad3a1185cf5",
    "fly/less_imu/less_imu_4.csv": "7c9215d4f52a7e6edccfff1e93dd412a6486ad21b32ead812fcf598dce9491f9",
    "fly/pcc16/pcc16_2.csv": "9cb8227b7bf4f9aca1c0927557c239eafafd671e0a8bf5a537c07349b8aefd02",
    "fly/pcc16/pcc16_4.csv": "b1a542776be0f51f93cf8924bd6e8a69959cb3b0a06a2c80668c26081773d809",
}
"""Names and sha256 of the released tables behind the paper's figures, and of ``rigid.csv``, which stands in none
(repository State-Estimator-for-Soft-Arm-SESA, commit 6045c11)."""
ORIGIN_M = 0.0178
"""Height of the tables' origin above the base [m]."""
POINTS = 8
SCORED_ROWS = (1000, 8000)
"""Rows that the released analysis scores: from the first to before the second."""
RIGID_LINKS_M = (0.102, *(0.08,) * 6)
"""Links of ``rigid.csv``, along the z axes of IMUs #1 to #7 [m]; its points are the joints, the origin included."""
MARKER_POINTS = (4, 7)
"""Points of both tables that stand for the markers M1 and M2."""
_TIME_FORMAT = "%Y/%m/%d/%H:%M:%S.%f"


@dataclass(frozen=True)
class ModelOutput:
    """A released table.

    Attributes
    ----------
    points
        Positions [m] of the points ``.ID_0`` to ``.ID_7``, from the table's origin, z up; NaN where the model gave
        none.
    replay_s
        Times of the replay after the first row [s]; not those of the trial.
    """

    points: Float[np.ndarray, "rows 8 3"]
    replay_s: Float[np.ndarray, " rows"]


def find_output(name: str) -> Path | None:
    """Return where a released table lies below `edition1_companion.recordings.sources.data_dir`, or None if it does not.

    Raises
    ------
    InputError
        If ``name`` is none of :data:`OUTPUTS`, or the file found is not the released one (by its sha256).
    """
    require(name in OUTPUTS, "name", "find_output", f"one of {', '.join(OUTPUTS)}", name)
    return verified(data_dir() / OUTPUT_FOLDER / name, name, OUTPUT_FOLDER, sha256=OUTPUTS[name])


def read_output(path: Path) -> ModelOutput:
    """Read a table of a model's points.

    Parameters
    ----------
    path
        CSV file with the columns ``time`` (``2022/02/23/15:44:33.431827``) and ``.ID_k, .xk, .yk, .zk`` for k from
        0 to 7, among others; positions in metres. ``.ID_k`` is k, or 0 with the position 0, 0, 0: no such point.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    InputError
        No table of comma-separated values, missing columns, a cell that is not a finite number, an id that is not
        its column's, a time that cannot be read, or times that go backwards.
    """
    if not path.is_file():
        raise FileNotFoundError(f"There is no table {path.name} in {path.parent}.")
    try:
        table = pd.read_csv(path)
    except ValueError as error:  # bytes that are no text, no columns, lines of unlike lengths
        expected = "a table of comma-separated values in UTF-8"
        raise bad_input("content", path.name, expected, f"{type(error).__name__}: {error}") from error
    names = [[f".{axis}{k}" for axis in "xyz"] for k in range(POINTS)]
    ids = [f".ID_{k}" for k in range(POINTS)]
    expected = ["time", *ids, *(name for point in names for name in point)]
    if missing := [name for name in expected if name not in table]:
        raise bad_input(
            "columns", path.name, "time, .ID_0, .x0, .y0, .z0 to .ID_7 and its own", f"none of {missing}"
        )
    require(not table.empty, "rows", path.name, "at least one", "none")
    numbers = table[expected[1:]].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    if not (finite := np.isfinite(numbers).all(axis=1)).all():
        raise bad_input(
            "values", path.name, "finite numbers", f"something else in row {int(np.argmin(finite))}"
        )
    numbered, points = numbers[:, :POINTS] == np.arange(POINTS), numbers[:, POINTS:].reshape(-1, POINTS, 3)
    none = ~numbered & (numbers[:, :POINTS] == 0) & (points == 0).all(axis=-1)
    if not (fits := (numbered | none).all(axis=1)).all():
        row = int(np.argmin(fits))
        raise bad_input("ids", path.name, "0 to 7", f"{numbers[row, :POINTS].tolist()} in row {row}")
    times = pd.to_datetime(table["time"], format=_TIME_FORMAT, errors="coerce")
    if times.isna().any():
        row = int(np.argmax(times.isna()))
        raise bad_input("time", path.name, "yyyy/mm/dd/HH:MM:SS.ffffff", f"{table['time'][row]} in row {row}")
    replay_s = (times - times[0]).dt.total_seconds().to_numpy(dtype=float)
    if (np.diff(replay_s) < 0).any():
        row = int(np.argmax(np.diff(replay_s) < 0)) + 1
        raise bad_input("time", path.name, "in order", f"a step back to row {row}")
    return ModelOutput(np.where(none[..., None], np.nan, points), replay_s)


CAPTURE = "elephant/mocap/mocap_base_and_2_points_1.csv"
CAPTURE_BLOB = "63d79912f714aae310c9c82a8e80d2223e0059fc"
"""Hash under which git stores the released file (commit 6045c11); its sha256 is not known."""
LAYOUT = {
    "header_row": "number of the line with the names of the columns, from 0",
    "first_row": "number of the first line of numbers, from 0",
    "time_s": "name of the column of times [s], or rows per second as a number",
    "base": "names of the columns of x, y and z (up) of the base",
    "M1": "names of the columns of x, y and z of the marker at 360 mm",
    "M2": "names of the columns of x, y and z of the marker at 600 mm",
    "metres_per_unit": "0.001 where positions are in millimetres",
}
"""What a layout must say, and in which words."""


@dataclass(frozen=True)
class MarkerCapture:
    """Markers as motion capture saw them.

    Attributes
    ----------
    time_s
        Increasing times [s].
    markers
        Positions [m] of M1 and M2 from the base, z up; NaN where base or marker were not seen.
    dropped
        Number of marker positions that are NaN.
    """

    time_s: Float[np.ndarray, " frames"]
    markers: Float[np.ndarray, "frames 2 3"]
    dropped: int


def find_capture() -> Path | None:
    """Return where the released motion capture lies below `edition1_companion.recordings.sources.data_dir`, or None.

    Raises
    ------
    InputError
        If the file found is not the released one, by its git blob hash.
    """
    return verified(data_dir() / OUTPUT_FOLDER / CAPTURE, CAPTURE, OUTPUT_FOLDER, git_blob=CAPTURE_BLOB)


def read_capture(path: Path, layout: Mapping[str, Any]) -> MarkerCapture:
    """Read base and markers from a file of motion capture.

    Parameters
    ----------
    path
        Text file of comma-separated values.
    layout
        What :data:`LAYOUT` asks for.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    InputError
        If the layout is not complete (the message shows the first lines of the file), a column is not there, or
        times do not increase.
    """
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path.name} in {path.parent}.")
    if missing := [name for name in LAYOUT if name not in layout]:
        what = "a mapping that names " + "; ".join(f"{name} ({LAYOUT[name]})" for name in missing)
        raise bad_input("layout", path.name, what, f"none of them; the file begins {_beginning(path)}")
    header, first = int(layout["header_row"]), int(layout["first_row"])
    try:
        table = pd.read_csv(path, header=None, skiprows=first)
        names = pd.read_csv(path, header=None, skiprows=header, nrows=1).iloc[0].astype(str).tolist()
    except (ValueError, IndexError) as error:  # no text, no such lines, lines of unlike lengths
        expected = f"comma-separated values in UTF-8, names in line {header} and numbers from line {first}"
        raise bad_input("content", path.name, expected, f"{type(error).__name__}: {error}") from error
    table.columns = [names[k] if k < len(names) else f"column {k}" for k in range(table.shape[1])]
    parts = {
        name: float(layout["metres_per_unit"]) * _columns(table, layout[name], 3, path.name)
        for name in ("base", "M1", "M2")
    }
    if isinstance(layout["time_s"], str):
        time_s = _columns(table, [layout["time_s"]], 1, path.name)[:, 0]
    else:
        time_s = np.arange(len(table)) / float(layout["time_s"])
    if not (np.diff(time_s) > 0).all():
        raise bad_input("time_s", path.name, "increasing", time_s[:5])
    markers = np.stack([parts["M1"] - parts["base"], parts["M2"] - parts["base"]], axis=1)
    seen = np.asarray(np.isfinite(markers).all(axis=-1))
    return MarkerCapture(time_s, np.where(seen[..., None], markers, np.nan), int((~seen).sum()))


def _beginning(path: Path) -> str:
    with path.open(encoding="utf-8", errors="replace") as stream:
        return " | ".join(line.strip()[:60] for line, _ in zip(stream, range(3), strict=False))


def _columns(table: pd.DataFrame, names: list[str], count: int, owner: str) -> np.ndarray:
    found = [name for name in names if list(table.columns).count(name) == 1]
    if len(names) != count or found != list(names):
        expected = f"{count} among {', '.join(map(str, table.columns))}, each there once"
        raise bad_input("columns", owner, expected, list(names))
    return table[list(names)].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
