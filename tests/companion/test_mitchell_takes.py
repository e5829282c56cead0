"""Bend tests and light bulb of Mitchell et al.: files, markers, lags, errors."""

from dataclasses import replace
from datetime import datetime

import numpy as np
import pandas as pd
import pytest

from repro import InputError
from repro.estimators.base import Estimate
from repro.motion_files import Motion as MotionCapture
from repro_companion.papers import mitchell
from repro_companion.run import project_folder, recordings_folder

RECORDED = (recordings_folder() / "mitchell2021/mocap/bend_0_try_1.csv").is_file()


@pytest.fixture(scope="module")
def synthetic():
    return mitchell.synthetic_takes(seed=3)


def test_files_give_the_take_that_they_were_written_from(tmp_path, monkeypatch):
    """Rows of the recorder, with what a buffer held; poses and clock as Motive exports them."""
    hall = mitchell.synthetic_hall(
        lambda t: mitchell.up_and_down(t, 12.0), 0.5, 20.0, np.random.default_rng(3)
    )
    seen = mitchell.synthetic_capture(mitchell.up_and_down(np.arange(1, 19, 1 / 120), 12.0) * np.exp(0.9j))
    made = mitchell.aligned("bend_1_try_2", hall, mitchell.motion(seen))
    for name in ("experiment_data", "mocap"):
        (tmp_path / "mitchell2021" / name).mkdir(parents=True)
    times = [*(hall.time_s[0] - 0.1 + 3e-4 * np.arange(15)), *hall.time_s]
    u = np.concatenate([hall.u[:1].repeat(15, axis=0), hall.u])
    # The model's z is along the body, x in the file; the magnet points the other way, and y is mirrored.
    write(
        tmp_path / "mitchell2021/experiment_data/bend_test_1_try_2.csv",
        [
            f"[{-z / 10:.3f} {x / 10:.3f} {-y / 10:.3f}],{t:.6f}"
            for (x, y, z), t in zip(u, times, strict=True)
        ],
    )
    began = f"{seen.started:%Y-%m-%d %I.%M.%S}.{seen.started.microsecond // 1000:03d} {seen.started:%p}"
    head = [
        f"Format Version,1.21,Export Frame Rate,120,Capture Start Time,{began},"
        f"Total Exported Frames,{len(seen.times)},Rotation Type,Quaternion,Length Units,Millimeters",
        "",
        ",," + ",".join(["Rigid Body"] * 8),
        ",," + ",".join(["Module"] * 8),
        ",," + ",".join(["1"] * 8),
        ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Error Per Marker",
        "Frame,Time,X,Y,Z,W,X,Y,Z,",
    ]
    poses = seen.bodies["Module"] * [1, 1, 1, 1, 1e3, 1e3, 1e3]
    frames = [f"{k},{k / 120:.6f},{','.join(f'{x:.6f}' for x in row)},0" for k, row in enumerate(poses)]
    write(tmp_path / "mitchell2021/mocap/bend_1_try_2.csv", head + frames)
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    (read,) = mitchell.recorded_takes()
    assert read.name == made.name
    assert read.facts == pytest.approx(made.facts | {"buffered": 15})
    assert read.facts["lag_s"] == 0.5
    np.testing.assert_allclose(read.time_s, made.time_s, atol=2e-6)
    np.testing.assert_allclose(read.u, made.u, atol=1e-12)
    np.testing.assert_allclose(read.q, made.q, atol=1e-6)


def test_all_exchanged_markers_of_synthetic_takes_are_undone(synthetic):
    for take in synthetic:
        bend = np.degrees(mitchell.up_and_down(take.time_s, 12.0))
        np.testing.assert_allclose(np.degrees(np.abs(take.q)), bend, atol=0.15)
        assert (take.facts["undone"], take.facts["masked_percent"]) == (132, 0.0)
        assert take.facts["off_displacement_deg"] < 0.01


def capture(q, n_lost=0):
    """Motion capture of bends, without exchanged markers; the last frames without the body."""
    found = mitchell.synthetic_capture(np.asarray(q))
    poses = found.bodies["Module"].copy()
    poses[len(poses) - n_lost :] = np.nan
    return found._replace(bodies={"Module": poses})


