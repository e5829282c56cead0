"""Methods and tables of the page on the twin that drifts: against made-up errors."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch

from edition1.estimation.base import Trajectory
from edition1_companion.book.studies import read_study
from edition1_companion.pages.forty_five_minutes import figures, tables
from edition1_companion.pages.forty_five_minutes.methods import (
    METHODS,
    Run,
    by_minute,
    judged,
)
from edition1_companion.pages.forty_five_minutes.twin import MINUTES, RATE_HZ, ROBOT, Sizes, draw_twin

HARD = replace(Sizes(), offset_mt=0.03, iron_a_m2=0.0)
"""Three times the wander of the offsets, so that six minutes show it."""


@pytest.fixture(scope="module")
def drifting():
    return draw_twin(101, minutes=6.0, sizes=HARD)


def test_an_error_is_the_distance_of_the_tip_and_counts_in_its_deviations(drifting):
    """The tip of a straight robot moves along z by an elongation, whose variance the three segments share."""
    truth = replace(drifting, q=torch.zeros(5, ROBOT.n_q, dtype=torch.float64))
    q, C = truth.q.clone(), 4e-12 * torch.eye(ROBOT.n_q, dtype=torch.float64).expand(5, -1, -1)
    q[:, 2] = 2e-6  # one segment is longer by one standard deviation
    flag = torch.zeros(5, 1, dtype=torch.bool)
    none = torch.empty(5, 1, 0, dtype=torch.float64)
    found = Trajectory(q=q[:, None], u_hat=none, covariance=C[:, None], diagnostics={"flag": flag})
    run = judged(found, [truth])
    np.testing.assert_allclose(run.tip_error_m, 2e-6, rtol=1e-9)
    np.testing.assert_allclose(run.nees, 1 / 3 / 3, rtol=1e-9)
    assert torch.equal(run.flag, flag)


def made_up(twin):
    """Tip errors of 1 and 2 % in turn, normalised errors that count up, a flag for ever."""
    n = len(twin.time_s)
    percent = torch.from_numpy(np.where(np.arange(n) % 2, 1.0, 2.0)).unsqueeze(-1)
    nees = torch.arange(n).double().unsqueeze(-1)
    return Run(percent / 100 * ROBOT.length, nees, torch.ones(n, 1, dtype=torch.bool))


def test_a_minute_is_a_root_of_a_mean_of_squares(drifting):
    table = by_minute(made_up(drifting), drifting, 0)
    assert table["minute"].tolist() == [1, 2, 3, 4, 5, 6]
    np.testing.assert_allclose(table["tip_rmse_percent"], 2.5**0.5)
    per_minute = 60 * RATE_HZ
    np.testing.assert_allclose(table["nees"], (per_minute - 1) / 2 + per_minute * np.arange(6))
    assert table["flag_iron_s"].sum() == table["iron_s"].sum() == Sizes().iron_s
    assert table["flag_else_s"].sum() == 6 * 60 - Sizes().iron_s - 15


def made_up_minutes():
    size = dict(zip(METHODS, (5.0, 4.0, 3.0, 1.2, 1.0), strict=True))
    rows = [
        (twin, m, minute, size[m] * (1 + twin) * (minute > 1), 0.5 + twin, 60.0 * (minute == 2), 6.0, 1.0)
        for twin in (0, 1)
        for m in METHODS
        for minute in (1, 2, 3)
    ]
    columns = ["twin", "method", "minute", "tip_rmse_percent", "nees", "iron_s", "flag_iron_s", "flag_else_s"]
    return pd.DataFrame(rows, columns=columns)


def test_tables_of_made_up_errors():
    minutes = made_up_minutes()
    twins = tables.by_twin(minutes, last=2)
    assert twins.columns.tolist() == ["twin", "method", "tip_rmse_percent", "nees"]
    np.testing.assert_allclose(twins.loc[twins["method"] == "fused", "tip_rmse_percent"], [3.0, 6.0])
    whole = tables.by_twin(minutes, last=3)
    np.testing.assert_allclose(whole["tip_rmse_percent"], twins["tip_rmse_percent"] * (2 / 3) ** 0.5)
    np.testing.assert_allclose(tables.drift_left(twins), 0.1)
    summary = tables.summary(twins).set_index("method").loc["oracle"]
    assert summary[["median_percent", "least_percent", "most_percent", "nees"]].tolist() == [
        1.5,
        1.0,
        2.0,
        1.0,
    ]
    assert (summary["nees_low"], summary["nees_high"]) == (0.5, 1.5)
    iron = tables.iron(minutes)
    np.testing.assert_allclose(iron["self_percent"], [1.2, 2.4])
    np.testing.assert_allclose(iron[["flag_s", "false_s"]], [[18.0, 3.0]] * 2)


def test_iron_is_drawn_as_in_its_table():
    learnt = pd.DataFrame([(k, kind, 1 / k) for k in (1, 2) for kind in figures.KINDS])
    learnt.columns = ["minute", "kind", "share"]
    iron = tables.iron(made_up_minutes())
    right = figures.learnt_and_iron(learnt, iron).axes[1]
    np.testing.assert_allclose(right.collections[0].get_offsets(), iron[["fused_percent", "self_percent"]])


def test_the_committed_twins_are_all_and_whole():
    table, _ = read_study("forty_five_minutes")
    counts = table.groupby(["twin", "method"]).size()
    assert set(counts.index) == {(twin, method) for twin in range(20) for method in METHODS}
    assert set(counts) == {int(MINUTES)}
    near = table[table["method"] == "oracle"].groupby("twin")["iron_s"].sum()
    np.testing.assert_allclose(near, Sizes().iron_s)


def test_without_the_minutes_of_iron_the_committed_twins_err_as_they_should():
    table, _ = read_study("forty_five_minutes")
    calm = tables.summary(tables.by_twin(table[table["iron_s"] == 0])).set_index("method")
    for method in ("self-calibrating", "oracle"):
        assert calm.loc[method, "nees_low"] < 1 < calm.loc[method, "nees_high"]
    near = tables.summary(tables.by_twin(table[table["iron_s"] > 0], last=45)).set_index("method")
    assert near.loc["oracle", "nees_low"] > calm.loc["oracle", "nees_high"]
