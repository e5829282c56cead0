"""The check of shapes that runs with `make test SHAPES=1`: the conftest of the project."""

import os

import jaxtyping
import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.estimation._particle_cloud import best_tenth

pytestmark = pytest.mark.skipif(not os.environ.get("SHAPES"), reason="checks shapes only with SHAPES=1")


def test_a_letter_has_one_size_in_a_call_and_another_in_the_next():
    for n in (20, 30):
        best_tenth(torch.zeros(n, 2), torch.zeros(n))
        with pytest.raises(TypeError, match="log_w"):
            best_tenth(torch.zeros(n, 2), torch.zeros(n + 1))


def test_results_are_checked_beside_what_was_taken():
    @jaxtyping.jaxtyped(typechecker=None)
    def leading(x: Float[Tensor, "n m"], k: int) -> Float[Tensor, " m"]:
        return x[0, :k]

    assert leading(torch.zeros(2, 3), 3).shape == (3,)
    with pytest.raises(TypeError, match="return"):
        leading(torch.zeros(2, 3), 2)


def test_a_call_inside_a_call_has_letters_of_its_own():
    @jaxtyping.jaxtyped(typechecker=None)
    def outer(x: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        best_tenth(torch.zeros(len(x) + 1, 2), torch.zeros(len(x) + 1))
        return x

    assert outer(torch.zeros(20)).shape == (20,)
