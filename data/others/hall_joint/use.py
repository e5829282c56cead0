"""One three-axis chip under a magnetic joint: its angle, by a spline of ten poses."""

import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

import repro

DATA = Path(os.environ.get("REPRO_DATA_DIR", "."), "hall_joint/data_07102024")
if not all((DATA / f"R{k}_DC0.csv").is_file() for k in (0, 1)):
    raise SystemExit("Run `repro fetch hall_joint`; REPRO_DATA_DIR is its folder.")


def cycle(number):
    """Return angles [deg] and readings [angle, sample, axis] in mT."""
    table = pd.read_csv(DATA / f"R{number}_DC0.csv")
    axes = [[json.loads(samples)[:499] for samples in table[axis]] for axis in "xyz"]
    return table["Angle"].to_numpy(float), 1e3 * np.stack(axes, axis=-1)


angle, u = cycle(0)
ten = np.linspace(0, len(angle) - 1, 10).round().astype(int)
poses, means = angle[ten], u[ten].mean(axis=1)
spline, off = CubicSpline(poses, means), []
for k in range(1, 9):  # by how much it misses a pose that is left out
    without = CubicSpline(np.delete(poses, k), np.delete(means, k, axis=0))
    off.append(without(poses[k]) - means[k])
noise = np.sqrt(u[ten].var(axis=1).mean(axis=0) + np.square(off).mean(axis=0))
model = lambda q: spline(q[..., 0].real)  # noqa: E731
method = repro.LevenbergMarquardt(model, [-36], [36], noise=noise)
figures, judged = {}, {}
for number in (k for k in (1, 2, 3) if (DATA / f"R{k}_DC0.csv").is_file()):
    truth, u = cycle(number)
    for name, rows in {"mean": u.mean(axis=1)[:, None], "sample": u[:, ::50]}.items():
        found, case = repro.track(method, rows.reshape(-1, 3)), f"cycle_{number}_{name}"
        error = found.q - np.repeat(truth, rows.shape[1])[:, None]
        judged[case] = error, found.covariance
        figures[f"{case}_rms_deg"] = np.sqrt((error**2).mean())
        good = (found.status == "consistent").mean()
        figures[f"{case}_consistent_percent"] = 100 * good
print(pd.Series(figures).round(3).to_string())
