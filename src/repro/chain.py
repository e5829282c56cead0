r"""A chain: segments in series, the frames along them, and how these move.

Every segment gives the pose of its backbone frame at :math:`v \in [0, 1]` and one *twist* per coordinate: how the
frame turns and moves when that coordinate changes. We refer all twists :math:`(\omega, \nu)` to the origin of the
base frame, where a point at :math:`p` moves by :math:`\nu + \omega \times p` and a direction :math:`o` by
:math:`\omega \times o`. In this form everything mounted on one frame shares its twists, and what lies beyond a
segment moves with the twist of its tip.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from repro.angles import FreeAngles
from repro.common import Array, ArrayLike, Dimensions, bad_input, kernel, numbers, require, rows_of, scalar

_CONSTANT, _AFFINE, _LINK, _JOINT, _FREE = range(5)
_KINDS = "of ConstantCurvature, AffineCurvature, Link, BallJoint, FreeBody"


_TOLERANCES = {
    "link": ("offset", "tilt"),
    "magnet": ("position", "at", "tilt", "polarisation", "size"),
    "sensor": ("position", "at", "radius", "azimuth", "tilt", "gain", "offset"),
    "imu": ("at", "tilt", "heading"),
}
"""What a part may be off its drawing by: lengths [m], angles [rad], offset [mT]; polarisation, gain are relative."""


def check_tolerance(tolerance: Mapping[str, float] | None, owner: str) -> None:
    """Refuse tolerances of a part that it does not have, or that are no standard deviations."""
    known = _TOLERANCES[owner.lower()]
    for name, value in (tolerance or {}).items():
        require(name in known, "tolerance", owner, f"of {', '.join(known)}", repr(name))
        std = numbers(value, f"tolerance {name}", owner, ())
        require(std >= 0, f"tolerance {name}", owner, "not negative", value)


class Segment:
    """What all segments have; the kernels know the five kinds below."""

    kind: ClassVar[int]
    length: float

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return ()

    @property
    def sizes(self) -> tuple[float, ...]:
        """Up to six numbers for the kernels: length [m], or which axes turn as the bits of a number; radius [m]."""
        return (self.length,)


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

    @property
    def sizes(self) -> tuple[float, ...]:
        """Length and radius [m]."""
        return self.length, self.radius


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
    """A rigid piece along z, without a coordinate; or one that leads aside, or turns what follows.

    Parameters
    ----------
    length
        Its length along z [m]; zero is a place to mount things on.
    offset
        Where it ends beside that, in the frame of its start [m]: at ``(0, 0, length) + offset``.
    orientation
        Quaternion XYZW from its own frame, and that of what follows, to the frame of its start. As the first
        segment it turns the robot on its base; before a hinge it turns its axis.
    tolerance
        Standard deviations by which it may be off its drawing, for :func:`repro.calibrate`: a mapping with some of
        ``offset`` along each axis [m], ``tilt`` about each of its axes [rad].

    Raises
    ------
    InputError
        If the length is negative, or the numbers describe no place or no orientation.

    Examples
    --------
    >>> from repro import Link, Robot
    >>> Robot([Link(0.1), Link(0.05)]).tip([])[:3, 3]
    array([0.  , 0.  , 0.15])

    A robot that lies along x, and a link whose end is 20 mm aside:

    >>> turned = Link(0.0, orientation=[0, np.sqrt(0.5), 0, np.sqrt(0.5)])
    >>> Robot([turned, Link(0.1, offset=[0, 0.02, 0])]).tip([])[:3, 3].round(3) + 0.0
    array([0.1 , 0.02, 0.  ])
    """

    length: float
    offset: ArrayLike | None = None
    orientation: ArrayLike | None = None
    tolerance: Mapping[str, float] | None = None
    kind: ClassVar[int] = _LINK

    def __post_init__(self) -> None:
        fits = 0 <= scalar(self.length, "length", "Link") < math.inf
        require(fits, "length", "Link", "not negative [m]", self.length)
        check_tolerance(self.tolerance, "Link")
        _ = self.end

    @cached_property
    def end(self) -> Place:
        """Its offset, and how it is turned there."""
        return place("Link", 0, 0.0, self.offset, self.orientation)

    @property
    def sizes(self) -> tuple[float, ...]:
        """Vector from its start to its end [m], and the rotation vector of its turn."""
        x, y, z = self.end.position.tolist()
        return x, y, z + self.length, *Rotation.from_matrix(self.end.rotation).as_rotvec().tolist()


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

    @property
    def sizes(self) -> tuple[float, ...]:
        """Which axes turn, as the bits of a number."""
        return (float(sum(1 << "xyz".index(axis) for axis in self.axes)),)


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
    length = 0.0

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return ("x", "y", "z", "rotation_x", "rotation_y", "rotation_z")

    @property
    def sizes(self) -> tuple[float, ...]:
        """Which axes turn, as the bits of a number (all three)."""
        return (7.0,)


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
    position: ArrayLike | None = None,
    rotation: ArrayLike | None = None,
    direction: ArrayLike | None = None,
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
        R = Rotation.from_quat(unit_quaternions(rotation, "orientation", owner, (4,))).as_matrix()
    return Place(int(segment), float(numbers(at, "at", owner, ())), r, R)


def _turn_of_z_to(z: Array) -> Array:
    x = np.cross([0.0, 1.0, 0.0], z)
    if np.linalg.norm(x) < 1e-6:
        x = np.array([1.0, 0.0, 0.0])
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def unit_quaternions(q: ArrayLike, name: str, owner: str, shape: Dimensions) -> Array:
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


class Frames(NamedTuple):
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


def kinds_of(chain: Frames) -> Array | None:
    """Return the kinds of the segments; None where all are of constant curvature, and the others are not compiled."""
    return None if (chain.kind == _CONSTANT).all() else chain.kind


class Chain:
    """Segments from base to tip, with bounds of their coordinates: a robot without anything on it.

    Parameters
    ----------
    segments
        From base to tip.
    lower, upper
        Bounds of ``q`` ``[n_q]`` [m, rad]. Equal bounds fix a coordinate. Azimuths and rotations need none: NaN or
        infinity gives them a whole turn.
    start
        Where estimators start ``[n_q]``.

    Raises
    ------
    InputError
        If there is no segment, or numbers do not fit the coordinates.

    Examples
    --------
    >>> Chain([Link(0.1), Link(0.05)]).tip([])[:3, 3]
    array([0.  , 0.  , 0.15])
    """

    def __init__(
        self,
        segments: Sequence[Segment],
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        start: ArrayLike | None = None,
    ) -> None:
        require(isinstance(segments, Iterable), "segments", "Robot", _KINDS, type(segments).__name__)
        self.segments = tuple(segments)
        require(self.segments, "segments", "Robot", "at least one segment", "none")
        for segment in self.segments:
            require(isinstance(segment, Segment), "segments", "Robot", _KINDS, type(segment).__name__)
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
        self.lower, self.upper = self._bounds(lower, upper)
        """Bounds of the coordinates ``[n_q]``, or None where not stated."""
        self.fixed = np.zeros(self.n_q, dtype=bool) if self.lower is None else self.lower == self.upper
        """Which coordinates equal bounds fix ``[n_q]``."""
        self.start = None if start is None else numbers(start, "start", "Robot", (self.n_q,))
        if self.start is not None and self.lower is not None and self.upper is not None:
            free = self.free_angles.free
            inside = (self.start >= self.lower) & (self.start <= self.upper)
            require((free | inside).all(), "start", "Robot", "within the bounds", self.start.tolist())

    def _bounds(self, lower: ArrayLike | None, upper: ArrayLike | None) -> tuple[Array | None, Array | None]:
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

    @cached_property
    def rotations(self) -> tuple[tuple[int, ...], ...]:
        """Coordinates of every rotation: an azimuth, or the components of a rotation vector."""
        segment = np.repeat(range(len(self.segments)), [len(x.coordinates) for x in self.segments])
        found = [np.flatnonzero(self.angles & (segment == g)) for g in range(len(self.segments))]
        return tuple(tuple(one.tolist()) for one in found if len(one))

    @cached_property
    def free_angles(self) -> FreeAngles:
        """Which angles come round again within the bounds: they are wrapped, subtracted and averaged as such."""
        unbounded = np.full(self.n_q, np.inf)
        if self.lower is None or self.upper is None:
            return FreeAngles(self.rotations, -unbounded, unbounded)
        return FreeAngles(self.rotations, self.lower, self.upper)

    def check_place(self, where: Place, name: str) -> None:
        """Refuse what is no place, or one on a segment that does not exist, or beyond its end."""
        if not isinstance(where, Place):  # to print one takes longer than all its poses
            expected = "a place: that of a part, or one from point_on(segment, at)"
            raise bad_input(name, "Robot", expected, repr(where))
        expected = f"on a segment from 0 (base) to {len(self.segments)}"
        require(where.segment <= len(self.segments), name, "Robot", expected, where.segment)
        reach = self.segments[where.segment - 1].length if where.segment else 0.0
        expected = f"between 0 and {1e3 * reach:g} mm along segment {where.segment}"
        require(-1e-12 <= where.at <= reach * (1 + 1e-12), name, "Robot", expected, f"{1e3 * where.at:g} mm")

    @property
    def units(self) -> list[tuple[str, str, float]]:
        """Name, unit in tables and pictures, and factor to it of every coordinate."""
        degrees = ("deg", math.degrees(1.0))
        known = {"kappa": ("rad", 1.0), "phi": degrees, "rotation": degrees}
        return [(name, *known.get(name.split("_")[0], ("mm", 1e3))) for name in self.coordinates]

    def check_q(self, q: ArrayLike, owner: str = "Robot") -> Array:
        """Return configurations ``[..., n_q]`` as float64; refuse another width, NaN and infinity."""
        found = numbers(q, "q", owner)
        names = f"of last dimension {self.n_q} ({', '.join(self.coordinates)})"
        require(found.shape[-1:] == (self.n_q,), "q", owner, names, f"shape {found.shape}")
        return found

    def frames(self, places: Sequence[Place]) -> tuple[Frames, Array]:
        """Return the frames of places as arrays for the kernels, and the frame of every place."""
        wanted = {(p.segment - 1, self._share(p)) for p in places if p.segment}
        wanted |= {(g, 1.0) for g in range(len(self.segments))}
        each = [(-1, 0.0), *sorted(wanted)]
        number = {frame: k for k, frame in enumerate(each)}
        counts = [len(segment.coordinates) for segment in self.segments]
        found = Frames(
            kind=np.array([segment.kind for segment in self.segments]),
            size=np.array([np.pad(s.sizes, (0, 6 - len(s.sizes))) for s in self.segments]),
            first=np.cumsum([0, *counts]),
            segment=np.array([g for g, _ in each]),
            v=np.array([v for _, v in each]),
            tip=np.array([number[g, 1.0] for g in range(len(self.segments))]),
        )
        where = [number[p.segment - 1, self._share(p)] if p.segment else 0 for p in places]
        return found, np.array(where, dtype=np.int64)

    def _share(self, where: Place) -> float:
        """Fraction of the segment; a joint, a body or a link of length zero has its tip only."""
        reach = self.segments[where.segment - 1].length
        return where.at / reach if reach else 1.0

    def poses(self, q: ArrayLike, places: Sequence[Place]) -> Array:
        """Return poses ``T_base_place`` ``[..., n, 4, 4]`` of places; positions in m.

        ``robot.poses(q, [magnet.place for magnet in robot.magnets])`` are those of the magnets.
        """
        return self.motion(q, places)[0]

    def motion(self, q: ArrayLike, places: Sequence[Place]) -> tuple[Array, Array]:
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
        if not isinstance(places, Iterable):
            raise bad_input("places", "Robot", "a list of places", repr(places))
        for where in places:
            self.check_place(where, "places")
        chain, frame = self.frames(places)
        flat = rows_of(q)
        R, p, X = (np.empty((len(flat), len(chain.v), *own)) for own in ((3, 3), (3,), (self.n_q, 6)))
        _all_frames(chain, kinds_of(chain), flat, R, p, X)
        T = np.zeros((len(flat), len(places), 4, 4))
        T[..., 3, 3] = 1.0
        for k, where in enumerate(places):
            T[:, k, :3, :3] = R[:, frame[k]] @ where.rotation
            T[:, k, :3, 3] = p[:, frame[k]] + R[:, frame[k]] @ where.position
        batch = q.shape[:-1]
        return T.reshape(*batch, *T.shape[1:]), X[:, frame].reshape(*batch, len(places), self.n_q, 6)

    def tip(self, q: ArrayLike) -> Array:
        """Return the pose of the tip ``[..., 4, 4]`` in the base frame; positions in m."""
        return self.poses(q, [point_on(len(self.segments), self.segments[-1].length)])[..., 0, :, :]

    def tip_slopes(self, q: ArrayLike) -> tuple[Array, Array]:
        """Return positions of the tip ``[..., 3]`` [m] and their slopes by the coordinates ``[..., 3, n_q]``."""
        T, X = self.motion(q, [point_on(len(self.segments), self.segments[-1].length)])
        p = T[..., 0, :3, 3]
        slopes = X[..., 0, :, 3:] + np.cross(X[..., 0, :, :3], p[..., None, :])
        return p, np.swapaxes(slopes, -1, -2)

    def backbone(self, q: ArrayLike, points: int = 33) -> Array:
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
def _in_segment(kinds, chain, g, q, v, T, W, J):
    """Write the frame at ``v`` of a segment in the frame of its base, and its twists (turn, motion of the origin)."""
    first = chain.first[g]
    if kinds is not None:  # known when it is compiled
        if kinds[g] == _AFFINE:
            _affine_curvature(q, first, chain.size[g, 0], v, T, W)
            return
        if kinds[g] != _CONSTANT:
            _rigid(kinds[g], chain.size[g], q, first, v, T, W, J)
            return
    extensible = chain.first[g + 1] - first == 3
    _constant_curvature(q, first, extensible, chain.size[g, 0], chain.size[g, 1], v, T, W)


@kernel
def _rigid(kind, size, q, first, v, T, W, J):
    """Write the same of a link, a joint or a free body."""
    T[:, :], W[:, :] = 0.0, 0.0
    if kind == _LINK:
        turn(size[3], size[4], size[5], T, J)
        for i in range(3):
            T[i, 3] = v * size[i]
    else:
        axes, c = int(size[0]), 0
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
def frames(kinds, chain, q, slopes, R, p, X, T, W, J):
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
        _in_segment(kinds, chain, g, q, chain.v[f], T, W, J)
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
def _all_frames(chain, kinds, q, R, p, X):
    """Frames of a batch, and their twists by all coordinates."""
    T, W, J, own = np.zeros((3, 4)), np.zeros((6, 6)), np.zeros((3, 3)), np.zeros((len(chain.v), 6, 6))
    for n in range(len(q)):
        frames(kinds, chain, q[n], len(q) > 0, R[n], p[n], own, T, W, J)
        for f in range(len(chain.v)):
            X[n, f] = 0.0
            for g in range(chain.segment[f] + 1):
                at = f if g == chain.segment[f] else chain.tip[g]
                for c in range(chain.first[g], chain.first[g + 1]):
                    for i in range(6):
                        X[n, f, c, i] = own[at, c - chain.first[g], i]
