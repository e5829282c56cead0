"""Bad input at the door of the library, as a user meets it: without the check of shapes that other tests have.

Run as a program it prints what was not refused in the one form; `test_refusals.py` expects no line.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

import edition1 as repro
from edition1.estimation.model_error import WithModelError
from edition1.estimation.poses import configurations
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.paper_robots import affine_robot, pcc_robot
from edition1.sensing.weights import read_manifest

ONE = torch.ones(1, dtype=torch.float64)
ROBOT = pcc_robot(1)
BENT = torch.rand(8, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) / 100
MOMENTS = torch.tensor([5.9e-5, -1.5e-9], dtype=torch.float64)
U = repro.LinearisedSensing(ROBOT, MOMENTS)(BENT)
LEAST_SQUARES = repro.LevenbergMarquardt(lambda q: torch.cat([q, q], -1), -ONE, ONE)
KALMAN = repro.IteratedKalmanFilter(lambda q: q, -ONE, ONE, ONE, ONE)
ROD = repro.StrainSeries(0.4, 3)
FOLDER = Path(tempfile.mkdtemp())


def self_calibrating(**changed: Any) -> repro.SelfCalibratingFilter:
    """A filter of the robot, with other options."""
    three = torch.ones(3, dtype=torch.float64)
    options = {"moments": MOMENTS, "wanders": [repro.Wander("gain", 0.1)]} | changed
    return repro.SelfCalibratingFilter(ROBOT, -0.02 * three, 0.02 * three, three, three, **options)


def rod_filter(**changed: Any) -> repro.RodFilter:
    """A filter of the rod, with other options."""
    tip = repro.RodSensor("orientation", (0.1, 0.1, 0.1), arc_m=0.4)
    return repro.RodFilter(
        **{"rod": ROD, "sensors": (tip,), "strain_std": (1.0,) * ROD.n_q, "rate": 1.0} | changed
    )


def stepped(method: Any, start: torch.Tensor, u: torch.Tensor) -> Any:
    """What the first step gives."""
    return method.step(method.init(start), u, 0.0)


def trained(rows: int = 64, dtype: torch.dtype = torch.float32, epochs: int = 1, **changed: Any) -> Any:
    """A short training."""
    xi = torch.rand(rows, 5, generator=torch.Generator().manual_seed(0)).to(dtype)
    u = changed.pop("u", xi.sum(1))
    checkpoint = FOLDER / f"{rows}_{dtype}"
    return repro.train_paper(
        xi, u, seed=0, learning_rate=0.01, checkpoint=checkpoint, epochs=epochs, progress=False
    )


def manifest() -> Any:
    """What is said of weights beside a manifest that is no text."""
    (FOLDER / "w.safetensors").write_bytes(b"")
    (FOLDER / "w.json").write_bytes(b"\xff\xfe")
    return read_manifest(FOLDER / "w.safetensors")


CASES: dict[str, Callable[[], Any]] = {
    "lower of LevenbergMarquardt must be finite": lambda: repro.LevenbergMarquardt(
        lambda q: q, -math.inf * ONE, ONE
    ),
    "lower, upper of LevenbergMarquardt must be ordered": lambda: repro.LevenbergMarquardt(
        lambda q: q, math.nan * ONE, ONE
    ),
    "sensing of an estimator that follows slopes must be one with derivatives": lambda: stepped(
        repro.LevenbergMarquardt(
            repro.compiled(repro.BendSensor(15e-3)), -torch.ones(2).double(), torch.ones(2).double()
        ),
        torch.zeros(2).double(),
        torch.ones(3).double(),
    ),
    "rate_hz of track must be positive": lambda: repro.track(LEAST_SQUARES, U[:, :2], ONE, rate_hz=0.0),
    "mask of track must be one row for each of 8": lambda: repro.track(
        LEAST_SQUARES, U[:, :2], ONE, mask=torch.ones(7, 2, dtype=torch.bool)
    ),
    "estimator of Monitored must be one that knows its noise": lambda: stepped(
        repro.Monitored(repro.GradientDescent(lambda q: q, ONE), LEAST_SQUARES, ONE[None], rate_hz=1.0),
        ONE,
        ONE,
    ),
    "starts of Monitored must be at least one configuration": lambda: repro.Monitored(
        LEAST_SQUARES, LEAST_SQUARES, ONE, rate_hz=1.0
    ),
    "earth_mt of SelfCalibratingFilter must be one vector": lambda: self_calibrating(earth_mt=MOMENTS),
    "earth_mt of SelfCalibratingFilter must be finite": lambda: self_calibrating(
        earth_mt=torch.full((3,), math.nan).double()
    ),
    "moments of SelfCalibratingFilter must be one row, or one for each of 1": lambda: self_calibrating(
        moments=MOMENTS.expand(3, 2)
    ),
    "gain of LinearisedSensing must be finite": lambda: repro.LinearisedSensing(
        ROBOT, MOMENTS, gain=torch.full((3,), math.nan).double()
    ),
    "earth_mt of LinearisedSensing must be a vector": lambda: repro.LinearisedSensing(
        ROBOT, MOMENTS, earth_mt=MOMENTS
    ),
    "robot of imu_arm.toml must be a robot with magnetic sensors": lambda: repro.load_robot(
        "data/robots/imu_arm.toml"
    ).readings(pd.DataFrame({"u1": [1.0]})),
    "positions of field must be of last dimension 3": lambda: repro.Ring(24e-3, 12e-3, 6e-3, 1450.0).field(
        np.zeros((3, 2))
    ),
    "polarisation_mt of Cube must be finite": lambda: repro.Cube(6e-3, math.nan),
    "time_s of Wander must be positive": lambda: repro.Wander.fading("tilt", 0.1, 0.0),
    "t of IteratedKalmanFilter must be not before the last step": lambda: KALMAN.predicted(
        KALMAN.step(KALMAN.init(0 * ONE), ONE, 1.0)[0], 0.0
    ),
    "method of smooth must be a filter that says how its state moves": lambda: repro.smooth(
        self_calibrating(), U, BENT[0], list(range(8))
    ),
    "arcs_m of RodFilter.positions must be places from base to tip": lambda: rod_filter().positions(
        torch.zeros(ROD.n_q).double(), torch.eye(ROD.n_q).double(), (0.4, 0.2)
    ),
    "strain_std of RodFilter must be positive": lambda: rod_filter(strain_std=(math.nan,) * ROD.n_q),
    "std of RodSensor must be positive": lambda: repro.RodSensor("orientation", (0.1, math.nan, 0.1)),
    "magnets.axial of Robot must be between 0 and the length": lambda: repro.Robot(
        ROBOT.segments, magnets=moved(ROBOT.magnets)
    ),
    "q of BendSensor must be of last dimension 2": lambda: repro.BendSensor(15e-3)(BENT),
    "q of ConstantCurvature.pose must be of last dimension 3": lambda: repro.ConstantCurvature(
        0.1, 0.02
    ).pose(ONE[0], ONE),
    "T_base_tip of ConstantCurvature.configuration must be a rigid motion": lambda: repro.ConstantCurvature(
        0.1, 0.02
    ).configuration(torch.diag(torch.tensor([-1.0, 1.0, 1.0, 1.0], dtype=torch.float64))),
    "moments of calibrate must be finite": lambda: calibrated(math.nan * MOMENTS),
    "moments of calibrate must be those that all magnets share": lambda: calibrated(MOMENTS[None]),
    "start of configurations must be near the configuration": lambda: configurations(
        affine_robot(), torch.eye(4).double()[None], position_m=1e-3, rotation_rad=1e-2
    ),
    "error of WithModelError must be a covariance of 2 readings": lambda: stepped(
        WithModelError(LEAST_SQUARES, LEAST_SQUARES.sensing, 1.0, lambda _: torch.eye(3).double()),
        ONE,
        U[0, :2],
    ),
    "manifest of": manifest,
    "xi, u of train_paper must be float32 of shapes [rows, k] and [rows]": lambda: trained(
        u=torch.ones(64, 1)
    ),
    "instead received torch.float64 of shape (64, 5)": lambda: trained(dtype=torch.float64),
    "rows of xi of train_paper must be at least 4": lambda: trained(3),
    "instead received 930": lambda: trained(930),
    "epochs of train_paper must be at least 2": lambda: (trained(epochs=2), trained(epochs=1)),
}
"""By words of the message: what must be refused with it."""


def moved(mounts: Mounts) -> Mounts:
    """The mounts of two by two robots, one of them beyond the end."""
    axial = mounts.axial.expand(2, 2, -1).clone()
    axial[1, 0, 0] = 1.0
    return Mounts(mounts.segment, axial, mounts.local)


def calibrated(moments: torch.Tensor) -> Any:
    """A calibration that starts from other moments."""
    return repro.calibrate(ROBOT, BENT, 1e-12 * torch.eye(3).double(), U, moments, noise_mt=1e-3)


def main() -> int:
    """Print a line for each case that is not refused as it should be."""
    for words, call in CASES.items():
        try:
            call()
            print(f"{words}: accepted")
        except repro.InputError as error:
            if words not in str(error):
                print(f"{words}: {error}")
        except Exception as error:
            print(f"{words}: {type(error).__name__}: {error}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
