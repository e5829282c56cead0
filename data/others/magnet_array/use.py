"""A magnet before sixteen sensors, readings simulated by others: its pose."""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

import repro

DATA = Path(__file__).parents[2] / "magnet_array"

robot = repro.load_robot(DATA / "robot.toml")
found = repro.track(
    repro.LevenbergMarquardt(robot), robot.readings(DATA / "readings.csv")
)

truth = pd.read_csv(DATA / "magnet.csv")
turns = Rotation.from_rotvec(truth[["rx_rad", "ry_rad", "rz_rad"]]).as_matrix()
cosine = (robot.tip(found.q)[:, :3, 2] * turns[:, :, 2]).sum(axis=1)
error = 1e3 * found.q[:, :3] - truth[["x_mm", "y_mm", "z_mm"]].to_numpy()
judged = {"position": (error, 1e6 * found.covariance[:, :3, :3])}
figures = {
    "position_mean_mm": np.linalg.norm(error, axis=1).mean(),
    "axis_mean_deg": np.degrees(np.arccos(cosine)).mean(),
    "consistent_percent": 100 * (found.status == "consistent").mean(),
}
print(pd.Series(figures).round(3).to_string())
