"""Every page of the built site, in a real browser: run with ``make check-site`` after ``make book``."""

from __future__ import annotations

import json
import re
import struct
from base64 import b64decode
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from built_site import SITE, links_of, no_site, url_of
from chromium import MISSING, find, started
from page_on_screen import at_rest, pixels, wait_until
from page_visit import AXE, FACTS, STILL, Visit, open_page, visit
from shown import cells_not_to_show, texts_of_a_program

from repro_companion.plots.style import STYLE

PAGES = sorted(path.relative_to(SITE).as_posix() for path in SITE.rglob("*.html"))
WRITTEN = [page for page in PAGES if not page.startswith(("api.", "genindex", "sources/"))]
"""Notebooks and pages written by hand."""
OF_CODE = max(set(PAGES) - {*WRITTEN}, key=lambda page: (page.startswith("sources/"), len(page)), default="")
"""One page stands for all that show a module: they are made alike."""
VISITED = [page for page in PAGES if not page.startswith("sources/") or page == OF_CODE]
FOLDED_TABLES = re.compile(
    r"<details[^>]*>\s*<summary[^>]*>\s*<span[^>]*>All numbers.*?</details>", re.DOTALL
)
"""All numbers of a page, as its files have them."""
PRINTED = re.compile(r'<div class="output text_plain.*?</pre></div>', re.DOTALL)
"""What a cell returns, as Python prints it."""
WITH_VIEWS = [page for page in WRITTEN if 'class="shape-view"' in (SITE / page).read_text(encoding="utf-8")]
EXECUTED = sorted((SITE.parents[1] / "notebooks").glob("*.ipynb"))
VIEWER = SITE / "_static" / "shape_viewer.js"
NARROW = (390, 320)
CONTRAST_OF_CODE = """async () => {
  const rules = {'color-contrast-enhanced': {enabled: true}};
  const options = {runOnly: {type: 'rule', values: ['color-contrast-enhanced']}, rules, preload: false};
  const found = await axe.run({include: [['div.highlight']]}, options);
  const nodes = kind => found[kind].flatMap(rule => rule.nodes);
  return {
    passed: nodes('passes').length,
    failed: nodes('violations').slice(0, 5).map(node => `${node.html}: ${node.failureSummary}`),
  };
}"""
MOST_WORDS = 1000
"""Of a notebook's page, without folds, captions, tables, code and formulas."""
LANDING_LIMIT_BYTES = 1_000_000
PAGE_LIMIT_BYTES = 2_000_000
"""Without 3-D views and MathJax, which many pages share; the theme included."""


@pytest.fixture(scope="module")
def browser() -> Iterator:
    """Return Chromium; here nothing is skipped."""
    executable = find()
    if executable is None:
        pytest.fail(MISSING)
    with started(executable) as chromium:
        yield chromium


@pytest.mark.parametrize("name", VISITED)
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
    assert not [url for url in seen.requests if "fa-solid" in url], "an icon that ICONS of repro_site lacks"
    if name.startswith("notebooks/"):
        assert seen.facts["words"] <= MOST_WORDS, "fold what is beside the thread"
    assert seen.facts["squeezed"] == [], "cells of a table with less than ten letters to a line"
    for width, overflow in seen.overflow.items():
        assert overflow["scroll"] <= width, f"too wide for {width} px: {overflow['wide']}"
    for scheme, severe in seen.severe.items():
        assert severe == [], f"axe, {scheme}: {severe}"

    total, of_views = _weight(seen)
    record_property("page", name)
    record_property("page_bytes", total)
    record_property("shape_view_bytes", of_views)
    assert total - of_views <= _limit(name), f"{total - of_views} bytes without 3-D views and MathJax"
    assert bool(seen.loaded("/_static/mathjax/")) == bool(seen.facts["formulas"])


def _limit(name: str) -> int:
    if name == "index.html":
        return LANDING_LIMIT_BYTES
    return PAGE_LIMIT_BYTES


