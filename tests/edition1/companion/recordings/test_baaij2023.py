"""Recordings T0 to T5: synthetic files through the pipeline, alignment, and files that cannot be trusted.

The authors' own files are compared where they are found.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from edition1.errors import InputError
from edition1_companion.book.project import find_project
from edition1_companion.recordings.baaij2023 import (
    NAMES,
    Recording,
    data_folder,
    merge,
    process,
    raw_paths,
    read_readings,
    split,
)
from edition1_companion.recordings.rig_capture import RingMotion, read_ring_motion
from edition1_companion.recordings.sources import read_sources
from edition1_companion.twins.pneumatic_rig import record_rig
from edition1_companion.twins.rig_twins import nominal_twin

FRAMES = 900


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A folder with a synthetic recording, and that recording."""
    folder = tmp_path_factory.mktemp("baaij2023")
    recording = record_rig(nominal_twin(), "T3", seed=0, duration_s=12.0)
    recording.write(folder)
    return folder, recording


def test_readings_survive_the_files_exactly(written):
    folder, recording = written
    u, dropped = read_readings(raw_paths(recording.name, folder)[1])
    np.testing.assert_array_equal(u, recording.readings_mv)
    assert dropped == 0


def test_configurations_survive_the_files_to_the_noise(written):
    folder, recording = written
    motion = read_ring_motion(raw_paths(recording.name, folder)[0])
    # The centre of the ring is taken from the first frame, so the noise of that frame (0.02 mm, about 0.05 mm of
    # bend) is in all of them.
    _, truth, _ = recording.motion.at(recording.capture_start_s + motion.time_s)
    np.testing.assert_allclose(1e3 * motion.q, 1e3 * truth, atol=0.3)
    assert np.abs(1e3 * (motion.q - truth)).mean() < 0.06
    assert motion.filled == (~recording.track.tracked).sum()


def test_relations_of_the_straight_segment_are_those_of_the_drawing():
    straight = Recording("straight", np.arange(2), np.zeros((2, 3)), np.zeros((2, 3)))
    lam, d, alpha, beta, theta = straight.relations()[0].T
    np.testing.assert_allclose(d, np.hypot(0.060, 0.013))
    np.testing.assert_allclose(alpha, np.pi)
    np.testing.assert_allclose(theta, np.arctan2(0.013, 0.060))
    np.testing.assert_allclose(beta, np.pi - theta)
    np.testing.assert_allclose(lam, np.pi - np.arccos(0.921 / np.linalg.norm([0.311, 0.234, 0.921])))


def streams(
    start_q: int, start_u: int, n_q: int = FRAMES, n_u: int = FRAMES
) -> tuple[RingMotion, np.ndarray]:
    """Motion and readings that count their own frames after the start of inflation."""
    q, u = np.zeros((n_q, 3)), np.full((n_u, 3), 1000.0)
    q[start_q:, 2] = 4e-3
    q[:, 0] = 1e-6 * (np.arange(n_q) - start_q)
    u[start_u:] += 100.0 + np.arange(n_u - start_u)[:, None]
    return RingMotion(np.arange(n_q) / 40, q, 0, 0), u


@pytest.mark.parametrize(("start_q", "start_u"), [(40, 40), (40, 75), (90, 13)])
def test_alignment_recovers_a_known_delay(start_q, start_u):
    recording = merge(*streams(start_q, start_u), "known", skip=0)
    since_q, since_u = np.rint(1e6 * recording.q[:, 0]), recording.u[:, 0] - 1100.0
    np.testing.assert_array_equal(since_q, since_u)
    assert recording.frame[0] == 0
    assert since_q[0] == 8 * 40 - min(start_q, start_u)  # 8 s after the start of the later recording
    assert recording.repairs["frames of motion capture cut to align"] == max(0, start_q - start_u)
    assert recording.repairs["readings cut to align"] == max(0, start_u - start_q)


@pytest.mark.parametrize(("start_q", "start_u", "apart"), [(40, 40, 0), (40, 75, 1), (90, 13, -1)])
def test_released_alignment_drops_one_frame_more(start_q, start_u, apart):
    recording = merge(*streams(start_q, start_u), "known")
    since_q, since_u = np.rint(1e6 * recording.q[:, 0]), recording.u[:, 0] - 1100.0
    np.testing.assert_array_equal(since_u - since_q, apart)


@pytest.mark.parametrize(
    ("start_q", "start_u", "skip", "first", "last"),
    [
        # Nothing to align: of frames 0 to 899 those from 8 s = frame 320 on, and before 899 - 5 s = frame 699.
        (40, 40, 1, 320, 698),
        # Readings cut by 75 - 40 = 35 frames: 865 in common, the last is 864, so those before 664.
        (40, 75, 0, 320, 663),
        # One frame more: 864 in common, those before 663.
        (40, 75, 1, 320, 662),
        # Motion cut by 90 - 13 = 77 frames: 823 in common, numbered from 0; those before 622, in the file 77 later.
        (90, 13, 0, 320 + 77, 621 + 77),
        # One frame more: 822 in common, numbered from 1 to 822; those from 320 to 621, in the file 77 later.
        (90, 13, 1, 320 + 77, 621 + 77),
    ],
)
def test_first_and_last_frame_that_are_kept(start_q, start_u, skip, first, last):
    """By the rule of the released code: index >= 8 s, index < last index - 5 s, at 40 Hz."""
    recording = merge(*streams(start_q, start_u), "known", skip=skip)
    frames = np.rint(1e6 * recording.q[:, 0]).astype(int) + start_q
    np.testing.assert_array_equal(frames, np.arange(first, last + 1))
    np.testing.assert_array_equal(recording.frame, np.arange(last - first + 1))
    delay = start_u - start_q + skip * np.sign(start_u - start_q)
    np.testing.assert_array_equal(recording.u[:, 0] - 1100.0 + start_u, frames + delay)


