"""The Table 1 page: what is drawn is what the tables hold."""

import numpy as np
import pandas as pd
import pytest

from edition1.errors import InputError
from edition1_companion.book.results import write_scorecard_rows
from edition1_companion.book.verdict_table import verdict_table
from edition1_companion.pages.table_1.figures import (
    calibration_gain,
    descents,
    model_by_solver,
    published_and_regenerated,
)

ROW = {"paper": "baaij2023", "artefact": "Table 1", "row": "n_b=1", "setting": "synthetic test values"}


@pytest.fixture
def written(tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_RESULTS_DIR", str(tmp_path))
    cells = [("e_u", "mT", 0.0149), ("delta_x_1", "%", 1.2), ("delta_y_1", "%", 9.0)]
    rows = [ROW | {"quantity": q, "unit": u, "regenerated": x, "note": "a note"} for q, u, x in cells]
    claim = {
        "artefact": "Section 3.5",
        "row": "tilted and shifted sensors mean error",
        "quantity": "mean",
        "unit": "%",
    }
    rows.append(ROW | claim | {"regenerated": 3.2})
    write_scorecard_rows(rows, "table_1")


def test_table_lists_every_published_number_with_its_verdict(written):
    table = verdict_table("table_1", "Table 1")
    verdicts = {row.quantity: row.verdict.value for row in table.rows if row.row == "n_b=1"}
    assert verdicts == {
        "e_u": "reproduced", "delta_x_1": "reproduced", "delta_y_1": "differs", "delta_L_1": "missing",
    }  # fmt: skip
    html = table._repr_html_()
    assert html.count("<tbody") == 4 + 7 + 11 * 10  # every number of Table 1
    assert "verdict-differs" in html
    assert "differs" in repr(table)


def test_cells_are_the_regenerated_numbers_of_a_unit(written):
    cells = verdict_table("table_1", "Table 1").cells("%")
    assert cells["regenerated"].tolist() == [1.2, 9.0]
    assert cells["published"].tolist() == [1.7, 1.8]
    assert cells["best"].isna().all()


def test_table_that_was_not_written_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_RESULTS_DIR", str(tmp_path))
    with pytest.raises((InputError, FileNotFoundError), match="table_1"):
        verdict_table("table_1", "Table 1")


def test_cells_are_drawn_beside_each_other(written):
    figure = published_and_regenerated(verdict_table("table_1", "Table 1").cells("%"))
    panel = figure.axes[0]
    drawn = [line.get_ydata().tolist() for line in panel.lines if len(line.get_ydata()) == 2]
    assert [1.7, 1.8] in drawn
    assert [1.2, 9.0] in drawn


def test_every_seed_is_a_point():
    table = pd.DataFrame(
        {
            "model": ["fast network"] * 2 + ["multipole"],
            "solver": ["gradient descent", "gradient descent", "Levenberg-Marquardt"],
            "configuration_percent": [0.3, 0.2, 1e-5],
            "tip_mm": [0.4, 0.3, 1e-5],
        }
    )
    left, _ = model_by_solver(table).axes
    assert [line.get_ydata().tolist() for line in left.lines] == [[0.3, 0.2], [1e-5]]


def test_gain_is_drawn_with_its_interval():
    summary = pd.DataFrame(
        {
            "row": ["n_b=1", "n_b=2"],
            "calibrated_percent": [0.3, 0.2],
            "uncalibrated_percent": [5.0, 6.0],
            "ratio": [0.06, 0.033],
            "ratio_low": [0.05, 0.02],
            "ratio_high": [0.08, 0.05],
        }
    )
    _, right = calibration_gain(summary).axes
    np.testing.assert_allclose(right.lines[0].get_xdata(), [0.06, 0.033])


def test_paths_of_both_solvers_are_drawn_in_the_bend():
    truth, sides = np.array([0.001, 0.002, 0.003]), np.linspace(-0.02, 0.02, 5)
    away = {"gradient descent": [10, 5, 2.5], "Levenberg-Marquardt": [10, 0, 0]}
    paths = {n: truth + 1e-3 * np.outer(mm, [0.6, 0.8, 7.0]) for n, mm in away.items()}
    (panel,) = descents(sides, np.add.outer(sides**2, sides**2), paths, truth).axes
    drawn = {line.get_label(): line.get_xydata() for line in panel.lines}
    for name, path in paths.items():
        np.testing.assert_allclose(drawn[name], 1e3 * path[:, :2])
