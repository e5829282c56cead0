"""Estimates on T0 to T5 that do not explain their readings are doubted, others are not."""

import numpy as np
import pytest

from edition1_companion.pages.table_2.reliability import decrease_of_chi2, doubted
from edition1_companion.twins.rig_map import BendMap

RNG = np.random.default_rng(0)
MAP = BendMap(
    degree=2,
    factors=np.array(
        [[0, 0, 0], [300, -150, -150], [0, 260, -260], [20, 15, 10], [5, -20, 10], [10, 5, 20]], float
    ),
    noise_mv=np.full(3, 0.2),
    error_mv=np.full(3, 2.0),
    error_s=1.0,
    acceleration=1.0,
    rate=1.0,
    mean_mm=np.zeros(2),
    spread_mm=np.full(2, 3.0),
    elongation_mm=np.zeros(2),
    elongation_spread_mm=3.0,
    lower=np.full(2, -9.0),
    upper=np.full(2, 9.0),
    starts=RNG.uniform(-8, 8, (40, 2)),
    elongation_slope=1.0,
)
BEND = RNG.uniform(-6, 6, (200, 2))


def test_the_truth_is_not_doubted_with_noise_and_a_common_bias():
    readings = MAP(BEND) + 3.0 + 2.0 * RNG.standard_normal((200, 3))
    decrease = decrease_of_chi2(MAP, readings, BEND)
    # two coordinates are free elsewhere: chi-square of two degrees of freedom
    assert decrease.mean() == pytest.approx(2.0, abs=0.6)
    assert not doubted(decrease).any()


def test_a_bend_that_is_off_is_doubted_after_a_second():
    readings = MAP(BEND)
    off = BEND.copy()
    off[100:] += 3.0
    found = doubted(decrease_of_chi2(MAP, readings, off))
    assert not found[:140].any()
    assert found[141:].all()


def test_a_bias_that_all_sensors_share_is_no_doubt():
    """8 mV is two standard deviations of its prior: chi-square grows by four at most."""
    assert decrease_of_chi2(MAP, MAP(BEND) + 8.0, BEND).max() < 4.5
