"""The face of the library: what `import repro` offers, and how it explains itself."""

from __future__ import annotations

import ast
import inspect
import pydoc
import re
from pathlib import Path

import numpy as np
import pytest

import repro

SOURCE = Path(repro.__file__).read_text(encoding="utf-8")


def test_type_checkers_see_the_names_that_there_are():
    """The imports that only they read say the same as the table from which names are found."""
    seen = {
        alias.asname: node.module.removeprefix("repro.")
        for node in ast.walk(ast.parse(SOURCE))
        if isinstance(node, ast.ImportFrom) and node.module.startswith("repro.")
        for alias in node.names
    }
    assert seen == repro._HOME_OF
    assert set(repro.__all__) == set(seen) <= set(dir(repro))


@pytest.mark.parametrize("name", repro.__all__)
def test_every_public_name_has_its_meaning_and_an_example(name):
    found = getattr(repro, name)
    text = inspect.getdoc(found) or ""
    assert text.split("\n")[0].endswith("."), "the first line is a sentence"
    if inspect.isclass(found) and issubclass(found, Exception):
        return
    called = found.__init__ if inspect.isclass(found) else found
    takes = [name for name in inspect.signature(called).parameters if name not in ("self", "args", "kwargs")]
    assert all(name in text for name in takes), "every argument is described"
    assert ">>>" in text


def test_help_reads_like_a_table_of_contents():
    text = pydoc.render_doc(repro, renderer=pydoc.plaintext)
    first = text.split("PACKAGE CONTENTS")[0]
    assert all(name in first for name in repro.__all__ if name != "InputError")
    assert len(first.splitlines()) < 70


def test_the_lines_of_the_reference_find_the_shape_that_they_simulate():
    page = Path(__file__).parents[2].joinpath("book", "api.md").read_text(encoding="utf-8")
    (lines,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    there: dict = {}
    exec(lines, there)
    tips = [there["robot"].tip(q)[:, :3, 3] for q in (there["q"], there["shape"].q)]
    assert np.linalg.norm(tips[0] - tips[1], axis=1).max() < 2e-4
    assert f"```text\n{there['shape']}\n```" in page


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'repro' has no attribute 'no_such_name'"):
        _ = repro.no_such_name
