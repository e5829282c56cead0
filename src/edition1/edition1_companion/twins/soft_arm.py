"""The SYNTHETIC motion behind the IMU experiments: a Cosserat rod moved by a stick, computed once and kept in a file.

The arm, the place of its IMUs and markers, and the three modes of motion are those of Martin et al. (2022); what the
paper does not say is assumed (see :class:`edition1_companion.twins.cosserat_rod.Rod` and
:mod:`edition1_companion.twins.stick_motion`). Base frame: z up, origin at the clamp.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from edition1.errors import bad_input, require
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from edition1_companion.twins.cosserat_rod import Rod, RodMotion, Stick, simulate_rod
from edition1_companion.twins.imu_errors import continuous_signs
from edition1_companion.twins.stick_motion import (
    DURATION_S,
    LEAD_IN_S,
    SCHEDULE,
    STICK_ARC_M,
    hand_path,
    mode_at,
)

RATE_HZ = 50.0
STEP_S = 2.5e-4
POINT_ARCS_M = np.arange(1, 34) * 0.02
"""Where the file has positions [m]: every 20 mm from the base to the tip, so also at every IMU and marker."""
FRAME_ARCS_M = np.arange(9) * 0.08
"""Where the file has orientations [m]: the base, and the eight IMUs."""
POSITION_QUANTUM_M = 1e-5
QUATERNION_QUANTUM = 2.0**-16


@dataclass(frozen=True)
class SoftArm:
    """How a soft arm moved; synthetic.

    Attributes
    ----------
    time_s
        Times of the samples [s].
    positions
        Positions [m] of the backbone at ``point_arcs_m``, base frame.
    point_arcs_m, frame_arcs_m
        Distances from the base along the undeformed arm [m].
    orientations
        Unit quaternions XYZW at ``frame_arcs_m``, arm to base, z along the arm, of continuous sign in time.
    parameters
        What the arm and its motion were computed with.
    """

    time_s: Float[np.ndarray, " samples"]
    positions: Float[np.ndarray, "samples points 3"]
    point_arcs_m: Float[np.ndarray, " points"]
    orientations: Float[np.ndarray, "samples frames 4"]
    frame_arcs_m: Float[np.ndarray, " frames"]
    parameters: dict[str, Any]

    @property
    def mode(self) -> np.ndarray:
        """Name of the mode of motion at every sample, as text."""
        return mode_at(self.time_s)

    def positions_at(
        self, time_s: Float[np.ndarray, " samples"], arcs_m: Float[np.ndarray, " points"]
    ) -> Float[np.ndarray, "samples points 3"]:
        """Positions [m] at any times, by cubic splines in time, of some of the ``point_arcs_m``.

        Raises
        ------
        InputError
            A time before the first or after the last sample, or an arc length that is none of them.
        """
        columns = [np.flatnonzero(np.isclose(self.point_arcs_m, arc, rtol=0, atol=1e-9)) for arc in arcs_m]
        if missing := [float(arc) for arc, found in zip(arcs_m, columns, strict=True) if len(found) != 1]:
            raise bad_input("arcs_m", "SoftArm", "among point_arcs_m [m]", missing)
        chosen = self.positions[:, np.concatenate(columns)]
        return CubicSpline(self.time_s, chosen)(self._within(time_s))

    def orientations_at(self, time_s: Float[np.ndarray, " samples"]) -> Float[np.ndarray, "samples frames 4"]:
        """Orientations at any times, by cubic splines of the quaternions, made unit again.

        Raises
        ------
        InputError
            A time before the first or after the last sample.
        """
        spline = CubicSpline(self.time_s, self.orientations)(self._within(time_s))
        return spline / np.linalg.norm(spline, axis=-1, keepdims=True)

    def _within(self, time_s: np.ndarray) -> np.ndarray:
        first, last = self.time_s[0], self.time_s[-1]
        if not ((time_s >= first) & (time_s <= last)).all():
            outside = f"{np.min(time_s):g} to {np.max(time_s):g} s"
            raise bad_input("time_s", "SoftArm", f"between {first:g} and {last:g} s", outside)
        return time_s


def simulate_soft_arm(*, duration_s: float = DURATION_S, progress: bool = False) -> SoftArm:
    """Simulate the arm and its stick: about a quarter of a second of computing per second of motion.

    The hand leaves the upright arm some seconds before time 0; that part is left out.

    Parameters
    ----------
    duration_s
        How much of the motion [s].
    progress
        Show a progress bar.

    Raises
    ------
    InputError
        If the duration is not above zero, or longer than the motion.
    """
    if not 0 < duration_s <= DURATION_S:
        raise bad_input("duration_s", "simulate_soft_arm", f"above 0 and up to {DURATION_S:g} s", duration_s)
    rod, stick = Rod(), Stick(lambda time_s: hand_path(time_s - LEAD_IN_S), STICK_ARC_M)
    motion = simulate_rod(
        rod, stick, duration_s=duration_s + LEAD_IN_S, rate_hz=RATE_HZ, dt_s=STEP_S, progress=progress
    )
    parameters = {
        "rod": asdict(rod),
        "stick": {"arc_m": stick.arc_m, "stiffness": stick.stiffness, "damping": stick.damping},
        "step_s": STEP_S,
        "rate_hz": RATE_HZ,
        "schedule": SCHEDULE,
    }
    return sampled(motion, first_s=LEAD_IN_S, parameters=json.loads(json.dumps(parameters)))


def sampled(motion: RodMotion, *, first_s: float, parameters: dict[str, Any]) -> SoftArm:
    """Take the arm's points and frames from a simulated rod, from the time ``first_s`` [s] on."""
    kept = motion.time_s >= first_s - 1e-9
    return SoftArm(
        time_s=motion.time_s[kept] - first_s,
        positions=motion.positions(POINT_ARCS_M)[kept],
        point_arcs_m=POINT_ARCS_M,
        orientations=continuous_signs(motion.orientations(FRAME_ARCS_M)[kept], axis=0),
        frame_arcs_m=FRAME_ARCS_M,
        parameters=parameters,
    )


