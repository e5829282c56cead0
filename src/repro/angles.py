r"""Angles among the coordinates: which of them are free, and how these are wrapped, subtracted and averaged.

A rotation is a single angle :math:`\varphi` (an azimuth, a hinge) or a rotation vector :math:`w`. The same shape has
the coordinates :math:`\varphi + 2\pi k` and :math:`w + 2\pi k\, w/|w|`. Of these we take the one next to a reference:
the middle of the bounds for an estimate, the other configuration for a difference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from repro.common import Array, kernel

_ROUNDING = 1e-9


class FreeAngles:
    """The coordinates that come round again within given bounds; all others are plain numbers.

    A single angle is free if its bounds are a whole turn apart. The components of a rotation vector are free
    together, if the bounds of each reach half a turn to both sides; a component that is fixed at zero is none. An
    angle that is not free stays within its bounds like a length.

    Parameters
    ----------
    rotations
        Indices of the coordinates of every rotation: one for an angle, two or three for a rotation vector.
    low, high
        Bounds of all coordinates ``[n_q]`` [m, rad]; infinite where there are none.

    Examples
    --------
    >>> one = FreeAngles([(0,)], np.array([-np.pi, 0.0]), np.array([np.pi, 1.0]))
    >>> np.degrees(one.difference(np.radians([-170.0, 20.0]), np.radians([170.0, 0.0]))).round(6)
    array([20., 20.])
    """

    def __init__(self, rotations: Sequence[Sequence[int]], low: Array, high: Array) -> None:
        self.free = np.zeros(len(low), dtype=bool)
        """Which coordinates have no bounds, because they come round again ``[n_q]``."""
        self.middle = np.zeros(len(low))
        """What free angles are wrapped to the next of: the middle of the bounds, zero for a rotation vector."""
        self._rotations = []
        for one in rotations:
            moving = [c for c in one if low[c] != 0.0 or high[c] != 0.0]
            if len(moving) == 1 and high[moving[0]] - low[moving[0]] >= 2 * math.pi - _ROUNDING:
                bounded = np.isfinite([low[moving[0]], high[moving[0]]]).all()
                self.middle[moving] = (low[moving] + high[moving]) / 2 if bounded else 0.0
            elif not all(low[c] <= _ROUNDING - math.pi and high[c] >= math.pi - _ROUNDING for c in moving):
                continue
            if moving:
                self._rotations.append(moving)
                self.free[moving] = True
        self._bounds = np.where(self.free, low, -np.inf), np.where(self.free, high, np.inf)
        self._first = np.cumsum([0, *map(len, self._rotations)])
        self._which = np.array([c for one in self._rotations for c in one], dtype=np.int64)

    def __bool__(self) -> bool:
        """Whether any angle is free."""
        return bool(self._rotations)

    def nearest(self, q: Array, reference: Array) -> Array:
        """Return the coordinates ``[..., n_q]`` of the same shapes that are next to those of a reference."""
        if not self:
            return q
        batch, n = np.broadcast_shapes(q.shape, reference.shape), q.shape[-1]
        found = np.array(np.broadcast_to(q, batch)).reshape(-1, n)
        _bring_near(self._first, self._which, found, np.broadcast_to(reference, batch).reshape(-1, n))
        return found.reshape(batch)

    def wrapped(self, q: Array) -> Array:
        """Return the coordinates ``[..., n_q]`` of the same shapes within the bounds."""
        return self.nearest(q, self.middle).clip(*self._bounds) if self else q

    def difference(self, q: Array, reference: Array) -> Array:
        """Return by how much configurations ``[..., n_q]`` differ, free angles by at most half a turn."""
        return self.nearest(q, reference) - reference

    def continuous(self, q: Array) -> Array:
        """Return the same shapes over time ``[t, n_q]``, each next to the last one without NaN: angles go on."""
        found, before = np.array(q), None
        for k in np.flatnonzero(np.isfinite(q).all(-1)) if self else ():
            found[k] = found[k] if before is None else self.nearest(found[k], before)
            before = found[k]
        return found

    def mean(self, q: Array, weights: Array) -> Array:
        """Return means ``[..., n_q]`` of configurations ``[..., n, n_q]``; the weights ``[..., n]`` add up to 1.

        A single angle has its circular mean, and a rotation vector the mean next to the heaviest configuration.
        """
        w = weights[..., None]
        found = (w * q).sum(-2)
        for one in self._rotations:
            if len(one) == 1:
                found[..., one] = np.arctan2(
                    (w * np.sin(q[..., one])).sum(-2), (w * np.cos(q[..., one])).sum(-2)
                )
            else:
                heaviest = weights.argmax(-1)[..., None, None]
                found[..., one] = np.take_along_axis(q[..., one], heaviest, axis=-2)[..., 0, :]
        vectors = [c for one in self._rotations if len(one) > 1 for c in one]
        for _ in range(2 if vectors else 0):
            found[..., vectors] += (w * self.difference(q, found[..., None, :]))[..., vectors].sum(-2)
        return self.wrapped(found)

    def slopes(self, q: Array, moved: Array) -> Array:
        r"""Return how other coordinates of the same shapes move with ``q``, ``[..., n_q, n_q]``.

        With :math:`w' = s w` the slopes are :math:`s I + (1 - s)\, w w^T/|w|^2`; a single angle has 1.
        """
        found = np.broadcast_to(np.eye(q.shape[-1]), (*q.shape, q.shape[-1])).copy()
        for one in self._rotations:
            if len(one) == 1:
                continue
            w, square = q[..., one], np.square(q[..., one]).sum(-1)[..., None, None]
            share = (moved[..., one] * w).sum(-1)[..., None, None] / np.where(square > 0, square, 1.0)
            share = np.where(square > 0, share, 1.0)
            along = w[..., :, None] * w[..., None, :] / np.where(square > 0, square, 1.0)
            found[(..., *np.ix_(one, one))] = share * np.eye(len(one)) + (1 - share) * along
        return found


@kernel(entry=True)
def _bring_near(first, which, q, reference):
    """Add whole turns to the rotations of rows ``q`` until they are next to those of the references, in place."""
    for k in range(len(q)):
        for g in range(len(first) - 1):
            square = along = far = 0.0
            for i in range(first[g], first[g + 1]):
                c = which[i]
                square += q[k, c] * q[k, c]
                along += q[k, c] * reference[k, c]
                far += reference[k, c] * reference[k, c]
            if first[g + 1] - first[g] == 1:
                c = which[first[g]]
                beyond = q[k, c] - reference[k, c] - math.pi
                q[k, c] -= 2.0 * math.pi * math.ceil(beyond / (2.0 * math.pi))
            elif square > 1e-24:
                size = math.sqrt(square)
                turns = math.ceil((size - along / size - math.pi) / (2.0 * math.pi))
                for i in range(first[g], first[g + 1]):
                    q[k, which[i]] *= 1.0 - 2.0 * math.pi * turns / size
            else:  # no turn at all, or whole turns about the axis of the reference
                turns = math.floor(math.sqrt(far) / (2.0 * math.pi) + 0.5)
                for i in range(first[g], first[g + 1]):
                    if turns > 0.0:
                        q[k, which[i]] = 2.0 * math.pi * turns * reference[k, which[i]] / math.sqrt(far)
