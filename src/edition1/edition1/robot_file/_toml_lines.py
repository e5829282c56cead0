"""Where in a TOML file a key stands: the parser of the standard library does not say."""

from __future__ import annotations

import re

_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]#]+?)\s*\]")
_KEY = re.compile(r"""\s*(?:([A-Za-z0-9_-]+)|"([^"]*)"|'([^']*)')\s*(?=[=.])""")

Place = tuple[str | int, ...]
"""``(key,)``, ``(table, key)`` or ``(table, number, key)``, and the same without the key for a header."""


def key_lines(text: str) -> dict[Place, int]:
    r"""Line, from 1, of every key and table header of a valid TOML file.

    Tables of an array (``[[name]]``) are numbered from 0. Of a key with dots only the first part is kept, and keys
    inside inline tables have none: ask for the line of what they stand in.

    Examples
    --------
    >>> key_lines('a = 1  # one\n[[part]]\nsize_mm = [\n  1, 2\n]\n[[part]]\nsize_mm = 3')
    {('a',): 1, ('part', 0): 2, ('part', 0, 'size_mm'): 3, ('part', 1): 6, ('part', 1, 'size_mm'): 7}
    """
    lines: dict[Place, int] = {}
    counts: dict[str, int] = {}
    table: Place = ()
    depth, quote = 0, ""
    for number, line in enumerate(text.split("\n"), start=1):
        rest = line
        if not depth and not quote:
            if header := _HEADER.match(line):
                name = header[2].strip("\"'")
                table = (name,)
                if header[1] == "[[":
                    table = (name, counts.get(name, 0))
                    counts[name] = table[1] + 1
                lines.setdefault(table, number)
                continue
            if not (key := _KEY.match(line)):
                continue
            name = next(part for part in key.groups() if part is not None)
            lines.setdefault((*table, name), number)
            rest = line[key.end() :]
        depth, quote = _still_open(rest, depth, quote)
    return lines


def _still_open(text: str, depth: int, quote: str) -> tuple[int, str]:
    """Brackets and the multi-line string that are open after a line, given those open before it."""
    k = 0
    while k < len(text):
        if quote:
            if text.startswith(quote, k):
                k, quote = k + len(quote), ""
            else:
                k += 2 if text[k] == "\\" and quote[0] == '"' else 1
            continue
        letter = text[k]
        if letter == "#":
            break
        if letter in "\"'":
            quote = letter * 3 if text.startswith(letter * 3, k) else letter
            k += len(quote)
            continue
        depth += (letter in "[{") - (letter in "]}")
        k += 1
    return depth, quote if len(quote) == 3 else ""
