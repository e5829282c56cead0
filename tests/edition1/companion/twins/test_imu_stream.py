"""The synthetic stream: the same form as a recording, made from its seed alone."""

import numpy as np
import pandas as pd
import pytest

from edition1.errors import InputError
from edition1.estimation.imu_chain import link_orientations, rigid_body
from edition1_companion.recordings.martin2022 import READING_COLUMNS, one_clock
from edition1_companion.twins.imu_stream import NEIGHBOUR_ANGLES_DEG, smooth_motion, synthetic_stream


def test_has_the_form_of_a_recording():
    readings = synthetic_stream(seed=0)
    assert tuple(readings.columns) == READING_COLUMNS
    assert readings["imu"].tolist() == list(range(8)) * 700
    stream = one_clock(readings)
    np.testing.assert_allclose(stream.facts["rate_hz"], 35.0)
    assert stream.lost == 0
    assert (stream.facts["gaps"] == 0).all()
    assert stream.facts["repeats"].sum() > 0


def test_same_seed_same_bits_and_another_seed_differs():
    pd.testing.assert_frame_equal(synthetic_stream(seed=3), synthetic_stream(seed=3), check_exact=True)
    assert not synthetic_stream(seed=3).equals(synthetic_stream(seed=4))


@pytest.mark.parametrize("seed", range(5))
def test_only_one_jump_and_it_is_the_one_put_in(seed):
    jumps = one_clock(synthetic_stream(seed=seed)).jumps
    assert len(jumps) == 1
    assert jumps["step_deg"][0] == pytest.approx(30, abs=8)
    assert jumps["time_s"][0] == pytest.approx(10, abs=1 / 35)


def test_shape_does_not_depend_on_how_the_sensors_are_mounted():
    shapes = [
        rigid_body(
            link_orientations(one_clock(synthetic_stream(seed=0, along_arm=axis)).orientations, axis),
            (0.08,) * 8,
        )
        for axis in "xyz"
    ]
    # Equal but for the noise, which is drawn in the sensor frame.
    assert np.abs(shapes[0] - shapes[2]).max() < 0.02
    assert np.abs(shapes[1] - shapes[2]).max() < 0.02


def test_motion_is_smooth_and_has_the_stated_median_angles():
    time_s = np.linspace(0, 2000, 20001)
    motion = smooth_motion(time_s, np.random.default_rng(0))
    steps = np.abs((motion[1:] * motion[:-1]).sum(-1)).clip(0, 1)
    assert np.degrees(2 * np.arccos(steps)).max() < 40  # in 0.1 s
    dots = np.abs((motion[:, 1:] * motion[:, :-1]).sum(-1)).clip(0, 1)
    median = np.median(np.degrees(2 * np.arccos(dots)), axis=0)
    np.testing.assert_allclose(median, NEIGHBOUR_ANGLES_DEG[1:], rtol=0.15)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [({"rate_hz": 0.0}, "rate_hz"), ({"duration_s": 0.01}, "duration_s"), ({"along_arm": "up"}, "along_arm")],
)
def test_bad_input_is_refused(arguments, name):
    with pytest.raises(InputError, match=f"Input {name} of "):
        synthetic_stream(seed=0, **arguments)
