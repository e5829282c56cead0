"""One contract for all estimators, and what checks that they keep it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from repro.angles import FreeAngles
from repro.common import Array, array, bad_input, numbers, require
from repro.parts import Assembly
from repro.sensing import Linearised, sensing_of


class Estimate(NamedTuple):
    """What an estimator says after a time step. Leading dimensions are a batch of independent robots.

    Parameters
    ----------
    q
        Configuration ``[..., n_q]``: m and rad.
    covariance
        Covariance of ``q`` ``[..., n_q, n_q]``, or ``None`` for estimators without one.
    u_hat
        Readings predicted at ``q`` ``[..., s]``, in the unit of the readings.
    chi2
        Squared residuals in units of the variances of the noise; NaN if no noise is stated.
    dof
        How many of these residuals the estimate could not adapt itself to. If model and noise are right, ``chi2`` has
        a chi-square distribution with so many degrees of freedom.
    missing
        Number of readings that were left out: masked, NaN or infinite.
    details
        More about the estimate, by name; arrays with the batch of ``q``.

    Examples
    --------
    >>> Estimate(np.zeros(3), None, np.zeros(8), np.nan, 5, 0, {}).q
    array([0., 0., 0.])
    """

    q: Array
    covariance: Array | None
    u_hat: Array
    chi2: Any
    dof: Any
    missing: Any
    details: dict[str, Array]


@runtime_checkable
class Estimator(Protocol):
    """What every estimator offers: an explicit state, from ``init`` through every ``step``, that nobody changes.

    ``init(q0, seed)`` returns the state before the first readings, at the configuration ``q0`` ``[..., n_q]``.
    ``step(state, u, t, mask, known)`` takes in readings ``u`` ``[..., s]`` at the time ``t`` [s] and returns the next
    state and an :class:`Estimate`. Readings that are NaN or infinite, or whose ``mask`` is false, are missing.
    ``known`` ``[..., n_q]`` holds coordinates that an experiment measures, and NaN for those to be estimated: truth
    never enters otherwise.
    """

    def init(self, q0: ArrayLike | None = None, seed: int = 0) -> Any:
        """Return the state before the first readings."""
        ...

    def step(
        self,
        state: Any,
        u: ArrayLike,
        t: float = 0.0,
        mask: ArrayLike | None = None,
        known: ArrayLike | None = None,
    ) -> tuple[Any, Estimate]:
        """Take in readings."""
        ...


@runtime_checkable
class OfRobot(Protocol):
    """What knows its robot: a sensor model, or an estimator that reads tables by the names of the robot's sensors."""

    robot: Assembly | None


@runtime_checkable
class Watched(Estimator, Protocol):
    """What an estimator offers beside ``init`` and ``step`` for a :class:`.Monitor` to watch it.

    Its estimates report ``chi2`` and ``dof``, and it takes batches and readings that are NaN.
    """

    robot: Assembly | None
    """Whose shape it estimates, if known."""
    n_q: int
    """Number of coordinates."""
    needs_time: bool
    """Whether it predicts by the time since the last row."""

    @property
    def angles(self) -> FreeAngles:
        """Which coordinates come round again."""
        ...

    @property
    def bounds(self) -> tuple[Array, Array] | None:
        """Bounds of the coordinates, if there are any."""
        ...

    def parts_of(self, n_readings: int) -> tuple[Array, Array]:
        """Return which part every reading belongs to, and which readings never stay the same ``[s]``."""
        ...

    def widened(self, share: float) -> Any:
        """Return the estimator with bounds a share of their width farther out, or nothing without bounds."""
        ...


_SHAPES = 256
"""Shapes within the bounds at which we look whether a reading comes too close to a magnet."""


class NearMagnets:
    """Which readings are taken too close to a magnet for its field to be known, at the last estimate.

    Where the multipoles do not describe the field, a reading would pull the estimate anywhere: it is left out.
    """

    def __init__(self, sensing: Any, q: Array) -> None:
        self.sensing, self.q = sensing, q

    @classmethod
    def of(cls, robot: Assembly | None, n_readings: int, q0: ArrayLike | None = None) -> NearMagnets | None:
        """Return it for a robot, or nothing if no reading comes so close within the bounds."""
        if robot is None or robot.lower is None or robot.upper is None or n_readings != robot.n_readings:
            return None
        if robot.model is not None or not robot.magnets:
            return None
        sensing = sensing_of(robot)
        if not sensing.too_near(evenly(robot.lower, robot.upper, _SHAPES)).any():
            return None
        return cls(sensing, np.asarray(robot.usual_shape if q0 is None else q0, dtype=float))

    def readings(self) -> Array:
        """Return which readings to leave out ``[..., s]``."""
        return self.sensing.too_near(np.nan_to_num(self.q))


