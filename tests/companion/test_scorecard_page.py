"""The index of the papers, and what the site shows of the scorecard."""

from __future__ import annotations

import inspect
import json
import pkgutil
import re
from html import unescape
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pandas as pd
import pytest

from repro_companion import scorecard_page as page
from repro_companion.claims import CLAIMS
from repro_companion.cli import app
from repro_companion.papers.others import FETCHED
from repro_companion.scorecard import WITH_FILES, beside, kinds, scorecard
from scripts.studies import STUDIES

ROOT = Path(__file__).resolve().parents[2]
INDEX = pd.read_csv(ROOT / "data/published/index.csv", dtype=str, keep_default_na=False)
ARTEFACT = (ROOT / "book/artifact.md").read_text(encoding="utf-8")
NOISE = pd.read_csv(ROOT / "data/studies/table_1_noise.csv")
NETWORKS = pd.read_csv(ROOT / "data" / "studies" / "table_2_networks.csv")
NUMBERED = {
    "baaij2023": {"Table": ["1", "2"], "Fig.": range(1, 12), "eq.": range(1, 19)},
    "mitchell2021": {"Table": [], "Fig.": range(1, 10), "eq.": range(1, 8)},
    "martin2022": {"Table": ["I", "II"], "Fig.": range(1, 7), "eq.": range(1, 8)},
}
"""What each paper numbers, counted in the papers."""
TRAJECTORIES = {
    "baaij2023": {"full lemniscate", "affine flower", "T0", "T1", "T2", "T3", "T4", "T5"},
    "mitchell2021": {"Spiral", "Flower", "Seagull"},
    "martin2022": {"oscillating", "buckling", "circling"},
}
MACHINE_NAME = re.compile(r"(?<![\w./])[A-Za-z]\w*_\w+(?!\w*\.\w)")


FILES = ROOT / "data/published/published.csv", sorted((ROOT / "results").glob("*.rows.csv"))


@pytest.fixture(scope="module")
def card() -> pd.DataFrame:
    return scorecard(*FILES)


@pytest.fixture(scope="module")
def real(tmp_path_factory) -> pd.DataFrame:
    """Return the scorecard as it would be with files of Martin et al.: made-up numbers for Table II."""
    rows = pd.read_csv(ROOT / "results/imu_markers.rows.csv", dtype=str, keep_default_na=False)
    rows = rows[rows["artefact"] == "Table II"].assign(
        setting="authors' files, made up", regenerated="99", regenerated_std="1", comparable="true"
    )
    path = tmp_path_factory.mktemp("made_up") / "made_up.rows.csv"
    rows.to_csv(path, index=False)
    return scorecard(*FILES, [path])


@pytest.fixture(scope="module", params=["without", "with"])
def state(request, card, real) -> pd.DataFrame:
    """Return the second state of the scorecard: as without files, or with made-up numbers."""
    return {"without": card, "with": real}[request.param]


def project(root: Path) -> Path:
    """Return a folder with the data, the notebooks and the texts of this project."""
    (root / "book").mkdir()
    texts = [f"book/{path.name}" for path in (ROOT / "book").glob("*.md")]
    for name in ("data", "notebooks", "results", "scripts", "book/measured.csv", *texts):
        (root / name).symlink_to(ROOT / name)
    return root


@pytest.fixture(scope="module")
def written(card, state, tmp_path_factory) -> dict[str, str]:
    """Return what is written for a project with the pages of this one."""
    root = project(tmp_path_factory.mktemp("project"))
    page.write_pages(root, card, state)
    return {path.name: path.read_text(encoding="utf-8") for path in (root / "book/generated").iterdir()}


# The index


@pytest.mark.parametrize("paper", NUMBERED)
def test_every_number_of_the_papers_is_listed(paper):
    """No table, figure, equation or trajectory of a paper is left out, and no number is made up."""
    listed = INDEX[INDEX["paper"] == paper]["artefact"]
    for word, numbers in NUMBERED[paper].items():
        found = {match[1] for one in listed if (match := re.match(rf"{re.escape(word)} \(?(\w+)\)?", one))}
        assert found == {str(number) for number in numbers}, word
    assert set(listed) >= TRAJECTORIES[paper]


def test_the_index_has_one_row_for_everything_and_known_words():
    assert not INDEX.duplicated(["paper", "kind", "artefact"]).any()
    assert set(INDEX["kind"]) == {"table", "figure", *page.FOLDED}
    assert set(INDEX["status"]) <= {"regenerated", "redrawn", "implemented", "not reproduced"}


