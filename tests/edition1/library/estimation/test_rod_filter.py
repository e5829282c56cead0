"""The filter of a rod: what it does with missing, late and surprising readings, and that its covariance holds.

That it is the posterior of a linear model is in ``test_smoothing``; its derivatives are in ``kernels/test_rod``.
"""

import math

import numpy as np
import pytest
import torch
from scipy import stats

from edition1 import se3
from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.rod_filter import RodFilter
from edition1.estimation.rod_sensors import RodSensor
from edition1.kinematics.mounts import magnet_mounts, sensor_mounts
from edition1.kinematics.robot import Robot
from edition1.kinematics.strain_series import StrainSeries
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField

ROD = StrainSeries(0.4, bending=2, torsion=1)
STD = (2.0, 1.0, 2.0, 1.0, 0.5)
POSE = RodSensor("pose", (1e-3,) * 3 + (5e-3,) * 3, arc_m=0.4)
GYRO = RodSensor("gyroscope", (0.02,) * 3, arc_m=0.2)
FILTER = RodFilter(ROD, (POSE, GYRO), STD, rate=4.0)
START = torch.zeros(5).double()


def drawn(method, steps, rng, dt=0.02):
    """A motion of the process, started as the prior says, with its readings."""
    state = method.init(START)
    n, x = method.n_q, torch.from_numpy(rng.multivariate_normal(np.zeros(10), state.covariance.numpy()))
    move, noise = method.motion(dt)
    root = torch.linalg.cholesky(noise)
    motion, errors = [], []
    for _ in range(steps):
        motion.append(x)
        errors.append(torch.from_numpy(rng.normal(size=9)) * torch.tensor(POSE.std + GYRO.std))
        x = move @ x + root @ torch.from_numpy(rng.normal(size=10))
    x, errors = torch.stack(motion), torch.stack(errors)
    q, half = x[:, :n], torch.tensor(0.5).double()
    T = ROD.pose(q[:, None], torch.tensor([0.5, 1.0]).double())
    J = torch.autograd.functional.jacobian(  # of all steps at once: each depends on its own only
        lambda d: se3.logarithm(se3.inverse(T[:, 0]) @ ROD.pose(q + d, half))[:, 3:].sum(0),
        torch.zeros_like(q),
    )
    turning = torch.einsum("isj,sj->si", J, x[:, n:])
    tip = T[:, 1] @ se3.exponential(errors[:, :6])
    return q, torch.cat([se3.logarithm(tip), turning + errors[:, 6:]], dim=-1)


@pytest.fixture(scope="module")
def runs():
    rng = np.random.default_rng(5)
    return [drawn(FILTER, 25, rng) for _ in range(20)]


def test_errors_are_as_large_as_the_covariance_says(runs):
    """The normalised error of the last step over 20 motions of the process is chi-square with 100 degrees."""
    total = 0.0
    for q, u in runs:
        found = track(FILTER, u, START, rate_hz=50.0)
        error = found.q[-1] - q[-1]
        total += float(error @ torch.linalg.solve(found.covariance[-1], error))
    assert stats.chi2(100).ppf(0.0005) < total < stats.chi2(100).ppf(0.9995)


def test_surprise_is_chi_square(runs):
    chi2, dof = 0.0, 0
    for _, u in runs:
        found = track(FILTER, u, START, rate_hz=50.0)
        chi2 += float(found.diagnostics["chi2"][1:].sum())
        dof += int(found.diagnostics["dof"][1:].sum())
    assert dof == 20 * 24 * 9
    assert stats.chi2(dof).ppf(0.0005) < chi2 < stats.chi2(dof).ppf(0.9995)


