"""What `import edition1 as repro` gives: the way of a stranger, from a robot file to a shape."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import edition1 as repro

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("name", repro.__all__)
def test_every_name_has_an_example_that_runs_as_a_doctest(name):
    found = getattr(repro, name)
    assert found.__name__ == name
    assert found.__module__.startswith("edition1.")
    assert ">>> " in found.__doc__
    assert f"{name}" in repro.__doc__


def test_names_are_few_and_others_are_refused():
    assert len(repro.__all__) <= 38
    assert set(repro.__all__) <= set(dir(repro))
    with pytest.raises(AttributeError, match="module 'edition1' has no attribute 'no_such_name'"):
        repro.no_such_name  # noqa: B018


@pytest.mark.parametrize(
    "line", ["import edition1 as repro", "import edition1.errors", "from edition1 import InputError"]
)
def test_names_are_loaded_on_first_use(line):
    code = f"import sys; {line}; sys.exit(bool({{'torch', 'pandas', 'numba', 'numpy'}} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.fixture
def folder(tmp_path):
    """An empty folder but for the two files of the example."""
    for name in ("robot.toml", "mine.csv"):
        shutil.copyfile(ROOT / "data" / "example" / name, tmp_path / name)
    return tmp_path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"u2_mT": None},
            "channel 2 of the table must be one column: u2_mT, channel_2 or sensor_2; .* none among",
        ),
        ({"ch2": 0.0}, "channel 2 of the table must be one column: .* received u2_mT, ch2: 2"),
        ({"u2_mT": None, "u2_uT": 0.0}, "column u2_uT of the table must be in mT, the unit of robot.toml"),
        ({"u3_mT": "n/a"}, "column u3_mT of the table must be numbers; instead received 'n/a' in row 0"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(folder, change, message):
    import pandas as pd

    robot, table = repro.load_robot(folder / "robot.toml"), pd.read_csv(folder / "mine.csv")
    for column, value in change.items():
        if value is None:
            del table[column]
        else:
            table[column] = value
    with pytest.raises(repro.InputError, match=message):
        robot.readings(table)


def test_columns_are_found_by_number_and_unit_in_any_order(folder):
    import pandas as pd

    robot, table = repro.load_robot(folder / "robot.toml"), pd.read_csv(folder / "mine.csv")
    named = table.rename(columns={"u1_mT": "sensor_1", "u2_mT": "Channel2 [mT]", "u3_mT": "ch3"})
    assert robot.readings(named[["ch3", "Channel2 [mT]", "time_s", "sensor_1"]]).equal(robot.readings(table))
    table.loc[5, "u2_mT"] = float("nan")
    assert torch.isnan(robot.readings(table)).nonzero().tolist() == [[5, 1]]