def write_soft_arm(path: Path, *, progress: bool = True) -> SoftArm:
    """Simulate the whole motion (about a minute) and write it to a file; return it as it was before rounding.

    Positions are rounded to 0.01 mm and quaternion components to 2^-16 (about 0.002 deg), and written as second
    differences in time, which take less room.

    Parameters
    ----------
    path
        The file, ``.npz``; its folder must exist.
    progress
        Show a progress bar.
    """
    arm = simulate_soft_arm(progress=progress)
    save_soft_arm(arm, path)
    return arm


def save_soft_arm(arm: SoftArm, path: Path) -> None:
    """Write an arm's motion to a file, rounded as :func:`write_soft_arm` says."""
    np.savez_compressed(
        path,
        time_s=arm.time_s,
        positions=_packed(arm.positions, POSITION_QUANTUM_M),
        point_arcs_m=arm.point_arcs_m,
        orientations=_packed(arm.orientations, QUATERNION_QUANTUM),
        frame_arcs_m=arm.frame_arcs_m,
        parameters=np.array(json.dumps(arm.parameters)),
    )


def load_soft_arm(path: Path) -> SoftArm:
    """Read what :func:`write_soft_arm` wrote.

    Raises
    ------
    InputError
        If the file is not there, or not such a file.
    """
    require(path.is_file(), "path", "load_soft_arm", "a file that write_soft_arm made", path)
    try:
        # From memory: of a damaged file NumPy leaves the handle open.
        with np.load(BytesIO(path.read_bytes()), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
            orientations = _unpacked(arrays["orientations"], QUATERNION_QUANTUM)
            return SoftArm(
                time_s=arrays["time_s"],
                positions=_unpacked(arrays["positions"], POSITION_QUANTUM_M),
                point_arcs_m=arrays["point_arcs_m"],
                orientations=orientations / np.linalg.norm(orientations, axis=-1, keepdims=True),
                frame_arcs_m=arrays["frame_arcs_m"],
                parameters=json.loads(str(arrays["parameters"])),
            )
    except (
        Exception
    ) as error:  # a damaged file can fail anywhere in the readers, with whatever is raised there
        raise bad_input(
            "file", path.name, "one that write_soft_arm made", f"{type(error).__name__}: {error}"
        ) from error


def _packed(values: np.ndarray, quantum: float) -> np.ndarray:
    """Round to a quantum; second differences in time, with time as the last axis."""
    rounded = np.moveaxis(np.round(values / quantum), 0, -1)
    return np.diff(rounded, n=2, prepend=np.zeros((*rounded.shape[:-1], 2))).astype(np.int32)


def _unpacked(steps: np.ndarray, quantum: float) -> np.ndarray:
    """Undo `_packed`, but for the rounding."""
    rounded = np.cumsum(np.cumsum(steps, axis=-1, dtype=np.int64), axis=-1)
    return np.moveaxis(rounded * quantum, -1, 0).copy()
