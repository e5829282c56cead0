"""Tables of pages: every number with three digits, no machine names, nothing missing that reads as a word."""

from __future__ import annotations

import math
import re

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edition1_companion.book.formatted import heading, shown_number, shown_value, table_html


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"), (1.0, "1"), (-2.5, "−2.50"), (0.012345, "0.0123"), (43978.0, "44,000"), (0.99999, "1.00"),
        (6.938894e-09, "6.94 × 10⁻⁹"), (3.094407e06, "3,090,000"), (1e-4, "0.000100"), (math.inf, "∞"),
        (400.0, "400"), (9996.4, "10,000"), (-1000.0, "−1000"),
    ],
)  # fmt: skip
def test_numbers(value, text):
    assert shown_number(value) == text


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12))
def test_a_number_has_three_digits_and_nearly_its_value(value):
    text = shown_number(value)
    mantissa, _, power = text.replace("−", "-").replace(",", "").partition(" × 10")
    shown = float(mantissa) * 10.0 ** int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or 0)
    assert shown == pytest.approx(value, rel=5.01e-3, abs=1e-300)
    digits = re.sub(r"\D", "", mantissa).lstrip("0")
    assert len(digits.rstrip("0")) <= 3


def test_headings():
    assert heading("tip_error_mm") == "tip error [mm]"
    assert heading("share_percent") == "share [%]"
    assert heading("within") == "within"
    assert heading("m") == "m"
    assert heading("n_b") == "n_b"
    assert heading("delta_x_mm") == "Δx [mm]"
    assert heading("filter_delta_L_2_mm") == "filter δL₂ [mm]"
    assert heading("psi_s") == "ψ_s"
    assert heading("kappa of phi, -3 to 5, 2-3") == "κ of φ, −3 to 5, 2-3"
    assert heading("T5.train->T4, -0.0") == "T5.train → T4, 0.0"
    assert heading(("tip_mm", "T3")) == "tip [mm], T3"
    assert heading("row n_b=3, d_s") == "row n_b=3, d_s"


def test_cells_and_columns():
    table = pd.DataFrame(
        {"name": ["paper_network", None], "error_mt": [math.nan, 0.12345], "seed": [12345, 2]}
    )
    page = table_html(table, {"name": "sensor model"}, exact=["seed"], folded="All rows").data
    assert page.startswith("<details><summary>All rows</summary>")
    cells = re.findall(r"<t[dh](?: [^>]*)?>([^<]*)<", page)
    assert cells == ["sensor model", "error [mT]", "seed", "paper network", "–", "12345", "–", "0.123", "2"]
    assert shown_value(pd.NA) == "–"
    assert shown_value(-1e-5, exact=True) == "−1 × 10⁻⁵"
    assert shown_value(True) == "yes"
    assert "&lt;b&gt;" in table_html(pd.DataFrame({"a": ["<b>"]})).data


def test_pivoted_and_transposed_tables_keep_their_labels():
    table = pd.DataFrame({"kind": ["a", "b"], "tip_mm": [1.2345, 2.0], "n_b": [1, 2]})
    cells = re.findall(r"<t[dh](?: [^>]*)?>(.*?)</t[dh]>", table_html(table.set_index("kind").T).data)
    assert cells == ["", "a", "b", "tip [mm]", "1.23", "2", "<i>n</i><sub>b</sub>", "1", "2"]
    cells = re.findall(
        r"<t[dh](?: [^>]*)?>(.*?)</t[dh]>", table_html(table.set_index("kind")[["tip_mm"]]).data
    )
    assert cells == ["kind", "tip [mm]", "a", "1.23", "b", "2"]


def test_a_long_table_is_folded():
    assert table_html(pd.DataFrame({"n": range(16)})).data.startswith(
        "<details><summary>All 16 rows</summary>"
    )
    assert table_html(pd.DataFrame({"n": range(15)})).data.startswith('<div class="formatted" tabindex="0"')


def test_numbers_that_keep_all_digits_are_told_apart():
    """The check of the built pages asks for few digits of the others."""
    html = table_html(pd.DataFrame({"sent": [123876], "error_mm": [1.23456]}), exact=["sent"]).data
    assert '<td class="number exact">123876</td><td class="number">1.23</td>' in html


def test_of_a_wide_table_the_first_columns_are_shown_and_all_are_folded():
    table = pd.DataFrame({"name": ["a"], "low_mm": [1.0], "high_mm": [2.0], "seed": [12345]})
    shown, whole = table_html(table, first=["name", "high_mm"], exact=["seed"]).data.split("<details>")
    assert re.findall(r"<t[dh](?: [^>]*)?>([^<]*)<", shown) == ["name", "high [mm]", "a", "2"]
    assert whole.startswith("<summary>All 4 columns</summary>")
    assert "12345" in whole
