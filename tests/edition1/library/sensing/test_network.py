"""Shapes, order of sensors, derivatives and precision of the networks; nothing draws from the global generator."""

import pytest
import torch
from torch import nn

from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import jacobian
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.magnetic import MagneticSensing
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField
from edition1.sensing.network import (
    CosineNetwork,
    DipoleResidual,
    Dropout,
    PerSensor,
    _n_inputs,
    _SignedExponential,
    paper_network,
)
from edition1.sensing.relations import relations


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def cosine_network(seed=0, width=5):
    network = CosineNetwork(width, generator(seed), (6, 4))
    x = torch.randn(50, width, generator=generator(seed))
    network.standardise(3 * x + 1, 2 * x.sum(-1) - 5)
    return network


def dipole_network(seed=0, width=5):
    coefficients = torch.rand(1 + width // 4, generator=generator(seed))
    return DipoleResidual(coefficients, cosine_network(seed, width))


def test_paper_network_has_the_layers_of_section_3_2():
    network = paper_network(13, generator())
    kinds = [type(m) for m in network]
    assert kinds[0] is nn.BatchNorm1d
    assert kinds[1:17] == [Dropout, nn.Linear, nn.ReLU, nn.BatchNorm1d] * 4
    shapes = [tuple(m.weight.shape) for m in network if isinstance(m, nn.Linear)]
    assert shapes == [(96, 13), (256, 96), (64, 256), (24, 64), (1, 24)]
    assert network.eval()(torch.zeros(7, 13)).shape == (7,)


@pytest.mark.parametrize("make", [cosine_network, dipole_network])
@pytest.mark.parametrize("batch", [(), (1,), (3, 1, 2)])
def test_networks_on_cosines_take_any_batch(make, batch):
    xi = torch.rand(*batch, 9, generator=generator())
    network = make(width=9)
    u = network(xi)
    assert u.shape == batch
    torch.testing.assert_close(u.reshape(-1), network(xi.reshape(-1, 9)))


@pytest.mark.parametrize("make", [cosine_network, dipole_network])
def test_double_precision_is_the_same_network(make):
    xi = 0.5 + torch.rand(20, 5, generator=generator())
    single = make()(xi)
    torch.testing.assert_close(make().double()(xi.double()).float(), single, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("make", [cosine_network, dipole_network])
def test_derivatives_by_jacrev_are_exact(make):
    robot = pcc_robot(2)
    model = PerSensor([make(0, 9).double(), make(1, 9).double()], robot.sensors.segment)
    sensing = MagneticSensing(robot, model)
    q = 0.01 * torch.rand(4, 6, dtype=torch.float64, generator=generator())
    _, J = jacobian(sensing, q)
    step = 1e-6 * torch.eye(6, dtype=torch.float64)
    with torch.no_grad():
        difference = (sensing(q.unsqueeze(1) + step) - sensing(q.unsqueeze(1) - step)) / 2e-6
    torch.testing.assert_close(J.mT, difference, rtol=1e-5, atol=1e-4)


def test_standardised_inputs_have_mean_zero_and_spread_one():
    network = CosineNetwork(5, generator())
    xi = 2 + 3 * torch.randn(400, 5, generator=generator())
    xi[:, 2] = 7.0  # a relation that never changes must not divide by zero
    network.standardise(xi, xi.sum(-1))
    scaled = (xi - network.centre) / network.spread
    torch.testing.assert_close(scaled.mean(0), torch.zeros(5), atol=1e-5, rtol=0)
    torch.testing.assert_close(scaled.std(0), torch.tensor([1.0, 1.0, 0.0, 1.0, 1.0]))


def test_dipole_terms_are_the_first_multipole():
    robot = pcc_robot(2)
    q = 0.01 * torch.rand(8, 6, dtype=torch.float64, generator=generator())
    xi = relations(robot, q).cosines()
    moments = torch.as_tensor(ring("released").multipoles(1)).expand(2, 1)
    expected = MultipoleField(moments, earth_mt=0.065)(xi)
    coefficients = torch.cat([torch.tensor([0.065]).double(), moments[:, 0]])
    torch.testing.assert_close(DipoleResidual.terms(xi) @ coefficients, expected)


def test_every_sensor_is_predicted_by_its_network():
    networks = [cosine_network(seed) for seed in range(3)]
    order = [2, 0, 1, 0]
    xi = torch.rand(3, 2, 4, 5, generator=generator())
    u = PerSensor(networks, order)(xi)
    expected = torch.stack([networks[k](xi[..., j, :]) for j, k in enumerate(order)], dim=-1)
    torch.testing.assert_close(u, expected)


def test_dropout_only_acts_in_training():
    dropout, x = Dropout(0.25, generator()), torch.ones(20_000)
    y = dropout(x)
    assert float((y == 0).float().mean()) == pytest.approx(0.25, abs=0.02)
    assert float(y.mean()) == pytest.approx(1, abs=0.02)
    assert torch.equal(dropout.eval()(x), x)


def test_weights_come_from_the_given_generator_only():
    torch.manual_seed(0)
    before = torch.get_rng_state()
    a, b, c = (paper_network(5, generator(seed)) for seed in (1, 1, 2))
    a(torch.rand(8, 5, generator=generator()))
    assert torch.equal(torch.get_rng_state(), before)
    assert all(torch.equal(p, q) for p, q in zip(a.parameters(), b.parameters(), strict=True))
    assert not torch.equal(next(b[2].parameters()), next(c[2].parameters()))


def test_signed_exponential_has_a_gap_between_minus_one_and_one():
    y = _SignedExponential()(torch.tensor([-2.0, -1e-6, 1e-6, 2.0]))
    torch.testing.assert_close(y, torch.tensor([-(torch.e**2), -1.0, 1.0, torch.e**2]))
    with_head = paper_network(5, generator(), exponential_head=True)
    assert [type(m) for m in with_head[:-1]] == [type(m) for m in paper_network(5, generator())]


def test_number_of_inputs():
    assert _n_inputs(paper_network(13, generator())) == 13
    assert _n_inputs(dipole_network(width=9)) == 9
    assert _n_inputs(nn.ReLU()) is None


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (
            lambda: cosine_network()(torch.zeros(3, 9)),
            r"Input cosines of CosineNetwork must be of last dimension 5; instead received shape \(3, 9\)",
        ),
        (
            lambda: dipole_network()(torch.zeros(3, 9)),
            r"Input cosines of CosineNetwork must be of last dimension 5",
        ),
        (
            lambda: PerSensor([paper_network(13, generator())], [0, 0])(torch.zeros(2, 5)),
            r"Input xi of PerSensor must be of last dimensions \(2, 13\) \(sensors, relations\); "
            r"instead received shape \(2, 5\)",
        ),
        (lambda: PerSensor([cosine_network()], [0, 0])(torch.zeros(3, 5)), r"of last dimensions \(2, 5\)"),
        (
            lambda: PerSensor([cosine_network()], [0, 1]),
            "Input network_of_sensor of PerSensor must be indices of 1 networks",
        ),
    ],
)
def test_bad_input(act, message):
    with pytest.raises(InputError, match=message):
        act()
