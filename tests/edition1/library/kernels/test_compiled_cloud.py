"""The particle filter compiled: the same draws give the same particles as in torch, and readings the same cloud."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.base import Estimator, track
from edition1.estimation.particle_filter import ParticleFilter
from edition1.estimation.regions import Box, Disc
from edition1.kernels import compiled
from edition1.kernels._weighing import _smallest
from edition1.sensing.bend_sensor import BendSensor
from edition1_companion.twins.bend_curves import bend_curve, bend_readings

SETTINGS = {  # process noise [pi rad], noise [mT], and more
    "as printed": (0.02, 0.0, {"estimate": "best tenth", "resampling": "multinomial"}),
    "weighted mean": (0.004, 0.0, {"estimate": "weighted", "resampling": "systematic"}),
    "Gauss-Newton": (0.02, 0.0, {"estimate": "Gauss-Newton", "resampling": "systematic"}),
    "constant velocity": (
        0.0005,
        0.025,
        {"estimate": "weighted", "resampling": "systematic", "motion": "constant velocity"},
    ),
}
"""The paper's equations, and ours."""
SENSOR = BendSensor(15e-3)
FAST = compiled(SENSOR)
START = torch.zeros(2, dtype=torch.float64)


def bend_filter(**options):
    defaults = {
        "sensing": SENSOR,
        "process_noise": torch.tensor([0.01, 0.02], dtype=torch.float64) * math.pi,
        "noise_mt": 0.05,
        "region": Disc(math.pi / 2),
        "particles": 400,
    }
    return ParticleFilter(**(defaults | options))


def assert_equal(filter_, u, q0, **inputs):
    """Run both and compare: the particles agree to the error of the series, which sharp likelihoods magnify."""
    one, other = (track(replace(filter_, sensing=s), u, q0, seed=3, **inputs) for s in (SENSOR, FAST))
    torch.testing.assert_close(other.q, one.q, atol=1e-8, rtol=0)
    torch.testing.assert_close(other.covariance, one.covariance, atol=1e-9, rtol=1e-5)
    torch.testing.assert_close(other.u_hat, one.u_hat, atol=1e-7, rtol=0)
    torch.testing.assert_close(
        other.diagnostics["surprise"], one.diagnostics["surprise"], atol=1e-4, rtol=1e-6
    )
    ess = (x.diagnostics["effective_sample_size"] for x in (other, one))
    torch.testing.assert_close(*ess, atol=1e-6, rtol=1e-5)
    for name in ("lost", "masked"):
        assert torch.equal(other.diagnostics[name], one.diagnostics[name])


@pytest.mark.parametrize("setting", SETTINGS)
def test_settings_of_section_ii_d(setting):
    """On Flower from the straight start to the limit of the bend, where noise is drawn again."""
    process_noise_pi, noise, how = SETTINGS[setting]
    u = bend_readings(bend_curve("flower")[:120], noise_mt=noise, seed=0)
    width = torch.full((2,), process_noise_pi * math.pi, dtype=torch.float64)
    single = bend_filter(process_noise=width, noise_mt=noise or 0.01 / 2**0.5, particles=1000, **how)
    assert_equal(single, u, START)


@pytest.mark.parametrize("options", [{}, {"motion": "constant velocity", "resampling": "multinomial"}])
def test_batches_masks_missing_readings_and_known_coordinates(options):
    q = bend_curve("seagull")[:40, None] * torch.tensor([[1.0], [0.5], [-1.0]], dtype=torch.float64)
    u = bend_readings(q, noise_mt=0.05, seed=1)
    u[5:8, 1, 2] = math.nan
    mask = torch.ones(40, 1, 3, dtype=torch.bool)
    mask[20:, :, 0] = False
    known = torch.full((40, 3, 2), math.nan).double()
    known[:, 2, 1] = q[:, 2, 1]
    walk = torch.tensor([0.01, 0.02, 0.03]).double()[:, None].expand(-1, 2)
    assert_equal(
        bend_filter(process_noise=walk, **options), u, torch.zeros(3, 2).double(), mask=mask, known=known
    )


