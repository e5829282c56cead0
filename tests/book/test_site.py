"""Every page of the built site, in a real browser: run with ``make check-site`` after ``make book``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

import numpy as np
import pytest
from chromium import MISSING, find, started
from page_on_screen import differing, pixels
from page_visit import FACTS, Visit, open_page, visit
from shown import MACHINE_NAME, cells_not_to_show, texts_of_picture

SITE = Path(__file__).resolve().parents[2] / "book" / "_build" / "html"
# Pages that only list source code need no browser; their links are checked with the others.
ALL_PAGES = sorted(path.relative_to(SITE).as_posix() for path in SITE.rglob("*.html"))
PAGES = [page for page in ALL_PAGES if not page.startswith("_modules/")]
WRITTEN = [page for page in PAGES if not page.startswith(("api/", "genindex"))]
"""Notebooks and pages written by hand."""
WITH_STRIPS = [page for page in WRITTEN if 'class="frame-strip"' in (SITE / page).read_text(encoding="utf-8")]
WITH_VIEWS = [page for page in WRITTEN if 'class="shape-view"' in (SITE / page).read_text(encoding="utf-8")]
EXECUTED = sorted((SITE.parents[1] / "notebooks").glob("*.ipynb"))
SMALLEST_LETTERS_PX = 5.5
"""On a telephone, without turning it or drawing the figure larger."""
VIEWER = SITE / "_static" / "shape_viewer.js"
NARROW = (390, 320)
LANDING_LIMIT_BYTES = 1_000_000
PAGE_LIMIT_BYTES = 3_000_000
"""Without 3-D views; the theme included."""
REFERENCE_LIMIT_BYTES = 5_000_000
"""Pages that list all docstrings of a package."""

no_site = pytest.mark.skipif("index.html" not in PAGES, reason="the site is not built")


@pytest.fixture(scope="module")
def browser() -> Iterator:
    """Return Chromium; here nothing is skipped."""
    executable = find()
    if executable is None:
        pytest.fail(MISSING)
    with started(executable) as chromium:
        yield chromium


def url_of(name: str) -> str:
    """Return the address of a page on disk."""
    return (SITE / name).as_uri()


@pytest.mark.parametrize("name", PAGES)
def test_page(name, browser, record_property):
    """A page is whole, quiet, light and readable, in light and dark, on a desk and on a telephone.

    Pages that list docstrings have no colours and tables of their own: axe looks at the others.
    """
    seen = visit(browser, url_of(name), widths=NARROW, accessible=name in WRITTEN)
    assert seen.asked_outside() == []
    assert seen.failed == []
    assert seen.console == []
    if name in WRITTEN:  # examples of the API show the errors they mean to show
        assert "Traceback (most recent call last)" not in seen.facts["text"]
    _check_images_and_formulas(seen)
    assert seen.facts["squeezed"] == [], "cells of a table with less than ten letters to a line"
    for width, overflow in seen.overflow.items():
        assert overflow["scroll"] <= width, f"too wide for {width} px: {overflow['wide']}"
    for scheme, severe in seen.severe.items():
        assert severe == [], f"axe, {scheme}: {severe}"

    total, of_views = _weight(seen)
    record_property("page", name)
    record_property("page_bytes", total)
    record_property("shape_view_bytes", of_views)
    assert total - of_views <= _limit(name), f"{total - of_views} bytes without 3-D views"


def _limit(name: str) -> int:
    if name == "index.html":
        return LANDING_LIMIT_BYTES
    return REFERENCE_LIMIT_BYTES if name.startswith("api/") else PAGE_LIMIT_BYTES


def _check_images_and_formulas(seen: Visit) -> None:
    for image in seen.facts["images"]:
        assert image["width"] > 0, f"{image['src']} did not load"
        alt = image["alt"].strip()
        assert alt, f"{image['src']} has no alt text"
        assert Path(image["src"]).name not in alt, f"the alt text of {image['src']} is its file name"
    assert seen.facts["rendered"] >= seen.facts["formulas"], "not every formula was drawn"
    assert seen.facts["errors"] == 0, "a formula has an error"


def _weight(seen: Visit) -> tuple[int, int]:
    """Return the bytes of a page, and how many of them are for 3-D views."""
    total = seen.weight()
    views = seen.facts["views"]
    return total, sum(views) + (VIEWER.stat().st_size if views else 0)


@no_site
def test_landing_page_is_a_page(browser):
    """The landing page does not redirect, and its counts lead to the rows that they count."""
    assert "http-equiv" not in (SITE / "index.html").read_text(encoding="utf-8").lower()
    page, _ = open_page(browser, url_of("index.html"))
    try:
        assert len(page.locator("main").inner_text()) > 1000
        link = page.locator("main table a[href*='verdict=']").last
        label = link.get_attribute("aria-label")
        link.click()
        page.wait_for_selector(".scorecard-count")
        count = page.locator(".scorecard-count").inner_text()
        assert count.split()[0] == label.split()[0], f"{label} leads to {count}"
    finally:
        page.close()


ROWS = "table.cards tbody"


@no_site
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
        page.get_by_role("button", name="Show all").press("Enter")
        page.wait_for_function("() => !document.querySelector('tbody[hidden]')")
        assert seen.console == []
    finally:
        page.close()
    assert (
        "hidden"
        not in (SITE / "scorecard.html").read_text(encoding="utf-8").split("scorecard-filter")[1][:20_000]
    )


@no_site
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


@no_site
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


@no_site
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
        assert rows.nth(5).locator("td").nth(0).inner_text() in hovered
        page.locator(".scorecard-picture a[tabindex='0']").focus()
        page.keyboard.press("ArrowRight")
        name = said.inner_text()
        assert name.startswith(page.locator("table.cards .title").first.inner_text())
        for cell in (0, 1, 3):
            assert rows.nth(1).locator("td").nth(cell).inner_text() in name
        page.keyboard.press("Enter")
        page.wait_for_selector("tbody.opened")
        assert page.locator("tbody.opened").get_attribute("id") == rows.nth(1).get_attribute("id")
        assert seen.console == []
    finally:
        page.close()


@no_site
@pytest.mark.parametrize(
    ("query", "first"),
    [
        ("particle filter", "chapters/particles.html"),
        ("how does particle filter work", "chapters/particles.html"),
        ("gradient descent", "chapters/magnets.html"),
        ("quaternions", "chapters/imus.html"),
        ("sensor fusion", "chapters/one_robot.html"),
        ("What happens when sensors fail?", "notebooks/sensor_failure.html"),
        ("light bulb", "notebooks/light_bulb.html"),
        ("where to put magnets", "notebooks/sensor_placement.html"),
        ("glossary", "glossary.html"),
        ("momentum", ""),
        ("lemniscate", ""),
    ],
)
def test_search_finds_pages_by_their_words(query, first, browser):
    """From disk, asking nobody: the page on a topic comes first, with an excerpt that has the words."""
    page, seen = open_page(browser, f"{url_of('search.html')}?q={quote(query)}")
    try:
        found = page.locator("#search-results ol.search > li")
        links = found.locator("a").evaluate_all("all => all.map(a => a.getAttribute('href'))")
        assert links
        assert links[0].startswith(first)
        words = [word.lower() for word in found.locator("mark").all_inner_texts()]
        assert any(word[:5] in query.lower() for word in words)
        assert page.locator(".bd-search-container form.bd-search input").input_value() == query
        assert seen.failed == []
        assert seen.console == []
        assert seen.asked_outside() == []
        for link in links:
            path, _, anchor = link.partition("#")
            assert not anchor or anchor in links_of(SITE / path).anchors
    finally:
        page.close()


@no_site
@pytest.mark.parametrize("width", [1400, 390])
def test_icon_of_the_search_covers_nothing(width, browser):
    """It ends before the words begin."""
    page, _ = open_page(browser, f"{url_of('search.html')}?q=magnet", width=width)
    try:
        box = "e => { const {left, right} = e.getBoundingClientRect(); return [left, right]; }"
        form = page.locator(".bd-search-container form.bd-search")
        _, icon = form.locator("i, svg").first.evaluate(box)
        field = form.locator("input")
        left, _ = field.evaluate(box)
        text = left + float(field.evaluate("e => parseFloat(getComputedStyle(e).paddingLeft)"))
        assert icon < text
    finally:
        page.close()


@no_site
@pytest.mark.parametrize("name", [page for page in WRITTEN if page.startswith(("chapters/", "notation"))])
def test_formulas_open_at_their_left_end(name, browser):
    """One that is wider than the screen begins where its box does."""
    page, _ = open_page(browser, url_of(name), width=390)
    try:
        page.evaluate(FACTS)  # waits for the formulas
        starts = page.evaluate(
            """() => [...document.querySelectorAll('div.math')].map(box =>
            box.querySelector('mjx-math').getBoundingClientRect().left - box.getBoundingClientRect().left)"""
        )
        assert [start for start in starts if start < -1] == []
    finally:
        page.close()


@pytest.mark.parametrize("name", WITH_VIEWS)
def test_shape_views(name, browser):
    """Each 3-D view is drawn, and its slider moves it."""
    page, seen = open_page(browser, url_of(name))
    try:
        views = page.locator(".shape-view")
        for k in range(views.count()):
            view = views.nth(k)
            view.scroll_into_view_if_needed()
            canvas = view.locator("canvas").first
            canvas.wait_for()
            page.wait_for_timeout(300)
            before = pixels(canvas)
            assert before.std() > 1, "the canvas is blank"
            slider = view.get_by_role("slider").first
            slider.focus()
            slider.press("End" if slider.input_value() == "0" else "Home")
            page.wait_for_timeout(300)
            assert np.abs(pixels(canvas) - before).max() > 20, "the slider does not move the shape"
        assert seen.console == []
    finally:
        page.close()


@pytest.mark.parametrize("name", WITH_STRIPS)
def test_strips_of_frames(name, browser):
    """Each has its slider, which moves it, and says what happens."""
    page, seen = open_page(browser, url_of(name))
    try:
        strips = page.locator(".frame-strip")
        for k in range(strips.count()):
            strip = strips.nth(k)
            strip.scroll_into_view_if_needed()
            slider, said = strip.get_by_role("slider"), strip.locator(".frame-strip-says").inner_text()
            before = pixels(strip.locator("img"))
            slider.focus()
            slider.press("End" if slider.input_value() == "0" else "Home")
            page.wait_for_timeout(300)
            assert differing(pixels(strip.locator("img")), before) > 100, "the slider does not move it"
            assert strip.locator(".frame-strip-says").inner_text() != said
        assert seen.console == []
    finally:
        page.close()


@pytest.mark.parametrize("name", WRITTEN)
def test_tables_are_for_readers(name):
    """No name of a column, nothing missing that reads as a word, no digits that nobody knows."""
    assert cells_not_to_show((SITE / name).read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("path", EXECUTED, ids=lambda path: path.stem)
def test_letters_of_figures_are_words_and_large_enough(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    outputs = [output.get("data", {}) for cell in cells for output in cell.get("outputs", [])]
    pictures = ["".join(data["image/svg+xml"]) for data in outputs if "image/svg+xml" in data]
    texts = [text for picture in pictures for text in texts_of_picture(picture)]
    assert [text for text, _ in texts if MACHINE_NAME.search(text)] == []
    assert [text for text, size_px in texts if size_px < SMALLEST_LETTERS_PX and len(text) > 1] == []


class Links(HTMLParser):
    """The links and anchors of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[tuple[str, str]] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect ``href``, ``src``, ``id`` and ``name``."""
        for key, value in attrs:
            if key in ("href", "src") and value:
                self.links.append((tag, value))
            elif key == "id" or (key == "name" and tag == "a"):
                self.anchors.add(value or "")


@cache
def links_of(path: Path) -> Links:
    """Return the links and anchors of a file."""
    parser = Links()
    parser.feed(path.read_text(encoding="utf-8"))
    return parser


@pytest.mark.parametrize("name", ALL_PAGES)
def test_links(name):
    """Links inside the site lead somewhere; nothing but a reader's click leads outside."""
    page = SITE / name
    broken = []
    for tag, link in links_of(page).links:
        parts = urlsplit(link)
        if parts.scheme in ("data", "mailto", "javascript"):
            continue
        if parts.scheme or parts.netloc:
            assert tag == "a", f"{link} is loaded from another host"
            continue
        target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
        if target.is_dir():
            target = target / "index.html"
        anchor = unquote(parts.fragment) if target.suffix == ".html" else ""
        if not target.is_file() or (anchor and anchor not in links_of(target).anchors | {"top"}):
            broken.append(link)
    assert broken == []
