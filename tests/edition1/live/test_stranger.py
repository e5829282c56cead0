"""What a stranger's files and names meet: nothing is lost, exchanged or taken for another unit without a word."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from edition1.errors import InputError
from edition1.robot_file.load import load_robot
from edition1_live.emulate.links import HAS_PTY, PtyLink
from edition1_live.record.export import export
from edition1_live.record.import_text import import_text
from edition1_live.record.recording import read_recording
from edition1_live.robot.readings_file import frames_of

ROBOT = load_robot("data/robots/one_segment.toml")
ROWS = "0.0,1,2,3\n0.1,1,2,3\n"


def imported(folder, head, form="frames"):
    """A recording made of a table with this header."""
    (folder / "a.csv").write_text(f"{head}\n{ROWS}")
    import_text(folder / "a.csv", folder / "a.rec", format=form)
    return read_recording(folder / "a.rec")


@pytest.mark.parametrize("form", ["frames", "csv"])
def test_columns_out_of_order_are_refused(form, tmp_path):
    with pytest.raises(
        InputError, match=r"columns of a.csv must be in the order of their numbers; .* u2_mT, u1_mT"
    ):
        imported(tmp_path, "time_s,u2_mT,u1_mT,u3_mT", form)


def test_the_unit_of_frames_is_kept(tmp_path):
    recording = imported(tmp_path, "time_s,u1_uT,u2_uT,u3_uT")
    with pytest.raises(InputError, match="uT"):
        frames_of(recording, ROBOT)
    (tmp_path / "again").mkdir()
    assert frames_of(imported(tmp_path / "again", "time_s,u1_mT,u2_mT,u3_mT"), ROBOT)[0].all()


@pytest.mark.parametrize("name", ["out.MCAPS", "out.xlsx"])
def test_an_unknown_ending_is_refused(name, tmp_path):
    recording = imported(tmp_path, "time_s,u1_mT,u2_mT,u3_mT")
    with pytest.raises(InputError, match=r"output of export must be named \.csv"):
        export(recording, tmp_path / name)
    assert not (tmp_path / name).exists()


def test_readings_are_no_estimates(tmp_path):
    recording = imported(tmp_path, "time_s,u1_mT,u2_mT,u3_mT")
    with pytest.raises(InputError, match="estimates of a.csv must be a table of repro track"):
        export(recording, tmp_path / "out.mcap", estimates=tmp_path / "a.csv")


@pytest.mark.skipif(not HAS_PTY, reason="no pseudo-terminals here")
def test_a_link_that_is_no_port_is_left_alone(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "mine").symlink_to("data")
    with pytest.raises(InputError, match="port_file of PtyLink"):
        PtyLink(tmp_path / "mine")
    assert (tmp_path / "mine").is_symlink()


def test_a_column_that_is_there_twice_is_refused():
    columns = {f"u{k}_mT": [1.0, 2.0] for k in (1, 2, 3)}
    twice = pd.DataFrame(columns | {"u1_mT.1": [1.0, 2.0]})
    for table in (twice, twice.rename(columns={"u1_mT.1": "u1_mT"})):
        with pytest.raises(InputError, match="column u1_mT of the table must be there once"):
            ROBOT.readings(table)


@pytest.mark.parametrize("values", [np.array([1 + 2j, 1]), pd.to_datetime(["2020-01-01", "2020-01-02"])])
def test_what_is_no_number_is_not_taken_for_one(values):
    table = pd.DataFrame({"u1_mT": values, "u2_mT": [1.0, 2.0], "u3_mT": [1.0, 2.0]})
    with pytest.raises(InputError, match="column u1_mT of the table must be numbers; instead received"):
        ROBOT.readings(table)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "calibrate none --robot data/robots/one_segment.toml --self -o {0}/today.rec",
            "a name such as today.json",
        ),
        ("calibrate none --robot data/robots/one_segment.toml --self -o {0}/file/today.json", "in a folder"),
        ("emulate lemniscate --seed -1", "Input seed of repro emulate must be 0 or more"),
        ("smooth none --robot data/robots/imu_arm.toml -o {0}/out.csv", "repro track takes IMUs"),
        ("export {0}/a.rec -o {0}/file/x.csv", "A file cannot be read or written: "),
    ],
)
def test_words_of_the_command(words, message, tmp_path):
    imported(tmp_path, "time_s,u1_mT,u2_mT,u3_mT")
    (tmp_path / "file").write_text("")
    command = [Path(sys.executable).with_name("repro"), *(word.format(tmp_path) for word in words.split())]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode in (1, 2)
    assert message in done.stderr
    assert "Traceback" not in done.stderr
