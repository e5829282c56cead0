"""Start of motion and alignment of the rig's recordings: made-up noise, false starts, and lags that are known."""

from pathlib import Path

import numpy as np
import pytest

from edition1.errors import InputError
from edition1_companion.recordings.baaij2023 import merge, process, raw_paths, read_readings, split
from edition1_companion.recordings.rig_alignment import (
    check_lags,
    noise_at_rest,
    start_of_motion,
    start_of_readings,
)
from edition1_companion.recordings.rig_capture import RingMotion, read_ring_motion
from edition1_companion.twins.pneumatic_rig import record_rig
from edition1_companion.twins.rig_twins import nominal_twin, random_twin

START = 70
"""Row in which the made-up readings begin to change."""
LSB_MV = 0.0625


def readings(noise_mv, seed, rows=200):
    """At rest up to row 70, with white noise, then rising by 8 mV a row; in steps of the converter."""
    g = np.random.default_rng(seed)
    rise = 8.0 * np.clip(np.arange(rows) - START + 1, 0, None)[:, None] * [1.0, -0.7, 0.5]
    return LSB_MV * np.rint((1200.0 + rise + noise_mv * g.standard_normal((rows, 3))) / LSB_MV)


def false_starts(noise_mv, rule, seeds=400):
    """Share of recordings whose start is found two rows or more (50 ms) before anything moves."""
    found = [start_of_readings(readings(noise_mv, seed), "a", rule=rule) for seed in range(seeds)]
    assert max(found) <= START + 2
    return np.mean(np.array(found) < START - 1)


@pytest.mark.parametrize(
    ("noise_mv", "lowest", "highest"),
    [(0.24, 0.0, 0.02), (0.30, 0.01, 0.15), (0.35, 0.1, 0.4), (0.40, 0.35, 0.75), (0.50, 0.8, 1.0)],
)
def test_noise_at_rest_is_no_start(noise_mv, lowest, highest):
    """The released rule measures from one noisy row, by a limit that does not know the noise."""
    assert lowest <= false_starts(noise_mv, "released") <= highest
    assert false_starts(noise_mv, "noise") == 0.0


def test_start_in_noise_of_the_pressurised_rig_is_found():
    """3.55 mV, what section 5.2 has for a pressurised segment: a limit of 21 mV, passed three to four rows late."""
    found = [start_of_readings(readings(3.55, seed), "a") for seed in range(100)]
    assert min(found) >= START
    assert max(found) <= START + 8


@pytest.mark.parametrize("noise_mv", [0.1, 0.5, 3.55])
def test_noise_at_rest_is_that_of_the_readings(noise_mv):
    found = [noise_at_rest(readings(noise_mv, seed)) for seed in range(100)]
    assert np.mean(found) == pytest.approx(noise_mv, rel=0.1)
    assert np.std(found) < 0.2 * noise_mv


def test_without_noise_the_limit_is_a_millivolt():
    u = np.full((40, 3), 1000.0)
    u[20:] += 0.9
    u[30:] += 0.2
    assert start_of_readings(u, "a") == 30


def test_rows_right_before_the_limit_belong_to_the_start():
    u = np.full((60, 3), 1000.0)
    u[::2] += 0.5  # noise of 0.35 mV: from the median, 0.25 mV; the limit is 2.1 mV
    u[30:] += np.array([1.5, 1.8, 4.0, *[20.0] * 27])[:, None]
    assert start_of_readings(u, "a") == 30
    u[:30] += np.where(np.arange(30) == 20, 1.5, 0.0)[:, None]  # not right before it
    assert start_of_readings(u, "a") == 30


def test_readings_that_move_from_the_beginning_are_refused():
    with pytest.raises(InputError, match=r"readings of a must be at rest in their first 10 rows \(0\.25 s\)"):
        start_of_readings(readings(0.24, 0)[START - 5 :], "a")
    with pytest.raises(InputError, match="rule of start_of_readings must be one of 'noise', 'released'"):
        start_of_readings(readings(0.24, 0), "a", rule="first")


@pytest.fixture(scope="module")
def raw():
    """Recordings of the nominal twin, 40 s each; synthetic."""
    return {name: record_rig(nominal_twin(), name, seed=0, duration_s=40.0) for name in ("T0", "T3", "T5")}


