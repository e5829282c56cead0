"""Exports hold the samples of a recording bit for bit, and replace no file."""

from __future__ import annotations

import json
from contextlib import closing

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader

from repro import ConstantCurvature, InputError, Robot, Sensor
from repro_board.export import export, table_of
from repro_board.record import Writer, read_recording, readings_of
from repro_board.wire import encode

START_S = 1_700_000_000
U = np.random.default_rng(0).normal(size=(40, 3)).astype(np.float32).astype(float)
U[3, 1] = np.nan


@pytest.fixture
def recording(tmp_path):
    return read_recording(
        written(tmp_path / "a.rec", [encode(u, 0, k + 7, 20_000 * k) for k, u in enumerate(U)])
    )


def written(path, parts):
    writer = Writer(path, {"port": "a board"})
    for k, part in enumerate(parts):
        writer.write(START_S * 10**9 + k * 20_000_000, part)
    writer.close()
    return path


def messages(path):
    with path.open("rb") as file:
        reader = make_reader(file)
        found = [(channel.topic, message.log_time, json.loads(message.data), json.loads(schema.data)["properties"])
                 for schema, channel, message in reader.iter_messages()]  # fmt: skip
        return found, next(reader.iter_metadata()).metadata


def test_a_csv_has_every_sample_bit_for_bit(recording, tmp_path):
    assert export(recording.path, tmp_path / "a.csv") == ([], 40)
    table = pd.read_csv(tmp_path / "a.csv")
    assert list(table) == ["time_s", "unix_s", "board_s", "stream", "sequence", "u1", "u2", "u3"]
    np.testing.assert_array_equal(table[["u1", "u2", "u3"]], U)
    np.testing.assert_array_equal(table["sequence"], np.arange(7, 47))
    np.testing.assert_allclose(table["time_s"], 0.02 * np.arange(40), atol=1e-9)
    np.testing.assert_allclose(table["unix_s"], START_S + 0.02 * np.arange(40), atol=1e-6)
    np.testing.assert_allclose(table["board_s"], 0.02 * np.arange(40), rtol=1e-15)


