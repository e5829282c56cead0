r"""The particle filter of Mitchell, Hurley and Onal 2021 (section II): weigh, predict, resample.

The filter carries the belief about the configuration as a cloud of particles. A step weighs every particle by the
likelihood of the readings, takes the estimate, draws as many particles again by their weights, and moves each of them
a little.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from repro.angles import FreeAngles
from repro.common import Array, bad_input, kernel, numbers, require
from repro.estimators.base import Estimate, described, fixed_coordinates, incoming, known_coordinates, start
from repro.parts import Assembly


@dataclass(frozen=True)
class BendDisc:
    """Bend vectors up to a bend angle: the parameter space of Mitchell et al. 2021, Fig. 3.

    Parameters
    ----------
    radius
        Largest bend angle [rad].

    Raises
    ------
    InputError
        If the radius is not positive.

    Examples
    --------
    >>> BendDisc(np.pi / 2).contains(np.array([[1.5, 0.0], [1.5, 1.5]]))
    array([ True, False])
    """

    radius: float

    def __post_init__(self) -> None:
        require(0 < self.radius < math.inf, "radius", "BendDisc", "positive [rad]", self.radius)

    def contains(self, q: Array) -> Array:
        """Return which bend vectors ``[..., 2]`` are at most as long as the radius."""
        return q[..., 0] ** 2 + q[..., 1] ** 2 <= self.radius**2

    def sample(self, n: int, generator: np.random.Generator) -> Array:
        """Return ``n`` bend vectors, uniform over the disc."""
        angle, direction = self.radius * np.sqrt(generator.random(n)), 2 * math.pi * generator.random(n)
        return np.stack([angle * np.cos(direction), angle * np.sin(direction)], axis=-1)


@dataclass(frozen=True)
class Box:
    """Configurations between bounds, as for least squares.

    Parameters
    ----------
    lower, upper
        Bounds of every coordinate ``[n_q]``, in its unit. Equal bounds fix it.
    angles
        Which of them have no bounds because they come round again; none if not given.

    Raises
    ------
    InputError
        If a lower bound is above its upper bound.

    Examples
    --------
    >>> Box([-1.0, 0.0], [1.0, 2.0]).contains(np.array([[0.5, 0.5], [0.5, -0.5]]))
    array([ True, False])
    """

    lower: Any
    upper: Any
    angles: Any = False

    def __post_init__(self) -> None:
        lower = numbers(self.lower, "lower", "Box", (None,))
        ordered = (lower <= numbers(self.upper, "upper", "Box", lower.shape)).all()
        require(ordered, "lower", "Box", f"not above upper, {self.upper}", self.lower)

    def contains(self, q: Array) -> Array:
        """Return which configurations ``[..., n_q]`` have every coordinate within its bounds."""
        inside = (q >= np.asarray(self.lower)) & (q <= np.asarray(self.upper))
        return np.all(inside | np.asarray(self.angles), axis=-1)

    def sample(self, n: int, generator: np.random.Generator) -> Array:
        """Return ``n`` configurations, uniform over the box."""
        return generator.uniform(self.lower, self.upper, (n, len(self.lower)))


class ParticleState(NamedTuple):
    """The cloud before the next readings.

    Random numbers are a function of ``seed`` and ``steps``: a state that is stepped twice gives the same bits twice.
    """

    q: Array
    """Configurations of the particles ``[..., n, n_q]``."""
    velocity: Array
    """What moved each particle in the last step ``[..., n, n_q]``; constant velocity carries it on."""
    seed: int
    steps: int


class ParticleFilter:
    r"""Estimator of Mitchell et al. 2021 that carries the belief about the configuration as a cloud of particles.

    A step follows the order of the paper: it weighs the particles, takes the estimate, draws particles again by their
    weights, and moves them. A particle that predicts the readings :math:`\hat u` has the weight

    .. math:: w \propto \exp\left(-\sum_k \frac{(\hat u_k - u_k)^2}{2 \sigma_k^2}\right)

    with the standard deviations :math:`\sigma_k` of the readings. **Eq. (1) of the paper has no factor 1/2**: its
    :math:`\sigma` is :math:`\sqrt 2` times our ``noise``. Eq. (2) subtracts the largest logarithm first, so that
    particles far from the readings cause no underflow. One step is one step of motion, whatever the time says.
    Members of a batch share their random numbers: each gives what it would give alone.

    Parameters
    ----------
    sensing
        A robot, or a sensor model: any callable from configurations ``[..., n_q]`` to readings ``[..., s]``.
    process_noise
        Standard deviation of the noise that moves a particle in one step ``[..., n_q]``, in the units of the
        coordinates; leading dimensions are those of the batch. The rule of thumb for a robot if not given: half of
        the range between its bounds in a second, and a fiftieth of the range if its rate is not stated.
    noise
        Standard deviation of the readings, in their unit: one number, or one per reading; the robot's if not given.
    region
        Where particles may be: noise that leads outside is drawn again (section II-C). A :class:`BendDisc`, a
        :class:`Box`, or any object with their ``contains`` and ``sample``; the robot's bounds if not given, without a
        robot everywhere.
    particles
        Number of particles.
    estimate
        ``"best tenth"``: mean bend angle and circular mean of the bend direction of the 10 % of particles with the
        largest weights, eqs (3) and (4); for bend vectors only. ``"weighted"``: mean of all particles by their
        weights.
    resampling
        ``"multinomial"`` as in the paper: independent draws. ``"systematic"``: one comb of equal spacing, which adds
        less noise.
    motion
        ``"random walk"`` as in the paper: noise on the configuration. ``"constant velocity"``: noise on a velocity
        that every particle carries.

    Raises
    ------
    InputError
        If a number is not positive, a name is unknown, or a best tenth is asked of anything but bend vectors.

    Examples
    --------
    >>> from repro import ParticleFilter, track
    >>> method = ParticleFilter(lambda q: 2 * q, [0.05], 0.02, region=Box([-1.0], [1.0]))
    >>> track(method, np.ones((20, 1)), [0.0], rate_hz=10).q[-1].round(1)
    array([0.5])
    """

    def __init__(
        self,
        sensing: Assembly | Callable[[Array], Any],
        process_noise: ArrayLike | None = None,
        noise: ArrayLike | None = None,
        region: Any = None,
        particles: int = 1000,
        estimate: str = "weighted",
        resampling: str = "systematic",
        motion: str = "random walk",
    ) -> None:
        owner = "ParticleFilter"
        robot = sensing if isinstance(sensing, Assembly) else None
        self.robot, self._fixed, self._by_rule = robot, None, process_noise is None
        self.angles = FreeAngles((), np.empty(0), np.empty(0)) if robot is None else robot.free_angles
        if robot is not None:
            _, sensing, lower, upper, noise = described(robot, None, None, noise, owner)
            self._fixed = fixed_coordinates(lower, upper)
            steps = 50.0 if robot.rate_hz is None else max(2.0 * robot.rate_hz, 10.0)
            process_noise = (upper - lower) / steps if process_noise is None else process_noise
            region = Box(lower, upper, self.angles.free) if region is None else region
        require(process_noise is not None, "process_noise", owner, "given without a robot", "nothing")
        require(noise is not None, "noise", owner, "given without a robot", "nothing")
        self.sensing: Any = sensing
        self.region, self.particles = region, particles
        self.estimate, self.resampling, self.motion = estimate, resampling, motion
        require(callable(sensing), "sensing", owner, "a callable from configurations to readings", sensing)
        self.process_noise = numbers(process_noise, "process_noise", owner, (..., None))
        self.noise = numbers(noise, "noise", owner)
        require(self.noise.ndim <= 1, "noise", owner, "one number, or one per reading", noise)
        if self._fixed is not None:
            self.process_noise = np.where(np.isnan(self._fixed), self.process_noise, 0.0)
        free = True if self._fixed is None else np.isnan(self._fixed)
        require(np.all(self.noise > 0), "noise", owner, "positive", self.noise)
        moves = np.all((self.process_noise > 0) == free)
        require(moves, "process_noise", owner, "positive", self.process_noise)
        whole = isinstance(particles, int | np.integer) and particles > 0
        require(whole, "particles", owner, "a positive whole number", particles)
        choices = {
            "estimate": ("best tenth", "weighted"),
            "resampling": ("multinomial", "systematic"),
            "motion": ("random walk", "constant velocity"),
        }
        for name, known in choices.items():
            expected = f"one of {', '.join(map(repr, known))}"
            require(vars(self)[name] in known, name, owner, expected, repr(vars(self)[name]))
        self.n_q = self.process_noise.shape[-1]
        if estimate == "best tenth" and self.n_q != 2:
            expected = "'weighted' for a configuration that is no bend vector"
            raise bad_input("estimate", owner, expected, f"'best tenth' for {self.n_q} coordinates")

    def __repr__(self) -> str:
        """Say its process noise, and whether that is the rule of thumb."""
        words = ", ".join(f"{a:.3g}" for a in self.process_noise.reshape(-1, self.n_q)[0])
        rule = ", by the rule of thumb: half of each range in a second" if self._by_rule else ""
        return f"ParticleFilter of {self.particles} particles; process noise {words} [unit per step]{rule}"

    def init(self, q0: ArrayLike | None = None, seed: int = 0) -> ParticleState:
        """Return a cloud at rest: around ``q0`` with the process noise of one step, or all over the region.

        Where the robot states a start, the cloud is around that.

        Raises
        ------
        InputError
            If ``q0`` has another width, is not finite or outside the region, is not given and there is no region,
            or the seed is not a whole number from 0.
        """
        owner, n, batch = "ParticleFilter", self.particles, self.process_noise.shape[:-1]
        require(
            isinstance(seed, int | np.integer) and 0 <= seed < 2**64,
            "seed",
            owner,
            "a whole number from 0",
            seed,
        )
        generator = _stream(seed, 0)
        q0 = self.robot.start if q0 is None and self.robot is not None else q0
        if q0 is None:
            require(self.region is not None, "q0", owner, "given for a filter without a region", q0)
            q = _members(self.region.sample(n, generator), batch, n, self.n_q)
        else:
            q0 = start(q0, self.n_q, owner)
            if self.region is not None:
                require(self.region.contains(q0).all(), "q0", owner, f"within {self.region}", q0.tolist())
            batch = _common(owner, q0=q0.shape[:-1], process_noise=batch)
            q = _members(q0[..., None, :], batch, n, self.n_q)
            at, width = np.arange(q[..., 0].size), _members(self.process_noise, batch, self.n_q)
            q, _ = self._moved(q, np.zeros_like(q), at.reshape(q.shape[:2]), width, generator)
        q = q.reshape(*batch, n, self.n_q)
        return ParticleState(q, np.zeros_like(q), seed, 1)

    def step(
        self,
        state: ParticleState,
        u: ArrayLike,
        t: float = 0.0,
        mask: ArrayLike | None = None,
        known: ArrayLike | None = None,
    ) -> tuple[ParticleState, Estimate]:
        """Weigh, predict and resample.

        The ``details`` are ``effective_sample_size``, the number of particles of equal weight that are worth as much;
        and ``surprise``, by how many standard deviations the readings are too unlikely for the cloud before it is
        weighed: about N(0, 1) while the filter follows, NaN without readings, far above 6 once it has lost the robot.
        The covariance is that of the weighted particles.

        Raises
        ------
        InputError
            If readings, mask or known coordinates do not fit the filter, or the sensor model takes no batches.
        """
        owner, n, n_q = "ParticleFilter", self.particles, self.n_q
        u, known = incoming(u, mask, owner), known_coordinates(known, n_q, owner, self._fixed)
        s, known, holds = u.shape[-1], np.full(n_q, np.nan) if known is None else known, known is not None
        batch = _common(
            owner,
            state=state.q.shape[:-2],
            u=u.shape[:-1],
            known=known.shape[:-1],
            process_noise=self.process_noise.shape[:-1],
        )
        require(self.noise.shape in ((), (s,)), "u", owner, f"{self.noise.size} readings (last dimension)", s)
        # From here on the batch is one leading dimension; only the sensor model sees it as it came.
        u, noise, known, width = (
            _members(x, batch, size)
            for x, size in ((u, s), (self.noise, s), (known, n_q), (self.process_noise, n_q))
        )
        used, free = np.isfinite(u), np.isnan(known)

        def held(q: Array) -> Array:
            return np.where(free[:, None], q, known[:, None]) if holds else q

        q, velocity = held(_members(state.q, batch, n, n_q)), _members(state.velocity, batch, n, n_q)
        w, squares, size, mean, C, e, S = _weighed(q, self._predicted(q, batch, s), u, noise)
        if self.angles:
            mean, C = self._turned(q, w)
        best = held(_best_tenth(q, squares) if self.estimate == "best tenth" else mean[:, None])
        C = np.where(free[:, None] & free[..., None], C, 0.0) if holds else C
        u_hat, n_used = self._predicted(best, batch, s), used.sum(-1)
        estimate = Estimate(
            best.reshape(*batch, n_q),
            C.reshape(*batch, n_q, n_q),
            u_hat.reshape(*batch, s),
            (np.where(used[:, None], (u_hat - u[:, None]) / noise[:, None], 0.0) ** 2)
            .sum((1, 2))
            .reshape(batch),
            np.maximum(n_used - free.sum(-1), 0).reshape(batch),
            (s - n_used).reshape(batch),
            {
                "effective_sample_size": size.reshape(batch),
                "surprise": _surprise(e, S, used).reshape(batch),
            },
        )
        q, velocity = (x.reshape(*batch, n, n_q) for x in self._resampled(state, q, velocity, w, width))
        return ParticleState(q, velocity, state.seed, state.steps + 1), estimate

    def _resampled(
        self, state: ParticleState, q: Array, velocity: Array, w: Array, width: Array
    ) -> tuple[Array, Array]:
        """Return particles drawn by their weights, after a step of motion."""
        generator = _stream(state.seed, state.steps)
        drawn = _drawn(w, _points(self.particles, self.resampling, generator))
        return self._moved(q, velocity, drawn, width, generator)

    def _turned(self, q: Array, w: Array) -> tuple[Array, Array]:
        """Return mean and covariance of particles with angles among their coordinates."""
        mean = self.angles.mean(q, w)
        off = self.angles.difference(q, mean[:, None])
        return mean, np.swapaxes(w[..., None] * off, 1, 2) @ off

    def _predicted(self, q: Array, batch: tuple[int, ...], s: int) -> Array:
        """Return the readings of particles ``[m, n, n_q]``; the sensor model sees the batch as it came."""
        there = (*batch, *q.shape[1:])
        found = np.ascontiguousarray(self.sensing(q.reshape(there)), dtype=np.float64)
        owner, expected = "ParticleFilter", f"a model that takes batches {there}"
        require(found.shape[:-1] == there[:-1], "sensing", owner, expected, f"shape {found.shape}")
        require(found.shape[-1] == s, "u", owner, f"{found.shape[-1]} readings (last dimension)", s)
        return found.reshape(-1, q.shape[1], s)

    def _moved(
        self, q: Array, velocity: Array, drawn: Array, width: Array, generator: np.random.Generator
    ) -> tuple[Array, Array]:
        """Return the drawn particles after a step of motion, and what moved each; noise never leads out."""
        following, moved, outside = np.empty_like(q), np.empty_like(q), np.ones(drawn.shape, dtype=np.bool_)
        q, velocity = q.reshape(-1, self.n_q), velocity.reshape(-1, self.n_q)
        # After fifty draws that lead out a particle stays where it is, at rest.
        for _ in range(50):
            noise = generator.standard_normal((self.particles, self.n_q))
            _move(q, velocity, self.motion != "random walk", drawn, width, noise, outside, following, moved)
            outside = np.zeros_like(outside) if self.region is None else ~self.region.contains(following)
            if not outside.any():
                break
        following[outside], moved[outside] = q[drawn[outside]], 0.0
        if not self.angles:
            return following, moved
        wrapped = self.angles.wrapped(following)
        return wrapped, (self.angles.slopes(following, wrapped) @ moved[..., None])[..., 0]


def _stream(seed: int, number: int) -> np.random.Generator:
    """Return random numbers that depend on the seed and the number only."""
    return np.random.Generator(np.random.Philox(key=[seed, number]))


def _common(owner: str, **shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape that the batches of the inputs broadcast to, or refuse them."""
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError as error:
        raise bad_input(", ".join(shapes), owner, "of batches that fit each other", shapes) from error


