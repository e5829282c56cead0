"""The scorecard from files: every row listed, broken files refused, pages and reference written."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from edition1.errors import InputError
from edition1_companion.book.after.scorecard_files import badge_text, picture_alt, scorecard_json
from edition1_companion.book.project import Project, find_project
from edition1_companion.book.published import read_csv, read_published, row_key
from edition1_companion.book.results import write_scorecard_rows
from edition1_companion.book.scorecard import (
    COLUMNS,
    KINDS,
    REFERENCE_COLUMNS,
    ScorecardRow,
    changed_verdicts,
    compare_files,
    compute_scorecard,
    geometric_mean_ratio,
    kinds,
    scorecard_csv,
    summary,
    telling,
)
from edition1_companion.book.scorecard_page import anchor, counts_page, scorecard_page, verdicts_page, words
from edition1_companion.book.verdicts import Verdict

E_U = {"paper": "a2020", "artefact": "Table 1", "row": "one", "quantity": "e_u", "unit": "mT", "setting": "x"}
RATE = {
    "paper": "b2021",
    "artefact": "Fig. 2",
    "row": "one",
    "quantity": "update_rate",
    "unit": "Hz",
    "setting": "y",
}


@pytest.fixture
def project(root: Path, monkeypatch: pytest.MonkeyPatch) -> Project:
    monkeypatch.setenv("REPRO_RESULTS_DIR", "results")
    return find_project()


def test_columns():
    assert ", ".join(COLUMNS) == (
        "paper, artefact, row, quantity, unit, published, published_std, regenerated, regenerated_std, n_seeds, "
        "setting, verdict, weak, near_edge, best, best_method, note"
    )


def test_every_row_is_listed_from_the_start(project):
    assert scorecard_csv(compute_scorecard(project)) == (
        ",".join(COLUMNS) + "\n"
        "a2020,Table 1,one,e_u,mT,0.015,0.002,,,,,missing,false,false,,,\n"
        "a2020,Table 1,two,e_u,mT,0.016,,,,,,missing,false,false,,,\n"
        "b2021,Fig. 2,one,update_rate,Hz,60,,,,,,missing,false,false,,,\n"
    )


def test_rows_from_several_files(project):
    write_scorecard_rows([{**E_U, "regenerated": 0.016, "n_seeds": 3}], "first")
    write_scorecard_rows([{**RATE, "regenerated": 90}], "second")
    rows = compute_scorecard(project)
    assert [row.verdict for row in rows] == ["reproduced", "missing", "better"]
    assert summary(rows) == (
        "       reproduced  better  differs  weak  printed again  not comparable  missing  all\n"
        "a2020           1       0        0     0              0               0        1    2\n"
        "b2021           0       1        0     0              0               0        0    1\n"
        "all             1       1        0     0              0               0        1    3"
    )


def test_timings_are_never_compared(project):
    write_scorecard_rows([{**RATE, "regenerated": 90, "setting": "benchmark"}], "timings")
    assert compute_scorecard(project)[2].verdict == "not_comparable"


def test_a_difference_needs_a_note(project):
    write_scorecard_rows([{**E_U, "regenerated": 0.03}], "first")
    with pytest.raises(InputError) as refused:
        compute_scorecard(project)
    assert str(refused.value) == (
        "Input note of the scorecard must be given where a number differs; "
        "instead received none for a2020 / Table 1 / one / e_u / mT."
    )
    write_scorecard_rows([{**E_U, "regenerated": 0.03, "note": "another magnet"}], "first")
    assert compute_scorecard(project)[0].verdict == "differs"


def test_a_number_regenerated_twice_is_refused(project):
    for name in ("first", "second"):
        write_scorecard_rows([{**E_U, "regenerated": 0.015}], name)
    with pytest.raises(
        InputError, match=r"must be regenerated once; instead received first.rows.csv and second"
    ):
        compute_scorecard(project)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "paper,artefact\n",
            "Input columns of published.csv must be paper, artefact, row, quantity, unit, value, std",
        ),
        ("HEAD\na,b,c,d,e,1\n", "Input line 2 of published.csv must be 7 cells; instead received 6."),
        ("HEAD\na,b,c,d,e,x,\n", "Input value of published.csv must be a number in row a / b / c / d / e"),
        ("HEAD\na,b,c,d,e,nan,\n", "Input value of published.csv must be a number in row a / b / c / d / e"),
        ("HEAD\na,b,c,d,e,1,\na,b,c,d,e,2,\n", "Input row of published.csv must be listed once"),
    ],
)
def test_broken_published_numbers_are_refused(tmp_path, text, message):
    path = tmp_path / "published.csv"
    path.write_text(text.replace("HEAD", "paper,artefact,row,quantity,unit,value,std"))
    with pytest.raises(InputError) as refused:
        read_published(path)
    assert message in str(refused.value)


def test_missing_published_numbers_are_refused(tmp_path):
    with pytest.raises(InputError, match="Input file of the scorecard must be an existing CSV file"):
        read_published(tmp_path / "published.csv")


def test_changed_verdicts(project, tmp_path):
    """Any other verdict is told, a better one too, and a row that only one list has."""
    reference = tmp_path / "reference.csv"
    write_scorecard_rows([{**E_U, "regenerated": 0.015}, {**RATE, "regenerated": 90}], "first")
    reference.write_text(scorecard_csv(compute_scorecard(project), REFERENCE_COLUMNS))
    assert changed_verdicts(compute_scorecard(project), reference) == []
    write_scorecard_rows([{**E_U, "regenerated": 0.001}, {**RATE, "regenerated": 1, "note": "slow"}], "first")
    assert changed_verdicts(compute_scorecard(project), reference) == [
        "a2020 / Table 1 / one / e_u / mT: was reproduced, is better",
        "b2021 / Fig. 2 / one / update_rate / Hz: was better, is differs",
    ]
    gone = [row for row in compute_scorecard(project) if row.paper == "a2020"]
    assert "was better, is not listed" in changed_verdicts(gone, reference)[1]
    lines = reference.read_text().splitlines(keepends=True)
    reference.write_text("".join(lines[:-1]))
    assert changed_verdicts(compute_scorecard(project), reference)[1:] == [
        "b2021 / Fig. 2 / one / update_rate / Hz: is not in reference.csv, is differs"
    ]


@pytest.mark.parametrize(
    ("regenerated", "verdict", "near"),
    # the band of 0.015 +- 0.002 is 0.002 sqrt(3) = 0.003464 wide on each side
    [
        (0.0182, "reproduced", False),
        (0.0184, "reproduced", True),
        (0.0186, "differs", True),
        (0.0187, "differs", False),
        (0.0116, "reproduced", True),
        (0.0114, "better", True),
    ],
)
def test_near_the_edge_of_a_band(project, tmp_path, regenerated, verdict, near):
    """Within 5 % of the edge a row is marked, on the page, in the table, and where its verdict has changed."""
    write_scorecard_rows([{**E_U, "regenerated": regenerated, "note": "n"}], "first")
    rows = compute_scorecard(project)
    assert (rows[0].verdict, rows[0].near_edge) == (verdict, near)
    assert ("near the edge" in scorecard_page(rows)) == near
    reference = tmp_path / "reference.csv"
    reference.write_text(scorecard_csv(rows, REFERENCE_COLUMNS).replace(verdict, "not_comparable", 1))
    (changed,) = changed_verdicts(rows, reference)
    assert changed.endswith("(within 5 % of the edge of its band)") == near


def test_what_is_not_compared_is_not_near_an_edge(project):
    write_scorecard_rows([{**E_U, "regenerated": 0.0184, "comparable": False}], "first")
    assert not any(row.near_edge for row in compute_scorecard(project))


def test_a_reference_with_an_unknown_verdict_is_refused(project, tmp_path):
    reference = tmp_path / "reference.csv"
    reference.write_text(",".join(REFERENCE_COLUMNS) + "\na,b,c,d,e,fine\n")
    with pytest.raises(InputError, match="Input verdict of reference.csv must be one of reproduced, better"):
        changed_verdicts(compute_scorecard(project), reference)


def test_geometric_means(project):
    write_scorecard_rows(
        [
            {**E_U, "regenerated": 0.03, "regenerated_std": 0.004, "note": "n"},
            {**E_U, "row": "two", "regenerated": 0.008},
            {**RATE, "regenerated": 1, "comparable": False},
        ],
        "first",
    )
    rows = compute_scorecard(project)
    mean, count = geometric_mean_ratio(rows, lambda row: row.regenerated, lambda row: row.published)
    assert (mean, count) == (pytest.approx(1.0), 2)
    mean, count = geometric_mean_ratio(rows, lambda row: row.regenerated_std, lambda row: row.published_std)
    assert (mean, count) == (pytest.approx(2.0), 1)


def test_pages(project):
    write_scorecard_rows(
        [
            {**E_U, "regenerated": 0.0301, "regenerated_std": 0.004, "n_seeds": 3, "note": "<b>\n\nx"},
            {**E_U, "row": "two", "regenerated": 0.00001, "best": 0.002, "best_method": "LM"},
        ],
        "first",
    )
    rows = compute_scorecard(project)
    page = scorecard_page(rows, {("b2021", "Fig. 2"): "notebooks/rates.html"})
    assert page.count("<table") == 2
    assert page.count('<th scope="row">') == 3
    assert "a2020, Table 1</span>" in page
    assert ": 1 better, 1 differs. Regenerated / published, geometric mean of 2" in page
    assert "of 1 standard deviations: 2.00" in page
    assert (
        'data-verdict="differs"><tr><th scope="row">one, <i>e</i><sub>u</sub></th>'
        "<td>0.015 ±\xa00.002\xa0mT</td><td>0.0301 ±\xa00.0040\xa0mT</td><td>±\xa00.0077\xa0mT</td>"
        '<td><span class="verdict verdict-differs">differs</span></td></tr>'
        '<tr class="remarks"><td colspan="5">&lt;b&gt; x. <span class="setting">Setting: x, 3 seeds.</span></td></tr>'
    ) in page
    assert 'data-ratio="2.007"' in page
    assert "<td>0.000010\xa0mT</td>" in page
    assert '<span class="best">Best: 0.0020\xa0mT (LM).</span>' in page
    assert 'class="verdict verdict-missing">missing<' in page
    assert '<a href="notebooks/rates.html">one</a>, update rate' in page
    # a blank line inside a table would end the block of HTML
    blocks = page.strip().split("\n\n")
    assert blocks[0] == '<div class="scorecard-filter"></div>'
    assert all(
        block.startswith("<details") and block.endswith("</table>\n</details>") for block in blocks[1:]
    )
    sentence, _, bias, _, header = counts_page(rows).splitlines()[:5]
    assert sentence == (
        "Of the 3 numbers that the papers print, 2 can be compared. 0 of these are weak, since zero would pass too,"
        " and 0 print a run again. **Of the 2 left, 0 are reproduced, 1 better, and 1 differ.**"
        " 0 are not comparable, 1 missing."
    )
    assert bias.startswith("The bias: 1 of the 2 lie below the published number; the geometric mean")
    assert header == "| | a2020 | b2021 | All |"


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("n_s=6", "<i>n</i><sub>s</sub> = 6"),
        ("d_s_r=16mm", "<i>d</i><sub>s,r</sub> = 16\N{NO-BREAK SPACE}mm"),
        ("delta_L_2", "δ<i>L</i><sub>2</sub>"),
        ("delta_y", "Δ<i>y</i>"),
        ("n_e=(0,0,1)", "<i>n</i><sub>e</sub> = (0,0,1)"),
        ("T5.train->T0.test", "T5.train → T0.test"),
        ("rad/m^2", "rad/m²"),
        ("<b>", "&lt;b&gt;"),
    ],
)
def test_names_are_written_with_the_letters_of_the_papers(name, written):
    assert words(name) == written


def test_no_name_of_a_file_is_left_on_the_page():
    """Rows, quantities and units of all published numbers are words or letters."""
    published = read_published(find_project(Path(__file__).parent).published)
    names = {name for key in published for name in (key.row, key.quantity, key.unit)}
    assert [name for name in names if "_" in words(name) or "&gt;" in words(name)] == []


def test_every_count_is_apart_for_weak_rows_and_runs_printed_again(project):
    """Page, picture, badge, chapter and JSON count the same."""
    weak = {**E_U, "regenerated": 0.001, "regenerated_std": 0.05, "n_seeds": 3, "note": "n"}
    again = {**E_U, "row": "two", "regenerated": 0.0301, "note": "n"}
    write_scorecard_rows([weak, again, {**RATE, "regenerated": 1, "comparable": False}], "first")
    rows = compute_scorecard(project)
    first = [row for row in rows if row.row == "two"]
    rows += [replace(row, row="three") for row in first]
    kind = first[0].verdict.words
    counts = {kind: 1, "weak": 1, "printed again": 1, "not comparable": 1}
    said = ", ".join(f"{counts[name]} {name}" for name in KINDS if name in counts)
    assert badge_text(rows) == said
    assert f"{len(rows)} numbers of the papers: {said}. The 1 ratios" in picture_alt(rows)
    ours = [row for row in rows if row.paper == "a2020"]
    assert verdicts_page(ours).endswith(f"Table 1: {said.removesuffix(', 1 not comparable')}.\n")
    of_all = json.loads(scorecard_json(rows))["counts"]["all"]
    assert {name.replace("_", " "): n for name, n in of_all.items() if n} == counts
    assert f": {said.removesuffix(', 1 not comparable')}. Regenerated / published, geometric mean of 1:" in (
        scorecard_page(rows)
    )


def test_weak_rows_and_runs_printed_again_count_apart():
    """Whatever their verdict; the first row of a run counts, and a weak row is no run of another."""

    def row(
        name: str, verdict: Verdict, regenerated: str, *, weak: bool = False, quantity: str = "e"
    ) -> ScorecardRow:
        texts = dict.fromkeys(COLUMNS, "") | {
            "paper": "a",
            "row": name,
            "quantity": quantity,
            "published": "1",
        }
        flags = {"verdict": verdict, "weak": weak, "near_edge": False, "regenerated": regenerated}
        return ScorecardRow(**texts | flags)  # pyright: ignore

    rows = [
        row("1", Verdict.REPRODUCED, "2", weak=True),
        row("2", Verdict.REPRODUCED, "2"),
        row("3", Verdict.DIFFERS, "2"),
        row("4", Verdict.BETTER, "2", quantity="f"),
        row("5", Verdict.NOT_COMPARABLE, "2"),
        row("6", Verdict.MISSING, ""),
    ]
    assert kinds(rows) == ["weak", "reproduced", "printed again", "better", "not comparable", "missing"]
    assert [row.row for row in telling(rows)] == ["2", "4"]


def test_numbers_read_off_figures_are_counted():
    """Beside the count stands how many of the numbers are printed nowhere."""
    place = {"paper": "martin2022", "artefact": "Fig. 3", "row": "one", "quantity": "median", "unit": "mm"}
    texts = dict.fromkeys(COLUMNS, "") | place | {"published": "160"}
    rows = [ScorecardRow(**texts | {"verdict": Verdict.MISSING, "weak": False, "near_edge": False})]  # pyright: ignore
    assert counts_page(rows).startswith(
        "Of the 1 numbers that the papers print, or show in figures (1 were read off), 0 can be compared."
    )
    assert verdicts_page(rows) == "Verdicts of the scorecard: Fig. 3: 1 missing.\n"


def test_the_committed_files_list_the_same_rows():
    here = find_project(Path(__file__).parent)
    published = read_published(here.published)
    reference = read_csv(here.data / "scorecard_reference.csv", REFERENCE_COLUMNS)
    assert [row_key(line) for line in reference] == list(published)


def test_every_published_number_has_an_address_of_its_own():
    published = read_published(find_project(Path(__file__).parent).published)
    rows = compare_files([], published)
    addresses = [anchor(row) for row in rows]
    assert len(set(addresses)) == len(rows)
    page = scorecard_page(rows, {})
    assert all(page.count(f'<tbody id="{address}"') == 1 for address in addresses)
    elsewhere = scorecard_page(rows)
    assert "<tbody id=" not in elsewhere, "a page of a notebook may show a row twice"
    assert all(elsewhere.count(f'<a href="../scorecard.html#{address}">') == 1 for address in addresses)
