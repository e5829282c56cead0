"""Readings and configurations from the columns of tables: names, units, missing values, quaternions."""

from __future__ import annotations

import copy
import pickle
from contextlib import nullcontext

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import repro
from repro import ConstantCurvature, Imu, InputError, Robot, Sensor
from repro.readings import configurations_of
from repro.tables import read_table

from .test_tables import HEADER, ROWS, robot, written

KEPT = {
    "copied": np.copy,
    "deeply copied": copy.deepcopy,
    "pickled": lambda u: pickle.loads(pickle.dumps(u)),
    "multiplied": lambda u: 2 * u - u.mean(axis=0),
    "without an outlier": lambda u: np.where(np.abs(u) > 3.4, np.nan, u),
    "of other columns": lambda u: u[:, [2, 0]],
    "turned back": lambda u: u[::-1][::-1],
}
LOST = {
    "put together": lambda u: np.concatenate([u, u]),
    "in one column": lambda u: u.reshape(-1, 1),
    "of several robots": lambda u: np.stack([u, u], axis=1),
    "averaged": lambda u: u.reshape(-1, 1, 3).mean(axis=1),
    "pickled after that": lambda u: pickle.loads(pickle.dumps(np.vstack([u, u]))),
}


@pytest.mark.parametrize("change", [*KEPT.values(), *LOST.values()], ids=[*KEPT, *LOST])
def test_readings_keep_their_times_or_it_is_known_that_they_are_lost(change):
    """Nobody gives them the rate of the robot file without a word."""
    readings = change(robot().readings(pd.DataFrame(ROWS, columns=HEADER))[1:])
    fit = repro.LevenbergMarquardt(lambda q: q * np.ones(readings.shape[-1]), [-9.0], [9.0], noise=1.0)
    if change in KEPT.values():
        assert repro.track(fit, readings).times.tolist() == [0.05, 0.1]
        return
    with pytest.raises(InputError, match="times, rate_hz of track must be given, one of the two: after what"):
        repro.track(fit, readings)
    assert repro.track(fit, readings, rate_hz=20.0).times[1] == 0.05


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


def test_readings_at_the_end_of_the_range_are_missing():
    frame = pd.DataFrame(np.tile(ROWS, (3, 1)), columns=HEADER).drop(columns="time_s")
    frame.loc[1, "u2_mT"], frame.loc[2, "u3_mT"], frame.loc[4] = 32.767, -5.0, 0.0
    readings = robot(range=5.0).readings(frame)
    assert np.argwhere(np.isnan(readings)).tolist() == [[1, 1], [2, 2], [4, 0], [4, 1], [4, 2]]
    expected = [f"1 of 9 readings of sensor {k} is missing: at the end of its range." for k in (2, 3)]
    assert readings.remarks == (*expected, "1 of 9 rows is missing: all readings are zero.")
    assert np.isnan(robot().readings(frame)).sum() == 3  # no range is stated: the monitor has to see it


def test_a_rounded_end_of_the_range_is_the_end():
    """As float32 rounds it, and within half a step; a row of zeros says nothing although one of them is missing."""
    assert robot(range=32.767).missing(np.float32([32.767, -32.767, 32.7])).tolist() == [2, 2, 0]
    assert robot(range=5.0, resolution=0.1).missing([4.96, -4.94, 0.0]).tolist() == [2, 0, 0]
    four = robot().replaced(sensors=[Sensor(1, 0.1)] * 4)
    rows = [[0, 0, 0, np.nan], [0, 0, np.nan, np.nan], [0, 0, 0, 1e-9]]
    assert four.missing(rows).tolist() == [[3, 3, 3, 3], [0, 0, 1, 1], [0, 0, 0, 0]]


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
    assert readings.remarks == ("1 of 2 quaternions of imu 2 is missing: empty, zero or not of norm 1.",)


