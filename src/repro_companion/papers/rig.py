"""The rig of Baaij et al. 2023, section 5: its recordings, a simulated rig in their place, and two methods.

We do not have the recordings behind Table 2. Where nobody has put them into ``REPRO_DATA_DIR``, a
simulated rig records the six trajectories: pressures bend a segment with lag and hysteresis, magpylib's field of the
ring reaches three sensors that are not where the drawing has them, and both go through the authors' pipeline. Its
parameters were set to what is known of the authors' sensors before any estimator ran on it, and then frozen.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import islice, product
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar, NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.signal import lfilter
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from repro import (
    ConstantCurvature,
    GradientDescent,
    Magnet,
    Ring,
    Robot,
    Sensing,
    Sensor,
)
from repro.chain import place
from repro.common import bad_input, require
from repro.networks import Network, load_network
from repro.sensing import relations
from repro_board.lag import search_lag
from repro_companion import show
from repro_companion.papers.fetch import states
from repro_companion.run import project_folder, recordings_folder
from repro_companion.scorecard import AUTHORS

RATE_HZ, SENSORS = 40.0, 3
LENGTH, RADIUS = 106.05e-3, 22e-3
"""Length and radius of the segment in the released code [m]; the text has 110 mm."""
MARKERS_AT, MAGNET_AT, SENSORS_AT, SENSOR_RADIAL = 100.05e-3, 46.05e-3, 106.05e-3, 13e-3
RING = Ring(12e-3, 6e-3, 6e-3, 1450.0)
EARTH = (-0.311, -0.234, 0.921)
"""Direction of the Earth's field in the base frame, section 5.2."""
TRAJECTORIES = ("T0", "T1", "T2", "T3", "T4", "T5")
SEEDS = (0, 1, 2)


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


# The simulated rig

DURATION_S = {"T0": 200.0, "T1": 90.0, "T2": 90.0, "T3": 90.0, "T4": 120.0, "T5": 1500.0}
PERIOD_S = {"T1": 5.0, "T2": 10.0, "T3": 10.0, "T5": 10.0}
SPEED_NM_PER_S = {"T0": 0.025, "T4": 0.0125}
"""Section 5.3; the text has T4 in kN m/s, which we read as N m/s."""
TURNED_DEG = {"T1": 270.0, "T3": 90.0}
"""By how much a sequence is turned, inferred from the names of the recordings."""
REGULATOR_HZ = 100.0
FILL_S, FILLED_S, SEQUENCE_S, TAIL_S = 2.5, 2.6, 8.0, 4.0
"""When the chambers begin to fill, are full, the sequence begins; how long they are empty at the end (assumed)."""
LEVER = 1e2 * 150e-6 * 13e-3
"""Torque of a chamber per pressure [N m/mbar]: 150 mm² at 13 mm (assumed)."""
OFFSET_MBAR, PEAK_MBAR = 225.0, 450.0
REACH_NM = 1.5 * LEVER * (PEAK_MBAR - OFFSET_MBAR)
"""Torque towards a chamber at which that chamber is at its peak."""
STEP_MV = 2.0 * 2048.0 / 2**16
"""Step of the converter, an ADS1115."""


class Place(NamedTuple):
    """Workspace of a recording [mm], read off the released networks that were trained on it."""

    centre: tuple[float, float]
    """Mean bend."""
    spread_x: float
    spread_y: tuple[float, float]
    """Deviation of the bend along x; along y, its part that follows x, and the rest."""
    elongation: float
    rise: float
    """Mean elongation, and its rise with the square of the bend [1/mm]."""


PLACES = {
    "T0": Place((1.76, 0.13), 2.21, (1.482, -2.60), 5.85, 0.029),
    "T1": Place((5.10, 0.28), 1.56, (0.14, 0.0), 6.38, 0.022),
    "T2": Place((-1.97, -0.45), 1.59, (0.426, -4.26), 5.72, -0.037),
    "T3": Place((2.00, 0.11), 3.76, (1.991, -4.63), 6.11, 0.024),
    "T4": Place((1.83, -0.01), 3.15, (1.072, -3.97), 5.76, 0.049),
    "T5": Place((2.02, -0.05), 2.72, (1.303, 3.62), 6.13, 0.029),
}
"""By least squares from the running means and variances of the norms of their inputs. Signs of ``spread_y`` remain
open: mirrored motions fit almost as well."""


