"""Compiled readings and slopes against torch and its automatic differentiation, model by model."""

import math
import subprocess
import sys
from dataclasses import replace

import pytest
import torch
from torch import nn

from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import jacobian
from edition1.kernels._sensing import CompiledSensing
from edition1.kinematics.affine_curvature import AffineCurvature
from edition1.kinematics.constant_curvature import ConstantCurvature
from edition1.kinematics.mounts import magnet_mounts, sensor_mounts
from edition1.kinematics.paper_robots import affine_robot, pcc_robot
from edition1.kinematics.robot import Robot
from edition1.sensing.ensemble import SeedEnsemble
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import MagneticSensing
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField
from edition1.sensing.network import CosineNetwork, DipoleResidual, PerSensor, paper_network

MOMENTS = torch.from_numpy(ring("released").multipoles(9))
EARTH = torch.tensor([0.03, -0.05, 0.02], dtype=torch.float64)


def random(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 0.5


def paper(seed, width):
    """Network of the paper with statistics of its own, as after training, on relations in m and rad."""
    g = torch.Generator().manual_seed(seed)
    network = paper_network(width, g)
    for m in network:
        if isinstance(m, nn.BatchNorm1d):
            for x, low, high in ((m.running_mean, -1, 1), (m.running_var, 0.5, 2)):
                nn.init.uniform_(x, low, high, generator=g)
            nn.init.uniform_(m.weight, -2, 2, generator=g)
            nn.init.uniform_(m.bias, -1, 1, generator=g)
    return network.eval()


def cosine(seed, width):
    network = CosineNetwork(width, torch.Generator().manual_seed(seed))
    network.spread.copy_(torch.linspace(0.01, 1.0, width))
    network.scale.fill_(0.3)
    network.offset.fill_(-2.0)
    return network


def unequal_robot():
    """Three segments of both kinds and unequal sizes, mounts in no order, one of them short of the tip."""
    segments = (ConstantCurvature(0.11, 0.022), AffineCurvature(0.2), ConstantCurvature(0.09, 0.018))
    return Robot(
        segments,
        magnet_mounts([2, 0, 1, 1], [0.03, 0.05, 0.04, 0.15]),
        sensor_mounts([1, 0, 2, 2, 1], [0.2, 0.06, 0.09, 0.09, 0.0], 0.013, [0.3, 1.0, 2.0, 4.0, 5.0], 0.2),
    )


def of_network(make, robot, inputs, seeds=None):
    width, segments = 1 + 4 * len(robot.magnets), len(robot.segments)
    networks = [[make(10 * s + k, width).double() for k in range(segments)] for s in range(seeds or 1)]
    of_sensor = list(robot.sensors.segment)
    model = SeedEnsemble(networks, of_sensor) if seeds else PerSensor(networks[0], of_sensor).eval()
    return MagneticSensing(robot, model, inputs, EARTH)


def per_magnet(n):
    return MultipoleField(MOMENTS * (1 + 0.1 * random(n, 1, seed=1)), 0.065)


BENT, AFFINE = 0.03, torch.tensor([2.0, 4.0, 6.0, 0.01]).double()
TILTED = pcc_robot(3, 2, tilt=0.2, radial=0.016, azimuth_offset=0.4)
MODELS = {
    "one segment": (LinearisedSensing(pcc_robot(1), MOMENTS), BENT),
    "three segments, gains, Earth field": (
        LinearisedSensing(TILTED, MOMENTS, 1 + 0.2 * random(6), EARTH),
        BENT,
    ),
    "bent beyond the series": (LinearisedSensing(pcc_robot(2), MOMENTS, earth_mt=EARTH), 0.1),
    "moments of their own": (MagneticSensing(TILTED, per_magnet(3), earth_axis=EARTH), BENT),
    "affine": (LinearisedSensing(affine_robot(), MOMENTS), AFFINE),
    "both kinds": (LinearisedSensing(unequal_robot(), MOMENTS, earth_mt=EARTH), 0.03),
    "network of the paper": (of_network(paper, pcc_robot(1), "angles"), BENT),
    "networks of the paper": (of_network(paper, TILTED, "angles"), BENT),
    "networks of the paper, affine": (of_network(paper, affine_robot(), "angles"), AFFINE),
    "networks of the paper on cosines": (of_network(paper, pcc_robot(2), "cosines"), BENT),
    "networks on cosines": (of_network(cosine, TILTED, "cosines"), BENT),
    "network on cosines, alone": (MagneticSensing(pcc_robot(1), cosine(0, 5).double()), BENT),
}


@pytest.mark.parametrize(("sensing", "scale"), MODELS.values(), ids=MODELS)
def test_readings_and_slopes_are_those_of_torch(sensing, scale):
    n_q = sensing.robot.n_q
    q = torch.cat([scale * random(20, n_q), 1e-9 * random(1, n_q)])
    u, J = CompiledSensing(sensing).linearise(q)
    pairs = [jacobian(sensing, x) for x in q]  # one by one: a network of the paper alone takes no batch
    expected = torch.stack([x for x, _ in pairs])
    torch.testing.assert_close(u, expected, atol=1e-10, rtol=1e-12)
    slopes = torch.stack([x for _, x in pairs])
    torch.testing.assert_close(J, slopes, atol=1e-8, rtol=1e-9)


@pytest.mark.parametrize(("sensing", "scale"), MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("bent", [(), (0,), (1,)])
def test_straight_segments(sensing, scale, bent):
    """Where angles have a kink both take the middle of its sides; exactly there, not only near it."""
    parts = sensing.robot.split(scale * random(sensing.robot.n_q, seed=3))
    q = torch.cat([x if i in bent else torch.zeros_like(x) for i, x in enumerate(parts)])
    u, J = CompiledSensing(sensing).linearise(q)
    expected, slopes = jacobian(sensing, q)
    torch.testing.assert_close(u, expected, atol=1e-10, rtol=1e-12)
    torch.testing.assert_close(J, slopes, atol=1e-8, rtol=1e-9)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_shapes_of_batches(shape):
    sensing = LinearisedSensing(pcc_robot(2), MOMENTS)
    u, J = CompiledSensing(sensing).linearise(BENT * random(*shape, 6))
    expected, slopes = sensing.linearise(BENT * random(*shape, 6))
    torch.testing.assert_close(u, expected, atol=1e-12, rtol=0)
    torch.testing.assert_close(J, slopes, atol=1e-10, rtol=0)


def test_batch_of_robots_with_moments_and_gains_of_their_own():
    robot = pcc_robot(2, tilt=0.1 * random(4), azimuth_offset=random(4, seed=1))
    robot = replace(robot, magnets=replace(robot.magnets, axial=robot.magnets.axial + 0.01 * random(4, 2)))
    sensing = LinearisedSensing(robot, MOMENTS * (1 + random(4, 1)), 1 + random(4, 6), EARTH)
    for q in (BENT * random(5, 4, 6), BENT * random(5, 1, 6), BENT * random(6)):
        expected, slopes = sensing.linearise(q)
        u, J = CompiledSensing(sensing).linearise(q)
        torch.testing.assert_close(u, expected, atol=1e-12, rtol=0)
        torch.testing.assert_close(J, slopes, atol=1e-10, rtol=0)


@pytest.mark.parametrize("inputs", ["angles", "cosines"])
def test_batch_of_earth_fields(inputs):
    model = per_magnet(2) if inputs == "cosines" else of_network(paper, pcc_robot(2), "angles").model
    axes = random(3, 3, seed=2)
    q = BENT * random(4, 3, 6)
    u, J = CompiledSensing(MagneticSensing(pcc_robot(2), model, inputs, axes)).linearise(q)
    for k in range(3):
        expected, slopes = jacobian(MagneticSensing(pcc_robot(2), model, inputs, axes[k]), q[:, k])
        torch.testing.assert_close(u[:, k], expected, atol=1e-10, rtol=1e-12)
        torch.testing.assert_close(J[:, k], slopes, atol=1e-8, rtol=1e-9)


@pytest.mark.parametrize("of_sensor", [[0, 0, 1, 1, 0, 1], [0, 0, 0, 0, 1, 0]])
@pytest.mark.parametrize("make", [paper, cosine])
def test_seeds_and_robots_are_dimensions(make, of_sensor):
    """Sensors in the order of the networks or not, equally many for each network or not."""
    robot = pcc_robot(2, tilt=0.1 * random(4))
    model = SeedEnsemble([[make(10 * s + k, 9).double() for k in range(2)] for s in range(3)], of_sensor)
    sensing, q = MagneticSensing(robot, model), BENT * random(3, 4, 6)
    u, J = CompiledSensing(sensing).linearise(q)
    expected, slopes = jacobian(sensing, q)
    torch.testing.assert_close(u, expected, atol=1e-10, rtol=1e-12)
    torch.testing.assert_close(J, slopes, atol=1e-8, rtol=1e-9)


def test_networks_in_single_precision_are_evaluated_in_it():
    """As in torch: the difference from double precision is that of rounding."""
    networks = [[paper(0, 9), paper(1, 9)]]
    robot, q = pcc_robot(2), BENT * random(1, 5, 6)
    single = MagneticSensing(robot, SeedEnsemble(networks, robot.sensors.segment), "angles")
    double = MagneticSensing(robot, SeedEnsemble(networks, robot.sensors.segment).double(), "angles")
    u, J = CompiledSensing(single).linearise(q)
    exact, slopes = CompiledSensing(double).linearise(q)
    torch.testing.assert_close(u, single(q), atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(u, exact, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(J, slopes, atol=1e-4 * float(slopes.abs().max()), rtol=0)
    assert not torch.equal(u, exact)


def test_later_changes_of_the_model_have_no_effect():
    network = cosine(0, 5).double()
    model = CompiledSensing(MagneticSensing(pcc_robot(1), network))
    before = model.linearise(torch.zeros(3).double())[0]
    network.offset.fill_(7.0)
    assert torch.equal(model.linearise(torch.zeros(3).double())[0], before)


class Rigid:
    """A segment of another kind."""

    length, coordinates, n_q = 0.1, ("length",), 1

    def pose(self, q, v):
        return torch.eye(4).to(q).expand(*q.shape[:-1], 4, 4)


def sequential(*extra):
    return MagneticSensing(pcc_robot(1), nn.Sequential(nn.Linear(5, 1), *extra))


MOUNTS = (magnet_mounts([0], 0.05), sensor_mounts([0], 0.1))
ENSEMBLE = SeedEnsemble([[cosine(0, 5)]] * 3, [0, 0, 0])
SUPPORTED = (
    "must be LinearisedSensing, or MagneticSensing with a MultipoleField on cosines, networks of the paper"
)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: CompiledSensing(lambda q: q), f"Input sensing of compiled {SUPPORTED}"),
        (
            lambda: CompiledSensing(MagneticSensing(pcc_robot(1), lambda xi: xi[..., 0])),
            f"Input sensing.model of compiled {SUPPORTED}.* instead received function",
        ),
        (lambda: CompiledSensing(sequential(nn.Flatten(-2))), f"{SUPPORTED}.* another kind"),
        (
            lambda: CompiledSensing(
                MagneticSensing(pcc_robot(1), DipoleResidual(torch.ones(2), cosine(0, 5)))
            ),
            f"{SUPPORTED}.* DipoleResidual",
        ),
        (
            lambda: CompiledSensing(MagneticSensing(pcc_robot(1), MultipoleField(MOMENTS), "angles")),
            SUPPORTED,
        ),
        (
            lambda: CompiledSensing(MagneticSensing(pcc_robot(1), paper(0, 5).train(), "angles")),
            "in evaluation mode; instead received in training",
        ),
        (
            lambda: CompiledSensing(LinearisedSensing(Robot((Rigid(),), *MOUNTS), MOMENTS)),
            "Input segments of Robot must be of constant or of affine curvature to be .*; instead received Rigid",
        ),
        (
            lambda: CompiledSensing(LinearisedSensing(pcc_robot(1), torch.ones(33).double())),
            "Input moments of .* must be at most 32; instead received 33",
        ),
        (
            lambda: CompiledSensing(MagneticSensing(pcc_robot(2), cosine(0, 5))),
            "Input cosines of CosineNetwork",
        ),
        (
            lambda: CompiledSensing(MagneticSensing(pcc_robot(1), ENSEMBLE)).linearise(
                torch.zeros(2, 3).double()
            ),
            r"Input q of SeedEnsemble must be of first dimension 3 \(seeds\); .* a batch of shape \(2,\)",
        ),
    ],
)
def test_bad_input(act, message):
    with pytest.raises(InputError, match=message):
        act()


def test_numba_is_imported_only_where_kernels_are():
    code = (
        "import sys, edition1.estimation.base, edition1.estimation.levenberg_marquardt; "
        "sys.exit('numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_not_a_number_stays_one():
    u, _ = CompiledSensing(LinearisedSensing(pcc_robot(1), MOMENTS)).linearise(
        torch.full((3,), math.nan).double()
    )
    assert bool(u.isnan().all())