@pytest.mark.parametrize("azimuth_deg", [-150.0, -30.0, 0.0, 90.0, 179.0])
def test_bend_and_direction_are_those_of_the_y_axis(azimuth_deg):
    q = np.radians(np.linspace(0, 39, 200)) * np.exp(1j * np.radians(azimuth_deg))
    found = mitchell.motion(capture(q, n_lost=4))
    np.testing.assert_allclose(found.q[:-4], q[:-4], atol=1e-4)
    assert np.isnan(found.q[-4:]).all()
    assert found.facts["masked_percent"] == pytest.approx(2.0)
    if azimuth_deg in (0.0, 90.0):  # the tilt of z is the bend only about one axis of the world
        np.testing.assert_allclose(found.tilt_z[:-4], np.abs(q[:-4]) * (azimuth_deg == 0), atol=2e-4)


def test_frames_beside_a_jump_are_left_out():
    q = np.radians(np.where((np.arange(100) >= 40) & (np.arange(100) < 43), 14.0, 10.0)).astype(complex)
    found = np.flatnonzero(np.isnan(mitchell.motion(capture(q)).q))
    assert found.tolist() == list(range(40 - mitchell.GUARD, 43 + mitchell.GUARD))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"started": None}, "Capture Start Time of synthetic must be in the header; instead received nothing."),
        ({"bodies": {"Ground": np.zeros((9, 7))}}, "body of synthetic must be Module; instead received Ground."),
        ({"bodies": {"Module": np.tile([1.0, 0, 0, 0.2, 0, 0, 0], (9, 1))}}, "first frame of synthetic must be up"),
    ],
)  # fmt: skip
def test_other_motion_capture_is_refused(change, message):
    with pytest.raises(InputError) as caught:
        mitchell.motion(capture(np.zeros(9, dtype=complex))._replace(**change))
    assert message in str(caught.value)


def rows(n=40, first_s=1000.0):
    """Rows of a Hall file: three from a buffer, then one every 16 ms."""
    times = [first_s - 0.1 + 3e-4 * k for k in range(3)] + [first_s + 0.016 * k for k in range(n)]
    return [f"[-2.4{k % 10}e+00 -1.000e-03  {k % 7:d}.0e-02],{t!r}" for k, t in enumerate(times)]


def write(path, lines):
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_what_is_no_reading_is_counted_and_dropped(tmp_path):
    lines = rows()
    lines[20], lines[30] = "[-2.4 0.0],1000.27", "[-2.4 0.0 9.0],1000.432"
    found = mitchell.read_hall(write(tmp_path / "a.csv", lines))
    assert found.facts == {"buffered": 3, "unreadable": 1, "beyond_range": 1, "gain_switches": 0}
    assert len(found.u) == 38
    assert found.time_s[0] == 1000.0
    # The first live row is -2.43, -0.001, 0.03 in units of 10 mT: y of the model is -z, z is -x.
    np.testing.assert_allclose(found.u[0], [-0.01, -0.3, 24.3])


def test_a_gain_that_switches_is_counted_and_leaves_the_ratios(tmp_path):
    lines = rows()
    plain = mitchell.read_hall(write(tmp_path / "a.csv", lines))
    for k in range(15, 30):
        field, t = lines[k].split(",")
        lines[k] = f"[{' '.join(f'{1.155 * float(x):.6f}' for x in field[1:-1].split())}],{t}"
    found = mitchell.read_hall(write(tmp_path / "b.csv", lines))
    assert found.facts["gain_switches"] == 2
    np.testing.assert_allclose(found.ratio, plain.ratio, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lines: lines[:3], "must be readings, two of them a millisecond apart; instead received 3 readings."),
        (lambda lines: [*lines, lines[-2]], "times of a.csv must be increasing; instead received a step back."),
        (lambda lines: ["x"] * 5 + lines, "at most 5 % unreadable or beyond the range; instead received 5 of 48."),
        (lambda lines: [f"[1 0 0],{900 + 1e-4 * k}" for k in range(26)] + lines, "at most 5 % out of a buffer"),
    ],
)  # fmt: skip
def test_files_of_the_sensor_that_cannot_be_used_are_refused(tmp_path, change, message):
    with pytest.raises(InputError) as caught:
        mitchell.read_hall(write(tmp_path / "a.csv", change(rows())))
    assert message in str(caught.value)


