"""Operations of kernels, counted by running them; against counts by hand."""

import math
import types

import numpy as np
import pytest
import torch
from edition1.kernels.compilation import machine_code

from bench.arithmetic import limit_rate, operations
from bench.operation_count import counting
from bench.trackers import Task, advance, least_squares, multipole


@machine_code()
def inner(x):
    return math.sqrt(x) * x + 1.0 / x


@machine_code()
def outer(x, out, n):
    """Per number one addition, one square and what ``inner`` does."""
    total, room = 0.0, np.zeros(len(x))
    for i in range(len(x)):
        room[i] = x[i] ** 2
        total += room[i]
        if room[i] > 4.0:
            out[i] = inner(x[i])
    return total - n * 1.0, room


def module():
    found = types.ModuleType("kernels")
    found.outer = outer
    return found


def test_counts_by_hand_and_equal_results():
    x, out, slow = np.array([1.0, 2.0, 3.0, 4.0]), np.zeros(4), np.zeros(4)
    expected, room = outer(x, out, 2)
    kernels = module()
    with counting(kernels, "outer") as tally:
        found, room_found = kernels.outer(x, slow, 2)
    assert kernels.outer is outer
    assert found == expected == 28.0
    np.testing.assert_array_equal(room_found, room)
    np.testing.assert_array_equal(slow, out)
    # Whole numbers count for nothing: 4 squares; 4 sums and a difference; twice the inner function.
    assert dict(tally) == {"mul": 4 + 2, "add": 4 + 1 + 2, "sqrt": 2, "div": 2}


def test_a_failing_kernel_is_put_back():
    kernels = module()
    with pytest.raises(IndexError), counting(kernels, "outer"):
        kernels.outer(np.ones(3) * 3, np.zeros(1), 0)
    assert kernels.outer is outer


def test_a_tracker_finds_the_same_while_it_is_counted():
    from edition1.kernels import _least_squares as compiled_least_squares

    method, task = least_squares(1, "multipole", multipole(1)).method, Task(1, members=2, steps=1)
    expected, found = advance(method, task, 2, seeds=False), []

    def work():
        found.append(advance(method, task, 2, seeds=False))
        return 2

    counted = operations(compiled_least_squares, "_fit", work)
    torch.testing.assert_close(found[0], expected, atol=1e-15, rtol=1e-12)
    # Four evaluations of three pairs: a distance each, and a factor of the normal equations for every solution.
    assert counted["sqrt"] >= 4 * 3
    assert 1000 < counted["mul"] < 20_000


def test_limit_is_the_time_of_all_operations():
    speed = {"scalar": 1e9, "single": 4e9, "div": 1e8}
    counted = operations(module(), "outer", lambda: 1)
    assert not counted
    counted.update({"add": 10.0, "mul": 30.0, "div": 2.0})
    assert limit_rate(counted, speed) == pytest.approx(1 / (20e-9 + 20e-9))
    assert limit_rate(counted, speed, "single") == pytest.approx(1 / (5e-9 + 20e-9))
