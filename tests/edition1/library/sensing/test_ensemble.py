"""Folded layers equal the network, the ensemble equals the loop over seeds and sensors."""

import pytest
import torch
from torch import nn

from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import jacobian
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.ensemble import SeedEnsemble, _fold_batch_norm, _fold_scaling
from edition1.sensing.magnetic import MagneticSensing
from edition1.sensing.network import CosineNetwork, DipoleResidual, PerSensor, paper_network


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def paper(seed, width=9):
    """Network of the paper whose batch norms have statistics of their own, as after training."""
    g = generator(seed)
    network = paper_network(width, g)
    for m in network:
        if isinstance(m, nn.BatchNorm1d):
            for x, low, high in ((m.running_mean, -1, 1), (m.running_var, 0.5, 2)):
                nn.init.uniform_(x, low, high, generator=g)
            nn.init.uniform_(m.weight, -2, 2, generator=g)
            nn.init.uniform_(m.bias, -1, 1, generator=g)
    return network.eval()


def cosine(seed, width=9):
    network = CosineNetwork(width, generator(seed), (16, 8))
    x = torch.randn(50, width, generator=generator(seed))
    network.standardise(3 * x + 1, 2 * x.sum(-1) - 5)
    return network


def apply(layers, activation, x):
    for W, b in layers[:-1]:
        x = activation(x @ W.T + b)
    W, b = layers[-1]
    return (x @ W.T + b).squeeze(-1)


@pytest.mark.parametrize(
    ("make", "fold", "activation"),
    [(paper, _fold_batch_norm, torch.relu), (cosine, _fold_scaling, nn.functional.silu)],
)
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-5), (torch.float64, 1e-12)])
def test_folded_layers_equal_the_network(make, fold, activation, dtype, tolerance):
    network = make(3).to(dtype)
    x = torch.randn(200, 9, dtype=dtype, generator=generator())
    layers = fold(network)
    assert {W.dtype for W, _ in layers} == {dtype}
    with torch.no_grad():
        torch.testing.assert_close(apply(layers, activation, x), network(x), atol=tolerance, rtol=tolerance)


@pytest.mark.parametrize("make", [paper, cosine])
@pytest.mark.parametrize("order", [[0, 0, 1, 1], [1, 0, 0, 1], [0, 1, 1, 1], [1, 1]])
@pytest.mark.parametrize("batch", [(), (1,), (3, 2)])
def test_ensemble_is_the_loop_over_seeds(make, order, batch):
    """Sensors in the order of the networks or not, equally many for each network or not."""
    networks = [[make(10 * s + k).double() for k in range(2)] for s in range(3)]
    xi = torch.rand(3, *batch, len(order), 9, dtype=torch.float64, generator=generator())
    expected = torch.stack([PerSensor(n, order).eval()(x) for n, x in zip(networks, xi, strict=True)])
    torch.testing.assert_close(SeedEnsemble(networks, order)(xi), expected, rtol=1e-12, atol=1e-12)


def test_derivatives_are_those_of_the_loop():
    robot, order = pcc_robot(2), [0, 0, 0, 1, 1, 1]
    networks = [[cosine(10 * s + k).double() for k in range(2)] for s in range(3)]
    q = 0.01 * torch.rand(3, 4, 6, dtype=torch.float64, generator=generator())
    _, J = jacobian(MagneticSensing(robot, SeedEnsemble(networks, order)), q)
    for s in range(3):
        _, expected = jacobian(MagneticSensing(robot, PerSensor(networks[s], order)), q[s])
        torch.testing.assert_close(J[s], expected)


def test_readings_have_the_precision_of_the_relations():
    ensemble = SeedEnsemble([[paper(0)]], [0, 0])
    xi = torch.rand(1, 2, 9, dtype=torch.float64, generator=generator())
    assert ensemble(xi).dtype == torch.float64
    torch.testing.assert_close(ensemble(xi).float(), ensemble(xi.float()))


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (
            lambda: SeedEnsemble([[paper(0)], [paper(0, 5)]], [0]),
            "Input networks of SeedEnsemble must be equally many networks of one architecture for every seed",
        ),
        (lambda: SeedEnsemble([[paper(0)], [paper(0), paper(1)]], [0]), "equally many networks"),
        (lambda: SeedEnsemble([], [0]), "equally many networks"),
        (lambda: SeedEnsemble([[paper(0)]], [1]), "network_of_sensor of SeedEnsemble must be indices of 1"),
        (
            lambda: SeedEnsemble([[DipoleResidual(torch.ones(3), cosine(0))]], [0]),
            "must be networks of the paper or on cosines; instead received DipoleResidual",
        ),
        (
            lambda: SeedEnsemble([[nn.Sequential(nn.Linear(9, 1), nn.Flatten(-2))]], [0]),
            "Input network of SeedEnsemble must be a network of the paper; instead received Linear, Flatten",
        ),
        (
            lambda: SeedEnsemble([[paper(0)]] * 3, [0, 0])(torch.zeros(2, 7, 2, 9)),
            r"Input xi of SeedEnsemble must be of first and last dimensions \(3, 2, 9\)",
        ),
        (lambda: SeedEnsemble([[paper(0)]], [0, 0])(torch.zeros(1, 2, 5)), r"dimensions \(1, 2, 9\)"),
    ],
)
def test_bad_input(act, message):
    with pytest.raises(InputError, match=message):
        act()
