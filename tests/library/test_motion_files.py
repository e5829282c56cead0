"""Files of motion capture: each kind, what is lost in them, configurations, exchanged markers."""

from __future__ import annotations

import re
from contextlib import nullcontext
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from repro import (
    ConstantCurvature,
    InputError,
    Robot,
)
from repro.motion_files import read_motion, read_poses, undo_exchanges

from .robots import tips

SEGMENT = ConstantCurvature(0.11, 0.022)
KINDS = ["Rotation"] * 4 + ["Position"] * 3 + ["Error Per Marker"]
AXES = [*"XYZWXYZ", "error"]


def write_motive(
    path: Path, bodies: dict[str, np.ndarray], *, version="1.21", unit="Millimeters", rate_hz=120, start=None
) -> Path:
    """Write poses ``[t, 7]``, quaternion and position in the unit, as Motive exports them."""
    scale = {"Millimeters": 1e3, "Meters": 1.0}[unit]
    n, names = len(next(iter(bodies.values()))), [name for name in bodies for _ in range(8)]
    labels = version != "1.21"
    at = (
        f"Capture Start Time,{start:%Y-%m-%d %I.%M.%S}.{start.microsecond // 1000:03d} {start:%p},"
        if start
        else ""
    )
    head = [
        [f"Format Version,{version},Take Name,{path.stem},Export Frame Rate,{rate_hz},{at}"
         f"Total Frames in Take,{n},Total Exported Frames,{n},Rotation Type,Quaternion,Length Units,{unit}"],
        [""],
        ["", "Type" * labels, *["Rigid Body"] * len(names)],
        ["", "Name" * labels, *names],
        ["", "ID" * labels, *["1"] * len(names)],
        ["", "", *KINDS * len(bodies)],
        ["Frame", "Time", *AXES * len(bodies)],
    ]  # fmt: skip
    lines = [",".join(row) for row in head]
    for k in range(n):
        cells = [str(k), f"{k / rate_hz:.6f}"]
        for poses in bodies.values():
            lost, row = np.isnan(poses[k]).any(), [*poses[k, :4], *scale * poses[k, 4:], 0.05]
            cells += [""] * 8 if lost else [f"{x:.6f}" for x in row]
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def turning(n: int = 30) -> dict[str, np.ndarray]:
    """Two bodies, one of them lost in the fourth frame."""
    half = np.linspace(0, 0.3, n)
    poses = np.stack(
        [0 * half, 0 * half, np.sin(half), np.cos(half), 0.01 * half, 0.1 + 0 * half, -half], axis=-1
    )
    moving = poses.copy()
    moving[3] = np.nan
    return {"Ground": np.tile(poses[:1], (n, 1)), "Module": moving}


@pytest.mark.parametrize(
    ("version", "unit"), [("1.21", "Millimeters"), ("1.23", "Meters"), ("1.23", "Millimeters")]
)
def test_poses_come_back_in_metres_whatever_version_and_unit(tmp_path, version, unit):
    start, bodies = datetime(2021, 3, 12, 21, 50, 1, 253000), turning()
    take = read_motion(write_motive(tmp_path / "a.csv", bodies, version=version, unit=unit, start=start))
    assert (take.name, take.started, take.rate_hz, take.missing) == ("a", start, 120.0, 0)
    np.testing.assert_allclose(take.times, np.arange(30) / 120, atol=1e-6)
    assert list(take.bodies) == ["Ground", "Module"]
    for name, poses in bodies.items():
        np.testing.assert_allclose(take.bodies[name], poses, rtol=0, atol=1e-6)


def test_a_body_is_lost_as_a_whole_by_an_empty_cell_and_by_a_quaternion_of_zeros(tmp_path):
    bodies = turning()
    path = write_motive(tmp_path / "a.csv", bodies, version="1.23", unit="Meters")
    lines = path.read_text(encoding="utf-8").splitlines()
    cells = lines[7 + 10].split(",")
    lines[7 + 10] = ",".join([*cells[:-2], "", cells[-1]])  # no z
    for k in (12, 14):
        cells = lines[7 + k].split(",")
        lines[7 + k] = ",".join([*cells[:10], "0", "0", "0", "0", *cells[14:]])
    path.write_text("\n".join(lines), encoding="utf-8")
    take = read_motion(path)
    assert np.flatnonzero(np.isnan(take.bodies["Module"]).all(axis=1)).tolist() == [3, 10, 12, 14]
    assert take.remarks[0].endswith("without a pose: 4 of 30 (lines 11, 18, 20, 22).")
    assert np.isfinite(take.bodies["Ground"]).all()


