"""Smooth curves whose frames and points are known: what the models of the arm are tested on."""

import numpy as np
from scipy.spatial.transform import Rotation

from edition1.estimation.imu_selection import Selection

LENGTH = 0.64
STEPS = 1280  # of 0.5 mm; each is an arc of constant rate through the rate in its middle: error below 1e-7 m


def smooth_curves(count, *, bend=2.0, seed=0, planar=False):
    """Curves of 640 mm without twist, in parallel frames, from the upright base: the two components of the curvature
    are sums of four cosines along the arc.

    Returns frames (XYZW) and points at STEPS + 1 evenly spread arc lengths, and per curve the largest curvature and
    the largest size of its derivative.
    """
    rng = np.random.default_rng(seed)
    waves = np.pi * np.arange(4)
    amplitudes = rng.normal(size=(count, 2, 4)) * bend / (1 + np.arange(4))
    if planar:
        amplitudes[:, 1] = 0.0
    s = (np.arange(STEPS) + 0.5) / STEPS
    rates = np.einsum("cam,sm->sca", amplitudes, np.cos(waves * s[:, None]))
    slopes = np.einsum("cam,sm->sca", amplitudes, -waves / LENGTH * np.sin(waves * s[:, None]))
    h = LENGTH / STEPS
    frame, frames, points = Rotation.identity(count), [], [np.zeros((count, 3))]
    frames.append(frame.as_quat())
    for rate in rates:
        turn = h * np.column_stack([rate, np.zeros(count)])
        chord = h * np.sinc(np.linalg.norm(turn, axis=1) / (2 * np.pi))
        middle = frame * Rotation.from_rotvec(turn / 2)
        points.append(points[-1] + chord[:, None] * middle.apply([0.0, 0.0, 1.0]))
        frame = frame * Rotation.from_rotvec(turn)
        frames.append(frame.as_quat())
    largest = [1.001 * np.linalg.norm(x, axis=-1).max(axis=0) for x in (rates, slopes)]
    return np.stack(frames, axis=1), np.stack(points, axis=1), *largest


def evenly(imus, sub_links=0, *, middle=False):
    """IMUs at the ends of equal links (in their middles), with the base if links have sub-segments."""
    h = LENGTH / imus
    if sub_links:
        return Selection(
            tuple(range(imus + 1)), tuple(h * i for i in range(imus + 1)), (h,) * imus, sub_links=sub_links
        )
    arcs = tuple(h * (i + (0.5 if middle else 1.0)) for i in range(imus))
    return Selection(tuple(range(1, imus + 1)), arcs, (h,) * imus)


def read(frames, selection):
    """What perfect IMUs of a selection report."""
    return frames[:, [round(arc / LENGTH * STEPS) for arc in selection.arcs]]
