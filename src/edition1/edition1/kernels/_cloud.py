"""The cloud of a particle filter compiled: weigh, resample and move, for one cube on a bent arc.

The draws come from the caller, so that the same seed gives the particles of the torch filter: to rounding and the
error of the series for the field, below 1e-8 mT for the cube and the arc of Mitchell et al. 2021.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edition1.errors import bad_input
from edition1.estimation._particle_cloud import Weighed
from edition1.estimation._resampling import draws
from edition1.estimation.regions import Disc
from edition1.kernels._bend import CompiledBendSensor
from edition1.kernels._bend_series import bend_series
from edition1.kernels._weighing import weigh
from edition1.kernels.compilation import machine_code


class CompiledCloud:
    """Weighs and moves the particles of a filter whose model is a bent arc.

    Parameters
    ----------
    sensing
        The compiled sensor.
    region
        :class:`~edition1.estimation.regions.Disc` that particles never leave.

    Raises
    ------
    InputError
        If the region is another one, or the series for the field is not good enough over the region.
    """

    def __init__(self, sensing: CompiledBendSensor, region: Any) -> None:
        if not isinstance(region, Disc):
            received = None if region is None else type(region).__name__
            raise bad_input("region", "ParticleFilter", "Disc for a compiled sensor", received)
        self.exact = sensing
        self.series = bend_series(sensing.length, region.radius, sensing.cube)

    def weigh(
        self,
        q: Float[Tensor, "*q n 2"],
        u: Float[Tensor, "*u 3"],
        use: Bool[Tensor, "*u 3"],
        noise_mt: float,
        *,
        top: bool,
    ) -> Weighed:
        """Weigh particles, as :func:`edition1.estimation._particle_cloud.weighed` does from their errors."""
        batch, n = _batch(q.shape[:-2], u.shape[:-1]), q.shape[-2]
        flat, u_, use_ = _rows(q, batch, 2), _rows(u, batch, 1), _rows(use, batch, 1)
        w, mean, C = np.empty((len(flat), n)), np.empty((len(flat), 2)), np.empty((len(flat), 2, 2))
        ess, unlikely, best = np.empty(len(flat)), np.empty(len(flat)), np.empty((len(flat), 2))
        keep = math.ceil(n / 10) if top else 0
        series = (self.series.coefficients, self.series.reach)
        weigh(flat, u_, use_, float(noise_mt), *series, keep, w, mean, C, ess, unlikely, best)

        pair = (*batch, 2)
        cloud = _tensor(w, (*batch, n), q), _tensor(mean, pair, q), _tensor(C, (*pair, 2), q)
        fit = _tensor(ess, batch, q), _tensor(unlikely, batch, q)
        return Weighed(*cloud, *fit, _tensor(best, pair, q) if top else None)

    def move(
        self,
        q: Float[Tensor, "*q n 2"],
        velocity: Float[Tensor, "*q n 2"] | None,
        w: Float[Tensor, "*batch n"],
        width: Float[Tensor, "*noise 2"],
        resampling: str,
        generator: np.random.Generator,
        limit: int,
    ) -> tuple[Float[Tensor, "*batch n 2"], Float[Tensor, "*batch n 2"]]:
        """Draw particles by their weights and move them; noise that leads outside is drawn again.

        Parameters
        ----------
        q, velocity, w
            Particles, their velocities when they carry any, and their weights.
        width
            Standard deviation of the noise.
        resampling
            Scheme of :func:`edition1.estimation._resampling.resample`.
        generator
            Draws as for the torch filter: the shares at which particles are drawn, then noise as often as needed.
        limit
            Largest number of draws of noise; particles still outside then stay where they were.

        Returns
        -------
        tuple
            Particles and the velocities that brought them there.
        """
        batch, n = _batch(q.shape[:-2], w.shape[:-1], width.shape[:-1]), q.shape[-2]
        old, w_, width_ = _rows(q, batch, 2), _rows(w, batch, 1), _rows(width, batch, 1)
        drift = old[:, :0] if velocity is None else _rows(velocity, batch, 2)
        drawn, outside = np.empty(old.shape[:2], dtype=np.int64), np.ones(old.shape[:2], dtype=np.bool_)
        following, moved = np.empty_like(old), np.empty_like(old)
        _draw(w_, draws(n, resampling, generator), drawn)
        for _ in range(limit):
            noise = generator.standard_normal((n, 2))
            if not _move(old, drift, drawn, noise, width_, self.series.reach, outside, following, moved):
                break
        else:
            _stay(old, drawn, outside, following, moved)
        shape = (*batch, n, 2)
        return _tensor(following, shape, q), _tensor(moved, shape, q)


def _batch(*shapes: torch.Size) -> torch.Size:
    """Shape that batches broadcast to. Most often they are equal, and torch takes longer than a small cloud."""
    first = shapes[0]
    return first if all(shape == first for shape in shapes) else torch.broadcast_shapes(*shapes)


def _tensor(x: np.ndarray, shape: tuple[int, ...], like: Tensor) -> Tensor:
    """Array as a tensor of that shape, on the device and in the precision of another."""
    return torch.from_numpy(x.reshape(shape)).to(like)


def _rows(x: Tensor, batch: torch.Size, own: int) -> np.ndarray:
    """Members of a batch one after the other, contiguous; the last ``own`` dimensions are theirs."""
    values = x.numpy(force=True)
    shape = values.shape[values.ndim - own :]
    if values.shape != (*batch, *shape):
        values = np.broadcast_to(values, (*batch, *shape))
    dtype = np.bool_ if values.dtype == np.bool_ else np.float64
    return np.ascontiguousarray(values, dtype=dtype).reshape(-1, *shape)


@machine_code()
def _draw(w, points, drawn):
    """Particles whose share of the cumulated weights holds each point: one pass over both."""
    n = len(points)
    edges = np.empty(n)
    for m in range(len(w)):
        total = 0.0
        for i in range(n):
            total += w[m, i]
            edges[i] = total
        k = 0
        for i in range(n):
            at = points[i] * total
            while k < n - 1 and edges[k] <= at:
                k += 1
            drawn[m, i] = k


@machine_code()
def _move(q, drift, drawn, noise, width, reach, outside, following, moved):
    """Move all that are outside once more, and count those that still are."""
    n_outside = 0
    for m in range(len(q)):
        for i in range(q.shape[1]):
            if not outside[m, i]:
                continue
            k, dx, dy = drawn[m, i], width[m, 0] * noise[i, 0], width[m, 1] * noise[i, 1]
            if drift.shape[1] > 0:
                dx, dy = dx + drift[m, k, 0], dy + drift[m, k, 1]
            x, y = q[m, k, 0] + dx, q[m, k, 1] + dy
            moved[m, i, 0], moved[m, i, 1] = dx, dy
            following[m, i, 0], following[m, i, 1] = x, y
            outside[m, i] = not x * x + y * y <= reach * reach
            n_outside += 1 if outside[m, i] else 0
    return n_outside


@machine_code()
def _stay(q, drawn, outside, following, moved):
    """Leave those that are outside where they were."""
    for m in range(len(q)):
        for i in range(q.shape[1]):
            if outside[m, i]:
                for c in range(2):
                    following[m, i, c], moved[m, i, c] = q[m, drawn[m, i], c], 0.0
