"""What is mounted on a chain: sensors and IMUs with their errors, and a chain with its magnets and these."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np

from repro.chain import Chain, Place, Segment, check_tolerance, place, unit_quaternions
from repro.common import Array, ArrayLike, numbers, require, scalar


def check_free(part: Any, sizes: Sequence[str] = ()) -> None:
    """Refuse a part whose freedom is not its own, or no range."""
    owner, known = type(part).__name__, ("at", "azimuth", *sizes)
    for name, ends in (part.free or {}).items():
        require(name in known, "free", owner, f"of {', '.join(known)}", repr(name))
        low, high = numbers(ends, f"free {name}", owner, (2,))
        require(low < high, f"free {name}", owner, "(lowest, highest), the smaller first", ends)


@dataclass(frozen=True)
class Sensor:
    r"""A magnetic sensor with one measuring axis, or a chip with three.

    A sensor with one axis (Baaij et al. 2023, eq. (2)) measures towards the base, along
    :math:`R_z(\varphi) (-\sin\psi, 0, -\cos\psi)`: a positive tilt :math:`\psi` points it inwards. ``direction`` says
    otherwise. A sensor with three axes gives three readings, along the x, y and z axes of its own frame.

    Parameters
    ----------
    segment
        Segment that it is mounted on, from 1 at the base; 0 is the base itself.
    at
        Distance from the base of that segment along the unextended backbone [m].
    radial
        Distance from the backbone [m].
    azimuth
        Angle in the cross-section, from x to y [rad].
    tilt
        Angle :math:`\psi` [rad] about the tangential direction.
    position
        Place in the frame of the cross-section [m], instead of ``radial`` and ``azimuth``.
    direction
        Measuring direction in that frame, of any length, instead of ``tilt``.
    axes
        1 or 3.
    orientation
        Quaternion XYZW from the frame of a chip with three axes to that of the cross-section.
    name
        What messages and tables call it; ``sensor 1`` and so on if not given.
    channels
        The columns of its readings, one for every axis: names, or numbers from 1.
    range
        Largest reading of either sign [mT].
    resolution
        Step between two readings [mT].
    noise
        Standard deviation of its readings, one number or one for every axis [mT].
    gain
        It reads ``gain`` times the flux density; one number or one for every axis.
    offset
        What it reads without a field [mT]; one number or one for every axis.
    per_mt
        Units of its column for 1 mT, where the column is not a flux density: 100 for 0.01 mT per count.
    unit
        What these units are called, such as ``"raw"``.
    tolerance
        Standard deviations by which it may be off its drawing: a mapping with some of ``position``, ``at``,
        ``radius`` [m], ``azimuth``, ``tilt`` [rad], ``gain`` (relative), ``offset`` [mT].
    free
        Ranges in which a better design may put it, of :func:`.improve_design`: a mapping from some of ``at`` [m],
        ``azimuth`` [rad] to ``(lowest, highest)``.

    Raises
    ------
    InputError
        If a number is not finite, the radius is negative, or an argument does not fit the number of axes.

    Examples
    --------
    >>> Sensor(segment=1, at=0.11, radial=0.013, tilt=np.pi / 6).place.rotation[:, 2].round(3)
    array([-0.5  ,  0.   , -0.866])
    """

    segment: int
    at: float
    radial: float = 0.0
    azimuth: float = 0.0
    tilt: float = 0.0
    position: ArrayLike | None = None
    direction: ArrayLike | None = None
    axes: int = 1
    orientation: ArrayLike | None = None
    name: str | None = None
    channels: Sequence[str | int] | None = None
    range: float = math.inf
    resolution: float = 0.0
    noise: ArrayLike | None = None
    gain: ArrayLike = 1.0
    offset: ArrayLike = 0.0
    per_mt: float = 1.0
    unit: str = "mT"
    tolerance: Mapping[str, float] | None = None
    free: Mapping[str, tuple[float, float]] | None = None

    def __post_init__(self) -> None:
        require(self.axes in (1, 3), "axes", "Sensor", "1 or 3", self.axes)
        named = self.channels
        fits = named is None or (type(named) is not str and len(named) == self.axes)
        require(fits, "channels", "Sensor", f"a list of {self.axes}, one for every axis", named)
        for name in ("resolution", "range", "per_mt", "radial"):
            _ = scalar(vars(self)[name], name, "Sensor")
        require(
            0 <= self.resolution < self.range,
            "resolution",
            "Sensor",
            "from 0 to below the range",
            (self.resolution, self.range),
        )
        for name in ("gain", "offset", "noise"):
            value = vars(self)[name]
            fits = value is None or numbers(value, name, "Sensor").shape in ((), (self.axes,))
            require(fits, name, "Sensor", f"one number or {self.axes}, one for every axis", value)
        require(np.all(self.gain), "gain", "Sensor", "not zero", self.gain)
        positive = self.noise is None or np.greater(self.noise, 0).all()
        require(positive, "noise", "Sensor", "positive [mT]", self.noise)
        require(math.isfinite(self.per_mt) and self.per_mt, "per_mt", "Sensor", "not zero", self.per_mt)
        check_tolerance(self.tolerance, "Sensor")
        check_free(self)
        require(self.radial >= 0, "radial", "Sensor", "not negative [m]", self.radial)
        turned = self.direction is not None or bool(self.tilt)
        expected = "for one axis; orientation is for three"
        require(self.axes == 1 or not turned, "direction, tilt", "Sensor", expected, "both")
        expected = "for three axes; direction is for one"
        require(
            self.axes == 3 or self.orientation is None, "orientation", "Sensor", expected, self.orientation
        )
        _ = self.place

    @cached_property
    def place(self) -> Place:
        """Where it is; the columns of the rotation are its axes, the last one that of a sensor with one axis."""
        phi, psi = (float(numbers(x, "angle", "Sensor", ())) for x in (self.azimuth, self.tilt))
        at = self.position
        if at is None:
            at = [self.radial * math.cos(phi), self.radial * math.sin(phi), 0.0]
        if self.axes == 1 and self.direction is None:
            c, s, cp, sp = math.cos(phi), math.sin(phi), math.cos(psi), math.sin(psi)
            R = np.array([[c * cp, s, -c * sp], [s * cp, -c, -s * sp], [-sp, 0.0, -cp]]) + 0.0
            return place("Sensor", self.segment, self.at, at)._replace(rotation=R)
        return place("Sensor", self.segment, self.at, at, self.orientation, self.direction)


@dataclass(frozen=True)
class Imu:
    """An orientation sensor. It reads the rotation vector [rad] that turns its own frame to the base frame.

    Parameters
    ----------
    segment
        Segment that it is mounted on, from 1 at the base; 0 is the base itself.
    at
        Distance from the base of that segment along the unextended backbone [m].
    orientation
        Quaternion XYZW from its own frame to that of the cross-section, whose z axis points along the backbone.
    name
        What messages and tables call it; ``imu 1`` and so on if not given.
    channels
        The columns of its quaternion XYZW, or the number of its stream.
    noise
        Standard deviation of its orientation about every axis [rad].
    world
        Quaternion XYZW from the frame of the base to the world that its quaternions refer to; the base itself if not
        given.
    tolerance
        Standard deviations by which it may be off its drawing: a mapping with some of ``at`` [m], ``tilt``,
        ``heading`` [rad].

    Raises
    ------
    InputError
        If the numbers describe no place or no orientation.

    Examples
    --------
    >>> Imu(segment=1, at=0.11).place.rotation[:, 2]
    array([0., 0., 1.])
    """

    segment: int
    at: float
    orientation: ArrayLike | None = None
    name: str | None = None
    channels: Any = None
    noise: float | None = None
    world: ArrayLike | None = None
    tolerance: Mapping[str, float] | None = None
    axes: ClassVar[int] = 3

    def __post_init__(self) -> None:
        _ = self.noise is None or scalar(self.noise, "noise", "Imu", "positive [rad]")
        if self.world is not None:
            unit_quaternions(self.world, "world", "Imu", (4,))
        check_tolerance(self.tolerance, "Imu")
        _ = self.place

    @cached_property
    def place(self) -> Place:
        """Where it is, and how it is turned there."""
        return place("Imu", self.segment, self.at, None, self.orientation)


@runtime_checkable
class Mounted(Protocol):
    """What is mounted on a chain."""

    @property
    def place(self) -> Place:
        """Where it is."""
        ...


class Source(NamedTuple):
    """The file that a robot was read from: its name, the hash of its content, and its table ``[stream]``."""

    name: str
    sha256: str
    stream: Mapping[str, Any]


class Assembly(Chain):
    """A chain with magnets, sensors and IMUs on it: what of :class:`repro.Robot` everything else builds on."""

    def __init__(
        self,
        segments: Sequence[Segment],
        magnets: Sequence[Any] = (),
        sensors: Sequence[Sensor] = (),
        imus: Sequence[Imu] = (),
        *,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        start: ArrayLike | None = None,
        noise: ArrayLike | None = None,
        rate_hz: float | None = None,
        earth: ArrayLike | None = None,
        model: Any = None,
        moments: ArrayLike | None = None,
        source: Source | None = None,
    ) -> None:
        super().__init__(segments, lower, upper, start)
        self.magnets, self.sensors, self.imus = tuple(magnets), tuple(sensors), tuple(imus)
        named: dict[str, Sequence[Any]] = {"magnets": magnets, "sensors": sensors, "imus": imus}
        for name, parts in named.items():
            for k, part in enumerate(parts):
                mounted = isinstance(part, Mounted) and isinstance(part.place, Place)
                require(mounted, name, "Robot", "parts with a place", type(part).__name__)
                self.check_place(part.place, f"{name}, number {k + 1},")
        self.n_readings = sum(part.axes for part in (*self.sensors, *self.imus))
        """Number of readings, one for every axis of every sensor, then three for every IMU."""
        self.range = self.per_reading("range", math.inf, math.inf)
        """Largest reading of either sign ``[s]`` [mT], infinite where not stated."""
        self.resolution = self.per_reading("resolution", 0.0, 0.0)
        """Step between two readings ``[s]`` [mT], zero where not stated."""
        # A reading at the end may be rounded, to its resolution or to float32; and no sensor reads 1e100.
        self.n_magnetic = sum(sensor.axes for sensor in self.sensors)
        self._end = np.minimum((1 - 1e-6) * self.range - self.resolution / 2, 1e100)
        self.model, self.moments, self.source = model, moments, source
        self.rate_hz = None if rate_hz is None else scalar(rate_hz, "rate_hz", "Robot", "positive")
        self.earth = None if earth is None else numbers(earth, "earth", "Robot", (3,))
        self._noise_given = noise
        self.noise = self._noise(noise)
        """Standard deviation of every reading ``[s]`` [mT; rad for IMUs], or None where not stated."""

    def _noise(self, noise: ArrayLike | None) -> Array | None:
        given = numbers(np.nan if noise is None else noise, "noise", "Robot", finite=False)
        n = self.n_readings
        require(
            given.shape in ((), (n,)), "noise", "Robot", f"one number or one for each of {n} readings", given
        )
        require(noise is None or (given > 0).all(), "noise", "Robot", "positive", noise)
        std = self.per_reading("noise", np.nan, np.nan)
        std = np.where(np.isnan(std), given, std)
        return None if np.isnan(std).any() else std

    @property
    def total_noise(self) -> Array | None:
        """Standard deviation of every reading ``[s]``, with the error of rounding to its resolution."""
        return None if self.noise is None else np.sqrt(self.noise**2 + self.resolution**2 / 12)

    def per_reading(self, name: str, none: float, of_imus: float) -> Array:
        """Return what sensors and IMUs state under a name, for every reading ``[s]``; ``none`` where they do not."""
        found = [np.zeros(0)]
        for part in (*self.sensors, *self.imus):
            value = vars(part).get(name, of_imus)
            found.append(np.full(part.axes, none if value is None else value, dtype=float))
        return np.concatenate(found)

    @cached_property
    def usual_shape(self) -> Array:
        """Where it starts ``[n_q]``; else the middle of its bounds, or straight without bounds."""
        if self.lower is None or self.upper is None:
            return np.zeros(self.n_q) if self.start is None else self.start
        return (self.lower + self.upper) / 2 if self.start is None else self.start

    @cached_property
    def part_names(self) -> tuple[str, ...]:
        """Names of the sensors and IMUs, each of which may give several readings."""
        named = [(x.name, f"sensor {k}") for k, x in enumerate(self.sensors, 1)]
        named += [(x.name, f"imu {k}") for k, x in enumerate(self.imus, 1)]
        return tuple(own or usual for own, usual in named)

    @cached_property
    def parts(self) -> Array:
        """Index of the sensor or IMU in :attr:`part_names` that every reading belongs to ``[s]``."""
        sizes = [part.axes for part in (*self.sensors, *self.imus)]
        return np.repeat(np.arange(len(sizes)), np.array(sizes, dtype=int))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """One name for every reading, which is its channel, or ``sensor 1 x`` and so on."""
        names = []
        for part, name in zip((*self.sensors, *self.imus), self.part_names, strict=True):
            channels = part.channels if isinstance(part, Sensor) else None
            if channels and all(isinstance(channel, str) for channel in channels):
                names += channels
            else:
                names += [name] if part.axes == 1 else [f"{name} {axis}" for axis in "xyz"]
        return tuple(names)

    def missing(self, u: ArrayLike) -> Array:
        """Return why readings are missing, each row by itself: one rule for files, boards and arrays.

        A reading at the end of its sensor's range, within half a step of it, says only that the field is larger.
        Magnetic readings that are all zero, if there are more than two, are what a bus sends that has failed.

        Parameters
        ----------
        u
            Readings ``[..., s]`` in mT, and rad for IMUs.

        Returns
        -------
        numpy.ndarray
            For every reading 0 if it is there, 1 if it is no number or infinite, 2 if it is at the end of its range
            or beyond, 3 if it is in a row without a magnetic reading but zeros.

        Raises
        ------
        InputError
            If the robot has another number of readings.

        Examples
        --------
        >>> from repro import Link, Robot, Sensor
        >>> chip = Robot([Link(0.1)], sensors=[Sensor(1, 0.05, axes=3, range=5.0)])
        >>> chip.missing([[0.0, 5.0, np.nan], [0.0, 0.0, 0.0]]).tolist()
        [[0, 2, 1], [3, 3, 3]]
        """
        u = numbers(u, "u", "missing", (..., self.n_readings), finite=False)
        size, n = np.abs(u), self.n_magnetic
        why = np.where(size >= self._end, 2, 0)
        why[~np.isfinite(size)] = 1
        zero = size[..., :n] == 0
        silent = (zero.sum(-1) > 2) & (zero | (why[..., :n] > 0)).all(-1)
        why[..., :n][silent] = 3
        return why

    def part(self, name: object, owner: str) -> int:
        """Return which of ``part_names`` a sensor or IMU is, from 0, by its name or by its number from 1."""
        names, word = list(self.part_names), str(name)
        k = names.index(word) if word in names else int(word) - 1 if word.isdecimal() else -1
        listed = ", ".join(f"{x} ({n})" for n, x in enumerate(names, 1))
        require(0 <= k < len(names), "sensor", owner, f"one of {listed}", repr(name))
        return k

    def replaced(self, **changes: Any) -> Self:
        """Return this robot with other parts or numbers, by the names of the arguments of :class:`Robot`.

        Examples
        --------
        >>> from repro import Link, Robot
        >>> Robot([Link(0.1)], rate_hz=25.0).replaced(segments=[Link(0.2)]).rate_hz
        25.0
        """
        options = inspect.signature(type(self)).parameters
        own = {name: vars(self)[name] for name in options if name != "noise"}
        if changes.keys() & {"segments", "magnets", "sensors", "earth", "model", "moments"}:
            own["source"] = None  # the file describes another robot
        return type(self)(**{**own, "noise": self._noise_given, **changes})
