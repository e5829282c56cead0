"""What all tests share: the browser, and with SHAPES=1 a check of every shape annotation of the first edition."""

from __future__ import annotations

import functools
import inspect
import os
import signal
import types
import typing
from collections.abc import Callable, Iterator
from typing import Any

import jaxtyping
import pytest
import torch
from beartype import BeartypeConf, beartype
from chromium import find, started
from hypothesis import settings

collect_ignore = ["conftest.py"]  # it has no examples to run, and other folders have a module of this name

torch.set_num_threads(1)
# Started in the background of a script, this process and its children ignore interruptions, which tests send.
signal.signal(signal.SIGINT, signal.default_int_handler)
settings.register_profile("repro", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("repro")

_jaxtyped = jaxtyping.jaxtyped
_as_jaxtyping_raises = beartype(conf=BeartypeConf(violation_type=TypeError))


def checked_once(fn: Any = None, *, typechecker: Any) -> Any:
    """Check what a call takes and gives in one pass, with one size for each letter.

    jaxtyping's own decorator, whose place this takes, checks twice what a call takes and binds its signature first:
    the fit of a recording takes 7 s unchecked, 9 s with this, and took 16 s.
    """
    if fn is None:
        return functools.partial(checked_once, typechecker=typechecker)
    if not isinstance(fn, types.FunctionType) or inspect.isgeneratorfunction(fn):
        return _jaxtyped(fn, typechecker=typechecker)
    resolved = types.FunctionType(fn.__code__, fn.__globals__, fn.__name__, fn.__defaults__, fn.__closure__)
    resolved.__qualname__, resolved.__module__ = fn.__qualname__, fn.__module__
    resolved.__kwdefaults__ = fn.__kwdefaults__
    resolved.__annotations__ = {name: _resolve(hint, fn) for name, hint in fn.__annotations__.items()}
    checked = _as_jaxtyping_raises(resolved)

    @functools.wraps(fn)
    def call(*args: Any, **kwargs: Any) -> Any:
        with _jaxtyped("context"):
            return checked(*args, **kwargs)

    return call


def _resolve(hint: Any, fn: Callable[..., Any]) -> Any:
    def annotated(value: Any) -> None: ...

    annotated.__annotations__ = {"value": hint}
    try:
        return typing.get_type_hints(annotated, fn.__globals__, include_extras=True)["value"]
    except NameError:  # of a module that is imported for type checkers alone
        return Any


if os.environ.get("SHAPES"):
    # The import hook names jaxtyping's decorator in the modules that it reads.
    jaxtyping.jaxtyped = checked_once
    # Not as a context: modules are imported as tests need them, and each must be caught.
    jaxtyping.install_import_hook(["edition1", "edition1_live", "edition1_companion"], "beartype.beartype")


@pytest.fixture(scope="module")
def browser() -> Iterator:
    """Return Chromium; the tests that need it are skipped where there is none.

    Not for longer than a module: as long as it runs, playwright's event loop is in the way of any other.
    """
    pytest.importorskip("playwright.sync_api")
    executable = find()
    if executable is None:
        pytest.skip("Chromium is not installed")
    with started(executable) as chromium:
        yield chromium
