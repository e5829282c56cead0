"""The site as one PDF, ``book/_build/repro.pdf`` and beside the start page: what ``make pdf`` runs.

Chromium prints each page of the table of contents, with scripts off: so the pictures that stand for 3-D and live
figures are printed. Then the pages are put together: links between them lead inside the file, each page has its
number, and parts, pages and their sections make the outline. What lies outside the printed pages (the listings of
the API, files to download) loses its link, for a file that is sent elsewhere would not find it.
"""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import unescape
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urldefrag, urljoin

import yaml
from edition1.errors import InputError, require
from edition1.files import whole_file, write_whole
from pypdf import PdfReader, PdfWriter
from pypdf.generic import ArrayObject, DictionaryObject, FloatObject, IndirectObject, NameObject, NullObject

from edition1_companion.book.project import Project, find_project, shown

NAME = "repro.pdf"
FORMAT: dict[str, Any] = {"format": "A4", "print_background": True}
MARGIN = {"top": "16mm", "bottom": "18mm", "left": "16mm", "right": "16mm"}
AREA = {"width": 673, "height": 994}
"""What the margins leave of a sheet [px]: tables are measured in it."""
PREPARE = """([css, anchors, vector]) => {
  document.documentElement.dataset.theme = document.documentElement.dataset.mode = "light";
  for (const box of document.querySelectorAll("details:not(.hide)")) box.open = true;
  for (const form of document.querySelectorAll("form, .run-form, .prev-next-footer, .bd-header-article"))
    form.remove();
  for (const image of document.images) {
    image.loading = "eager";
    const holder = image.closest("[id^=fig-]");
    if (holder && vector[holder.id]) image.src = vector[holder.id];
  }
  const sections = [...document.querySelectorAll("main h2")]
    .map(h => [(h.closest("section") || h).id, h.innerText.replace(/#$/, "").trim()]).filter(s => s[0]);
  const last = document.createElement("div");
  last.style.breakBefore = "page";
  const wanted = new Set([...anchors, ...sections.map(s => s[0])]);
  for (const id of wanted) if (document.getElementById(id)) {
    const link = document.createElement("a");
    link.href = "#" + id; link.textContent = "x ";
    last.append(link);
  }
  last.append("x");
  (document.querySelector("main article") || document.body).append(last);
  document.head.append(Object.assign(document.createElement("style"), { textContent: css }));
  for (const table of document.querySelectorAll(".cell_output table")) {
    const room = table.parentElement.clientWidth;
    if (table.scrollWidth > room) table.style.zoom = 0.98 * room / table.scrollWidth;
  }
  return sections;
}"""
"""Opens what is folded but code, puts in vector figures, makes wide tables smaller, and has places named by links on
a last page of its own."""
STYLE = """
.bd-sidebar-primary, .bd-sidebar-secondary, .bd-header, .bd-header-article, .bd-footer, .bd-footer-content,
.headerlink, .copybtn, #pst-back-to-top, .pst-async-banner-revealer, .skip-link, #pst-skip-link
  { display: none !important; }
.bd-main, .bd-content, .bd-article-container, .bd-article { display: block !important; max-width: none !important;
  padding: 0 !important; margin: 0 !important; overflow: visible !important; }
html { font-size: 13px !important; }
img, svg { max-height: 235mm; }
img, svg:not([style*=max-width]) { max-width: 100% !important; }
figure, .cell_output img, table tr, math[display=block] { break-inside: avoid; }
h1, h2, h3, summary { break-after: avoid; }
.bd-main .bd-content table { break-inside: auto; }
div.highlight, div[class*=highlight-] { display: block !important; break-inside: auto !important; }
.bd-article .cell_output table:not(.scorecard) { width: auto !important; max-width: 100% !important; }
.bd-article .cell_output table:not(.scorecard) :is(th, td) { padding: 2px 5px; }
pre, code { white-space: pre-wrap !important; overflow-wrap: anywhere; }
.cell_output, .table-wrapper, .pst-scrollable-table-container, .highlight, .output { overflow: visible !important;
  max-height: none !important; }
"""
NUMBERS = (
    "<style>@page{{size:A4;margin:0}}body{{margin:0}}p{{height:297mm;margin:0;position:relative;break-after:page}}"
    "p:last-child{{break-after:auto}}b{{position:absolute;bottom:8mm;width:100%;text-align:center;"
    "font:400 9pt sans-serif;color:#555}}</style>{}"
)