def placement(place: Place, bend: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrix ``[2, 2]`` and the shift [mm] that turn x and take a motion ``[t, 2]`` [mm] to its place."""
    spread = np.maximum(bend.std(axis=0), 1e-9)
    matrix = np.array([[place.spread_x, 0.0], place.spread_y]) / spread * [-1.0, 1.0]
    return matrix, place.centre - matrix @ bend.mean(axis=0)


def elongations(place: Place, bend: np.ndarray, running: np.ndarray) -> np.ndarray:
    """Return the elongation [mm] that motion capture sees at bends ``[t, 2]`` [mm], by the mean over some of them."""
    square = (bend**2).sum(axis=1)
    return place.elongation + place.rise * (square - square[running].mean())


RIG = SimpleNamespace(
    # Bend [mm] of the inflated segment without torque, and how an axis bends with its torque in units of the reach
    neutral=(1.72, -0.1),
    linear=(3.4, 9.17),
    quadratic=(0.8, 0.0),
    cubic=(2.9, 0.0),
    elongation=4.5,  # [mm]
    lag=0.2,  # of the bend after the pressures [s]
    hysteresis=0.3,  # of the tip [mm]
    stroke=3.0,  # way after which that has turned over [mm]
    # How the bend at the magnet differs: a hysteresis, and a lag [s] where the direction of bending turns
    inner_hysteresis=0.06,
    inner_stroke=4.0,
    across=0.11,
    centre=0.1,
    places=PLACES,
    # Every sensor along its own axes [mV/mT], as drawn (0, 0, 5000); where sensors and magnet are [mm, deg]
    sensitivity=((-1895.0, -1745.0, 4285.0), (-2514.0, 970.0, 4212.0), (-4084.0, -1097.0, 2668.0)),
    sensor_shift=((0.4, -0.3, 0.2), (-0.5, 0.2, 0.3), (0.3, 0.5, -0.4)),
    magnet_shift=(0.5, -0.4, 0.6),
    magnet_tilt=(1.5, -1.0),
    earth_mt=0.0493,
    rest=(1035.2, 935.5, 1182.0),  # readings of the straight segment [mV]
    # What no field of the ring explains: second derivatives xx, xy, yy [mV/mm²] and a sine of the bend [mV, mm, deg]
    curvature=((-1.0, 0.31, -1.97), (-1.17, 0.07, -1.25), (-1.07, -0.11, -1.14)),
    ripple=(-0.37, -0.04, -1.53),
    ripple_period=9.0,
    ripple_azimuth=(30.0, 80.0, 150.0),
    # Noise at rest, more of it in proportion to the pressure, a ramp over 1,500 s [mV]
    noise=0.24,
    inflated_noise=0.55,
    drift=0.6,
    # Of the readings in T0 to T5: common bias; of every sensor in all but T5: bias [mV] and relative gain
    bias=(-3.7, -3.4, -3.2, -0.2, -3.2, 0.0),
    bias_scatter=0.5,
    gain_scatter=0.04,
    # Motion capture [mm, deg, s]
    capture_noise=0.02,
    capture_noise_deg=0.02,
    gaps_per_s=0.02,
    clock_ppm=10.0,
    latest_start=2.0,
    ring_offset=(0.8, -0.5),
    base=(120.0, -80.0, 300.0),
)
"""Parameters of the simulated rig, frozen before an estimator ran on it.

Sensitivities, readings at rest, curvatures and ripples follow by least squares from what the authors' networks
predict along these motions, up to an offset of each recording (the study ``rig_sensors``); the hystereses follow from
differences between the recordings. All else is assumed.
"""


def torques(name: str, time_s: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return the torques ``[t, 2]`` [N m] about x and y of a sequence of section 5.3; the seed is that of T0."""
    t, phase = time_s, 2 * np.pi * time_s / PERIOD_S.get(name, 1.0)
    if name == "T0":
        return _way_points(t, np.random.default_rng(seed))
    if name == "T4":
        return _spiral(t)
    shape = {
        "T1": ((1 - np.cos(phase)) / 2, 0 * t),
        "T2": (np.sin(phase), np.abs(np.sin(phase / 2))),
        "T3": (np.sin(2 * phase), np.sin(phase)),
        "T5": (np.sin(phase) * np.cos(0.0126 * t), np.sin(phase) * np.sin(0.0126 * t)),
    }[name]
    turned = np.radians(TURNED_DEG.get(name, 0.0))
    c, s = np.cos(turned), np.sin(turned)
    return REACH_NM * np.column_stack(shape) @ np.array([[c, s], [-s, c]])


def _way_points(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Straight lines at constant speed between points that are uniform in a disc."""
    n = 2 + int(4 * SPEED_NM_PER_S["T0"] * DURATION_S["T0"] / REACH_NM)
    radius, azimuth = REACH_NM * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    points = np.vstack([np.zeros(2), np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth)])])
    arc = np.append(0.0, np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum())
    return np.column_stack([np.interp(SPEED_NM_PER_S["T0"] * t, arc, column) for column in points.T])


def _spiral(t: np.ndarray) -> np.ndarray:
    """Archimedean spiral from zero to the reach, at constant speed."""

    def arc(angle: np.ndarray | float, end: float) -> np.ndarray:
        return REACH_NM / (2 * end) * (angle * np.sqrt(1 + angle**2) + np.arcsinh(angle))

    length = SPEED_NM_PER_S["T4"] * DURATION_S["T4"]
    end = brentq(lambda x: arc(x, x) - length, 1e-3, 1e6)
    angles = np.linspace(0.0, end, 20_001)
    angle = np.interp(SPEED_NM_PER_S["T4"] * t, arc(angles, end), angles)
    return (REACH_NM * angle / end)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def pressures(name: str, time_s: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return the pressures ``[t, 3]`` [mbar] that make the torques, the least in norm, with filling and emptying.

    A sequence without a speed of its own is scaled so that no pressure leaves 0 to 450 mbar.
    """
    duration = DURATION_S[name]
    scale = 1.0
    if name not in SPEED_NM_PER_S:
        whole = torques(name, np.arange(0, duration, 0.01)) @ _levers().T
        scale = (PEAK_MBAR - OFFSET_MBAR) / np.abs(2 / (3 * LEVER) * whole).max()
    t = time_s - SEQUENCE_S
    running = ((t >= 0) & (t < duration))[:, None]
    torque = np.where(running, scale * torques(name, np.clip(t, 0, duration), seed), 0.0)
    end = SEQUENCE_S + duration
    filled = np.interp(time_s, [FILL_S, FILLED_S, end, end + 1], [0.0, 1.0, 1.0, 0.0])
    return OFFSET_MBAR * filled[:, None] + 2 / (3 * LEVER) * torque @ _levers().T


def _levers() -> np.ndarray:
    azimuth = np.radians(180.0 + 120.0 * np.arange(3))
    return np.column_stack([-np.sin(azimuth), np.cos(azimuth)])


def motion(rig: SimpleNamespace, pressures_mbar: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return configurations [m] of the tip, which motion capture sees, and of the place of the magnet.

    The bend follows the pressures with a lag, an asymmetry and a hysteresis. The magnet has a hysteresis of its own,
    and lags where the direction of bending turns, so that readings are no function of what motion capture sees.
    """
    dt = 1 / REGULATOR_HZ
    torque = LEVER / REACH_NM * pressures_mbar @ _levers()
    driven = np.column_stack([torque[:, 1], -torque[:, 0], pressures_mbar.mean(axis=1) / OFFSET_MBAR])
    share = -np.expm1(-dt / rig.lag)
    s, inflation = np.split(np.asarray(lfilter([share], [1.0, share - 1.0], driven, axis=0)), [2], axis=1)
    neutral = inflation * np.array(rig.neutral)
    free = neutral + s * rig.linear + s**2 * rig.quadratic + s**3 * rig.cubic
    tip = free - rig.hysteresis * _memory(free, rig.stroke)
    rate = np.gradient(s, dt, axis=0)
    turning = (s[:, 0] * rate[:, 1] - s[:, 1] * rate[:, 0]) / ((s * s).sum(axis=1) + rig.centre**2)
    across = turning[:, None] * (tip - neutral)[:, ::-1] * [-1.0, 1.0]
    magnet = tip - rig.across * across - rig.inner_hysteresis * _memory(tip, rig.inner_stroke)
    return tuple(1e-3 * np.column_stack([xy, rig.elongation * inflation]) for xy in (tip, magnet))


def placed(
    rig: SimpleNamespace, name: str, q: np.ndarray, q_magnet: np.ndarray, running: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return both motions at the place of a recording, and the first as motion capture sees it [m].

    The elongation that motion capture sees, two frames joined by an arc, differs between recordings by tenths of a
    millimetre, for which the field of the ring would change by tens of millivolts. The authors' networks differ by a
    few at equal bends. So we assume that the sensors feel the same elongation in all recordings.
    """
    if name not in rig.places:
        return q, q_magnet, q
    matrix, shift = placement(rig.places[name], 1e3 * q[running, :2])
    inflation = 1e3 * q[:, 2:] / rig.elongation
    tip, magnet = (
        np.column_stack([x[:, :2] @ matrix.T + 1e-3 * inflation * shift, x[:, 2]]) for x in (q, q_magnet)
    )
    captured = tip.copy()
    captured[:, 2:] = 1e-3 * inflation * elongations(rig.places[name], 1e3 * tip[:, :2], running)[:, None]
    return tip, magnet, captured


def _memory(x: np.ndarray, stroke: float) -> np.ndarray:
    """Memory of every column, in [-1, 1], by Bouc and Wen: 1 after a long rise, -1 after a long fall."""
    columns = []
    for steps in np.diff(x, axis=0).T.tolist():
        z = [0.0]
        for step in steps:
            end = math.copysign(1.0, step)
            z.append(end + (z[-1] - end) * math.exp(-abs(step) / stroke))
        columns.append(z)
    return np.array(columns).T


def readings(rig: SimpleNamespace, q: np.ndarray, q_magnet: np.ndarray) -> np.ndarray:
    """Return readings ``[t, 3]`` [mV] before noise, drift and converter; the field is magpylib's."""
    change = _field(rig, q, q_magnet) - _field(rig, np.zeros((1, 3)), np.zeros((1, 3)))
    x, y = 1e3 * q[:, :1], 1e3 * q[:, 1:2]
    xx, xy, yy = np.array(rig.curvature).T
    azimuth = np.radians(rig.ripple_azimuth)
    along = 2 * np.pi / rig.ripple_period * (x * np.cos(azimuth) + y * np.sin(azimuth))
    unexplained = (xx * x * x + 2 * xy * x * y + yy * y * y) / 2 + np.array(rig.ripple) * np.sin(along)
    return np.array(rig.rest) + (change * np.array(rig.sensitivity)).sum(axis=-1) + unexplained


def _field(rig: SimpleNamespace, q: np.ndarray, q_magnet: np.ndarray) -> np.ndarray:
    """Flux density ``[t, sensor, 3]`` [mT] at the sensors, along their own axes."""
    drawn = robot()
    T_s = drawn.poses(q, [sensor.place for sensor in drawn.sensors])
    T_m = drawn.poses(q_magnet, [drawn.magnets[0].place])
    R_s = T_s[..., :3, :3]
    p_s = T_s[..., :3, 3] + (R_s @ (1e-3 * np.array(rig.sensor_shift))[..., None])[..., 0]
    turned = Rotation.from_euler("XY", rig.magnet_tilt, degrees=True).as_matrix()
    p_m = T_m[..., :3, 3] + (T_m[..., :3, :3] @ (1e-3 * np.array(rig.magnet_shift)))
    R_m = T_m[..., :3, :3] @ turned
    B = np.einsum("tkij,tsj->tsi", R_m, RING.field(np.einsum("tkij,tsi->tsj", R_m, p_s - p_m)))
    return np.einsum("tsij,tsi->tsj", R_s, B + rig.earth_mt * np.array(EARTH))


def simulated(name: str, rig: SimpleNamespace = RIG, seed: int = 0) -> Recording:
    """Record one trajectory with the simulated rig, and send it through the authors' pipeline."""
    number = TRAJECTORIES.index(name)
    rng = np.random.default_rng([seed, number])
    time_s = np.arange(round((SEQUENCE_S + DURATION_S[name] + TAIL_S) * REGULATOR_HZ) + 1) / REGULATOR_HZ
    p = pressures(name, time_s, seed)
    running = (time_s > SEQUENCE_S) & (time_s < SEQUENCE_S + DURATION_S[name])
    q, q_magnet, q_captured = placed(rig, name, *motion(rig, p), running)

    def at(t: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(t, time_s, column) for column in values.T])

    starts = rng.uniform(0.0, rig.latest_start, 2)  # of the sensors, and of motion capture
    clock = np.arange(int((time_s[-1] - starts.max()) * RATE_HZ)) / RATE_HZ
    t = starts[0] + clock
    u = readings(rig, at(t, q), at(t, q_magnet))
    if name != "T5":
        u = u + (u - u.mean(axis=0)) * rig.gain_scatter * rng.standard_normal(SENSORS)
        u = u + rig.bias_scatter * rng.standard_normal(SENSORS)
    noise = np.hypot(rig.noise, rig.inflated_noise * at(t, p).mean(axis=1) / OFFSET_MBAR)
    u = u + rig.bias[number] + noise[:, None] * rng.standard_normal(u.shape)
    u = u + rig.drift * rng.standard_normal(SENSORS) * clock[:, None] / 1500.0
    u = np.clip(np.round(u / STEP_MV) * STEP_MV, *CLIPPED_MV)
    seen = _captured(rig, at(starts[1] + clock / (1 + 1e-6 * rig.clock_ppm), q_captured), rng)
    whole = f"synthetic_{name}"
    return aligned(configurations(seen, whole), u, whole)


def _captured(rig: SimpleNamespace, q: np.ndarray, rng: np.random.Generator) -> Capture:
    """Poses of base and ring as motion capture exports them: noisy, with gaps, to six digits."""
    n = len(q)
    T = robot().poses(q, [place("ring", 1, MARKERS_AT)])[:, 0]
    noise = 1e-3 * rig.capture_noise * rng.standard_normal((2, n, 3))
    turn = Rotation.from_rotvec(np.radians(rig.capture_noise_deg) * rng.standard_normal((n, 3)))
    rotation = (Rotation.from_matrix(T[:, :3, :3]) * turn).inv().as_quat()
    base = 1e-3 * np.array(rig.base)
    at = base + T[:, :3, 3] + 1e-3 * np.array([*rig.ring_offset, 0.0]) + noise[1]
    ring = _six_digits(np.column_stack([_capture_axes(rotation[:, :3]), rotation[:, 3], _capture_axes(at)]))
    lost = np.zeros(n + 2, dtype=bool)
    for k in np.flatnonzero(rng.random(n) < rig.gaps_per_s / RATE_HZ):
        length = int(rng.integers(1, 3))
        if k > 0 and k + length + 1 < n and not lost[k - 1 : k + length + 1].any():
            lost[k : k + length] = True
    ring[lost[:n]] = np.nan
    first = _six_digits(_capture_axes(base + [0.0, 0.0, BASE_HEIGHT] + noise[0, :1]))
    return Capture(np.array([0.0, 0.0, 0.0, 1.0, *first[0]]), ring)


def _six_digits(x: np.ndarray) -> np.ndarray:
    """Round as a file does; a product of 1e6 and a half would round the other way now and then."""
    return np.array([float(f"{value:.6f}") for value in x.ravel()]).reshape(x.shape)


def _capture_axes(xyz: np.ndarray) -> np.ndarray:
    return np.column_stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]])


