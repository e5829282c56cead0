"""Numbers and tables as a page shows and writes them."""

import math

import numpy as np
import pandas as pd
import pytest

from repro_companion import show as module
from repro_companion.show import KEY, mean_ratio, number, rows, save, show


@pytest.fixture(autouse=True)
def results(tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_RESULTS", str(tmp_path / "tables"))
    return tmp_path / "tables"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.123456, "0.123"),
        (-0.5, "−0.500"),
        (12.345, "12.3"),
        (1234.5678, "1235"),
        (100.0, "100"),
        (0.0, "0.00"),
        (0.0001, "0.000100"),
        (1.2345e-9, "1.23 × 10⁻⁹"),
        (-2.5e7, "−2.50 × 10⁷"),
        (1089, "1089"),
        (59902, "59,902"),
        (9999, "9999"),
        (-10000, "−10,000"),
        (math.nan, "–"),
        (None, "–"),
        (math.inf, "∞"),
        (np.True_, "yes"),
        ("n_b=1", "n_b=1"),
    ],
)
def test_three_significant_digits_whole_numbers_exact_and_a_dash_for_nothing(value, text):
    assert number(value) == text


def test_what_is_shown_is_what_the_file_holds(results):
    frame = pd.DataFrame({"row": ["None", "b"], "error": [1 / 3, math.nan], "count": [1, 2]})
    back = save(frame, "a")
    assert (results / "a.csv").read_text() == "row,error,count\nNone,0.3333333333,1\nb,,2\n"
    assert back["error"].to_list()[0] == 0.3333333333
    assert back["row"].to_list() == ["None", "b"]


def test_a_table_has_its_headings_and_no_markup_of_its_cells():
    frame = pd.DataFrame({"who": ["<b>", "c"], "time_s": [1234.5678, math.nan], "error": [0.5, 1e-9]})
    html = show(frame, {"time_s": "time [s]"}).to_html()
    for text in ("time [s]", "1235", "–", "0.500", "1.00 × 10⁻⁹", "&lt;b&gt;"):
        assert f">{text}<" in html
    assert show(frame).to_html() == show(frame).to_html() != show(frame.assign(error=1.0)).to_html()


def test_rows_of_the_scorecard_have_its_columns(results):
    row = dict.fromkeys(KEY, "a") | {"regenerated": 1 / 3, "setting": "s", "n_seeds": 3, "comparable": False}
    rows(pd.DataFrame([row, row | {"row": "b", "n_seeds": None, "comparable": True}]), "a")
    lines = (results / "a.rows.csv").read_text().splitlines()
    assert lines[0] == ",".join(module.ROW_COLUMNS)
    assert lines[1:] == ["a,a,a,a,a,0.3333333333,,3,s,,,,false", "a,a,b,a,a,0.3333333333,,,s,,,,true"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"regenerated": math.nan}, "A row of a has no regenerated"),
        ({"setting": None}, "A row of a has no setting"),
        ({"colour": "red"}, "columns that the scorecard does not know: colour"),
    ],
)
def test_rows_that_the_scorecard_cannot_use_are_refused(change, message):
    row = dict.fromkeys(KEY, "a") | {"regenerated": 1.0, "setting": "s"}
    with pytest.raises(ValueError, match=message):
        rows(pd.DataFrame([row | change]), "a")


def test_a_page_regenerates_a_number_once():
    row = dict.fromkeys(KEY, "a") | {"regenerated": 1.0, "setting": "s"}
    with pytest.raises(ValueError, match="a regenerates a number twice"):
        rows(pd.DataFrame([row, row]), "a")


@pytest.mark.parametrize(
    ("values", "reference", "expected"),
    [
        # Paired draws: what they have in common leaves no doubt of a ratio, not even in columns.
        ([1.5, 3.0, 6.0, 12.0], [1.0, 2.0, 4.0, 8.0], [1.5, 1.5]),
        ([[3.0, 3.0], [1.0, 6.0]], [[1.0, 1.0], [3.0, 2.0]], [[1 / 3, 3], [3, 3]]),
        # One of 27 resamples has a draw of three alone, which is more than the fortieth left out at either end.
        ([1.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0, 1]),
        ([1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [0, 1]),
        # One of 98 resamples of five has two of them alone, which is less; the mean of ratios would be 4/5.
        ([1.0, 1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 3.0, 3.0, 3.0], [0, 4 / 7]),
    ],
)
def test_the_interval_of_a_ratio_is_paired_and_leaves_out_a_fortieth_at_either_end(
    values, reference, expected
):
    ratio, *ends = mean_ratio(np.array(values), np.array(reference))
    np.testing.assert_allclose(ratio, np.mean(values, axis=0) / np.mean(reference, axis=0), rtol=1e-12)
    np.testing.assert_allclose(ends, expected, rtol=1e-12)
