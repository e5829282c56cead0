"""A run beside the book: what the page shows, and which places are refused."""

from __future__ import annotations

import base64
import json
import shutil
from html.parser import HTMLParser
from pathlib import Path

import nbformat
import pytest
from edition1.errors import InputError
from edition1_companion.book.after.diff_page import write_diff
from edition1_companion.book.project import Project
from edition1_companion.book.runner import read_notebook, run_notebook
from edition1_companion.cli import diff

TABLES = """\
from edition1_companion.book.results import results_dir
folder = results_dir()
(folder / "same.csv").write_text("label,x_mm\\na,1\\n")
rows = "".join(f"{i},{i * gain},{'x' if gain < 2 else 'y'}\\n" for i in range(n))
(folder / "numbers.csv").write_text("row_nr,x_mm,kind\\n" + rows)
if gain < 2:
    (folder / "book_only.csv").write_text("a\\n1\\n")"""


def draw(colour: str) -> str:
    """Return the source of a cell that shows a picture of one pixel."""
    return (
        "from IPython.display import Image, display\n"
        "import base64, struct, zlib\n"
        "def chunk(kind, data):\n"
        "    body = kind + data\n"
        "    return struct.pack('>I', len(data)) + body + struct.pack('>I', zlib.crc32(body))\n"
        "head = chunk(b'IHDR', struct.pack('>IIBBBBB', 1, 1, 8, 2, 0, 0, 0))\n"
        f"data = chunk(b'IDAT', zlib.compress(bytes([0, {colour}])))\n"
        "Image(b'\\x89PNG\\r\\n\\x1a\\n' + head + data + chunk(b'IEND', b''))"
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Return a project whose book has run one notebook, and a run of it with other parameters in ``runs/a``."""
    root = tmp_path_factory.mktemp("made") / "project"
    (root / "notebooks").mkdir(parents=True)
    (root / "pyproject.toml").write_text("[tool.repro]\n")
    parameters = 'n: int = 2  # rows\ngain: float = 1.0  # gain\nname: str = "<b>"  # a name'
    kernel = {"name": "python3", "language": "python", "display_name": "Python 3"}
    notebook = nbformat.v4.new_notebook(metadata={"kernelspec": kernel})
    sources = (parameters, TABLES, draw("int(gain), 0, 0"), draw("9, 9, 9"))
    notebook.cells = [nbformat.v4.new_code_cell(source) for source in sources]
    notebook.cells[0].metadata["tags"] = ["parameters"]
    for number, name in ((2, "fig-one"), (3, "fig-two")):
        about = {
            "figure": {"name": name, "caption": f"Caption of {name}"},
            "image": {"alt": f"Alt of {name}"},
        }
        notebook.cells[number].metadata["mystnb"] = about
    source = root / "notebooks" / "a.ipynb"
    nbformat.write(notebook, source)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("REPRO_DATA_DIR", str(root / "recordings"))
        found = Project(root)
        run_notebook(source, {}, found.executed / "a.ipynb", found.results, project=found)
        changed = {"n": 3, "gain": 2.5, "name": "</td>&"}
        run_notebook(source, changed, root / "runs" / "a" / "mine.ipynb", root / "runs" / "a", project=found)
    return root


@pytest.fixture
def project(made, tmp_path, monkeypatch) -> Project:
    """Return a copy of the project; it is the current folder."""
    shutil.copytree(made, tmp_path / "project")
    monkeypatch.chdir(tmp_path / "project")
    return Project(tmp_path / "project")


class Page(HTMLParser):
    """The cells of tables, the pictures and everything that would be loaded."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.pictures: list[tuple[str, bytes]] = []
        self.loaded: list[str] = []
        self.words = ""
        self.in_cell = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect rows and sources."""
        given = dict(attrs)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")
            self.in_cell = True
        elif tag == "img":
            source = given["src"] or ""
            self.pictures.append((given["alt"] or "", base64.b64decode(source.partition(",")[2])))
        self.loaded += [value or "" for key, value in attrs if key in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        """Leave a cell."""
        self.in_cell = self.in_cell and tag not in ("td", "th")

    def handle_data(self, data: str) -> None:
        """Collect words, by cell where there is one."""
        self.words += data
        if self.in_cell:
            self.rows[-1][-1] += data.strip()


def test_the_page_of_a_run(project, capsys):
    assert diff(Path("runs/a/mine.ipynb")) == 0
    said = capsys.readouterr().out.splitlines()
    assert said == [
        "book_only.csv: only the book has it",
        "numbers.csv: 2 of 2 matched rows differ; 1 only in the run",
        "same.csv: identical",
        "The page: runs/a/mine.diff.html",
    ]
    page = Page(Path("runs/a/mine.diff.html").read_text(encoding="utf-8"))
    assert all(source.startswith("data:") for source in page.loaded)
    for row in (
        ["parameter n", "2", "3"],
        ["parameter gain", "1.0", "2.5"],
        ["parameter name", "<b>", "</td>&"],
        ["row_nr", *("Book", "Run", "Difference", "%"), *("Book", "Run")],
        ["0", "0", "0", "+0", "+0", "x", "y"],
        ["1", "1", "2.5", "+1.5", "+150", "x", "y"],
        ["2", "5", "y"],
    ):
        assert row in page.rows
    assert [alt for alt, _ in page.pictures] == [
        "Alt of fig-one",
        "The same figure of the run: fig-one",
        "Alt of fig-two",
        "The same figure of the run: fig-two",
    ]
    drawn = [read_notebook(path) for path in (project.executed / "a.ipynb", Path("runs/a/mine.ipynb"))]
    for (_, content), notebook in zip(page.pictures[:2], drawn, strict=True):
        cell = next(c for c in notebook.cells if "mystnb" in c.metadata)
        assert content == base64.b64decode(cell.outputs[0].data["image/png"])
    assert page.pictures[0][1] != page.pictures[1][1]
    assert "Caption of fig-two (identical)" in page.words
    assert "Caption of fig-one (identical)" not in page.words

    # the folder names the same run; the book's files are as they were, and the page is no input of a second one
    before = Path("runs/a/mine.diff.html").read_text(encoding="utf-8")
    path, _ = write_diff(Path("runs/a"), project)
    assert path.read_text(encoding="utf-8") == before


def test_a_table_with_many_rows_shows_the_largest_differences(project):
    """The rows are chosen by relative difference; their number is told."""
    lines = ["row_nr,x_mm,kind", *(f"{i},{i + 1},x" for i in range(500))]
    (project.results / "numbers.csv").write_text("\n".join(lines) + "\n")
    lines[401] = "400,4010,x"
    Path("runs/a/numbers.csv").write_text("\n".join(lines) + "\n")
    path, summary = write_diff(Path("runs/a"), project)
    assert "numbers.csv: 1 of 500 matched rows differ" in summary
    page = Page(path.read_text(encoding="utf-8"))
    assert "the 100 with the largest relative differences are shown" in page.words
    rows = [row for row in page.rows if len(row) == 5 and row[0].isdecimal()]
    assert len(rows) == 100
    assert rows[0] == ["400", "401", "4010", "+3609", "+900"]


def test_places_that_are_no_run_are_refused(project):
    what = "the folder or the executed notebook of a finished repro run"

    def refusal(place: Path) -> str:
        with pytest.raises(InputError) as error:
            write_diff(place, project)
        return str(error.value)

    start = "Input run of repro diff must be"
    assert refusal(Path("nowhere")) == f"{start} {what}; instead received nowhere."
    assert refusal(Path("runs")) == f"{start} {what}; instead received runs, which has no *.provenance.json."
    assert refusal(Path("runs/a/numbers.csv")) == f"{start} {what}; instead received runs/a/numbers.csv."
    # the executed notebook of plain papermill has no record
    Path("runs/b.ipynb").write_bytes(Path("runs/a/mine.ipynb").read_bytes())
    assert refusal(Path("runs/b.ipynb")) == (
        f"{start} {what}; instead received runs/b.ipynb, without b.provenance.json."
    )
    # a record that lies beside its tables is the book's own
    record = json.loads(Path("runs/a/mine.provenance.json").read_text())
    Path("runs/a/second.provenance.json").write_text(json.dumps(record))
    assert refusal(Path("runs/a")) == (
        f"{start} one of the notebooks mine.ipynb, second.ipynb; instead received runs/a."
    )
    Path("runs/a/second.provenance.json").unlink()
    assert refusal(project.executed / "a.ipynb").startswith(f"{start} {what}; instead received ")
    Path("runs/a/same.csv").unlink()
    assert refusal(Path("runs/a")) == f"{start} complete; instead received no runs/a/same.csv."
    (project.results / "a.provenance.json").unlink()
    assert refusal(Path("runs/a")) == (
        f"{start} of a notebook that the book has (make book computes it); instead received one of notebooks/a.ipynb."
    )
