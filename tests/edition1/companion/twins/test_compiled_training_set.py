"""Compiled training rows against the training set by magpylib."""

import pytest
import torch
from edition1.errors import InputError
from edition1.sensing.magnets import ring
from edition1.sensing.relations import relations
from edition1_companion.twins.training_set import training_set

from bench.compiled_training_set import training_rows


@pytest.mark.parametrize(
    "options",
    [
        {"n_segments": 1},
        {"n_segments": 3, "magnet": ring("published")},
        {"n_segments": 2, "earth": True, "sensors_per_segment": 4},
        {"n_segments": 2, "elongation_m": 5.5e-3, "samples": 1, "earth": True},
    ],
)
def test_same_draws_same_relations_and_the_readings_of_magpylib(options):
    options = {"seed": 3, "samples": 500} | options
    found, expected = training_rows(**options), training_set(**options)
    assert torch.equal(found.q, expected.q)
    cosines = relations(expected.robot, expected.q, expected.earth_axis).cosines()
    torch.testing.assert_close(found.cosines, cosines, atol=1e-12, rtol=0)
    torch.testing.assert_close(found.u, expected.u, atol=1e-6, rtol=0)


def test_order_of_the_series():
    exact = training_set(1, seed=0, samples=200).u
    error = [float((training_rows(1, seed=0, samples=200, l_max=n).u - exact).abs().max()) for n in (1, 5, 9)]
    assert error[0] > 100 * error[1] > 1e4 * error[2]


def test_same_seed_same_bits():
    a, b = (training_rows(2, seed=1, samples=100) for _ in range(2))
    assert torch.equal(a.u, b.u)
    assert torch.equal(a.cosines, b.cosines)


def test_bad_input():
    with pytest.raises(
        InputError, match="Input samples of training_rows must be positive; instead received 0."
    ):
        training_rows(1, seed=0, samples=0)