def test_a_gyroscope_carries_the_shape_through_a_gap(runs):
    """Without it the estimate falls back to rest."""
    errors = []
    for sensors in ("both", "pose alone"):
        for q, u in runs:
            u = u.clone()
            u[15:, :6] = math.nan
            if sensors == "both":
                found = track(FILTER, u, START, rate_hz=50.0)
                errors.append(float((found.q[-1] - q[-1]).norm()))
            else:
                state = FILTER.init(START)
                for k in range(15):
                    state, _ = FILTER.step(state, u[k], 0.02 * k)
                errors.append(float((FILTER.predicted(state, 0.48).q - q[-1]).norm()))
    assert np.mean(errors[:20]) < 0.8 * np.mean(errors[20:])


def test_positions_and_their_covariance_are_those_of_the_pose():
    q = torch.tensor([[1.0, -0.4, 2.0, 0.3, 0.2], [0.0, 0.0, 0.0, 0.0, 0.0]]).double()
    root = torch.randn(2, 5, 5, generator=torch.Generator().manual_seed(1)).double()
    C = root @ root.mT
    positions, spread = FILTER.positions(q, C, (0.1, 0.4))
    for k in range(2):
        J = torch.autograd.functional.jacobian(
            lambda x: ROD.pose(x, torch.tensor([0.25, 1.0]).double())[:, :3, 3], q[k]
        )
        torch.testing.assert_close(positions[k], ROD.pose(q[k], torch.tensor([0.25, 1.0]).double())[:, :3, 3])
        torch.testing.assert_close(spread[k], J @ C[k] @ J.mT)


def test_a_pose_that_is_not_whole_is_left_out_whole(runs):
    u = runs[0][1][:3].clone()
    partly, without = u.clone(), u.clone()
    partly[1, 2] = math.nan
    without[1, :6] = math.nan
    a, b = (track(FILTER, x, START, rate_hz=50.0) for x in (partly, without))
    assert torch.equal(a.q, b.q)
    assert a.diagnostics["masked"].tolist() == [0, 6, 0]


def test_an_outlier_counts_less(runs):
    q, u = runs[0]
    u = u.clone()
    u[20, 0] += 0.2
    errors = {}
    for outliers in (math.inf, 4.0):
        pose = RodSensor("pose", POSE.std, arc_m=0.4, outliers=outliers)
        found = track(RodFilter(ROD, (pose, GYRO), STD, rate=4.0), u, START, rate_hz=50.0)
        errors[outliers] = float((found.q[20] - q[20]).norm())
    assert errors[4.0] < 0.5 * errors[math.inf]


def test_a_sensor_without_surprise_is_the_same_with_outliers_in_mind(runs):
    u = FILTER.step(FILTER.init(START), runs[0][1][0], 0.0)[1].u_hat
    pose = RodSensor("pose", POSE.std, arc_m=0.4, outliers=4.0)
    robust = RodFilter(ROD, (pose, GYRO), STD, rate=4.0)
    plain, other = (m.step(m.init(START), 0 * u, 0.0)[1] for m in (FILTER, robust))
    torch.testing.assert_close(plain.q, other.q, atol=1e-3, rtol=0)


