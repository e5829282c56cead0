"""What `repro doctor` prints, and when it finds fault."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from edition1_companion.book.after.doctor import TROUBLE, pinned, report
from edition1_companion.book.digests import file_digest
from edition1_companion.book.provenance import Record, write_record

import edition1 as repro

EMPTY = Record("a.ipynb", {}, "", {}, "", {}, {}, "", 0.0, {}, "")


def faults() -> list[str]:
    """Return the lines that call for something."""
    return [line.removeprefix(TROUBLE) for line in report() if line.startswith(TROUBLE)]


@pytest.fixture
def healthy(root) -> Path:
    """Return a project with the versions installed here in its lock, and one table with its record."""
    (root / "requirements.lock").write_text(
        f"numpy==1.0 ; python_version < '3'\nnumpy=={np.__version__} \\\n"
    )
    (root / "results").mkdir()
    table = root / "results" / "t.csv"
    table.write_text("a\n1\n")
    written = asdict(EMPTY) | {"results": {"t.csv": file_digest(table)}}
    write_record(Record(**written), root / "results" / "a.provenance.json")
    return root


def test_it_says_what_the_computer_is(healthy):
    text = "\n".join(report())
    assert faults() == []
    for word in (
        repro.__version__,
        platform.python_version(),
        f"{os.cpu_count()} cores",
        f"numpy {np.__version__}",
    ):
        assert word in text
    assert "Results: 1 tables" in text
    assert str(healthy) not in text, "places on somebody's disk are nobody's business"


def test_another_version_than_the_lock_has(healthy):
    (healthy / "requirements.lock").write_text("numpy==1.0\nnumpy==1.1\n")
    assert faults() == [f"numpy {np.__version__}; the lock has 1.0 or 1.1"]


@pytest.mark.parametrize("change", [lambda file: file.write_text("a\n2\n"), Path.unlink])
def test_a_table_that_is_not_what_was_written(healthy, change):
    change(healthy / "results" / "t.csv")
    assert faults() == ["results/t.csv is not what a.provenance.json says was written"]


def test_a_verdict_that_is_not_the_committed_one(healthy):
    published = (healthy / "data" / "published" / "published.csv").read_text().splitlines()
    head, row = "paper,artefact,row,quantity,unit", ",".join(published[1].split(",")[:5])
    reference = healthy / "data" / "scorecard_reference.csv"
    reference.write_text(
        f"{head},verdict\n{row},missing\n"
        + "".join(",".join(line.split(",")[:5]) + ",missing\n" for line in published[2:])
    )
    assert faults() == []
    reference.write_text(reference.read_text().replace("missing", "reproduced", 1))
    (said,) = faults()
    assert said.endswith("was reproduced, is missing")


def test_recordings_are_counted(healthy, tmp_path):
    entry = {"path": "x/a.csv", "sha256": "0" * 64, "size": 1}
    source = {"repository": "https://github.com/a/b", "commit": "1" * 40, "files": [entry]}
    (healthy / "data" / "sources.json").write_text(json.dumps({"p2000": source}))
    assert any("p2000: 1 files" in line and " 0 there" in line for line in report())
    place = tmp_path / "recordings" / "p2000" / "x" / "a.csv"
    place.parent.mkdir(parents=True)
    place.write_text("1")
    entry["sha256"] = file_digest(place)
    (healthy / "data" / "sources.json").write_text(json.dumps({"p2000": source}))
    assert any("p2000: 1 files" in line and " 1 there" in line for line in report())


def test_versions_of_a_lock():
    assert pinned("a==1 \\\n    --hash=sha256:b\nB-c==2 ; python_version < '3'\nB-c==3\n# d==4\n") == {
        "a": {"1"},
        "b-c": {"2", "3"},
    }


@pytest.mark.parametrize("healthy_lock", [True, False])
def test_the_exit_status(healthy, healthy_lock):
    if not healthy_lock:
        (healthy / "requirements.lock").write_text("numpy==1.0\n")
    command = [sys.executable, "-m", "edition1_companion.cli", "doctor"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == (0 if healthy_lock else 1), done.stderr
    assert done.stderr == ""
    assert done.stdout.splitlines() == report()
