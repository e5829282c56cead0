"""Values that a parameter may have, as the end of its comment says; checked by ``repro run``.

``, 1 to 6``, ``, at least 0``, ``, above 0``, ``, at most 10``, ``, below 10``, ``, above 0 and at most 10`` or
``, one of: released, published``, with the unit behind it. Commas between choices have a space behind them, and a
choice with such a comma stands in double quotes.

In a list the rule holds for each value, and before it may stand how many there are, one that must be there, and that
there is none twice: ``, 8 values, above 0``, ``, 13.0 among them, each once, above 0``; a choice takes none twice. A
list may be empty where its comment has the words ``when empty``; its values are whole numbers where those of its
default are.
"""

from __future__ import annotations

import ast
import math
import re
from dataclasses import dataclass
from typing import Any

_NUMBER = r"[-+]?[0-9]+(?:\.[0-9]+)?(?:e[-+]?[0-9]+)?"
_BETWEEN = re.compile(r',\s+(?=(?:[^"]*"[^"]*")*[^"]*$)')
"""What divides choices: not within quotes."""
_END = rf"(at least|above|at most|below) ({_NUMBER})"
_RULE = re.compile(
    rf",\s*(?:(?P<count>[0-9]+) values, )?(?:(?P<among>{_NUMBER}) among them, )?(?P<once>each once, )?"
    rf"(?P<said>(?P<low>{_NUMBER}) to (?P<high>{_NUMBER})"
    rf"|(?P<ends>{_END}(?: and {_END})?)|one of: (?P<choices>[^\[\]]+?))\s*(?:\[[^\]]*\])?$"
)


@dataclass(frozen=True)
class Rule:
    """What the values of a parameter must keep to."""

    said: str
    """As the comment has it: ``1 to 6``."""
    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    """Whether the lower end is not allowed itself."""
    below: bool = False
    """Whether the upper end is not."""
    choices: tuple[Any, ...] = ()
    """All values that there are; empty where a range says it."""
    is_list: bool = False
    whole: bool = False
    """Whether numbers must be whole."""
    once: bool = False
    """Whether a list may not have a value twice."""
    filled: bool = False
    """Whether a list may not be empty."""
    among: float | None = None
    """A value that a list must have."""
    count: int = 0
    """How many values a list has that is not empty; 0 where any number will do."""

    def allows(self, value: Any) -> bool:
        """Return whether a value of the parameter's type keeps to the rule."""
        if not self.is_list:
            return self._allows_one(value)
        if (self.filled and not value) or not all(map(self._allows_one, value)):
            return False
        if self.count and value and len(value) != self.count:
            return False
        if self.among is not None and self.among not in value:
            return False
        return not self.once or len(set(value)) == len(value)

    def _allows_one(self, value: Any) -> bool:
        if self.choices:
            return any(type(value) is type(choice) and value == choice for choice in self.choices)
        if type(value) is not int and (type(value) is not float or self.whole or not math.isfinite(value)):
            return False
        return (value > self.low if self.above else value >= self.low) and (
            value < self.high if self.below else value <= self.high
        )

    @property
    def must_be(self) -> str:
        """The rule as messages name it: *must be 1 to 6*."""
        if not self.is_list:
            return self.said
        number = f"{self.count} " if self.count else "one or more " if self.filled else ""
        among = "" if self.among is None else f", {self.among:g} among them"
        if self.choices:
            kind = "one or more" if self.filled else "any"
            return f"a list of {kind} of: {self.said.removeprefix('one of: ')}{among}, none of them twice"
        values = "whole numbers" if self.whole else "values"
        return f"a list of {number}{values}{among}, each {self.said}{', none of them twice' if self.once else ''}"


def rule_of(kind: str, default: str, meaning: str) -> Rule | None:
    """Return the rule in a parameter's comment, None where it has none.

    Parameters
    ----------
    kind, default, meaning
        Type, default as it is written, and comment of the parameter.

    Examples
    --------
    >>> rule = rule_of("int", "3", "segments of the robot, 1 to 6")
    >>> rule.must_be, rule.allows(6), rule.allows(-4)
    ('1 to 6', True, False)
    """
    found = _RULE.search(meaning)
    if found is None:
        return None
    is_list, words = kind == "list", found.groupdict()
    of_list = {
        "is_list": is_list,
        "once": is_list and bool(words["once"] or words["choices"]),
        "filled": is_list and "when empty" not in meaning,
        "count": int(words["count"] or 0),
        "among": float(words["among"]) if words["among"] else None,
        "whole": kind == "int" or (is_list and _all_whole(default)),
    }
    if words["choices"]:
        texts = [text.strip('"') for text in _BETWEEN.split(words["choices"])]
        choices = texts if kind == "str" else map(_value, texts)
        return Rule(words["said"], choices=tuple(choices), **of_list)
    ends = {"at least": words["low"], "at most": words["high"]}
    ends |= dict(re.findall(_END, words["ends"] or ""))
    low = float(ends.get("above") or ends["at least"] or "-inf")
    high = float(ends.get("below") or ends["at most"] or "inf")
    return Rule(words["said"], low, high, "above" in ends, "below" in ends, **of_list)


def _all_whole(default: str) -> bool:
    try:
        values = ast.literal_eval(default)
    except (ValueError, SyntaxError):
        return False
    return isinstance(values, list) and bool(values) and all(type(value) is int for value in values)


def _value(text: str) -> Any:
    """A choice among numbers is a number."""
    if re.fullmatch(_NUMBER, text):
        return int(text) if re.fullmatch(r"[-+]?[0-9]+", text) else float(text)
    return text
