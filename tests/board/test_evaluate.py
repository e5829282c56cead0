"""What track, calibrate and evaluate do with files; the lag between readings and a motion."""

import re
from contextlib import closing, nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import repro
from repro import InputError
from repro.estimators.calibration import Calibration
from repro.estimators.drift import Drift, Drifting, DriftModel
from repro.estimators.track import Trajectory
from repro.motion_files import Poses
from repro.readings import Readings
from repro.tolerances import placed
from repro_board import cleaning, report
from repro_board import lag as module
from repro_board.calibrations import _judge, _parameters, _told, by_motion
from repro_board.cli import main
from repro_board.evaluate import (
    _Both,
    _holds,
    _interpolated,
    _pace,
    _Parts,
    _said,
    calibrate_by_motion,
    calibrate_files,
    evaluate_files,
    pose_covariance,
    track_file,
)
from repro_board.lag import Signal, fine_lag, search_lag
from repro_board.record import Note, Writer
from repro_board.wire import encode

DATA = Path(__file__).parent / "data"
RAW = DATA / "robot_raw.toml"
EXAMPLE = repro.example() / "robot.toml"
RATE_HZ, POSES_HZ, LAG_S = 40.0, 100.0, 0.73
RING = """
[stream]
rate_hz = 40.0
unit = "mT"
noise_mt = 2e-3

[[segments]]
kind = "constant_curvature"
length_mm = 110.0
radius_mm = 22.0
delta_x_mm = [-20.0, 20.0]
delta_y_mm = [-20.0, 20.0]
delta_L_mm = LONGER

[[magnets]]
kind = "ring"
segment = 1
at_mm = 55.0
outer_diameter_mm = 24.0
inner_diameter_mm = 12.0
height_mm = 6.0
polarisation_mt = 1450.0
""" + "".join(
    f"""
[[sensors]]
segment = 1
at_mm = 110.0
radial_mm = 13.0
azimuth_deg = {azimuth}
"""
    for azimuth in (0.0, 90.0, 180.0, 270.0)
)
ARM = "[stream]\nrate_hz = 40.0\n" + "".join(
    f"""
[[segments]]
kind = "constant_curvature"
length_mm = 80.0
radius_mm = 12.0
delta_x_mm = [-9.0, 9.0]
delta_y_mm = [-9.0, 9.0]
delta_L_mm = 0.0

[[imus]]
segment = {k}
at_mm = 60.0
channels = ["qx_{k}", "qy_{k}", "qz_{k}", "qw_{k}"]
"""
    for k in (1, 2)
)


def robot_file(folder: Path, text: str = RING, longer: str = "[0.0, 8.0]") -> Path:
    path = folder / "robot.toml"
    path.write_text(text.replace("LONGER", longer), encoding="utf-8")
    return path


def shapes(robot: Any, t: np.ndarray, seed: int = 0) -> np.ndarray:
    """A motion without a period, over most of the bounds."""
    rng = np.random.default_rng(seed)
    waves = [
        np.sin(rng.uniform(0.5, 2.2, robot.n_q) * t[:, None] + rng.uniform(0, 6, robot.n_q)) for _ in range(4)
    ]
    return (robot.lower + robot.upper) / 2 + (robot.upper - robot.lower) / 2 * np.mean(waves, axis=0)


def write_table(path: Path, times: Any, columns: list[str], values: np.ndarray) -> Path:
    frame = pd.DataFrame(values, columns=columns)
    if times is not None:
        frame.insert(0, "time_s", times)
    frame.to_csv(path, index=False, float_format="%.7g")
    return path


def read(robot: repro.Robot, q: np.ndarray, seed: int = 1) -> np.ndarray:
    """Readings of a robot whose gains and offsets are off."""
    rng = np.random.default_rng(seed)
    u = robot.sensing()(q)
    off = 1 + 0.03 * rng.normal(size=u.shape[1])
    return off * u + 0.1 * rng.normal(size=u.shape[1]) + robot.noise * rng.normal(size=u.shape)


def recording(folder: Path, robot: repro.Robot, seconds: float = 30.0) -> tuple[Path, Path]:
    """Readings, and poses by a clock that is behind by the lag; pose noise of 0.1 mm."""
    t, times = np.arange(0, seconds, 1 / RATE_HZ), np.arange(0, seconds, 1 / POSES_HZ)
    readings = write_table(
        folder / "readings.csv", t, [f"u{k}_mT" for k in range(1, robot.n_readings + 1)],
        read(robot, shapes(robot, t)),
    )  # fmt: skip
    names = [f"{name}_mm" for name in robot.coordinates]
    noise = np.random.default_rng(2).normal(size=(len(times), robot.n_q)) * 0.1 * ~robot.fixed
    return readings, write_table(
        folder / "poses.csv", times, names, 1e3 * shapes(robot, times + LAG_S) + noise
    )


def tip_error(table: Any, name: str) -> float:
    rows = table[(table["estimate"] == name) & (table["quantity"] == "tip")]
    return float(rows["mean"].iloc[0])


LM = "calibrated, levenberg marquardt"


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> tuple[Path, Path, Path, report.Report]:
    folder = tmp_path_factory.mktemp("good")
    path = robot_file(folder)
    readings, poses = recording(folder, repro.load_robot(path))
    return path, readings, poses, evaluate_files(readings, poses, path, folder / "out")


def test_an_evaluation_finds_the_lag_and_what_is_off(good):
    path, _, _, report = good
    table, folder = report.found, path.parent / "out"
    lag, error = (float(x) for x in str(report).split("Lag: ")[1].split(" ms")[0].split(" ± "))
    assert lag == pytest.approx(1e3 * LAG_S, abs=max(4 * error, 0.5))
    assert error < 2.0
    assert tip_error(table, LM) < 0.3 * tip_error(table, "as described, levenberg marquardt")
    coverage = table[table["estimate"] == LM]["coverage"]
    assert coverage.min() > 90.0
    assert {x.name for x in folder.iterdir()} == {
        "calibration.json", "errors.csv", "estimates.csv", "estimates.png", "report.txt",
    }  # fmt: skip
    assert (folder / "report.txt").read_text(encoding="utf-8").strip() in str(report)
    moved = repro.load_robot(path, folder / "calibration.json")
    assert moved.sensors[0].gain != repro.load_robot(path).sensors[0].gain
    estimates = pd.read_csv(folder / "estimates.csv")
    assert f"{LM}: delta_x_1_mm" in estimates
    assert len(estimates) == table["rows"].max()


def estimates(robot: Any, q: Any, covariance: Any = None) -> Trajectory:
    q = np.array(q, dtype=float)
    n = np.full(len(q), np.nan)
    C = None if covariance is None else np.tile(covariance, (len(q), 1, 1))
    return Trajectory(np.arange(float(len(q))), q, C, q, n, n, n, robot=robot)


def test_errors_of_1_and_7_mm_have_a_mean_of_4_and_a_root_mean_square_of_5():
    """A straight robot is 7 mm longer than measured, and 1 mm shorter: ± 0.6 mm beside a pose known to 0.8."""
    robot, one = repro.Robot([repro.ConstantCurvature(0.11, 0.022)]), 1e-6 * np.eye(3)
    shapes = {"a": estimates(robot, [[0, 0, -1e-3], [0, 0, 7e-3], [0, 0, np.nan]], 0.36 * one)}
    shapes |= {"b": estimates(robot, np.zeros((3, 3))), "c": estimates(robot, np.zeros((3, 3)), one)}
    table = report.errors_table(estimates(robot, np.zeros((3, 3))), 0.64 * one, shapes)
    rows = table.set_index(["estimate", "quantity"]).drop(columns="unit")
    grown = np.sqrt((1 + 0.95 * 48) / 3.841459)  # of the squares 1 and 49, one degree of freedom
    np.testing.assert_allclose(rows.loc[("a", "delta_L_1")], [4, 5, 7, 6.7, 50, grown, 2], rtol=1e-6)
    tip = [4, 5, 7, 6.7, 50, grown * np.sqrt(3.841459 / 7.814728), 2]
    np.testing.assert_allclose(rows.loc[("a", "tip")], tip, rtol=1e-6)
    np.testing.assert_array_equal(rows.loc[("b", "tip")], [0, 0, 0, 0, np.nan, np.nan, 3])
    np.testing.assert_array_equal(rows.loc[("c", "tip")], [0, 0, 0, 0, 100, 0, 3])
    assert list(table["unit"]) == ["mm"] * 12


