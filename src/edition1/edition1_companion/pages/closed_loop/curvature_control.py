r"""A simple controller of the curvature of the rig: proportional and integral, behind an inverse static map.

With the reference :math:`r`, the bend :math:`\Delta` that is fed back and the error :math:`e = r - \Delta`, all in
the plane :math:`(\Delta_x, \Delta_y)`, the chambers are given the pressures of the torque

.. math:: \tau = F\bigl(\phi\, r + k_p e + k_i \textstyle\int e\, dt\bigr) ,

with the static map :math:`F` from bend to torque, and :math:`\phi = 1` with feed-forward, 0 without. The torque is
scaled back where a pressure would leave its range, so that the mean pressure, and with it the elongation, stays.
Meanwhile the integral does not grow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from edition1_companion.recordings.rig_robot import RIG_RATE_HZ
from edition1_companion.twins.pneumatic_actuation import Chambers
from edition1_companion.twins.rig_map import monomials

INVERSE_DEGREE = 3
"""Degree of the inverse static map."""
NEAR = 0.1
"""Torque over the reference below which a bend counts as at rest."""


@dataclass(frozen=True)
class InverseMap:
    """Torque by bend, as a polynomial.

    Attributes
    ----------
    factors
        Of the monomials: torque over the reference of the chambers, turned to where it bends.
    lower, upper
        Box of the bends that it was fitted to [mm]; a bend outside is moved to its edge.
    rest_mm
        Bend without torque.
    """

    factors: Float[np.ndarray, "terms 2"]
    lower: Float[np.ndarray, " 2"]
    upper: Float[np.ndarray, " 2"]
    rest_mm: Float[np.ndarray, " 2"]

    def __call__(self, bend_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Torque over the reference, at bends [mm]."""
        return monomials(np.clip(bend_mm, self.lower, self.upper), INVERSE_DEGREE) @ self.factors


def fit_inverse(
    chambers: Chambers, pressures_mbar: Float[np.ndarray, "t 3"], bend_mm: Float[np.ndarray, "t 2"]
) -> InverseMap:
    """Fit the inverse static map by least squares to pressures [mbar] and bends [mm] of a slow motion there and back.

    Lag and hysteresis delay the bend on both ways, so that they leave the map in their middle.
    """
    torque = chambers.bending_torque(pressures_mbar)
    factors = np.linalg.lstsq(monomials(bend_mm, INVERSE_DEGREE), torque, rcond=None)[0]
    near = np.linalg.norm(torque, axis=1) < NEAR
    return InverseMap(factors, bend_mm.min(axis=0), bend_mm.max(axis=0), bend_mm[near].mean(axis=0))


@dataclass(frozen=True)
class Gains:
    """Settings of a controller.

    Parameters
    ----------
    proportional, integral_per_s
        Gains of the error and of its integral, millimetres of the map's input by millimetres of the error.
    feed_forward
        Whether the map is also given the reference.
    """

    proportional: float
    integral_per_s: float
    feed_forward: bool


@dataclass(frozen=True)
class ControlState:
    """The controller after a reading: integral terms [mm], and where the pressures were at a bound."""

    integral_mm: Float[np.ndarray, "runs 2"]
    bounded: Bool[np.ndarray, " runs"]


class CurvatureController:
    """Controllers of several runs, one step at a time.

    Parameters
    ----------
    chambers
        Chambers, with the range of their pressures.
    inverse
        Inverse static map.
    gains
        For each run.
    """

    def __init__(self, chambers: Chambers, inverse: InverseMap, gains: Sequence[Gains]) -> None:
        self.chambers, self.inverse = chambers, inverse
        columns = [(g.proportional, g.integral_per_s / RIG_RATE_HZ, float(g.feed_forward)) for g in gains]
        self._proportional, self._integral, self._forward = np.array(columns).T[:, :, None]

    def init(self) -> ControlState:
        """State before the first reading: without torque a controller without feed-forward holds the bend at rest."""
        runs = len(self._forward)
        integral = (1.0 - self._forward) * self.inverse.rest_mm
        return ControlState(integral, np.zeros(runs, dtype=bool))

    def step(
        self,
        state: ControlState,
        reference_mm: Float[np.ndarray, "runs 2"],
        bend_mm: Float[np.ndarray, "runs 2"],
    ) -> tuple[ControlState, Float[np.ndarray, "runs 3"]]:
        """Return the new state, and the pressures [mbar] for a reference and the bend that is fed back [mm]."""
        error, inverse = reference_mm - bend_mm, self.inverse
        integral = state.integral_mm + self._integral * error
        wanted = self._forward * reference_mm + self._proportional * error + integral
        pressures, beyond = self.bounded(inverse(wanted))
        outside = ((wanted < inverse.lower) | (wanted > inverse.upper)).any(axis=1)
        bounded = beyond | outside
        # Anti-windup: at a bound the integral may move back towards rest only.
        outward = error * (wanted - inverse.rest_mm) > 0
        held = np.where(bounded[:, None] & outward, state.integral_mm, integral)
        return ControlState(held, bounded), pressures

    def bounded(
        self, torque: Float[np.ndarray, "runs 2"]
    ) -> tuple[Float[np.ndarray, "runs 3"], Bool[np.ndarray, " runs"]]:
        """Pressures [mbar] for torques over the reference, scaled back into their range, and where they were."""
        chambers = self.chambers
        turned = chambers.reference_nm * np.column_stack([-torque[:, 1], torque[:, 0]])
        change = chambers.pressures(turned) - chambers.offset_mbar
        room = min(chambers.offset_mbar, chambers.peak_mbar - chambers.offset_mbar)
        reach = np.abs(change).max(axis=1, keepdims=True)
        scale = np.minimum(1.0, room / np.maximum(reach, room))
        return chambers.offset_mbar + scale * change, reach[:, 0] > room
