"""The project as a whole: versions agree, documented commands exist."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterable
from importlib import metadata
from itertools import chain
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import repro
from repro_companion.papers.others import FETCHED

ROOT = Path(__file__).resolve().parents[1]


def read(name: str) -> str:
    """Return the text of a file of the project."""
    return (ROOT / name).read_text(encoding="utf-8")


def pyproject() -> dict:
    """Return pyproject.toml."""
    return tomllib.loads(read("pyproject.toml"))


def direct() -> dict[str, Requirement]:
    """Return what pyproject.toml asks for by name: the package, its extras but parquet, and the checks.

    Where pandas finds pyarrow it behaves otherwise, so the tables are computed without.
    """
    found = pyproject()
    extras = [lines for name, lines in found["project"]["optional-dependencies"].items() if name != "parquet"]
    lines = [*found["project"]["dependencies"], *chain(*extras), *found["dependency-groups"]["checks"]]
    return {requirement.name.lower(): requirement for requirement in map(Requirement, lines)}


def locked() -> dict[str, list[Requirement]]:
    """Return what the lock pins, by name; a package may have one version per version of Python."""
    found: dict[str, list[Requirement]] = {}
    for line in read("requirements.lock").splitlines():
        if line[:1].isalnum():
            requirement = Requirement(line.rstrip("\\ "))
            found.setdefault(requirement.name.lower(), []).append(requirement)
    return found


def test_python_versions_agree():
    """One version of Python in conda's file, the package, the linters, the Makefile and the lock."""
    project = pyproject()
    conda = {str(item).split("=")[0]: str(item).partition("=")[2] for item in conda_dependencies()}
    version = conda["python"].strip("=")
    assert project["project"]["requires-python"] == f">={version}"
    assert project["tool"]["ruff"]["target-version"] == "py" + version.replace(".", "")
    assert project["tool"]["basedpyright"]["pythonVersion"] == version
    assert f"PYTHON ?= python{version}\n" in read("Makefile")
    assert f"--python-version {version} " in read("Makefile")
    minor = int(version.split(".")[1])
    assert f"sys.version_info < (3, {minor})" in read("Makefile")


def conda_dependencies() -> list[str]:
    """Return what environment.yml asks for."""
    return yaml.safe_load(read("environment.yml"))["dependencies"]


def test_torch_is_pinned_once():
    """The Makefile installs the torch that the lock was compiled for."""
    (specifier,) = direct()["torch"].specifier
    assert specifier.operator == "=="
    assert f"TORCH := torch=={specifier.version}\n" in read("Makefile")


def test_lock_has_everything_with_hashes():
    """Every direct requirement is pinned within its range; every pin has hashes; torch and CUDA are left out."""
    pins = locked()
    assert not [name for name in pins if re.match(r"torch$|triton|nvidia-|cuda-", name)]
    for name, requirement in direct().items():
        if name == "torch":
            continue
        assert name in pins, f"{name} is not in requirements.lock: make lock"
        for pin in pins[name]:
            (version,) = pin.specifier
            assert requirement.specifier.contains(version.version, prereleases=True), f"{pin}: make lock"
    blocks = re.split(r"\n(?=[A-Za-z0-9])", read("requirements.lock").strip())
    assert not [
        block.splitlines()[0] for block in blocks if block[:1] != "#" and "--hash=sha256:" not in block
    ]
    assert {"setuptools", "wheel"} <= set(pins), "the package is built without isolation"


def needed_by(requirements: Iterable[Requirement]) -> set[str]:
    """Return the names of what requirements lead to, by what the packages here say of themselves."""
    todo, seen = list(requirements), {}
    while todo:
        asked = todo.pop()
        if str(asked) not in seen:
            seen[str(asked)] = canonicalize_name(asked.name)
            lines = map(Requirement, metadata.requires(asked.name) or [])
            extras = asked.extras or {""}
            todo += [
                line
                for line in lines
                if not line.marker or any(line.marker.evaluate({"extra": e}) for e in extras)
            ]
    return set(seen.values())


def test_the_book_needs_none_of_the_checks():
    """CHECKS in the Makefile, which it leaves out beside torch, are what only tests, tools and training lead to."""
    (listed,) = re.findall(r"^CHECKS := ((?:.*\\\n)*.*)$", read("Makefile"), re.MULTILINE)
    project = pyproject()["project"]
    extras = [
        lines for name, lines in project["optional-dependencies"].items() if name not in ("parquet", "train")
    ]
    book = map(Requirement, [*project["dependencies"], *chain(*extras)])
    assert {*listed.replace("\\", " ").split(), "torch"} == needed_by(direct().values()) - needed_by(book)


