"""Every page of the built site on paper: run with ``make check-site`` after ``make book``."""

from __future__ import annotations

import re

import pytest
from built_site import SITE, no_site, url_of
from page_visit import FACTS, open_page

PAGES = sorted(path.relative_to(SITE).as_posix() for path in SITE.rglob("*.html"))
PRINTED = [page for page in PAGES if not page.startswith(("genindex", "search", "sources/"))]
WIDTH, HEIGHT = (round((length_mm - 30) / 25.4 * 96) for length_mm in (210, 297))
"""What margins leave of a sheet of A4, in pixels."""
ON_PAPER = """() => {
  const unseen = 'mjx-assistive-mml, .live-unseen, svg';
  const shown = e => e.checkVisibility() && !e.closest(unseen);
  const box = e => e.getBoundingClientRect(), style = e => getComputedStyle(e);
  const pale = e => style(e).color.match(/\\d+/g).slice(0, 3).every(part => part > 190);
  const scrolls = e => e.scrollWidth > e.clientWidth + 1 && style(e).overflowX !== 'visible';
  const all = (kind, test) => [...document.querySelectorAll(kind)].filter(test);
  const name = e => `${e.tagName}.${e.className}`;
  const names = (kind, test = shown) => all(kind, e => shown(e) && test(e)).map(name);
  return {
    wide: names('main *', e => box(e).width && box(e).right > innerWidth + 1),
    scrolling: names('main *', scrolls),
    broken: names('main tr', e => style(e).breakInside !== 'avoid'),
    folded: all('main details:not(.from-files) > :not(summary)', e => !shown(e)).map(name),
    pale: names('main :is(p, pre, pre span, td, th)', pale),
    of_screens: names('.bd-sidebar, .bd-header-article, .prev-next-footer, .copybtn'),
    moving: names('.live-controls, .shape-view canvas'),
    tall: all('main tr, main img', shown).map(e => box(e).height),
  };
}"""


@no_site
@pytest.mark.parametrize("name", PRINTED)
def test_a_page_is_whole_on_paper(name, browser):
    """Nothing is cut, no row or figure is larger than a sheet, folds are open, and what is for screens is gone.

    Letters are dark, also where pages are, and afterwards the page is as it was.
    """
    with open_page(browser, url_of(name), width=WIDTH) as (page, _):
        page.evaluate(FACTS)  # waits for figures and formulas
        page.emulate_media(media="print", color_scheme="dark")
        page.wait_for_function("document.documentElement.dataset.theme === 'dark'")
        page.evaluate("dispatchEvent(new Event('beforeprint'))")
        found = page.evaluate(ON_PAPER)
        page.evaluate("dispatchEvent(new Event('afterprint'))")
        sheets = page.pdf(prefer_css_page_size=True)
        assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    assert max(found.pop("tall"), default=0) < HEIGHT
    assert not any(found.values()), found
    sizes = re.findall(rb"/MediaBox \[(.*?)\]", sheets)
    assert {tuple(round(float(side)) for side in size.split()) for size in sizes} == {(0, 0, 595, 842)}
