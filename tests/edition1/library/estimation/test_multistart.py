"""Starts of least squares fill the box evenly."""

import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.multistart import starts_within

LOW, HIGH = torch.tensor([-0.02, -0.02, 0.0]).double(), torch.tensor([0.02, 0.02, 0.0066]).double()


def test_starts_fill_the_box():
    starts = starts_within(LOW, HIGH, 65, seed=0)
    torch.testing.assert_close(starts[0], (LOW + HIGH) / 2)
    assert bool((starts >= LOW).all() & (starts <= HIGH).all())
    octants = (starts[1:] > starts[0]).int() @ torch.tensor([1, 2, 4], dtype=torch.int32)
    assert torch.bincount(octants.long(), minlength=8).tolist() == [8] * 8
    assert torch.equal(starts, starts_within(LOW, HIGH, 65, seed=0))


def test_bad_input():
    with pytest.raises(InputError, match="Input count of starts_within must be at least 1"):
        starts_within(LOW, HIGH, 0, seed=0)
