"""The lemniscates of section 3.4."""

import math

import pytest
import torch

from edition1.errors import InputError
from edition1_companion.twins.trajectories import flower, lemniscate


@pytest.mark.parametrize("half", [False, True])
def test_ranges_and_ends(half):
    q = lemniscate(1, half=half)
    assert q.shape == (400, 3)
    bending = torch.linalg.vector_norm(q[:, :2], dim=-1) / 22e-3
    assert math.degrees(float(q[:, 0].max()) / 22e-3) == pytest.approx(45, abs=0.01)
    assert math.degrees(float(bending.max())) < 64
    torch.testing.assert_close(q[0], torch.tensor([0, 0, 2.75e-3], dtype=torch.float64))
    assert float(q[:, 2].min()) == pytest.approx(0, abs=1e-7)
    assert float(q[:, 2].max()) == pytest.approx(5.5e-3, abs=1e-7)


def test_full_lemniscate_closes_and_crosses_itself():
    q = lemniscate(1, steps=401)
    torch.testing.assert_close(q[0], q[-1], atol=1e-15, rtol=0)
    torch.testing.assert_close(q[0, :2], q[200, :2], atol=1e-15, rtol=0)


def test_segments_are_shifted_in_phase():
    """A third of a turn for three segments: delta_y and delta_L of segment i + 1 are those of i, earlier."""
    q = lemniscate(3, steps=301)
    torch.testing.assert_close(q[:201, 4], q[100:, 1], atol=1e-15, rtol=0)
    torch.testing.assert_close(q[:201, 8], q[100:, 5], atol=1e-15, rtol=0)


def test_bad_input():
    with pytest.raises(InputError, match="Input n_segments, steps of lemniscate must be at least 1"):
        lemniscate(0)


class TestFlower:
    def test_ranges_of_section_4_3(self):
        k0, k1, phi, dL = flower(steps=601).unbind(-1)
        for x, low, high in (
            (k0, 0, math.pi / 4),
            (k1, 0.1 * math.pi, math.pi),
            (phi, 0, 2 * math.pi),
            (dL, 0, 5.5e-3),
        ):
            assert float(x.min()) == pytest.approx(low, abs=1e-5)
            assert float(x.max()) == pytest.approx(high, abs=1e-5)

    def test_three_equal_petals(self):
        """0.3 Hz in 10 s."""
        petals = flower(steps=601)[:, :2]
        torch.testing.assert_close(petals[:401], petals[200:], atol=1e-12, rtol=0)
        assert float(petals[100, 1]) == pytest.approx(math.pi)

    def test_bad_input(self):
        with pytest.raises(InputError, match="Input steps of flower must be at least 1"):
            flower(steps=0)
