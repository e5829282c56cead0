"""Best figures for Table 1: targets on few draws, no leak of the truth, limits of the exact model."""

from pathlib import Path

import pandas as pd
import pytest
import torch

from edition1.errors import InputError
from edition1.sensing.linearised import LinearisedSensing
from edition1_companion.pages.table_1.limits import (
    best,
    checks,
    consistency,
    coverage,
    observability,
    worst_cold_start_mm,
)
from edition1_companion.twins.calibrated_robots import calibration, gain_by_calibration, session
from edition1_companion.twins.calibration_session import Config
from edition1_companion.twins.table_1_rows import ROWS

FEW = Config(draws=2)
BY_NAME = {row.name: row for row in ROWS}
PUBLISHED = Path(__file__).parents[4] / "data" / "published" / "published.csv"


@pytest.fixture(scope="module")
def table():
    return best([BY_NAME["n_b=1"], BY_NAME["n_b=2"]], FEW)


def test_table_is_tidy(table):
    assert list(table.columns) == ["row", "quantity", "draw", "calibrated", "error_percent"]
    assert len(table) == (3 + 6) * 2 * 2
    assert not table.duplicated(["row", "quantity", "draw", "calibrated"]).any()
    assert table["error_percent"].between(0.01, 100).all()


def test_calibrated_robots_are_below_three_tenths_of_the_published_errors(table):
    """Mean over the per-cent columns of each row of ours over published."""
    published = pd.read_csv(PUBLISHED).query("paper == 'baaij2023' and artefact == 'Table 1' and unit == '%'")
    cells = table.groupby(["row", "quantity", "calibrated"], as_index=False)["error_percent"].mean()
    joined = cells.merge(published[["row", "quantity", "value"]], on=["row", "quantity"])
    ratio = (joined["error_percent"] / joined["value"]).groupby([joined["row"], joined["calibrated"]]).mean()
    found = ratio.unstack()
    assert (found[True] <= 0.30).all()
    assert (found[False] > found[True]).all()


def test_summary(table):
    found = gain_by_calibration(table)
    assert set(found.query("row == 'n_b=1'")["quantity"]) == {"delta_x_1", "delta_y_1", "delta_L_1", "mean"}
    assert found["ratio"].between(found["ratio_low"] - 1e-12, found["ratio_high"] + 1e-12).all()
    line = found.query("row == 'n_b=1' and quantity == 'delta_L_1'").iloc[0]
    here = table.query("row == 'n_b=1' and quantity == 'delta_L_1' and calibrated")["error_percent"]
    assert line["calibrated_percent"] == pytest.approx(here.mean())
    assert line["calibrated_percent_std"] == pytest.approx(here.std(ddof=1))


def test_same_seed_same_table_and_draws_do_not_depend_on_their_number(table):
    row = BY_NAME["n_b=1"]
    again = best([row], FEW)
    pd.testing.assert_frame_equal(
        again, table.query("row == 'n_b=1'").reset_index(drop=True), check_exact=True
    )
    one, two = session(row, Config(draws=1)), session(row, FEW)
    torch.testing.assert_close(one.readings[:, 0], two.readings[:, 0])
    assert not torch.equal(session(row, Config(draws=1, seed=1)).readings, one.readings)


def test_the_true_robot_does_not_reach_the_calibration():
    """The calibrated robot is near the true one, yet depends on nothing but poses and readings."""
    row = BY_NAME["n_b=1"]
    measured = session(row, FEW)
    found = calibration(row, measured, FEW)
    blind = calibration(
        row,
        type(measured)(
            row.robot(),
            measured.poses,
            measured.pose_readings,
            *[torch.empty(0, 3, dtype=torch.float64), torch.empty(0, 2, 3, dtype=torch.float64)],
        ),
        FEW,
    )
    assert torch.equal(found.estimate, blind.estimate)
    offset = measured.true_robot.magnets.local - row.robot().magnets.local
    left = measured.true_robot.magnets.local - found.robot.magnets.local
    assert float(left[..., :2, 3].norm()) < 0.5 * float(offset[..., :2, 3].norm())


def test_earth_field_is_known_to_the_estimator():
    row = BY_NAME["n_e=(0,0,1)"]
    measured = session(row, Config(draws=1))
    sensing = calibration(row, measured, Config(draws=1)).sensing(row.earth_mt())
    error = sensing(measured.q.unsqueeze(1)) - measured.readings
    assert float(error.square().mean().sqrt()) < 3e-3
    without = LinearisedSensing(sensing.robot, sensing.moments, sensing.gain)(measured.q.unsqueeze(1))
    assert float((without - measured.readings).square().mean().sqrt()) > 0.03


@pytest.mark.parametrize("n", [1, 2, 3])
def test_exact_model_on_exact_readings(n):
    assert float(consistency(n).max()) <= 0.005
    assert worst_cold_start_mm(n, starts=200) < 0.001


def test_covariance_ellipsoids():
    found = coverage(1)
    assert found["trials"] == 2000
    assert 93 <= found["inside_95_percent_ellipsoid"] <= 97


def test_checks_tell_how_many_truths_were_tried():
    """Of those drawn, the ones far enough inside the bounds; with three segments fewer than with one."""
    one, three = (checks(n, starts=2, trials=5)["kept_percent"].item() for n in (1, 3))
    assert three < one < 100


def test_two_sensors_per_segment_leave_bending_out_of_their_plane_open():
    found = observability(BY_NAME["n_s=6"]).query("where == 'T3'")
    lost = found[found["unobservable_percent"] == 100]
    assert len(lost) == 3
    assert all(part.startswith("delta_y") for line in lost["mainly"] for part in line.split(", "))
    assert found["mirror_difference_mT"].max() < 1e-6
    assert (found["relative_eigenvalue"][3:] > 1e-3).all()


def test_three_sensors_per_segment_determine_everything():
    found = observability(BY_NAME["n_b=3"])
    assert (found["unobservable_percent"] == 0).all()
    assert found["deviation_percent"].max() < 1


def test_bad_input():
    with pytest.raises(
        InputError, match=r"draws, poses of Config must be at least 1; instead received \(0, 100\)"
    ):
        Config(draws=0)
