"""Hysteresis: closed forms, independence of the rate, and the two models against each other."""

import numpy as np
import pytest

from edition1_companion.twins.rig_motion import MODELS, STOPS, memory


def cycle(samples: int, amplitude: float = 1.0, turns: int = 4) -> np.ndarray:
    return amplitude * np.sin(2 * np.pi * np.linspace(0, turns, turns * samples + 1))


def loop_area(x: np.ndarray, y: np.ndarray) -> float:
    """Area between the way up and the way down of the last cycle."""
    return float(np.sum((np.roll(y, -1) + y) / 2 * (np.roll(x, -1) - x)))


@pytest.mark.parametrize("model", MODELS)
def test_stays_between_minus_one_and_one_and_gets_there(model):
    z = memory(np.r_[np.linspace(0, 50, 500), np.linspace(50, -50, 1000)], 2.0, model)
    assert np.abs(z).max() <= 1 + 1e-12
    assert z[499] == pytest.approx(1, abs=1e-9)
    assert z[-1] == pytest.approx(-1, abs=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_depends_on_the_path_and_not_on_the_rate(model):
    x = cycle(200)
    slow = np.interp(np.linspace(0, len(x) - 1, 10 * len(x) - 9), np.arange(len(x)), x)
    np.testing.assert_allclose(memory(slow, 0.7, model)[::10], memory(x, 0.7, model), atol=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_a_path_that_stands_still_remembers(model):
    x = np.r_[0.0, 1.0, np.full(50, 1.0)]
    z = memory(x, 3.0, model)
    assert (z[1:] == z[1]).all()


def test_bouc_wen_after_a_turn_is_an_exponential():
    x = np.r_[np.linspace(0, 40, 400), 40 - np.linspace(0, 3, 31)]
    z = memory(x, 1.5)[400:]
    np.testing.assert_allclose(z, -1 + 2 * np.exp(-np.linspace(0, 3, 31) / 1.5), atol=1e-9)


def test_prandtl_ishlinskii_loop_has_the_area_of_its_stops():
    # A stop of threshold r in a cycle of amplitude A > r encloses 4 r (A - r): a parallelogram.
    x = cycle(4000)
    z = memory(x, 0.6, "prandtl-ishlinskii")
    thresholds = 0.6 * np.arange(1, STOPS + 1) / STOPS
    expected = np.mean(4 * thresholds * (1 - thresholds) / thresholds)
    assert loop_area(x[-4000:], z[-4000:]) == pytest.approx(expected, rel=1e-3)


def test_prandtl_ishlinskii_is_elastic_below_the_smallest_threshold():
    x = cycle(100, amplitude=0.99 / STOPS)
    z = memory(x, 1.0, "prandtl-ishlinskii")
    slope = np.mean(STOPS / np.arange(1, STOPS + 1))
    np.testing.assert_allclose(z, slope * x, atol=1e-12)
    assert loop_area(x[-100:], z[-100:]) == pytest.approx(0, abs=1e-12)
