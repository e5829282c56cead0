"""Table 1's training with one factor changed at a time."""

from functools import partial

import pytest
import torch
from edition1.sensing.weights import load_paper_network
from edition1_companion.pages.table_1 import training as table1_factors
from edition1_companion.pages.table_1.training import NEW_ORDER, OTHER_DRAWS, factor_errors
from edition1_companion.twins.networks import DATA_SEED, NetworkSpec, training_rows


@pytest.fixture
def short(monkeypatch):
    """Two epochs on few rows; the options and readings of every training."""
    seen, train = [], table1_factors.train_together

    def together(sets, **options):
        seen.append((options, sets[0][1]))
        return train(sets, epochs=2, swa_start=1, **options)

    monkeypatch.setattr(table1_factors, "train_together", together)
    monkeypatch.setattr(table1_factors, "training_rows", partial(training_rows, samples=600))
    return seen


def test_each_factor_changes_what_it_says_and_nothing_else(short, tmp_path):
    robots = {NEW_ORDER: [1], OTHER_DRAWS: [1]}
    table = factor_errors(robots, [0, 2], tmp_path)
    assert table.groupby(["factor", "seed"], sort=False).size().nunique() == 1
    assert table["factor"].unique().tolist() == [NEW_ORDER, OTHER_DRAWS]
    assert [options["shuffled"] for options, _ in short] == [True, True, False, False]
    assert [options["seed"] for options, _ in short] == [0, 2, 0, 2]
    for (_, u), data_seed in zip(short, [DATA_SEED] * 2 + [DATA_SEED + 1] * 2, strict=True):
        expected = training_rows(1, 0, earth=False, samples=600, data_seed=data_seed)[1]
        assert torch.equal(u, expected)
    assert not torch.equal(short[0][1], short[-1][1])
    again = factor_errors(robots, [0, 2], tmp_path)
    assert len(short) == 4  # nothing was trained a second time
    assert again.equals(table)


def test_networks_are_those_of_the_spec(short, tmp_path):
    table1_factors.train_factor(NEW_ORDER, 2, 1, tmp_path)
    for segment in (0, 1):
        load_paper_network(tmp_path / f"{NetworkSpec(2, segment, False, 1).name}.safetensors")
