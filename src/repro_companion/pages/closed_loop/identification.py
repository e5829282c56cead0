r"""How the rig follows its commands, from a short experiment that a user can make; the twin's is SYNTHETIC.

With the commanded torque :math:`p` and its first-order lag :math:`\dot s = (p - s)/T`, the bend is

.. math:: x = f(s) + \delta ,

with a static map :math:`f` and a rest :math:`\delta` (hysteresis, and all that the command does not know), taken for
an Ornstein-Uhlenbeck process. Where the direction of :math:`s` turns, at the rate
:math:`\omega = (s_x \dot s_y - s_y \dot s_x)/(|s|^2 + c^2)`, the magnet is not yet where the tip is, and the readings
differ from the map of the bend by

.. math:: \ell = \omega\, A\, (-(x - x_0)_y,\; (x - x_0)_x)^T ,

with three rows of :math:`A` for three sensors. The form is that of the twin: of those that were tried on the second
half of an experiment (bends that turn, rates of the bend with factors polynomial in it), it left the least. Numbers
are fitted. **T5.train alone does not tell** :math:`A`: there the direction turns slowly and always the same way, so
that :math:`\ell` is a function of the bend, which the map takes up (:func:`told_by`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from repro_companion.pages.closed_loop.experiment import Commanded
from repro_companion.twins.rig_map import SCALE_MM, BendMap, correlation_s, monomials

STATIC_DEGREE = 3
"""Degree of the static map from torque to bend, as that of its inverse."""
LAGS_S = tuple(k / 100 for k in range(5, 61))
CENTRES = (0.02, 0.03, 0.05, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4)
"""Candidates for :math:`T` [s] and :math:`c`; the best fit is taken."""
SMALL_MV, LARGE_MV = 1.0, 2.0
"""Readings with a lag below the first tell the error without it, those above the second how it grows with the lag."""


@dataclass(frozen=True)
class Segment:
    r"""How the segment follows its commands, and the readings its bend.

    Attributes
    ----------
    lag_s
        Time constant :math:`T` from command to bend [s].
    static
        Factors of the monomials of :math:`f` [mm].
    rest_mm
        Bend without torque :math:`x_0`.
    apart_mm, apart_s
        Root mean square of :math:`\delta` over both axes, and its correlation time [s].
    centre, across
        :math:`c`, and :math:`A` transposed [mV s/mm].
    error_mv
        Standard deviation, for each sensor, of what map and lag leave beside the white noise.
    share
        Error of :math:`\ell`, as a share of it.
    """

    lag_s: float
    static: Float[np.ndarray, "terms 2"]
    rest_mm: Float[np.ndarray, " 2"]
    apart_mm: float
    apart_s: float
    centre: float
    across: Float[np.ndarray, "2 3"]
    error_mv: Float[np.ndarray, " 3"]
    share: float

    def bend_mm(self, torque: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Bend :math:`f(s)` [mm]."""
        return _powers(torque) @ self.static

    def lag_mv(
        self,
        torque: Float[np.ndarray, "n 2"],
        rate: Float[np.ndarray, "n 2"],
        bend_mm: Float[np.ndarray, "n 2"],
    ) -> Float[np.ndarray, "n 3"]:
        r"""How far the readings are from the map of the bend, :math:`\ell` [mV]; the rate of the torque in 1/s."""
        return _turned(torque, rate, bend_mm - self.rest_mm, self.centre) @ self.across


def identify(
    bend_map: BendMap,
    excited: Commanded,
    training: Commanded | None,
    rest_mm: Float[np.ndarray, " 2"],
) -> Segment:
    """Fit a segment by least squares: lag and static map to both recordings, all else to the excited one.

    Parameters
    ----------
    bend_map
        Readings by bend, from T5.train.
    excited
        The experiment of :func:`record_experiment`.
    training
        T5.train; it counts as much as the other, whatever its length.
    rest_mm
        Bend without torque.
    """
    parts = [excited] if training is None else [excited, training]

    def fit(lag_s: float) -> tuple[float, np.ndarray]:
        kept = [max(len(part.recording) // 5000, 1) for part in parts]
        weights = [(every / len(part.recording)) ** 0.5 for every, part in zip(kept, parts, strict=True)]
        rows = [w * _powers(p.lagged(lag_s)[0][::k]) for p, w, k in zip(parts, weights, kept, strict=True)]
        bends = [w * p.bend_mm[::k] for p, w, k in zip(parts, weights, kept, strict=True)]
        columns, wanted = np.vstack(rows), np.vstack(bends)
        factors = np.linalg.lstsq(columns, wanted, rcond=None)[0]
        return float(((wanted - columns @ factors) ** 2).sum()), factors

    lag_s = min(LAGS_S, key=lambda x: fit(x)[0])
    static = fit(lag_s)[1]
    s, rate = excited.lagged(lag_s)
    apart = excited.bend_mm - _powers(s) @ static
    left = excited.recording.u - bend_map(excited.bend_mm)

    def across(centre: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        turned = _turned(s, rate, excited.bend_mm - rest_mm, centre)
        columns = np.column_stack([turned, np.ones(len(turned))])
        factors = np.linalg.lstsq(columns, left, rcond=None)[0]
        return factors[:2], np.abs(turned @ factors[:2]), left - columns @ factors

    centre = min(CENTRES, key=lambda x: float((across(x)[2] ** 2).sum()))
    factors, lag, after = across(centre)
    small = lag.max(axis=1) < SMALL_MV
    calm = (after[small] ** 2).mean(axis=0)
    large = lag > LARGE_MV
    beyond = (after**2 - calm)[large].sum() / max(float((lag[large] ** 2).sum()), 1e-12)
    return Segment(
        lag_s=lag_s,
        static=static,
        rest_mm=rest_mm,
        apart_mm=float(np.sqrt((apart**2).mean())),
        apart_s=correlation_s(apart),
        centre=centre,
        across=factors,
        error_mv=np.sqrt(np.maximum(calm - bend_map.noise_mv**2, bend_map.error_mv**2)),
        share=float(np.sqrt(max(beyond, 0.0))),
    )


def told_by(bend_map: BendMap, part: Commanded, segment: Segment) -> tuple[float, float]:
    """What a recording tells about the lag in its readings.

    Returns
    -------
    tuple
        Root mean square of the regressors of the lag [mm/s], over frames and both axes; and the share of it (root
        mean square) that no polynomial of the bend, of the degree of the map, takes up.
    """
    turned = _turned(*part.lagged(segment.lag_s), part.bend_mm - segment.rest_mm, segment.centre)
    columns = monomials(part.bend_mm, bend_map.degree)
    own = turned - columns @ np.linalg.lstsq(columns, turned, rcond=None)[0]
    size = float(np.sqrt((turned**2).mean()))
    return size, float(np.sqrt((own**2).mean())) / size


def _powers(torque: np.ndarray) -> np.ndarray:
    """Monomials of torques over the reference: their unit is one, not that of a bend."""
    return monomials(SCALE_MM * torque, STATIC_DEGREE)


def _turned(torque: np.ndarray, rate: np.ndarray, bent_mm: np.ndarray, centre: float) -> np.ndarray:
    """Rate of turning of the torque times the bend turned by a right angle [mm/s]."""
    turning = torque[:, 0] * rate[:, 1] - torque[:, 1] * rate[:, 0]
    turning = turning / ((torque**2).sum(axis=1) + centre**2)
    return turning[:, None] * np.column_stack([-bent_mm[:, 1], bent_mm[:, 0]])
