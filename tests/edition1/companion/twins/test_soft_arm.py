"""The motion in the file: physical, and as lively as the recorded one."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1.estimation.imu_chain import adjacent_angles
from edition1_companion.twins.soft_arm import load_soft_arm

FILE = Path(__file__).parents[4] / "data" / "soft_arm.npz"


@pytest.fixture(scope="module")
def arm():
    return load_soft_arm(FILE)


def angle_deg(a, b):
    turns = Rotation.from_quat(a.reshape(-1, 4)).inv() * Rotation.from_quat(b.reshape(-1, 4))
    return np.degrees(turns.magnitude()).reshape(a.shape[:-1])


def test_speeds_and_angles_are_near_the_recorded_ones(arm):
    """Targets: section III-C (0.1 and 0.2 m/s, up to 0.6), and the angles between IMUs #1 to #7 in a recording."""
    markers = arm.positions_at(arm.time_s, np.array([0.36, 0.60]))
    speed = np.linalg.norm(np.gradient(markers, arm.time_s, axis=0), axis=-1)
    np.testing.assert_allclose(np.median(speed, axis=0), [0.1, 0.2], atol=0.02)
    assert speed.max() == pytest.approx(0.6, abs=0.1)
    angles = np.degrees(adjacent_angles(arm.orientations))
    np.testing.assert_allclose(np.median(angles, axis=0)[1:7], [22, 18, 13, 14, 10, 8.5], atol=6)
    assert angles.max() == pytest.approx(52, abs=6)


def test_modes_show_in_the_shape(arm):
    tip = arm.positions[:, -1]
    assert tip[arm.mode == "oscillating", 2].min() < -0.05  # below the base
    assert np.ptp(tip[arm.mode == "buckling", 2]) > 0.2
    assert arm.time_s[-1] == pytest.approx(250.0)


def test_the_arm_hardly_stretches_and_its_frames_lie_along_it(arm):
    arcs = np.append(0.0, arm.point_arcs_m)
    backbone = np.concatenate([np.zeros_like(arm.positions[:, :1]), arm.positions], axis=1)[::5]
    slopes = CubicSpline(arcs, backbone, axis=1)(np.linspace(0, 0.66, 100), 1)
    assert np.abs(np.linalg.norm(slopes, axis=-1) - 1).max() < 0.006
    tangents = CubicSpline(arcs, backbone, axis=1)(arm.frame_arcs_m[1:], 1)
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    frames = Rotation.from_quat(arm.orientations[::5, 1:].reshape(-1, 4))
    along = frames.apply([0.0, 0.0, 1.0]).reshape(tangents.shape)
    assert np.degrees(np.linalg.norm(along - tangents, axis=-1)).max() < 1.0  # shear and rounding
    np.testing.assert_array_equal(arm.orientations[:, 0], np.tile([0.0, 0.0, 0.0, 1.0], (len(arm.time_s), 1)))


def test_the_file_is_small_and_holds_no_objects():
    assert FILE.stat().st_size < 1e6
    with np.load(FILE, allow_pickle=False) as file:
        assert {file[name].dtype.kind for name in file.files} == {"f", "i", "U"}


def test_bad_input(arm, tmp_path):
    with pytest.raises(
        InputError,
        match=r"Input time_s of SoftArm must be between 0 and 250 s; instead received 0 to 251 s\.",
    ):
        arm.orientations_at(np.array([0.0, 251.0]))
    with pytest.raises(
        InputError,
        match=r"Input arcs_m of SoftArm must be among point_arcs_m \[m\]; instead received \[0.37\]",
    ):
        arm.positions_at(np.zeros(1), np.array([0.36, 0.37]))
    with pytest.raises(InputError, match="Input path of load_soft_arm must be a file of a motion"):
        load_soft_arm(tmp_path / "none.npz")
    (tmp_path / "half.npz").write_bytes(FILE.read_bytes()[:5000])
    with pytest.raises(InputError, match="Input file of half.npz must be one of a motion"):
        load_soft_arm(tmp_path / "half.npz")