def test_a_gap_in_the_readings_does_not_move_the_lag():
    rng, towards = np.random.default_rng(0), np.radians(30)
    hall = mitchell.synthetic_hall(lambda t: mitchell.up_and_down(t, 30.0), towards, 38.0, rng)
    motion = mitchell.motion(
        mitchell.synthetic_capture(mitchell.up_and_down(np.arange(1, 37, 1 / 120), 30.0) + 0j)
    )
    t = hall.time_s - hall.time_s[0]
    holed = hall._replace(time_s=hall.time_s[(t < 12) | (t > 20)], u=hall.u[(t < 12) | (t > 20)])
    take = mitchell.aligned("bend_1_try_1", holed, motion)
    assert take.facts["lag_s"] == pytest.approx(mitchell.LAG_S, abs=0.02)
    assert take.facts["longest_gap_s"] == pytest.approx(8, abs=0.1)


def test_a_log_is_laid_on_the_readings_by_its_own_clock():
    """It begins with the 31st reading and ends with the 70th, and its direction is mirrored."""
    t = np.cumsum(np.random.default_rng(1).uniform(0.012, 0.02, 100))
    log = pd.DataFrame({"time": t[30:70] - t[30], "bend_ang": np.linspace(0.1, 0.5, 40), "bend_dir": 0.25})
    found = mitchell.on_readings(log, t)
    assert np.flatnonzero(np.isfinite(found)).tolist() == list(range(30, 70))
    np.testing.assert_allclose(np.abs(found[30:70]), log["bend_ang"])
    np.testing.assert_allclose(np.angle(found[30:70]), np.pi - 0.25)


def made_up(name, truth_deg, direction_deg=0.0):
    """A take at constant bend, its second reading masked."""
    q = np.radians(np.full(4, truth_deg)) * np.exp(1j * np.radians(direction_deg))
    tilt_z = np.radians(np.full(4, truth_deg / 2))
    q[1] = tilt_z[1] = np.nan
    empty = np.zeros((4, 3))
    return mitchell.Take(name, np.arange(4.0), empty, empty[:, 0], empty[0], q, tilt_z, None, {})


def run(take, off_deg, turned_deg=0.0, deviation_deg=1.0, calibration="none"):
    bend = np.radians(np.nanmean(np.degrees(np.abs(take.q))) + off_deg * np.ones(4))
    q = bend * np.exp(1j * (np.nanmean(np.angle(take.q)) + np.radians(turned_deg)))
    return mitchell.Run("ours", calibration, 13.0, take, q, np.radians(np.full(4, deviation_deg)))


def test_errors_of_made_up_takes():
    """Three readings count. Errors of 3, 4 and 0 degrees: sqrt(25/3); the z axis tilts by half: 18, 19 and 15."""
    line = mitchell.bend_errors(
        [run(made_up("bend_1_try_1", 30), np.array([3, 50, 4, 0]), deviation_deg=1.6)]
    ).iloc[0]
    assert line["rmse_deg"] == line["rmse_20_to_40_deg"] == pytest.approx(np.sqrt(25 / 3))
    assert np.isnan(line["rmse_below_20_deg"])
    assert np.isnan(line["rmse_above_40_deg"])
    assert line["rmse_tilt_z_deg"] == pytest.approx(np.sqrt((18**2 + 19**2 + 15**2) / 3))
    assert line["within_percent"] == pytest.approx(200 / 3)
    assert line["length_mm"] == 13.0