def anchors(name: str) -> set[str]:
    """Return the names of a page's figures and schematics, and its headings as links have them."""
    notebook = ROOT / f"{name}.ipynb"
    figures = set()
    if notebook.is_file():
        cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
        figures = {cell["metadata"].get("mystnb", {}).get("figure", {}).get("name", "") for cell in cells}
        text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    else:
        text = (ROOT / "book" / f"{name}.md").read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    for file in re.findall(r"^:file: .*?(schematics/.+)$", text, flags=re.MULTILINE):
        figures |= set(re.findall(r'<svg id="(.+?)"', (ROOT / "book" / file).read_text(encoding="utf-8")))
    return figures | {re.sub(r"[^a-z0-9]+", "-", heading.lower()).strip("-") for heading in headings}


@pytest.mark.parametrize(
    "entry", INDEX.to_dict("records"), ids=lambda one: f"{one['paper']}-{one['artefact']}"
)
def test_places_exist(entry):
    """The page is in the book and has the figure or heading; the code can be imported."""
    assert not entry["anchor"] or entry["anchor"] in anchors(entry["page"])
    if entry["code"]:
        found = pkgutil.resolve_name(entry["code"])
        assert entry["code"] == f"{found.__module__}.{found.__qualname__}"


def test_every_entry_is_a_row_that_leads_to_its_place(written):
    text = written["index.md"]
    assert re.findall(r"^### (.+)$", text, re.MULTILINE) == list(page.PAPERS.values())
    assert text.count("<tr><th") == len(INDEX) + text.count("<thead>")
    links = re.findall(r'<th scope="row"><a href="(.*?)">(.*?)</a>', text)
    there = INDEX["page"] + ".html" + ("#" + INDEX["anchor"]).str.rstrip("#")
    assert sorted(links) == sorted(zip(there, INDEX["artefact"], strict=True))
    assert not re.search(r"\n\n(?!<|#)", text.rstrip()), "an empty line ends a block of HTML"


def test_the_finder_leads_to_what_is_there(written):
    """Table II has a link by its number, and no photograph has one."""
    links = re.findall(r'href="(.*?)" title="(.*?)"', written["find.md"])
    assert any(name == "Table II" and link.startswith("notebooks/") for link, name in links)
    assert (
        written["find.md"].count("<a ")
        == (INDEX["kind"].isin(["table", "figure"]) & (INDEX["status"] != "not reproduced")).sum()
    )


@pytest.mark.parametrize(
    ("found", "word"),
    [
        (["reproduced", "better", "weak"], "reproduced"),
        (["reproduced"] * 3 + ["differs"], "mostly reproduced"),
        (["reproduced", "differs", "weak"], "differs"),
        (["differs"], "differs"),
        (["not comparable", "weak", "not comparable"], "not comparable"),
    ],
)
def test_a_verdict_in_a_word(found, word):
    assert page.verdict_in_a_word(pd.Series(found)) == word


def test_what_recordings_make_real_is_no_longer_synthetic(card, tmp_path, monkeypatch):
    """Figures on recordings of a paper, once these are there; a trial that is not public stays synthetic."""
    root = project(tmp_path)
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path / "recordings"))
    counted = []
    for paper in ("other", "baaij2023", "mitchell2021", "martin2022"):
        (tmp_path / "recordings" / paper).mkdir(parents=True)
        (tmp_path / "recordings" / paper / "a.csv").write_text("1\n")
        page.write_pages(root, card, card)
        counted.append((root / "book/generated/index.md").read_text(encoding="utf-8").count("(synthetic)"))
    synthetic = INDEX[INDEX["note"].str.contains("synthetic")]
    real = synthetic["note"].str.contains("where they are found")
    assert counted[0] > counted[1] >= counted[2] >= counted[3]
    assert (counted[3] > 0) == (~real).any()


# Counts and rows


def test_every_count_leads_to_the_rows_that_it_counts(card, state, written):
    """In both states: a paper of which a number was computed with its files has a second line."""
    tables = r'data-paper="(.*?)"|<tbody id=".*?" data-verdict="(.*?)" data-files="(.*?)"'
    listed, paper = [], ""
    for about, verdict, files in re.findall(tables, unescape(written["rows.md"])):
        paper = about or paper
        listed += [{"paper": paper, "verdict": verdict, "files": files}] * bool(verdict)
    assert len(listed) == len(card)
    found = {"verdict": 0, "files": 0}
    for link, count in re.findall(r'href="(.*?)".*?>(\d+)</a>', unescape(written["counts.md"])):
        parts = urlsplit(link)
        chosen = {key: value for key, (value,) in parse_qs(parts.query).items()}
        assert (parts.path, parts.fragment) == ("scorecard.html", "all-rows")
        assert sum(chosen.items() <= row.items() for row in listed) == int(count)
        found[min(chosen.keys() - {"paper"})] += int(count)
    second = 0 if state is card else 43
    assert found == {"verdict": len(card), "files": second}