def test_the_library_imports_only_what_it_requires():
    """And rich, which cyclopts brings; only a torch module as a sensor model needs an extra, torch."""
    required = {Requirement(line).name for line in pyproject()["project"]["dependencies"]}
    assert "rich" in needed_by([Requirement("cyclopts")])
    for path in (ROOT / "src" / "repro").rglob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
        names += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
        extra = {"torch"} if path.name == "networks.py" else set()
        found = {name.partition(".")[0] for name in names} - sys.stdlib_module_names
        assert found <= required | extra | {"repro", "rich"}, path


def targets() -> set[str]:
    """Return the public targets of the Makefile."""
    names = set(re.findall(r"^([a-z][a-z-]*):(?!=)", read("Makefile"), re.MULTILINE))
    return names


def test_help_lists_what_works_and_nothing_else():
    """Each target is in the help, and each line of the help is a target."""
    listed = set(re.findall(r"^\t@echo 'make ([a-z-]+) ", read("Makefile"), re.MULTILINE))
    assert listed == targets() - {"help"}


DOCUMENTS = [
    "README.md",
    ".github/CONTRIBUTING.md",
    ".ci/run",
    *(
        p.relative_to(ROOT).as_posix()
        for folder in ("", "chapters", "contributing")
        for p in (ROOT / "book" / folder).glob("*.md")
    ),
]


@pytest.mark.parametrize("name", sorted(DOCUMENTS))
def test_documented_targets_exist(name):
    """A command that a text names can be typed."""
    said = re.findall(r"(?:^|`|&& )make ([a-z][a-z-]*(?: [a-z][a-z-]*)*)", read(name), re.MULTILINE)
    words = {word for words in said for word in words.split()}
    assert words <= targets(), words - targets()


def dead_paths(text: str, folder: Path = ROOT) -> list[str]:
    """Return what a text names of the project and what is not there.

    Links are read from a folder, or lead to a label. A word in code counts as a path if it begins with a folder of
    the project, and alone between backticks also if it is a file's name. What builds make (``.gitignore``) need not
    be there, nor what the text itself shows: a path, a colon, and a block.
    """
    linked = [target.split("#")[0] for target in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in target]
    code = "\n".join(re.findall(r"```.*?```|`[^`\n]+`", text, re.DOTALL))
    folders = "|".join(re.escape(path.name) for path in ROOT.iterdir() if path.is_dir())
    named = re.findall(rf"(?<![\w./-])(?:{folders})/[\w.*/-]+", code)
    named += re.findall(r"`([\w-][\w.-]*\.(?:md|toml|in|lock|yml|cff|py|json))`", text)
    made = tuple(line.strip("/*") for line in read(".gitignore").splitlines() if line.startswith("/"))
    shown = re.findall(r"^`([^`\n]+)`[^`\n]*(?:`\w+`)?:\n\n```", text, re.MULTILINE)
    labels = {label for page in DOCUMENTS for label in re.findall(r"^\((.+)\)=$", read(page), re.MULTILINE)}
    dead = [target for target in linked if target and target not in labels and not (folder / target).exists()]
    for name in named:
        there = any(ROOT.glob(name.rstrip("/."))) or any(ROOT.glob(f"{name}.ipynb"))  # pages have no suffix
        if not there and not name.startswith(made) and not any(path.startswith(name) for path in shown):
            dead.append(name)
    return dead


@pytest.mark.parametrize("name", ["README.md", ".github/CONTRIBUTING.md", "book/contributing.md"])
def test_named_paths_and_links_exist(name):
    """No text for contributors leads to a file that is not there."""
    assert dead_paths(read(name), (ROOT / name).parent) == []


def test_citation_matches_the_package():
    """The citation names this version, this licence and an entity as author."""
    citation = yaml.safe_load(read("CITATION.cff"))
    project = pyproject()["project"]
    assert citation["version"] == repro.__version__
    assert citation["license"] == project["license"]
    assert citation["authors"] == project["authors"]
    papers = {line.split(",")[0] for line in read("data/published/published.csv").splitlines()[1:]}
    assert len(citation["references"]) == len(papers)


def test_every_committed_study_has_a_script_that_makes_it():
    from scripts.studies import STUDIES

    others = {f"others_{name}" for name in FETCHED}
    stored = {path.name.partition(".")[0] for path in (ROOT / "data" / "studies").iterdir()}
    assert stored == set(STUDIES) | others
