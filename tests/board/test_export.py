"""Exports hold the samples of a recording bit for bit, and replace no file."""

from __future__ import annotations

import json
from contextlib import closing, nullcontext

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from repro import (
    BallJoint,
    ConstantCurvature,
    Disc,
    FreeBody,
    InputError,
    LevenbergMarquardt,
    Link,
    Magnet,
    Robot,
    Sensor,
    track,
)
from repro_board.export import POSES, estimates_table, even_places, export, table_of
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


PUBLISHED = {
    "timestamp": {"sec": "integer", "nsec": "integer"},
    "frame_id": "string",
    "poses": [{"position": dict.fromkeys("xyz", "number"), "orientation": dict.fromkeys("xyzw", "number")}],
}
"""All that foxglove/foxglove-sdk requires of a message (schemas/jsonschema/PosesInFrame.json), and its types."""


def types_of(schema):
    """The types that a schema requires, in the form of `PUBLISHED`."""
    if schema["type"] == "array":
        return [types_of(schema["items"])]
    if schema["type"] != "object":
        return schema["type"]
    assert schema["required"] == list(schema["properties"])
    return {name: types_of(part) for name, part in schema["properties"].items()}


@pytest.fixture
def bending(recording, tmp_path):
    """A robot of two segments, estimates of its shape, the poses that were exported, their schema and the remarks."""
    robot = Robot(
        [ConstantCurvature(0.06, 0.015), Link(0.01), ConstantCurvature(0.03, 0.015)],
        [Magnet(Disc(8e-3, 3e-3, 1300.0), 1, 0.03)],
        [Sensor(3, 0.03, 0.01, channels=[f"u{k}"]) for k in (1, 3)],
        lower=np.full(6, -0.01), upper=np.full(6, 0.01), noise=1.0,
    )  # fmt: skip
    shape = track(LevenbergMarquardt(robot), U[:, [0, 2]], times=0.02 * np.arange(40))
    frame = shape.to_frame()
    frame.loc[7, [name for name in frame if name.endswith("_mm")]] = np.nan
    frame.to_csv(tmp_path / "shape.csv", index=False)
    options = {"robot": robot, "estimates": tmp_path / "shape.csv"}
    assert export(recording.path, tmp_path / "a.mcap", **options) == ([], 40)
    with (tmp_path / "a.mcap").open("rb") as file:
        found = [(schema, message.log_time, json.loads(message.data))
                 for schema, _, message in make_reader(file).iter_messages(topics=["/backbone"])]  # fmt: skip
    return robot, frame.dropna(subset=["tip_x_mm"]), found


def test_poses_are_messages_of_the_published_schema(bending):
    jsonschema = pytest.importorskip("jsonschema")
    _, frame, found = bending
    assert len(found) == len(frame) == 39
    schema = json.loads(found[0][0].data)
    assert (found[0][0].name, found[0][0].encoding) == ("foxglove.PosesInFrame", "jsonschema")
    assert types_of(schema) == PUBLISHED
    assert (schema["properties"]["timestamp"]["title"], found[0][2]["frame_id"]) == ("time", "base")
    for (_, time_ns, message), time_s in zip(found, frame["time_s"], strict=True):
        jsonschema.validate(message, schema)
        stamp = message["timestamp"]
        assert stamp["sec"] * 10**9 + stamp["nsec"] == time_ns
        assert abs(time_ns - round(1e9 * (START_S + time_s))) < 1000


def test_poses_are_those_of_the_estimates(bending):
    """At even places of the backbone, from the base to the tip of the table; quaternions of length one, XYZW.

    They have five decimals, so that a position is right to half of 0.01 mm.
    """
    robot, frame, found = bending
    poses = [pose for *_, message in found for pose in message["poses"]]
    p = np.array([[pose["position"][axis] for axis in "xyz"] for pose in poses]).reshape(39, POSES, 3)
    quaternions = np.array([[pose["orientation"][axis] for axis in "xyzw"] for pose in poses])
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, atol=2e-5)
    assert all(np.array_equal(x.round(5), x) for x in (p, quaternions))
    tips = frame[["tip_x_mm", "tip_y_mm", "tip_z_mm"]] / 1e3
    np.testing.assert_allclose(p[:, -1], tips, rtol=0, atol=0.51e-5)
    np.testing.assert_allclose(p[:, 0], 0.0, atol=1e-9)
    q = frame[[f"{name}_mm" for name in robot.coordinates]].to_numpy() / 1e3
    turns = Rotation.from_quat(quaternions).as_matrix().reshape(39, POSES, 3, 3)
    np.testing.assert_allclose(turns[:, -1], robot.tip(q)[:, :3, :3], atol=4e-5)


