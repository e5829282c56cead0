"""What every module needs: bad input refused in words, and functions compiled by numba."""

from __future__ import annotations

import errno
import functools
import gc
import hashlib
import math
import os
import pickle
import secrets
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import EllipsisType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike as ArrayLike

Array = np.ndarray
"""An array of numbers: what functions return. Where numbers are taken, lists, tuples and data frames will do."""
Dimensions = tuple[int | EllipsisType | None, ...]
"""A shape: whole numbers, ``None`` for any size, ``...`` in front for any leading dimensions."""


class InputError(ValueError):
    """Input that cannot be used. The message names the input and its owner, what was expected and what came.

    Examples
    --------
    >>> import repro
    >>> try:
    ...     repro.ConstantCurvature(length=-0.1, radius=0.02)
    ... except repro.InputError as error:
    ...     print(error)
    Input length of ConstantCurvature must be positive [m]; instead received -0.1.
    """


def bad_input(name: str, owner: str, must_be: str, received: object) -> InputError:
    """Return the error to raise for the input ``name`` of ``owner``; long values are cut at 200 characters.

    What is not printable is escaped: words of a file must not control the terminal that shows them.
    """
    text = str(received)
    text = text if len(text) <= 200 else text[:197] + "..."
    return InputError(printable(f"Input {name} of {owner} must be {must_be}; instead received {text}."))


def printable(text: str) -> str:
    """Return a text in one line, with everything escaped that is not printable."""
    text = text.replace("\n", " ")
    return "".join(x if x.isprintable() else x.encode("unicode_escape").decode() for x in text)


def require(holds: object, name: str, owner: str, must_be: str, received: object) -> None:
    """Refuse the input ``name`` of ``owner`` unless ``holds``."""
    if not holds:
        raise bad_input(name, owner, must_be, received)


def array(value: object, name: str, owner: str) -> Array:
    """Return ``value`` as an array of whatever it holds, or refuse it where its rows are not of one length."""
    try:
        return np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:
        words = "numbers in rows of one length" if isinstance(error, ValueError) else "numbers"
        raise bad_input(name, owner, words, f"{type(value).__name__} {value!r}") from error


def numbers(
    value: object, name: str, owner: str, shape: Dimensions | None = None, *, finite: bool = True
) -> Array:
    """Return ``value`` as an array of float64, or refuse it.

    Parameters
    ----------
    value
        An array, a list, a data frame, a number.
    name, owner
        For the message.
    shape
        What its shape must be.
    finite
        Whether NaN and infinity are refused.

    Raises
    ------
    InputError
        If it is not as it must be.
    """
    given = array(value, name, owner)
    if given.dtype.kind == "c":  # NumPy would drop the imaginary part
        raise bad_input(name, owner, "real numbers", f"{type(value).__name__} {value!r}")
    try:
        found = np.asarray(given, dtype=np.float64)
    except OverflowError as error:  # it may have more digits than Python writes
        raise bad_input(name, owner, "numbers below 1.8e308", f"a larger {type(value).__name__}") from error
    except (TypeError, ValueError) as error:
        raise bad_input(name, owner, "numbers", f"{type(value).__name__} {value!r}") from error
    if shape is not None:
        own = tuple(n for n in shape if n is not ...)
        there = found.shape[found.ndim - len(own) :] if len(shape) > len(own) else found.shape
        if len(there) != len(own) or any(n is not None and n != m for n, m in zip(own, there, strict=True)):
            words = ", ".join("..." if n is ... else "any" if n is None else str(n) for n in shape)
            raise bad_input(name, owner, f"numbers of shape ({words})", f"shape {found.shape}")
    if finite and not np.isfinite(found).all():
        raise bad_input(name, owner, "finite", f"{int((~np.isfinite(found)).sum())} values that are not")
    return found


def scalar(value: object, name: str, owner: str, positive: str = "") -> float:
    """Return one number, or refuse what is none, such as a text; with a word for it, also what is not positive."""
    require(not isinstance(value, str | bytes), name, owner, "a number", repr(value))
    found = float(numbers(value, name, owner, (), finite=False))
    require(not positive or 0 < found < math.inf, name, owner, positive, value)
    return found


