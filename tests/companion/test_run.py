"""Running a notebook: parameters, keys, whole outputs, sweeps."""

from __future__ import annotations

import json
import os
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from repro.common import InputError
from repro_companion import run as tool
from repro_companion.run import Parameter

from .sample import in_project, notebook


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return in_project(tmp_path, monkeypatch)


def refused(parameter: Parameter, text: str) -> str:
    with pytest.raises(InputError) as caught:
        tool.value_of(parameter, text, "a.ipynb")
    return str(caught.value)


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        ("int", "-3", -3),
        ("float", "1e-3", 0.001),
        ("str", "[1", "[1"),
        ("bool", "True", True),
        ("list", '[1, 1e-3, "on", true, ["x"]]', [1, 0.001, "on", True, ["x"]]),
        ("dict", '{"a": 1, "b": [2.5]}', {"a": 1, "b": [2.5]}),
    ],
)
def test_a_text_becomes_the_declared_type(kind, text, value):
    assert json.dumps(tool.value_of(Parameter("x", kind, "", ""), text, "a")) == json.dumps(value)


@pytest.mark.parametrize(
    ("kind", "text"),
    [("int", "1.5"), ("float", "x"), ("bool", "1"), ("list", "1"), ("list", "[1"), ("dict", "[1]")],
)
def test_another_type_is_refused_in_words(kind, text):
    must_be = f"{kind}: {tool.KINDS[kind]}"
    said = f"Input parameter x of a.ipynb must be {must_be}; instead received {text}."
    assert refused(Parameter("x", kind, "", ""), text) == said


@pytest.mark.parametrize(
    ("kind", "value"),
    [("int", "3"), ("int", True), ("int", 3.0), ("float", None), ("list", (1,)), ("str", 1)],
)
def test_a_value_of_another_type_is_refused_in_words(kind, value):
    with pytest.raises(InputError, match=f"must be {kind}: .*; instead received that"):
        tool.check_value(Parameter("x", kind, "", ""), value, "a.ipynb", "that")
    tool.check_value(Parameter("x", "float", "", ""), 3, "a.ipynb", "3")
    with pytest.raises(InputError, match="must be a list of values, each one of: 0, 1; instead"):
        tool.check_value(Parameter("x", "list", "", "seeds, one of: 0, 1"), [np.arange(2)], "a.ipynb", "that")


@pytest.mark.parametrize(
    ("kind", "meaning", "allowed", "outside"),
    [
        ("int", "how many, at least 1", "1", "0"),
        ("float", "time, 0.1 to 1 [s]", "0.1", "1.5"),
        ("float", "share, above 0 and at most 1 [-]", "1", "0"),
        ("float", "noise [mT], below 1e-3", "-5", "0.001"),
        ("str", "ring, one of: released, as printed", "as printed", "printed"),
        ("list", "seeds, one of: 0, 1, 2", "[2, 0]", "[0, 3]"),
        ("list", "steps, at least 0", "[]", "[1, true]"),
    ],
)
def test_the_meaning_says_what_is_allowed(kind, meaning, allowed, outside):
    parameter = Parameter("x", kind, "", meaning)
    tool.value_of(parameter, allowed, "a.ipynb")
    each = "a list of values, each " if kind == "list" else ""
    assert f"must be {each}{parameter.rule}; instead received {outside}." in refused(parameter, outside)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("int", "1" + 400 * "0"),
        ("float", "NaN"),
        ("float", "-inf"),
        ("float", "1e999"),
        ("list", "[1, NaN]"),
        ("dict", '{"a": [Infinity]}'),
    ],
)
def test_numbers_are_finite_whatever_the_notebook_states(kind, text):
    for meaning in ("of which nothing is stated", "with a bound, at least 0"):
        said = refused(Parameter("x", kind, "", meaning), text)
        assert said.startswith(
            "Input parameter x of a.ipynb must be finite, below 1e308 in size; instead received"
        )


