"""The recordings of the continuum robot: where they are found, how their files are read, and what they say."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1_companion.book.project import find_project
from edition1_companion.recordings.continuum_robot import (
    FETCHED,
    LENGTH_M,
    SENSORS,
    STATIONS_M,
    TRUTH,
    Readings,
    find_trials,
    poses,
    read_readings,
)

COMMITTED = find_project().data / "recordings" / "continuum_robot"
HEAD = "sensor type:,gyro\ntimestamp (s),arclength (m),data\n"


@pytest.fixture(autouse=True)
def _only_committed(monkeypatch, tmp_path):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))


def test_committed_files_are_those_of_the_repository():
    """By the hashes of the list of public recordings; with the licence."""
    listed = json.loads((COMMITTED.parents[1] / "sources.json").read_text())["continuum_robot"]["files"]
    hashes = {entry["path"].removeprefix("assets/data/"): entry["sha256"] for entry in listed}
    for path in (*COMMITTED.glob("[si]*/*.csv"), COMMITTED / "LICENSE"):
        name = path.relative_to(COMMITTED).as_posix()
        assert hashlib.sha256(path.read_bytes()).hexdigest() == hashes[name], name


def test_trials_of_the_project():
    trials = {trial.name: trial for trial in find_trials(COMMITTED)}
    assert sorted(trials) == ["fast_contact", "impulse_1", "slow_free_space"]
    assert trials["fast_contact"].folder == trials["impulse_1"].folder
    assert trials["fast_contact"].window_s == (10.0, 20.0)


def test_a_trial_counts_once(tmp_path):
    """A fetched copy of a trial, or one under another name, adds none; a new one is scored whole."""
    shutil.copytree(COMMITTED / "impulse_1", tmp_path / FETCHED / "fast_contact")
    shutil.copytree(COMMITTED / "slow_free_space", tmp_path / FETCHED / "slow_free_space")
    assert len(find_trials(COMMITTED)) == 3
    new = tmp_path / FETCHED / "new"
    shutil.copytree(COMMITTED / "slow_free_space", new)
    lines = (new / "aurora0.csv").read_text().splitlines()
    (new / "aurora0.csv").write_text("\n".join(lines[:-1]))
    assert [(t.name, t.window_s) for t in find_trials(COMMITTED)][-1] == ("new", None)


@pytest.mark.parametrize("trial", find_trials(COMMITTED), ids=lambda trial: trial.name)
def test_sensors_are_where_the_description_says(trial):
    at = {name: trial.readings(name).arc_m for name in (*SENSORS, *TRUTH)}
    assert [at[name] for name in SENSORS] == [0.0, LENGTH_M, 0.233, LENGTH_M]
    np.testing.assert_allclose([at[name] for name in TRUTH], [0.0, *STATIONS_M], atol=1e-4)


@pytest.mark.parametrize("trial", find_trials(COMMITTED), ids=lambda trial: trial.name)
def test_pose_is_a_logarithm_and_the_gyroscope_turns_with_the_robot(trial):
    """Where the middle turns, its angular velocity is that of the motion capture in the sensor's own frame."""
    vicon, gyro = trial.readings("vicon2"), trial.readings("gyro_mid")
    turns = Rotation.from_matrix(poses(vicon)[:, :3, :3])
    middle = (vicon.time_s[1:] + vicon.time_s[:-1]) / 2
    rate = (turns[:-1].inv() * turns[1:]).as_rotvec() / np.diff(vicon.time_s)[:, None]
    near = np.diff(vicon.time_s) < 0.1
    said = np.stack([np.interp(middle, gyro.time_s, column) for column in gyro.data.T], 1)
    turn, _ = Rotation.align_vectors(rate[near], said[near])
    assert np.degrees(turn.magnitude()) < 5


def test_pose_by_another_route():
    """A quarter of a circle about y: position and turn in closed form, and the turn by SciPy."""
    xi = np.array([[0.0, 0.0, np.pi / 2, 0.0, np.pi / 2, 0.0], [0.1, 0.2, 0.3, 0.4, -0.5, 0.6]])
    T = poses(Readings("vicon", 0.0, np.arange(2.0), xi))
    np.testing.assert_allclose(T[0, :3, 3], [1, 0, 1], atol=1e-15)
    np.testing.assert_allclose(T[:, :3, :3], Rotation.from_rotvec(xi[:, 3:]).as_matrix(), atol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1 of a.csv of the continuum robot must be sensor type:, and one of aurora, vicon, gyro"),
        ("sensor type:,camera\n", "instead received 'sensor type:,camera'"),
        (HEAD, "at least one reading behind two lines"),
        (HEAD + "0,0.2,1,2\n", "line 3 of a.csv of the continuum robot must be 5 finite numbers"),
        (HEAD + "0,0.2,1,2,x\n", "5 finite numbers with commas between; instead received '0,0.2,1,2,x'"),
        (HEAD + "0,0.2,1,2,nan\n", "finite"),
        (HEAD + "0,0.2,1,2,3\n0,0.2,1,2,3\n", "line 4 of a.csv of the continuum robot must be a later time"),
        (HEAD + "0,0.2,1,2,3\n1,0.3,1,2,3\n", "line 4 of a.csv of the continuum robot must be at 0.2 m"),
    ],
)
def test_what_cannot_be_read_is_refused_by_its_line(text, message, tmp_path):
    path = Path(tmp_path / "a.csv")
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_readings(path)


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match="an existing file"):
        read_readings(tmp_path / "vicon9.csv")
