"""The recorded continuum robot: files, constants, errors of the trackers, and the figures of the released program."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from repro import InputError
from repro_companion.papers import toronto

TRIALS = toronto.trials()


@pytest.fixture(scope="module")
def slow():
    return toronto.capture(toronto.CHOOSING, *TRIALS[toronto.CHOOSING])


def test_two_windows_of_one_recording_are_found_and_further_folders_too(tmp_path, monkeypatch):
    assert set(TRIALS) == {"slow_free_space", "impulse_1", "fast_contact"}
    assert TRIALS["impulse_1"][0] == TRIALS["fast_contact"][0]
    place = tmp_path / "continuum_robot/assets/data"
    shutil.copytree(TRIALS["impulse_1"][0], place / "fast_contact")  # the same content once more
    shutil.copytree(TRIALS["impulse_1"][0], place / "my_trial")
    (place / "my_trial" / "aurora0.csv").write_text("sensor type:,aurora\nt,s,x\n0.0,0.0,0,0,0,0,0,0\n")
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    found = toronto.trials()
    assert set(found) == {*TRIALS, "my_trial"}
    assert found["my_trial"] == (place / "my_trial", None)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("0,0,1,2,3\n0,0,1,2,3", "later in every row"),
        ("0,0,1,2", "rows of 5 numbers; instead received shape"),
        ("0,0,1,2,x", "rows of numbers below two lines"),
        ("0,0,1,2,nan", "rows of 5 numbers"),
    ],
)
def test_a_damaged_file_is_named(tmp_path, rows, words):
    (tmp_path / "gyro_mid.csv").write_text(f"sensor type:,gyro\nt,s,x\n{rows}\n")
    with pytest.raises(InputError, match=rf"gyro_mid.csv of the continuum robot must be .*{words}"):
        toronto.read(tmp_path, "gyro_mid")
    with pytest.raises(InputError, match="recording of the continuum robot must be a file that exists"):
        toronto.read(tmp_path, "aurora0")


def test_logarithms_have_the_translation_first_and_are_inverse_to_poses():
    x = np.random.default_rng(0).normal(size=(20, 6))
    np.testing.assert_allclose(toronto.logarithms(toronto.poses(x)), x, atol=1e-12)
    np.testing.assert_allclose(toronto.poses(np.array([0.1, 0.2, 0.3, 0, 0, 0]))[:3, 3], [0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("name", "means"),
    [
        ("slow_free_space", {"filter": 9.7, "window": 9.5, "batch": 9.7}),
        ("impulse_1", {"filter": 12.1, "window": 12.0, "batch": 12.0}),
        ("fast_contact", {"filter": 9.7, "window": 9.2}),
    ],
)
def test_the_released_estimates_have_the_errors_that_their_program_printed(name, means):
    capture = toronto.capture(name, *TRIALS[name])
    for estimator, mean in means.items():
        errors = toronto.released(capture, estimator, np.zeros(18))
        assert errors is not None
        rmse = [row["rmse_mm"] for row in toronto.error_rows(name, "raw", estimator, errors)]
        assert np.mean(rmse) == pytest.approx(mean, abs=0.06)
    assert toronto.released(capture, "none", np.zeros(18)) is None


def test_what_the_body_at_the_tip_is_off_counts_with_the_share_of_the_length(slow):
    constants = np.zeros(18)
    constants[12] = 0.01
    both = zip(*(toronto.released(slow, "window", c) or [] for c in (constants, 0 * constants)), strict=True)
    for station, (moved, drawn) in enumerate(both, 1):
        np.testing.assert_allclose(np.linalg.norm(moved - drawn, axis=-1), 0.01 * station / 4)


def test_constants_that_were_put_in_are_found(monkeypatch):
    rng = np.random.default_rng(0)
    constants = 0.02 * rng.normal(size=18)
    T = [
        toronto.poses(np.hstack([0.1 * rng.normal(size=(200, 3)), rng.normal(size=(200, 3))]))
        for _ in range(2)
    ]
    pairs = [(np.arange(200.0), T[k], toronto.moved(constants, T[k], k)) for k in range(2)]
    monkeypatch.setattr(toronto, "tracker_pairs", lambda: pairs)
    np.testing.assert_allclose(toronto.calibration_constants(), constants, atol=1e-4)


def test_a_radian_counts_as_much_as_a_tenth_of_a_metre(monkeypatch):
    """At 0.1 m from an axis positions do not turn about it and rotations do: the frame is turned half as far."""
    T = np.tile(np.eye(4), (4, 1, 1))
    T[:, 0, 3], T[2:, :3, :3] = [0.1, -0.1] * 2, np.diag([1.0, -1.0, -1.0])
    truth = T.copy()
    truth[:, :3, :3] = Rotation.from_rotvec([0.0, 0.0, 0.02]).as_matrix() @ T[:, :3, :3]
    monkeypatch.setattr(toronto, "tracker_pairs", lambda: [(np.arange(4.0), T, truth)] * 2)
    np.testing.assert_allclose(toronto.calibration_constants()[:6], [0, 0, 0, 0, 0, 0.01], atol=1e-5)


@pytest.mark.slow
def test_white_and_lasting_errors_are_told_apart(monkeypatch):
    """An error that fades by e in 2 s, beside a white one: their sizes and the time are found."""
    rng, dt, n = np.random.default_rng(1), 0.06, 20_000
    keep = math.exp(-dt / 2.0)
    lasting = np.zeros((n, 6))
    for k in range(1, n):
        lasting[k] = keep * lasting[k - 1] + math.sqrt(1 - keep**2) * rng.normal(size=6)
    r = 2e-3 * lasting + 1e-3 * rng.normal(size=(n, 6))
    truth = toronto.poses(r)
    pairs = [(dt * np.arange(n), np.tile(np.eye(4), (n, 1, 1)), truth)] * 2
    monkeypatch.setattr(toronto, "tracker_pairs", lambda: pairs)
    table = toronto.tracker_errors(np.zeros(18)).set_index(["tracker", "part"])
    for factor, part in ((1e3, "position_mm"), (math.degrees(1), "rotation_deg")):
        own = table.loc[("tip", part)]
        assert own["rms"] == pytest.approx(factor * math.sqrt(5) * 1e-3, rel=0.05)
        steps = 1e-6 + 4e-6 * (1 - keep)  # half of the variance from frame to frame
        assert own["white"] == pytest.approx(factor * math.sqrt(steps), rel=0.05)
        assert 1.2 < own["lasts_s"] < 2.2  # of the whole error, whose correlation begins at 0.8
    both = table.reset_index()
    white, inflated, estimated = (toronto.errors_of(both, model, 1 / 7)[1] for model in toronto.ERROR_MODELS)
    assert white.white[0] == pytest.approx(math.sqrt(5) * 1e-3, rel=0.05)
    assert white.lasting == inflated.lasting == ()
    apart = estimated.white[0] ** 2, estimated.lasting[0] ** 2
    assert sum(apart) == pytest.approx(white.white[0] ** 2, rel=1e-9)
    assert inflated.white[0] ** 2 == pytest.approx(apart[0] + 50 / 7 * apart[1], rel=1e-9)
    monkeypatch.setattr(toronto, "tracker_pairs", lambda: [(dt * np.arange(90), np.tile(np.eye(4), (90, 1, 1)),
                                                            toronto.poses(np.full((90, 6), 1e-3)))] * 2)  # fmt: skip
    assert np.isinf(toronto.tracker_errors(np.zeros(18))["lasts_s"]).all()  # an offset never fades


def test_steps_over_a_pause_are_no_white_errors(monkeypatch):
    """Frames are 60 ms apart, but for a pause of 110 ms over which a lasting error has changed."""
    times, T = np.cumsum(np.where(np.arange(90) == 45, 0.11, 0.06)), np.tile(np.eye(4), (90, 1, 1))
    truth = toronto.poses(np.repeat([[0.0] * 6, [1e-3] * 6], 45, axis=0))
    monkeypatch.setattr(toronto, "tracker_pairs", lambda: [(times, T, truth)] * 2)
    np.testing.assert_allclose(toronto.tracker_errors(np.zeros(18))["white"], 0.0, atol=1e-12)


@pytest.mark.parametrize("model", toronto.shape_models())
def test_stations_are_on_the_arm_and_a_joint_belongs_to_the_segment_before_it(model):
    robot = toronto.shape_models()[model]
    length = robot.segments[0].length
    for arc, (segment, place) in zip(toronto.STATIONS, toronto.at_stations(robot), strict=True):
        assert 1 <= segment <= len(robot.segments)
        assert (segment - 1) * length + place == pytest.approx(arc, rel=1e-12)
        assert 0 < place <= length


def test_readings_of_all_sensors_are_on_one_clock(slow):
    assert (np.diff(slow.time_s) > 0).all()
    assert slow.time_s[0] >= 19.0
    assert slow.time_s[-1] <= 29.0
    counts = np.isfinite(slow.u).sum(0)
    rates = counts[[0, 6, 12, 15]] / 10.0
    np.testing.assert_allclose(rates[:2], 50.0, rtol=0.05)
    np.testing.assert_allclose(rates[2:], 31.0, rtol=0.15)
    same = toronto.calibrated(slow, np.zeros(18)).u
    there = np.isfinite(slow.u)
    np.testing.assert_allclose(
        toronto.poses(same[there[:, 6]][:, 6:12]), toronto.poses(slow.u[there[:, 6]][:, 6:12])
    )


def test_bodies_point_as_recorded_and_have_no_turn_about_the_arm():
    shown = []
    toronto.floors([toronto.CHOOSING], 500, lambda robot, T, seen: shown.append(T) or 0.0)
    seen, recorded = shown[0], toronto.body_poses(toronto.CHOOSING)[::500, 1:]
    np.testing.assert_allclose(seen[..., :3, 2:], recorded[..., :3, 2:], atol=1e-9)
    turns = Rotation.from_matrix(seen[..., :3, :3].reshape(-1, 3, 3)).as_rotvec()
    np.testing.assert_allclose(turns[:, 2], 0.0, atol=1e-9)


ONCE = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [6e-3, 8e-3, 0]])
"""An error of 10 mm once in four frames: 5 mm in the root mean square."""


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (
            lambda: [
                row["rmse_mm"] for row in toronto.error_rows("a", "b", "c", [ONCE, 2 * ONCE, 0 * ONCE, ONCE])
            ],
            [5, 10, 0, 5],
        ),
        (
            lambda: toronto.region(
                pd.DataFrame(
                    {
                        "shortest_mm": [1, 3],
                        "longest_mm": [20, 14],
                        "covered_percent": [50, 80],
                        "positions": [100, 200],
                    }
                )
            ),
            {"axes": "1 to 20", "covered": "70 %"},
        ),
        # What covers the truth by trial, and the extreme semi-axes over all trials.
        (
            lambda: toronto.sure_shown(
                pd.DataFrame(
                    {
                        "ellipsoids": "as stated",
                        "estimator": "filter",
                        "trial": ["impulse_1", "slow_free_space"],
                        "covered_percent": [50.0, 80.0],
                        "shortest_mm": [1.0, 3.0],
                        "longest_mm": [20.0, 14.0],
                    }
                )
            ).to_dict("records")[0],
            {
                "ellipsoids": "filter, as stated",
                "hit [%]": 50.0,
                "slow [%]": 80.0,
                "shortest [mm]": 1.0,
                "longest [mm]": 20.0,
            },
        ),
        (
            lambda: toronto.by_trial(
                pd.DataFrame({"trial": ["impulse_1", "another"], "model": "m", "error_mm": [7.0, 5.0]}),
                ["model"],
                "error_mm",
            ).to_dict("records")[0],
            {"model": "m", "hit [mm]": 7.0, "another [mm]": 5.0},
        ),
    ],
)
def test_numbers_of_the_page_by_hand(found, expected):
    assert found() == (expected if isinstance(expected, dict) else pytest.approx(expected, nan_ok=True))


def test_our_smoother_stands_above_the_window_and_raw_readings_first():
    """A trial that nobody's program estimated has a dash for it, and other estimators have no row."""
    index = [
        (t, s, e)
        for s in ("calibrated", "raw")
        for t in ("impulse_1", "my_trial")
        for e in ("filter", "smoother")
    ]
    index += [("impulse_1", s, "released window") for s in ("raw", "calibrated")]
    errors = pd.Series(
        np.arange(10.0), pd.MultiIndex.from_tuples(index, names=["trial", "setting", "estimator"])
    )
    table = toronto.compared(errors)
    assert list(table) == ["readings", "estimator", "hit [mm]", "my_trial [mm]"]
    assert table[["readings", "estimator"]].to_numpy().tolist() == [
        [readings, who] for readings in ("raw", "calibrated") for who in ("our smoother", "authors' window")
    ]
    np.testing.assert_array_equal(table.iloc[:, 2:], [[5, 7], [8, np.nan], [1, 3], [9, np.nan]])


