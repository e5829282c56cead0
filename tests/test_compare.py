"""What `repro compare` lets pass and what it names."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from llvmlite.binding import get_host_cpu_name

from repro import InputError
from repro_companion.compare import REFERENCE, compare_folders, compare_tables, on_reference_processor

TOLERANCES = """table,row,column,tolerance,reason
*,*,*,1e-6,last digits
table_2,*chaotic*,error_*,2,a chaotic step
table_2,*chaotic*,note,1,words with digits
"""
TABLE = "trajectory,descent,error_mm,note\nT0,chaotic,1.0,one\nT4,steady,4.0,four\n"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Return a project with tolerances, and folders with one table each."""
    for name in ("data", "results", "old"):
        (tmp_path / name).mkdir()
    (tmp_path / "data/tolerances.csv").write_text(f"{REFERENCE}another\n{TOLERANCES}")
    for folder in ("results", "old"):
        (tmp_path / folder / "table_2.csv").write_text(TABLE)
    return tmp_path


def found(root: Path, text: str, name: str = "table_2.csv", **options: bool) -> list[str]:
    """Write a table and return what is found."""
    (root / "results" / name).write_text(text)
    return compare_folders(root / "old", root / "results", root, **options).found


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("4.0", "4.000003", []),  # within 1e-6 of the largest
        (
            "4.0",
            "4.00001",
            ["error_mm differs in 1 row, most where the row is 'T4 steady four': by 2.5e-06"],
        ),
        ("chaotic,1.0", "chaotic,7.0", []),  # by 6 of 7
        ("4.0", "", ["by inf of the column's largest"]),
        ("one", "two", []),
        ("four", "five", ["note differs in 1 row"]),
        ("T4", "T5", ["table_2.csv has 1 row that only one of the two has"]),
        ("error_mm", "error_m", ["only one of the two has error_m, error_mm"]),
        ("T0,chaotic,1.0,one\n", "", ["table_2.csv has 1 row that only one of the two has"]),
        ("four\n", "four\nT5,steady,1.0,five\n", ["table_2.csv has 1 row that only one of the two has"]),
    ],
)
def test_cells_may_move_as_far_as_their_tolerance(root, before, after, said):
    lines = found(root, TABLE.replace(before, after))
    assert len(lines) == len(said)
    for line, words in zip(lines, said, strict=True):
        assert words in line


def test_numbers_are_measured_by_the_largest_of_their_column_and_missing_words_are_alike(root):
    (root / "old/small.csv").write_text("name,note,error_mm\na,,0.001\nb,x,0.002\n")
    (said,) = found(root, "name,note,error_mm\na,,0.001\nb,x,0.0021\n", "small.csv")
    assert "error_mm differs in 1 row, most where the row is 'b x': by 4.8e-02 of" in said


def test_rows_are_matched_by_what_tells_them_apart_not_by_their_place(root):
    head, *rows = TABLE.splitlines(keepends=True)
    assert found(root, "".join([head, *reversed(rows)])) == []


def test_exact_means_every_byte(root):
    assert found(root, TABLE.replace("4.0", "4.000003"), exact=True) == [
        "table_2.csv is not the same byte for byte"
    ]


def test_rows_that_only_one_table_has_are_counted(root):
    table = pd.DataFrame({"name": "u", "time_s": range(10), "u_mT": 0.1})
    table.to_csv(root / "old/series.csv", index=False)
    said = found(root, table[:1].to_csv(index=False), "series.csv")
    assert said == ["series.csv has 9 rows that only one of the two has"]


def test_columns_tell_rows_apart_if_they_do_so_in_both_tables(root):
    (root / "old/pairs.csv").write_text("a,b,x_mm\n1,p,0.5\n2,q,0.5\n")
    assert found(root, "a,b,x_mm\n1,r,0.5\n1,s,0.5\n", "pairs.csv") == [
        "pairs.csv has 2 rows that only one of the two has"
    ]


def test_a_table_that_is_not_in_both_folders_is_named(root):
    assert found(root, TABLE, "new.csv") == [f"new.csv is missing in {root / 'old'}"]


def compare(root: Path, *folders: str) -> subprocess.CompletedProcess[str]:
    """Run the command."""
    command = [sys.executable, "-m", "repro_companion.cli", "compare", *folders]
    return subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)


def test_results_are_compared_with_what_is_committed(root):
    """Byte for byte on the processor that made them, elsewhere within the tolerances."""
    git = ["git", "-C", str(root), "-c", "user.name=a", "-c", "user.email=a@example.org"]
    for arguments in (["init", "-q"], ["add", "."], ["commit", "-qm", "Add tables"]):
        subprocess.run([*git, *arguments], check=True)
    done = compare(root)
    assert (done.returncode, done.stdout) == (0, "Tables: 1 the same byte for byte.\n")
    (root / "results/table_2.csv").write_text(TABLE.replace("4.0", "4.000003"))
    done = compare(root)
    assert (done.returncode, done.stdout[:12]) == (0, "Tables: 0 th")
    (root / "data/tolerances.csv").write_text(f"{REFERENCE}{get_host_cpu_name()}\n{TOLERANCES}")
    assert on_reference_processor(root)
    done = compare(root)
    assert (done.returncode, done.stderr) == (1, "table_2.csv is not the same byte for byte\n")


def test_wrong_folders_are_refused_in_one_line(root, tmp_path_factory):
    empty = tmp_path_factory.mktemp("empty")
    for folder, arguments, said in (
        (root, ["old"], "give two folders, or none"),
        (root, ["old", "data/none"], "there are no tables (*.csv) in data/none"),
        (root, [], "The committed tables cannot be read"),
        (empty, [], "its data/tolerances.csv is needed"),
    ):
        done = compare(folder, *arguments)
        assert done.returncode == 2
        assert said in done.stderr
        assert "Traceback" not in done.stderr


def test_of_the_methods_of_table_2_only_those_with_the_chaotic_step_may_move(tmp_path):
    root = Path(__file__).parents[1]
    lines = pd.read_csv(root / "data/tolerances.csv", comment="#", dtype={"tolerance": float})
    table = pd.read_csv(root / "results/table_2_methods.csv")
    guarded = []
    for column in table.columns[2:]:
        moved = table.assign(**{column: table[column] + 1e-3 * table[column].max()})
        moved.to_csv(tmp_path / "table_2_methods.csv", index=False)
        found = compare_tables(root / "results/table_2_methods.csv", tmp_path / "table_2_methods.csv", lines)
        guarded += [column] if found else []
    assert guarded == ["ours", "descent", "half step", "filter"]


@pytest.mark.parametrize("name", ["results/table_2.csv", "data/tolerances.csv"])
@pytest.mark.parametrize("content", [b"\xaf\xff,1\n2,3\n", b'a,b\n"1,2\n', b"a\n1,2\n3\n4,5,6\n"])
def test_what_is_no_table_is_refused_by_its_name(root, content, name):
    (root / name).write_bytes(content)
    with pytest.raises(InputError, match=f"{name} must be a table in UTF-8 with commas"):
        compare_folders(root / "old", root / "results", root)
