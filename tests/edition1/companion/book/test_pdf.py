"""Where the start page leads to the PDF; the PDF itself is looked at in ``tests/book/test_site_pdf.py``."""

from pathlib import Path

from edition1_companion.book.after.pdf import NAME, link_from_start_page

BOOK = Path(__file__).resolve().parents[4] / "book"


def test_the_start_page_leads_to_the_pdf_instead_of_telling_how_to_print_it(tmp_path):
    """The words are those of the page of this book; once replaced, a second PDF changes nothing."""
    source = (BOOK / "index.md").read_text(encoding="utf-8")
    assert source.count('<span class="as-pdf">') == 1
    start = tmp_path / "index.html"
    start.write_text(source, encoding="utf-8")
    link_from_start_page(start)
    linked = start.read_text(encoding="utf-8")
    assert f'href="{NAME}"' in linked
    assert "make pdf" not in linked
    assert len(linked.splitlines()) == len(source.splitlines())
    link_from_start_page(start)
    assert start.read_text(encoding="utf-8") == linked