def test_errors_of_imu_models_are_means_over_the_stations(monkeypatch):
    """At the stations root mean squares over time of 0, 3, 4 and 5 mm: once in four frames 0, 6, 8 and 10."""
    T = np.tile(np.eye(4), (4, 5, 1, 1))
    T[:, :, 2, 3] = np.array([0.0, *toronto.STATIONS])
    T[1, 2:, 0, 3] = [6e-3, 8e-3, 10e-3]
    monkeypatch.setattr(toronto, "body_poses", lambda name: T)
    np.testing.assert_allclose(toronto.imu_errors(["hit"])["error_mm"], 3.0)


def test_gyroscopes_are_compared_with_the_mean_turn_between_two_frames(monkeypatch, tmp_path):
    """The body turns by 1 rad/s about z; readings of 0.8 and 1.2 agree, one of 3.0 is 2 rad/s off."""
    gyroscope = "kind\nt,s,x,y,z\n0.01,0,0,0,0.8\n0.02,0,0,0,1.2\n0.07,0,0,0,3.0\n"
    body = "kind\nt,s,pose\n0,0,0,0,0,0,0,0\n0.05,0,0,0,0,0,0,0.05\n0.1,0,0,0,0,0,0,0.1\n"
    for name in ("gyro_mid", "gyro_ee", "vicon2", "vicon4"):
        (tmp_path / f"{name}.csv").write_text(gyroscope if "gyro" in name else body)
    monkeypatch.setattr(toronto, "trials", lambda: {toronto.CHOOSING: (tmp_path, None)})
    assert toronto.gyroscope_errors() == pytest.approx([math.sqrt((0 + 4) / 2 / 3)] * 2)


