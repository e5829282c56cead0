"""A continuum robot with trackers and gyroscopes: its shape, against motion capture."""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import RigidTransform

import repro
from repro.estimators.rod import Rod, RodFilter, RodSensor

DATA = Path(__file__).parents[2] / "recordings/continuum_robot"
LENGTH, ARCS = 0.466, [0.1165, 0.233, 0.3495, 0.466]
WINDOWS = {"slow_free_space": (19, 29), "impulse_1": (20, 30)}  # of the source [s]

base = RodSensor("pose", [1.9e-3] * 3 + [0.0108] * 3, 0.0)  # errors in slow_free_space
tip = RodSensor("pose", [3.3e-3] * 3 + [0.0203] * 3, LENGTH)
gyroscopes = [RodSensor("gyroscope", 0.2, arc) for arc in (LENGTH / 2, LENGTH)]
std = [2.0, 0.5, 2 / 9] * 2 + [0.3]  # three terms about x and y, twist [rad/m]
rod, sensors = Rod(LENGTH, bending=3, torsion=1), [base, tip, *gyroscopes]
arm = RodFilter(rod, sensors, std, rate=7.0, base_std=(3e-3, 0.02), iterations=1)


def read(trial, name):
    """Return times [s] and readings in the window that the source evaluates."""
    table = np.loadtxt(DATA / trial / f"{name}.csv", delimiter=",", skiprows=2)
    start, end = WINDOWS[trial]
    table = table[(table[:, 0] >= start) & (table[:, 0] <= end)]
    return table[:, 0], table[:, 2:]


figures, judged, shapes = {}, {}, {}
for trial in WINDOWS:
    seen = [read(trial, name) for name in ("aurora0", "aurora1", "gyro_mid", "gyro_ee")]
    bodies = [read(trial, f"vicon{k}") for k in range(1, 5)]
    times = np.unique(np.concatenate([t for t, _ in seen + bodies]))
    u = np.full((len(times), 18), np.nan)  # a row without a reading is predicted
    for (t, values), first in zip(seen, (0, 6, 12, 15)):
        u[np.searchsorted(times, t), first : first + values.shape[1]] = values
    found, parts = repro.track(arm, u, times=times), []
    p, C = arm.positions(found.q, found.covariance, ARCS)
    for k, (t, logarithms) in enumerate(bodies):
        frames = np.searchsorted(times, t)
        truth = RigidTransform.from_exp_coords(np.roll(logarithms, 3, axis=1))
        parts.append((1e3 * (p[frames, k] - truth.translation), 1e6 * C[frames, k]))
    rms = [np.sqrt((error**2).sum(axis=1).mean()) for error, _ in parts]
    judged[trial] = tuple(np.concatenate(part) for part in zip(*parts))
    shapes[trial] = found, frames, p[frames]
    figures[f"{trial}_rms_mm"] = np.mean(rms)
    told = found.status != "undetermined"  # else too little was read
    figures[f"{trial}_consistent_percent"] = (
        100 * (found.status[told] == "consistent").mean()
    )
print(pd.Series(figures).round(2).to_string())
