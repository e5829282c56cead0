"""Exports of OptiTrack: small synthetic ones written here; the released ones are read in test_mitchell2021.py."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1_companion.recordings.mitchell2021_capture import GUARD_FRAMES, read_capture

HEADER = (
    "Format Version,1.21,Take Name,{name},Capture Frame Rate,120,Export Frame Rate,120,Capture Start Time,"
    "2021-03-12 09.50.01.253 PM,Total Frames in Take,{n},Total Exported Frames,{n},Rotation Type,Quaternion,"
    "Length Units,Millimeters"
)
NAMES = ["Rotation"] * 4 + ["Position"] * 3 + ["Error Per Marker"]
AXES = ["X", "Y", "Z", "W", "X", "Y", "Z", "error"]
START_UNIX_S = 1615603801.253  # 2021-03-13 02:50:01.253 UTC


def write_capture(path: Path, rotations: Rotation, lost: tuple[int, ...] = ()) -> Path:
    """Write a synthetic export with bodies Ground and Module in the layout of the authors' files."""
    lines = [
        HEADER.format(name=path.stem, n=len(rotations)),
        "," * 17,
        ",".join(["", "", *["Rigid Body"] * 16]),
        ",".join(["", "", *["Ground"] * 8, *["Module"] * 8]),
        ",".join(["", "", *["E1F0"] * 8, *["773C"] * 8]),
        ",".join(["", "", *NAMES, *NAMES]),
        ",".join(["Frame", "Time", *AXES, *AXES]),
    ]
    for k, quaternion in enumerate(rotations.as_quat()):
        module = [""] * 8 if k in lost else [f"{x:.6f}" for x in (*quaternion, 1.0, 115.0, 2.0, 0.05)]
        ground = ["0", "0", "0", "-1", "60", "0", "77", "0.01"]
        lines.append(",".join([str(k), f"{k / 120:.6f}", *ground, *module]))
    path.write_text("\n".join(lines) + "\n")
    return path


def bending(angles_deg: np.ndarray, direction_deg: float) -> Rotation:
    """Rotations that tilt the y axis by the angles towards a direction, counted from world z towards world x."""
    direction = np.radians(direction_deg)
    turn_about = np.array([np.cos(direction), 0.0, -np.sin(direction)])
    return Rotation.from_rotvec(np.radians(angles_deg)[:, None] * turn_about)


UP_AND_DOWN = np.concatenate([np.zeros(60), 50 * np.sin(np.linspace(0, np.pi, 1200)) ** 2, np.zeros(60)])


@pytest.mark.parametrize("direction_deg", [-150.0, -30.0, 0.0, 90.0, 179.0])
def test_bend_and_direction(tmp_path, direction_deg):
    capture = read_capture(write_capture(tmp_path / "a.csv", bending(UP_AND_DOWN, direction_deg)))
    motion = capture.motion
    np.testing.assert_allclose(np.degrees(motion["bend_rad"]), UP_AND_DOWN, atol=2e-3)
    bent = UP_AND_DOWN > 5
    np.testing.assert_allclose(np.degrees(motion["direction_rad"][bent]), direction_deg, atol=2e-3)
    np.testing.assert_allclose(motion["time_s"], np.arange(len(UP_AND_DOWN)) / 120, atol=1e-6)
    assert (capture.rate_hz, capture.start_unix_s, capture.masked_share) == (120.0, START_UNIX_S, 0.0)


def test_tilt_of_z_is_the_bend_only_about_world_x(tmp_path):
    along = read_capture(write_capture(tmp_path / "a.csv", bending(UP_AND_DOWN, 0.0))).motion
    np.testing.assert_allclose(along["tilt_z_rad"], along["bend_rad"], atol=1e-4)
    across = read_capture(write_capture(tmp_path / "b.csv", bending(UP_AND_DOWN, 90.0))).motion
    np.testing.assert_allclose(across["tilt_z_rad"], 0, atol=1e-4)


HALF_TURN = Rotation.from_rotvec(np.radians(178) * np.array([0.0, np.sin(0.3), np.cos(0.3)]))
OTHER_TURN = Rotation.from_rotvec(np.radians(179.5) * np.array([0.89, 0.0, -0.456]))
TRUTH = bending(UP_AND_DOWN, 30.0)


def frames(*stretches: tuple[int, int]) -> np.ndarray:
    """Mark frames of a synthetic take."""
    marked = np.zeros(len(UP_AND_DOWN), dtype=bool)
    for start, end in stretches:
        marked[start:end] = True
    return marked


def exchanged(marked: np.ndarray, turn: Rotation = HALF_TURN, truth: Rotation = TRUTH) -> Rotation:
    """Exchange the markers of a synthetic take in some frames: its rotations there, turned in body axes."""
    return Rotation.concatenate([r * turn if off else r for r, off in zip(truth, marked, strict=True)])


