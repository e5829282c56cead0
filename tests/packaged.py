"""The package as a stranger gets it: built, looked into, installed on its own, used in an empty folder.

It is installed twice: for the Python that runs this, and for the newest one found that torch and numba are built for.
The latter is not tried where its torch cannot be had: beside CUDA that is some gigabytes.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("repro", "edition1_live", "edition1_companion")
WITH_THE_SOURCES_ONLY = "edition1_live/view/viewer/"
"""From its other files `make vendor` bundles the script of the viewer."""
BUNDLED = {"shape_viewer.js", "LICENSE.three"}
NEED_A_CHECKOUT = ("run a.ipynb", "sweep a.ipynb", "scorecard", "fetch", "train", "studies")
NEWER = ("3.13", "3.12")
"""Newest first: the lock has wheels for them."""
LONG_S = 600.0
BUILD = "import sys; from setuptools.build_meta import build_sdist; build_sdist(sys.argv[1])"
SHOW = "import edition1 as r; print(r.__version__, tuple(shape.q.shape), tuple(shape.tip(robot).shape))"


def build(folder: Path) -> tuple[Path, Path]:
    """Build the source distribution, and from that alone the wheel; return both."""
    sources = folder / "sources"
    sources.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copyfile(ROOT / name, sources / name)
    shutil.copytree(ROOT / "src", sources / "src", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    subprocess.run([sys.executable, "-c", BUILD, folder], cwd=sources, check=True, stdout=subprocess.DEVNULL)
    (sdist,) = folder.glob("*.tar.gz")
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--wheel-dir", folder, sdist], check=True)
    (wheel,) = folder.glob("*.whl")
    return sdist, wheel


def check_contents(sdist: Path, wheel: Path) -> None:
    """Both hold every file of the three packages, and the wheel nothing but them."""
    files = {
        path.relative_to(ROOT / "src").as_posix()
        for package in PACKAGES
        for path in (ROOT / "src" / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    wanted = {
        name for name in files if not name.startswith(WITH_THE_SOURCES_ONLY) or Path(name).name in BUNDLED
    }
    with zipfile.ZipFile(wheel) as archive:
        inside = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert inside == wanted, f"missing: {sorted(wanted - inside)}; too much: {sorted(inside - wanted)}"
    with tarfile.open(sdist) as archive:
        names = {name.partition("/src/")[2] for name in archive.getnames()}
    assert wanted <= names, f"missing in the source distribution: {sorted(wanted - names)}"


def newer() -> Path | None:
    """Return the newest Python that is installed here beside the one that runs this, if any."""
    show = ["-c", "import sys; print(sys.executable)"]
    for version in NEWER:
        with suppress(FileNotFoundError):
            environment = {**os.environ, "PYENV_VERSION": version}  # asks pyenv for it, where that is there
            found = subprocess.run(
                [f"python{version}", *show], env=environment, capture_output=True, text=True
            )
            if found.returncode == 0:
                return Path(found.stdout.strip())
    return None


def has_torch(python: Path, venv: Path) -> bool:
    """Make an environment with torch; return whether that could be had."""
    subprocess.run([python, "-m", "venv", venv], check=True)
    (torch,) = re.findall(r"^TORCH := (\S+)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    try:
        subprocess.run(
            [venv / "bin" / "python", "-m", "pip", "install", "--quiet", torch], check=True, timeout=LONG_S
        )
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
        return False
    return True


def install(wheel: Path, venv: Path) -> Path:
    """Install the wheel with what it asks for, in the versions of the lock; return the folder of its programs."""
    programs = venv / "bin"
    # Without hashes: with them, pip would ask for one of the wheel too. `make env` checks them.
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    versions = venv / "versions.txt"
    versions.write_text(re.sub(r" *\\\n *--hash=\S+", "", lock), encoding="utf-8")
    pip = [programs / "python", "-m", "pip"]
    subprocess.run([*pip, "install", "--quiet", "--constraint", versions, wheel], check=True)
    subprocess.run([*pip, "check"], check=True, stdout=subprocess.DEVNULL)
    return programs


def use(programs: Path, folder: Path) -> None:
    """Run the lines of the README, and the commands that need a checkout, in an empty folder."""
    empty = folder / "empty"
    empty.mkdir()
    for name in ("robot.toml", "mine.csv"):
        shutil.copyfile(ROOT / "data" / "example" / name, empty / name)
    environment = {"PATH": str(programs), "HOME": str(empty)}
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (lines,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)

    def called(*command: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command, cwd=empty, env=environment, capture_output=True, text=True, check=False
        )

    done = called(programs / "python", "-c", lines + SHOW)
    assert re.fullmatch(r"\d+\.\d+\.\d+ \(200, 3\) \(200, 4, 4\)\n", done.stdout), done.stderr
    assert called(programs / "repro", "record", "--list").returncode == 0
    versions = called(programs / "repro", "run", "--versions")
    assert versions.returncode == 0, versions
    for command in NEED_A_CHECKOUT:
        done = called(programs / "repro", *command.split())
        said = done.stderr.strip().splitlines()
        assert done.returncode == 2, (command, done)
        assert len(said) == 1, said
        assert "must be inside a checkout of the project" in said[0], said


def main() -> None:
    """Do all of it, in a folder that is removed afterwards."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        sdist, wheel = build(folder)
        check_contents(sdist, wheel)
        for python in filter(None, (Path(sys.executable), newer())):
            venv = folder / python.name
            if has_torch(python, venv):
                use(install(wheel, venv), venv)
                print(f"{sdist.name} and {wheel.name}: built, installed, used by {python}.")
            elif python == Path(sys.executable):
                raise SystemExit("torch cannot be installed.")
            else:
                print(f"Not tried with {python}: its torch cannot be had here.")
            shutil.rmtree(venv)


if __name__ == "__main__":
    main()
