"""The files of one recording of the rig in the authors' raw formats: motion capture (Motive 1.23) and readings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from repro.sensing.rig import RIG_RATE_HZ
from repro_companion.recordings.baaij2023 import raw_paths
from repro_companion.recordings.rig_capture import BODY_COLUMNS
from repro_companion.twins.marker_capture import RingTrack

SYNTHETIC = "synthetic"
"""First part of the name of every recording that this project writes, and its folder of motion capture."""


def write_recording(
    folder: Path, name: str, track: RingTrack, readings_mv: Float[np.ndarray, "readings 3"]
) -> tuple[Path, Path]:
    """Write a recording as raw files; the paths below ``folder`` are those of the authors' repository.

    Numbers of motion capture have six digits after the point (metres and quaternions), as Motive exports them; the
    readings are whole steps of the converter, so nothing of them is lost.

    Parameters
    ----------
    folder
        Folder that stands for the authors' repository; created when needed.
    name
        Name of the recording; motion capture comes to lie in a folder of the part before its first underscore.
    track
        What motion capture saw.
    readings_mv
        Readings at 40 Hz [mV].

    Returns
    -------
    tuple
        The file of motion capture and that of the readings.
    """
    capture, sensors = raw_paths(name, folder)
    for path in (capture, sensors):
        path.parent.mkdir(parents=True, exist_ok=True)
    _write_capture(capture, name, track)
    pd.DataFrame(readings_mv, columns=[f"u{j}" for j in (1, 2, 3)]).to_csv(
        sensors, index=False, float_format="%.4f", lineterminator="\n"
    )
    return capture, sensors


def _write_capture(path: Path, name: str, track: RingTrack) -> None:
    n = len(track.time_s)
    bodies, columns = ("Base", "Ring"), [*BODY_COLUMNS, ("Mean Marker Error", "")]
    header = {
        "Format Version": "1.23",
        "Take Name": name,
        "Take Notes": "",
        "Capture Frame Rate": f"{RIG_RATE_HZ:.6f}",
        "Export Frame Rate": f"{RIG_RATE_HZ:.6f}",
        "Total Frames in Take": n,
        "Total Exported Frames": n,
        "Rotation Type": "Quaternion",
        "Length Units": "Meters",
        "Coordinate Space": "Global",
    }
    lines = [
        ",".join(f"{key},{value}" for key, value in header.items()),
        "",
        ",".join(["", "", *["Rigid Body"] * 16]),
        ",".join(["", "", *(body for body in bodies for _ in columns)]),
        ",".join(["", "", *(f"{k}" for k in (1, 2) for _ in columns)]),
        ",".join(["", "", *(kind for _ in bodies for kind, _ in columns)]),
        ",".join(["Frame", "Time (Seconds)", *(axis for _ in bodies for _, axis in columns)]),
    ]
    # The files hold the inverse of each rotation, in the axes X = x, Y = z, Z = -y.
    quaternion = track.ring_rotation.inv().as_quat()
    ring = np.column_stack(
        [_in_capture_axes(quaternion[:, :3]), quaternion[:, 3], _in_capture_axes(track.ring_m)]
    )
    base = np.column_stack([np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)), _in_capture_axes(track.base_m)])
    error = np.full((n, 1), 1e-4)
    table = np.hstack([base, error, np.where(track.tracked[:, None], np.hstack([ring, error]), np.nan)])
    frames = pd.DataFrame(table)
    frames.insert(0, "time", track.time_s)
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write("\n".join(lines) + "\n")
        frames.to_csv(stream, header=False, float_format="%.6f", lineterminator="\n")


def _in_capture_axes(xyz: np.ndarray) -> np.ndarray:
    return np.column_stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]])
