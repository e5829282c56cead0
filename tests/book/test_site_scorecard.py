"""The scorecard of the built site, in a real browser: run with ``make check-site`` after ``make book``."""

from __future__ import annotations

import pytest
from built_site import SITE, no_site, url_of
from page_visit import open_page

pytestmark = no_site
ROWS = "table.cards tbody"


def test_scorecard_filter(browser):
    """Keys alone narrow the rows down; the count says so aloud; without the script every row is there."""
    page, seen = open_page(browser, url_of("scorecard.html"))
    try:
        total = page.locator(ROWS).count()
        count = page.get_by_role("status").filter(has_text="rows")
        assert count.inner_text().startswith(f"{total} of {total} rows")
        page.locator("select[name=verdict]").focus()
        page.keyboard.type("differs")
        shown = page.locator(f"{ROWS}:visible")
        differ = page.locator("tbody[data-verdict=differs]").count()
        assert shown.count() == differ
        assert count.inner_text().startswith(f"{differ} of {total} rows: {differ} differ")
        for caption in page.locator("table.cards:visible caption:has(.part:not(:empty))").all():
            assert not caption.locator(".whole").is_visible(), "a caption speaks of rows that are not shown"
        page.get_by_label("Text").fill("no such row anywhere")
        assert shown.count() == 0
        assert count.inner_text() == f"0 of {total} rows."
        page.get_by_role("button", name="Clear").press("Enter")
        page.wait_for_function("() => !document.querySelector('tbody[hidden]')")
        assert seen.console == []
    finally:
        page.close()
    assert (
        "hidden"
        not in (SITE / "scorecard.html").read_text(encoding="utf-8").split("scorecard-filter")[1][:20_000]
    )


@pytest.mark.parametrize(
    ("order", "key", "falling"),
    [("low", "ratio", False), ("high", "ratio", True), ("band", "away", True), ("verdict", "verdict", False)],
)
def test_scorecard_order(order, key, falling, browser):
    """Rows of all papers in one order, chosen by keys and kept in the address; what has no number comes last."""
    page, seen = open_page(browser, url_of("scorecard.html"))
    try:
        in_file = page.locator(ROWS).evaluate_all("rows => rows.map(row => row.id)")
        page.locator("select[name=order]").focus()
        page.locator("select[name=order]").select_option(order)
        assert page.url.endswith(f"?order={order}")
        page.reload()
        shown = page.locator(f"{ROWS}:visible")
        assert shown.count() == len(in_file)
        assert shown.first.locator(".from").is_visible()
        values = shown.evaluate_all("(rows, key) => rows.map(row => row.dataset[key])", key)
        if key == "verdict":
            assert values == sorted(values, key=list(dict.fromkeys(values)).index)
        else:
            numbers = [float(value) for value in values if value]
            assert numbers == sorted(numbers, reverse=falling)
            assert not any(values[len(numbers) :])
        page.locator("select[name=order]").select_option("")
        assert page.locator(ROWS).evaluate_all("rows => rows.map(row => row.id)") == in_file
        assert seen.console == []
    finally:
        page.close()


def test_rows_are_folded_table_by_table(browser):
    """On a telephone the page is a few screens, not thirty; a table opens by keys."""
    page, _ = open_page(browser, url_of("scorecard.html"), width=390)
    try:
        assert page.evaluate("document.documentElement.scrollHeight") < 8000
        folds = page.locator(".published-table")
        assert folds.count() == page.locator("table.cards[data-paper]").count()
        assert page.locator(f"{ROWS}:visible").count() == 0
        folds.last.locator("summary").press("Enter")
        assert page.locator(f"{ROWS}:visible").count() == folds.last.locator("tbody").count() > 0
    finally:
        page.close()


def test_link_to_a_row_opens_it(browser):
    """The row is on the screen and marked, even where the filter of the same address hides it."""
    page, _ = open_page(browser, url_of("scorecard.html"))
    try:
        row = page.locator("tbody[data-verdict=reproduced]").last.get_attribute("id")
    finally:
        page.close()
    page, seen = open_page(browser, f"{url_of('scorecard.html')}?verdict=differs#{row}", width=390)
    try:
        opened = page.locator(f"#{row}")
        assert "opened" in (opened.get_attribute("class") or "")
        box = opened.bounding_box()
        assert box
        assert 0 <= box["y"] <= 900 - box["height"]
        assert page.locator("select[name=verdict]").input_value() == ""
        for cell in (2, 4):  # regenerated, verdict
            seen_box = opened.locator("tr >> nth=0").locator("th, td").nth(cell).bounding_box()
            assert seen_box
            assert seen_box["x"] >= 0
            assert seen_box["x"] + seen_box["width"] <= 390
        assert seen.console == []
    finally:
        page.close()


def test_dots_name_themselves(browser):
    """A dot under the pointer or with the focus says which number it is; the arrows go on; Enter opens its row."""
    page, seen = open_page(browser, url_of("scorecard.html"))
    try:
        dots = page.locator(".scorecard-picture a")
        rows = page.locator(ROWS)
        assert dots.count() == rows.count()
        said = page.locator(".scorecard-dot")
        dots.nth(5).hover(force=True)
        hovered = said.inner_text()
        assert rows.nth(5).locator("td").nth(0).text_content() in hovered
        page.locator(".scorecard-picture a[tabindex='0']").focus()
        page.keyboard.press("ArrowRight")
        name = said.inner_text()
        assert name.startswith(page.locator(".published-table .title").first.text_content())
        for cell in (0, 1, 3):
            assert rows.nth(1).locator("td").nth(cell).text_content() in name
        page.keyboard.press("Enter")
        page.wait_for_selector("tbody.opened")
        assert page.locator("tbody.opened").get_attribute("id") == rows.nth(1).get_attribute("id")
        assert seen.console == []
    finally:
        page.close()
