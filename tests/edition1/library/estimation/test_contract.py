"""What every estimator promises: one suite for all of them."""

import math
from dataclasses import dataclass, is_dataclass
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.gradient_descent import GradientDescent
from edition1.estimation.imu_models import exact_arcs
from edition1.estimation.imu_selection import Selection
from edition1.estimation.imu_shape import ImuShape
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.estimation.particle_filter import ParticleFilter
from edition1.estimation.regions import Box
from edition1.estimation.rod_filter import RodFilter
from edition1.estimation.rod_sensors import RodSensor
from edition1.estimation.self_calibration import SelfCalibratingFilter
from edition1.kernels import compiled
from edition1.kinematics.paper_robots import pcc_robot
from edition1.kinematics.strain_series import StrainSeries
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField
from edition1_companion.twins.trajectories import lemniscate

ROBOT = pcc_robot(1)
SENSING = MagneticSensing(ROBOT, MultipoleField.of(ring("released")))
LEMNISCATE = lemniscate(1)[:6]
MAGNETIC = readings(ROBOT, LEMNISCATE, ring("released"))
LOW, HIGH = torch.tensor([-0.021, -0.021, 0.0]).double(), torch.tensor([0.021, 0.021, 0.0066]).double()
CLOUD = {
    "sensing": SENSING,
    "process_noise": torch.tensor([4e-4, 4e-4, 8e-5]).double(),
    "noise_mt": 0.003,
    "region": Box(LOW, HIGH),
}
ESTIMATORS = {
    "gradient descent": GradientDescent(SENSING, torch.full((3,), 3.5e-4)),
    "gradient descent, momentum reset": GradientDescent(
        SENSING, torch.full((3,), 3.5e-4), carry_momentum=False
    ),
    "gradient descent, compiled": GradientDescent(compiled(SENSING), torch.full((3,), 3.5e-4)),
    "Levenberg-Marquardt": LevenbergMarquardt(SENSING, LOW, HIGH, noise_mt=1e-3),
    "Levenberg-Marquardt, compiled": LevenbergMarquardt(compiled(SENSING), LOW, HIGH, noise_mt=1e-3),
    "Kalman filter": IteratedKalmanFilter(
        SENSING,
        LOW,
        HIGH,
        torch.tensor([0.5, 0.5, 0.1]).double(),
        torch.tensor([0.1, 0.1, 0.02]).double(),
        noise_mt=1e-4,
    ),
    "self-calibrating filter, nothing wanders": SelfCalibratingFilter(
        ROBOT,
        LOW,
        HIGH,
        torch.tensor([0.5, 0.5, 0.1]).double(),
        torch.tensor([0.1, 0.1, 0.02]).double(),
        moments=SENSING.model.moments,
        noise_mt=1e-4,
    ),
    "particle filter": ParticleFilter(**CLOUD),
    "particle filter, Gauss-Newton": ParticleFilter(
        **CLOUD, particles=200, estimate="Gauss-Newton", resampling="multinomial", restart=True
    ),
    "particle filter, constant velocity": ParticleFilter(**CLOUD, motion="constant velocity"),
}

# An arm of 640 mm bent to circles, about axes across it that turn; three IMUs, the base among them.
ANGLES, AXES = np.linspace(0.3, 2.1, 6), np.linspace(0.0, 3.0, 6)
BENDS = np.stack([-np.sin(AXES), np.cos(AXES), 0 * AXES], axis=1) * ANGLES[:, None]
BENT = Rotation.from_rotvec((BENDS[:, None] * np.array([0.0, 0.5, 1.0])[:, None]).reshape(-1, 3))
QUATERNIONS = torch.from_numpy(BENT.as_quat().reshape(6, 12))
ACROSS = (1 - np.cos(ANGLES)) * np.stack([np.cos(AXES), np.sin(AXES)])
TIPS = torch.from_numpy((0.64 / ANGLES * np.stack([*ACROSS, np.sin(ANGLES)])).T)
ARM = Selection((0, 4, 8), (0.0, 0.32, 0.64), (0.32, 0.32), sub_links=1)


@dataclass(frozen=True)
class Case:
    """An estimator, a trajectory with its readings, and noise that these readings may have."""

    estimator: Any
    q: Tensor
    u: Tensor
    noise: float
    sensors: int

    def step(self, u, **options):
        return self.estimator.step(self.estimator.init(self.q[0], seed=0), u, 0.0, **options)

    def check(self, estimate):
        torch.testing.assert_close(estimate.u_hat, SENSING(estimate.q))


class ImuCase(Case):
    def check(self, estimate):
        """Positions do not determine the quaternions, so the other way round."""
        positions = exact_arcs(estimate.u_hat.numpy().reshape(-1, 3, 4), ARM, [0.64])
        torch.testing.assert_close(torch.from_numpy(positions[:, 0]), estimate.q)


# A rod of one arc that twists, read by the positions of two points of it.
class RodCase(Case):
    def check(self, estimate):
        torch.testing.assert_close(estimate.u_hat, two_points(estimate.q))


ROD = StrainSeries(0.4, bending=1, torsion=1)


def two_points(q):
    return ROD.pose(q.unsqueeze(-2), torch.tensor([0.5, 1.0]).to(q))[..., :3, 3].flatten(-2)


PHASE = torch.linspace(0.0, 0.3, 6).double()
STRAINS = torch.stack([2 + PHASE.sin(), 3 - PHASE, 1 + PHASE.cos()], -1)
POINTS = two_points(STRAINS)
ROD_FILTER = RodFilter(ROD, (RodSensor("model", (1e-6,) * 6, sensing=two_points),), (10.0,) * 3, rate=5.0)


