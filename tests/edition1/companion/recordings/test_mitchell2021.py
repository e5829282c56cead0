"""The recordings of Mitchell et al.: small synthetic files written here, and the released ones where found."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_mitchell2021_capture import START_UNIX_S, UP_AND_DOWN, bending, write_capture

from edition1.errors import InputError
from edition1_companion.recordings.mitchell2021 import (
    FIELD,
    GAIN_RATIO,
    align,
    bending_signal,
    read_hall,
    takes,
)
from edition1_companion.recordings.mitchell2021_capture import read_capture
from edition1_companion.recordings.mitchell2021_tables import on_readings, read_calibration, read_filtered

DRAINED = 15


def write_hall(path: Path, time_s: np.ndarray, field: np.ndarray, drained: int = DRAINED) -> Path:
    """Write a synthetic Hall file as the authors' recorder does: NumPy rows, after a burst of buffered ones."""
    path.parent.mkdir(parents=True, exist_ok=True)
    burst_s = time_s[0] - 0.01 - 3e-4 * np.arange(drained, 0, -1)
    rows = np.concatenate([np.repeat(field[:1], drained, axis=0), field])
    if drained:
        rows[0] = [0, 0, 0.003]
    times = np.concatenate([burst_s, time_s])
    with np.printoptions(precision=4):
        path.write_text(
            "".join(f"{np.round(row, 3)},{t!r}\n" for row, t in zip(rows, times.tolist(), strict=True))
        )
    return path


def synthetic_field(bend_rad: np.ndarray) -> np.ndarray:
    """A synthetic field [mT / 10] that weakens as the body bends, and turns as a dipole's does."""
    axial = -2.3 * (1 - 0.3 * np.sin(bend_rad))
    return np.stack([axial, axial * 0.2 * np.sin(bend_rad), 0.05 * axial], axis=1)