def test_numbers_are_as_large_as_a_float_allows():
    assert tool.are_finite({"a": [1e307, -1e307]})
    assert not tool.are_finite({"a": [-1e308]})


def test_a_meaning_without_a_rule_allows_all():
    for meaning in ("poses at least 3 sigma inside", "one segment only", "a small part, for a quick look"):
        assert Parameter("x", "int", "0", meaning).rule == ""


def test_declared_parameters_and_a_misspelt_name(root):
    declared = tool.declared(root / "notebooks/a.ipynb")
    assert [(one.name, one.kind, one.default) for one in declared.values()] == [
        ("noise_mt", "float", "0.0"),
        ("seeds", "list", "[0, 1]"),
        ("kind", "str", '"a"'),
        ("fast", "bool", "False"),
    ]
    with pytest.raises(InputError, match=r"^a has no parameter noise_mT; did you mean noise_mt\?\n"):
        tool.converted(declared, [("noise_mT", "1")], "a")
    with pytest.raises(InputError, match="must be given once; instead received true as well"):
        tool.converted(declared, [("fast", "true"), ("fast", "true")], "a")


@pytest.mark.parametrize(
    ("text", "kind", "values"),
    [
        ("0,0.005", "float", [0.0, 0.005]),
        ("0:3", "list", [[0], [1], [2]]),
        ("[0,1,2]", "list", [[0, 1, 2]]),
        ("[0,1],2", "list", [[0, 1], [2]]),
        ("-1:1,7", "int", [-1, 0, 7]),
        ("a,b", "str", ["a", "b"]),
        ('{"a": 1, "b": 2},{"a": 3}', "dict", [{"a": 1, "b": 2}, {"a": 3}]),
    ],
)
def test_commas_and_ranges_are_swept(text, kind, values):
    assert tool.grid_of({"x": Parameter("x", kind, "", "")}, [("x", text)], "a") == {"x": values}


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (("1,1", "2:2"), "one value or more, which differ"),
        (("1,,2", ",1", "1, ", ""), "parameter x of a must be a value between any two commas"),
    ],
)
def test_values_of_a_sweep_are_there_and_differ(texts, message):
    for text in texts:
        with pytest.raises(InputError, match=message):
            tool.grid_of({"x": Parameter("x", "int", "", "")}, [("x", text)], "a")


