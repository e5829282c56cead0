"""Motion capture of the rig's ring of markers: its own clock, noise, and frames in which the ring is lost.

Frames are those of `repro_companion.recordings.rig_capture`: the base frame of the robot, from which motion capture
differs by an exchange of axes that `repro_companion.twins.rig_files` makes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from repro.sensing.rig import RIG_LENGTH_M, RIG_MARKERS_M, rig_segment
from repro_companion.recordings.rig_capture import BASE_HEIGHT_M


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
