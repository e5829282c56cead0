"""What the pages weigh, listed after the tests that loaded them."""

from __future__ import annotations

import csv
from pathlib import Path

LIST = Path(__file__).resolve().parents[2] / "book" / "_build" / "page_weights.csv"
HEAVIEST = 10
collect_ignore = ["conftest.py"]  # it has no examples to run, and another folder has a module of this name


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
