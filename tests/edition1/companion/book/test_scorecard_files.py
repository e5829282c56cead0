"""What the site serves of the scorecard: JSON, a badge, the picture and its text, links and counts."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from fractions import Fraction

import pytest

from edition1.errors import InputError
from edition1_companion.book.after.scorecard_files import (
    HIGHEST,
    badge,
    badge_text,
    height_of,
    picture_alt,
    picture_page,
    scorecard_json,
    write_scorecard_files,
)
from edition1_companion.book.project import Project
from edition1_companion.book.scorecard import ScorecardRow
from edition1_companion.book.scorecard_page import anchor, counts_page, scorecard_page
from edition1_companion.book.verdicts import Verdict, band, within_band

SVG = "{http://www.w3.org/2000/svg}"


def row(verdict: Verdict, published: str = "2.0", regenerated: str = "1.0", **other: str) -> ScorecardRow:
    """Return a row of the scorecard."""
    texts = {"paper": "baaij2023", "artefact": "Table 1", "row": "n_b=1", "quantity": "e_u", "unit": "mT"}
    texts |= {"published_std": "", "regenerated_std": "", "n_seeds": "3", "setting": "x", "best": ""}
    texts |= {"best_method": "", "note": ""} | other
    return ScorecardRow(
        published=published, regenerated=regenerated, verdict=verdict, weak=False, near_edge=False, **texts
    )


ROWS = [
    row(Verdict.REPRODUCED, regenerated="2.04"),
    row(Verdict.BETTER, row="n_b=2", published_std="0.1"),
    row(Verdict.DIFFERS, row="n_b=3", regenerated="100"),
    row(Verdict.NOT_COMPARABLE, paper="martin2022", artefact="Fig. 3", regenerated="0.2"),
    row(Verdict.MISSING, paper="martin2022", artefact="Fig. 3", row="M2", regenerated=""),
]


def test_json():
    """Numbers are numbers, whole ones whole, and null where there is none."""
    content = json.loads(scorecard_json(ROWS))
    assert content["counts"]["all"] == {
        "reproduced": 1,
        "better": 1,
        "differs": 1,
        "weak": 0,
        "printed_again": 0,
        "not_comparable": 1,
        "missing": 1,
    }
    assert content["counts"]["martin2022"]["missing"] == 1
    first = content["rows"][0]
    assert (first["published"], first["regenerated"], first["n_seeds"], first["best"]) == (2.0, 2.04, 3, None)
    assert isinstance(first["n_seeds"], int)
    assert (first["weak"], first["verdict"], first["unit"]) == (False, "reproduced", "mT")


def test_badge():
    """The badge shows the rows that count and is named by all; text and telephone are wide enough."""
    assert badge_text(ROWS) == "1 reproduced, 1 better, 1 differs, 1 not comparable, 1 missing"
    assert badge_text(ROWS[:2]) == "1 reproduced, 1 better"
    root = ET.fromstring(badge(ROWS))
    assert root.get("aria-label") == f"5 published numbers: {badge_text(ROWS)}"
    drawn = [text.text or "" for text in root.findall(f".//{SVG}text")]
    assert drawn == ["3 compared", "1 reproduced, 1 better, 1 differs"]
    assert 6 * len("".join(drawn)) < float(root.get("width") or 0) < 360
    assert [text.text for text in ET.fromstring(badge([])).findall(f".//{SVG}text")] == ["0 compared", "none"]


def test_band_is_the_one_of_the_verdict():
    """The edge of the drawn band is where the verdict changes."""
    for printed, s_pub, s_reg in (("1.7", "", ""), ("1.0", "0.3", "0.4"), ("60", "", "0.01")):
        edge = band(printed, s_pub, s_reg)
        for factor, inside in ((0.999, True), (1.001, False)):
            assert within_band(Fraction(edge * factor), printed, s_pub, s_reg) is inside


def test_picture_shows_every_row():
    """Every row has one dot at its ratio, or at the edge beyond which it lies; it says which row, and leads to it."""
    page = picture_page(ROWS)
    assert "\n\n" not in page, "a blank line would end the block of HTML"
    figure = ET.fromstring(page.replace("&nbsp;", " "))
    links = figure.findall(f".//{SVG}a")
    assert [link.get("href") for link in links] == [f"#{anchor(row)}" for row in ROWS]
    assert [link.get("tabindex") for link in links] == ["0", "-1", "-1", "-1", "-1"]
    heights = [float(link.find(f"{SVG}use").get("y")) for link in links]
    tops = [min(heights[:3]), min(heights[3:])]  # two lines, of three rows and of two
    assert heights[0] - tops[0] == pytest.approx(height_of(2.04 / 2) - height_of(HIGHEST), abs=0.1)
    assert heights[2] == tops[0], "fifty times the published number stands at the upper edge"
    assert heights[4] - heights[3] == 0, "a tenth of it, and a missing one, stand at the lower edge"
    titles = [link.findtext(f"{SVG}title") for link in links]
    assert (
        titles[0]
        == "Baaij et al. (2023), Table 1, nb = 1, eu: published 2.0 mT, regenerated 2.04 mT, reproduced"
    )
    assert titles[4].endswith("published 2.0 mT, regenerated –, missing")
    labels = [text.text for text in figure.iter(f"{SVG}text")]
    assert {"Baaij, Table 1", "Martin, Fig. 3"} <= set(labels)
    assert picture_alt(ROWS) == (
        "Regenerated over published for 5 numbers of the papers: 1 reproduced, 1 better, 1 differs, "
        "1 not comparable, 1 missing. The 3 ratios that are compared go from 0.5 to 50, median 1.02."
    )
    assert picture_alt(ROWS[4:]).endswith("1 missing.")


def test_every_row_leads_to_its_page():
    page = scorecard_page(ROWS, {("baaij2023", "Table 1"): "notebooks/table_1.html#fig-table-1"})
    assert page.startswith('<div class="scorecard-filter"></div>\n\n<details class="published-table">')
    assert page.count('<a href="notebooks/table_1.html#fig-table-1">') == 4  # three rows and the caption
    assert page.count("data-verdict=") == len(ROWS)
    assert '<th scope="row">M2, <i>e</i><sub>u</sub></th>' in page
    assert 'data-paper="Martin et al. (2022)" data-artefact="Fig. 3"' in page
    assert "scorecard-filter" not in scorecard_page(ROWS)


def test_counts_lead_to_the_rows_that_they_count():
    page = counts_page(ROWS)
    assert (
        '<a href="scorecard.html?paper=Martin+et+al.+%282022%29&amp;verdict=not+comparable" '
        'aria-label="1 not comparable of Martin et al. (2022)">1</a>'
    ) in page
    assert re.search(r"\| weak \| 0 \| 0 \| 0 \|", page)


def test_files(tmp_path):
    """All that pages include is written, twice the same."""
    project = Project(tmp_path)
    (tmp_path / "data" / "published").mkdir(parents=True)
    (tmp_path / "data" / "published" / "index.csv").write_text(
        "paper,kind,artefact,shows,status,page,anchor,code,note\n"
        "martin2022,figure,Fig. 3,errors,regenerated,notebooks/imu_markers,fig-imu-markers,,synthetic\n",
        encoding="utf-8",
    )
    with pytest.raises(
        InputError, match="page of index.csv must be a page of the book; instead received note"
    ):
        write_scorecard_files(project, ROWS)
    project.notebooks.mkdir()
    cell = {"cell_type": "markdown", "source": ["# Markers\n", "\n", "Text."]}
    (project.notebooks / "imu_markers.ipynb").write_text(json.dumps({"cells": [cell]}), encoding="utf-8")
    write_scorecard_files(project, ROWS)
    folder = project.book / "generated"
    first = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert sorted(first) == [
        "counts.md",
        "papers.md",
        "scorecard.json",
        "scorecard.md",
        "scorecard.svg",
        "scorecard_picture.md",
        "verdicts_baaij2023.md",
        "verdicts_martin2022.md",
    ]
    assert b"notebooks/imu_markers.html#fig-imu-markers" in first["scorecard.md"]
    assert b'<a href="notebooks/imu_markers.html#fig-imu-markers">Markers</a>' in first["papers.md"]
    assert b'aria-label="Regenerated over published for 5 numbers' in first["scorecard_picture.md"]
    write_scorecard_files(project, ROWS)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == first
