"""Allowed values at the end of a parameter's comment."""

import pytest

from repro.errors import InputError
from repro_companion.book.parameters import Parameter, convert

CASES = [
    ("int", "segments of the robot, 1 to 6", ["1", "6"], ["-4", "0", "7"]),
    ("float", "noise, at least 0 [mT]", ["0", "1e-3", "inf"], ["-1e-9", "nan"]),
    ("float", "how long it takes, at most 10 [s]", ["10", "-1"], ["10.5"]),
    ("str", "ring, one of: released, published", ["published"], ["other", ""]),
    ("list", "failed sensors, 1 to 12", ["[]", "[1, 12]"], ["[0]", "[1, 13]", "[a]", "[true]"]),
    ("list", "models, one of: fast network, multipole", ["[fast network]"], ["[fast]", "[[multipole]]"]),
    ("float", "compared for at least 10 for an estimate [s]", ["-1"], []),
]


@pytest.mark.parametrize(("kind", "meaning", "allowed", "refused"), CASES)
def test_values_keep_to_the_rule_in_the_comment(kind, meaning, allowed, refused):
    parameter = Parameter("x", kind, "", meaning)
    for text in allowed:
        convert(parameter, text, "page.ipynb")
    for text in refused:
        with pytest.raises(InputError, match="parameter x") as error:
            convert(parameter, text, "page.ipynb")
        assert meaning in str(error.value)
