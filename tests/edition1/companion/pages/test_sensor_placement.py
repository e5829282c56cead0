"""Placement of sensors: slopes of the objective, laws of the information, what an optimisation may and may not do."""

import math
from dataclasses import replace

import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.information import fisher_information
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.placement import Tolerances
from edition1_companion.pages.sensor_placement.errors import measured_errors
from edition1_companion.pages.sensor_placement.layouts import Layout, Room
from edition1_companion.pages.sensor_placement.search import Settings, optimise, search
from edition1_companion.pages.sensor_placement.studies import quarter_turn
from edition1_companion.pages.sensor_placement.tasks import (
    NOISE_MT,
    expected_errors,
    guaranteed_error,
    mean_errors,
    pcc_task,
    ring_moments,
)

TASKS = {
    "one segment": pcc_task(1, shapes=5, steps=8),
    "two segments": pcc_task(2, shapes=3, steps=8),
    "elongation known": pcc_task(2, 2, known_elongation=True, shapes=3, steps=8),
}


def scattered(task, seed=1):
    return Room().random(task.nominal, torch.Generator().manual_seed(seed))


@pytest.mark.parametrize(
    ("name", "nominal"),
    [(name, False) for name in TASKS] + [(name, True) for name in TASKS if name != "elongation known"],
)
def test_slopes_of_both_errors_are_right(name, nominal):
    """Also at the nominal layout, where sensors share a plane and lie next to the limit of their height."""
    task = TASKS[name]
    layout = task.nominal if nominal else scattered(task)
    height = torch.from_numpy(layout.of_kind(("axial",)))
    top = Room().limits(layout)[1]
    inwards = torch.where(height, layout.values.clamp(torch.full_like(top, 1e-4), top - 1e-4), layout.values)
    unit = torch.where(torch.from_numpy(layout.of_kind(("azimuth", "tilt"))), 1.0, 0.1).double()

    def errors(x):
        found = expected_errors(task, layout.moved(inwards + unit * x), tolerances=Tolerances())
        return tuple(error.mean() / 10 for error in found)

    x = torch.zeros_like(unit, requires_grad=True)
    assert torch.autograd.gradcheck(errors, (x,), eps=1e-6, atol=1e-6, rtol=1e-4, fast_mode=True)


def information(task, layout, q):
    J = LinearisedSensing(layout.robot(), ring_moments()).linearise(q)[1]
    return fisher_information(J, NOISE_MT)


@pytest.mark.parametrize("name", ["one segment", "two segments"])
def test_turning_the_layout_about_the_axis_of_symmetric_shapes_changes_nothing(name):
    """Four shapes, each a quarter turn from the last, and a layout turned by a quarter: the mean stays."""
    task = TASKS[name]
    layout = scattered(task)
    q = task.shapes[:1].repeat(4, 1)
    for k in range(4):
        for i in range(0, q.shape[1], 3):
            x, y = q[0, i].clone(), q[0, i + 1].clone()
            q[k, i], q[k, i + 1] = [(x, y), (-y, x), (-x, -y), (y, -x)][k]
    quarter = torch.from_numpy(layout.of_kind(("azimuth",))) * (math.pi / 2)
    turned = layout.moved(layout.values + quarter)
    for one, two in zip(
        *(expected_errors(task, x, q, tolerances=Tolerances()) for x in (layout, turned)), strict=True
    ):
        torch.testing.assert_close(one.mean(), two.mean(), rtol=1e-7, atol=0)
        assert not torch.allclose(one[0], two[0], rtol=1e-3)
    assert guaranteed_error(task, layout, q) == pytest.approx(guaranteed_error(task, turned, q))


def test_another_sensor_never_takes_information_away():
    task = TASKS["one segment"]
    layout = scattered(task)
    axial, radial, azimuth, tilt, magnet = layout.parts()
    generator = torch.Generator().manual_seed(0)
    for _ in range(5):
        u = torch.rand(4, 1, generator=generator, dtype=torch.float64)
        parts = [torch.cat([x, low + w * v]) for x, low, w, v in zip(
            (axial, radial, azimuth, tilt), (0.0, 0.009, 0.0, -1.5), (0.1, 0.008, 6.28, 3.0), u, strict=True,
        )]  # fmt: skip
        more = Layout(
            layout.segments, (*layout.sensor_segment, 0), layout.magnet_segment, torch.cat([*parts, magnet])
        )
        before, after = (information(task, x, task.shapes) for x in (layout, more))
        scale = before.diagonal(dim1=-2, dim2=-1).sqrt()
        gained = (after - before) / (scale.unsqueeze(-1) * scale.unsqueeze(-2))
        assert float(torch.linalg.eigvalsh(gained).min()) > -1e-9
        assert (expected_errors(task, more)[0] <= expected_errors(task, layout)[0] * (1 + 1e-9)).all()


