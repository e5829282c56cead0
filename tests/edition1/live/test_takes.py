"""What can be played: the numbers of the simulations, in the unit and the axes of the wire."""

import numpy as np
import pytest

from edition1.errors import InputError
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ
from edition1_companion.twins import bend_curves, takes, trajectories
from edition1_companion.twins.bend_curves import bend_curve, bend_readings
from edition1_companion.twins.courses import all_courses
from edition1_companion.twins.pneumatic_actuation import TRAJECTORIES
from edition1_companion.twins.pneumatic_rig import record_rig
from edition1_companion.twins.rig_twins import nominal_twin
from edition1_companion.twins.takes import SOURCES, open_take
from edition1_companion.twins.trajectories import lemniscate
from edition1_live.record.recording_file import RecordingFile
from edition1_live.wire.formats import encode
from edition1_live.wire.frame import Frame

QUICK = [source for source in SOURCES if not source.startswith("twin")] + ["twin:T2"]


def test_the_courses_that_are_kept_are_those_computed():
    """In the file that emulators play without torch; steps of a converter may fall the other way elsewhere."""
    assert (takes.CURVES, takes.TRAJECTORIES) == (bend_curves.CURVES, TRAJECTORIES)
    assert (takes.STEPS, takes.RATE_HZ) == (trajectories.STEPS, trajectories.RATE_HZ)
    assert (takes.RIG_RATE_HZ, takes.TIME_STEP) == (RIG_RATE_HZ, bend_curves.TIME_STEP)
    computed = all_courses()
    with np.load(takes.KEPT) as kept:
        assert set(kept) == set(computed)
        for name, values in computed.items():
            assert (kept[name].dtype, kept[name].shape) == (values.dtype, values.shape)
            if name.startswith("twin"):
                apart = np.abs(kept[name].astype(int) - values)
                assert apart.max() <= 1
                assert apart.mean() < 1e-3
            else:
                np.testing.assert_allclose(kept[name], values, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("source", QUICK)
@pytest.mark.parametrize("as_frames", [False, True])
def test_every_take_fits_its_format(source, as_frames):
    take = open_take(source, "frames" if as_frames else "")
    assert "SYNTHETIC" in take.label
    assert (np.diff(take.time_s) >= 0).all()
    assert take.time_s[0] == 0 < take.time_s[-1] < take.period_s
    for k, reading in zip(range(50), take.readings(), strict=False):
        assert encode(take.format, Frame(reading.stream, k, 0, reading.values))


def test_the_lemniscate_is_that_of_table_1():
    expected = readings(pcc_robot(), lemniscate(1), ring("released")).numpy()
    take = open_take("lemniscate")
    assert take.format == "frames"
    np.testing.assert_allclose(take.values, expected, rtol=1e-6)
    np.testing.assert_allclose(take.time_s[[0, 1, -1]], [0, 0.025, 399 / 40])
    faster = open_take("lemniscate", rate_hz=1000.0)
    assert len(faster.values) == 10_000
    assert faster.period_s == take.period_s == 10.0


def test_the_hall_sensor_sends_counts_with_the_body_axis_last():
    u = bend_readings(bend_curve("flower"))
    take = open_take("flower")
    assert take.format == "hall"
    # The body is along z of the model; the magnet points the other way, and y is mirrored.
    back = 0.01 * take.values[:, [1, 0, 2]] * [1, -1, -1]
    assert np.abs(back - u.numpy()).max() <= 0.005 + 1e-9  # half a count
    np.testing.assert_allclose(open_take("flower", "frames").values, u.numpy(), rtol=1e-6, atol=1e-9)


def test_the_twin_sends_what_its_board_read():
    raw = record_rig(nominal_twin(), "T2", seed=3).readings_mv
    take = open_take("twin:T2", seed=3)
    assert take.format == "millivolts"
    np.testing.assert_array_equal(take.values, raw)  # steps of 1/16 mV need four decimals
    doubled = open_take("twin:T2", seed=3, rate_hz=80.0)
    np.testing.assert_array_equal(doubled.values[::2], raw[: len(doubled.values[::2])])
    np.testing.assert_allclose(doubled.values[1], raw[:2].mean(axis=0), atol=5e-5)


def test_the_arm_sends_unit_quaternions_of_eight_imus():
    take = open_take("arm")
    assert take.stream[:9].tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 0]
    np.testing.assert_allclose(np.linalg.norm(take.values, axis=1), 1, atol=1e-3)
    assert open_take("arm", rate_hz=10.0).time_s[8] == pytest.approx(0.1)


def test_a_take_begins_again():
    take = open_take("lemniscate")
    looped = take.readings(loop=True)
    first = [next(looped) for _ in range(801)]
    assert first[:400] == list(take.readings())
    assert [reading.values for reading in first[400:800]] == [reading.values for reading in first[:400]]
    np.testing.assert_allclose([reading.time_s for reading in first], np.arange(801) / 40)


def test_a_recording_is_played_as_it_came(tmp_path):
    path = tmp_path / "one.rrb"
    with RecordingFile(
        path, {"format": "millivolts", "start_unix_s": 0.0, "start_host_ns": 10**9, "channels": ["u1_mV"]}
    ) as file:
        for k, at in enumerate((2.0, 2.5, 2.5, 4.0)):
            file.append(int(1e9 * at), [Frame(0, None, None, (100.0 + k, 7.25, 9.0))])
    take = open_take(str(path))
    assert take.format == "millivolts"
    np.testing.assert_allclose(take.time_s, [0, 0.5, 0.5, 2.0])
    np.testing.assert_array_equal(take.values[:, 0], [100, 101, 102, 103])
    np.testing.assert_allclose(open_take(str(path), "frames", rate_hz=10.0).time_s, [0, 0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("lemniskate",),
            "Input source of open_take must be one of lemniscate, spiral, flower, seagull, twin:T0, twin:T1, "
            "twin:T2, twin:T3, twin:T4, twin:T5, arm, or the path of a recording; instead received 'lemniskate'.",
        ),
        (
            ("T2",),
            "Input source of open_take must be one of .*; instead received 'T2'.",
        ),
        (
            ("lemniscate", "hall"),
            "Input format of the take lemniscate must be frames or csv; instead received hall.",
        ),
        (
            ("arm", "millivolts"),
            "Input format of the take arm must be quaternions or frames; instead received millivolts.",
        ),
        (
            ("arm", "csv"),
            "Input format of the take arm must be quaternions or frames; instead received csv.",
        ),
        (
            ("arm", "mcap"),
            "Input format of open_take must be one of frames, hall, millivolts, quaternions, csv; .* mcap.",
        ),
    ],
)
def test_takes_that_do_not_fit_are_refused(arguments, message):
    with pytest.raises(InputError, match=f"^{message}$"):
        open_take(*arguments)


def test_a_rate_must_be_positive():
    with pytest.raises(
        InputError, match=r"^Input rate_hz of open_take must be above zero \[Hz\]; instead received 0.0.$"
    ):
        open_take("arm", rate_hz=0.0)