@pytest.mark.parametrize(
    "segments",
    [
        [ConstantCurvature(0.06, 0.015), Link(0.01), ConstantCurvature(0.03, 0.015)],
        [BallJoint("xy"), Link(0.05), BallJoint("x")],
        [Link(0.02), Link(0.0), ConstantCurvature(0.04, 0.01)],
        [FreeBody()],
    ],
)
def test_places_are_even_and_end_at_the_tip(segments):
    robot = Robot(segments)
    places, lengths = even_places(robot), np.array([segment.length for segment in segments])
    before = np.concatenate([[0.0], lengths.cumsum()])
    along = [before[place.segment - 1] + place.at for place in places]
    np.testing.assert_allclose(along, np.linspace(0, lengths.sum(), POSES), atol=1e-12)
    q = np.full(robot.n_q, 0.003)
    np.testing.assert_allclose(robot.poses(q, places)[-1], robot.tip(q), atol=1e-15)


def test_readings_keep_names_and_units_beside_the_poses(bending, tmp_path):
    found, _ = messages(tmp_path / "a.mcap")
    robot = bending[0]
    topics = [topic for topic, *_ in found]
    assert {name: topics.count(name) for name in topics} == {
        "/estimate": 40,
        "/readings": 40,
        "/backbone": 39,
    }
    properties = next(x for topic, _, _, x in found if topic == "/readings")
    assert [*properties][-2:] == [f"{name}_mT" for name in robot.names]
    times = [time_ns for _, time_ns, *_ in found]
    assert times == sorted(times)


def test_poses_need_the_robot_of_the_estimates(bending, recording, tmp_path):
    robot, estimates = bending[0], tmp_path / "shape.csv"
    remarks, _ = export(recording.path, tmp_path / "b.mcap", estimates=estimates)
    assert remarks == ["No poses of the backbone are written: they need the robot file (--robot)."]
    assert {topic for topic, *_ in messages(tmp_path / "b.mcap")[0]} == {"/estimate", "/readings"}
    first, _, last = robot.segments
    other = Robot([first, Link(0.0101), last], robot.magnets, robot.sensors)
    shorter = Robot([first], robot.magnets, [Sensor(1, 0.06, 0.01, channels=["u1"])])
    pd.read_csv(estimates).drop(columns="delta_y_3_mm").to_csv(tmp_path / "less.csv", index=False)
    pd.read_csv(estimates)[::-1].to_csv(tmp_path / "back.csv", index=False)
    for model, path, words in [
        (other, estimates, r"shape\.csv must be estimates of this robot; instead received tips up to 0\.1"),
        (shorter, estimates, r"must be estimates of this robot; instead received tips up to 4"),
        (robot, tmp_path / "less.csv", r"instead received a table without delta_y_3_mm"),
        (robot, tmp_path / "back.csv", r"time_s of back\.csv must be increasing"),
    ]:  # fmt: skip
        with pytest.raises(InputError, match=words):
            export(recording.path, tmp_path / "c.mcap", robot=model, estimates=path)
        assert not (tmp_path / "c.mcap").exists()


@pytest.mark.parametrize("span_s", [10.0, 10_000.0])
def test_estimates_may_begin_or_end_a_second_and_a_thousandth_beyond_the_recording(tmp_path, span_s):
    spare, path = 1.0 + 1e-3 * span_s, tmp_path / "a.csv"
    for more in (-1e-3, 1e-3):
        for ends in ((-spare - more, span_s), (0.0, span_s + spare + more)):
            pd.DataFrame({"time_s": ends, "status": "consistent"}).to_csv(path, index=False)
            with (
                pytest.raises(InputError, match="time_s of a.csv must be within")
                if more > 0
                else nullcontext()
            ):
                assert len(estimates_table(path, np.array([0.0, span_s]))) == 2


def test_what_cannot_be_exported_is_refused_and_leaves_nothing(recording, tmp_path):
    (tmp_path / "there.csv").write_text("mine")
    (tmp_path / "late.csv").write_text("time_s,status\n0,good\n99,good\n")
    (tmp_path / "other.csv").write_text("time_s,u1\n0,1\n")
    empty = read_recording(written(tmp_path / "b.rec", [b"no sample"]))
    before = sorted(tmp_path.iterdir())
    for source, output, options, message in [
        (recording, "there.csv", {}, r"output of the export must be one that does not exist"),
        (recording, "a.csv", {"to": "xlsx"}, r"to of the export must be one of csv, parquet, mcap"),
        (recording, "none/a.csv", {}, r"output of the export must be in a folder that exists"),
        (recording, "a.csv", {"estimates": tmp_path / "late.csv"}, "estimates of the export must be left out"),
        (recording, "a.mcap", {"estimates": tmp_path / "none.csv"}, r"estimates of none\.csv must be a file that"),
        (recording, "a.mcap", {"estimates": tmp_path / "other.csv"}, r"estimates of other\.csv must be a table of"),
        (recording, "a.mcap", {"estimates": tmp_path / "late.csv"}, r"time_s of late\.csv must be within"),
        (empty, "a.csv", {}, r"recording of b\.rec must be one with samples"),
    ]:  # fmt: skip
        with pytest.raises(InputError, match=message):
            export(source.path, tmp_path / output, **options)
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "there.csv").read_text() == "mine"
