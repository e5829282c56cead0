"""The one form in which bad input is refused: what was wrong, what was expected, what came instead."""

from __future__ import annotations

from typing import Any


class InputError(ValueError):
    """Input that cannot be used. The message names the input, its owner, what it must be and what it was.

    Examples
    --------
    >>> import repro
    >>> try:
    ...     repro.ConstantCurvature(length=-0.1, radius=0.02)
    ... except repro.InputError as error:
    ...     print(error)
    Input length of ConstantCurvature must be positive [m]; instead received -0.1.
    """


def bad_input(name: str, owner: str, must_be: str, received: Any) -> InputError:
    """Return the error to raise for input ``name`` of ``owner``.

    Parameters
    ----------
    name, owner
        The input and the function, class or file that it belongs to.
    must_be
        What would be accepted, as it reads after "must be".
    received
        What came instead; shown as text, cut at 200 characters.

    Examples
    --------
    >>> raise bad_input("length", "ConstantCurvature", "a positive length [m]", -0.1)
    Traceback (most recent call last):
    ...
    repro.errors.InputError: Input length of ConstantCurvature must be a positive length [m]; instead received -0.1.
    """
    text = str(received)
    text = text if len(text) <= 200 else text[:197] + "..."
    return InputError(f"Input {name} of {owner} must be {must_be}; instead received {text}.")