def test_frames_that_a_header_announces_in_vain_are_counted(tmp_path):
    path = write_motive(tmp_path / "a.csv", turning())
    path.write_text("\n".join(path.read_text(encoding="utf-8").splitlines()[:-4]), encoding="utf-8")
    take = read_motion(path)
    assert (len(take.times), take.missing) == (26, 4)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Version,1.21", "Version,1.31", "Format Version of a.csv must be 1.20 to 1.29; instead received 1.31."),
        ("Quaternion", "XYZ", "Rotation Type of a.csv must be Quaternion; instead received XYZ."),
        ("Units,Millimeters", "Units,Feet", "Length Units of a.csv must be Millimeters or Centimeters or Meters"),
        ("Length Units", "Coordinate Space,Local,Length Units", "Coordinate Space of a.csv must be Global"),
        ("Exported Frames,30", "Exported Frames,many", "header of a.csv must be one with frame rate"),
        ("Frame,Time", "Number,Time", "header of a.csv must be one with frame rate"),
        ("Position", "Place", "rigid bodies of a.csv must be there with rotation and position"),
        ("\n9,0.075000,", "\n9,,", "times of a.csv must be increasing from frame to frame"),
        ("\n9,0.075000,0.0", "\n9,0.075000,x", "frames of a.csv must be rows of numbers"),
        ("\n9,0.075000,0.0", "\n9,0.075000,0.2", "quaternions of Ground of a.csv must be unit within 0.01"),
    ],
)  # fmt: skip
def test_other_files_are_refused(tmp_path, old, new, message):
    path = write_motive(tmp_path / "a.csv", turning())
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(message)):
        read_motion(path)


ROWS = np.array(
    [[0.0, 5.0, -3.0, 110.0], [0.1, 6.0, -2.0, 109.0], [0.2, 8.0, 1.0, 108.0], [0.3, 9.0, 2.0, 107.0]]
)
TURNS = np.array([[0.0, 0.1, 0.2], [0.1, 0.0, 0.2], [0.3, 0.1, 0.0], [0.2, 0.2, 0.1]])
POSES = np.hstack([Rotation.from_rotvec(TURNS).as_quat(), 1e-3 * ROWS[:, 1:]])


def vicon(unit="rad") -> str:
    turns = np.degrees(TURNS) if unit == "deg" else TURNS
    rows = [f"{k + 1},0,{','.join(f'{x:.9f}' for x in (*turns[k], *ROWS[k, 1:]))}," for k in range(4)]
    rows[1] = "2,0,,,,,,,"
    head = [
        "Segments",
        "10",
        ",,arm:tip,,,,,",
        "Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ",
        f",,{unit},{unit},{unit},mm,mm,mm",
    ]
    return "\n".join([*head, *rows, "", "Trajectories", "10", ",,arm:a,,", "Frame,Sub Frame,X,Y,Z"]) + "\n"


def qualisys() -> str:
    R = np.swapaxes(Rotation.from_rotvec(TURNS).as_matrix(), 1, 2).reshape(4, 9)
    cells = [[k + 1, ROWS[k, 0], *ROWS[k, 1:], 0, 0, 0, 0.2, *R[k]] for k in range(4)]
    cells[1][2:] = 16 * [0]
    names = ["Frame", "Time", *"XYZ", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{k}]" for k in range(9))]
    head = ["NO_OF_FRAMES\t4", "FREQUENCY\t10", "TIME_STAMP\t2024-05-03, 14:02:11.345", "BODY_NAMES\ttip"]
    return "\r\n".join([*head, *("\t".join(map(str, row)) for row in (names, *cells))]) + "\r\n"


def plain() -> str:
    names = "time_s,x_1_mm,y_1_mm,z_1_mm,qx_1,qy_1,qz_1,qw_1\n"
    rows = np.hstack([ROWS, POSES[:, :4]])
    rows[1, 1:] = [0, 0, 0, 0, 0, 0, 1]
    return names + "".join(",".join(f"{x:.9f}" for x in row) + "\n" for row in rows)


