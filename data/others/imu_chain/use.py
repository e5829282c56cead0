"""Five IMUs on a chain of five links: where its joints are, from raw accelerometers and gyroscopes."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation, Slerp
from vqf import VQF  # pip install vqf

import repro

DATA = Path(os.environ["REPRO_DATA_DIR"]) / "imu_chain/data/dataset"
ALONG = Rotation.from_euler("y", 90, degrees=True)  # the IMUs' x points along the links, ours z
figures = {}
for trial, mounted in [
    (k, m) for k in (1, 2) for m in ("nonrigid", "rigid") if (DATA / f"trial{k}").is_dir()
]:
    capture = pd.read_csv(DATA / f"trial{trial}/omc.csv", comment="#")
    imus = pd.read_csv(DATA / f"trial{trial}/imu_{mounted}.csv", comment="#")
    raw = {
        (k, s): np.ascontiguousarray(imus.filter(regex=f"seg{k}_{s}"))
        for k in range(1, 6)
        for s in ("gyr", "acc")
    }
    q = [
        VQF(1 / 40).updateBatch(raw[k, "gyr"], raw[k, "acc"])["quat6D"][:, [1, 2, 3, 0]] for k in range(1, 6)
    ]
    times = np.arange(len(capture)) / 30
    seen = np.flatnonzero(capture.notna().all(axis=1) & (times < (len(imus) - 1) / 40))
    centre = [
        capture.filter(regex=f"seg{k}_marker").to_numpy().reshape(-1, 4, 3).mean(1)[seen] for k in range(1, 6)
    ]
    R = [
        Rotation.from_quat(capture[[f"seg{k}_quat_{a}" for a in "xyzw"]].to_numpy()[seen])
        for k in range(1, 6)
    ]
    joints = []  # where two links meet in the motion capture, as seen from the first link
    for i in range(4):
        A = np.concatenate([R[i].as_matrix(), -R[i + 1].as_matrix()], axis=2).reshape(-1, 6)
        own = np.linalg.lstsq(A, (centre[i + 1] - centre[i]).ravel(), rcond=1e-2)[0]
        joints.append(centre[i] + R[i].apply(own[:3]) - centre[0])
    joints = np.stack(joints, axis=1)
    links = [Slerp(np.arange(len(x)) / 40, Rotation.from_quat(x))(times[seen]) * ALONG for x in q[:4]]
    links = np.stack([x.as_quat() for x in links], axis=1)
    arm = repro.Arm(
        [1, 2, 3, 4], [0.1, 0.3, 0.6, 0.9], [0.15, 0.29, 0.29, 0.27], markers=[0.15, 0.44, 0.73, 1.0]
    )
    third = len(seen) // 3
    found = repro.calibrate_imus(links[:third:5], joints[:third:5], repro.rigid_body, arm, noise=0.03)
    p = repro.rigid_body(repro.calibrated(links, found), arm, arm.markers) + found.translation
    error = 1e3 * np.linalg.norm(p - joints, axis=-1)[third:, 3]
    figures[f"trial {trial}, {mounted}, 4th joint, rms [mm]"] = np.sqrt((error**2).mean())
for name, value in figures.items():
    print(f"{name} {value:.0f}")
print("the source states no figure of the joints")
