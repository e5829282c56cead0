r"""A robot: segments in series, with magnets, sensors and IMUs mounted on them.

Every segment gives the pose of its backbone frame at :math:`v \in [0, 1]` and one *twist* per coordinate: how the
frame turns and moves when that coordinate changes. We refer all twists :math:`(\omega, \nu)` to the origin of the
base frame, where a point at :math:`p` moves by :math:`\nu + \omega \times p` and a direction :math:`o` by
:math:`\omega \times o`. In this form everything mounted on one frame shares its twists, and what lies beyond a
segment moves with the twist of its tip.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from repro.angles import FreeAngles
from repro.common import Array, bad_input, kernel, numbers, require, rows_of, scalar

_CONSTANT, _AFFINE, _LINK, _JOINT, _FREE = range(5)
_KINDS = "of ConstantCurvature, AffineCurvature, Link, BallJoint, FreeBody"


class Segment:
    """What all segments have; the kernels know the five kinds below."""

    kind: ClassVar[int]
    length: float

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return ()

    @property
    def sizes(self) -> tuple[float, float]:
        """Two numbers for the kernels: length [m], or which axes turn as the bits of a number; and radius [m]."""
        axes = sum(1 << "xyz".index(axis) for axis in getattr(self, "axes", ""))
        return float(axes) or self.length, getattr(self, "radius", 0.0)


@dataclass(frozen=True)
class ConstantCurvature(Segment):
    r"""A segment that bends in an arc of constant curvature and may lengthen (Baaij et al. 2023, appendix A.1).

    Its configuration is :math:`q = (\Delta_x, \Delta_y, \delta L)` [m]. The segment bends by
    :math:`\theta = \sqrt{\Delta_x^2 + \Delta_y^2}/r` towards :math:`(\Delta_x, \Delta_y)`, and is
    :math:`L_0 + \delta L` long. At :math:`v` the tangent has turned by :math:`v\theta`, eq. (15).

    Parameters
    ----------
    length
        Unextended length :math:`L_0` [m].
    radius
        Distance :math:`r` from the backbone to the actuators [m], the unit of bending: ``delta_x = radius`` bends by
        1 rad.
    extensible
        Whether it lengthens. If not, :math:`\delta L` is no coordinate; with ``radius=1`` the coordinates are then
        the bend vector [rad] of Mitchell et al. 2021.

    Raises
    ------
    InputError
        If a size is not positive.

    Examples
    --------
    A quarter circle of 110 mm towards x ends at (2 L/pi, 0, 2 L/pi):

    >>> from repro import ConstantCurvature, Robot
    >>> robot = Robot([ConstantCurvature(length=0.110, radius=0.022)])
    >>> robot.tip([0.022 * np.pi / 2, 0.0, 0.0])[:3, 3].round(6)
    array([0.070028, 0.      , 0.070028])
    """

    length: float
    radius: float
    extensible: bool = True
    kind: ClassVar[int] = _CONSTANT

    def __post_init__(self) -> None:
        for name in ("length", "radius"):
            _ = scalar(vars(self)[name], name, "ConstantCurvature", "positive [m]")

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return ("delta_x", "delta_y", "delta_L") if self.extensible else ("delta_x", "delta_y")


@dataclass(frozen=True)
class AffineCurvature(Segment):
    r"""A segment whose curvature changes linearly along it, in one plane (Baaij et al. 2023, appendix A.2).

    Its configuration is :math:`q = (\kappa_0, \kappa_1, \phi, \delta L)` [rad, rad, rad, m]. The tangent at :math:`v`
    has turned by :math:`\theta(v) = \kappa_0 v + \kappa_1 v^2/2`, eq. (17), towards
    :math:`(\sin\phi, -\cos\phi)`. The position, eq. (18), is the integral of the tangent: we take 24 Gauss-Legendre
    nodes, whose error is below 2e-14 of the length up to :math:`|\kappa_0| = \pi, |\kappa_1| = 4\pi`. The same shape
    has a second configuration, :math:`(-\kappa_0, -\kappa_1, \phi + \pi)`.

    Parameters
    ----------
    length
        Unextended length :math:`L_0` [m].

    Raises
    ------
    InputError
        If the length is not positive.

    Examples
    --------
    A quarter circle of 0.2 m towards -y:

    >>> from repro import AffineCurvature, Robot
    >>> Robot([AffineCurvature(0.2)]).tip([np.pi / 2, 0.0, 0.0, 0.0])[:3, 3].round(4)
    array([ 0.    , -0.1273,  0.1273])
    """

    length: float
    kind: ClassVar[int] = _AFFINE

    def __post_init__(self) -> None:
        _ = scalar(self.length, "length", "AffineCurvature", "positive [m]")

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return ("kappa_0", "kappa_1", "phi", "delta_L")


@dataclass(frozen=True)
class Link(Segment):
    """A rigid piece along z, without a coordinate.

    Parameters
    ----------
    length
        Its length [m]; zero is a place to mount things on.

    Raises
    ------
    InputError
        If the length is negative.

    Examples
    --------
    >>> from repro import Link, Robot
    >>> Robot([Link(0.1), Link(0.05)]).tip([])[:3, 3]
    array([0.  , 0.  , 0.15])
    """

    length: float
    kind: ClassVar[int] = _LINK

    def __post_init__(self) -> None:
        fits = 0 <= scalar(self.length, "length", "Link") < math.inf
        require(fits, "length", "Link", "not negative [m]", self.length)


@dataclass(frozen=True)
class BallJoint(Segment):
    """A joint that turns what follows it by a rotation vector; with one axis it is a hinge.

    Parameters
    ----------
    axes
        Which components of the rotation vector [rad] are coordinates: some of "xyz", in this order.

    Raises
    ------
    InputError
        If the axes are none of these.

    Examples
    --------
    A hinge about x, then a link of 0.1 m:

    >>> from repro import BallJoint, Link, Robot
    >>> robot = Robot([BallJoint("x"), Link(0.1)])
    >>> robot.coordinates, robot.tip([np.pi / 2])[:3, 3].round(3)
    (('rotation_x_1',), array([ 0. , -0.1,  0. ]))
    """

    axes: str = "xyz"
    kind: ClassVar[int] = _JOINT
    length = 0.0

    def __post_init__(self) -> None:
        known = self.axes in ("x", "y", "z", "xy", "xz", "yz", "xyz")
        require(known, "axes", "BallJoint", "some of 'xyz', in this order", self.axes)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return tuple(f"rotation_{axis}" for axis in self.axes)


@dataclass(frozen=True)
class FreeBody(Segment):
    """A body that is not attached: a position [m], then a rotation vector [rad].

    Examples
    --------
    >>> from repro import FreeBody, Robot
    >>> Robot([FreeBody()]).tip([0.1, 0.2, 0.3, 0.0, 0.0, 0.0])[:3, 3]
    array([0.1, 0.2, 0.3])
    """

    kind: ClassVar[int] = _FREE
    axes: ClassVar[str] = "xyz"
    length = 0.0

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return ("x", "y", "z", "rotation_x", "rotation_y", "rotation_z")


class Place(NamedTuple):
    """Where something is mounted: segment (0 is the base), distance along it [m], and its pose in the frame there."""

    segment: int
    at: float
    position: Array
    rotation: Array


def place(
    owner: str,
    segment: int,
    at: float,
    position: Any = None,
    rotation: Any = None,
    direction: Any = None,
) -> Place:
    """Return a checked place; the rotation is a quaternion XYZW or the shortest turn of z to a direction."""
    require(isinstance(segment, int | np.integer) and segment >= 0, "segment", owner, "0 or above", segment)
    r = np.zeros(3) if position is None else numbers(position, "position", owner, (3,))
    R = np.eye(3)
    if direction is not None:
        z = numbers(direction, "direction", owner, (3,))
        require(np.any(z), "direction", owner, "a vector that is not zero", direction)
        R = _turn_of_z_to(z / np.linalg.norm(z))
    elif rotation is not None:
        R = rotation_matrix(unit_quaternions(rotation, "orientation", owner, (4,)))
    return Place(int(segment), float(numbers(at, "at", owner, ())), r, R)


def _turn_of_z_to(z: Array) -> Array:
    x = np.cross([0.0, 1.0, 0.0], z)
    if np.linalg.norm(x) < 1e-6:
        x = np.array([1.0, 0.0, 0.0])
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def unit_quaternions(q: Any, name: str, owner: str, shape: tuple[Any, ...]) -> Array:
    """Return quaternions XYZW rescaled to norm 1; refuse those that are off by more than rounding.

    Raises
    ------
    InputError
        If a norm differs from 1 by more than 1e-3: raw counts or rounded numbers are no orientation.
    """
    found = numbers(q, name, owner, shape)
    norm = np.linalg.norm(found, axis=-1, keepdims=True)
    if not (np.abs(norm - 1) <= 1e-3).all():
        worst = float(norm.flat[np.argmax(np.abs(norm - 1))])
        raise bad_input(name, owner, "unit quaternions XYZW (norm 1 within 0.001)", f"a norm of {worst:g}")
    return found / norm


def rotation_matrix(q: Array) -> Array:
    """Return rotation matrices ``[..., 3, 3]`` of unit quaternions XYZW ``[..., 4]``."""
    x, y, z, w = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


TOLERANCES = {
    "magnet": ("position", "at", "tilt", "polarisation", "size"),
    "sensor": ("position", "at", "radius", "azimuth", "tilt", "gain", "offset"),
    "imu": ("at", "tilt", "heading"),
}
"""What a part may be off its drawing by: lengths [m], angles [rad], offset [mT]; polarisation, gain are relative."""


def check_tolerance(tolerance: Any, owner: str) -> None:
    """Refuse tolerances of a part that it does not have, or that are no standard deviations."""
    known = TOLERANCES[owner.lower()]
    for name, value in (tolerance or {}).items():
        require(name in known, "tolerance", owner, f"of {', '.join(known)}", repr(name))
        std = numbers(value, f"tolerance {name}", owner, ())
        require(std >= 0, f"tolerance {name}", owner, "not negative", value)


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
    position: Any = None
    direction: Any = None
    axes: int = 1
    orientation: Any = None
    name: str | None = None
    channels: Any = None
    range: float = math.inf
    resolution: float = 0.0
    noise: Any = None
    gain: Any = 1.0
    offset: Any = 0.0
    per_mt: float = 1.0
    unit: str = "mT"
    tolerance: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        require(self.axes in (1, 3), "axes", "Sensor", "1 or 3", self.axes)
        if self.channels is not None:
            fits = type(self.channels) is not str and len(self.channels) == self.axes
            require(fits, "channels", "Sensor", f"a list of {self.axes}, one for every axis", self.channels)
        for name in ("resolution", "range", "per_mt", "radial"):
            _ = scalar(getattr(self, name), name, "Sensor")
        require(
            0 <= self.resolution < self.range,
            "resolution",
            "Sensor",
            "from 0 to below the range",
            (self.resolution, self.range),
        )
        for name in ("gain", "offset", "noise"):
            value = getattr(self, name)
            fits = value is None or numbers(value, name, "Sensor").shape in ((), (self.axes,))
            require(fits, name, "Sensor", f"one number or {self.axes}, one for every axis", value)
        require(np.all(self.gain), "gain", "Sensor", "not zero", self.gain)
        if self.noise is not None:
            require(np.greater(self.noise, 0).all(), "noise", "Sensor", "positive [mT]", self.noise)
        require(math.isfinite(self.per_mt) and self.per_mt, "per_mt", "Sensor", "not zero", self.per_mt)
        check_tolerance(self.tolerance, "Sensor")
        require(self.radial >= 0, "radial", "Sensor", "not negative [m]", self.radial)
        if self.axes == 3:
            one = self.direction is None and not self.tilt
            require(one, "direction, tilt", "Sensor", "for one axis; orientation is for three", "both")
        elif self.orientation is not None:
            raise bad_input("orientation", "Sensor", "for three axes; direction is for one", self.orientation)
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
    orientation: Any = None
    name: str | None = None
    channels: Any = None
    noise: float | None = None
    world: Any = None
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


class Chain(NamedTuple):
    """Segments and the frames that something is mounted on, as arrays for the kernels."""

    kind: Array
    size: Array
    first: Array
    """First coordinate of every segment, and their number."""
    segment: Array
    """Segment of every frame, from 0; -1 for the base, which is frame 0."""
    v: Array
    """Where along its segment."""
    tip: Array
    """Frame of the tip of every segment."""


class Robot:
    """Segments from base to tip, with magnets, sensors and IMUs on them.

    Its configuration ``q`` holds the coordinates of all segments, one after the other. Leading dimensions are a
    batch. Poses are 4 x 4 matrices in the frame of the base, whose z axis points along the straight robot; lengths
    are in metres, angles in radians.

    Parameters
    ----------
    segments
        From base to tip: :class:`ConstantCurvature`, :class:`AffineCurvature`, :class:`Link`, :class:`BallJoint`,
        :class:`FreeBody`, in any order.
    magnets
        Each a :class:`repro.Magnet` on a segment or on the base.
    sensors
        Each a :class:`Sensor` on a segment or on the base.
    imus
        Each an :class:`Imu` on a segment or on the base.
    lower, upper
        Bounds of ``q`` ``[n_q]`` [m, rad]. Equal bounds fix a coordinate. Azimuths and rotations need none: NaN or
        infinity gives them a whole turn.
    start
        Where estimators start ``[n_q]``; they choose for themselves if not given.
    noise
        Standard deviation of a reading [mT; rad for IMUs], one number or one for each. What a sensor states of its
        own noise comes first.
    rate_hz
        Readings per second.
    earth
        Field of the Earth in the base frame [mT]; none if not given.
    model
        Trained networks that predict the readings: see :class:`repro.Sensing`.
    moments
        Multipole moments ``[m, terms]`` [mT m^(l+2)] in place of the shapes of the magnets.
    source
        The file that it was read from.

    Raises
    ------
    InputError
        If there is no segment, something is mounted where there is none, or numbers do not fit the coordinates or
        the readings.

    Examples
    --------
    A chain of three kinds of segments:

    >>> from repro import AffineCurvature, ConstantCurvature, Link, Robot
    >>> robot = Robot([ConstantCurvature(0.11, 0.022), Link(0.02), AffineCurvature(0.2)])
    >>> robot.coordinates
    ('delta_x_1', 'delta_y_1', 'delta_L_1', 'kappa_0_3', 'kappa_1_3', 'phi_3', 'delta_L_3')
    >>> robot.tip(np.zeros(7))[:3, 3].round(3)
    array([0.  , 0.  , 0.33])
    """

    def __init__(
        self,
        segments: Sequence[Segment],
        magnets: Sequence[Any] = (),
        sensors: Sequence[Sensor] = (),
        imus: Sequence[Imu] = (),
        *,
        lower: Any = None,
        upper: Any = None,
        start: Any = None,
        noise: Any = None,
        rate_hz: float | None = None,
        earth: Any = None,
        model: Any = None,
        moments: Any = None,
        source: Any = None,
    ) -> None:
        self.segments, self.magnets = tuple(segments), tuple(magnets)
        self.sensors, self.imus = tuple(sensors), tuple(imus)
        require(self.segments, "segments", "Robot", "at least one segment", "none")
        for segment in self.segments:
            require(isinstance(segment, Segment), "segments", "Robot", _KINDS, type(segment).__name__)
        for name, parts in (("magnets", self.magnets), ("sensors", self.sensors), ("imus", self.imus)):
            for k, part in enumerate(parts):
                require(
                    isinstance(getattr(part, "place", None), Place),
                    name,
                    "Robot",
                    "parts with a place",
                    type(part).__name__,
                )
                self.check_place(part.place, f"{name}, number {k + 1},")
        self.coordinates = tuple(
            f"{name}_{i}" for i, x in enumerate(self.segments, 1) for name in x.coordinates
        )
        """Names of the coordinates, such as ``delta_x_1``, numbered by segment from 1."""
        self.n_q = len(self.coordinates)
        """Number of coordinates."""
        self.angles = np.array([x.startswith(("phi_", "rotation_")) for x in self.coordinates], dtype=bool)
        """Which coordinates are angles, ``[n_q]``."""
        self.length = sum(segment.length for segment in self.segments)
        """Unextended length of the robot [m]."""
        self.n_readings = sum(part.axes for part in (*self.sensors, *self.imus))
        """Number of readings, one for every axis of every sensor, then three for every IMU."""
        self.range = self.per_reading("range", math.inf, math.inf)
        """Largest reading of either sign ``[s]`` [mT], infinite where not stated."""
        self.resolution = self.per_reading("resolution", 0.0, 0.0)
        """Step between two readings ``[s]`` [mT], zero where not stated."""
        # A reading at the end may be rounded, to its resolution or to float32; and no sensor reads 1e100.
        self._n_magnetic = sum(sensor.axes for sensor in self.sensors)
        self._end = np.minimum((1 - 1e-6) * self.range - self.resolution / 2, 1e100)
        self.model, self.moments, self.source = model, moments, source
        self.lower, self.upper = self._bounds(lower, upper)
        """Bounds of the coordinates ``[n_q]``, or None where not stated."""
        self.fixed = np.zeros(self.n_q, dtype=bool) if self.lower is None else self.lower == self.upper
        """Which coordinates equal bounds fix ``[n_q]``."""
        self.start = None if start is None else numbers(start, "start", "Robot", (self.n_q,))
        if self.start is not None and self.lower is not None and self.upper is not None:
            free = self.free_angles.free
            inside = (self.start >= self.lower) & (self.start <= self.upper)
            require((free | inside).all(), "start", "Robot", "within the bounds", self.start.tolist())
        self.rate_hz = None if rate_hz is None else scalar(rate_hz, "rate_hz", "Robot", "positive")
        self.earth = None if earth is None else numbers(earth, "earth", "Robot", (3,))
        self._noise_given = noise
        self.noise = self._noise(noise)
        """Standard deviation of every reading ``[s]`` [mT; rad for IMUs], or None where not stated."""

    def _bounds(self, lower: Any, upper: Any) -> tuple[Array | None, Array | None]:
        if lower is None and upper is None and not (self.n_q and self.angles.all()):
            return None, None
        found = []
        for name, value, turn in (("lower", lower, -math.pi), ("upper", upper, math.pi)):
            given = np.full(self.n_q, np.nan) if value is None else value
            bound = numbers(given, name, "Robot", (self.n_q,), finite=False)
            bound = np.where(self.angles & ~np.isfinite(bound), turn, bound)
            for k in np.flatnonzero(~np.isfinite(bound)):
                raise bad_input(name, "Robot", f"finite for {self.coordinates[k]}", f"{bound[k]}")
            found.append(bound)
        for k in np.flatnonzero(~(found[0] <= found[1])):
            expected = f"ordered bounds for {self.coordinates[k]}"
            raise bad_input("lower, upper", "Robot", expected, (found[0][k], found[1][k]))
        return found[0], found[1]

    def _noise(self, noise: Any) -> Array | None:
        given = numbers(np.nan if noise is None else noise, "noise", "Robot", finite=False)
        n = self.n_readings
        require(
            given.shape in ((), (n,)), "noise", "Robot", f"one number or one for each of {n} readings", given
        )
        require(noise is None or (given > 0).all(), "noise", "Robot", "positive", noise)
        std = self.per_reading("noise", np.nan, np.nan)
        std = np.where(np.isnan(std), given, std)
        return None if np.isnan(std).any() else std

    @cached_property
    def rotations(self) -> tuple[tuple[int, ...], ...]:
        """Coordinates of every rotation: an azimuth, or the components of a rotation vector."""
        found: list[tuple[int, ...]] = []
        first = 0
        for segment in self.segments:
            of_segment = range(first, first + len(segment.coordinates))
            first = of_segment.stop
            found.append(tuple(c for c in of_segment if self.angles[c]))
        return tuple(one for one in found if one)

    @cached_property
    def free_angles(self) -> FreeAngles:
        """Which angles come round again within the bounds: they are wrapped, subtracted and averaged as such."""
        unbounded = np.full(self.n_q, np.inf)
        if self.lower is None or self.upper is None:
            return FreeAngles(self.rotations, -unbounded, unbounded)
        return FreeAngles(self.rotations, self.lower, self.upper)

    @property
    def total_noise(self) -> Array | None:
        """Standard deviation of every reading ``[s]``, with the error of rounding to its resolution."""
        return None if self.noise is None else np.sqrt(self.noise**2 + self.resolution**2 / 12)

    def per_reading(self, name: str, none: float, of_imus: float) -> Array:
        """Return what sensors and IMUs state under a name, for every reading ``[s]``; ``none`` where they do not."""
        found = [np.zeros(0)]
        for part in (*self.sensors, *self.imus):
            value = getattr(part, name, of_imus)
            found.append(np.full(part.axes, none if value is None else value, dtype=float))
        return np.concatenate(found)

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

    def sensing(self) -> Any:
        """Return the sensor model with the gain and offset of every sensor and the Earth's field."""
        from repro.sensing import Sensing

        n = sum(sensor.axes for sensor in self.sensors)
        gain, offset = (self.per_reading(*x)[:n] for x in (("gain", 1.0, 1.0), ("offset", 0.0, 0.0)))
        return Sensing(self, self.model, moments=self.moments, gain=gain, offset=offset, earth=self.earth)

    def missing(self, u: Any) -> Array:
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
        >>> chip = Robot([Link(0.1)], sensors=[Sensor(1, 0.05, axes=3, range=5.0)])
        >>> chip.missing([[0.0, 5.0, np.nan], [0.0, 0.0, 0.0]]).tolist()
        [[0, 2, 1], [3, 3, 3]]
        """
        u = numbers(u, "u", "missing", (..., self.n_readings), finite=False)
        size, n = np.abs(u), self._n_magnetic
        why = np.where(size >= self._end, 2, 0)
        why[~np.isfinite(size)] = 1
        zero = size[..., :n] == 0
        silent = (zero.sum(-1) > 2) & (zero | (why[..., :n] > 0)).all(-1)
        why[..., :n][silent] = 3
        return why

    def readings(self, table: Any) -> Any:
        """Return the readings of a table ``[t, s]``: flux densities in mT, rotation vectors of IMUs in rad.

        Columns are found by the names of channels, or by their numbers (``u1_mT``, ``ch2``, ``channel_3``), and their
        units are taken from their names; without a unit they are in mT. What a board has printed is read too, with
        commas, tabs, blanks or labels: without names its columns are those of the readings, in their order. An IMU
        has the four columns of its quaternion (``qx_1`` to ``qw_1``), or rows with the number of its ``stream``.

        A cell without a number, what :meth:`missing` names and a quaternion of zeros are NaN, a missing reading. The
        result has the ``times`` of the rows [s], or None, the ``lines`` where they stand, and ``remarks``: sentences
        that say what is missing, left out or put together. Copies and parts of it keep them.

        Parameters
        ----------
        table
            A data frame, or the path of a text file.

        Raises
        ------
        InputError
            If a column is missing, there twice, or of another unit; if a cell is no number, times do not increase or
            quaternions are no orientations; with the file and the line.
        """
        from repro.tables import read_readings

        return read_readings(self, table)

    def check(self, *, samples: int = 400, seed: int = 0) -> Any:
        """Ask whether the design can work, before any reading is taken: see :class:`repro.check.DesignCheck`.

        In random shapes within the bounds it finds how well readings determine the tip, by noise alone and with the
        tolerances of the parts; sensors that contribute nothing or go beyond their range; what stays undetermined.
        ``print`` shows it in a few lines, the last of them a verdict.

        Parameters
        ----------
        samples
            Number of random shapes.
        seed
            Seed of their generator.

        Raises
        ------
        InputError
            If the robot states no bounds or no noise, or has no sensors.
        """
        from repro.check import check_design

        return check_design(self, samples=samples, seed=seed)

    def plot(self, q: Any = None, *, axes: Any = None, labels: Sequence[str] | None = None) -> Any:
        """Draw the robot in one shape or several on each other, and return the axes: :func:`repro.plots.plot_robot`.

        Parameters
        ----------
        q
            Configurations ``[n_q]`` or ``[k, n_q]``; its start, the middle of its bounds, or straight, if not given.
        axes
            matplotlib axes in three dimensions to draw on; new ones if not given.
        labels
            One name for each shape.
        """
        from repro.plots import plot_robot

        return plot_robot(self, q, axes=axes, labels=labels)

    def part(self, name: Any, owner: str) -> int:
        """Return which of ``part_names`` a sensor or IMU is, from 0, by its name or by its number from 1."""
        names, word = list(self.part_names), str(name)
        k = names.index(word) if word in names else int(word) - 1 if word.isdecimal() else -1
        listed = ", ".join(f"{x} ({n})" for n, x in enumerate(names, 1))
        require(0 <= k < len(names), "sensor", owner, f"one of {listed}", repr(name))
        return k

    def replaced(self, **changes: Any) -> Robot:
        """Return this robot with other parts or numbers, by the names of the arguments of :class:`Robot`.

        Examples
        --------
        >>> from repro import Link, Robot
        >>> Robot([Link(0.1)], rate_hz=25.0).replaced(segments=[Link(0.2)]).rate_hz
        25.0
        """
        names = (
            "segments", "magnets", "sensors", "imus", "lower", "upper", "start", "rate_hz", "earth", "model",
            "moments", "source",
        )  # fmt: skip
        own = {name: getattr(self, name) for name in names}
        if changes.keys() & {"segments", "magnets", "sensors", "earth", "model", "moments"}:
            own["source"] = None  # the file describes another robot
        return Robot(**{**own, "noise": self._noise_given, **changes})

    def check_place(self, where: Place, name: str) -> None:
        """Refuse a place on a segment that does not exist, or beyond its end."""
        expected = f"on a segment from 0 (base) to {len(self.segments)}"
        require(where.segment <= len(self.segments), name, "Robot", expected, where.segment)
        reach = self.segments[where.segment - 1].length if where.segment else 0.0
        expected = f"between 0 and {1e3 * reach:g} mm along segment {where.segment}"
        require(-1e-12 <= where.at <= reach * (1 + 1e-12), name, "Robot", expected, f"{1e3 * where.at:g} mm")

    def __repr__(self) -> str:
        """Say what it is made of."""
        kinds = ", ".join(type(segment).__name__ for segment in self.segments)
        parts = f"{len(self.magnets)} magnets, {len(self.sensors)} sensors, {len(self.imus)} IMUs"
        return f"Robot of {kinds}; {parts}; {self.n_q} coordinates"

    def check_q(self, q: Any, owner: str = "Robot") -> Array:
        """Return configurations ``[..., n_q]`` as float64; refuse another width, NaN and infinity."""
        found = numbers(q, "q", owner)
        names = f"of last dimension {self.n_q} ({', '.join(self.coordinates)})"
        require(found.shape[-1:] == (self.n_q,), "q", owner, names, f"shape {found.shape}")
        return found

    def chain(self, places: Sequence[Place]) -> tuple[Chain, Array]:
        """Return the frames of places as arrays for the kernels, and the frame of every place."""
        wanted = {(p.segment - 1, self._share(p)) for p in places if p.segment}
        wanted |= {(g, 1.0) for g in range(len(self.segments))}
        frames = [(-1, 0.0), *sorted(wanted)]
        number = {frame: k for k, frame in enumerate(frames)}
        counts = [len(segment.coordinates) for segment in self.segments]
        chain = Chain(
            kind=np.array([segment.kind for segment in self.segments]),
            size=np.array([segment.sizes for segment in self.segments]),
            first=np.cumsum([0, *counts]),
            segment=np.array([g for g, _ in frames]),
            v=np.array([v for _, v in frames]),
            tip=np.array([number[g, 1.0] for g in range(len(self.segments))]),
        )
        where = [number[p.segment - 1, self._share(p)] if p.segment else 0 for p in places]
        return chain, np.array(where, dtype=np.int64)

    def _share(self, where: Place) -> float:
        """Fraction of the segment; a joint, a body or a link of length zero has its tip only."""
        reach = self.segments[where.segment - 1].length
        return where.at / reach if reach else 1.0

    def poses(self, q: Any, places: Sequence[Place]) -> Array:
        """Return poses ``T_base_place`` ``[..., n, 4, 4]`` of places; positions in m.

        ``robot.poses(q, [magnet.place for magnet in robot.magnets])`` are those of the magnets.
        """
        return self.motion(q, places)[0]

    def motion(self, q: Any, places: Sequence[Place]) -> tuple[Array, Array]:
        r"""Return poses of places and the twist of each by every coordinate.

        Parameters
        ----------
        q
            Configurations ``[..., n_q]``.
        places
            Where: the ``place`` of magnets, sensors and IMUs, or places from :func:`point_on`.

        Returns
        -------
        tuple
            Poses ``[..., n, 4, 4]``, and twists ``[..., n, n_q, 6]``: the angular velocity :math:`\omega` [rad per
            unit of the coordinate], then :math:`\nu` [m per unit], referred to the origin of the base frame. A point
            at :math:`p` moves by :math:`\nu + \omega \times p`.
        """
        q = self.check_q(q)
        for where in places:
            self.check_place(where, "places")
        chain, frame = self.chain(places)
        flat = rows_of(q)
        R, p, X = (np.empty((len(flat), len(chain.v), *own)) for own in ((3, 3), (3,), (self.n_q, 6)))
        _all_frames(chain, flat, R, p, X)
        T = np.zeros((len(flat), len(places), 4, 4))
        T[..., 3, 3] = 1.0
        for k, where in enumerate(places):
            T[:, k, :3, :3] = R[:, frame[k]] @ where.rotation
            T[:, k, :3, 3] = p[:, frame[k]] + R[:, frame[k]] @ where.position
        batch = q.shape[:-1]
        return T.reshape(*batch, *T.shape[1:]), X[:, frame].reshape(*batch, len(places), self.n_q, 6)

    def tip(self, q: Any) -> Array:
        """Return the pose of the tip ``[..., 4, 4]`` in the base frame; positions in m."""
        return self.poses(q, [point_on(len(self.segments), self.segments[-1].length)])[..., 0, :, :]

    def tip_slopes(self, q: Any) -> tuple[Array, Array]:
        """Return positions of the tip ``[..., 3]`` [m] and their slopes by the coordinates ``[..., 3, n_q]``."""
        T, X = self.motion(q, [point_on(len(self.segments), self.segments[-1].length)])
        p = T[..., 0, :3, 3]
        slopes = X[..., 0, :, 3:] + np.cross(X[..., 0, :, :3], p[..., None, :])
        return p, np.swapaxes(slopes, -1, -2)

    def backbone(self, q: Any, points: int = 33) -> Array:
        """Return points on the backbone ``[..., k, 3]`` [m], so many per segment, from its base to its tip."""
        places = [
            point_on(g, share * segment.length)
            for g, segment in enumerate(self.segments, 1)
            for share in np.linspace(0, 1, points)
        ]
        return self.poses(q, places)[..., :3, 3]


def point_on(segment: int, at: float) -> Place:
    """Return the place on the backbone at a distance [m] from the base of a segment (from 1).

    Examples
    --------
    >>> point_on(1, 0.05).at
    0.05
    """
    return place("point_on", segment, at)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_SINC = np.array([(-1.0) ** k / math.factorial(2 * k + 1) for k in range(9)])
_COSC = np.array([(-1.0) ** k / math.factorial(2 * k + 2) for k in range(9)])
_TANC = np.array([(-1.0) ** k / math.factorial(2 * k + 3) for k in range(9)])


@kernel
def arc_functions(z):
    """Return sin(t)/t, (1 - cos t)/t^2, (t - sin t)/t^3 and the slope of the second by z = t^2."""
    if z < 0.25:
        s = c = d = c_z = 0.0
        for k in range(8, -1, -1):
            s, c, d = s * z + _SINC[k], c * z + _COSC[k], d * z + _TANC[k]
            if k:
                c_z = c_z * z + k * _COSC[k]
        return s, c, d, c_z
    t = math.sqrt(z)
    s, half = math.sin(t) / t, math.sin(0.5 * t) / t
    c = 2.0 * half * half
    return s, c, (1.0 - s) / z, (s - 2.0 * c) / (2.0 * z)


@kernel(entry=True)
def turn(x, y, z, T, J):
    """Write the rotation of a rotation vector and the left Jacobian of SO(3) there, whose columns are its twists."""
    s, c, d, _ = arc_functions(x * x + y * y + z * z)
    w = (x, y, z)
    for i in range(3):
        for j in range(3):
            both = w[i] * w[j]
            T[i, j], J[i, j] = c * both, d * both
    square = x * x + y * y + z * z
    for i in range(3):
        T[i, i] += 1.0 - c * square
        J[i, i] += 1.0 - d * square
        j, k = (i + 1) % 3, (i + 2) % 3
        T[k, j] += s * w[i]
        T[j, k] -= s * w[i]
        J[k, j] += c * w[i]
        J[j, k] -= c * w[i]


@kernel
def _constant_curvature(q, first, extensible, length, radius, v, T, W):
    """Eq. (15), with the misprint in the position corrected."""
    a, b = q[first] / radius, q[first + 1] / radius
    L = length + (q[first + 2] if extensible else 0.0)
    z = v * v * (a * a + b * b)
    s0, c0, d0, c_z = arc_functions(z)
    s, c = v * s0, v * v * c0
    T[0, 0], T[0, 1], T[0, 2], T[0, 3] = 1.0 - c * a * a, -c * a * b, s * a, L * c * a
    T[1, 0], T[1, 1], T[1, 2], T[1, 3] = -c * a * b, 1.0 - c * b * b, s * b, L * c * b
    T[2, 0], T[2, 1], T[2, 2], T[2, 3] = -s * a, -s * b, 1.0 - c * (a * a + b * b), L * s
    # The rotation vector is w = v (-b, a, 0), and its twists are columns of the left Jacobian.
    wx, wy, k = -v * b, v * a, v / radius
    W[0, 0], W[0, 1], W[0, 2] = k * d0 * wx * wy, k * (1.0 + d0 * (wy * wy - z)), k * c0 * wx
    W[1, 0], W[1, 1], W[1, 2] = -k * (1.0 + d0 * (wx * wx - z)), -k * d0 * wx * wy, k * c0 * wy
    s_z, power = v * v * v * (d0 - c0), 2.0 * v * v * v * v * c_z
    s_a, s_b, c_a, c_b, f = s_z * a, s_z * b, power * a, power * b, L / radius
    W[0, 3], W[0, 4], W[0, 5] = f * (c + a * c_a), f * b * c_a, f * s_a
    W[1, 3], W[1, 4], W[1, 5] = f * a * c_b, f * (c + b * c_b), f * s_b
    if extensible:
        W[2, 0] = W[2, 1] = W[2, 2] = 0.0
        W[2, 3], W[2, 4], W[2, 5] = c * a, c * b, s


@kernel
def _affine_curvature(q, first, length, v, T, W):
    """Eqs (17) and (18)."""
    k0, k1, phi, L = q[first], q[first + 1], q[first + 2], length + q[first + 3]
    across = ahead = across_0 = across_1 = ahead_0 = ahead_1 = 0.0
    for i in range(len(_NODES)):
        s, w = 0.5 * v * (_NODES[i] + 1.0), 0.5 * v * _WEIGHTS[i]
        angle = k0 * s + 0.5 * k1 * s * s
        sine, cosine = w * math.sin(angle), w * math.cos(angle)
        across, ahead = across + sine, ahead + cosine
        across_0, across_1 = across_0 + cosine * s, across_1 + 0.5 * cosine * s * s
        ahead_0, ahead_1 = ahead_0 - sine * s, ahead_1 - 0.5 * sine * s * s
    theta, c, s = k0 * v + 0.5 * k1 * v * v, math.cos(phi), math.sin(phi)
    ct, st = math.cos(theta), math.sin(theta)
    # R = R_z(phi) R_x(theta) R_z(-phi), a turn about (cos phi, sin phi, 0).
    T[0, 0], T[0, 1], T[0, 2], T[0, 3] = c * c + s * s * ct, c * s * (1.0 - ct), s * st, L * across * s
    T[1, 0], T[1, 1], T[1, 2], T[1, 3] = c * s * (1.0 - ct), s * s + c * c * ct, -c * st, -L * across * c
    T[2, 0], T[2, 1], T[2, 2], T[2, 3] = -s * st, c * st, ct, L * ahead
    turns = (v, 0.5 * v * v)
    for i in range(2):
        W[i, 0], W[i, 1], W[i, 2] = turns[i] * c, turns[i] * s, 0.0
    W[0, 3], W[0, 4], W[0, 5] = L * across_0 * s, -L * across_0 * c, L * ahead_0
    W[1, 3], W[1, 4], W[1, 5] = L * across_1 * s, -L * across_1 * c, L * ahead_1
    W[2, 0], W[2, 1], W[2, 2] = -T[0, 2], -T[1, 2], 1.0 - T[2, 2]
    W[2, 3], W[2, 4], W[2, 5] = L * across * c, L * across * s, 0.0
    W[3, 0] = W[3, 1] = W[3, 2] = 0.0
    W[3, 3], W[3, 4], W[3, 5] = across * s, -across * c, ahead


@kernel
def _in_segment(chain, g, q, v, T, W, J):
    """Write the frame at ``v`` of a segment in the frame of its base, and its twists (turn, motion of the origin)."""
    kind, first = chain.kind[g], chain.first[g]
    n = chain.first[g + 1] - first
    if kind == _CONSTANT:
        _constant_curvature(q, first, n == 3, chain.size[g, 0], chain.size[g, 1], v, T, W)
        return
    if kind == _AFFINE:
        _affine_curvature(q, first, chain.size[g, 0], v, T, W)
        return
    T[:, :], W[:, :] = 0.0, 0.0
    if kind == _LINK:
        T[0, 0] = T[1, 1] = T[2, 2] = 1.0
        T[2, 3] = v * chain.size[g, 0]
    else:
        axes, c = int(chain.size[g, 0]), 0
        if kind == _FREE:
            for c in range(3):
                T[c, 3], W[c, 3 + c] = q[first + c], 1.0
            c = 3
        second, third = c + (axes & 1), c + (axes & 1) + (axes >> 1 & 1)
        x = q[first + c] if axes & 1 else 0.0
        y = q[first + second] if axes & 2 else 0.0
        z = q[first + third] if axes & 4 else 0.0
        turn(x, y, z, T, J)
        for i in range(3):
            if axes >> i & 1:
                for k in range(3):
                    W[c, k] = J[k, i]
                c += 1


@kernel
def frames(chain, q, slopes, R, p, X, T, W, J):
    """Write rotation, position and own twists of every frame, in the base frame; ``T``, ``W`` and ``J`` are room.

    ``X[f, c]`` is the twist of frame ``f`` by coordinate ``c`` of its own segment, referred to the origin.
    """
    for f in range(len(chain.v)):
        g = chain.segment[f]
        if g < 0:
            for i in range(3):
                p[f, i] = 0.0
                for j in range(3):
                    R[f, i, j] = 1.0 if i == j else 0.0
            continue
        _in_segment(chain, g, q, chain.v[f], T, W, J)
        b = chain.tip[g - 1] if g > 0 else 0
        for i in range(3):
            p[f, i] = p[b, i] + R[b, i, 0] * T[0, 3] + R[b, i, 1] * T[1, 3] + R[b, i, 2] * T[2, 3]
            for j in range(3):
                R[f, i, j] = R[b, i, 0] * T[0, j] + R[b, i, 1] * T[1, j] + R[b, i, 2] * T[2, j]
        if slopes:
            x, y, z = p[f, 0], p[f, 1], p[f, 2]
            for c in range(chain.first[g + 1] - chain.first[g]):
                for i in range(3):
                    X[f, c, i] = R[b, i, 0] * W[c, 0] + R[b, i, 1] * W[c, 1] + R[b, i, 2] * W[c, 2]
                    X[f, c, 3 + i] = R[b, i, 0] * W[c, 3] + R[b, i, 1] * W[c, 4] + R[b, i, 2] * W[c, 5]
                X[f, c, 3] -= X[f, c, 1] * z - X[f, c, 2] * y
                X[f, c, 4] -= X[f, c, 2] * x - X[f, c, 0] * z
                X[f, c, 5] -= X[f, c, 0] * y - X[f, c, 1] * x


@kernel(entry=True, allocates=True)
def _all_frames(chain, q, R, p, X):
    """Frames of a batch, and their twists by all coordinates."""
    T, W, J, own = np.zeros((3, 4)), np.zeros((6, 6)), np.zeros((3, 3)), np.zeros((len(chain.v), 6, 6))
    for n in range(len(q)):
        frames(chain, q[n], True, R[n], p[n], own, T, W, J)
        for f in range(len(chain.v)):
            X[n, f] = 0.0
            for g in range(chain.segment[f] + 1):
                at = f if g == chain.segment[f] else chain.tip[g]
                for c in range(chain.first[g], chain.first[g + 1]):
                    for i in range(6):
                        X[n, f, c, i] = own[at, c - chain.first[g], i]