FULL_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""A disk that is full, or refuses: nothing that a user gave is wrong then."""


def new(path: str | os.PathLike[str], owner: str, name: str = "output") -> Path:
    """Return the path of what is to be written; refuse one that is there."""
    path = Path(path)
    expected = "one that does not exist yet"
    require(not (path.exists() or path.is_symlink()), name, owner, expected, path.name or path)
    require(path.parent.is_dir(), name, owner, "in a folder that exists", path)
    return path


@contextmanager
def whole(path: str | os.PathLike[str], owner: str, *, new: bool = True) -> Iterator[Path]:
    """Give a place beside a file or folder to write it, which takes its name when all went well.

    Where something fails nothing is left. A process that is killed leaves a hidden ``.part``, which is in nobody's
    way.

    Parameters
    ----------
    path
        What is written.
    owner
        For the message.
    new
        Whether one that is there already is refused; else a file is replaced.

    Raises
    ------
    InputError
        If it is there already, or cannot be made.
    OSError
        With the path, if the disk is full or refuses.
    """
    path = Path(path)
    part = path.parent / f".{path.name}.{secrets.token_hex(4)}.part"  # "." has no name
    try:
        yield part
        if new and (path.exists() or path.is_symlink()):  # another process may have made it meanwhile
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
        if part.exists():
            part.replace(path)
    except OSError as error:
        if error.errno in FULL_DISK:
            raise OSError(error.errno, error.strerror or str(error), str(path)) from error
        must = "a file that can be made"
        if isinstance(error, FileExistsError):
            must = "a new file (give another name, or move the old one)"
        raise bad_input("output", owner, must, f"{path} ({error.strerror or error})") from error
    finally:
        with suppress(OSError):  # where nothing can be written nothing is left
            shutil.rmtree(part) if part.is_dir() else part.unlink(missing_ok=True)


def is_table(value: object) -> bool:
    """Whether it is the path of a table, or a data frame whose columns have names."""
    columns = getattr(value, "columns", None)
    return isinstance(value, str | os.PathLike) or (columns is not None and columns.dtype.kind == "O")


def rows_of(values: Array) -> Array:
    """Return an array of any leading dimensions as contiguous rows ``[n, last]``."""
    return np.ascontiguousarray(values.reshape(math.prod(values.shape[:-1]), values.shape[-1]))


def kernel(
    function: Callable[..., Any] | None = None,
    *,
    entry: bool = False,
    reorder: bool = False,
    allocates: bool = False,
    apart: bool = False,
    ahead: Callable[[tuple[Any, ...]], None] | None = None,
) -> Any:
    """Compile a function when it is first called, and keep the machine code on disk for other processes.

    numba keeps code by the file of a function, and does not notice that another file has changed whose functions it
    calls. Our folder is named after the content of all files with kernels, so that an edit there compiles all anew.

    Parameters
    ----------
    function
        The function.
    entry
        Whether Python calls the function. The others are called by kernels only, which saves the compiler work.
    reorder
        Let sums be reordered, so that the processor adds several numbers at once; NaN and infinity stay exact.
    allocates
        Whether the function makes arrays. The others do not count references to arrays, which would cost them half
        of their time.
    apart
        Whether the function is not inlined, which halves the compiler's work on a long one.
    ahead
        Is called with the types of the arguments when the function is not on disk, and compiles what it calls.
    """
    if function is None:
        return lambda found: kernel(
            found, entry=entry, reorder=reorder, allocates=allocates, apart=apart, ahead=ahead
        )
    import numba

    _attend_to_compiling()
    config: Any = numba.config  # type: ignore[attr-defined]
    before = config.CACHE_DIR
    folder = Path(before) if before else cache_folder() / "numba"
    # Set for this function only: other users of numba keep their own place.
    config.CACHE_DIR = str(folder / f"repro-{_digest()}")
    try:
        fastmath = {"reassoc", "contract", "nsz"} if reorder else False
        options: dict[str, Any] = {"error_model": "numpy", "fastmath": fastmath, "_nrt": allocates}
        options |= {"no_cpython_wrapper": not entry, "no_cfunc_wrapper": True}
        # Tables are many words to hand on at every call. Inlining would change sums that may be reordered.
        options["forceinline"] = not (entry or reorder or apart)
        options["nogil"] = entry  # several threads may estimate at a time
        found: Any = numba.njit(function, cache=_writable(config.CACHE_DIR), **options)
        found.ahead = ahead
        return found
    finally:
        config.CACHE_DIR = before


@functools.cache
def _attend_to_compiling() -> None:
    """Let numba tell of the kernels that it compiles because they are not on disk: that takes some seconds.

    One line says so, once a process, and none in a page of the book, for which ``REPRO_RESULTS`` is set. Meanwhile no
    garbage is collected: a tenth of the time went into looking for it.
    """
    from numba.core import event

    class Attending(event.Listener):
        told = collects = False
        within = 0

        def on_start(self, event: Any) -> None:
            if not _is_ours(event):
                return
            if not self.within:
                self.collects = gc.isenabled()
                gc.disable()
            self.within += 1
            if not self.told and "REPRO_RESULTS" not in os.environ:
                words = "Compiling for this machine once, about 10 s; later runs take it from disk."
                print(f"repro: {words}", file=sys.stderr)
            self.told = True
            ahead = getattr(event.data["dispatcher"], "ahead", None)
            if ahead is not None:
                ahead(event.data["args"])

        def on_end(self, event: Any) -> None:
            self.within -= _is_ours(event)
            if self.collects and not self.within:
                gc.enable()

    event.register("numba:compile", Attending())


_PATIENCE_S = 60.0
"""Longest wait for another process that compiles [s]."""
_COMPILE = """
import importlib, pickle, sys
sys.path[:], module, name = pickle.load(sys.stdin.buffer)
getattr(importlib.import_module(module), name).compile(pickle.load(sys.stdin.buffer))
"""


def result_of(function: Any, *types: Any) -> Any:
    """Compile a kernel for the types of its arguments, and return the type of its result."""
    function.compile(types)
    return function.overloads[types].signature.return_type


@contextmanager
def compiled_beside(function: Any, *types: Any) -> Iterator[None]:
    """Let another process compile a kernel, and write it to disk, while the block compiles others.

    What calls the kernel finds it on disk then. Where there can be no such process, it compiles the kernel.
    """
    # A program that has Python inside would be started anew by its own name.
    is_python = "python" in Path(sys.executable or "").name and not hasattr(sys, "frozen")
    is_kept = function.stats.cache_path is not None and types not in function.overloads
    child = None
    if is_python and is_kept and (os.cpu_count() or 1) > 1:
        with suppress(OSError):
            child = _compiling(function, types)
    try:
        yield
        if child is not None:
            with suppress(subprocess.TimeoutExpired):
                child.wait(_PATIENCE_S)
    finally:
        if child is not None:
            child.kill()
            child.wait()


def _compiling(function: Any, types: tuple[Any, ...]) -> subprocess.Popen[bytes]:
    """Return a process that compiles a kernel. It is a new one, because threads do not survive a fork."""
    with tempfile.TemporaryFile() as given:
        pickle.dump((sys.path, function.__module__, function.__name__), given)
        pickle.dump(types, given)
        given.seek(0)
        return subprocess.Popen(
            [sys.executable, "-I", "-c", _COMPILE],
            stdin=given,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )


def _is_ours(event: Any) -> bool:
    return event.data["dispatcher"].py_func.__module__.startswith("repro.")


def cache_folder() -> Path:
    """Return the folder for what can be made again; one where nothing can be written, for a user without a home."""
    import platformdirs

    try:
        return platformdirs.user_cache_path("repro")
    except RuntimeError:
        return Path(os.devnull, "repro")


@functools.cache
def _digest() -> str:
    files = [file.read_bytes() for file in sorted(Path(__file__).parent.rglob("*.py"))]
    return hashlib.sha256(b"".join(content for content in files if b"@kernel" in content)).hexdigest()[:16]


def _writable(folder: str) -> bool:
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
