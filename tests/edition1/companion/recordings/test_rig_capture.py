"""Motion capture of the rig: inverse kinematics against the forward ones, and files that cannot be trusted."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from edition1 import se3
from edition1.errors import InputError
from edition1_companion.recordings.rig_capture import read_ring_motion, ring_configuration
from edition1_companion.recordings.rig_robot import RIG_LENGTH_M, RIG_MARKERS_M, rig_segment
from edition1_companion.twins.rig_files import MarkerCapture, RingTrack, capture_ring, write_recording

QUIET = MarkerCapture(0.0, 0.0, 0.0, 0.0, 0.0, (0.8, -0.5), (120.0, -80.0, 300.0))
N = 60


def ring_pose(q: torch.Tensor) -> torch.Tensor:
    return rig_segment().pose(q, torch.tensor(RIG_MARKERS_M / RIG_LENGTH_M, dtype=torch.float64))


BEND_MM = st.floats(-20.0, 20.0)


@given(BEND_MM, BEND_MM, st.floats(-5.0, 10.0))
def test_inverse_kinematics_is_exact(x, y, elongation):
    q = 1e-3 * torch.tensor([x, y, elongation], dtype=torch.float64)
    T = ring_pose(q)
    torch.testing.assert_close(ring_configuration(T[:3, 3], T[:3, :3]), q, atol=1e-13, rtol=0)
    torch.testing.assert_close(ring_configuration(T[:3, 3], T[:3, :3].mT), q, atol=1e-13, rtol=0)


def test_inverse_kinematics_of_the_ring_agrees_with_that_of_the_tip():
    q = 1e-3 * torch.tensor([[3.0, -4.0, 2.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    ring, tip = ring_pose(q), rig_segment().pose(q, torch.tensor(1.0))
    from_tip = rig_segment().configuration(tip)
    torch.testing.assert_close(
        ring_configuration(ring[:, :3, 3], ring[:, :3, :3]), from_tip, atol=1e-12, rtol=0
    )


def test_refuses_a_ring_that_points_sideways():
    sideways = se3.rotation_y(torch.tensor(torch.pi / 2 + 0.1, dtype=torch.float64))
    with pytest.raises(
        InputError, match=r"rotation of ring_configuration must be bent by less than 90 deg; .* 95\.7 deg"
    ):
        ring_configuration(torch.tensor([0.1, 0.0, 0.05], dtype=torch.float64), sideways)


def track(q_mm: np.ndarray, capture: MarkerCapture = QUIET) -> RingTrack:
    return capture_ring(capture, np.arange(len(q_mm)) / 40, 1e-3 * q_mm, np.random.default_rng(0))


def bent() -> np.ndarray:
    """Bends of N frames, the first one straight [mm]."""
    angle = np.linspace(0, 4, N)
    return np.column_stack([6 * angle / 4 * np.cos(angle), 8 * angle / 4 * np.sin(angle), 1 + np.sin(angle)])


def write(folder: Path, of: RingTrack) -> Path:
    return write_recording(folder, "synthetic_T2", of, np.full((len(of.time_s), 3), 1000.0))[0]


def with_lost(of: RingTrack, *frames: int) -> RingTrack:
    tracked = of.tracked.copy()
    tracked[list(frames)] = False
    return RingTrack(of.time_s, of.base_m, of.ring_m, of.ring_rotation, tracked)


def test_files_give_the_configurations_back(tmp_path):
    motion = read_ring_motion(write(tmp_path, track(bent())))
    np.testing.assert_allclose(1e3 * motion.q, bent(), atol=0.01)  # of micrometres and 1e-6 in a quaternion
    np.testing.assert_allclose(motion.time_s, np.arange(N) / 40, atol=1e-9)
    assert (motion.filled, motion.gaps) == (0, 0)


def test_short_gaps_are_interpolated_and_counted(tmp_path):
    motion = read_ring_motion(write(tmp_path, with_lost(track(bent()), 10, 20, 21, 57)))
    assert (motion.filled, motion.gaps) == (4, 3)
    np.testing.assert_allclose(1e3 * motion.q, bent(), atol=0.05)


def test_a_quaternion_that_changes_sign_across_a_gap_is_the_same_rotation(tmp_path):
    seen = track(bent())
    quaternions = seen.ring_rotation.as_quat() * np.where(np.arange(N) > 30, -1.0, 1.0)[:, None]
    flipped = RingTrack(seen.time_s, seen.base_m, seen.ring_m, Rotation.from_quat(quaternions), seen.tracked)
    motion = read_ring_motion(write(tmp_path, with_lost(flipped, 30, 31)))
    np.testing.assert_allclose(1e3 * motion.q, bent(), atol=0.05)


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ((10, 11, 12), r"frames without the ring of .* must be at most 2 in a row; instead received 3 from frame 10"),
        ((0,), r"first and last frame of .*_Quat\.csv must be with the ring; instead received 1 frames without it"),
        ((N - 1,), r"first and last frame of .* must be with the ring"),
    ],
)  # fmt: skip
def test_longer_gaps_and_gaps_at_the_ends_are_refused(tmp_path, frames, message):
    path = write(tmp_path, with_lost(track(bent()), *frames))
    with pytest.raises(InputError, match=message):
        read_ring_motion(path)


def cells(path: Path, row: int, column: int, value: str) -> None:
    """Replace a cell of the file; rows count from its first line."""
    lines = path.read_text().splitlines()
    parts = lines[row].split(",")
    parts[column] = value
    lines[row] = ",".join(parts)
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("row", "column", "value", "message"),
    [
        (0, 1, "1.21", r"Format Version of .* must be 1\.23; instead received 1\.21"),
        (0, 17, "Millimeters", r"Length Units of .* must be Meters; instead received Millimeters"),
        (0, 13, "61", r"number of frames of .* must be 61, as its header says; instead received 60"),
        (6, 4, "Q", r"columns of the base of .* must be rotation X, Y, Z, W and position X, Y, Z; .*'Q'"),
        (5, 10, "Position", r"columns of the ring of .* must be rotation X, Y, Z, W"),
        (9, 12, "abc", r"frames of .* must be rows of numbers; .*abc"),
        (9, 1, "0.025", r"times of .* must be increasing; instead received a step of 0 s to frame 2"),
        (9, 1, "0.010", r"times of .* must be increasing; instead received a step of -0\.015 s to frame 2"),
        (66, 1, "9.0", r"times of .* must be 0\.025 s apart, within half of it; .* to frame 59"),
        (9, 1, "", r"times of .* must be two numbers or more; instead received 59 of 60"),
        (9, 13, "3.0", r"quaternions of .* must be unit within 0\.01"),
        (7, 6, "", r"base of .* must be seen in the first frame; instead received empty cells"),
        (9, 15, "450", r"ring of .* must be 0\.05 to 0\.2 m from the base \(is the file in metres\?\)"),
    ],
)
def test_files_that_cannot_be_trusted_are_refused(tmp_path, row, column, value, message):
    path = write(tmp_path, track(bent()))
    cells(path, row, column, value)
    with pytest.raises(InputError, match=message):
        read_ring_motion(path)


def test_a_file_in_millimetres_is_refused_whatever_its_header_says(tmp_path):
    seen = track(bent())
    in_mm = RingTrack(seen.time_s, 1e3 * seen.base_m, 1e3 * seen.ring_m, seen.ring_rotation, seen.tracked)
    with pytest.raises(
        InputError, match=r"\(is the file in metres\?\); instead received 9\d\.\d+ to 9\d\.\d+"
    ):
        read_ring_motion(write(tmp_path, in_mm))


def test_truncated_files_are_refused(tmp_path):
    path = write(tmp_path, track(bent()))
    whole = path.read_text().splitlines()
    for lines in ([], whole[:3], whole[:30]):
        path.write_text("\n".join(lines))
        with pytest.raises(InputError, match=r"(Format Version|number of frames) of"):
            read_ring_motion(path)
    with pytest.raises(FileNotFoundError):
        read_ring_motion(tmp_path / "none.csv")
