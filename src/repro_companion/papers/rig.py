"""The rig of Baaij et al. 2023, section 5: its geometry, and recordings of motion and readings, put together."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from repro import ConstantCurvature, Magnet, Ring, Robot, Sensor
from repro.common import bad_input, require
from repro_board.lag import search_lag

RATE_HZ, SENSORS = 40.0, 3
LENGTH, RADIUS = 106.05e-3, 22e-3
"""Length and radius of the segment in the released code [m]; the text has 110 mm."""
MARKERS_AT, MAGNET_AT, SENSORS_AT, SENSOR_RADIAL = 100.05e-3, 46.05e-3, 106.05e-3, 13e-3
RING = Ring(12e-3, 6e-3, 6e-3, 1450.0)
EARTH = (-0.311, -0.234, 0.921)
"""Direction of the Earth's field in the base frame, section 5.2."""
TRAJECTORIES = ("T0", "T1", "T2", "T3", "T4", "T5")


def robot() -> Robot:
    """Return the segment with its ring and three sensors, as drawn in the released code."""
    sensors = [
        Sensor(1, SENSORS_AT, SENSOR_RADIAL, azimuth=2 * math.pi * j / SENSORS) for j in range(SENSORS)
    ]
    return Robot([ConstantCurvature(LENGTH, RADIUS)], [Magnet(RING, 1, MAGNET_AT)], sensors)


# Recordings: motion capture and readings, aligned


@dataclass(frozen=True)
class Recording:
    """Configurations by motion capture [m] and readings [mV] at common frames, 40 Hz."""

    name: str
    q: np.ndarray
    u: np.ndarray
    remarks: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.u)

    @property
    def time_s(self) -> np.ndarray:
        """Times after the first frame."""
        return np.arange(len(self)) / RATE_HZ

    def cut(self, first: int, last: int | None = None) -> Recording:
        """Return some of its frames."""
        return replace(self, q=self.q[first:last], u=self.u[first:last])


FOLDER = Path("baaij2023", "datasets", "experimental")
NAMES = {
    "T0": "2022-05-02_RAND_200mBar_200s_P0_R1",
    "T1": "2022-05-02_T1_270deg_P0_R1",
    "T2": "2022-05-02_T2_P0_R1",
    "T3": "2022-05-02_T3_90deg_P0_R1",
    "T4": "2022-05-02_SPIRAL_FORWARD_120s_P0_R1",
    "T5": "2022-05-02_FLOWER_SLOW_NOMINAL_P0_R1",
}
"""The authors' names of the trajectories."""
BASE_HEIGHT = 2.7e-3
"""Height of the base body above the origin of the base frame [m]."""
LONGEST_GAP = 2
"""Frames without the ring that are interpolated."""
CLIPPED_MV = (0.0, 2047.9375)
INFLATION_S, DEFLATION_S = 8.0, 5.0
"""What is cut at the start and at the end [s]."""
BODY = [("Rotation", axis) for axis in "XYZW"] + [("Position", axis) for axis in "XYZ"]


def raw_files(folder: Path, whole: str) -> tuple[Path, Path]:
    """Return the files of motion capture and of readings of a recording."""
    capture = folder / "raw_motion_capture_data" / whole.split("_")[0] / f"{whole}_Quat.csv"
    return capture, folder / "sensor_data" / f"{whole}_SV.csv"


class Capture(NamedTuple):
    """What motion capture exports, in its own axes: rows of X, Y, Z, W, then a position [m]."""

    base: np.ndarray
    """Of the base in the first frame ``[7]``."""
    ring: np.ndarray
    """Of the ring ``[t, 7]``, NaN where it is not seen."""