def test_a_tip_that_only_one_coordinate_moves_has_the_region_of_one_degree_of_freedom():
    """Deviations of 2.2 are outside of it; with three degrees of freedom 2.7 would be inside."""
    robot = repro.Robot([repro.ConstantCurvature(0.11, 0.022)], lower=[0, 0, -0.01], upper=[0, 0, 0.01])
    shapes = {"a": estimates(robot, [[0, 0, 2.2e-3]], np.diag([0.0, 0.0, 1e-6]))}
    table = report.errors_table(estimates(robot, np.zeros((1, 3))), np.zeros((3, 3)), shapes)
    assert table["coverage"].tolist() == [0.0, 0.0]


def test_angles_are_in_degrees_and_go_the_short_way_round():
    """179 and -179 degrees are two apart; a quarter turn reads 90."""
    robot = repro.Robot([repro.AffineCurvature(0.2), repro.BallJoint("x")])
    q = np.radians([[30.0, 0.0, 90.0, 0.0, -45.0], [30.0, 0.0, 179.0, 0.0, 0.0]])
    frame = estimates(robot, q, np.diag(np.radians([1.0, 1.0, 2.0, 1.0, 3.0]) ** 2)).to_frame()
    named = frame[["kappa_0_1_rad", "phi_1_deg", "rotation_x_2_deg", "phi_1_sd_deg", "rotation_x_2_sd_deg"]]
    np.testing.assert_allclose(named.iloc[0], [np.pi / 6, 90, -45, 2, 3])
    turned = np.where(np.arange(5) == 2, np.radians([[92.0], [-179.0]]), q)
    table = report.errors_table(estimates(robot, q), np.eye(5), {"a": estimates(robot, turned)})
    phi = table[table["quantity"] == "phi_1"].iloc[0]
    np.testing.assert_allclose([phi["mean"], phi["rmse"], phi["largest"]], 2.0)
    assert phi["unit"] == "deg"


