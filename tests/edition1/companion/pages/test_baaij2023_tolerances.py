"""Robots that are not as drawn: derivatives of the estimate, first order for small errors, laws, interpolation."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1.sensing.placement import Tolerances, parameter_names
from edition1_companion.pages.noise_and_tolerances.tolerances import (
    KINDS,
    allowed,
    placed_readings,
    sensitivity,
    tolerance_errors,
    tolerance_means,
)

MOMENTS = torch.tensor(ring("released").multipoles(9))


def interior(n_segments, count=3):
    generator = torch.Generator().manual_seed(0)
    unit = torch.rand(count, 3 * n_segments, dtype=torch.float64, generator=generator)
    return torch.tensor([0.02, 0.02, 0.004] * n_segments) * (
        unit - torch.tensor([0.5, 0.5, -0.5] * n_segments)
    )


@pytest.mark.parametrize("n_segments", [1, 2])
def test_derivative_of_the_estimate_is_its_difference(n_segments):
    """Every parameter moved a little in magpylib; the estimate by least squares without bounds in reach."""
    robot, q = pcc_robot(n_segments), interior(n_segments)
    S = sensitivity(robot, q, MOMENTS)
    names = parameter_names(robot, len(MOMENTS))
    assert S.shape == (3, 3 * n_segments, len(names))
    step = 1e-2 * Tolerances().of_parameters(robot, len(MOMENTS))
    wide = torch.full((3 * n_segments,), 0.05, dtype=torch.float64)
    method = LevenbergMarquardt(LinearisedSensing(robot, MOMENTS), -wide, wide)
    u = placed_readings(robot, torch.stack([torch.diag(step), -torch.diag(step)]), q, ring("released"))
    state = method.init(q[:, None, None].expand(-1, *u.shape[1:-1], -1))
    found = method.step(state, u, 0.0)[1].q
    difference = ((found[:, 0] - found[:, 1]) / (2 * step.unsqueeze(-1))).transpose(1, 2)
    scaled, expected = difference * step, S * step
    torch.testing.assert_close(scaled, expected, atol=2e-3 * float(expected.abs().max()), rtol=2e-3)


def test_gain_of_all_sensors_cannot_be_told_from_the_moments():
    robot = pcc_robot(1)
    S = sensitivity(robot, interior(1), MOMENTS)
    names = parameter_names(robot, len(MOMENTS))
    gain = S[..., [k for k, name in enumerate(names) if name.endswith("gain")]].sum(-1)
    moments = S[..., [k for k, name in enumerate(names) if name.startswith("moment")]].sum(-1)
    torch.testing.assert_close(gain, moments, rtol=1e-9, atol=0)


def test_all_moments_alike_are_another_polarisation():
    """The series that is added for changed moments, against magpylib with a stronger magnet."""
    robot, q, magnet = pcc_robot(2), interior(2), ring("released")
    names = parameter_names(robot, len(MOMENTS))
    parameters = torch.tensor([0.1 * name.startswith("moment") for name in names], dtype=torch.float64)
    stronger = replace(magnet, polarisation_mt=1.1 * magnet.polarisation_mt)
    torch.testing.assert_close(
        placed_readings(robot, parameters, q, magnet), readings(robot, q, stronger), atol=1e-6, rtol=0
    )


@pytest.mark.parametrize("n_segments", [1, 3])
def test_no_error_and_small_errors(n_segments):
    """A robot as drawn has the error of the series alone; a little off it, first order is right."""
    table = tolerance_errors(n_segments, factors=[0.0, 0.005], draws=1, steps=24)
    as_drawn = table[table["factor"] == 0]
    assert as_drawn["linear_percent"].max() == 0
    assert as_drawn["error_percent"].max() < 1e-4
    off = table[table["factor"] > 0]
    assert off["error_percent"].min() > 1e-3
    np.testing.assert_allclose(off["error_percent"], off["linear_percent"], rtol=0.03)


def test_first_order_is_proportional_and_draws_do_not_depend_on_their_number():
    kinds = ["magnet_tilt_rad", "sensor_gain"]
    two = tolerance_errors(1, kinds, [0.5, 1.0], draws=2, steps=8)
    one = tolerance_errors(1, kinds, [1.0], draws=1, steps=8)
    half, whole = (two[two["factor"] == x]["linear_percent"].to_numpy() for x in (0.5, 1.0))
    assert whole == pytest.approx(2 * half)
    again = two[(two["factor"] == 1) & (two["draw"] == 0)].reset_index(drop=True)
    pd.testing.assert_frame_equal(one, again)
    assert (
        tolerance_errors(1, kinds, [1.0], draws=1, steps=8, seed=1)["error_percent"][0]
        != one["error_percent"][0]
    )


def test_sizes_are_in_the_units_of_the_table():
    table = tolerance_errors(1, factors=[2.0], draws=1, steps=3)
    sizes = dict(zip(table["kind"], zip(table["size"], table["unit"], strict=True), strict=True))
    assert set(sizes) == set(KINDS)
    assert sizes["magnet_position_m"] == (pytest.approx(1.0), "mm")
    assert sizes["magnet_tilt_rad"] == (pytest.approx(4.0), "deg")
    assert sizes["sensor_radius"] == (pytest.approx(2.0), "%")


def power_law(exponent=1.0, draws=3):
    """Errors of 2 % times the size, the draws 10 % apart."""
    rows = [
        (1, "sensor_gain", size, size, "%", draw, (2 + 0.2 * (draw - 1)) * size**exponent, 2 * size)
        for size in (0.1, 0.4, 1.6)
        for draw in range(draws)
    ]
    columns = ["n_b", "kind", "factor", "size", "unit", "draw", "error_percent", "linear_percent"]
    return pd.DataFrame(rows, columns=columns)


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_allowed_size_of_a_power_law(exponent):
    found = allowed(power_law(exponent)).iloc[0]
    assert found["tolerance"] == "sensor gain"
    assert found["allowed"] == pytest.approx(0.5 ** (1 / exponent))
    assert found["linear"] == pytest.approx(0.5)
    rounding = 1e-12
    assert (1 / 2.2) ** (1 / exponent) - rounding <= found["low"] < found["allowed"]
    assert found["allowed"] < found["high"] <= (1 / 1.8) ** (1 / exponent) + rounding
    assert found["assumed"] == 1.0


def test_allowed_size_outside_the_study_is_not_extrapolated():
    assert math.isnan(allowed(power_law(), error_percent=0.1)["allowed"].item())
    assert math.isnan(allowed(power_law(), error_percent=10.0)["allowed"].item())


def test_means_with_their_intervals():
    found = tolerance_means(power_law())
    assert found["error_percent"].tolist() == pytest.approx([0.2, 0.8, 3.2])
    assert (found["low_percent"] < found["error_percent"]).all()
    assert (found["high_percent"] > found["error_percent"]).all()
    single = tolerance_means(power_law(draws=1))
    assert single["low_percent"].tolist() == single["high_percent"].tolist()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"kinds": ["glue"]},
            r"Input kinds of tolerance_errors must be among 'magnet_position_m', .*\['glue'\]",
        ),
        ({"factors": [-1.0]}, r"factors of tolerance_errors must be not negative; instead received \[-1.0\]"),
        ({"draws": 0}, "Input draws of tolerance_errors must be at least 1; instead received 0"),
    ],
)
def test_bad_input(change, message):
    with pytest.raises(InputError, match=message):
        tolerance_errors(1, **change)
