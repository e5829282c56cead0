"""Gradient descent compiled against torch: iterate by iterate the same numbers."""

import math
from pathlib import Path

import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.gradient_descent import GradientDescent
from edition1.kernels import compiled
from edition1.kinematics.paper_robots import affine_robot, pcc_robot
from edition1.sensing.ensemble import SeedEnsemble
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1.sensing.weights import load_paper_network
from edition1_companion.twins.table_1_rows import rows_named, simulate
from edition1_companion.twins.trajectories import flower, lemniscate

FOLDER = Path(__file__).parents[4] / "data" / "networks"
MOMENTS = torch.from_numpy(ring("released").multipoles(9))
STEPS = 6


def step_sizes(n_segments):
    bending, elongation = {1: (3.5e-4, 3.5e-4), 2: (3e-3, 3e-4), 3: (2e-3, 2e-4)}[n_segments]
    return torch.tensor([bending, bending, elongation] * n_segments, dtype=torch.float64)


def networks(names, per_network=1, seeds=(0, 1, 2)):
    """Committed networks, each for so many sensors."""
    loaded = [
        [load_paper_network(FOLDER / f"{name}_seed{seed}.safetensors") for name in names] for seed in seeds
    ]
    return SeedEnsemble(loaded, [k for k in range(len(names)) for _ in range(per_network)]).double()


def both(sensing, step_size, u, q0, *, options=None, **inputs):
    """Trajectories by torch and by the kernel."""
    return [
        track(
            GradientDescent(model, step_size, **(options or {})),
            u,
            q0,
            **inputs,
        )
        for model in (sensing, compiled(sensing))
    ]


def assert_equal(one, other):
    torch.testing.assert_close(other.q, one.q, atol=1e-10, rtol=1e-10)
    torch.testing.assert_close(other.u_hat, one.u_hat, atol=1e-9, rtol=1e-9)
    torch.testing.assert_close(other.diagnostics["loss"], one.diagnostics["loss"], atol=1e-12, rtol=1e-8)
    for name in ("best_iteration", "masked"):
        assert torch.equal(other.diagnostics[name], one.diagnostics[name])


@pytest.mark.parametrize("names", [["n_b=1"], ["n_b=2"], ["n_b=3", "n_s=6"], ["n_e=(1,0,0)", "n_e=(0,0,1)"]])
def test_table_1_with_the_networks_of_the_paper(names):
    """Three seeds, rows as a batch with masked sensors, momentum carried; weights taken in double precision."""
    rows = rows_named(names)
    simulation, n = simulate(rows, steps=400), rows[0].n_segments
    kind = "pcc" if simulation.earth_axis is None else "earth"
    model = networks([f"{kind}_nb{n}_segment{k + 1}" for k in range(n)], simulation.mask.shape[-1] // n)
    sensing = MagneticSensing(simulation.robot, model, "angles", simulation.earth_axis)
    u = simulation.u[:STEPS].unsqueeze(1).expand(-1, 3, -1, -1)
    start = simulation.q[0].expand(3, len(rows), -1)
    mask = simulation.mask.expand(STEPS, 1, *simulation.mask.shape)
    assert_equal(*both(sensing, step_sizes(n), u, start, mask=mask))


def test_affine_flower():
    """Readings of the networks themselves, off by as much as networks are."""
    model, q = networks([f"affine_sensor{k}" for k in range(1, 10)]), flower()
    sensing = MagneticSensing(affine_robot(magnet_shift_m=0.0), model, "angles")
    with torch.no_grad():
        u = sensing(q[:STEPS].expand(3, -1, -1)).movedim(0, 1)
    generator = torch.Generator().manual_seed(0)
    u, start = u + 0.02 * torch.randn(u.shape, generator=generator, dtype=u.dtype), q[0].expand(3, -1)
    step_size = torch.tensor([1.0, 5.0, 1.0, 2e-4], dtype=torch.float64)  # of the released code
    assert_equal(*both(sensing, step_size, u, start, options={"momentum": 0.3}))


@pytest.mark.parametrize(
    "options", [{}, {"carry_momentum": False}, {"iterations": 1}, {"iterations": 2, "momentum": 0.0}]
)
def test_options_masks_known_coordinates_and_missing_readings(options):
    robot, q = pcc_robot(2, 4), lemniscate(2)[:STEPS]
    sensing = LinearisedSensing(robot, MOMENTS, 1 + 0.1 * torch.arange(8).double() / 8)
    generator = torch.Generator().manual_seed(0)
    u = sensing(q).unsqueeze(1) + 1e-3 * torch.randn(STEPS, 3, 8, generator=generator, dtype=torch.float64)
    u[2, 1, 3] = math.nan
    mask = torch.ones(STEPS, 1, 8, dtype=torch.bool)
    mask[3:, :, 5] = False
    known = torch.full((STEPS, 3, 6), math.nan).double()
    known[:, 0, 2], known[1:, 1, 5] = q[:, 2], q[1:, 5]
    start = q[0].expand(3, -1)
    one, other = both(sensing, step_sizes(2), u, start, options=options, mask=mask, known=known)
    assert_equal(one, other)
    assert torch.equal(other.q[:, 0, 2], q[:, 2])
    assert other.diagnostics["masked"].tolist() == [[0] * 3, [0] * 3, [0, 1, 0], [1] * 3, [1] * 3, [1] * 3]


def test_start_at_the_straight_pose():
    """Where the angles have their kink, for the network of the paper."""
    model = networks(["pcc_nb2_segment1", "pcc_nb2_segment2"], per_network=3, seeds=(0,))
    sensing = MagneticSensing(pcc_robot(2), model, "angles")
    u = readings(pcc_robot(2), lemniscate(2)[3:6], ring("released")).unsqueeze(1)
    assert_equal(*both(sensing, step_sizes(2), u, torch.zeros(1, 6).double()))


def test_precision_of_the_caller_is_kept():
    sensing = LinearisedSensing(pcc_robot(1), MOMENTS)
    method = GradientDescent(compiled(sensing), step_sizes(1))
    state, estimate = method.step(method.init(torch.zeros(3)), sensing(torch.zeros(3).double()).float(), 0.0)
    assert state.q.dtype == state.momentum.dtype == estimate.u_hat.dtype == torch.float32


@pytest.mark.parametrize("made", [lambda sensing: sensing, compiled], ids=["torch", "compiled"])
def test_divergence_is_refused(made):
    sensing = made(LinearisedSensing(pcc_robot(1), MOMENTS))
    method = GradientDescent(sensing, torch.full((3,), 1e300, dtype=torch.float64))
    with pytest.raises(InputError, match=r"Input q of Robot must be finite; instead received \d+ values"):
        method.step(method.init(torch.zeros(3).double()), torch.ones(3).double(), 0.0)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (
            lambda s: GradientDescent(compiled(s), step_sizes(2)).step(
                GradientDescent(s, step_sizes(2)).init(torch.zeros(6).double()), torch.ones(3).double(), 0.0
            ),
            r"Input q of GradientDescent must be of last dimension 3; instead received shape \(6,\)",
        ),
        (
            lambda s: GradientDescent(compiled(s), step_sizes(1)).step(
                GradientDescent(s, step_sizes(1)).init(torch.zeros(3).double()), torch.ones(4).double(), 0.0
            ),
            r"Input u of GradientDescent must be of last dimension 3; instead received shape \(4,\)",
        ),
    ],
)
def test_bad_input(act, message):
    with pytest.raises(InputError, match=message):
        act(LinearisedSensing(pcc_robot(1), MOMENTS))