def test_a_batch_is_each_of_its_members():
    u = bend_readings(torch.stack([bend_curve(name)[:30] for name in ("spiral", "flower")], dim=1))
    filter_ = bend_filter(sensing=FAST, estimate="best tenth")
    both = track(filter_, u, torch.zeros(2, 2).double())
    for k in range(2):
        torch.testing.assert_close(both.q[:, k], track(filter_, u[:, k], START).q, atol=1e-12, rtol=0)


def test_lost_and_found():
    """Readings jump by a radian: both lose the track and find it at the same step."""
    q = torch.tensor([[0.6, 0.1], [-0.5, 0.4]], dtype=torch.float64).repeat_interleave(5, 0)
    filter_ = bend_filter(process_noise=torch.full((2,), 0.01).double(), restart=True)
    assert_equal(filter_, bend_readings(q), q[0])
    found = track(replace(filter_, sensing=FAST), bend_readings(q), q[0])
    assert found.diagnostics["lost"].tolist() == [False] * 5 + [True] + [False] * 4
    assert float((found.q[-1] - q[-1]).norm()) < 0.05


def test_noise_wider_than_the_region_leaves_particles_inside():
    filter_ = bend_filter(process_noise=torch.full((2,), 3.0).double(), region=Disc(0.3))
    u = bend_readings(torch.tensor([[0.2, 0.1]] * 6, dtype=torch.float64))
    assert_equal(filter_, u, START)
    state = filter_.init(START)
    for k in range(6):
        state, _ = replace(filter_, sensing=FAST).step(state, u[k], 0.0)
        assert bool(filter_.region.contains(state.q).all())


def test_one_particle_and_single_precision():
    u = bend_readings(bend_curve("spiral")[:5])
    assert_equal(bend_filter(particles=1, estimate="best tenth"), u, START)
    found = track(bend_filter(sensing=FAST), u.float(), START.float())
    assert found.q.dtype == found.covariance.dtype == torch.float32


def test_same_seed_same_bits_and_an_unchanged_state():
    filter_, u = bend_filter(sensing=FAST), bend_readings(START)
    state = filter_.init(START, seed=7)
    before = state.q.clone()
    (first, a), (second, b) = (filter_.step(state, u, 0.0) for _ in range(2))
    assert torch.equal(state.q, before)
    assert torch.equal(first.q, second.q)
    assert torch.equal(a.q, b.q)
    assert isinstance(filter_, Estimator)


@pytest.mark.parametrize("n", [1, 2, 10, 999])
@pytest.mark.parametrize("levels", [1, 2, 5, None])
def test_the_best_are_as_many_as_asked_for_also_among_equals(n, levels):
    rng = np.random.default_rng(n)
    d = rng.random(n) ** 8 if levels is None else rng.integers(levels, size=n).astype(float)
    for keep in {1, -(-n // 10), n}:
        limit, ties = _smallest(d, keep)
        assert (d < limit).sum() + ties == keep
        assert 0 <= ties <= (d == limit).sum()


def test_far_readings_do_not_underflow():
    found = track(bend_filter(noise_mt=1e-6, sensing=FAST), bend_readings(torch.ones(3, 2).double()), START)
    assert bool(torch.isfinite(found.q).all() & torch.isfinite(found.diagnostics["surprise"]).all())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"region": None},
            "Input region of ParticleFilter must be Disc for a compiled sensor; instead received None.",
        ),
        (
            {"region": Box(-torch.ones(2), torch.ones(2))},
            "Input region of ParticleFilter must be Disc for a compiled sensor; instead received Box.",
        ),
    ],
)
def test_supported_models(options, message):
    with pytest.raises(InputError, match=message):
        bend_filter(sensing=FAST, **options)
