"""The archive of the project: what it lists is there, and what is changed or without a licence is noticed."""

from __future__ import annotations

import ast
import json
import shutil
import zipfile
from pathlib import Path

import pandas as pd
import pytest

from repro_companion.artifact_page import MEASURED, in_words
from repro_companion.compare import CRATE, compare_with_head
from repro_companion.run import RunFailed, digest
from scripts import artifact

ROOT = Path(__file__).resolve().parents[1]
PAGES = pd.read_csv(ROOT / MEASURED, keep_default_na=False).set_index("what")
WRITERS = {table: what for what, tables in PAGES["tables"].items() for table in tables.split()}
TABLES = sorted(path.name for path in (ROOT / "results").glob("*.csv"))
REQUIRED = ["@context", "@type", "name", "description", "version", "license", "author", "datePublished"]


def test_what_was_measured_names_every_page_and_every_table_once():
    """So a page or a table that is new or gone asks for another measurement."""
    assert {*PAGES.index} == {f"notebooks/{path.stem}" for path in (ROOT / "notebooks").glob("*.ipynb")} | {
        "site"
    }
    assert sorted([*" ".join(PAGES["tables"]).split(), "scorecard.csv"]) == TABLES
    assert (PAGES[["minutes", "megabytes"]] > 0).all(axis=None)


@pytest.mark.parametrize(
    ("tolerance", "words"),
    [
        (0.0, "last digits"),
        (1e-4, "last digits"),
        (2e-4, "0.02 %"),
        (0.5, "50 %"),
        (1.0, "any: the step is chaotic"),
    ],
)
def test_how_far_a_number_may_move_is_said_in_percent(tolerance, words):
    assert in_words(tolerance) == words


@pytest.fixture
def built(tmp_path) -> Path:
    """Return this project as it is after a build, without git; its tables are copies."""
    for name in ("notebooks", "data", "src", "pyproject.toml", "CITATION.cff", "requirements.lock"):
        (tmp_path / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "results", tmp_path / "results", ignore=shutil.ignore_patterns("with_recordings"))
    (tmp_path / "book/notebooks").mkdir(parents=True)
    for what in {*WRITERS.values()}:
        found = {name: digest(ROOT / "results" / name) for name in TABLES if WRITERS.get(name) == what}
        record = {"results": found, "started": "2026-01-01T00:00:00+00:00"}
        (tmp_path / f"book/{what}.provenance.json").write_text(json.dumps(record))
    return tmp_path


def test_the_crate_lists_every_table_with_its_hash_its_notebook_and_inputs(built):
    parts = artifact.crate(built)["@graph"]
    hashes = {part["@id"]: part["sha256"] for part in parts if part["@id"].startswith("results/")}
    assert hashes == {f"results/{name}": digest(ROOT / "results" / name) for name in TABLES}
    runs = [part for part in parts if part["@type"] == "CreateAction"]
    writers = {table["@id"]: run["instrument"]["@id"] for run in runs for table in run["result"]}
    own = {"results/scorecard.csv": "src/repro_companion/scorecard.py"}
    assert writers == {f"results/{table}": f"{what}.ipynb" for table, what in WRITERS.items()} | own
    named = [part for run in runs for part in [*run["object"], run["instrument"]]] + parts[1]["hasPart"]
    assert all(run["object"] for run in runs)
    by_name = {part["@id"]: part for part in parts}
    assert all(by_name[tool]["@type"] == ["File", "SoftwareSourceCode"] for tool in {*writers.values()})
    assert all(by_name[tool]["name"] for tool in {*writers.values()})
    assert {part["@id"] for part in named} <= {part["@id"] for part in parts}


def test_a_table_that_its_notebook_did_not_write_stops_the_archive(built):
    (built / "results/table_1_errors.csv").write_text("a\n1\n")
    with pytest.raises(RunFailed, match=r"^table_1\.ipynb has not written table_1_errors\.csv: make book$"):
        artifact.crate(built)


