"""Released outputs of the models: small tables written here, and the released ones where they are found."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from edition1.errors import InputError
from edition1_companion.recordings.martin2022_trial import (
    OUTPUT_FOLDER,
    OUTPUTS,
    POINTS,
    RIGID_LINKS_M,
    find_output,
    read_output,
)

SOURCES = Path(__file__).parents[4] / "data" / "sources.json"


def table(rows=3):
    columns = {
        "time": [f"2022/02/23/15:44:{33 + k}.431827" for k in range(rows)],
        ".header.seq": range(rows),
        ".header.frame_id": [float("nan")] * rows,
    }
    for k in range(POINTS):
        columns[f".ID_{k}"] = [k] * rows
        columns |= {
            f".{axis}{k}": [10.0 * k + n + row / 10 for row in range(rows)] for n, axis in enumerate("xyz")
        }
    return pd.DataFrame(columns)


def written(path, changed):
    changed.to_csv(path, index=False)
    return path


def test_points_and_times(tmp_path):
    found = read_output(written(tmp_path / "rigid.csv", table()))
    assert found.points.shape == (3, 8, 3)
    np.testing.assert_allclose(found.points[1, 5], [50.1, 51.1, 52.1])
    np.testing.assert_allclose(found.replay_s, [0, 1, 2])


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        (".y3", "NaN", r"Input values of rigid.csv must be finite numbers; .* something else in row 1\."),
        (".z0", "x", r"Input values of rigid.csv must be finite numbers; .* something else in row 1\."),
        (
            ".ID_2",
            3,
            r"Input ids of rigid.csv must be 0 to 7; instead received \[0.0, 1.0, 3.0, .*\] in row 1\.",
        ),
        ("time", "15:44", r"Input time of rigid.csv must be yyyy/mm/dd/HH:MM:SS.ffffff; .* 15:44 in row 1\."),
        (
            "time",
            "2021/02/23/15:44:33.431827",
            r"Input time of rigid.csv must be in order; instead received a step back to row 1\.",
        ),
    ],
)
def test_cells_that_cannot_be_used(tmp_path, column, value, message):
    changed = table().astype({column: object})
    changed.loc[1, column] = value
    with pytest.raises(InputError, match=message):
        read_output(written(tmp_path / "rigid.csv", changed))


def test_points_that_a_model_did_not_give(tmp_path):
    changed = table()
    changed[".ID_3"] = 0
    changed[[".x3", ".y3", ".z3"]] = 0.0
    found = read_output(written(tmp_path / "pcc16_2.csv", changed)).points
    assert np.isnan(found[:, 3]).all()
    assert np.isfinite(np.delete(found, 3, axis=1)).all()
    changed[".z3"] = 0.1  # a position, but no number
    with pytest.raises(InputError, match=r"Input ids of pcc16_2.csv must be 0 to 7; .* in row 0\."):
        read_output(written(tmp_path / "pcc16_2.csv", changed))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n\n",
        b"\xff\xfe\x00\xd8",
        b"time,.ID_0\n1,2\n1,2,3,4\n",
        b'time,"unclosed\n1,2\n',
        b"\x00\x01\x02",
    ],
)
def test_files_that_are_no_table(tmp_path, content):
    path = tmp_path / "rigid.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"^Input (content|columns) of rigid\.csv must be "):
        read_output(path)


def test_a_file_that_was_cut(tmp_path):
    """Wherever it ends, it is refused by name, or has whole rows (but for digits of the last number)."""
    path = written(tmp_path / "rigid.csv", table())
    whole, read = path.read_bytes(), []
    for end in range(0, len(whole), 7):
        path.write_bytes(whole[:end])
        try:
            read.append(len(read_output(path).points))
        except InputError:
            read.append(0)
    assert set(read) == {0, 2, 3}


def test_columns_that_are_missing(tmp_path):
    path = written(tmp_path / "rigid.csv", table().drop(columns=[".y3", "time"]))
    message = r"Input columns of rigid.csv must be time, .*; instead received none of \['time', '\.y3'\]\."
    with pytest.raises(InputError, match=message):
        read_output(path)


def test_no_rows(tmp_path):
    with pytest.raises(
        InputError, match=r"Input rows of rigid.csv must be at least one; instead received none\."
    ):
        read_output(written(tmp_path / "rigid.csv", table(0)))


def test_no_file(tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    assert find_output("elephant/pcc/pcc2.csv") is None
    with pytest.raises(FileNotFoundError, match="There is no table"):
        read_output(tmp_path / "rigid.csv")
    with pytest.raises(
        InputError, match=r"Input name of find_output must be one of elephant/rigid/rigid\.csv"
    ):
        find_output("pcc3.csv")


def test_another_file_of_the_name(tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    path = tmp_path / OUTPUT_FOLDER / "elephant/pcc/pcc2.csv"
    path.parent.mkdir(parents=True)
    written(path, table())
    with pytest.raises(
        InputError, match=r"must be the released file, sha256 e3cbff8e.*; instead received sha256"
    ):
        find_output("elephant/pcc/pcc2.csv")


def test_hashes_are_those_of_the_list_of_recordings():
    listed = json.loads(SOURCES.read_text())["martin2022"]["files"]
    known = {entry["path"]: entry.get("sha256") for entry in listed}
    for name, sha256 in OUTPUTS.items():
        assert known[f"data analysis/data/{name}"] == sha256


class TestReleased:
    """The released tables, where they are found."""

    @pytest.fixture
    def outputs(self):
        paths = [find_output(name) for name in ("elephant/rigid/rigid.csv", "elephant/pcc/pcc2.csv")]
        if None in paths:
            pytest.skip("the recordings are not found")
        return [read_output(path) for path in paths]

    def test_links_of_the_rigid_body_model(self, outputs):
        lengths = np.linalg.norm(np.diff(outputs[0].points, axis=1), axis=-1)
        np.testing.assert_allclose(lengths - RIGID_LINKS_M, 0, atol=1e-5)
        np.testing.assert_array_equal(outputs[0].points[:, 0], 0)

    def test_points_of_the_pcc_model_are_no_further_apart_than_along_the_chain(self, outputs):
        points = outputs[1].points
        np.testing.assert_allclose(np.linalg.norm(points[:, 0], axis=-1), 0.0285, atol=1e-6)
        apart = np.linalg.norm(np.diff(points, axis=1), axis=-1)
        along = np.array([0.0685, *[0.08] * 6])
        assert (apart < along + 1e-6).all()
        np.testing.assert_allclose(apart.max(axis=0), along, atol=1e-5)  # straight at some time

    def test_times_are_those_of_replays(self, outputs):
        rigid, pcc = (output.replay_s[-1] for output in outputs)
        assert (round(rigid), round(pcc)) == (249, 1242)