CASES = {name: Case(estimator, LEMNISCATE, MAGNETIC, 1e-3, 3) for name, estimator in ESTIMATORS.items()}
CASES["IMUs"] = ImuCase(ImuShape(exact_arcs, ARM, (0.64,), noise_rad=0.02), TIPS, QUATERNIONS, 1e-4, 12)
CASES["rod filter"] = RodCase(ROD_FILTER, STRAINS, POINTS, 1e-4, 6)


@pytest.fixture(params=CASES.values(), ids=CASES)
def case(request):
    return request.param


def flatten(state):
    """All arrays of a state, as tensors without NaN."""
    if isinstance(state, torch.Tensor | np.ndarray):
        return [torch.as_tensor(state).nan_to_num()]
    parts = vars(state).values() if is_dataclass(state) else state if isinstance(state, tuple) else ()
    return [x for part in parts for x in flatten(part)]


def test_step_leaves_the_state_and_the_readings_alone(case):
    state = case.estimator.init(case.q[0], seed=0)
    before, u = [x.clone() for x in flatten(state)], case.u[1].clone()
    case.estimator.step(state, u, 0.0)
    assert all(torch.equal(a, b) for a, b in zip(before, flatten(state), strict=True))
    assert torch.equal(u, case.u[1])


def test_same_seed_same_bits(case):
    first, second = (track(case.estimator, case.u, case.q[0], seed=3) for _ in range(2))
    assert torch.equal(first.q, second.q)
    assert torch.equal(first.u_hat, second.u_hat)


def test_follows_the_trajectory(case):
    estimate = track(case.estimator, case.u, case.q[0])
    assert float((estimate.q - case.q).abs().max()) < 2e-4


def test_prediction_belongs_to_the_estimate(case):
    estimate = track(case.estimator, case.u, case.q[0])
    case.check(estimate)


def test_batch_equals_loop(case):
    """Also for a batch of two dimensions, and with different masks for its members."""
    generator = torch.Generator().manual_seed(0)
    noise = case.noise * torch.randn(6, 2, 2, case.u.shape[-1], generator=generator, dtype=torch.float64)
    u = case.u[:, None, None] + noise
    u[2, 1, 0, 1] = math.nan
    batched = track(case.estimator, u, case.q[0].expand(2, 2, 3))
    assert batched.q.shape == (6, 2, 2, 3)
    for i in range(2):
        for j in range(2):
            alone = track(case.estimator, u[:, i, j], case.q[0])
            torch.testing.assert_close(batched.q[:, i, j], alone.q, atol=1e-9, rtol=0)


def test_a_reading_that_is_nan_is_a_masked_sensor_and_is_counted(case):
    mask = torch.ones(6, case.sensors, dtype=torch.bool)
    mask[3, 1] = False
    u = case.u.clone()
    u[3, 1] = math.nan
    by_mask, by_nan = track(case.estimator, case.u, case.q[0], mask=mask), track(case.estimator, u, case.q[0])
    assert torch.equal(by_mask.q, by_nan.q)
    assert by_nan.diagnostics["masked"].tolist() == [0, 0, 0, 1, 0, 0]


def test_masked_readings_have_no_effect(case):
    mask = (torch.arange(case.sensors) != 2).expand(6, -1)
    u = case.u.clone()
    u[:, 2] = 1e6
    assert torch.equal(
        track(case.estimator, case.u, case.q[0], mask=mask).q,
        track(case.estimator, u, case.q[0], mask=mask).q,
    )


def test_known_coordinates_are_held(case):
    known = torch.full((6, 3), math.nan, dtype=torch.float64)
    known[:, 2] = case.q[:, 2]
    estimate = track(case.estimator, case.u, case.q[0], known=known)
    assert torch.equal(estimate.q[:, 2], case.q[:, 2])
    if estimate.covariance is not None:
        assert (estimate.covariance[:, 2] == 0).all()


def test_precision_of_the_caller_is_kept(case):
    state, estimate = case.estimator.step(
        case.estimator.init(case.q[0].float(), seed=0), case.u[0].float(), 0.0
    )
    assert estimate.q.dtype == state.q.dtype == torch.float32


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda c: c.step(torch.full_like(c.u[0], math.nan)),
            "Input u of .* at least one",
        ),
        (
            lambda c: c.step(c.u[0], mask=torch.zeros(c.sensors, dtype=torch.bool)),
            "Input u of .* must be at least one reading that is a number and not masked; instead received none.",
        ),
        (
            lambda c: c.step(torch.full_like(c.u[0], math.inf)),
            "infinite readings",
        ),
        (
            lambda c: c.step(c.u[0], mask=torch.ones(40, dtype=torch.bool)),
            r"each of \d+ sensors",
        ),
        (
            lambda c: c.step(c.u[0], mask=torch.ones(c.sensors)),
            "Input mask of .* boolean",
        ),
        (lambda c: c.estimator.init(torch.full((3,), math.nan), seed=0), "Input q0 of .* must be finite"),
        (
            lambda c: c.estimator.init(torch.zeros(2), seed=0),
            r"Input q0 of .* of last dimension 3; .* \(2,\)",
        ),
        (
            lambda c: track(c.estimator, c.u[:0], c.q[0]),
            "Input readings of track must be at least one time step",
        ),
    ],
)
def test_bad_input(case, call, message):
    with pytest.raises(InputError, match=message):
        call(case)
