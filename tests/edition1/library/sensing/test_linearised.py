"""Readings with closed-form derivatives, against the model they speed up and against automatic differentiation."""

import math
from dataclasses import replace

import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import jacobian
from edition1.kinematics.motion import backbone_motion
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.paper_robots import pcc_robot
from edition1.kinematics.robot import Robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import MagneticSensing
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField
from edition1.sensing.placement import PlacedReadings, Tolerances, placed

MOMENTS = torch.from_numpy(ring("released").multipoles(9))
EARTH = torch.tensor([0.03, -0.05, 0.02], dtype=torch.float64)


def random(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 0.5


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
@pytest.mark.parametrize("segments", [1, 2, 3])
def test_backbone_motion_is_the_derivative_of_mount_poses(segments, shape):
    robot = pcc_robot(segments, 2)
    q = 0.03 * random(*shape, 3 * segments)
    mounts = robot.magnets.joined(robot.sensors)
    T, dT = backbone_motion(robot, q, mounts)
    bare = Mounts(mounts.segment, mounts.axial, torch.eye(4).double().expand(len(mounts), 4, 4))
    torch.testing.assert_close(T, robot.mount_poses(q, bare))
    _, reference = torch.func.vmap(
        lambda e: torch.func.jvp(lambda x: robot.mount_poses(x, bare), (q,), (e.expand_as(q),))
    )(torch.eye(3 * segments).double())
    torch.testing.assert_close(dT, reference.movedim(0, -3), atol=1e-12, rtol=1e-12)


def test_motion_of_mounts_below_the_last_segments():
    robot, q = pcc_robot(3), 0.03 * random(9)
    mounts = Mounts((0, 1), torch.tensor([0.05, 0.06]).double(), torch.eye(4).double().expand(2, 4, 4))
    T, dT = backbone_motion(robot, q, mounts)
    torch.testing.assert_close(T, robot.mount_poses(q, mounts))
    reference = torch.func.jacfwd(lambda x: robot.mount_poses(x, mounts))(q).movedim(-1, 1)
    torch.testing.assert_close(dT, reference, atol=1e-12, rtol=1e-12)


def test_motion_of_unequal_segments_and_a_batch_of_mounts():
    from edition1.kinematics.constant_curvature import ConstantCurvature

    nominal = pcc_robot(3)
    segments = (nominal.segments[0], ConstantCurvature(0.12, 0.02), nominal.segments[2])
    robot = Robot(segments, nominal.magnets, nominal.sensors)
    axial = torch.tensor([[0.05, 0.055, 0.06], [0.04, 0.055, 0.06]]).double()
    mounts = Mounts((0, 1, 2), axial, torch.eye(4).double().expand(2, 3, 4, 4))
    q = 0.03 * random(5, 1, 9)
    T, dT = backbone_motion(robot, q, mounts)
    torch.testing.assert_close(T, robot.mount_poses(q, mounts))
    step = 1e-6 * torch.eye(9).double()[4]
    change = (robot.mount_poses(q + step, mounts) - robot.mount_poses(q - step, mounts)) / 2e-6
    torch.testing.assert_close(dT[..., 4, :, :], change, atol=1e-7, rtol=1e-6)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
@pytest.mark.parametrize("earth", [None, EARTH])
def test_equals_the_multipole_model(shape, earth):
    robot, q = pcc_robot(2, 4, tilt=0.2), 0.03 * random(*shape, 6)
    length = 0.0 if earth is None else float(torch.linalg.vector_norm(earth))
    model = MagneticSensing(robot, MultipoleField(MOMENTS, length), earth_axis=earth)
    fast = LinearisedSensing(robot, MOMENTS, earth_mt=earth)
    (u, J), (u_fast, J_fast) = jacobian(model, q), jacobian(fast, q)
    torch.testing.assert_close(u_fast, u, atol=1e-12, rtol=0)
    torch.testing.assert_close(J_fast, J, atol=1e-10, rtol=0)


@pytest.mark.parametrize("scale", [0.0, 1e-8, 0.022])
def test_gradcheck(scale):
    q = (scale * torch.tensor([1.0, -0.5, 0.1]).double()).requires_grad_()
    sensing = LinearisedSensing(pcc_robot(1), MOMENTS, 1 + 0.1 * random(3))
    assert torch.autograd.gradcheck(sensing, (q,), eps=1e-6, atol=1e-4)


def test_gradient_through_a_robot_batch_has_the_shape_of_q():
    robot = pcc_robot(1, azimuth_offset=torch.tensor([0.0, 0.1]).double())
    q = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True)
    LinearisedSensing(robot, MOMENTS)(q).sum().backward()
    assert q.grad is not None
    assert q.grad.shape == q.shape


def test_derivatives_by_every_parameter():
    robot, q = pcc_robot(2, 2, tilt=0.1), 0.03 * random(4, 6)
    scale = Tolerances().of_parameters(robot, 5)
    parameters = 2 * scale * random(len(scale), seed=1)

    def moved(x):
        parts = placed(robot, MOMENTS, x)
        true = replace(robot, magnets=parts.magnets, sensors=parts.sensors)
        return LinearisedSensing(true, parts.moments, parts.gain, EARTH)

    u, J, J_q = PlacedReadings(robot, q, MOMENTS, EARTH).linearise(parameters)
    torch.testing.assert_close(u, moved(parameters)(q))
    torch.testing.assert_close(J_q, moved(parameters).linearise(q)[1])
    for k, size in enumerate(scale):
        step = 1e-4 * size * torch.eye(len(scale)).double()[k]
        slope = (moved(parameters + step)(q) - moved(parameters - step)(q)) / (2e-4 * size)
        torch.testing.assert_close(J[..., k], slope, atol=1e-6, rtol=1e-6)


def test_parameters_move_what_their_names_say():
    robot = pcc_robot(1, 1)
    azimuth, radius, tilt = placed(robot, MOMENTS, torch.eye(14).double()[5:8] * 0.1).sensors.local.unbind(0)
    nominal = robot.sensors.local
    torch.testing.assert_close(
        azimuth[0, :2, 3], 0.013 * torch.tensor([math.cos(0.1), math.sin(0.1)]).double()
    )
    torch.testing.assert_close(radius[0, 0, 3], 1.1 * nominal[0, 0, 3])
    torch.testing.assert_close(tilt, pcc_robot(1, 1, tilt=0.1).sensors.local)  # positive inwards


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"robot": Robot(pcc_robot(1).segments)},
            "robot of LinearisedSensing must be a robot with magnets and sen",
        ),
        ({"moments": torch.tensor([math.nan]).double()}, "moments of LinearisedSensing must be finite"),
        ({"gain": torch.ones(2).double()}, "gain of LinearisedSensing must be one for each of 3 sensors"),
    ],
)
def test_bad_input(change, message):
    with pytest.raises(InputError, match=message):
        LinearisedSensing(**({"robot": pcc_robot(1), "moments": MOMENTS} | change))


def test_bad_placement():
    with pytest.raises(InputError, match="parameters of placed must be of last dimension 22"):
        placed(pcc_robot(1), MOMENTS, torch.zeros(21).double())
    with pytest.raises(InputError, match="tolerances of Tolerances must be positive"):
        Tolerances(sensor_gain=0.0)
    batch = pcc_robot(1, azimuth_offset=torch.tensor([0.0, 0.1]).double())
    with pytest.raises(InputError, match="robot of PlacedReadings must be one robot, not a batch"):
        PlacedReadings(batch, torch.zeros(4, 3).double(), MOMENTS)
