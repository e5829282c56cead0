"""A magnet before sixteen sensors, readings simulated by others: its pose, and how sure we are of it."""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

import repro

DATA = Path(__file__).parents[2] / "magnet_array"

robot = repro.load_robot(DATA / "robot.toml")
shape = repro.track(repro.LevenbergMarquardt(robot), robot.readings(DATA / "readings.csv"))

truth = pd.read_csv(DATA / "magnet.csv")
error = shape.q[:, :3] - truth[["x_mm", "y_mm", "z_mm"]].to_numpy() / 1e3
axis = Rotation.from_rotvec(truth[["rx_rad", "ry_rad", "rz_rad"]]).as_matrix()[:, :, 2]
turned = np.degrees(np.arccos((robot.tip(shape.q)[:, :3, 2] * axis).sum(1)))
C = shape.covariance[:, :3, :3]
d2 = np.einsum("ti,tij,tj->t", error, np.linalg.inv(C), error)
figures = {
    "position, mean [mm]": 1e3 * np.linalg.norm(error, axis=1).mean(),
    "axis, mean [deg]": turned.mean(),
}
figures["90 % ellipsoids hold [%]"] = 100 * (d2 < 6.25).mean()
figures["median deviation along an axis [mm]"] = 1e3 * np.sqrt(np.median(C.diagonal(0, 1, 2)))
figures["rows consistent [%]"] = 100 * (shape.status == "consistent").mean()
for name, value in figures.items():
    print(f"{name} {value:.3f}")
print("the source states a rate, more than 100 Hz, and no error")
