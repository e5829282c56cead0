"""Parameters of the digital twins of the rig: two calibrated ones, and random others; all recordings are SYNTHETIC.

The nominal parameters were set so that the recordings show what is known of the authors' sensors, before any estimator
ran on them. Then they were frozen:
:attr:`edition1_companion.twins.pneumatic_rig.TwinConfig.sha256` tells whether they still are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from edition1_companion.recordings.rig_robot import RIG_SENSORS
from edition1_companion.twins.pneumatic_actuation import TRAJECTORIES, Chambers
from edition1_companion.twins.pneumatic_rig import Differences, TwinConfig
from edition1_companion.twins.rig_files import MarkerCapture
from edition1_companion.twins.rig_motion import MODELS, Bending, InnerShape
from edition1_companion.twins.sensor_board import DRIFTS, Board


def nominal_twin() -> TwinConfig:
    """Return the twin that was calibrated to the facts and then frozen.

    Directions and curvatures of the sensors follow from the slopes, ranges and misfits of the authors' sensors by
    least squares, with a sensitivity of 5000 mV/mT; the Earth field is that of the released code, 0.0493 mT; the
    hystereses follow from the differences between recordings. All else is assumed.
    """
    return TwinConfig(
        chambers=Chambers(),
        bending=Bending(
            neutral_mm=(1.72, -0.1),
            linear_mm=(3.4, 9.17),
            quadratic_mm=(0.8, 0.0),
            cubic_mm=(2.9, 0.0),
            elongation_mm=4.5,
            lag_s=0.2,
            hysteresis_mm=0.3,
            stroke_mm=3.0,
        ),
        inner=InnerShape(hysteresis_mm=0.06, stroke_mm=4.0, across_s=0.11),
        board=Board(
            sensitivity=((-1665.0, -1358.0, 4515.0), (-2461.0, 875.0, 4264.0), (-4111.0, -677.0, 2764.0)),
            shift_mm=((0.4, -0.3, 0.2), (-0.5, 0.2, 0.3), (0.3, 0.5, -0.4)),
            magnet_shift_mm=(0.5, -0.4, 0.6),
            magnet_tilt_deg=(1.5, -1.0),
            earth_mt=0.0493,
            rest_mv=(1032.0, 915.4, 1159.5),
            curvature=((-2.18, -0.55, -0.66), (-0.69, -0.09, 0.5), (-1.04, -0.23, 0.19)),
            ripple_mv=(4.0, 0.95, 2.8),
            ripple_period_mm=9.0,
            ripple_azimuth_deg=(30.0, 80.0, 150.0),
            noise_mv=0.24,
            inflated_noise_mv=0.55,
            drift_mv=0.6,
            drift="ramp",
        ),
        capture=MarkerCapture(
            noise_mm=0.02,
            noise_deg=0.02,
            gaps_per_s=0.02,
            clock_ppm=10.0,
            latest_start_s=2.0,
            ring_offset_mm=(0.8, -0.5),
            base_mm=(120.0, -80.0, 300.0),
        ),
        hysteresis="bouc-wen",
        bias_mv=(-3.7, -3.4, -3.2, -0.2, -3.2, 0.0),
        bias_scatter_mv=0.5,
        gain_scatter=0.04,
    )


def second_twin() -> TwinConfig:
    """Return the twin whose recordings differ in elongation and workspace; frozen before an estimator ran on it.

    From running means and variances of networks that were trained on the authors' recordings follow, by recording,
    the mean elongation, its change with the square of the bend (0.021 to 0.030 mm/mm², of which the middle is taken,
    and -0.038 in T2), and the mean bend along x of T1 (5.1 mm) and T2 (-2.0 mm). Assumed: the middle for T4, too.
    All else is the nominal twin.

    The readings do not follow these elongations. By the drawing they would change by about 50 mV for a millimetre,
    and at the same bend the authors' readings differ by 2 to 7 mV between recordings whose elongations differ by
    0.3 mm and more. Both hold if what motion capture calls elongation (two frames, joined by an arc) is not what the
    sensors feel, and that is the same in all recordings. So it is assumed here.
    """
    differences = Differences(
        shift_mm=(0.0, 5.74, -6.4, 0.0, 0.0, 0.0),
        elongation_mm=(5.32, 5.66, 6.93, 5.13, 5.06, 5.41),
        elongation_per_mm2=(0.025, 0.025, -0.038, 0.025, 0.025, 0.025),
    )
    return replace(nominal_twin(), differences=differences)


def random_twin(seed: int) -> TwinConfig:
    """Another twin, for studies of robustness: the nominal one with other errors and other kinds of errors.

    Random are the places of sensors and magnet (0.5 mm and 1.5 deg on each axis), the directions of the sensors
    (10 deg), the asymmetry, stiffness and lag of the bending, what no field explains, model and size of the
    hysteresis, shape and size (0.3 to 2 mV) of the drift, and the biases of the recordings. The facts do not hold for
    such a twin.

    Parameters
    ----------
    seed
        The same seed gives the same twin.
    """
    rng, twin = np.random.default_rng(seed), nominal_twin()

    def times(values: Any, low: float, high: float) -> Any:
        """Multiply by factors between two bounds, one for each number."""
        return _tuples(np.asarray(np.array(values) * rng.uniform(low, high, np.shape(values))))

    board, bending, inner = twin.board, twin.bending, twin.inner
    turned = Rotation.from_rotvec(np.radians(10.0) * rng.standard_normal((RIG_SENSORS, 3)))
    return replace(
        twin,
        bending=replace(
            bending,
            neutral_mm=_tuples(np.array(bending.neutral_mm) + 0.3 * rng.standard_normal(2)),
            linear_mm=times(bending.linear_mm, 0.9, 1.1),
            lag_s=times(bending.lag_s, 0.7, 1.5),
            hysteresis_mm=times(bending.hysteresis_mm, 0.5, 2.0),
        ),
        inner=replace(
            inner,
            hysteresis_mm=times(inner.hysteresis_mm, 0.5, 2.0),
            stroke_mm=times(inner.stroke_mm, 0.5, 2.0),
            across_s=times(inner.across_s, 0.5, 1.5),
        ),
        board=replace(
            board,
            sensitivity=_tuples(turned.apply(np.array(board.sensitivity))),
            shift_mm=_tuples(0.5 * rng.standard_normal((RIG_SENSORS, 3))),
            magnet_shift_mm=_tuples(0.5 * rng.standard_normal(3)),
            magnet_tilt_deg=_tuples(1.5 * rng.standard_normal(2)),
            curvature=times(board.curvature, 0.5, 1.5),
            ripple_mv=times(board.ripple_mv, 0.5, 1.5),
            ripple_period_mm=float(rng.uniform(7.0, 12.0)),
            ripple_azimuth_deg=_tuples(rng.uniform(0.0, 180.0, RIG_SENSORS)),
            drift_mv=float(rng.uniform(0.3, 2.0)),
            drift=DRIFTS[int(rng.integers(len(DRIFTS)))],
        ),
        hysteresis=MODELS[int(rng.integers(len(MODELS)))],
        bias_mv=(*_tuples(-3.0 + 0.7 * rng.standard_normal(len(TRAJECTORIES) - 1)), 0.0),
    )


def _tuples(values: np.ndarray) -> Any:
    """Numbers of NumPy as nested tuples of Python's: a frozen dataclass of them can be compared and hashed."""
    plain = values.tolist()
    if not isinstance(plain, list):
        return plain
    return tuple(tuple(row) if isinstance(row, list) else row for row in plain)
