r"""Nonlinear least squares: Levenberg-Marquardt within bounds, with a covariance.

Each iteration solves :math:`(A + \lambda\, \mathrm{diag} A)\, \delta = g` with :math:`A = J^T S^{-1} J + \Lambda` and
:math:`g = J^T S^{-1} r - \Lambda (q - m)` for the coordinates that no bound holds, and accepts a step that lowers the
error. :math:`S` is the variance of the readings; a Kalman filter adds its prior with mean :math:`m` and information
:math:`\Lambda`. The iteration ends when a step is small against the uncertainty that the noise leaves,
:math:`\delta^T A \delta < \varepsilon^2`.

**Bounds are knowledge.** Between bounds a width :math:`w` apart a coordinate has the standard deviation
:math:`w/\sqrt{12}`. With these on the diagonal of :math:`D`, the eigenvalues of :math:`D A D` say how much better the
readings know a direction than the bounds. Those above 1 count as seen, and their number, the rank, is what the fit
takes from the degrees of freedom. The covariance is :math:`(A + D^{-2})^{-1}`. If a direction is not seen, the fit is
made again with a prior as wide as the bounds around the last estimate, at first around the middle of the bounds: what
nobody sees stays where it was. The covariance then also holds how far that is from the middle.
"""

from __future__ import annotations

import copy
import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import ArrayLike

from repro.angles import FreeAngles
from repro.common import Array, bad_input, compiled_beside, kernel, numbers, require, result_of
from repro.estimators.base import (
    Estimate,
    Tuned,
    batch_of,
    described,
    each,
    evenly,
    fixed_coordinates,
    in_line,
    incoming,
    information_of_bounds,
    known_coordinates,
    model_of,
    parts_of,
    spread,
    start,
)
from repro.sensing import cut, evaluate, network_for, residuals, room_for, unpack

_DAMPING, CHI2, TURN, _DONE, _DETERMINED, _WEAK, _USED = range(7)
"""What is said of a fit in floating point; chi-square is the cost, with what the prior is off."""
_FIELDS, _COUNTS = 7, 4
USED, MISSING, DOF, BOUND = range(4)
"""How many readings it used and did not; to how many the estimate could not adapt itself; how many bounds stop it."""
_EPS, _TINY = 2.0**-52, 2.0**-1022
_WELL_DETERMINED = 1e-6
"""Smallest pivot of the scaled information for which its inverse is taken directly."""


class LeastSquaresState(NamedTuple):
    """Where the next step starts; ``None`` where nothing is known yet."""

    q: Array | None


