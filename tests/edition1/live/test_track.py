"""Offline estimation: the same as live, from recordings and tables; the estimates in a CSV of whole lines."""

from __future__ import annotations

import math
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.base import Estimate
from edition1.estimation.consistency import Status
from edition1.robot_file.load import load_robot
from edition1_companion.twins.played import played
from edition1_companion.twins.takes import open_take
from edition1_live.emulate.board import passages
from edition1_live.emulate.emulator import Emulator
from edition1_live.emulate.links import SocketLink
from edition1_live.follow.estimate_table import EstimateFile, EstimateRows
from edition1_live.follow.follower import Follower, track_readings
from edition1_live.follow.live_text import limits
from edition1_live.follow.robot_estimator import ESTIMATORS, robot_estimator
from edition1_live.follow.time_steps import TimeStep
from edition1_live.record.export import export
from edition1_live.record.recording import read_recording
from edition1_live.record.recording_file import RecordingFile, WriteFailed
from edition1_live.robot.readings_file import read_readings, read_table
from edition1_live.wire.frame import Frame

PROJECT = Path(__file__).parents[3]
ROBOTS = PROJECT / "data" / "robots"
SECOND_NS = 10**9
START_NS = 7 * SECOND_NS


@pytest.fixture(scope="module")
def robot():
    return load_robot(ROBOTS / "one_segment.toml")


@pytest.fixture(scope="module")
def estimator(robot):
    return robot_estimator(robot)


@pytest.fixture(scope="module")
def sent(robot):
    return played(robot, rate_hz=100.0, seconds=0.5, seed=3)


