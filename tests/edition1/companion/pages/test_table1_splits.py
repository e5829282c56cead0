"""What a seed is: by hand on made-up manifests and errors."""

import json

import numpy as np
import pandas as pd
import pytest

from edition1_companion.pages.table_1.training import RELEASED_MT, orders_table, parts_of_errors, splits_table
from edition1_companion.twins.networks import NetworkSpec


def test_splits_by_seed(tmp_path):
    for n, segment in RELEASED_MT:
        for seed in (0, 1, 7):
            path = tmp_path / f"{NetworkSpec(n, segment, earth=False, seed=seed).name}.safetensors"
            path.touch()
            error = 0.01 * n + 0.001 * seed * (1 if segment == 0 else -1)
            path.with_suffix(".json").write_text(json.dumps({"metrics_mt": {"rmse_train": error}}))
    table = splits_table(tmp_path, (0, 1, 7))
    assert len(table) == 18
    worst = table[table["worst"]].set_index(["n_b", "segment"])["seed"].to_dict()
    assert worst == {(1, 1): 7, (2, 1): 7, (2, 2): 0, (3, 1): 7, (3, 2): 0, (3, 3): 0}
    first = table[(table["n_b"] == 2) & (table["segment"] == 2)]
    assert first["rmse_mt"].tolist() == pytest.approx([0.02, 0.019, 0.013])
    assert first["released_mt"].tolist()[:2] == [0.0140, 0.0209]
    assert first["released_mt"].isna().tolist() == [False, False, True]


def test_seed_one_is_the_worst_of_all_released_networks():
    assert all(max(errors) == errors[1] for errors in RELEASED_MT.values())


def test_errors_are_taken_apart_into_what_sensors_share_and_what_they_do_not():
    """Three sensors off by 1 mT and by sqrt(2) sin(t), and by 0.3 (-1, 0, 1): squares 1, 1 and 0.06."""
    t = np.arange(400) * np.pi / 200
    error = 1.0 + np.sqrt(2.0) * np.sin(t)[:, None] + 0.3 * np.array([-1.0, 0.0, 1.0])
    parts = parts_of_errors(error)
    assert parts == pytest.approx({"offset_mt": 1.0, "shared_mt": 1.0, "between_mt": 0.3 * np.sqrt(2 / 3)})
    assert sum(x**2 for x in parts.values()) == pytest.approx((error**2).mean())


def test_orders_are_means_over_the_seeds_of_each():
    cell = {"row": "n_b=1", "quantity": "dx_1", "unit": "%"}
    errors = pd.DataFrame([cell | {"seed": k, "error": e} for k, e in enumerate((1.0, 2.0))])
    shuffled = pd.DataFrame([cell | {"seed": 0, "error": 0.5}])
    published = pd.DataFrame([cell | {"published": 3.0}, cell | {"row": "n_b=2", "published": 1.0}])
    table = orders_table(errors, shuffled, published)
    assert table.to_dict("records") == [cell | {"published": 3.0, "one_order": 1.5, "shuffled": 0.5}]
