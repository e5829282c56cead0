"""The search for a lag between readings and motion capture."""

import numpy as np
import pytest

from repro import InputError
from repro_board.evaluate import search_lag


def motion(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    slow = np.cumsum(rng.normal(size=(n, 3)), axis=0)
    return (slow - slow.mean(0)) / slow.std(0)


def readings(q: np.ndarray) -> np.ndarray:
    x, y, z = q.T
    return np.stack([3 * x - y + 0.5 * x * y, y + z, 2 * z + 0.3 * x * x], axis=-1)


@pytest.mark.parametrize("lag", [-900, -37, 0, 5, 700])
def test_finds_any_lag_of_up_to_half_the_recording(lag):
    q = motion(4000)
    u = readings(q) + 0.01 * np.random.default_rng(1).normal(size=(4000, 3))
    a, b = (q[:-lag], u[lag:]) if lag > 0 else (q[-lag:], u[: 4000 + lag])
    found = search_lag(a, b, 40)
    assert found.lag_s == -lag / 40
    assert found.best == pytest.approx(0.01, rel=0.1)


def test_residuals_are_those_of_least_squares_over_what_both_have():
    q = motion(300)
    u = readings(q) + np.sin(np.arange(300))[:, None]
    q[20:25], u[100:103, 1] = np.nan, np.nan
    low, up = np.triu_indices(3)
    columns = np.column_stack([np.ones(300), q, q[:, low] * q[:, up]])
    both = np.isfinite(columns).all(1) & np.isfinite(u).all(1)
    left = u[both] - columns[both] @ np.linalg.lstsq(columns[both], u[both], rcond=None)[0]
    assert search_lag(q, u, 40).residual == pytest.approx(np.sqrt((left**2).mean()), rel=1e-5)


def test_gaps_of_motion_capture_do_not_end_it():
    q = motion(2000)
    u = readings(q)
    q[::50] = np.nan
    q[700:760] = np.nan
    assert search_lag(q[12:], u[:-12], 40).lag_s == 0.3


def test_a_motion_without_end_has_its_smallest_lag():
    t = np.arange(4000) / 40
    q = np.stack([np.sin(2 * np.pi * t / 5), np.cos(4 * np.pi * t / 5)], axis=-1)
    assert search_lag(q, q @ [[1.0, 2.0], [3.0, 1.0]], 40).lag_s == 0.0


@pytest.mark.parametrize(
    ("q", "u", "message"),
    [
        ((100, 2), (99, 2), "readings of search_lag must be one row for each of 100 poses"),
        ((79, 2), (79, 2), "motion of search_lag must be two seconds long or more; instead received 1.975 s"),
    ],
)
def test_what_cannot_be_compared_is_refused(q, u, message):
    with pytest.raises(InputError) as caught:
        search_lag(np.zeros(q), np.zeros(u), 40)
    assert message in str(caught.value)


def test_mostly_missing_poses_are_refused():
    q = motion(200)
    q[:120] = np.nan
    with pytest.raises(InputError, match="motion of search_lag must be there in most frames.*120 of 200"):
        search_lag(q, readings(motion(200)), 40)