def test_a_column_has_the_numbers_with_the_authors_files(card, state, written):
    """Only a table with such a number has it; the numbers without the files stay where they were."""
    for artefact in ("Table II", "Fig. 3"):
        text = written["rows.md"].partition(f'data-artefact="{artefact}"')[2].partition("</table>")[0]
        known = state is not card and artefact == "Table II"
        assert text.count("files, made up") == text.count(f'<th scope="col">{page.REAL}</th>') == known
        cells = re.findall("<td>(.*?)</td>", text.partition("<tbody")[2].partition("</tr>")[0])
        assert ">not comparable<" in cells[3]
        assert [cell.partition("\N{NO-BREAK SPACE}")[0] for cell in cells[4:]] == ["99.0 ± 1.00"] * known
        row = re.search(rf">{artefact}</a>.*?</tr>", written["index.md"])[0]
        assert ("with the authors' files: " in row) == known


def test_every_row_has_an_address_and_no_name_of_a_file(written):
    ids = re.findall(r'<tbody id="(.*?)"', written["rows.md"])
    assert len(set(ids)) == len(ids) > 200
    text = re.sub(r"<code>.*?</code>|<[^>]*>", " ", written["rows.md"] + written["index.md"])
    assert [found[0] for found in MACHINE_NAME.finditer(text)] == []


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("psi_s=10deg", "ψ = 10°"),
        ("delta_x_1", "Δ<i>x</i><sub>1</sub>"),
        ("delta_L", "δ<i>L</i>"),
        ("kappa_0", "κ<sub>0</sub>"),
        ("n_b=2, d_s_r=18mm", "<i>n</i><sub>b</sub> = 2, <i>d</i><sub>s,r</sub> = 18\N{NO-BREAK SPACE}mm"),
        ("noise 7.1e-4 mT at -3", "noise 7.1 × 10<sup>−4</sup> mT at −3"),
        ("T5.train->T5.test", "T5.train → T5.test"),
        ("a < b & c", "a &lt; b &amp; c"),
        ("tip_error_x, see new_file.csv", "tip error x, see new_file.csv"),
    ],
)
def test_names_are_written_with_the_letters_of_the_papers(name, shown):
    assert page.words(name) == shown


def test_a_row_says_why_it_counts_apart_and_what_we_reach(card):
    row = card.iloc[1].to_dict() | {"kind": "weak", "verdict": "reproduced", "near_edge": "true"}
    row |= {"width": 0.25, "best": "0.1234", "note": "of three seeds", "unit": "%", "real_kind": ""}
    row |= dict.fromkeys(WITH_FILES, "") | {"name": "B"}

    def shown(**other: str) -> str:
        return page.rows_page(pd.DataFrame([row | other]), {("B", row["artefact"]): "p.html"})

    text = shown()
    assert "weak</span> (reproduced), near the edge</td>" in text
    assert "±\N{NO-BREAK SPACE}0.25\N{NO-BREAK SPACE}%" in text
    assert "Of three seeds. " in text
    assert "Our best: 0.123\N{NO-BREAK SPACE}%." in text
    assert "–</td>" in shown(verdict="not_comparable"), "without a band"
    assert "Our method: " in shown(best="1e9"), "not better"


# Home


def test_the_numbers_of_the_home_page_are_means():
    """Of numbers like 1, 2 and 6; readings, and noise that is not the printed one, do not count."""
    numbers = pd.DataFrame(
        {"published": [2, 4, 12], "regenerated": [1, 2, 6], "best": [0.1, 0.2, 0.6]}, dtype=str
    )
    numbers = numbers.assign(paper="a paper", verdict="reproduced", weak="false", regenerated_std="0")
    ring = numbers.assign(artefact="Table 1", row="n_b=1", unit="%", quantity="delta_x_1")
    bend = numbers.assign(artefact="Section II-D", row="spiral", unit="mm", quantity="rmse_position")
    noise = pd.DataFrame(
        {"row": "n_b=1", "method": "calibrated", "noise_mt": [0.019, 7.1e-4], "error_percent": [9, 99]}
    )
    axes = ["delta_x", "delta_y", "e_u"]
    rig = numbers.assign(artefact="Table 2", row="T5", quantity=axes, unit="mm", regenerated=["1", "8", "99"])
    networks = pd.DataFrame({"row": "T5", "quantity": axes, "unit": "mm", "error": [6.0, 4.0, 99.0]})
    others = (
        rig.assign(row="T4", regenerated="12"),
        rig.assign(row="T3", unit="%", regenerated="400"),
        ring.assign(regenerated="9", best="9", unit="mT"),
    )
    found = page.findings(pd.concat([ring, bend, rig, *others]), noise, networks)
    assert list(found.items())[4:] == [
        ("home.ring_paper", "3"), ("home.ring_best", "0.3"), ("home.ring_noisy", "9"), ("home.rig_least", "0.50"),
        ("home.rig_least_on", "T5, Δx"), ("home.rig_most", "6.0"), ("home.rig_most_on", "T4, Δx"),
        ("home.networks_least", "1.0"), ("home.networks_most", "3.0"), ("home.bend_paper", "3"),
        ("home.bend_printed", "6.0"),
    ]  # fmt: skip


