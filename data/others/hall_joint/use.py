"""One three-axis chip under a magnetic joint: a model of one's own, from ten poses of the first cycle."""

import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

import repro

DATA = Path(os.environ["REPRO_DATA_DIR"]) / "hall_joint/data_07102024"


def cycle(number):
    """Return angles [deg] and readings [angle, sample, axis] in mT."""
    table = pd.read_csv(DATA / f"R{number}_DC0.csv")
    samples = [
        np.stack([json.loads(row[axis])[:499] for axis in "xyz"], axis=1) for _, row in table.iterrows()
    ]
    return table["Angle"].to_numpy(float), 1e3 * np.stack(samples)


angle, u = cycle(0)
ten = np.linspace(0, len(angle) - 1, 10).round().astype(int)
model = CubicSpline(angle[ten], u[ten].mean(1))
method = repro.LevenbergMarquardt(lambda q: model(q[..., 0]), [-36.0], [36.0], noise=u[ten].std(1).mean(0))
figures = {}
for number in (1, 2, 3):
    if not (DATA / f"R{number}_DC0.csv").is_file():
        continue  # repro fetch hall_joint
    truth, u = cycle(number)
    for name, readings in (("means", u.mean(1)), ("single samples", u[:, ::50].reshape(-1, 3))):
        found = repro.track(method, readings)
        error = found.q[:, 0] - np.repeat(truth, len(readings) // len(truth))
        figures[f"cycle {number}, {name}, rms [deg]"] = np.sqrt((error**2).mean())
        inside = np.abs(error) < 2 * np.sqrt(found.covariance[:, 0, 0])
        figures[f"cycle {number}, {name}, within 2 sd [%]"] = 100 * inside.mean()
for name, value in figures.items():
    print(f"{name} {value:.2f}")
print("the source's lookup 2.0 deg rms")