class TestQuaternions:
    """An arm of two IMUs, in tables of one row for each of them."""

    @staticmethod
    def arm() -> repro.Robot:
        segment = repro.ConstantCurvature(0.1, 1.0, extensible=False)
        return Robot([segment, segment], imus=[Imu(1, 0.1, channels=3), Imu(2, 0.1, channels=7)])

    @staticmethod
    def turns() -> np.ndarray:
        bend = np.linspace(0, 1, 40)[:, None]
        return np.hstack([bend * [1.0, 0.3, 0.0], 2 * bend * [1.0, 0.3, 0.0]])

    def table(self, scale=1.0, decimals=6, order="xyzw", header="time_s,stream,{},{},{},{}\n") -> str:
        q = Rotation.from_rotvec(self.turns().reshape(-1, 3)).as_quat()
        q = np.round(scale * q[:, ["xyzw".index(axis) for axis in order]], decimals)
        rows = [
            f"{0.03 * (k // 2):.5f},{3 + 4 * (k % 2)}," * bool(header) + ",".join(map(str, x))
            for k, x in enumerate(q)
        ]
        return header.format(*"xyzw") + "\n".join(rows) + "\n"

    def test_rows_of_one_time_are_put_together(self, tmp_path):
        readings = self.arm().readings(written(tmp_path, self.table()))
        np.testing.assert_allclose(readings, self.turns(), atol=1e-5)
        np.testing.assert_allclose(readings.times, 0.03 * np.arange(40))
        assert readings.remarks == ("80 of 80 rows of mine.csv are put together to 40.",)

    def test_the_only_stream_keeps_its_number(self, tmp_path):
        rows, printed = (self.table(order=x).splitlines(keepends=True) for x in ("xyzw", "wxyz"))
        texts = "".join(rows[:1] + rows[1::2]), "".join(x.partition(",")[2] for x in printed[1::2])
        for text in texts:
            path = written(tmp_path, text)
            for channels in (3, ["qx", "qy", "qz", "qw"]):
                alone = Robot([ConstantCurvature(0.1, 1.0)], imus=[Imu(1, 0.1, channels=channels)])
                np.testing.assert_allclose(alone.readings(path), self.turns()[:, :3], atol=1e-5)
            with pytest.raises(InputError, match="must be one column for qx_7"):
                alone.replaced(imus=[Imu(1, 0.1, channels=7)]).readings(path)

    def test_a_row_that_is_lost_is_one_missing_reading(self, tmp_path):
        kept = self.table().splitlines(keepends=True)
        readings = self.arm().readings(written(tmp_path, "".join(kept[:11] + kept[12:])))
        assert np.argwhere(np.isnan(readings)).tolist() == [[5, 0], [5, 1], [5, 2]]
        np.testing.assert_allclose(readings[6], self.turns()[6], atol=1e-5)

    def test_text_beside_the_streams_is_left_alone_and_a_stream_of_text_refused(self, tmp_path):
        rows = self.table().splitlines()
        text = "\n".join([f"{rows[0]},status", *(f"{row},OK" for row in rows[1:])]) + "\n"
        np.testing.assert_allclose(self.arm().readings(written(tmp_path, text)), self.turns(), atol=1e-5)
        text = (
            "\n".join([rows[0], *(row.replace(",3,", ",a,").replace(",7,", ",b,") for row in rows[1:])])
            + "\n"
        )
        with pytest.raises(InputError, match="line 2, column stream, must be a number; instead received 'a'"):
            self.arm().readings(written(tmp_path, text))

    def test_a_log_may_begin_in_the_middle_of_a_turn(self, tmp_path):
        printed = self.table(order="wxyz").splitlines()[1:]
        text = "\n".join(line.partition(",")[2] for line in printed[1:]) + "\n"
        readings = self.arm().readings(written(tmp_path, text))
        np.testing.assert_allclose(readings[1:], self.turns()[1:], atol=1e-5)
        np.testing.assert_allclose(readings[0, 3:], self.turns()[0, 3:], atol=1e-5)
        assert np.isnan(readings[0, :3]).all()

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            (
                {"scale": 16384, "decimals": 0},
                "of norm 1: divide raw counts by their scale; .* such as 16384",
            ),
            ({"decimals": 2}, "of norm 1, with four decimals; instead received norms such as"),
            ({"order": "wxyz"}, "in the order x, y, z, w, of an IMU that is mounted as .* turns by 180 deg"),
        ],
    )
    def test_what_is_no_orientation_is_refused(self, tmp_path, changes, message):
        with pytest.raises(InputError, match=f"quaternions of imu 1 of mine.csv must be {message}"):
            self.arm().readings(written(tmp_path, self.table(**changes)))

    def test_two_quaternions_and_a_hundredth_may_be_damaged(self, tmp_path):
        rows = self.table().splitlines()
        for n in (2, 3):
            others = [
                row.rsplit(",", 1)[0] + ",3.0" if k % 20 == 1 and k < 20 * n else row
                for k, row in enumerate(rows)
            ]
            path = written(tmp_path, "\n".join(others) + "\n")
            with pytest.raises(InputError, match="of norm 1") if n > 2 else nullcontext():
                assert np.isnan(self.arm().readings(path)[:, 0]).sum() == n

    @pytest.mark.parametrize("degrees", [155.0, 165.0])
    def test_an_orientation_is_believed_up_to_160_degrees(self, degrees):
        """With w first it would be one of less than half of that."""
        q = np.tile(Rotation.from_rotvec([degrees, 0, 0], degrees=True).as_quat(), (5, 1))
        arm = Robot([ConstantCurvature(0.1, 1.0)], imus=[Imu(1, 0.1)])
        with pytest.raises(InputError, match="in the order x, y, z, w") if degrees > 160 else nullcontext():
            assert np.degrees(
                arm.readings(pd.DataFrame(q, columns=["qx_1", "qy_1", "qz_1", "qw_1"]))[0, 0]
            ) == pytest.approx(degrees)