JOINTS = "Joints\n10\n,,arm:j,,\nFrame,Sub Frame,RX,RY,RZ\n,,deg,deg,deg\n1,0,1,2,3\n2,0,1,2,3\n3,0,1,2,3\n\n"


def with_decimal_commas(text: str) -> str:
    return re.sub(r"(\d)\.(\d)", r"\1,\2", text)


FILES = {
    "Vicon": (vicon(), "arm:tip", 7, None),
    "Vicon, joints first": (JOINTS + vicon(), "arm:tip", 16, None),
    "Vicon in degrees": (vicon("deg"), "arm:tip", 7, None),
    "Qualisys": (qualisys(), "tip", 7, datetime(2024, 5, 3, 14, 2, 11, 345000)),
    "Qualisys, decimal commas": (
        with_decimal_commas(qualisys()),
        "tip",
        7,
        datetime(2024, 5, 3, 14, 2, 11, 345000),
    ),
    "a table": (plain(), "1", 3, None),
}


@pytest.mark.parametrize(("text", "name", "line", "started"), FILES.values(), ids=FILES)
def test_files_of_other_systems(tmp_path, text, name, line, started):
    """One body, lost in the second of four frames."""
    path = tmp_path / "take.csv"
    path.write_text(text, encoding="utf-8", newline="")
    take = read_motion(path)
    assert (take.name, list(take.bodies), take.started, take.up) == ("take", [name], started, "z")
    assert take.rate_hz == pytest.approx(10)
    np.testing.assert_allclose(take.times, ROWS[:, 0], atol=1e-9)
    poses = take.bodies[name]
    poses[poses[:, 3] < 0, :4] *= -1
    np.testing.assert_allclose(poses[[0, 2, 3]], POSES[[0, 2, 3]], atol=1e-8)
    assert np.isnan(poses[1]).all()
    assert f"without a pose: 1 of 4 (line {line})." in take.remarks[0]
    assert take.lines[1] == line


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "file of a.csv must be a table"),
        ("time_s,x\n1,2\n", "columns of a.csv must be x_1_mm, y_1_mm, z_1_mm and so on"),
        (
            "x_1_mm,y_1_mm,z_1_mm\n1,2,3\n4,5,6\n",
            "times of a.csv must be there in two rows or more: a column time_s, or a file of Motive",
        ),
        (JOINTS, "header of a.csv must be of Vicon: a rate, names, RX"),
        (vicon().replace("RX", "X"), "header of a.csv must be of Vicon: a rate, names, RX"),
        (vicon().replace("rad", "gon"), "header of a.csv must be of Vicon"),
        (vicon().replace("3,0,", "1,0,"), "times of a.csv must be increasing"),
        (
            qualisys().replace("BODY_NAMES", "MARKER_NAMES"),
            "header of a.csv must be of Qualisys 6D: BODY_NAMES",
        ),
        (qualisys().replace("107.0", "word"), "frames of a.csv must be rows of numbers"),
    ],
)
def test_files_of_other_systems_that_are_none(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8", newline="")
    with pytest.raises(InputError, match=re.escape(message)):
        read_motion(tmp_path / "a.csv")


def test_damaged_files_of_motion_capture_are_refused_in_words(tmp_path):
    rng, path = np.random.default_rng(0), tmp_path / "a.csv"
    motive = write_motive(path, turning(5), version="1.23").read_text(encoding="utf-8")
    texts = [motive, *(text for text, *_ in FILES.values())]
    bits = [b",", b"\t", b'"', b"\n", b"-", b"1e999", b"Name", b"RX", b"X", b"\0", b"\xff"]
    for _ in range(200):
        content = bytearray(texts[rng.integers(len(texts))].encode())
        for at in rng.integers(min(len(content), 600), size=rng.integers(1, 8)):
            content[at : at + rng.integers(3) * rng.integers(10)] = bits[rng.integers(len(bits))]
        path.write_bytes(content)
        try:
            read_motion(path)
        except InputError as error:
            assert str(error).isprintable()  # noqa: PT017


def test_timecode_and_parents_of_motive(tmp_path):
    """A column of times as text, and a line of parents, which version 1.25 writes."""
    path = write_motive(tmp_path / "a.csv", turning(), version="1.25", unit="Meters")
    lines = path.read_text(encoding="utf-8").splitlines()
    lines = [",".join([*cells[:2], "15:26:00:00.00" if k > 6 else "", *cells[2:]])
             for k, cells in enumerate(line.split(",") for line in lines) if k] + []  # fmt: skip
    head = path.read_text(encoding="utf-8").splitlines()[0]
    path.write_text("\n".join([head, *lines[:4], ",Parent" + 17 * ",", *lines[4:]]) + "\n", encoding="utf-8")
    np.testing.assert_allclose(read_motion(path).bodies["Module"], turning()["Module"], atol=1e-6)


def test_frozen_frames_are_lost_and_a_body_that_rests_is_not(tmp_path):
    """A body that moves, rests exactly and moves on; then it is frozen for 22 frames, and for 20."""
    t = np.r_[np.arange(60), np.full(50, 60), np.arange(60, 200)] / 100
    half = 0.1 + 0.3 * np.sin(np.pi * (t - 0.6)) ** 2
    moving = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half), half, 0 * half, 0 * half], axis=1)
    moving[125:147], moving[200:220] = moving[125], moving[200]
    resting = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (len(t), 1))
    take = read_motion(write_motive(tmp_path / "a.csv", {"Ground": resting, "Module": moving}))
    assert np.flatnonzero(np.isnan(take.bodies["Module"]).all(axis=1)).tolist() == list(range(126, 147))
    assert np.isfinite(take.bodies["Ground"]).all()
    assert take.remarks == (
        "Frames of Module in a.csv left out, which only repeat the one before, more than 20 in a row: 21 of 250 "
        "(lines 134 to 154).",
    )


