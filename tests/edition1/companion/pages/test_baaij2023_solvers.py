"""Model by solver on a few time steps, and pieces of work in processes."""

from functools import partial

import pytest

from edition1.errors import InputError
from edition1_companion.book.parallel import in_processes
from edition1_companion.pages.table_1.limits import model_by_solver


def test_multipole_model_with_both_solvers(tmp_path):
    table = model_by_solver(1, (0, 1), tmp_path, models=["multipole"], steps=7)
    assert table["solver"].tolist() == ["gradient descent", "Levenberg-Marquardt"]
    assert table["start"].tolist() == ["ground truth", "straight"]
    assert table["configuration_percent"].iloc[1] < 0.005
    assert table["tip_mm"].iloc[1] < 1e-3


def test_noise_gives_every_seed_its_own_readings(tmp_path):
    table = model_by_solver(
        1, (0, 1), tmp_path, models=["multipole"], solvers=["Levenberg-Marquardt"], noise_mt=1e-3, steps=5
    )
    assert table["seed"].tolist() == [0, 1]
    assert table["tip_mm"].nunique() == 2


def test_networks_that_are_not_trained_are_left_out(tmp_path):
    table = model_by_solver(1, (0,), tmp_path, models=["network of the paper", "multipole"], steps=3)
    assert set(table["model"]) == {"multipole"}


def test_published_ring_needs_no_other_call(tmp_path):
    table = model_by_solver(1, (0,), tmp_path, models=["multipole"], ring_name="published", steps=100)
    assert table["configuration_percent"].max() < 1.0  # step sizes follow the squared field


@pytest.mark.parametrize("change", [{"models": ["oracle"]}, {"solvers": ["Newton"]}])
def test_bad_input(tmp_path, change):
    (name,) = change
    with pytest.raises(InputError, match=f"Input {name} of model_by_solver must be among"):
        model_by_solver(1, (0,), tmp_path, **change)


def test_processes_keep_the_order_and_one_job_starts_none():
    tasks = [partial(pow, k, 2) for k in range(4)]
    assert in_processes(tasks, 2) == in_processes(tasks, 1) == [0, 1, 4, 9]
