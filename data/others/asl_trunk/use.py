"""A hose with three discs under motion capture: its shape by three arcs, and its tip from orientations alone."""

from pathlib import Path

import numpy as np
import pandas as pd

import repro
from repro.chain import point_on
from repro.estimators.fit_shape import Rig

DATA = Path(__file__).parents[2] / "recordings/asl_trunk"
LENGTHS = [0.106, 0.095, 0.115]
hanging = np.eye(4)  # T_capture_base: the arm hangs along -y of the cameras
hanging[:3, :3], hanging[:3, 3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [0.1, 0.0, 0.105]
disc = np.eye(4)
disc[:3, :3] = hanging[:3, :3].T  # bodies have the axes of the room at rest
first = Rig(hanging, np.stack([disc] * 3), np.zeros((4, 6)))
arm = repro.Robot([repro.ConstantCurvature(length, 1.0) for length in LENGTHS])
figures = {}
for name in ("adiabatic", "controlled"):
    table = pd.read_csv(DATA / f"{name}.csv")
    body = [f"{a}_{{}}_mm" for a in "xyz"] + [f"q{a}_{{}}" for a in "xyzw"]
    poses = np.stack([table[[c.format(k) for c in body]].to_numpy() for k in (1, 2, 3)], axis=1)
    poses[..., :3] /= 1e3
    third = len(poses) // 3
    learnt = repro.fit_shape(arm, poses[:third], rig=first, fit_rig=True)
    whole = repro.fit_shape(arm, poses, rig=learnt.rig)
    figures[f"{name}: disc, three arcs, median [mm]"] = 1e3 * np.median(whole.residual)

    lengths = np.array(LENGTHS) + np.median(learnt.q[:, 2::3], axis=0)
    stiff = repro.Robot([repro.ConstantCurvature(length, 1.0, extensible=False) for length in lengths])
    turned = repro.fit_shape(stiff, poses, rig=learnt.rig, noise=(1e3, 0.01))  # positions count for nothing
    places = [point_on(k, length) for k, length in enumerate(lengths, 1)]
    tips = (learnt.rig.base @ stiff.poses(turned.q, places) @ learnt.rig.bodies)[third:, 2, :3, 3]
    error = 1e3 * np.linalg.norm(tips - poses[third:, 2, :3], axis=1)
    figures[f"{name}: tip from orientations, median [mm]"] = np.median(error)
for name, value in figures.items():
    print(f"{name} {value:.2f}")
print("the source states no figure")