# What Table 2 is made from

STEP_SIZE, MOMENTUM, ITERATIONS = (1.5e-8, 1.5e-8, 0.0), 0.2, 20
"""Section 5.4; the elongation is not optimised."""
TEST_SHARE = 0.3
"""As in the released code; the text has 0.2."""
LEARNING_RATE = 5e-5


BADGES = {
    "simulated": "simulated rig",
    "recorded": "recorded by the authors",
    "own": "your own recordings",
}


@dataclass(frozen=True)
class Data:
    """T5.train, and the test part of every trajectory: the whole of T4, the end of the others."""

    train: Recording
    tests: dict[str, Recording]
    source: str
    """One of `BADGES`; ``own`` are other files under the authors' names."""

    @property
    def badge(self) -> str:
        """What a table says of its origin."""
        return BADGES[self.source]

    @property
    def remarks(self) -> list[str]:
        """What speaks against the alignment of its recordings."""
        return [remark for part in (self.train, *self.tests.values()) for remark in part.remarks]

    def beginnings(self, seconds: float) -> tuple[np.ndarray, np.ndarray]:
        """Return configurations and readings ``[t, trajectory, 3]`` of the first seconds of all test parts."""
        n = min(round(seconds * RATE_HZ), *map(len, self.tests.values()))
        return tuple(np.stack([getattr(p, name)[:n] for p in self.tests.values()], axis=1) for name in "qu")


