"""A continuum robot of 466 mm with trackers and gyroscopes: its shape over time, against motion capture."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

import repro
from repro.estimators.rod import Rod, RodFilter, RodSensor

DATA = Path(__file__).parents[2] / "recordings/continuum_robot"
ARCS = [0.1165, 0.233, 0.3495, 0.466]
WINDOWS = {"slow_free_space": (19, 29), "impulse_1": (20, 30)}  # what the source evaluates

sensors = [
    RodSensor("pose", [1.9e-3] * 3 + [0.0108] * 3, 0.0),  # errors of the trackers in slow_free_space
    RodSensor("pose", [3.3e-3] * 3 + [0.0203] * 3, 0.466),
    RodSensor("gyroscope", 0.2, 0.233),
    RodSensor("gyroscope", 0.2, 0.466),
]
std = [2.0, 0.5, 2 / 9] * 2 + [0.3]  # curvature in three terms about x and y, twist [rad/m]
arm = RodFilter(Rod(0.466, bending=3, torsion=1), sensors, std, rate=7.0, base_std=(3e-3, 0.02), iterations=1)


def read(name, window):
    table = np.loadtxt(DATA / trial / f"{name}.csv", delimiter=",", skiprows=2)
    return table[(table[:, 0] >= window[0]) & (table[:, 0] <= window[1])]


figures = {}
for trial, window in WINDOWS.items():
    seen = [read(name, window) for name in ("aurora0", "aurora1", "gyro_mid", "gyro_ee")]
    bodies = [read(f"vicon{k}", window) for k in range(1, 5)]
    times = np.unique(np.concatenate([part[:, 0] for part in seen + bodies]))
    u = np.full((len(times), 18), np.nan)  # a row without a reading is predicted
    for part, first in zip(seen, (0, 6, 12, 15)):
        u[np.searchsorted(times, part[:, 0]), first : first + part.shape[1] - 2] = part[:, 2:]
    for name, found in (
        ("filter", repro.track(arm, u, times=times)),
        ("smoother", repro.smooth(arm, u, times=times)),
    ):
        p, C = arm.positions(found.q, found.covariance, ARCS)
        rows = [np.searchsorted(times, body[:, 0]) for body in bodies]
        truth = [
            RigidTransform.from_exp_coords(np.roll(body[:, 2:], 3, axis=1)).translation for body in bodies
        ]
        e = [p[row, k] - x for k, (row, x) in enumerate(zip(rows, truth))]
        inside = [
            np.einsum("ti,ti->t", x, np.linalg.solve(C[row, k], x[..., None])[..., 0]) < 6.25
            for k, (row, x) in enumerate(zip(rows, e))
        ]
        rms = np.mean([1e3 * np.sqrt((x**2).sum(1).mean()) for x in e])
        figures[f"{trial}, {name}, rms [mm]"] = rms
        figures[f"{trial}, {name}, 90 % ellipsoids hold [%]"] = 100 * np.concatenate(inside).mean()
for name, value in figures.items():
    print(f"{name} {value:.2f}")
print("the source's filter 11.46 mm, window 11.00 mm, raw, geometric mean of four trials")
