"""Errors of poses with known answers."""

import math

import pytest
import torch

from edition1.kinematics.paper_robots import pcc_robot
from edition1_companion.book.pose_errors import pose_errors


def test_pure_elongation_moves_the_tip_and_turns_nothing():
    q = torch.zeros(4, 3, dtype=torch.float64)
    q_hat = q.clone()
    q_hat[:, 2] = 0.003
    errors = pose_errors(pcc_robot(1), q_hat, q)
    assert float(errors["tip_mm"]) == pytest.approx(3.0)
    assert float(errors["orientation_deg"]) == 0
    assert float(errors["shape_mm"]) == pytest.approx(
        3.0 / math.sqrt(3), rel=0.02
    )  # grows linearly from the base


def test_orientation_error_is_the_bending_angle():
    q_hat = torch.tensor([[0.022 * 0.1, 0.0, 0.0]], dtype=torch.float64)
    errors = pose_errors(pcc_robot(1), q_hat, torch.zeros_like(q_hat))
    assert float(errors["orientation_deg"]) == pytest.approx(math.degrees(0.1))


def test_root_mean_square_over_time_and_batches():
    q = torch.zeros(2, 1, 3, dtype=torch.float64)
    q_hat = torch.zeros(2, 5, 3, dtype=torch.float64)
    q_hat[0, :, 2], q_hat[1, :, 2] = 0.003, 0.004
    assert pose_errors(pcc_robot(1), q_hat, q)["tip_mm"].tolist() == pytest.approx([math.sqrt(12.5)] * 5)