def load(source: str = "auto") -> Data:
    """Return the authors' recordings if they are in REPRO_DATA_DIR, else those of the simulated rig.

    Raises
    ------
    InputError
        If recorded files are asked for and one is missing, or a file cannot be used.
    """
    folder = recordings_folder() / FOLDER
    files = {name: _raw(folder, whole) for name, whole in NAMES.items()}
    missing = [name for name, pair in files.items() if not all(path.is_file() for path in pair)]
    words = f"recorded: raw files of {', '.join(NAMES)} below {folder} (repro fetch baaij2023)"
    require(source != "recorded" or not missing, "source", "load", words, f"none of {', '.join(missing)}")
    if source == "simulated" or missing:
        recordings, source = {name: simulated(name) for name in TRAJECTORIES}, "simulated"
    else:
        recordings = {
            name: aligned(configurations(read_capture(capture), name), read_readings(sensors), name)
            for name, (capture, sensors) in files.items()
        }
        source = "recorded" if set(states("baaij2023").values()) == {"released"} else "own"
    return divided(recordings, source)


def _raw(folder: Path, whole: str) -> tuple[Path, Path]:
    """Return the files of motion capture and of readings of a recording."""
    capture = folder / "raw_motion_capture_data" / whole.split("_")[0] / f"{whole}_Quat.csv"
    return capture, folder / "sensor_data" / f"{whole}_SV.csv"


