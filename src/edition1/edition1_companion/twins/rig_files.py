"""Motion capture of the rig's ring of markers, and the files of a recording in the authors' raw formats.

Motion capture (Motive 1.23) has its own clock, noise, and frames in which the ring is lost. Frames are those of
`edition1_companion.recordings.rig_capture`: the base frame of the robot; motion capture exchanges axes in its files.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from edition1_companion.recordings.baaij2023 import raw_paths
from edition1_companion.recordings.rig_capture import BASE_HEIGHT_M, BODY_COLUMNS
from edition1_companion.recordings.rig_robot import RIG_LENGTH_M, RIG_MARKERS_M, RIG_RATE_HZ, rig_segment

SYNTHETIC = "synthetic"
"""First part of the name of every recording that this project writes, and its folder of motion capture."""


@dataclass(frozen=True)
class MarkerCapture:
    """How motion capture sees the ring.

    Parameters
    ----------
    noise_mm, noise_deg
        Standard deviation of the position along each axis and of the rotation about each axis; assumed.
    gaps_per_s
        How often the ring is lost, for one or two frames; assumed.
    clock_ppm
        How much faster its clock runs than that of the sensors; assumed.
    latest_start_s
        It and the sensors start within this time, each at random; assumed.
    ring_offset_mm
        Position of the ring's centre beside the backbone, along x and y; assumed.
    base_mm
        Position of the base in its frame; assumed.
    """

    noise_mm: float
    noise_deg: float
    gaps_per_s: float
    clock_ppm: float
    latest_start_s: float
    ring_offset_mm: tuple[float, float]
    base_mm: tuple[float, float, float]


@dataclass(frozen=True)
class RingTrack:
    """What motion capture exports, still in the axes of the robot.

    Attributes
    ----------
    time_s
        Times by its own clock [s].
    base_m
        Position of the base body in every frame [m].
    ring_m, ring_rotation
        Position [m] and rotation (ring to base) of the ring.
    tracked
        Whether the ring was seen.
    """

    time_s: Float[np.ndarray, " frames"]
    base_m: Float[np.ndarray, "frames 3"]
    ring_m: Float[np.ndarray, "frames 3"]
    ring_rotation: Rotation
    tracked: Bool[np.ndarray, " frames"]


def capture_ring(
    capture: MarkerCapture,
    time_s: Float[np.ndarray, " frames"],
    q: Float[np.ndarray, "frames 3"],
    rng: np.random.Generator,
) -> RingTrack:
    """See the ring of a segment in configurations ``q`` [m].

    Parameters
    ----------
    capture
        How it is seen.
    time_s
        Times by its own clock [s].
    q
        Configurations at these times [m].
    rng
        Source of the random numbers. The first and the last frame are never lost.
    """
    n = len(time_s)
    pose = rig_segment().pose(torch.from_numpy(q), torch.tensor(RIG_MARKERS_M / RIG_LENGTH_M)).numpy()
    base = 1e-3 * np.array(capture.base_mm)
    ring = base + pose[:, :3, 3] + 1e-3 * np.array([*capture.ring_offset_mm, 0.0])
    noise = 1e-3 * capture.noise_mm * rng.standard_normal((2, n, 3))
    turn = Rotation.from_rotvec(np.radians(capture.noise_deg) * rng.standard_normal((n, 3)))
    base_body = base + [0.0, 0.0, BASE_HEIGHT_M] + noise[0]
    return RingTrack(
        time_s=time_s,
        base_m=base_body,
        ring_m=ring + noise[1],
        ring_rotation=Rotation.from_matrix(pose[:, :3, :3]) * turn,
        tracked=_tracked(n, capture.gaps_per_s * float(np.diff(time_s).mean()), rng),
    )


def _tracked(n: int, probability: float, rng: np.random.Generator) -> np.ndarray:
    """Lose the ring for one or two frames, with at least one frame in which it is seen in between."""
    tracked = np.ones(n, dtype=bool)
    for k in np.flatnonzero(rng.random(n) < probability):
        length = int(rng.integers(1, 3))
        if k > 0 and k + length + 1 < n and tracked[k - 1 : k + length + 1].all():
            tracked[k : k + length] = False
    return tracked


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
