"""A simulated rig in place of that of Baaij et al. 2023, whose recordings we may not pass on.

It records the six trajectories: pressures bend a segment with lag and hysteresis, magpylib's field of the ring
reaches three sensors that are not where the drawing has them, and both go through the authors' pipeline. Its
parameters were set to what is known of the authors' sensors before any estimator ran on it, and then frozen.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from repro.chain import place
from repro_companion.papers.rig import (
    BASE_HEIGHT,
    CLIPPED_MV,
    EARTH,
    MARKERS_AT,
    RATE_HZ,
    RING,
    SENSORS,
    TRAJECTORIES,
    Capture,
    Recording,
    aligned,
    configurations,
    robot,
)

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
