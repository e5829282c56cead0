"""What a reader sees of tables and figures, and which texts of them no reader should meet."""

from __future__ import annotations

import re
from html import unescape
from html.parser import HTMLParser

MACHINE_NAME = re.compile(r"(?<![\w./])(?![A-Za-z]_\w{1,2}\b)[A-Za-z]\w*_\w+(?!\w*\.\w)")
"""A name with underscores, other than a letter with its index and the name of a file."""
NO_VALUE = re.compile(r"nan|NaN|[-−]?inf|<NA>|NaT|None")
NUMBER = re.compile(r"[-−]?[\d.,]+(?= × 10|$)")
MOST_DIGITS = 4
OUTPUT = re.compile(r'class="output text_plain.*?<pre[^>]*>(.*?)</pre>', re.DOTALL)
FORMULA = re.compile(r'<(span|div) class="math .*?</\1>', re.DOTALL)
NO_PROSE = re.compile(r"<(script|style|pre|code|svg|form)\b.*?</\1>|\b[0-9a-f]{12}\b", re.DOTALL)
"""A hash may read as a number with a power."""
AS_COMPUTED = re.compile(
    r"(?<![\w.])\d+(?:\.\d+)?e[-+]?\d{1,3}\b"  # 1e-05
    r"|[{[(]'|\[-?\d[\d.]*, [^]]*\]|(?<=[:=,] )(?:True|False|None)\b|\b(?:array|tensor|dtype)[(=]"
)
"""Numbers and values as a program writes them, not a person."""


class Cells(HTMLParser):
    """The cells of the tables of a page: text without code, and whether all its digits are meant."""

    def __init__(self) -> None:
        super().__init__()
        self.cells: list[tuple[str, bool]] = []
        self._text: list[str] | None = None
        self._exact = False
        self._code = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Begin a cell."""
        if tag in ("td", "th", "caption"):
            self._text, self._exact = [], "exact" in (dict(attrs).get("class") or "").split()
        self._code += tag == "code"

    def handle_endtag(self, tag: str) -> None:
        """End a cell."""
        if tag in ("td", "th", "caption") and self._text is not None:
            text = "".join(self._text)
            self.cells.append((" ".join(text.split()), self._exact))
            self._text = None
        self._code -= tag == "code"

    def handle_data(self, data: str) -> None:
        """Collect what is no code."""
        if self._text is not None and not self._code:
            self._text.append(data)


def cells_not_to_show(html: str) -> list[str]:
    """Return the cells of a page's tables with a machine's name, no value, or more digits than are known."""
    parser = Cells()
    parser.feed(FORMULA.sub("", html))
    return [
        text
        for text, exact in parser.cells
        if MACHINE_NAME.search(text) or NO_VALUE.fullmatch(text) or (not exact and digits(text) > MOST_DIGITS)
    ]


def texts_of_a_program(html: str) -> list[str]:
    """Return where a page says, outside of code and commands, what only a program would: 1e-05, lists, None."""
    said = [*OUTPUT.findall(html), NO_PROSE.sub(" ", FORMULA.sub(" ", html))]
    text = " | ".join(unescape(re.sub(r"<[^>]*>", " ", part)) for part in said)
    return [
        " ".join(text[max(0, found.start() - 40) : found.end() + 20].split())
        for found in AS_COMPUTED.finditer(text)
    ]


def digits(text: str) -> int:
    """Return the significant digits of a cell that is a number, else 0; whole numbers end where they end."""
    found = NUMBER.match(text)
    if not found:
        return 0
    number = found[0].lstrip("-−").replace(",", "")
    return len(number.replace(".", "").lstrip("0") if "." in number else number.strip("0"))