def with_gain(field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pass a synthetic field through a gain that switches at 1.9 and 2.57, and return the gain too."""
    gain, sent, gains = 1.0, [], []
    for row in field:
        magnitude = np.linalg.norm(row) * gain
        gain *= GAIN_RATIO if magnitude < 1.9 else 1 / GAIN_RATIO if magnitude > 2.57 else 1.0
        sent.append(row * gain)
        gains.append(gain)
    return np.array(sent), np.array(gains)


@pytest.fixture
def times() -> np.ndarray:
    """Times of synthetic readings, unevenly at about 61 Hz; the first is 3 s before the synthetic capture."""
    return START_UNIX_S - 3 + np.cumsum(np.random.default_rng(0).uniform(0.012, 0.0208, 1200))


@pytest.fixture
def hall_file(tmp_path, times) -> Path:
    bend = np.radians(np.interp(times - START_UNIX_S, np.arange(1320) / 120 + 0.5, UP_AND_DOWN))
    sent, _ = with_gain(synthetic_field(bend))
    return write_hall(tmp_path / "experiment_data/bend_test_0_try_1.csv", times, sent)


def test_readings_come_back_scaled_and_without_the_drained_buffer(hall_file, times):
    text = hall_file.read_text()
    assert "e-0" in text  # the authors' files hold such rows, so must this one
    hall = read_hall(hall_file)
    assert (hall.name, hall.unreadable, hall.drained, hall.masked) == ("bend_test_0_try_1", 0, DRAINED, 0)
    assert list(hall.readings) == ["time_s", *FIELD, "gain"]
    assert hall.start_unix_s == times[0]
    np.testing.assert_allclose(hall.readings["time_s"], times - times[0], atol=1e-6)
    first = [float(x) for x in text.splitlines()[DRAINED].split("]")[0].strip("[").split()]
    np.testing.assert_allclose(hall.readings[FIELD].iloc[0], 10 * np.array(first), atol=1e-12)


def test_without_a_buffer_only_the_first_row_is_dropped(tmp_path, times):
    hall = read_hall(write_hall(tmp_path / "a.csv", times, synthetic_field(np.zeros(1200)), drained=0))
    assert (hall.drained, len(hall.readings)) == (1, 1199)


def test_gain_is_found_where_it_switches(tmp_path, times):
    bend = np.radians(60) * np.sin(np.linspace(0, np.pi, 1200)) ** 2
    field = synthetic_field(bend)
    sent, gain = with_gain(field)
    hall = read_hall(write_hall(tmp_path / "a.csv", times, sent))
    assert hall.switches == 2
    np.testing.assert_allclose(hall.readings["gain"], gain)
    restored = hall.readings[FIELD].to_numpy() / hall.readings[["gain"]].to_numpy()
    np.testing.assert_allclose(restored, 10 * field, atol=0.0051)


def test_bending_signal_does_not_depend_on_gain(hall_file, tmp_path, times):
    hall = read_hall(hall_file)
    bend = np.radians(np.interp(times - START_UNIX_S, np.arange(1320) / 120 + 0.5, UP_AND_DOWN))
    assert hall.switches == 2
    np.testing.assert_allclose(bending_signal(hall), 0.2 * np.sin(bend), atol=1e-3)


@pytest.mark.parametrize(
    "row",
    ["", "junk", "[1 2],1615603801.0", "[1 2 x],1615603801.0", "[nan 0 0],1.0", "[1 2 3]", "[1 2 3 4],5.0"],
)
def test_rows_that_are_no_reading_are_counted_and_dropped_never_zero(hall_file, row):
    whole = read_hall(hall_file)
    lines = hall_file.read_text().splitlines()
    hall_file.write_text("\n".join([*lines[:500], row, *lines[500:800], row, *lines[800:]]))
    hall = read_hall(hall_file)
    assert hall.unreadable == 2
    pd.testing.assert_frame_equal(hall.readings, whole.readings)


def test_readings_beyond_the_range_are_masked_and_no_switch_of_gain(hall_file):
    whole = read_hall(hall_file)
    lines = hall_file.read_text().splitlines()
    for k in (DRAINED + 100, DRAINED + 101, DRAINED + 700):
        lines[k] = "[-212.4 0.1 0.2]," + lines[k].split(",")[1]
    hall_file.write_text("\n".join(lines))
    hall = read_hall(hall_file)
    assert (hall.masked, hall.switches, len(hall.readings)) == (3, whole.switches, len(whole.readings))
    np.testing.assert_array_equal(np.flatnonzero(hall.readings["bx_mT"].isna()), [100, 101, 700])
    np.testing.assert_array_equal(hall.readings["gain"], whole.readings["gain"])
    assert np.isnan(bending_signal(hall)).sum() == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "",
            r"rows of a\.csv must be readings, two of them more than 0\.001 s apart; .* 0 readings and 0 rows",
        ),
        ("x\ny\n", "instead received 0 readings and 2 rows that are none"),
        ("[1 2 3],5.0\n[1 2 3],5.0003\n", "instead received 2 readings and 0 rows that are none"),
        (
            "[1 2 3],5.0\n[1 2 3],6.0\n[1 2 3],5.5\n",
            r"times of a\.csv must be increasing; .* a step of -0\.5 s to row 2",
        ),
    ],
)
def test_hall_files_that_cannot_be_used(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_hall(tmp_path / "a.csv")


def test_a_hall_file_that_is_no_text(hall_file):
    hall_file.write_bytes(hall_file.read_bytes()[:2000] + b"\xfe\xff" * 20)
    with pytest.raises(InputError, match=r"content of bend_test_0_try_1\.csv must be text .* 0xfe at 2000"):
        read_hall(hall_file)


@pytest.mark.parametrize(
    ("row", "what"),
    [("junk", "unreadable"), ("[-212.4 0.1 0.2],{time}", r"beyond the sensor's range")],
)
def test_more_than_a_twentieth_of_the_rows_is_refused(hall_file, row, what):
    lines = hall_file.read_text().splitlines()
    for share, refused in ((24, False), (18, True)):  # one in 24 rows, one in 18
        spoilt = list(lines)
        for k in range(DRAINED + 5, len(lines), share):
            spoilt[k] = row.format(time=lines[k].split(",")[1])
        hall_file.write_text("\n".join(spoilt))
        if not refused:
            hall = read_hall(hall_file)
            assert max(hall.unreadable, hall.masked) == 50
            continue
        message = rf"rows of bend_test_0_try_1\.csv must be at most 5% {what}; .* 67 of 1215, 5\.5%\."
        with pytest.raises(InputError, match=message):
            read_hall(hall_file)


def test_a_long_burst_of_buffered_rows_is_refused(tmp_path, times):
    path = write_hall(tmp_path / "a.csv", times, synthetic_field(np.zeros(1200)), drained=70)
    with pytest.raises(InputError, match=r"at most 5% out of a buffer; .* 70 of 1270, 5\.5%\."):
        read_hall(path)


def test_a_gap_in_the_readings_moves_no_lag(tmp_path):
    """Twenty of sixty seconds are missing."""
    angles = np.concatenate([np.zeros(600), 50 * np.sin(np.linspace(0, np.pi, 4800)) ** 2, np.zeros(600)])
    capture = read_capture(write_capture(tmp_path / "bend_0_try_1.csv", bending(angles, 30.0)))
    time_s = START_UNIX_S - 3 + np.cumsum(np.random.default_rng(0).uniform(0.012, 0.0208, 3400))
    bend = np.radians(np.interp(time_s - START_UNIX_S, np.arange(6000) / 120 + 0.5, angles))
    kept = (time_s < START_UNIX_S + 15) | (time_s > START_UNIX_S + 35)
    sent, _ = with_gain(synthetic_field(bend))
    hall = read_hall(write_hall(tmp_path / "a.csv", time_s[kept], sent[kept]))
    assert hall.longest_gap_s == pytest.approx(20, abs=0.05)
    _, lag = align(hall, capture)
    assert lag.lag_s == pytest.approx(0.5, abs=0.02)


def test_missing_hall_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_hall(tmp_path / "a.csv")


def test_alignment_finds_the_lag_between_the_clocks(hall_file, tmp_path):
    """The synthetic field was made half a second late."""
    capture = read_capture(
        write_capture(tmp_path / "bend_0_try_1.csv", bending(UP_AND_DOWN, 30.0), lost=(700,))
    )
    hall = read_hall(hall_file)
    table, lag = align(hall, capture)
    assert lag.lag_s == pytest.approx(0.5, abs=0.01)
    assert lag.r > 0.99
    assert table["time_s"].iloc[0] == pytest.approx(3.5, abs=0.03)
    assert table["time_s"].iloc[-1] == pytest.approx(3.5 + 1319 / 120, abs=0.03)
    at_s = table["time_s"] + hall.start_unix_s - START_UNIX_S - lag.lag_s
    bend = np.interp(at_s, capture.motion["time_s"], np.radians(UP_AND_DOWN))
    known = table["bend_rad"].notna()
    # At most half a frame away, at 0.27 rad/s or less.
    np.testing.assert_allclose(table["bend_rad"][known], bend[known], atol=0.27 / 240 + 1e-4)
    assert (~known).sum() <= 1
    assert {"bx_mT", "gain", "direction_rad", "tilt_z_rad"} <= set(table)


def test_capture_of_another_time_is_refused(hall_file, tmp_path):
    path = write_capture(tmp_path / "a.csv", bending(UP_AND_DOWN, 30.0))
    path.write_text(path.read_text().replace("09.50.01.253 PM", "09.51.01.253 PM"))
    with pytest.raises(
        InputError,
        match=r"capture of bend_test_0_try_1 must be within the recording, 0 to 19\.\d s; "
        r"instead received a capture from 6\d\.\d to 7\d\.\d s\.",
    ):
        align(read_hall(hall_file), read_capture(path))


def test_capture_of_another_motion_is_refused(hall_file, tmp_path):
    angles = 20 + 20 * np.sin(np.arange(1320) / 30)
    path = write_capture(tmp_path / "a.csv", bending(angles, 30.0))
    with pytest.raises(InputError, match=r"^bend_test_0_try_1: Input recordings of find_lag must be with "):
        align(read_hall(hall_file), read_capture(path))


def test_takes_are_those_found(tmp_path):
    for name in (
        "experiment_data/bend_test_3_try_1.csv",
        "experiment_data/light_test_-1.csv",
        "mocap/bend_3_try_1.csv",
        "mocap/bend_1_try_2.csv",
        "mocap/.~lock.Bend 0 Try 1.csv#",
        "filter_readings/bend_3_try_1.csv",
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    one, both, light = takes(tmp_path)
    assert (one.name, one.hall, one.capture) == ("bend_1_try_2", None, tmp_path / "mocap/bend_1_try_2.csv")
    assert (both.name, None in (both.hall, both.capture, both.filtered)) == ("bend_3_try_1", False)
    assert (light.name, light.capture) == ("light_-1", None)
    assert takes(tmp_path / "nowhere") == []


def test_filtered(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(",bend_dir,bend_ang,time\n0,0.5,0.25,0.0\n1,-0.5,0.75,0.016\n")
    expected = pd.DataFrame({"time_s": [0, 0.016], "direction_rad": [0.5, -0.5], "bend_rad": [0.25, 0.75]})
    pd.testing.assert_frame_equal(read_filtered(path), expected)
    path.write_text(",bend_dir,time\n0,0.5,0.0\n")
    with pytest.raises(
        InputError, match=r"columns of a\.csv must be time, bend_dir, bend_ang; .* none of \['bend_ang'\]"
    ):
        read_filtered(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", r"rows of a\.csv must be a table; .* No columns to parse"),
        (b"bend_dir,bend_ang,time\n", r"rows of a\.csv must be finite numbers; .* no row"),
        (
            b"bend_dir,bend_ang,time\n1,2,\xff\n",
            r"content of a\.csv must be text in UTF-8; .* byte 0xff at 27",
        ),
        (b"bend_dir,bend_ang,time\n1,2,3\n1,x,4\n", r"rows of a\.csv .* others in 1 rows, first in row 2"),
        (b"bend_dir,bend_ang,time\n1,2,3\n1,2,3,4,5\n", r"rows of a\.csv must be a table"),
        (b"bend_dir,bend_ang,time\n1,2,3\n1,2,3\n", r"times of a\.csv must be increasing; .* to row 2"),
        (b"bend_dir,bend_ang,time\n1,2,\n", r"rows of a\.csv must be finite numbers; .* first in row 1"),
    ],
)
def test_logs_that_cannot_be_used(tmp_path, content, message):
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_filtered(path)


@pytest.mark.parametrize(("first", "last"), [(0, 900), (17, 900), (300, 900), (0, 400), (450, 900)])
def test_a_log_finds_its_readings_by_its_own_clock(first, last):
    """Rows from a buffer come before it, readings before and after it are not in it."""
    rng = np.random.default_rng(0)
    time_s = np.cumsum(rng.uniform(0.012, 0.02, 900))
    own_s = np.r_[time_s[first] - 3e-4 * np.arange(15, 0, -1) - 0.01, time_s[first:last]]
    number = np.r_[np.full(15, -1), np.arange(first, last)]
    log = pd.DataFrame({"time_s": own_s - own_s[0], "direction_rad": 0.5, "bend_rad": 0.001 * number})
    wanted = time_s[200:800]
    found = on_readings(log, wanted, time_s)
    inside = (np.arange(200, 800) >= first) & (np.arange(200, 800) < last)
    np.testing.assert_array_equal(found["bend_rad"].notna(), inside)
    np.testing.assert_allclose(found["bend_rad"][inside], 0.001 * np.arange(200, 800)[inside])


def test_a_log_of_other_readings_covers_little():
    rng = np.random.default_rng(0)
    time_s, own_s = (np.cumsum(rng.uniform(0.012, 0.02, 900)) for _ in range(2))
    log = pd.DataFrame({"time_s": own_s, "direction_rad": 0.5, "bend_rad": 0.1})
    assert on_readings(log, time_s, time_s)["bend_rad"].notna().mean() < 0.3


def calibration_file(folder: Path, name: str, text: str) -> None:
    path = folder / "calibrate_data" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def test_calibration(tmp_path):
    calibration_file(tmp_path, "3pi2dir/50deg_2.csv", "-2.0,0.1,-0.1\n-2.0,0.1,-212.0\n-2.1,0.1,-0.1\n")
    calibration_file(tmp_path, "0dir/0deg_1.csv", "-2.0,0.0,0.0\n")
    table = read_calibration(tmp_path)
    assert list(table) == ["direction_rad", "bend_rad", "repeat", *FIELD]
    assert table["direction_rad"].tolist() == [0, *[1.5 * np.pi] * 3]
    np.testing.assert_allclose(np.degrees(table["bend_rad"]), [0, 50, 50, 50])
    assert table["repeat"].tolist() == [1, 2, 2, 2]
    np.testing.assert_allclose(table[FIELD].iloc[[0, 1, 3]], [[-20, 0, 0], [-20, 1, -1], [-21, 1, -1]])
    assert table[FIELD].iloc[2].isna().all()
    assert read_calibration(tmp_path / "nowhere").empty


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("0dir/0deg_1.csv", "1.0,2.0\n", r"rows of 0dir/0deg_1\.csv must be three numbers each"),
        ("0dir/0deg_1.csv", "1.0,2.0,x\n", r"rows of 0dir/0deg_1\.csv must be three numbers each"),
        ("0dir/0deg_1.csv", "1.0,2.0,\n", r"rows of 0dir/0deg_1\.csv must be three numbers each"),
        ("0dir/0deg_1.csv", "", r"rows of 0dir/0deg_1\.csv must be three numbers each; .* no row"),
        ("0dir/0deg_1.csv", "1,2,3\n1,2\n", r"rows of 0dir/0deg_1\.csv .* '1,2' in line 2"),
        ("0dir/0deg_1.csv", "1,2,3\n1,2,nan\n", r"rows of 0dir/0deg_1\.csv .* '1,2,nan' in line 2"),
        (
            "2pidir/0deg_1.csv",
            "1.0,2.0,3.0\n",
            r"file of calibrate_data must be .*; instead received 2pidir/0deg_1\.csv",
        ),
    ],
)
def test_calibration_files_that_cannot_be_used(tmp_path, name, text, message):
    calibration_file(tmp_path, name, text)
    with pytest.raises(InputError, match=message):
        read_calibration(tmp_path)


def released(kind: str) -> list:
    found = [take for take in takes() if getattr(take, kind)]
    if not found:
        pytest.skip(f"no {kind} recordings of Mitchell et al. are below REPRO_DATA_DIR")
    return found


def test_released_hall_files():
    for take in released("hall"):
        hall = read_hall(take.hall)
        assert (hall.unreadable, hall.masked) == (0, 0), take.name
        assert 15 <= hall.drained <= 24, take.name
        rate_hz = 1 / hall.readings["time_s"].diff().median()
        assert 60 < rate_hz < 80, take.name
        if take.name.startswith("bend"):
            # The module returns to rest: the axial field over the gain does too, though the gain may not.
            axial = (hall.readings["bx_mT"] / hall.readings["gain"]).to_numpy()
            assert axial[-60:].mean() == pytest.approx(axial[:60].mean(), rel=0.006), take.name
            assert np.abs(np.diff(axial)).max() < 0.3, take.name  # 3.5 mT in the components as sent


def test_released_takes_align_at_one_lag_between_the_clocks():
    found = [take for take in released("capture") if take.hall]
    lags = []
    for take in found:
        capture = read_capture(take.capture)
        table, lag = align(read_hall(take.hall), capture)
        lags.append(lag.lag_s)
        assert lag.r > 0.998, take.name
        assert capture.masked_share < 0.07, take.name
        assert 49 < np.degrees(table["bend_rad"].max()) < 57, take.name
    assert min(lags) > 0.45
    assert max(lags) < 0.61


def test_released_bends_turn_about_horizontal_axes_sixty_degrees_apart():
    """Six tests, six directions: what the azimuth of Module's y axis says, from the motion capture alone."""
    directions = {}
    for take in released("capture"):
        motion = read_capture(take.capture).motion
        bent = motion[motion["bend_rad"] > np.radians(40)]
        towards = np.degrees(np.angle(np.exp(1j * bent["direction_rad"]).mean()))
        directions.setdefault(int(take.name.split("_")[1]), []).append(towards)
    towards = [np.mean(directions[k]) for k in sorted(directions)]
    if len(towards) == 6:
        np.testing.assert_allclose(np.diff(np.unwrap(towards, period=360)), 60, atol=8)


def test_released_calibration_has_few_spikes():
    table = read_calibration()
    if table.empty:
        pytest.skip("no calibration readings of Mitchell et al. are below REPRO_DATA_DIR")
    assert 0 < table["bx_mT"].isna().sum() < 20
    assert set(np.round(np.degrees(table["bend_rad"])).astype(int)) == set(range(0, 91, 10))


def test_released_filter_output():
    for take in released("filtered"):
        table = read_filtered(take.filtered)
        assert table["bend_rad"].between(0, np.pi / 2).all()
        assert len(table) > 1000