def test_a_moving_base_is_estimated():
    base = RodSensor("pose", POSE.std, arc_m=0.0)
    method = RodFilter(ROD, (base, POSE), STD, rate=4.0, base_std=(0.01, 0.1))
    assert method.n_q == 11
    twist = torch.tensor([0.004, -0.002, 0.001, 0.05, 0.02, -0.03]).double()
    strain = torch.tensor([1.0, 0.2, -0.5, 0.1, 0.0]).double()
    tip = se3.exponential(twist) @ ROD.pose(strain, torch.tensor(1.0).double())
    u = torch.cat([twist, se3.logarithm(tip)])
    found = track(method, u.expand(40, -1), torch.zeros(11).double(), rate_hz=50.0)
    torch.testing.assert_close(found.q[-1, :6], twist, atol=2e-3, rtol=0)
    torch.testing.assert_close(found.u_hat[-1], u, atol=2e-3, rtol=0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RodSensor("camera", (1.0,)), "Input kind of RodSensor must be one of pose, orientation"),
        (
            lambda: RodSensor("pose", (1.0,)),
            "Input std of RodSensor must be positive, one for each of 6 readings",
        ),
        (lambda: RodSensor("gyroscope", (1.0, 1.0, 0.0)), "Input std of RodSensor .* 3 readings"),
        (lambda: RodSensor("model", (1.0,)), "Input sensing of RodSensor must be given for a model"),
        (lambda: RodSensor("gyroscope", (1.0,) * 3, lasting_std=(1.0,)), "Input lasting_std .* empty, or 3"),
        (
            lambda: RodSensor("gyroscope", (1.0,) * 3, outliers=0.0),
            "Input outliers of RodSensor must be positive",
        ),
        (lambda: RodFilter(ROD, (), STD, 1.0), "Input sensors of RodFilter must be at least one"),
        (
            lambda: RodFilter(ROD, (POSE,), STD[:2], 1.0),
            "Input strain_std of RodFilter must be one for each of 5",
        ),
        (lambda: RodFilter(ROD, (POSE,), STD, 0.0), "Input rate of RodFilter must be positive"),
        (
            lambda: RodFilter(ROD, (RodSensor("pose", POSE.std, arc_m=0.5),), STD, 1.0),
            "Input arc_m of RodFilter",
        ),
        (lambda: FILTER.step(FILTER.init(START), torch.zeros(8).double(), 0.0), "Input u of .* dimension 9"),
        (lambda: FILTER.init(torch.zeros(4).double()), "Input q0 of RodFilter must be of last dimension 5"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_a_track_at_given_times_is_that_at_their_rate(runs):
    u = runs[0][1]
    times = [0.02 * k for k in range(len(u))]
    by_times, by_rate = track(FILTER, u, START, times_s=times), track(FILTER, u, START, rate_hz=50.0)
    torch.testing.assert_close(by_times.q, by_rate.q, atol=1e-9, rtol=0)
    with pytest.raises(InputError, match="Input times_s of track must be one for each of 25 rows"):
        track(FILTER, u, START, times_s=times[:3])


def test_readings_out_of_order_are_refused():
    state, _ = FILTER.step(FILTER.init(START), torch.zeros(9).double(), 1.0)
    for t in (1.0, 0.9):
        with pytest.raises(InputError, match=r"Input t of RodFilter must be after the last step, 1\.0 s"):
            FILTER.step(state, torch.zeros(9).double(), t)
    with pytest.raises(InputError, match="not before the last step"):
        FILTER.predicted(state, 0.5)


def test_magnets_on_the_rod_are_read_beside_a_gyroscope():
    """A ring at the tip, three tilted sensors below: the filter has multipoles, the readings are magpylib's."""
    rod = StrainSeries(0.1, bending=1, torsion=0)
    robot = Robot(
        (rod,),
        magnets=magnet_mounts([0], [0.1]),
        sensors=sensor_mounts([0] * 3, 0.05, radial=0.013, azimuth=[0.0, 2.1, 4.2], tilt=torch.pi / 6),
    )
    sensing = MagneticSensing(robot, MultipoleField.of(ring("released")))
    magnets = RodSensor("model", (0.01,) * 3, sensing=sensing)
    gyro = RodSensor("gyroscope", (0.05,) * 3, arc_m=0.1)
    method = RodFilter(rod, (magnets, gyro), (5.0, 5.0), rate=4.0)
    t = torch.linspace(0, 1, 51).double()
    q = torch.stack([4 * t.sin(), 3 * (1 - t.cos())], -1)
    turning = torch.stack(
        [0.4 * t.cos(), 0.3 * t.sin(), 0 * t], -1
    )  # about the axes across, while the bend is small
    u = torch.cat([readings(robot, q, ring("released")), turning], -1)
    found = track(method, u, torch.zeros(2).double(), rate_hz=50.0)
    torch.testing.assert_close(found.q[5:], q[5:], atol=0.1, rtol=0)
