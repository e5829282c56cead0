"""Compiled kernels, by numba, with a cache that an edited kernel can never outlive.

Numba notices that the file of a cached function has changed, but not that a function which it calls has. Here the
folder of the cache is named after the content of all of `edition1.kernels`, so that any edit there compiles all anew. A
kernel uses functions and constants of that package and of its own module only; the rest comes as arguments. Within
that folder numba names one after the place of each file; here it is the file's content, which copies share.
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
from numba.core.caching import UserProvidedCacheLocator

_CONFIG: Any = numba.config  # type: ignore[attr-defined]
_REORDER = {"reassoc", "contract", "nsz"}
"""Freedom to sum in any order, which lets the processor add several numbers at once; NaN and infinity stay exact."""


class ByContent(UserProvidedCacheLocator):
    """Where numba keeps the machine code of a file: a folder that a copy of the file has too."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        super().__init__(py_func, py_file)
        path = Path(py_file)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        self._cache_path = str(Path(_CONFIG.CACHE_DIR, f"{path.stem}-{digest[:16]}"))


def machine_code(*, reorder: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function when it is first called, and keep the machine code for other processes.

    Parameters
    ----------
    reorder
        Let sums be reordered: for long sums, never where an exact zero has a meaning.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        before = (
            _CONFIG.CACHE_DIR,
            getattr(_CONFIG, "CACHE_LOCATOR_CLASSES", ""),
        )  # numba 0.60 has only the first
        folder = _CACHE if not before[0] else Path(before[0]) / _CACHE.name
        # Set for this decoration only, which is when numba looks: other users of numba keep their own place.
        _CONFIG.CACHE_DIR, _CONFIG.CACHE_LOCATOR_CLASSES = str(folder), f"{__name__}.{ByContent.__name__}"
        try:
            return numba.njit(
                inspect.unwrap(function),
                cache=_writable(folder),
                error_model="numpy",
                fastmath=_REORDER if reorder else False,
            )
        finally:
            _CONFIG.CACHE_DIR, _CONFIG.CACHE_LOCATOR_CLASSES = before

    return decorate


def _digest(package: Path) -> str:
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        content = file.read_bytes()
        digest.update(f"{file.relative_to(package).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:16]


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


_CACHE = platformdirs.user_cache_path("repro") / "numba" / _digest(Path(__file__).resolve().parent)
"""Folder for the machine code, for all copies of the package; below ``NUMBA_CACHE_DIR`` where that is set."""