def test_the_home_page_names_no_other_numbers(card):
    text = (ROOT / "book/index.md").read_text(encoding="utf-8")
    both = text + (ROOT / CLAIMS).read_text(encoding="utf-8")
    assert set(re.findall(r"\{(home\.\w+)\}", both)) == set(page.findings(card, NOISE, NETWORKS))
    assert set(page.findings(card.iloc[:0], NOISE.iloc[:0], NETWORKS.iloc[:0]).values()) == {"–"}
    found = text[text.index("## What we found") : text.index("## Find a table")]
    prose = re.sub(r"\{.*?\}|\(.*?\)|`[^`]*`|Table \d", "", found)
    assert re.findall(r"\d", prose) == []


def test_kinds_of_the_index_and_the_scorecard_do_not_mix(card):
    """What has no numbers has the word of the index; the others lead to their rows."""
    card = beside(card, card).assign(name=card["paper"].replace(page.PAPERS), kind=kinds(card))
    entry = {"paper": "baaij2023", "name": "B", "artefact": "Table 1", "status": "implemented"}
    entry |= {"note": "a note", "code": "a.b.track", "real": False}
    text = page.verdict_of(pd.Series(entry), card)
    assert '<a href="scorecard.html?paper=B&amp;artefact=Table+1#all-rows"' in text
    text = page.verdict_of(pd.Series(entry | {"artefact": "eq. (1)"}), card)
    assert text == 'implemented <span class="setting">(<code>track</code>; a note)</span>'


# For evaluators


def test_every_claim_has_a_line_with_a_page_and_its_command(written):
    """Which may stand above it, in the nearest line that has a command."""
    lines, command = written["artifact_claims.md"].splitlines(), ""
    for claim in pd.read_csv(ROOT / "data/published/claims.csv", dtype=str).to_dict("records"):
        (line,) = (line for line in lines if line.startswith(f"| {claim['claim']} ("))
        _, command, cost, *_ = [command if cell == "as above" else cell for cell in line[2:-2].split(" | ")]
        assert (ROOT / f"{claim['page']}.ipynb").is_file()
        assert command.startswith(f"`make page P={Path(claim['page']).name}` [")
        assert command.endswith(f"]({claim['page']}.ipynb)")
        assert re.fullmatch(r"[\d.]+\ss, [\d.]+\sMB", cost) or "as above | – |" in line


def test_a_study_without_a_duration_is_a_copy_or_reads_files_of_others(written):
    """And those that read the authors' networks are the ones that the page names."""
    lines = re.findall(r"scripts/(\w+)\.py (\w+)` .* (\S+) \|$", written["artifact_studies.md"], re.MULTILINE)
    sources = {name: inspect.getsource(study) for name, study in STUDIES.items()}
    copies = {name for name, text in sources.items() if re.search("of_bend_tests|with_recordings", text)}
    assert {name for script, name, takes in lines if takes == "–"} == copies | {*FETCHED}
    assert len(copies) == 5
    (named,) = re.findall(r"^The studies (.+) read the authors' networks", ARTEFACT, re.MULTILINE)
    networks = {name for name, text in sources.items() if "released_networks.load_sensing" in text}
    networks |= {name for name, text in sources.items() if "released_networks.robots" in text}
    assert {*re.findall(r"`(\w+)`", named)} == networks
    assert all(f"P={page}" in ARTEFACT for page in ("bend_tests", "imu_markers"))


def test_a_rate_that_a_page_copies_moves_by_no_tolerance(written):
    """It is measured by another command, on the computer that the benchmark names."""
    (line,) = (one for one in written["artifact_claims.md"].splitlines() if "updates a second" in one)
    assert line.endswith("| – |")


def test_what_evaluators_are_given_can_be_typed(written):
    """Studies and commands; a test of all texts looks at the targets of make."""
    text = ARTEFACT + "".join(written.values())
    included = re.findall(r"\{include\} generated/(artifact_.+)", text)
    assert sorted(included) == sorted(name for name in written if name.startswith("artifact_"))
    assert {*re.findall(r"python scripts/studies\.py (\w+)", text)} == {*STUDIES}
    assert {*re.findall(r"python scripts/others\.py (\w+)", text)} == {*FETCHED}
    assert {*re.findall(r"\brepro ([a-z]+)\b(?=[^\n`]*`|\n| --)", text)} <= {*app}