def read_capture(path: Path) -> Capture:
    """Read a file of motion capture, ``NAME_Quat.csv`` of Motive 1.23, and check that it is one."""
    with path.open(newline="", encoding="utf-8-sig") as stream:
        head = list(islice(csv.reader(stream), 7))
    require(
        len(head) == 7 and head[0], "header", path.name, "seven lines of Motive 1.23", f"{len(head)} lines"
    )
    header = dict(zip(head[0][::2], head[0][1::2], strict=False))
    expected = {"Format Version": "1.23", "Length Units": "Meters", "Rotation Type": "Quaternion"}
    for key, value in expected.items():
        require(header.get(key) == value, key, path.name, value, header.get(key, "nothing"))
    columns = list(zip(head[5], head[6], strict=False))
    for first, body in ((2, "base"), (10, "ring")):
        words = "rotation X, Y, Z, W and position X, Y, Z"
        require(columns[first : first + 7] == BODY, f"columns of the {body}", path.name, words, "others")
    try:
        table = pd.read_csv(path, skiprows=7, header=None, usecols=range(18), dtype=float).to_numpy()
    except ValueError as error:
        raise bad_input("frames", path.name, "rows of 18 numbers", error) from error
    steps = np.diff(table[:, 1]) * RATE_HZ
    require(np.abs(steps - 1).max(initial=0) < 0.5, "times", path.name, "1/40 s apart", "other steps")
    return Capture(table[0, 2:9], table[:, 10:17])


def read_readings(path: Path) -> np.ndarray:
    """Read a file of readings, ``NAME_SV.csv``: columns u1, u2, u3 [mV]; incomplete rows at the end are dropped."""
    table = pd.read_csv(path)
    names = [f"u{j + 1}" for j in range(SENSORS)]
    require(set(names) <= set(table.columns), "columns", path.name, "u1, u2, u3", ", ".join(table.columns))
    try:
        u = table[names].to_numpy(dtype=float)
    except ValueError as error:
        raise bad_input("readings", path.name, "numbers [mV]", error) from error
    whole = np.asarray(np.isfinite(u).all(axis=1))
    kept = len(u) if whole.all() else int(np.argmin(whole))
    require(
        kept and not whole[kept:].any(),
        "readings",
        path.name,
        "complete up to the end",
        f"a gap in row {kept}",
    )
    u = u[:kept]
    clipped = int(((u <= CLIPPED_MV[0]) | (u >= CLIPPED_MV[1])).sum())
    require(
        not clipped,
        "readings",
        path.name,
        f"between {CLIPPED_MV[0]} and {CLIPPED_MV[1]} mV",
        f"{clipped} that are not",
    )
    return u


def configurations(capture: Capture, name: str) -> np.ndarray:
    r"""Return configurations ``[t, 3]`` [m] from poses of the ring, in closed form (section 5.2).

    With the ring at :math:`l_r` along the unextended backbone, :math:`\theta = \arccos R_{33}`,
    :math:`\delta L_r = z\,\theta/\sin\theta - l_r` and
    :math:`(\Delta_x, \Delta_y)_r = (x, y)\,\frac{d}{l_r + \delta L_r}\,\frac{\theta^2}{1 - \cos\theta}`;
    all three are extended to the tip by :math:`L_0/l_r`. As in the released code, the base counts with its first
    position alone, and the ring is centred in the first frame.
    """
    ring = _without_gaps(capture.ring, name)
    off = float(np.abs(np.linalg.norm(ring[:, :4], axis=1) - 1).max())
    require(off < 0.01, "quaternions", name, "unit within 0.01", f"an error of {off:.3g}")
    at = _robot_axes(ring[:, 4:]) - _robot_axes(capture.base[4:]) + [0.0, 0.0, BASE_HEIGHT]
    reach = np.linalg.norm(at, axis=1)
    words = "0.05 to 0.2 m from the base (is the file in metres?)"
    require(
        reach.min() > 0.05 and reach.max() < 0.2, "ring", name, words, f"{reach.min():g} to {reach.max():g}"
    )
    at[:, :2] -= at[0, :2]
    turned = np.column_stack([_robot_axes(ring[:, :3]), ring[:, 3]])
    cos = np.minimum(Rotation.from_quat(turned).inv().as_matrix()[:, 2, 2], 1.0)
    require((cos > 0).all(), "ring", name, "bent by less than 90 degrees", "more")
    theta = np.arccos(cos)
    length = at[:, 2] / np.sinc(theta / np.pi)  # z theta / sin(theta)
    versine = np.sinc(theta / (2 * np.pi)) ** 2 / 2  # (1 - cos(theta)) / theta^2
    bend = at[:, :2] * (RADIUS / length / versine)[:, None]
    return LENGTH / MARKERS_AT * np.column_stack([bend, length - MARKERS_AT])


def _robot_axes(xyz: np.ndarray) -> np.ndarray:
    return np.stack([xyz[..., 0], -xyz[..., 2], xyz[..., 1]], axis=-1)


