"""A hose with three discs: its shape by three arcs, its tip from orientations alone."""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.distance import cdist

import repro
from repro.chain import point_on
from repro.estimators.fit_shape import Rig

DATA = Path(__file__).parents[2] / "recordings/asl_trunk"
LENGTHS, SHARE = [0.106, 0.095, 0.115], 0.1
BODY = [f"{a}_{{0}}_mm" for a in "xyz"] + [f"q{a}_{{0}}" for a in "xyzw"]
COLUMNS = [[column.format(k) for column in BODY] for k in (1, 2, 3)]
hanging, disc = np.eye(4), np.eye(4)  # it hangs along -y of the cameras
hanging[:3, :3], hanging[:3, 3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [0.1, 0, 0.105]
disc[:3, :3] = hanging[:3, :3].T
drawn = Rig(hanging, np.stack([disc] * 3), np.zeros((4, 6)))
arm = repro.Robot([repro.ConstantCurvature(length, 1.0) for length in LENGTHS])


def learned(x, y, at):
    """Return what kernel ridge predicts, and which share of the variance it leaves."""
    K = np.exp(-cdist(x, x, "sqeuclidean") / 2) + SHARE * np.eye(len(x))
    k = np.exp(-cdist(at, x, "sqeuclidean") / 2)
    predicted = y.mean(axis=0) + k @ np.linalg.solve(K, y - y.mean(axis=0))
    return predicted, 1 - np.einsum("ij,ji->i", k, np.linalg.solve(K, k.T))


figures, judged, kept = {}, {}, {}
for name in ("adiabatic", "controlled"):
    poses = np.stack([pd.read_csv(DATA / f"{name}.csv")[c] for c in COLUMNS], axis=1)
    poses[..., :3] /= 1e3
    third = len(poses) // 3  # teaches, the rest judges
    rig = repro.fit_shape(arm, poses[:third], rig=drawn, fit_rig=True).rig
    whole = repro.fit_shape(arm, poses, rig=rig, leave_out=False)
    good = whole.chi2 < 10 * np.median(whole.chi2)  # else markers were exchanged

    lengths = LENGTHS + np.median(whole.q[:third, 2::3], axis=0)
    arcs = [repro.ConstantCurvature(x, 1.0, extensible=False) for x in lengths]
    stiff, tip = repro.Robot(arcs), point_on(3, lengths[2])
    loose = {"noise": (1e3, 0.01), "leave_out": False}  # no positions
    turned = repro.fit_shape(stiff, poses, rig=rig, **loose)
    T = rig.base @ stiff.poses(turned.q, [tip]) @ rig.bodies[2]
    off = 1e3 * (T[:, 0, :3, 3] - poses[:, 2, :3])
    x, rows = turned.q / turned.q[:third].std(axis=0), np.flatnonzero(good)
    teach, judge = rows[rows < third][:: third // 500 + 1], rows[rows >= third]
    left_out = []
    for part in np.array_split(teach, 3):
        others = np.setdiff1d(teach, part)
        left_out.append(off[part] - learned(x[others], off[others], x[part])[0])
    expected, unknown = learned(x[teach], off[teach], x[judge])
    error, C = off[judge] - expected, np.cov(np.concatenate(left_out).T)
    judged[name] = error, C + unknown[:, None, None] * np.cov(off[teach].T)
    kept[name] = poses, good, off[judge]
    figures[f"{name}_disc_median_mm"] = 1e3 * np.median(whole.residual)
    figures[f"{name}_left_out_frames"] = (~good).sum()
    for case, e in {"arcs_tip": off[judge], "tip": error}.items():
        figures[f"{name}_{case}_median_mm"] = np.median(np.linalg.norm(e, axis=1))
print(pd.Series(figures).round(2).to_string())
