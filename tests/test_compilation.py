"""The cache of machine code: fresh after any edit of a kernel, used otherwise, and never in anybody's way."""

import ast
import importlib
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

import repro
from repro.compilation import CACHE, PATTERN, cache_folder, compiled

PACKAGE = Path(repro.__file__).parent
MODULES = sorted(PACKAGE.rglob(PATTERN))
CALLEE = "from repro.compilation import compiled\n\n\n@compiled()\ndef factor(x):\n    return {} * x\n"
CALLER = """from repro.compilation import compiled
from repro.compiled_callee import factor


@compiled()
def call(x):
    return factor(x)


if __name__ == "__main__":
    print(call(1.0), sum(call.stats.cache_hits.values()))
"""


def run(root):
    # Without byte code: Python tells an edited file by its size and the second of its change.
    environment = os.environ | {"PYTHONPATH": str(root / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "repro.compiled_caller"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_an_edited_callee_is_noticed_and_an_unchanged_one_is_not_compiled_again(tmp_path):
    package = tmp_path / "src" / "repro"
    package.mkdir(parents=True)
    (tmp_path / "pyproject.toml").touch()
    (package / "__init__.py").touch()
    (package / "compilation.py").write_bytes((PACKAGE / "compilation.py").read_bytes())
    (package / "compiled_caller.py").write_text(CALLER)
    for factor, expected in ((2.0, ["2.0", "0"]), (2.0, ["2.0", "1"]), (3.0, ["3.0", "0"])):
        (package / "compiled_callee.py").write_text(CALLEE.format(factor))
        assert run(tmp_path) == expected
    assert len(list((tmp_path / ".cache" / "numba").iterdir())) == 2


def test_folder_depends_on_every_kernel_and_on_nothing_else(tmp_path):
    package = tmp_path / "site-packages" / "repro"
    (package / "room").mkdir(parents=True)
    (package / "compilation.py").touch()
    first = cache_folder(package)
    (package / "other.py").write_text("a")
    assert cache_folder(package) == first
    (package / "room" / "compiled_a.py").write_text("a")
    second = cache_folder(package)
    (package / "room" / "compiled_a.py").rename(package / "room" / "compiled_b.py")
    assert len({first, second, cache_folder(package)}) == 3
    assert not first.is_relative_to(tmp_path)  # not in a project: the user's cache


def test_other_users_of_numba_keep_their_place():
    before = numba.config.CACHE_DIR
    compiled()(lambda x: x)
    assert before == numba.config.CACHE_DIR


def test_this_package_has_a_folder():
    assert CACHE.is_dir()
    assert CACHE.name == cache_folder(PACKAGE).name


@pytest.mark.parametrize("file", MODULES, ids=lambda file: file.stem)
def test_kernels_use_nothing_from_modules_that_the_folder_does_not_depend_on(file):
    """What a kernel takes from another module is frozen into its machine code."""
    name = ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts)
    kernels = [x for x in vars(importlib.import_module(name)).values() if hasattr(x, "py_func")]
    used = {x for kernel in kernels for x in kernel.py_func.__code__.co_names}
    elsewhere = {
        alias.asname or alias.name
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module.startswith("repro.")
        for alias in node.names
        if not node.module.rpartition(".")[2].startswith("compiled_")
    }
    assert kernels
    assert not used & elsewhere
