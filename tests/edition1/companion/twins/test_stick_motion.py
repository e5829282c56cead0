"""The mode of the synthetic motion at a time."""

import numpy as np
import pytest

from edition1.errors import InputError
from edition1_companion.twins.stick_motion import mode_at


def test_bad_input():
    with pytest.raises(
        InputError, match=r"Input time_s of mode_at must be 0 or later \[s\]; instead received -1.0"
    ):
        mode_at(np.array([3.0, -1.0]))


def test_a_mode_begins_at_its_start():
    found = mode_at(np.array([89.99, 90.0, 112.0, 134.0, 206.0, 226.0, 300.0]))
    expected = "oscillating buckling circling oscillating buckling circling circling"
    assert found.tolist() == expected.split()
