"""Committed studies: computed once, resumable by file, never shown with settings that are not theirs."""

import json

import pandas as pd
import pytest
from edition1.errors import InputError
from edition1_companion.book.project import find_project
from edition1_companion.book.studies import (
    Study,
    committed,
    read_study,
    write_studies,
)
from edition1_companion.pages import all_studies

SMALL = {"kinds": ["sensor_gain"], "factors": [0.1, 1.0], "draws": 1}


def computed(kinds, factors, draws):
    """Return a table of an error for each kind, factor and draw."""
    rows = [(kind, factor, draw, factor / 3) for kind in kinds for factor in factors for draw in range(draws)]
    return pd.DataFrame(rows, columns=["kind", "factor", "draw", "error_percent"])


@pytest.fixture
def small():
    """Small studies of given factors, and the names of those that were computed."""
    names = []

    def study(name, **settings):
        def compute(**given):
            names.append(name)
            return computed(**given)

        return Study(name, compute, SMALL | settings)

    def of(*factors):
        return tuple(study(f"gain_{k}", factors=list(f)) for k, f in enumerate(factors))

    return names, of


def test_what_is_there_is_not_computed_again(tmp_path, small):
    names, of = small
    studies = of([0.1, 1.0], [0.5])
    paths = write_studies(studies, tmp_path, progress=False)
    assert names == ["gain_0", "gain_1"]
    assert paths == [tmp_path / "gain_0.csv", tmp_path / "gain_1.csv"]
    assert write_studies(studies, tmp_path, progress=False) == paths
    assert len(names) == 2
    paths[1].with_suffix(".json").unlink()  # as if interrupted between the two files
    write_studies(studies, tmp_path, progress=False)
    assert names[2:] == ["gain_1"]


def test_other_settings_are_computed_anew(tmp_path, small):
    names, of = small
    write_studies(of([0.1, 1.0], [0.5]), tmp_path, progress=False)
    write_studies(of([0.1, 1.0], [0.7]), tmp_path, progress=False)
    assert names[2:] == ["gain_1"]
    assert read_study("gain_1", tmp_path)[1]["factors"] == [0.7]


def test_table_and_settings_as_written(tmp_path, small):
    _, of = small
    studies = of([0.1, 1.0], [0.5])
    write_studies(studies, tmp_path, progress=False)
    table, settings = read_study("gain_0", tmp_path)
    assert settings == SMALL | {"factors": [0.1, 1.0]}
    pd.testing.assert_frame_equal(table, computed(**settings), rtol=1e-4)
    together = committed(studies, tmp_path)
    assert together["factor"].tolist() == [0.1, 1.0, 0.5]


def test_a_study_is_given_what_it_needs(tmp_path):
    study = Study("more", lambda **given: pd.DataFrame([given]), {"draws": 3}, ("data",))
    (path,) = write_studies([study], tmp_path, progress=False)
    assert path.stem == "more"
    table, settings = read_study("more", tmp_path)
    assert settings == {"draws": 3}
    assert table.to_dict("records") == [{"draws": 3, "data": str(find_project().data)}]


def test_progress_names_the_studies(tmp_path, small, capsys):
    write_studies(small[1]([0.1], [0.5]), tmp_path, progress=True)
    assert capsys.readouterr().err.splitlines() == ["gain_0", "gain_1"]


def test_studies_that_are_not_there(tmp_path):
    message = r"Input name of read_study must be a study in data/studies with its settings .* received none"
    with pytest.raises(InputError, match=message):
        read_study("none", tmp_path)
    with pytest.raises(InputError, match=message):
        committed([Study("none", pd.DataFrame, {})], tmp_path)


def test_every_study_has_a_committed_table_of_its_own():
    tables = {path.stem for path in (find_project().data / "studies").glob("*.csv")}
    names = [study.name for study in all_studies()]
    assert len(set(names)) == len(names) > 15
    assert set(names) <= tables


@pytest.mark.parametrize("study", all_studies(), ids=lambda study: study.name)
def test_committed_tables_belong_to_the_settings_of_today(study):
    table, settings = read_study(study.name)
    assert settings == study.settings == json.loads(json.dumps(study.settings))
    assert not table.empty
    for column, setting in (("model", "models"), ("solver", "solvers"), ("seed", "seeds"), ("kind", "kinds")):
        if setting in settings:
            assert sorted(set(table[column])) == sorted(settings[setting])
