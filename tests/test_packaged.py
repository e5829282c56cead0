"""The package as a stranger gets it: a wheel, installed beside the locked packages, used in an empty folder."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES_OF_THE_BUNDLE = "edition1_live/view/viewer/"
"""From these `make vendor` makes the script of the viewer; the wheel holds only what it made."""
BUNDLED = {"shape_viewer.js", "LICENSE.three"}
SHOW = "import edition1; print(edition1.__file__, tuple(shape.q.shape), tuple(shape.tip(robot).shape))"


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
        path.relative_to(src).as_posix().removeprefix("edition1/")
        for path in src.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and ".egg-info" not in path.as_posix()
    }
    bundle = {name for name in files if name.startswith(SOURCES_OF_THE_BUNDLE)}
    files -= {name for name in bundle if Path(name).name not in BUNDLED}
    with zipfile.ZipFile(wheel) as archive:
        assert {name for name in archive.namelist() if ".dist-info/" not in name} == files


def test_the_lines_of_the_readme_run_from_the_wheel(wheel, tmp_path):
    """And the command says in one line that it needs a checkout where it does."""
    venv, empty = tmp_path / "venv", tmp_path / "empty"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", venv], check=True)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(venv)}))
    pip = [sys.executable, "-m", "pip", "--python", venv, "install", "--quiet", "--no-deps", wheel]
    subprocess.run(pip, check=True)
    # Its path alone: the links to this checkout that lie there are then not followed.
    (site / "locked.pth").write_text(sysconfig.get_path("purelib") + "\n")
    empty.mkdir()
    for name in ("robot.toml", "mine.csv"):
        shutil.copyfile(ROOT / "data" / "example" / name, empty / name)
    (lines,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)

    def called(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        command, environment = [venv / "bin" / program, *arguments], {"PATH": "", "HOME": str(empty)}
        return subprocess.run(
            command, cwd=empty, env=environment, capture_output=True, text=True, check=False
        )

    done = called("python", "-c", lines + SHOW)
    assert done.stdout == f"{site / 'edition1/__init__.py'} (200, 3) (200, 4, 4)\n", done.stderr
    for command in ("run a.ipynb", "sweep a.ipynb", "scorecard", "fetch", "compare"):
        done = called("repro", *command.split())
        assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done
        assert "a checkout of the project" in done.stderr