def incoming(u: ArrayLike, mask: ArrayLike | None, owner: str, n: int | None = None) -> Array:
    """Return readings as float64 with NaN for every missing one; refuse another number of readings.

    Raises
    ------
    InputError
        If ``u`` holds no numbers, has another width than ``n``, or the mask does not fit.
    """
    if not (type(u) is np.ndarray and u.dtype == np.float64):
        u = numbers(u, "u", owner, finite=False)
    if u.ndim == 0 or (n is not None and u.shape[-1] != n):
        words = "of shape (..., s)" if n is None else f"{n} readings (last dimension)"
        raise bad_input("u", owner, words, f"shape {u.shape}")
    if mask is not None:
        use = array(mask, "mask", owner)
        if use.dtype != np.bool_ or use.shape[-1:] != u.shape[-1:]:
            words = f"true or false for each of {u.shape[-1]} readings"
            raise bad_input("mask", owner, words, f"{use.dtype} of shape {use.shape}")
        u = np.where(use, u, np.nan)
    return u


class Tuned:
    """An estimator whose public attributes may be set at any time: what was derived from them is then forgotten.

    Arrays among them are copies that nobody can write to, so that none changes unnoticed.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if not name.startswith("_"):
            if isinstance(value, np.ndarray):
                value = value.copy()
                value.setflags(write=False)
            for kind in type(self).__mro__:
                for derived, x in vars(kind).items():
                    if isinstance(x, cached_property):
                        vars(self).pop(derived, None)
        object.__setattr__(self, name, value)


def robot_of(x: object) -> Assembly | None:
    """Return the robot of a sensor model or an estimator, if it knows one."""
    return x.robot if isinstance(x, OfRobot) and isinstance(x.robot, Assembly) else None


def start(q0: ArrayLike, n_q: int, owner: str) -> Array:
    """Return a start configuration ``[..., n_q]`` as float64, or refuse it."""
    return numbers(q0, "q0", owner, (..., n_q))


def check_free(robot: Assembly, owner: str) -> None:
    """Refuse a robot without a coordinate to estimate: its shape would be known exactly, whatever is read."""
    fixed = "none" if robot.n_q == 0 else f"{', '.join(robot.coordinates)}, fixed by equal bounds"
    require(not robot.fixed.all(), "robot", owner, "one with a coordinate that is free", fixed)


def described(
    sensing: Any, lower: ArrayLike | None, upper: ArrayLike | None, noise: ArrayLike | None, owner: str
) -> tuple[Assembly | None, Any, Any, Any, Any]:
    """Return the robot behind a sensor model if there is one, the model, and what is not given as the robot has it.

    Raises
    ------
    InputError
        If bounds or noise are neither given nor stated by a robot, or nothing of the robot is to be estimated.
    """
    if isinstance(sensing, Assembly):
        robot = sensing
        if lower is None or upper is None:
            check_free(robot, owner)
        sensing = sensing_of(robot)
    else:
        robot = robot_of(sensing)
    stated = (None, None, None) if robot is None else (robot.lower, robot.upper, robot.total_noise)
    found = []
    for name, value, own in zip(("lower", "upper", "noise"), (lower, upper, noise), stated, strict=True):
        found.append(own if value is None else value)
        require(found[-1] is not None, name, owner, "given, or stated by the robot", "neither")
    return robot, sensing, *found


def fixed_coordinates(lower: Array, upper: Array) -> Array | None:
    """Return what equal bounds fix ``[n_q]``, NaN for the other coordinates; ``None`` if they fix nothing."""
    fixed = lower == upper
    return np.where(fixed, lower, np.nan) if fixed.any() else None


def information_of_bounds(lower: Array, upper: Array, free: Array) -> Array:
    """Return the inverse variance of every coordinate between its bounds, zero where they fix it.

    It is that of a uniform distribution, over a whole turn for a free angle.
    """
    width = np.where(free, 2 * np.pi, upper - lower)
    return np.divide(12.0, width**2, out=np.zeros(len(width)), where=upper > lower)


def batch_of(x: Array, y: Array) -> tuple[int, ...]:
    """Return the batch of two arrays ``[..., n]``; for one robot without NumPy's long way."""
    return () if x.ndim == y.ndim == 1 else np.broadcast_shapes(x.shape[:-1], y.shape[:-1])


def each(x: Array, batch: tuple[int, ...], *own: int) -> Array:
    """Return what each member of a batch has, one after the other ``[members, *own]``; copied only if shared."""
    shape = (*batch, *own)
    return (x if x.shape == shape else np.broadcast_to(x, shape)).reshape(-1, *own)


