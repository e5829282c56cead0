"""Judging layouts: errors at the bound, the same draws for all, known coordinates, summaries, the committed study."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from edition1.errors import InputError
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1_companion.pages.sensor_placement.errors import (
    ROBOTS,
    bound_over_time,
    errors_by_layout,
    estimate,
    field_check,
    measured_errors,
)
from edition1_companion.pages.sensor_placement.studies import (
    NOISE_ONLY,
    NOMINAL,
    OPTIMISED,
    QUARTER,
    expected,
    optimised_layouts,
    quarter_turn,
)
from edition1_companion.pages.sensor_placement.tasks import expected_errors, pcc_task

STUDIES = Path(__file__).parents[4] / "data" / "studies"
TASKS = {
    task.name: task
    for task in (
        pcc_task(1, shapes=48, steps=100),
        pcc_task(3, shapes=48, steps=100),
        pcc_task(3, 2, known_elongation=True, shapes=48, steps=100),
    )
}


@pytest.fixture(scope="module")
def layouts():
    return pd.read_csv(STUDIES / "placement_layouts.csv")


def studied(layouts, task, name):
    chosen = layouts[(layouts["task"] == task.name) & (layouts["layout"] == name)]
    sensors, magnets = (chosen[chosen["part"] == part] for part in ("sensor", "magnet"))
    lengths = np.concatenate([sensors["axial_mm"], sensors["radial_mm"]]) / 1e3
    angles = np.radians(np.concatenate([sensors["azimuth_deg"], sensors["tilt_deg"]]))
    values = np.concatenate([lengths, angles, magnets["axial_mm"] / 1e3])
    return task.nominal.moved(torch.from_numpy(values))


def test_errors_of_the_nominal_layout_are_at_their_bound():
    """Readings from magpylib with noise: the estimator reaches the Cramér-Rao bound of the multipole model."""
    task = pcc_task(1, steps=40)
    found = measured_errors(task, {NOMINAL: task.nominal}, draws=10)
    for test, q in task.tests.items():
        here = found[(found["shapes"] == test) & (found["robot"] == "as drawn")]
        rms = here.groupby("quantity", sort=False)["error_percent"].apply(lambda x: math.sqrt((x**2).mean()))
        bound = expected_errors(task, task.nominal, q)[0].square().mean(0).sqrt()
        bound = bound * task.width[task.unknown] / (q.amax(0) - q.amin(0))[task.unknown]
        np.testing.assert_allclose(rms, bound, rtol=0.15)


def test_all_layouts_meet_the_same_draws():
    task = pcc_task(1, steps=5)
    found = measured_errors(task, {"one": task.nominal, "two": task.nominal}, draws=2)
    one, two = (found[found["layout"] == name]["error_percent"].to_numpy() for name in ("one", "two"))
    np.testing.assert_array_equal(one, two)
    assert set(found["robot"]) == set(ROBOTS)
    other = measured_errors(task, {"one": task.nominal}, draws=2, seed=1)
    assert not np.allclose(other["error_percent"], one)


def test_known_coordinates_are_held_and_not_judged():
    task = pcc_task(1, 2, known_elongation=True, steps=6)
    layout = quarter_turn(task.nominal)
    q = task.tests["lemniscate T3"]
    u = readings(layout.robot(), q, ring("released")).unsqueeze(1)
    found = estimate(task, layout, u, q)
    assert torch.equal(found[:, 0, 2], q[:, 2])
    torch.testing.assert_close(found[:, 0], q, rtol=0, atol=1e-8)
    assert set(measured_errors(task, {"pair": layout}, draws=1)["quantity"]) == {"delta_x_1", "delta_y_1"}


def test_summary_is_a_ratio_of_means_with_its_interval():
    rows = [("nominal", draw, 2.0 + draw) for draw in range(4)]
    rows += [("half", draw, 1.0 + draw / 2) for draw in range(4)]
    table = pd.DataFrame(rows, columns=["layout", "draw", "error_percent"])
    table = table.assign(task="robot", robot="as drawn", shapes="random shapes", quantity="delta_x_1")
    found = errors_by_layout(table).set_index("layout")
    assert found.loc["nominal", ["ratio", "ratio_low", "ratio_high"]].tolist() == [1, 1, 1]
    assert found.loc["half", ["ratio", "ratio_low", "ratio_high"]].tolist() == [0.5, 0.5, 0.5]
    assert found.loc["half", "mean_percent"] == 1.75
    assert found.loc["half", "std_percent"] == pytest.approx(np.std([1, 1.5, 2, 2.5], ddof=1))


def test_bound_over_time_lists_the_trajectory_of_every_layout():
    task = pcc_task(1, steps=5)
    found = bound_over_time(task, {"a": task.nominal, "b": task.nominal})
    assert found.groupby("layout")["time_s"].max().tolist() == [9.975, 9.975]
    mean = expected_errors(task, task.nominal, task.tests["lemniscate T3"])[0].mean(-1)
    np.testing.assert_allclose(found[found["layout"] == "b"]["bound_percent"], mean)


def test_opposite_sensors_are_compared_with_a_quarter_turn():
    task = pcc_task(1, 2, known_elongation=True, shapes=4, steps=3)
    task = replace(task, shapes=task.shapes * torch.tensor([1.0, 1e-6, 1.0], dtype=torch.float64))
    found, starts = optimised_layouts(task, starts=1, iterations=3)
    assert list(found) == [NOMINAL, QUARTER, OPTIMISED, NOISE_ONLY]
    azimuths = found[QUARTER].table().query("part == 'sensor'")["azimuth_deg"]
    np.testing.assert_allclose(azimuths, [0.0, 90.0], atol=1e-9)
    assert starts["layout"].tolist() == [OPTIMISED, NOISE_ONLY]


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("layout", [OPTIMISED, NOISE_ONLY])
def test_committed_layouts_have_the_errors_that_the_study_lists(layouts, name, layout):
    task = TASKS[name]
    listed = pd.read_csv(STUDIES / "placement_expected.csv").query("task == @name and layout == @layout")
    here = studied(layouts, task, layout)
    for quantity, value in (expected(task, here) | field_check(task, here)).items():
        if quantity != "largest_difference_mT":
            assert value == pytest.approx(listed[quantity].item(), rel=1e-4)
    assert field_check(task, here)["largest_difference_mT"] < 1e-4


def test_study_meets_its_target():
    """At equal number of sensors the error is at most 0.8 of that of the reference, on shapes and noise not used."""
    table = pd.read_csv(STUDIES / "placement_errors.csv").query(
        "robot == 'as drawn' and layout == @OPTIMISED"
    )
    assert set(table["task"]) == {*TASKS, "affine, n_s=9"}
    assert (table["ratio_high"] <= 0.8).all()


def test_bad_input():
    task = pcc_task(1, steps=2)
    with pytest.raises(InputError, match="draws of measured_errors must be at least 1; instead received 0"):
        measured_errors(task, {NOMINAL: task.nominal}, draws=0)
