"""Synthetic bend and light-bulb tests pass through the loaders of the recordings and come back as they were made."""

import numpy as np
import pytest

from edition1_companion.recordings.mitchell2021 import FIELD, align, read_hall, takes
from edition1_companion.recordings.mitchell2021_capture import read_capture
from edition1_companion.twins.bend_takes import (
    DRAINED,
    BendRecorder,
    tightening,
    up_and_down,
    write_bend_takes,
    write_light_tests,
)

AS_DRAWN = BendRecorder(noise_mt=0.0, transverse_gain=1.0, rest_mt=(0.0, 0.0))


@pytest.mark.parametrize("lag_s", [-0.8, 0.0, 0.5])
def test_bend_direction_and_lag_come_back(tmp_path, lag_s):
    recorder = BendRecorder(lag_s=lag_s)
    write_bend_takes(tmp_path, seed=0, takes=((2, 1),), recorder=recorder, duration_s=12.0)
    (take,) = takes(tmp_path)
    hall, capture = read_hall(take.hall), read_capture(take.capture)
    assert (hall.unreadable, hall.drained, hall.masked, hall.switches) == (0, DRAINED, 0, 0)
    table, lag = align(hall, capture)
    assert lag.lag_s == pytest.approx(lag_s, abs=0.02)
    bend = up_and_down(table["time_s"].to_numpy(), duration_s=12.0)
    assert np.degrees(np.abs(table["bend_rad"] - bend)).max() < 0.5
    bent = table["bend_rad"] > 0.1
    np.testing.assert_allclose(table["direction_rad"][bent], np.radians(120.0) + 0.4, atol=1e-4)


def test_field_is_that_of_the_cube_in_the_axes_of_the_files(tmp_path):
    write_bend_takes(tmp_path, seed=0, takes=((0, 1),), recorder=AS_DRAWN, duration_s=6.0)
    (take,) = takes(tmp_path)
    field = read_hall(take.hall).readings[FIELD].to_numpy()
    # Towards the model's x, so along y of the files; straight, the field on the axis of a cube, negative.
    edge = 6.35
    near, far = (
        np.arctan(edge**2 / (2 * z * np.sqrt(4 * z**2 + 2 * edge**2))) for z in (13 - edge / 2, 13 + edge / 2)
    )
    np.testing.assert_allclose(field[0], [-1320 / np.pi * (near - far), 0, 0], atol=0.0051)
    assert np.abs(field[:, 2]).max() < 0.01
    peak = field[np.argmax(np.abs(field[:, 1]))]
    # A dipole at 50 deg has the ratio 0.210, the cube a little more.
    assert -peak[1] / peak[0] == pytest.approx(
        np.sin(np.radians(50)) / (3 + np.cos(np.radians(50))), rel=0.06
    )


def test_same_seed_same_file_other_seed_another(tmp_path):
    texts = []
    for folder, seed in (("a", 1), ("b", 1), ("c", 2)):
        write_light_tests(tmp_path / folder, seed=seed)
        texts.append((tmp_path / folder / "experiment_data/light_test_0.csv").read_text())
    assert texts[0] == texts[1] != texts[2]


def test_light_tests_are_found_and_the_first_ends_at_rest(tmp_path):
    write_light_tests(tmp_path, seed=0)
    found = takes(tmp_path)
    assert [take.name for take in found] == ["light_-1", "light_0", "light_1", "light_2"]
    field = read_hall(found[0].hall).readings
    late = field[field["time_s"] > 16.0][FIELD]
    np.testing.assert_allclose(late.std(), 0.025, rtol=0.15)


def test_tightening_adds_one_bump_per_event():
    time_s = np.arange(0.0, 30.0, 0.01)
    bend = np.degrees(tightening(time_s, (10.0, 20.0)))
    np.testing.assert_allclose(bend[[0, 1000, 1500, 2000]], [0, 48, 40, 48], atol=1e-6)
    assert np.degrees(tightening(time_s, ())).max() == pytest.approx(40.0)
