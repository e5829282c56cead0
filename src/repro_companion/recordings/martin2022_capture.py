"""The motion capture of the trial of Martin et al. (2022): found, verified, and read by a layout that the user names.

The file is listed in ``data/sources.json`` but was not available when this was written, so its columns are not known
here. Nothing is guessed: whoever has the file says which columns hold what.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from repro.errors import bad_input
from repro_companion.recordings.martin2022_outputs import OUTPUT_FOLDER
from repro_companion.recordings.released import verified
from repro_companion.recordings.sources import data_dir

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
    """Return where the released motion capture lies below `repro_companion.recordings.sources.data_dir`, or None.

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
