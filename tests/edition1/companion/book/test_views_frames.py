"""Frames and readings that 3-D views have in common."""

import numpy as np
import pytest

from edition1.errors import InputError
from edition1_companion.book.views_frames import every_nth, readings


@pytest.mark.parametrize(("samples", "most"), [(1, 1), (99, 100), (100, 100), (101, 100), (7750, 200)])
def test_frames_are_even_and_not_too_many(samples, most):
    taken = np.arange(samples)[every_nth(samples, most)]
    assert taken[0] == 0
    assert len(set(np.diff(taken))) <= 1
    assert most / 2 < len(taken) <= most or len(taken) == samples


def test_no_frame_is_refused():
    with pytest.raises(InputError) as caught:
        every_nth(0, 100)
    assert (
        str(caught.value) == "Input samples, most of every_nth must be at least 1; instead received (0, 100)."
    )


def test_each_sensor_has_its_line():
    panel = readings(np.array([[1.0, 2.0], [3.0, 4.0]]), "mV", np.array([[5.0, 6.0], [7.0, 8.0]]))
    assert {name: x.tolist() for name, x in panel.values.items()} == {"u_1": [1, 3], "u_2": [2, 4]}
    assert panel.estimates["u_2"].tolist() == [6, 8]
    assert readings(np.ones((2, 1)), "mV").estimates == {}
