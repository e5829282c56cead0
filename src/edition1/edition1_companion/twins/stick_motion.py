"""A SYNTHETIC hand that moves a soft arm with a stick, in the three modes of Martin et al. (2022), section III-C.

The path belongs to the point 480 mm from the base, between the two markers, which the stick pulls towards it. All
amplitudes and periods are assumed; they were set so that the speeds and the angles between the IMUs come near the
recorded ones. Base frame: z up, origin at the clamp.
"""

from __future__ import annotations

import numpy as np
from edition1.errors import bad_input
from jaxtyping import Float

MODES = ("oscillating", "buckling", "circling")
"""Going back and forth over the base with the tip down to below it; contractions along the vertical; circles about
the vertical with the arm in the shape of a question mark."""
STICK_ARC_M = 0.48
"""Where the stick is attached [m]; the paper says between the markers at 360 and 600 mm."""
SCHEDULE = (
    (0.0, "oscillating"),
    (90.0, "buckling"),
    (112.0, "circling"),
    (134.0, "oscillating"),
    (206.0, "buckling"),
    (226.0, "circling"),
)
"""Start [s] and mode of every part of the motion."""
DURATION_S = 250.0
"""Length of the motion [s], that of the paper's trial."""
LEAD_IN_S = 6.0
"""Time before 0 in which the hand joins the motion [s]."""
BLEND_S = 4.0  # around the start of a part, in which one mode passes into the next


def mode_at(time_s: Float[np.ndarray, " samples"]) -> np.ndarray:
    """Return the name of the mode at each time, as text.

    Raises
    ------
    InputError
        A time before 0; the last mode goes on after :data:`DURATION_S`.

    Examples
    --------
    >>> mode_at(np.array([0.0, 100.0, 250.0])).tolist()
    ['oscillating', 'buckling', 'circling']
    """
    time_s = np.asarray(time_s, dtype=float)
    if not (time_s >= 0).all():
        raise bad_input("time_s", "mode_at", "0 or later [s]", time_s.min())
    starts, names = zip(*SCHEDULE, strict=True)
    return np.array(names)[np.searchsorted(starts, time_s, side="right") - 1]


def hand_path(time_s: Float[np.ndarray, " samples"]) -> Float[np.ndarray, "samples 3"]:
    """Position of the hand [m], base frame: smooth, and without random numbers.

    Before time 0 the hand leaves the upright arm, at rest at minus :data:`LEAD_IN_S`, and joins the motion.

    Parameters
    ----------
    time_s
        Times [s]; any number, with the last mode going on after :data:`DURATION_S`.

    Examples
    --------
    >>> hand_path(np.array([-10.0]))
    array([[0.  , 0.  , 0.48]])
    """
    time_s = np.asarray(time_s, dtype=float)
    path = {"oscillating": _oscillating, "buckling": _buckling, "circling": _circling}
    position = np.tile([0.0, 0.0, STICK_ARC_M], (len(time_s), 1))
    joined = ((-LEAD_IN_S, 0.0), *((start - BLEND_S / 2, start + BLEND_S / 2) for start, _ in SCHEDULE[1:]))
    for (begin, end), (_, mode) in zip(joined, SCHEDULE, strict=True):
        share = _smooth_step((time_s - begin) / (end - begin))[:, None]
        position = (1 - share) * position + share * path[mode](time_s)
    return position


def _oscillating(t: np.ndarray) -> np.ndarray:
    """Where an arm of constant curvature would have its 480 mm: bent by an angle that swings through zero."""
    swing = (
        np.radians(155)
        * (1 + _waves(t, (0.08, 31.0)))
        * np.sin(2 * np.pi * t / 14.5 + _waves(t, (0.4, 29.0)))
    )
    azimuth = _waves(t, (0.7, 53.0))
    radius = STICK_ARC_M * np.sin(swing / 2) * np.sinc(swing / 2 / np.pi)
    return _cylindrical(radius, azimuth, STICK_ARC_M * np.sinc(swing / np.pi))


def _buckling(t: np.ndarray) -> np.ndarray:
    height = 0.375 + _waves(t, (0.055, 5.0), (0.02, 3.1))
    return _cylindrical(0.12 + _waves(t, (0.05, 8.0)), _waves(t, (1.5, 17.0)), height)


def _circling(t: np.ndarray) -> np.ndarray:
    azimuth = 2 * np.pi * t / 13 + _waves(t, (0.4, 17.0))
    return _cylindrical(0.30 + _waves(t, (0.03, 13.0)), azimuth, 0.27 + _waves(t, (0.05, 7.7)))


def _waves(t: np.ndarray, *waves: tuple[float, float]) -> np.ndarray:
    """Sum of sinusoids, each given by its amplitude and its period [s]."""
    return np.sum([a * np.sin(2 * np.pi * t / period + k) for k, (a, period) in enumerate(waves)], axis=0)


def _cylindrical(radius: np.ndarray, azimuth: np.ndarray, height: np.ndarray) -> np.ndarray:
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height], axis=-1)


def _smooth_step(x: np.ndarray) -> np.ndarray:
    """From 0 to 1 with continuous velocity and acceleration."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)
