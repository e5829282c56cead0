"""Judge the prototypes on the robots of others: ``python scripts/prototypes/bars.py [NAME ...]``.

Recordings without a licence lie below ``REPRO_DATA_DIR``. Settings come from the part of each recording that is
learned from. Figures go to ``data/studies/others_prototypes.csv``.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from learned import Learned
from left_out_bodies import fit
from link_vectors import calibrate_links
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import repro
from repro.chain import point_on

ROOT = Path(__file__).resolve().parents[2]
STUDY = ROOT / "data" / "studies" / "others_prototypes.csv"


def used(name):
    """Return the names of a user's script, after it ran."""
    return runpy.run_path(str(ROOT / "data" / "others" / name / "use.py"))


def inside(error, C):
    """Return how many errors ``[n, m]`` ellipsoids of 90 % hold [%], and the median of their longest semi-axis."""
    edge = chi2(error.shape[1]).ppf(0.9)
    d2 = np.einsum("ti,ti->t", error, np.linalg.solve(C, error[..., None])[..., 0])
    return 100 * (d2 < edge).mean(), np.median(np.sqrt(edge * np.linalg.eigvalsh(C)[:, -1]))


def jumps(q, kept):
    """Return how often a body turns by more than 10 degrees from one kept frame to the next."""
    turn = Rotation.from_quat(q[kept])
    return int(((turn[:-1].inv() * turn[1:]).magnitude() > np.radians(10)).sum())