def test_the_deviation_of_a_lag_is_that_of_a_median_of_twelve():
    """A robot that reads its coordinate, at constant speed, and is 1 ms early or late in turn."""

    class Plain:
        difference = staticmethod(np.subtract)

        def __call__(self, q):
            return q

    t = 1.0 + 0.01 * np.arange(1200)
    late = np.where(np.arange(1200) // 100 % 2, 1e-3, -1e-3)
    motion = Signal.of(np.arange(0, 16, 0.01), np.arange(0, 16, 0.01)[:, None])
    lag, error = fine_lag(Plain(), motion, t, (t - 0.5 - late)[:, None], 0.5)
    assert lag == pytest.approx(0.5, abs=1e-6)
    assert error == pytest.approx(1.2533e-3 / np.sqrt(12), rel=1e-3)


def test_readings_of_noise_alone_do_not_hide_a_lag():
    """One reading moves and five only have their noise, as an IMU on the base."""
    q, t = motion(4000), np.arange(4000) / 40
    rng = np.random.default_rng(2)
    u = np.column_stack([np.roll(q[:, 0], 60), rng.normal(size=(4000, 5))])
    signals, noise = (Signal.of(t, q), Signal.of(t[60:], u[60:])), np.r_[0.01, np.ones(5)]
    assert module.clock_lag(*signals, 5.0, noise) == pytest.approx(1.5, abs=0.03)
    with pytest.raises(InputError, match="of one motion"):
        module.clock_lag(*signals, 5.0, np.zeros(6))


@pytest.mark.parametrize("share", [0.45, 0.55])
def test_readings_of_which_half_is_unexplained_are_of_no_motion(share):
    """Which is said; lines explain all of a line, nothing of its mirror."""
    q, t = motion(4000), np.arange(4000) / 40
    u = np.sqrt(1 - share**2) * q[:, :1] + share * np.random.default_rng(1).normal(size=(4000, 1))
    words = "of one motion; instead received (54|55|56)% of the readings"
    with pytest.raises(InputError, match=words) if share > 0.5 else nullcontext():
        assert module.clock_lag(Signal.of(t, q), Signal.of(t, u), 5.0, np.zeros(1)) == pytest.approx(
            0.0, abs=0.03
        )
    for x, left in ((3 * q[:, :1] + 1, 0.0), (-q[:, :1], 1.0), (u, share**2)):
        assert module.unexplained(x, q[:, :1]) == pytest.approx(left, abs=0.03)


def test_a_lag_is_told_if_another_one_leaves_a_tenth_more():
    """A motion that repeats itself every 5 s, but for one reading that wanders; and noise."""
    t, ratios = np.arange(4000) / 40, []
    x = np.column_stack([np.sin(2 * np.pi * t / 5), np.cos(4 * np.pi * t / 5), motion(4000)[:, 0]])
    for size in (0.05, 0.15, 0.25, 0.35, 0.6, 1.2):
        u = x * [1, 1, size] @ np.ones((3, 3)) + 0.3 * np.random.default_rng(1).normal(size=(4000, 3))
        found = search_lag(x, u / u.std(axis=0), 40, 12.0)
        ratios.append(found.other / found.best)
        with nullcontext() if ratios[-1] > 1.1 else pytest.raises(InputError, match="alike at one lag only"):
            assert module.clock_lag(Signal.of(t, x), Signal.of(t, u), 12.0, np.zeros(3)) == 0.0
    assert [min(abs(np.array(ratios) - x)) < 0.1 for x in (1.05, 1.2)] == [True, True], ratios


@pytest.mark.parametrize("gone", [199, 200])
def test_most_frames_have_a_pose_and_readings(gone):
    for k in range(2):
        both = [motion(400), readings(motion(400))]
        both[k][:gone] = np.nan
        with (
            pytest.raises(InputError, match=f"there in most frames; .* {gone} of 400")
            if gone > 199
            else nullcontext()
        ):
            assert search_lag(*both, 40).lag_s == 0.0


@pytest.mark.parametrize(("unexplained", "lag_s"), [(0.15, 3.0), (0.4, 0.0)])
def test_a_lag_of_held_poses_that_leaves_more_than_a_quarter_of_the_readings_is_none(unexplained, lag_s):
    """Sixteen holds of 1.6 s by a clock that is 3 s behind, and noise with a share of the square of the readings."""
    robot, rng = repro.load_robot(EXAMPLE), np.random.default_rng(0)
    q = robot.lower + (robot.upper - robot.lower) * rng.uniform(0.05, 0.95, (16, robot.n_q))
    u = read(robot, q)
    u = u + np.sqrt(unexplained / (1 - unexplained)) * u.std(0) * rng.normal(size=u.shape)
    t, held = np.arange(0, 32, 1 / 40), 2.0 * np.arange(16)[:, None] + [0.2, 1.8]
    found = module.held_lag(robot, q, held - 3.0, t, u[(t / 2).astype(int)], [])
    assert found == pytest.approx(lag_s, abs=0.06)


def test_residuals_of_a_calibration_are_root_mean_squares():
    """Two sensors that are off by 3 and 4 mT: 5 by the root of 2."""
    robot = repro.load_robot(RAW)
    named = replace(robot.sensors[0], name="left")
    robot = robot.replaced(sensors=[named, robot.sensors[1]], noise=1.0)
    off = {"sensor 1 offset": 3.0, "sensor 2 offset": 4.0}
    found = Calibration(
        placed(robot, off), robot, tuple(off), np.array([3.0, 4.0]), np.array([0.91, 0.89]), np.ones(2), np.eye(2),
        1.0, 9, 1.0, 1.0, np.zeros((2, 2)),
    )  # fmt: skip
    q = shapes(robot, np.arange(9.0))
    text = report.calibration_report(found, q, robot.sensing()(q))
    assert "mT as described, 3.54 mT calibrated." in text
    assert "1 parameters stay as uncertain as before: left offset" in text


@pytest.mark.parametrize(
    ("worst", "words"),
    [(20.0, "known to ±10 mm in most rows, ±20 mm in the worst"), (999.0, "known to ±10 mm in most rows, ±1e+03 mm"),
     (1000.0, "known to ±10 mm in most rows")],
)  # fmt: skip
def test_how_well_the_tip_is_known_is_a_length_over_three_axes(worst, words):
    """Rows of 5 and 10 mm, by the triangle with sides 3, 4 and 5, and a worst one, which a metre makes unknown."""
    names = [f"tip_{axis}_sd_mm" for axis in "xyz"]
    frame = pd.DataFrame([[3.0, 0.0, 4.0], [6.0, 8.0, 0.0], [worst, 0.0, 0.0]], columns=names)
    said = report.tip_known(frame)
    assert said.startswith(f"tip: {words}")
    assert ("worst" in said) == (worst < 1000)
    assert report.tip_known(100 * frame[1:]) == "tip: not known in most rows"


def test_a_deviation_that_is_stated_half_too_small_must_grow_twofold():
    rng, robot = np.random.default_rng(1), repro.Robot([repro.ConstantCurvature(0.11, 0.022)])
    q, n = 0.005 + 1e-3 * rng.standard_normal((4000, 3)), np.full(4000, np.nan)
    error = rng.multivariate_normal(np.zeros(3), C := np.diag([1e-4, 2e-4, 3e-4]) ** 2, 4000)
    of = {"times": np.arange(4000.0), "u_hat": q, "chi2": n, "dof": n, "missing": n, "robot": robot}
    truth, found = (
        Trajectory(q=q, covariance=None, **of),
        Trajectory(q=q + error, covariance=C[None] / 4 + 0 * q[..., None], **of),
    )
    table = report.errors_table(truth, np.zeros((3, 3)), {"one": found})
    assert table["grown"].to_numpy() == pytest.approx(2.0, rel=0.06)


def gaps(q: np.ndarray) -> np.ndarray:
    """Two per cent of the frames are lost, in gaps of four."""
    for start in np.random.default_rng(3).choice(len(q) // 8, len(q) // 200, replace=False) * 8:
        q[start : start + 4] = np.nan
    return q


def short_holds(q: np.ndarray) -> np.ndarray:
    for start in np.random.default_rng(3).choice(len(q) // 8, len(q) // 200, replace=False) * 8:
        q[start : start + 4] = q[start]
    return q


def frozen(q: np.ndarray) -> np.ndarray:
    q[1900:2200] = q[1900]
    return q


def one_spike(q: np.ndarray) -> np.ndarray:
    q[400] += [9.0, -9.0, 0.0]
    return q


@pytest.mark.parametrize(
    ("spoilt", "words"),
    [(gaps, "have no pose"), (short_holds, "while the readings move: left out, from 1.13 s,"),
     (frozen, "repeat the one before"), (one_spike, "do not go with their poses")],
)  # fmt: skip
def test_bad_samples_of_the_motion_capture_change_the_error_by_less_than_a_twentieth(
    good, spoilt, words, tmp_path
):
    path, readings, poses, report = good
    frame = pd.read_csv(poses)
    values = spoilt(frame.iloc[:, 1:].to_numpy().copy())
    spoilt_poses = write_table(tmp_path / "p.csv", frame["time_s"], list(frame.columns[1:]), values)
    found = evaluate_files(readings, spoilt_poses, path, tmp_path / "out")
    assert tip_error(found.found, LM) == pytest.approx(tip_error(report.found, LM), rel=0.05)
    assert words in str(found)


@pytest.mark.parametrize(
    ("rows", "columns"), [(slice(400, 404), slice(0, 4)), (slice(900, 901), slice(1, 2))]
)
def test_errors_of_the_bus_in_the_readings_leave_lag_and_calibration_alone(good, rows, columns, tmp_path):
    path, readings, poses, report = good
    frame = pd.read_csv(readings)
    values = frame.iloc[:, 1:].to_numpy().copy()
    values[rows, columns] = -266.24
    spoilt = write_table(tmp_path / "u.csv", frame["time_s"], list(frame.columns[1:]), values)
    found = evaluate_files(spoilt, poses, path, tmp_path / "out")
    n, of = values[rows, columns].size, rows.stop - rows.start
    assert f"calibration: {n} in {of} of 1200 rows, from {rows.start / 40:.2f} s." in str(found)
    assert float(str(found).split("Lag: ")[1].split(" ")[0]) == pytest.approx(1e3 * LAG_S, abs=3)
    assert tip_error(found.found, LM) == pytest.approx(tip_error(report.found, LM), rel=0.05)


def test_only_what_no_pose_explains_is_an_error_of_the_bus():
    """A robot that rests for most of the time, then with a tenth of garbage: all readings stay, all garbage goes."""
    robot, t = repro.load_robot(EXAMPLE), np.arange(400) / 40
    q = np.where(np.arange(400)[:, None] > 300, shapes(robot, t), shapes(robot, 0 * t))
    u, lines = robot.sensing()(q), list[str]()
    np.testing.assert_array_equal(cleaning.without_spikes(robot, q, u, t, lines), u)
    assert not lines
    spoilt = u.copy()
    spoilt[::10, 2] = 3e4
    found = cleaning.without_spikes(robot, q, spoilt, t, lines)
    np.testing.assert_array_equal(np.isnan(found), spoilt == 3e4)
    assert lines[0].endswith(
        "calibration: 40 in 40 of 400 rows, from 0.00 s, 0.25 s, 0.50 s, 0.75 s, 1.00 s and 35 more."
    )


def test_poses_a_little_outside_the_bounds_are_left_out_by_their_lines(good, tmp_path):
    path, readings, poses, report = good
    frame = pd.read_csv(poses)
    frame.iloc[800:850, 1] = 21.7
    frame.to_csv(tmp_path / "p.csv", index=False)
    found = evaluate_files(readings, tmp_path / "p.csv", path, tmp_path / "out")
    words = "left out, outside the robot's bounds, for delta_x_1 -20 to 20 mm: 50 of 3000 (lines 802 to 851)."
    assert f"Poses of p.csv {words}" in str(found)
    assert tip_error(found.found, LM) == pytest.approx(tip_error(report.found, LM), rel=0.05)
    frame.iloc[::2, 1] = 21.7
    frame.iloc[:10, 1] = 21.7
    frame.to_csv(tmp_path / "p.csv", index=False)
    with pytest.raises(
        InputError, match=r"delta_x_1 of p.csv must be within the robot's bounds.*15\d\d of 3000 poses"
    ):
        evaluate_files(readings, tmp_path / "p.csv", path, tmp_path / "other")


def test_an_arm_that_hangs_is_evaluated_by_the_command(good, tmp_path, capsys):
    """A body with the axes of the room, z up; the arm points down, and x of its base along -y of the room."""
    path, robot = good[0], repro.load_robot(good[0])
    t, times = np.arange(0, 18, 1 / RATE_HZ), np.arange(0, 18, 1 / 30)
    q, course = (np.clip(x - 2, 0, 1)[:, None] * shapes(robot, x) for x in (t, times + LAG_S))
    u = write_table(tmp_path / "u.csv", t, [f"u{k}_mT" for k in range(1, 5)], read(robot, q))
    R, T = np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]]), robot.tip(course)
    turn, p = (
        Rotation.from_matrix(R @ T[:, :3, :3] @ R.T).as_quat(),
        1e3 * T[:, :3, 3] @ R.T + [100, -300, 1200],
    )
    names = ["x_1_mm", "y_1_mm", "z_1_mm", "qx_1", "qy_1", "qz_1", "qw_1"]
    poses = write_table(tmp_path / "p.csv", times, names, np.concatenate([p, turn], axis=1))
    words = [
        "evaluate",
        str(u),
        str(poses),
        "--robot",
        str(path),
        "-o",
        str(tmp_path / "out"),
        "--straight-s",
        "1",
    ]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "the straight robot points along -z, and x of its base along +x." in said
    assert (
        "The base is taken as turned by 90 deg about the straight robot: 0% of the readings unexplained"
        in said
    )
    assert tip_error(pd.read_csv(tmp_path / "out" / "errors.csv"), LM) < 0.5


def test_a_pose_that_was_left_out_stays_out_where_the_base_is_turned(good):
    robot, lines = repro.load_robot(good[0]), list[str]()
    q = shapes(robot, np.arange(40.0))
    turned = q[:, [1, 0, 2]] * [-1, 1, 1]
    u, expected = robot.sensing()(turned), turned.copy()
    q[3] = expected[3] = np.nan
    found = module.in_axes_of_the_readings(robot, q, {90: turned, 180: -q}, u, lines)
    np.testing.assert_array_equal(found, expected)
    assert lines[0].startswith("The base is taken as turned by 90 deg about the straight robot: 0% of the")


