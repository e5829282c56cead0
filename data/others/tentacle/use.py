"""A soft tentacle, four markers, 22 loads: how well do arcs and affine curvature describe its shape?"""

from pathlib import Path

import numpy as np
import pandas as pd

import repro
from repro.estimators.fit_shape import Rig

DATA = Path(__file__).parents[2] / "recordings/tentacle"
LENGTH = 0.372
ARCS = [0.138, 0.217, 0.284, 0.370]  # of the markers, and how far they stand off, from the least load [m]
OFF = [0.029, -0.015, 0.029, 0.023]

markers = pd.read_csv(DATA / "shapes.csv").drop(columns="load").to_numpy().reshape(-1, 4, 3) / 1e3
down = np.diag([1.0, -1.0, -1.0, 1.0])  # the tentacle hangs along -z
figures = {}
for name, n in {"two arcs": 2, "three arcs": 3, "affine": 1}.items():
    length = LENGTH / n
    kind = repro.AffineCurvature(length) if n == 1 else repro.ConstantCurvature(length, 1.0)
    limits = {} if n > 1 else {"lower": [-9, -18, -np.pi, -0.2], "upper": [9, 18, np.pi, 0.2]}
    robot = repro.Robot([kind] * n, **limits, start=[0.3, 0.1, 0.1, 0.0] if n == 1 else None)
    at = [(int(a / length) + 1, a % length, (off, 0.0, 0.0)) for a, off in zip(ARCS, OFF)]
    first = Rig(down, np.tile(np.eye(4), (4, 1, 1)), np.zeros((5, 6)))
    found = repro.fit_shape(robot, markers, at, noise=(3e-3, 0.1), rig=first, fit_rig=True)
    error = 1e3 * np.linalg.norm(found.residuals[..., :3], axis=-1)
    figures[f"{name} [mm]"] = error.mean(0).round(1).tolist()
released = pd.read_csv(DATA / "released_errors.csv")["identified_mm"].tolist()
for name, value in figures.items():
    print(name, value)
print("the source, another task (from the tension of the tendons) [mm]", released)
