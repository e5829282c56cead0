"""Tables of readings and poses: one content in many spellings, and what is refused with its line."""

from __future__ import annotations

import bz2
import gzip
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import repro
from repro import ConstantCurvature, InputError, Robot, Sensor
from repro.common import bad_input
from repro.lines import MARK, fields, labelled
from repro.tables import read_table, text_of

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
    "an index of R": "\n".join(f'"{k or ""}",{line}' for k, line in enumerate(lines().splitlines())) + "\n",
    "text above the names": "Logger v1.2\nSerial No: 4711\nStart: 2024-05-03 14:02\n\n" + lines(),
    "a header of LabVIEW": "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n\t\t\t\n"
    + lines("\t"),
    "units below the names": lines(header=["time", "u1", "u2", "u3"]).replace("u3\n", "u3\ns,mT,mT,mT\n"),
    "names of a message": lines(header=["__time", "/board/u1_mT", "/board/u2_mT", "/board/u3_mT"]).replace(
        "__time", "__time_s"
    ),
    "numbers as names": lines(header=["time_s", "1", "2", "3"]),
    "a separator at the end of the names": lines().replace("mT\n", "mT,\n"),
    "a separator at the end of the numbers": lines().replace("0\n", "0,\n"),
    "empty columns": lines().replace("\n", ",,,\n"),
    "blanks": lines("  "),
    "lines that end with CR": lines().replace("\n", "\r"),
    "labels": "".join(f"t_s: {t} u1: {a:g} mT, u2={b} mT u3:{c}mT\n" for t, a, b, c in ROWS),
    "labels and one unit at the end": "".join(
        f"t: {t}, u1: {1e3 * a}, u2: {1e3 * b}, u3: {1e3 * c} uT\n" for t, a, b, c in ROWS
    ),
    "labels and a unit of each": "".join(
        f"t: {t} s u1: {1e3 * a} uT u2: {b} mT u3: {10 * c} G\n" for t, a, b, c in ROWS
    ),
    "JSON": "".join(f'{{"t_s": {t}, "u1": {a}, "u2": {b}, "u3": {c}}}\n' for t, a, b, c in ROWS),
    "one number a line": "".join(
        f"{t:.5f},{x},,\n{t + 0.001:.5f},,{y},\n{t + 0.002:.5f},,,{z}\n"
        for t, x, y, z in ROWS - [0.002, 0, 0, 0]
    ).join([",".join(HEADER) + "\n", ""]),
    "counters": lines(header=["millis", *HEADER[1:]], rows=ROWS * [1e3, 1, 1, 1]),
    "two times, one without a unit": lines(
        header=["time", "seconds_elapsed", *HEADER[1:]],
        rows=np.column_stack([1.7e18 + 1e9 * ROWS[:, 0], ROWS]),
    ),
    "a line that started before the log": "125,3.5,0.25\n" + lines(),
    "a stream": lines(header=[*HEADER, "stream"], rows=np.column_stack([ROWS, [0, 0, 0]])),
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


def test_the_index_of_a_data_frame_is_the_time_if_it_can_be():
    """Moments, fractions, or what is called so; whole numbers without a name number the rows."""
    frame, s = pd.DataFrame(ROWS[:, 1:], columns=HEADER[1:]), ROWS[:, 0]
    moments = pd.Timestamp("1970-01-02") + pd.to_timedelta(s, "s")
    clocks = {"time_ms": (50 * np.arange(3), 0.0), None: (s, 0.0), "when": (pd.to_timedelta(s, "s"), 0.0)}
    for name, (index, first) in (clocks | {"utc": (moments.tz_localize("UTC"), 86400.0)}).items():
        readings = robot().readings(frame.set_index(pd.Index(index, name=name)))
        np.testing.assert_allclose(readings.times - first, s, atol=1e-9)
        assert readings.remarks == ()
    assert robot().readings(frame[::-1]).times is None
    unused = robot().readings(frame.set_index(pd.Index(s, name="place")))
    assert (unused.times, unused.remarks) == (None, ("The index of the table is left out.",))
    both = robot().readings(frame.assign(time_s=s).set_index(moments))
    assert (both.times.tolist(), both.remarks) == (s.tolist(), unused.remarks)
    bare = pd.DataFrame(ROWS[:, 1:], index=moments)  # without names it is no table, but numbers
    fit = repro.LevenbergMarquardt(lambda q: q * np.ones(3), [-9.0], [9.0], noise=1.0)
    with pytest.raises(InputError, match="times, rate_hz of track must be given"):
        repro.track(fit, bare)


