"""The book as one PDF: outline, links, fonts, figures, numbers and size; skipped where it was not printed."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pypdf
import pytest
from built_site import SITE

FILE = SITE.parent / "repro.pdf"
pytestmark = pytest.mark.skipif(not FILE.is_file(), reason="the PDF is not printed: make pdf")
VECTORS_AT_LEAST = 30
"""So many sheets draw more than text and rules: figures that stayed lines."""


@pytest.fixture(scope="module")
def book():
    return pypdf.PdfReader(FILE)


def titles(outline: list) -> Iterator[str]:
    """Return the titles of an outline and of what is below them."""
    for item in outline:
        if isinstance(item, list):
            yield from titles(item)
        else:
            yield item.title


def resources(found) -> Iterator:
    """Return what a sheet draws with, and the forms on it."""
    found = found.get_object()
    yield found
    for item in found.get("/XObject", {}).values():
        if "/Resources" in (form := item.get_object()):
            yield from resources(form["/Resources"])


def test_the_outline_has_parts_pages_and_sections(book):
    found = list(titles(book.outline))
    for title in ("Learn", "Reproduce", "Build", "Reference", "Glossary", "Exercise", "What to read next"):
        assert title in found
    pages = [book.get_destination_page_number(item) for item in book.outline if not isinstance(item, list)]
    assert pages == sorted(set(pages))
    assert pages[0] == 0


def test_every_link_leads_to_a_sheet_or_to_another_host(book):
    sheets, inside = {sheet.indirect_reference.idnum for sheet in book.pages}, 0
    for sheet in book.pages:
        for reference in sheet.get("/Annots", ()):
            link = reference.get_object()
            if "/Dest" in link:
                assert link["/Dest"][0].idnum in sheets
                inside += 1
            else:
                assert re.match("https?://|mailto:", link["/A"]["/URI"]), link["/A"]
    assert inside > len(sheets)


def test_every_sheet_has_its_number(book):
    assert len(book.pages) > 100
    for number, sheet in enumerate(book.pages, start=1):
        assert sheet.extract_text().rstrip().endswith(str(number))


def test_fonts_are_embedded(book):
    checked = 0
    for sheet in book.pages:
        for found in resources(sheet["/Resources"]):
            for reference in found.get("/Font", {}).values():
                font = reference.get_object()
                inner = font["/DescendantFonts"][0].get_object() if "/DescendantFonts" in font else font
                descriptor = inner.get("/FontDescriptor", {})
                embedded = {"/FontFile", "/FontFile2", "/FontFile3"} & set(descriptor)
                assert embedded or font["/Subtype"] == "/Type3", font
                checked += 1
    assert checked > len(book.pages)


def test_figures_are_lines_and_live_ones_have_a_picture(book):
    curves = [len(re.findall(rb"\sc\n", sheet.get_contents().get_data())) for sheet in book.pages]
    assert sum(count > 200 for count in curves) > VECTORS_AT_LEAST
    assert any(sheet.images for sheet in book.pages[:2]), "the picture of the live figure of the start page"


def test_it_is_light_and_names_nobodys_disk(book):
    assert FILE.stat().st_size < 20e6
    assert SITE.parent.as_posix().encode() not in FILE.read_bytes()
    assert book.metadata.title


def test_the_start_page_leads_to_it():
    """Unless the site was built anew since: then it says how to print one."""
    beside = SITE / FILE.name
    start = (SITE / "index.html").read_text(encoding="utf-8")
    assert (f'href="{FILE.name}"' in start) == beside.is_file()
    assert not beside.is_file() or beside.read_bytes() == FILE.read_bytes()
