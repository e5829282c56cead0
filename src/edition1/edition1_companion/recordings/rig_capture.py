r"""Motion capture of the rig of Baaij et al. 2023, section 5: from Motive's files to configurations.

The pose of a ring of markers near the tip gives the configuration in closed form (section 5.2). Settings are those of
the released code: axes :math:`(x, y, z) = (X, -Z, Y)`; each rotation is the inverse of the ring's; of the base body
only the position in the first frame counts, 2.7 mm above the origin; the ring is taken to be centred in the first
frame.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input, require
from edition1_companion.recordings.rig_robot import RIG_LENGTH_M, RIG_MARKERS_M, RIG_RADIUS_M, RIG_RATE_HZ
from edition1_live.own.optitrack import HEADER_LINES, read_header

BASE_HEIGHT_M = 2.7e-3
"""Height of the base body above the origin of the base frame [m]."""
LONGEST_GAP = 2
"""Consecutive frames without the ring that are interpolated."""
REACH_M = (0.05, 0.2)
"""Distances between ring and base that are possible [m]; another unit than metres is far outside."""
BODY_COLUMNS = [("Rotation", axis) for axis in "XYZW"] + [("Position", axis) for axis in "XYZ"]
"""Of a body in Motive's files: the two lines of their heads."""
_COLUMNS = ["frame", "time_s"] + [
    f"{body}_{kind}" for body in "br" for kind in (*"XYZW", "TX", "TY", "TZ", "error")
]


@dataclass(frozen=True)
class RingMotion:
    """Configurations of the segment by motion capture.

    Attributes
    ----------
    time_s
        Times of the frames by motion capture's clock [s].
    q
        Configurations ``(delta_x, delta_y, delta_L)`` [m].
    filled
        Frames without the ring that were interpolated.
    gaps
        Runs of such frames.
    """

    time_s: Float[np.ndarray, " frames"]
    q: Float[np.ndarray, "frames 3"]
    filled: int
    gaps: int


def ring_configuration(
    position: Float[Tensor, "*batch 3"], rotation: Float[Tensor, "*batch 3 3"]
) -> Float[Tensor, "*batch 3"]:
    r"""Configuration of the segment from the pose of its ring of markers, in closed form (section 5.2).

    With :math:`\theta = \arccos R_{33}` and the ring at :math:`l_r` along the unextended backbone,
    :math:`\delta L_r = z\,\theta/\sin\theta - l_r` and :math:`(\Delta_x, \Delta_y)_r = (x, y)\,
    \frac{d}{l_r + \delta L_r}\,\frac{\theta^2}{1 - \cos\theta}`; all three are extended to the tip by
    :math:`L_0/l_r`. For the pose of a segment of constant curvature it is exact; the azimuth is that of the position.

    Parameters
    ----------
    position
        Of the ring in the base frame [m].
    rotation
        Of the ring; only its :math:`R_{33}` matters, so its inverse gives the same.

    Raises
    ------
    InputError
        If a number is not finite, or the ring points sideways or back (bending of 90 degrees or more), where the
        height says little about the length.

    Examples
    --------
    >>> upright = torch.eye(3, dtype=torch.float64)
    >>> ring_configuration(torch.tensor([0.0, 0.0, 0.10105], dtype=torch.float64), upright) * 1e3
    tensor([0.0000, 0.0000, 1.0600], dtype=torch.float64)
    """
    owner = "ring_configuration"
    se3.require_finite(position, "position", owner)
    se3.require_finite(rotation, "rotation", owner)
    cos = rotation[..., 2, 2].clamp(max=1.0)
    if bool((cos <= 0).any()):
        worst = float(torch.rad2deg(cos.min().arccos()))
        raise bad_input("rotation", owner, "bent by less than 90 deg", f"{worst:.1f} deg")
    ratio = se3.acosc(cos)  # theta/sin(theta)
    squared = ratio * ratio * (1 - cos) * (1 + cos)
    length = position[..., 2] * ratio
    xy = position[..., :2] * (RIG_RADIUS_M / length / se3.cosc(squared)).unsqueeze(-1)
    elongation = (length - RIG_MARKERS_M).unsqueeze(-1)
    return RIG_LENGTH_M / RIG_MARKERS_M * torch.cat([xy, elongation], dim=-1)


