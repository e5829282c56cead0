"""The ratio of regenerated to printed errors of Table 1, and what its verdicts can tell, on made-up cells."""

import math

import pandas as pd
import pytest

from edition1_companion.book.scorecard import ScorecardRow
from edition1_companion.book.verdict_table import VerdictTable
from edition1_companion.book.verdicts import Verdict
from edition1_companion.pages.table_1.scorecard import bias_by_factor, bias_table, scorecard_rows


def cell(row, quantity, printed, errors, unit="%"):
    """Return the printed cell, and the errors of its seeds."""
    key = {"row": row, "quantity": quantity, "unit": unit}
    seeds = [key | {"seed": seed, "error": error} for seed, error in enumerate(errors)]
    return key | {"published": printed, "published_std": 1.0}, seeds


def test_bias_of_made_up_cells():
    """By hand: means over print are 1/2, 2 and 1/4; single seeds are 1/4 to 3/4, and so on."""
    cells = [
        cell("n_b=1", "delta_x_1", 4.0, [1.0, 3.0]),
        cell("n_b=3", "delta_x_1", 1.0, [1.0, 3.0]),
        cell("n_b=3", "delta_y_1", 8.0, [1.0, 3.0]),
        cell("n_s=6", "delta_y_1", 1.0, [100.0, 300.0]),  # not observable
        cell("n_b=1", "e_u", 1.0, [100.0, 300.0], "mT"),
    ]
    published = pd.DataFrame([printed for printed, _ in cells])
    twice = pd.concat([published, published.assign(row="nominal")])  # another name of n_b=3, without errors
    table = bias_table(pd.DataFrame([line for _, seeds in cells for line in seeds]), twice)
    assert table["n_b"].tolist() == ["1", "3", "all"]
    assert table["cells"].tolist() == [1, 2, 3]
    assert table["below"].tolist() == [1, 1, 2]
    assert table["ratio"].tolist() == pytest.approx([0.5, math.sqrt(2 / 4), 0.25 ** (1 / 3)])
    assert table["lowest_seed"].tolist() == pytest.approx([1 / 4, (1 / 8) ** 0.5, (1 / 32) ** (1 / 3)])
    assert table["highest_seed"].tolist() == pytest.approx([3 / 4, (9 / 8) ** 0.5, (27 / 32) ** (1 / 3)])
    assert table["std_ratio"].tolist() == pytest.approx([math.sqrt(2)] * 3)


def test_bias_of_a_changed_factor_stands_beside_that_of_the_recipe():
    """Of the recipe 1/2 and 2, of a factor tried with one robot 1/4; robots in an Earth field are no part."""
    cells = [
        cell("n_b=1", "delta_x_1", 4.0, [1.0, 3.0]),
        cell("n_b=2", "delta_x_1", 1.0, [1.0, 3.0]),
        cell("n_e=(1,0,0)", "delta_x_1", 1.0, [40.0, 50.0]),
    ]
    printed = pd.DataFrame([printed for printed, _ in cells])
    errors = pd.DataFrame([line for _, seeds in cells for line in seeds])
    other = errors[errors["row"] == "n_b=1"].assign(factor="other", error=[0.5, 1.5])
    table = bias_by_factor(errors, other, printed)
    assert table["changed"].tolist() == ["nothing", "other", "nothing"]
    assert table["n_b"].tolist() == ["1", "1", "2"]
    assert table["ratio"].tolist() == pytest.approx([1 / 2, 1 / 4, 2.0])


def row(published, regenerated, verdict):
    texts = dict.fromkeys(("paper", "artefact", "row", "quantity", "unit", "n_seeds", "setting"), "")
    texts |= dict.fromkeys(("best", "best_method", "note"), "")
    numbers = {"published": published, "regenerated": regenerated, "regenerated_std": ""}
    band_of_3 = {"published_std": str(3**0.5)}
    return ScorecardRow(**texts, **numbers, **band_of_3, verdict=verdict, weak=False, near_edge=False)


def test_what_the_verdict_would_be_had_the_numbers_been_others():
    """Bands of half a width of 3 around 10 and 4; what is not compared does not count."""
    rows = [
        row("10", "9", Verdict.REPRODUCED),
        row("4", "3", Verdict.REPRODUCED),
        row("10", "9", Verdict.NOT_COMPARABLE),
    ]
    table = VerdictTable(rows).if_scaled(0.5, 1.0, 2.0)
    assert table["reproduced"].tolist() == [1, 2, 1]
    assert table["compared"].tolist() == [2, 2, 2]
    assert VerdictTable(rows).band_percent() == pytest.approx((30 + 75) / 2)


def test_a_slip_in_print_is_not_compared():
    """Section 3.5 prints 3.3 for the mean of 18 cells that give 4.2."""
    errors = [
        {"row": name, "seed": seed, "quantity": "delta_x_1", "unit": "%", "error": 4.2}
        for name in ("psi_s=10deg", "d_s_r=16mm")
        for seed in (0, 1)
    ]
    *others, claim = scorecard_rows(pd.DataFrame(errors))
    assert claim["artefact"] == "Section 3.5"
    assert claim["comparable"] is False
    assert "slip" in claim["note"]
    assert all(line.get("comparable", True) for line in others)
