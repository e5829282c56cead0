"""A robot file as it was read: what its keys must be, and errors that say where."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, NamedTuple

from edition1.errors import InputError, bad_input
from edition1.robot_file._toml_lines import Place, key_lines


class Key(NamedTuple):
    """What a key takes: its words in a message, a test, and its value when left out (None: it must be given)."""

    must_be: str
    fits: Callable[[Any], bool]
    default: Any = None


def word(*words: str, default: str | None = None) -> Key:
    """Describe one of some words."""
    return Key(f"one of {', '.join(map(repr, words))}", lambda x: x in words, default)


@dataclass(frozen=True)
class Document:
    """A robot file as it was read, and where everything in it stands.

    Parameters
    ----------
    name
        Name of the file, for messages.
    content
        What tomllib made of it.
    lines
        From :func:`~edition1.robot_file._toml_lines.key_lines`.
    """

    name: str
    content: Mapping[str, Any]
    lines: Mapping[Place, int]

    @classmethod
    def of(cls, name: str, text: str) -> Document:
        """Parse a text.

        Raises
        ------
        InputError
            If it is not TOML; the message of tomllib says where.
        """
        try:
            return cls(name, tomllib.loads(text), key_lines(text))
        except ValueError as error:  # also of numbers with thousands of digits
            raise bad_input("file", name, "valid TOML", error) from error
        except RecursionError as error:
            raise bad_input("file", name, "valid TOML", "arrays or tables nested too deeply") from error

    def line(self, *place: str | int) -> int:
        """Line of a key; of its table where the key has none."""
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place, 1)

    def error(self, place: Place, must_be: str, received: Any) -> InputError:
        """Error about a key: file, line, table, what it must be, what it is."""
        *table, key = place
        where = f", {_shown(tuple(table))}" if table else ""
        return bad_input(str(key), f"{self.name}, line {self.line(*place)}{where},", must_be, received)

    def tables(self, name: str) -> list[dict[str, Any]]:
        """Tables ``[[name]]``, none if there are none."""
        found = self.content.get(name, [])
        if not isinstance(found, list) or not all(isinstance(table, dict) for table in found):
            raise self.error((name,), f"tables [[{name}]]", found)
        return found

    def table(self, name: str) -> dict[str, Any]:
        """Table ``[name]``, empty if there is none."""
        found = self.content.get(name, {})
        if not isinstance(found, dict):
            raise self.error((name,), f"a table [{name}]", found)
        return found

    def checked(self, keys: Mapping[str, Key], *place: str | int) -> dict[str, Any]:
        """Values of a table, those left out at their defaults.

        Raises
        ------
        InputError
            If a key is unknown, missing, or its value does not fit.
        """
        table: Any = self.content
        for part in place:
            table = table[part] if isinstance(part, int) or part in table else {}
        for name in table:
            if name not in keys:
                raise self.error((*place, name), _known(name, keys), "a key that does not exist")
        values = {}
        for name, key in keys.items():
            if name not in table:
                if key.default is None:
                    raise self.error((*place, name), f"given: {key.must_be}", "nothing")
                values[name] = key.default
            elif not key.fits(table[name]):
                raise self.error((*place, name), key.must_be, repr(table[name]))
            else:
                values[name] = table[name]
        return values

    def checked_kind(
        self, kinds: Mapping[str, Mapping[str, Key]], others: Mapping[str, Key], *place: str | int
    ) -> dict[str, Any]:
        """Values of a table whose ``kind`` says which keys it has beside others."""
        name, number = place
        table, kind = self.tables(str(name))[int(number)], word(*kinds)
        if not kind.fits(table.get("kind")):
            received = repr(table["kind"]) if "kind" in table else "nothing"
            raise self.error((*place, "kind"), kind.must_be, received)
        return self.checked({"kind": kind, **others, **kinds[table["kind"]]}, *place)


def _known(name: str, keys: Mapping[str, Key]) -> str:
    """Say which key was probably meant: one of the same name in another unit, or of a similar name."""
    stem = name.rsplit("_", 1)[0]
    same = [key for key in keys if key.rsplit("_", 1)[0] == stem]
    near = same or get_close_matches(name, keys, n=1, cutoff=0.6)
    return near[0] if near else f"one of {', '.join(keys)}"


def _shown(table: Place) -> str:
    return f"[[{table[0]}]] {int(table[1]) + 1}" if len(table) == 2 else f"[{table[0]}]"
