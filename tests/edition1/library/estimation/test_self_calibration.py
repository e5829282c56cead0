"""The filter that calibrates itself: its model and slopes, laws, closed forms, gauges, consistency, and its flag."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.estimation.self_calibration import SelfCalibratingFilter
from edition1.estimation.undetermined import not_determined
from edition1.estimation.wander import Wander, errors
from edition1.kernels._self_calibration import drift, innovate
from edition1.kinematics.mounts import magnet_mounts
from edition1.kinematics.paper_robots import pcc_robot
from edition1.kinematics.robot import Robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnets import ring

MOMENTS = torch.from_numpy(ring("released").multipoles(5))
EARTH = torch.tensor([0.04, 0.01, -0.03]).double()
ALL = (
    Wander("moment", 0.02),
    Wander("gain", 0.01, 1e-4),
    Wander("offset", 0.01, 1e-3),
    Wander("heading", 0.1, 1e-3),
    Wander.fading("tilt", 0.02, 3.0),
)


def box(n):
    return torch.tensor([-0.02, -0.02, 0.0] * n).double(), torch.tensor([0.02, 0.02, 0.006] * n).double()


def filter_of(n=1, sensors=3, wanders=ALL, imus=True, share=0.3, **options):
    """Return a filter of a robot of ``n`` segments with IMUs at their tips."""
    low, high = box(n)
    mounts = magnet_mounts(range(n), 0.11) if imus else None
    moving = (share * (high - low), 0.5 * (high - low))
    return SelfCalibratingFilter(
        pcc_robot(n, sensors), low, high, *moving, wanders, MOMENTS, mounts, EARTH, **options
    )


def readings_of(method, q, b):
    """Return what the model says is read, from parts of the library that the filter does not use."""
    robot, n_m, n_h = method.robot, len(method.robot.magnets), method.n_hall
    value = {kind: np.zeros(n) for kind, n in (("moment", n_m), ("gain", n_h), ("offset", n_h))}
    lean = np.zeros((len(method.imus), 3))
    for name, x in zip(method.errors.names, b, strict=True):
        kind, part = name.replace("of all", "all").split(",")[0].split()[:2]
        here = slice(None) if part == "all" else int(part) - 1
        if kind in value:
            value[kind][here] += x
        else:
            lean[here, 2 if kind == "heading" else "xy".index(name.split(",")[0][-1])] += x
    strength = torch.from_numpy(1 + value["moment"]).unsqueeze(-1)
    sensing = LinearisedSensing(
        robot, strength * MOMENTS, torch.from_numpy(1 + value["gain"]), EARTH, per_magnet=True
    )
    hall = sensing(q).numpy() + value["offset"]
    true = Rotation.from_matrix(robot.mount_poses(q, method.imus)[:, :3, :3].numpy())
    heading, tilt = (Rotation.from_rotvec(lean * on) for on in ([0, 0, 1], [1, 1, 0]))
    return np.concatenate([hall, (heading * tilt * true).as_rotvec().ravel()])


def somewhere(method, seed=0):
    """Return a configuration and errors of the sensors, both far from zero."""
    rng = np.random.default_rng(seed)
    n = method.robot.n_q
    q = np.tile([0.0, 0.0, 0.003], n // 3) + np.tile([0.015, 0.015, 0.002], n // 3) * rng.uniform(-1, 1, n)
    return q, 0.1 * rng.uniform(-1, 1, len(method.errors.names))


def innovation(method, x, u):
    s, use = len(u), np.ones(len(u), dtype=bool)
    r, H, u_hat = np.empty(s), np.empty((s, len(x))), np.empty(s)
    innovate(method._parts, x, u, use, r, H, u_hat)
    return r, H, u_hat


SHARED = tuple(replace(wander, shared=True) for wander in ALL)


@pytest.mark.parametrize("n", [1, 3])
def test_the_model_is_that_of_the_library(n):
    method = filter_of(n, wanders=ALL + SHARED)
    q, b = somewhere(method)
    expected = readings_of(method, torch.from_numpy(q), b)
    r, _, u_hat = innovation(method, np.concatenate([q, b, 0 * q]), expected)
    np.testing.assert_allclose(u_hat, expected, atol=1e-12)
    np.testing.assert_allclose(r, 0, atol=1e-12)


def test_slopes_are_those_of_what_is_read_beyond_the_prediction():
    method = filter_of(3, wanders=ALL + SHARED)
    q, b = somewhere(method)
    x = np.concatenate([q, b, 0 * q])
    u = readings_of(method, torch.from_numpy(q), b) + np.random.default_rng(1).uniform(-0.2, 0.2, 18)
    _, H, _ = innovation(method, x, u)
    for k in range(len(x)):
        step = np.where(np.arange(len(x)) == k, 1e-6, 0.0)
        slope = (innovation(method, x + step, u)[0] - innovation(method, x - step, u)[0]) / 2e-6
        np.testing.assert_allclose(-slope, H[:, k], atol=1e-6 * max(1.0, np.abs(H[:, k]).max()))


def test_without_errors_it_is_the_plain_kalman_filter():
    rng = np.random.default_rng(2)
    method = filter_of(wanders=(), imus=False, noise_mt=1e-3, iterations=8)
    sensing = LinearisedSensing(method.robot, MOMENTS, earth_mt=EARTH)
    plain = IteratedKalmanFilter(
        sensing, method.lower, method.upper, method.acceleration, method.velocity, noise_mt=1e-3
    )
    t = torch.linspace(0, 1, 30).double()
    q = torch.stack([0.01 * (3 * t).sin(), 0.008 * t, 0.003 + 0.001 * (5 * t).cos()], -1)
    u = sensing(q) + 1e-3 * torch.from_numpy(rng.standard_normal((30, 3)))
    ours, theirs = track(method, u, q[0]), track(plain, u, q[0])
    torch.testing.assert_close(ours.q, theirs.q, atol=1e-7, rtol=0)
    torch.testing.assert_close(ours.covariance, theirs.covariance, atol=1e-10, rtol=1e-3)
    held = track(replace(method, wanders=(Wander("gain", 0.0), Wander("offset", 0.0))), u, q[0])
    torch.testing.assert_close(held.q, ours.q, atol=1e-12, rtol=0)


def test_an_offset_in_a_known_pose_is_an_average():
    method = filter_of(wanders=(Wander("offset", 0.05),), imus=False, noise_mt=0.02)
    q = torch.tensor([0.01, -0.005, 0.002]).double()
    noise = 0.02 * torch.randn(40, 3, generator=torch.Generator().manual_seed(0)).double()
    u = torch.from_numpy(innovation(method, np.concatenate([q, np.zeros(6)]), np.zeros(3))[2]) + 0.03 + noise
    found = track(method, u, q, known=q.expand(40, 3)).diagnostics
    variance = 1 / (1 / 0.05**2 + 40 / 0.02**2)
    torch.testing.assert_close(found["errors_std"][-1], torch.full((3,), variance**0.5).double())
    torch.testing.assert_close(found["errors"][-1], variance * (0.03 + noise).sum(0) / 0.02**2)


def test_states_move_alike_in_one_step_and_in_two():
    listed = errors([Wander("gain", 0.1, 0.02), Wander("offset", 0.2, 0.03, 5.0)], 1, 2, 0)
    rng = np.random.default_rng(3)
    root = rng.standard_normal((10, 10))
    x, P, density = rng.standard_normal(10), root @ root.T, np.array([0.1, 0.2, 0.3])
    a, b = (x.copy(), P.copy()), (x.copy(), P.copy())
    wide = np.full(3, -1e9), np.full(3, 1e9)
    drift(*a, *wide, density, listed.walk, listed.rate, 2.0)
    for tau in (0.7, 1.3):
        drift(*b, *wide, density, listed.walk, listed.rate, tau)
    np.testing.assert_allclose(a[0], b[0])
    np.testing.assert_allclose(a[1], b[1])
    alone = np.zeros(10), np.diag(np.concatenate([np.zeros(3), listed.start**2, np.zeros(3)]))
    drift(*alone, *wide, density, listed.walk, listed.rate, 2.0)
    np.testing.assert_allclose(np.sqrt(alone[1].diagonal()[3:7]), listed.prior_std(2.0))
    always = errors([Wander.fading("tilt", 0.02, 3.0)], 0, 0, 1)
    np.testing.assert_allclose(always.prior_std(100.0), 0.02)
    np.testing.assert_allclose(always.fast_std, 0.02)


def test_a_coordinate_that_nothing_reads_is_as_uncertain_as_its_bounds_and_in_their_middle():
    """IMUs do not see the elongation; without its bounds it would drift away."""
    method = filter_of(wanders=())
    start = torch.tensor([0.0, 0.0, 0.001]).double()
    hall = torch.arange(6) < 3
    found = track(method, torch.zeros(400, 6).double(), start, rate_hz=4.0, mask=~hall.expand(400, 6))
    width = float(method.upper[2] - method.lower[2])
    std = found.covariance[100:, 2, 2].sqrt()
    assert float(std.min()) > 0.6 * width / 12**0.5
    assert float(std.max()) < 1.01 * width / 12**0.5
    assert float((found.q[100:, 2] - 0.003).abs().max()) < 1e-4


@pytest.mark.parametrize(
    ("wanders", "expected"),
    [
        (("moment", "gain"), ["The ratio of moment 1 and gain 1 is not determined by this motion."]),
        (
            ("moment", "gain", "offset"),
            ["The ratio of moment 1 and gain 1 is not determined by this motion."],
        ),
        (("gain", "offset"), []),
    ],
)
def test_a_gauge_is_found_by_name(wanders, expected):
    """One sensor and one magnet in poses that are known: only the product of moment and gain is read."""
    method = filter_of(sensors=1, wanders=[Wander(kind, 0.05) for kind in wanders], imus=False, noise_mt=1e-4)
    method = replace(method, earth_mt=None)
    state = method.init(torch.zeros(3).double())
    for k in range(30):
        q = torch.tensor(
            [0.015 * math.sin(k), 0.01 * math.cos(2 * k), 0.003 + 0.003 * math.sin(3 * k)]
        ).double()
        u = torch.from_numpy(
            innovation(method, np.concatenate([q, np.zeros(3 + len(wanders))]), np.zeros(1))[2]
        )
        state, _ = method.step(state, u, 0.1 * k, known=q)
    assert method.undetermined(state, 2.9) == expected


def test_at_rest_an_offset_and_a_gain_cannot_be_told_apart_and_nothing_else_is_said():
    method = filter_of(sensors=1, wanders=[Wander("offset", 0.1)], imus=False, noise_mt=1e-4)
    state = method.init(torch.zeros(3).double())
    assert method.undetermined(state, 0.0) == ["Offset 1 is not determined by this motion."]


@pytest.mark.parametrize(
    ("names", "direction", "sentence"),
    [
        (["gain 1", "gain 2"], [1, 1], "The product of gain 1 and gain 2"),
        (["offset 1", "offset 2"], [1, 1], "The sum of offset 1 and offset 2"),
        (["offset 1", "heading 2"], [1, -1], "The difference of offset 1 and heading 2"),
        (["offset 1", "gain 2", "tilt 3"], [1, -1, 1], "A combination of offset 1, gain 2 and tilt 3"),
    ],
)
def test_what_stays_open_is_said_in_words(names, direction, sentence):
    d = np.array(direction) / np.linalg.norm(direction)
    covariance = 1e-6 * np.eye(len(d)) + np.outer(d, d)
    assert not_determined(names, covariance) == [f"{sentence} is not determined by this motion."]


def drawn(method, steps, rng, tau=0.1, path=None):
    """Draw truth and readings of the filter's own model; along ``path`` where that is given."""
    n, listed = method.robot.n_q, method.errors
    x = np.tile([0.0, 0.0, 0.003], n // 3) + method.acceleration.numpy() * 0.05 * rng.standard_normal(n)
    v, b = 0 * x, listed.start * rng.standard_normal(len(listed.names))
    stay = np.exp(-listed.rate * tau)
    added = np.sqrt(np.maximum(listed.prior_std(tau) ** 2 - (stay * listed.start) ** 2, 0))
    density = method.acceleration.numpy()
    root = np.linalg.cholesky([[tau**3 / 3, tau**2 / 2], [tau**2 / 2, tau]])
    noise = np.sqrt(method._parts.variance)
    truth, u = [], []
    for k in range(steps):
        kick = density[:, None] * (rng.standard_normal((n, 2)) @ root.T)
        x, v = x + tau * v + kick[:, 0], v + kick[:, 1]
        x = x if path is None else path[k]
        b = stay * b + added * rng.standard_normal(len(b))
        truth.append(np.concatenate([x, b]))
        u.append(readings_of(method, torch.from_numpy(x), b) + noise * rng.standard_normal(len(noise)))
    return np.array(truth), torch.from_numpy(np.array(u))


def test_the_covariance_is_that_of_the_errors_where_the_model_is_true():
    method = filter_of(share=0.02)
    method = replace(method, velocity=0.02 * (method.upper - method.lower))
    nees, k = [], method.robot.n_q + len(method.errors.names)
    for seed in range(30):
        truth, u = drawn(method, 25, np.random.default_rng([4, seed]))
        state = method.init(torch.tensor([0.0, 0.0, 0.003]).double())
        for i, reading in enumerate(u):
            state, _ = method.step(state, reading, 0.1 * i)
        off = state.q.numpy() - truth[-1]
        nees.append(off @ np.linalg.solve(state.covariance[:k, :k].numpy(), off))
    low, high = chi2.ppf([0.0005, 0.9995], 30 * k)
    assert low < sum(nees) < high


def test_what_no_state_explains_raises_a_flag_and_not_a_wrong_shape():
    method, t = filter_of(share=0.1, gate=1e-6), np.arange(360) / 10
    path = np.stack([0.01 * np.sin(t / 2), 0.012 * np.sin(t / 3 + 1), 0.003 + 0.002 * np.sin(t / 5)], axis=-1)
    truth, u = drawn(method, 360, np.random.default_rng(5), path=path)
    iron = torch.zeros(360, 6).double()
    iron[100:200, :3] = torch.tensor([0.12, -0.08, 0.04])
    start = torch.from_numpy(path[0])
    found, ungated = (track(m, u + iron, start, rate_hz=10.0) for m in (method, replace(method, gate=None)))
    flag = found.diagnostics["flag"]
    assert not flag[:100].any()
    assert flag[101:200].all()
    assert not flag[320:].any()
    wrong, right = ((x.q[100:200, :2].numpy() - truth[100:200, :2]).std() for x in (ungated, found))
    assert wrong > 3 * right
    assert found.diagnostics["masked"][150] == 3
    calm = track(method, u, start, rate_hz=10.0)
    assert not calm.diagnostics["flag"].any()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: Wander("size", 1.0),
            "Input kind of Wander must be one of moment, gain, offset, heading, tilt",
        ),
        (lambda: Wander("gain", -1.0), "Input start of Wander must be finite and not negative"),
        (lambda: Wander("gain", 1.0, 0.0, 0.0), "Input time_s of Wander must be positive"),
        (lambda: filter_of(gate=1.5), "Input gate of SelfCalibratingFilter must be between 0 and 1"),
        (lambda: filter_of(noise_mt=0.0), "Input noise_mt of SelfCalibratingFilter must be positive"),
        (lambda: replace(filter_of(), moments=None), "Input moments of SelfCalibratingFilter must be those"),
        (
            lambda: replace(filter_of(imus=False, wanders=()), robot=Robot(pcc_robot(1).segments)),
            "Input imus of SelfCalibratingFilter must be some",
        ),
        (
            lambda: filter_of().step(filter_of().init(torch.zeros(3).double()), torch.zeros(4).double(), 0.0),
            "Input u of SelfCalibratingFilter must be of last dimension 6",
        ),
    ],
)
def test_what_cannot_be_used_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