def test_parquet_has_the_same_table(recording, tmp_path):
    pytest.importorskip("pyarrow")
    export(recording.path, tmp_path / "a.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "a.parquet"), table_of(recording)[0])


def test_without_pyarrow_parquet_is_refused_in_words(recording, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(InputError, match="to of the export must be csv or mcap, unless pyarrow is installed"):
        export(recording.path, tmp_path / "a.parquet")
    assert list(tmp_path.iterdir()) == [recording.path]


def test_names_and_units_are_those_of_the_board(tmp_path):
    line = b"x: 1.25 uT, y: -2.5 uT\r\n"
    table, _ = table_of(read_recording(written(tmp_path / "a.rec", [b"\r\n", *[line] * 5])))
    assert list(table) == ["time_s", "unix_s", "stream", "x_uT", "y_uT"]
    assert table[["x_uT", "y_uT"]].drop_duplicates().to_numpy().tolist() == [[1.25, -2.5]]
    for line in (b"stream: 1.5, y: 2.5\r\n", b"y: 1.5, y: 2.5\r\n"):  # names that would hide a column
        path = written(tmp_path / f"{line[0]}.rec", [b"\r\n", *[line] * 5])
        assert list(table_of(read_recording(path))[0]) == ["time_s", "unix_s", "stream", "u1", "u2"]


def test_readings_of_a_robot_have_its_names_in_mt(recording, tmp_path):
    sensors = [
        Sensor(1, 0.05, 0.01, channels=["u3"], per_mt=2.0, unit="raw"),
        Sensor(1, 0.05, 0.01, channels=["u1"]),
    ]
    robot = Robot([ConstantCurvature(0.1, 0.02)], sensors=sensors)
    export(recording.path, tmp_path / "a.csv", robot=robot)
    table = pd.read_csv(tmp_path / "a.csv")
    assert list(table) == ["time_s", "unix_s", "board_s", *(f"{name}_mT" for name in robot.names)]
    np.testing.assert_allclose(table.iloc[:, 3:], np.column_stack([U[:, 2] / 2, U[:, 0]]), rtol=1e-15)


def test_streams_of_other_widths_are_said(tmp_path):
    parts = [
        encode([1.0] * (1 + k % 2), stream=k % 2, sequence=k // 2, time_us=20_000 * k) for k in range(10)
    ]
    recording = read_recording(written(tmp_path / "a.rec", parts))
    table, remarks = table_of(recording)
    assert remarks == ["samples have 1 to 2 values; missing ones are empty"]
    assert table["u2"].isna().tolist() == [True, False] * 5
    export(recording.path, tmp_path / "a.mcap")
    found, _ = messages(tmp_path / "a.mcap")
    assert [topic for topic, *_ in found] == ["/readings/0", "/readings/1"] * 5
    assert ["u2" in content for _, _, content, _ in found] == [False, True] * 5


def test_mcap_has_readings_and_estimates_in_the_order_of_time(recording, tmp_path):
    estimates = pd.DataFrame(
        {"time_s": 0.02 * np.arange(40) + 0.001, "tip_x_mm": np.arange(40.0), "status": "good"}
    )
    estimates.loc[5, "tip_x_mm"] = np.nan
    estimates.to_csv(tmp_path / "shape.csv", index=False)
    export(recording.path, tmp_path / "a.mcap", estimates=tmp_path / "shape.csv")
    found, about = messages(tmp_path / "a.mcap")
    assert [topic for topic, *_ in found] == ["/readings", "/estimate"] * 40
    times = [time_ns for _, time_ns, *_ in found]
    assert times == sorted(times)
    assert abs(times[2] - (START_S * 10**9 + 20_000_000)) < 1000
    read = [
        [content.get(f"u{k}", np.nan) for k in (1, 2, 3)]
        for topic, _, content, _ in found
        if topic == "/readings"
    ]
    np.testing.assert_array_equal(read, U)
    assert "u2" not in found[6][2]
    assert found[1][2] == {"time_s": 0.001, "tip_x_mm": 0.0, "status": "good"}
    assert "tip_x_mm" not in found[11][2]
    assert found[1][3] == {
        name: {"type": kind}
        for name, kind in (("time_s", "number"), ("tip_x_mm", "number"), ("status", "string"))
    }
    assert about == {"port": '"a board"'}


def test_notes_are_in_the_row_nearest_in_time_and_messages_of_their_own(tmp_path):
    robot, path = Robot([ConstantCurvature(0.1, 0.02)], sensors=[Sensor(1, 0.05, axes=3)]), tmp_path / "a.rec"
    with closing(Writer(path, {"port": "a board"})) as writer:
        for k, u in enumerate(U):
            writer.write(START_S * 10**9 + k * 20_000_000, encode(u, 0, k, 20_000 * k))
        for time_ms, text in ((-500, "early"), (108, "load on"), (92, 'a "quoted", word'), (9000, "late")):
            writer.note(START_S * 10**9 + time_ms * 1_000_000, text)
    expected = {0: "early", 5: 'a "quoted", word; load on', 39: "late"}
    for name, options in (("a.csv", {}), ("b.csv", {"robot": robot})):
        export(path, tmp_path / name, **options)
        table = pd.read_csv(tmp_path / name)
        assert table["note"].dropna().to_dict() == expected
        np.testing.assert_array_equal(readings_of(robot, tmp_path / name), U)
    export(path, tmp_path / "a.mcap")
    found, _ = messages(tmp_path / "a.mcap")
    notes = [(time_ns, content) for topic, time_ns, content, _ in found if topic == "/notes"]
    assert [content["text"] for _, content in notes] == ["early", 'a "quoted", word', "load on", "late"]
    assert abs(notes[2][0] - (START_S * 10**9 + 108_000_000)) < 1000
    assert len(found) == 40 + 4
    assert not any("note" in content for topic, _, content, _ in found if topic != "/notes")


def test_what_cannot_be_exported_is_refused_and_leaves_nothing(recording, tmp_path):
    (tmp_path / "there.csv").write_text("mine")
    (tmp_path / "late.csv").write_text("time_s,status\n0,good\n99,good\n")
    (tmp_path / "other.csv").write_text("time_s,u1\n0,1\n")
    empty = read_recording(written(tmp_path / "b.rec", [b"no sample"]))
    before = sorted(tmp_path.iterdir())
    for source, output, options, message in [
        (recording, "there.csv", {}, r"output of the export must be a new file"),
        (recording, "a.csv", {"to": "xlsx"}, r"to of the export must be one of csv, parquet, mcap"),
        (recording, "none/a.csv", {}, r"output of the export must be a file that can be made"),
        (recording, "a.csv", {"estimates": tmp_path / "late.csv"}, "estimates of the export must be left out"),
        (recording, "a.mcap", {"estimates": tmp_path / "none.csv"}, r"estimates of none\.csv must be a table of"),
        (recording, "a.mcap", {"estimates": tmp_path / "other.csv"}, r"estimates of other\.csv must be a table of"),
        (recording, "a.mcap", {"estimates": tmp_path / "late.csv"}, r"time_s of late\.csv must be within"),
        (empty, "a.csv", {}, r"recording of b\.rec must be one with samples"),
    ]:  # fmt: skip
        with pytest.raises(InputError, match=message):
            export(source.path, tmp_path / output, **options)
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "there.csv").read_text() == "mine"
