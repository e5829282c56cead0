"""Keys change with any content they depend on, and with nothing else; records say what was used."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from edition1.files import write_whole
from edition1_companion.book.digests import tree_digests, write_if_changed
from edition1_companion.book.project import find_project, shown
from edition1_companion.book.provenance import (
    make_record,
    notebook_key,
    read_inputs,
    read_record,
    write_record,
)
from edition1_companion.recordings.sources import data_dir


@pytest.fixture
def notebook(root, notebook_at):
    return notebook_at(root / "notebooks" / "a.ipynb", "1 + n")


def key(notebook: Path, **parameters) -> str:
    return notebook_key(notebook, parameters, read_inputs(find_project()), find_project())


def append(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as stream:
        stream.write("# more\n")


@pytest.mark.parametrize(
    "path",
    [
        "src/edition1/edition1/module.py",
        "src/edition1/edition1/new/module.py",
        "src/edition1/edition1_live/module.py",
        "src/edition1/edition1_companion/twins/module.py",
        "src/edition1/edition1_companion/pages/a/figures.py",
        "src/edition1/edition1_companion/pages/a.py",
        "data/published/published.csv",
        "data/networks/new.safetensors",
        "requirements.lock",
        "notebooks/a.ipynb",
        "../recordings/martin2022/new.bag",
    ],
)
def test_any_content_changes_the_key(notebook, root, path):
    before = key(notebook)
    append(root / path)
    assert key(notebook) != before


OTHERS = [
    "src/edition1/edition1_companion/pages/other/figures.py",
    "src/edition1/edition1_companion/pages/other.py",
    "src/edition1/edition1_companion/book/after/build.py",
]


@pytest.mark.parametrize("path", OTHERS)
def test_a_page_does_not_depend_on_other_pages_and_on_what_runs_afterwards(notebook, root, path):
    before = key(notebook)
    append(root / path)
    assert key(notebook) == before


@pytest.mark.parametrize("path", [*OTHERS, "src/edition1/edition1_companion/pages/a/figures.py"])
def test_a_notebook_that_is_not_a_page_depends_on_everything(root, notebook_at, path):
    own = notebook_at(root / "mine" / "a.ipynb", "1 + n")
    before = key(own)
    append(root / path)
    assert key(own) != before


def test_a_renamed_recording_changes_the_key(notebook, root):
    recording = root / "../recordings/a.csv"
    append(recording)
    before = key(notebook)
    recording.rename(recording.with_name("b.csv"))
    assert key(notebook) != before


def test_a_linked_recording_counts(notebook, root, tmp_path):
    append(tmp_path / "disk" / "a.csv")
    (root / "../recordings/linked").symlink_to(tmp_path / "disk")
    before = key(notebook)
    append(tmp_path / "disk" / "a.csv")
    assert key(notebook) != before


def test_kernels_compiled_in_between_do_not_change_the_key(notebook, monkeypatch, tmp_path):
    """They lie in the user's cache, where recordings lie as well if nothing else is said."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("REPRO_DATA_DIR")
    before = key(notebook)
    command = [sys.executable, "-c", "from edition1.kernels import compilation; print(compilation._CACHE)"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    cache = Path(done.stdout.strip())
    assert cache.is_relative_to(data_dir())
    append(cache / "module" / "function.nbc")
    assert key(notebook) == before


def test_parameters_change_the_key(notebook):
    assert len({key(notebook), key(notebook, n=3), key(notebook, n=4), key(notebook, n=4.0)}) == 4
    assert key(notebook, a=1, b=2) == key(notebook, b=2, a=1)


def test_times_caches_and_places_do_not_change_the_key(notebook, root, tmp_path, monkeypatch):
    before = key(notebook)
    os.utime(root / "src/edition1/edition1/module.py", (0, 0))
    append(root / "src/edition1/edition1/__pycache__/module.cpython-311.pyc")
    append(root / "README.md")
    (tmp_path / "recordings").rename(tmp_path / "moved")
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path / "moved"))
    assert key(notebook) == before


def test_keys_need_no_heavy_import():
    code = (
        "import sys, edition1_companion.book.after.build; "
        "from edition1_companion.book.provenance import read_inputs; "
        "sys.exit(bool({'torch', 'pandas', 'papermill', 'numpy'} & set(sys.modules)))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_data_dir(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("REPRO_DATA_DIR", "recordings")
    assert data_dir() == tmp_path / "recordings"
    monkeypatch.setenv("REPRO_DATA_DIR", "")
    assert data_dir().is_absolute()
    assert data_dir().name == "repro"


def record_of(notebook: Path):
    project = find_project()
    return make_record(
        project, notebook, {}, read_inputs(project), started="", seconds=1.26, results={}, executed="00"
    )


def git(root: Path, *arguments: str) -> str:
    names = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    done = subprocess.run(["git", *names, *arguments], cwd=root, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_record_of_a_source_archive(notebook, root, tmp_path):
    append(tmp_path / "recordings" / "a.csv")
    record = record_of(notebook)
    assert list(record.code) == ["source archive"]
    assert record.notebook == "notebooks/a.ipynb"
    assert record.seconds == 1.3
    assert record.data["source"] == "REPRO_DATA_DIR"
    assert list(record.data["recordings"]) == ["a.csv"]
    assert str(tmp_path) not in str(record)


def test_record_of_a_repository(notebook, root):
    git(root, "init", "--quiet")
    assert list(record_of(notebook).code) == ["source archive"]
    git(root, "add", ".")
    git(root, "commit", "--quiet", "-m", "first")
    assert record_of(notebook).code == {"commit": git(root, "rev-parse", "HEAD"), "dirty": False}
    append(root / "src/edition1/edition1/module.py")
    assert record_of(notebook).code["dirty"] is True


def test_an_archive_inside_another_repository_does_not_take_its_commit(notebook, root):
    git(root.parent, "init", "--quiet")
    git(root.parent, "add", ".")
    git(root.parent, "commit", "--quiet", "-m", "first")
    assert list(record_of(notebook).code) == ["source archive"]


def test_record_round_trip(notebook, tmp_path):
    record = record_of(notebook)
    write_record(record, tmp_path / "a.json")
    assert read_record(tmp_path / "a.json") == record
    (tmp_path / "a.json").write_text("{}")
    assert read_record(tmp_path / "a.json") is None
    (tmp_path / "a.json").write_text("{")
    assert read_record(tmp_path / "a.json") is None
    assert read_record(tmp_path / "b.json") is None


def test_the_project_is_found_from_below_and_from_elsewhere(root, tmp_path, monkeypatch):
    assert find_project(root / "src" / "edition1" / "edition1").root == root
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "repro"\n')
    assert find_project(tmp_path).root == Path(__file__).parents[4]
    assert shown(root / "a") == "a"
    assert shown(tmp_path / "a") == str(tmp_path / "a")


def test_links_that_lead_back_end(tmp_path):
    (tmp_path / "a.txt").write_text("a")
    (tmp_path / "back").symlink_to(tmp_path)
    assert list(tree_digests(tmp_path)) == ["a.txt"]


def test_whole_files(tmp_path):
    path = tmp_path / "new" / "a.txt"
    write_whole(path, "ä\n")
    assert path.read_bytes() == "ä\n".encode()
    assert not write_if_changed(path, "ä\n")
    assert write_if_changed(path, "b\n")
    assert os.listdir(path.parent) == ["a.txt"]
    with pytest.raises(UnicodeEncodeError):
        write_whole(path, "\udc80")
    assert path.read_text() == "b\n"
    assert os.listdir(path.parent) == ["a.txt"]