def _without_gaps(ring: np.ndarray, name: str) -> np.ndarray:
    """Interpolate where the ring is lost for a frame or two."""
    seen = np.asarray(np.isfinite(ring).all(axis=1))
    known = np.flatnonzero(seen)
    words = f"lost for at most {LONGEST_GAP} frames, and never in the first or last"
    gap = int(np.diff(known, prepend=-1, append=len(ring)).max()) - 1 if len(known) else len(ring)
    require(seen[0] and seen[-1] and gap <= LONGEST_GAP, "ring", name, words, f"lost for {gap} frames")
    whole = ring.copy()
    signs = np.sign((ring[known[1:], :4] * ring[known[:-1], :4]).sum(axis=1))
    whole[known, :4] *= np.cumprod(np.r_[1.0, signs])[:, None]  # q and -q are one rotation
    for column in whole.T:
        column[~seen] = np.interp(np.flatnonzero(~seen), known, column[known])
    return whole


def start_of_readings(u: np.ndarray, name: str) -> int:
    """Return the row in which readings leave rest, for a change of more than six times the noise, at least 1 mV.

    It is the first of the rise to that change: the rows before it differ by less than three times the noise, or by
    less than 1 mV. The released rule, 1 mV from the first row, takes noise for a start where readings are noisier
    than the authors'.
    """
    rest, limit = (
        np.median(u[:10], axis=0),
        max(1.0, 6 * float(np.sqrt((np.diff(u[:10], axis=0) ** 2).mean() / 2))),
    )
    change = np.sqrt(((u - rest) ** 2).mean(axis=1))
    moving = np.flatnonzero(change[10:] > limit) + 10
    require(len(moving), "start", name, f"readings that change by {limit:.3g} mV", "none that do")
    start = int(moving[0])
    while start > 10 and change[start - 1] > max(1.0, limit / 2):
        start -= 1
    return start


def aligned(q: np.ndarray, u: np.ndarray, name: str) -> Recording:
    """Put both starts of inflation together, check that by the lag, and cut what the authors cut.

    Raises
    ------
    InputError
        If there is no start, the readings fit the motion much better at another lag, or too little is left.
    """
    risen = np.abs(q[:, 2] - q[0, 2]) > 0.2e-3
    require(risen.any(), "start", name, "an elongation that changes by 0.2 mm", "none that does")
    k_q, k_u = int(np.argmax(risen)), start_of_readings(u, name)
    skip = int(k_q != k_u)  # the released code drops one frame more than the starts differ by
    cut_q, cut_u = max(k_q - k_u + skip, 0) if k_q > k_u else 0, k_u - k_q + skip if k_u > k_q else 0
    q, u = q[cut_q:], u[cut_u:]
    n = min(len(q), len(u))
    first, last = round(INFLATION_S * RATE_HZ), round(DEFLATION_S * RATE_HZ)
    first -= skip if cut_q else 0  # its index of frames begins at the one skipped
    require(
        n > first + last + 2, "length", name, f"above {INFLATION_S + DEFLATION_S:g} s", f"{n / RATE_HZ:g} s"
    )
    remarks = doubts(q[:n], u[:n], name)
    return Recording(name, q[first : n - last - 1], u[first : n - last - 1], remarks)


def doubts(q: np.ndarray, u: np.ndarray, name: str) -> tuple[str, ...]:
    """Compare an alignment with all other lags: refuse it, say what speaks against it, or nothing."""
    every = 1 + len(q) // 10_000  # of a long recording some frames tell as much
    found = search_lag(q[::every], u[::every], RATE_HZ / every)
    gain = found.residual / max(found.best, 0.02)  # the converter's steps leave 0.02 mV
    better = (
        f"a shift of {found.lag_s:+.2f} s, which divides what the motion leaves of the readings by {gain:.1f}"
    )
    if found.best > 0.5 * found.spread:
        return (f"{name}: the readings hardly follow the motion, so we cannot check their alignment.",)
    require(gain < 2 or abs(found.lag_s) < 0.5, "alignment", name, "that of the first inflation", better)
    if gain > 1.5 and abs(found.lag_s) > 0.125:
        return (f"{name}: the alignment is in doubt; better is {better}.",)
    return ()
