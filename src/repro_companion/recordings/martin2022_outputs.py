"""What the models of Martin et al. (2022) gave in the paper's own trial: released tables, read as they are.

The tables stand in the authors' repository below ``data analysis/data``. A row has the time of its replay and eight
points; the origin is 17.8 mm above the base. Points that a model did not give have the number 0 and are at 0, 0, 0.
The time column is the clock of a replay (249 s in one file, 1242 s in another, for one trial), so tables are aligned
by row.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from repro.errors import bad_input
from repro_companion.recordings.released import verified
from repro_companion.recordings.sources import data_dir

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
    """Return where a released table lies below `repro_companion.recordings.sources.data_dir`, or None if it does not.

    Raises
    ------
    InputError
        If ``name`` is none of :data:`OUTPUTS`, or the file found is not the released one (by its sha256).
    """
    if name not in OUTPUTS:
        raise bad_input("name", "find_output", f"one of {', '.join(OUTPUTS)}", name)
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
    if table.empty:
        raise bad_input("rows", path.name, "at least one", "none")
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