def _surprise(e: Array, S: Array, used: Array) -> Array:
    """Return by how many standard deviations readings are too unlikely, by means and covariances of their errors.

    Their distance from the mean prediction, normalised by the covariance of predictions and noise, is chi-square
    while the filter follows; its cube root is nearly normal (Wilson and Hilferty 1931).
    """
    dof = np.where(used.any(-1), used.sum(-1), np.nan)
    try:
        distance = (e * np.linalg.solve(S + np.eye(e.shape[-1]), e[..., None])[..., 0]).sum(-1)
        distance = np.where(distance >= 0, distance, np.inf)  # rounding leaves nothing of the cloud either
    except np.linalg.LinAlgError:  # a reading so far off that rounding leaves nothing of the cloud
        distance = np.full(len(e), np.inf)
    return ((distance / dof) ** (1 / 3) - 1 + 2 / (9 * dof)) / np.sqrt(2 / (9 * dof))


def _members(x: Array, batch: tuple[int, ...], *own: int) -> Array:
    """Return a copy for every member, with the batch as one leading dimension."""
    return np.full((*batch, *own), x).reshape(-1, *own)


def _points(n: int, resampling: str, generator: np.random.Generator) -> Array:
    """Return the shares of the sum of all weights at which particles are drawn, increasing."""
    if resampling == "systematic":
        return (np.arange(n) + generator.random()) / n
    # Sums of exponential numbers, divided by the last, are uniform numbers in order: nothing has to be sorted.
    edges = np.cumsum(generator.standard_exponential(n + 1))
    return edges[:-1] / edges[-1]


