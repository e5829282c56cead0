"""Rows of the scorecard: every printed number once, in its unit, and none comparable."""

import numpy as np
import pandas as pd
import pytest
from short_arm import DATA

from edition1_companion.book.published import read_published, row_key
from edition1_companion.book.results import write_scorecard_rows
from edition1_companion.book.verdict_table import verdict_table
from edition1_companion.pages.imu_markers.scorecard import (
    CAPABILITY,
    SETTING,
    scorecard_rows,
    three_ways,
    time_rows,
)
from edition1_companion.twins.arm_markers import EVALUATIONS, FILES, QUANTILES, cases

PUBLISHED = DATA / "published" / "published.csv"


@pytest.fixture
def table():
    """Errors that say where they come from: 100 for M1, 200 for M2, twice that for Q3, ten more per draw."""
    lines = []
    for number in (0, 1):
        for case in cases():
            for evaluation in EVALUATIONS:
                for marker, base in (("M1", 100.0), ("M2", 200.0)):
                    scale = 0.5 if case.model == "pcc" else 1.0
                    median = scale * (base + 10 * number) * (1 if evaluation == FILES else 3)
                    values = dict.fromkeys(QUANTILES, median) | {"q75_mm": 2 * median}
                    keys = (
                        case.figure,
                        case.name,
                        case.model,
                        case.n_imus,
                        case.segments,
                        evaluation,
                        marker,
                    )
                    names = ("figure", "case", "model", "n_imus", "segments", "evaluation", "marker")
                    lines.append({"draw": number} | dict(zip(names, keys, strict=True)) | values)
    return pd.DataFrame(lines)


def by_key(rows):
    return {(row["artefact"], row["row"], row["quantity"], row["unit"]): row for row in rows}


def test_every_printed_number_once(table):
    benchmark = pd.DataFrame({"capability": ["other", CAPABILITY], "figure": [1.0, 8e4]})
    rows = scorecard_rows(table) + time_rows(benchmark)
    keys = [row_key(row) for row in rows]
    printed = [key for key in read_published(PUBLISHED) if key.paper == "martin2022"]
    assert sorted(keys) == sorted(printed)
    assert not any(row["comparable"] for row in rows if row["quantity"] != "time")
    assert {row["setting"] for row in rows} == {SETTING, "benchmark"}


def test_units_and_draws(table):
    rows = by_key(scorecard_rows(table))
    in_percent = rows["Table II", "M1 rigid-body", "median", "%"]
    assert in_percent["regenerated"] == pytest.approx(105 / 3.6)
    assert in_percent["regenerated_std"] == pytest.approx(np.sqrt(50) / 3.6)
    assert in_percent["n_seeds"] == 2
    assert rows["Table II", "M2 PCC-extended", "q3", "%"]["regenerated"] == pytest.approx(205 / 6)
    assert rows["Fig. 3", "M2 rigid-body 4 IMUs", "q3", "mm"]["regenerated"] == pytest.approx(410)
    more = rows["Fig. 4", "M1 PCC-extended 16 segments and more", "q3", "%"]
    assert more["regenerated"] == pytest.approx(105 / 3.6)
    assert "as described 87.5; same point 87.5" in more["note"]
    reduction = rows["Section IV-A", "PCC-extended error against rigid-body", "reduction", "%"]
    assert reduction["regenerated"] == pytest.approx(50)


def test_best_is_the_calibrated_spline_over_all_modes(table):
    best = pd.DataFrame({
        "method": ["spline + all", "spline + all", "spline + all", "PCC-16"],
        "mode": ["all", "all", "buckling", "all"],
        "point_mm": [600.0, 360.0, 600.0, 600.0],
        "median_mm": [6.0, 3.6, 60.0, 600.0],
        "q75_mm": [12.0, 7.2, 60.0, 600.0],
    })  # fmt: skip
    rows = by_key(scorecard_rows(table, best))
    assert rows["Table II", "M2 PCC-extended", "median", "%"]["best"] == pytest.approx(1)
    assert rows["Section IV-C", "M1 PCC-extended 8 IMUs 16 segments", "q3", "mm"]["best"] == pytest.approx(
        7.2
    )
    assert "best" not in rows["Table II", "M2 rigid-body", "median", "%"]


def test_time_is_that_of_8000_samples():
    rows = time_rows(pd.DataFrame({"capability": [CAPABILITY], "figure": [1e5]}))
    assert rows[0]["regenerated"] == pytest.approx(0.08)
    assert time_rows(pd.DataFrame({"capability": ["other"], "figure": [1e5]})) == []


def test_cases_that_were_not_run_are_left_out(table):
    rows = scorecard_rows(table[table["n_imus"] == 2])
    assert {row["row"].split()[-2:][0] for row in rows} == {"2"}
    assert len(rows) == 9


def test_three_ways_beside_the_paper(table):
    ways = three_ways(table, pd.read_csv(PUBLISHED)).set_index(["artefact", "row", "quantity"])
    line = ways.loc[("Section IV-B", "M1 rigid-body 2 IMUs", "median")]
    assert line["paper"] == 44.4
    np.testing.assert_allclose([line[way] for way in EVALUATIONS], np.array([315, 105, 315]) / 3.6)


def test_no_row_can_be_compared(table, tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_RESULTS_DIR", str(tmp_path))
    write_scorecard_rows(scorecard_rows(table), "imu")
    rows = [row for row in verdict_table("imu", "Table II").rows if row.paper == "martin2022"]
    assert len(rows) == 8
    assert {row.verdict.value for row in rows} == {"not_comparable"}