def divided(recordings: dict[str, Recording], source: str) -> Data:
    """Return the first seven tenths of T5 for training, and the test parts of all recordings."""
    tests = {name: r if name == "T4" else r.cut(_first_of_test(r)) for name, r in recordings.items()}
    return Data(recordings["T5"].cut(0, _first_of_test(recordings["T5"])), tests, source)


def _first_of_test(recording: Recording) -> int:
    return math.ceil((len(recording) - 1) * (1 - TEST_SHARE))


def networks(data: Data, seed: int) -> list[Network]:
    """Return the networks of the three sensors, trained on T5.train.

    Those for the simulated rig are in data/networks. For other recordings ``scripts/train.py`` trains them, a minute
    each, and goes on where it stopped.
    """
    files = network_files(data, seed)
    if not all(path.is_file() for path in files):
        _train()
    return [load_network(path) for path in files]


def network_files(data: Data, seed: int) -> list[Path]:
    """Return where the networks of the three sensors are: those of other recordings lie beside the recordings."""
    folder = project_folder() / "data" / "networks"
    if data.source != "simulated":
        content = hashlib.sha256(data.train.q.tobytes() + data.train.u.tobytes()).hexdigest()[:12]
        folder = recordings_folder() / "networks" / f"T5_{content}"
    return [folder / f"rig_sensor{j + 1}_seed{seed}.safetensors" for j in range(SENSORS)]


def _train() -> None:
    """Train the networks for the recordings in a process of its own, whose progress is seen."""
    owner = "networks for these recordings"
    require(find_spec("torch"), "torch", owner, "installed (make env)", "no package of this name")
    script = project_folder() / "scripts" / "train.py"
    done = subprocess.run([sys.executable, script, "--recordings"], check=False)
    require(not done.returncode, "training", owner, "complete", f"exit {done.returncode} of {script.name}")


def training_rows(train: Recording, sensor: int) -> tuple[np.ndarray, np.ndarray]:
    """Return relations as angles, of the robot as drawn, and readings [mV] of one sensor, counted from 0."""
    return relations(robot(), train.q, inputs="angles", earth=EARTH)[:, sensor], train.u[:, sensor]


@dataclass(frozen=True)
class RigNetwork:
    """A network of section 5.4 for the simulated rig: it predicts one sensor, counted from 0."""

    sensor: int
    seed: int
    learning_rate: ClassVar[float] = LEARNING_RATE

    @property
    def name(self) -> str:
        """File name without its ending."""
        return f"rig_sensor{self.sensor + 1}_seed{self.seed}"

    @property
    def origin(self) -> dict[str, str | int]:
        """What a manifest says of the recording: its name, its seed, and the hash of the rig's parameters."""
        parameters = hashlib.sha256(json.dumps(vars(RIG), sort_keys=True).encode()).hexdigest()
        return {"recording": "synthetic_T5_train", "recording_seed": 0, "twin_sha256": parameters}

    def rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Return relations as angles and readings [mV] of T5.train, as they are trained on."""
        whole = simulated("T5")
        xi, u = training_rows(whole.cut(0, _first_of_test(whole)), self.sensor)
        return xi.astype(np.float32), u.astype(np.float32)


# Table 2 and Figs 9 to 11 as tables


def row_name(trajectory: str) -> str:
    """Return the name of a row of Table 2."""
    return f"T5.train->{trajectory}{'' if trajectory == 'T4' else '.test'}"


def errors(
    data: Data, found: Mapping[str, np.ndarray], predicted: np.ndarray, seconds: float
) -> pd.DataFrame:
    """Return the errors of Table 2, one row for each elongation, trajectory, seed, quantity and unit.

    ``found`` are configurations ``[t, trajectory, seed, 3]`` by what the method knew of the elongation, ``predicted``
    the readings at the true configurations. Relative errors refer to the ranges of the whole test parts; that of the
    readings, as in the paper, to the range pooled over the sensors with their offsets.
    """
    q, u = data.beginnings(seconds)
    e_u = np.sqrt(((predicted - u[:, :, None]) ** 2).mean(0)).mean(-1)
    e_q = {name: np.sqrt(((estimate - q[:, :, None]) ** 2).mean(0)) for name, estimate in found.items()}
    lines = []
    for (i, (name, whole)), elongation in product(enumerate(data.tests.items()), e_q):
        of_readings = [("e_u", "mV", e_u[i]), ("e_u", "%", 100 / np.ptp(whole.u) * e_u[i])]
        of_bend = []
        for k, quantity in enumerate(("delta_x", "delta_y")):
            error = e_q[elongation][i, :, k]
            of_bend += [(quantity, "mm", 1e3 * error), (quantity, "%", 100 / np.ptp(whole.q[:, k]) * error)]
        for cells, seed in product((of_readings, of_bend), range(e_q[elongation].shape[1])):
            line = elongation, row_name(name), seed
            lines += [(*line, quantity, unit, values[seed]) for quantity, unit, values in cells]
    return pd.DataFrame(lines, columns=["elongation", "row", "seed", "quantity", "unit", "error"])


SETTING = "as released: elongation known, start at ground truth, momentum carried, split 70/30"
MEANS = (("Abstract", "experiments mean relative error", ("delta_x", "delta_y")),
         ("Section 5.5", "experiments mean relative e_u", ("e_u",)))  # fmt: skip
NOTES = {
    "simulated": "synthetic: from the simulated rig, so not comparable with the authors' hardware",
    "recorded": "our networks, trained on the authors' recordings",
    "own": "recordings of the reader's own under the authors' names, so not comparable with what they printed",
}
ABOUT = {
    "simulated": """The authors' recordings carry no licence and are not part of this project, so this page uses a
**simulated rig**. Its numbers cannot confirm or refute the paper's. With the recordings this page computes Table 2
from them and compares 37 numbers with the published ones, two of which are the means in the text:

```bash
.venv/bin/repro fetch baaij2023
.venv/bin/python scripts/train.py --recordings
make page P=table_2
```