def recording(path: Path, frames: list[Frame], format: str = "frames", late_s: float = 0.25, **more) -> Path:
    head = {"format": format, "start_unix_s": 0.0, "start_host_ns": START_NS} | more
    with RecordingFile(path, head) as file:
        for k, frame in enumerate(frames):
            file.append(START_NS + round(1e9 * late_s) + k * SECOND_NS // 100, [frame])
    return path


def frames_of(sent) -> list[Frame]:
    return [Frame(0, k, 10_000 * k, tuple(row)) for k, row in enumerate(sent.take.values.tolist())]


def tracked(path: Path, estimator, output: Path):
    with EstimateFile(output, estimator) as table:
        done, lines = track_readings(read_readings(path, estimator.robot), estimator, table.add)
    return done, lines, pd.read_csv(output)


# ---- estimates ----


def test_a_recording_gives_what_the_follower_gives_live(tmp_path, estimator, sent):
    path = recording(tmp_path / "a.rec", frames_of(sent))
    done, lines, table = tracked(path, estimator, tmp_path / "e.csv")
    follower = Follower(estimator)
    expected = [
        follower.step(TimeStep(0.01 * k, 0, 0, (frame,)))[1] for k, frame in enumerate(frames_of(sent))
    ]
    q = torch.stack([e.q for e in expected]).numpy()
    names = ["delta_x_1_mm", "delta_y_1_mm", "delta_L_1_mm"]
    np.testing.assert_allclose(table[names], 1e3 * q, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(table["time_s"], 0.25 + 0.01 * np.arange(50), atol=1e-6)
    assert done.estimated == len(table) == 50
    assert float(np.abs(1e-3 * table[names] - sent.q.numpy()).max().max()) < 3e-4, "near the truth"
    assert lines[0].startswith("50 estimates by levenberg_marquardt in ")


def test_uncertainties_are_those_of_the_covariance(tmp_path, estimator, sent):
    path = recording(tmp_path / "a.rec", frames_of(sent)[:5])
    *_, table = tracked(path, estimator, tmp_path / "e.csv")
    follower = Follower(estimator)
    for k, frame in enumerate(frames_of(sent)[:5]):
        _, estimate = follower.step(TimeStep(0.01 * k, 0, 0, (frame,)))
    C = 1e6 * estimate.covariance.numpy()  # mm^2
    row = table.iloc[-1]
    names = ["delta_x_1", "delta_y_1", "delta_L_1"]
    deviation = np.array([row[f"{name}_sd_mm"] for name in names])
    np.testing.assert_allclose(deviation, np.sqrt(np.diag(C)), rtol=1e-6)
    for a in range(3):
        for b in range(a + 1, 3):
            correlation = row[f"{names[a]}__{names[b]}_correlation"]
            np.testing.assert_allclose(
                correlation * deviation[a] * deviation[b], C[a, b], rtol=1e-5, atol=1e-12
            )
    # the tip by central differences
    tip = estimator.robot.robot.tip

    def place(q):
        return 1e3 * tip(q)[:3, 3].numpy()

    np.testing.assert_allclose([row[f"tip_{axis}_mm"] for axis in "xyz"], place(estimate.q), rtol=1e-8)
    steps = 1e-6 * torch.eye(3, dtype=torch.float64)
    J = np.stack([(place(estimate.q + s) - place(estimate.q - s)) / 2e-6 for s in steps], -1) / 1e3
    tip_C = J @ C @ J.T
    np.testing.assert_allclose(
        [row[f"tip_{axis}_sd_mm"] for axis in "xyz"], np.sqrt(np.diag(tip_C)), rtol=1e-5
    )
    expected = tip_C[0, 2] / np.sqrt(tip_C[0, 0] * tip_C[2, 2])
    assert row["tip_x__tip_z_correlation"] == pytest.approx(expected, abs=1e-5)


def test_deviations_are_grown_as_asked(tmp_path, estimator, sent):
    path, wide = recording(tmp_path / "a.rec", frames_of(sent)[:20]), replace(estimator, grown=2.5)
    *_, stated = tracked(path, estimator, tmp_path / "stated.csv")
    *_, grown = tracked(path, wide, tmp_path / "grown.csv")
    deviations = [name for name in stated if "_sd_" in name]
    np.testing.assert_allclose(grown[deviations], 2.5 * stated[deviations], rtol=1e-8)
    pd.testing.assert_frame_equal(grown.drop(columns=deviations), stated.drop(columns=deviations))
    assert limits(wide) == ["Every ± is 2.5 times what the estimator states.", *limits(estimator)]
    for wrong in (0.0, -1.0, math.inf, math.nan):
        message = f"Input grown of repro live must be a positive number; instead received {wrong}."
        with pytest.raises(InputError, match=re.escape(message)):
            replace(estimator, grown=wrong)


def test_columns_of_every_kind_of_estimate(estimator):
    q = torch.zeros(3, dtype=torch.float64)
    plain = Estimate(q, None, q)
    rows = EstimateRows(estimator, plain)
    assert rows.header == [
        "time_s", "delta_x_1_mm", "delta_y_1_mm", "delta_L_1_mm", "tip_x_mm", "tip_y_mm", "tip_z_mm",
    ]  # fmt: skip
    assert rows.rows([0.5], [plain]) == [["0.500000", "0", "0", "0", "0", "0", "110"]]
    said = Estimate(
        q, None, q, {"chi2": torch.tensor(3.5), "dof": torch.tensor(2), "status": torch.tensor(1)}
    )
    rows = EstimateRows(estimator, said)
    assert rows.header[-3:] == ["chi2", "dof", "consistency"]
    assert [row[-3:] for row in rows.rows([0.5, 0.6], [said, plain])] == [
        ["3.5", "2", Status(1).word],
        [""] * 3,
    ]
    held = Estimate(q, torch.zeros(3, 3, dtype=torch.float64), q)
    rows = EstimateRows(estimator, held)
    first, second = rows.rows([0.5, 0.6], [held, plain])
    assert len(first) == len(second) == len(rows.header) == 1 + 3 + 3 + 3 + 3 + 3 + 3
    assert first[4:10] == ["0"] * 3 + [""] * 3, "correlations of nothing"
    assert second[4:10] == [""] * 6


@pytest.mark.parametrize("name", ESTIMATORS[:-1])
def test_every_estimator_is_stored(tmp_path, robot, sent, name):
    path = recording(tmp_path / "a.rec", frames_of(sent)[:5])
    done, _, table = tracked(path, robot_estimator(robot, name), tmp_path / "e.csv")
    assert done.estimated == len(table) == 5
    numbers = table.drop(columns="consistency")
    assert np.isfinite(numbers.to_numpy(dtype=float)).all()
    assert set(table["consistency"]) <= {"consistent", "suspicious", "wrong"}
    assert ("tip_x_sd_mm" in table) == (name != "gradient_descent")


def test_imus_give_points_and_the_tip(tmp_path):
    arm = robot_estimator(load_robot(ROBOTS / "imu_arm.toml"))
    take = open_take("arm", seed=1)
    frames = [
        Frame(int(s), None, None, tuple(v)) for s, v in zip(take.stream, take.values.tolist(), strict=True)
    ]
    path = recording(tmp_path / "a.rec", frames[:80], "quaternions")
    done, _, table = tracked(path, arm, tmp_path / "e.csv")
    assert done.estimated == 10
    n = len(arm.start) // 3
    np.testing.assert_array_equal(table[f"point_{n}_x_mm"], table["tip_x_mm"])
    assert (table["tip_x_sd_mm"] > 0).all()
    assert not [name for name in table if name.startswith("point") and name.endswith("correlation")]
    export(read_recording(path), tmp_path / "a.csv")
    *_, again = tracked(tmp_path / "a.csv", arm, tmp_path / "f.csv")
    np.testing.assert_allclose(
        again.drop(columns="consistency"), table.drop(columns="consistency"), rtol=1e-8, atol=1e-6
    )


# ---- tables ----


def test_an_exported_recording_gives_the_same_estimates(tmp_path, robot, estimator, sent):
    path = recording(tmp_path / "a.rec", frames_of(sent))
    for unit in ("", robot.unit):
        export(read_recording(path), tmp_path / f"a{unit}.csv", unit=unit)
        tracked(path, estimator, tmp_path / f"e{unit}.csv")
        tracked(tmp_path / f"a{unit}.csv", estimator, tmp_path / f"f{unit}.csv")
        assert (tmp_path / f"e{unit}.csv").read_bytes() == (tmp_path / f"f{unit}.csv").read_bytes()


@pytest.mark.parametrize(
    "header",
    [
        "time_s,u1,u2,u3",
        "time_s,u1_mT,u2_mT,u3_mT",
        "time_s,channel_1,channel_2,channel_3",
        "Time [s],Channel 1 [mT],ch2,sensor_3 (mT)",
        "time_s,sensor_1,sensor_2,sensor_3,",
    ],
)
def test_channels_are_found_by_their_names_whatever_their_order(tmp_path, estimator, header):
    path = tmp_path / "a.csv"
    if header.endswith(","):
        header = header[:-1]
    names = header.replace("Channel 1", "Channel_1").split(",")
    order = [3, 0, 2, 1]
    rows = [[0.5, 1.0, 2.0, 3.0], [0.6, 1.5, 2.5, 3.5]]
    lines = [[names[k] for k in order], *([str(row[k]) for k in order] for row in rows)]
    path.write_text("\n".join(",".join(line) for line in lines) + "\n")
    frames, start_s, notes = read_table(path, estimator.robot)
    assert start_s == 0.5
    assert notes == []
    assert frames == [
        (0, Frame(0, None, None, (1.0, 2.0, 3.0))),
        (10**8, Frame(0, None, None, (1.5, 2.5, 3.5))),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "u1,u2,u3\n1,2,3\n",
            "times of a.csv must be one column, such as time_s; instead received none among",
        ),
        ("time_s,time_ms,u1,u2,u3\n1,1,1,2,3\n", "must be one column, .* received 2: time_s, time_ms"),
        ("time,u1,u2,u3\n1,1,2,3\n", "must be named with their unit, such as time_s or time_ms"),
        (
            "time_s,u1,u2\n1,2,3\n",
            "channel 3 of a.csv must be one column: u3, u3_mT, channel_3 or sensor_3; .* none",
        ),
        ("time_s,X,Y,Z\n1,2,3,4\n", "channel 1 of a.csv must be one column"),
        ("time_s,u1,u2,u3,sensor_3\n1,2,3,4,5\n", "channel 3 of a.csv must be one column.* u3, sensor_3: 2"),
        (
            "time_s,u1,u1,u2,u3\n1,2,3,4,5\n",
            "columns of a.csv must be of different names; instead received u1 twice",
        ),
        (
            "time_s,u1_mV,u2,u3\n1,2,3,4\n",
            "column u1_mV of a.csv must be in mT, the unit of one_segment.toml",
        ),
        ("time_s,u1,u2,u3\n1,2,3,x\n", r"u3 in line 2 of a.csv must be a number \(.*; instead received 'x'"),
        ("time_s;u1;u2;u3\n1;2;3;4\n", r"must be a number \(cells are separated by commas\)"),
        (
            "time_s,u1,u2,u3\n# a pause\n1,2,3\n",
            "line 3 of a.csv must be of 4 cells, as the header; instead received 3",
        ),
        ("time_s,u1,u2,u3\n1,2,3,4,\n2,2,3,4,\n", "line 2 of a.csv must be of 4 cells, .* received 5"),
        ("time_s,u1,u2,u3\n1,2,3,4\n,2,3,4\n", "time_s in line 3 of a.csv must be a time; .* an empty cell"),
        (
            "time_s,u1,u2,u3\n1,2,3,4\n0.5,2,3,4\n",
            "time_s in line 3 of a.csv must be not before the time before, 1 s; instead received 0.5 s",
        ),
        ("time_s,u1,u2,u3\n", "at least one row"),
        ("", "table of a.csv must be a CSV of numbers"),
        ("time_s,device_us,u1,u2,u3\n1,-2,1,2,3\n", "device_us of a.csv must be whole numbers from 0"),
        ("time_s,stream,u1,u2,u3\n1,0.5,1,2,3\n", "stream of a.csv must be whole numbers from 0 to 65535"),
    ],
)
def test_tables_that_do_not_fit_are_refused_by_name(tmp_path, estimator, text, message):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_readings(tmp_path / "a.csv", estimator.robot)


