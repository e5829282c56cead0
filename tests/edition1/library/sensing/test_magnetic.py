"""Relations and readings: golden values, two independent routes, invariances, derivatives, refused input."""

import math

import magpylib as magpy
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1.kinematics.constant_curvature import ConstantCurvature
from edition1.kinematics.mounts import magnet_mounts, sensor_mounts
from edition1.kinematics.paper_robots import pcc_robot
from edition1.kinematics.robot import Robot
from edition1.sensing.magnetic import MagneticSensing, field_at_sensors, readings
from edition1.sensing.magnets import B444B, ring
from edition1.sensing.multipole import MultipoleField
from edition1.sensing.relations import relations
from edition1_companion.twins.trajectories import lemniscate

D = 0.022


def random_q(n, *shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return 0.04 * (torch.rand(*shape, 3 * n, dtype=torch.float64, generator=generator) - 0.5)


@pytest.mark.parametrize(
    ("n_segments", "earth", "ranges"),
    [
        (1, None, [0.92345]),
        (2, None, [0.16533, 0.96032]),
        (3, None, [0.92824, 0.92514, 1.02826]),
        (3, [0.065, 0.0, 0.0], [0.92562, 0.97282, 1.02896]),
    ],
)
@pytest.mark.parametrize("route", ["magpylib", "multipole"])
def test_ranges_on_the_lemniscate(n_segments, earth, ranges, route):
    """Ranges of the released recordings [mT], pooled over the three sensors of each segment."""
    earth_mt = None if earth is None else torch.tensor(earth)
    u = readings(
        pcc_robot(n_segments), lemniscate(n_segments), ring("released"), route=route, earth_mt=earth_mt
    )
    pooled = u.reshape(400, n_segments, 3)
    found = pooled.amax((0, 2)) - pooled.amin((0, 2))
    np.testing.assert_allclose(found, ranges, rtol=5e-5)


def test_published_ring_is_about_four_times_weaker():
    u = readings(pcc_robot(1), lemniscate(1), ring("published"))
    assert float(u.max() - u.min()) == pytest.approx(0.231, abs=0.0005)


@pytest.mark.parametrize(("name", "l_max"), [("released", 9), ("published", 7)])
@pytest.mark.parametrize("n_segments", [1, 2, 3])
def test_two_routes_agree(name, l_max, n_segments):
    """Magpylib and multipoles, three-axis readings, random poses with pairs down to 51 mm; within 1e-5 mT."""
    robot, q = pcc_robot(n_segments, tilt=0.2, azimuth_offset=0.3), random_q(n_segments, 500)
    earth = torch.tensor([0.01, -0.02, 0.05])
    by = {
        r: field_at_sensors(robot, q, ring(name), route=r, l_max=l_max, earth_mt=earth)
        for r in ("magpylib", "multipole")
    }
    assert float((by["magpylib"] - by["multipole"]).abs().max()) < 1e-5


def test_reading_is_that_of_magpylibs_objects():
    """An independent scene of magpylib objects, posed by SciPy rotations."""
    robot, q = pcc_robot(2, tilt=-0.1), random_q(2)
    u = field_at_sensors(robot, q, ring("released"))
    sources = []
    for T in robot.magnet_poses(q).numpy():
        pose = {"position": T[:3, 3], "orientation": Rotation.from_matrix(T[:3, :3])}
        sources.append(magpy.magnet.Cylinder(polarization=(0, 0, 1.45), dimension=(0.024, 0.006), **pose))
        sources.append(magpy.magnet.Cylinder(polarization=(0, 0, -1.45), dimension=(0.012, 0.006), **pose))
    for T, expected in zip(robot.sensor_poses(q).numpy(), u.numpy(), strict=True):
        sensor = magpy.Sensor(position=T[:3, 3], orientation=Rotation.from_matrix(T[:3, :3]))
        np.testing.assert_allclose(1e3 * magpy.getB(sources, sensor, sumup=True), expected, rtol=1e-10)


def test_grid_and_sensors_see_the_same_field():
    robot, q = pcc_robot(2), random_q(2)
    T = robot.sensor_poses(q)
    world = np.zeros((len(T), 3))
    for magnet in robot.magnet_poses(q).numpy():
        R, p = magnet[:3, :3], magnet[:3, 3]
        world += ring("published").field((T[:, :3, 3].numpy() - p) @ R) @ R.T
    local = (T[:, :3, :3].transpose(-1, -2) @ torch.from_numpy(world).unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(local, field_at_sensors(robot, q, ring("published")), atol=1e-12, rtol=1e-10)


@pytest.mark.parametrize("earth_mt", [0.0, 0.065])
def test_multipole_model_of_relations_is_the_reading(earth_mt):
    """The sensor model that sees only the relations of eq. (1) knows everything: axisymmetric structure."""
    robot, q = pcc_robot(3, 4, tilt=0.15), random_q(3, 50)
    axis = torch.tensor([0.6, 0.0, -0.8], dtype=torch.float64)
    sensing = MagneticSensing(robot, MultipoleField.of(ring("released"), 9, earth_mt), "cosines", axis)
    expected = readings(robot, q, ring("released"), route="multipole", earth_mt=earth_mt * axis)
    torch.testing.assert_close(sensing(q), expected, atol=1e-12, rtol=1e-11)


def test_relations_by_hand_at_the_straight_pose():
    """Sensor 13 mm beside and 55 mm above the magnet, looking down."""
    related = relations(pcc_robot(1, 1), torch.zeros(3, dtype=torch.float64))
    d = math.hypot(0.055, 0.013)
    theta = math.atan2(0.013, 0.055)
    expected = torch.tensor([[math.pi / 2, d, math.pi, math.pi - theta, theta]], dtype=torch.float64)
    torch.testing.assert_close(related.angles(), expected)
    cosines = expected.cos()
    cosines[:, 1] = d
    torch.testing.assert_close(related.cosines(), cosines, atol=1e-15, rtol=0)


def test_angles_are_those_of_the_cosines_and_hold_near_zero():
    robot, q = pcc_robot(2), random_q(2, 100)
    related = relations(robot, q, torch.tensor([0.0, 2.0, 0.0]))
    angles, cosines = related.angles(), related.cosines()
    is_distance = torch.arange(angles.shape[-1]) % 4 == 1
    torch.testing.assert_close(
        angles[..., ~is_distance].cos(), cosines[..., ~is_distance], atol=1e-14, rtol=0
    )
    torch.testing.assert_close(angles[..., is_distance], cosines[..., is_distance])
    tiny = relations(pcc_robot(1, 1), torch.tensor([1e-12, 0, 0], dtype=torch.float64)).angles()[0, 2]
    assert math.pi - float(tiny) == pytest.approx(0.5e-12 / D, rel=1e-3)  # half the bending


def test_relations_do_not_depend_on_where_the_base_stands():
    """Bending a segment below moves its neighbours rigidly: their mutual relations stay."""
    robot = Robot(
        (ConstantCurvature(0.11, D),) * 2,
        magnet_mounts([1], 0.055),
        sensor_mounts([1, 1], 0.11, 0.013, [0.0, 2.0]),
    )
    q = random_q(2, 2)
    q[1, 3:] = q[0, 3:]
    both = relations(robot, q).angles()
    torch.testing.assert_close(both[0, :, 1:], both[1, :, 1:], atol=1e-13, rtol=0)


@pytest.mark.parametrize("size", [0.0, 1e-8, D, 0.02])
def test_derivatives_of_the_readings(size):
    robot = pcc_robot(2, 2)
    q = torch.tensor([size, -size / 2, 0.0, size / 3, size, 0.0], dtype=torch.float64)
    scaled = (q / D).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda x: readings(robot, D * x, ring("released"), route="multipole"), scaled
    )
    sensing = MagneticSensing(robot, MultipoleField.of(ring("released")))
    assert torch.autograd.gradcheck(lambda x: sensing(D * x), scaled)


def test_angles_have_finite_derivatives_at_the_straight_pose():
    """The kink of alpha: the derivative is the middle of both sides, zero; never NaN."""
    jacobian = torch.func.jacrev(lambda q: relations(pcc_robot(1), q).angles())(torch.zeros(3).double())
    assert torch.isfinite(jacobian).all()
    assert (jacobian[:, 2] == 0).all()


def test_cube_magnet_reads_by_magpylib_only():
    robot = Robot((ConstantCurvature(0.015, 0.01),), magnet_mounts([0], 0.015), sensor_mounts([0], 0.0))
    q = torch.zeros(3, dtype=torch.float64)
    assert float(readings(robot, q, B444B)) == pytest.approx(-15.83, abs=0.005)
    with pytest.raises(
        InputError, match=r"Input magnet of field_at_sensors must be a Ring for route='multipole'"
    ):
        readings(robot, q, B444B, route="multipole")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: readings(pcc_robot(1), random_q(1), ring("released"), route="fem"),
            "'magpylib' or 'multipole'; .* 'fem'",
        ),
        (lambda: relations(Robot((ConstantCurvature(0.1, D),)), torch.zeros(3)), "0 magnets and 0 sensors"),
        (
            lambda: relations(pcc_robot(1), torch.zeros(3), torch.zeros(3)),
            "Input earth_axis of relations must be a direction",
        ),
        (lambda: MagneticSensing(pcc_robot(1), torch.sum, "sines"), "Input inputs of MagneticSensing"),
        (
            lambda: MagneticSensing(pcc_robot(1), torch.sum)(torch.zeros(3)),
            r"a callable that maps \(3, 5\) to \(3,\); .* returns \(\)",
        ),
        (
            lambda: MultipoleField(torch.ones(2, 3))(torch.zeros(4, 5)),
            r"of last dimension 9; .* shape \(4, 5\)",
        ),
        (lambda: MultipoleField(torch.tensor([math.nan])), "Input moments of MultipoleField"),
        (lambda: pcc_robot(0), "Input n_segments, sensors_per_segment of pcc_robot must be at least 1"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
