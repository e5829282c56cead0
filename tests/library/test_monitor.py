"""The monitor: what it says of sensors that fail, and what it leaves alone. All readings are synthetic."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import repro
from repro import (
    Drift,
    Drifting,
    GradientDescent,
    KalmanFilter,
    LevenbergMarquardt,
    Robot,
    Sensor,
    example,
    load_robot,
    simulated_readings,
    smooth,
    track,
)
from repro.estimators.base import CallableModel
from repro.estimators.monitor import STATUS, Monitor, limit
from repro.estimators.rod import Rod, RodFilter, RodSensor
from repro_board.emulate import course, faulty

TWO = load_robot(Path(__file__).parents[2] / "data" / "robots" / "two_segments.toml")
CHIPS = load_robot(example() / "robot.toml")
METHODS = {"least squares": LevenbergMarquardt(TWO), "Kalman": KalmanFilter(TWO)}
RATE = 100.0


def moving(robot=TWO, rows=200, seed=7, rate=RATE):
    """Times, configurations and readings of a robot that moves."""
    times = np.arange(rows) / rate
    q = course(robot, times, seed=seed)
    u = simulated_readings(robot, q, robot.earth)
    return times, q, u + robot.noise * np.random.default_rng(seed).normal(size=u.shape)


TIMES, Q, U = moving()


@pytest.fixture(params=METHODS)
def method(request):
    return METHODS[request.param]


@pytest.mark.parametrize("x", [18.4, 4.6])
def test_the_bound_is_above_the_quantile_and_not_far(x):
    dof = np.array([1, 2, 5, 20, 100, 1000])
    quantile = stats.chi2.isf(np.exp(-x), dof)
    assert (limit(dof, x) > quantile).all()
    assert (limit(dof, x) < 2.5 * quantile).all()


def test_nothing_is_said_of_good_readings_and_nothing_changes(method):
    found, bare = (track(method, U, times=TIMES, monitor=m) for m in ("auto", None))
    assert set(found.status) == {"consistent"}
    assert not found.suspects.any()
    for name in ("q", "covariance", "u_hat", "chi2", "missing"):
        np.testing.assert_array_equal(getattr(found, name), getattr(bare, name))
    assert bare.status is bare.suspects is None
    assert len(repr(found).splitlines()) == 3


def test_sixty_thousand_good_rows_give_no_alarm():
    A = np.random.default_rng(0).normal(size=(7, 3))
    fit = LevenbergMarquardt(lambda q: q @ A.T, [-9.0] * 3, [9.0] * 3, noise=0.1)
    u = 0.1 * np.random.default_rng(1).normal(size=(300, 200, 7))
    assert set(track(fit, u, np.zeros(3)).status.ravel()) == {"consistent"}


LINE = np.linalg.qr(np.random.default_rng(0).normal(size=(7, 7)))[0]


def followed(squares):
    """A linear model of three coordinates and seven readings, whose chi-square is as given, row by row."""
    fit = LevenbergMarquardt(lambda q: q @ LINE[:, :3].T, [-9.0] * 3, [9.0] * 3, noise=1.0)
    q = np.sin(np.arange(len(squares))[:, None] / 9 + np.arange(3))
    return track(fit, q @ LINE[:, :3].T + np.sqrt(squares)[:, None] * LINE[:, 3], np.zeros(3))


def test_a_row_gives_an_alarm_just_above_the_bound_of_once_in_a_hundred_million():
    bound = 4 + 2 * np.sqrt(4 * np.log(1e8)) + 2 * np.log(1e8)
    assert list(followed(np.array([0.99 * bound])).status) == ["consistent"]
    assert list(followed(np.array([1.01 * bound])).status) == ["inconsistent"]


@pytest.mark.parametrize(("before", "then"), [(1.6, 1.6), (2.2, 2.2), (0.9, 4.0)])
def test_small_errors_that_last_give_an_alarm_when_sums_over_ten_or_a_hundred_rows_say_so(before, then):
    squares = 4 * np.repeat([before, then], [300, 60])
    above = np.zeros(360, dtype=bool)
    for rows in (10, 100):
        weights = (1 - 1 / rows) ** np.arange(360.0)
        chi2, dof = (np.convolve(x, weights)[:360] for x in (squares, np.full(360, 4.0)))
        above |= chi2 > limit(dof, 18.4)
    assert np.argmax(followed(squares).status == "inconsistent") == np.argmax(above) > 0


def test_the_covariance_grows_by_small_errors_that_last():
    found = followed(np.full(400, 4 * 2.2))
    assert set(found.status[100:]) == {"inconsistent"}
    np.testing.assert_allclose(found.details["growth"][100:], 2.2, rtol=0.01)


def test_the_covariance_grows_by_what_is_not_decided():
    """Two readings of a coordinate contradict each other, so it may be where either of them says."""
    A = np.array([[1.0, 0], [1, 0], [0, 1], [0, 1], [0, 1]])
    fit = LevenbergMarquardt(lambda q: q @ A.T, [-9.0] * 2, [9.0] * 2, noise=0.01)
    u = np.sin(np.arange(80) / 9 + np.arange(2)[:, None]).T @ A.T
    u[20:, 0] += 1.0
    found = track(fit, u, np.zeros(2))
    assert not found.suspects[:, 2:].any()
    std = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))[30:]
    np.testing.assert_allclose(std[:, 0], np.sqrt(0.5), rtol=0.01)  # none, or a whole unit, from where it is
    assert (std[:, 1] < 0.01).all()


def test_what_is_left_out_does_not_change_with_the_noise():
    """Two readings contradict each other, and a third one hardly tells which of them is right."""
    A = np.array([[1.0, 0], [1, 0], [0.005, 0], [0, 1], [0, 1], [0, 1]])
    fit = LevenbergMarquardt(lambda q: q @ A.T, [-9.0] * 2, [9.0] * 2, noise=0.01)
    u = np.sin(np.arange(160) / 9 + np.arange(2)[:, None]).T @ A.T
    u += 0.01 * np.random.default_rng(0).normal(size=u.shape)
    u[20:, :2] += [0.5, -0.5]
    left = track(fit, u, np.zeros(2)).details["left_out"][24:]
    assert left[0].sum() == 1
    assert (left == left[0]).all()


def test_what_is_not_decided_of_an_angle_goes_the_shorter_way_round():
    def readings(q):
        return np.concatenate([10 * np.sin(q), 10 * np.sin(q), np.cos(q), np.cos(q)], axis=-1)

    turning: Any = CallableModel(readings, np.zeros(1), np.ones(1), "turning")
    turning.rotations, turning.n_q = ((0,),), 1
    fit = LevenbergMarquardt(turning, [-np.pi], [np.pi], noise=0.01)
    angle = np.pi - 0.02 + 1e-3 * np.sin(np.arange(40.0))[:, None]
    u = turning(angle)
    u[20:, 0] = -u[20:, 0]
    found = track(fit, u, [3.1])
    assert "inconsistent" in found.status[20:]
    assert (np.sqrt(found.covariance[20:, 0, 0]) < 0.1).all()


def test_a_robot_that_rests_at_a_bound_is_as_certain_as_without_a_monitor():
    """Noise takes half of the rows beyond the bound; only one in twenty fits so badly that the bound is doubted."""
    fit = LevenbergMarquardt(lambda q: q * np.ones(4), [-1.0], [1.0], noise=0.001)
    u = 1 + 0.001 * np.random.default_rng(0).normal(size=(400, 4))
    found, bare = (track(fit, u, monitor=monitor) for monitor in ("auto", None))
    assert found.details["at_bound"].mean() > 0.4
    assert (found.covariance == bare.covariance).mean() > 0.9


def test_a_slow_drift_is_named_and_its_alarm_ends_with_it(method):
    """2 uT/s: five seconds after it has passed ten standard deviations the sensor has long been named."""
    times, _, u = moving(rows=1050)
    passed = 20 + int(10 * TWO.noise[6] / 2e-5)
    u[20:920, 6] += 2e-5 * np.arange(900)
    found = track(method, u, times=times)
    alarm = np.flatnonzero(found.status != "consistent")
    assert 20 < alarm[0] < passed
    assert {tuple(np.flatnonzero(row)) for row in found.suspects if row.any()} == {(6,)}
    assert found.suspects[passed + 500 : 920, 6].all()
    assert alarm[-1] < 920 + 100


@pytest.mark.parametrize(("since", "named"), [(0, set()), (60, {(6,)})])
def test_a_small_error_names_a_sensor_only_if_the_readings_fitted_before(since, named):
    """An error that is there from the start may be one of the model."""
    times, _, u = moving(rows=400)
    u[since:, 6] += 0.012
    found = track(METHODS["least squares"], u, times=times)
    assert (found.status[since + 10 :] != "consistent").mean() > 0.9
    assert {tuple(np.flatnonzero(row)) for row in found.suspects if row.any()} == named


@pytest.mark.parametrize("fault", ["unplugged", "stuck", "scaled", "drifting"])
def test_a_sensor_that_fails_is_named_and_left_out(method, fault):
    sent = faulty(U, fault, 4, 60, 5e-3 if fault == "drifting" else None)
    found = track(method, sent, times=TIMES)
    without = track(method, faulty(U, "missing", 4, 60), times=TIMES, monitor=None)
    assert set(found.status[:60]) == {"consistent"}
    assert found.status[-1] == "left out"
    assert {tuple(np.flatnonzero(row)) for row in found.suspects if row.any()} == {(4,)}
    late = slice(130, None)
    std = np.sqrt(np.diagonal(without.covariance, axis1=1, axis2=2))[late]
    assert (np.abs(found.q - without.q)[late] < 0.5 * std).all()
    assert found.details["left_out"][late, 4].all()
    assert (found.missing[late] == 1).all()


@pytest.mark.parametrize("fault", ["unplugged", "stuck", "scaled"])
def test_a_chip_fails_as_one_part(fault):
    times, _, u = moving(CHIPS, rate=25.0)
    found = track(LevenbergMarquardt(CHIPS), faulty(u, fault, CHIPS.parts == 2, 60), times=times)
    assert found.suspects.shape == (200, 4)
    assert {tuple(np.flatnonzero(row)) for row in found.suspects if row.any()} == {(2,)}
    assert (found.status[60:] == "left out").mean() > 0.8
    assert (found.missing[found.status == "left out"] == 3).all()


@pytest.mark.parametrize("value", [32.767, -4.096])
def test_one_impossible_code_changes_one_row(method, value):
    missing = U.copy()
    missing[90, 2] = np.nan
    found, expected = (track(method, u, times=TIMES) for u in (faulty(U, "spike", 2, 90, value), missing))
    assert list(np.flatnonzero(found.status != "consistent")) == [90]
    np.testing.assert_allclose(found.q, expected.q, atol=2e-7)
    np.testing.assert_array_equal(found.missing, expected.missing)


def test_a_glitch_of_all_readings_in_an_alarm_is_forgotten_and_the_part_is_named():
    sent = faulty(U, "scaled", 4, 60)
    sent[80:82] += 0.3
    found = track(METHODS["Kalman"], sent, times=TIMES)
    assert set(found.status[180:]) == {"left out"}
    assert {tuple(np.flatnonzero(row)) for row in found.suspects[180:]} == {(4,)}


def test_the_smoother_says_what_track_says():
    sent, fit = faulty(U, "unplugged", 2, 80), METHODS["Kalman"]
    found, told = smooth(fit, sent, times=TIMES), track(fit, sent, times=TIMES)
    np.testing.assert_array_equal(found.status, told.status)
    np.testing.assert_array_equal(found.suspects, told.suspects)
    good = smooth(fit, U, times=TIMES, monitor=None)
    tip, wrong, usual = (TWO.tip(q)[:, :3, 3] for q in (Q, found.q, good.q))
    assert np.linalg.norm(wrong - tip, axis=-1).mean() < 2 * np.linalg.norm(usual - tip, axis=-1).mean()


def test_at_the_last_reading_the_smoother_states_the_covariance_of_the_filter():
    """Three times the noise that is stated, from which both grow."""
    u = U + 8**0.5 * TWO.noise * np.random.default_rng(0).normal(size=U.shape)
    found, back = (run(METHODS["Kalman"], u, times=TIMES) for run in (track, smooth))
    assert found.details["growth"][-1] > 3
    np.testing.assert_allclose(back.covariance[-1], found.covariance[-1], rtol=1e-9)


def test_a_robot_that_jumps_starts_anew_and_nothing_goes_back_from_there():
    q = course(TWO, TIMES + np.where(TIMES >= 1.0, 40.0, 0.0), seed=7)
    u = simulated_readings(TWO, q) + TWO.noise * np.random.default_rng(0).normal(size=U.shape)
    fit = METHODS["Kalman"]
    found, back = track(fit, u, times=TIMES), smooth(fit, u, times=TIMES)
    assert list(np.flatnonzero(found.details["restarted"])) == [100]
    assert list(np.flatnonzero(found.status != "consistent")) == [100]
    np.testing.assert_array_equal(back.q[:100], smooth(fit, u[:100], times=TIMES[:100]).q)
    assert (
        np.abs(track(fit, u, times=TIMES, monitor=None).q - q)[105:].max()
        > 3 * np.abs(found.q - q)[100:].max()
    )


def test_the_covariance_grows_where_no_part_explains_the_readings(method):
    noisy = U.copy()
    noisy[60:] += np.sqrt(24) * TWO.noise * np.random.default_rng(3).normal(size=U[60:].shape)
    found, bare = (track(method, noisy, times=TIMES, monitor=m) for m in ("auto", None))
    late = found.status == "inconsistent"
    assert late[70:].mean() > 0.95
    assert not found.suspects.any()
    growth = found.details["growth"]
    assert np.median(growth[late]) == pytest.approx(25, rel=0.5)
    if isinstance(method, LevenbergMarquardt):
        kept = ~found.details["left_out"].any(-1)
        C = growth[:, None, None] * bare.covariance
        np.testing.assert_allclose(found.covariance[kept], C[kept], rtol=1e-9)


@pytest.mark.parametrize(("rate", "first"), [(100.0, 51), (25.0, 19), (400.0, 201)])
def test_a_board_that_repeats_itself_is_told(rate, first):
    times = np.arange(60 + 230) / rate
    u = np.concatenate([moving(rows=60, rate=rate)[2], np.repeat(U[60:61], 230, axis=0)])
    for method in METHODS.values():
        found = track(method, u, times=times)
        assert list(np.flatnonzero(found.status == "frozen")) == list(range(60 + first, 290))


def holds(found, q):
    """Whether the covariance holds the truth, but for one row in a thousand."""
    off = (found.q - q)[..., None]
    squared = (np.swapaxes(off, 1, 2) @ np.linalg.solve(found.covariance, off))[:, 0, 0]
    return squared < stats.chi2.isf(1e-3, off.shape[1])


@pytest.mark.parametrize("frames", [1, 2, 8, 16])
def test_old_frames_in_turn_are_a_frozen_board_whose_deviation_grows_and_holds_the_truth(method, frames):
    old = U.copy()
    old[60:] = U[60 - frames + np.arange(140) % frames]
    found = track(method, old, times=TIMES)
    assert set(found.status[:60]) == {"consistent"}
    assert list(np.flatnonzero(found.status == "frozen")) == list(range(60 + 50, 200))
    std = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2))
    assert (np.diff(std[60:]) > -1e-12).all()  # to what the bounds leave
    assert std[-1] > 5 * std[60]
    assert holds(found, Q)[60:].all()


def test_frames_in_turn_of_coarse_sensors_are_new():
    places = [replace(sensor, resolution=0.01) for sensor in TWO.sensors]
    u = np.repeat(U[:1].round(2), 100, axis=0)
    u[1::2, 0] += 0.01
    found = track(KalmanFilter(TWO.replaced(sensors=places)), u, times=TIMES[:100])
    assert set(found.status) == {"consistent"}
    assert (found.missing == 0).all()
    assert (found.dof == 8).all()  # the filter takes in all of them


def test_least_squares_on_a_frozen_board_adds_the_square_of_half_a_width_a_second():
    line = LevenbergMarquardt(lambda q: q * np.ones(4), [-1.0], [3.0], noise=0.001)
    found = track(line, np.full((60, 4), 0.5), [0.5], rate_hz=20.0)
    moved = 0.5 * 4.0 * np.arange(60) / 20
    np.testing.assert_allclose(found.covariance[:, 0, 0], 0.001**2 / 4 + moved**2, rtol=1e-6)


@pytest.mark.parametrize("resolution", [0.0, 7.0e-4, 7.2e-4, 0.1])
def test_a_robot_at_rest_with_coarse_sensors_is_no_frozen_board(resolution):
    places = [Sensor(s.segment, s.at, s.radial, s.azimuth, resolution=resolution) for s in TWO.sensors]
    robot = Robot(TWO.segments, TWO.magnets, places, lower=TWO.lower, upper=TWO.upper, noise=7.1e-4)
    found = track(LevenbergMarquardt(robot), np.repeat(U[:1], 100, axis=0), rate_hz=100)
    assert ("frozen" in found.status) == (resolution < 7.1e-4)
    rng, step = np.random.default_rng(0), resolution or 1e-9
    u = np.round((simulated_readings(robot, Q[100]) + 7.1e-4 * rng.normal(size=(300, 8))) / step) * step
    assert set(track(LevenbergMarquardt(robot), u, rate_hz=100).status) == {"consistent"}


@pytest.mark.parametrize("times_sent", [2, 10])
def test_a_frame_sent_again_adds_nothing(method, times_sent):
    n = 200 // times_sent
    times = np.arange(n * times_sent) / (RATE * times_sent)
    found = track(method, np.repeat(U[:n], times_sent, axis=0), times=times)
    once = track(method, U[:n], times=times[::times_sent])
    assert set(found.status) == {"consistent"}
    np.testing.assert_allclose(found.q[::times_sent], once.q, atol=1e-12)
    np.testing.assert_allclose(found.covariance[::times_sent], once.covariance, rtol=1e-9)
    assert not found.missing.any()  # a filter does not use it again, but it is there
    assert "0 of 1600 readings missing; " in repr(found)


def test_a_frame_sent_again_in_an_alarm_says_the_same(method):
    u = faulty(U, "unplugged", 4, 20)[:100]
    times = np.arange(200) / (2 * RATE)
    found, once = track(method, np.repeat(u, 2, axis=0), times=times), track(method, u, times=times[::2])
    for field in ("status", "suspects"):
        np.testing.assert_array_equal(getattr(found, field)[::2], getattr(once, field))
        np.testing.assert_array_equal(getattr(found, field)[1::2], getattr(once, field))


def test_a_reading_is_missing_or_left_out_but_not_both(method):
    """Also where a sensor stays the same while frames come again, and where it was not there."""
    u = np.repeat(faulty(U, "unplugged", 4, 20), 4, axis=0)
    u[:, 3] = u[0, 3]
    u[100:140:3, 3], mask = np.nan, np.ones(u.shape, dtype=bool)
    mask[50:60, 0] = False
    found = track(method, u, times=np.arange(len(u)) / (4 * RATE), mask=mask)
    lost, left_out = np.isnan(u) | ~mask, found.details["left_out"]
    assert left_out.any()
    np.testing.assert_array_equal(found.missing, (left_out | lost).sum(1))
    assert f"{lost.sum()} of {u.size} readings missing, {left_out.sum()} left out" in repr(found)


def test_what_an_array_does_not_say_is_missing_as_in_a_table(method):
    """A row of zeros, the end of the range, and infinity."""
    robot = TWO.replaced(sensors=[replace(sensor, range=200.0) for sensor in TWO.sensors])
    u = U.copy()
    u[50], u[60, 3], u[70:, 3] = 0.0, 200.0, np.inf
    fit, missing = type(method)(robot), (robot.missing(u) > 0) | np.isinf(u)
    found, expected = (track(fit, x, times=TIMES) for x in (u, np.where(missing, np.nan, u)))
    np.testing.assert_array_equal(found.q, expected.q)
    assert found.missing[[50, 60, 199]].tolist() == [8, 1, 1]
    assert set(found.status[70:]) == {"consistent"}


def test_fewer_readings_than_unknowns_are_told_without_a_motion_model():
    u = U.copy()
    u[50:, :3] = np.nan
    assert set(track(METHODS["least squares"], u).status[50:]) == {"undetermined"}
    assert set(track(METHODS["Kalman"], u, times=TIMES).status) == {"consistent"}
    known = np.full((200, 6), np.nan)
    known[:, 5] = Q[:, 5]
    assert "undetermined" not in track(METHODS["least squares"], u, known=known).status


@pytest.mark.parametrize("kind", ["offset", "gain"])
def test_one_impossible_code_moves_no_error_of_a_sensor(kind):
    fit = KalmanFilter(Drifting(TWO.sensing(), [Drift(kind, 0.05)]), TWO.lower, TWO.upper, TWO.noise)
    found, good, bare = (
        track(fit, u, times=TIMES, monitor=m)
        for u, m in (
            (faulty(U, "spike", 2, 90, 32.767), "auto"),
            (U, "auto"),
            (faulty(U, "spike", 2, 90, 32.767), None),
        )
    )
    moved, without = (np.abs(x.details["drift"] - good.details["drift"]).max(0) for x in (found, bare))
    assert (moved < 0.5 * good.details["drift_std"].min(0)).all()
    assert (without > 10 * good.details["drift_std"].min(0)).any()
    assert found.details["left_out"].sum() == 1


def test_a_restart_keeps_the_errors_of_sensors():
    offsets = 0.02 * np.random.default_rng(5).normal(size=8)
    fit = KalmanFilter(Drifting(TWO.sensing(), [Drift("offset", 0.02)]), TWO.lower, TWO.upper, TWO.noise)
    times, _, u = moving(rows=1000)
    jump = np.concatenate([u, simulated_readings(TWO, course(TWO, times[:20] + 50, seed=7))]) + offsets
    found = track(fit, jump, times=np.arange(1020) / RATE)
    assert found.details["restarted"][1000]
    before, after, std = found.details["drift"][999], found.details["drift"][1000], found.details["drift_std"]
    assert (np.abs(after - before) < 2 * std[999]).all()
    assert std[1000].mean() < 1.5 * std[999].mean()


def test_a_batch_says_what_its_members_say_alone(method):
    kinds = ("missing", "unplugged", "stuck", "frozen", "spike")
    rows = np.stack(
        [faulty(U, kind, k, 40, 9.0 if kind == "spike" else None) for k, kind in enumerate(kinds)], axis=1
    )
    found = track(method, rows[:120], times=TIMES[:120])
    for k in range(len(kinds)):
        alone = track(method, rows[:120, k], times=TIMES[:120])
        np.testing.assert_array_equal(found.status[:, k], alone.status)
        np.testing.assert_array_equal(found.suspects[:, k], alone.suspects)
        np.testing.assert_array_equal(found.missing[:, k], alone.missing)
        np.testing.assert_allclose(found.q[:, k], alone.q, atol=1e-11)
        np.testing.assert_allclose(found.covariance[:, k], alone.covariance, rtol=1e-6, atol=1e-18)


def test_a_state_is_never_changed(method):
    watched, sent = Monitor(method), faulty(U, "unplugged", 4, 20)
    state = watched.init()
    for k in range(40):
        before = state
        state, found = watched.step(before, sent[k], TIMES[k])
        _, again = watched.step(before, sent[k], TIMES[k])
        np.testing.assert_array_equal(found.q, again.q)
        assert found.details["status"] == again.details["status"]


def test_every_reading_of_a_callable_is_a_part_of_its_own():
    A = np.random.default_rng(0).normal(size=(8, 3))
    fit = LevenbergMarquardt(lambda q: q @ A.T, [-9.0] * 3, [9.0] * 3, noise=0.01)
    u = np.sin(np.arange(60) / 9)[:, None] @ A.sum(-1)[None] + 0.01 * np.random.default_rng(1).normal(
        size=(60, 8)
    )
    found = track(fit, faulty(u, "unplugged", 6, 30, 1.0))
    assert {tuple(np.flatnonzero(row)) for row in found.suspects if row.any()} == {(6,)}
    assert found.status[-1] == "left out"


def test_the_sensors_of_a_rod_are_parts():
    sensors = [RodSensor("orientation", 1e-3, arc_m=s) for s in (0.4, 0.7, 1.0)]
    fit = RodFilter(Rod(1.0, bending=1, torsion=0), sensors, strain_std=2.0, rate=0.5)
    times, rng = np.arange(60) / 20, np.random.default_rng(0)
    bend = 0.5 * np.sin(times)[:, None] * np.repeat([0.4, 0.7, 1.0], 3) * np.tile([1.0, 0.0, 0.0], 3)
    u = bend + 1e-3 * rng.normal(size=bend.shape)
    u[20:, 3:6] += 0.2
    found = track(fit, u, times=times)
    assert found.suspects.shape == (60, 3)
    assert {tuple(np.flatnonzero(row)) for row in found.suspects if row.any()} == {(1,)}
    assert np.abs(found.q[25:, 0] - 0.5 * np.sin(times[25:])).max() < 0.01


def test_what_papers_use_has_no_monitor():
    descent = GradientDescent(TWO.sensing(), [1e-4] * 6)
    assert track(descent, U[:3], Q[0]).status is None
    assert STATUS[0] == "consistent"


@pytest.mark.parametrize("name", ["least squares", "Kalman"])
def test_a_chip_that_repeats_itself_is_named_even_if_no_other_reading_contradicts(name):
    """Six readings, four unknowns: the fit hardly notices that one of two chips stands still, its bits do."""
    robot = CHIPS.replaced(sensors=[CHIPS.sensors[0], CHIPS.sensors[2]])
    times, _, u = moving(robot, rate=25.0)
    u[60:160, 3:] = u[60, 3:]
    found = track({"least squares": LevenbergMarquardt, "Kalman": KalmanFilter}[name](robot), u, times=times)
    named = found.suspects[:, 1]
    first = np.flatnonzero(named)[0]
    assert 60 + 20 <= first <= 60 + 21 + 8  # we look at every eighth row whether a reading stays
    assert named[first:160].all()
    assert not found.suspects[:60].any()
    assert not named[175:].any()
    assert found.details["left_out"][first:160, 3:].all()
    assert (found.missing[first:160] == 3).all()
    assert "suspects: B3 in " in repr(found)


def test_readings_that_stay_within_their_resolution_are_no_failure():
    times, _, u = moving(CHIPS, rate=25.0)
    u[60:, 3:6] = u[60, 3:6]
    coarse = [*CHIPS.sensors]
    coarse[1] = Sensor(1, 0.09, radial=0.012, azimuth=np.pi, axes=3, resolution=0.1, name="B2")
    robot = CHIPS.replaced(sensors=coarse, noise=0.02)
    found = track(LevenbergMarquardt(robot, noise=5.0), u, times=times)  # so that no residual speaks
    assert set(found.status) == {"consistent"}


def test_a_filter_without_any_reading_says_so(method):
    missing = U.copy()
    missing[80:120] = np.nan
    status = track(method, missing, times=TIMES).status
    assert set(status[80:120]) == {"undetermined"}
    assert set(status[:80]) == {"consistent"}


def test_a_part_that_is_found_to_stand_still_ends_the_search():
    """Before that, another chip was left out on suspicion: with both out, the shape would be anywhere."""
    robot, t = repro.load_robot(repro.example() / "robot.toml"), np.arange(110) / 25
    q = course(robot, t, seed=1)
    u = simulated_readings(robot, q, robot.earth)
    u += robot.noise * np.random.default_rng(1).standard_normal((150, 12))[:110]
    u[50:, :3] = u[50, :3]
    found = track(LevenbergMarquardt(robot), u, times=t)
    assert (found.details["left_out"].sum(-1) <= 3).all()
    assert found.suspects[-1].tolist() == [True, False, False, False]
    assert np.linalg.norm(robot.tip(found.q)[:, :3, 3] - robot.tip(q)[:, :3, 3], axis=1)[66:].max() < 0.03