CLOCKS = {
    "a clock": ("time,u1,u2,u3\n", "14:02:11.{:03.0f},{},{},{}\n", 50531.0),
    "the old Arduino IDE": ("", "14:02:11.{:03.0f} -> {},{},{}\n", 50531.0),
    "the old Arduino IDE with labels": ("", "14:02:11.{:03.0f} -> u1: {} u2: {} u3: {}\n", 50531.0),
    "the new Arduino IDE": ("", "14:02:11.{:03.0f},{},{},{}\n", 50531.0),
    "ISO": ("timestamp,u1,u2,u3\n", "1970-01-03T14:02:11.{:03.0f},{},{},{}\n", 223331.0),
    "a date and a time": ("Date,Time,u1,u2,u3\n", "1970-01-03,14:02:11.{:03.0f},{},{},{}\n", 223331.0),
    "a counter that wraps": ("micros,u1,u2,u3\n", "{:.0f},{},{},{}\n", 4294.947296),
}


@pytest.mark.parametrize(("header", "line", "first"), CLOCKS.values(), ids=CLOCKS)
def test_times_of_clocks(tmp_path, header, line, first):
    ms = ROWS[:, 0] * 1e3
    ms = (4294947296 + 1e3 * ms) % 2**32 if "micros" in header else ms
    text = header + "".join(line.format(t, *row) for t, row in zip(ms, ROWS[:, 1:], strict=True))
    readings = robot().readings(written(tmp_path, text))
    np.testing.assert_allclose(readings.times, first + ROWS[:, 0], atol=1e-6)
    np.testing.assert_allclose(readings, ROWS[:, 1:])
    again = "Times of mine.csv start again from 0 in line 3: they are put on."
    assert (again in readings.remarks) == ("micros" in header)


def test_midnight(tmp_path):
    text = "time,u1_mT\n23:59:59.900,1\n00:00:00.000,2\n"
    np.testing.assert_allclose(read_table(written(tmp_path, text)).times, [86399.9, 86400.0])


MISSING = [
    "",
    "nan",
    "NaN",
    "NA",
    "N/A",
    "#N/A",
    "null",
    "NULL",
    "-",
    " ",
    "ovf",
    "1.#QNAN",
    "inf",
    "-inf",
    "1e400",
]


@pytest.mark.parametrize("empty", MISSING)
def test_cells_without_a_number_are_missing(tmp_path, empty):
    readings = robot().readings(written(tmp_path, lines().replace("3.37500", empty)))
    assert np.argwhere(np.isnan(readings)).tolist() == [[1, 1]]
    assert "1 of 3 readings of sensor 2 is missing." in readings.remarks
    infinite = [remark for remark in readings.remarks if "infinite" in remark]
    assert len(infinite) == ("inf" in empty.lower() or "e400" in empty)


ROW = "-2.0,3.5,0.25"
CELLS = {ROW: 0, "#NV,3.5,0.25": 1, "####,#DIV/0!,0.25": 2, "#N/A,#n/a,#REF!": 3}
"""Rows, and how many of their cells have no number."""
OTHERS = ["# a pause, 3 minutes", "% 1,2,3", "ets Jul 29 2019", "#,,"]


