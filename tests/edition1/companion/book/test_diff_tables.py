"""Which rows of two tables belong together, and how far their numbers differ."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from edition1_companion.book.after.diff_tables import OCCURRENCE, compare_tables, read_csv
from hypothesis import given
from hypothesis import strategies as st

LABELS = pd.DataFrame(
    {"row": ["a", "a", "b"], "seed": [0, 1, 0], "error_mm": [1.0, 2.0, 4.0], "kind": ["x", "y", "z"]}
)


def test_a_table_is_identical_to_itself():
    same = compare_tables("t", LABELS, LABELS.copy())
    assert same.identical
    assert same.keys == ["row", "seed"]
    assert same.changed == []


def test_labels_match_whatever_the_order():
    run = LABELS.iloc[[2, 0, 1]].assign(error_mm=[5.0, 1.0, 2.0])
    found = compare_tables("t", LABELS, run)
    assert found.changed == ["error_mm"]
    assert list(found.difference("error_mm")) == [0.0, 0.0, 1.0]
    assert list(found.relative("error_mm")) == [0.0, 0.0, 0.25]
    assert list(found.differs("error_mm")) == [False, False, True]
    assert not found.is_number("kind")


def test_rows_without_a_counterpart_are_told():
    run = pd.concat(
        [LABELS.iloc[1:], pd.DataFrame({"row": ["c"], "seed": [0], "error_mm": [9.0], "kind": ["x"]})]
    )
    found = compare_tables("t", LABELS, run)
    assert found.only_book.to_dict("list") == {"row": ["a"], "seed": [0], "error_mm": [1.0], "kind": ["x"]}
    assert list(found.only_run["row"]) == ["c"]
    assert len(found.run) == 2
    assert not found.identical


def test_times_match_by_value_and_equal_labels_by_order():
    book = pd.DataFrame({"time_s": [0.0, 0.5, 1.0], "x_mm": [1.0, 2.0, 3.0]})
    found = compare_tables("t", book, book.iloc[::2])
    assert found.keys == ["time_s"]
    assert list(found.only_book["time_s"]) == [0.5]
    assert found.changed == []

    # wherever the time stands; a measured first column is no label although each value occurs once
    book = pd.DataFrame({"x_mm": [3.0, 1.0, 2.0], "time_s": [0.0, 0.5, 1.0]})
    assert compare_tables("t", book, book).keys == ["time_s"]
    assert compare_tables("t", book[["x_mm"]], book[["x_mm"]]).keys == []

    book = pd.DataFrame({"shape": [1, 1, 2], "x_mm": [1.0, 2.0, 3.0]})
    found = compare_tables("t", book, book.assign(x_mm=[1.0, 2.5, 3.0]))
    assert found.keys == ["shape"]
    assert list(found.run.index.get_level_values(OCCURRENCE)) == [0, 1, 0]
    assert list(found.difference("x_mm")) == [0.0, 0.5, 0.0]

    book = pd.DataFrame({"x_mm": [1.0, 1.0]})
    found = compare_tables("t", book, pd.DataFrame({"x_mm": [1.0, 2.0]}))
    assert found.keys == []
    assert list(found.difference("x_mm")) == [0.0, 1.0]


def test_missing_cells_infinities_and_zero():
    book = pd.DataFrame({"n": range(6), "v": [np.nan, np.nan, 1.0, np.inf, 0.0, 0.0]})
    run = pd.DataFrame({"n": range(6), "v": [np.nan, 1.0, np.nan, np.inf, 0.0, 2.0]})
    found = compare_tables("t", book, run)
    assert list(found.differs("v")) == [False, True, True, False, False, True]
    assert np.array_equal(found.difference("v"), [np.nan, np.nan, np.nan, 0.0, 0.0, 2.0], equal_nan=True)
    assert np.array_equal(found.relative("v"), [np.nan, np.nan, np.nan, 0.0, 0.0, np.nan], equal_nan=True)


def test_columns_and_kinds_that_changed():
    found = compare_tables("t", LABELS, LABELS.drop(columns="kind").assign(more=1))
    assert found.other_columns == ["kind", "more"]
    assert not found.identical
    # numbers in one table, words in the other: never matched as labels, and shown as different
    found = compare_tables("t", pd.DataFrame({"n": [1, 2]}), pd.DataFrame({"n": ["1", "two"]}))
    assert found.changed == ["n"]
    assert not found.is_number("n")


def test_empty_tables(tmp_path):
    (tmp_path / "t.csv").write_text("")
    empty = read_csv(tmp_path / "t.csv")
    assert compare_tables("t", empty, empty).identical
    found = compare_tables("t", LABELS, empty)
    assert len(found.only_book) == 3
    (tmp_path / "t.csv").write_text("label,n\nNone,1\nn/a,2\n")
    assert list(read_csv(tmp_path / "t.csv")["label"]) == ["None", "n/a"]


rows = st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 2), st.floats(-1e6, 1e6)), max_size=8)


@given(rows, rows)
def test_no_row_is_lost_and_differences_change_sign(one, other):
    """Every row is matched or told as without counterpart; exchanging the tables negates the differences."""
    tables = [pd.DataFrame(part, columns=["label", "seed", "v"]) for part in (one, other)]
    tables = [t.astype({"label": str, "seed": int, "v": float}) for t in tables]
    found, back = compare_tables("t", *tables), compare_tables("t", *tables[::-1])
    assert len(found.book) + len(found.only_book) == len(one)
    assert len(found.run) + len(found.only_run) == len(other)
    assert sorted(found.difference("v")) == pytest.approx(sorted(-back.difference("v")))
