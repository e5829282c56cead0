"""The method cell of the page on Table 1: the value of its cell of the table, from few modules of the library."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from edition1_companion.twins import table_1_method as table1
from edition1_companion.twins.table_1_rows import rows_named

ROOT = Path(__file__).parents[4]
MOST_MODULES = 8


@pytest.fixture(scope="module")
def cells():
    notebook = json.loads((ROOT / "notebooks" / "table_1.ipynb").read_text(encoding="utf-8"))
    return {cell["id"]: "".join(cell["source"]) for cell in notebook["cells"]}


def test_method_cell_gives_the_errors_of_the_table_from_few_modules(cells):
    folder, steps = ROOT / "data" / "networks", 30
    errors = table1.run(rows_named(["n_b=1"]), (0, 1), folder, steps=steps, jobs=1)
    page = {"folder": folder, "steps": steps, "errors": errors}
    for name in ("table-1-01", "table-1-02", "table-1-method-data"):
        exec(cells[name], page)
    method = compile(cells["table-1-method"], "method cell", "exec")
    entered = set()

    def note(frame, event, _):
        if event == "call":
            entered.add(frame.f_globals.get("__name__", ""))

    sys.setprofile(note)
    try:
        exec(method, page)
    finally:
        sys.setprofile(None)
    library = {name for name in entered if name.split(".")[0] == "edition1"}
    companion = {name for name in entered if name.startswith("edition1_companion")}
    assert "edition1.estimation.gradient_descent" in library
    assert len(library) <= MOST_MODULES, sorted(library)
    assert all(name.startswith("edition1_companion.pages.table_1") for name in companion)
    assert "edition1.kernels" not in library  # the reference in torch
    np.testing.assert_allclose(page["errors_here"], errors.query("seed == 0")["error"], rtol=1e-3)


def test_method_cell_is_short(cells):
    code = [line for line in cells["table-1-method"].splitlines() if line.strip()]
    assert len(code) <= 25