class TestPoses:
    """Configurations and bodies."""

    @staticmethod
    def bounded() -> repro.Robot:
        return robot().replaced(lower=[-0.02, -0.02, 0.0], upper=[0.02, 0.02, 0.0])

    def test_configurations(self):
        frame = pd.DataFrame({"time_s": [0.0], "delta_y_1_mm": [3.0], "delta_x_1_m": [0.002]})
        q = configurations_of(self.bounded(), read_table(frame))  # the last one is fixed
        np.testing.assert_allclose(q, [[0.002, 0.003, 0.0]])

    def test_a_coordinate_without_a_unit_or_a_column(self):
        frame = pd.DataFrame({"delta_x_1_mm": [1.0], "delta_y_1": [1.0]})
        with pytest.raises(
            InputError, match="column delta_y_1 of the table must be in mm or cm or m; instead received "
        ):
            configurations_of(self.bounded(), read_table(frame))
        with pytest.raises(InputError, match="must be one column for delta_y_1"):
            configurations_of(self.bounded(), read_table(frame[["delta_x_1_mm"]]))


@pytest.mark.parametrize(
    ("field", "time"),
    [
        ((0.002, "T"), (3.0, "s")),
        ((2.0, "mT"), (3.0, "sec")),
        ((2e3, "uT"), (3e3, "ms")),
        ((2e3, "µT"), (3e6, "us")),
        ((2e6, "nT"), (3e9, "ns")),
        ((20.0, "G"), (0.05, "min")),
        ((20.0, "gauss"), (3.0, "seconds")),
        ((2e4, "mG"), (3.0, "s")),
    ],
)
def test_two_millitesla_after_three_seconds_in_every_unit(field, time):
    """One gauss is a tenth of a millitesla."""
    columns = {f"u{k} [{field[1]}]": [field[0] / 2, field[0]] for k in (1, 2, 3)}
    readings = robot().readings(pd.DataFrame({f"time [{time[1]}]": [0.0, time[0]]} | columns))
    np.testing.assert_allclose(
        np.column_stack([readings.times, readings]), [[0, 1, 1, 1], [3, 2, 2, 2]], rtol=1e-12
    )


@pytest.mark.parametrize(
    ("names", "row", "expected"),
    [
        (["rotation_x_1_rad", "phi_2_rad", "delta_L_2_m"], [1.5, 1.5, 0.02], [1.5, 1.5, 0.02]),
        (["rotation_x_1_deg", "phi_2_deg", "delta_L_2_cm"], [90.0, 180.0, 2.0], [np.pi / 2, np.pi, 0.02]),
        (
            ["rotation_x_1_deg", "phi_2_deg", "delta_L_2_mm"],
            [-90.0, 18.0, 20.0],
            [-np.pi / 2, np.pi / 10, 0.02],
        ),
    ],
)
def test_coordinates_in_every_unit(names, row, expected):
    arm = Robot([repro.BallJoint("x"), repro.AffineCurvature(0.1)])
    frame = pd.DataFrame([row], columns=names).assign(kappa_0_2_deg=180.0, kappa_1_2_rad=1.0)
    q = configurations_of(arm, read_table(frame))
    np.testing.assert_allclose(q, [[expected[0], np.pi, 1.0, *expected[1:]]], rtol=1e-12)


def test_a_column_that_is_there_twice_is_not_said_to_be_meant():
    frame = pd.DataFrame(ROWS, columns=["time_s", "u1_mT", "u1_mT", "u3_mT"])
    with pytest.raises(InputError, match=r"or sensor 1; instead received \['u1_mT', 'u1_mT'\]"):
        robot().readings(frame)


def test_a_coordinate_without_a_unit_is_told_so():
    frame = pd.DataFrame(np.zeros((3, 3)), columns=["delta_x_1", "delta_y_1_mm", "delta_L_1_mm"])
    with pytest.raises(
        InputError, match="delta_x_1 of the table must be in mm or cm or m; .* received no unit"
    ):
        configurations_of(robot(), read_table(frame))
