"""Bend tests, nominal bends and light bulb of Mitchell et al.: files, markers, lags, errors.

The files are SYNTHETIC, in the form of the released ones: a module with an invented sensor bends as we say.
"""

import json
import re
from dataclasses import replace
from datetime import datetime

import numpy as np
import pandas as pd
import pytest
from IPython.display import display
from scipy.spatial.transform import Rotation

from repro import InputError
from repro.estimators.base import Estimate
from repro.motion_files import Motion as MotionCapture
from repro_companion.papers import mitchell, mitchell_files, mitchell_takes
from repro_companion.run import project_folder

GAIN, TILTED_MT, TURNED, LAG_S, RATE_HZ = 1.2, (0.3, -0.5), 0.4, 0.5, 40.0
"""Gain across over along the body, field of a tilted magnet, azimuth of the capture, lag, rate of the sensor."""
START_S, HEIGHT, DURATION_S = 1.6e9, 0.116, 12.0
HALF_TURNED = Rotation.from_rotvec(np.radians(178.0) * np.array([0.0, 0.3, 0.954]))
"""The exchange of markers."""
TAKES = ((0, 1), (0, 2), (2, 1), (4, 1))
"""Tests and tries; from test to test the direction turns by 60 deg."""
EVENTS = {-1: (), 0: (8.0, 13.0, 18.0), 1: (9.0, 14.0, 19.0), 2: (13.0,)}
"""When the bulb is tightened [s], by file."""


def up_and_down(t, duration_s=DURATION_S):
    """The bend [rad] of a module that rests for 4 s, rises to 50 deg and falls again."""
    return np.radians(50.0) * np.sin(np.pi * np.clip((t - 4.0) / duration_s, 0.0, 1.0)) ** 2


def field_mt(bend, towards, rng):
    """Magpylib's field, seen by the invented sensor with noise."""
    u = mitchell.readings(mitchell.bend_vector(bend, towards), 13e-3)
    u[..., :2] = GAIN * u[..., :2] + TILTED_MT
    return u + mitchell.SENSOR_NOISE_MT * rng.standard_normal(u.shape)


def hall_of(bend, towards, duration_s, rng):
    """Readings over time."""
    steps = rng.uniform(0.8, 1.2, int(duration_s * RATE_HZ)) / RATE_HZ
    t = np.cumsum(steps) - steps[0]
    return mitchell_files.Hall(START_S + t, np.round(field_mt(bend(t), towards, rng), 2), {})


def capture_of(q):
    """Motion capture of bends, complex [rad], 120 a second; above 40 deg some markers are exchanged."""
    bend, about = np.abs(q), np.stack([np.cos(np.angle(q)), 0 * np.abs(q), -np.sin(np.angle(q))], axis=-1)
    turned = Rotation.from_rotvec(bend[:, None] * about)
    off = (bend > np.radians(40)) & (np.arange(len(q)) % 120 < 40)
    seen = np.where(off[:, None], (turned * HALF_TURNED).as_quat(), turned.as_quat())
    aside = HEIGHT * np.exp(1j * np.angle(q)) * bend / 2 * np.sinc(bend / 2 / np.pi) ** 2
    poses = np.stack([*seen.T, aside.imag, HEIGHT * np.sinc(bend / np.pi), aside.real], axis=-1)
    started = datetime.fromtimestamp(START_S + 1.0 - LAG_S, mitchell_files.ZONE).replace(tzinfo=None)
    return MotionCapture("made", started, 120.0, np.arange(len(q)) / 120, {"Module": np.round(poses, 6)}, 0)


def in_file(u):
    """Readings in the units and axes of the files: x is along the body, and y is mirrored."""
    return u @ mitchell_files.MODEL_FROM_FILE / mitchell_files.MT_PER_UNIT


def write(path, lines):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_hall(path, hall):
    """As the recorder writes, with 15 rows that a buffer held."""
    times = [*(hall.time_s[0] - 0.1 + 3e-4 * np.arange(15)), *hall.time_s]
    u = in_file(np.concatenate([hall.u[:1].repeat(15, axis=0), hall.u]))
    write(path, [f"[{x:.3f} {y:.3f} {z:.3f}],{t:.6f}" for (x, y, z), t in zip(u, times, strict=True)])