@given(st.lists(st.sampled_from([*CELLS, *OTHERS])), st.booleans())
def test_no_line_below_the_names_vanishes_without_a_count(tmp_path_factory, below, named):
    """Cells that a spreadsheet could not compute are missing; there are no comments, but text, which is counted."""
    path = tmp_path_factory.getbasetemp() / "mine.csv"
    below = [ROW] * (len(below) + 1) + below
    path.write_text("\n".join(["# logged by somebody", *["u1_mT,u2_mT,u3_mT"] * named, *below]) + "\n")
    readings = robot().readings(path)
    expected = [CELLS[line] for line in below if line in CELLS]
    assert np.isnan(readings).sum(axis=1).tolist() == expected
    text = [x for x in readings.remarks if x.endswith("text and left out.")]
    assert sum(int(x.split()[0]) for x in text) == len(below) - len(expected)


@pytest.mark.parametrize("cell", ["-2_113.4", "-２.１１", "−2.11340", "0x7f", "1.2.3", "high", "12:00:00"])
def test_cells_that_are_no_numbers_are_refused(tmp_path, cell):
    with pytest.raises(InputError, match="cell of mine.csv, line 3, column u2_mT, must be a number; instead"):
        robot().readings(written(tmp_path, lines().replace("3.37500", cell)))


def test_a_last_line_that_may_be_cut_is_left_out(tmp_path):
    """Without a newline, and with fewer digits than the lines before; the same number of digits is whole."""
    table = read_table(written(tmp_path, lines()[:-3]))
    assert len(table.values) == 2
    assert table.remarks == (
        "Line 4 of mine.csv does not end, and its last cell may be cut: it is left out.",
    )
    assert len(read_table(written(tmp_path, lines()[:-1])).values) == 3
    assert len(read_table(written(tmp_path, lines()[:-10])).values) == 2


def test_text_of_the_board_between_numbers_is_left_out(tmp_path):
    boot = "ets Jul 29 2019 12:21:46\nrst:0x1 (POWERON_RESET),boot:0x13\nconfigsip: 0, SPIWP:0xee\n"
    row = "0.20000,-2.50000,3.25000,0.75000\n"
    table = read_table(written(tmp_path, lines() + boot + ",".join(HEADER) + "\n" + row))
    assert table.times.tolist() == [0.0, 0.05, 0.1, 0.2]
    assert table.remarks == ("4 of 9 lines of mine.csv are text and left out.",)


def test_other_encodings(tmp_path):
    path = written(tmp_path, lines(header=["time_s", "u1 [µT]", "u2 [µT]", "u3 [µT]"]), "cp1252")
    readings = robot().readings(path)
    np.testing.assert_allclose(readings, 1e-3 * ROWS[:, 1:])
    assert readings.remarks == ("mine.csv is not in UTF-8 (line 1): it is read as Windows-1252.",)
    for other in ("utf-16-le", "utf-32"):
        with pytest.raises(
            InputError, match="must be text in UTF-8, or in UTF-16 with a byte order mark; instead"
        ):
            read_table(written(tmp_path, lines(), other))


def test_equal_times(tmp_path):
    """Rows that arrived together, or whose times were rounded, are spread; time never goes back."""
    text = "time_s,u1_mT\n0.00,1\n0.00,2\n0.01,3\n0.01,4\n0.02,5\n0.02,6\n"
    for zero in ("0.00", "0.00000"):
        table = read_table(written(tmp_path, text.replace("0.00", zero)))
        np.testing.assert_allclose(table.times, np.arange(6) * 0.005)
        assert table.remarks == ("3 of 6 times of mine.csv are equal to the one before: spread evenly.",)
    with pytest.raises(InputError, match=r"time in line 4 .* received 0\.01 s after 0\.05 s"):
        read_table(written(tmp_path, text.replace("0.00,2", "0.05,2")))
    with pytest.raises(
        InputError, match="column time of mine.csv must be named with its unit, such as time_ms"
    ):
        read_table(written(tmp_path, "time,u1_mT\n0,1\n50,2\n100,3\n"))


