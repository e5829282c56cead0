"""Formulas as MathML, typeset while the site is built: a page needs no script for them, only a font."""

from __future__ import annotations

import re
from functools import cache

from docutils import nodes
from math_core import LatexError, LatexToMathML
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.math import get_node_equation_number
from sphinx.writers.html5 import HTML5Translator

logger = logging.getLogger(__name__)

BRACKET_WITH_INDEX = re.compile(r"(<m(?:sub|sup|subsup)>)(<mo [^>]*\bminsize[^>]*>[^<]*</mo>)")
CLOSING = re.compile(r"[.,;:?!)\]]+")


@cache
def mathml(tex: str, *, displayed: bool) -> str:
    """Return a formula as a ``math`` element that holds its TeX as well.

    Raises
    ------
    LatexError
        If the formula cannot be typeset.
    """
    converter = LatexToMathML(annotation=True, fancy_error=False)
    written = converter.convert_with_local_state(tex, displaystyle=displayed)
    # Chromium draws a bracket of a given size too small and too low where it carries the exponent itself
    return BRACKET_WITH_INDEX.sub(r"\1<mrow>\2</mrow>", written)


def in_lines(tex: str) -> str:
    """Return a displayed formula as one: lines, at a blank line or a line break, are aligned."""
    lines = r" \\ ".join(re.split(r"\n\s*\n", tex.strip()))
    return rf"\begin{{aligned}}{lines}\end{{aligned}}" if r"\\" in lines else lines


def keep_marks(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Give a formula the mark that ends its clause: browsers break the line after any formula."""
    for node in list(doctree.findall(nodes.math)):
        after = node.next_node(descend=False, siblings=True)
        if isinstance(after, nodes.Text) and (mark := CLOSING.match(after)):
            node["mark"] = mark.group()
            node.parent.replace(after, nodes.Text(after[mark.end() :]))


def _typeset(tex: str, node: nodes.Element, *, displayed: bool) -> str:
    try:
        return mathml(tex, displayed=displayed)
    except LatexError as error:
        formula = " ".join(node.astext().split())
        message = f"the formula {formula} cannot be typeset: at character {error}"
        logger.warning(message, location=node, type="math")
        return ""


def visit_inline(self: HTML5Translator, node: nodes.math) -> None:
    """Write a formula within a line."""
    formula = _typeset(node.astext(), node, displayed=False) + node.get("mark", "")
    self.body.append(f"{self.starttag(node, 'span', '', CLASS='math notranslate')}{formula}</span>")
    raise nodes.SkipNode


def visit_displayed(self: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula on lines of its own, in a box that scrolls where it is long and that the keyboard reaches."""
    tex = node.astext() if node["nowrap"] else in_lines(node.astext())
    reached = {"tabindex": "0", "role": "group", "aria-label": "Formula"}
    self.body.append(self.starttag(node, "div", "", CLASS="math notranslate", **reached))
    self.body.append(_typeset(tex, node, displayed=True))
    if node["number"]:
        self.body.append(f'<span class="eqno">({get_node_equation_number(self, node)})')
        self.add_permalink_ref(node, "Link to this equation")
        self.body.append("</span>")
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_displayed, None))
    app.connect("doctree-resolved", keep_marks)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
