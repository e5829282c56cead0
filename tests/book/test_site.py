"""Every page of the built site, in a real browser: run with ``make check-site`` after ``make book``."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

SITE = Path(__file__).resolve().parents[2] / "book" / "_build" / "html"
# Pages that only list source code need no browser; their links are checked with the others.
ALL_PAGES = sorted(path.relative_to(SITE).as_posix() for path in SITE.rglob("*.html"))
PAGES = [page for page in ALL_PAGES if not page.startswith("_modules/")]
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
LOUD = ("error", "warning")
LANDING_LIMIT_BYTES = 1_000_000


@dataclass
class Visit:
    """What happened while a page was open."""

    requests: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    console: list[str] = field(default_factory=list)
    facts: dict = field(default_factory=dict)


FACTS = """async () => {
  if (window.MathJax && MathJax.startup && MathJax.startup.promise) await MathJax.startup.promise;
  const images = [...document.querySelectorAll('img')];
  images.forEach(image => { image.loading = 'eager'; });
  await Promise.all(images.map(image => image.decode().catch(() => null)));
  const wide = [...document.querySelectorAll('main *')]
    .filter(e => e.getBoundingClientRect().right > innerWidth + 1)
    .slice(0, 5).map(e => `${e.tagName}.${e.className}`);
  return {
    text: document.body.innerText,
    scroll: document.documentElement.scrollWidth,
    wide: wide,
    images: images.map(i => ({src: i.getAttribute('src'), alt: i.alt, width: i.naturalWidth})),
    formulas: document.querySelectorAll('.math').length,
    rendered: document.querySelectorAll('.math mjx-container svg').length,
    errors: document.querySelectorAll('[data-mml-node="merror"], mjx-merror').length,
  };
}"""


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator:
    """Return Debian's Chromium with a profile of its own."""
    api = pytest.importorskip("playwright.sync_api")
    executable = shutil.which("chromium")
    if executable is None:
        pytest.skip("Chromium is not installed")
    with api.sync_playwright() as playwright:
        profile = tmp_path_factory.mktemp("profile")
        context = playwright.chromium.launch_persistent_context(
            profile, executable_path=executable, args=FLAGS
        )
        yield context
        context.close()


@pytest.fixture
def visit(browser):
    """Open a page of the site from disk and return what happened."""

    def open_page(name: str, width: int = 1280, scheme: str = "light") -> Visit:
        seen = Visit()
        page = browser.new_page()
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        page.on("request", lambda request: seen.requests.append(request.url))
        page.on("requestfailed", lambda request: seen.failed.append(request.url))
        page.on("pageerror", lambda error: seen.console.append(str(error)))
        page.on(
            "console", lambda message: seen.console.append(message.text) if message.type in LOUD else None
        )
        try:
            page.goto((SITE / name).as_uri(), wait_until="load")
            seen.facts = page.evaluate(FACTS)
            page.wait_for_timeout(100)
        finally:
            page.close()
        return seen

    return open_page


@pytest.mark.parametrize("name", PAGES)
def test_page(name, visit):
    """A page asks no other host, reports no error, and shows its figures and formulas."""
    seen = visit(name)
    assert [url for url in seen.requests if urlsplit(url).scheme not in ("file", "data", "blob")] == []
    assert seen.failed == []
    assert seen.console == []
    if not name.startswith("api/"):  # examples there show the errors they mean to show
        assert "Traceback (most recent call last)" not in seen.facts["text"]
    for image in seen.facts["images"]:
        assert image["width"] > 0, f"{image['src']} did not load"
        alt = image["alt"].strip()
        assert alt, f"{image['src']} has no alt text"
        assert Path(image["src"]).name not in alt, f"the alt text of {image['src']} is its file name"
    assert seen.facts["rendered"] >= seen.facts["formulas"], "not every formula was drawn"
    assert seen.facts["errors"] == 0, "a formula has an error"


@pytest.mark.parametrize("width", [390, 320])
@pytest.mark.parametrize("name", PAGES)
def test_no_sideways_scrolling(name, width, visit):
    """On a telephone the page itself does not scroll sideways; wide tables and code do so in their own box."""
    seen = visit(name, width=width)
    assert seen.facts["scroll"] <= width, f"too wide: {seen.facts['wide']}"


@pytest.mark.skipif("index.html" not in PAGES, reason="the site is not built")
def test_landing_page(visit):
    """The landing page is a page, and a light one."""
    text = (SITE / "index.html").read_text(encoding="utf-8")
    assert "http-equiv" not in text.lower(), "index.html redirects"
    seen = visit("index.html")
    assert len(seen.facts["text"]) > 1000
    paths = {Path(unquote(urlsplit(url).path)) for url in seen.requests if url.startswith("file:")}
    paths -= {SITE / "searchindex.js"}  # it grows with the book
    assert sum(path.stat().st_size for path in paths) < LANDING_LIMIT_BYTES


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
