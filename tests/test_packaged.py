"""The package as a stranger gets it: a wheel, installed beside the locked packages, used in an empty folder."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
SOURCES_OF_THE_BUNDLE = "repro_board/page/"
"""From these `make vendor` makes the script of the viewer; the wheel holds only what it made."""
BUNDLED = {
    "shape_viewer.js",
    "LICENSE.three",
    "live.html",
    "live.css",
    "live.js",
    "show.html",
    "show.js",
    "traces.js",
}
SHOW = "print(repro.__file__, shape.q.shape, found.q.shape)"
THREE_LINES = """import repro
robot = repro.Robot([repro.ConstantCurvature(0.11, 0.022), repro.Link(0.02)])
print(robot.tip([0.01, 0.0, 0.002]))"""
BROUGHT = """import sys
before = set(sys.modules)
import repro
print({name.partition(".")[0] for name in set(sys.modules) - before} - sys.stdlib_module_names)"""
LOCKED = Path(sysconfig.get_path("purelib"))

Called = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Return the wheel, built from a copy of the sources."""
    folder = tmp_path_factory.mktemp("wheel")
    sources = folder / "sources"
    shutil.copytree(ROOT / "src", sources / "src", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copyfile(ROOT / name, sources / name)
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--wheel-dir", folder, sources], check=True)
    return next(folder.glob("*.whl"))


def test_the_wheel_holds_the_packages_and_nothing_else(wheel):
    src = ROOT / "src"
    files = {
        path.relative_to(src).as_posix()
        for path in src.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and ".egg-info" not in path.as_posix()
    }
    bundle = {name for name in files if name.startswith(SOURCES_OF_THE_BUNDLE)}
    files -= {name for name in bundle if Path(name).name not in BUNDLED}
    with zipfile.ZipFile(wheel) as archive:
        assert {name for name in archive.namelist() if ".dist-info/" not in name} == files


@pytest.fixture(scope="module")
def called(wheel, tmp_path_factory) -> Called:
    """Return what calls a program where the wheel is installed, in an empty folder, with other packages beside it."""
    folder = tmp_path_factory.mktemp("stranger")
    venv, empty = folder / "venv", folder / "empty"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", venv], check=True)
    pip = [sys.executable, "-m", "pip", "--python", venv, "install", "--quiet", "--no-deps", wheel]
    subprocess.run(pip, check=True)
    empty.mkdir()
    for name in ("robot.toml", "mine.csv"):
        shutil.copyfile(ROOT / "data" / "example" / name, empty / name)

    def call(packages: Path, program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        # By their path alone: links to this checkout that lie beside the packages are then not followed.
        environment = {"PATH": "", "HOME": str(empty), "PYTHONPATH": str(packages)}
        command = [venv / "bin" / program, *arguments]
        return subprocess.run(
            command, cwd=empty, env=environment, capture_output=True, text=True, check=False
        )

    return call


@pytest.fixture(scope="module")
def required(wheel, tmp_path_factory) -> Path:
    """Return a folder with links to the locked packages that a bare installation brings, and to no others."""
    folder = tmp_path_factory.mktemp("required")
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        lines = metadata.PathDistribution(zipfile.Path(archive, name.removesuffix("METADATA"))).requires or []
    seen: set[str] = set()
    while lines:
        requirement = Requirement(lines.pop())
        if requirement.name in seen or (
            requirement.marker and not requirement.marker.evaluate({"extra": ""})
        ):
            continue
        seen.add(requirement.name)
        lines += metadata.requires(requirement.name) or []
        for top in {file.parts[0] for file in metadata.files(requirement.name) or []} - {"..", "__pycache__"}:
            (folder / top).symlink_to(LOCKED / top)
    assert "numba" in seen
    assert not {"torch", "jaxtyping", "tqdm", "pyserial", "papermill"} & seen
    return folder


@pytest.mark.slow
def test_a_bare_installation_has_the_library(called: Called, required):
    """``import repro`` brings nothing else before a name of it is used."""
    assert called(required, "python", "-c", BROUGHT).stdout == "{'repro'}\n"
    done = called(required, "python", "-c", THREE_LINES)
    assert done.returncode == 0, done.stderr
    theta, length = 0.01 / 0.022, 0.112
    sin, cos = math.sin(theta), math.cos(theta)
    x, z = length * (1 - cos) / theta + 0.02 * sin, length * sin / theta + 0.02 * cos
    printed = [float(number) for number in done.stdout.translate(str.maketrans("[]", "  ")).split()]
    closed_form = [cos, 0, sin, x, 0, 1, 0, 0, -sin, 0, cos, z, 0, 0, 0, 1]
    assert printed == pytest.approx(closed_form, abs=1e-7)


@pytest.mark.slow
def test_a_bare_installation_says_which_extra_a_command_needs(called: Called, required):
    """In one line, before it asks for anything else; help works."""
    for command, said in {
        "run": 'repro run needs the extra "book": pip install "repro-soft-robots[book]"\n',
        "record x -o y.rec": 'repro record needs the extra "board": pip install "repro-soft-robots[board]"\n',
        "fetch": 'repro fetch needs the extra "book": pip install "repro-soft-robots[book]"\n',
    }.items():
        done = called(required, "repro", *command.split())
        assert (done.returncode, done.stdout, done.stderr) == (2, "", said)
    done = called(required, "repro", "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert "A robot of your own" in done.stdout
    done = called(required, "repro", "track", "mine.csv", "--robot", "robot.toml", "-o", "shape.csv")
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_lines_of_the_readme_run_from_the_wheel(called: Called):
    """And the command says in one line that it needs a checkout where it does."""
    (lines,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    done = called(LOCKED, "python", "-c", lines + SHOW)
    (file, shapes) = done.stdout.splitlines()[-1].split(" ", 1)
    assert (Path(file).parts[-3:], shapes) == (("site-packages", "repro", "__init__.py"), "(200, 6) (40, 6)")
    for command in ("run a.ipynb", "sweep a.ipynb", "scorecard", "fetch", "compare"):
        done = called(LOCKED, "repro", *command.split())
        assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done
        assert "a checkout of the project" in done.stderr