def test_a_log_with_another_number_of_columns_is_refused(tmp_path):
    """The first column may be a time: it must not become the reading of a sensor."""
    with pytest.raises(InputError, match="table of mine.csv must be 3 columns, one for every reading"):
        robot().readings(written(tmp_path, "".join(lines().splitlines(keepends=True)[1:])))
    with pytest.raises(InputError, match="must be 3 columns, one for every reading .* received 4"):
        robot().readings(written(tmp_path, "14:02:11.5,1,2,3,4\n14:02:11.6,1.5,2,3,4\n"))


def test_words_of_a_file_do_not_reach_the_terminal(tmp_path):
    with pytest.raises(InputError) as refused:
        robot().readings(written(tmp_path, lines(header=["time_s", "\x1b]0;owned\x07", "u2_mT", "u3_mT"])))
    assert str(refused.value).isprintable()
    assert str(bad_input("a\x1b[2J", "b", "c\nd", "Höhe")) == (
        "Input a\\x1b[2J of b must be c d; instead received Höhe."
    )


def test_a_comma_among_points_is_no_number(tmp_path):
    """Thousands, or a slip: either way not what the rest of the table means by a comma."""
    with pytest.raises(InputError, match="line 3, column u2_mT, must be a number; instead received '3,375'"):
        robot().readings(written(tmp_path, lines(";").replace("3.37500", "3,375")))


def damaged_log(*damage: str, names: bool = True) -> str:
    """A log of 40 lines, the last of which are damaged."""
    rows = [f"{20 * k},{k + 1}.5,{k + 2}.25" for k in range(40 - len(damage))]
    rows = rows if names else [row.partition(",")[2] for row in rows]
    return "\n".join([*["millis,u1,u2"] * names, *rows[:20], *damage, *rows[20:]]) + "\n"


@pytest.mark.parametrize(
    "line",
    [
        "400,1.5",
        "400,1.5,2.2420,2.5,3.5",
        "400,1..5,2.25",
        "400,1.5,\0\0\0",
        "Note: touched the table,,",
        "400,-2_113.4,2.25",
        f"400,{'x' * 200_000},2.25",
    ],
)
def test_a_damaged_line_of_many_is_left_out_and_counted_and_of_few_refused(tmp_path, line):
    """As a port does."""
    table = read_table(written(tmp_path, damaged_log(line)))
    assert len(table.values) == 39
    assert np.isfinite(table.values).all()
    assert table.remarks == ("1 of 40 lines of mine.csv is damaged and left out (the first: line 22).",)
    pair = Robot([ConstantCurvature(0.1, 0.02)], sensors=[Sensor(1, 0.1)] * 2)
    with pytest.raises(InputError, match="of mine.csv"):
        pair.readings(written(tmp_path, damaged_log(line, line, line)))


def test_a_merged_line_without_names_is_damaged_not_the_others(tmp_path):
    table = read_table(written(tmp_path, damaged_log("1.5,2.2520,3.5,4.25", names=False)))
    assert (len(table.values), len(table.names)) == (39, 2)
    assert table.remarks[-1] == "1 of 40 lines of mine.csv is damaged and left out (the first: line 21)."


@given(st.lists(st.sampled_from(["", "load on", "5", "tip; bent"]), min_size=40, max_size=60))
def test_a_column_of_notes_costs_no_row(tmp_path_factory, notes):
    """Wherever they stand, and if some of them are numbers, as long as others are not."""
    texts = sum(note not in ("", "5") for note in notes)
    notes = [note if note != "5" or notes[:k].count("5") < texts else "" for k, note in enumerate(notes)]
    rows = [f"{k / 10},{k}.5,{note}" for k, note in enumerate(notes)]
    table = read_table(written(tmp_path_factory.mktemp("n"), "\n".join(["time_s,u1_mT,note", *rows]) + "\n"))
    np.testing.assert_array_equal(table.values[:, 0], np.arange(len(notes)) + 0.5)
    assert table.remarks == ()


