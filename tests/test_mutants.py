"""The runner of mutants on a small project: what is killed, what survives, and what is refused."""

import importlib.util
import re
import tomllib
from pathlib import Path

import pytest

RUNNER = Path(__file__).parents[1] / "bench" / "mutants" / "run.py"
RULE = {"file": "rule.py", "old": "x > LIMIT", "new": "x < LIMIT", "tests": ["test_rule.py::test_rule"]}


@pytest.fixture(scope="module")
def runner():
    spec = importlib.util.spec_from_file_location("run_mutants", RUNNER)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def project(tmp_path):
    """Sources that say which numbers are large, and a test that looks at two of them."""
    (tmp_path / "src").mkdir()
    (tmp_path / "pyproject.toml").write_text('[tool.pytest.ini_options]\npythonpath = ["src"]\n')
    (tmp_path / "src" / "rule.py").write_text("LIMIT = 3\n\n\ndef large(x):\n    return x > LIMIT\n")
    (tmp_path / "test_rule.py").write_text(
        "from rule import large\n\n\ndef test_rule():\n    assert large(5) and not large(1)\n"
    )
    return tmp_path


def test_a_change_that_is_noticed_and_one_that_is_not(runner, project, capsys):
    work = project / "work"
    mutants = [RULE | {"name": "sign"}, RULE | {"name": "limit", "old": "LIMIT = 3", "new": "LIMIT = 4"}]
    assert runner.run(project, mutants, work) == 1
    said = capsys.readouterr().out
    assert "sign: killed" in said
    assert "limit: survived" in said
    assert "2 mutants, 1 not killed" in said
    assert runner.run(project, mutants[:1], work) == 0
    assert (project / "src" / "rule.py").read_text().startswith("LIMIT = 3\n")  # only the copy is changed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"old": "LIMIT"}, "refused: the old expression is there 2 times"),
        ({"old": "limit"}, "refused: the old expression is there 0 times"),
        ({"file": "none.py"}, "refused: the old expression is there 0 times"),
        ({"new": "x > > LIMIT"}, "refused: the tests cannot be run"),
    ],
)
def test_changes_that_cannot_be_made_are_refused(runner, project, change, message):
    found = runner.outcome(project, project / "work", RULE["tests"], RULE | change)
    assert found.startswith(message)


def test_tests_that_fail_without_a_change_are_told(runner, project, capsys):
    (project / "test_rule.py").write_text("def test_rule():\n    assert False\n")
    assert runner.run(project, [RULE | {"name": "sign"}], project / "work") == 1
    assert "The tests do not pass without a change." in capsys.readouterr().err


def test_every_listed_change_can_still_be_made():
    """Of each mutant the old expression stands once in its file, and its tests are where the list says."""
    root = RUNNER.parents[2]
    for mutant in tomllib.loads((RUNNER.parent / "mutants.toml").read_text(encoding="utf-8"))["mutant"]:
        path = root / "src" / mutant["file"]
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        assert text.count(mutant["old"]) == 1, mutant["name"]
        for test in mutant["tests"]:
            file, *names = test.partition("[")[0].split("::")
            assert all(re.search(rf"(def|class) {name}\b", (root / file).read_text()) for name in names), test
