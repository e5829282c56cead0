"""Magnets and IMUs in one filter: models against each other, consistency where the model is true, and tables."""

import numpy as np
import pandas as pd
import pytest
import torch
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1.kinematics.mounts import magnet_mounts
from edition1.kinematics.paper_robots import Dimensions
from edition1_companion.pages.fusion.models import Imus, Magnets
from edition1_companion.pages.fusion.study import SETTINGS, record
from edition1_companion.pages.fusion.tables import errors_by_step, judged, mean_errors, ratio_to_better_single
from edition1_companion.twins.segment_motion import ROBOT, TRAJECTORIES, motion


def states(n, seed=0):
    scale = torch.tensor([0.01, 0.01, 0.002] + [0.1] * 9 + [0.04] * 3, dtype=torch.float64)
    return scale * torch.randn(n, 15, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("model", [Magnets(True), Magnets(False), Imus(False), Imus(True)])
def test_derivatives_against_differences(model):
    x, h = states(3), 1e-6
    J = model.linearise(x)[1]
    for k in range(x.shape[-1]):
        step = h * torch.eye(15, dtype=torch.float64)[k]
        slope = (model(x + step) - model(x - step)) / (2 * h)
        torch.testing.assert_close(J[..., k], slope, atol=1e-7, rtol=1e-7)


def test_the_imus_are_those_of_the_robot_with_errors_on_both_sides():
    """By the kinematics of the robot and SciPy: log(exp(left) R_base^T R_tip exp(right))."""
    x = states(5)
    R = ROBOT.mount_poses(x[:, :3], magnet_mounts([0, 0], [0.0, Dimensions.LENGTH_M]))[..., :3, :3]
    base, tip = (Rotation.from_matrix(R[:, k].numpy()) for k in (0, 1))
    left, right = (Rotation.from_rotvec(e.numpy()) for e in (x[:, 3:6] + x[:, 6:9], x[:, 9:12]))
    expected = (left * base.inv() * tip * right).as_rotvec()
    np.testing.assert_allclose(Imus(False)(x), expected, atol=1e-13, rtol=0)


def test_readings_without_errors_are_those_of_the_models():
    """The last draw: magpylib against the multipole series, the rotation vector against the bending."""
    moved = motion(TRAJECTORIES[0], steps=8)
    found = record([moved], [0], SETTINGS[2])
    assert moved.q is not None
    q = torch.nn.functional.pad(moved.q, (0, 12))
    torch.testing.assert_close(found.magnets[1:, 0, -1], Magnets(True)(q), atol=3e-5, rtol=0)
    torch.testing.assert_close(found.turns[1:, 0, -1], Imus(False)(q), atol=1e-12, rtol=0)
    again = record([moved], [0], SETTINGS[2])
    assert torch.equal(found.magnets, again.magnets)
    assert torch.equal(found.turns, again.turns)


@pytest.fixture(scope="module")
def table():
    moved = judged(40)[:1]
    return errors_by_step(moved, range(10), settings=SETTINGS[1:2])


def test_covariance_is_consistent_and_both_win_as_predicted(table):
    found = mean_errors(table).set_index("method")
    assert np.isnan(found.loc["IMUs", "nees_tip"])
    for kind in ("direction", "tip"):
        part = found.loc[["magnets", "both"]]
        assert bool((part[f"nees_{kind}"] > part[f"low_{kind}"]).all())
        assert bool((part[f"nees_{kind}"] < part[f"high_{kind}"]).all())
    won = ratio_to_better_single(table).set_index("quantity")
    assert list(won["single"]) == ["magnets", "magnets"]
    assert bool((won["high"] < 1).all())
    assert bool((won["predicted"] < 1).all())
    assert won.loc["tip_mm", "ratio"] == pytest.approx(won.loc["tip_mm", "predicted"], rel=0.25)


def test_band_and_ratio_of_a_table_made_by_hand():
    lines = [
        {"setting": "s", "trajectory": "t", "method": m, "seed": seed, "time_s": 0.0}
        | {"tip_mm": e, "orientation_deg": e, "nees_tip": 1.0, "nees_direction": 9.0}
        | {"predicted_tip_mm": e, "predicted_orientation_deg": e}
        for m, e in (("magnets", 2.0), ("IMUs", 3.0), ("both", 1.0))
        for seed in range(10)
    ]
    table = pd.DataFrame(lines)
    found = mean_errors(table)
    np.testing.assert_allclose(
        found[["low_direction", "high_direction"]].iloc[0], [0.4795, 1.7085], atol=1e-4
    )
    assert list(found["inside_tip_percent"]) == [100.0] * 3
    assert list(found["inside_direction_percent"]) == [0.0] * 3
    won = ratio_to_better_single(table).iloc[0]
    assert (won["single"], won["ratio"], won["low"], won["high"], won["predicted"]) == (
        "magnets",
        0.5,
        0.5,
        0.5,
        0.5,
    )


def test_bad_input():
    with pytest.raises(InputError, match="draws of record must be at least 1; instead received 0."):
        record([motion(TRAJECTORIES[0], steps=3)], [], SETTINGS[0])
