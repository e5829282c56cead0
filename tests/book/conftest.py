"""Pages with one live figure; and what the pages of the site weigh, listed after the tests that loaded them."""

from __future__ import annotations

import csv
from contextlib import ExitStack
from pathlib import Path

import pytest
from page_visit import open_page

LIST = Path(__file__).resolve().parents[2] / "book" / "_build" / "page_weights.csv"
HEAVIEST = 10
LIVE = Path(__file__).resolve().parents[2] / "book" / "_static" / "live"
DATA = {"landscape": ["landscape_grid"]}
"""Scripts with data that a live figure needs, as the extension of the site has it."""
PAGE = """<!doctype html><html lang="en" data-theme="light"><meta charset="utf-8"><title>A live figure</title>
<meta name="viewport" content="width=device-width"><link rel="stylesheet" href="{folder}/live.css">
<style>:root {{ --pst-color-background: #fff; --pst-color-text-base: #222; --pst-color-primary: #06c; }}</style>
<main><h1>A live figure</h1>{box}</main>{scripts}"""
collect_ignore = ["conftest.py"]  # it has no examples to run, and another folder has a module of this name


@pytest.fixture
def figure(browser, tmp_path):
    """Open a page with one figure, and close it; nothing may be said on the console, and nothing asked outside."""
    opened, pages = [], ExitStack()

    def show(name: str, address: str = "", *, width: int = 900):
        parts = ("model", "figure", *DATA.get(name, []), name)
        scripts = "".join(f'<script src="{LIVE.as_uri()}/{part}.js"></script>' for part in parts)
        box = f'<div class="live-figure" data-live="{name}"></div>'
        path = tmp_path / f"{name}.html"
        path.write_text(PAGE.format(folder=LIVE.as_uri(), box=box, scripts=scripts), encoding="utf-8")
        opened.append(pages.enter_context(open_page(browser, path.as_uri() + address, width=width)))
        return opened[-1][0]

    with pages:
        yield show
        for page, _ in opened:
            page.wait_for_timeout(50)
    for _, seen in opened:
        assert seen.console == []
        assert seen.asked_outside() == []


def pytest_terminal_summary(terminalreporter) -> None:
    """List the heaviest pages, and write all of them beside the site."""
    weights = {}
    for outcome in ("passed", "failed"):
        for report in terminalreporter.getreports(outcome):
            properties = dict(report.user_properties)
            if "page_bytes" in properties:
                weights[properties["page"]] = (properties["page_bytes"], properties["shape_view_bytes"])
    if not weights:
        return
    ordered = sorted(weights.items(), key=lambda item: -item[1][0])
    terminalreporter.section(f"page weights, all in {LIST.name}")
    for page, (total, of_views) in ordered[:HEAVIEST]:
        views = f", of it {of_views / 1e6:.2f} MB for 3-D views" if of_views else ""
        terminalreporter.line(f"{total / 1e6:6.2f} MB  {page}{views}")
    with LIST.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(("page", "bytes", "bytes_of_3d"))
        writer.writerows((page, *sizes) for page, sizes in sorted(weights.items()))