def assert_true_where_known(capture, known) -> None:
    motion = capture.motion
    assert (motion[["bend_rad", "direction_rad", "tilt_z_rad"]].notna().all(axis=1) == known).all()
    np.testing.assert_allclose(np.degrees(motion["bend_rad"][known]), UP_AND_DOWN[known], atol=3e-3)
    bent = known & (UP_AND_DOWN > 5)
    np.testing.assert_allclose(np.degrees(motion["direction_rad"][bent]), 30.0, atol=0.02)


def test_exchanged_markers_are_undone_where_they_are_and_nowhere_else(tmp_path):
    """Single frames, a stretch over the peak while the module moves by 25 deg, and two lost frames."""
    off = frames((200, 202), (300, 301), (600, 900))
    capture = read_capture(write_capture(tmp_path / "a.csv", exchanged(off), lost=(100, 1319)))
    assert (capture.undone, capture.turns) == (303, 1)
    assert (capture.turned, capture.lost, capture.near_jumps) == (0, 2, 0)
    assert capture.masked_share == pytest.approx(2 / 1320)
    assert capture.masked_if_not_undone == pytest.approx(305 / 1320)
    np.testing.assert_array_equal(capture.motion["undone"], off)
    assert_true_where_known(capture, ~frames((100, 101), (1319, 1320)))


def test_two_different_exchanges_in_one_take(tmp_path):
    """They follow each other without an upright frame in between at 720, where the jump is no half turn."""
    one, other = frames((300, 310), (700, 720)), frames((500, 505), (720, 760))
    rotations = exchanged(other, OTHER_TURN, exchanged(one))
    capture = read_capture(write_capture(tmp_path / "a.csv", rotations))
    assert (capture.undone, capture.turns, capture.masked_share) == (75, 2, 0.0)
    np.testing.assert_array_equal(capture.motion["undone"], one | other)
    assert_true_where_known(capture, ~frames())


def test_a_take_without_exchanges_is_not_touched(tmp_path):
    capture = read_capture(write_capture(tmp_path / "a.csv", TRUTH, lost=(700,)))
    assert (capture.undone, capture.turns, capture.turned, capture.lost) == (0, 0, 0, 1)
    assert capture.masked_share == capture.masked_if_not_undone == pytest.approx(1 / 1320)
    known = capture.motion["bend_rad"].notna()
    seen = Rotation.from_quat(np.round(TRUTH.as_quat(), 6)).as_matrix()[:, 1, 1]
    np.testing.assert_allclose(capture.motion["bend_rad"][known], np.arccos(seen)[known], rtol=0, atol=1e-12)


@pytest.mark.parametrize("step_deg", [20.0, 60.0, 85.0])
def test_fast_rotations_that_are_real_are_not_undone(tmp_path, step_deg):
    """The body spins by half a turn and back, in steps that are each below 90 deg."""
    frames_of_spin = int(np.ceil(180 / step_deg))
    spin = np.zeros(len(UP_AND_DOWN))
    spin[500 : 500 + frames_of_spin] = np.linspace(0, 180, frames_of_spin + 1)[1:]
    spin[500 + frames_of_spin : 700] = 180.0
    spin[700 : 700 + frames_of_spin] = np.linspace(180, 0, frames_of_spin + 1)[1:]
    rotations = TRUTH * Rotation.from_rotvec(spin[:, None] * [0.0, 0.0, 1.0], degrees=True)
    capture = read_capture(write_capture(tmp_path / "a.csv", rotations))
    assert (capture.undone, capture.turned) == (0, 0)
    np.testing.assert_allclose(  # z is the body's own axis: y is now down
        np.degrees(capture.motion["bend_rad"][530:680]), 180 - UP_AND_DOWN[530:680], atol=3e-3
    )


def test_what_is_no_exchange_is_masked(tmp_path):
    """A jump by 120 deg; a half turn seen once; and a known one that begins and ends while the body is lost."""
    jump = exchanged(frames((400, 420)), Rotation.from_euler("x", 120, degrees=True))
    capture = read_capture(write_capture(tmp_path / "a.csv", jump))
    assert (capture.undone, capture.turned, capture.turns) == (0, 20, 0)
    assert_true_where_known(capture, ~frames((400, 420)))

    capture = read_capture(write_capture(tmp_path / "b.csv", exchanged(frames((1200, 1320)))))
    assert (capture.undone, capture.turned, capture.turns) == (0, 120, 0)
    assert_true_where_known(capture, ~frames((1200, 1320)))

    hidden = exchanged(frames((300, 310), (400, 420)))
    capture = read_capture(write_capture(tmp_path / "c.csv", hidden, lost=(399, 420)))
    assert (capture.undone, capture.turned, capture.lost) == (10, 20, 2)
    assert_true_where_known(capture, ~frames((399, 421)))


