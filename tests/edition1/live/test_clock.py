"""The board's clock against the host's, on simulated arrivals whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from edition1.errors import InputError
from edition1_live.record.clock import MOST_CORNERS, DeviceClock
from edition1_live.wire.frame import WRAP

START_NS = 5_000_000_000_000


def arrivals(
    seed: int, seconds: float, *, rate_hz: float = 100.0, ppm: float = 50.0, first_us: float = 1.2e6
):
    """Device time [us], true host time and arrival [ns]: exponential latency of 2 ms, then batches of 1 ms."""
    rng = np.random.default_rng(seed)
    device_us = first_us + np.arange(int(seconds * rate_hz)) / rate_hz * 1e6
    true_s = (device_us - first_us) * 1e-6 / (1 + 1e-6 * ppm) + rng.uniform(0, 1 / rate_hz)
    arrived_s = np.ceil((true_s + rng.exponential(2e-3, true_s.shape)) / 1e-3) * 1e-3
    arrived_ns = np.round(np.maximum.accumulate(arrived_s) * 1e9).astype(np.int64)
    return device_us, START_NS + true_s * 1e9, START_NS + arrived_ns


def sent(device_us: np.ndarray) -> np.ndarray:
    return np.floor(device_us).astype(np.int64) % WRAP


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("ppm", [-200.0, 7.0, 50.0])
def test_drift_within_2_ppm_after_10_minutes(seed, ppm):
    device_us, true_ns, host_ns = arrivals(seed, 600.0, ppm=ppm)
    clock = DeviceClock()
    for first in range(0, len(host_ns), 997):  # in chunks, as they come
        clock.add(host_ns[first : first + 997], sent(device_us[first : first + 997]))
    fit = clock.fit()
    assert abs(fit.drift_ppm - ppm) < 2.0
    assert abs(fit.drift_ppm - ppm) < 5 * fit.drift_error_ppm < 2.0
    # The offset is late by the smallest latency: never early but for the last digit, and by less than a batch.
    late_us = (fit.host_ns - np.interp(fit.device_us, device_us, true_ns)) / 1e3
    assert -1.0 < late_us < 100.0
    # Times by the fit are far better than arrivals.
    error_ms = (fit.host_s(device_us) - 1e-9 * true_ns) * 1e3
    assert np.abs(error_ms).max() < 0.2
    assert np.std(host_ns - true_ns) / 1e6 > 1.5


def test_after_one_minute_the_stated_error_holds_the_true_one():
    errors = []
    for seed in range(20):
        device_us, _, host_ns = arrivals(seed, 60.0)
        clock = DeviceClock()
        clock.add(host_ns, sent(device_us))
        fit = clock.fit()
        errors.append(abs(fit.drift_ppm - 50.0) / fit.drift_error_ppm)
    assert np.mean(np.array(errors) < 1.0) > 0.6
    assert max(errors) < 5.0


def test_chunks_do_not_matter():
    device_us, _, host_ns = arrivals(3, 60.0)
    whole, pieces = DeviceClock(), DeviceClock()
    unwrapped, _ = whole.add(host_ns, sent(device_us))
    for first in range(0, len(host_ns), 13):
        part = slice(first, first + 13)
        np.testing.assert_array_equal(pieces.add(host_ns[part], sent(device_us[part]))[0], unwrapped[part])
    a, b = whole.fit(), pieces.fit()
    # A chunk's last frame may be followed by another that arrived at its time: that changes the parts only.
    assert a.drift_ppm == pytest.approx(b.drift_ppm, abs=1e-6)
    middle = np.array([30e6])
    assert abs(a.host_s(middle) - b.host_s(middle)) < 1e-6


def test_exact_arrivals_give_the_exact_line():
    device_us = np.arange(0, 100_000_000, 10_000)
    clock = DeviceClock()
    clock.add(START_NS + 1000 * device_us, device_us)
    fit = clock.fit()
    assert fit.drift_ppm == 0.0
    assert fit.host_ns - 1000 * fit.device_us == START_NS


@pytest.mark.parametrize("rate_hz", [0.0004, 0.01, 100.0])
def test_wraps_are_unwrapped_at_any_rate(rate_hz):
    """Even one frame in 42 minutes, and pauses of several wraps."""
    n = 3000 if rate_hz == 100.0 else 60
    device_us = WRAP - 5e6 + np.arange(n) / rate_hz * 1e6
    device_us[n // 2 :] += 3 * WRAP
    host_ns = (START_NS + 1000 * (device_us - device_us[0]) / (1 + 30e-6)).astype(np.int64)
    clock = DeviceClock()
    unwrapped, restarted = clock.add(host_ns, sent(device_us))
    np.testing.assert_array_equal(unwrapped, np.floor(device_us).astype(np.int64))
    assert not restarted.any()
    assert clock.restarts == 0


@pytest.mark.parametrize("uptime_s", [0.3, 3.0, 1000.0, 3000.0, 4290.0, 6000.0])
@pytest.mark.parametrize("away_s", [0.05, 0.5])
def test_a_reboot_begins_anew(uptime_s, away_s):
    """The board starts again from 0; before it is heard again passes the time of its start."""
    before = np.arange(0.0, uptime_s, 0.1) * 1e6
    after = np.arange(0.02, 5.0, 0.01) * 1e6
    host_ns = np.concatenate([before, uptime_s * 1e6 + away_s * 1e6 + after]) * 1000
    clock = DeviceClock()
    unwrapped, restarted = clock.add(
        START_NS + host_ns.astype(np.int64), sent(np.concatenate([before, after]))
    )
    assert np.flatnonzero(restarted).tolist() == [len(before)]
    np.testing.assert_array_equal(unwrapped[len(before) :], np.floor(after).astype(np.int64))
    assert clock.fit().restarts == 1
    assert clock.fit().span_s == pytest.approx(4.98, abs=0.011)


def test_a_reboot_longer_than_the_uptime_is_seen_after_a_reopened_port():
    before, after = np.arange(0, 2_000_000, 10_000), np.arange(3_000_000, 5_000_000, 10_000)
    clock = DeviceClock()
    clock.add(START_NS + 1000 * before, before)
    clock.reopened()
    _, restarted = clock.add(START_NS + 1000 * (after + 60_000_000), after)
    assert restarted.tolist() == [True] + [False] * (len(after) - 1)


def test_a_stalled_host_is_no_reboot():
    """Frames of 8 s come at once out of a buffer; the line ignores them."""
    device_us = np.arange(0, 60_000_000, 10_000)
    host_ns = START_NS + 1000 * device_us
    stalled = (device_us > 20_000_000) & (device_us < 28_000_000)
    host_ns[stalled] = START_NS + 28_000_000_000
    clock = DeviceClock()
    _, restarted = clock.add(host_ns, device_us)
    assert not restarted.any()
    assert clock.fit().drift_ppm == pytest.approx(0.0, abs=1e-9)


def test_memory_is_bounded_even_where_every_point_is_a_corner():
    device_us = np.arange(0, 400_000_000, 10_000)
    bent = 1e-5 * (device_us * 1e-6) ** 2 * 1e9  # a clock that drifts more and more
    clock = DeviceClock()
    for first in range(0, len(device_us), 100):
        part = slice(first, first + 100)
        clock.add(START_NS + (1000 * device_us[part] + bent[part]).astype(np.int64), device_us[part])
    assert len(clock._line.corners) <= MOST_CORNERS + 100
    # The tangent in the middle: 2e-5/s times 200 s, less what a thinned hull costs.
    assert clock.fit().drift_ppm == pytest.approx(-4000.0, rel=0.03)


def test_nothing_is_claimed_from_too_little():
    clock = DeviceClock()
    assert clock.fit() is None
    clock.add(START_NS, np.array([5]))
    assert clock.fit() is None
    clock.add(START_NS + 1_000_000_000, np.array([1_000_005]))
    assert np.isnan(clock.fit().drift_ppm)
    with pytest.raises(InputError, match="device_us of DeviceClock must be 32 bits without sign"):
        clock.add(START_NS, np.array([WRAP]))