def test_an_added_error_covers_what_it_was_chosen_on():
    """Errors of 5 units and stated deviations of 3, 4 and 12: one more of 4 makes 5 and the root of 160."""
    unit, stated = 1e-3 * math.sqrt(stats.chi2(3).ppf(0.9)), np.diag([9e-6, 16e-6, 144e-6])

    def part(*errors):
        return [(unit * np.array(errors), np.tile(stated, (len(errors), 1, 1)))]

    chosen, other = part([5.0, 0, 0], [-5.0, 0, 0]), part([4.9, 0, 0], [5.1, 0, 0], [2.9, 0, 0], [0, 0, 13.0])
    table = toronto.coverage({toronto.CHOOSING: 2 * chosen, "other": other})
    assert table["covered_percent"].to_list()[2:] == [25.0, 50.0]  # of the last, a factor would cover 13 too
    sizes = table[["added_mm", "shortest_mm", "longest_mm"]] / [1, 1e3 * unit, 1e3 * unit]
    np.testing.assert_allclose(sizes, 2 * [[0, 3, 12], [4, 5, math.sqrt(160)]])
    enough = toronto.coverage({toronto.CHOOSING: part([2.0, 0, 0])})
    assert enough[["added_mm", "covered_percent"]].to_numpy().tolist() == [[0, 100]] * 2