The first command brings twelve files, 16 MB: raw motion capture and readings of the six trajectories. The second
needs torch. It trains nine networks, a minute each, shows how far it is, and goes on where it stopped.""",
    "recorded": "This page ran on the **authors' recordings**, with networks that we trained on T5.train.",
    "own": """This page ran on **recordings of your own** under the authors' names, so nothing on it is compared
with the published numbers.""",
}
"""What a page says first, by the source of its data."""
RECORDINGS = {
    "simulated": """Our rig works in three steps:

1. Torques of section 5.3 become pressures, and the pressures a bend with lag and hysteresis. We take it to the place
   of each recording: we shift and scale it to the means and deviations that the authors' networks keep of their
   inputs, in their first layer.
2. magpylib computes the field of the ring at three sensors. These are the sensors that fit the predictions of the
   authors' networks best, plus a smooth ripple.
3. Noise, drift and a 16-bit converter make the readings. Each recording has a bias of up to 4 mV, which the
   sensors share.

We assumed everything else, including the biases, and froze it before any estimator ran.

The authors also released the networks that they trained on each recording. They carry no licence, so this
project does not contain them, but `repro fetch baaij2023_networks` brings 36 (six recordings, three sensors,
two seeds). In a stored study we took them as robots: our rig moved, and the networks of each recording (mean of
two seeds, plus noise) gave the readings. The networks of T5 are the model. The third line of Table 2 shows the
errors of the paper's method there. On T5 this is nearly circular, because the robot is the mean of the two
models. T4 is missing, because the readings of its networks differ by 4.7 mV between seeds, more than the
printed error of 3.0 mV. Without T4 the paper's means are 3.6 % for the readings and 4.9 % for
the bend.""",
    "recorded": """We read poses and readings of six recordings and follow the authors' pipeline: bends in closed
form from the pose of the ring, and both starts of inflation put together. We check the alignment against all other
lags.""",
}
RECORDINGS["own"] = RECORDINGS["recorded"]


def scorecard_rows(table: pd.DataFrame, data: Data, seconds: float, ranges: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the scorecard from the errors of the paper's method with known elongation."""
    across_t1 = (table["row"] == row_name("T1")) & (table["quantity"] == "delta_y") & (table["unit"] == "%")
    printed = table[(table["elongation"] == "known") & ~across_t1]
    parts = [printed.assign(artefact="Table 2")]
    for artefact, row, quantities in MEANS:
        relative = printed[(printed["unit"] == "%") & printed["quantity"].isin(quantities)]
        mean = relative.groupby("seed")["error"].mean().reset_index()
        parts.append(mean.assign(artefact=artefact, row=row, quantity="mean", unit="%"))
    key = ["artefact", "row", "quantity", "unit"]
    cells = pd.concat(parts).groupby(key, sort=False)["error"]
    lines = cells.agg(regenerated="mean", regenerated_std="std", n_seeds="count").reset_index()
    origin = {"simulated": f"simulated rig {RigNetwork(0, 0).origin['twin_sha256'][:8]}", "recorded": AUTHORS}
    setting = [
        origin.get(data.source, data.badge),
        SETTING,
        f"here the first {seconds:g} s of each test part",
    ]
    lines = lines.assign(paper="baaij2023", setting="; ".join(setting), comparable=data.source == "recorded")
    spans = {
        (line.row, line.quantity): f"; decided by rounding: {STARTS} other starts give"
        f" {line.lowest:.3g} to {line.highest:.3g} mm"
        for line in _decided_by_rounding(ranges).itertuples()
    }
    keys, note = zip(lines["row"], lines["quantity"], strict=True), NOTES.get(data.source, "")
    lines["note"] = [note + spans.get(key, "") for key in keys]
    return lines


def paths(data: Data) -> pd.DataFrame:
    """Return bend and tip [mm] of the first minute of every trajectory, ten times a second: Fig. 9."""
    parts = []
    for name, part in data.tests.items():
        q, time_s = (values[: round(60 * RATE_HZ) : 4] for values in (part.q, part.time_s))
        mm = 1e3 * np.hstack([q[:, :2], robot().tip(q)[:, :3, 3]])
        columns = ["delta_x_mm", "delta_y_mm", "tip_x_mm", "tip_y_mm", "tip_z_mm"]
        about = pd.DataFrame({"recording": name, "time_s": time_s})
        parts.append(about.join(pd.DataFrame(mm, columns=columns)))
    return pd.concat(parts, ignore_index=True)


def bends(q: np.ndarray, found: np.ndarray) -> dict[str, np.ndarray]:
    """Return true bends and those of all seeds ``[t, 2, 1 + seeds]`` [mm] on T2 and T5, in this order: Fig. 10(b)."""
    both = np.concatenate([q[..., None, :2], found[..., :2]], axis=2)
    return dict(zip(("T2", "T5"), 1e3 * np.moveaxis(both, (1, 3), (0, 2)), strict=True))