def _check_images_and_formulas(seen: Visit) -> None:
    for image in seen.facts["images"]:
        assert image["width"] > 0, f"{image['src']} did not load"
        alt = image["alt"].strip()
        assert alt, f"{image['src']} has no alt text"
        assert Path(image["src"]).name not in alt, f"the alt text of {image['src']} is its file name"
    assert seen.facts["rendered"] == seen.facts["formulas"], "not every formula is typeset"
    assert seen.facts["errors"] == 0, "a formula has an error"
    assert seen.facts["tex"] == [], "TeX that is not typeset"


def _weight(seen: Visit) -> tuple[int, int]:
    """Return the bytes of a page without MathJax, and how many of them are for 3-D views."""
    total = seen.weight() - sum(path.stat().st_size for path in seen.loaded("/_static/mathjax/"))
    views = seen.facts["views"]
    return total, sum(views) + (VIEWER.stat().st_size if views else 0)


@no_site
def test_landing_page_is_a_page(browser):
    """The landing page does not redirect, and its counts lead to the rows that they count."""
    assert "http-equiv" not in (SITE / "index.html").read_text(encoding="utf-8").lower()
    with open_page(browser, url_of("index.html")) as (page, _):
        assert len(page.locator("main").inner_text()) > 1000
        link = page.locator("main table a[href*='verdict=']").last
        counted = link.inner_text()
        link.click()
        page.wait_for_selector(".scorecard-count")
        count = page.locator(".scorecard-count").inner_text()
        assert count.split()[0] == counted, f"{counted} leads to {count}"
        page.wait_for_load_state()
        first = page.locator("table.cards tbody:visible").first.bounding_box()
        assert 0 < first["y"] < 900, "the rows are not in the first screen"


@no_site
def test_first_screen_of_the_landing_page(browser):
    """On a desk it says what this is and holds the whole robot."""
    with open_page(browser, url_of("index.html"), width=1400) as (page, _):
        for part in ("main section > p >> nth=0", ".live-stage"):
            box = page.locator(part).bounding_box()
            assert box["y"] + box["height"] < 900, part


@no_site
def test_from_the_landing_page_to_a_table_of_a_paper(browser):
    """Table II has a link by its number, and the link leads to its page."""
    with open_page(browser, url_of("index.html")) as (page, _):
        page.locator("main a[title='Table II']").click()
        page.wait_for_url("**/notebooks/imu_markers.html*")


@no_site
@pytest.mark.parametrize("name", [page for page in WRITTEN if page.startswith("notation")])
def test_formulas_open_at_their_left_end(name, browser):
    """One that is wider than the screen begins where its box does."""
    with open_page(browser, url_of(name), width=390) as (page, _):
        page.evaluate(FACTS)  # waits for MathJax
        starts = page.evaluate(
            """() => [...document.querySelectorAll('div.math')].map(box =>
            box.querySelector('mjx-math').getBoundingClientRect().left - box.getBoundingClientRect().left)"""
        )
        assert [start for start in starts if start < -1] == []


@no_site
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_first_column_stays_while_a_table_is_scrolled(scheme, browser):
    """So that a number keeps the name of its row; nothing is seen through it."""
    with open_page(browser, url_of("notebooks/live.html"), width=390) as (page, _):
        page.emulate_media(color_scheme=scheme)
        moved = page.evaluate(
            """() => [...document.querySelectorAll('.formatted')]
            .filter(e => e.scrollWidth > e.clientWidth).map(e => {
            e.scrollLeft = 40;
            const [first, second] = e.querySelectorAll('tbody tr td');
            const left = e.getBoundingClientRect().left;
            return [first.getBoundingClientRect().left - left, second.getBoundingClientRect().left - left,
                first.getBoundingClientRect().width, getComputedStyle(first).backgroundColor];
            })"""
        )
    assert moved
    for first, second, width, ground in moved:
        assert abs(first) < 1
        assert second < width
        assert ground not in ("transparent", "rgba(0, 0, 0, 0)")


