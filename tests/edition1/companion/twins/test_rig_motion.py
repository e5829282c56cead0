"""Motion of the rig's segment: lag in closed form, and hysteresis that vanishes where it must."""

from dataclasses import replace

import numpy as np
import pytest

from edition1_companion.twins.pneumatic_actuation import Chambers
from edition1_companion.twins.rig_motion import Bending, InnerShape, rig_motion

CHAMBERS = Chambers()
LINEAR = Bending((0.0, 0.0), (8.0, 8.0), (0.0, 0.0), (0.0, 0.0), 4.5, 0.2, 0.0, 3.0)
SAME = InnerShape(0.0, 4.0, 0.0)
TIME_S = np.arange(0, 40, 0.01)


def pressures(torque_x: np.ndarray, torque_y: np.ndarray) -> np.ndarray:
    return CHAMBERS.pressures(CHAMBERS.reference_nm * np.column_stack([torque_x, torque_y]))


def test_inflation_is_a_first_order_response():
    motion = rig_motion(TIME_S, np.full((len(TIME_S), 3), 225.0), CHAMBERS, LINEAR, SAME)
    expected = 4.5e-3 * (1 - np.exp(-(TIME_S + 0.01) / 0.2))  # the first sample is already a step of it
    np.testing.assert_allclose(motion.q[:, 2], expected, atol=1e-12)
    assert np.abs(motion.q[:, :2]).max() < 1e-12


def test_torque_bends_where_it_points():
    one = np.ones(len(TIME_S))
    towards_x = rig_motion(TIME_S, pressures(0 * one, 0.5 * one), CHAMBERS, LINEAR, SAME).q[-1]
    np.testing.assert_allclose(towards_x[:2], [4e-3, 0], atol=1e-12)
    towards_minus_y = rig_motion(TIME_S, pressures(0.5 * one, 0 * one), CHAMBERS, LINEAR, SAME).q[-1]
    np.testing.assert_allclose(towards_minus_y[:2], [0, -4e-3], atol=1e-12)


def test_lag_encloses_the_area_of_a_first_order_low_pass():
    # Driven by sin(wt), the bend A/sqrt(1 + (w T)^2) sin(wt - phase) encloses pi A w T/(1 + (w T)^2).
    omega = 2 * np.pi / 10
    drive = np.sin(omega * TIME_S)
    motion = rig_motion(TIME_S, pressures(0 * drive, drive), CHAMBERS, LINEAR, SAME)
    x, y = drive[-1000:], 1e3 * motion.q[-1000:, 0]
    area = abs(np.sum((np.roll(y, -1) + y) / 2 * (np.roll(x, -1) - x)))
    wt = omega * 0.2
    assert area == pytest.approx(np.pi * 8.0 * wt / (1 + wt**2), rel=0.05)


@pytest.mark.parametrize("model", ["bouc-wen", "prandtl-ishlinskii"])
def test_without_hysteresis_slow_loops_are_closed_and_with_it_they_are_not(model):
    drive = np.sin(2 * np.pi * TIME_S / 20)
    quick = replace(LINEAR, lag_s=1e-4)
    for amplitude in (0.0, 0.5):
        bending = replace(quick, hysteresis_mm=amplitude, stroke_mm=0.5)
        q = (
            1e3
            * rig_motion(TIME_S, pressures(0 * drive, drive), CHAMBERS, bending, SAME, model=model).q[:, 0]
        )
        up, down = q[2000], q[3000]  # both at zero torque, on the way up and down
        assert down - up == pytest.approx(2 * amplitude, abs=0.01)


def test_magnet_and_tip_agree_without_inner_hysteresis_and_rate():
    drive = np.sin(2 * np.pi * TIME_S / 10)
    motion = rig_motion(TIME_S, pressures(np.cos(TIME_S), drive), CHAMBERS, LINEAR, SAME)
    np.testing.assert_array_equal(motion.q, motion.q_magnet)


def test_magnet_lags_only_where_the_direction_of_bending_turns():
    across = InnerShape(0.0, 4.0, 0.1)
    radial = np.sin(2 * np.pi * TIME_S / 10)
    planar = rig_motion(TIME_S, pressures(0 * radial, radial), CHAMBERS, LINEAR, across)
    np.testing.assert_allclose(planar.q, planar.q_magnet, atol=1e-12)
    for omega in (0.3, 0.6):  # on a circle of bend r the magnet is r w T behind
        circle = rig_motion(
            TIME_S, pressures(-np.sin(omega * TIME_S), np.cos(omega * TIME_S)), CHAMBERS, LINEAR, across
        )
        behind = np.linalg.norm((circle.q - circle.q_magnet)[2000:3500], axis=1)
        radius = np.linalg.norm(circle.q[2000:3500, :2], axis=1)
        np.testing.assert_allclose(behind / radius, 0.1 * omega, rtol=0.02)