class TestMeasuredPoses:
    """From a file to the configurations of a robot."""

    @staticmethod
    def arm(n=1) -> Robot:
        bounds = np.tile([0.03, 0.03, 0.007], n)
        return Robot([SEGMENT] * n, lower=-bounds, upper=bounds)

    @staticmethod
    def q(n=1) -> np.ndarray:
        t = 0.01 * np.arange(120)[:, None]
        return np.sin(t * np.arange(1, 3 * n + 1) + 0.3) * np.tile([0.02, 0.015, 0.005], n)

    def table(self, robot, q, bodies=None) -> pd.DataFrame:
        T = robot.poses(q, tips(robot)) if bodies is None else bodies
        columns = {"time_s": 0.01 * np.arange(len(q))}
        for k in range(T.shape[1]):
            turn = Rotation.from_matrix(T[:, k, :3, :3]).as_quat()
            columns |= {f"{axis}_{k + 1}_mm": 1e3 * T[:, k, c, 3] for c, axis in enumerate("xyz")}
            columns |= {f"q{axis}_{k + 1}": turn[:, c] for c, axis in enumerate("xyzw")}
        return pd.DataFrame(columns)

    def test_bodies_on_the_ends_of_segments(self, tmp_path):
        robot, q = self.arm(2), self.q(2)
        self.table(robot, q).to_csv(tmp_path / "a.csv", index=False)
        found = read_poses(robot, tmp_path / "a.csv")
        np.testing.assert_allclose(found.q, q, atol=1e-7)
        np.testing.assert_allclose(found.times, 0.01 * np.arange(120))
        swapped = read_poses(robot, tmp_path / "a.csv", bodies=["1", "2"])
        np.testing.assert_array_equal(swapped.q, found.q)
        with pytest.raises(
            InputError, match="bodies of a.csv must be one on the end of each of 2 segments, from base to tip"
        ):
            read_poses(robot, tmp_path / "a.csv", bodies=["1"])

    def test_a_base_that_moves_and_a_straight_start(self):
        """Bodies are turned and shifted where they are mounted, and the base turns with its body."""
        robot, q = self.arm(), self.q()
        q[:20] = 0.0
        q[:20, 2] = 1e-9 * np.arange(20)
        mount, base = np.eye(4), np.tile(np.eye(4), (120, 1, 1))
        mount[:3, :3], mount[:3, 3] = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), [0.01, 0.02, -0.005]
        base[:, :3, :3] = Rotation.from_rotvec(np.linspace(0, 1, 120)[:, None] * [0.1, 0.5, 0.2]).as_matrix()
        tip = base @ robot.tip(q) @ mount
        found = read_poses(robot, self.table(robot, q, np.stack([base, tip], axis=1)), straight_s=0.2)
        np.testing.assert_allclose(found.q, q, atol=1e-6)

    @pytest.mark.parametrize("angle", [20.0, 40.0, 90.0])
    def test_a_body_that_was_defined_turned_is_named(self, angle):
        """By as much as no segment turns about its own axis; a straight start takes the turn away."""
        robot, q = self.arm(2), self.q(2)
        q[:20] = 0.0
        T = robot.poses(q, tips(robot))
        T[:, 1, :3, :3] = T[:, 1, :3, :3] @ Rotation.from_rotvec([0.0, 0.0, angle], degrees=True).as_matrix()
        expected = r"Input body 2 of the table must be turned as the end of its segment .*--straight-s"
        if angle > 30:
            with pytest.raises(
                InputError, match=rf"{expected}.*; instead received turned against it by \d\d deg"
            ):
                read_poses(robot, self.table(robot, q, T))
        else:
            assert "kinematics miss the poses" in read_poses(robot, self.table(robot, q, T)).remarks[0]
        found = read_poses(robot, self.table(robot, q, T), straight_s=0.2)
        np.testing.assert_allclose(found.q, q, atol=1e-6)

    def test_motive_has_y_up(self, tmp_path):
        robot, q = self.arm(), self.q()
        T = robot.tip(q)
        x, y, z, w = Rotation.from_matrix(T[:, :3, :3]).as_quat().T
        poses = np.stack([x, z, -y, w, T[:, 0, 3], T[:, 2, 3], -T[:, 1, 3]], axis=1)
        path = write_motive(tmp_path / "a.csv", {"tip": poses}, version="1.23", unit="Meters")
        np.testing.assert_allclose(read_poses(robot, path, bodies=["tip"]).q, q, atol=1e-5)

    @pytest.mark.parametrize(
        ("turns", "plate", "points"),
        [
            ([2, 0, 0], True, "-y"),
            ([2, 0, 1], False, "-y"),
            ([0, 1, 0], True, "+x"),
            ([0, 0, 3], False, "+y"),
            ([1, 0, 0], True, "+z"),
            ([3, 0, 0], False, "-z"),
        ],
    )
    def test_bodies_with_the_axes_of_the_room_and_a_straight_start(self, turns, plate, points, tmp_path):
        """However an arm hangs, one of the ways that fit is right, and the axes are named by Motive's letters."""
        robot, q = self.arm(), self.q()
        q[:15] = 0.0
        R, T = Rotation.from_euler("xyz", 90 * np.array(turns), degrees=True).as_matrix(), robot.tip(q)
        x, y, z, w = Rotation.from_matrix(R @ T[:, :3, :3] @ R.T).as_quat().T
        p = T[:, :3, 3] @ R.T + [0.1, -0.3, 1.2]
        tip = np.stack([x, z, -y, w, p[:, 0], p[:, 2], -p[:, 1]], axis=1)
        ground = np.tile([0.0, 0, 0, 1, 0.1, 1.2, 0.3], (len(q), 1))
        bodies = {"plate": ground, "tip": tip} if plate else {"tip": tip}
        path = write_motive(tmp_path / "a.csv", bodies, version="1.23", unit="Meters")
        found = read_poses(robot, path, straight_s=0.1)
        assert set(found.turned) == {-90, 90, 180}
        assert min(np.abs(x - q).max() for x in (found.q, *found.turned.values())) < 1e-4
        assert f"By the axes of a.csv, the straight robot points along {points}, and x of" in found.remarks[0]
        if plate:
            with pytest.raises(InputError, match="with y along the straight robot.*--straight-s"):
                read_poses(robot, path)

    def test_coordinates(self):
        robot, q = self.arm(), self.q()
        q[50:52], q[60:66:2], q[70], q[80:102] = 0.0, np.nan, [0.5, 0, 0], q[80]
        frame = pd.DataFrame(1e3 * q, columns=[f"{name}_mm" for name in robot.coordinates])
        frame["time_s"] = 0.01 * np.arange(120)
        found = read_poses(robot, frame)
        expected = [50, 51, 60, 62, 64, 70, *range(81, 102)]
        assert np.flatnonzero(np.isnan(found.q).all(axis=1)).tolist() == expected
        np.testing.assert_allclose(np.delete(found.q, expected, 0), np.delete(q, expected, 0))
        assert found.remarks == (
            "Rows of the table left out, which only repeat the one before, more than 20 in a row: 21 of 120 "
            "(lines 82 to 102).",
            "Rows of the table without a pose: 26 of 120 (lines 51 to 52, 61, 63, 65, and so on).",
            "Poses of the table left out, outside the robot's bounds, for delta_x_1 -30 to 30 mm: 1 of 120 "
            "(line 71).",
        )

    @pytest.mark.parametrize(("step_s", "lost"), [(0.49, 21), (0.51, 0)])
    def test_rows_half_a_second_apart_are_no_frames(self, step_s, lost):
        """Of frames a run of equal ones that ends in a jump is frozen."""
        robot, q = self.arm(), self.q()
        q[80:102] = q[80]
        frame = pd.DataFrame(1e3 * q, columns=[f"{name}_mm" for name in robot.coordinates])
        frame["time_s"] = step_s * np.arange(120)
        assert np.isnan(read_poses(robot, frame).q[:, 0]).sum() == lost

    @pytest.mark.parametrize("n", [59, 61])
    def test_frames_of_zeros_are_lost_if_they_are_fewer_than_half(self, n):
        """Else the robot stands straight. They are spread over the motion, so that none is frozen."""
        robot, q = self.arm(), self.q()
        zero = np.argsort(np.arange(120) * 49 % 120) < n
        q[zero] = 0.0
        frame = pd.DataFrame(1e3 * q, columns=[f"{name}_mm" for name in robot.coordinates])
        found = read_poses(robot, frame.assign(time_s=0.01 * np.arange(120)))
        assert np.isnan(found.q[:, 0]).tolist() == (zero & (n < 60)).tolist()

    @pytest.mark.parametrize("n", [6, 7])
    def test_a_twentieth_of_the_poses_may_be_far_outside_the_bounds(self, n):
        robot, q = self.arm(), self.q()
        q[5 : 5 + n, 0] = 0.5
        frame = pd.DataFrame(1e3 * q, columns=[f"{name}_mm" for name in robot.coordinates])
        with pytest.raises(InputError, match=f"{n} of 120 poses outside") if n > 6 else nullcontext():
            assert np.isnan(read_poses(robot, frame).q[:, 0]).sum() == n

    def test_poses_that_were_held_for_a_while(self):
        """A table of poses for a calibration: the straight one is no lost frame."""
        robot = self.arm()
        frame = pd.DataFrame(
            [[0.0, 0.8, 0, 0, 0], [1.0, 1.8, 9.5, 0, 1]],
            columns=["start_s", "end_s", "delta_x_1_mm", "delta_y_1_mm", "delta_L_1_mm"],
        )
        found = read_poses(robot, frame)
        np.testing.assert_allclose(found.q, [[0, 0, 0], [0.0095, 0, 0.001]])
        np.testing.assert_allclose(found.windows, [[0, 0.8], [1.0, 1.8]])
        np.testing.assert_allclose(found.times, [0.4, 1.4])
        board = read_poses(robot, frame.assign(start_board_s=[7.0, 8.0], end_board_s=[7.8, 8.8]))
        np.testing.assert_allclose(board.windows, [[7, 7.8], [8.0, 8.8]])
        assert (found.clock, board.clock) == ("", "board_")

    def test_poses_of_another_robot_are_refused(self):
        robot, q = self.arm(), self.q()
        frame = pd.DataFrame(1e3 * q, columns=[f"{name}_cm" for name in robot.coordinates])
        with pytest.raises(
            InputError, match="delta_x_1 of the table must be within the robot's bounds, -30 to 30 mm"
        ):
            read_poses(robot, frame)
        turned = np.swapaxes(robot.poses(q, tips(robot)), 2, 3) * 1.0
        turned[..., :3, 3] = robot.poses(q, tips(robot))[..., [2, 0, 1], 3]
        turned[..., 3, :3] = 0.0
        with pytest.raises(
            InputError, match="poses of the table must be those that the robot can take, with z along"
        ):
            read_poses(robot, self.table(robot, q, turned))
        with pytest.raises(
            InputError, match="poses of the table must be bodies; instead received coordinates of"
        ):
            read_poses(robot, frame, straight_s=1.0)
        one = self.table(robot, q, robot.poses(q, tips(robot))).iloc[:1]
        with pytest.raises(InputError, match="there in two rows or more: .*; instead received one row"):
            read_poses(robot, one)

    def test_a_straight_start_in_which_the_robot_moves_is_refused(self):
        robot, q = self.arm(), self.q()
        frame = self.table(robot, q, robot.poses(q, tips(robot)))
        expected = "straight_s of the table must be so short that the bodies are still for the first 1.2 s"
        with pytest.raises(InputError, match=f"{expected}; instead received 1 that is .* mm from its mean"):
            read_poses(robot, frame, straight_s=1.2)

    def test_a_file_whose_bodies_are_in_other_units_is_named(self):
        robot, q = self.arm(), self.q()
        T = robot.poses(q, tips(robot))
        T[..., :3, 3] *= 1e3
        with pytest.raises(InputError, match="^the table: Input poses of fit_shape must be in metres"):
            read_poses(robot, self.table(robot, q, T))


