"""A miniature project with one notebook, for the tests of what runs notebooks, and stored answers."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import nbformat
import numpy as np

ONE_DEVIATION: Any = SimpleNamespace(standard_normal=np.ones, random=np.ones)
"""In place of a generator: everything is off by one standard deviation, and nothing happens by chance."""
PARAMETERS = """\
noise_mt: float = 0.0  # noise of a sensor [mT], at least 0
seeds: list = [0, 1]  # seeds, at least 0
kind: str = "a"  # kind, one of: a, b
fast: bool = False  # a small part"""
TABLE = """\
import os
from pathlib import Path
if noise_mt > 1:
    raise RuntimeError("too much noise")
Path(os.environ["REPRO_RESULTS"], "NAME.csv").write_text(f"seed,x\\n{seeds[0]},{noise_mt + 1:.4f}\\n")
print("what comes first")"""


def in_project(folder: Path, monkeypatch: Any) -> Path:
    """Make a folder the miniature project, and the current folder; recordings lie in it, too."""
    monkeypatch.chdir(project(folder))
    monkeypatch.setenv("REPRO_DATA_DIR", str(folder / "recordings"))
    return folder


def notebook(path: Path, table: str = "t", *cells: str) -> Path:
    """Write a notebook that writes one table."""
    v4 = nbformat.v4
    kernel = {"name": "python3", "language": "python", "display_name": "Python 3"}
    content = v4.new_notebook(metadata={"kernelspec": kernel})
    content.cells = [
        v4.new_markdown_cell("# Sample\n\nWhat it is about."),
        v4.new_code_cell(PARAMETERS, metadata={"tags": ["parameters"]}),
        v4.new_code_cell("x = 1", metadata={"tags": ["remove-input"]}),
        v4.new_markdown_cell("## Method"),
        v4.new_code_cell(TABLE.replace("NAME", table), metadata={"tags": ["first"]}),
        *map(v4.new_code_cell, cells),
    ]
    for number, cell in enumerate(content.cells):
        cell.id = f"cell-{number}"
    path.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(content, path)
    return path


def project(folder: Path) -> Path:
    """Write a project with the notebook ``a`` and return its folder."""
    for name, text in {
        "requirements.lock": "numpy==2.0\n",
        "src/repro/module.py": "x = 1\n",
        "data/published/published.csv": "paper,artefact,row,quantity,unit,value,std\n",
    }.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    notebook(folder / "notebooks" / "a.ipynb")
    return folder
