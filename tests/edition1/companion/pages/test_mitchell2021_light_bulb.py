"""Events of a synthetic bulb, whose number is known, and the released files where found."""

import numpy as np
import pandas as pd
import pytest

from edition1.errors import InputError
from edition1_companion.pages.light_bulb import (
    FIRST,
    all_events,
    as_drawn,
    bend_over_time,
    counts,
    detector,
    events,
    facts,
    light_tests,
    recorded_or_synthetic,
)
from edition1_companion.twins.bend_takes import BendRecorder, write_light_tests

MODEL = as_drawn(13.0)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bulb")
    write_light_tests(folder, seed=0)
    return light_tests(folder)


def test_detector_finds_rest_and_noise(files):
    found = detector(files[FIRST])
    # 0.3 and -0.5 mT of 24.2 mT, and 0.025 mT of noise.
    np.testing.assert_allclose(found.rest, [0.3 / 24.2, -0.5 / 24.2], atol=1e-3)
    assert found.noise == pytest.approx(0.025 / 24.2, rel=0.15)
    assert found.threshold == pytest.approx(10 * found.noise)
    assert found.quiet_from_s > 14.5


def test_events_are_those_put_in(files):
    found, curves, marks = all_events(files, MODEL)
    centre = (marks["start_s"] + marks["end_s"]) / 2
    for file, at in (("light_0", (10, 15, 20)), ("light_1", (9, 14, 20)), ("light_2", (15,))):
        np.testing.assert_allclose(centre[marks["file"] == file], at, atol=0.1)
    assert set(curves["file"]) == set(files)
    table = counts(curves, found)
    frozen = table[table["frozen"]]
    assert frozen[["light_0", "light_1", "light_2"]].to_numpy().tolist() == [[3, 3, 1]]


def test_what_was_dropped_is_told(files):
    table = facts(files).set_index("file")
    assert list(table.index) == list(files)
    assert (table["drained"] == 15).all()
    assert (table[["unreadable", "beyond_range"]] == 0).all(axis=None)
    assert table["longest_gap_s"].between(0.016, 0.021).all()


def test_other_files_do_not_move_the_threshold(files):
    alone, _, _ = all_events({FIRST: files[FIRST]}, MODEL)
    together, _, _ = all_events(files, MODEL)
    assert alone.threshold == together.threshold


def test_bend_is_that_of_the_grasp(tmp_path):
    write_light_tests(tmp_path, seed=0, recorder=BendRecorder(transverse_gain=1.0, rest_mt=(0.0, 0.0)))
    tests = light_tests(tmp_path)
    table = bend_over_time(tests["light_2"], detector(tests[FIRST]), MODEL)
    held = table[(table["time_s"] > 6) & (table["time_s"] < 12)]
    error = np.degrees(held["bend_rad"]) - 40
    assert abs(error.mean()) < 0.3
    assert error.std() == pytest.approx(np.degrees(held["deviation_rad"].mean()), rel=0.15)
    assert not table["at_bound"].any()


def test_short_events_are_none_and_close_ones_are_one():
    time_s = np.arange(0, 10, 0.02)
    ratio = np.zeros_like(time_s)
    for start, end in ((1.0, 1.04), (3.0, 3.5), (4.0, 4.5), (7.0, 7.5)):
        ratio[(time_s >= start) & (time_s < end)] = 0.2
    table = pd.DataFrame({"time_s": time_s, "ratio": ratio, "baseline": 0.0})
    np.testing.assert_allclose(events(table, 0.1)["start_s"], [3, 7])
    np.testing.assert_allclose(events(table, 0.1, merged_s=0.25)["start_s"], [3, 4, 7])
    assert events(table, 0.3).empty


def test_without_the_first_file_nothing_is_set(files):
    with pytest.raises(
        InputError, match=r"files of all_events must be with light_-1 among them; .* \['light_0'\]"
    ):
        all_events({"light_0": files["light_0"]}, MODEL)


def test_a_recording_too_short_for_rest_is_refused(files):
    hall = files[FIRST]
    short = type(hall)(**(vars(hall) | {"readings": hall.readings[hall.readings["time_s"] < 15]}))
    with pytest.raises(InputError, match=r"recording of detector must be longer than 20 s; .* 14\.9\d+ s"):
        detector(short)


def test_without_recordings_files_are_synthetic_and_say_so(monkeypatch, tmp_path):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    found, source = recorded_or_synthetic()
    assert (source, list(found)) == ("synthetic", [FIRST, "light_0", "light_1", "light_2"])


def test_released_files_have_events_where_the_ratio_rises_most():
    found = light_tests()
    if set(found) != {FIRST, "light_0", "light_1", "light_2"}:
        pytest.skip("no light-bulb tests of Mitchell et al. are below REPRO_DATA_DIR")
    frozen, curves, marks = all_events(found, MODEL)
    assert frozen.quiet_from_s > 25
    for file, at in (("light_1", (13, 19)), ("light_2", (13, 19))):
        best = marks[marks["file"] == file].sort_values("rise").iloc[-1]
        assert best["start_s"] > at[0]
        assert best["end_s"] < at[1]
    assert curves.groupby("file")["at_bound"].mean()["light_2"] > 0.5