def streams(recording, folder: Path):
    recording.write(folder)
    capture, sensors = raw_paths(recording.name, folder)
    return read_ring_motion(capture), read_readings(sensors)[0]


def test_both_rules_find_the_same_start_on_the_twin(raw, tmp_path):
    for recording in raw.values():
        recording.write(tmp_path)
        read, released = (process(recording.name, tmp_path, rule=rule) for rule in ("noise", "released"))
        np.testing.assert_array_equal(read.u, released.u)
        np.testing.assert_array_equal(read.q, released.q)
        assert read.remarks == released.remarks == ()


@pytest.mark.parametrize("trajectory", ["T0", "T3", "T5"])
@pytest.mark.parametrize("rows", [-50, -25, 25, 50])
def test_a_lag_that_is_wrong_is_found(raw, tmp_path, trajectory, rows):
    read = merge(*streams(raw[trajectory], tmp_path), "a")
    n = abs(rows)
    check = check_lags(read.q[n:-n], np.roll(read.u, rows, axis=0)[n:-n])
    own = check_lags(read.q, read.u)
    assert check is not None
    assert own is not None
    assert own.gain < 1.5
    assert check.gain > 1.5
    assert check.best_s == pytest.approx(own.best_s + rows / 40, abs=0.1)


def glitch(u, row=None):
    """Readings with one row at rest that is 5 mV off, as a plug that is touched: a start that is none."""
    u = u.copy()
    u[15 if row is None else row] += 5.0
    return u


def test_a_recording_that_is_not_aligned_is_refused_or_said(raw, tmp_path):
    """The start found is 55 rows too early, 1.4 s."""
    motion, u = streams(raw["T5"], tmp_path)
    refused = r"motion capture and readings of a must be aligned at the start of inflation; instead received readings"
    with pytest.raises(
        InputError, match=refused + r" that fit 1\.\d* s later, with 1\.\d* mV left instead of"
    ):
        merge(motion, glitch(u), "a")
    read = merge(motion, glitch(u), "a", rule="released")
    assert len(read.remarks) == 1
    assert "a: the alignment is in doubt; the readings fit motion capture best 1." in read.remarks[0]
    assert split(read)[0].remarks == read.remarks


def test_rules_that_differ_are_said(raw, tmp_path):
    """Row 0 is 1.5 mV off: the released rule finds a start in row 1, and the readings say that it is none."""
    motion, u = streams(raw["T5"], tmp_path)
    before, u = start_of_readings(u, "a"), u.copy()
    u[0] += 1.5
    read, start = merge(motion, u, "a"), start_of_readings(u, "a")
    assert before <= start <= before + 1
    assert read.remarks == (
        f"a: the readings begin in row {start} by the rule 'noise', in row 1 ({(1 - start) / 40:+g} s) by"
        " 'released'.",
    )
    released = merge(motion, u, "a", rule="released")
    assert f"a: the readings begin in row 1 by the rule 'released', in row {start}" in released.remarks[0]
    assert "a: the alignment is in doubt; the readings fit" in released.remarks[1]
    assert len(read) != len(released)


def test_readings_of_another_motion_are_said(raw, tmp_path):
    motion, _ = streams(raw["T5"], tmp_path)
    _, u = streams(raw["T0"], tmp_path)
    assert any("the readings hardly follow the motion" in x for x in merge(motion, u, "a").remarks)


def test_what_is_too_short_to_check_is_said():
    motion = RingMotion(np.arange(600) / 40, np.zeros((600, 3)), 0, 0)
    motion.q[START:, 2] = 4e-3
    read = merge(motion, readings(0.24, 0, rows=600), "a")
    assert len(read) < 80
    assert read.remarks == ("a: too short to check how readings and motion capture are aligned.",)


@pytest.mark.parametrize("seed", [0, 1])
def test_random_twins_are_not_refused(tmp_path, seed):
    for name in ("T0", "T2"):
        recording = record_rig(random_twin(seed), name, seed=seed, duration_s=30.0)
        motion, u = streams(recording, tmp_path)
        assert start_of_motion(motion.q, name) > 0
        assert merge(motion, u, name).remarks == ()
