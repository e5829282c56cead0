"""Errors against the size of the training set: laws of least squares, networks that learn, one point of the paper."""

from pathlib import Path

import pytest
from edition1_companion.pages.noise_and_tolerances.data_size import COLUMNS, PAPER, data_size_errors
from edition1_companion.twins.table_1_method import DIPOLE

NETWORKS = Path(__file__).parents[4] / "data" / "networks"
FIVE = "5 moments"


def test_moments_improve_with_the_root_of_the_number_of_readings():
    """Variance of a prediction by p parameters from N readings: about p/N of that of the noise."""
    table = data_size_errors([30, 3000], range(4), NETWORKS, models=[FIVE], steps=20)
    few, many = table.groupby("configurations")["e_u_mt"].mean()
    assert few / many == pytest.approx(10, rel=0.5)
    assert few < 3 * 7.1e-4 * (5 / 90) ** 0.5


def test_without_noise_the_moments_are_exact_from_few_configurations():
    found = data_size_errors([10], [0], NETWORKS, models=[FIVE], noise_mt=0.0, steps=20).iloc[0]
    assert found["e_u_mt"] < 3e-6  # what order 9 leaves
    assert found["configuration_percent"] < 1e-3
    assert found["noisy_percent"] == found["configuration_percent"]


def test_three_moments_keep_an_error_that_data_do_not_remove():
    table = data_size_errors([300], [0], NETWORKS, models=["3 moments", FIVE], noise_mt=0.0, steps=20)
    three, five = table["e_u_mt"]
    assert three > 10 * five


def test_networks_learn_from_more_configurations():
    table = data_size_errors([10, 300], [0], NETWORKS, models=[DIPOLE], steps=20)
    few, many = table["e_u_mt"]
    assert many < few / 2
    assert list(table.columns) == COLUMNS


def test_networks_of_the_paper_are_one_point():
    table = data_size_errors([30], [0, 1], NETWORKS, models=[PAPER, FIVE], steps=20)
    paper = table[table["model"] == PAPER]
    assert paper["configurations"].tolist() == [120_000, 120_000]
    assert 0.003 < paper["e_u_mt"].mean() < 0.03  # published: 0.015 on all of T3
    assert data_size_errors([], [9], NETWORKS, models=[PAPER]).empty