@pytest.mark.parametrize("cells", [["OK", "OVR", "low"], ["True", "False", "True"], ["0x00", "0x1f", "0xab"]])
def test_a_column_without_numbers_is_refused_when_it_is_used(tmp_path, cells):
    """Above the names there is text, too."""
    rows = [f"{x},{y}" for x, y in zip(lines().splitlines(), ["status", *cells], strict=True)]
    text = "\n".join(["Logger v1.2", "Serial No: 4711", *rows]) + "\n"
    np.testing.assert_allclose(robot().readings(written(tmp_path, text)), ROWS[:, 1:])
    frame = pd.DataFrame(ROWS, columns=HEADER).assign(status=cells)
    np.testing.assert_allclose(robot().readings(frame), ROWS[:, 1:])
    by_name = robot().replaced(sensors=[Sensor(1, 0.1, channels=[c]) for c in (1, 2, "status")])
    message = rf"cell of mine.csv, line 4, column status, must be a number; instead received '{cells[0]}'"
    with pytest.raises(InputError, match=message):
        by_name.readings(tmp_path / "mine.csv")
    with pytest.raises(InputError, match="column status of the table must be of numbers; instead"):
        by_name.readings(frame)


BELOW = {
    "brackets": ("time,u1,u2,u3\n[s],[mT],[mT],[mT]\n", 1.0, ()),
    "round brackets": ("time,u1,u2,u3\n(s),(mT),(mT),(mT)\n", 1.0, ()),
    "Greek": ("time,u1,u2,u3\n[s],[µT],[μT],µT\n", 1e-3, ()),
    "in the cells of the names": ('time_s,"u1\n(mT)","u2\n(mT)","u3\n(mT)"\n', 1.0, ()),
    "types": (
        "time_s,u1_mT,u2_mT,u3_mT\ndouble,float,float,float\n",
        1.0,
        ("1 of 5 lines of mine.csv is above the table and left out.",),
    ),
}


@pytest.mark.parametrize(("head", "factor", "remarks"), BELOW.values(), ids=BELOW)
def test_what_stands_below_the_names(tmp_path, head, factor, remarks):
    text = head + "".join(lines().splitlines(keepends=True)[1:])
    readings = robot().readings(written(tmp_path, text))
    np.testing.assert_allclose(readings, factor * ROWS[:, 1:])
    np.testing.assert_allclose(readings.times, ROWS[:, 0])
    assert readings.remarks == remarks


def test_a_board_that_begins_again_in_the_middle_of_a_log(tmp_path):
    """It prints its names again. Times that go back without them are refused."""
    rows = [f"{50 * k},1.5,2.5,{k}" for k in range(40)]
    boot = ["ets Jul 29 2019 12:21:46", "Temp: 23.5, Hum: 41", "3,2,1"]
    text = "\n".join(["millis,u1,u2,u3", *rows[:30], *boot, "millis,u1,u2,u3", *rows[:10]]) + "\n"
    readings = robot().readings(written(tmp_path, text))
    np.testing.assert_allclose(readings.times, 0.05 * np.arange(40))
    assert readings[:, 2].tolist() == [*range(30), *range(10)]
    again = "The board began again in line 35 of mine.csv: times go on from those before."
    assert readings.remarks[:3] == (
        "3 of 45 lines of mine.csv are text and left out.",
        "1 of 41 lines of mine.csv is damaged and left out (the first: line 34).",
        again,
    )
    with pytest.raises(InputError, match="did the board start again"):
        read_table(written(tmp_path, text.replace("3,2,1\nmillis,u1,u2,u3\n", "")))


def test_empty_rows_at_the_end_are_left_out_and_counted(tmp_path):
    readings = robot().readings(written(tmp_path, lines() + ",,,\n" * 3))
    assert len(readings) == 3
    assert readings.remarks == ("3 of 7 lines of mine.csv are empty, at the end, and left out.",)


def test_a_counter_of_16_bits_goes_on_and_a_board_that_begins_anew_does_not(tmp_path):
    def text(ms) -> str:
        return "time_ms,u1_mT\n" + "".join(f"{t},1.5\n" for t in ms)

    counts = 65_400 + 20 * np.arange(20)
    table = read_table(written(tmp_path, text(counts % 2**16)))
    np.testing.assert_allclose(table.times, counts / 1e3)
    assert table.remarks == ("Times of mine.csv start again from 0 in line 9: they are put on.",)
    for again in (0, 700):
        with pytest.raises(InputError, match="did the board start again"):
            read_table(written(tmp_path, text([60_000, 60_020, 60_040, again, again + 20])))