def stills(q: np.ndarray, found: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return five even times and that of the largest error [s], with truth and estimates ``[t, seed, 3]``."""
    off = np.linalg.norm(found[..., :2] - q[:, None, :2], axis=-1).max(axis=1)
    chosen = np.sort(np.r_[np.linspace(0, len(q) - 1, 6)[:5].astype(int), off.argmax()])
    return chosen / RATE_HZ, q[chosen], found[chosen]


def landscape(
    sensing: Sensing, q: np.ndarray, u: np.ndarray, low: np.ndarray, high: np.ndarray, points: int = 50
) -> pd.DataFrame:
    """Return the error of the readings over the bend at one time, clipped at 100 mV: Fig. 10(a)."""
    x, y = (grid.ravel() for grid in np.meshgrid(*np.linspace(low, high, points).T))
    off = sensing(np.column_stack([x, y, np.full_like(x, q[2])])) - u
    rmse = np.minimum(np.sqrt((off**2).mean(axis=-1)), 100.0)
    return pd.DataFrame({"delta_x_mm": 1e3 * x, "delta_y_mm": 1e3 * y, "rmse_mV": rmse})


def iterates(
    sensing: Sensing, q: np.ndarray, momentum: np.ndarray, u: np.ndarray, shorter: int = 1
) -> pd.DataFrame:
    """Return the bends that the paper's descent tries in one time step, and the errors of their readings.

    With a step that is so many times shorter it tries as many times more.
    """
    lines = []
    for _ in range(ITERATIONS * shorter):
        u_hat, J = sensing.linearise(q)
        lines.append((*(1e3 * q[:2]), np.sqrt(((u_hat - u) ** 2).mean())))
        momentum = MOMENTUM * momentum + 2 / SENSORS * (u_hat - u) @ J
        q = q - np.array(STEP_SIZE) / shorter * momentum
    return pd.DataFrame(lines, columns=["delta_x_mm", "delta_y_mm", "rmse_mV"])


def loss_and_descent(sensing: Sensing, part: Recording, k: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the landscape at one frame, and what the descent tries there from rest and the straight shape."""
    q, u, bend = part.q[k], part.u[k], part.q[:, :2]
    path = iterates(sensing, q * [0, 0, 1], np.zeros(3), u)
    return landscape(sensing, q, u, bend.min(axis=0), bend.max(axis=0)), path


def largest_jump(
    sensings: Sequence[Sensing], q: np.ndarray, u: np.ndarray, found: np.ndarray
) -> tuple[int, pd.DataFrame, list[pd.DataFrame]]:
    """Return the frame in which an estimate of the descent ``[t, seed, 3]`` jumps farthest, and what happens there.

    That is the landscape around all estimates, what the descent tries, and what it would try with half the step.
    """
    jumps = np.linalg.norm(np.diff(found[..., :2], axis=0, prepend=found[:1, :, :2]), axis=-1)
    k, seed = (int(at) for at in np.unravel_index(jumps.argmax(), jumps.shape))
    descent = GradientDescent(sensings[seed], STEP_SIZE, MOMENTUM, ITERATIONS)
    state = descent.init(q[0])
    for q_j, u_j in zip(q[:k], u[:k], strict=True):
        state, _ = descent.step(state, u_j, known=[np.nan, np.nan, q_j[2]])
    start, bends = np.append(state.q[:2], q[k, 2]), found[..., :2].reshape(-1, 2)
    paths = [iterates(sensings[seed], start, state.momentum, u[k], shorter) for shorter in (1, 2)]
    return k, landscape(sensings[seed], q[k], u[k], bends.min(axis=0) - 5e-3, bends.max(axis=0) + 5e-3), paths


# Studies: what takes minutes and is committed in data/studies

STARTS, APART = 32, 1e-12
"""Starts of the descent, and by how much of each coordinate they differ: as much as rounding does."""


def ranges_over_starts(study: pd.DataFrame) -> pd.DataFrame:
    """Return the range over the starts of the mean over the seeds [mm], and whether rounding decides it.

    It does where the error of one seed moves by more than a tenth of its mean.
    """
    key, long = ["step", "row", "quantity"], study.melt(["step", "row", "seed", "start"], var_name="quantity")
    means = long.groupby([*key, "start"], sort=False)["value"].mean().groupby(key, sort=False)
    by_seed = long.groupby([*key, "seed"], sort=False)["value"]
    moved = ((by_seed.max() - by_seed.min()) / by_seed.mean()).groupby(key, sort=False).max()
    table = means.agg(lowest="min", middle="median", highest="max").assign(chaotic=moved > 0.1)
    return table.reset_index()


def stored(data: Data) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return ranges over starts, and errors of our filter: two studies of the simulated rig, empty for recordings."""
    both = ranges_over_starts(show.study("rig_starts")), show.study("bend_filter")
    return both if data.source == "simulated" else tuple(table[:0] for table in both)


def beside_print(data: Data, errors: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the tables of errors below the published one by their names: ours, and of the authors' networks."""
    networks = {"authors' networks": show.study("table_2_networks")} if data.source == "simulated" else {}
    return {data.badge: errors} | networks


def about(data: Data, seconds: float) -> str:
    """Return what a page says first: where its numbers come from, and what speaks against the recordings."""
    errors = (
        f"Errors are over the first {seconds:g} s of each test part: on T4 the inner turns of the spiral. ± is over"
        " three seeds, of the authors' networks over two. T1 hardly moves in y, so its relative error is left out."
    )
    return "\n\n".join([ABOUT[data.source], errors, *data.remarks])


def decided_by_rounding(ranges: pd.DataFrame) -> set[tuple[str, str]]:
    """Return the rows and quantities that rounding decides at the published step."""
    return {(line.row, line.quantity) for line in _decided_by_rounding(ranges).itertuples()}


def _decided_by_rounding(ranges: pd.DataFrame) -> pd.DataFrame:
    return ranges[ranges["chaotic"] & (ranges["step"] == "published")]


METHODS = {
    "bend": "error of",
    "known": "descent",
    "half": "half step",
    "ours": "filter",
    "descent": "networks: descent",
    "half step": "networks: half step",
    "filter": "networks: filter",
}
"""Columns of the table of methods, and what a reader sees."""


def methods(table: pd.DataFrame, study: pd.DataFrame) -> pd.DataFrame:
    """Return errors of the bend [mm], the mean over the seeds, a column for each method of a table of errors.

    Beside them stand those of the study ``bend_filter`` on robots whose readings are the authors' networks.
    """
    cells = table[table["unit"] == "mm"].groupby(["row", "quantity", "elongation"], sort=False)["error"]
    found = cells.mean().unstack(sort=False).reset_index()
    names = {row_name(name): name for name in TRAJECTORIES}
    found = found.assign(row=found["row"].map(names)).rename(columns={"row": "recording"})
    own = study[study["robot"] == "authors' networks"]
    own = own.melt(["recording", "method"], ["delta_x", "delta_y"], var_name="quantity")
    wide = own.pivot(index=["recording", "quantity"], columns="method", values="value").reset_index()
    shown = [name for name in METHODS if name in wide]
    return found.merge(wide[["recording", "quantity", *shown]], how="left") if shown else found


def caption(data: Data) -> str:
    """Return the caption of a table of methods."""
    networks = ", then the authors' networks as the robot" * (data.source == "simulated")
    return f"Errors of the bend in mm: {data.badge}{networks}."


def with_axes(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of methods as it is shown: one column says recording and axis."""
    axis = {"delta_x": ", Δx", "delta_y": ", Δy"}
    named = table.assign(bend=table["recording"] + table["quantity"].map(axis))
    return named[[name for name in METHODS if name in named]]


JUDGEMENT = {
    "robot": "robot",
    "of_descent": "filter / descent",
    "of_half_step": "/ half step",
    "own_biases": "own biases",
    "far_percent": "far off [%]",
    "far_unsaid_percent": "no flag [%]",
    "covered_percent": "covered [%]",
}


JUDGED = """Ratios of errors are geometric means over recordings and axes, of random rigs the median. Below one our
filter is better, although the descent knows start and elongation. On the authors' networks it is worse in five of
the ten errors. *Own biases*: the same over the descent for a filter with a further bias for each sensor. *Far off*:
largest share of frames of a recording with an error above 5 mm, and how many of these the filter does not flag.
*Covered*: frames whose true bend lies in the 95 % ellipse. Do not trust it: the plates err more in other recordings
than T5.train shows."""


def judgement(study: pd.DataFrame) -> pd.DataFrame:
    """Return how our filter compares with the paper's descent in study ``bend_filter``; of random rigs the median.

    A ratio of errors is the geometric mean over recordings and both axes. Of shares of frames that are far off, the
    largest of a recording stands, of those that the ellipse covers the mean.
    """
    lines = []
    for robot, own in study.groupby("robot", sort=False):
        by_method = {name: part.set_index("recording") for name, part in own.groupby("method")}
        axes, ours = ["delta_x", "delta_y"], by_method["filter"]
        ratios = [
            np.exp(np.log(by_method[over][axes] / by_method[under][axes]).to_numpy().mean())
            for over, under in (
                ("filter", "descent"),
                ("filter", "half step"),
                ("filter, own biases", "descent"),
            )
        ]
        shares = ours["far_percent"].max(), ours["far_unsaid_percent"].max(), ours["covered_percent"].mean()
        lines.append((robot, *ratios, *shares))
    table = pd.DataFrame(lines, columns=[*JUDGEMENT]).set_index("robot")
    random = table.index.str.startswith("random")
    table.loc[f"{random.sum()} random rigs"] = table[random].median()
    return table[~np.append(random, False)].reset_index()


def claims(printed: pd.DataFrame, lines: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return what the paper says of Table 2, and what its cells and those of tables of errors give [%]."""
    key = ["row", "quantity", "unit"]
    table = {"Table 2": printed.set_index(key)["value"]}
    for name, errors in lines.items():
        table[name] = errors[errors["elongation"] == "known"].groupby(key)["error"].mean()
    said = ("readings: mean 3.1", "readings: 0.6 to 4.6", "bend: mean 4.5", "bend: 1.9 to 13.6")
    columns: dict[str, Sequence[str]] = {"claim": said}
    for name, values in table.items():
        relative = values.xs("%", level="unit").drop([(row_name("T1"), "delta_y")], errors="ignore")
        parts = relative.xs("e_u", level="quantity"), relative.drop("e_u", level="quantity")
        columns[name] = [
            words for x in parts for words in (f"{x.mean():.1f}", f"{x.min():.1f} to {x.max():.1f}")
        ]
    return pd.DataFrame(columns)


def outside(train: Recording, q: np.ndarray) -> np.ndarray:
    """Return which configurations have a bend that is more than 0.5 mm from all of a recording."""
    return cKDTree(train.q[:, :2]).query(q[..., :2])[0] > 0.5e-3


def why_lost(ranges: pd.DataFrame, errors: pd.DataFrame, sensing: Sensing, seconds: float) -> str:
    """Return what makes errors on the simulated rig, rounding and on T3 a magnet that lags; else nothing."""
    if ranges.empty:
        return ""
    still = simulated("T3", SimpleNamespace(**vars(RIG) | {"across": 0.0}))
    part = still.cut(_first_of_test(still)).cut(0, round(seconds * RATE_HZ))
    without = float(np.sqrt(((sensing(part.q) - part.u) ** 2).mean(axis=0)).mean())
    own = errors[(errors["row"] == row_name("T3")) & (errors["unit"] == "mV")]["error"].iloc[0]
    chaotic = ranges.groupby("step")["chaotic"].sum()
    study = project_folder() / "data" / "studies" / "table_2_networks.json"
    networks = json.loads(study.read_text(encoding="utf-8"))
    return (
        "**Rounding.** Where the step is too long, starts that differ by rounding end on different tracks. In a"
        f" stored study of {STARTS} such starts this decides {chaotic['published']} of the {len(ranges) // 2} errors"
        f" of the bend at the published step, and {chaotic['half']} at half of it. On the authors' networks it"
        f" decides {networks['decided_by_rounding']} of {networks['of_errors']}.\n\n"
        "**T3.** The magnet of this rig lags where the direction of bending turns. Without the lag the readings of T3"
        f" would be off by {without:.1f} mV instead of {own:.1f} mV (first network)."
    )
