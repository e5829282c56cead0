"""Readings with slopes: against magpylib, complex steps, torch's autograd and stored answers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from scipy.spatial.transform import Rotation
from training import FastNetwork, paper_network

from repro import (
    ConstantCurvature,
    Imu,
    InputError,
    Robot,
    Sensing,
    Sensor,
    load_robot,
    simulated_readings,
)
from repro.networks import Network, load_network, network_of
from repro.sensing import cut, numbers_in_room, relations, room_for

from .robots import CHAINS, STORED, chain, complex_pose, configuration, paper_robot

NETWORKS, ROBOTS = (Path(__file__).parents[2] / "data" / name for name in ("networks", "robots"))


def by_complex_poses(robot: Robot, q: np.ndarray, moments: np.ndarray, earth: np.ndarray) -> np.ndarray:
    """Multipole readings at a complex configuration: eqs (4) to (7) and the Legendre series, written down plainly."""
    magnets = [complex_pose(robot, q, magnet.place) for magnet in robot.magnets]
    rows = []
    for sensor in robot.sensors:
        R, at = complex_pose(robot, q, sensor.place)
        for axis in range(3) if sensor.axes == 3 else [2]:
            u = R[:, axis] @ earth
            for A, (M, centre) in zip(moments, magnets, strict=True):
                p = at - centre
                d = np.sqrt(p @ p)
                ca, cb, c = R[:, axis] @ M[:, 2], R[:, axis] @ p / d, M[:, 2] @ p / d
                for k, A_l in enumerate(A):
                    P, Q = (np.polynomial.Legendre.basis(n).deriv()(c) for n in (2 * k + 1, 2 * k + 2))
                    u += A_l / d ** (2 * k + 3) * (Q * cb - P * ca)
            rows.append(u)
    return np.array(rows)


@pytest.mark.parametrize("names", CHAINS, ids="-".join)
@pytest.mark.parametrize("scale", [0.0, 1e-5, 1.0])
def test_readings_and_slopes_agree_with_complex_steps(names, scale):
    robot, earth = chain(names), np.array([0.03, -0.02, 0.04])
    sensing = Sensing(robot, l_max=3, earth=earth)
    q = configuration(robot, scale * np.random.default_rng(1).uniform(-1, 1, robot.n_q))
    u, J = sensing.linearise(q)
    n, size = sensing.n_magnetic, np.abs(u[: sensing.n_magnetic]).max()
    np.testing.assert_allclose(
        u[:n], by_complex_poses(robot, q, sensing.moments, earth).real, rtol=0, atol=1e-12 * size
    )
    np.testing.assert_array_equal(sensing(q), u)
    for c in range(robot.n_q):
        step = np.zeros(robot.n_q, dtype=complex)
        step[c] = 1e-20j
        slope = by_complex_poses(robot, q + step, sensing.moments, earth).imag / 1e-20
        np.testing.assert_allclose(J[:n, c], slope, rtol=0, atol=1e-12 * max(np.abs(J[:n]).max(), size))
    for i, imu in enumerate(robot.imus):
        rows = slice(n + 3 * i, n + 3 * i + 3)
        R, _ = complex_pose(robot, q, imu.place)
        np.testing.assert_allclose(Rotation.from_rotvec(u[rows]).as_matrix(), R.real, rtol=0, atol=1e-12)
        _, X = robot.motion(q, [imu.place])
        np.testing.assert_allclose(J[rows], X[0, :, :3].T, rtol=0, atol=1e-14)


def test_a_gain_scales_readings_and_slopes():
    sensing, gain = Sensing(paper_robot(1)), np.array([1.1, 0.9, -1.0])
    q = [0.004, -0.003, 0.002]
    (u, J), (plain, slopes) = Sensing(paper_robot(1), gain=gain).linearise(q), sensing.linearise(q)
    np.testing.assert_allclose(u, gain * plain, rtol=1e-14)
    np.testing.assert_allclose(J, gain[:, None] * slopes, rtol=1e-14)


def test_readings_agree_with_magpylib_within_the_tail_of_the_series():
    q = np.random.default_rng(0).uniform(-1, 1, (20, 9)) * np.tile([0.017, 0.017, 0.005], 3)
    robot = paper_robot(3)
    for l_max, error in ((5, 2e-3), (7, 5e-5), (9, 1e-6)):
        difference = np.abs(Sensing(robot, l_max=l_max)(q) - simulated_readings(robot, q)).max()
        assert error / 100 < difference < error


@pytest.mark.parametrize("inputs", ["angles", "cosines"])
def test_relations_are_those_of_the_poses(inputs):
    """Eqs (4) to (6), and lambda for the Earth, from the poses of both parts."""
    robot, earth = paper_robot(2, tilt=0.1), np.array([0.3, -0.1, 0.9])
    q = np.random.default_rng(0).normal(size=(4, 6)) * 0.008
    q[0] = 0.0
    T_s, T_m = (robot.poses(q, [part.place for part in parts]) for parts in (robot.sensors, robot.magnets))
    o, m = T_s[..., :3, 2], T_m[..., :3, 2]
    apart = T_s[:, :, None, :3, 3] - T_m[:, None, :, :3, 3]
    d = np.linalg.norm(apart, axis=-1)
    cosines = [
        np.einsum("tsi,tmi->tsm", o, m),
        np.einsum("tsi,tsmi->tsm", o, apart) / d,
        np.einsum("tmi,tsmi->tsm", m, apart) / d,
    ]
    turned = np.arccos if inputs == "angles" else np.array
    of_magnets = np.stack([d, *map(turned, cosines)], axis=-1).reshape(4, 6, -1)
    expected = np.concatenate([turned(o @ earth / np.linalg.norm(earth))[..., None], of_magnets], axis=-1)
    found = relations(robot, q, inputs=inputs, earth=earth)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def paper_networks(files, *, double):
    """The networks in files of weights, as torch modules and as ours."""
    modules, mine = [], []
    for path in files:
        state = load_file(path)
        module = paper_network(len(state["0.weight"]))
        module.load_state_dict(state)
        modules.append(module.eval().double() if double else module.eval())
        mine.append(network_of({name: x.numpy() for name, x in module.state_dict().items()}))
    return modules, mine


@pytest.mark.parametrize("double", [True, False])
def test_networks_of_the_paper_predict_what_torch_predicts(double):
    files = sorted(NETWORKS.glob("*nb2*seed0*.safetensors"))[:2]
    modules, mine = paper_networks(files, double=double)
    q = np.random.default_rng(0).normal(size=(6, 6)) * 0.008
    sensing = Sensing(paper_robot(2), mine)
    u, J = sensing.linearise(q)
    xi = torch.from_numpy(sensing.relations(q)).to(torch.float64 if double else torch.float32)
    expected = [modules[j // 3](xi[:, j]).detach().numpy() for j in range(6)]
    np.testing.assert_allclose(u.T, expected, rtol=0, atol=1e-12 if double else 3e-6)
    if double:  # by autograd through the first edition's robot
        np.testing.assert_allclose(J, STORED["network_slopes"], rtol=0, atol=1e-12 * np.abs(J).max())
    else:
        np.testing.assert_array_equal(Sensing(paper_robot(2), [load_network(path) for path in files])(q), u)


@pytest.mark.slow
def test_the_fast_network_predicts_what_torch_predicts():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        module = FastNetwork(5).double()
    xi = torch.rand(50, 5, generator=torch.Generator().manual_seed(1)).double()
    module.centre, module.spread = xi.mean(0), xi.std(0)
    module.offset, module.scale = xi.sum(1).mean(), xi.sum(1).std()
    network = network_of({name: x.numpy() for name, x in module.state_dict().items()})
    u, slopes = network.linearise(xi.numpy())
    np.testing.assert_allclose(u, module(xi).detach().numpy(), rtol=0, atol=1e-13)
    expected = torch.func.vmap(torch.func.jacrev(module))(xi).detach().numpy()
    np.testing.assert_allclose(slopes, expected, rtol=0, atol=1e-12)


def test_what_an_imu_reads_beyond_the_prediction_is_a_turn_in_the_base():
    """Near half a turn, where rotation vectors jump, the difference is small and right."""
    robot = Robot([ConstantCurvature(0.1, 1.0)], imus=[Imu(1, 0.1)])
    sensing = Sensing(robot)
    u, near = sensing(np.array([[3.13, 0.0, 0.0], [3.15, 0.0, 0.0]]))
    np.testing.assert_allclose(sensing.difference(near, u), [0.0, 0.02, 0.0], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(sensing.difference([0.0, np.nan, 0.0], u), [np.nan] * 3)


def test_one_network_for_all_for_each_reading_or_for_each_segment():
    def constant(value):
        return Network([(np.zeros((1, 9)), np.array([value]))], "silu", "cosines")

    robot, q = paper_robot(2), np.zeros(6)
    assert Sensing(robot, constant(3.0))(q).tolist() == [3.0] * 6
    assert Sensing(robot, [constant(1.0), constant(2.0)])(q).tolist() == [1.0] * 3 + [2.0] * 3
    assert Sensing(robot, [constant(float(k)) for k in range(6)])(q).tolist() == list(range(6))


SMALL = Network([(np.zeros((1, 5)), np.zeros(1))], "relu", "angles")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Sensing(Robot([ConstantCurvature(0.1, 0.02)])),
            "one with sensors or IMUs; instead received neither",
        ),
        (
            lambda: Sensing(Robot([ConstantCurvature(0.1, 0.02)], sensors=[Sensor(1, 0.1)])),
            "one with magnets",
        ),
        (lambda: Sensing(paper_robot(2), SMALL), "one of 9 relations, as the robot has; instead received 5"),
        (
            lambda: Sensing(paper_robot(1), [SMALL, SMALL]),
            "one network, one for each of 3 readings or of 1 segments",
        ),
        (
            lambda: Sensing(paper_robot(1), 3),
            "model of Sensing must be networks; instead received int",
        ),
        (
            lambda: Sensing(paper_robot(1), gain=[1.0, 2.0]),
            "one number or one for each of 3 magnetic readings",
        ),
        (
            lambda: Sensing(paper_robot(2), moments=[[1.0], [2.0], [3.0]]),
            r"moments of Sensing must be numbers of shape",
        ),
        (lambda: relations(paper_robot(1), [0, 0, 0], inputs="degrees"), '"angles" or "cosines"'),
        (lambda: Sensing(paper_robot(1))([0, 0]), "of last dimension 3"),
        (
            lambda: load_network("nowhere.safetensors"),
            "must be a file; instead received nowhere.safetensors, which does",
        ),
        (lambda: load_network(__file__), "must be a safetensors file"),
        (lambda: network_of({"0.weight": np.zeros(3)}), "a network of the paper"),
        (
            lambda: Network([(np.zeros((2, 3)), np.zeros(2))], "relu", "angles"),
            "with one output; instead received 2",
        ),
        (lambda: SMALL(np.zeros(4)), r"xi of Network must be numbers of shape \(..., 5\)"),
        (lambda: SMALL(np.zeros(5) * 1j), "xi of Network must be real numbers; instead received ndarray"),
    ],
)
def test_what_cannot_be_is_refused_in_words(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_a_part_is_cut_at_its_number_and_shares_memory_also_without_machine_code():
    rows = np.arange(12.0).reshape(4, 3)
    np.testing.assert_array_equal(cut(rows, 3, (2, 3)), rows[1:3])
    cut(rows, 9, (3,))[:] = 0
    np.testing.assert_array_equal(rows[3], 0)
    np.testing.assert_array_equal(rows[2], [6, 7, 8])


@pytest.mark.parametrize("name", ["one_segment", "three_segments", "imu_arm"])
def test_the_room_of_an_evaluation_is_cut_without_overlap_or_rest(name):
    """In machine code nobody would notice: a cut does not look whether it ends within its array."""
    tables = load_robot(ROBOTS / f"{name}.toml").sensing().tables
    numbers = np.arange(float(numbers_in_room(tables)))
    room = room_for.py_func(tables, numbers)
    np.testing.assert_array_equal(np.sort(np.concatenate([part.ravel() for part in room])), numbers)