def test_noise_error_is_the_bound_of_the_estimator():
    """The inverse of the information of the unknown coordinates, in per cent of their ranges."""
    task = TASKS["elongation known"]
    layout = scattered(task)
    C = torch.linalg.inv(information(task, layout, task.shapes)[..., task.unknown, :][..., task.unknown])
    expected = 100 * C.diagonal(dim1=-2, dim2=-1).sqrt() / task.width[task.unknown]
    torch.testing.assert_close(expected_errors(task, layout)[0], expected)
    assert expected_errors(task, layout, noise_mt=2 * NOISE_MT)[0].sum() == pytest.approx(2 * expected.sum())
    worst = guaranteed_error(task, layout)
    assert expected.max() <= worst <= math.sqrt(len(task.unknown)) * expected.max() * (1 + 1e-9)


def test_tolerance_error_is_what_least_squares_makes_of_robots_that_are_off():
    """Small tolerances: estimates by one linear step from draws of robots have the deviation that is expected."""
    task = TASKS["one segment"]
    layout = scattered(task, seed=2)
    small = Tolerances(*(1e-3 * x for x in vars(Tolerances()).values()))
    expected = expected_errors(task, layout, tolerances=small)[1]
    few = replace(task, tests={"training": task.shapes[:2]})
    found = measured_errors(few, {"scattered": layout}, draws=400, noise_mt=1e-9, tolerances=small)
    found = found[found["robot"] == "within tolerances"]
    range_of_test = (few.shapes[:2].amax(0) - few.shapes[:2].amin(0)) / task.width
    rms = found.groupby("quantity", sort=False)["error_percent"].apply(lambda x: (x**2).mean() ** 0.5)
    predicted = expected[:2].square().mean(0).sqrt() / range_of_test
    torch.testing.assert_close(torch.tensor(rms.to_numpy()), predicted, rtol=0.12, atol=0)


def of_gains_alone(size):
    """Tolerances of which only the gains of the sensors count."""
    nothing = dict.fromkeys(vars(Tolerances()), 1e-12)
    return Tolerances(**nothing | {"sensor_gain": size})


def test_gains_alone_move_the_estimate_as_their_readings_say():
    """Sensors whose gains are off by g read (1 + g) u; least squares turns g u into J^+ g u."""
    task = TASKS["one segment"]
    layout, size = scattered(task, seed=2), 1e-3
    u, J = LinearisedSensing(layout.robot(), ring_moments()).linearise(task.shapes[:2])
    moved = torch.linalg.pinv(J) * u.unsqueeze(-2)
    deviation = size * torch.linalg.vector_norm(moved, dim=-1)
    expected = expected_errors(task, layout, task.shapes[:2], tolerances=of_gains_alone(size))[1]
    torch.testing.assert_close(expected, 100 * deviation / task.width, rtol=1e-3, atol=0)
    few = replace(task, tests={"training": task.shapes[:2]})
    found = measured_errors(few, {"x": layout}, draws=400, noise_mt=1e-9, tolerances=of_gains_alone(size))
    found = found[found["robot"] == "within tolerances"]
    rms = found.groupby("quantity", sort=False)["error_percent"].apply(lambda x: (x**2).mean() ** 0.5)
    range_ = task.shapes[:2].amax(0) - task.shapes[:2].amin(0)
    predicted = 100 * deviation.square().mean(0).sqrt() / range_
    torch.testing.assert_close(torch.tensor(rms.to_numpy()), predicted, rtol=0.12, atol=0)


@pytest.mark.parametrize("name", TASKS)
def test_every_sensor_twice_is_half_the_variance(name):
    """Information of independent sensors adds up: all errors by noise are smaller by the root of two, no more."""
    task = TASKS[name]
    layout = scattered(task)
    *sensors, magnet = layout.parts()
    values = torch.cat([*(torch.cat([x, x]) for x in sensors), magnet])
    twice = Layout(layout.segments, 2 * layout.sensor_segment, layout.magnet_segment, values)
    one, two = (expected_errors(task, x)[0] for x in (layout, twice))
    torch.testing.assert_close(one, math.sqrt(2) * two, rtol=1e-6, atol=0)
    least = [guaranteed_error(task, x) for x in (layout, twice)]
    assert least[0] == pytest.approx(math.sqrt(2) * least[1], rel=1e-6)


@pytest.mark.parametrize("name", TASKS)
def test_guaranteed_error_is_that_of_the_direction_that_is_known_least(name):
    """The smallest eigenvalue of the information in units of the ranges, over the shapes."""
    task = TASKS[name]
    layout = scattered(task)
    known = information(task, layout, task.shapes)[..., task.unknown, :][..., task.unknown]
    width = task.width[task.unknown]
    smallest = torch.linalg.eigvalsh(known * width * width.unsqueeze(-1))[..., 0].min()
    assert guaranteed_error(task, layout) == pytest.approx(100 / float(smallest.sqrt()), rel=1e-6)
    assert guaranteed_error(task, layout, noise_mt=3 * NOISE_MT) == pytest.approx(
        300 / float(smallest.sqrt())
    )