def test_what_cannot_be_used_is_said(tmp_path, estimator, sent):
    rows = [",".join(map(str, row)) for row in sent.take.values[:6].tolist()]
    rows[1], rows[2], rows[3] = ",,", "inf,1,1", "," + rows[3].split(",", 1)[1]
    lines = [f"{0.01 * k},{row},25" for k, row in enumerate(rows)]
    (tmp_path / "a.csv").write_text("\n".join(["time_s,u1,u2,u3,temperature", *lines]) + "\n")
    _, lines, table = tracked(tmp_path / "a.csv", estimator, tmp_path / "e.csv")
    assert len(table) == 4
    said = "\n".join(lines)
    assert "2 time steps without an estimate." in said
    assert "sensor 1 gave no reading in 2 time steps" in said
    assert "Columns of a.csv that are not used: temperature." in said


# ---- recordings that do not fit ----


def test_frames_that_do_not_fit_are_left_out_and_said(tmp_path, estimator, sent):
    frames = frames_of(sent)
    frames[3] = frames[3]._replace(values=(1.0, 2.0))
    frames[7] = frames[7]._replace(stream=4)
    path = recording(tmp_path / "a.rec", frames)
    with path.open("ab") as stream:
        stream.write(b"RRB1F")
    _, lines, table = tracked(path, estimator, tmp_path / "e.csv")
    assert len(table) == 48
    assert lines[1:] == [
        "Consistency: 48 consistent, 0 suspicious, 0 wrong.",
        "Recording: 5 bytes of the recording are not whole and were left out.",
        "1 frames of stream 0 have another number of values than 3 and were left out.",
        "Streams that one_segment.toml does not have: 4 (1 frames).",
    ]