def evenly(lower: Array, upper: Array, n: int) -> Array:
    """Return ``n`` points that fill a box evenly ``[n, n_q]``: an additive recurrence, the middle first."""
    golden, count = 2.0, len(lower)
    for _ in range(60):  # the root of x^(n_q + 1) = x + 1
        golden = (1 + golden) ** (1 / (count + 1))
    share = (0.5 + np.arange(n)[:, None] * golden ** -np.arange(1.0, count + 1)) % 1.0
    return lower + share * (upper - lower)


def known_coordinates(
    known: ArrayLike | None, n_q: int, owner: str, fixed: Array | None = None
) -> Array | None:
    """Return known coordinates ``[..., n_q]``, NaN for those to be estimated; infinity is refused."""
    if known is None:
        return fixed
    values = numbers(known, "known", owner, (..., n_q), finite=False)
    require(not np.isinf(values).any(), "known", owner, "finite, or NaN for unknown", "infinity")
    return values if fixed is None else np.where(np.isnan(values), fixed, values)


def conditioned(x: Array, C: Array, known: Array) -> tuple[Array, Array]:
    """Return mean and covariance, given the coordinates that are known."""
    given = ~np.isnan(known)
    rows, columns = given[..., :, None], given[..., None, :]
    inverse = np.linalg.pinv(np.where(rows & columns, C, 0.0), rcond=1e-12, hermitian=True)
    gain = np.where(columns, C, 0.0) @ inverse
    off = np.where(given, known - x, 0.0)
    moved = x + (gain @ off[..., None])[..., 0]
    return np.where(given, known, moved), np.where(~rows & ~columns, C - gain @ C, 0.0)


def spread(x: Array, shape: tuple[int, ...]) -> Array:
    """Return a copy of what each member of a batch has, in the shape of all, as kernels take it."""
    return x.copy() if x.shape == shape else np.broadcast_to(x, shape).copy()


def in_line(batch: tuple[int, ...], *arrays: Array) -> Sequence[Array]:
    """Return arrays ``[*batch, n, ...]`` with the members one after the other ``[members * n, ...]``, for a kernel.

    Those of a single robot already are: it is reshaped by nobody.
    """
    n = len(batch) + 1
    return [x.reshape(math.prod(x.shape[:n]), *x.shape[n:]) for x in arrays] if batch else arrays


class CallableModel:
    """Any callable as a sensor model: how it takes batches and where its slopes come from is found out once."""

    compiled = False
    rotations = ()

    def __init__(self, sensing: Any, middle: Array, width: Array, owner: str) -> None:
        self.sensing, self._step, self.owner = sensing, 6e-6 * width, owner
        nearby = np.stack([middle, middle + 0.01 * width])
        single = [self._one(q) for q in nearby]
        self.n_readings = len(single[0])
        self.batched = self._matches(sensing, nearby, np.stack(single))
        self._slopes = sensing.linearise if isinstance(sensing, Linearised) else None
        turned = nearby + 1e-20j * self._step
        self.complex = self._slopes is None and self._matches(
            lambda q: np.imag(self._called(q, complex)) / 1e-20,
            turned,
            np.stack([self._called(q + self._step) - self._called(q - self._step) for q in nearby]) / 2,
            1e-5,
        )

    def _one(self, q: Array) -> Array:
        try:
            u = np.asarray(self.sensing(q), dtype=float)
        except Exception as error:  # whatever a model raises is said in one line
            expected, words = f"a callable of {len(q)} coordinates", f"{type(error).__name__}: {error}"
            if hasattr(self.sensing, "state_dict"):
                expected += (
                    " and arrays: of a torch module, lambda q: module(torch.as_tensor(q)).detach().numpy()"
                )
                expected += " after module.double()"
            raise bad_input("sensing", self.owner, expected, words) from error
        require(u.ndim == 1, "sensing", self.owner, "one that returns readings [s]", f"shape {u.shape}")
        return u

    @staticmethod
    def _matches(call: Callable[[Array], Any], q: Array, expected: Array, tolerance: float = 1e-9) -> bool:
        try:
            with warnings.catch_warnings():
                # Who drops the imaginary part drops the slope.
                warnings.simplefilter("error", np.exceptions.ComplexWarning)
                found = np.asarray(call(q))
        except Exception:  # it does not take this: there is another way
            return False
        close = found.shape == expected.shape and np.isrealobj(found)
        return close and bool(
            np.allclose(found, expected, tolerance, tolerance * np.abs(expected).max(), True)
        )

    def _called(self, q: Array, dtype: type = float) -> Array:
        if q.ndim == 1 or self.batched:
            return np.asarray(self.sensing(q), dtype=dtype)
        return np.stack([np.asarray(self.sensing(x), dtype=dtype) for x in q])

    def __call__(self, q: Array) -> Array:
        """Return readings ``[n, s]`` at configurations ``[n, n_q]``."""
        return self._called(q)

    def linearise(self, q: Array) -> tuple[Array, Array]:
        """Return readings ``[n, s]`` and slopes ``[n, s, n_q]``."""
        if self._slopes is not None:
            pairs = [self._slopes(q)] if self.batched else [self._slopes(x) for x in q]
            u, J = (
                np.concatenate([np.reshape(x[i], (-1, *np.shape(x[i])[-1 - i :])) for x in pairs])
                for i in (0, 1)
            )
            return np.asarray(u, dtype=float), np.asarray(J, dtype=float)
        n, n_q = q.shape
        moves = np.diag(self._step)
        if self.complex:
            u: Any = self._called((q[:, None] + 1e-14j * moves).reshape(-1, n_q), complex).reshape(n, n_q, -1)
            return np.ascontiguousarray(u[:, 0].real), np.swapaxes(u.imag, 1, 2) / (1e-14 * self._step)
        around = np.concatenate([q[:, None], q[:, None] + moves, q[:, None] - moves], axis=1)
        u = self._called(around.reshape(-1, n_q)).reshape(n, 2 * n_q + 1, -1)
        slopes = (u[:, 1 : n_q + 1] - u[:, n_q + 1 :]) / (2 * self._step[:, None])
        return u[:, 0], np.swapaxes(slopes, 1, 2)

    @staticmethod
    def difference(u: Array, u_hat: Array) -> Array:
        """Return what was read beyond what was predicted, NaN where nothing was read."""
        return np.where(np.isfinite(u), u, np.nan) - u_hat