def test_the_key_follows_all_that_a_result_depends_on(root):
    page = root / "notebooks/a.ipynb"

    def key(**parameters):
        return tool.key_of(page, parameters, tool.inputs_of(root))

    keys = [key(), key(noise_mt=1.0)]
    for name in ("src/repro/module.py", "data/new.csv", "requirements.lock", "recordings/p/a.csv", str(page)):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text((path.read_text() if path.is_file() else "") + " ")
        keys.append(key())
    assert len(set(keys)) == len(keys)
    for name in ("src/other/module.py", "src/repro/__pycache__/x.pyc", "results/t.csv"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("other")
    assert key() == keys[-1]


def test_a_commit_is_dirty_where_sources_differ_and_not_by_what_pages_write(root):
    git = ["git", "-C", str(root), "-c", "user.name=a", "-c", "user.email=a@example.org"]
    subprocess.run([*git, "init", "-q"], check=True)
    assert tool.commit_of(root) == ""
    (root / "results").mkdir()
    (root / "results/t.csv").write_text("n\n1\n")
    for words in (["add", "."], ["commit", "-qm", "Begin"]):
        subprocess.run([*git, *words], check=True)
    commit = tool.commit_of(root)
    assert re.fullmatch("[0-9a-f]{40}", commit)
    (root / "results/t.csv").write_text("n\n2\n")
    (root / "results/new.csv").write_text("n\n2\n")
    assert tool.commit_of(root) == commit
    for name in ("src/repro/new.py", "data/new.csv", "notebooks/new.ipynb"):
        (root / name).write_text(" ")
        assert tool.commit_of(root) == f"{commit}-dirty", name
        (root / name).unlink()
    (root / "requirements.lock").write_text("numpy==2.1\n")
    assert tool.commit_of(root) == f"{commit}-dirty"


def test_output_and_tables_are_whole_or_not_there(root):
    page, output, results = root / "notebooks/a.ipynb", root / "runs/x.ipynb", root / "runs/x"
    record = tool.run(page, {"noise_mt": 0.5}, output, results, root=root)
    assert (results / "t.csv").read_text() == "seed,x\n0,1.5000\n"
    assert json.loads((root / "runs/x.provenance.json").read_text()) == record
    assert record["notebook"] == "notebooks/a.ipynb"
    assert tool.is_finished(output, results, record["key"])
    before = output.read_bytes()
    with pytest.raises(tool.RunFailed) as caught:
        tool.run(page, {"noise_mt": 2.0}, output, results, root=root)
    assert str(caught.value) == (
        "notebooks/a.ipynb failed in the cell `import os`: RuntimeError: too much noise\n"
        "The partial notebook is runs/x.failed.ipynb"
    )
    assert output.read_bytes() == before
    assert sorted(os.listdir("runs")) == ["x", "x.failed.ipynb", "x.ipynb", "x.provenance.json"]
    assert "REPRO_RESULTS" not in os.environ
    (results / "t.csv").write_text("edited\n")
    assert not tool.is_finished(output, results, record["key"])
    notebook(page, "other")
    tool.run(page, {}, output, results, root=root)
    assert os.listdir(results) == ["other.csv"]


def test_results_may_lie_on_another_disk(root):
    memory = Path("/dev/shm")
    if not memory.is_dir() or memory.stat().st_dev == root.stat().st_dev:
        pytest.skip("there is no other disk here")
    with tempfile.TemporaryDirectory(dir=memory) as elsewhere:
        (root / "results").symlink_to(elsewhere)
        tool.run(root / "notebooks/a.ipynb", {}, root / "runs/x.ipynb", root / "results", root=root)
        assert os.listdir(elsewhere) == ["t.csv"]


@pytest.mark.slow
def test_a_sweep_joins_what_succeeds_and_runs_nothing_twice(root, capfd):
    page, folder = root / "notebooks/a.ipynb", root / "runs/a-sweep"
    grid = {"noise_mt": [0.0, 3.0], "seeds": [[5], [6, 7]]}
    points = tool.points_of(page, grid, folder, root)
    failures = tool.sweep(points, jobs=2)
    assert all("noise_mt=3.0" in label for label in failures)
    assert all("too much noise" in why for why in failures.values())
    assert len(failures) == 2
    assert tool.joined(points, folder) == [folder / "t.csv"]
    assert pd.read_csv(folder / "t.csv").to_dict("list") == {
        "noise_mt": [0.0, 0.0],
        "seeds": ["5", "[6, 7]"],
        "seed": [5, 6],
        "x": [1.0, 1.0],
    }
    started = [tool.read_record(point.output) for point in points[:2]]
    assert tool.sweep(points[:2], jobs=2) == {}
    assert [tool.read_record(point.output) for point in points[:2]] == started


@pytest.mark.slow
def test_workers_of_a_scheduler_run_a_sweep(root):
    from distributed import LocalCluster

    page, folder = root / "notebooks/a.ipynb", root / "runs/a-sweep"
    points = tool.points_of(page, {"noise_mt": [0.0], "seeds": [[5], [6]]}, folder, root)
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        assert tool.sweep(points, jobs=1, scheduler=cluster.scheduler_address) == {}
    assert all(point.finished for point in points)
    with pytest.raises(
        InputError, match=r"scheduler of repro sweep .* such as tcp://host:8786; .* tcp://127"
    ):
        tool.sweep(
            tool.points_of(page, {"seeds": [[7]]}, folder, root), jobs=1, scheduler="tcp://127.0.0.1:9"
        )
