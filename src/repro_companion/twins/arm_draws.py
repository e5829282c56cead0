"""Draws of the synthetic trial of Martin et al. (2022): the same motion, other sensors and another frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from repro.errors import bad_input
from repro_companion.twins.arm_recording import MotionCapture, record_soft_arm
from repro_companion.twins.arm_trial import ArmTrial, synchronised
from repro_companion.twins.imu_errors import ImuErrors
from repro_companion.twins.soft_arm import SoftArm

ORIGIN_M = 0.005
"""How well the position of the arm's base is known in the frame of the motion capture, per axis [m]; assumed."""
HEADING_RAD = float(np.radians(2.0))
"""How well the two frames are aligned about the vertical [rad]; assumed."""
CHOSEN_ORIGIN_M = (0.006, -0.014, -0.034)
"""An offset of the origin that was CHOSEN so that medians come near the published figures; never in the scorecard."""


@dataclass(frozen=True)
class Draw:
    """A trial, and the truth behind it that a recording does not tell.

    Attributes
    ----------
    seed
        Of sensors and frame.
    trial
        What an evaluation sees.
    capture
        How the frame of the motion capture was off.
    latency_s
        Age of what the sensors' readings show [s].
    """

    seed: int
    trial: ArmTrial
    capture: MotionCapture
    latency_s: float

    def truth(
        self, arm: SoftArm, arcs_m: Sequence[float] | Float[np.ndarray, " points"], every: int = 1
    ) -> Float[np.ndarray, "samples points 3"]:
        """Where points of the arm were at every n-th sample [m], in the frame of the motion capture; no noise."""
        time_s = self.trial.time_s[::every] - self.latency_s
        c, s = np.cos(self.capture.heading_rad), np.sin(self.capture.heading_rad)
        turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return arm.positions_at(time_s, np.array(arcs_m)) @ turned.T + self.capture.origin_m


def errors_with(angles_deg: Mapping[str, float]) -> ImuErrors:
    """Default errors of the IMUs but for some angles, given in degrees by their names without ``_rad``.

    Raises
    ------
    InputError
        If there is no such angle, or it is negative.

    Examples
    --------
    >>> round(errors_with({"mounting": 180.0}).mounting_rad, 4)
    3.1416
    """
    known = [name.removesuffix("_rad") for name in vars(ImuErrors()) if name.endswith("_rad")]
    for name in angles_deg:
        if name not in known:
            raise bad_input("angles_deg", "errors_with", f"among {', '.join(known)}", name)
    return replace(
        ImuErrors(), **{f"{name}_rad": float(np.radians(value)) for name, value in angles_deg.items()}
    )


def frame_with(origin_mm: float, heading_deg: float) -> dict[str, float]:
    """Arguments ``origin_m`` and ``heading_rad`` of :func:`draw` from millimetres and degrees."""
    return {"origin_m": origin_mm / 1e3, "heading_rad": float(np.radians(heading_deg))}


def draw(
    arm: SoftArm,
    seed: int,
    *,
    errors: ImuErrors | None = None,
    origin_m: float = ORIGIN_M,
    heading_rad: float = HEADING_RAD,
) -> Draw:
    """Record the motion with sensors and a frame of their own, and bring the recording onto one clock.

    Parameters
    ----------
    arm
        How the arm moved.
    seed
        The same seed gives the same bits.
    errors
        Errors of the IMUs; the defaults when not given.
    origin_m, heading_rad
        Standard deviations of the frame of the motion capture: of its origin along each axis [m] and of its turn
        about the vertical [rad].

    Raises
    ------
    InputError
        If the motion is too short, or the two clocks cannot be aligned.
    """
    rng = np.random.default_rng([seed, 2])  # apart from the numbers of IMUs and markers
    x, y, z = origin_m * rng.standard_normal(3)
    capture = MotionCapture(
        origin_m=(float(x), float(y), float(z)), heading_rad=float(heading_rad * rng.standard_normal())
    )
    return drawn(arm, seed, errors or ImuErrors(), capture)


def drawn(arm: SoftArm, seed: int, errors: ImuErrors, capture: MotionCapture) -> Draw:
    """Record the motion as :func:`draw` does, with a given frame."""
    trial = synchronised(record_soft_arm(arm, seed=seed, errors=errors, capture=capture))
    return Draw(seed, trial, capture, errors.latency_s)