@dataclass(frozen=True)
class Printed:
    """A printed page of the site: its sheets, where its anchors lie, and its sections."""

    title: str
    reader: PdfReader
    sheets: int
    sections: Sequence[tuple[str, str]]
    """Anchor and heading of each."""
    places: Mapping[str, tuple[int, float, float]]
    """Sheet, left and top of each anchor."""


def contents(project: Project) -> list[tuple[str, list[str]]]:
    """Return the captions of the parts and the pages of each; the start page is in a part without one."""
    table = yaml.safe_load((project.book / "_toc.yml").read_text(encoding="utf-8"))

    def files(chapters: Sequence[dict[str, Any]]) -> Iterator[str]:
        for chapter in chapters:
            if "file" in chapter:
                yield chapter["file"]
            yield from files(chapter.get("sections", []))

    return [("", [table["root"]])] + [
        (part["caption"], [*files(part["chapters"])]) for part in table["parts"]
    ]


@contextmanager
def browser(executable: str) -> Iterator[Any]:
    """Start Chromium without scripts in the pages."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        started = playwright.chromium.launch(
            executable_path=executable, args=["--no-sandbox", "--disable-gpu"]
        )
        yield started.new_context(java_script_enabled=False, viewport=AREA)
        started.close()


def print_page(context: Any, site: Path, name: str, anchors: Sequence[str]) -> Printed:
    """Print one page of the site; ``anchors`` are the places in it that other pages lead to."""
    page = context.new_page()
    page.goto((site / f"{name}.html").as_uri())
    page.emulate_media(media="print", color_scheme="light")
    vector = {file.stem: file.as_uri() for file in (site / "downloads" / Path(name).name).glob("fig-*.svg")}
    sections = page.evaluate(PREPARE, [STYLE, list(anchors), vector])
    while not page.evaluate("() => [...document.images].every(image => image.complete)"):
        page.wait_for_timeout(20)
    title = page.evaluate("() => document.querySelector('h1').innerText.replace(/#$/, '').trim()")
    reader = PdfReader(io.BytesIO(page.pdf(**FORMAT, margin=MARGIN)))
    page.close()
    sheet_of = {
        sheet.indirect_reference.idnum: i for i, sheet in enumerate(reader.pages) if sheet.indirect_reference
    }
    places = {}
    for anchor, target in reader.trailer["/Root"].get("/Dests", {}).items():
        sheet, _, left, top = target.get_object()[:4]
        places[unquote(anchor[1:])] = (sheet_of[sheet.idnum], float(left), float(top))
    return Printed(title, reader, len(reader.pages) - 1, sections, places)


def links(page: Any) -> Iterator[tuple[DictionaryObject, str]]:
    """Return the links of a sheet, and where each leads: an address, or ``#anchor``."""
    for reference in page.get("/Annots", ()):
        annotation = reference.get_object()
        if annotation.get("/Subtype") != "/Link":
            continue
        if "/Dest" in annotation:
            yield annotation, "#" + unquote(str(annotation["/Dest"]).lstrip("/"))
        elif "/A" in annotation:
            yield annotation, str(annotation["/A"].get_object().get("/URI", ""))


def wanted_anchors(site: Path, names: Sequence[str]) -> dict[str, list[str]]:
    """Return, for each page, the anchors in it that the pages lead to."""
    wanted: dict[str, dict[str, None]] = {name: {} for name in names}
    for name in names:
        file = site / f"{name}.html"
        for address in re.findall(r'href="([^"]+)"', file.read_text(encoding="utf-8")):
            page, anchor = inside(urljoin(file.as_uri(), unescape(address)), site)
            if page in wanted and anchor:
                wanted[page][anchor] = None
    return {name: list(anchors) for name, anchors in wanted.items()}


def inside(address: str, site: Path) -> tuple[str, str]:
    """Return page and anchor of an address of the site; an empty page where it is none of them."""
    plain, anchor = urldefrag(address)
    start = site.as_uri() + "/"
    if not plain.startswith(start) or not plain.endswith(".html"):
        return "", unquote(anchor)
    return unquote(plain.removeprefix(start).removesuffix(".html")), unquote(anchor)


