"""3-D view of the synthetic trial of Martin et al. 2022: the arm and its markers, and an estimate with its errors."""

from __future__ import annotations

import numpy as np
import torch

from edition1.errors import bad_input
from edition1.estimation.imu_models import chain
from edition1.estimation.imu_shape import ImuShape
from edition1.estimation.orientations import tangents
from edition1_companion.book.views_arm import RADIUS_M, inclinations
from edition1_companion.book.views_frames import every_nth
from edition1_companion.recordings.martin2022_models import IMU_ARCS, MARKERS, selection
from edition1_companion.twins.arm_markers import MARKER_NAMES, distances_mm
from edition1_companion.twins.arm_trial import Draw
from edition1_companion.twins.imu_errors import ImuErrors
from edition1_companion.twins.soft_arm import SoftArm
from edition1_live.view.shape_view import Markers, Shape, ShapeView, Traces

LEAST_RAD = 1e-9  # the estimator asks for some error, also of perfect IMUs
MODES_S = (84.0, 134.0)
"""A part of the synthetic trial that has all three modes of motion [s]."""


def trial_view(
    arm: SoftArm,
    one: Draw,
    errors: ImuErrors,
    *,
    origin_m: float = 0.0,
    heading_rad: float = 0.0,
    between_s: tuple[float, float] = MODES_S,
    frames: int = 200,
) -> ShapeView:
    r"""Synthetic arm, its markers, and the PCC-extended model (eight IMUs, 16 segments) with what it may be off.

    The covariance along the arm is that of :class:`~edition1.estimation.imu_shape.ImuShape`, by linear propagation of
    independent errors of the IMUs, the same about every axis: the root mean square of those assumed. That of the
    frame of the motion capture is added to it: :math:`\sigma_o^2 I + \sigma_h^2 (e_z \times x)(e_z \times x)^T`. The
    error of the model between IMUs is not part of it.

    Parameters
    ----------
    arm, one
        The motion, and a trial made from it.
    errors, origin_m, heading_rad
        Assumed errors of the IMUs, and standard deviations of the frame [m, rad]: those the trial was drawn with.
    between_s
        First and last time that are shown [s].
    frames
        Most frames of the view.

    Raises
    ------
    InputError
        If the trial has no sample between these times.
    """
    trial, made, arcs = one.trial, selection("pcc", 8), np.arange(len(IMU_ARCS) * 2 - 1) * 0.04
    inside = np.flatnonzero((trial.time_s >= between_s[0]) & (trial.time_s <= between_s[1]))
    if not len(inside):
        expected = f"such that samples from {trial.time_s[0]:.4g} to {trial.time_s[-1]:.4g} s lie between"
        raise bad_input("between_s", "trial_view", expected, between_s)
    shown = inside[every_nth(len(inside), frames)]
    times, q = trial.time_s[shown], trial.orientations[shown]
    base = np.broadcast_to(one.capture.origin_m, (len(shown), 1, 3))
    truth = np.concatenate([base, one.truth(arm, arcs[1:])[shown]], axis=1)
    estimate, covariance = _estimate(ImuShape(chain, made, tuple(arcs), _rms_rad(errors)), made.of(q))
    turned = np.cross([0.0, 0.0, 1.0], estimate)
    covariance += origin_m**2 * np.eye(3) + heading_rad**2 * turned[..., :, None] * turned[..., None, :]
    deviation = np.sqrt(np.linalg.eigvalsh(covariance)[..., -1].clip(min=0))
    error = np.linalg.norm(estimate - truth, axis=-1)
    held = (error < 2 * deviation).mean()
    label = (
        f"Synthetic arm with two markers, and the PCC-extended model with eight IMUs. {len(times)} frames from "
        f"{times[0]:.4g} to {times[-1]:.4g} s: {', '.join(dict.fromkeys(trial.mode[shown].tolist()))}. At "
        f"{1e3 * arcs[-1]:.0f} mm from the base the estimate is {1e3 * np.median(error[:, -1]):.0f} mm off in the "
        f"median, {1e3 * error[:, -1].max():.0f} mm at most; {100 * held:.0f} % of the true points lie within two "
        "standard deviations."
    )
    markers, at = trial.points[shown, : len(MARKERS)], [round(arc / 0.04) for arc in MARKERS]
    along = truth[:, [k + 1 for k in at]] - truth[:, [k - 1 for k in at]]
    up = tangents(q[:, 1:])
    off = distances_mm(trial, made)[shown]
    heights = chain(made.of(q), made, MARKERS)[..., 2]
    return ShapeView(
        label=label,
        time_s=times,
        shapes=(Shape("truth", truth), Shape("PCC-extended", estimate, deviation, role="estimate")),
        radius_m=RADIUS_M,
        magnets=Markers(markers, along / np.linalg.norm(along, axis=-1, keepdims=True), "markers"),
        sensors=Markers(estimate[:, 2::2], up, "IMUs"),
        traces=(
            Traces("height of the markers", "mm", _named(1e3 * markers[..., 2]), _named(1e3 * heights)),
            Traces("distance of the estimate from the markers", "mm", _named(off)),
            Traces("inclination of the IMUs", "deg", inclinations(up, first=1)),
        ),
    )


def _estimate(method: ImuShape, orientations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and their covariances, ``[t, points, 3]`` and ``[t, points, 3, 3]``."""
    k = len(method.arc_lengths)
    start = torch.zeros(3 * k, dtype=torch.float64)
    found = method.step(method.init(start), torch.from_numpy(orientations).flatten(-2), 0.0)[1]
    assert found.covariance is not None  # ImuShape has one
    blocks = found.covariance.unflatten(-1, (k, 3)).unflatten(-3, (k, 3)).diagonal(dim1=-4, dim2=-2)
    return found.q.unflatten(-1, (k, 3)).numpy(), blocks.movedim(-1, -3).numpy().copy()


def _rms_rad(errors: ImuErrors) -> float:
    """Root mean square over the three axes: the heading errs about the vertical, tilt about the other two."""
    every = errors.mounting_rad**2
    vertical = errors.heading_offset_rad**2 + errors.heading_wander_rad**2
    across = errors.tilt_static_rad**2 + errors.tilt_dynamic_rad**2
    return float(np.sqrt(every + (vertical + 2 * across) / 3)) or LEAST_RAD


def _named(values: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(MARKER_NAMES, values.T, strict=True))
