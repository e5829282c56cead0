"""Samples of a robot's streams put together: which make a step, what they read, and when it was."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from repro import Imu, InputError, Link, Robot, Sensor
from repro_board.record import Writer, readings_of
from repro_board.steps import STANDS_STILL, STILL, Labels, Steps
from repro_board.wire import WRAP, Parser, Sample, encode

CHIP = Robot([Link(0.1)], sensors=[Sensor(1, 0.05, 0.01, axes=3)], rate_hz=100.0)
ARM = Robot([Link(0.1)], imus=[Imu(1, 0.02), Imu(1, 0.05), Imu(1, 0.1)], rate_hz=100.0)
BOTH = Robot([Link(0.1)], sensors=[Sensor(1, 0.05, 0.01)], imus=[Imu(1, 0.1)], rate_hz=100.0)
TURN = np.array([math.sin(0.1), 0.0, 0.0, math.cos(0.1)])


def sample(stream, *values, time_us=None):
    return Sample(stream, None, time_us, 0, np.array(values, dtype=float))


def turned(stream, angle=0.2):
    return sample(stream, math.sin(angle / 2), 0.0, 0.0, math.cos(angle / 2))


def readings(steps, samples):
    return [step.u.tolist() for k, x in enumerate(samples) for step in steps.feed([x], 0.01 * k)]


# ---- what makes a step ----


def test_every_sample_of_magnetic_sensors_is_a_step_in_mt():
    steps = Steps(CHIP)
    assert readings(steps, [sample(0, 1, 2, 3), sample(0, 4, math.nan, -math.inf)])[0] == [1, 2, 3]
    assert repr(readings(Steps(CHIP), [sample(0, 4, math.nan, -math.inf)])) == "[[4.0, nan, nan]]"
    named = Labels(names=("u1", "u3", "u2"), units=("uT", "mT", "uT"))
    assert readings(Steps(CHIP, source=named), [sample(0, 1000, 2, 3000)]) == [[1, 3, 2]]


def test_labels_that_mean_no_channel_are_channels_in_their_order():
    steps = Steps(CHIP, source=Labels(names=("X", "Y", "Z"), units=("uT",) * 3))
    assert readings(steps, [sample(0, 1000, 2000, 3000)]) == [[1, 2, 3]]
    assert steps.remarks[0] == "X, Y, Z are taken for u1, u2, u3, in this order."
    by_name = CHIP.replaced(sensors=[Sensor(1, 0.05, 0.01, axes=3, channels=["Bx", "By", "Bz"])])
    assert readings(Steps(by_name), [sample(0, 1, 2, 3)]) == [[1, 2, 3]]  # frames have no names
    swapped = Labels(names=("By", "Bx", "Bz"), units=("mT",) * 3)
    assert readings(Steps(by_name, source=swapped), [sample(0, 1, 2, 3)]) == [[2, 1, 3]]


@pytest.mark.parametrize(
    ("names", "units", "message"),
    [
        (("u1", "u2", "u4"), ("mT",) * 3, "one column for sensor 1 z"),
        (("u1", "u2", "u3"), ("mV",) * 3, "in mT or another unit of flux density"),
        (("a", "b"), ("", ""), "none among a, b"),
    ],
)
def test_a_board_that_is_not_the_robots_is_refused(names, units, message):
    with pytest.raises(InputError, match=message):
        Steps(CHIP, source=Labels(names=names, units=units)).feed([sample(0, *range(len(names)))], 0.0)


@pytest.mark.parametrize("line", ["9,1,2,3", "9 1 2 3"])
def test_one_number_too_many_without_names_is_refused(line):
    """Any of them may be the one, such as a time in front."""
    parser = Parser()
    samples = parser.feed(f"\n{line}\n{line}\n{line}\n".encode())
    assert len(samples) == 3
    with pytest.raises(
        InputError, match="of the board must be 3 columns, one for every reading .* received 4"
    ):
        Steps(CHIP, source=parser).feed(samples, 1.0)
    with pytest.raises(InputError, match="must be 1 columns, one for every reading .* received 2"):
        Steps(BOTH).feed([sample(0, 1, 2)], 1.0)
    chosen = CHIP.replaced(sensors=[Sensor(1, 0.05, 0.01, axes=3, channels=[4, 2, 3])])
    assert readings(Steps(chosen), [sample(0, 9, 1, 2, 3)]) == [[3, 1, 2]]  # frames have numbers


def test_orientations_in_another_order_are_said_once():
    steps = Steps(Robot([Link(0.1)], imus=[Imu(1, 0.1)]))
    found = readings(steps, [sample(1, *np.roll(TURN, 1))] * 50)
    assert len(found) == 50
    assert [x for x in steps.remarks if "with w first" in x] == steps.remarks[:1]
    assert len(steps.remarks) == 1


def test_imus_make_a_step_when_all_have_sent_or_one_sends_again():
    steps = Steps(ARM)
    found = readings(steps, [turned(k, 0.1 * k) for k in (1, 2, 3)])
    np.testing.assert_allclose(found, [[0.1, 0, 0, 0.2, 0, 0, 0.3, 0, 0]], atol=1e-15)
    assert [len(steps.feed([turned(k, 0.4)], 1.0 + k)) for k in (1, 2, 1)] == [0, 0, 1]  # the third was lost
    assert len(steps.feed([turned(3, 0.4)], 5.0)) == 0
    assert len(steps.feed([turned(2, 0.4)], 6.0)) == 1


def test_a_silent_imu_is_missing_and_comes_back():
    steps = Steps(ARM)
    readings(steps, [turned(k) for k in (1, 2, 3)] * 5)
    without = np.array(readings(steps, [turned(k) for k in (1, 2)] * 100))
    silent = np.asarray(np.isnan(without[:, 6:]).all(axis=1))
    assert 2 <= np.argmax(silent) <= 3  # what it said last is kept for two turns
    assert silent[4:].all()
    assert np.isfinite(without[:, :6]).all()
    again = np.array(readings(steps, [turned(k) for k in (3, 1, 2)] * 3))
    assert np.isfinite(again[-2:]).all()
    without = np.array(readings(steps, [turned(k) for k in (1, 2)] * 10))
    assert np.isnan(without[3:, 6:]).all()  # a long silence is no reason to wait longer for the next one


def test_an_imu_that_never_sends_costs_no_step():
    found = readings(Steps(ARM), [turned(k) for k in (1, 3)] * 10)
    assert len(found) >= 9
    assert np.isnan(np.array(found)[:, 3:6]).all()


def test_imus_beside_magnetic_sensors_keep_what_they_said():
    steps = Steps(BOTH)
    cycle = [sample(0, 1.0), sample(0, 2.0), sample(0, 3.0)]
    assert np.isnan(readings(steps, [sample(0, 1.0)] * 4)[3][1:]).all()  # not heard yet
    found = np.array(readings(steps, [turned(1), *cycle] * 10))
    assert found[:, 0].tolist() == [1, 2, 3] * 10
    assert np.isfinite(found).all()
    alone = np.array(readings(steps, cycle * 10))
    assert np.isfinite(alone[:3]).all()
    assert np.isnan(alone[10:, 1:]).all()


def test_other_streams_and_widths_are_counted_and_said():
    steps = Steps(BOTH)
    readings(steps, [sample(0, 1.0), sample(255, 1.0), sample(1, 1.0), sample(0, 1.0, 2.0), sample(255, 2.0)])
    assert steps.counters == {"steps": 1, "other_streams": 2, "other_widths": 2, "clock_jumps": 0}
    assert "Samples of stream 255 are none of the robot's: left out." in steps.remarks
    assert "Samples of stream 1 have other than 4 values: left out." in steps.remarks


def test_a_stream_for_imus_and_magnetic_sensors_at_once_is_refused():
    with pytest.raises(InputError, match="stream of an IMU must be above 0"):
        Steps(BOTH.replaced(imus=[Imu(1, 0.1, channels=0)]))


READ = Robot(
    [Link(0.1)],
    sensors=[Sensor(1, 0.05, 0.01, axes=3, range=5.0, resolution=0.5)],
    imus=[Imu(1, 0.1, channels=7)],
    rate_hz=100.0,
)
VALUES = [0.0, -0.0, 1.5, 4.5, 4.75, 5.0, -4.75, -5.25, 1e30, math.nan]
TURNS = [TURN, -TURN, np.zeros(4), np.full(4, math.nan), np.array([0.0, 0.0, 0.0, 1.0])]


@st.composite
def sent_rows(draw, values):
    """Readings, orientations and times [µs] of a board; some rows have one time, but not too many."""
    n = draw(st.integers(4, 15))
    rows = st.lists(st.sampled_from(values), min_size=3, max_size=3)
    u = np.array(draw(st.lists(rows, min_size=n, max_size=n)))
    q = np.array(draw(st.lists(st.sampled_from(TURNS), min_size=n, max_size=n)))
    q[0] = q[0] if draw(st.booleans()) else [0.5, 0.5, 0.5, 1.0]
    passed = draw(st.lists(st.sampled_from([0, 1000, 10_000, 25_000]), min_size=n, max_size=n))
    passed[::STILL], passed[-1] = [10_000] * len(passed[::STILL]), 10_000
    return u, q.astype(np.float32).astype(float), np.cumsum(passed)


def at_port(robot, data, cuts):
    """Readings, times and sentences about a board whose bytes arrive cut at some places."""
    parser, found, last = Parser(), [], 0
    steps = Steps(robot, source=parser)
    for cut in [*sorted(cuts), len(data)]:
        found += steps.feed(parser.feed(data[last:cut]), 0.001 * cut)
        last = cut
    times = np.array([x.time_s for x in found])
    return np.array([x.u for x in found]), times - times[0], [*steps.remarks, *steps.losses()]


def recorded(robot, parts, us, path):
    """Readings of a recording with a block for each part."""
    path.unlink(missing_ok=True)
    writer = Writer(path, {})
    for part, time_us in zip(parts, us.tolist(), strict=True):
        writer.write(17 * 10**17 + 1000 * time_us, part)
    writer.close()
    return readings_of(robot, path)


@settings(max_examples=20)
@given(st.data(), st.sampled_from(["frames", "lines"]))
def test_the_same_numbers_are_the_same_readings_whatever_brings_them(tmp_path_factory, data, format):
    """As a table, as a recording, and at a port: cut anywhere, in single bytes, or all at once."""
    u, q, us = data.draw(sent_rows([*VALUES, -math.inf] if format == "frames" else VALUES))
    folder, robot = tmp_path_factory.getbasetemp(), READ
    frame = pd.DataFrame(np.column_stack([us, u]), columns=["time_us", "u1_mT", "u2_mT", "u3_mT"])
    if format == "frames":
        parts = [encode(q[k], 7, k, t) + encode(u[k], 0, k, t) for k, t in enumerate(us.tolist())]
        table, owner = (
            robot.readings(frame.assign(**{f"q{x}_7": q[:, k] for k, x in enumerate("xyzw")})),
            "the table",
        )
    else:
        robot, owner = READ.replaced(imus=[]), "a.csv"
        frame.astype({"time_us": int}).to_csv(folder / owner, index=False, na_rep="nan")
        table, (names, *parts) = (
            robot.readings(folder / owner),
            (folder / owner).read_bytes().splitlines(True),
        )
        parts[0] = names + parts[0]
    whole = recorded(robot, parts, us, folder / "a.rec")
    np.testing.assert_array_equal(whole, table)
    np.testing.assert_allclose(whole.times - whole.times[0], table.times - table.times[0], atol=2e-6)
    assert [x.replace("a.rec", owner) for x in whole.remarks] == list(table.remarks)
    sent = b"".join(parts)
    cuts = data.draw(st.lists(st.integers(1, len(sent)), max_size=9))
    _, first, _ = at_port(robot, sent, cuts)
    for places in (cuts, range(1, len(sent)), []):
        found, times, remarks = at_port(robot, sent, places)
        np.testing.assert_array_equal(found, table)
        assert remarks == [x for x in table.remarks if "times of" not in x and "infinite" not in x]
        np.testing.assert_allclose(times, first, atol=1e-9)
    late = first - 1e-6 * (us - us[0])
    assert late.min() > -1e-9
    assert late.max() < 1e-9 or (np.diff(us) == 0).any()


# ---- when it was ----


def timed(steps, *calls):
    """Times of steps whose samples came in calls of (arrival, times of the board...)."""
    return [
        x.time_s
        for arrived, *sent in calls
        for x in steps.feed([sample(0, 1, 2, 3, time_us=t) for t in sent], arrived)
    ]


def test_the_boards_clock_counts_over_wraps_and_resets():
    sent = [WRAP - 20_000, WRAP - 10_000, 0, 10_000]  # as of streams that wrapped at other times
    times = timed(Steps(CHIP), *((7.0 + 0.013 * k, t) for k, t in enumerate(sent)))
    np.testing.assert_allclose(times, [7.0, 7.01, 7.02, 7.03], atol=1e-9)
    times = timed(Steps(CHIP), (7.0, 90_000_000), (7.01, 90_010_000), (8.0, 5000), (8.01, 15_000))
    np.testing.assert_allclose(times, [7.0, 7.01, 8.0, 8.01], atol=1e-9)
    times = timed(Steps(CHIP), (7.0, 10_000), (67.3, 60_010_000))  # a minute of silence
    np.testing.assert_allclose(times, [7.0, 67.0], atol=1e-9)


@pytest.mark.parametrize("together", [1, 5])
def test_a_clock_that_stands_still_is_said_and_not_used(together):
    """From the beginning, or after a while; and when it moves again, time goes on."""
    zero, stops = np.zeros(100, dtype=int), 10_000 * np.minimum(np.arange(100), 30)
    again = np.r_[stops[:60], 310_000 + 10_000 * np.arange(40)]
    for clock in (zero, stops, again):
        steps = Steps(CHIP)
        blocks = clock.reshape(-1, together).tolist()
        times = timed(steps, *((0.01 * together * k, *sent) for k, sent in enumerate(blocks)))
        np.testing.assert_allclose(np.diff(times), 0.01, atol=2e-6)
        assert steps.remarks == [STANDS_STILL]


def test_a_clock_may_show_one_time_for_longer_than_a_step_takes():
    steps = Steps(CHIP.replaced(rate_hz=None))
    timed(
        steps, *((0.5 * k, 4_000_000 * (k // 8)) for k in range(40))
    )  # it goes on by 4 s, eight steps later
    assert (steps.counters["clock_jumps"], steps.remarks) == (0, [])


def test_steps_of_one_time_are_spread_as_those_before():
    steps = Steps(CHIP.replaced(rate_hz=None))
    sent = [10_000 * (k // 4) for k in range(400)]  # four samples a tick
    times = timed(steps, *((1.0 + 0.0025 * k, t) for k, t in enumerate(sent)))
    np.testing.assert_allclose(np.diff(times[16:]), 0.0025, atol=1e-9)
    assert steps.remarks == []


def test_samples_that_arrive_together_are_spread_over_the_time_since_the_ones_before():
    steps = Steps(CHIP)
    regular = timed(steps, *((0.04 * k, *[None] * 4) for k in range(1, 50)))
    np.testing.assert_allclose(np.diff(regular), 0.01, atol=1e-9)
    assert regular[-1] == pytest.approx(0.04 * 49)
    held_up = timed(steps, (2.96, *[None] * 100))  # a second was held up and comes at once
    np.testing.assert_allclose(np.diff([regular[-1], *held_up]), 0.01, atol=1e-9)
    assert timed(steps, (3.96, None)) == [3.96]  # a pause is a pause
    np.testing.assert_allclose(timed(steps, (13.96, None, None)), [13.95, 13.96], atol=1e-9)


def test_a_stated_rate_that_is_too_low_does_not_make_time_run_ahead():
    steps = Steps(CHIP.replaced(rate_hz=5.0))
    times = timed(steps, *((0.04 * k, *[None] * 4) for k in range(1, 500)))
    assert abs(times[-1] - 0.04 * 499) < 0.05


@given(
    st.lists(
        st.tuples(
            st.floats(0, 1e4),
            st.lists(st.one_of(st.none(), st.integers(0, 2 * WRAP)), min_size=1, max_size=5),
        ),
        max_size=20,
    )
)
def test_times_increase_whatever_the_clocks_do(calls):
    found = timed(Steps(CHIP), *((arrived, *sent) for arrived, sent in calls))
    assert (np.diff(found) > 0).all()
    assert np.isfinite(found).all()


@pytest.mark.parametrize("first", [0, 1, 2])
def test_a_log_that_begins_in_the_middle_of_a_turn_is_the_same_as_a_table_and_from_a_port(tmp_path, first):
    """Lines of IMUs without times: turns begin with the lowest number, wherever the log does."""
    angles = np.linspace(0.0, 1.5, 60).reshape(20, 3)
    lines = [
        f"{k},{math.cos(x / 2):.6f},{math.sin(x / 2):.6f},0.000000,0.000000\r\n"
        for row in angles
        for k, x in enumerate(row, 1)
    ][first:]
    (tmp_path / "log.txt").write_text("".join(lines), newline="")
    table = ARM.readings(tmp_path / "log.txt")
    parser, steps = Parser(), Steps(ARM)
    parser.feed(b"\n")
    found = [step.u for line in lines for step in steps.feed(parser.feed(line.encode()), 0.0)]
    np.testing.assert_array_equal(found, table)
    np.testing.assert_allclose(table[int(first > 0) :, ::3], angles[int(first > 0) :], atol=1e-5)
    assert np.isnan(table[0]).sum() == 3 * first


def test_streams_that_come_in_the_other_order_begin_no_turn_early():
    found = readings(Steps(ARM), [turned(k, 0.1 * k) for k in (3, 2, 1)] * 3)
    np.testing.assert_allclose(found, [[0.1, 0, 0, 0.2, 0, 0, 0.3, 0, 0]] * 3, atol=1e-15)


SKETCHES = {
    "commas": "{},{},{}",
    "semicolons": "{}; {}; {}",
    "tabs": "{}\t{}\t{}",
    "blanks": "{} {}  {}",
    "a list": "[{}, {}, {}]",
    "tuples": "({}, {}, {}),",
    "bytes": "b'{},{},{}\\r\\n'",
    "JSON": '{{"u1": {}, "u2": {}, "u3": {}}}',
    "labels with one unit for all": "u1: {} u2: {} u3: {} uT",
    "labels between blanks and commas": "u1: {} uT, u2={} uT u3:{}uT",
    "a plotter": ">u1:{}§uT\n>u2:{}§uT\n>u3:{}§uT",
}


@pytest.mark.parametrize("form", SKETCHES.values(), ids=SKETCHES)
def test_what_a_sketch_prints_is_the_same_in_a_file_and_from_a_port(tmp_path, form):
    u = np.random.default_rng(0).normal(size=(9, 3)).round(3)
    text = "".join(f"{form.format(*row)}\n" for row in u)
    (tmp_path / "log.txt").write_text(text, encoding="utf-8")
    table = CHIP.readings(tmp_path / "log.txt")
    np.testing.assert_allclose(table, u * (1e-3 if "uT" in form else 1.0), rtol=1e-12)
    assert table.times is None
    unsure = "Columns without a unit are taken as mT: u1, u2, u3." in table.remarks
    assert unsure == ("uT" not in form)
    parser = Parser()
    steps = Steps(CHIP, source=parser)
    found = [step.u for step in steps.feed(parser.feed(b"\n" + text.encode()), 0.0)]
    np.testing.assert_array_equal(found, table[: 8 if ">" in form else 9])


@pytest.mark.parametrize(
    "damage",
    [
        "400,1.5,2",
        "400,1.5,2.5,3.5420,1.5,2.5,3.5",
        "400,1..5,2.5,3.5",
        "400,\0\0\0,2.5,3.5",
        "load: 40, len 7",
    ],
)
def test_a_damaged_line_costs_itself_in_a_file_and_from_a_port(tmp_path, damage):
    rows = [f"{20 * k},{k}.5,{k + 1}.5,{k + 2}.25" for k in range(40)]
    text = "\n".join(["millis,u1,u2,u3", *rows[:20], damage, *rows[21:]]) + "\n"
    (tmp_path / "log.txt").write_text(text)
    table, parser = CHIP.readings(tmp_path / "log.txt"), Parser()
    found = Steps(CHIP, source=parser).feed(parser.feed(b"\n" + text.encode()), 0.0)
    assert len(found) == 39
    np.testing.assert_array_equal([step.u for step in found], table)
    assert any("1 of 4" in remark and "left out" in remark for remark in table.remarks)
    assert parser.counters["malformed"] == 1


def test_numbers_without_names_are_readings_in_their_order_in_a_file_and_from_a_port(tmp_path):
    by_name = CHIP.replaced(sensors=[Sensor(1, 0.05, 0.01, axes=3, channels=["Bx", "By", "Bz"])])
    text = "".join(f"{k}.5,{k + 1}.5,{k + 2}.25\n" for k in range(9))
    (tmp_path / "log.txt").write_text(text)
    table, parser = by_name.readings(tmp_path / "log.txt"), Parser()
    steps = Steps(by_name, source=parser)
    found = steps.feed(parser.feed(b"\n" + text.encode()), 0.0)
    np.testing.assert_array_equal([step.u for step in found], table)
    words = "u1, u2, u3 are taken for Bx, By, Bz, in this order."
    assert words in table.remarks
    assert words in steps.remarks