def test_a_chain_of_ideal_imus_on_an_arc_is_the_arc():
    """Five orientations of one arc: exact arcs have no error, links that end at their IMU the largest."""
    arm = {name: toronto.imu_arm(5, where) for name, (_, where) in toronto.IMU_MODELS.items()}
    angle = 1.2 * np.array([0, *toronto.STATIONS]) / toronto.LENGTH
    R = Rotation.from_rotvec(angle[:, None] * [0.0, 1.0, 0.0])
    r = toronto.LENGTH / 1.2
    truth = np.stack([r * (1 - np.cos(angle)), 0 * angle, r * np.sin(angle)], axis=-1)[1:]
    errors = {}
    for name, (model, _) in toronto.IMU_MODELS.items():
        q = R.as_quat()[list(arm[name].imus)]
        errors[name] = np.abs(model(q, arm[name], toronto.STATIONS) - truth).max()
    assert errors["exact arcs"] < 1e-9
    assert max(errors, key=lambda name: errors[name]) == "rigid links that end at their IMU"
    assert errors["PCC-extended, two sub-segments"] < errors["rigid links centred on their IMU"]
    assert len(toronto.imu_errors(["fast_contact"])) == 12


def test_the_ellipsoids_that_the_page_states_are_small_and_cover_most_positions():
    table = pd.read_csv(Path(__file__).parents[2] / "results" / "real_arm_coverage.csv")
    table = table[(table["ellipsoids"] == "widened") & (table["trial"] != toronto.CHOOSING)]
    assert table["longest_mm"].max() <= 15
    assert table["covered_percent"].min() >= 50
    for _, part in table.groupby(["model", "estimator"]):
        assert np.average(part["covered_percent"], weights=part["positions"]) >= 72