class LevenbergMarquardt(Tuned):
    r"""Estimator that minimises the squared residuals in units of the noise, within bounds.

    Every time step starts at the last estimate. The covariance is the inverse of :math:`J^T S^{-1} J` and of what the
    bounds say: the Cramér-Rao bound where the readings know more than these. It starts from many places and keeps the
    best where no start is given (``init()``) or stated by the robot. An estimate lies within its bounds.

    Parameters
    ----------
    sensing
        Configuration to readings: a :class:`repro.Robot`, a :class:`repro.Sensing`, or any callable. Its slopes are
        those of its method ``linearise(q) -> (u, J)`` if it has one, else by complex step if it takes complex
        numbers, else by central differences. A callable that takes a leading dimension is called once for all of
        them. After ``module.double()``, ``lambda q: module(torch.as_tensor(q)).detach().numpy()`` is a torch module.
    lower, upper
        Bounds of ``q``; the robot's if not given. Angles whose bounds are a whole turn apart come round again. Equal
        bounds fix a coordinate: it has no variance.
    noise
        Standard deviation of a reading, one number or one for each, in their unit; the robot's if not given.
    iterations
        Largest number of iterations in a time step.
    tolerance
        The iteration ends when a step is below this share of the standard deviation of the estimate.
    starts
        Number of starts where no start is given.

    Raises
    ------
    InputError
        If the bounds are not ordered, or a number is not positive.

    Examples
    --------
    A reading of 1 from twice the coordinate: half of it, and half the noise.

    >>> from repro import LevenbergMarquardt
    >>> method = LevenbergMarquardt(lambda q: 2 * q, lower=[-1.0], upper=[1.0], noise=0.01)
    >>> state, estimate = method.step(method.init([0.0]), [1.0])
    >>> estimate.q.round(6), np.sqrt(estimate.covariance).round(6)
    (array([0.5]), array([[0.005]]))
    """

    needs_time = False

    def __init__(
        self,
        sensing: Any,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        noise: ArrayLike | None = None,
        *,
        iterations: int = 50,
        tolerance: float = 1e-4,
        starts: int = 32,
    ) -> None:
        owner = type(self).__name__
        self.robot, sensing, lower, upper, noise = described(sensing, lower, upper, noise, owner)
        lower, upper = (numbers(x, name, owner, (None,)) for x, name in ((lower, "lower"), (upper, "upper")))
        if lower.shape != upper.shape or not (lower <= upper).all():
            raise bad_input("lower, upper", owner, "ordered bounds", f"{lower} and {upper}")
        self.lower, self.upper = lower, upper
        self.noise = numbers(noise, "noise", owner)
        expected = "positive, one number or one for each reading"
        require(self.noise.ndim < 2 and (self.noise > 0).all(), "noise", owner, expected, noise)
        for name, value in (("iterations", iterations), ("tolerance", tolerance), ("starts", starts)):
            require(value > 0, name, owner, "positive", value)
        self.iterations, self.tolerance, self.starts = iterations, tolerance, starts
        self.model = model_of(sensing, lower, upper, owner)
        self.n_q = len(lower)

    @property
    def angles(self) -> FreeAngles:
        """Which coordinates come round again."""
        return self._angles

    @cached_property
    def _angles(self) -> FreeAngles:
        return FreeAngles(self.model.rotations, self.lower, self.upper)

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Bounds of the coordinates, infinite for free angles."""
        free = self.angles.free
        return np.where(free, -np.inf, self.lower), np.where(free, np.inf, self.upper)

    @cached_property
    def by_bounds(self) -> Array:
        """What the bounds say of every coordinate: the inverse of its variance between them."""
        return information_of_bounds(self.lower, self.upper, self.angles.free)

    @cached_property
    def _fixed(self) -> Array | None:
        return fixed_coordinates(self.lower, self.upper)

    @cached_property
    def _shapes(self) -> tuple[tuple[int, ...], ...]:
        """Shapes of configuration, readings, covariance and what is said of the fit, of one robot."""
        return (self.n_q,), (self.model.n_readings,), (self.n_q, self.n_q), (_FIELDS,), (_COUNTS,)

    @cached_property
    def _middle(self) -> Array:
        return (self.lower + self.upper) / 2

    @cached_property
    def _settings(self) -> Array:
        """Bounds, weights of the readings, tolerance and iterations, as the kernels take them."""
        s = self.model.n_readings
        fits = self.noise.shape in ((), (s,))
        expected = f"one number or one for each of {s} readings"
        require(fits, "noise", type(self).__name__, expected, f"shape {self.noise.shape}")
        weights = np.broadcast_to(1.0 / self.noise, s)
        return np.concatenate([*self.limits, weights, [self.tolerance, self.iterations]])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of the coordinates."""
        return self.lower, self.upper

    def parts_of(self, n_readings: int) -> tuple[Array, Array]:
        """Return which part every reading belongs to, and which readings never stay the same ``[s]``."""
        return parts_of(self.robot, self.noise, n_readings)

    def widened(self, share: float) -> LevenbergMarquardt:
        """Return this estimator with bounds that are a share of their width farther out on each side."""
        found, more = copy.copy(self), share * (self.upper - self.lower)
        found.lower, found.upper = self.lower - more, self.upper + more
        return found

    def init(self, q0: ArrayLike | None = None, seed: int = 0) -> LeastSquaresState:
        """Return the state at ``q0`` ``[..., n_q]``, or where the robot starts; else the first step searches."""
        if q0 is None and (self.robot is None or self.robot.start is None):
            return LeastSquaresState(None)
        given: Any = self.robot.start if q0 is None and self.robot else q0
        q, (low, high) = start(given, self.n_q, "LevenbergMarquardt"), self.limits
        if ((q < low) | (q > high)).any():
            expected = f"within the bounds {low.tolist()} to {high.tolist()}"
            raise bad_input("q0", "LevenbergMarquardt", expected, q.tolist())
        return LeastSquaresState(q)

    def step(
        self,
        state: LeastSquaresState,
        u: ArrayLike,
        t: float = 0.0,
        mask: ArrayLike | None = None,
        known: ArrayLike | None = None,
    ) -> tuple[LeastSquaresState, Estimate]:
        """Minimise from the last estimate.

        The details hold ``iterations``, and which coordinates are ``at_bound`` ``[..., n_q]``. The degrees of freedom
        are the readings used, less the directions of the configuration that these know better than the bounds.

        Raises
        ------
        InputError
            If there are not as many readings as the model predicts, or the model is not finite where it starts.
        """
        u = incoming(u, mask, "LevenbergMarquardt", self.model.n_readings)
        known = known_coordinates(known, self.n_q, "LevenbergMarquardt", self._fixed)
        q, rest = (self._searched(u, known), self._middle) if state.q is None else (state.q, None)
        q, u_hat, C, at_bound, status, counts = self.fit(q, u, known, rest=rest)
        q = self.angles.wrapped(q) if self.angles else q
        details = {"iterations": status[..., TURN], "at_bound": at_bound}
        chi2, dof, missing = status[..., CHI2][()], counts[..., DOF][()], counts[..., MISSING][()]
        return LeastSquaresState(q), Estimate(q, C, u_hat, chi2, dof, missing, details)

    def fit(
        self,
        q: Array,
        u: Array,
        known: Array | None = None,
        prior: tuple[Array, Array] | None = None,
        *,
        rest: Array | None = None,
        by_bounds: Array | None = None,
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Return configuration, readings there, covariance, which bounds stop it, and what is said of the fit.

        The latter are numbers ``[..., 7]``, such as ``CHI2``, and counts ``[..., 4]``, such as ``USED``.

        ``prior`` holds means ``[..., n_q]`` and information ``[..., n_q, n_q]`` of a Gaussian prior; what the bounds
        say is no part of the covariance then, unless ``by_bounds`` says so. What the readings leave open stays next
        to ``rest`` ``[..., n_q]``, the start if not given.
        """
        n, batch = self.n_q, batch_of(q, u)
        of_q, of_u, of_C, of_status, of_counts = (
            self._shapes if not batch else [(*batch, *own) for own in self._shapes]
        )
        if by_bounds is None:
            by_bounds = self.by_bounds if prior is None else _NOTHING
        held = np.zeros(of_q, np.bool_) if known is None else spread(~np.isnan(known), of_q)
        if known is not None:
            q = np.where(held, known, q)
        priors = _NO_PRIOR
        if prior is not None:  # means, and below each its information
            means, information = spread(prior[0], of_q), spread(prior[1], of_C)
            priors = np.concatenate([means[..., None, :], information], axis=-2).reshape(-1, n)
        found, rows, C, u_hat = spread(q, of_q), spread(u, of_u), np.empty(of_C), np.empty(of_u)
        at_bound, status, counts = np.empty(of_q, bool), np.empty(of_status), np.empty(of_counts, int)
        flat = in_line(batch, held, rows, found, C, u_hat, at_bound, status, counts)
        arrays = (self._settings, by_bounds, priors, *flat)
        if self.model.compiled:
            own = np.zeros(_numbers_in_fit(n, self.model.n_readings))
            good = _fit(self.model.packed, self.model.work(), own, *arrays)
        else:
            good = self._fit_callable(*arrays)
        if not good:
            rest = None if prior is not None else each(q if rest is None else rest, batch, n)
            self._settle(rest, each(q, batch, n), *flat)
        return found, u_hat, C, at_bound, status, counts

    def _settle(
        self,
        rest: Array | None,
        given: Array,
        held: Array,
        u: Array,
        q: Array,
        C: Array,
        u_hat: Array,
        *found: Array,
    ) -> None:
        """Say, in place, what is left to say where the readings leave a direction open, or the model is not finite.

        Without a prior such rows are fitted again, with one as wide as the bounds.
        """
        n, status = self.n_q, found[1].reshape(-1, _FIELDS)
        held, u, q, u_hat = (x.reshape(len(given), -1) for x in (held, u, q, u_hat))
        C = C.reshape(-1, n, n)
        if not np.isfinite(status[:, CHI2]).all():
            expected = "finite where the estimator starts"
            raise bad_input("sensing", type(self).__name__, expected, "readings that are NaN or infinite")
        for k in np.flatnonzero(status[:, _DETERMINED] == 0):
            C[k] = bounded_inverse(C[k], held[k])
        weak = status[:, _WEAK] > 0
        if rest is None or not weak.any():
            return
        free = self.angles.free  # the bounds of a free angle have no middle
        prior = np.where(free, given, rest)[weak], np.diag(np.where(free, 0.0, self.by_bounds))
        known, left = np.where(held, given, np.nan)[weak], np.where(free, self.by_bounds, 0.0)
        x, u_hat[weak], P, stopped, *_ = self.fit(q[weak], u[weak], known, prior, by_bounds=left)
        off = np.where(free, 0.0, self.by_bounds * (x - self._middle))
        off = (P @ off[..., None])[..., 0]
        q[weak], C[weak] = x, P + off[:, :, None] * off[:, None, :]
        found[0].reshape(-1, n)[weak] = stopped

    def _fit_callable(self, *arrays: Array) -> bool:
        """Fit every member of a batch, whose model is no kernel: what ``_fit`` takes and fills."""
        settings, by_bounds, priors, held, u, q, C, u_hat, at_bound, status, counts = arrays
        n = self.n_q
        todo, rows = np.arange(len(C) // n), u.reshape(len(C) // n, -1)
        status.reshape(-1, _FIELDS)[:] = _UNTRIED
        x, g, A = q.copy(), np.zeros(len(q)), np.zeros((len(q), n))
        while len(todo):
            hat, J = self.model.linearise(x.reshape(-1, n)[todo])
            r = self.model.difference(rows[todo], hat)
            slopes = np.ascontiguousarray(hat), r, np.ascontiguousarray(J)
            _advance_all(todo, *slopes, settings, priors, held, x, q, u_hat, A, g, status)
            todo = todo[status[todo * _FIELDS + _DONE] == 0]
        return _finish_all(settings, by_bounds, A, q, held, C, at_bound, status, counts)

    def _searched(self, u: Array, known: Array | None) -> Array:
        """Best of the fits from starts that fill the bounds evenly: an additive recurrence, the middle first."""
        n, starts = self.n_q, evenly(self.lower, self.upper, self.starts)
        starts = starts.reshape(-1, *(1,) * (u.ndim - 1), n)
        q, _, _, _, status, _ = self.fit(starts, u, known)
        best = status[..., CHI2].argmin(0)
        return np.take_along_axis(q, best[None, ..., None], axis=0)[0]


_NO_PRIOR = np.zeros((0, 0))
_NOTHING = np.zeros(0)
_UNTRIED = np.array([0.0, math.inf, -1.0, 0.0, 0.0, 0.0, 0.0])


def bounded_inverse(A: Array, held: Array) -> Array:
    """Return the inverse of an information matrix; directions without information get a huge, finite variance.

    Coordinates that are held have no variance.
    """
    free = ~held
    scale = np.sqrt(np.where(free & (np.diag(A) > 0), np.diag(A), 1.0))
    values, vectors = np.linalg.eigh(
        np.where(np.outer(free, free), A, np.diag(held.astype(float))) / np.outer(scale, scale)
    )
    values = np.maximum(values, _EPS * len(A))
    C = (vectors / values) @ vectors.T / np.outer(scale, scale)
    return np.where(np.outer(free, free), C, 0.0)


def _numbers_in_fit(n: int, s: int) -> int:
    """Return how many numbers ``_fit`` writes besides the room for one evaluation."""
    return 2 * n * n + (s + 3) * n + 2 * s


def _compile_ahead(given: tuple[Any, ...]) -> None:
    """Compile what ``_fit`` calls, of given types: the half that takes longest beside all the rest."""
    packed, work, own, settings, by_bounds, priors, held, u, q, C, u_hat, at_bound, status, counts = given
    ints, floats, weights, kinds = packed
    t, matrix = result_of(unpack, ints, floats), own.copy(ndim=2)
    network, room = result_of(network_for, t, weights), result_of(room_for, t, work)
    with compiled_beside(evaluate, kinds, network, t, own, types.boolean, own, matrix, room):
        result_of(residuals, kinds, t, u, own, own, room)
        trial = own, own, matrix, settings, priors, held, own
        result_of(advance, *trial, q, u_hat, matrix, own, status, own, matrix)
        result_of(_finish, settings, by_bounds, matrix, q, held, matrix, C, at_bound, status, counts)


@kernel(entry=True, allocates=True, ahead=_compile_ahead)
def _fit(packed, work, own, settings, by_bounds, priors, held, u, q, C, u_hat, at_bound, status, counts):
    """Fit every member of a batch; members stand one after the other.

    ``work`` and ``own`` are room. In one array the compiler would relate all their addresses, which takes it long.
    """
    ints, floats, weights, kinds = packed
    t, n, s = unpack(ints, floats), C.shape[1], len(settings) - 2 * C.shape[1] - 2
    network, room, good = network_for(t, weights), room_for(t, work), True
    A, L, J = cut(own, 0, (n, n)), cut(own, n * n, (n, n)), cut(own, 2 * n * n, (s, n))
    at = 2 * n * n + s * n
    x, g, delta = cut(own, at, (n,)), cut(own, at + n, (n,)), cut(own, at + 2 * n, (n,))
    hat, r = cut(own, at + 3 * n, (s,)), cut(own, at + 3 * n + s, (s,))
    for k in range(len(C) // n):
        at, of, width = k * n, k * s, n + 1 if len(priors) else 0
        prior, own_held, best = cut(priors, at * width, (width, n)), cut(held, at, (n,)), cut(q, at, (n,))
        row, best_hat, says = cut(u, of, (s,)), cut(u_hat, of, (s,)), cut(status, k * _FIELDS, (_FIELDS,))
        _begin(says)
        for a in range(n):
            x[a] = best[a]
        while says[_DONE] == 0.0:
            evaluate(kinds, network, t, x, n > 0, hat, J, room)
            residuals(kinds, t, row, hat, r, room)
            advance(
                hat,
                r,
                J,
                settings,
                prior,
                own_held,
                x,
                best,
                best_hat,
                A,
                g,
                says,
                delta,
                L,
            )
        own_C, stopped, found = (
            cut(C, at * n, (n, n)),
            cut(at_bound, at, (n,)),
            cut(counts, k * _COUNTS, (_COUNTS,)),
        )
        end = _finish(settings, by_bounds, A, best, own_held, L, own_C, stopped, says, found)
        good = good and end
    return good


@kernel(entry=True, allocates=True)
def _advance_all(todo, hat, r, J, settings, priors, held, x, q, u_hat, A, g, status):
    s, n = J.shape[1:]
    delta, L = np.zeros(n), np.zeros((n, n))
    for i in range(len(todo)):
        k = todo[i]
        at, of, says = (
            slice(k * n, (k + 1) * n),
            slice(k * s, (k + 1) * s),
            status[k * _FIELDS : (k + 1) * _FIELDS],
        )
        prior = priors[k * (n + 1) : (k + 1) * (n + 1)]
        advance(
            hat[i], r[i], J[i], settings, prior, held[at], x[at], q[at], u_hat[of], A[at], g[at], says, delta, L
        )  # fmt: skip


@kernel(entry=True, allocates=True)
def _finish_all(settings, by_bounds, A, q, held, C, at_bound, status, counts):
    n, good = A.shape[1], True
    L = np.zeros((n, n))
    for k in range(len(A) // n):
        at, says = slice(k * n, (k + 1) * n), status[k * _FIELDS : (k + 1) * _FIELDS]
        good = (
            _finish(
                settings,
                by_bounds,
                A[at],
                q[at],
                held[at],
                L,
                C[at],
                at_bound[at],
                says,
                counts[_COUNTS * k :],
            )
            and good
        )
    return good


@kernel
def _begin(status):
    for i in range(_FIELDS):
        status[i] = 0.0
    status[CHI2], status[TURN] = math.inf, -1.0


@kernel(apart=True)
def _finish(settings, by_bounds, A, q, held, L, C, at_bound, status, counts):
    """Write the covariance, which bounds stopped the fit, and how many directions the readings see.

    Return whether nothing is left open.
    """
    n, free, open_, stopped = len(q), 0, 0, 0
    for a in range(n):
        bound = q[a] <= settings[a] or q[a] >= settings[n + a]
        at_bound[a] = bound and not held[a]
        L[a, a] = 0.0 if held[a] or (len(by_bounds) and by_bounds[a] == 0.0) else 1.0
        stopped += 1 if at_bound[a] else 0
        free += 0 if bound or held[a] else 1
        open_ += 0 if held[a] else 1
    status[_WEAK] = 0.0
    if len(by_bounds):
        seen = _directions_seen(A, by_bounds, L)
        free, status[_WEAK] = min(seen, free), open_ - seen
        for a in range(n):
            A[a, a] += by_bounds[a]
    counts[USED] = int(status[_USED])
    counts[MISSING] = len(settings) - 2 * n - 2 - counts[USED]
    counts[DOF], counts[BOUND] = max(counts[USED] - free, 0), stopped
    status[_DETERMINED] = invert(A, held, L, C) if status[CHI2] < math.inf else 0.0
    return status[_DETERMINED] == 1.0 and status[_WEAK] == 0.0


@kernel
def _directions_seen(A, by_bounds, L):
    """Return how many eigenvalues of the scaled information exceed 1, over the coordinates with a mark in ``L``.

    They are as many as the factorisation of the matrix less 1 has positive pivots (Sylvester's law of inertia).
    """
    n, seen = len(A), 0
    for a in range(n):
        if L[a, a] == 0.0:
            continue
        for b in range(a):
            L[a, b] = A[a, b] / math.sqrt(by_bounds[a] * by_bounds[b]) if L[b, b] != 0.0 else 0.0
            for c in range(b):
                L[a, b] -= L[a, c] * L[b, c] * L[c, c]
            L[a, b] = L[a, b] / L[b, b] if L[b, b] != 0.0 else 0.0
        pivot = A[a, a] / by_bounds[a] - 1.0
        for c in range(a):
            pivot -= L[a, c] * L[a, c] * L[c, c]
        seen += 1 if pivot > 0.0 else 0
        L[a, a] = pivot if pivot != 0.0 else -_TINY
    return seen


@kernel(apart=True)
def advance(hat, r, J, settings, prior, held, x, q, u_hat, A, g, status, delta, L):
    """Judge the trial ``x``, whose residuals are ``r`` and slopes ``J``, and write the next one to ``x``.

    ``q``, ``u_hat``, ``A``, ``g`` belong to the best trial so far. ``prior`` is the mean with the information below
    it, or empty.
    """
    n, s = len(x), len(r)
    low, high, weight = settings[:n], settings[n : 2 * n], settings[2 * n : 2 * n + s]
    tolerance, iterations = settings[2 * n + s], settings[2 * n + s + 1]
    cost, status[_USED] = _cost(hat, r, weight, prior, x)
    # Near the minimum rounding hides which is better: a step that is no worse than that is taken.
    better, damping = cost < status[CHI2] * (1.0 + 8.0 * _EPS), status[_DAMPING]
    damping = min(max(damping / 10.0 if better else damping * 10.0, 1e-12), 1e12)
    status[_DAMPING] = 1e-3 if status[TURN] < 0.0 else damping
    status[TURN] += 1.0
    if better:
        status[CHI2] = cost
        _normal_equations(hat, r, J, weight, x, q, u_hat, A, g)
        for a in range(n if len(prior) else 0):
            for b in range(n):
                g[a] -= prior[1 + a, b] * (x[b] - prior[0, b])
                if b <= a:
                    A[a, b] += prior[1 + a, b]
    if status[TURN] >= iterations or status[CHI2] == math.inf:
        status[_DONE] = 1.0
        return
    _damped_step(A, g, status[_DAMPING], low, high, q, held, L, delta)
    size = 0.0
    for a in range(n):
        x[a] = min(max(q[a] + delta[a], low[a]), high[a])
        delta[a] = x[a] - q[a]
        for b in range(a):
            size += 2.0 * delta[a] * A[a, b] * delta[b]
        size += delta[a] * A[a, a] * delta[a]
    if size <= tolerance * tolerance:
        status[_DONE] = 1.0


@kernel
def _cost(hat, r, weight, prior, x):
    """Return squared residuals in units of the noise, with what the prior is off, and of how many readings.

    They are infinite if the model is.
    """
    cost = used = 0.0
    for j in range(len(r)):
        if r[j] == r[j]:
            used += 1.0
            cost += (weight[j] * r[j]) ** 2
        if not math.isfinite(hat[j]):
            cost = math.inf
    for a in range(len(prior) - 1):
        for b in range(len(prior) - 1):
            cost += (x[a] - prior[0, a]) * prior[1 + a, b] * (x[b] - prior[0, b])
    return cost, used


@kernel
def _normal_equations(hat, r, J, weight, x, q, u_hat, A, g):
    """Take over a trial; of ``A`` the lower triangle counts."""
    n = len(x)
    for a in range(n):
        q[a], g[a] = x[a], 0.0
        for b in range(a + 1):
            A[a, b] = 0.0
    for j in range(len(r)):
        u_hat[j] = hat[j]
        if r[j] == r[j]:
            square = weight[j] * weight[j]
            for a in range(n):
                scaled = square * J[j, a]
                g[a] += scaled * r[j]
                for b in range(a + 1):
                    A[a, b] += scaled * J[j, b]


@kernel
def _damped_step(A, g, damping, low, high, q, held, L, delta):
    """Solve for the coordinates that neither a bound nor knowledge holds; the others do not move."""
    n, largest = len(g), 0.0
    for a in range(n):
        largest = max(largest, A[a, a])
    floor = _EPS * largest + _TINY
    for a in range(n):
        stays = (q[a] <= low[a] and g[a] < 0.0) or (q[a] >= high[a] and g[a] > 0.0)
        stays = stays or held[a]
        L[a, a] = -1.0 if stays else A[a, a] + damping * max(A[a, a], floor) + floor
        delta[a] = 0.0 if stays else g[a]
    for a in range(n):
        for b in range(a):
            L[a, b] = 0.0 if L[a, a] < 0.0 or L[b, b] < 0.0 else A[a, b]
    for a in range(n):
        L[a, a] = abs(L[a, a])
    cholesky(L, floor)
    solve(L, delta)


@kernel
def cholesky(L, floor):
    """Cholesky factor in place of the lower triangle; return the smallest pivot, ``floor`` at least."""
    smallest = math.inf
    for a in range(len(L)):
        for b in range(a):
            total = L[a, b]
            for c in range(b):
                total -= L[a, c] * L[b, c]
            L[a, b] = total / L[b, b]
        pivot = L[a, a]
        for c in range(a):
            pivot -= L[a, c] * L[a, c]
        pivot = pivot if pivot > floor else floor
        smallest = min(smallest, pivot)
        L[a, a] = math.sqrt(pivot)
    return smallest


@kernel
def solve(L, x):
    """Solve ``L L^T y = x`` in place."""
    n = len(x)
    for a in range(n):
        for b in range(a):
            x[a] -= L[a, b] * x[b]
        x[a] /= L[a, a]
    for a in range(n - 1, -1, -1):
        for b in range(a + 1, n):
            x[a] -= L[b, a] * x[b]
        x[a] /= L[a, a]


@kernel
def invert(A, held, L, C):
    """Write the inverse of the lower triangle ``A`` to ``C``; where nearly singular ``A`` itself, and return 0.

    Coordinates that are held have no variance.
    """
    n = len(A)
    good = True
    for a in range(n):
        L[a, a] = 0.0 if held[a] else 1.0
        for b in range(a + 1):
            C[a, b] = C[b, a] = A[a, b]
        good = good and (held[a] or A[a, a] > 0.0)
    if not good:
        return 0.0
    for a in range(n):
        for b in range(a):
            both = L[a, a] > 0.0 and L[b, b] > 0.0
            L[a, b] = A[a, b] / math.sqrt(A[a, a] * A[b, b]) if both else 0.0
    for a in range(n):
        L[a, a] = 1.0
    if not cholesky(L, 0.0) > _WELL_DETERMINED:
        return 0.0
    for a in range(n):  # the inverse of the factor, in the upper triangle of L
        for b in range(a):
            total = 0.0
            for c in range(b, a):
                total -= L[a, c] * (L[b, c] if c > b else 1.0 / L[b, b])
            L[b, a] = total / L[a, a]
    for a in range(n):
        for b in range(a + 1):
            total = 1.0 / (L[a, a] * L[a, a]) if a == b else L[b, a] / L[a, a]
            for c in range(a + 1, n):
                total += L[b, c] * L[a, c]
            C[a, b] = total / math.sqrt(A[a, a] * A[b, b])
            C[b, a] = C[a, b]
    for a in range(n):
        for b in range(n):
            if held[a] or held[b]:
                C[a, b] = 0.0
    return 1.0