def asl_trunk():
    """Bodies left out; the tip from orientations with what the first third teaches; 200 g."""
    own, rows = used("asl_trunk"), []
    for name in ("adiabatic", "controlled"):
        table = pd.read_csv(own["DATA"] / f"{name}.csv")
        poses = np.stack([table[[c.format(k) for c in own["body"]]].to_numpy() for k in (1, 2, 3)], axis=1)
        poses[..., :3] /= 1e3
        third = len(poses) // 3
        rig = repro.fit_shape(own["arm"], poses[:third], rig=own["first"], fit_rig=True).rig
        clean, status, body, _ = fit(own["arm"], poses, rig=rig)
        for k in range(3):
            before, after = (
                jumps(poses[:, k, 3:], np.full(len(poses), True)),
                jumps(poses[:, k, 3:], body != k),
            )
            rows += [
                (name, f"body {k + 1}: jumps above 10 deg before", before),
                (name, f"body {k + 1}: after", after),
            ]
            rows.append((name, f"body {k + 1}: frames left out", int((body == k).sum())))
        rows.append((name, "inconsistent frames", int((status == "inconsistent").sum())))
        good = np.flatnonzero(body < 0)
        learn, judge = good[good < third], good[good >= third]
        learnt: Any = repro.fit_shape(own["arm"], clean[learn], rig=own["first"], fit_rig=True)
        lengths = np.array(own["LENGTHS"]) + np.median(learnt.q[:, 2::3], axis=0)
        stiff = repro.Robot([repro.ConstantCurvature(x, 1.0, extensible=False) for x in lengths])
        turned = repro.fit_shape(stiff, poses, rig=learnt.rig, noise=(1e3, 0.01))
        places = [point_on(k, length) for k, length in enumerate(lengths, 1)]
        tips = (learnt.rig.base @ stiff.poses(turned.q, places) @ learnt.rig.bodies)[:, 2, :3, 3]
        off = 1e3 * (poses[:, 2, :3] - tips)
        model = Learned(
            turned.q[learn][:: max(1, len(learn) // 500)], off[learn][:: max(1, len(learn) // 500)]
        )
        error = off[judge] - model(turned.q[judge])
        held, size = inside(error, model.covariance(turned.q[judge]))
        rows.append((name, "tip from orientations, median [mm]", np.median(np.linalg.norm(error, axis=1))))
        rows.append((name, "90 % ellipsoids hold [%]", held))
        rows.append((name, "longest semi-axis, median [mm]", size))
        if name == "controlled":
            rows += loaded(own, stiff, learnt.rig)
    return rows


def loaded(own, stiff, rig):
    """Judge arcs and rig of the arm without a load on shapes with 200 g: disc 2 from discs 1 and 3."""
    table = pd.read_csv(own["DATA"] / "steady_200g.csv").to_numpy().reshape(-1, 3, 3) / 1e3
    rows = []
    for name, arm in (("arcs that stretch", own["arm"]), ("arcs of constant length", stiff)):
        found = repro.fit_shape(arm, table, rig=rig)
        rows.append(("200 g", f"{name}: disc distance, median [mm]", 1e3 * np.median(found.residual)))
    given = table.copy()
    given[:, 1] = np.nan
    found = repro.fit_shape(stiff, given, rig=rig)
    places = [point_on(k, s.length) for k, s in enumerate(stiff.segments, 1)]
    p = (rig.base @ stiff.poses(found.q, places) @ rig.bodies)[:, 1, :3, 3]
    rows.append(
        (
            "200 g",
            "disc 2 from discs 1 and 3, median [mm]",
            1e3 * np.median(np.linalg.norm(p - table[:, 1], axis=1)),
        )
    )
    return rows


def eflesh():
    """Where it is touched, learned from readings to places."""
    folder = ROOT / "data/recordings/eflesh"
    table = pd.read_csv(folder / "contacts.csv")
    u, p = table.filter(like="uT").to_numpy(), table[["x_mm", "y_mm"]].to_numpy()
    n = int(0.8 * len(u))
    model = Learned(u[:n], p[:n], blocks=4, most=1200, lengths=(1, 2, 4, 8), shares=(1e-5, 1e-4, 1e-3, 1e-2))
    error, C = model(u[n:]) - p[n:], model.covariance(u[n:])
    held, size = inside(error, C)
    other = model.covariance(pd.read_csv(folder / "pressed.csv").filter(like="uT").to_numpy())
    return [
        *(("contacts", f"{a}, rms [mm]", x) for a, x in zip("xy", np.sqrt((error**2).mean(0)), strict=True)),
        ("contacts", "90 % ellipses hold [%]", held),
        ("contacts", "longest semi-axis, median [mm]", size),
        ("contacts", "standard deviation of x, median [mm]", np.sqrt(np.median(C[:, 0, 0]))),
        ("another sensor", "standard deviation of x, median [mm]", np.sqrt(np.median(other[:, 0, 0]))),
    ]


def hall_joint():
    """The angle by a model learned from ten poses, with what left-out poses are off as a part of the noise."""
    own = used("hall_joint")
    angle, u = own["cycle"](0)
    ten = own["ten"]
    model = Learned(
        angle[ten, None],
        u[ten].mean(1),
        blocks=10,
        lengths=(0.5, 1, 1.5, 2, 3),
        shares=(1e-8, 1e-6, 1e-4, 1e-2),
    )
    noise = np.diag(u[ten].var(1).mean(0)) + np.median(model.covariance(angle[:, None]), axis=0)
    white = np.linalg.inv(np.linalg.cholesky(noise)).T

    class Whitened:
        def __call__(self, q):
            return self.linearise(q)[0]

        def linearise(self, q):
            value, slope = model.linearise(q)
            return value @ white, np.einsum("...sk,st->...tk", slope, white)

    method, rows = repro.LevenbergMarquardt(Whitened(), [-36.0], [36.0], noise=1.0), []
    for number in (1, 2, 3):
        if not (own["DATA"] / f"R{number}_DC0.csv").is_file():
            continue
        truth, u = own["cycle"](number)
        for name, readings in (("means", u.mean(1)), ("single samples", u[:, ::50].reshape(-1, 3))):
            found: Any = repro.track(method, readings @ white)
            error = found.q[:, 0] - np.repeat(truth, len(readings) // len(truth))
            sd = np.sqrt(found.covariance[:, 0, 0])
            rows.append((f"cycle {number}", f"{name}, rms [deg]", np.sqrt((error**2).mean())))
            rows.append(
                (f"cycle {number}", f"{name}, within 2 sd [%]", 100 * (np.abs(error) < 2 * sd).mean())
            )
            rows.append((f"cycle {number}", f"{name}, sd, median [deg]", np.median(sd)))
            rows.append(
                (
                    f"cycle {number}",
                    f"{name}, rows consistent [%]",
                    100 * (found.status == "consistent").mean(),
                )
            )
    return rows


def imu_chain():
    """The fourth joint with vectors of the links, and with their lengths alone."""
    own = used("imu_chain")  # leaves the last set, mounted loosely: both are judged by their own script
    joints, third = own["joints"], own["third"]
    turns = (Rotation.from_quat(own["links"].reshape(-1, 4)).as_matrix()).reshape(-1, 4, 3, 3)
    rows = []
    for name, along in (("lengths alone", True), ("vectors", False)):
        drawn = [[0, 0, x] for x in (0.15, 0.29, 0.29, 0.27)]
        found = calibrate_links(turns[:third:5], joints[:third:5], drawn, along_only=along)
        error = 1e3 * np.linalg.norm(found(turns) - joints, axis=-1)[third:, 3]
        rows.append(
            (
                f"trial {own['trial']}, {own['mounted']}",
                f"{name}: 4th joint, rms [mm]",
                np.sqrt((error**2).mean()),
            )
        )
    return rows


ROBOTS = {"asl_trunk": asl_trunk, "eflesh": eflesh, "hall_joint": hall_joint, "imu_chain": imu_chain}


def main():
    """Judge the robots that are named, all if none is, and keep the rows of the others."""
    names = sys.argv[1:] or list(ROBOTS)
    rows = [(name, *row) for name in names for row in ROBOTS[name]()]
    table = pd.DataFrame(rows, columns=["robot", "part", "measured", "prototype"])
    if STUDY.is_file():
        old = pd.read_csv(STUDY)
        table = pd.concat([old[~old["robot"].isin(names)], table])
    partial = STUDY.with_suffix(".partial")
    table.to_csv(partial, index=False, float_format="%.4g", lineterminator="\n")
    partial.replace(STUDY)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