def test_a_robot_at_rest_is_not_taken_for_a_frozen_capture(good, tmp_path):
    path, _, poses, _ = good
    frame, robot = pd.read_csv(poses), repro.load_robot(path)
    t = np.arange(0, 30, 1 / RATE_HZ)
    stop = np.where(t < 12, t, np.maximum(t - 1, 12))  # stands for a second
    readings = write_table(
        tmp_path / "u.csv", t, [f"u{k}_mT" for k in range(1, 5)], read(robot, shapes(robot, stop))
    )
    at = frame["time_s"].to_numpy() + LAG_S
    at = np.where(at < 12, at, np.maximum(at - 1, 12))
    poses = write_table(
        tmp_path / "p.csv", frame["time_s"], list(frame.columns[1:]), (1e3 * shapes(robot, at)).round(4)
    )
    q = pd.read_csv(poses).iloc[:, 1:].to_numpy() / 1e3
    u = pd.read_csv(readings).iloc[:, 1:].to_numpy()
    repeats = cleaning.repeats(q)
    assert repeats.sum() > 90
    assert not cleaning.frozen(q, frame["time_s"].to_numpy() + LAG_S, t, u, robot.noise).any()
    held = q.copy()
    held[1500:1530] = held[1500]
    found = cleaning.frozen(held, frame["time_s"].to_numpy() + LAG_S, t, u, robot.noise)
    np.testing.assert_array_equal(np.flatnonzero(found), np.arange(1501, 1530))


def test_clocks_that_drift_are_told(good, tmp_path):
    path, readings, poses, _ = good
    frame = pd.read_csv(poses)
    frame.assign(time_s=1.001 * frame["time_s"]).to_csv(tmp_path / "p.csv", index=False)
    text = str(evaluate_files(readings, tmp_path / "p.csv", path, tmp_path / "out"))
    drift = float(text.split("clocks drift (")[1].split(" ppm")[0])
    assert drift == pytest.approx(-1000, rel=0.15)


def test_clocks_without_a_time_in_common_are_counted_from_their_first_rows(good, tmp_path):
    """So are notes: the sensors of the robot begin two seconds after another device."""
    path, readings, poses, report = good
    frame = pd.read_csv(poses)
    frame.assign(time_s=frame["time_s"] + 1000).to_csv(tmp_path / "p.csv", index=False)
    with closing(Writer(tmp_path / "a.rec", {"format": "frames"})) as writer:
        writer.write(0, encode([1.0], stream=9))
        for k, row in enumerate(pd.read_csv(readings).to_numpy()):
            writer.write(round(1e9 * (2 + row[0])), encode(row[1:], 0, k, round(1e6 * (2 + row[0]))))
        writer.note(12_000_000_000, "load on")
    found = evaluate_files(tmp_path / "a.rec", tmp_path / "p.csv", path, tmp_path / "out")
    assert "no time in common" in str(found)
    assert "   1     10.00  load on" in str(found)
    assert tip_error(found.found, LM) == pytest.approx(tip_error(report.found, LM), rel=0.02)


def test_what_is_no_one_motion_or_no_one_lag_is_refused(good, tmp_path):
    path, readings, poses, _ = good
    frame, robot = pd.read_csv(poses), repro.load_robot(path)
    times, names = frame["time_s"].to_numpy(), list(frame.columns[1:])
    other = write_table(tmp_path / "other.csv", times, names, 1e3 * shapes(robot, times, seed=9))
    with pytest.raises(InputError, match="readings and poses of repro evaluate must be of one motion"):
        evaluate_files(readings, other, path, tmp_path / "out")
    with pytest.raises(
        InputError, match="of clocks that differ by less than 0.5 s.*at the end of the search"
    ):
        evaluate_files(readings, poses, path, tmp_path / "out", longest_lag_s=0.5)
    with pytest.raises(InputError, match="together for 5 s in the first part"):
        evaluate_files(readings, poses, path, tmp_path / "out", share=0.05)
    again = np.stack([np.sin(2 * np.pi * times / 4 + x) for x in (0, 1, 2)], axis=1) * [9, 9, 3] + [0, 0, 4]
    t = np.arange(0, 30, 1 / RATE_HZ)
    q = np.stack([np.interp(t, times, x) for x in again.T / 1e3], axis=1)
    u = write_table(tmp_path / "u.csv", t, [f"u{k}_mT" for k in range(1, 5)], read(robot, q))
    circle = write_table(tmp_path / "circle.csv", times, names, again)
    with pytest.raises(InputError, match="alike at one lag only.*--longest-lag.*and elsewhere too"):
        evaluate_files(u, circle, path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_note_is_marked_in_the_picture_if_it_is_of_its_time():
    """By its number, as a note may be long, and its letters may be missing in the font."""
    rows = np.arange(10.0)
    columns = ("time_s", "bend_deg", *(f"tip_{axis}_mm" for axis in "xyz"))
    frames = {"measured": pd.DataFrame(dict.fromkeys(columns, rows))}
    plain, *marked = (
        report.picture(frames, [("bend", "deg", 1.0)], notes)
        for notes in (
            [], [Note(-0.1, "a"), Note(9.1, "b")], [Note(4.0, "$x")], [Note(11.0, "b"), Note(4.0, "$x")],
            [Note(0.0, "a")], [Note(9.0, "b")],
        )
    )  # fmt: skip
    assert marked[0] == plain
    assert len({plain, *marked[1:]}) == 5
    assert report.notes_in_words([Note(4.0, "$x"), Note(123.456, "load on")])[1:] == [
        "   1      4.00  $x",
        "   2    123.46  load on",
    ]


def test_what_is_missing_in_every_row_is_named(good, tmp_path):
    path, readings, poses, _ = good
    for kind, name, label in (("readings", "u2_mT", "sensor 2"), ("poses", "delta_L_1_mm", "delta_L_1")):
        files = {"readings": readings, "poses": poses}
        frame = pd.read_csv(files[kind]).assign(**{name: np.nan})
        frame.to_csv(tmp_path / f"{kind}.csv", index=False)
        files[kind] = tmp_path / f"{kind}.csv"
        with pytest.raises(
            InputError, match=f"{kind} of repro evaluate must be complete in 3.*without {label}"
        ):
            evaluate_files(*files.values(), path, tmp_path / "out")


def test_where_two_coordinates_move_readings_are_interpolated_too(tmp_path):
    path = robot_file(tmp_path, longer="3.0")
    readings, poses = recording(tmp_path, repro.load_robot(path), seconds=40.0)
    table = evaluate_files(readings, poses, path, tmp_path / "out").found
    plain, ours = tip_error(table, "readings interpolated"), tip_error(table, LM)
    assert 0.5 * ours < plain < 3 * ours
    assert set(table["quantity"]) == {"tip", "delta_x_1", "delta_y_1"}


def test_mountings_and_frames_of_imus_are_calibrated(tmp_path):
    path = robot_file(tmp_path, ARM)
    robot = repro.load_robot(path)
    t, times = np.arange(0, 30, 1 / RATE_HZ), np.arange(0, 30, 1 / POSES_HZ)
    rng, columns, names = np.random.default_rng(0), [], []
    frame = Rotation.from_euler("z", 25, degrees=True)  # magnetic north is elsewhere
    for k, imu in enumerate(robot.imus, 1):
        mounted = Rotation.from_euler("xyz", [4 * k, -3, 5], degrees=True)
        R = Rotation.from_matrix(robot.poses(shapes(robot, t), [imu.place])[:, 0, :3, :3])
        noise = Rotation.from_rotvec(np.radians(0.2) * rng.normal(size=(len(t), 3)))
        columns.append((frame * R * mounted * noise).as_quat())
        names += [f"q{axis}_{k}" for axis in "xyzw"]
    readings = write_table(tmp_path / "u.csv", t, names, np.concatenate(columns, axis=1))
    q = 1e3 * shapes(robot, times + LAG_S)
    poses = write_table(tmp_path / "p.csv", times, [f"{name}_mm" for name in robot.coordinates], q)
    report = evaluate_files(readings, poses, path, tmp_path / "out")
    assert tip_error(report.found, LM) < 0.5
    assert tip_error(report.found, "as described, levenberg marquardt") > 10
    angles = [float(x) for x in str(report).split("off by ")[1].split(" deg")[0].split(" and ")]
    assert angles == pytest.approx(
        [np.sqrt(4**2 + 3**2 + 5**2), 25.0], abs=0.6
    )  # small turns about three axes
    stated = str(report).split("mounted = [")[2].split("]")[0]  # of the second
    off = (
        Rotation.from_quat([float(x) for x in stated.split(",")])
        * Rotation.from_euler("xyz", [8, -3, 5], degrees=True).inv()
    )
    assert np.degrees(off.magnitude()) < 0.5
    assert not (tmp_path / "out" / "calibration.json").exists()


def test_the_refined_lag_ignores_a_bad_second_and_noise():
    robot = repro.load_robot(EXAMPLE)
    t, times = np.arange(0, 30, 0.04), np.arange(0, 30, 0.01)
    u = robot.sensing()(shapes(robot, t)) + 0.005 * np.random.default_rng(0).normal(size=(len(t), 12))
    q = shapes(robot, times + 0.123)
    q[1000:1100] = q[1000]
    lag, error = fine_lag(robot.sensing(), Signal.of(times, q), t, u, 0.11)
    assert lag == pytest.approx(0.123, abs=4e-4)
    assert error < 5e-3


def test_signals_are_not_interpolated_over_gaps():
    signal = Signal.of(np.arange(6) / 10, np.array([[0.0], [1.0], [np.nan], [3.0], [np.nan], [np.nan]]))
    np.testing.assert_allclose(
        signal.at(np.array([-0.01, 0.05, 0.2, 0.3, 0.31]))[:, 0], [np.nan, 0.5, 2.0, 3.0, np.nan]
    )
    wide = Signal.of(np.arange(8) / 10, np.array([[0.0], [1], [np.nan], [np.nan], [4], [5], [6], [7]]))
    assert np.isnan(wide.at(np.array([0.25]))).all()
    assert wide.at(np.array([0.45]))[0, 0] == pytest.approx(4.5)


def example_readings(folder: Path, seconds: float = 20.0) -> tuple[Path, np.ndarray, np.ndarray]:
    robot = repro.load_robot(EXAMPLE)
    t = np.arange(0, seconds, 1 / 25)
    q = shapes(robot, t)
    u = robot.sensing()(q) + 0.005 * np.random.default_rng(0).normal(size=(len(t), 12))
    return write_table(folder / "u.csv", t, list(robot.names), u), q, u


def rewritten(path: Path, change) -> Path:
    frame = pd.read_csv(path)
    change(frame)
    frame.to_csv(path, index=False)
    return path


@pytest.mark.parametrize("smooth", [False, True])
def test_an_unplugged_chip_is_named_in_a_sentence_and_left_out(tmp_path, smooth):
    path, q, _ = example_readings(tmp_path)
    robot = repro.load_robot(EXAMPLE)

    def unplug(frame):
        frame.loc[200:399, ["B2x", "B2y", "B2z"]] = 0.0

    report = track_file(rewritten(path, unplug), EXAMPLE, smooth=smooth, output=tmp_path / "shape.csv")
    last = str(report).splitlines()[-1]
    assert last.startswith("Suspected: B2 does not fit the other sensors in ")
    assert last.endswith(" s.")
    assert 8.0 <= float(last.split("from ")[1].split(" to ")[0]) < 9.0
    assert "to 15.960 s" in last
    away = np.linalg.norm(robot.tip(report.found.q)[:, :3, 3] - robot.tip(q)[:, :3, 3], axis=1)
    assert np.median(away[200:400]) < 2.5e-3
    assert away.max() < 15e-3
    frame = pd.read_csv(tmp_path / "shape.csv", keep_default_na=False)
    assert len(frame) == 500
    assert "B2" in set(frame["suspects"])
    assert set(frame["status"]) <= {"consistent", "left out", "inconsistent"}


def test_failed_sensors_are_not_used(tmp_path):
    path, _, u = example_readings(tmp_path, 4.0)
    found = track_file(path, EXAMPLE, failed=["B2"]).found
    np.testing.assert_array_equal(np.isnan(found.readings).any(0), np.arange(12) // 3 == 1)
    np.testing.assert_array_equal(found.q, track_file(path, EXAMPLE, failed=["2"]).found.q)
    with pytest.raises(InputError, match=r"sensor of repro track must be one of B1 \(1\), .*B4 \(4\); .* 5"):
        track_file(path, EXAMPLE, failed=[5])
    assert u.shape == (100, 12)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"estimator": "magic"}, "estimator of repro track must be one of levenberg_marquardt"),
     ({"estimator": "levenberg_marquardt", "smooth": True}, "must be kalman with --smooth; instead received leven"),
     ({"output": "u.csv"}, "output of repro track must be one that does not exist yet; instead received u.csv"),
     ({"output": "no/such/shape.csv"}, "must be in a folder that exists")],
)  # fmt: skip
def test_options_of_tracking_that_cannot_be_are_refused(tmp_path, options, message):
    path, _, _ = example_readings(tmp_path, 2.0)
    if "output" in options:
        options = {"output": tmp_path / options["output"]}
    with pytest.raises(InputError, match=re.escape(message)):
        track_file(path, EXAMPLE, **options)


