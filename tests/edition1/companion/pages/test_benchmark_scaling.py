"""How the cost grows: exponents of known power laws."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from edition1_companion.pages.performance.rows import COLUMNS
from edition1_companion.pages.performance.tables import exponent, exponents

from bench.scaling import Curve, curves, exponent_rows, scaling

DATA = Path(__file__).parents[4] / "data"


def test_only_the_largest_decade_counts():
    size = np.array([1.0, 3.0, 10.0, 30.0, 100.0])
    cost = 2e-6 * size**1.3
    cost[:2] = 1.0  # what a call costs before it has done anything
    assert exponent(size, cost) == pytest.approx((1.3, 0.0), abs=1e-12)
    cost[3] *= 1.21
    found, deviation = exponent(size, cost)
    assert found == pytest.approx(1.3, abs=0.01)
    assert 0.05 < deviation < 0.21


def test_rows_of_exponents():
    size = np.array([10.0, 30.0, 100.0])
    laws = (("samples", 1.0), ("particles", 1.2), ("segments", 1.9))
    points = pd.concat(
        pd.DataFrame({"capability": "c", "against": against, "size": size, "seconds": size**power})
        for against, power in laws
    )
    assert exponents(points)["exponent"].tolist() == pytest.approx([1.0, 1.2, 1.9])
    rows = list(exponent_rows(points))
    assert [tuple(line) for line in rows] == [COLUMNS] * 3
    assert [line["met"] for line in rows] == [True, False, None]
    assert [line["target"] for line in rows] == [1.1, 1.1, None]


def test_work_of_every_curve_runs_at_its_smallest_setting():
    for curve in curves():
        assert curve.prepare(curve.settings[0])() == 1
    assert {name for curve in curves() for name in curve.sizes} == {
        "samples", "particles", "segments", "sensors", "sensor-magnet pairs",
    }  # fmt: skip


def test_points_for_every_size_of_a_setting():
    curve = Curve("c", (1, 2), {"a": int, "b": lambda n: 9 * n}, lambda n: lambda: bool(sum(range(1000 * n))))
    points = scaling([curve])
    assert points["against"].tolist() == ["a", "a", "b", "b"]
    assert points["size"].tolist() == [1, 2, 9, 18]
    assert points["seconds"].tolist()[:2] == points["seconds"].tolist()[2:]
    assert (points["seconds"] > 0).all()


def test_committed_points_belong_to_the_committed_exponents():
    table, points = (pd.read_csv(DATA / f"{name}.csv") for name in ("benchmark", "benchmark_scaling"))
    lines = table[table["kind"] == "scaling"]
    np.testing.assert_allclose(lines["ours"], exponents(points)["exponent"], atol=2e-3)
