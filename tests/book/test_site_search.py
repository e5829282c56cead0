"""The search of Sphinx: every table and figure of the papers has an entry for it, and is found in a browser."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pandas as pd
import pytest
from built_site import no_site, url_of
from page_visit import open_page

PROJECT = Path(__file__).resolve().parents[2]
PAPERS = {
    "baaij2023": "Baaij et al. 2023",
    "mitchell2021": "Mitchell et al. 2021",
    "martin2022": "Martin et al. 2022",
}
INDEX = pd.read_csv(PROJECT / "data/published/index.csv", dtype=str, keep_default_na=False)
ENTRIES = INDEX[INDEX["kind"].isin(["table", "figure"])].to_dict("records")


def index_entries(page: str) -> set[str]:
    """Return what the ``{index}`` directive of a page names."""
    notebook = PROJECT / f"{page}.ipynb"
    if notebook.is_file():
        cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
        text = "".join(cells[0]["source"])
    else:
        text = (PROJECT / "book" / f"{page}.md").read_text(encoding="utf-8")
    named = re.findall(r"^```\{index\} (.+)\n```$", text, re.MULTILINE)
    return {entry.removeprefix("! ") for names in named for entry in names.split(", ")}


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: f"{entry['paper']}-{entry['artefact']}")
def test_every_table_and_figure_has_an_entry(entry):
    """The search drops numbers that stand in no entry. Of "Fig. 11, upper row" the figure is the entry."""
    name = entry["artefact"].split(",")[0]
    assert f"{name}; {PAPERS[entry['paper']]}" in index_entries(entry["page"])


@no_site
@pytest.mark.parametrize(
    ("query", "pages"),
    [
        ("Table 2", ["notebooks/table_2.html"]),
        ("Table II", ["notebooks/imu_markers.html"]),
        ("Fig. 9", ["notebooks/table_2.html", "notebooks/bend_tests.html"]),
        ("Fig 9", ["notebooks/table_2.html", "notebooks/bend_tests.html"]),
        ("install", ["index.html"]),
        ("how to install", ["index.html"]),
        ("tip error", ["notebooks/own_robot.html"]),
        ("time per step", ["notebooks/live.html"]),
        ("recordings", ["commands.html"]),
        ("MLX90393", ["robot_file.html"]),
        ("step size", ["notebooks/table_1.html"]),
    ],
)
def test_the_right_page_is_found_first(query, pages, browser):
    """Two papers have a Fig. 9: both pages come before any other."""
    with open_page(browser, url_of("search.html")) as (tab, seen):
        field = tab.locator(".bd-search-container form.bd-search input")
        field.fill(query)
        field.press("Enter")
        links = tab.locator("#search-results ul.search a")
        links.first.wait_for()
        found = [links.nth(k).get_attribute("href").partition("#")[0] for k in range(len(pages))]
        assert set(found) == set(pages)
        assert seen.asked_outside() == []