@pytest.mark.parametrize(
    "cell", ["6:19:10.5 AM", "29.11.2026 06:19:10.5", "11/29/2026 06:19:10.5", "00:50.0"]
)
def test_a_form_of_time_that_is_not_read_says_which_are(tmp_path, cell):
    must = r"column time, must be a time such as 14:02:11\.5 or 2024-05-03 14:02:11\.5; instead received "
    with pytest.raises(InputError, match=must):
        read_table(written(tmp_path, "time,u1_mT\n" + f"{cell},1.5\n" * 3))
    text = "time,u1_mT\n6:19:10.5,1.5\n6:19:11,1.5\n2024-05-03 6:19:12,1.5\n"
    np.testing.assert_allclose(read_table(written(tmp_path, text)).times[:2], [22750.5, 22751.0])


REFUSED = {
    "no file": (None, "table of read_table must be a file that exists; instead received"),
    "a word": (
        lines().replace("3.37500", "high"),
        "cell, line 3, column u2_mT, must be a number; instead received 'high'.",
    ),
    "commas in commas": (
        lines(comma=True),
        "line 2 must be of 4 cells, as the line of names; decimal commas need another separator, such",
    ),
    "a short line": (
        lines().replace(",0.50000", ""),
        "line 3 must be of 4 cells, as the line of names; instead received 3.",
    ),
    "names alone": ("time_s,u1_mT\n", "file must be a line of names and lines of numbers"),
    "nothing": ("\n\n", "file must be a table; instead received nothing."),
    "comments and the beginning of a line": (
        "# a, bc\n# d, ef\n1,2",
        "file must be a table; instead received nothing.",
    ),
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
    "two times": (
        lines(header=["time_s", "t_ms", "u2_mT", "u3_mT"]),
        "column t_ms must be the only one of times",
    ),
    "a time of another name": (
        lines(header=["time_of_day", *HEADER[1:]], rows=100 * ROWS),
        "named with its unit",
    ),
    "decimal commas without names": (
        "-2,10978,-2,04614\n-2,12096,-2,10341\n",
        "file must be of numbers with decimal points; decimal commas need another separator, such as ;",
    ),
    "names and numbers in one line": (
        lines(header=["0.05", "-2.1", "high", "3.2"]),
        "cell, line 1, must be a number, or all of them names; instead received 'high'.",
    ),
    "a time that is none": (
        lines().replace("0.05000", ""),
        "column time_s must be a time in every line; instead received none in line 3.",
    ),
}


@pytest.mark.parametrize(("text", "message"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused(tmp_path, text, message):
    path = tmp_path / "mine.csv" if text is None else written(tmp_path, text)
    with pytest.raises(InputError) as refused:
        robot().readings(path)
    assert message in str(refused.value).replace(" of mine.csv", "")


def test_damaged_files_are_refused_in_words(tmp_path):
    """Whatever is cut out, put in or doubled: a table, or an error in one line of printable words."""
    rng, path = np.random.default_rng(0), tmp_path / "mine.csv"
    texts = [
        *SPELLINGS.values(),
        *(header + 5 * line.format(0, 1.5, 2.5, 3.5) for header, line, _ in CLOCKS.values()),
    ]
    bits = [
        b",",
        b";",
        b'"',
        b"\n",
        b"-",
        b"nan",
        b"1e999",
        b"time_s",
        b":",
        b"->",
        b"\0",
        b"\xff",
        b"(",
        b"\x1b[2J",
    ]
    for _ in range(600):
        content = bytearray(texts[rng.integers(len(texts))].encode())
        for at in rng.integers(len(content), size=rng.integers(1, 20)):
            part = bits[rng.integers(len(bits))] if rng.random() < 0.5 else content[at : at + 10]
            content[at : at + rng.integers(3) * rng.integers(10)] = part
        path.write_bytes(content)
        try:
            read_table(path)
        except InputError as error:
            assert str(error).isprintable()  # noqa: PT017


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


def test_a_temperature_is_no_time(tmp_path):
    table = read_table(written(tmp_path, "time_s,u1_mT,T\n0.0,1.5,25.1\n0.1,1.6,25.2\n0.2,1.7,25.0\n"))
    assert table.columns == ("u1_mT", "T")
    assert table.remarks == ()


def test_the_table_says_where_its_cells_stand(tmp_path):
    table = read_table(written(tmp_path, "# one\n" + lines()))
    assert (table.columns, table.units, table.lines) == (tuple(HEADER[1:]), ("mT",) * 3, [3, 4, 5])


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lambda text: bytes(range(32)) * 3 + text])
def test_a_packed_file_is_no_text(tmp_path, pack):
    path = tmp_path / "mine.csv"
    path.write_bytes(pack(lines(rows=np.random.default_rng(0).normal(size=(100, 4))).encode()))
    with pytest.raises(InputError, match="instead received bytes that are no text .packed, or a spreadsheet"):
        read_table(path)


