"""Parameters: what is declared, and texts converted to the declared type."""

from __future__ import annotations

import math

import nbformat
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edition1.errors import InputError
from edition1_companion.book.parameters import Parameter, convert, convert_all, declared_parameters

DECLARED = """\
n_segments: int = 3  # segments in series
step_mT: float = 1e-3  # step [mT]
name: str = "a"
fast: bool = False  # a short run
gains: list = [1, 2]  # gains
sizes: dict = {"a": 1}"""


def notebook(source: str):
    cell = nbformat.v4.new_code_cell(source, metadata={"tags": ["parameters"]})
    return nbformat.v4.new_notebook(cells=[cell])


def to(kind: str, text: str):
    return convert(Parameter("x", kind, "", ""), text, "a.ipynb")


@given(st.integers())
def test_int_round_trip(value):
    assert to("int", str(value)) == value


@given(st.floats(allow_nan=False))
def test_float_round_trip(value):
    assert to("float", repr(value)) == value


@given(st.text())
def test_str_is_taken_as_typed(value):
    assert to("str", value) == value


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=8,
)


@given(st.lists(PLAIN, max_size=4))
def test_list_round_trip(value):
    text = repr(value).replace("None", "null")
    assert to("list", text) == value


@given(st.text())
def test_any_text_is_converted_or_refused(text):
    for kind, types in {"int": int, "float": float, "bool": bool, "list": list, "dict": dict}.items():
        try:
            value = to(kind, text)
        except InputError:
            continue
        assert type(value) is types


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        ("float", "1e-3", 1e-3),
        ("float", "-5", -5.0),
        ("float", ".5", 0.5),
        ("float", "-inf", -math.inf),
        ("int", "-5", -5),
        ("bool", "true", True),
        ("bool", "False", False),
        ("list", "[1e-3, -2, on, 'a', 2020-01-01]", [1e-3, -2, "on", "a", "2020-01-01"]),
        ("list", "[012, .inf]", [12, math.inf]),
        ("dict", "{a: 1e3, b: [x]}", {"a": 1000.0, "b": ["x"]}),
        ("dict", "a: 1", {"a": 1}),
    ],
)
def test_values(kind, text, value):
    converted = to(kind, text)
    assert converted == value
    assert type(converted) is type(value)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("int", "1.5"),
        ("int", "1e3"),
        ("int", "1_000"),
        ("int", "true"),
        ("int", ""),
        ("float", "1,5"),
        ("float", "."),
        ("float", "[1]"),
        ("bool", "1"),
        ("bool", "yes"),
        ("list", "1"),
        ("list", "{a: 1}"),
        ("list", "[1"),
        ("list", "!!python/name:os.system"),
        ("list", "&a [*a]"),
        ("dict", "{1: 2}"),
        ("dict", "[1]"),
    ],
)
def test_values_that_are_refused(kind, text):
    with pytest.raises(InputError, match=r"^Input parameter x of a.ipynb must be "):
        to(kind, text)


def test_declared_parameters():
    declared = declared_parameters(notebook(DECLARED), "a.ipynb")
    assert {name: parameter.type for name, parameter in declared.items()} == {
        "n_segments": "int",
        "step_mT": "float",
        "name": "str",
        "fast": "bool",
        "gains": "list",
        "sizes": "dict",
    }
    assert declared["step_mT"] == Parameter("step_mT", "float", "1e-3", "step [mT]")


def test_generic_types_count_as_their_container():
    assert declared_parameters(notebook("x: list[float] = [1.0]"), "a.ipynb")["x"].type == "list"


@pytest.mark.parametrize(
    ("source", "received"),
    [
        ("x = 3", "None = 3"),
        ("x: complex = 3", "complex = 3"),
        ("x: int = 3  # n = 3", "a line that papermill does not read"),
    ],
)
def test_declarations_that_are_refused(source, received):
    with pytest.raises(InputError) as refused:
        declared_parameters(notebook(source), "a.ipynb")
    assert str(refused.value) == (
        "Input parameter x of a.ipynb must be written as name: type = value  # meaning, with one of the types "
        f"int, float, str, bool, list, dict; instead received {received}."
    )


def test_broken_parameters_cell():
    with pytest.raises(InputError, match="parameters cell of a.ipynb must be valid Python"):
        declared_parameters(notebook("x: int ="), "a.ipynb")


LISTING = """
Parameters of a.ipynb:
  n_segments: int = 3     segments in series
  step_mT: float = 1e-3   step [mT]
  name: str = "a"
  fast: bool = False      a short run
  gains: list = [1, 2]    gains
  sizes: dict = {"a": 1}"""


@pytest.mark.parametrize(
    ("given_values", "message"),
    [
        (
            [("nonsense", "1")],
            "Input parameter nonsense of a.ipynb must be one of the parameters listed below; "
            "instead received nonsense = 1.",
        ),
        (
            [("n_segments", "1.5")],
            "Input parameter n_segments of a.ipynb must be int: a whole number, such as 3; "
            "instead received 1.5.",
        ),
        (
            [("n_segments", "1"), ("n_segments", "2")],
            "Input parameter n_segments of a.ipynb must be given once; instead received n_segments = 2 as well.",
        ),
    ],
)
def test_refusals_list_what_may_be_given(given_values, message):
    declared = declared_parameters(notebook(DECLARED), "a.ipynb")
    with pytest.raises(InputError) as refused:
        convert_all(given_values, declared, "a.ipynb")
    assert str(refused.value) == message + LISTING
