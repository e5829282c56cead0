"""Exchanged markers in a motion capture of a rigid body: found by the jumps that they cause, and undone.

Markers that lie nearly symmetrically are now and then taken for each other. The body is then seen turned by one and
the same half turn in its own axes, from one frame to the next, and back again from one frame to the next: with the
true orientation T, the orientation seen is T H. No body moves like that: half a turn within a frame at 120 Hz is
21,600 deg/s. H is known from the jumps themselves, as the mean of what each of them turned by.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

JUMP_DEG = 90.0
"""Turn between consecutive frames that no body makes [deg]."""
LEAST_HALF_TURN_DEG = 170.0
"""Least turn of a jump that counts as an exchange of markers [deg]."""
SAME_TURN_DEG = 15.0
"""Jumps within this of each other are one exchange [deg]; those of different markers are 125 deg apart."""
LARGEST_REST_DEG = 5.0
"""Largest turn that may be left at an end of a stretch whose exchange was undone [deg]."""


def not_turned(
    quaternions: Float[np.ndarray, "frames 4"], tracked: Bool[np.ndarray, " frames"]
) -> Bool[np.ndarray, " frames"]:
    """Return which tracked frames are within `JUMP_DEG` of the last such frame before them; the first tracked is."""
    kept = np.zeros(len(quaternions), dtype=bool)
    last = quaternions[int(np.argmax(tracked))]
    for k in np.flatnonzero(tracked):
        if abs(quaternions[k] @ last) > np.cos(np.radians(JUMP_DEG / 2)):  # q and -q are one rotation
            kept[k], last = True, quaternions[k]
    return kept


def undo_exchanges(
    quaternions: Float[np.ndarray, "frames 4"],
    tracked: Bool[np.ndarray, " frames"],
    kept: Bool[np.ndarray, " frames"],
) -> tuple[Float[np.ndarray, "frames 4"], Bool[np.ndarray, " frames"], int]:
    """Turn back the frames in which markers are exchanged.

    A stretch of turned frames is turned back as a whole, by the half turn that joins it to the frame before or behind
    within `LARGEST_REST_DEG`. A stretch that is entered and left while the body is lost, one that no half turn
    joins, and a half turn that was seen only once, so that nothing says that it is constant, stay as they are.

    Parameters
    ----------
    quaternions
        Body to world, XYZW, unit where tracked.
    tracked
        Frames in which the body was seen.
    kept
        Of :func:`not_turned`.

    Returns
    -------
    quaternions, frames, turns
        Orientations as if no marker had been exchanged in ``frames``, else as they came; which frames were turned
        back; and how many half turns were found.
    """
    off = tracked & ~kept
    seen = Rotation.from_quat(np.where(tracked[:, None], quaternions, [0.0, 0.0, 0.0, 1.0]))
    turns = _half_turns(seen, kept, off)
    found, undone = seen.as_quat(), np.zeros(len(off), dtype=bool)
    for start, end in _stretches(seen, off):
        best = LARGEST_REST_DEG, found[start:end]
        for turn in turns:
            back = seen[start:end] * turn.inv()
            for inner, outer in ((0, start - 1), (-1, end)):
                if 0 <= outer < len(off) and (kept | undone)[outer]:
                    rest = np.degrees((Rotation.from_quat(found[outer]).inv() * back[inner]).magnitude())
                    if rest < best[0]:
                        best, undone[start:end] = (rest, back.as_quat()), True
        found[start:end] = best[1]
    return np.where(undone[:, None], found, quaternions), undone, len(turns)


def _half_turns(seen: Rotation, kept: np.ndarray, off: np.ndarray) -> list[Rotation]:
    """Return the mean of each group of equal half turns that frames are entered or left with, two jumps or more."""
    k = np.flatnonzero((kept[:-1] & off[1:]) | (off[:-1] & kept[1:]))
    if not k.size:
        return []
    upright, turned = np.where(kept[k], k, k + 1), np.where(kept[k], k + 1, k)
    # Where the body would have been at the turned frame: moved on as from the frame before to the upright one.
    before = np.clip(2 * upright - turned, 0, len(off) - 1)
    before = np.where(kept[before], before, upright)
    jumps = (seen[upright] * seen[before].inv() * seen[upright]).inv() * seen[turned]
    groups: list[list[int]] = []
    for j in np.flatnonzero(np.degrees(jumps.magnitude()) >= LEAST_HALF_TURN_DEG):
        for group in groups:
            if np.degrees((jumps[group].mean().inv() * jumps[int(j)]).magnitude()) < SAME_TURN_DEG:
                group.append(int(j))
                break
        else:
            groups.append([int(j)])
    return [jumps[group].mean() for group in groups if len(group) > 1]


def _stretches(seen: Rotation, off: np.ndarray) -> list[tuple[int, int]]:
    """Return first frame and end of each stretch of turned frames in which no frame jumps against the one before."""
    steps = np.degrees((seen[:-1].inv() * seen[1:]).magnitude())
    begins = off & ~(np.r_[False, off[:-1]] & np.r_[True, steps < JUMP_DEG])
    edges = np.flatnonzero(begins | (np.r_[False, off[:-1]] & ~off))
    ends = np.append(edges, len(off))[1:]
    return [(int(start), int(end)) for start, end in zip(edges, ends, strict=True) if begins[start]]
