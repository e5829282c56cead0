"""One page of the site in a browser: what it asks for, says and shows, in light and dark, wide and narrow."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote, urlsplit

from chromium import LONGEST_MS
from page_on_screen import NO_GPU

AXE = Path(__file__).resolve().parents[1] / "vendor" / "axe-core" / "axe.min.js"
LOUD = ("error", "warning")
SEVERE = ("serious", "critical")
OF_COLOUR = ("color-contrast", "link-in-text-block")
"""Rules whose outcome depends on the colours; all others are the same in light and dark."""

FACTS = """async () => {
  if (window.MathJax) await MathJax.startup.promise;
  await document.fonts.ready;
  const images = [...document.querySelectorAll('img')];
  images.forEach(image => { image.loading = 'eager'; });
  await Promise.all(images.map(image => image.decode().catch(() => null)));
  const cells = '.cell_output table:not(.scorecard, .table-1 *) :is(th, td)';
  const squeezed = [...document.querySelectorAll(cells)].filter(cell => {
    const inside = document.createRange();
    inside.selectNodeContents(cell);
    const lines = inside.getBoundingClientRect().height / parseFloat(getComputedStyle(cell).lineHeight);
    return lines > 1.5 && lines > cell.textContent.trim().length / 10;
  });
  const prose = document.querySelector('main').cloneNode(true);
  prose.querySelectorAll('pre, code, script, style, mjx-container').forEach(part => part.remove());
  const tex = prose.textContent.match(/\\\\[a-z]{2,}|\\\\[()[\\]]|[_^]\\{/gi) || [];
  const beside = 'table, figcaption, details, noscript, svg, .live-figure, .shape-view';
  prose.querySelectorAll(beside).forEach(part => part.remove());
  return {
    words: ((prose.querySelector('article') || prose).textContent.match(/[\\p{L}'’]+/gu) || []).length,
    squeezed: squeezed.map(cell => cell.textContent.trim()),
    text: document.body.innerText,
    images: images.map(i => ({src: i.getAttribute('src'), alt: i.alt, width: i.naturalWidth})),
    formulas: document.querySelectorAll('.math').length,
    rendered: document.querySelectorAll('.math > mjx-container').length,
    errors: document.querySelectorAll('mjx-merror, [data-mjx-error]').length,
    tex,
    views: [...document.querySelectorAll('.shape-view')].map(view => new Blob([view.outerHTML]).size),
  };
}"""

OVERFLOW = """() => ({
  scroll: document.documentElement.scrollWidth,
  wide: [...document.querySelectorAll('main *')]
    .filter(e => e.getBoundingClientRect().right > innerWidth + 1)
    .slice(0, 5).map(e => `${e.tagName}.${e.className}`),
})"""

VIOLATIONS = """async rules => {
  const options = {preload: false, resultTypes: ['violations']};
  if (rules) options.runOnly = {type: 'rule', values: rules};
  const {violations} = await axe.run(document, options);
  return violations.map(v => ({
    id: v.id, impact: v.impact,
    nodes: v.nodes.slice(0, 3).map(n => `${n.target.join(' ')}: ${n.failureSummary}`),
  }));
}"""

STILL = "*, *::before, *::after { transition: none !important; animation: none !important; }"
"""Colours that are still changing would be measured half-way."""


@dataclass
class Visit:
    """What happened while a page was open."""

    requests: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    console: list[str] = field(default_factory=list)
    facts: dict = field(default_factory=dict)
    overflow: dict[int, dict] = field(default_factory=dict)
    """By width of the window."""
    severe: dict[str, list[dict]] = field(default_factory=dict)
    """Serious violations by colour scheme."""

    def asked_outside(self) -> list[str]:
        """Requests that left the site."""
        return [url for url in self.requests if urlsplit(url).scheme not in ("file", "data", "blob")]

    def loaded(self, part: str = "") -> set[Path]:
        """Files that the page loaded, by a part of their path."""
        paths = (unquote(urlsplit(url).path) for url in self.requests if url.startswith("file:"))
        return {Path(path) for path in paths if part in path}

    def weight(self) -> int:
        """Bytes of all files that the page loaded."""
        return sum(path.stat().st_size for path in self.loaded())


@contextmanager
def open_page(browser, url: str, *, width: int = 1280):
    """Open a page; give it with a record of what happens there, and close it in the end."""
    seen = Visit()
    page = browser.new_page()
    page.set_default_timeout(LONGEST_MS)
    page.set_viewport_size({"width": width, "height": 900})
    page.emulate_media(color_scheme="light")
    page.on("request", lambda request: seen.requests.append(request.url))
    page.on("requestfailed", lambda request: seen.failed.append(request.url))
    page.on("pageerror", lambda error: seen.console.append(str(error)))
    page.on("console", lambda message: seen.console.append(message.text) if _is_defect(message) else None)
    try:
        page.goto(url, wait_until="load")
        yield page, seen
    finally:
        page.close()


def visit(browser, url: str, *, widths: Iterable[int] = (), accessible: bool = False) -> Visit:
    """Open a page, look at it in windows of some widths and, with axe, in both colour schemes."""
    with open_page(browser, url) as (page, seen):
        seen.facts = page.evaluate(FACTS)
        if accessible:
            page.add_style_tag(content=STILL)
            page.evaluate(AXE.read_text(encoding="utf-8"))
            for scheme, rules in (("light", None), ("dark", OF_COLOUR)):
                page.emulate_media(color_scheme=scheme)
                page.wait_for_function(
                    "theme => document.documentElement.dataset.theme === theme", arg=scheme
                )
                found = page.evaluate(VIOLATIONS, rules)
                seen.severe[scheme] = [violation for violation in found if violation["impact"] in SEVERE]
        for width in widths:
            page.set_viewport_size({"width": width, "height": 900})
            seen.overflow[width] = page.evaluate(OVERFLOW)
        page.wait_for_timeout(50)  # a message that is on its way
    return seen


def _is_defect(message) -> bool:
    """Whether a message on the console is one that a page is to blame for."""
    return message.type in LOUD and NO_GPU not in message.text
