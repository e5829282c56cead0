"""The one form in which bad input is refused: what was wrong, what was expected, what came instead."""

from __future__ import annotations

from typing import Any


class InputError(ValueError):
    """Input that cannot be used. The message names the input, its owner, what it must be and what it was.

    Examples
    --------
    >>> import edition1 as repro
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
    edition1.errors.InputError: Input length of ConstantCurvature must be a positive length [m]; instead received -0.1.
    """
    text = str(received)
    text = text if len(text) <= 200 else text[:197] + "..."
    return InputError(f"Input {name} of {owner} must be {must_be}; instead received {text}.")


def require(holds: object, name: str, owner: str, must_be: str, received: Any) -> None:
    """Refuse input ``name`` of ``owner`` unless it is as it must be: a check in one line.

    Parameters
    ----------
    holds
        Whether it is: true, or something that counts as true.
    name, owner, must_be, received
        As for :func:`bad_input`; they are made in any case, so they must be cheap, and right where the check holds.

    Raises
    ------
    InputError
        If it is not.

    Examples
    --------
    >>> require(0 < 0.4 < 1, "share", "fit", "between 0 and 1", 0.4)
    """
    if not holds:
        raise bad_input(name, owner, must_be, received)
