"""Tables of readings and poses: one content in many spellings, and what is refused with its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import repro
from repro import ConstantCurvature, Imu, InputError, Robot, Sensor
from repro.tables import name_and_unit, read_configurations, read_poses, read_table

ROWS = np.array([[0.0, -2.125, 3.5, 0.25], [0.05, -2.25, 3.375, 0.5], [0.1, -2.5, 3.25, 0.75]])
HEADER = ["time_s", "u1_mT", "u2_mT", "u3_mT"]


def robot(**sensor) -> repro.Robot:
    """One segment with three sensors."""
    magnet = repro.Magnet(repro.Disc(6e-3, 3e-3, 1300.0), 1, 0.055)
    sensors = [repro.Sensor(1, 0.11, radial=0.013, azimuth=k, **sensor) for k in range(3)]
    return repro.Robot([repro.ConstantCurvature(0.11, 0.022)], [magnet], sensors)


def lines(
    separator: str = ",", header: list[str] = HEADER, comma: bool = False, rows: np.ndarray = ROWS
) -> str:
    text = [separator.join(header), *(separator.join(f"{x:.5f}" for x in row) for row in rows)]
    return "\n".join([text[0], *(x.replace(".", ",") if comma else x for x in text[1:])]) + "\n"


def written(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    path = folder / "mine.csv"
    path.write_text(text, encoding=encoding)
    return path


SPELLINGS = {
    "commas": lines(),
    "semicolons": lines(";"),
    "decimal commas": lines(";", comma=True),
    "tabs with decimal commas": lines("\t", comma=True),
    "quoted decimal commas": '"time_s","u1_mT","u2_mT","u3_mT"\n'
    + "".join('"' + '","'.join(f"{x:.5f}".replace(".", ",") for x in row) + '"\n' for row in ROWS),
    "a line that states the separator": "sep=;\n" + lines(";", comma=True),
    "comments": "# logged by somebody\n% rate 20\n\n" + lines(),
    "a separator at the end": lines().replace("\n", ",\n"),
    "an index": "\n".join(f"{k or ''},{line}" for k, line in enumerate(lines().splitlines())),
    "other names": lines(header=["Elapsed Time (s)", "CH_1", "channel 2 [mT]", "sensor3"]),
    "milliseconds and microtesla": lines(
        header=["Zeit_ms", "u1 (µT)", "u2_uT", "u3_uT"], rows=ROWS * [1e3, 1e3, 1e3, 1e3]
    ),
    "another order": lines(header=["u3_mT", "time_s", "u1_mT", "u2_mT"], rows=ROWS[:, [3, 0, 1, 2]]),
    "a column that nobody needs": lines(
        header=[*HEADER, "room [C]"], rows=np.column_stack([ROWS, [20.0, 21.0, 22.0]])
    ),
}


@pytest.mark.parametrize("text", SPELLINGS.values(), ids=SPELLINGS)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_one_table_in_many_spellings(tmp_path, text, encoding):
    readings = robot().readings(written(tmp_path, text, encoding))
    np.testing.assert_allclose(readings, ROWS[:, 1:], rtol=1e-12)
    np.testing.assert_allclose(readings.times, ROWS[:, 0], rtol=1e-12)


def test_data_frames_and_missing_readings():
    frame = pd.DataFrame(ROWS, columns=HEADER)
    frame.loc[1, "u2_mT"], frame.loc[2, "u3_mT"] = np.nan, np.inf
    readings = robot().readings(frame)
    assert np.argwhere(np.isnan(readings)).tolist() == [[1, 1], [2, 2]]
    assert readings.times.tolist() == ROWS[:, 0].tolist()
    assert robot().readings(frame.drop(columns="time_s")).times is None
    with pytest.raises(InputError, match="must be a data frame or a path; instead received ndarray"):
        robot().readings(ROWS)


def test_rows_of_readings_keep_their_times():
    readings = robot().readings(pd.DataFrame(ROWS, columns=HEADER))
    np.testing.assert_array_equal(readings[1:].times, readings.times[1:])
    np.testing.assert_array_equal(readings[1:, :].times, readings.times[1:])
    assert readings[:, 1].times is None
    assert (2 * readings).times is None
    assert readings[1, 2] == 0.5


def test_two_readings_never_share_a_column():
    """A slip in the channels would give two sensors one reading."""
    frame = pd.DataFrame(ROWS, columns=HEADER)
    sensors = [Sensor(1, 0.1, channels=[c]) for c in (1, 1, 3)]
    with pytest.raises(
        InputError, match="channels of the table must be another column for every reading; .* u1_mT"
    ):
        robot().replaced(sensors=sensors).readings(frame)
    q = Rotation.random(3, rng=0).as_quat()
    both = pd.DataFrame(np.hstack([q, q[::-1]]), columns=[f"q{x}_{k}" for k in (0, 1) for x in "xyzw"])
    arm = Robot([ConstantCurvature(0.1, 0.02)], imus=[Imu(1, 0.05, channels=0), Imu(1, 0.1, channels=1)])
    np.testing.assert_allclose(arm.readings(both)[:, 3:], Rotation.from_quat(q[::-1]).as_rotvec())


def test_a_unit_that_nobody_stated_is_refused():
    frame = pd.DataFrame(ROWS[:, 1:], columns=["u1_raw", "u2_raw", "u3_raw"])
    with pytest.raises(InputError, match="column u1_raw of the table must be in mT or another unit"):
        robot().readings(frame)
    np.testing.assert_allclose(robot(unit="raw").readings(frame), ROWS[:, 1:])
    with pytest.raises(InputError, match="in mT or another unit of flux density, or in raw; .* received V"):
        robot(unit="raw").readings(frame.set_axis(["u1_V", "u2_V", "u3_V"], axis=1))


@pytest.mark.parametrize("empty", ["", "nan", "NaN", "NA", "null", "-", " ", "inf"])
def test_cells_without_a_number_are_missing(tmp_path, empty):
    text = lines().replace("3.37500", empty)
    assert np.argwhere(np.isnan(robot().readings(written(tmp_path, text)))).tolist() == [[1, 1]]


def test_a_comma_among_points_is_no_number(tmp_path):
    """Thousands, or a slip: either way not what the rest of the table means by a comma."""
    with pytest.raises(InputError, match="line 3, column u2_mT, must be a number; instead received '3,375'"):
        robot().readings(written(tmp_path, lines(";").replace("3.37500", "3,375")))


def test_counts_become_mt():
    """A sensor of 100 counts for 1 mT: a column of counts, of no unit, or already in mT."""
    counts = robot(per_mt=-100.0, unit="raw")
    for names, factor in ((["u1_raw", "u2", "u3_counts"], -100.0), (["u1_mT", "u2_mT", "u3_mT"], 1.0)):
        readings = counts.readings(pd.DataFrame(factor * ROWS[:, 1:], columns=names))
        np.testing.assert_allclose(readings, ROWS[:, 1:])
    millivolts = robot(per_mt=50.0, unit="mV").readings(
        pd.DataFrame(0.05 * ROWS[:, 1:], columns=["u1_V", "u2_V", "u3_V"])
    )
    np.testing.assert_allclose(millivolts, ROWS[:, 1:])


def test_columns_by_the_names_of_channels(tmp_path):
    arm = repro.load_robot(repro.example() / "robot.toml")
    frame = pd.read_csv(repro.example() / "mine.csv")
    readings = arm.readings(frame[sorted(frame.columns, reverse=True)])
    np.testing.assert_array_equal(readings, frame.iloc[:, 1:])
    with pytest.raises(InputError) as refused:
        arm.readings(frame.rename(columns={"B2y_mT": "B2Y_mT"}))
    assert "must be one column for B2y: B2y (is it B2Y?); instead received none among B1x_mT" in str(
        refused.value
    )


def test_imus_have_columns_of_quaternions():
    """Turned into the base: here the world is the base turned by a quarter about z."""
    imus = [repro.Imu(1, 0.11, world=[0, 0, np.sqrt(0.5), np.sqrt(0.5)]), repro.Imu(1, 0.11, channels=4)]
    arm = repro.Robot([repro.ConstantCurvature(0.11, 0.022)], [], [], imus)
    turns = np.array([[0.1, 0.2, 0.3], [0.0, 0.0, 0.0]])
    names = [f"q{x}_{k}" for k in (1, 4) for x in "xyzw"]
    q = Rotation.from_rotvec(turns).as_quat()
    frame = pd.DataFrame(np.tile(q, 2), columns=names)
    frame.loc[1, names[4:]] = 0.0  # an IMU that sends zeros
    readings = arm.readings(frame)
    expected = (Rotation.from_rotvec([0, 0, -np.pi / 2]) * Rotation.from_rotvec(turns)).as_rotvec()
    np.testing.assert_allclose(readings[:, :3], expected, atol=1e-14)
    np.testing.assert_allclose(readings[0, 3:], turns[0])
    assert np.isnan(readings[1, 3:]).all()
    with pytest.raises(
        InputError, match="quaternion of the table, line 1, must be of norm 1 .* of norm 1.638e"
    ):
        arm.readings(frame * 16384)


REFUSED = {
    "no file": (None, "table of read_table must be a file that exists; instead received"),
    "a word": (
        lines().replace("3.37500", "high"),
        "cell, line 3, column u2_mT, must be a number; instead received 'high'.",
    ),
    "commas in commas": (
        lines(comma=True),
        "line 2 must be of 4 cells, as the first line; decimal commas need another separator, such",
    ),
    "a short line": (
        lines().replace(",0.50000", ""),
        "line 3 must be of 4 cells, as the first line; instead received 3.",
    ),
    "names alone": ("time_s,u1_mT\n", "file must be a line of names and lines of numbers"),
    "nothing": ("\n\n", "file must be a table; instead received nothing."),
    "unknown names": (
        lines(header=["time_s", "Höhe_1", "Höhe_2", "Höhe_3"]),
        "columns must be one column for sensor 1: u1_mT, channel_1, or sensor 1; instead rec",
    ),
    "a name twice": (
        lines(header=["time_s", "u1_mT", "u1_mT", "u3_mT"]),
        "instead received ['u1_mT', 'u1_mT'].",
    ),
    "a channel twice": (
        lines(header=["time_s", "u1_mT", "ch1", "u3_mT"]),
        "instead received ['u1_mT', 'ch1'].",
    ),
    "another unit": (
        lines(header=["time_s", "u1_mV", "u2_mT", "u3_mT"]),
        "column u1_mV must be in mT or another unit of flux density;",
    ),
    "a time in hours": (
        lines(header=["time [h]", *HEADER[1:]]),
        "column time [h] must be in s, ms, us, ns or min; instead received h.",
    ),
    "two times": (lines(header=["time_s", "t", "u2_mT", "u3_mT"]), "column t must be the only one of times"),
    "a time that is none": (
        lines().replace("0.05000", ""),
        "column time_s must be times; instead received none in line [3].",
    ),
    "no names": (
        "1,2,3\n5,6,7\n",
        "columns must be one column for sensor 1: u1_mT, channel_1, or sensor 1 (is it 1?); instead",
    ),
}


@pytest.mark.parametrize(("text", "message"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused(tmp_path, text, message):
    path = tmp_path / "mine.csv" if text is None else written(tmp_path, text)
    with pytest.raises(InputError) as refused:
        robot().readings(path)
    assert message in str(refused.value).replace(" of mine.csv", "")


def test_dates_and_truths_are_no_numbers():
    for values in (
        pd.to_datetime(["2024-01-01"] * 3),
        pd.to_timedelta([1, 2, 3]),
        [True] * 3,
        [1j] * 3,
        ["a"] * 3,
    ):
        frame = pd.DataFrame(ROWS, columns=HEADER).astype(object)
        frame["u2_mT"] = values
        with pytest.raises(
            InputError, match="column u2_mT of the table must be of numbers; instead received"
        ):
            robot().readings(frame)


class TestPoses:
    """Configurations and bodies."""

    @staticmethod
    def bounded() -> repro.Robot:
        return robot().replaced(lower=[-0.02, -0.02, 0.0], upper=[0.02, 0.02, 0.0])

    def test_configurations(self):
        frame = pd.DataFrame({"time_s": [0.0], "delta_y_1_mm": [3.0], "delta_x_1_m": [0.002]})
        q, times, rows = read_configurations(self.bounded(), frame)  # the last one is fixed
        np.testing.assert_allclose(q, [[0.002, 0.003, 0.0]])
        assert times.tolist() == [0.0]
        assert len(rows) == 1

    def test_a_coordinate_without_a_unit_or_a_column(self):
        frame = pd.DataFrame({"delta_x_1_mm": [1.0], "delta_y_1": [1.0]})
        with pytest.raises(
            InputError, match="column delta_y_1 of the table must be in mm or cm or m; instead received "
        ):
            read_configurations(self.bounded(), frame)
        with pytest.raises(InputError, match="must be one column for delta_y_1"):
            read_configurations(self.bounded(), frame[["delta_x_1_mm"]])

    def test_bodies_and_markers(self):
        names = ["x_10_mm", "y_10_mm", "z_10_mm", "x_2_m", "y_2_m", "z_2_m"]
        frame = pd.DataFrame([[1.0, 2.0, 3.0, 4.0, 5.0, np.nan]], columns=names)
        poses, times = read_poses(frame)
        np.testing.assert_allclose(poses, [[[4.0, 5.0, np.nan], [1e-3, 2e-3, 3e-3]]])
        assert times is None
        poses, times = read_poses(repro.example() / "poses.csv")
        assert poses.shape == (40, 2, 7)
        assert np.isnan(poses[10:12, 0]).all()
        with pytest.raises(InputError, match="columns of the table must be x_1_mm, y_1_mm, z_1_mm and so on"):
            read_poses(pd.DataFrame({"height": [1.0]}))
        with pytest.raises(
            InputError, match="column x_2 of the table must be in mm or cm or m; instead received ."
        ):
            read_poses(frame.rename(columns={"x_2_m": "x_2"}))


def test_names_and_units():
    found = [name_and_unit(x) for x in ("u1 [mT]", "Bx (Gauss)", "t_ms", "delta_x_1_mm", "B_x", "a_(uT)")]
    assert found == [
        ("u1", "mT"),
        ("Bx", "gauss"),
        ("t", "ms"),
        ("delta_x_1", "mm"),
        ("B_x", ""),
        ("a", "uT"),
    ]


def test_the_table_says_where_its_cells_stand(tmp_path):
    table = read_table(written(tmp_path, "# one\n" + lines()))
    assert (table.columns, table.units, table.lines) == (tuple(HEADER[1:]), ("mT",) * 3, [3, 4, 5])
