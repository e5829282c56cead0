"""Digits in prose that nothing vouches for: neither of a paper, nor a setting, nor put there by the build.

``python tests/loose_digits.py FILE …`` prints them for notebooks and pages. A number of a paper stands in
``{paper}`0.81` ``, a setting or a size of the robot in ``{setting}`25 lines` ``; a result is a value that the build
fills in, ``{{name}}``. Places in papers (section 3.3, eq. (15), Fig. 9, Table 1), code, formulas, links and names
such as T2 or SO(3) need nothing. A page without results of its own says in its front matter what its digits are:
``digits: settings`` or ``digits: of the sources it names``.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

_FENCE = re.compile(r"\s*(`{3,}|:{3,})(?:\{([\w:-]+)\})?(.*)")
_NO_PROSE = {
    "include",
    "literalinclude",
    "code-block",
    "code",
    "math",
    "raw",
    "bibliography",
    "tableofcontents",
}
"""Directives that hold no prose; code without a directive is none either."""
_VOUCHED = (
    r"\A---\n.*?\n---\n",  # front matter
    r"<!--.*?-->",
    r"\$\$.*?\$\$",
    r"\$[^$]*\$",
    r"\{\{[^}]*\}\}",
    r"\{(?:paper|setting|math|eq|ref|numref|doc|term|cite:?\w*|py:\w+|download)\}`[^`]*`",
    r"`+[^`]*`+",
    r"<https?://[^>]*>",
    r"^(?:\([\w-]+\)=|:[\w-]+: .*)$",  # labels, options of a directive
)
_AS_COMPUTED = re.compile(r"\{(?:paper|setting)\}`(?:-\d|[^`]*\de[-+]?\d)[^`]*`")
"""A number of a paper or a setting as a program writes it: with a hyphen for its minus, or with e."""
_PLACES = (
    r"\bappendix [A-Z](?:\.\d+)?\b|"
    r"\b(?:[Ee]qs?\.?|[Ee]quations?|[Ss]ections?|sec\.|Figs?\.?|figures?|Tables?|steps?|parts?|chapters?|items?|pages?|appendix|seeds?)"
    r"\s+\(?(?:[IVX]+(?:-[A-Z])?|\d)[\w.()]*"
    r"(?:(?:,\s*|\s+and\s+|\s+to\s+|\s*[-–]\s*)\(?(?:[IVX]+(?:-[A-Z])?|\d)[\w.()]*)*"
)
_NUMBER_WORDS = (
    "two|three|four|five|six|seven|eight|nine|ten|eleven|twelve|twenty|thirty|forty|fifty|sixty"
    "|hundred|thousand|half"
)
_COUNTED = r"times|degrees?|deg|mm|cm|metres?|per cent|percent|seconds?|minutes|milliseconds?|mT|Hz|%"
_WORDS = re.compile(rf"\b(?:twice|(?:{_NUMBER_WORDS})\s+(?:{_COUNTED}))\b", re.IGNORECASE)
_DIGITS = re.compile(r"(?<![A-Za-z\d(])\(?\d[\d.,]*")


def prose_lines(text: str) -> Iterator[str]:
    """Yield the lines of a Markdown text that are prose: not code, and not what a directive includes."""
    open_fences: list[tuple[str, bool]] = []
    for line in text.splitlines():
        fence = _FENCE.fullmatch(line)
        if (
            fence
            and open_fences
            and fence[1].startswith(open_fences[-1][0])
            and not (fence[2] or fence[3].strip())
        ):
            open_fences.pop()
        elif fence and not any(hidden for _, hidden in open_fences):
            open_fences.append((fence[1], fence[2] is None or fence[2] in _NO_PROSE))
        elif not any(hidden for _, hidden in open_fences):
            yield line


def loose_digits(text: str) -> list[str]:
    """Return the numbers of a Markdown text that nothing vouches for, each with what stands around it."""
    if re.match(r"---\n(?:.*\n)*?digits: (?:settings|of the sources it names)\n", text):
        return []
    text = "\n".join(prose_lines(text))
    typed = _AS_COMPUTED.findall(text)
    for pattern in _VOUCHED:
        text = re.sub(pattern, " ", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    text = re.sub(_PLACES, " ", text)
    text = re.sub(r"(?m)^\s*\d+\.\s", " ", text)  # numbered lists and headings
    text = re.sub(r"(?m)^(#+) \d+\. ", r"\1 ", text)
    text = re.sub(r"\b[1-9]-D\b", " ", text)
    found = [*_DIGITS.finditer(text), *_WORDS.finditer(text)]
    return typed + [
        " ".join(text[max(0, m.start() - 30) : m.end() + 20].split())
        for m in sorted(found, key=lambda m: m.start())
    ]


def texts(path: Path) -> dict[str, str]:
    """Return the texts of a page by where they stand: Markdown, and for a notebook captions and alternative texts."""
    if path.suffix != ".ipynb":
        return {"text": path.read_text(encoding="utf-8")}
    found = {}
    for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
        if cell["cell_type"] == "markdown":
            found[f"cell {number}"] = "".join(cell["source"])
        about = cell["metadata"].get("mystnb", {})
        found[f"caption in cell {number}"] = about.get("figure", {}).get("caption", "")
        found[f"alt in cell {number}"] = about.get("image", {}).get("alt", "")
    return found


def main(paths: list[str]) -> int:
    """Print the loose digits of files; return how many there are, at most 99."""
    count = 0
    for path in map(Path, paths):
        for place, text in texts(path).items():
            for loose in loose_digits(text):
                count += 1
                print(f"{path.name}, {place}: … {loose} …")
    print(count, file=sys.stderr)
    return min(count, 99)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
