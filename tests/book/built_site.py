"""The built site on disk, for the tests of its pages."""

from __future__ import annotations

from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import pytest

SITE = Path(__file__).resolve().parents[2] / "book" / "_build" / "html"
no_site = pytest.mark.skipif(not (SITE / "index.html").is_file(), reason="the site is not built")


def url_of(name: str) -> str:
    """Return the address of a page on disk."""
    return (SITE / name).as_uri()


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