ONE = Rotation.from_rotvec(np.radians(178) * np.array([0.0, np.sin(0.3), np.cos(0.3)]))
OTHER = Rotation.from_rotvec(np.radians(179.5) * np.array([0.89, 0.0, -0.456]))


def bending(n: int = 1320) -> Rotation:
    """A body that bends by 50 degrees and back."""
    angle = 50 * np.sin(np.linspace(0, np.pi, n)) ** 2
    return Rotation.from_rotvec(angle[:, None] * [0.87, 0.0, -0.5], degrees=True)


def exchanged(truth: Rotation, turn: Rotation, *stretches: tuple[int, int]) -> Rotation:
    """Turn a body in its own axes in some frames."""
    q = truth.as_quat()
    for a, b in stretches:
        q[a:b] = (truth[a:b] * turn).as_quat()
    return Rotation.from_quat(q)


def off_deg(found: np.ndarray, truth: Rotation) -> np.ndarray:
    known = np.isfinite(found[:, 0])
    return np.degrees((Rotation.from_quat(found[known]).inv() * truth[known]).magnitude())


def test_exchanged_markers_are_undone_where_they_are_and_nowhere_else():
    """Single frames, a stretch over the peak, two exchanges that follow each other, and lost frames."""
    truth, one, other = bending(), ((200, 202), (300, 301), (600, 900)), ((500, 505), (900, 940))
    seen = exchanged(exchanged(truth, ONE, *one), OTHER, *other).as_quat()
    seen[[100, 1319]] = np.nan
    found, undone = undo_exchanges(seen)
    expected = np.zeros(1320, dtype=bool)
    for a, b in (*one, *other):
        expected[a:b] = True
    np.testing.assert_array_equal(undone, expected)
    assert np.flatnonzero(np.isnan(found).any(axis=1)).tolist() == [100, 1319]
    assert off_deg(found, truth).max() < 0.2
    np.testing.assert_array_equal(found[~undone], seen[~undone])


