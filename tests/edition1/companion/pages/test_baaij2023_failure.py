"""Sensor failure: what masks do and do not change, what the covariance says, and how the errors are taken."""

import math
from pathlib import Path

import pandas as pd
import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt, covariance, jacobian
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.paper_robots import pcc_robot
from edition1.kinematics.robot import Robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1_companion.book.project import find_project
from edition1_companion.pages.sensor_failure import failure as experiment
from edition1_companion.pages.sensor_failure import tables
from edition1_companion.pages.sensor_failure.failure import Estimates, Failure
from edition1_companion.twins.calibrated_robots import box, start
from edition1_companion.twins.calibration_session import released_moments
from edition1_companion.twins.trajectories import lemniscate

NETWORKS = find_project().data / "networks"
MOMENTS = released_moments()
STEPS = 20  # 2 Hz: the failure comes at step 10
COORDINATES = list(experiment.ROW.robot().coordinates)


@pytest.fixture(scope="module")
def descent() -> Estimates:
    return experiment.paper_method(Failure(), (0,), NETWORKS, steps=STEPS)


@pytest.fixture(scope="module")
def least_squares() -> Estimates:
    return experiment.calibrated_method(Failure(), draws=3, steps=STEPS)


def test_mask_is_that_of_the_paper():
    working = Failure().working()
    assert working.shape == (400, 2, 12)
    assert bool(working[:, 0].all())
    assert bool(working[:200, 1].all())
    assert (
        working[200:, 1].any(0).tolist() == working[200:, 1].all(0).tolist() == 3 * [True, True, True, False]
    )
    assert float(experiment.times()[200]) == 5.0


@pytest.mark.parametrize("run", ["descent", "least_squares"])
def test_before_the_failure_the_runs_are_equal_bit_for_bit_and_differ_from_then_on(run, request):
    estimates = request.getfixturevalue(run)
    everything, failure = estimates.q_hat.unbind(2)
    assert torch.equal(everything[:10], failure[:10])
    assert bool((everything[10:] != failure[10:]).any(-1).all())


def test_what_fails_does_not_reach_back(descent):
    other = experiment.paper_method(Failure((1,)), (0,), NETWORKS, steps=STEPS)
    assert torch.equal(other.q_hat[:10], descent.q_hat[:10])
    assert torch.equal(other.q_hat[:, :, 0], descent.q_hat[:, :, 0])


def test_no_sensor_fails():
    nothing = Failure(())
    for found in (
        experiment.paper_method(nothing, (0,), NETWORKS, steps=4),
        experiment.calibrated_method(nothing, draws=1, steps=4),
    ):
        assert torch.equal(found.q_hat[:, :, 0], found.q_hat[:, :, 1])


def test_masked_sensors_equal_a_robot_without_them():
    """Another route: nine sensors mounted instead of three masked."""
    whole, q = pcc_robot(3, 4), lemniscate(3, steps=7)
    kept = [k for k in range(12) if k % 4 != 3]
    sensors = Mounts(
        tuple(whole.sensors.segment[k] for k in kept), whole.sensors.axial[kept], whole.sensors.local[kept]
    )
    u = readings(whole, q, ring("released"))
    found = []
    for robot, seen, mask in (
        (whole, u, Failure().working()[-1, 1]),
        (Robot(whole.segments, whole.magnets, sensors), u[:, kept], None),
    ):
        method = LevenbergMarquardt(LinearisedSensing(robot, MOMENTS), *box(3), noise_mt=1e-3)
        found.append(method.step(method.init(start(3).expand(7, -1)), seen, 0.0, mask=mask)[1])
    torch.testing.assert_close(found[0].q, found[1].q, atol=1e-9, rtol=0)
    torch.testing.assert_close(found[0].covariance, found[1].covariance, rtol=1e-6, atol=0)


def test_covariance_grows_in_the_loewner_order_when_sensors_fail():
    generator = torch.Generator().manual_seed(0)
    low, high = box(3)
    q = low + (high - low) * torch.rand(200, 9, generator=generator, dtype=torch.float64)
    J = jacobian(LinearisedSensing(pcc_robot(3, 4), MOMENTS), q)[1]
    failed = [3, 7, 11]
    chain = [covariance(J, 1e-3)]
    for n in range(1, 4):
        J = J.index_fill(-2, torch.tensor(failed[:n]), 0.0)
        chain.append(covariance(J, 1e-3))
    for fewer, more in zip(chain[1:], chain[:-1], strict=True):
        values = torch.linalg.eigvalsh(fewer - more)
        assert bool((values[:, 0] >= -1e-9 * values[:, -1]).all())
        assert bool((values[:, -1] > 0).all())


