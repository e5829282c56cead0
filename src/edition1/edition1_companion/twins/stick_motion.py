"""When a SYNTHETIC hand moves a soft arm in which of the three modes of Martin et al. (2022), section III-C.

The hand holds a stick, which pulls the point 480 mm from the base, between the two markers. The path of the hand is
assumed: its amplitudes and periods were set so that the speeds and the angles between the IMUs come near the recorded
ones. The code of the path is that of the last commit of the first edition.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from edition1.errors import bad_input

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
        A time before 0; the last mode has no end.

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