@given(st.text("\0\ufffdu1: .5,-e=;\tT"))
def test_every_mark_in_the_form_of_a_line_is_a_number(text):
    """Also where a damaged byte looks like a mark."""
    form, cells = fields(text)
    assert form.count(MARK) == len(cells)
    assert labelled(text).keys() >= set()


@pytest.mark.parametrize(("byte", "most", "what"), [(0, 100, "zero"), (1, 50, "no text")])
def test_so_many_bytes_of_the_first_thousand_may_be_damaged(tmp_path, byte, most, what):
    path = tmp_path / "mine.csv"
    for n in (most, most + 1):
        path.write_bytes(bytes([byte]) * n + b"1" * (1000 - n) + b"\n" * 9000)
        with pytest.raises(InputError, match=f"bytes that are {what}") if n > most else nullcontext():
            text_of(path, [])


def test_seconds_begin_again_at_midnight_and_others_never(tmp_path):
    for first, then, goes_on in ((86300.0, 20.0, True), (100_000.0, 20_020.0, False)):
        text = "time_s,u1_mT\n" + "".join(f"{t},1.5\n" for t in (first, first + 50, then, then + 50))
        with nullcontext() if goes_on else pytest.raises(InputError, match="did the board start again"):
            table = read_table(written(tmp_path, text))
            np.testing.assert_allclose(np.diff(table.times), [50.0, 70.0, 50.0])


def test_columns_that_take_turns_take_two_at_least():
    for n in (5, 6):
        frame = pd.DataFrame({f"u{k}": np.where(np.arange(n) % 3 == k, 1.5, np.nan) for k in range(3)})
        assert len(read_table(frame).values) == (n if n < 6 else 2)


@pytest.mark.parametrize("share", [1, 3])
def test_a_label_that_one_line_of_fifty_has_is_a_column(tmp_path, share):
    """That of one in fifty or fewer is what a board says now and then."""
    text = [f"u1: {k}.5" + ", u2: 7" * (k % 100 < share) for k in range(100)]
    names = read_table(written(tmp_path, "\n".join(text) + "\n")).names
    assert names == (("u1", "u2") if share > 2 else ("u1",))


def test_a_rate_is_positive_and_never_ignored_in_silence(tmp_path):
    path = written(tmp_path, lines())
    for rate_hz in (0.0, -3.0, np.nan, np.inf):
        with pytest.raises(InputError, match="rate_hz of read_table must be positive and finite"):
            read_table(path, rate_hz)
    table = read_table(path, 40.0)
    np.testing.assert_allclose(table.times, ROWS[:, 0])
    assert table.remarks == ("mine.csv has times: the rate of 40 Hz is not used.",)
    assert read_table(written(tmp_path, "0,0,0\n" * 3), 20.0).times.tolist() == [0.0, 0.05, 0.1]