def test_three_of_four_sensors_closed_form():
    """Readings linear in the position on a circle: without the one at -y deviations grow by 1, sqrt 3, sqrt 2."""
    J = jacobian(LinearisedSensing(pcc_robot(1, 4), MOMENTS), torch.zeros(3, dtype=torch.float64))[1]
    four, three = (covariance(x, 1e-3).diagonal().sqrt() for x in (J, J[:3]))
    expected = torch.tensor([1.0, math.sqrt(3), math.sqrt(2)], dtype=torch.float64)
    torch.testing.assert_close(three / four, expected, rtol=1e-9, atol=0)


def test_errors_are_those_of_equation_13_on_each_part():
    q = lemniscate(3, steps=10)
    span = q.amax(0) - q.amin(0)
    q_hat = q[:, None, None].repeat(1, 1, 2, 1)
    q_hat[:5] += 0.01 * span
    q_hat[5:, :, 1] -= torch.tensor([0.03, 0.04, 0.04, 0.04, 0.05]).view(5, 1, 1) * span
    deviation = (0.02 * span).expand(10, 1, 2, 9)
    u = torch.zeros(10, 1, 12, dtype=torch.float64)
    estimates = Estimates(q, u, q_hat, u.unsqueeze(2).expand(-1, -1, 2, -1), deviation)
    table = tables.errors_by_run(estimates, Failure())
    assert list(table.columns) == ["member", "run", "part", "quantity", "error_percent", "deviation_percent"]
    found = table.pivot(index="quantity", columns=["run", "part"], values="error_percent").loc[COORDINATES]
    rms = 100 * math.sqrt((0.03**2 + 3 * 0.04**2 + 0.05**2) / 5)
    for key, value in {
        ("failure", "before"): 1.0,
        ("failure", "after"): rms,
        ("all sensors", "after"): 0.0,
    }.items():
        assert found[key].tolist() == pytest.approx([value] * 9, abs=1e-6)
    assert table["deviation_percent"].tolist() == pytest.approx([2.0] * len(table))


def test_two_ratios_and_which_holds():
    lines = [
        {"member": m, "run": run, "part": part, "quantity": c, "error_percent": x * (1 + m), "deviation_percent": d}
        for m in (0, 1)
        for c in ("delta_x_1", "delta_y_1")
        for run, part, x, d in (
            ("all sensors", "before", 1.0, 1.0),
            ("all sensors", "after", 2.0, 1.0),
            ("failure", "before", 1.0, 1.0),
            ("failure", "after", 2.2 if c == "delta_x_1" else 1.1, 3.0 if c == "delta_x_1" else 30.0),
        )
    ]  # fmt: skip
    found = tables.compensation(pd.DataFrame(lines)).set_index("quantity")
    assert found["after_to_before"].tolist() == pytest.approx([2.2, 1.1, 1.65])
    assert found["failure_to_all_sensors"].tolist() == pytest.approx([1.1, 0.55, 0.825])
    assert found["after_to_before_holds"].tolist() == [False, True, False]
    assert found["failure_to_all_sensors_holds"].all()
    assert found["failure_to_all_sensors_low"].tolist() == pytest.approx(
        [1.1, 0.55, 0.825]
    )  # draws in proportion
    assert found["deviation_ratio"].tolist() == pytest.approx([3.0, 30.0, 16.5])
    assert found["determined"].tolist() == [True, False, False]


def test_gradient_descent_beside_the_authors_networks(descent):
    table = tables.errors_with_authors(tables.errors_by_run(descent, Failure()))
    assert table["quantity"].tolist() == COORDINATES
    assert table["authors_before_percent"].tolist() == [3.5, 3.8, 3.5, 2.8, 3.1, 3.6, 1.5, 1.3, 2.4]
    assert table["authors_after_percent"].tolist() == [3.7, 5.8, 5.8, 2.2, 3.0, 5.1, 1.6, 2.2, 3.5]
    assert table["after_percent_std"].isna().all()  # of one seed


