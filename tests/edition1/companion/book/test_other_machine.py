"""Tables of two machines: what moves within its tolerance is the same, and everything else is found."""

import math

import pytest
from edition1.errors import InputError
from edition1_companion.book.after.diff_tables import Tolerance, beyond, read_tolerances
from edition1_companion.book.after.rebuild import OTHER_MACHINE, differences, main
from edition1_companion.book.project import find_project

LAST_DIGITS = Tolerance("*", "*", 1e-9, "sums")


@pytest.fixture
def two(tmp_path):
    """Write a table on two machines; their paths."""

    def write(first, second, name="errors.csv"):
        paths = [tmp_path / folder / name for folder in ("here", "there")]
        for path, text in zip(paths, (first, second), strict=True):
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
        return paths

    return write


def test_a_column_may_move_by_parts_of_its_largest_value(two):
    first, second = two("n,mm\n1,10\n2,0.001\n", "n,mm\n1,10\n2,0.0011\n")
    assert beyond(first, second, [Tolerance("errors", "mm", 1.001e-5, "sums")]) == []
    assert beyond(first, second, [Tolerance("errors", "mm", 0.999e-5, "sums")]) == [
        "errors.csv: mm moved by 1.0e-05 of its largest value; 1e-05 is allowed"
    ]


def test_infinities_of_one_sign_are_the_same_and_of_two_are_not(two):
    allowed = [Tolerance("*", "*", 0.2, "sums")]
    assert beyond(*two("n,mm\n1,inf\n2,10\n", "n,mm\n1,inf\n2,11\n"), allowed) == []
    assert beyond(*two("n,mm\n1,inf\n2,10\n", "n,mm\n1,-inf\n2,10\n"), allowed) != []


def test_without_a_tolerance_nothing_may_move_and_the_last_line_that_fits_counts(two):
    first, second = two("n,mm\n1,1\n", "n,mm\n1,2\n")
    assert beyond(first, second, []) == [
        "errors.csv: mm moved by 5.0e-01 of its largest value; none is allowed"
    ]
    chaotic = Tolerance("err*", "m*", 0.6, "chaotic")
    assert beyond(first, second, [LAST_DIGITS, chaotic]) == []
    assert beyond(first, second, [chaotic, LAST_DIGITS]) != []


@pytest.mark.parametrize(
    ("second", "found"),
    [
        ("n,way,mm\n2,a,1\n", "errors.csv has 2 rows that only one of the two has"),
        ("n,way,mm\n1,b,1\n", "errors.csv: way says something else"),
        ("n,way\n1,a\n", "errors.csv: only one of the two has mm"),
        ("n,way,mm\n1,a,\n", "errors.csv: mm moved by inf of its largest value; 9e-01 is allowed"),
        ("n,way,mm\n1,a,inf\n", "errors.csv: mm moved by inf of its largest value; 9e-01 is allowed"),
        ("n,way,mm\n1,a,much\n", "errors.csv: mm says something else"),
    ],
)
def test_labels_rows_columns_and_missing_cells_never_move(two, second, found):
    here, there = two("n,way,mm\n1,a,1\n", second)
    assert found in beyond(here, there, [Tolerance("*", "*", 0.9, "nearly anything goes")])


def test_words_may_differ_where_their_tolerance_says_so(two):
    first, second = two("n,note\n1,of the seeds 1 and 2\n", "n,note\n1,of the seeds 1 and 3\n")
    assert beyond(first, second, [Tolerance("errors", "note", 1.0, "digits in words")]) == []


def test_folders_are_compared_by_bytes_or_within_tolerances(two):
    first, second = two("n,mm\n1,1\n", "n,mm\n1,1.0000000001\n")
    folders = first.parent, second.parent
    assert len(differences(*folders)) == 1
    assert differences(*folders, [LAST_DIGITS]) == []
    assert len(differences(*folders, [])) == 1


def test_the_tolerances_of_the_book_are_read_and_the_command_uses_them(two, capsys):
    tolerances = read_tolerances(find_project().root / "data/tolerances.csv")
    assert all(0 < t.tolerance < math.inf for t in tolerances)
    first, second = two("n,mm\n1,1\n", "n,mm\n1,1.0000000000001\n")
    folders = str(first.parent), str(second.parent)
    assert main(*folders) == 1
    assert main(*folders, OTHER_MACHINE) == 0
    assert (
        "All 1 tables are the same, within the tolerances of data/tolerances.csv." in capsys.readouterr().out
    )
    assert main(OTHER_MACHINE) == 2
    assert "must be given with AGAINST or STUDIES; instead received alone" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("table,column\n*,*\n", "header of .* must be table,column,tolerance,reason"),
        ("table,column,tolerance,reason\n*,*,0,sums\n", "tolerance of line 2 of .* positive number"),
        ("table,column,tolerance,reason\n*,*,few,sums\n", "tolerance of line 2 of .* received few"),
        ("table,column,tolerance,reason\n*,*,1e-9,\n", "reason of line 2 of .* why the column moves"),
    ],
)
def test_tolerances_without_a_number_or_a_reason_are_refused(tmp_path, text, message):
    (tmp_path / "tolerances.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_tolerances(tmp_path / "tolerances.csv")
