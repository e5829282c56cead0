"""A recording smoothed: less error than the filter's, and a table with the columns of a track."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from edition1.errors import InputError
from edition1.robot_file.load import load_robot
from edition1_companion.twins.played import played
from edition1_live.follow.estimate_table import EstimateRows
from edition1_live.follow.follower import track_readings
from edition1_live.follow.robot_estimator import robot_estimator
from edition1_live.follow.smoother import smooth_readings
from edition1_live.robot.readings_file import read_readings

PROJECT = Path(__file__).parents[3]
ROBOT = PROJECT / "data" / "robots" / "one_segment.toml"
RATE_HZ = 100.0


@pytest.fixture(scope="module")
def robot():
    return load_robot(ROBOT)


@pytest.fixture(scope="module")
def sent(robot):
    return played(robot, rate_hz=RATE_HZ, seconds=1.0, seed=3)


def write(path, robot, sent, noise):
    """A CSV of the readings with so much more noise, in that of the robot file."""
    values = sent.take.values
    more = noise * robot.noise * np.random.default_rng(0).normal(size=values.shape)
    frame = pd.DataFrame(values + more, columns=[f"channel_{k + 1}" for k in range(values.shape[1])])
    frame.insert(0, "time_s", np.arange(len(frame)) / RATE_HZ)
    frame.to_csv(path, index=False)
    return path


@pytest.fixture
def table(tmp_path, sent, robot):
    return write(tmp_path / "mine.csv", robot, sent, 9.0)


def errors(estimates, sent):
    q = torch.stack([estimate.q for _, estimate in estimates])
    return float((q - torch.as_tensor(sent.q)[: len(q)]).square().mean().sqrt())


def test_later_readings_lower_the_error(robot, sent, table):
    method = robot_estimator(robot, "kalman")
    readings = read_readings(table, robot)
    filtered, _ = smooth_readings(readings, method, lag_s=0.0)
    smoothed, said = smooth_readings(readings, method)
    lagged, _ = smooth_readings(readings, method, lag_s=0.05)
    assert errors(smoothed, sent) < errors(lagged, sent) < errors(filtered, sent)
    assert said[0] == f"{len(filtered)} estimates, smoothed."
    middle = len(filtered) // 2
    narrow, wide = (e[middle][1].covariance.diagonal().sum() for e in (smoothed, filtered))
    assert float(narrow) < float(wide)


def test_no_lag_is_the_filter(robot, sent, tmp_path):
    """Where nothing makes the filter start anew."""
    method = robot_estimator(robot, "kalman")
    readings, filtered = read_readings(write(tmp_path / "mine.csv", robot, sent, 0.0), robot), []
    track_readings(readings, method, lambda t, e: filtered.append((t, e)))
    alone, said = smooth_readings(readings, method, lag_s=0.0)
    assert [t for t, _ in alone] == [t for t, _ in filtered]
    assert all(torch.equal(a.q, b.q) for (_, a), (_, b) in zip(alone, filtered, strict=True))
    assert said[0].endswith("smoothed by readings up to 0 s later.")


def test_the_command_writes_the_columns_of_a_track(robot, table, tmp_path):
    out = tmp_path / "smooth.csv"
    call = "from edition1_companion.cli import main; raise SystemExit(main())"
    command = [sys.executable, "-c", call, "smooth", str(table), "--robot", str(ROBOT), "-o", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    written = pd.read_csv(out)
    method = robot_estimator(robot, "kalman")
    estimates, _ = smooth_readings(read_readings(table, robot), method)
    columns = EstimateRows(method, estimates[0][1]).header
    assert list(written) == columns
    assert len(written) == len(estimates)
    assert f"({len(estimates)} estimates)" in done.stdout


def test_another_estimator_and_readings_without_a_number_are_refused(robot, table, tmp_path):
    with pytest.raises(InputError, match="the Kalman filter, for magnetic sensors"):
        smooth_readings(read_readings(table, robot), robot_estimator(robot))
    frame = pd.read_csv(table)
    frame.iloc[:, 1:] = math.nan
    frame.to_csv(tmp_path / "empty.csv", index=False)
    with pytest.raises(InputError):
        smooth_readings(read_readings(tmp_path / "empty.csv", robot), robot_estimator(robot, "kalman"))