def _best_tenth(q: Array, squares: Array) -> Array:
    """Return the estimate of eqs (3) and (4) ``[m, 1, 2]`` from bend vectors.

    Angles are never negative, so that near the straight pose their mean is too large.
    """
    m, n = squares.shape
    keep, tiny = math.ceil(n / 10), np.finfo(float).tiny
    best = np.argpartition(squares, keep - 1, axis=1)[:, :keep] + n * np.arange(m)[:, None]
    bend = q.view(np.complex128).ravel().take(best)
    angle = np.abs(bend)
    direction = (bend / (angle + tiny)).sum(1)
    direction /= np.abs(direction) + tiny
    return (angle.sum(1) / keep * direction).view(np.float64).reshape(m, 1, 2)


@kernel(entry=True, reorder=True, allocates=True)
def _weighed(q, u_hat, u, noise):
    """Return what readings say about clouds; errors are in units of the noise.

    These are weights, squared errors, effective sample sizes, means and covariances of the particles, and means and
    covariances of the errors before weighing. Readings that are not finite are missing and have no error.
    """
    m, n, n_q, s = *q.shape, u.shape[1]
    w, squares, size, e_mean = np.empty((m, n)), np.zeros((m, n)), np.empty(m), np.empty((m, s))
    mean, C, S = np.empty((m, n_q)), np.empty((m, n_q, n_q)), np.empty((m, s, s))
    for b in range(m):
        e = np.zeros((s, n))
        for k in range(s):
            if math.isfinite(u[b, k]):
                for i in range(n):
                    e[k, i] = (u_hat[b, i, k] - u[b, k]) / noise[b, k]
                    squares[b, i] += e[k, i] * e[k, i]
        # Eq. (2). Most particles are far below the best and get a floor, which takes no exponential function; without
        # it their squares would be denormal numbers, on which arithmetic is slow.
        least, total = np.min(squares[b]), 0.0
        for i in range(n):
            w[b, i] = math.exp(0.5 * (least - squares[b, i])) if squares[b, i] < least + 600.0 else 1e-130
            total += w[b, i]
        w[b] /= total
        size[b] = 1.0 / _dot(w[b], w[b])
        _moments(q[b].T.copy(), w[b], mean[b], C[b])
        _moments(e, np.full(n, 1.0 / n), e_mean[b], S[b])
    return w, squares, size, mean, C, e_mean, S


