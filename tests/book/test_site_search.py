"""The search of the built site, in a real browser, from disk: run with ``make check-site`` after ``make book``."""

from __future__ import annotations

from urllib.parse import quote

import pytest
from built_site import SITE, links_of, no_site, url_of
from page_visit import open_page

pytestmark = no_site


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
