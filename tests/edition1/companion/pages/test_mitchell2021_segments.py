"""The particle filter on several segments: what is compared is fair, what is ambiguous is so, and tables add up."""

import pandas as pd
import pytest
import torch
from edition1.errors import InputError
from edition1.estimation.base import Trajectory
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1_companion.pages.filter_on_segments import figures, tables
from edition1_companion.pages.filter_on_segments.methods import (
    BEGUN,
    FILTERS,
    METHODS,
    NOISE_MT,
    TUNED,
    Course,
    run,
)
from scipy.stats import chi2


@pytest.fixture(scope="module")
def tracked() -> pd.DataFrame:
    return tables.tracking((1,), NOISE_MT[:1], draws=3, steps=12, particles=100)


@pytest.fixture(scope="module")
def modes() -> pd.DataFrame:
    return tables.two_modes(NOISE_MT[1:], draws=2, steps=40, particles=60)


def test_compiled_model_equals_the_reference_with_its_slopes():
    course = Course(2)
    q = course.q[:5] + 1e-3
    reference = LinearisedSensing(course.robot, course.model.moments)
    for ours, theirs in zip(course.model.linearise(q), reference.linearise(q), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-9)


def test_readings_are_those_of_magpylib_and_the_first_draws_do_not_depend_on_their_number():
    few, many = Course(2, draws=2, steps=30), Course(2, draws=5, steps=30)
    assert torch.equal(few.u, many.u[:, :2])
    noise = few.u - readings(few.robot, few.q, ring("released")).unsqueeze(1)
    assert abs(float(noise.std()) / few.noise_mt - 1) < 0.15
    assert not torch.equal(few.u, Course(2, draws=2, steps=30, half=True).u)


def test_bend_and_mirror_image_read_alike_without_the_two_sensors_and_not_with_them():
    """With the first segment in the plane of the sensors the two are exactly symmetric."""
    course = tables.mirrored(NOISE_MT[0], draws=1)
    q = torch.tensor([4e-3, 0.0, 2e-3, -6e-3, 8e-3, 3e-3], dtype=torch.float64)
    other = q * torch.tensor([1, -1, 1, 1, -1, 1])
    kept = course.working[-1] & torch.tensor([True, False, True, False] * 2)
    u, v = (readings(course.robot, x, ring("released")) for x in (q, other))
    torch.testing.assert_close(u[kept], v[kept], rtol=0, atol=1e-12)
    failed = ~course.working[-1]
    assert bool(((u - v)[failed].abs() > 100 * NOISE_MT[0]).all())


def test_search_finds_two_configurations_after_the_failure_and_one_before():
    table = tables.two_modes(NOISE_MT[:1], draws=1, steps=40, particles=20)
    found = table.query("method == 'search'")
    assert (found.loc[~found["failed"], "minima"] == 1).all()
    bent = found["failed"] & (found["true_mm"].abs() > 4)
    assert found.loc[bent, "minima"].between(1, 3).all()


def test_filter_starts_from_readings_alone_and_gives_the_same_bits_again():
    course = Course(2, noise_mt=NOISE_MT[1], draws=2, steps=6)
    first, again = (run(course, "constant velocity", particles=50) for _ in range(2))
    assert torch.equal(first.q, again.q)
    assert len(first.q) == course.steps - BEGUN
    assert not torch.equal(first.diagnostics["positive"][:, 0], first.diagnostics["positive"][:, 1])


def test_a_draw_does_not_depend_on_the_others():
    one, two = (Course(1, noise_mt=NOISE_MT[1], draws=k, steps=6) for k in (1, 2))
    assert torch.equal(run(one, "Kalman filter").q, run(two, "Kalman filter").q[:, :1])


def test_calibration_is_the_squared_error_in_standard_deviations():
    q = torch.zeros(1, 3, dtype=torch.float64)
    C = torch.diag(torch.tensor([1.0, 4.0, 9.0], dtype=torch.float64)).unsqueeze(0)
    found = Trajectory(torch.tensor([[1.0, 2.0, 3.0]], dtype=torch.float64), C, q, {})
    assert float(tables.calibration(q, found)) == pytest.approx(3.0)


def test_least_squares_is_calibrated_with_all_sensors():
    course = Course(2, draws=20, steps=20)
    squared = tables.calibration(course.q.unsqueeze(1), course.cold())
    assert abs(float(squared.mean()) / 6 - 1) < 0.15
    assert abs(float((squared < chi2.ppf(0.95, 6)).double().mean()) - 0.95) < 0.03


def test_tables(tracked):
    assert list(tracked["method"].unique()) == list(METHODS)
    summary = tables.mean_errors(tracked).set_index("method")
    assert float(summary.loc[tables.REFERENCE, "ratio"]) == 1.0
    assert (summary["tip_mm_low"] <= summary["tip_mm"]).all()
    assert (summary["tip_mm"] <= summary["tip_mm_high"]).all()
    filters = summary.loc[list(FILTERS)]
    assert filters["effective_sample_size"].between(1, 100).all()
    assert filters["evaluations"].tolist() == [101, 101, 108]
    # A Gauss-Newton step after the mean ends where least squares does.
    ratio = summary.loc["constant velocity + Gauss-Newton", "ratio"]
    assert float(ratio) == pytest.approx(1, abs=0.05)


def test_tables_of_the_modes(modes, monkeypatch):
    monkeypatch.setattr(tables, "CLEAR_MM", 2.0)
    summary = tables.kept_modes(modes).set_index("method")
    assert list(summary.index) == [*METHODS, "search"]
    assert summary["true_side_percent"].dropna().between(0, 100).all()
    share = modes.loc[modes["method"] == "random walk", "share"]
    assert share.between(0, 1).all()
    assert float(share[:30].min()) > 0.9  # before the failure the cloud is on the true side


def test_the_choice_on_the_half_lemniscate_is_a_process_noise_that_follows(monkeypatch):
    """As all choices were made: errors of the tip on a part of T2 from 1 s on, with noise of its own."""
    course = Course(1, noise_mt=NOISE_MT[0], draws=1, first=40, steps=20, half=True)
    key = (1, NOISE_MT[0], "constant velocity")
    errors = []
    for choice in (TUNED[key], (5e-2, 1.0)):
        monkeypatch.setitem(TUNED, key, choice)
        found = run(course, "constant velocity")
        errors.append(float(tables.tip_errors_mm(course, found).square().mean().sqrt()))
    assert errors[0] < errors[1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"draws": 0}, "Input draws of Course must be at least 1; instead received 0."),
        (
            {"first": 390, "steps": 20},
            "Input first, steps of Course must be more than 2 of the 400 steps; instead received (390, 20).",
        ),
    ],
)
def test_bad_course(options, message):
    with pytest.raises(InputError) as error:
        Course(2, **options)
    assert str(error.value) == message


def test_nothing_was_chosen_for_this():
    with pytest.raises(InputError, match="Input method of mitchell2021_segments must be one of"):
        run(Course(2, noise_mt=0.5, draws=1, steps=4), "random walk")


def test_figures_show_every_method(tracked, modes):
    figure = figures.errors_by_method(tables.mean_errors(tracked))
    assert len(figure.legends[0].get_texts()) == len(METHODS)
    chosen = ["random walk", "Kalman filter"]
    assert len(figures.two_modes(modes, chosen).axes) == 2
