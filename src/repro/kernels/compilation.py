"""Compiled kernels, by numba, with a cache that an edited kernel can never outlive.

Numba notices that the file of a cached function has changed, but not that a function which it calls has. Here the
folder of the cache is named after the content of all of `repro.kernels`, so that any edit there compiles all anew. A
kernel uses functions and constants of that package and of its own module only; the rest comes as arguments.
"""

from __future__ import annotations

import hashlib
import inspect
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import platformdirs

_REORDER = {"reassoc", "contract", "nsz"}
"""Freedom to sum in any order, which lets the processor add several numbers at once; NaN and infinity stay exact."""


def machine_code(*, reorder: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function when it is first called, and keep the machine code for other processes.

    Parameters
    ----------
    reorder
        Let sums be reordered: for long sums, never where an exact zero has a meaning.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        folder = _CACHE if not before else Path(before) / _CACHE.name
        # Set for this decoration only, which is when numba looks: other users of numba keep their own place.
        numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
        try:
            return numba.njit(
                inspect.unwrap(function),
                cache=_writable(folder),
                error_model="numpy",
                fastmath=_REORDER if reorder else False,
            )
        finally:
            numba.config.CACHE_DIR = before  # type: ignore[attr-defined]

    return decorate


def _cache_folder(package: Path) -> Path:
    """Folder for the machine code of kernels: below ``.cache`` of the project, or in the user's cache.

    Parameters
    ----------
    package
        Folder of kernels. It belongs to a project if its package lies in ``src`` beside a ``pyproject.toml``.
    """
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        content = file.read_bytes()
        digest.update(f"{file.relative_to(package).as_posix()} {len(content)}\n".encode() + content)
    root = package.parents[2]
    project = package.parents[1].name == "src" and (root / "pyproject.toml").is_file()
    place = root / ".cache" if project else Path(platformdirs.user_cache_dir("repro"))
    return place / "numba" / digest.hexdigest()[:16]


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


_CACHE = _cache_folder(Path(__file__).resolve().parent)
"""Folder for the machine code; below ``NUMBA_CACHE_DIR`` where that is set."""
