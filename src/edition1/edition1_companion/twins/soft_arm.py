"""The SYNTHETIC motion behind the IMU experiments: a Cosserat rod moved by a stick, kept in a file.

The file was simulated with PyElastica by the code of the last commit of the first edition. The arm, the place of its
IMUs and markers, and the three modes of motion are those of Martin et al. (2022). What the paper does not say is
assumed, and the file holds it as its parameters. Base frame: z up, origin at the clamp.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from edition1.errors import bad_input, require
from edition1_companion.twins.stick_motion import mode_at

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


def load_soft_arm(path: Path) -> SoftArm:
    """Read a motion from a file.

    Positions are in 0.01 mm and quaternion components in 2^-16, as second differences in time.

    Raises
    ------
    InputError
        If the file is not there, or not such a file.
    """
    require(path.is_file(), "path", "load_soft_arm", "a file of a motion", path)
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
        raise bad_input("file", path.name, "one of a motion", f"{type(error).__name__}: {error}") from error


def _unpacked(steps: np.ndarray, quantum: float) -> np.ndarray:
    """Values from second differences in time, whose last axis is time, in units of a quantum."""
    rounded = np.cumsum(np.cumsum(steps, axis=-1, dtype=np.int64), axis=-1)
    return np.moveaxis(rounded * quantum, -1, 0).copy()
