"""Formulas are typeset while the site is built; what cannot be typeset stops the build."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

BOOK = Path(__file__).resolve().parents[2] / "book"
pytest.importorskip("sphinx")
math_core = pytest.importorskip("math_core")


@pytest.fixture
def formulas(monkeypatch):
    """Import the extension."""
    monkeypatch.syspath_prepend(str(BOOK / "_ext"))
    yield importlib.import_module("repro_formulas")
    sys.modules.pop("repro_formulas", None)


@pytest.fixture
def build(tmp_path):
    """Return a function that builds one page with warnings as errors: its HTML, or what was said instead."""

    def of(text: str) -> tuple[int, str]:
        (tmp_path / "conf.py").write_text(
            f"import sys\nsys.path.insert(0, {str(BOOK / '_ext')!r})\n"
            "extensions = ['repro_formulas']\nhtml_math_renderer = 'mathml'\n"
        )
        (tmp_path / "index.rst").write_text(text)
        command = [
            sys.executable,
            "-m",
            "sphinx",
            "-q",
            "-W",
            "--keep-going",
            "-E",
            str(tmp_path),
            str(tmp_path / "out"),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return done.returncode, done.stderr or (tmp_path / "out" / "index.html").read_text()

    return of


def seen(html: str) -> str:
    """Return the characters of MathML that a reader sees."""
    return re.sub(r"<annotation.*?</annotation>|<[^>]+>", "", html, flags=re.DOTALL)


def test_a_formula_holds_its_tex(formulas):
    tex = r"\frac{a}{b} < \mathbf{q}"
    written = formulas.mathml(tex, displayed=False)
    assert seen(written) == "ab&lt;𝐪"
    assert r'<annotation encoding="application/x-tex">\frac{a}{b} &lt; \mathbf{q}</annotation>' in written


@pytest.mark.parametrize("tex", [r"\frac{a", r"\nosuchcommand x", "a_b_c", r"\begin{pmatrix} a", "a & b"])
def test_what_is_not_understood_is_refused(formulas, tex):
    with pytest.raises(math_core.LatexError):
        formulas.mathml(tex, displayed=True)


@pytest.mark.parametrize(("tex", "rows"), [("a = b", 0), (r"a &= b \\ c &= d", 2), ("a\n\nb\n  \nc", 3)])
def test_lines_stay_lines(formulas, tex, rows):
    """The library would write lines without an environment one after the other, silently."""
    assert formulas.mathml(formulas.in_lines(tex), displayed=True).count("<mtr>") == rows


def test_a_bracket_of_given_size_is_a_row_of_its_own(formulas):
    written = formulas.mathml(r"\bigl(a\bigr)^2", displayed=True)
    assert re.search(r"<msup><mrow><mo [^>]*minsize[^>]*>\)</mo></mrow><mn>2</mn></msup>", written)


def test_a_mark_stays_with_its_formula_and_a_number_with_its_equation(build):
    """A mark is in the span of its formula; a displayed formula can be reached, a reference leads to its number."""
    code, html = build("Title\n=====\n\nFor :math:`x`, see :eq:`one`.\n\n.. math:: y = x\n   :label: one\n")
    assert code == 0, html
    assert re.search(r'<span class="math notranslate"><math>.*?</math>,</span> see', html, re.DOTALL)
    assert re.search(r'<a[^>]* href="#equation-one">\(1\)</a>', html)
    box = re.search(
        r'<div ([^>]*class="math notranslate"[^>]*)>.*?</math><span class="eqno">\(1\)', html, re.DOTALL
    )
    assert box
    for attribute in ('id="equation-one"', 'tabindex="0"', 'aria-label="Formula"'):
        assert attribute in box.group(1)


def test_a_formula_that_cannot_be_typeset_stops_the_build(build):
    """With its file, its line, itself, and what is wrong with it."""
    code, said = build("Title\n=====\n\nGood :math:`x`.\n\n.. math::\n\n   y = \\nosuch{x}\n")
    assert code != 0
    assert re.search(r"index\.rst:6: WARNING: the formula y = \\nosuch\{x\} cannot be typeset", said)
    assert r'at character 4: Unknown command "\nosuch"' in said