@pytest.mark.parametrize("name", WITH_VIEWS)
def test_shape_views(name, browser):
    """Each 3-D view is drawn, and its slider moves it."""
    with open_page(browser, url_of(name)) as (page, seen):
        views = page.locator(".shape-view")
        for k in range(views.count()):
            view = views.nth(k)
            view.scroll_into_view_if_needed()
            canvas = view.locator("canvas").first
            canvas.wait_for()
            wait_until(page, lambda canvas=canvas: pixels(canvas).std() > 1)  # it is not blank
            before = at_rest(canvas)
            slider = view.get_by_role("slider").first
            slider.focus()
            slider.press("End" if slider.input_value() == "0" else "Home")
            moved = lambda canvas=canvas, before=before: np.abs(pixels(canvas) - before).max() > 20  # noqa: E731
            wait_until(page, moved)
        assert seen.console == []


@pytest.mark.parametrize("name", WRITTEN)
def test_tables_are_for_readers(name):
    """No name of a column, nothing missing that reads as a word, no digits that nobody knows."""
    assert cells_not_to_show(FOLDED_TABLES.sub("", (SITE / name).read_text(encoding="utf-8"))) == []


@pytest.mark.parametrize("name", WRITTEN)
def test_pages_say_what_a_person_would(name):
    """Outside of code no power of ten has an ``e``, and no list, dictionary or None of Python is shown."""
    text = FOLDED_TABLES.sub("", (SITE / name).read_text(encoding="utf-8"))
    assert texts_of_a_program(PRINTED.sub("", text)) == []


@no_site
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(
    "name", ["notebooks/closed_loop.html", "notebooks/own_robot.html", "notebooks/table_1.html"]
)
def test_code_has_contrast(name, scheme, browser):
    """Seven to one, as for small text that is read for long."""
    with open_page(browser, url_of(name)) as (page, _):
        page.emulate_media(color_scheme=scheme)
        page.add_style_tag(content=STILL)
        page.evaluate(AXE.read_text(encoding="utf-8"))
        page.wait_for_function("theme => document.documentElement.dataset.theme === theme", arg=scheme)
        found = page.evaluate(CONTRAST_OF_CODE)
    assert found["passed"] > 0
    assert found["failed"] == []


@no_site
@pytest.mark.parametrize("name", ["notebooks/real_arm.html", "notebooks/table_1.html"])
def test_a_figure_opens_its_file(name, browser):
    """By keys alone, from disk; its alternative text stays."""
    with open_page(browser, url_of(name), width=390) as (page, _):
        figures = page.locator("main figure:not(.schematic) a.in-full")
        assert figures.count() == page.locator("main figure img[src*='_images/']").count() > 0
        source = figures.first.locator("img").get_attribute("src")
        assert figures.first.locator("img").get_attribute("alt")
        figures.first.press("Enter")
        page.wait_for_url(f"**/{Path(source).name}")


@no_site
def test_a_schematic_opens_by_itself(browser):
    """By keys alone, from disk, as wide as the window."""
    with open_page(browser, url_of("notebooks/particle_filter.html"), width=390) as (page, _):
        schematic = page.locator("main figure.schematic a.in-full").first
        assert schematic.locator("svg").get_attribute("aria-label")
        schematic.press("Enter")
        page.wait_for_url("**/notebooks-particle_filter-1.svg")
        assert page.evaluate("document.documentElement.getBoundingClientRect().width") == 390


@pytest.mark.parametrize("path", EXECUTED, ids=lambda path: path.stem)
def test_letters_of_figures_are_nine_pixels_high_on_a_telephone(path):
    """A figure that is drawn wider than the others is shown smaller; a phone gives it 358 px."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    outputs = [output.get("data", {}) for cell in cells for output in cell.get("outputs", [])]
    pictures = [b64decode(data["image/png"]) for data in outputs if "image/png" in data]
    assert pictures
    letter_px = STYLE["font.size"] / 72 * STYLE["figure.dpi"]
    for png in pictures:
        (width_px,) = struct.unpack(">I", png[16:20])
        assert round(letter_px * 358 / width_px, 1) >= 9.0


@pytest.mark.parametrize("name", PAGES)
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