def test_the_metadata_have_what_catalogues_require():
    found = artifact.codemeta(ROOT)
    assert all(found[key] for key in REQUIRED)
    assert (found["@type"], len(found["referencePublication"])) == ("SoftwareSourceCode", 3)
    assert "OWNER" not in json.dumps(found)


def test_studies_start_where_make_book_has_installed_no_torch():
    """What trains, or reads networks of TorchScript, imports it there."""
    top = ast.parse((ROOT / "scripts/studies.py").read_text(encoding="utf-8")).body
    names = {node.module for node in top if isinstance(node, ast.ImportFrom)}
    names |= {name.name for node in top if isinstance(node, ast.Import) for name in node.names}
    assert "numpy" in names
    assert not names & {"torch", "training", "training_sets"}


@pytest.mark.slow
def test_the_unpacked_archive_is_what_was_sealed_and_a_changed_table_is_named(built):
    """Its own command says so; the same files give the same bytes."""
    (built / CRATE).write_text(json.dumps(artifact.crate(built)))
    names = [CRATE, "requirements.lock", "data/tolerances.csv", *(f"results/{name}" for name in TABLES)]
    names += [path.relative_to(ROOT).as_posix() for path in (ROOT / "src").rglob("*.py")]
    archive = artifact.sealed({name: built / name for name in names}, built / "repro-1.zip")
    first = (built / "repro-1.zip.sha256").read_text()
    assert first == f"{digest(archive)}  repro-1.zip\n"
    artifact.sealed({name: built / name for name in reversed(names)}, archive)
    assert (built / "repro-1.zip.sha256").read_text() == first
    assert artifact.compared(archive) == f"Tables: {len(TABLES)} the same byte for byte."
    with zipfile.ZipFile(archive) as source:
        source.extractall(built)
    tables = built / "repro-1/results"
    (tables / "table_1.rows.csv").unlink()
    for name in ("new.csv", "noise_study.csv"):
        (tables / name).write_text("a\n1\n")
    compared = compare_with_head(tables.parent)
    assert compared.summary().endswith("repro compare SECOND/results results")
    found = " ".join(compared.found)
    assert found.replace(f" is not the table of {CRATE}", "").replace("results/", "").split() == [
        "new.csv",
        "noise_study.csv",
        "table_1.rows.csv",
    ]


def test_the_archive_holds_no_file_that_others_released_without_a_licence(tmp_path):
    """By content; what is here of others has a licence beside it."""
    files = {name: ROOT / name for name in artifact.listed(ROOT)}
    artifact.refuse_recordings(ROOT, files)
    assert not [name for name in files if name.startswith(("results/with_recordings", "runs/", "build/"))]
    theirs = {Path(*Path(name).parts[:3]) for name in files if name.startswith("data/recordings/")}
    assert {(folder / "LICENSE").as_posix() for folder in theirs if folder.name != "README.md"} <= {*files}
    (tmp_path / "data").mkdir()
    copy = tmp_path / "copy.csv"
    copy.write_text("a\n1\n")
    for known in ({"sha256": digest(copy)}, {"git_blob": "38c94da49473ad9ff172c45d5caff133fb8ca53f"}):
        listed = {"files": [known]}
        (tmp_path / "data/sources.json").write_text(json.dumps({"a": listed | {"license": "MIT"}}))
        artifact.refuse_recordings(tmp_path, {"copy.csv": copy})
        (tmp_path / "data/sources.json").write_text(json.dumps({"a": listed}))
        with pytest.raises(RunFailed, match=r"^copy\.csv is a file of others without a licence"):
            artifact.refuse_recordings(tmp_path, {"copy.csv": copy})


def test_without_git_the_files_are_those_that_gitignore_leaves(tmp_path):
    kept = [".gitignore", "a.md", "book/build/b.md", "results/c.csv", "src/repro/x.py"]
    left = [
        ".git/HEAD",
        ".venv/x.py",
        "build/lib/x.py",
        "src/__pycache__/x.pyc",
        "src/a.egg-info/b",
        "runs/a.csv",
    ]
    for name in [*kept, *left]:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / ".gitignore", tmp_path / name)
    assert artifact.left_without_git(tmp_path) == kept
