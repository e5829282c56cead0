r"""Calibration of a chain of IMUs from a short motion-capture segment, with the tolerances as priors.

The orientation of link :math:`i` in the frame of the motion capture is

.. math:: R_i = R_f\, R_z(\psi_i)\, \hat R_i\, e^{[\mu_i]_\times},

with the measured :math:`\hat R_i`, its heading error :math:`\psi_i` about the world's vertical, its mounting
:math:`\mu_i` (a small turn in the link frame; about x and y only: a turn about the link moves no tangent),
and the rotation :math:`R_f` of the two frames. Points of the arm are at
:math:`p = \hat x(R_0, \ldots, R_N) + p_f`. Parameters :math:`z` in units of their tolerances minimise
:math:`\|z\|^2 + \sum \|p - \hat p\|^2/\sigma^2`; the inverse of the Hessian is their posterior covariance.
Without that scaling metres and radians differ by more than the solver's tolerances allow for, and it stops
early.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from edition1.errors import bad_input, require
from edition1.estimation._quaternions import unit_quaternions
from edition1.estimation.imu_models import ShapeModel
from edition1.estimation.imu_selection import Selection
from edition1.estimation.orientations import exponential, product
from edition1.estimation.undetermined import undetermined

_FRAME = tuple(f"{part}_{axis}" for part in ("rotation", "translation") for axis in "xyz")
_PER_IMU = ("heading", "mounting_x", "mounting_y")


@dataclass(frozen=True)
class ImuTolerances:
    """Prior standard deviations of the parameters, all assumed.

    Parameters
    ----------
    rotation_rad, translation_m
        Of the motion capture's frame against the base of the arm, about and along each axis.
    heading_rad
        Of the heading of each IMU.
    mounting_rad
        Of the mounting of each IMU, about each of the two axes across its link.

    Raises
    ------
    InputError
        If one is not positive.
    """

    rotation_rad: float = math.radians(10.0)
    translation_m: float = 0.05
    heading_rad: float = math.radians(10.0)
    mounting_rad: float = math.radians(5.0)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require(math.isfinite(value) and value > 0, name, "ImuTolerances", "positive", value)


@dataclass(frozen=True)
class ImuCalibration:
    """Frame, headings and mountings that fit a motion-capture segment best, and how well they are known.

    Parameters
    ----------
    names
        Names of the parameters; ``heading_3`` belongs to IMU #3.
    estimate
        Parameters: rotation vector of the frame [rad], translation [m], angles [rad].
    deviation
        Their posterior standard deviations, in the same units.
    covariance
        Posterior covariance in units of the tolerances.
    imus
        IMUs of the selection, and so the order of the orientations that :func:`calibrated` takes.
    rms_m
        Root mean square distance between markers and model after calibration [m].
    samples, dropped
        Marker positions used, and those left out because they were NaN.
    """

    names: tuple[str, ...]
    estimate: Float[np.ndarray, " k"]
    deviation: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    imus: tuple[int, ...]
    rms_m: float
    samples: int
    dropped: int

    @property
    def translation_m(self) -> Float[np.ndarray, " 3"]:
        """Position of the arm's base in the frame of the motion capture [m]."""
        return self.estimate[3:6]

    def undetermined(self, threshold: float = 0.9) -> list[str]:
        """Combinations of parameters that the segment leaves as uncertain as their tolerances, in words.

        Parameters
        ----------
        threshold
            Ratio of posterior to prior standard deviation from which a combination counts.
        """
        return undetermined(self.names, self.covariance, threshold)