@pytest.mark.parametrize("step_deg", [20.0, 60.0, 85.0])
def test_a_body_that_really_turns_fast_is_left_alone(step_deg):
    angle = np.concatenate(
        [np.zeros(50), np.arange(0, 181, step_deg), np.full(50, 180.0), np.arange(180, -1, -step_deg)]
    )
    seen = Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0], degrees=True).as_quat()
    found, undone = undo_exchanges(seen)
    assert not undone.any()
    np.testing.assert_array_equal(found, seen)


def test_what_is_no_exchange_is_left_out():
    """A jump by 120 degrees, and a half turn that is seen once: nothing says that it is always the same."""
    truth, turn = bending(), Rotation.from_euler("x", 120, degrees=True)
    for seen, lost in ((exchanged(truth, turn, (400, 420)), 20), (exchanged(truth, ONE, (1200, 1320)), 120)):
        found, undone = undo_exchanges(seen.as_quat())
        assert not undone.any()
        assert np.isnan(found).any(axis=1).sum() == lost
        assert off_deg(found, truth).max() < 1e-5


def test_a_body_that_is_never_seen_is_refused():
    with pytest.raises(
        InputError, match="quaternions of undo_exchanges must be there.*received 5 lost frames"
    ):
        undo_exchanges(np.full((5, 4), np.nan))
