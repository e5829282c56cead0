"""A miniature project and small notebooks, built for real."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest

collect_ignore = ["conftest.py"]  # it has no examples to run, and other folders have a module of this name
PUBLISHED = """\
paper,artefact,row,quantity,unit,value,std
a2020,Table 1,one,e_u,mT,0.015,0.002
a2020,Table 1,two,e_u,mT,0.016,
b2021,Fig. 2,one,update_rate,Hz,60,
"""
# without pandas, whose import takes longer than all the rest
WRITES_A_TABLE = """\
from edition1_companion.book.results import results_dir
(results_dir() / "TABLE.csv").write_text(f"n,third\\n{n},{n / 3:g}\\n")"""


def write_notebook(path: Path, *cells: str, parameters: str | None = "n: int = 3  # how many") -> Path:
    """Write a notebook of a parameters cell and further code cells."""
    kernel = {"name": "python3", "language": "python", "display_name": "Python 3"}
    notebook = nbformat.v4.new_notebook(metadata={"kernelspec": kernel})
    if parameters is not None:
        notebook.cells.append(nbformat.v4.new_code_cell(parameters, metadata={"tags": ["parameters"]}))
    notebook.cells += [nbformat.v4.new_code_cell(cell) for cell in cells]
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number}"
    path.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(notebook, path)
    return path


@pytest.fixture
def notebook_at():
    return write_notebook


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a project without notebooks and without a site; it is the current folder."""
    project = tmp_path / "project"
    texts = {
        "pyproject.toml": "[tool.repro]\n",
        "requirements.lock": "numpy==2.0\n",
        "src/edition1/edition1/module.py": '"""A module."""\n',
        "data/published/published.csv": PUBLISHED,
        "data/thinned.csv": "table,keys,every\nthinned,n,2\n",
        "data/published/index.csv": "paper,kind,artefact,shows,status,page,anchor,code,note\n",
    }
    for name, text in texts.items():
        path = project / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (project / "notebooks").mkdir()
    (tmp_path / "recordings").mkdir()
    monkeypatch.chdir(project)
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path / "recordings"))
    monkeypatch.delenv("REPRO_RESULTS_DIR", raising=False)
    monkeypatch.setenv("JOBS", "2")
    return project


@pytest.fixture
def writes_a_table():
    """Return a function that gives the source of a cell that writes a table of a name."""
    return lambda name: WRITES_A_TABLE.replace("TABLE", name)