def test_odd_times_and_a_robot_without_spare_readings_are_told(tmp_path):
    """A unit of times that is wrong, a hole, no times at all; and that nothing can be checked."""
    path = robot_file(tmp_path)
    robot = repro.load_robot(path)
    t = np.arange(60) / RATE_HZ
    u, names = robot.sensing()(shapes(robot, t)), [f"u{k}_mT" for k in range(1, 5)]
    for times, words in (
        (1e-3 * t, "are 2.5e-05 s apart, but the robot file says 40 readings in a second: is the unit"),
        (0.19 * t, "are 0.00475 s apart, but the robot file says 40 readings in a second: is the unit"),
        (5.2 * t, "are 0.13 s apart, but the robot file says 40 readings in a second: is the unit"),
        (np.where(t > t[30], t + 2, t), "The longest gap without a reading is 2.02 s, after 0.750 s."),
    ):
        assert words in str(track_file(write_table(tmp_path / "a.csv", times, names, u), path))
    slow = robot_file(tmp_path, RING.replace("rate_hz", "# rate_hz"))
    assert "rows count as one second" in str(
        track_file(write_table(tmp_path / "a.csv", None, names, u), slow)
    )
    assert "All rows are consistent" in report.suspicions(repro.track(repro.LevenbergMarquardt(robot), u))[-1]
    alone = repro.LevenbergMarquardt(robot.replaced(sensors=robot.sensors[:3], noise=0.01))
    assert "the fit uses up all readings" in report.suspicions(repro.track(alone, u[:, :3]))[0]


@pytest.mark.parametrize(
    ("step_s", "gap_s", "words"),
    [
        (0.1, 0.24, ""),
        (0.1, 0.26, "The longest gap without a reading is 0.26 s"),
        (0.04, 0.19, ""),  # what a computer may do meanwhile
        (0.04, 0.21, "The longest gap without a reading is 0.21 s"),
        (0.021, 0.021, ""),
        (0.019, 0.019, "is the unit of the times right"),
        (0.49, 0.49, ""),
        (0.51, 0.51, "is the unit of the times right"),
    ],
)
def test_readings_of_ten_in_a_second_may_be_five_times_as_many_or_few(step_s, gap_s, words):
    times = np.cumsum(np.r_[0.0, np.full(9, step_s), gap_s, np.full(9, step_s)])
    found = _pace(repro.Robot([repro.Link(0.1)], rate_hz=10.0), times)
    assert len(found) == bool(words)
    assert words in "".join(found)


@pytest.mark.parametrize("late", [0.049, 0.051])
def test_poses_of_the_times_of_the_rows_are_those_of_the_rows(late):
    u = np.zeros((5, 2)).view(Readings)
    u.times = np.arange(5.0)
    measured = Poses(u.times + late, np.zeros((5, 1)), range(5), ())
    found = _holds(measured, u, "a")
    if late < 0.05:
        assert found is None
    else:
        np.testing.assert_allclose(found, u.times[:, None] + late + [-0.25, 0.25])


@pytest.mark.parametrize("moved", [9.0, 11.0])
def test_readings_are_interpolated_where_two_coordinates_move_by_more_than_ten_deviations(moved):
    n, robot = 60, repro.Robot([repro.ConstantCurvature(0.1, 0.02)])
    q = np.linspace(0, 1, n)[:, None] ** [1, 2, 3] * [12.0, 12.0, moved]
    parts = _Parts(0.0, 1.0, 2.0, np.arange(n) < n, np.arange(n) % 2 == 1)
    both = _Both(np.arange(n) / 10, q @ np.diag([1.0, 2.0, 3.0]), q, Signal.of(np.arange(n), q), 0.0)
    found = _interpolated(robot, both, parts, q, np.eye(3))
    assert (found is None) == (moved > 10)
    if found is not None:
        np.testing.assert_allclose(found.q, q[1::2], atol=0.5)


