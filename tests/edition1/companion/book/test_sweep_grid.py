"""The grid of a sweep: what is typed and what a file holds become values of the declared types, or are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from edition1.errors import InputError
from edition1_companion.book.parameters import Parameter, convert
from edition1_companion.book.sweep_grid import grid_points, read_grid, read_part, value_text

DECLARED = {
    name: Parameter(name, kind, "0", "")
    for name, kind in {
        "n": "int",
        "noise_mt": "float",
        "ring": "str",
        "fast": "bool",
        "gains": "list",
        "options": "dict",
    }.items()
}


def grid(*given: tuple[str, str], file: Path | None = None):
    return read_grid(given, file, DECLARED, "a.ipynb")


@pytest.mark.parametrize(
    ("name", "text", "values"),
    [
        ("n", "2,3,4,6", [2, 3, 4, 6]),
        ("n", "0:3", [0, 1, 2]),
        ("n", "-2:1, 7", [-2, -1, 0, 7]),
        ("noise_mt", "1e-3, -2,inf", [1e-3, -2.0, float("inf")]),
        ("ring", "released,published b", ["released", "published b"]),
        ("ring", "0:3", ["0:3"]),
        ("fast", "true,False", [True, False]),
    ],
)
def test_values_as_typed(name, text, values):
    found = grid((name, text))[name]
    assert found == values
    assert {type(x) for x in found} == {type(x) for x in values}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("n", "2,x", "parameter n of repro sweep must be int: a whole number, such as 3; instead received x."),
        ("n", "2,,3", "parameter n of repro sweep must be int: a whole number, such as 3; instead received ."),
        ("n", "1.5", "parameter n of repro sweep must be int: a whole number, such as 3; instead received 1.5."),
        (
            "n",
            "3:3",
            "parameter n of repro sweep must be a range first:end with first below end; instead received 3:3.",
        ),
        ("n", "0:2,1", "parameter n of repro sweep must be values that differ; instead received 1 twice."),
        (
            "n",
            "0:999999999999",
            "parameter n of repro sweep must be at most 100000 points; instead received 999999999999.",
        ),
        (
            "noise_mt",
            "0:3",
            "parameter noise_mt of repro sweep must be float: a number, such as 1e-3; instead received 0:3.",
        ),
        ("noise_mt", "1,1.0", "parameter noise_mt of repro sweep must be values that differ; "
         "instead received 1.0 twice."),
        (
            "gains",
            "[1,2]",
            "parameter gains of repro sweep must be given by a grid file, because it is a list; "
            "instead received [1,2].",
        ),
        (
            "options",
            "{a: 1}",
            "parameter options of repro sweep must be given by a grid file, because it is a dict; "
            "instead received {a: 1}.",
        ),
    ],
)  # fmt: skip
def test_values_that_are_refused(name, text, message):
    with pytest.raises(InputError) as refused:
        grid((name, text))
    assert str(refused.value) == f"Input {message}"


def test_parameters_that_are_refused(tmp_path):
    with pytest.raises(InputError) as refused:
        grid(("m", "1"))
    first, *rest = str(refused.value).splitlines()
    assert first == (
        "Input parameter m of repro sweep must be one of the parameters listed below; instead received 1."
    )
    assert rest[:2] == ["Parameters of a.ipynb:", "  n: int = 0"]
    with pytest.raises(
        InputError, match=r"^Input parameter n of repro sweep must be given once; instead rec.* 2 as"
    ):
        grid(("n", "1"), ("n", "2"))
    file = tmp_path / "grid.yaml"
    file.write_text("n: [1]")
    with pytest.raises(InputError, match=r"^Input parameter n of grid.yaml must be given once"):
        grid(("n", "1"), file=file)
    with pytest.raises(InputError) as refused:
        grid()
    assert str(refused.value) == (
        "Input grid of repro sweep must be at least one parameter, by -p NAME VALUES or --grid; "
        "instead received none."
    )
    with pytest.raises(InputError) as refused:
        grid(("n", "0:1000"), ("noise_mt", ",".join(map(str, range(101)))))
    assert str(refused.value) == (
        "Input grid of repro sweep must be at most 100000 points; instead received 101000."
    )


TEXT = {
    ".yaml": "gains: [[1e-3, on], []]\nnoise_mt: [1, 2e-4]\noptions: [{a: {b: 1}}]\nring: ['1', \"a,b\"]\n",
    ".json": '{"gains": [[1e-3, "on"], []], "noise_mt": [1, 2e-4], "options": [{"a": {"b": 1}}],'
    ' "ring": ["1", "a,b"]}',
}


@pytest.mark.parametrize("ending", TEXT)
def test_a_grid_file(tmp_path, ending):
    file = tmp_path / f"grid{ending}"
    file.write_text(TEXT[ending])
    found = grid(("n", "0:2"), file=file)
    assert list(found) == ["n", "gains", "noise_mt", "options", "ring"]
    assert found["gains"] == [[0.001, "on"], []]
    assert found["options"] == [{"a": {"b": 1}}]
    assert found["ring"] == ["1", "a,b"]
    assert found["noise_mt"] == [1.0, 2e-4]
    assert type(found["noise_mt"][0]) is float
    # every value reaches the notebook as it is, through the text that repro run is given
    for name, values in found.items():
        assert [convert(DECLARED[name], value_text(value), "a.ipynb") for value in values] == values


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("n: 3", "parameter n of g.yaml must be a list of values; instead received 3."),
        ("n: []", "parameter n of g.yaml must be a list of values; instead received []."),
        (
            "n: [1, true]",
            "parameter n of g.yaml must be values of the type int: a whole number, such as 3; "
            "instead received True.",
        ),
        (
            "ring: [a, 1]",
            "parameter ring of g.yaml must be values of the type str: a text; instead received 1.",
        ),
        (
            "gains: [[.nan]]",
            "parameter gains of g.yaml must be values of the type list: a list in YAML, such as [1, 2]; "
            "instead received [nan].",
        ),
        (
            "gains: [[1], [1]]",
            "parameter gains of g.yaml must be values that differ; instead received [1] twice.",
        ),
    ],
)
def test_values_of_a_file_that_are_refused(tmp_path, text, message):
    file = tmp_path / "g.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as refused:
        grid(file=file)
    assert str(refused.value) == f"Input {message}"


LAUGHS = "[*a{0}, *a{0}, *a{0}, *a{0}, *a{0}, *a{0}, *a{0}, *a{0}, *a{0}, *a{0}]"
NESTED = "- &a0 [1]\n" + "".join(f"- &a{k + 1} {LAUGHS.format(k)}\n" for k in range(15))


def test_aliases_of_aliases_are_refused_before_they_are_written_out(tmp_path):
    (file := tmp_path / "g.yaml").write_text("gains:\n" + NESTED)
    for refusal, arguments in (
        (f"Input grid {file} of repro sweep", {"file": file}),
        ("Input parameter gains of a.ipynb", None),
    ):
        with pytest.raises(InputError) as refused:
            grid(**arguments) if arguments else convert(DECLARED["gains"], NESTED, "a.ipynb")
        expected = "must be at most 1000000 values, aliases counted as often as used; instead received more."
        assert str(refused.value) == f"{refusal} {expected}"
    file.write_text("gains: [&a [1, 2], [*a, *a]]")
    assert grid(file=file)["gains"] == [[1, 2], [[1, 2], [1, 2]]]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("g.yaml", "gains: " + "[" * 5000),
        ("g.json", '{"gains": ' + "[" * 200_000),
        ("g.yaml", "[1, 2]"),
        ("g.yaml", "n: [1]\nn: [2]"),
        ("g.yaml", "n: ["),
        ("g.yaml", ""),
        ("g.yaml", "3: [1]\n? [a]\n: [1]"),
        ("g.json", '{"n": [1], "n": [2]}'),
        ("g.json", "n: [1]"),
        ("missing.yaml", None),
    ],
)
def test_files_that_are_refused(tmp_path, name, text):
    file = tmp_path / name
    if text is not None:
        file.write_text(text)
    with pytest.raises(InputError) as refused:
        grid(file=file)
    assert str(refused.value) == (
        "Input grid of repro sweep must be a file with a dictionary from parameters to lists of values, "
        f"each parameter once; instead received {file}."
    )


def test_points_and_parts():
    points = grid_points({"a": [1, 2, 3], "b": [True, False], "c": ["x", "y"]})
    assert len(points) == 12
    assert points[:3] == [
        {"a": 1, "b": True, "c": "x"},
        {"a": 1, "b": True, "c": "y"},
        {"a": 1, "b": False, "c": "x"},
    ]
    # parts are disjoint and together the whole, also where they are not of one size or more than the points
    for parts in (1, 5, 20):
        taken = [points[i - 1 :: n] for i, n in (read_part(f"{i}/{parts}") for i in range(1, parts + 1))]
        assert sorted((point for one in taken for point in one), key=points.index) == points
    assert read_part("") == (1, 1)


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/b", "1/0", "-1/2", "1/2/3"])
def test_parts_that_are_refused(text):
    with pytest.raises(InputError) as refused:
        read_part(text)
    assert str(refused.value) == (
        f"Input part of repro sweep must be i/n, a number from 1 to n and n, such as 2/8; instead received {text}."
    )
