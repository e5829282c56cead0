r"""Actuation of the experiments T0 to T5 (Baaij et al. 2023, section 5.3): torques and chamber pressures.

A torque :math:`(\tau_x, \tau_y)` on the tip bends about the local axes: positive :math:`\tau_y` towards +x, positive
:math:`\tau_x` towards -y. With three chambers of area ``A`` at the radius ``r`` and the azimuths :math:`\varphi_i`,

.. math:: p_i = p_0 + \frac{2}{3 A r}\,(\tau_y \cos\varphi_i - \tau_x \sin\varphi_i) ,

the solution of least norm: the mean pressure, and with it the elongation, stays constant. Each sequence is scaled
so that no pressure leaves the range between zero and the peak of section 5.3, which is twice the offset. Inferred:
the text gives T4's speed in kN m/s; it is read as N m/s. Area, radius and azimuths are not in the text: they are
assumed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

TRAJECTORIES = ("T0", "T1", "T2", "T3", "T4", "T5")
"""Names of the sequences."""
DURATION_S = {"T0": 200.0, "T1": 90.0, "T2": 90.0, "T3": 90.0, "T4": 120.0, "T5": 1500.0}
"""Durations (section 5.3) [s]."""
PERIOD_S = {"T1": 5.0, "T2": 10.0, "T3": 10.0, "T5": 10.0}
"""Periods (section 5.3) [s]."""
SPEED_NM_PER_S = {"T0": 0.025, "T4": 0.0125}
"""Speeds in the plane of torques (section 5.3) [N m/s]."""
AZIMUTH_RATE = 0.0126
"""Turning of the flower T5 (section 5.3) [rad/s]."""
TURNED_DEG = {"T1": 270.0, "T3": 90.0}
"""By how much a sequence is turned, after the names of the recordings (T1_270deg, T3_90deg)."""
PA_PER_MBAR = 100.0


@dataclass(frozen=True)
class Chambers:
    """The three chambers and the pressures commanded.

    Parameters
    ----------
    area_mm2, radius_mm
        Cross-section of a chamber and distance of its centre from the backbone; assumed.
    azimuth_deg
        Azimuth of the first chamber, the others 120 deg apart; assumed.
    offset_mbar, peak_mbar
        Pressure in all chambers before a sequence starts, and highest pressure (section 5.3).
    """

    area_mm2: float = 150.0
    radius_mm: float = 13.0
    azimuth_deg: float = 180.0
    offset_mbar: float = 225.0
    peak_mbar: float = 450.0

    @property
    def lever(self) -> float:
        """Torque per pressure of one chamber [N m/mbar]."""
        return PA_PER_MBAR * self.area_mm2 * 1e-6 * self.radius_mm * 1e-3

    @property
    def reference_nm(self) -> float:
        """Torque towards a chamber at which that chamber is at the peak pressure [N m]."""
        return 1.5 * self.lever * (self.peak_mbar - self.offset_mbar)

    def pressures(self, torque_nm: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Pressures [mbar] for torques ``(tau_x, tau_y)`` [N m]."""
        return self.offset_mbar + 2.0 / (3.0 * self.lever) * torque_nm @ self._levers().T

    def torque(self, pressures_mbar: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Torques ``(tau_x, tau_y)`` [N m] of pressures [mbar]."""
        return self.lever * pressures_mbar @ self._levers()

    def bending_torque(self, pressures_mbar: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Torque of pressures [mbar] over the reference, turned to where it bends: along +x and +y."""
        torque = self.torque(pressures_mbar) / self.reference_nm
        return np.stack([torque[..., 1], -torque[..., 0]], axis=-1)

    def _levers(self) -> np.ndarray:
        azimuth = np.radians(self.azimuth_deg + 120.0 * np.arange(3))
        return np.column_stack([-np.sin(azimuth), np.cos(azimuth)])


def torque_sequence(
    name: str, time_s: Float[np.ndarray, " samples"], chambers: Chambers, *, seed: int
) -> Float[np.ndarray, "samples 2"]:
    r"""Torques ``(tau_x, tau_y)`` [N m] of a sequence, zero before its start and after its end.

    With the phase :math:`\omega t` of the period: T1 is one-sided, :math:`(1 - \cos\omega t)/2` in one direction; T2
    the lobe :math:`(\sin\omega t, |\sin\omega t/2|)`; T3 the lemniscate :math:`(\sin 2\omega t, \sin\omega t)`; T5
    :math:`\sin\omega t` in a direction that turns; T0 straight lines between random points and T4 an Archimedean
    spiral, both at constant speed. T4's spiral starts at zero and its number of turns follows from speed, duration
    and peak; T0's points are uniform in the disc.

    Parameters
    ----------
    name
        One of :data:`TRAJECTORIES`.
    time_s
        Times after the start [s].
    chambers
        For the scale: the highest pressure.
    seed
        Of T0's points.
    """
    duration = DURATION_S[name]
    torque = _shape(name, np.clip(time_s, 0.0, duration), chambers.reference_nm, seed)
    if name not in SPEED_NM_PER_S:  # T0 and T4 have their scale from their speed
        whole = _shape(name, np.arange(0.0, duration, 0.01), chambers.reference_nm, seed)
        # Both ways: a pressure below zero, which the opposite of a high one may be, cannot be commanded.
        rise = float(np.abs(chambers.pressures(whole) - chambers.offset_mbar).max())
        torque = torque * (chambers.peak_mbar - chambers.offset_mbar) / rise
    return np.where(((time_s >= 0) & (time_s <= duration))[:, None], torque, 0.0)


def _shape(name: str, t: np.ndarray, reach: float, seed: int) -> np.ndarray:
    if name in SPEED_NM_PER_S:
        return _waypoints(t, reach, seed) if name == "T0" else _spiral(t, reach)
    phase, turn = 2.0 * np.pi * t / PERIOD_S[name], AZIMUTH_RATE * t
    shapes = {
        "T1": ((1.0 - np.cos(phase)) / 2.0, np.zeros(len(t))),
        "T2": (np.sin(phase), np.abs(np.sin(phase / 2.0))),
        "T3": (np.sin(2.0 * phase), np.sin(phase)),
        "T5": (np.sin(phase) * np.cos(turn), np.sin(phase) * np.sin(turn)),
    }
    turned = np.radians(TURNED_DEG.get(name, 0.0))
    c, s = np.cos(turned), np.sin(turned)
    return np.column_stack(shapes[name]) @ np.array([[c, s], [-s, c]])


def _waypoints(t: np.ndarray, reach: float, seed: int) -> np.ndarray:
    """Straight lines at constant speed, from zero, between points that are uniform in a disc."""
    rng = np.random.default_rng(seed)
    length = SPEED_NM_PER_S["T0"] * DURATION_S["T0"]
    # Lines are 0.9 of the radius long on average: enough for the whole length.
    n = 2 + int(4 * length / reach)
    radius, azimuth = reach * np.sqrt(rng.random(n)), 2.0 * np.pi * rng.random(n)
    points = np.vstack([np.zeros(2), np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth)])])
    arc = np.append(0.0, np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum())
    travelled = SPEED_NM_PER_S["T0"] * t
    return np.column_stack([np.interp(travelled, arc, column) for column in points.T])


def _spiral(t: np.ndarray, reach: float) -> np.ndarray:
    """Archimedean spiral from zero to the radius ``reach``, at constant speed."""

    def arc(angle: np.ndarray | float, end: float) -> np.ndarray | float:
        return reach / (2.0 * end) * (angle * np.sqrt(1.0 + np.square(angle)) + np.arcsinh(angle))

    length = SPEED_NM_PER_S["T4"] * DURATION_S["T4"]
    end = float(brentq(lambda x: arc(x, x) - length, 1e-3, 1e6))
    angles = np.linspace(0.0, end, 20_001)
    angle = np.interp(SPEED_NM_PER_S["T4"] * t, arc(angles, end), angles)
    radius = reach * angle / end
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