def calibrate_imus(
    orientations: Float[np.ndarray, "samples imus 4"],
    markers: Float[np.ndarray, "times points 3"],
    model: ShapeModel,
    selection: Selection,
    *,
    per_imu: bool = True,
    noise_m: float = 0.01,
    tolerances: ImuTolerances | None = None,
) -> ImuCalibration:
    """Fit frame, headings and mountings to marker positions, by nonlinear least squares.

    Six parameters of the frame, and three of each IMU between the base and the last marker: 27 for eight
    IMUs, of which #8 lies beyond M2 and is left as it is. The base is part of the frame.

    Parameters
    ----------
    orientations
        Link orientations of the selected IMUs, unit quaternions XYZW.
    markers
        Positions [m] of the points at ``selection.markers`` at the same times, in the frame of the motion
        capture. NaN where a marker was not seen.
    model
        The model to calibrate for, one of `edition1.estimation.imu_models`: part of its error is absorbed.
    selection
        Its IMUs and links.
    per_imu
        Whether to estimate headings and mountings, or the frame alone.
    noise_m
        Standard deviation of a marker's position against the model along each axis [m]. The error of the
        model counts, and the deviations take samples for independent: readings of neighbouring moments are
        not, so give a larger value, or every k-th sample.
    tolerances
        Standard deviations of the priors.

    Raises
    ------
    InputError
        If orientations and markers do not fit together or are not finite, fewer than two marker positions
        were seen, or the noise is not positive.

    References
    ----------
    Beyond the paper: Martin, Bruder and Wood (2022) calibrate nothing against the motion capture.
    """
    q = unit_quaternions(orientations, "calibrate_imus")
    _one_per_imu(q, selection.imus, "calibrate_imus", "selection")
    points = len(selection.markers)
    if q.ndim != 3 or np.shape(markers) != (len(q), points, 3):
        expected = f"of shape ({len(q)}, {points}, 3), as there are orientations and markers"
        raise bad_input("markers", "calibrate_imus", expected, f"shape {np.shape(markers)}")
    require(noise_m > 0, "noise_m", "calibrate_imus", "positive [m]", noise_m)
    if np.isinf(markers).any():
        raise bad_input("markers", "calibrate_imus", "finite, or NaN where not seen", "infinite positions")
    seen = ~np.isnan(markers).any(axis=-1)
    if seen.sum() < 2:
        raise bad_input("markers", "calibrate_imus", "at least two positions that were seen", int(seen.sum()))
    corrected = [
        imu
        for imu, arc in zip(selection.imus, selection.arcs, strict=True)
        if per_imu and imu > 0 and arc <= max(selection.markers)
    ]
    names = _FRAME + tuple(f"{name}_{imu}" for imu in corrected for name in _PER_IMU)
    scale = _scale(len(corrected), tolerances or ImuTolerances())

    def predicted(z: np.ndarray) -> np.ndarray:
        turned = _turned(q, names, z * scale, selection.imus)
        return (model(turned, selection, selection.markers) + (z * scale)[3:6])[seen]

    def residuals(z: np.ndarray) -> np.ndarray:
        return np.concatenate([((predicted(z) - markers[seen]) / noise_m).ravel(), z])

    z = np.zeros(len(names))
    z[:6] = _frame(predicted(z), markers[seen]) / scale[:6]
    fit = least_squares(residuals, z, x_scale=1.0, ftol=1e-6, xtol=1e-6)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)
    distances = np.linalg.norm(predicted(fit.x) - markers[seen], axis=-1)
    return ImuCalibration(
        names=names,
        estimate=fit.x * scale,
        deviation=np.sqrt(np.diag(covariance)) * scale,
        covariance=covariance,
        imus=selection.imus,
        rms_m=float(np.sqrt((distances**2).mean())),
        samples=int(seen.sum()),
        dropped=int((~seen).sum()),
    )


def calibrated(
    orientations: Float[np.ndarray, "*samples imus 4"], calibration: ImuCalibration
) -> Float[np.ndarray, "*samples imus 4"]:
    """Correct orientations by a calibration: link frames against the frame of the motion capture.

    Positions that a model finds from them, plus ``calibration.translation_m``, are positions in that frame.

    Parameters
    ----------
    orientations
        Unit quaternions XYZW of the IMUs that were calibrated, in the same order.
    calibration
        From :func:`calibrate_imus`.

    Raises
    ------
    InputError
        Another number of IMUs, or quaternions that are not finite or not unit within 1e-3.
    """
    q = unit_quaternions(orientations, "calibrated")
    _one_per_imu(q, calibration.imus, "calibrated", "calibration")
    return _turned(q, calibration.names, calibration.estimate, calibration.imus)


def _one_per_imu(q: np.ndarray, imus: tuple[int, ...], owner: str, what: str) -> None:
    if q.shape[-2] != len(imus):
        raise bad_input(
            "orientations", owner, f"those of the {len(imus)} IMUs of the {what}", f"shape {q.shape}"
        )


def _turned(
    q: np.ndarray, names: tuple[str, ...], parameters: np.ndarray, imus: tuple[int, ...]
) -> np.ndarray:
    """Apply frame, headings and mountings."""
    values = dict(zip(names, parameters, strict=True))
    heading, mounting = np.zeros((len(imus), 3)), np.zeros((len(imus), 3))
    for row, imu in enumerate(imus):
        heading[row, 2] = values.get(f"heading_{imu}", 0.0)
        mounting[row, :2] = values.get(f"mounting_x_{imu}", 0.0), values.get(f"mounting_y_{imu}", 0.0)
    before = product(exponential(parameters[:3]), exponential(heading))
    return product(product(before, q), exponential(mounting))


def _frame(positions: np.ndarray, markers: np.ndarray) -> np.ndarray:
    """Rotation vector and translation that take positions to markers best, without priors: the start."""
    middle, target = positions.mean(axis=0), markers.mean(axis=0)
    matrix = (markers - target).T @ (positions - middle)
    left, _, right = np.linalg.svd(matrix)
    R = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return np.concatenate([Rotation.from_matrix(R).as_rotvec(), target - R @ middle])


def _scale(imus: int, tolerances: ImuTolerances) -> np.ndarray:
    """Tolerances of the parameters in their order."""
    frame = [tolerances.rotation_rad] * 3 + [tolerances.translation_m] * 3
    return np.array(frame + [tolerances.heading_rad, *[tolerances.mounting_rad] * 2] * imus)
