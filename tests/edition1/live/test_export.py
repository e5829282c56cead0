"""A recording as a table: every frame, every value, every time; read back, they are the same."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_recorder import COMMANDS

from edition1.errors import InputError
from edition1_live.record.export import export
from edition1_live.record.recording import read_recording
from edition1_live.record.recording_file import RecordingFile, write_sidecar
from edition1_live.wire.frame import Frame

ROBOTS = Path(__file__).parents[3] / "data" / "robots"
HEAD = {"start_unix_s": 1_700_000_000.25, "start_host_ns": 5 * 10**9}


def recording(path: Path, frames: list[Frame], format: str = "frames", **more):
    with RecordingFile(path, HEAD | {"format": format} | more) as file:
        for k, frame in enumerate(frames):
            file.append(HEAD["start_host_ns"] + k * 12_345_678, [frame])
    write_sidecar(path, HEAD | {"format": format} | more)
    return read_recording(path)


def numbered(width: int, n: int = 50, **more) -> list[Frame]:
    rows = np.random.default_rng(width).normal(size=(n, width)) * 10.0 ** np.arange(-3, width - 3)
    return [
        Frame(**({"stream": 0, "sequence": k, "device_us": 1000 * k} | more), values=tuple(row))
        for k, row in enumerate(rows.tolist())
    ]


@pytest.mark.parametrize("width", [1, 5, 12])
def test_any_number_of_channels_comes_out_bit_for_bit(tmp_path, width):
    frames = numbered(width)
    read = recording(tmp_path / "a.rec", frames)
    assert export(read, tmp_path / "a.csv") == []
    table = pd.read_csv(tmp_path / "a.csv")
    names = [f"u{k + 1}" for k in range(width)]
    assert list(table) == ["time_s", "unix_s", "stream", "sequence", "device_us", *names]
    np.testing.assert_array_equal(table[names], [frame.values for frame in frames])
    np.testing.assert_array_equal(table["time_s"], read.frames["time_s"])
    np.testing.assert_allclose(table["unix_s"] - HEAD["start_unix_s"], table["time_s"], atol=5e-7)
    np.testing.assert_array_equal(table["sequence"], np.arange(50))


def test_lines_keep_their_names_and_have_no_numbers(tmp_path):
    frames = numbered(2, sequence=None, device_us=None)
    read = recording(tmp_path / "a.rec", frames, "csv", channels=["X_uT", "Y"], units=["uT", ""])
    export(read, tmp_path / "a.csv")
    assert list(pd.read_csv(tmp_path / "a.csv")) == ["time_s", "unix_s", "X_uT", "Y"]
    export(read, tmp_path / "b.csv", unit="uT")
    assert list(pd.read_csv(tmp_path / "b.csv")) == ["time_s", "unix_s", "X_uT", "Y_uT"]


def test_frames_of_many_widths_and_streams(tmp_path):
    frames = [Frame(k % 2, k, None, tuple(range(3 + k % 2))) for k in range(6)]
    said = export(recording(tmp_path / "a.rec", frames), tmp_path / "a.csv")
    table = pd.read_csv(tmp_path / "a.csv")
    assert said == ["frames have 3 to 4 values; missing ones are empty"]
    assert table["stream"].tolist() == [0, 1] * 3
    assert table["u4"].isna().tolist() == [True, False] * 3


def test_names_that_no_column_can_have_are_numbered(tmp_path):
    frames = numbered(2, sequence=None, device_us=None)
    for k, names in enumerate((["stream", "b"], ["a", "a"], ["a"], [1, 2], "ab")):
        read = recording(tmp_path / f"{k}.rec", frames, "csv", channels=names)
        assert read.channels == ["u1", "u2"]


def test_an_empty_recording_is_refused(tmp_path):
    with pytest.raises(
        InputError, match="recording of export must be one with frames; instead received no frame"
    ):
        export(recording(tmp_path / "a.rec", []), tmp_path / "a.csv")


def test_the_command_names_units_by_the_robot_file(tmp_path):
    def exported(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", COMMANDS, "export", *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)

    robot = str(ROBOTS / "one_segment.toml")
    recording(tmp_path / "a.rec", numbered(3))
    recording(tmp_path / "b.rec", numbered(5))
    done = exported("a.rec", "-o", "a.csv", "--robot", robot)
    assert (done.returncode, done.stdout, done.stderr) == (0, "a.csv  (50 frames)\n", "")
    assert list(pd.read_csv(tmp_path / "a.csv"))[-3:] == ["u1_mT", "u2_mT", "u3_mT"]
    done = exported("b.rec", "-o", "b.csv", "--robot", robot)
    assert done.returncode == 2
    assert (
        "of one_segment.toml must be one with frames of 3 values in stream 0; instead received" in done.stderr
    )
    assert exported("b.rec", "-o", "b.csv").returncode == 0
    recording(tmp_path / "c.rec", numbered(3), "hall")
    done = exported("c.rec", "-o", "c.csv", "--robot", robot)
    assert "of one_segment.toml must be of the format frames; instead received hall" in done.stderr
