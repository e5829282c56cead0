"""3,000 static shapes of a soft arm of 645 mm: how many arcs does it take?"""

import os
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

import repro
from repro.estimators.fit_shape import Rig

DATA = Path(os.environ.get("REPRO_DATA_DIR", "."), "soft_arm_3000/csv_files")
FILES = sorted(DATA.glob("optitrack*.csv"))
if not FILES:
    raise SystemExit("Run `repro fetch soft_arm_3000`; REPRO_DATA_DIR is its folder.")
BODIES, ANGLES = ("SA-low", "SA-middle", "SA-up"), ("Roll", "Pitch", "Yaw")
LENGTH, ARCS = 0.63, (0.21, 0.42, 0.63)
AFFINE = {"lower": [-6, -12, -np.pi, -0.3], "upper": [6, 12, np.pi, 0.3]}
AFFINE["start"] = [0.3, 0.1, 0.1, 0.0]

table = pd.read_csv(FILES[0])
poses = np.tile(np.eye(4), (len(table), 3, 1, 1))
for k, name in enumerate(BODIES):
    turns = table[[f"{name}-{a}" for a in ANGLES]]
    poses[:, k, :3, :3] = Rotation.from_euler("xyz", turns, degrees=True).as_matrix()
    poses[:, k, :3, 3] = table[[f"{name}-{a}" for a in "XYZ"]]
base, body = np.eye(4), np.eye(4)  # the arm stands along y of the cameras
base[:3, :3] = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
base[:3, 3] = table[[f"SA-base-{a}" for a in "XYZ"]].mean()
body[:3, :3] = base[:3, :3].T
first = Rig(base, np.stack([body] * 3), np.zeros((4, 6)))
robots = {"affine": repro.Robot([repro.AffineCurvature(LENGTH)], **AFFINE)}
for n in (1, 2, 3):
    robots[f"arcs_{n}"] = repro.Robot([repro.ConstantCurvature(LENGTH / n, 1.0)] * n)
figures = {}
for name, robot in robots.items():
    length = LENGTH / len(robot.segments)
    segment = [int(np.ceil(a / length - 1e-9)) for a in ARCS]
    at = [(g, min(a - (g - 1) * length, length)) for g, a in zip(segment, ARCS)]
    rig = repro.fit_shape(robot, poses[::5], at, rig=first, fit_rig=True).rig
    found = repro.fit_shape(
        robot, poses[2::5], at, rig=rig, leave_out=False
    )  # other shapes
    figures[f"{name}_median_mm"] = 1e3 * np.median(found.residual)
    figures[f"{name}_99_percent_mm"] = 1e3 * np.quantile(found.residual, 0.99)
print(pd.Series(figures).round(2).to_string())
