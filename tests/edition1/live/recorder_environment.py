"""Test the recorder in an environment of its own, made of `requirements-recorder.lock` alone; run as a program."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[3]
BUILT_FROM = ("pyproject.toml", "README.md", "LICENSE", "src")


def main() -> int:
    """Install as the README says, then run the tests of the recorder with what was installed."""
    with TemporaryDirectory() as folder:
        environment, source = Path(folder) / "environment", Path(folder) / "source"
        source.mkdir()
        for name in BUILT_FROM:  # a copy: a build leaves files behind
            of = ROOT / name
            copy = shutil.copytree if of.is_dir() else shutil.copy
            copy(of, source / name)
        subprocess.run([sys.executable, "-m", "venv", environment], check=True)
        install = [environment / "bin" / "python", "-m", "pip", "install", "--quiet", "--no-deps"]
        subprocess.run([*install, "--require-hashes", "-r", ROOT / "requirements-recorder.lock"], check=True)
        subprocess.run([*install, source], check=True)
        tests = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-s",
            ROOT / "tests/edition1/live/test_without_torch.py",
        ]
        variables = os.environ | {"REPRO_RECORDER": str(environment / "bin" / "repro")}
        return subprocess.run(tests, cwd=ROOT, env=variables, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
