"""Options of the command line that take a name and a value, and may be repeated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cyclopts import Parameter, Token


def pairs(names: str | list[str], metavar: str) -> Parameter:
    """Return the option: its values are passed on as typed, for they may start with a hyphen or look like JSON.

    Parameters
    ----------
    names
        Of the option, such as ``["-p", "--parameter"]``.
    metavar
        The pair as help shows it.
    """
    return Parameter(
        name=names,
        metavar=metavar,
        allow_leading_hyphen=True,
        negative="",
        json_list=False,
        json_dict=False,
        converter=_as_typed,
    )


def _as_typed(_: Any, tokens: Sequence[Token]) -> list[tuple[str, str]]:
    """Return names and values: cyclopts itself would take a value that starts with { for a whole pair in JSON."""
    words = [token.value for token in tokens]
    return list(zip(words[::2], words[1::2], strict=True))
