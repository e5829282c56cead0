"""A SYNTHETIC hand that moves a soft arm with a stick, in the three modes of Martin et al. (2022), section III-C.

The path belongs to the point 480 mm from the base, between the two markers, which the stick pulls towards it. All
amplitudes and periods are assumed; they were set so that the speeds and the angles between the IMUs come near the
recorded ones. Base frame: z up, origin at the clamp.
"""

from __future__ import annotations

import numpy as np
from edition1.errors import bad_input
from jaxtyping import Float

SCHEDULE = (
    (0.0, "oscillating"),
    (90.0, "buckling"),
    (112.0, "circling"),
    (134.0, "oscillating"),
    (206.0, "buckling"),
    (226.0, "circling"),
)
"""Start [s] and mode of every part of the motion."""


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