def test_the_rest_of_the_longer_stream_is_cut_and_counted():
    longer = merge(*streams(40, 40, n_u=FRAMES + 50), "known")
    shorter = merge(*streams(40, 40, n_u=FRAMES - 50), "known")
    assert longer.repairs["readings without frame"] == 50
    assert shorter.repairs["frames of motion capture without reading"] == 50
    assert len(longer) == len(shorter) + 50


def test_streams_too_short_or_without_start_are_refused():
    with pytest.raises(
        InputError, match=r"motion capture and readings of a must be longer than 13 s together; .* 12\.5 s"
    ):
        merge(*streams(40, 40, n_u=500), "a")
    motion, u = streams(40, 40)
    with pytest.raises(
        InputError, match=r"start of a must be readings that change by 1 mV; instead received none"
    ):
        merge(motion, np.full_like(u, 1000.0), "a")
    still = RingMotion(motion.time_s, np.zeros_like(motion.q), 0, 0)
    with pytest.raises(InputError, match=r"start of a must be an elongation that changes by 0\.2 mm"):
        merge(still, u, "a")


@pytest.mark.parametrize(("share", "test_frames"), [(0.3, 300), (0.2, 200)])
def test_split(share, test_frames):
    recording = Recording("a", np.arange(1001), np.arange(3003.0).reshape(-1, 3), np.zeros((1001, 3)))
    train, test = split(recording, share)
    assert (len(train), len(test)) == (1001 - len(test), test_frames + 1)
    np.testing.assert_array_equal(np.vstack([train.q, test.q]), recording.q)
    assert (test.frame == np.arange(len(test))).all()


def test_split_refuses_bad_input():
    recording = Recording("a", np.arange(1), np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(
        InputError, match=r"test_share of split must be between 0 and 1; instead received 1\.5"
    ):
        split(recording, 1.5)
    with pytest.raises(InputError, match="recording of split must be long enough for two parts"):
        split(recording, 0.3)


def readings_file(folder: Path, text: str) -> Path:
    path = folder / "a_SV.csv"
    path.write_text(text)
    return path


def test_incomplete_readings_at_the_end_are_dropped_and_counted(tmp_path):
    u, dropped = read_readings(readings_file(tmp_path, "u1,u2,u3\n1,2,3\n4,5,6\n7,8\n,,\n"))
    np.testing.assert_array_equal(u, [[1, 2, 3], [4, 5, 6]])
    assert dropped == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("u1,u2\n1,2\n", r"columns of a_SV\.csv must be u1, u2, u3; instead received none named u3"),
        ("u1,u2,u3\n1,x,3\n", r"readings of a_SV\.csv must be numbers \[mV\]"),
        ("u1,u2,u3\n1,2,3\n4,,6\n7,8,9\n", r"readings of a_SV\.csv must be complete up to the end; .* row 1"),
        ("u1,u2,u3\n,2,3\n", r"readings of a_SV\.csv must be rows of three numbers; .* none in the first row"),
        ("u1,u2,u3\n1,2,3\n4,2047.9375,0\n", r"above 0 and below 2047\.94 mV; instead received 1 of u2, 1 of u3"),
    ],
)  # fmt: skip
def test_readings_that_cannot_be_trusted_are_refused(tmp_path, text, message):
    path = readings_file(tmp_path, text)
    with pytest.raises(InputError, match=message):
        read_readings(path)


def test_the_list_of_recordings_names_the_files_read_here():
    listed = {file.path for file in read_sources(find_project().data / "sources.json", ["baaij2023"])}
    for name in NAMES.values():
        paths = raw_paths(name, Path())
        assert {path.as_posix() for path in paths} <= listed
        assert f"datasets/experimental/merged_data/{name}.csv" in listed


@pytest.mark.parametrize("trajectory", NAMES)
def test_pipeline_repeats_the_released_merged_files(trajectory):
    name = NAMES[trajectory]
    if not all(path.is_file() for path in raw_paths(name)):
        pytest.skip("the recording is not found")
    ours = process(name, rule="released")
    theirs = pd.read_csv(data_folder() / "merged_data" / f"{name}.csv")  # a row for each sensor and frame
    np.testing.assert_array_equal(ours.u.ravel(), theirs["u"])
    q = theirs[["q_dx_0", "q_dy_0", "q_dL_0"]].to_numpy()[::3]
    np.testing.assert_allclose(1e3 * ours.q, 1e3 * q, atol=0.05)  # theirs are in single precision