def test_directions_count_less_the_mean_turn_of_other_tests():
    """A calibration says itself how the sensor is turned, and the direction of a small bend does not count."""
    takes = [made_up(f"bend_{k}_try_1", 30, 50.0 * k) for k in (1, 2, 3)]
    runs = [run(take, 0.0, turned) for take, turned in zip(takes, (35, 20, 40), strict=True)]
    found = mitchell.bend_errors(runs)["direction_deg"]
    np.testing.assert_allclose(found, [5.0, 17.5, 12.5], atol=1e-6)
    calibrated = [one._replace(calibration="other tests") for one in runs]
    np.testing.assert_allclose(mitchell.bend_errors(calibrated)["direction_deg"], [35, 20, 40], atol=1e-6)
    small = run(made_up("bend_1_try_1", 19.9), 0.0, 35.0)
    assert np.isnan(mitchell.bend_errors([small])["direction_deg"].item())


def test_two_tries_of_one_test_do_not_correct_each_other():
    runs = [run(made_up(f"bend_1_try_{k}", 30), 0.0, 30.0) for k in (1, 2)]
    np.testing.assert_allclose(mitchell.bend_errors(runs)["direction_deg"], 30.0, atol=1e-6)


def test_medians_are_over_the_takes_of_a_method_and_a_length():
    takes = [made_up(f"bend_{k}_try_1", 30) for k in (1, 2, 3)]
    runs = [run(take, off) for take, off in zip(takes, (1.0, 2.0, 9.0), strict=True)]
    longer = [one._replace(method="paper, as released", length_mm=mm) for one in runs for mm in (13.0, 15.0)]
    found = mitchell.median_errors(mitchell.bend_errors([*runs, *longer]))
    np.testing.assert_allclose(found["rmse_deg"], 2.0)
    assert found["takes"].tolist() == [3, 3, 3]
    assert found["name"].tolist()[1:] == [f"paper's filter, as released, {mm} mm" for mm in (13, 15)]


def test_the_study_has_each_take_once_for_a_method():
    """Another try can calibrate a take only where the test has one."""
    study = pd.read_csv(project_folder() / "data" / "studies" / "bend_tests.csv")
    assert not study.duplicated(["name", "take"]).any()
    assert set(zip(study["method"], study["calibration"], strict=True)) < set(mitchell.METHODS)
    twice = study[study["calibration"] == "other try"].groupby(study["take"].str[5])["take"].nunique()
    assert twice.eq(2).all()
    assert study.groupby("take")["name"].nunique().min() >= 5


def test_takes_side_by_side_end_in_nothing():
    table = mitchell.side_by_side([np.ones((2, 3)), 2 * np.ones((1, 3))])
    np.testing.assert_array_equal(table[..., 0], [[1, 2], [1, np.nan]])
    assert table.shape == (2, 2, 3)


def test_no_take_calibrates_itself(synthetic):
    for take in synthetic:
        found = mitchell.calibrations(take, synthetic)
        assert all(other is not take for some in found.values() for other in some)
        assert {other.test for other in found.get("other try", [])} <= {take.test}
        assert take.test not in {other.test for other in found["other tests"]}
    assert [len(mitchell.calibrations(take, synthetic).get("other try", [])) for take in synthetic] == [
        1,
        1,
        0,
        0,
    ]
    assert list(mitchell.calibrations(synthetic[0], synthetic[:1])) == ["none"]


def test_curves_over_time_begin_at_zero_and_have_directions_where_the_module_is_bent(synthetic):
    take = synthetic[2]
    table = mitchell.over_time([mitchell.Run("ours", "other tests", 13.0, take, take.q)])
    assert table["method"].unique().tolist() == ["motion capture", "ratios, calibrated on other tests"]
    assert table.groupby("method")["time_s"].min().eq(0).all()
    assert (table["direction_deg"].notna() == (table["bend_deg"] >= mitchell.LEAST_BEND_DEG)).all()
    assert table["direction_deg"].abs().max() < 0.1


