"""Files that other programs open, read back by their own libraries: the same numbers, bit for bit."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader
from test_export import HEAD, numbered, recording

from edition1.errors import InputError
from edition1_live.record.export import export
from edition1_live.wire.frame import Frame

START_NS = round(1e9 * HEAD["start_unix_s"])


def messages(path: Path) -> dict[str, list[tuple[int, dict]]]:
    """Return the time and content of the messages of each topic, whose schemas name all that they hold."""
    found: dict[str, list[tuple[int, dict]]] = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            content = json.loads(message.data)
            properties = json.loads(schema.data)["properties"]
            for name, value in content.items():
                kind = properties[name]["type"]
                types = {"number": (int, float), "string": str, "array": list}
                assert isinstance(value, types[kind]), name
            found.setdefault(channel.topic, []).append((message.log_time, content))
    return found


def bits(x: float) -> bytes:
    """Return the bits of a number, so that 0 and -0 differ."""
    return struct.pack("<d", x)


def test_readings_of_mcap_are_those_recorded(tmp_path):
    frames = [*numbered(5), Frame(0, 50, 1, (-0.0, 5e-324, np.nextafter(1, 2), 1e300, np.nan))]
    read = recording(tmp_path / "a.rec", frames)
    assert export(read, tmp_path / "a.mcap", unit="mT") == []
    found = messages(tmp_path / "a.mcap")["/readings"]
    assert [ns for ns, _ in found] == [START_NS + k * 12_345_678 for k in range(51)]
    for (_, content), frame, time_s in zip(found, frames, read.frames["time_s"], strict=True):
        assert (content["time_s"], content["sequence"], content["device_us"]) == (time_s, *frame[1:3])
        for k, value in enumerate(frame.values):
            assert bits(content.get(f"u{k + 1}_mT", np.nan)) == bits(value)
    assert "u5_mT" not in found[-1][1]


def test_every_stream_has_a_topic(tmp_path):
    frames = [Frame(3 * (k % 2), k, None, (float(k),) * (1 + k % 2)) for k in range(6)]
    export(recording(tmp_path / "a.rec", frames), tmp_path / "a.mcap")
    found = messages(tmp_path / "a.mcap")
    assert [content["u1"] for _, content in found["/readings/0"]] == [0, 2, 4]
    assert [content["u2"] for _, content in found["/readings/3"]] == [1, 3, 5]


def test_health_has_events_and_ends_with_the_counters(tmp_path):
    read = recording(tmp_path / "a.rec", numbered(1), counters={"frames": 50, "gaps": 7})
    read.notes.append({"event": "lost", "host_ns": HEAD["start_host_ns"] + 1000})
    export(read, tmp_path / "a.mcap")
    (lost_ns, lost), (end_ns, end) = messages(tmp_path / "a.mcap")["/health"]
    assert (lost_ns, lost) == (START_NS + 1000, {"time_s": 1e-6, "event": "lost"})
    assert end_ns == START_NS + 49 * 12_345_678
    assert (end["event"], end["frames"], end["gaps"], end["torn_bytes"]) == ("end", 50, 7, 0)


def estimates(path: Path, C: np.ndarray, **more) -> Path:
    """Write a table of estimates of two coordinates with a covariance."""
    sd = np.sqrt(np.diag(C))
    row = {"time_s": 0.025, "delta_x_1_mm": 1.5, "kappa_0_1_rad": -0.25, "delta_x_1_sd_mm": sd[0]}
    row |= {"kappa_0_1_sd_rad": sd[1], "delta_x_1__kappa_0_1_correlation": C[0, 1] / sd[0] / sd[1]}
    row |= {"tip_x_mm": 3.0, "tip_x_sd_mm": 2.0, "consistency": "consistent"} | more
    path.write_text(f"{','.join(row)}\n{','.join(map(str, row.values()))}\n")
    return path


def test_estimates_stand_beside_the_readings_with_their_covariance(tmp_path):
    read = recording(tmp_path / "a.rec", numbered(2))
    C = np.array([[0.04, -0.003], [-0.003, 0.01]])
    table = estimates(tmp_path / "e.csv", C)
    export(read, tmp_path / "a.mcap", estimates=table)
    ((ns, content),) = messages(tmp_path / "a.mcap")["/estimate"]
    assert ns == START_NS + 25_000_000
    np.testing.assert_allclose(content["covariance"], C, rtol=1e-14)
    assert content["tip_covariance"] == [[4.0]]
    row = pd.read_csv(table).iloc[0]
    assert {name: content[name] for name in row.index} == row.to_dict()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"time_s": 30.0}, "time_s in line 2 of e.csv must be within the recording, 0 to 0.605 s; instead "),
        ({"tip_x_mm": "x"}, "tip_x_mm in line 2 of e.csv must be a number; instead received 'x'"),
        ({"tip_x_mm": "inf"}, "tip_x_mm in line 2 of e.csv must be a number; instead received 'inf'"),
        ({"tip_x_mm": "1,2"}, "line 2 of e.csv must be of 9 cells, as the header; instead received 10"),
    ],
)
def test_a_table_that_is_none_of_this_recording_leaves_no_file(tmp_path, more, said):
    read = recording(tmp_path / "a.rec", numbered(2))
    table = estimates(tmp_path / "e.csv", np.eye(2), **more)
    with pytest.raises(InputError, match=said):
        export(read, tmp_path / "a.mcap", estimates=table)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.rec", "a.rec.json", "e.csv"]


def test_what_fails_while_it_is_written_leaves_no_file(tmp_path):
    read = recording(tmp_path / "a.rec", numbered(2))
    read.metadata["strange"] = {1, 2}  # nothing that JSON holds; met when all messages are written
    with pytest.raises(TypeError):
        export(read, tmp_path / "a.mcap")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.rec", "a.rec.json"]


def test_a_file_that_is_there_is_kept(tmp_path):
    read = recording(tmp_path / "a.rec", numbered(2))
    for form in ("csv", "mcap", "parquet"):
        (tmp_path / f"a.{form}").write_text("mine")
        with pytest.raises(InputError, match="must be a new file"):
            export(read, tmp_path / f"a.{form}", to=form)
        assert (tmp_path / f"a.{form}").read_text() == "mine"


def test_parquet_holds_the_table(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")  # an extra
    frames = [Frame(k % 2, k, None, tuple(np.arange(3 + k % 2) / 3)) for k in range(6)]
    read = recording(tmp_path / "a.rec", frames)
    assert export(read, tmp_path / "a.parquet") == export(read, tmp_path / "a.csv")
    table = parquet.read_table(tmp_path / "a.parquet").to_pandas()
    expected = pd.read_csv(tmp_path / "a.csv")
    pd.testing.assert_frame_equal(table, expected, check_exact=True, check_dtype=False)


def test_refused_forms(tmp_path):
    read = recording(tmp_path / "a.rec", numbered(3))
    with pytest.raises(
        InputError, match="to of export must be one of csv, parquet, mcap; instead received xls"
    ):
        export(read, tmp_path / "a", to="xls")
    with pytest.raises(
        InputError, match="to of export must be left out with --as hall; instead received csv"
    ):
        export(read, tmp_path / "a", "hall", to="csv")
    with pytest.raises(InputError, match="estimates of export must be left out, but for mcap; instead"):
        export(read, tmp_path / "a.csv", estimates=tmp_path / "e.csv")