@kernel(reorder=True, allocates=True)
def _moments(x, w, mean, C):
    """Write mean and covariance of the columns of ``x``, with weights whose sum is 1, and take the mean off ``x``."""
    for a in range(len(x)):
        mean[a] = _dot(w, x[a])
        x[a] -= mean[a]
        share = w * x[a]
        for b in range(a + 1):
            C[a, b] = C[b, a] = _dot(share, x[b])


@kernel(reorder=True, allocates=True)
def _dot(x, y):
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@kernel(entry=True, allocates=True)
def _drawn(w, points):
    """Return the particles, counted over all members, whose share of the weights holds each point."""
    (m, n), drawn = w.shape, np.empty(w.shape, dtype=np.int64)
    for b in range(m):
        total, k, edge = np.sum(w[b]), 0, w[b, 0]
        for i in range(n):
            while k < n - 1 and edge <= points[i] * total:
                k += 1
                edge += w[b, k]
            drawn[b, i] = b * n + k
    return drawn


@kernel(entry=True, allocates=True)
def _move(q, velocity, carry, drawn, width, noise, outside, following, moved):
    """Move the drawn particles that are outside once more."""
    for b in range(len(drawn)):
        for i in range(drawn.shape[1]):
            if outside[b, i]:
                k = drawn[b, i]
                for c in range(q.shape[1]):
                    moved[b, i, c] = (velocity[k, c] if carry else 0.0) + width[b, c] * noise[i, c]
                    following[b, i, c] = q[k, c] + moved[b, i, c]
