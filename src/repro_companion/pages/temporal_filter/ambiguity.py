"""Readings that several configurations explain: what a search from many starts reports."""

from __future__ import annotations

import math

import pandas as pd
import torch

from repro.estimation.levenberg_marquardt import LevenbergMarquardt
from repro.estimation.multistart import search, starts_within
from repro.kernels import compiled
from repro.kinematics.paper_robots import affine_robot, pcc_robot
from repro.kinematics.trajectories import flower, lemniscate
from repro.sensing.linearised import LinearisedSensing
from repro.sensing.magnetic import readings
from repro.sensing.magnets import ring
from repro_companion.twins.calibrated_robots import box
from repro_companion.twins.calibration_session import L_MAX

STARTS = 40


def ambiguities(noise_mt: float = 7.1e-4, *, seed: int = 0) -> pd.DataFrame:
    """Minima that the readings do not exclude, found by a search from many starts, for three robots.

    The affine segment has an exact ambiguity: both curvatures negated and the azimuth turned by half a turn are the
    same shape. Two sensors per segment do not tell a robot from its mirror image in their plane. Columns: ``robot,
    minima, furthest_mm`` (largest distance between the tips of two of them).

    Parameters
    ----------
    noise_mt
        Noise of a reading.
    seed
        Of noise and starts.
    """
    generator, lines = torch.Generator().manual_seed(seed), []
    moments = torch.from_numpy(ring("released").multipoles(L_MAX))
    half_turn = torch.tensor([1.2, 4.5, math.pi, 6.6e-3], dtype=torch.float64)
    affine = (torch.tensor([-1.2, -4.5, -math.pi, 0.0], dtype=torch.float64), half_turn)
    cases = (
        ("three sensors, constant curvature", pcc_robot(1), box(1), lemniscate(1)[40]),
        ("two sensors, constant curvature", pcc_robot(1, 2), box(1), lemniscate(1)[40]),
        ("nine sensors, affine curvature", affine_robot(), affine, flower()[40]),
    )
    for name, robot, (low, high), q in cases:
        u = readings(robot, q, ring("released"))
        u = u + noise_mt * torch.randn(u.shape, generator=generator, dtype=u.dtype)
        sensing = LinearisedSensing(robot, moments)
        method = LevenbergMarquardt(compiled(sensing), low, high, noise_mt=noise_mt, iterations=50)
        found = search(method, u, starts_within(low, high, STARTS, seed=seed))
        tips = 1e3 * robot.tip(found.q[found.candidate])[:, :3, 3]
        line = {
            "robot": name,
            "minima": int(found.count),
            "furthest_mm": float(torch.cdist(tips, tips).max()),
        }
        lines.append(line)
    return pd.DataFrame(lines)
