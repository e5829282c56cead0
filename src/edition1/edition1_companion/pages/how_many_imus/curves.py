"""Curves that an arm can take, known exactly: random ones within limits, and the synthetic arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from edition1.errors import bad_input, require
from edition1.estimation.orientations import exponential, product, tangents
from edition1_companion.twins.soft_arm import SoftArm

STEPS = 1280
"""Steps of a curve."""


@dataclass(frozen=True)
class Curves:
    """Curves of one length, from the upright base.

    Attributes
    ----------
    length_m
        Their length [m].
    frames
        Unit quaternions XYZW at evenly spread arc lengths, without twist along the curve.
    points
        Positions there [m]; tangents are unit vectors, so nothing stretches.
    curvature, slope
        Largest curvature [rad/m] and largest derivative of it [rad/m^2] of each curve.
    """

    length_m: float
    frames: Float[np.ndarray, "curves steps 4"]
    points: Float[np.ndarray, "curves steps 3"]
    curvature: Float[np.ndarray, " curves"]
    slope: Float[np.ndarray, " curves"]


def random_curves(count: int, *, length_m: float, curvature: float, slope: float, seed: int) -> Curves:
    """Smooth curves that use up one of two limits: largest curvature, or largest derivative of it.

    The two components of the curvature are sums of four cosines along the arm, with random amplitudes.

    Parameters
    ----------
    count
        Number of curves.
    length_m
        Their length [m].
    curvature, slope
        The limits [rad/m], [rad/m^2].
    seed
        The same seed gives the same bits.

    Raises
    ------
    InputError
        If a limit, the length or the count is not above zero.
    """
    given = {"count": count, "length_m": length_m, "curvature": curvature, "slope": slope}
    for name, value in given.items():
        require(value > 0, name, "random_curves", "above zero", value)
    waves = np.pi * np.arange(4)
    amplitudes = np.random.default_rng(seed).normal(size=(count, 2, 4)) / (1 + np.arange(4))
    s = (np.arange(STEPS) + 0.5) / STEPS
    rates = np.einsum("cam,sm->csa", amplitudes, np.cos(waves * s[:, None]))
    slopes = np.einsum("cam,sm->csa", amplitudes, -waves / length_m * np.sin(waves * s[:, None]))
    largest, steepest = (np.linalg.norm(x, axis=-1).max(axis=1) for x in (rates, slopes))
    scale = np.minimum(curvature / largest, slope / steepest)
    h = length_m / STEPS
    turns = h * scale[:, None, None] * np.concatenate([rates, np.zeros_like(rates[..., :1])], axis=-1)
    frame, frames, points = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)), [], [np.zeros((count, 3))]
    frames.append(frame)
    for turn in np.moveaxis(turns, 1, 0):
        half = product(frame, exponential(turn / 2))
        chord = h * np.sinc(np.linalg.norm(turn, axis=-1, keepdims=True) / (2 * np.pi))
        points.append(points[-1] + chord * tangents(half))
        frame = product(frame, exponential(turn))
        frames.append(frame)
    return Curves(
        length_m, np.stack(frames, axis=1), np.stack(points, axis=1), scale * largest, scale * steepest
    )


def arm_curves(arm: SoftArm, *, length_m: float = 0.64, count: int = 200) -> Curves:
    """Shapes that the synthetic arm took, evenly spread over its motion.

    Tangents come from splines through the simulated points; the small stretch of the arm is left out.

    Parameters
    ----------
    arm
        The motion.
    length_m
        How much of the arm from the base on [m].
    count
        Number of shapes.

    Raises
    ------
    InputError
        If the arm is shorter, or there are fewer samples.
    """
    if not 0 < length_m <= arm.point_arcs_m[-1]:
        raise bad_input("length_m", "arm_curves", f"above 0 and up to {arm.point_arcs_m[-1]:g} m", length_m)
    require(0 < count <= len(arm.time_s), "count", "arm_curves", f"between 1 and {len(arm.time_s)}", count)
    rows = np.linspace(0, len(arm.time_s) - 1, count).round().astype(int)
    base = np.zeros((count, 1, 3))
    s = np.linspace(0.0, length_m, STEPS + 1)
    knots = np.append(0.0, arm.point_arcs_m)
    upright = np.tile([0.0, 0.0, 1.0], (count, 1))
    last = 3 * arm.positions[rows, -1] - 4 * arm.positions[rows, -2] + arm.positions[rows, -3]
    ends = ((1, upright), (1, last / (2 * (knots[-1] - knots[-2]))))
    spline = CubicSpline(knots, np.concatenate([base, arm.positions[rows]], axis=1), axis=1, bc_type=ends)
    d = spline(s, 1)
    d = d / np.linalg.norm(d, axis=-1, keepdims=True)
    middle = spline((s[1:] + s[:-1]) / 2, 1)
    middle = middle / np.linalg.norm(middle, axis=-1, keepdims=True)
    h = length_m / STEPS
    steps = h * (d[:, :-1] + 4 * middle + d[:, 1:]) / 6  # Simpson's rule
    points = np.concatenate([base, np.cumsum(steps, axis=1)], axis=1)
    frames = frames_along(d[:, 1:])
    bend = np.diff(d, axis=1) / h
    # The derivative of the curvature in a parallel frame is the part of d'' across d.
    second = np.diff(bend, axis=1) / h
    second = second - (second * d[:, 1:-1]).sum(axis=-1, keepdims=True) * d[:, 1:-1]
    curvature, slope = (np.linalg.norm(x, axis=-1).max(axis=1) for x in (bend, second))
    return Curves(length_m, frames, points, curvature, slope)


def frames_along(directions: Float[np.ndarray, "*samples imus 3"]) -> Float[np.ndarray, "*samples frames 4"]:
    """Orientations of an upright base and of IMUs whose z axes are given, without twist from one to the next.

    Positions say where an IMU's z axis points, not how it is turned about it. Each frame is the one before, turned
    by the smallest angle that takes its z axis to the next direction.

    Parameters
    ----------
    directions
        Unit vectors, base to tip.

    Returns
    -------
    Float[np.ndarray, "*samples frames 4"]
        Unit quaternions XYZW, the base first.
    """
    d = np.asarray(directions, dtype=float)
    frames = [np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*d.shape[:-2], 4))]
    for following in np.moveaxis(d, -2, 0):
        before = tangents(frames[-1])
        axis = np.cross(before, following)
        sine = np.linalg.norm(axis, axis=-1, keepdims=True)
        angle = np.arctan2(sine, (before * following).sum(axis=-1, keepdims=True))
        frames.append(product(exponential(axis * angle / np.maximum(sine, 1e-300)), frames[-1]))
    return np.stack(frames, axis=-2)
