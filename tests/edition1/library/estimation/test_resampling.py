"""Weights without underflow, and both ways to draw, by their frequencies."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from scipy import stats

from edition1.errors import InputError
from edition1.estimation._resampling import effective_sample_size, normalised, resample, stream, weights
from edition1.estimation.regions import Box, Disc, Region

CALLS = 1500
W = torch.tensor([0.5, 0.02, 0.08, 0.13, 0.001, 0.1, 0.16, 0.009], dtype=torch.float64)


def counts(scheme, seed=0):
    generator = np.random.default_rng(seed)
    drawn = [resample(W, scheme, generator) for _ in range(CALLS)]
    return torch.stack([torch.bincount(i, minlength=len(W)) for i in drawn]).numpy()


def test_multinomial_frequencies():
    """Chi-square over all draws, and the covariance of a multinomial distribution."""
    found = counts("multinomial")
    expected = CALLS * len(W) * W.numpy()
    assert stats.chisquare(found.sum(0), expected).pvalue > 1e-3
    w = W.numpy()
    covariance = len(W) * (np.diag(w) - np.outer(w, w))
    np.testing.assert_allclose(np.cov(found.T), covariance, atol=5 * 2 / math.sqrt(CALLS))


def test_systematic_frequencies():
    """Each particle is drawn floor or ceil of n w times; the share of the latter is the fraction of n w."""
    found, share = counts("systematic"), len(W) * W.numpy()
    assert ((found == np.floor(share)) | (found == np.ceil(share))).all()
    fraction = share - np.floor(share)
    above = (found - np.floor(share)).sum(0)
    uncertain = fraction > 0
    deviation = (above - CALLS * fraction)[uncertain]
    z = deviation / np.sqrt(CALLS * fraction * (1 - fraction))[uncertain]
    # Counts of one comb depend on each other: a bound for each, not for their sum.
    assert np.abs(z).max() < 3.9


@pytest.mark.parametrize("scheme", ["multinomial", "systematic"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_only_particles_with_weight_are_drawn(scheme, dtype):
    w = torch.zeros(1000, dtype=dtype)
    w[[0, 417]] = torch.tensor([0.25, 0.75], dtype=dtype)
    drawn = [resample(w, scheme, np.random.default_rng(seed)) for seed in range(20)]
    assert set(torch.cat(drawn).tolist()) == {0, 417}


def test_members_of_a_batch_draw_as_alone():
    w = torch.rand(3, 2, 50, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    for scheme in ("multinomial", "systematic"):
        batched = resample(w, scheme, np.random.default_rng(1))
        alone = [[resample(x, scheme, np.random.default_rng(1)) for x in row] for row in w]
        assert torch.equal(batched, torch.stack([torch.stack(row) for row in alone]))


def test_weights_do_not_underflow():
    log_w = normalised(torch.tensor([-1e12, -1e12 - 1, -2e12], dtype=torch.float64))
    w = weights(log_w)
    assert float(w.sum()) == pytest.approx(1)
    assert float(w[1] / w[0]) == pytest.approx(math.exp(-1), rel=1e-3)  # 1e12 has four digits after the point
    assert float(w[2]) > 0
    assert float(effective_sample_size(w)) == pytest.approx(1 / float((w * w).sum()))


def test_effective_sample_size_of_equal_weights_is_their_number():
    assert float(
        effective_sample_size(weights(normalised(torch.full((7,), -1e5).double())))
    ) == pytest.approx(7)


def test_disc_is_filled_evenly():
    disc = Disc(1.5)
    q = disc.sample(20_000, np.random.default_rng(0))
    assert isinstance(disc, Region)
    assert bool(disc.contains(q).all())
    assert not bool(disc.contains(torch.tensor([1.2, 1.2])))
    squared = (q * q).sum(-1).numpy() / 1.5**2
    assert stats.kstest(squared, "uniform").pvalue > 1e-3
    assert stats.kstest(torch.atan2(q[:, 1], q[:, 0]).numpy() / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3


def test_box_is_filled_evenly():
    box = Box(torch.tensor([-1.0, 2.0]), torch.tensor([1.0, 5.0]))
    q = box.sample(20_000, np.random.default_rng(0))
    assert isinstance(box, Region)
    assert bool(box.contains(q).all())
    assert box.contains(torch.tensor([[0.0, 3.0], [0.0, 1.9], [1.1, 3.0]])).tolist() == [True, False, False]
    for k, (low, width) in enumerate([(-1, 2), (2, 3)]):
        assert stats.kstest(q[:, k].numpy(), stats.uniform(low, width).cdf).pvalue > 1e-3


def test_streams_are_those_of_their_keys_in_every_thread():
    def drawn(seed):
        return [stream(seed, step, restart=bool(step % 2)).random() for step in range(200)]

    def fresh(seed):
        keys = (np.array([seed, 2 * step + step % 2], dtype=np.uint64) for step in range(200))
        return [np.random.Generator(np.random.Philox(key=key)).random() for key in keys]

    stream(5, 5).standard_normal(7)  # leaves nothing behind
    seeds = [0, 1, 7, 2**63]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(drawn, seeds)) == [fresh(seed) for seed in seeds]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: resample(W, "residual", np.random.default_rng(0)),
            "Input scheme of resample must be one of 'multinomial', 'systematic'; instead received 'residual'.",
        ),
        (lambda: Disc(0.0), r"Input radius of Disc must be positive \[rad\]; instead received 0.0."),
        (
            lambda: Box(torch.zeros(1), torch.zeros(1)),
            r"Input lower, upper of Box must be ordered bounds; instead received \(\[0.0\], \[0.0\]\).",
        ),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
