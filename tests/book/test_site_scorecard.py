"""The scorecard of the built site, in a real browser: run with ``make check-site`` after ``make book``."""

from __future__ import annotations

import pytest
from built_site import SITE, no_site, url_of
from page_visit import open_page

pytestmark = no_site
ROWS = "table.cards tbody"


def test_scorecard_filter(browser):
    """Keys alone narrow the rows down, and the count says so aloud; without the script every row is there."""
    with open_page(browser, url_of("scorecard.html")) as (page, seen):
        total = page.locator(ROWS).count()
        count = page.get_by_role("status").filter(has_text="rows")
        assert count.inner_text() == f"{total} of {total} rows."
        page.locator("select[name=verdict]").focus()
        page.keyboard.type("differs")
        shown = page.locator(f"{ROWS}:visible")
        differ = page.locator("tbody[data-verdict=differs]").count()
        assert shown.count() == differ > 0
        assert count.inner_text() == f"{differ} of {total} rows."
        assert page.url.endswith("?verdict=differs"), "the address keeps the choice"
        page.get_by_label("Text").fill("no such row anywhere")
        assert shown.count() == 0
        assert count.inner_text() == f"0 of {total} rows."
        page.get_by_role("button", name="Clear").press("Enter")
        page.wait_for_function("() => !document.querySelector('tbody[hidden]')")
        assert page.locator("select[name=verdict]").input_value() == ""
        assert seen.console == []
    text = (SITE / "scorecard.html").read_text(encoding="utf-8").split("scorecard-filter")[1]
    assert "hidden" not in text[: text.rindex("</tbody>")]


def test_rows_are_folded_table_by_table(browser):
    """A table opens by keys."""
    with open_page(browser, url_of("scorecard.html"), width=390) as (page, _):
        assert page.locator(f"{ROWS}:visible").count() == 0
        fold = page.locator("details:has(table.cards)").last
        fold.locator("summary").press("Enter")
        assert page.locator(f"{ROWS}:visible").count() == fold.locator("tbody").count() > 0


def test_the_counts_come_first_and_the_index_next(browser):
    """They are in the first screen, with a link to the index, in which the folds of equations are shut."""
    with open_page(browser, url_of("scorecard.html")) as (page, _):
        for first in ("main table a[href*='verdict=']", "main p a[href='#index-of-the-papers']"):
            assert page.locator(first).first.bounding_box()["y"] < 900
        assert page.locator("details[open]:has(table.paper-index)").count() == 0


@pytest.mark.parametrize("width", [1400, 390])
def test_a_verdict_of_the_index_leads_to_its_rows(width, browser):
    """They are on the screen, and no others are."""
    with open_page(browser, url_of("scorecard.html"), width=width) as (page, seen):
        link = page.locator("table.paper-index a[href*='artefact=Table+2']")
        link.click()
        page.wait_for_url("**?paper=*#all-rows")
        page.wait_for_load_state()
        first = page.locator(f"{ROWS}:visible").first
        assert first.evaluate("row => row.parentElement.dataset.artefact") == "Table 2"
        assert 0 < first.bounding_box()["y"] < 900
        assert seen.console == []


def test_link_to_a_row_opens_it(browser):
    """The row is on the screen and marked, even where the filter of the same address hides it."""
    with open_page(browser, url_of("scorecard.html")) as (page, _):
        row = page.locator("tbody[data-verdict=reproduced]").last.get_attribute("id")
    with open_page(browser, f"{url_of('scorecard.html')}?verdict=differs#{row}", width=390) as (page, seen):
        opened = page.locator(f"#{row}:target")
        box = opened.bounding_box()
        assert 0 <= box["y"] <= 900 - box["height"]
        assert page.locator("select[name=verdict]").input_value() == ""
        for cell in (2, 4):  # regenerated, verdict
            seen_box = opened.locator("tr >> nth=0").locator("th, td").nth(cell).bounding_box()
            assert seen_box["x"] >= 0
            assert seen_box["x"] + seen_box["width"] <= 390
        assert seen.console == []
