"""Errors in units of their covariance, shares within it and its quantiles: made-up cases whose answers are known."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import chi2

from edition1_companion.pages.fusion import study as fusion
from edition1_companion.pages.fusion import tables as fusion_tables
from edition1_companion.recordings.baaij2023 import Recording
from edition1_companion.twins.calibrated_robots import relative_error
from edition1_companion.twins.rig_bank import OursConfig
from edition1_companion.twins.rig_filter import filtered
from edition1_companion.twins.rig_map import fit_map
from edition1_companion.twins.segment_motion import ROBOT
from edition1_companion.twins.trajectories import lemniscate


def gaussian(covariance, n, seed=0):
    """Errors of this covariance, with their samples' own mean and covariance removed: exact to rounding."""
    C = np.atleast_2d(covariance)
    e = np.random.default_rng(seed).standard_normal((n, len(C)))
    e = np.linalg.solve(np.linalg.cholesky(np.cov(e.T, bias=True).reshape(C.shape)), (e - e.mean(0)).T).T
    return e @ np.linalg.cholesky(C).T


D_M = 22e-3 * math.pi / 4
"""Bending amplitude of T3, 17.28 mm: 45 degrees at a radius of 22 mm (Baaij et al. 2023, section 3.4)."""
SPREAD = np.array([[4.0, 1.0, 0.3], [1.0, 2.0, -0.5], [0.3, -0.5, 1.0]])
"""A covariance whose axes are not those of the coordinates."""


def test_relative_error_of_a_made_up_error():
    """Eq. (13) of Baaij et al. 2023: errors 3, 4 and 0 have a root mean square of sqrt(25/3); the range is 10."""
    truth = torch.tensor([[0.0], [10.0], [5.0]], dtype=torch.float64)
    found = truth + torch.tensor([[3.0], [-4.0], [0.0]], dtype=torch.float64)
    assert relative_error(found, truth).tolist() == pytest.approx([10 * math.sqrt(25 / 3)])
    batch = torch.stack([found, truth], dim=1)
    assert relative_error(batch, truth).flatten().tolist() == pytest.approx([10 * math.sqrt(25 / 3), 0.0])


@pytest.fixture(scope="module")
def columns():
    """Errors of a robot of one segment, bent, whose estimates scatter by tenths of a micrometre."""
    q = torch.tensor([6e-3, -4e-3, 3e-3], dtype=torch.float64)
    C, n = 1e-14 * SPREAD, 4000
    off = torch.from_numpy(gaussian(C, n)).reshape(n, 1, 1, 3)
    truth = ROBOT.tip(q).expand(n, 1, 1, 4, 4)
    found = fusion.Tracked(q + off, torch.from_numpy(C).expand(n, 1, 1, 3, 3))
    return fusion_tables._columns(found, truth)


class TestFusion:
    """Made-up estimates: a Gaussian of a known covariance about a bent robot, so small that the tip is linear."""

    def test_squared_errors_in_units_of_the_covariance_are_one(self, columns):
        """Of a position with three coordinates and of a direction with two coordinates."""
        assert float(columns["nees_tip"].mean()) == pytest.approx(1.0, abs=1e-3)
        assert float(columns["nees_direction"].mean()) == pytest.approx(1.0, abs=1e-3)

    def test_errors_are_as_large_as_predicted(self, columns):
        """The mean square of the distance and of the angle is the trace of their covariance."""
        for name in ("tip_mm", "orientation_deg"):
            size = float(columns[name].square().mean().sqrt())
            assert float(columns[f"predicted_{name}"][0]) == pytest.approx(size, rel=2e-3)

    def test_position_and_angle_have_their_units(self):
        """The straight robot 1 mm longer; and bent by 22 um, a turn of 1e-3 rad (its diameter d is 22 mm)."""
        truth = ROBOT.tip(torch.zeros(3, dtype=torch.float64)).expand(2, 1, 1, 4, 4)
        q = torch.tensor([[0.0, 0.0, 1e-3], [22e-6, 0.0, 0.0]], dtype=torch.float64).reshape(2, 1, 1, 3)
        C = torch.eye(3, dtype=torch.float64).expand(2, 1, 1, 3, 3)
        found = fusion_tables._columns(fusion.Tracked(q, C), truth)
        assert float(found["tip_mm"][0]) == pytest.approx(1.0)
        assert float(found["orientation_deg"][1]) == pytest.approx(math.degrees(1e-3), rel=1e-4)


class TestRig:
    def test_bend_of_recordings_of_another_shape_scatters_as_its_covariance_says(self):
        """Readings linear in the bend, by slopes J, each sensor off by a normal 5 mV that stays for the recording.

        Least squares turns that into a spread of 25 (J^T J)^-1 mV^2; the prior of the bend takes a few per cent of
        it away. Squared errors in units of the covariance are 1 then, with a deviation of 0.07 over 200 recordings.
        """
        g, slopes = (
            np.random.default_rng(0),
            np.array([[-5300.0, 900.0, -4300.0], [-3000.0, -2800.0, -1200.0]]),
        )

        def recorded(bend, off):
            """Readings with noise of 0.5 mV, the elongation known to be constant."""
            q = np.column_stack([bend, 4.5e-3 + 1e-9 * g.standard_normal(len(bend))])
            u = [1282.0, 1205.0, 1387.0] + bend @ slopes + off
            return Recording("toy", np.arange(len(q)), q, u + 0.5 * g.standard_normal(u.shape))

        phi = np.linspace(0, 60, 4000)
        path = 8e-3 * np.sqrt(phi / 60)[:, None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
        bend_map = fit_map(recorded(path, 0.0), degree=1)
        # No bias that is common: its prior is 10 uV wide.
        config = OursConfig(bias_mv=0.01, widest_mv=0.02, step_mv=0.01, shape_mv=5.0)
        squares, bend = [], path[2000:2040]
        for _ in range(200):
            run = filtered(bend_map, recorded(bend, 5.0 * g.standard_normal(3)).u, config)
            error = run.q[-1, :2].numpy() - bend[-1]
            squares.append(error @ np.linalg.solve(run.covariance[-1, :2, :2].numpy(), error))
        assert np.mean(squares) / 2 == pytest.approx(1.0, abs=0.25)
        assert np.mean(np.array(squares) < chi2.ppf(0.95, 2)) == pytest.approx(0.95, abs=0.05)


def test_lemniscate_has_the_range_that_the_tables_divide_by():
    """D either way and 0 to 5.5 mm (section 3.4), but for the steps beside the highest points."""
    q = lemniscate(1)
    span = (q.amax(0) - q.amin(0)).tolist()
    assert span == pytest.approx([2 * D_M, 2 * D_M, 5.5e-3], rel=2e-4)
