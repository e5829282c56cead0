"""Five IMUs on a chain of five links: its joints, by accelerometers and gyroscopes."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation, Slerp

import repro

try:
    from vqf import VQF
except ModuleNotFoundError:
    raise SystemExit("Orientations come from vqf: `pip install vqf` first.") from None
DATA = Path(os.environ.get("REPRO_DATA_DIR", "."), "imu_chain/data/dataset")
FILES = sorted(DATA.glob("trial*/imu_*.csv"))
if not FILES:
    raise SystemExit("Run `repro fetch imu_chain`; REPRO_DATA_DIR is its folder.")
ALONG = Rotation.from_euler("y", 90, degrees=True)  # from their x along a link to our z
PLACES, LENGTHS = [0.1, 0.3, 0.6, 0.9], [0.15, 0.29, 0.29, 0.27]
ENDS = [0.15, 0.44, 0.73, 1.0]
arm = repro.Arm([1, 2, 3, 4], PLACES, LENGTHS, markers=ENDS)
figures = {}
for file in FILES:
    imus = pd.read_csv(file, comment="#")
    capture = pd.read_csv(file.with_name("omc.csv"), comment="#")
    clock, times = np.arange(len(imus)) / 40, np.arange(len(capture)) / 30
    seen = capture.notna().all(axis=1) & (times < clock[-1])
    capture, times = capture[seen], times[seen]

    links, centres, turns = [], [], []  # orientations by vqf (w first), motion capture
    for k in range(1, 6):
        gyr, acc = (imus.filter(regex=f"seg{k}_{s}").to_numpy() for s in ("gyr", "acc"))
        quaternions = VQF(1 / 40).updateBatch(gyr.copy(), acc.copy())["quat6D"]
        read = Slerp(clock, Rotation.from_quat(quaternions, scalar_first=True))
        links.append((read(times) * ALONG).as_quat())
        markers = capture.filter(regex=f"seg{k}_marker").to_numpy()
        centres.append(markers.reshape(-1, 4, 3).mean(axis=1))
        turns.append(Rotation.from_quat(capture[[f"seg{k}_quat_{a}" for a in "xyzw"]]))
    joints = []  # where two links meet in the motion capture, from the first link
    for i in range(4):
        A = np.concatenate([turns[i].as_matrix(), -turns[i + 1].as_matrix()], axis=2)
        apart = (centres[i + 1] - centres[i]).ravel()
        own = np.linalg.lstsq(A.reshape(-1, 6), apart, rcond=1e-2)[0]
        joints.append(centres[i] + turns[i].apply(own[:3]) - centres[0])

    links, joints = np.stack(links[:4], axis=1), np.stack(joints, axis=1)
    third = len(times) // 3  # teaches, the rest judges
    taught = links[:third:5], joints[:third:5]
    found = repro.calibrate_imus(*taught, repro.rigid_body, arm, noise=0.03)
    p = repro.rigid_body(repro.calibrated(links, found), arm, ENDS) + found.translation
    distance = 1e3 * np.linalg.norm(p - joints, axis=-1)[third:, 3]
    case = f"{file.parent.name}_{file.stem.removeprefix('imu_')}"
    figures[f"{case}_joint_4_rms_mm"] = np.sqrt((distance**2).mean())
print(pd.Series(figures).round(1).to_string())
