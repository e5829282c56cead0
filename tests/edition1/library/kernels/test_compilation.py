"""The cache of machine code: fresh after any edit of a kernel, used otherwise, and never in anybody's way."""

import ast
import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from edition1 import kernels
from edition1.kernels.compilation import _CACHE, _digest, machine_code

PACKAGE = Path(kernels.__file__).parent
SOURCES = PACKAGE.parents[1]
MODULES = {
    ".".join(file.relative_to(SOURCES).with_suffix("").parts): file
    for file in sorted(SOURCES.rglob("*.py"))
    if "kernels.compilation import machine_code\n" in file.read_text()
}
"""Those with kernels."""
CALLEE = """from edition1.kernels.compilation import machine_code


@machine_code()
def factor(x):
    return {} * x
"""
CALLER = """from edition1.kernels.compilation import machine_code
from edition1.kernels.callee import factor


@machine_code()
def call(x):
    return factor(x)


if __name__ == "__main__":
    print(call(1.0), sum(call.stats.cache_hits.values()))
"""


def run(root, cache):
    # Without byte code: Python tells an edited file by its size and the second of its change.
    changes = {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1", "NUMBA_CACHE_DIR": str(cache)}
    environment = os.environ | changes
    command = [sys.executable, "-m", "edition1.kernels.caller"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_an_edited_callee_is_noticed_and_an_unchanged_one_is_not_compiled_again(tmp_path):
    """Wherever the package lies: copies share what is compiled."""
    cache, copy = tmp_path / "cache", tmp_path / "copy"
    package = tmp_path / "src" / "edition1" / "kernels"
    package.mkdir(parents=True)
    (package.parent / "__init__.py").touch()
    (package / "__init__.py").touch()
    (package / "compilation.py").write_bytes((PACKAGE / "compilation.py").read_bytes())
    (package / "caller.py").write_text(CALLER)
    for factor, expected in ((2.0, ["2.0", "0"]), (2.0, ["2.0", "1"]), (3.0, ["3.0", "0"])):
        (package / "callee.py").write_text(CALLEE.format(factor))
        assert run(tmp_path / "src", cache) == expected
    shutil.copytree(tmp_path / "src", copy)
    assert run(copy, cache) == ["3.0", "1"]
    assert len(list(cache.iterdir())) == 2


def test_folder_depends_on_every_kernel_and_on_nothing_else(tmp_path):
    package = tmp_path / "edition1" / "kernels"
    package.mkdir(parents=True)
    (package / "compilation.py").touch()
    first = _digest(package)
    (package.parent / "other.py").write_text("a")
    assert _digest(package) == first
    (package / "a.py").write_text("a")
    second = _digest(package)
    (package / "a.py").rename(package / "b.py")
    assert len({first, second, _digest(package)}) == 3


def test_other_users_of_numba_keep_their_place():
    before = numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES
    machine_code()(lambda x: x)
    assert before == (numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES)


def test_this_package_has_a_folder():
    assert _CACHE.is_dir()
    assert _CACHE.name == _digest(PACKAGE)


@pytest.mark.parametrize("name", MODULES)
def test_kernels_use_nothing_from_modules_that_the_folder_does_not_depend_on(name):
    """What a kernel takes from another module is frozen into its machine code: allowed are its own and `kernels`."""
    kernels = [x for x in vars(importlib.import_module(name)).values() if hasattr(x, "py_func")]
    used = {x for kernel in kernels for x in kernel.py_func.__code__.co_names}
    elsewhere = {
        alias.asname or alias.name
        for node in ast.walk(ast.parse(MODULES[name].read_text()))
        if isinstance(node, ast.ImportFrom) and node.module.startswith("edition1")
        for alias in node.names
        if not node.module.startswith("edition1.kernels")
    }
    assert kernels
    assert not used & elsewhere