def test_frames_around_a_jump_are_masked(tmp_path):
    angles = UP_AND_DOWN.copy()
    angles[400:403] += 4.0
    capture = read_capture(write_capture(tmp_path / "a.csv", bending(angles, 30.0)))
    masked = np.flatnonzero(capture.motion["bend_rad"].isna())
    np.testing.assert_array_equal(masked, np.arange(400 - GUARD_FRAMES, 403 + GUARD_FRAMES))
    assert (capture.turned, capture.near_jumps) == (0, len(masked))


def spoilt(path: Path, old: str, new: str) -> Path:
    path.write_text(path.read_text().replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Version,1.21", "Version,1.23", r"Format Version of a\.csv must be 1\.21; instead received 1\.23\."),
        ("Quaternion", "XYZ", r"Rotation Type of a\.csv must be Quaternion; instead received XYZ\."),
        (
            "Exported Frames,61",
            "Exported Frames,80",
            r"number of frames of a\.csv must be 80, as its header says; .* 61\.",
        ),
        (
            "Module",
            "Other",
            r"body of a\.csv must be .*\(there are: Ground, Other\); instead received Module, without",
        ),
        (
            "Frames,61",
            "Frames,many",
            r"Total Exported Frames of a\.csv must be a whole number; instead received many\.",
        ),
        (
            "Capture Frame Rate,120",
            "Capture Frame Rate,0",
            r"Capture Frame Rate of a\.csv must be above zero; .* 0\.",
        ),
        (
            "09.50.01.253 PM",
            "21:50",
            r"Capture Start Time of a\.csv must be a date and time; .* 2021-03-12 21:50\.",
        ),
        ("Take Name", "Take", r"Take Name of a\.csv must be in the header; instead received nothing\."),
        (
            ",1.000000,1.000000,115",
            ",1.100000,1.000000,115",
            r"quaternions of a\.csv must be unit within 0\.001",
        ),
        (
            ",1.000000,1.000000,115",
            ",x,1.000000,115",
            r"frames of a\.csv must be rows of numbers; .*'x'",
        ),
    ],
)
def test_files_that_cannot_be_trusted_are_refused(tmp_path, old, new, message):
    path = write_capture(tmp_path / "a.csv", bending(np.zeros(61), 0.0))
    with pytest.raises(InputError, match=message):
        read_capture(spoilt(path, old, new))


def test_truncated_and_foreign_files_are_refused(tmp_path):
    path = write_capture(tmp_path / "a.csv", bending(UP_AND_DOWN, 0.0))
    whole = path.read_text()
    for text in ("", "time,x\n", whole[: len(whole) // 2], "\n".join(whole.splitlines()[:5])):
        path.write_text(text)
        with pytest.raises(InputError, match=r"(Format Version|number of frames) of a\.csv"):
            read_capture(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"Module", b"Mod\xff\xfele", r"content of a\.csv must be text in UTF-8; .* byte 0xff at \d+"),
        (b"Module", b"Mod\x00le", r"content of a\.csv must be text in UTF-8; .* a zero byte at \d+"),
        (b"Millimeters", b"Meters", r"Length Units of a\.csv must be Millimeters; .* Meters\."),
        (b"\n9,0.075000,", b"\n9,,", r"Time of a\.csv must be increasing from frame to frame"),
        (b"Position", b"Place", r"body of a\.csv .* received Module, without Position X, Position Z\."),
    ],
)
def test_damaged_files_are_refused_by_name(tmp_path, old, new, message):
    path = write_capture(tmp_path / "a.csv", bending(np.zeros(61), 0.0))
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new))
    with pytest.raises(InputError, match=message):
        read_capture(path)


def test_a_header_without_frames_is_refused(tmp_path):
    path = write_capture(tmp_path / "a.csv", bending(np.zeros(1), 0.0))
    lines = path.read_text().replace("Frames,1,", "Frames,0,").splitlines()[:7]
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"Time of a\.csv must be increasing"):
        read_capture(path)


def test_first_frame_must_be_upright(tmp_path):
    path = write_capture(tmp_path / "a.csv", bending(np.full(10, 120.0), 0.0))
    with pytest.raises(
        InputError, match=r"first frame of a\.csv must be upright within 45 deg; .* 120\.0 deg\."
    ):
        read_capture(path)


def test_body_that_was_never_tracked(tmp_path):
    path = write_capture(tmp_path / "a.csv", bending(np.zeros(5), 0.0), lost=tuple(range(5)))
    with pytest.raises(InputError, match="instead received no frame at all"):
        read_capture(path)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_capture(tmp_path / "none.csv")