def test_rest_is_where_the_ratio_varies_least():
    t = np.arange(0, 40, 0.016)
    moving = np.where((t > 22) & (t < 34), 0.0, 0.05 * np.sin(t))
    noise = 1e-3 * np.random.default_rng(0).standard_normal((len(t), 2))
    u = np.column_stack(
        [20 * (0.02 + moving + noise[:, 0]), 20 * (-0.07 + noise[:, 1]), np.full(len(t), 20.0)]
    )
    ratio, deviation = mitchell.rest_of(mitchell.Hall(t, u, {}))
    assert ratio == pytest.approx(0.02 - 0.07j, abs=2e-4)
    assert deviation == pytest.approx(1e-3, rel=0.1)
    with pytest.raises(
        InputError, match=r"recording of rest_of must be longer than 20 s; instead received 16\.0 s"
    ):
        mitchell.rest_of(mitchell.Hall(t[:1001], u[:1001], {}))


def test_without_recordings_takes_and_light_bulb_are_synthetic(monkeypatch, tmp_path):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    assert mitchell.bend_takes()[1] == mitchell.light_files()[1] == "synthetic"
    assert mitchell.unlike_released() == []


def test_a_recording_with_other_content_is_named(monkeypatch, tmp_path):
    (tmp_path / "mitchell2021/mocap").mkdir(parents=True)
    write(tmp_path / "mitchell2021/mocap/bend_0_try_1.csv", ["Format Version,1.21"])
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    assert mitchell.unlike_released() == ["mocap/bend_0_try_1.csv"]


@pytest.mark.skipif(not RECORDED, reason="there are no recordings")
def test_released_takes_follow_the_displacement_and_repeat():
    takes = mitchell.recorded_takes()
    assert mitchell.unlike_released() == []
    facts = mitchell.taken(takes)
    assert facts["off_displacement_deg"].max() < 0.6
    assert facts["masked_percent"].max() < 8
    assert facts["lag_s"].between(0.4, 0.7).all()
    assert facts["peak_deg"].between(49, 57).all()
    # The authors' own output of tests 3 and 4 is that of the released settings, too small by a factor.
    logged = {take.name: np.nanmax(np.abs(take.log)) for take in takes if take.log is not None}
    assert logged["bend_3_try_1"] == pytest.approx(np.radians(30), rel=0.1)


def test_captures_begin_by_the_clock_of_their_header():
    started = datetime(2021, 3, 12, 21, 50, 1, 253000)
    found = mitchell.motion(MotionCapture("a", started, 120.0, *capture(np.zeros(9, dtype=complex))[3:]))
    assert found.start_s == pytest.approx(1615603801.253, abs=1e-6)


def test_a_lag_is_compared_with_the_median_of_the_other_takes():
    lags = {"1": 1.0, "2": 2.0, "3": 3.0, "4": 8.0}
    takes = [replace(made_up(f"bend_{k}_try_1", 10.0), facts={"lag_s": lag_s}) for k, lag_s in lags.items()]
    found = mitchell.taken(takes)[["lag_off_s", "peak_deg"]]
    np.testing.assert_allclose(found, [[-2, 10], [-1, 10], [1, 10], [6, 10]])


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        # The deviation along a bend of 3 and 4, if it is 10 along x alone.
        (
            lambda: mitchell.bend_deviation(
                Estimate(np.array([3.0, 4.0]), np.diag([100.0, 0.0]), *[np.zeros(1)] * 4, {})
            ),
            6,
        ),
        # Of x and of y over z, each by itself.
        (
            lambda: mitchell.median(mitchell.ratio(np.array([[1, 60, 10], [2, 40, 10], [9.0, 90, 10]]))),
            0.2 + 6j,
        ),
        # Directions less their mean, where the take is known.
        (
            lambda: mitchell.over_time(
                [
                    mitchell.Run(
                        "ours",
                        "none",
                        13.0,
                        made_up("bend_1_try_1", 30),
                        np.exp(1j * np.radians([50, 0, 70, 60])),
                    )
                ]
            )["direction_deg"].to_list(),
            [0, np.nan, 0, 0, -10, np.nan, 10, 0],
        ),
        (lambda: mitchell.rms_deg(np.radians([0.0, np.nan, 0.0, 0.0, 8.0])), 4),
    ],
)
def test_numbers_of_the_page_by_hand(found, expected):
    assert found() == pytest.approx(expected, nan_ok=True, abs=1e-9)
