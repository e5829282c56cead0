"""Parameters of the digital twins of the rig: two calibrated ones, and random others; all recordings are SYNTHETIC.

The nominal parameters were set so that the recordings show what is known of the authors' sensors, before any estimator
ran on them. Then they were frozen:
:attr:`edition1_companion.twins.pneumatic_rig.TwinConfig.sha256` tells whether they still are.
"""

from __future__ import annotations

from dataclasses import replace

from edition1_companion.twins.pneumatic_actuation import Chambers
from edition1_companion.twins.pneumatic_rig import Differences, TwinConfig
from edition1_companion.twins.rig_files import MarkerCapture
from edition1_companion.twins.rig_motion import Bending, InnerShape
from edition1_companion.twins.sensor_board import Board


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
