"""Committed studies: each has its settings beside it, and none is read without them."""

import json

import pandas as pd
import pytest

from edition1.errors import InputError
from edition1_companion.book.project import find_project
from edition1_companion.book.studies import joined, read_study

STUDIES = find_project().data / "studies"


@pytest.fixture
def folder(tmp_path):
    """Two small studies, and a table without its settings."""
    for name, factors in (("first", [0.1, 1.0]), ("second", [0.5])):
        (tmp_path / f"{name}.csv").write_text("factor\n" + "".join(f"{x}\n" for x in factors))
        (tmp_path / f"{name}.json").write_text(json.dumps({"factors": factors}))
    (tmp_path / "bare.csv").write_text("factor\n1.0\n")
    return tmp_path


def test_table_and_settings_as_written(folder):
    table, settings = read_study("first", folder)
    assert settings == {"factors": [0.1, 1.0]}
    pd.testing.assert_frame_equal(table, pd.DataFrame({"factor": [0.1, 1.0]}))


def test_tables_are_joined_in_the_order_of_their_names(folder):
    found = joined(["second", "first"], folder)
    pd.testing.assert_frame_equal(found, pd.DataFrame({"factor": [0.5, 0.1, 1.0]}))


@pytest.mark.parametrize("name", ["none", "bare"])
def test_studies_that_are_not_there(folder, name):
    message = (
        rf"Input name of read_study must be a study in data/studies with its settings; .* received {name}"
    )
    with pytest.raises(InputError, match=message):
        read_study(name, folder)
    with pytest.raises(InputError, match=message):
        joined(["first", name], folder)


@pytest.mark.parametrize("name", sorted(path.stem for path in STUDIES.glob("*.csv")))
def test_committed_tables_belong_to_their_settings(name):
    table, settings = read_study(name)
    assert not table.empty
    for column, setting in (("model", "models"), ("solver", "solvers"), ("seed", "seeds"), ("kind", "kinds")):
        if setting in settings:
            assert sorted(set(table[column])) == sorted(settings[setting])


def test_no_settings_are_without_a_table():
    assert {path.stem for path in STUDIES.glob("*.json")} == {path.stem for path in STUDIES.glob("*.csv")}
