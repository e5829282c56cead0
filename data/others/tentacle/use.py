"""A soft tentacle, four markers, 22 loads: how well do arcs describe its shape?"""

from pathlib import Path

import numpy as np
import pandas as pd

import repro
from repro.estimators.fit_shape import Rig

DATA = Path(__file__).parents[2] / "recordings/tentacle"
LENGTH, NOISE = 0.372, (3e-3, 0.1)
ARCS = [0.138, 0.217, 0.284, 0.370]  # of the markers, from the least load [m]
OFF = [0.029, -0.015, 0.029, 0.023]  # how far they stand off the backbone
AFFINE = {"lower": [-9, -18, -np.pi, -0.2], "upper": [9, 18, np.pi, 0.2]}
AFFINE["start"] = [0.3, 0.1, 0.1, 0.0]

markers = pd.read_csv(DATA / "shapes.csv").drop(columns="load").to_numpy() / 1e3
markers = markers.reshape(-1, 4, 3)
down = np.diag([1.0, -1.0, -1.0, 1.0])  # the tentacle hangs along -z
first = Rig(down, np.tile(np.eye(4), (4, 1, 1)), np.zeros((5, 6)))
robots = {
    "two arcs": repro.Robot([repro.ConstantCurvature(LENGTH / 2, 1.0)] * 2),
    "three arcs": repro.Robot([repro.ConstantCurvature(LENGTH / 3, 1.0)] * 3),
    "affine": repro.Robot([repro.AffineCurvature(LENGTH)], **AFFINE),
}
errors, fits = pd.read_csv(DATA / "released_errors.csv")[["identified_mm"]], {}
errors.columns = ["source, from the tension"]
for name, robot in robots.items():
    length = LENGTH / len(robot.segments)
    at = [(int(a / length) + 1, a % length, (off, 0, 0)) for a, off in zip(ARCS, OFF)]
    fits[name] = repro.fit_shape(
        robot, markers, at, noise=NOISE, rig=first, fit_rig=True, leave_out=False
    )
    distance = 1e3 * np.linalg.norm(fits[name].residuals[..., :3], axis=-1)
    errors[name] = distance.mean(axis=0)
errors.index += 1
figures = {f"{name}_marker_{k}_mm": x for (k, name), x in errors.stack().items()}
print(errors.round(2).to_string())
