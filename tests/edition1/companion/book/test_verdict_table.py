"""A table of verdicts on a page: every published number, and what this notebook regenerates of it."""

import pytest

from edition1.errors import InputError
from edition1_companion.book.results import write_scorecard_rows
from edition1_companion.book.verdict_table import verdict_table

ROW = {"paper": "baaij2023", "artefact": "Table 1", "row": "n_b=1", "setting": "synthetic test values"}


@pytest.fixture
def written(tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_RESULTS_DIR", str(tmp_path))
    cells = [("e_u", "mT", 0.0149), ("delta_x_1", "%", 1.2), ("delta_y_1", "%", 9.0)]
    rows = [ROW | {"quantity": q, "unit": u, "regenerated": x, "note": "a note"} for q, u, x in cells]
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