def test_recordings_of_another_board_are_refused(tmp_path, estimator):
    five = [Frame(0, k, None, (1.0,) * 5) for k in range(3)]
    expected = "one with frames of 3 values in stream 0; instead received 3 frames of 5 values in stream 0"
    with pytest.raises(InputError, match=expected):
        read_readings(recording(tmp_path / "a.rec", five), estimator.robot)
    lines = [Frame(0, None, None, (1.0,) * 3)] * 3
    with pytest.raises(InputError, match="must be of the format frames; instead received hall"):
        read_readings(recording(tmp_path / "b.rec", lines, "hall"), estimator.robot)
    with pytest.raises(InputError, match="which is not there"):
        read_readings(tmp_path / "c.rec", estimator.robot)


def test_lines_in_another_unit_are_refused(tmp_path):
    text = (ROBOTS / "one_segment.toml").read_text().replace('"frames"', '"csv"')
    (tmp_path / "robot.toml").write_text(text)
    estimator = robot_estimator(load_robot(tmp_path / "robot.toml"))
    frames = [Frame(0, None, None, (1.0, 2.0, 3.0))] * 3
    about = {"channels": ["x_uT", "y_uT", "z_uT"], "units": ["uT"] * 3}
    with pytest.raises(InputError, match="unit of the robot file must be uT, as the lines say of x_uT"):
        read_readings(recording(tmp_path / "a.rec", frames, "csv", **about), estimator.robot)
    assert len(read_readings(recording(tmp_path / "b.rec", frames, "csv"), estimator.robot).frames) == 3
    (tmp_path / "c.csv").write_text("time_s,x_uT,y_uT,z_uT\n0,1,2,3\n")
    with pytest.raises(InputError, match="unit of the robot file must be uT, as the lines say of x_uT"):
        read_readings(tmp_path / "c.csv", estimator.robot)