def test_tolerance_error_is_never_more_than_that_of_an_estimate_at_a_bound():
    task = TASKS["one segment"]
    large = Tolerances(*(1e4 * x for x in vars(Tolerances()).values()))
    found = expected_errors(task, task.nominal, tolerances=large)[1]
    assert float(found.max()) < 100 / math.sqrt(3)
    assert float(found.min()) > 0.99 * 100 / math.sqrt(3)


def test_two_sensors_per_segment_cannot_determine_nine_coordinates_wherever_they_are():
    task = pcc_task(3, 2, shapes=4, steps=2)
    for seed in range(3):
        found = expected_errors(task, scattered(task, seed))[0]
        assert torch.isinf(found).any(-1).all()
        assert guaranteed_error(task, scattered(task, seed)) == math.inf


def test_two_sensors_a_quarter_turn_apart_see_what_opposite_ones_do_not():
    """With the elongation known; shapes in the plane of the opposite sensors, from which neither side differs."""
    task = pcc_task(3, 2, shapes=4, steps=2, known_elongation=True)
    q = task.shapes.clone()
    q[:, 1::3] = 0.0
    worst = expected_errors(task, task.nominal, q)[0].amax(-1)
    assert (worst > 1e6).all()
    assert guaranteed_error(task, task.nominal, q) > 1e6
    assert guaranteed_error(task, quarter_turn(task.nominal), q) < 1


@pytest.mark.parametrize("limit", [0.9, math.inf])
def test_optimum_keeps_its_limits(limit):
    task, room = TASKS["one segment"], Room()
    low, high = room.limits(task.nominal)
    for start in (task.nominal, scattered(task)):
        layout, found = optimise(task, start, Settings(limit=limit, iterations=5))
        assert ((layout.values >= low) & (layout.values <= high)).all()
        assert (found["noise_percent"], found["tolerance_percent"]) == pytest.approx(
            mean_errors(task, layout)
        )
        if found["feasible"]:
            assert room.holds(layout)
            assert found["tolerance_percent"] <= limit * mean_errors(task, task.nominal)[1] * 1.0011


def test_search_ends_below_the_nominal_layout():
    task = TASKS["one segment"]
    best, table = search(task, Settings(limit=math.inf, iterations=12), starts=1)
    assert mean_errors(task, best)[0] < 0.5 * mean_errors(task, task.nominal)[0]
    assert table["chosen"].tolist() == [True]
    assert table["feasible"].tolist() == [True]
    assert mean_errors(task, best)[0] == pytest.approx(table["noise_percent"].item())


def test_search_returns_the_nominal_layout_rather_than_one_that_breaks_the_limit():
    task = TASKS["one segment"]
    best, table = search(task, Settings(limit=0.05, iterations=2), starts=1)
    assert torch.equal(best.values, task.nominal.values)
    assert not table["chosen"].any()


def test_search_repeats():
    task = TASKS["one segment"]
    (one, table), (two, other) = (search(task, Settings(iterations=3), starts=2, seed=4) for _ in range(2))
    assert torch.equal(one.values, two.values)
    assert table.equals(other)
    assert mean_errors(task, one)[0] <= mean_errors(task, task.nominal)[0]


def test_only_what_is_free_moves():
    task = TASKS["one segment"]
    found, _ = optimise(task, task.nominal, Settings(free=("tilt",), iterations=5))
    fixed = ~torch.from_numpy(task.nominal.of_kind(("tilt",)))
    assert torch.equal(found.values[fixed], task.nominal.values[fixed])
    assert (found.values[~fixed] != task.nominal.values[~fixed]).all()


def test_held_out_shapes_are_not_those_of_the_optimisation():
    for task in TASKS.values():
        for q in task.tests.values():
            assert float(torch.cdist(q / task.width, task.shapes / task.width).min()) > 1e-3


def test_bad_input():
    task = TASKS["one segment"]
    with pytest.raises(InputError, match=r"starts, iterations of search must be at least 1; .* \(0, 60\)"):
        search(task, starts=0)
    with pytest.raises(InputError, match=r"starts, iterations of search must be at least 1; .* \(4, 0\)"):
        search(task, Settings(iterations=0))
    low = task.nominal.moved(task.nominal.values - 1.0)
    with pytest.raises(InputError, match="reference of search must be a layout that the room allows"):
        search(task, reference=low)
    open_ = pcc_task(3, 2, shapes=2, steps=2)
    with pytest.raises(InputError, match="start of optimise must be a layout whose readings determine every"):
        optimise(open_, open_.nominal)
    with pytest.raises(InputError, match=r"Input steps of pcc_task must be at least 2; instead received 1"):
        pcc_task(1, steps=1)
