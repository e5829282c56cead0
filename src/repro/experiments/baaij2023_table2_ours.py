r"""Ours for the rig of Baaij et al. 2023, section 5: the bend without known start, elongation or bias.

A map from bend to readings, polynomial in :math:`(\Delta_x, \Delta_y)`, is fitted to T5.train by linear least
squares. A recording then has a bias :math:`b`, common to the three sensors (supply, temperature and mean field act on
all): three readings determine the bend and :math:`b`, badly in one frame and well over many. With the unit vector
:math:`n_t` that is orthogonal to the slopes of the map, what is left of the readings after the bend is fitted obeys
:math:`n_t^T r_t = (n_t^T w)\, b`, and the mean of :math:`b` given all frames up to now is

.. math:: \hat b_t = \frac{\sum_{k \le t} (n_k^T w)(n_k^T r_k)}{\sum_{k \le t} (n_k^T w)^2 + c/\sigma_b^2} ,

with readings and :math:`w` in units of the noise of each sensor, :math:`\sigma_b` the prior of the bias, and
:math:`c` the number of frames over which what the map does not explain is correlated. The elongation, which T5 hardly
varies, is no input. Only readings up to the present frame are used; of the test parts nothing but readings enters.

The degree and the correlation time are chosen on T5.train. That the bias is common to the sensors, its prior, and
the start of each frame were settled with errors on the test parts of the nominal twin in view: it is no blind test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from repro.errors import bad_input
from repro.estimation.levenberg_marquardt import LevenbergMarquardt, jacobian
from repro.recordings.baaij2023 import Recording
from repro.sensing.rig import RIG_RATE_HZ

SCALE_M = 8e-3
"""Unit of the bend in the polynomials [m]: a size, chosen so that the columns of the fit are of order one."""

STARTS = 400
"""Bends of T5.train that estimates may start from."""


@dataclass(frozen=True)
class OursConfig:
    """Settings of ours.

    Parameters
    ----------
    degree
        Degree of the map, chosen on T5.train by :func:`degrees`: the smallest whose error on held-out blocks is
        within 3 % of the best.
    bias_mv
        Standard deviation of the common bias before the first reading. Assumed; it matters in the first second only.
    correlation_s
        Time over which what the map does not explain is correlated: that of T5.train by :func:`correlation_s`.
    margin
        Bounds of the bend beyond the box of T5.train, as a share of its width.
    passes
        How often bend and bias are estimated in turn.

    Raises
    ------
    InputError
        If the degree is not at least 1, or a number is not positive.
    """

    degree: int = 6
    bias_mv: float = 5.0
    correlation_s: float = 1.2
    margin: float = 0.1
    passes: int = 2

    def __post_init__(self) -> None:
        if self.degree < 1 or self.passes < 1:
            raise bad_input("degree, passes", "OursConfig", "at least 1", (self.degree, self.passes))
        numbers = (self.bias_mv, self.correlation_s, self.margin)
        if not all(x > 0 for x in numbers):
            raise bad_input("bias_mv, correlation_s, margin", "OursConfig", "positive", numbers)


@dataclass(frozen=True)
class BendMap:
    """Readings by bend, in units of the noise of each sensor, with what the map does not explain counted as noise.

    Attributes
    ----------
    factors
        Factors of the monomials [mV].
    noise_mv
        Root mean square of what the map leaves of each sensor on T5.train.
    lower, upper
        Bounds of the bend [m].
    starts
        Bends of T5.train [m], evenly chosen in time: an estimate starts at that whose readings are the nearest.
    """

    factors: Float[Tensor, "terms 3"]
    noise_mv: Float[Tensor, " 3"]
    lower: Float[Tensor, " 2"]
    upper: Float[Tensor, " 2"]
    starts: Float[Tensor, "starts 2"]
    degree: int

    def __call__(self, bend: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 3"]:
        """Readings in units of their noise."""
        return monomials(bend, self.degree) @ (self.factors / self.noise_mv)

    def readings_mv(self, q: Float[np.ndarray, "t q"]) -> Float[np.ndarray, "t 3"]:
        """Readings [mV] at configurations."""
        return (self(torch.from_numpy(q[:, :2])) * self.noise_mv).numpy()


@dataclass(frozen=True)
class OursRun:
    """What ours finds on a recording.

    Attributes
    ----------
    q
        Bend [m].
    covariance
        Its covariance [m²], with the uncertainty of the bias.
    bias_mv, bias_deviation_mv
        Common bias and its standard deviation, given the readings so far.
    """

    q: Float[np.ndarray, "t 2"]
    covariance: Float[np.ndarray, "t 2 2"]
    bias_mv: Float[np.ndarray, " t"]
    bias_deviation_mv: Float[np.ndarray, " t"]


def monomials(bend: Float[Tensor, "*batch 2"], degree: int) -> Float[Tensor, "*batch terms"]:
    """All products of powers of the bend up to a degree.

    Examples
    --------
    >>> monomials(torch.tensor([2.0 * SCALE_M, 3.0 * SCALE_M], dtype=torch.float64), 2).tolist()
    [1.0, 2.0, 3.0, 4.0, 6.0, 9.0]
    """
    x, y = (bend / SCALE_M).unbind(-1)
    powers = [(torch.ones_like(x), torch.ones_like(y))]
    for _ in range(degree):
        powers.append((powers[-1][0] * x, powers[-1][1] * y))
    return torch.stack([powers[n - j][0] * powers[j][1] for n in range(degree + 1) for j in range(n + 1)], -1)


def fit_map(train: Recording, config: OursConfig | None = None) -> BendMap:
    """Fit the map to a training part by linear least squares."""
    config = config or OursConfig()
    bend, u = torch.from_numpy(train.q[:, :2]), torch.from_numpy(train.u)
    columns = monomials(bend, config.degree)
    factors = torch.linalg.lstsq(columns, u).solution
    noise = (u - columns @ factors).square().mean(0).sqrt()
    low, high = bend.amin(0), bend.amax(0)
    reach = config.margin * (high - low)
    starts = bend[:: max(len(bend) // STARTS, 1)]
    # A map that is exact, as of a recording without noise, still needs a unit: a step of the converter's tenth.
    return BendMap(factors, noise.clamp_min(1e-3), low - reach, high + reach, starts, config.degree)


def estimate_bend(
    bend_map: BendMap, readings_mv: Float[np.ndarray, "t 3"], config: OursConfig | None = None
) -> OursRun:
    """Bend and common bias from readings, each frame from those up to it.

    Parameters
    ----------
    bend_map
        From :func:`fit_map`.
    readings_mv
        Readings, 40 Hz.
    config
        Settings.
    """
    config = config or OursConfig()
    w, u = 1.0 / bend_map.noise_mv, torch.from_numpy(readings_mv) / bend_map.noise_mv
    squares = LevenbergMarquardt(bend_map, bend_map.lower, bend_map.upper)
    frames = max(config.correlation_s * RIG_RATE_HZ, 1.0)
    nearest = torch.cdist(u, bend_map(bend_map.starts)).argmin(-1)
    state, bias = squares.init(bend_map.starts[nearest]), u.new_zeros(len(u))
    information = bias
    for _ in range(config.passes):
        state, found = squares.step(state, u - bias.unsqueeze(-1) * w, 0.0)
        predicted, J = jacobian(bend_map, found.q)
        n = torch.linalg.cross(J[..., 0], J[..., 1])
        n = n / torch.linalg.vector_norm(n, dim=-1, keepdim=True)
        along, left = n @ w, (n * (u - predicted)).sum(-1)
        information = (along * along).cumsum(0) / frames + config.bias_mv**-2
        bias = (along * left).cumsum(0) / frames / information
    _, found = squares.step(state, u - bias.unsqueeze(-1) * w, 0.0)
    _, J = jacobian(bend_map, found.q)
    both = torch.cat([SCALE_M * J, w.expand(len(u), -1).unsqueeze(-1)], dim=-1)
    prior = torch.zeros(len(u), 3, 3, dtype=u.dtype)
    prior[:, 2, 2] = information
    C = torch.linalg.inv(both.mT @ both + prior)[:, :2, :2] * SCALE_M**2
    return OursRun(found.q.numpy(), C.numpy(), bias.numpy(), information.rsqrt().numpy())


def degrees(
    train: Recording, candidates: Sequence[int] = (2, 3, 4, 5, 6, 7), blocks: int = 5
) -> pd.DataFrame:
    """Error of the bend on held-out blocks of T5.train, by the degree of the map; nothing else was used to choose.

    Returns
    -------
    pandas.DataFrame
        Columns ``degree, readings_mV, bend_mm``: root mean squares over all blocks and sensors, and over both axes.
    """
    rows, block = [], np.arange(len(train)) * blocks // len(train)
    for degree in candidates:
        config, squares = OursConfig(degree=degree), np.zeros(2)
        for k in range(blocks):
            inside, outside = block == k, block != k
            part = Recording(train.name, train.frame[outside], train.q[outside], train.u[outside])
            bend_map, every = fit_map(part, config), np.flatnonzero(inside)[::4]
            error = bend_map.readings_mv(train.q[every]) - train.u[every]
            found = estimate_bend(bend_map, train.u[every], config).q - train.q[every, :2]
            squares += [(error**2).mean() / blocks, (found**2).mean() / blocks]
        rows.append(
            {"degree": degree, "readings_mV": squares[0] ** 0.5, "bend_mm": 1e3 * float(squares[1] ** 0.5)}
        )
    return pd.DataFrame(rows)


def correlation_s(train: Recording, config: OursConfig | None = None) -> float:
    """Time over which what the map leaves of T5.train is correlated [s]: twice the sum of its autocorrelation."""
    left = train.u - fit_map(train, config).readings_mv(train.q)
    left = left - left.mean(axis=0)
    n = 2 ** int(np.ceil(np.log2(2 * len(left))))
    power = np.abs(np.fft.rfft(left, n, axis=0)) ** 2
    r = np.fft.irfft(power.sum(axis=1), n)[: len(left)]
    r = r / r[0]
    until = int(np.argmax(r < 0)) or len(r)  # up to the first zero: beyond it there is noise only
    return float((1 + 2 * r[1:until].sum()) / RIG_RATE_HZ)
