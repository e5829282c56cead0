"""Readings of others: what a file says comes out of the recording bit for bit; what is not clear is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_export import numbered, recording

from edition1.errors import InputError
from edition1_live.record.export import export
from edition1_live.record.import_text import import_text
from edition1_live.record.recording import Recording, read_recording
from edition1_live.wire.frame import Frame


def imported(folder: Path, text: str, **options) -> Recording:
    """Import a text and read the recording."""
    (folder / "a.txt").write_text(text, newline="")
    import_text(folder / "a.txt", folder / "b.rec", **options)
    return read_recording(folder / "b.rec")


def read_csv(path: Path) -> pd.DataFrame:
    """Read a table without rounding."""
    return pd.read_csv(path)


@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 10**7), *[st.floats(allow_nan=False, allow_infinity=False)] * 2), min_size=1
    )
)
def test_a_table_comes_out_as_it_was(tmp_path_factory, rows):
    """Also its times: their decimals are nanoseconds at the finest."""
    folder = tmp_path_factory.mktemp("law")
    rows = sorted((t / 1e4, *values) for t, *values in rows)
    table = pd.DataFrame(rows, columns=["time_s", "Bx_uT", "temperature"])
    export(imported(folder, table.to_csv(index=False)), folder / "c.csv")
    pd.testing.assert_frame_equal(read_csv(folder / "c.csv"), table, check_exact=True)


@pytest.mark.parametrize("several", [False, True])
def test_an_export_comes_back(tmp_path, several):
    frames = [Frame(k % 2, *frame[1:]) if several else frame for k, frame in enumerate(numbered(3))]
    export(recording(tmp_path / "a.rec", frames), tmp_path / "a.csv")
    import_text(tmp_path / "a.csv", tmp_path / "b.rec", format="frames")
    export(read_recording(tmp_path / "b.rec"), tmp_path / "b.csv")
    once, twice = read_csv(tmp_path / "a.csv"), read_csv(tmp_path / "b.csv")
    np.testing.assert_allclose(once.pop("unix_s"), twice.pop("unix_s"), rtol=0, atol=5e-7)
    pd.testing.assert_frame_equal(once, twice, check_exact=True)


@pytest.mark.parametrize(
    ("text", "names", "values"),
    [
        ("x: 12 y: 3\nx: -1 y: .5\nx: 2 y: 4\n", ["x", "y"], [[12, 3], [-1, 0.5], [2, 4]]),
        ("1\t2\n3\t4\n5\t6", ["u1", "u2"], [[1, 2], [3, 4], [5, 6]]),
        ("1,2\r\n3,4\r\n5,6\r\n", ["u1", "u2"], [[1, 2], [3, 4], [5, 6]]),
        ("X: 1 uT, Y: 2 uT\n" * 3, ["X_uT", "Y_uT"], [[1, 2]] * 3),
        ("a b\n1 2\n3 4\n5 6\n", ["a", "b"], [[1, 2], [3, 4], [5, 6]]),
        ("a\tb (mV)\n1\t\n3\t4\n", ["a", "b_mV"], [[1, np.nan], [3, 4]]),
        ("a;b\n1;2\n", ["a", "b"], [[1, 2]]),
    ],
)
def test_lines_of_sketches(tmp_path, text, names, values):
    read = imported(tmp_path, text, rate_hz=40.0)
    assert read.channels == names
    np.testing.assert_array_equal(read.frames[names], values)
    np.testing.assert_array_equal(read.frames["time_s"], np.arange(len(values)) / 40)


@pytest.mark.parametrize("text", ["millis\tx\n{}\t1\n{}\t2\n{}\t3\n", "millis: {} x: 1\n" * 3])
def test_times_of_the_board_are_those_of_the_recording(tmp_path, text):
    read = imported(tmp_path, text.format(1500, 1510, 4_294_968))  # beyond the 32 bits of µs
    np.testing.assert_array_equal(read.frames["time_s"], [1.5, 1.51, 4294.968])


def test_a_unit_goes_to_the_values_that_have_none(tmp_path):
    read = imported(tmp_path, "t_ms,a_uT,b\n0,1,2\n", unit="mT")
    assert read.channels == ["a_uT", "b_mT"]
    assert read.metadata["units"] == ["uT", "mT"]


def test_times_since_1970_count_from_the_first(tmp_path):
    read = imported(tmp_path, "timestamp_s,x\n1700000000.25,1\n1700000000.75,2\n")
    assert read.frames["time_s"].tolist() == [0.0, 0.5]


def test_what_is_left_out_is_counted_and_the_rest_is_kept(tmp_path):
    lines = "x: 1\nbroken!\nx: 2\nx: 3\n"
    (tmp_path / "a.txt").write_text(lines)
    summary, _ = import_text(tmp_path / "a.txt", tmp_path / "b.rec", rate_hz=1.0)
    assert summary.losses() == (
        "1 of 4 lines or frames were dropped (1 malformed); the first: 'broken!': 'broken!' is no number with a "
        "decimal point."
    )
    assert read_recording(tmp_path / "b.rec").frames["x"].tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        ("a,b\n1,2\n", {}, "rate of repro import must be given: the file has no column of times; instead"),
        ("t_s,b\n1,2\n", {"rate_hz": 2.0}, "rate of repro import must be left out: the file has times"),
        ("t_s,b\n1,2\n0,2\n", {}, "t_s in line 3 of a.txt must be not before the time before, 1 s"),
        ("t_s,b\n1,2\n2,x\n", {}, "b in line 3 of a.txt must be a number .* instead received 'x'"),
        ("t_s,b\n1,2\n2\n", {}, "line 3 of a.txt must be of 2 cells, as the header; instead received 1"),
        ("t_s;b\n1,5;2,5\n", {}, "t_s in line 2 of a.txt must be a number .*semicolons.* '1,5'"),
        ("t,b\n1,2\n", {}, "times of a.txt must be named with their unit, such as t_s or t_ms; instead"),
        ("t_s,t_ms,b\n1,1,2\n", {}, "times of a.txt must be one column, such as time_s; instead received 2"),
        ("t_s,a,a\n1,1,2\n", {}, "columns of a.txt must be of different names; instead received a twice"),
        ("t_s,stream,x\n1,-1,2\n", {}, "stream of a.txt must be whole numbers from 0 to 65535; instead"),
        (
            "t_ms: 2 x: 1\nt_ms: 1 x: 1\nt_ms: 3 x: 1\n",
            {},
            "the line of numbers 2 of a.txt .* one 0.001 s before",
        ),
        ("a,b\n1,2\n", {"rate_hz": 0.0}, "rate of repro import must be above zero"),
        ("a,b\n1,2\n", {"rate_hz": 1.0, "format": "hall"}, "channels of hall must be 3"),
        ("nothing\nat all\n", {"rate_hz": 1.0}, "file of a.txt must be a table of numbers with a header, or"),
        ("", {}, "file of a.txt must be a table of numbers with a header, or lines"),
    ],
)
def test_what_is_not_clear_is_refused_and_nothing_is_written(tmp_path, text, options, said):
    with pytest.raises(InputError, match=said):
        imported(tmp_path, text, **options)
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_bytes_and_recordings_that_are_there_are_refused(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"t_s,x\n\xff\xfe")
    with pytest.raises(InputError, match=r"file of a.txt must be text in UTF-8"):
        import_text(tmp_path / "a.txt", tmp_path / "b.rec")
    (tmp_path / "b.rec").write_text("mine")
    with pytest.raises(InputError, match="must be a new file"):
        import_text(tmp_path / "a.txt", tmp_path / "b.rec")
    assert (tmp_path / "b.rec").read_text() == "mine"