def write_capture(path, seen):
    """As Motive exports it."""
    began = f"{seen.started:%Y-%m-%d %I.%M.%S}.{seen.started.microsecond // 1000:03d} {seen.started:%p}"
    head = [
        f"Format Version,1.21,Export Frame Rate,120,Capture Start Time,{began},"
        f"Total Exported Frames,{len(seen.times)},Rotation Type,Quaternion,Length Units,Millimeters",
        "",
        *(",," + ",".join([name] * 8) for name in ("Rigid Body", "Module", "1")),
        ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Error Per Marker",
        "Frame,Time,X,Y,Z,W,X,Y,Z,",
    ]
    poses = seen.bodies["Module"] * [1, 1, 1, 1, 1e3, 1e3, 1e3]
    frames = [f"{k},{k / 120:.6f},{','.join(f'{x:.6f}' for x in row)},0" for k, row in enumerate(poses)]
    write(path, head + frames)


def write_nominal(folder, direction, bend_deg, repetition, u):
    path = folder / f"calibrate_data/{direction}/{bend_deg}deg_{repetition}.csv"
    return write(path, [",".join(f"{x:.3f}" for x in row) for row in in_file(u)])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Bend tests, two repetitions of every nominal bend, and the light bulb."""
    root = tmp_path_factory.mktemp("recordings")
    folder, rng, t = root / "mitchell2021", np.random.default_rng(3), np.arange(1, DURATION_S + 7, 1 / 120)
    for test, attempt in TAKES:
        hall = hall_of(up_and_down, np.radians(60.0) * test, DURATION_S + 8, rng)
        write_hall(folder / f"experiment_data/bend_test_{test}_try_{attempt}.csv", hall)
        seen = capture_of(up_and_down(t) * np.exp(1j * (np.radians(60.0) * test + TURNED)))
        write_capture(folder / f"mocap/bend_{test}_try_{attempt}.csv", seen)
    for direction, degrees in mitchell_files.DIRECTIONS_DEG.items():
        for bend_deg in range(0 if direction == "0dir" else 10, 100, 10):
            for repetition in (1, 2):
                u = field_mt(np.full(40, np.radians(bend_deg)), np.radians(degrees), rng)
                write_nominal(folder, direction, bend_deg, repetition, u)
    for name, events in EVENTS.items():
        hall = hall_of(lambda t, events=events: tightening(t, events), np.radians(30.0), 24.0, rng)
        write_hall(folder / f"experiment_data/light_test_{name}.csv", hall)
    return root


def tightening(t, events):
    """The bend [rad] of a module that grasps and tightens; without events it only moves and rests."""
    if not events:
        return up_and_down(t, 7.0)
    bumps = sum(np.exp(-(((t - at) / 0.5) ** 2)) for at in events)
    return np.radians(40.0 * np.clip((t - 3.0) / 2.0, 0.0, 1.0) + 8.0 * bumps)


@pytest.fixture
def in_place(files, monkeypatch):
    monkeypatch.setenv("REPRO_DATA_DIR", str(files))


@pytest.fixture(scope="module")
def takes(files):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("REPRO_DATA_DIR", str(files))
        return mitchell_files.recorded_takes()


def test_files_give_the_motion_that_they_were_written_from(takes):
    """What a buffer held is dropped, exchanged markers are turned back, the lag is found."""
    assert [take.name for take in takes] == [f"bend_{test}_try_{attempt}" for test, attempt in TAKES]
    for take, (test, _) in zip(takes, TAKES, strict=True):
        q = up_and_down(take.time_s) * np.exp(1j * (np.radians(60.0) * test + TURNED))
        np.testing.assert_allclose(take.q, q, atol=np.radians(0.3))
        assert (take.facts["buffered"], take.facts["undone"], take.facts["masked_percent"]) == (15, 132, 0.0)
        assert take.facts["lag_s"] == LAG_S
        assert take.facts["off_displacement_deg"] < 0.01


@pytest.mark.slow
@pytest.mark.usefixtures("in_place")
def test_the_page_finds_gain_and_events_in_files(tmp_path, monkeypatch):
    """All of its code: nominal bends calibrate the sensor that was invented, and every event is found."""
    monkeypatch.setenv("REPRO_RESULTS", str(tmp_path))
    cells = json.loads((project_folder() / "notebooks/bend_tests.ipynb").read_text(encoding="utf-8"))["cells"]
    page = {"display": lambda *what, **_: display(*what)}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), page)
            page["fast"] = True
    nominal = page["nominal"].set_index("direction")
    np.testing.assert_allclose(nominal["gain"], GAIN, rtol=0.01)
    assert nominal["turn_deg"].abs().max() < 1
    assert nominal["error_deg"].max() < 1
    rmse_deg = page["medians"].set_index("name")["rmse_deg"]
    assert rmse_deg.filter(like="ratios, calibrated").max() < 0.5
    assert f"paper's filter, arc from nominal bends, {13 * GAIN ** (-1 / 3):.1f} mm" in rmse_deg
    events = page["counts"].set_index("frozen").loc[True]
    assert [events[f"light_{k}"] for k in (0, 1, 2)] == [3, 3, 1]


def capture(q, n_lost=0):
    """Motion capture of bends, without exchanged markers; the last frames without the body."""
    found = capture_of(np.asarray(q))
    poses = found.bodies["Module"].copy()
    poses[len(poses) - n_lost :] = np.nan
    return found._replace(bodies={"Module": poses})


@pytest.mark.parametrize("azimuth_deg", [-150.0, -30.0, 0.0, 90.0, 179.0])
def test_bend_and_direction_are_those_of_the_y_axis(azimuth_deg):
    q = np.radians(np.linspace(0, 39, 200)) * np.exp(1j * np.radians(azimuth_deg))
    found = mitchell_files.motion(capture(q, n_lost=4)._replace(missing=50))
    np.testing.assert_allclose(found.q[:-4], q[:-4], atol=1e-4)
    assert np.isnan(found.q[-4:]).all()
    assert found.facts["masked_percent"] == pytest.approx(100 * 54 / 250)  # also frames that the file lacks
    if azimuth_deg in (0.0, 90.0):  # the tilt of z is the bend only about one axis of the world
        np.testing.assert_allclose(found.tilt_z[:-4], np.abs(q[:-4]) * (azimuth_deg == 0), atol=2e-4)


def test_the_misfit_of_the_tilt_is_a_root_mean_square():
    """Of three frames at one place one tilts 0.8 deg too far, and two 0.4 deg too little."""
    bend_deg = np.linspace(0, 39, 300).repeat(3)
    off_deg = np.where(bend_deg > 1, np.tile([0.8, -0.4, -0.4], 300), 0.0)
    there, tilted = (capture(np.radians(x)) for x in (bend_deg, bend_deg + off_deg))
    poses = np.hstack([tilted.bodies["Module"][:, :4], there.bodies["Module"][:, 4:]])
    facts = mitchell_files.motion(there._replace(bodies={"Module": poses})).facts
    assert facts["off_displacement_deg"] == pytest.approx(np.sqrt((off_deg**2).mean()), rel=0.02)


def test_frames_beside_a_jump_are_left_out():
    q = np.radians(np.where((np.arange(100) >= 40) & (np.arange(100) < 43), 14.0, 10.0)).astype(complex)
    found = np.flatnonzero(np.isnan(mitchell_files.motion(capture(q)).q))
    assert found.tolist() == list(range(40 - mitchell_files.GUARD, 43 + mitchell_files.GUARD))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"started": None}, "Capture Start Time of made must be in the header; instead received nothing."),
        ({"bodies": {"Ground": np.zeros((9, 7))}}, "body of made must be Module; instead received Ground."),
        ({"bodies": {"Module": np.tile([1.0, 0, 0, 0.2, 0, 0, 0], (9, 1))}}, "first frame of made must be up"),
    ],
)  # fmt: skip
def test_other_motion_capture_is_refused(change, message):
    with pytest.raises(InputError, match=re.escape(message)):
        mitchell_files.motion(capture(np.zeros(9, dtype=complex))._replace(**change))


def rows(n=40, first_s=1000.0):
    """Rows of a Hall file: three from a buffer, then one every 16 ms."""
    times = [first_s - 0.1 + 3e-4 * k for k in range(3)] + [first_s + 0.016 * k for k in range(n)]
    return [f"[-2.4{k % 10}e+00 -1.000e-03  {k % 7:d}.0e-02],{t!r}" for k, t in enumerate(times)]


def test_what_is_no_reading_is_counted_and_dropped(tmp_path):
    lines = rows()
    lines[20], lines[30] = "[-2.4 0.0],1000.27", "[-2.4 0.0 9.0],1000.432"
    found = mitchell_files.read_hall(write(tmp_path / "a.csv", lines))
    assert found.facts == {"buffered": 3, "unreadable": 1, "beyond_range": 1, "gain_switches": 0}
    assert len(found.u) == 38
    assert found.time_s[0] == 1000.0
    # The first live row is -2.43, -0.001, 0.03 in units of 10 mT: y of the model is -z, z is -x.
    np.testing.assert_allclose(found.u[0], [-0.01, -0.3, 24.3])


def test_a_gain_that_switches_is_counted_and_leaves_the_ratios(tmp_path):
    lines = rows()
    plain = mitchell_files.read_hall(write(tmp_path / "a.csv", lines))
    for k in range(15, 30):
        field, t = lines[k].split(",")
        lines[k] = f"[{' '.join(f'{1.155 * float(x):.6f}' for x in field[1:-1].split())}],{t}"
    found = mitchell_files.read_hall(write(tmp_path / "b.csv", lines))
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
    with pytest.raises(InputError, match=re.escape(message)):
        mitchell_files.read_hall(write(tmp_path / "a.csv", change(rows())))


def test_a_gap_in_the_readings_does_not_move_the_lag():
    hall = hall_of(lambda t: up_and_down(t, 30.0), np.radians(30), 38.0, np.random.default_rng(0))
    motion = mitchell_files.motion(capture_of(up_and_down(np.arange(1, 37, 1 / 120), 30.0) + 0j))
    t = hall.time_s - hall.time_s[0]
    holed = hall._replace(time_s=hall.time_s[(t < 12) | (t > 20)], u=hall.u[(t < 12) | (t > 20)])
    take = mitchell_files.aligned("bend_1_try_1", holed, motion)
    assert take.facts["lag_s"] == pytest.approx(LAG_S, abs=0.02)
    assert take.facts["longest_gap_s"] == pytest.approx(8, abs=0.1)


def test_a_log_is_laid_on_the_readings_by_its_own_clock():
    """It begins with the 31st reading and ends with the 70th, and its direction is mirrored."""
    t = np.cumsum(np.random.default_rng(1).uniform(0.012, 0.02, 100))
    log = pd.DataFrame({"time": t[30:70] - t[30], "bend_ang": np.linspace(0.1, 0.5, 40), "bend_dir": 0.25})
    found = mitchell_files.on_readings(log, t)
    assert np.flatnonzero(np.isfinite(found)).tolist() == list(range(30, 70))
    np.testing.assert_allclose(np.abs(found[30:70]), log["bend_ang"])
    np.testing.assert_allclose(np.angle(found[30:70]), np.pi - 0.25)


def made_up(name, truth_deg, direction_deg=0.0):
    """A take at constant bend, its second reading masked."""
    q = np.radians(np.full(4, truth_deg)) * np.exp(1j * np.radians(direction_deg))
    tilt_z = np.radians(np.full(4, truth_deg / 2))
    q[1] = tilt_z[1] = np.nan
    u = np.tile([0.0, 2.0, 20.0], (4, 1))
    return mitchell_files.Take(name, np.arange(4.0), u, np.zeros(4), u[0], q, tilt_z, None, {})


def run(take, off_deg, turned_deg=0.0, deviation_deg=1.0, calibration="none"):
    bend = np.radians(np.nanmean(np.degrees(np.abs(take.q))) + off_deg * np.ones(4))
    q = bend * np.exp(1j * (np.nanmean(np.angle(take.q)) + np.radians(turned_deg)))
    return mitchell_takes.Run("ours", calibration, 13.0, take, q, np.radians(np.full(4, deviation_deg)))


def test_errors_of_made_up_takes():
    """Three readings count. Errors of 3, 4 and 0 degrees: sqrt(25/3); the z axis tilts by half: 18, 19 and 15."""
    line = mitchell_takes.bend_errors(
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
    found = mitchell_takes.bend_errors(runs)["direction_deg"]
    np.testing.assert_allclose(found, [5.0, 17.5, 12.5], atol=1e-6)
    nominal = [one._replace(calibration="nominal bends") for one in runs]
    np.testing.assert_allclose(
        mitchell_takes.bend_errors(nominal)["direction_deg"], [5.0, 17.5, 12.5], atol=1e-6
    )
    calibrated = [one._replace(calibration="other tests") for one in runs]
    np.testing.assert_allclose(
        mitchell_takes.bend_errors(calibrated)["direction_deg"], [35, 20, 40], atol=1e-6
    )
    small = run(made_up("bend_1_try_1", 19.9), 0.0, 35.0)
    assert np.isnan(mitchell_takes.bend_errors([small])["direction_deg"].item())


def test_two_tries_of_one_test_do_not_correct_each_other():
    runs = [run(made_up(f"bend_1_try_{k}", 30), 0.0, 30.0) for k in (1, 2)]
    np.testing.assert_allclose(mitchell_takes.bend_errors(runs)["direction_deg"], 30.0, atol=1e-6)


def test_medians_are_over_the_takes_of_a_method_and_a_length():
    takes = [made_up(f"bend_{k}_try_1", 30) for k in (1, 2, 3)]
    runs = [run(take, off) for take, off in zip(takes, (1.0, 2.0, 9.0), strict=True)]
    longer = [one._replace(method="paper, as released", length_mm=mm) for one in runs for mm in (13.0, 15.0)]
    found = mitchell_takes.median_errors(mitchell_takes.bend_errors([*runs, *longer]))
    np.testing.assert_allclose(found["rmse_deg"], 2.0)
    assert found["takes"].tolist() == [3, 3, 3]
    assert found["name"].tolist()[1:] == [
        f"paper's filter, released settings{mm} mm" for mm in (", 13", " but 15")
    ]


def test_takes_side_by_side_end_in_nothing():
    table = mitchell_files.side_by_side([np.ones((2, 3)), 2 * np.ones((1, 3))])
    np.testing.assert_array_equal(table[..., 0], [[1, 2], [1, np.nan]])
    assert table.shape == (2, 2, 3)


def test_no_take_calibrates_itself(takes):
    for take in takes:
        found = mitchell_files.calibrations(take, takes)
        assert all(other is not take for some in found.values() for other in some)
        assert {other.test for other in found.get("other try", [])} <= {take.test}
        assert take.test not in {other.test for other in found["other tests"]}
    assert [len(mitchell_files.calibrations(take, takes).get("other try", [])) for take in takes] == [
        1,
        1,
        0,
        0,
    ]
    assert list(mitchell_files.calibrations(takes[0], takes[:1])) == ["none"]


def test_rest_is_where_the_ratio_varies_least():
    t = np.arange(0, 40, 0.016)
    moving = np.where((t > 22) & (t < 34), 0.0, 0.05 * np.sin(t))
    noise = 1e-3 * np.random.default_rng(0).standard_normal((len(t), 2))
    u = np.column_stack(
        [20 * (0.02 + moving + noise[:, 0]), 20 * (-0.07 + noise[:, 1]), np.full(len(t), 20.0)]
    )
    ratio, deviation = mitchell_files.rest_of(mitchell_files.Hall(t, u, {}))
    assert ratio == pytest.approx(0.02 - 0.07j, abs=2e-4)
    assert deviation == pytest.approx(1e-3, rel=0.1)
    with pytest.raises(
        InputError, match=r"recording of rest_of must be longer than 20 s; instead received 16\.0 s"
    ):
        mitchell_files.rest_of(mitchell_files.Hall(t[:1001], u[:1001], {}))


@pytest.mark.usefixtures("in_place")
def test_a_page_says_which_files_are_missing_or_others(monkeypatch, tmp_path):
    """Of 151 released ones: here are 4 bend tests, 4 bulbs and 74 nominal bends, none of them released."""
    said = mitchell_files.files_in_words()
    counts = "8 of 16 files of the Hall sensor in the experiments, 8 of 12 files of motion capture, 12 of 12 files of"
    assert said.startswith(
        f"Not found: {counts} the authors' filter, 37 of 111 files at nominal bends. **Not the"
    )
    assert "calibrate_data/0dir/0deg_1.csv" in said
    assert "repro fetch mitchell2021" in said
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    assert "151 files (15 MB)" in mitchell_files.files_in_words()
    assert (
        mitchell_files.recorded_takes(),
        mitchell_files.nominal_bends(),
        mitchell_files.light_files(),
    ) == ([], None, {})


def test_nominal_bends_are_medians_without_spikes_and_with_signs_of_the_files(tmp_path, monkeypatch):
    """At rest 22 mT along the body; towards 90 deg the third column falls, towards 0 deg the second rises."""
    rest = np.array([[0.0, 0.0, 22.0]]).repeat(20, axis=0)
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    folder = tmp_path / "mitchell2021"
    write_nominal(folder, "0dir", 0, 1, rest)
    lines = write_nominal(folder, "0dir", 90, 2, rest + np.array([2.2, 0, 0])).read_text().splitlines()
    assert lines[0] == "-2.200,0.220,0.000"
    lines[3], lines[7] = "-212.5,0.22,0", "-2.2,0.22"
    write(folder / "calibrate_data/0dir/90deg_2.csv", lines)
    write_nominal(folder, "pi2dir", 30, 1, rest + np.array([0, 4.4, 0]))
    found = mitchell_files.nominal_bends()
    np.testing.assert_allclose(found.ratio, [0.1, 0.2j], atol=1e-12)
    np.testing.assert_allclose(found.across_mt, [2.2, 4.4j], atol=1e-12)
    np.testing.assert_allclose(found.q, [np.pi / 2, 1j * np.pi / 6], atol=1e-12)
    assert found.files[["rows", "spikes", "unreadable"]].to_numpy().tolist() == [[20, 1, 1], [20, 0, 0]]
    assert found.suspect.tolist() == [True, False]


@pytest.mark.parametrize(
    ("name", "lines", "message"),
    [
        ("0dir/15deg_1", ["-2.2,0,0"], "must be DIRECTION/BENDdeg_REPETITION.csv"),
        ("0dir/10deg_1", ["[-2.2 0 0],1600000000.0"] * 9, "at most 5 % unreadable; instead received 9 of 9"),
        ("0dir/10deg_1", ["-2200,0,0"] * 9, "must be between 0.5 and 8.192 units of 10 mT; instead received 2200."),
        ("0dir/10deg_1", ["-2.2,0,0"] * 9 + ["-4.2,0,0"], "but 5 %; instead received 1 of 10 elsewhere"),
    ],
)  # fmt: skip
def test_other_files_of_nominal_bends_are_refused(tmp_path, monkeypatch, name, lines, message):
    write(tmp_path / f"mitchell2021/calibrate_data/{name}.csv", lines)
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    with pytest.raises(InputError, match=re.escape(message)):
        mitchell_files.nominal_bends()


def test_repetitions_differ_and_cross_by_hand():
    """Ratios are bends here, 10 and 13 deg for 10, 24 and 20 for 20; the factor is the mean repetition."""
    found_deg, nominal_deg = np.array([10.0, 13, 24, 20]), np.array([10.0, 10, 20, 20])
    files = pd.DataFrame({"direction": "0dir", "bend_deg": nominal_deg, "repetition": [1, 2, 1, 2]})
    files = files.assign(rows=9, spikes=1, unreadable=0)
    bends = mitchell_files.NominalBends(files, *np.radians([nominal_deg, found_deg, found_deg]), 0.1j)
    table = mitchell_takes.nominal_errors(
        bends, lambda some: some[0].files["repetition"].mean(), lambda m, c: (m * c, None)
    ).set_index("direction")
    line = table.loc["all"]
    assert line["repeat_deg"] == pytest.approx(np.sqrt((4.5**2 + 6**2) / 2))
    assert line["error_deg"] == pytest.approx(np.sqrt((10**2 + 3**2 + 28**2 + 0**2) / 4))
    assert (line["gain"], line["rest"], line["spikes"], line["files"]) == (1.5, 0.1, 4, 4)
    assert list(table.index) == ["all", "0°", "all, with 90° in direction 0°"]
    names = [mitchell_takes.METHODS["ours", how] for how in ("none", "other tests", "nominal bends")]
    rmse_deg, takes = pd.Series([8.2, 1.9, 14.0], names), pd.DataFrame({"gain": [0.6, 0.9], "rest": 0.05})
    said = mitchell_takes.nominal_in_words(table.reset_index(), rmse_deg, takes)
    assert "an error of 14°, which is worse than without any calibration" in said
    assert "Without it the error is 8.2°, and with a calibration on other tests 1.9°." in said
    assert "at about 50 % of its size" in said
    said = mitchell_takes.nominal_in_words(table.reset_index(), rmse_deg[:2], takes)
    assert said.startswith("The files at nominal bends are not here.")


def test_the_arc_of_nominal_bends_is_the_one_that_made_them():
    """A cube at 11 mm is nearly a dipole; a suspect file does not count."""
    q = np.radians([30.0, 60.0, 90.0]) * np.exp(1j * np.radians([0.0, 90.0, 0.0]))
    u = mitchell.BendSensor(11e-3)(np.stack([q.real, q.imag], axis=-1))
    across = (u[:, 0] + 1j * u[:, 1]) * [1, 1, 0.2]
    files = pd.DataFrame({"direction": ["0dir", "pi2dir", "0dir"], "bend_deg": [30, 60, 90]})
    bends = mitchell_files.NominalBends(files, q, across, across, 0j)
    (calibrating,) = mitchell_files.calibrations(made_up("bend_1_try_1", 30), [], bends)["nominal bends"]
    assert calibrating.files["bend_deg"].tolist() == [30, 60]
    assert mitchell_takes.nominal_length_mm(bends, 13.0) == pytest.approx(11.0, rel=0.01)


def test_captures_begin_by_the_clock_of_their_header():
    started = datetime(2021, 3, 12, 21, 50, 1, 253000)
    found = mitchell_files.motion(
        MotionCapture("a", started, 120.0, *capture(np.zeros(9, dtype=complex))[3:])
    )
    assert found.start_s == pytest.approx(1615603801.253, abs=1e-6)


def test_a_lag_is_compared_with_the_median_of_the_other_takes():
    lags = {"1": 1.0, "2": 2.0, "3": 3.0, "4": 8.0}
    takes = [replace(made_up(f"bend_{k}_try_1", 10.0), facts={"lag_s": lag_s}) for k, lag_s in lags.items()]
    found = mitchell_takes.taken(takes, [0.5] * 4)[["lag_off_s", "peak_deg", "rest"]]
    np.testing.assert_allclose(found, [[-2, 10, 0.1], [-1, 10, 0.1], [1, 10, 0.1], [6, 10, 0.1]])


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        # The deviation along a bend of 3 and 4, if it is 10 along x alone.
        (
            lambda: mitchell_takes.bend_deviation(
                Estimate(np.array([3.0, 4.0]), np.diag([100.0, 0.0]), *[np.zeros(1)] * 4, {})
            ),
            6,
        ),
        # Of x and of y over z, each by itself.
        (
            lambda: mitchell_files.median(
                mitchell_files.ratio(np.array([[1, 60, 10], [2, 40, 10], [9.0, 90, 10]]))
            ),
            0.2 + 6j,
        ),
        # Directions less their mean, where the take is known.
        (
            lambda: mitchell_takes.over_time(
                [
                    mitchell_takes.Run(
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
        (lambda: mitchell_takes.rms_deg(np.radians([0.0, np.nan, 0.0, 0.0, 8.0])), 4),
    ],
)
def test_numbers_of_the_page_by_hand(found, expected):
    assert found() == pytest.approx(expected, nan_ok=True, abs=1e-9)


def test_events_of_the_bulb_count_from_ten_times_the_noise_and_bends_from_rest():
    """Detectors and filters that say what they are given: levels and pauses, and fields less those at rest."""
    u = np.r_[np.full((100, 3), 2.0), np.full((100, 3), 2.5)]
    light = {name: mitchell_files.Hall(np.arange(200.0), u, {}) for name in mitchell_files.BULB}
    rises = {name: pd.DataFrame({"time_s": np.arange(200.0)}) for name in [*light, "light_-1"]}
    marks = mitchell_takes.bulb_events(rises, 0.4, lambda _, level, apart: [(level, apart)])
    assert marks.to_numpy().tolist() == [[name, 4.0, 1.0] for name in light]
    counts = mitchell_takes.event_counts(rises, 0.4, lambda _, level, apart: range(round(level + 4 * apart)))
    assert counts["light_0"].tolist() == [x + y for x in (2, 4, 8, 16) for y in (1, 4)]
    shown = mitchell_takes.bulb_shown(counts)
    assert shown.iloc[:, 2:].to_numpy().tolist() == [[8, 3, 20]] * 4
    curves = mitchell_takes.bulb_curves(light, rises, lambda x: x[..., :2], lambda x, rest: x - rest)
    last = curves[curves["file"] == "light_2"].set_index("time_s")
    assert list(last.index) == [*range(0, 200, 4)]
    np.testing.assert_allclose(last["bend_deg"], np.where(last.index < 100, 0.0, np.degrees(0.5**0.5)))
    assert last.loc[196, "direction_deg"] == pytest.approx(45)