@pytest.mark.parametrize(
    ("later_ms", "error_ms", "told"), [(9.0, 0.0, False), (12.0, 2.0, True), (12.0, 3.0, False)]
)
def test_clocks_drift_if_lags_differ_by_half_a_step_and_four_deviations(later_ms, error_ms, told):
    """Poses 20 ms apart; the middles of both parts are 10.5 s apart."""
    both = SimpleNamespace(motion=Signal.of(np.arange(0, 1, 0.02), np.zeros((50, 1))))
    parts = _Parts(0.0, 8.0, 20.0, np.ones(3, bool), np.ones(3, bool))
    fitted = SimpleNamespace(
        lag=0.5, error=1e-3 * error_ms, later=0.5 + 1e-3 * later_ms, later_error=1e-3 * error_ms, words=[]
    )
    lines = _said(both, parts, fitted, np.zeros((3, 1)))
    assert lines[0] == f"Lag: +500.00 ± {error_ms:.2f} ms to be added to the times of the poses."
    assert len(lines) == 2 + told
    assert f"drift ({1e3 * later_ms / 10.5:+.0f} ppm)" in lines[-1] or not told


def test_five_words_are_said_and_the_others_counted():
    assert report.some(range(5)) == "0, 1, 2, 3, 4"
    assert report.some(range(7)) == "0, 1, 2, 3, 4 and 2 more"


def test_tables_keep_large_times_and_are_never_written_over(tmp_path):
    path, _, _ = example_readings(tmp_path, 2.0)
    rewritten(path, lambda frame: frame.insert(0, "time_s", 1.7e9 + frame.pop("time_s")))
    track_file(path, EXAMPLE, output=tmp_path / "shape.csv")
    times = (tmp_path / "shape.csv").read_text(encoding="utf-8").splitlines()[1:3]
    assert [line.split(",")[0] for line in times] == ["1700000000.000000", "1700000000.040000"]


def held_poses(folder: Path, robot: Any, n: int = 20) -> tuple[Path, Path, np.ndarray]:
    """Held poses of 0.4 s, one each second, and readings of a robot whose gains and offsets are off."""
    q = robot.lower + (robot.upper - robot.lower) * np.random.default_rng(4).uniform(
        0.05, 0.95, (n, robot.n_q)
    )
    u = read(robot, np.repeat(q, 10, axis=0))
    t = (np.arange(n)[:, None] + 0.04 * np.arange(10)).ravel()
    readings = write_table(folder / "u.csv", t, [f"u{k}_mT" for k in range(1, robot.n_readings + 1)], u)
    frame = pd.DataFrame(1e3 * q, columns=[f"{name}_mm" for name in robot.coordinates])
    frame.insert(0, "start_s", np.arange(n) - 0.01)
    frame.insert(1, "end_s", np.arange(n) + 0.39)
    frame.to_csv(folder / "poses.csv", index=False)
    return readings, folder / "poses.csv", u


def test_calibration_finds_offsets_and_a_tracked_robot_states_what_it_left_open(tmp_path):
    path = robot_file(tmp_path)
    robot = repro.load_robot(path)
    readings, poses, _ = held_poses(tmp_path, robot)
    report = calibrate_files(readings, poses, path, tmp_path / "c.json")
    found = report.found
    rng = np.random.default_rng(1)
    gains, offsets = 0.03 * rng.normal(size=4), 0.1 * rng.normal(size=4)
    estimate = dict(zip(found.names, zip(found.estimate, found.deviation, strict=True), strict=True))
    for k in range(4):
        for name, truth in ((f"sensor {k + 1} gain", gains[k]), (f"sensor {k + 1} offset", offsets[k])):
            value, deviation = estimate[name]
            assert abs(value - truth) < 4 * deviation
    assert "as described" in str(report)
    assert "stay as uncertain as before" in str(report)
    tracked = track_file(readings, path, calibration=tmp_path / "c.json")
    bare = tracked.found
    tip = np.sqrt(
        np.square(bare.to_frame().filter(regex="tip_._sd_mm")).sum(axis=1)
    )  # along x, y and z together
    assert f"known to ±{tip.median():.2g} mm in most rows, ±{tip.max():.2g} mm in the worst" in str(tracked)
    sensing = found.q_covariance(bare.q[:1])[0]
    np.testing.assert_allclose(bare.covariance[0], sensing, rtol=0.05, atol=1e-12)


def test_a_spike_in_a_hold_is_left_out_named_and_changes_nothing(tmp_path):
    """One 0x7FFF among 1280 rows of held poses."""
    poses = DATA / "held_poses.csv"
    text = (DATA / "held_one_spike.csv").read_text(encoding="utf-8")
    assert text.count("32767") == 1
    good = tmp_path / "good.csv"
    good.write_text(text.replace("32767", "-2230"), encoding="utf-8")
    before = calibrate_files(good, poses, RAW, tmp_path / "good.json")
    found = calibrate_files(DATA / "held_one_spike.csv", poses, RAW, tmp_path / "c.json")
    np.testing.assert_allclose(found.found.estimate / found.found.tolerances,
                               before.found.estimate / before.found.tolerances, atol=0.02)  # fmt: skip
    assert "left out: 1: sensor 2 at 9 s (32.77, not -2.23)." in str(found)
    assert "left out" not in str(before)


def test_a_hold_whose_readings_vary_by_more_than_five_times_their_noise_is_named(tmp_path):
    robot, t = repro.load_robot(robot_file(tmp_path)), np.arange(40) / 20
    size = robot.noise * np.where(t < 0.99, 4.9, 5.1)[:, None] * (-1) ** np.arange(40)[:, None]
    windows = np.array([[0.0, 0.95], [1.0, 1.95]])
    _, remarks = cleaning.averaged(robot, t, size, windows, ["a", "b"])
    assert remarks == ["Poses in which the readings were not still: 1: b."]


def test_a_hold_is_averaged_from_its_first_reading_to_its_last(tmp_path):
    robot, t = repro.load_robot(robot_file(tmp_path)), np.arange(10.0)
    u = 1e-3 * (t**2)[:, None] * np.ones(4)
    found, _ = cleaning.averaged(
        robot, t, u, np.array([[2.0, 4.0], [5.0, 5.0], [np.nan, 1.0]]), ["a", "b", "c"]
    )
    np.testing.assert_allclose(found[:2, 0], [29e-3 / 3, 25e-3])
    assert np.isnan(found[2]).all()


@pytest.mark.parametrize(("moves", "is_frozen"), [(5.9, False), (6.1, True)])
@pytest.mark.parametrize("repeated", [1, 2, 8])
def test_poses_are_frozen_if_readings_move_by_six_deviations_meanwhile(moves, is_frozen, repeated):
    """Of a short hold the readings before and after count, too."""
    times = 0.1 * np.arange(20)
    q = np.maximum(np.arange(20.0) - repeated, np.minimum(np.arange(20.0), 5.0))[:, None]
    u = np.zeros((20, 2))
    u[6 if repeated < 3 else 8 :, 1] = moves
    found = cleaning.frozen(q, times, times, u, np.ones(2))
    assert np.flatnonzero(found).tolist() == [*range(6, 6 + repeated)] * is_frozen


def test_poses_that_cannot_be_or_lack_a_sensor_are_left_out_and_named(tmp_path):
    path = robot_file(tmp_path)
    readings, poses, _ = held_poses(tmp_path, repro.load_robot(path))

    def too_far(frame):
        frame.loc[7, "delta_x_1_mm"] = 1e305

    def no_reading(frame):
        frame.loc[30:39, "u2_mT"] = np.nan

    def no_time(frame):
        frame.loc[11, "start_s"] = np.nan

    rewritten(poses, too_far)
    rewritten(poses, no_time)
    rewritten(readings, no_reading)
    report = calibrate_files(readings, poses, path, tmp_path / "c.json")
    assert report.found.poses == 17
    assert (
        "3 poses lack a reading, a coordinate or a time and are left out: poses.csv, line 5, poses.csv, line 9, "
        "poses.csv, line 13." in str(report)
    )

    def a_little(frame):
        frame.loc[7, "delta_x_1_mm"] = 22.5

    text = str(calibrate_files(readings, rewritten(poses, a_little), path, tmp_path / "d.json"))
    assert "outside the robot's bounds, for delta_x_1 -20 to 20 mm: 1 of 20 (line 9)." in text

    def mirrored(frame):
        frame.loc[4, ["delta_x_1_mm", "delta_y_1_mm"]] *= -1

    with pytest.raises(InputError, match=r"worst in poses\.csv, line 6, by"):
        calibrate_files(readings, rewritten(poses, mirrored), path, tmp_path / "e.json")


