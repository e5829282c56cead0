"""3,000 static shapes of a soft arm of 645 mm: how many arcs does it take?"""

import os
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

import repro
from repro.estimators.fit_shape import Rig

DATA = Path(os.environ["REPRO_DATA_DIR"]) / "soft_arm_3000/csv_files"
BODIES = ("SA-low", "SA-middle", "SA-up")

table = pd.read_csv(next(DATA.glob("optitrack*.csv")))
p = np.stack([table[[f"{body}-{a}" for a in "XYZ"]] for body in BODIES], axis=1)
turns = np.stack([table[[f"{body}-{a}" for a in ("Roll", "Pitch", "Yaw")]] for body in BODIES], axis=1)
q = Rotation.from_euler("xyz", turns.reshape(-1, 3), degrees=True).as_quat().reshape(-1, 3, 4)
poses = np.concatenate([p, q], axis=-1)
base = np.eye(4)  # the arm stands along y of the cameras
base[:3, :3], base[:3, 3] = [[0, 1, 0], [0, 0, 1], [1, 0, 0]], table[[f"SA-base-{a}" for a in "XYZ"]].mean()
body = np.eye(4)
body[:3, :3] = base[:3, :3].T
first = Rig(base, np.stack([body] * 3), np.zeros((4, 6)))
figures = {}
for name, n in {"one arc": 1, "two arcs": 2, "three arcs": 3, "affine": 0}.items():
    length = 0.63 / max(n, 1)
    affine = {"lower": [-6, -12, -np.pi, -0.3], "upper": [6, 12, np.pi, 0.3], "start": [0.3, 0.1, 0.1, 0.0]}
    kind = repro.ConstantCurvature(length, 1.0) if n else repro.AffineCurvature(length)
    robot = repro.Robot([kind] * max(n, 1), **({} if n else affine))
    segment = [int(np.ceil(a / length - 1e-9)) for a in (0.21, 0.42, 0.63)]
    at = [(g, min(a - (g - 1) * length, length)) for g, a in zip(segment, (0.21, 0.42, 0.63))]
    rig = repro.fit_shape(robot, poses[::5], at, rig=first, fit_rig=True).rig
    found = repro.fit_shape(robot, poses[2::5], at, rig=rig)
    figures[f"{name}, median [mm]"] = 1e3 * np.median(found.residual)
    figures[f"{name}, 99 % [mm]"] = 1e3 * np.quantile(found.residual, 0.99)
for name, value in figures.items():
    print(f"{name} {value:.2f}")
print("the source states no figure")
