r"""A rod with bodies of a motion capture on it: the frames that show all of them, and how far they sit off it.

A body is a rigid plate. Its axes are taken for those of the backbone at its station; its origin is :math:`o_i` off
the backbone, a constant in these axes. With the rod's pose :math:`T(q, s)` from its base, which is body 0,
body i shows

.. math:: p_i = p(q, s_i) + R(q, s_i)\, o_i, \qquad R_i = R(q, s_i) .
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.estimation.levenberg_marquardt import jacobian
from edition1_companion.recordings.continuum_robot import (
    LENGTH_M,
    STATIONS_M,
    TRUTH,
    Trial,
    poses,
)
from edition1_companion.twins.curvature_series import CurvatureSeries

_ITERATIONS = 50
_SMALLEST = 1e-9  # last step of the offsets [m]


def captured(
    trial: Trial, *, whole: bool = False
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 5 4 4"]]:
    """Times [s] and poses of the five bodies, in the frames that show all five.

    The rows of one frame have the same time stamp in every file, to the last bit; nothing is interpolated.

    Parameters
    ----------
    trial
        Its window is read.
    whole
        Read all of the recording instead.
    """
    if whole:
        trial = Trial(trial.name, trial.folder, None)
    bodies = [trial.readings(name) for name in TRUTH]
    shared = bodies[0].time_s
    for body in bodies[1:]:
        shared = np.intersect1d(shared, body.time_s)
    require(shared.size, "recording", "captured", "at least one frame with all five bodies", trial.name)
    return shared, np.stack([poses(body)[np.isin(body.time_s, shared)] for body in bodies], axis=1)


def stations(
    T_world_body: Float[np.ndarray, "n 5 4 4"], offsets_m: Float[np.ndarray, "4 3"] | None = None
) -> Float[np.ndarray, "n 4 4 4"]:
    """Poses of the backbone at the four stations in the frame of the base; without offsets those of the bodies."""
    T = np.linalg.inv(T_world_body[:, :1]) @ T_world_body[:, 1:]
    if offsets_m is not None:
        T[..., :3, 3] -= np.einsum("nsij,sj->nsi", T[..., :3, :3], offsets_m)
    return T


def body_offsets(
    T_base_body: Float[np.ndarray, "n 4 4 4"], *, position_m: float, angle_rad: float
) -> Float[np.ndarray, "4 3"]:
    """How far the four bodies sit off the backbone [m], with a quadratic curvature for every frame: least squares.

    Parameters
    ----------
    T_base_body
        Frames of a recording, from :func:`stations`.
    position_m, angle_rad
        Standard deviations of a position along each axis and of an orientation about each axis.
    """
    rod, n_stations = CurvatureSeries(LENGTH_M, 3), len(STATIONS_M)
    weight = torch.tensor([1 / (2**0.5 * angle_rad)] * 3 + [1 / position_m], dtype=torch.float64)
    n_q = rod.n_q

    def readings(x: Tensor) -> Tensor:
        T = rod.quarters(x[..., :n_q])
        offset = x[..., n_q:].unflatten(-1, (n_stations, 3, 1))
        return (
            torch.cat([T[..., :3, :3], T[..., :3, :3] @ offset + T[..., :3, 3:]], dim=-1) * weight
        ).flatten(-3)

    u = (torch.as_tensor(T_base_body)[..., :3, :] * weight).flatten(-3)
    q, o = u.new_zeros(len(u), n_q), u.new_zeros(3 * n_stations)
    for _ in range(_ITERATIONS):
        u_hat, J = jacobian(readings, torch.cat([q, o.expand(len(u), -1)], dim=-1))
        r, Jq, Jo = (u - u_hat).unsqueeze(-1), J[..., :n_q], J[..., n_q:]
        # A shape belongs to one frame only: eliminated, it leaves a system of the offsets (Schur complement).
        own, shared = Jq.mT @ Jq, Jq.mT @ Jo
        A = (Jo.mT @ Jo - shared.mT @ torch.linalg.solve(own, shared)).sum(0)
        g = (Jo.mT @ r - shared.mT @ torch.linalg.solve(own, Jq.mT @ r)).sum(0)
        step = torch.linalg.solve(A, g).squeeze(-1)
        o = o + step
        q = q + torch.linalg.solve(own, Jq.mT @ r - shared @ step.unsqueeze(-1)).squeeze(-1)
        if float(step.abs().max()) < _SMALLEST:
            return o.unflatten(-1, (n_stations, 3)).numpy()
    raise bad_input("T_base_body", "body_offsets", "frames with a common solution", "none after 50 steps")


def bend_deg(T_base_station: Float[np.ndarray, "n 4 4 4"]) -> Float[np.ndarray, " n"]:
    """Angle between the backbone at the base and at the tip [deg]."""
    return np.degrees(np.arccos(np.clip(T_base_station[:, -1, 2, 2], -1.0, 1.0)))