def test_labels_of_a_sketch_come_back_from_an_export_in_their_order(tmp_path):
    text = (ROBOTS / "one_segment.toml").read_text().replace('"frames"', '"csv"')
    (tmp_path / "robot.toml").write_text(text)
    estimator = robot_estimator(load_robot(tmp_path / "robot.toml"))
    frames = [Frame(0, None, 20_000 * k, (1.0, 2.0, 3.0 + k)) for k in range(3)]
    about = {"channels": ["Z_mT", "Y_mT", "X_mT"], "units": ["mT"] * 3}
    path = recording(tmp_path / "a.rec", frames, "csv", **about)
    export(read_recording(path), tmp_path / "a.csv")
    found = read_readings(tmp_path / "a.csv", estimator.robot)
    assert [frame for _, frame in found.frames] == frames
    (tmp_path / "b.csv").write_text("time_s,Z,Y\n0,1,2\n")
    with pytest.raises(InputError, match="channel 1 of b.csv must be one column"):
        read_readings(tmp_path / "b.csv", estimator.robot)


# ---- the file of estimates ----


def an_estimate() -> Estimate:
    q = torch.zeros(3, dtype=torch.float64)
    return Estimate(q, 1e-8 * torch.eye(3, dtype=torch.float64), q)


def test_estimates_appear_while_they_come_in_whole_lines(tmp_path, estimator):
    path = tmp_path / "new" / "e.csv"
    with EstimateFile(path, estimator) as table:
        for k in range(300):
            table.add(0.01 * k, an_estimate())
            time.sleep(0.002)
        deadline = time.monotonic() + 20
        while table.written < 300 and time.monotonic() < deadline:
            time.sleep(0.05)
        text = path.read_text()
        assert text.endswith("\n")
        assert len(text.splitlines()) == 301
    with pytest.raises(InputError, match="estimates of repro must be a new file"):
        EstimateFile(path, estimator)


def test_no_estimate_leaves_no_file(tmp_path, estimator):
    with EstimateFile(tmp_path / "e.csv", estimator):
        pass
    assert not (tmp_path / "e.csv").exists()


def test_a_file_that_cannot_be_written_is_said(tmp_path, estimator):
    table = EstimateFile(tmp_path / "e.csv", estimator)
    (tmp_path / "e.csv").mkdir()  # taken meanwhile
    table.add(0.0, an_estimate())
    with pytest.raises(WriteFailed, match=r"e.csv cannot be written: .*; 0 estimates are kept"):
        table.close()


# ---- commands ----


@pytest.fixture(scope="module")
def folder(tmp_path_factory, sent):
    path = tmp_path_factory.mktemp("track")
    shutil.copy(ROBOTS / "one_segment.toml", path / "robot.toml")
    recording(path / "a.rec", frames_of(sent))
    return path


def repro(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "edition1_companion.cli", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300)


def test_track_and_live_of_a_file_are_the_same(folder):
    done = repro(folder, "track", "a.rec", "--robot", "robot.toml", "-o", "e.csv")
    assert (done.returncode, done.stdout) == (0, "e.csv  (50 estimates)\n"), done.stderr
    assert "50 estimates by levenberg_marquardt" in done.stderr
    done = repro(folder, "live", "a.rec", "--robot", "robot.toml", "--estimates", "f.csv")
    assert (done.returncode, done.stdout) == (0, "f.csv  (50 estimates)\n"), done.stderr
    assert "a.rec is a file, not a port: it is estimated at full speed" in done.stderr
    assert (folder / "e.csv").read_bytes() == (folder / "f.csv").read_bytes()
    done = repro(folder, "live", "a.rec", "--robot", "robot.toml", "-o", "b.rec")
    assert done.returncode == 2
    assert "output of repro live must be left out for a.rec, which is a file, not a port" in done.stderr
    done = repro(folder, "track", "a.rec", "--robot", "robot.toml", "-o", "e.csv")
    assert done.returncode == 2
    assert "must be a new file" in done.stderr


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_live_estimates_are_stored_through_an_interrupt(folder, sent):
    over = threading.Event()

    def again():
        while not over.is_set():
            yield from sent.take.readings()

    output = folder / "live.csv"
    with Emulator(passages(again(), "frames"), SocketLink()) as emulator:
        arguments = [
            "live",
            emulator.address,
            "--robot",
            "robot.toml",
            "--estimates",
            output.name,
            "--failed",
            "3",
        ]
        process = subprocess.Popen(
            [sys.executable, "-m", "edition1_companion.cli", *arguments],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        deadline = time.monotonic() + 240
        while not output.exists() and time.monotonic() < deadline:
            assert process.poll() is None, process.communicate()
            time.sleep(0.1)
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
        over.set()
    assert process.returncode == 0, err
    table = pd.read_csv(output)
    assert out == f"live.csv  ({len(table)} estimates)\n"
    assert len(table) > 10
    assert (np.diff(table["time_s"]) > 0).all()
    assert output.read_text().endswith("\n")