def assemble(printed: Mapping[str, Printed], parts: Sequence[tuple[str, list[str]]], site: Path) -> PdfWriter:
    """Put the printed pages together, with links inside the file and an outline."""
    writer, first = PdfWriter(), {}
    for name, page in printed.items():
        first[name] = len(writer.pages)
        for sheet in page.reader.pages[: page.sheets]:
            writer.add_page(sheet)
    for name, page in printed.items():
        for sheet in writer.pages[first[name] : first[name] + page.sheets]:
            _lead_inside(writer, sheet, name, printed, first, site)
    for caption, names in parts:
        sheet = first[names[0]]
        part = writer.add_outline_item(title=caption, page_number=sheet, bold=True) if caption else None
        for name in names:
            title, sheet = printed[name].title, first[name]
            item = writer.add_outline_item(title=title, page_number=sheet, parent=part)
            for anchor, heading in printed[name].sections:
                sheet = first[name] + printed[name].places.get(anchor, (0, 0, 0))[0]
                writer.add_outline_item(title=heading, page_number=sheet, parent=item)
    return writer


def _lead_inside(
    writer: PdfWriter,
    sheet: Any,
    name: str,
    printed: Mapping[str, Printed],
    first: Mapping[str, int],
    site: Path,
) -> None:
    kept = ArrayObject()
    for annotation, address in links(sheet):
        page, anchor = (name, address[1:]) if address.startswith("#") else inside(address, site)
        if page in printed:
            number, left, top = printed[page].places.get(anchor, (0, 0.0, 842.0))
            if number >= printed[page].sheets:
                continue
            target = writer.pages[first[page] + number].indirect_reference
            annotation.pop("/A", None)
            place: list[Any] = [target, NameObject("/XYZ"), FloatObject(left), FloatObject(top), NullObject()]
            annotation[NameObject("/Dest")] = ArrayObject(place)
        elif not address.startswith(("https://", "http://", "mailto:")):
            continue
        reference = annotation.indirect_reference
        kept.append(reference if isinstance(reference, IndirectObject) else annotation)
    sheet[NameObject("/Annots")] = kept


def number_sheets(writer: PdfWriter, context: Any) -> None:
    """Print a number at the foot of every sheet."""
    page = context.new_page()
    page.set_content(NUMBERS.format("".join(f"<p><b>{i + 1}</b></p>" for i in range(len(writer.pages)))))
    numbers = PdfReader(io.BytesIO(page.pdf(format="A4")))
    for sheet, number in zip(writer.pages, numbers.pages, strict=True):
        sheet.merge_page(number)
        sheet.compress_content_streams()


def write_pdf(project: Project, executable: str) -> Path:
    """Print the built site and write the PDF, whole or not at all; return where it lies."""
    site = project.book / "_build" / "html"
    require((site / "index.html").is_file(), "site", "make pdf", "built (run `make book` first)", shown(site))
    parts = contents(project)
    names = [name for _, pages in parts for name in pages]
    with browser(executable) as context:
        anchors = wanted_anchors(site, names)
        printed = {name: print_page(context, site, name, anchors[name]) for name in names}
        writer = assemble(printed, parts, site)
        number_sheets(writer, context)
    writer.add_metadata({"/Title": printed[names[0]].title})
    writer.page_mode = "/UseOutlines"
    writer.compress_identical_objects()
    place = project.book / "_build" / NAME
    for copy in (place, site / NAME):
        with whole_file(copy) as temporary:
            writer.write(temporary)
    link_from_start_page(site / "index.html")
    return place


def link_from_start_page(start: Path) -> None:
    """Let the start page lead to the PDF in its folder, where it said how to print one; a new site says so again."""
    link = rf'\g<1><a class="reference internal" href="{NAME}">The book as one PDF</a>.</span>'
    text = start.read_text(encoding="utf-8")
    write_whole(start, re.sub(r'(<span class="as-pdf">).*?</span>', link, text))


def main() -> int:
    """Write the PDF of the current project by the Chromium named; return 0, or 2 for wrong input."""
    try:
        place = write_pdf(find_project(), sys.argv[1])
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    print(f"The book in one file: {shown(place)} ({place.stat().st_size / 1e6:.1f} MB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
