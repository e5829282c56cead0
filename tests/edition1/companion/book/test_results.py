"""Tables and scorecard rows: numbers only, whole files, bad rows refused."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from edition1.errors import InputError
from edition1_companion.book.results import read_table, results_dir, write_scorecard_rows, write_table

ROW = {
    "paper": "a2020",
    "artefact": "Table 1",
    "row": "one",
    "quantity": "e_u",
    "unit": "mT",
    "regenerated": 0.0151,
    "setting": "as released",
}


def test_results_folder_by_default_is_runs(root):
    assert results_dir() == root / "runs"
    assert results_dir().is_dir()


def test_results_folder_inside_notebooks_is_runs_of_the_project(root, monkeypatch):
    monkeypatch.chdir(root / "notebooks")
    assert results_dir() == root / "runs"


def test_results_folder_from_the_environment_is_absolute(root, monkeypatch):
    monkeypatch.setenv("REPRO_RESULTS_DIR", "some/where")
    assert results_dir() == root / "some" / "where"
    assert results_dir().is_dir()


def test_a_table(root):
    table = pd.DataFrame(
        {
            "robot": ["one segment", "two"],
            "n": np.array([1, 2]),
            "error_mm": [1 / 3, math.nan],
            "error_float32": np.array([0.1, 0.25], dtype=np.float32),
            "fast": [True, False],
        }
    )
    write_table(table, "errors")
    path = root / "runs" / "errors.csv"
    assert path.read_bytes().decode() == (
        "robot,n,error_mm,error_float32,fast\n"
        "one segment,1,0.3333333333,0.1000000015,True\n"
        "two,2,,0.25,False\n"
    )
    assert [file.name for file in path.parent.iterdir()] == ["errors.csv"]


def test_row_numbers_left_by_a_selection_are_not_written(root):
    table = pd.DataFrame({"n": [1, 2, 3]})
    write_table(table[table.n > 1], "t")
    assert (root / "runs" / "t.csv").read_text() == "n\n2\n3\n"
    table.index.name = "step"
    with pytest.raises(InputError, match="must be row numbers without a name"):
        write_table(table, "t")


def test_a_table_is_read_as_it_was_written(root):
    table = pd.DataFrame({"name": ["a", "b"], "n": [1, 2], "x_mm": [0.25, math.nan], "fast": [True, False]})
    write_table(table, "t")
    pd.testing.assert_frame_equal(read_table("t"), table, check_dtype=False)
    with pytest.raises(
        InputError, match="must be a table that this notebook has written; instead received u"
    ):
        read_table("u")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (pd.DataFrame({"a": [1]}, index=["x"]), "Input index of table t must be row numbers without a name"),
        (pd.DataFrame([[1, 2]], columns=["a", "a"]), "Input columns of table t must be different"),
        (
            pd.DataFrame({"a": [pd.Timestamp("2020-01-01")]}),
            "Input value of column a of table t must be a number",
        ),
        (pd.DataFrame({"a": ["made on 2020-01-01"]}), "instead received made on 2020-01-01."),
        (pd.DataFrame({"a": ["/somewhere/else"]}), "instead received /somewhere/else."),
        (pd.DataFrame({"a": [[1, 2]]}), "instead received [1, 2]."),
        (pd.DataFrame({"a": [1j]}), "instead received 1j."),
    ],
)
def test_tables_that_are_refused(root, table, message):
    with pytest.raises(InputError) as refused:
        write_table(table, "t")
    assert message in str(refused.value)
    assert not (root / "runs" / "t.csv").exists()


@pytest.mark.parametrize("name", ["", "../up", "a b", "a.rows", "scorecard"])
def test_names_that_are_refused(root, name):
    with pytest.raises(InputError, match="Input name of a table must be"):
        write_table(pd.DataFrame({"a": [1]}), name)


def test_scorecard_rows(root):
    full = {
        **ROW,
        "row": "two",
        "regenerated_std": np.float64(0.25),
        "n_seeds": np.int64(3),
        "best": 0.01,
        "best_method": "LM, damped",
        "note": "a, b",
        "comparable": np.bool_(False),
    }
    write_scorecard_rows([ROW, full], "fields")
    assert (root / "runs" / "fields.rows.csv").read_text() == (
        "paper,artefact,row,quantity,unit,regenerated,regenerated_std,n_seeds,setting,best,best_method,note,comparable\n"
        "a2020,Table 1,one,e_u,mT,0.0151,,,as released,,,,true\n"
        'a2020,Table 1,two,e_u,mT,0.0151,0.25,3,as released,0.01,"LM, damped","a, b",false\n'
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"row": "nine"},
            "Input row of fields must be a row of published.csv; instead received a2020 / Table 1 / nine",
        ),
        ({"colour": "red"}, "Input columns of fields must be among paper, artefact, "),
        ({"regenerated": math.nan}, "must be a finite number; instead received nothing."),
        ({"regenerated": math.inf}, "must be a finite number; instead received inf."),
        ({"regenerated": "0_1"}, "must be a finite number; instead received 0_1."),
        ({"regenerated_std": -1}, "must be a finite number of 0 or more, or left out; instead received -1."),
        ({"n_seeds": 2.5}, "must be a whole number of 1 or more, or left out; instead received 2.5."),
        ({"n_seeds": 0}, "must be a whole number of 1 or more, or left out; instead received 0."),
        (
            {"setting": ""},
            "must be the setting under which the number was regenerated; instead received nothing.",
        ),
        (
            {"best": 1.0},
            "Input best_method of row a2020 / Table 1 / one / e_u / mT of fields must be given exactly",
        ),
        ({"comparable": "maybe"}, "must be true or false; instead received maybe."),
    ],
)
def test_scorecard_rows_that_are_refused(root, change, message):
    with pytest.raises(InputError) as refused:
        write_scorecard_rows([{**ROW, **change}], "fields")
    assert message in str(refused.value)


def test_a_row_given_twice_is_refused(root):
    with pytest.raises(InputError, match="Input row of fields must be given once"):
        write_scorecard_rows([ROW, ROW], "fields")