def model_of(sensing: Any, lower: Array, upper: Array, owner: str) -> Any:
    """Return a sensor model with ``linearise``, ``difference`` and ``rotations``: itself, or a wrapper.

    Raises
    ------
    InputError
        If it is no callable, fails, or has another number of coordinates than the bounds.
    """
    require(callable(sensing), "sensing", owner, "a callable from q to readings", type(sensing).__name__)
    if hasattr(sensing, "compiled"):
        expected = f"bounds of its {sensing.n_q} coordinates"
        require(len(lower) == sensing.n_q, "lower, upper", owner, expected, f"{len(lower)}")
        return sensing
    width = np.where(upper > lower, upper - lower, 1.0)
    return CallableModel(sensing, (lower + upper) / 2, width, owner)


def parts_of(robot: Assembly | None, noise: Array, n_readings: int) -> tuple[Array, Array]:
    """Return which part every reading belongs to, and which never stay the same: their noise is above their step."""
    if robot is None or robot.n_readings != n_readings:
        return np.arange(n_readings), np.ones(n_readings, dtype=bool)
    noise = noise if robot.noise is None else robot.noise
    return robot.parts, np.broadcast_to(noise >= robot.resolution, (n_readings,))


def _each_of(function: Any, x: Any, *others: Any) -> Any:
    """Apply a function to all arrays and numbers of states or estimates of one kind."""
    if isinstance(x, dict):
        return {name: _each_of(function, y, *(other[name] for other in others)) for name, y in x.items()}
    if isinstance(x, tuple):
        return type(x)(*(_each_of(function, *values) for values in zip(x, *others, strict=True)))
    return function(x, *others)


def member(x: Any, k: Any) -> Any:
    """Return one robot of a batch of states or estimates."""
    return _each_of(lambda y: y[k] if isinstance(y, np.ndarray) else y, x)


def with_member(x: Any, k: Any, y: Any) -> Any:
    """Return a batch with one robot exchanged."""

    def exchanged(old: Any, new: Any) -> Any:
        if not isinstance(old, np.ndarray):
            return new
        old = old.copy()
        old[k] = new
        return old

    return y if k == () else _each_of(exchanged, x, y)


def chosen(condition: Array, x: Any, y: Any) -> Any:
    """Return a batch of the robots of one where a condition holds, else of another."""

    def where(old: Any, new: Any) -> Any:
        return np.where(condition[(...,) + (None,) * (np.ndim(old) - condition.ndim)], new, old)[()]

    return _each_of(where, y, x)


def grown(estimate: Estimate, added: Array | float, factor: Array | float = 1.0) -> Estimate:
    """Return an estimate whose covariance is multiplied by a factor, with another one added."""
    C: Any = estimate.covariance
    return estimate._replace(covariance=factor * C + added)