def test_poses_and_readings_row_by_row_or_at_one_time(tmp_path):
    path = robot_file(tmp_path)
    readings, poses, u = held_poses(tmp_path, repro.load_robot(path))
    frame = pd.read_csv(poses)
    only = frame.drop(columns=["start_s", "end_s"])
    only.to_csv(tmp_path / "rows.csv", index=False)
    rows = write_table(
        tmp_path / "means.csv", None, [f"u{k}_mT" for k in range(1, 5)], u.reshape(20, 10, 4).mean(1)
    )
    held = calibrate_files(readings, poses, path, tmp_path / "a.json").found
    by_row = calibrate_files(rows, tmp_path / "rows.csv", path, tmp_path / "b.json").found
    np.testing.assert_allclose(by_row.estimate, held.estimate, atol=1e-5)
    only.assign(time_s=frame["start_s"] + 0.19).to_csv(tmp_path / "times.csv", index=False)
    at = calibrate_files(readings, tmp_path / "times.csv", path, tmp_path / "c.json").found
    np.testing.assert_allclose(at.estimate / at.tolerances, held.estimate / at.tolerances, atol=0.1)
    with pytest.raises(
        InputError, match=r"poses of rows\.csv must be held from start_s.*20 poses for 200 rows"
    ):
        calibrate_files(readings, tmp_path / "rows.csv", path, tmp_path / "d.json")
    late = frame.assign(start_s=frame["start_s"].where(frame.index != 3, 50.0), end_s=frame["end_s"] + 50)
    late.to_csv(tmp_path / "late.csv", index=False)
    with pytest.raises(
        InputError,
        match=r"pose of late\.csv, line 5, must be within the readings, 0 to 19\.36 s after the first",
    ):
        calibrate_files(readings, tmp_path / "late.csv", path, tmp_path / "d.json")
    untimed = write_table(tmp_path / "untimed.csv", None, [f"u{k}_mT" for k in range(1, 5)], u)
    with pytest.raises(InputError, match="times of the readings must be given"):
        calibrate_files(untimed, poses, path, tmp_path / "d.json")
    with pytest.raises(InputError, match="poses of repro calibrate must be given"):
        calibrate_files(readings, None, path, tmp_path / "d.json")


def moves_and_holds(folder: Path, robot: Any) -> tuple[Path, Any, np.ndarray]:
    """Readings of a robot that holds each of 12 poses for 1.5 s and then moves for 0.5 s, and when it holds."""
    q = robot.lower + (robot.upper - robot.lower) * np.random.default_rng(4).uniform(
        0.05, 0.95, (13, robot.n_q)
    )
    t = np.arange(0, 25, 1 / RATE_HZ)
    k, share = (t / 2).astype(int), np.clip(t % 2 - 1.5, 0, 0.5)[:, None] * 2
    u = read(robot, q[k] * (1 - share) + q[np.minimum(k + 1, 12)] * share)
    readings = write_table(folder / "u.csv", t, [f"u{k}_mT" for k in range(1, robot.n_readings + 1)], u)
    frame = pd.DataFrame(1e3 * q[:12], columns=[f"{name}_mm" for name in robot.coordinates])
    return readings, frame.assign(start_s=2.0 * np.arange(12) + 0.2, end_s=2.0 * np.arange(12) + 1.3), u


@pytest.mark.parametrize("late", [-700.0, -3.0, 1.2, 50.0])
def test_held_poses_by_a_clock_that_is_off_calibrate_as_those_that_are_not(tmp_path, late):
    path = robot_file(tmp_path)
    readings, frame, _ = moves_and_holds(tmp_path, repro.load_robot(path))
    frame.to_csv(tmp_path / "p.csv", index=False)
    right = calibrate_files(readings, tmp_path / "p.csv", path, tmp_path / "a.json")
    assert "Lag" not in str(right)
    frame.assign(start_s=frame["start_s"] + late, end_s=frame["end_s"] + late).to_csv(
        tmp_path / "p.csv", index=False
    )
    found = calibrate_files(readings, tmp_path / "p.csv", path, tmp_path / "b.json")
    assert float(str(found).split("Lag: ")[1].split(" s")[0]) == pytest.approx(-late, abs=0.06)
    assert "0% of the readings unexplained" in str(found)
    np.testing.assert_allclose(found.found.estimate, right.found.estimate, atol=0.01)


def test_held_poses_by_the_clocks_of_the_board_and_of_the_day(tmp_path):
    """The board ran for 700 s when its recording began; the table that is exported of it has all three clocks."""
    from repro_board.export import export

    path = robot_file(tmp_path)
    readings, frame, u = moves_and_holds(tmp_path, repro.load_robot(path))
    writer = Writer(tmp_path / "a.rec", {"format": "frames"})
    for k, row in enumerate(u):
        sent = encode(row, sequence=k, time_us=700_000_000 + 25_000 * k)
        writer.write(1_700_000_000_000_000_000 + 25_000_000 * k, sent)
    writer.close()
    export(tmp_path / "a.rec", tmp_path / "a.csv", robot=path)
    estimates, held = [], frame.drop(columns=["start_s", "end_s"])
    for clock, began in (("", 0.0), ("board_", 700.0), ("unix_", 1.7e9)):
        poses = held.assign(**{f"{end}_{clock}s": frame[f"{end}_s"] + began for end in ("start", "end")})
        poses.to_csv(tmp_path / "p.csv", index=False)
        for name in ("a.rec", "a.csv"):
            report = calibrate_files(
                tmp_path / name, tmp_path / "p.csv", path, tmp_path / f"{clock}{name}.json"
            )
            assert "Lag" not in str(report)
            estimates.append(report.found.estimate)
    np.testing.assert_allclose(estimates, np.tile(estimates[0], (6, 1)), atol=1e-3)
    with pytest.raises(InputError, match=r"columns of u\.csv must be one column for unix_s"):
        calibrate_files(readings, tmp_path / "p.csv", path, tmp_path / "none.json")


def in_motion(folder: Path, spike: bool = False) -> tuple[Path, np.ndarray, np.ndarray]:
    """The example arm: 12 readings and four coordinates, all gains and offsets off."""
    robot, rng = repro.load_robot(EXAMPLE), np.random.default_rng(5)
    t = np.arange(0, 40, 1 / 25)
    gains, offsets = 0.03 * rng.normal(size=12), 0.2 * rng.normal(size=12)
    u = (1 + gains) * robot.sensing()(shapes(robot, t)) + offsets + 0.005 * rng.normal(size=(len(t), 12))
    if spike:
        u[300, 4] = 32.767
    return write_table(folder / "motion.csv", t, list(robot.names), u), gains, offsets


@pytest.mark.parametrize("spike", [False, True])
def test_motion_alone_tells_gains_and_offsets_as_well_as_stated(tmp_path, spike):
    path, gains, offsets = in_motion(tmp_path, spike)
    report = calibrate_by_motion(path, EXAMPLE, tmp_path / "c.json")
    found = report.found
    truth = dict.fromkeys(found.names, 0.0)
    for k, name in enumerate(f"{j} {{}} {axis}" for j in range(1, 5) for axis in "xyz"):
        truth[f"sensor {name.format('gain')}"], truth[f"sensor {name.format('offset')}"] = (
            gains[k],
            offsets[k],
        )
    off = (found.estimate - np.array(list(truth.values()))) / found.deviation
    assert np.abs(off).max() < 3.5
    is_offset = np.array(["offset" in name for name in found.names])
    assert (
        np.abs(found.estimate - np.array(list(truth.values())))[is_offset].mean()
        < 0.5 * np.abs(offsets).mean()
    )
    assert f"1000 rows of readings in motion; {int(spike)} do not fit" in str(report)
    value, deviation, prior = (100 * x[found.names.index("sensor 1 gain x")] for x in
                               (found.estimate, found.deviation, found.tolerances))  # fmt: skip
    assert f"B1 gain x: {value:+.2g} ± {deviation:.2g} % (before ± {prior:.2g})" in str(report)
    assert repro.load_robot(EXAMPLE, tmp_path / "c.json").sensors[0].gain == found.robot.sensors[0].gain


def test_no_parameter_is_less_certain_after_a_motion_than_before_it():
    """Five times the noise that is stated: what the motion does not tell keeps its tolerance all the same."""
    robot, rng = repro.load_robot(EXAMPLE), np.random.default_rng(0)
    u = robot.sensing()(shapes(robot, np.arange(0, 10, 0.04)))
    found, _ = by_motion(robot, u + 5 * robot.noise * rng.normal(size=u.shape))
    assert found.chi2 > 2
    assert (found.deviation < found.tolerances * (1 + 1e-9)).all()