def test_ours_loses_what_the_covariance_says(least_squares):
    """No unbiased estimator from one time step can keep delta_y; the mean stays within the target."""
    table = tables.errors_by_run(least_squares, Failure())
    found = tables.compensation(table).set_index("quantity")
    assert found.loc["mean", "failure_to_all_sensors"] == pytest.approx(1.2, abs=0.1)
    across = [c for c in COORDINATES if c.startswith("delta_y")]
    assert found.loc[across, "failure_to_all_sensors"].between(1.4, 2.3).all()
    assert found.loc[across, "deviation_ratio"].between(1.6, 2.1).all()
    along = [c for c in COORDINATES if c.startswith("delta_x")]
    assert found.loc[along, "failure_to_all_sensors"].between(0.95, 1.2).all()
    assert (found["deviation_ratio"] > 1).all()
    assert found["determined"].all()
    assert found["after_percent"].max() < 1.2


def test_draws_do_not_depend_on_their_number(least_squares):
    one = experiment.calibrated_method(Failure(), draws=1, steps=STEPS)
    torch.testing.assert_close(one.q_hat[:, 0], least_squares.q_hat[:, 0], atol=1e-8, rtol=0)


def test_loss_of_a_whole_segment_is_reported():
    """Eight readings for nine coordinates: none is determined, and the reported deviation says so."""
    failure = Failure((9, 10, 11, 12))
    table = tables.errors_by_run(experiment.calibrated_method(failure, draws=1, steps=10), failure)
    found = tables.compensation(table).set_index("quantity")
    assert not found["determined"].any()
    assert (found["deviation_ratio"] > 1e3).all()
    assert found["before_percent"].max() < 1.2


def test_tables_over_time(descent):
    u, q = tables.over_time(descent, Failure())
    assert (len(u), len(q)) == (STEPS * 12, STEPS * 9)
    here = u[(u["sensor"] == 8) & (u["time_s"] == 5.0)].iloc[0]
    assert (here["segment"], bool(here["working"])) == (2, False)
    assert here["true_mT"] == float(descent.u[10, 0, 7])
    assert here["mean_mT"] == float(descent.u_hat[10, 0, 1, 7])
    here = q[(q["quantity"] == "delta_y_3") & (q["time_s"] == 2.5)].iloc[0]
    assert (here["segment"], here["true_mm"]) == (3, 1e3 * float(descent.q[5, 7]))
    assert q["std_mm"].isna().all()  # of one seed


def test_uncertainty_over_time(least_squares):
    table = tables.uncertainty(least_squares)
    assert len(table) == STEPS * 2 * 3
    here = table.query("time_s == 7.5 and run == 'failure' and quantity == 'delta_L'").iloc[0]
    expected = 1e3 * (least_squares.q_hat - least_squares.q[:, None, None])[15, :, 1, 2::3]
    assert here["error_mm"] == pytest.approx(float(expected.square().mean().sqrt()))


def test_stills_hold_both_shapes(descent):
    shapes, parts = tables.stills(descent, Failure(), n=3)
    assert shapes["time_s"].unique().tolist() == pytest.approx([0.0, 5.0, 9.5])
    assert shapes.groupby(["time_s", "estimated"]).size().tolist() == [75] * 6
    failed = parts[~parts["working"]]
    assert (failed["part"] == "sensor").all()
    assert failed.groupby(["time_s", "estimated"]).size().tolist() == [3] * 4
    tip = shapes[(shapes["time_s"] == 5.0) & ~shapes["estimated"]].iloc[-1]
    expected = 1e3 * experiment.ROW.robot().tip(descent.q[10])[:3, 3]
    assert [tip["x_mm"], tip["y_mm"], tip["z_mm"]] == pytest.approx(expected.tolist())


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: Failure((4, 13)),
            "Input sensors of Failure must be numbers from 1 to 12, each once; instead received [4, 13].",
        ),
        (
            lambda: Failure((0,)),
            "Input sensors of Failure must be numbers from 1 to 12, each once; instead received [0].",
        ),
        (
            lambda: Failure((4, 4)),
            "Input sensors of Failure must be numbers from 1 to 12, each once; instead received [4, 4].",
        ),
        (
            lambda: Failure(range(1, 13)),
            "Input sensors of Failure must be fewer than all 12 sensors; instead received "
            "[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12].",
        ),
        (
            lambda: Failure(time_s=10.0),
            "Input time_s of Failure must be within the 10 s of the trajectory; instead received 10.0.",
        ),
        (
            lambda: Failure(time_s=9.99).after(),
            "Input time_s of Failure must be between two time steps; instead received 9.99.",
        ),
        (
            lambda: experiment.paper_method(Failure(), (0, 77), Path("nowhere")),
            "Input seeds of paper_method must be seeds whose networks are trained; instead received [0, 77].",
        ),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError) as caught:
        call()
    assert str(caught.value) == message
