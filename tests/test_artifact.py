"""The archive of the project and the page for evaluators: what they list is there, and what is changed is noticed."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import zipfile
from pathlib import Path

import pandas as pd
import pytest

import repro
from repro_board.cli import app
from repro_companion import cli
from repro_companion.artifact_page import MEASURED, appendix, in_words
from repro_companion.claims import claims_of
from repro_companion.compare import CRATE, compare_with_head
from repro_companion.papers.others import FETCHED
from repro_companion.run import RunFailed
from repro_companion.scorecard_page import PAPERS, title
from scripts import artifact
from scripts.studies import STUDIES

ROOT = Path(__file__).resolve().parents[1]
CLAIMS = pd.read_csv(ROOT / "data/published/claims.csv", dtype=str, keep_default_na=False)
PAGES = pd.read_csv(ROOT / MEASURED, keep_default_na=False).set_index("what")
TABLES = {path.name for path in (ROOT / "results").glob("*.csv")}


# The page for evaluators


@pytest.fixture(scope="module")
def page() -> str:
    """Return the page with all that it includes."""
    card = pd.read_csv(ROOT / "results/scorecard.csv", dtype=str, keep_default_na=False)
    names = re.findall(r"\{(home\.\w+)\}", "".join(CLAIMS["found"]))
    claims = claims_of(ROOT, card, dict.fromkeys(names, "12"))
    parts = appendix(ROOT, claims, {name: title(ROOT, name) for name in CLAIMS["page"]}, PAPERS)
    text = (ROOT / "book/artifact.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"\{include\} generated/(.+)", text)) == sorted(parts)
    return "\n".join([text, *parts.values()])


def test_every_claim_has_a_line_with_a_page_and_its_command(page):
    for claim in CLAIMS.to_dict("records"):
        assert (ROOT / f"{claim['page']}.ipynb").is_file()
        (line,) = (line for line in page.splitlines() if line.startswith(f"| {claim['claim']} ("))
        assert f"| `make page P={Path(claim['page']).name}` [" in line
        assert f"]({claim['page']}.ipynb) |" in line
        assert re.search(r"\| [\d.]+\smin, [\d.]+\sMB \| ", line)


def test_every_command_of_the_page_can_be_typed(page):
    """Targets of make, pages, commands and options of repro, scripts and their studies."""
    assert cli.app is app
    targets = re.findall(r"^([a-z][a-z-]*):(?!=)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    blocks = "".join(re.findall(r"```bash\n(.*?)```", page, re.DOTALL)).splitlines()
    commands = [*re.findall(r"`(make [^`]+|\.venv/[^`]+|repro [^`]+)`", page), *blocks]
    assert len(commands) > 40
    for command in commands:
        program, *words = command.removeprefix(".venv/bin/").split()
        if program == "make":
            assert {word for word in words if "=" not in word} <= {*targets}, command
        elif program == "repro":
            options = {name for one in app[words[0]].assemble_argument_collection() for name in one.names}
            assert {word for word in words if word.startswith("--")} <= options, command
            assert all((ROOT / word).exists() for word in words if "/" in word)
        else:
            script, name = words
            known = {"scripts/studies.py": STUDIES, "scripts/others.py": FETCHED}[script]
            assert (program, name in known) == ("python", True), command


def test_what_was_measured_names_every_page_and_every_table_once():
    """So a page or a table that is new or gone asks for another measurement."""
    assert {*PAGES.index} == {f"notebooks/{path.stem}" for path in (ROOT / "notebooks").glob("*.ipynb")} | {
        "site"
    }
    named = " ".join(PAGES["tables"]).split()
    assert sorted(named) == sorted(TABLES - {"scorecard.csv"})
    assert (PAGES[["minutes", "megabytes"]] > 0).all(axis=None)


@pytest.mark.parametrize(
    ("tolerance", "words"),
    [(5e-6, "last digits"), (0.005, "0.5 %"), (0.3, "30 %"), (2.0, "any: the step is chaotic")],
)
def test_a_tolerance_in_words(tolerance, words):
    assert in_words(tolerance) == words


# The archive


@pytest.fixture
def built(tmp_path) -> Path:
    """Return this project as it is after a build, without git; its tables are copies."""
    for name in ("notebooks", "data", "src", "pyproject.toml", "CITATION.cff", "requirements.lock"):
        (tmp_path / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "results", tmp_path / "results", ignore=shutil.ignore_patterns("with_recordings"))
    (tmp_path / "book/notebooks").mkdir(parents=True)
    for what, tables in PAGES["tables"].drop("site").items():
        found = {
            name: hashlib.sha256((ROOT / "results" / name).read_bytes()).hexdigest()
            for name in tables.split()
        }
        record = {"results": found, "started": "2026-01-01T00:00:00+00:00"}
        (tmp_path / f"book/{what}.provenance.json").write_text(json.dumps(record))
    return tmp_path


def test_the_crate_lists_every_table_with_its_hash_its_notebook_and_inputs(built):
    graph = {part["@id"]: part for part in artifact.crate(built)["@graph"]}
    assert graph[CRATE]["about"] == {"@id": "./"}
    assert {name.removeprefix("results/") for name in graph if name.startswith("results/")} == TABLES
    writers = {part["@id"]: run for run in graph.values() for part in run.get("result", [])}
    for name in TABLES:
        content = (ROOT / "results" / name).read_bytes()
        assert graph[f"results/{name}"]["sha256"] == hashlib.sha256(content).hexdigest()
        run = writers[f"results/{name}"]
        what = Path(run["instrument"]["@id"])
        assert what.suffix == ".py" or name in PAGES["tables"][what.with_suffix("").as_posix()].split()
        assert {part["@id"] for part in [*run["object"], run["instrument"]]} <= {*graph}
    assert {part["@id"] for part in graph["./"]["hasPart"]} <= {*graph}


def test_a_table_that_its_notebook_did_not_write_stops_the_archive(built):
    (built / "results/table_1_errors.csv").write_text("a\n1\n")
    with pytest.raises(RunFailed, match=r"^table_1\.ipynb has not written table_1_errors\.csv: make book$"):
        artifact.crate(built)


def test_the_metadata_have_what_catalogues_require():
    found = artifact.codemeta(ROOT)
    required = {"@context", "@type", "name", "description", "identifier", "license", "author", "version"}
    assert all(found[key] for key in (*required, "datePublished", "softwareRequirements"))
    assert (found["@type"], found["version"]) == ("SoftwareSourceCode", repro.__version__)
    assert len(found["referencePublication"]) == len(PAPERS)
    assert "OWNER" not in json.dumps(found)


def archive_of(built: Path, place: Path) -> Path:
    """Seal the tables, their crate and what compares them."""
    crate = built / CRATE
    crate.write_text(json.dumps(artifact.crate(built)))
    names = [f"results/{name}" for name in TABLES] + ["data/tolerances.csv", "requirements.lock", CRATE]
    names += [f"src/{path.relative_to(ROOT / 'src').as_posix()}" for path in (ROOT / "src").rglob("*.py")]
    place.mkdir()
    return artifact.sealed({name: built / name for name in names}, place / "repro-1.zip")


@pytest.mark.slow
def test_the_unpacked_archive_is_what_was_sealed_and_a_changed_table_is_named(built):
    """Its own command says so; the same files give the same bytes."""
    one, two = (archive_of(built, built / name) for name in ("one", "two"))
    assert one.read_bytes() == two.read_bytes()
    digest = hashlib.sha256(one.read_bytes()).hexdigest()
    assert one.with_name("repro-1.zip.sha256").read_text() == f"{digest}  repro-1.zip\n"
    assert artifact.compared(one) == f"Tables: {len(TABLES)} the same byte for byte."
    with zipfile.ZipFile(one) as archive:
        archive.extractall(built)
    unpacked = built / "repro-1"
    (unpacked / "results/noise_study.csv").write_text("a\n1\n")
    (unpacked / "results/table_1.rows.csv").unlink()
    (unpacked / "results/new.csv").write_text("a\n1\n")
    names = ("new.csv", "noise_study.csv", "table_1.rows.csv")
    assert compare_with_head(unpacked).found == [
        f"results/{name} is not the table of {CRATE}" for name in names
    ]


def test_no_file_of_the_archive_is_one_of_others_without_a_licence(tmp_path):
    """By content; what is here of others has a licence beside it."""
    files = {name: ROOT / name for name in artifact.listed(ROOT)}
    artifact.refuse_recordings(ROOT, files)
    assert not [name for name in files if name.startswith(("results/with_recordings", "runs/", "build/"))]
    for name in files:
        if name.startswith("data/recordings/") and name.count("/") > 2:
            assert "/".join([*name.split("/")[:3], "LICENSE"]) in files, name
    (tmp_path / "data").mkdir()
    content = b"theirs\n"
    (tmp_path / "copy.csv").write_bytes(content)
    for kind, value in {
        "sha256": hashlib.sha256(content).hexdigest(),
        "git_blob": hashlib.sha1(b"blob 7\0" + content).hexdigest(),
    }.items():
        group = {"files": [{"path": "a.csv", kind: value}]}
        (tmp_path / "data/sources.json").write_text(json.dumps({"a": group | {"license": "MIT"}}))
        artifact.refuse_recordings(tmp_path, {"copy.csv": tmp_path / "copy.csv"})
        (tmp_path / "data/sources.json").write_text(json.dumps({"a": group}))
        with pytest.raises(RunFailed, match=r"^copy\.csv is a file of others without a licence"):
            artifact.refuse_recordings(tmp_path, {"copy.csv": tmp_path / "copy.csv"})


def test_without_git_the_files_are_those_that_gitignore_leaves(tmp_path):
    shutil.copyfile(ROOT / ".gitignore", tmp_path / ".gitignore")
    kept = ["a.md", "src/repro/x.py", "book/build/b.md", "results/c.csv"]
    left = [
        ".venv/x.py",
        "build/lib/x.py",
        "src/__pycache__/x.pyc",
        "src/a.egg-info/b",
        "results/with_recordings/c.csv",
    ]
    for name in [*kept, *left, ".git/HEAD"]:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert artifact.left_without_git(tmp_path) == sorted([*kept, ".gitignore"])