def read_ring_motion(path: Path) -> RingMotion:
    """Read a motion capture file of the rig (``NAME_Quat.csv``) and compute the configurations.

    Frames without the ring are interpolated linearly where at most :data:`LONGEST_GAP` follow each other,
    and counted.

    Parameters
    ----------
    path
        Export of Motive, format 1.23: seven lines of header; frame, time, and for the base, then the ring: X, Y, Z,
        W, position [m] and mean marker error.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    InputError
        Another format, unit, rate or order of columns; fewer frames than the header says; numbers that are none;
        times that do not increase evenly; longer gaps, or one at an end of the file; quaternions that are not unit; a
        ring that is nowhere near the base.
    """
    with path.open(newline="", encoding="utf-8-sig") as stream:
        head = list(islice(csv.reader(stream), HEADER_LINES))
        frames = sum(1 for _ in stream)
    header = read_header(head, path.name, version="1.23", frames=frames)
    if header.get("Length Units") != "Meters":
        raise bad_input("Length Units", path.name, "Meters", header.get("Length Units", "nothing"))
    columns = list(zip(head[5], head[6], strict=False))
    for first, body in ((2, "base"), (10, "ring")):
        found = columns[first : first + len(BODY_COLUMNS)]
        if found != BODY_COLUMNS:
            expected = "rotation X, Y, Z, W and position X, Y, Z"
            raise bad_input(f"columns of the {body}", path.name, expected, found or "nothing")
    try:
        table = pd.read_csv(
            path, skiprows=HEADER_LINES, names=_COLUMNS, usecols=range(len(_COLUMNS)), dtype=float
        )
    except ValueError as error:
        raise bad_input("frames", path.name, "rows of numbers", error) from error
    time_s = table["time_s"].to_numpy()
    _check_times(time_s, path.name)
    base, ring = (
        table[[f"{body}_{kind}" for kind in (*"XYZW", "TX", "TY", "TZ")]].to_numpy() for body in "br"
    )
    require(np.isfinite(base[0]).all(), "base", path.name, "seen in the first frame", "empty cells")
    whole, filled, gaps = _filled(ring, path.name)
    q = _configurations(base[0, 4:], whole, path.name)
    return RingMotion(time_s, q, filled, gaps)


def _check_times(time_s: np.ndarray, owner: str) -> None:
    steps = np.diff(time_s)
    if not np.isfinite(time_s).all() or len(time_s) < 2:
        raise bad_input(
            "times", owner, "two numbers or more", f"{np.isfinite(time_s).sum()} of {len(time_s)}"
        )
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0))
        raise bad_input("times", owner, "increasing", f"a step of {steps[row]:g} s to frame {row + 1}")
    uneven = np.abs(steps * RIG_RATE_HZ - 1.0) > 0.5
    if uneven.any():
        row = int(np.argmax(uneven))
        seen = f"a step of {steps[row]:g} s to frame {row + 1}"
        raise bad_input("times", owner, f"{1 / RIG_RATE_HZ:g} s apart, within half of it", seen)


def _filled(ring: np.ndarray, owner: str) -> tuple[np.ndarray, int, int]:
    """Interpolate short gaps; return the poses, the number of frames filled and that of gaps."""
    lost = np.asarray(~np.isfinite(ring).all(axis=1))
    if not lost.any():
        return ring, 0, 0
    edges = np.flatnonzero(np.diff(np.r_[False, lost, False].astype(int)))
    starts, lengths = edges[::2], edges[1::2] - edges[::2]
    if lost[0] or lost[-1]:
        raise bad_input(
            "first and last frame", owner, "with the ring", f"{int(lost.sum())} frames without it"
        )
    longest = int(np.argmax(lengths))
    if lengths[longest] > LONGEST_GAP:
        seen = f"{lengths[longest]} from frame {starts[longest]} on"
        raise bad_input("frames without the ring", owner, f"at most {LONGEST_GAP} in a row", seen)
    known, whole = np.flatnonzero(~lost), ring.copy()
    signs = np.sign((ring[known[1:], :4] * ring[known[:-1], :4]).sum(axis=1))
    whole[known, :4] *= np.cumprod(np.r_[1.0, signs])[:, None]  # q and -q are one rotation: the nearer one
    for column in range(whole.shape[1]):
        whole[lost, column] = np.interp(np.flatnonzero(lost), known, whole[known, column])
    return whole, int(lost.sum()), len(starts)


def _configurations(base: np.ndarray, ring: np.ndarray, owner: str) -> np.ndarray:
    error = float(np.abs(np.linalg.norm(ring[:, :4], axis=1) - 1.0).max())
    if error > 1e-2:  # interpolated ones are a little shorter
        raise bad_input("quaternions", owner, "unit within 0.01", f"an error of {error:.3g}")
    position = _robot_axes(ring[:, 4:]) - (_robot_axes(base) - [0.0, 0.0, BASE_HEIGHT_M])
    distance = np.linalg.norm(position, axis=1)
    if not (distance.min() > REACH_M[0] and distance.max() < REACH_M[1]):
        expected = f"{REACH_M[0]:g} to {REACH_M[1]:g} m from the base (is the file in metres?)"
        raise bad_input("ring", owner, expected, f"{distance.min():g} to {distance.max():g}")
    position[:, :2] -= position[0, :2]
    turned = np.column_stack([_robot_axes(ring[:, :3]), ring[:, 3]])
    rotation = Rotation.from_quat(turned).inv().as_matrix()
    return ring_configuration(torch.from_numpy(position), torch.from_numpy(rotation)).numpy()


def _robot_axes(xyz: np.ndarray) -> np.ndarray:
    return np.stack([xyz[..., 0], -xyz[..., 2], xyz[..., 1]], axis=-1)