def test_motion_tells_nothing_where_every_reading_is_needed_for_the_shape(tmp_path):
    """Three readings and three coordinates: a spike is written as no offset."""
    robot = repro.load_robot(RAW)
    u = 1e3 * robot.sensing()(shapes(robot, np.arange(0, 10, 0.025)))
    u[200, 1] = 32767
    path = write_table(tmp_path / "u.csv", np.arange(0, 10, 0.025), ["u1", "u2", "u3"], u.round())
    report = calibrate_by_motion(path, RAW, tmp_path / "c.json")
    assert np.abs(report.found.estimate / report.found.tolerances).max() < 0.2
    assert str(report).count("not determined") == len(report.found.names)
    assert "; 1 do not fit" in str(report)


@pytest.mark.slow
def test_motion_of_another_robot_is_refused_and_a_doubtful_one_told(tmp_path, capsys):
    path, _, _ = in_motion(tmp_path)
    mirrored = rewritten(path, lambda frame: frame.update(-frame[["B1x", "B2y"]]))
    with pytest.raises(
        InputError, match="readings of repro calibrate --self must be those of this robot in motion"
    ):
        calibrate_by_motion(mirrored, EXAMPLE, tmp_path / "c.json")
    path, _, _ = in_motion(tmp_path)
    off = rewritten(path, lambda frame: frame.update(frame["B1x"] + 1.4))
    text = str(calibrate_by_motion(off, EXAMPLE, tmp_path / "c.json"))
    assert [line.split(":")[0].strip() for line in text.splitlines() if "DOUBT" in line] == ["B1 offset x"]
    words = ["calibrate", str(path), str(DATA / "held_poses.csv"), "--self"]
    assert main([*words, "--robot", str(EXAMPLE), "-o", str(tmp_path / "d.json")]) == 2
    assert "poses of repro calibrate must be left out with --self" in capsys.readouterr().err


def test_errors_of_five_times_the_tolerance_or_a_chi_square_of_sixteen_are_the_most_that_motion_calibrates():
    _judge(["a", "b"], np.array([1.0, 5.0]), 16.0)
    for far, spread, words in ((5.1, 1.0, "b 5.1 times"), (4.9, 16.1, "a chi-square per reading of 16.1")):
        with pytest.raises(InputError, match=words):
            _judge(["a", "b"], np.array([1.0, far]), spread)


@pytest.mark.parametrize("factor", [1.0, 1.2])
def test_errors_that_motion_finds_are_those_of_a_calibration(factor):
    """Of magnets, alike or not, and chips with gains and offsets: the same readings, to second order."""
    robot = repro.load_robot(EXAMPLE)
    chips = [replace(chip, gain=[1.1, 0.9, 1.2], offset=[1.0, -2.0, 0.5]) for chip in robot.sensors]
    first, last = robot.magnets
    shape = replace(last.shape, polarisation_mt=factor * last.shape.polarisation_mt)
    robot = robot.replaced(sensors=chips, magnets=[first, replace(last, shape=shape)])
    kinds = [Drift("moment", 0.05, shared=factor == 1.0), Drift("gain", 0.05), Drift("offset", 0.5)]
    model = DriftModel(Drifting(robot.sensing(), kinds), robot.lower, robot.upper, "a test")
    changes = _parameters(robot, model.names)
    for z in 1e-4 * np.eye(len(model.names)):
        off = placed(robot, {name: float(row @ z) for name, row in changes.items()})
        expected = model(np.concatenate([robot.usual_shape, z])[None])
        np.testing.assert_allclose(off.sensing()(robot.usual_shape), expected[0], rtol=1e-7)


def test_what_motion_finds_is_doubted_beyond_twice_and_undetermined_from_nine_tenths():
    robot = repro.load_robot(EXAMPLE)
    names = ("sensor 1 gain x", "sensor 1 gain y", "sensor 2 offset x", "sensor 2 offset y")
    found = SimpleNamespace(
        robot=robot, names=names, estimate=[0.019, -0.021, 0.2, 0.1], deviation=[0.0089, 0.0091, 0.0, 0.0],
        tolerances=[0.01, 0.01, 0.1, 0.1],
    )  # fmt: skip
    assert _told(found, 100, 3).splitlines()[:5] == [
        "100 rows of readings in motion; 3 do not fit (spikes, failures) and are left out.",
        "  B1 gain x: +1.9 ± 0.89 % (before ± 1)",
        "  B1 gain y: -2.1 ± 0.91 % (before ± 1), not determined; DOUBT: beyond twice what was assumed",
        "  B2 offset x: +0.2 ± 0 mT (before ± 0.1)",
        "  B2 offset y: +0.1 ± 0 mT (before ± 0.1)",
    ]


def test_pose_noise_by_the_kind_of_coordinate():
    robot = repro.Robot(
        [repro.ConstantCurvature(0.1, 0.02), repro.AffineCurvature(0.2), repro.BallJoint("xy")]
    )
    found = np.sqrt(np.diag(pose_covariance(robot, 0.2, 0.5)))
    lengths = [name.startswith("delta") for name in robot.coordinates]
    np.testing.assert_allclose(found, np.where(lengths, 0.2e-3, np.radians(0.5)))
    with pytest.raises(InputError, match="pose noise of the command must be positive"):
        pose_covariance(robot, 0.0, 0.5)


def motion(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    slow = np.cumsum(rng.normal(size=(n, 3)), axis=0)
    return (slow - slow.mean(0)) / slow.std(0)


def readings(q: np.ndarray) -> np.ndarray:
    x, y, z = q.T
    return np.stack([3 * x - y + 0.5 * x * y, y + z, 2 * z + 0.3 * x * x], axis=-1)


@pytest.mark.parametrize("lag", [-900, -37, 0, 5, 700])
def test_finds_any_lag_of_up_to_half_the_recording(lag):
    q = motion(4000)
    u = readings(q) + 0.01 * np.random.default_rng(1).normal(size=(4000, 3))
    a, b = (q[:-lag], u[lag:]) if lag > 0 else (q[-lag:], u[: 4000 + lag])
    found = search_lag(a, b, 40)
    assert found.lag_s == -lag / 40
    assert found.best == pytest.approx(0.01, rel=0.1)


def test_residuals_are_those_of_least_squares_over_what_both_have():
    q = motion(300)
    u = readings(q) + np.sin(np.arange(300))[:, None]
    q[20:25], u[100:103, 1] = np.nan, np.nan
    low, up = np.triu_indices(3)
    columns = np.column_stack([np.ones(300), q, q[:, low] * q[:, up]])
    both = np.isfinite(columns).all(1) & np.isfinite(u).all(1)
    left = u[both] - columns[both] @ np.linalg.lstsq(columns[both], u[both], rcond=None)[0]
    assert search_lag(q, u, 40).residual == pytest.approx(np.sqrt((left**2).mean()), rel=1e-5)


def test_a_motion_without_end_has_its_smallest_lag():
    t = np.arange(4000) / 40
    q = np.stack([np.sin(2 * np.pi * t / 5), np.cos(4 * np.pi * t / 5)], axis=-1)
    assert search_lag(q, q @ [[1.0, 2.0], [3.0, 1.0]], 40).lag_s == 0.0


@pytest.mark.parametrize(
    ("q", "u", "message"),
    [
        ((100, 2), (99, 2), "readings of search_lag must be one row for each of 100 poses"),
        ((79, 2), (79, 2), "motion of search_lag must be two seconds long or more; instead received 1.975 s"),
    ],
)
def test_what_cannot_be_compared_is_refused(q, u, message):
    with pytest.raises(InputError, match=re.escape(message)):
        search_lag(np.zeros(q), np.zeros(u), 40)


def test_a_lag_that_is_not_known_is_refused():
    """No frame has both a pose and a reading, at any lag that is tried."""
    q, u = motion(400), readings(motion(400))
    q[:190], u[210:] = np.nan, np.nan
    with pytest.raises(
        InputError, match="motion and readings of search_lag must be there together at some lag"
    ):
        search_lag(q, u, 40, longest_s=0.2)


def test_the_least_residual_elsewhere_tells_a_motion_that_repeats_itself():
    t = np.arange(4000) / 40
    q = np.stack([np.sin(2 * np.pi * t / 5), np.cos(4 * np.pi * t / 5)], axis=-1)
    again, once = (
        search_lag(q, q @ [[1.0, 2.0], [3.0, 1.0]], 40),
        search_lag(motion(4000), readings(motion(4000)), 40),
    )
    assert again.other < again.best + 1e-4 * again.spread
    assert once.other > 0.2 * once.spread
