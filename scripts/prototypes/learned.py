"""Prototype of a model that is learned from rows: what the robot file does not explain, with an honest ±.

Gaussian process regression with one length for all scaled inputs. Length and noise are chosen by predicting blocks of
consecutive rows from the other blocks. The same left-out blocks give the covariance of the outputs, scaled so that
the ellipsoids of 90 % hold 90 % of the left-out rows: what drifts from block to block is part of the ±. Far from the
rows that were learned it grows.
"""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist
from scipy.stats import chi2

LENGTHS = (0.25, 0.5, 1.0, 2.0, 4.0)
SHARES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)


class Learned:
    """Outputs ``[..., m]`` of inputs ``[..., d]``, with ``linearise`` and ``covariance``.

    Parameters
    ----------
    x, y
        Rows of inputs ``[n, d]`` and outputs ``[n, m]``, in the order in which they were taken.
    base
        What is known already, a callable from inputs to outputs; zero if not given.
    blocks
        Number of blocks of consecutive rows that are left out in turn.
    most
        Rows that take part in the choice of length and noise.
    lengths, shares
        Lengths, in standard deviations of the inputs, and shares of noise among which to choose.
    """

    def __init__(self, x, y, base=None, *, blocks=3, most=600, lengths=LENGTHS, shares=SHARES):
        x, y = np.asarray(x, float), np.asarray(y, float)
        self.base = base
        rest = y if base is None else y - base(x)
        self.scale = x.std(0)
        self.middle = rest.mean(0) if base is None else np.zeros(y.shape[1])
        x, rest = x / self.scale, rest - self.middle
        size = np.sqrt((rest**2).mean(0)) + 1e-300
        some = np.unique(np.linspace(0, len(x) - 1, min(len(x), most)).astype(int))
        tried = {}
        for length, share in product(lengths, shares):
            off = self._left_out(x[some], rest[some], length, share, blocks)
            parts = np.array_split(np.square(off / size).mean(1), min(blocks, len(some)))
            tried[length, share] = [part.mean() for part in parts]
        best = min(tried.values(), key=np.mean)
        enough = np.mean(best) + np.std(best) / np.sqrt(len(best))
        # The most cautious of those that are as good as the best within chance: one standard error (Breiman 1984).
        as_good = [(share, length) for (length, share), score in tried.items() if np.mean(score) <= enough]
        self.share, self.length = max(as_good)
        self.tried = {key: float(np.mean(score)) for key, score in tried.items()}
        self.x, self.y = x, rest
        self.off = self._left_out(x, rest, self.length, self.share, blocks)
        C = self.off.T @ self.off / len(self.off) + 1e-12 * np.diag(size**2)
        self.signal = rest.T @ rest / len(rest)
        d2 = np.einsum("ni,ij,nj->n", self.off, np.linalg.inv(C), self.off)
        self.error = C * max(1.0, np.quantile(d2, 0.9) / chi2(len(C)).ppf(0.9))
        self.factor = cho_factor(self._kernel(x, x) + self.share * np.eye(len(x)))
        self.weights = cho_solve(self.factor, rest)

    @staticmethod
    def _left_out(x, y, length, share, blocks):
        """Return what predictions of left-out blocks are off."""
        off = np.empty_like(y)
        K = np.exp(-cdist(x, x, "sqeuclidean") / (2 * length**2))
        edges = np.linspace(0, len(x), min(blocks, len(x)) + 1).astype(int)
        for a, b in pairwise(edges):
            kept = np.r_[0:a, b : len(x)]
            factor = cho_factor(K[np.ix_(kept, kept)] + share * np.eye(len(kept)))
            k = K[a:b, kept]
            off[a:b] = y[a:b] - k @ cho_solve(factor, y[kept])
        return off

    def _kernel(self, a, b):
        return np.exp(-cdist(a, b, "sqeuclidean") / (2 * self.length**2))

    def __call__(self, x):
        """Return outputs ``[..., m]``."""
        return self.linearise(x)[0]

    def linearise(self, x):
        """Return outputs ``[..., m]`` and slopes ``[..., m, d]``."""
        x = np.asarray(x, float)
        flat = np.atleast_2d(x) / self.scale
        k = self._kernel(flat, self.x)
        u, J = k @ self.weights, np.empty((len(flat), self.y.shape[1], flat.shape[1]))
        for c in range(flat.shape[1]):
            slope = k @ (self.x[:, c : c + 1] * self.weights) - flat[:, c : c + 1] * u
            J[..., c] = slope / self.length**2 / self.scale[c]
        u = u + self.middle
        if self.base is not None:
            known, slopes = self.base.linearise(np.atleast_2d(x))
            u, J = u + known, J + slopes
        return (u, J) if x.ndim > 1 else (u[0], J[0])

    def covariance(self, x):
        """Return the covariance ``[n, m, m]`` of the outputs at inputs ``[n, d]``: more where little was learned.

        Near rows that were learned it does not shrink: left-out blocks say how well the model does, and a model that
        takes a smooth error for noise would average it away. Far from all rows nothing was learned, and the whole of
        what was to be learned is added.
        """
        k = self._kernel(np.atleast_2d(x) / self.scale, self.x)
        unknown = 1 - np.einsum("ij,ji->i", k, cho_solve(self.factor, k.T))
        return self.error + unknown[:, None, None] * self.signal
