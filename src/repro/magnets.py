r"""Permanent magnets: their fields by magpylib, the multipoles of their fields, and simulated readings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.polynomial import Legendre
from numpy.polynomial.legendre import leggauss
from scipy.spatial.transform import Rotation

from repro.chain import Place, check_tolerance, place
from repro.common import Array, ArrayLike, numbers, require, scalar
from repro.parts import Assembly, check_free

_nodes = cache(leggauss)  # a calibration asks for them thousands of times


@dataclass(frozen=True)
class Ring:
    """A ring magnet, magnetised along its axis, the z axis of its frame.

    Parameters
    ----------
    outer_diameter, inner_diameter, height
        Dimensions [m].
    polarisation_mt
        Magnetic polarisation [mT].

    Raises
    ------
    InputError
        If the dimensions do not describe a ring, or the polarisation is not finite.

    Examples
    --------
    On the axis, 50 mm from the centre [mT]:

    >>> Ring(24e-3, 12e-3, 6e-3, 1450.0).field([0.0, 0.0, 0.05]).round(3)
    array([0.   , 0.   , 3.402])
    """

    outer_diameter: float
    inner_diameter: float
    height: float
    polarisation_mt: float

    def __post_init__(self) -> None:
        for name in ("outer_diameter", "inner_diameter", "height"):
            _ = scalar(getattr(self, name), name, "Ring")
        ordered = 0 <= self.inner_diameter < self.outer_diameter < math.inf and 0 < self.height < math.inf
        require(ordered, "dimensions", "Ring", "0 <= inner < outer and a positive height [m]", self)
        _check_polarisation(self.polarisation_mt, "Ring")

    @property
    def reach(self) -> float:
        """Radius of the sphere around the ring, beyond which its multipoles describe the field [m]."""
        return math.hypot(self.outer_diameter, self.height) / 2

    def field(self, positions: ArrayLike) -> Array:
        """Return the flux density [mT] at positions ``[..., 3]`` [m], both in the frame of the magnet, by magpylib.

        The ring is a full cylinder less its bore; magpylib solves both in closed form.
        """
        total = _field("cylinder_field", (self.outer_diameter, self.height), self.polarisation_mt, positions)
        if self.inner_diameter > 0:
            bore = (self.inner_diameter, self.height)
            total = total - _field("cylinder_field", bore, self.polarisation_mt, positions)
        return total

    def multipoles(self, l_max: int = 9) -> Array:
        r"""Return the axial multipole moments :math:`A_1, A_3, \dots, A_{l_{max}}` [mT m^(l+2)].

        Outside the sphere around the magnet the scalar potential is :math:`\sum_l A_l P_l(\cos\theta)/r^{l+1}`. The
        faces carry the magnetic charge :math:`\pm J`, so
        :math:`A_l = J \int_a^b \varrho\, r^l P_l(h/2r)\, d\varrho` with :math:`r^2 = \varrho^2 + h^2/4`; even
        moments vanish. The integrand is a polynomial, which Gauss-Legendre quadrature integrates exactly.

        Raises
        ------
        InputError
            If ``l_max`` is not a positive odd number.

        Examples
        --------
        In mT mm^(l+2):

        >>> (Ring(12e-3, 6e-3, 6e-3, 1450.0).multipoles(5) * [1e9, 1e15, 1e21]).round()
        array([   58725., -1453444.,  7729678.])
        """
        orders = _orders(l_max)
        nodes, weights = _nodes(l_max + 2)
        a, b = self.inner_diameter / 2, self.outer_diameter / 2
        rho = (b + a) / 2 + (b - a) / 2 * nodes
        terms = _solid(orders, np.hypot(rho, self.height / 2), self.height / 2)
        return self.polarisation_mt * (b - a) / 2 * (terms * rho) @ weights


@dataclass(frozen=True)
class Disc:
    """A full cylinder magnet, magnetised along its axis, the z axis of its frame.

    Parameters
    ----------
    diameter, height
        Dimensions [m].
    polarisation_mt
        Magnetic polarisation [mT].

    Raises
    ------
    InputError
        If a dimension is not positive, or the polarisation is not finite.

    Examples
    --------
    Far away it is a dipole, of :math:`2 A_1/z^3` on its axis:

    >>> disc = Disc(8e-3, 3e-3, 1300.0)
    >>> disc.field([0.0, 0.0, 0.5])[2] / (2 * disc.multipoles(1)[0] / 0.5**3)
    np.float64(0.999...)
    """

    diameter: float
    height: float
    polarisation_mt: float

    def __post_init__(self) -> None:
        for name in ("diameter", "height"):
            _ = scalar(getattr(self, name), name, "Disc", "positive [m]")
        _check_polarisation(self.polarisation_mt, "Disc")

    @property
    def reach(self) -> float:
        """Radius of the sphere around the disc, beyond which its multipoles describe the field [m]."""
        return math.hypot(self.diameter, self.height) / 2

    def field(self, positions: ArrayLike) -> Array:
        """Return the flux density [mT] at positions ``[..., 3]`` [m], both in the frame of the magnet."""
        return _field("cylinder_field", (self.diameter, self.height), self.polarisation_mt, positions)

    def multipoles(self, l_max: int = 9) -> Array:
        """Return the axial multipole moments, as :meth:`Ring.multipoles`."""
        return Ring(self.diameter, 0.0, self.height, self.polarisation_mt).multipoles(l_max)


@dataclass(frozen=True)
class Cube:
    """A cube magnet, magnetised along the z axis of its frame, which is normal to two of its faces.

    Parameters
    ----------
    edge
        Length of an edge [m].
    polarisation_mt
        Magnetic polarisation [mT].

    Raises
    ------
    InputError
        If the edge is not positive, or the polarisation is not finite.

    Examples
    --------
    A dipole's 2 J a^3 / (4 pi z^3), in mT:

    >>> Cube(10e-3, 1450.0).field([0.0, 0.0, 0.1]).round(4)
    array([0.    , 0.    , 0.2308])
    """

    edge: float
    polarisation_mt: float

    def __post_init__(self) -> None:
        _ = scalar(self.edge, "edge", "Cube", "positive [m]")
        _check_polarisation(self.polarisation_mt, "Cube")

    @property
    def reach(self) -> float:
        """Radius of the sphere around the cube, beyond which its multipoles describe the field [m]."""
        return math.sqrt(3.0) / 2 * self.edge

    def field(self, positions: ArrayLike) -> Array:
        """Return the flux density [mT] at positions ``[..., 3]`` [m], both in the frame of the magnet."""
        return _field("cuboid_field", (self.edge,) * 3, self.polarisation_mt, positions)

    def multipoles(self, l_max: int = 3) -> Array:
        r"""Return the axial multipole moments, as :meth:`Ring.multipoles`, averaged over turns about the axis.

        Up to :math:`l = 3` the field of a cube is axisymmetric. From :math:`l = 5` on it has a part that changes four
        times in a turn, which no axial moment describes.
        """
        orders = _orders(l_max)
        nodes, weights = _nodes(l_max + 2)
        x, y = np.meshgrid(nodes * self.edge / 2, nodes * self.edge / 2)
        terms = _solid(orders, np.sqrt(x**2 + y**2 + self.edge**2 / 4), self.edge / 2)
        area = self.edge**2 / 4 * np.outer(weights, weights)
        return self.polarisation_mt / (2 * math.pi) * (terms * area).sum((-1, -2))


def _check_polarisation(value: float, owner: str) -> None:
    require(math.isfinite(scalar(value, "polarisation_mt", owner)), "polarisation_mt", owner, "finite", value)


def _orders(l_max: int) -> range:
    require(l_max >= 1 and l_max % 2, "l_max", "multipoles", "a positive odd number", l_max)
    return range(1, l_max + 1, 2)


def _solid(orders: range, r: Array, height: float) -> Array:
    """Solid harmonics of points on a face, at that height above the centre."""
    return np.array([r**n * Legendre.basis(n)(height / r) for n in orders])


def _field(name: str, dimensions: tuple[float, ...], polarisation_mt: float, positions: ArrayLike) -> Array:
    import magpylib

    at = numbers(positions, "positions", "field", (..., 3))
    if not at.size:
        return np.zeros(at.shape)
    points = at.reshape(-1, 3)
    flux = getattr(magpylib.func, name)(
        "B",
        points,
        dimensions=np.broadcast_to(dimensions, (len(points), len(dimensions))),
        polarizations=np.broadcast_to([0.0, 0.0, 1e-3 * polarisation_mt], (len(points), 3)),
        squeeze=False,
    )
    return 1e3 * flux.reshape(at.shape)


Shape = Ring | Disc | Cube
"""What a magnet can be."""


@dataclass(frozen=True)
class Magnet:
    """A magnet on a robot.

    Parameters
    ----------
    shape
        :class:`Ring`, :class:`Disc` or :class:`Cube`.
    segment
        Segment that it is mounted on, from 1 at the base; 0 is the base itself.
    at
        Distance of its centre from the base of that segment along the unextended backbone [m].
    direction
        Direction of magnetisation in the frame of the cross-section, of any length; along the backbone, towards the
        tip, if not given.
    position
        Place of its centre in that frame [m]; on the backbone if not given.
    tolerance
        Standard deviations by which it may be off its drawing: a mapping with some of ``position`` (along every
        axis), ``at`` (along the backbone), ``size`` (every dimension) [m], ``tilt`` [rad], ``polarisation``
        (relative).
    free
        Ranges in which a better design may put it, of :func:`.improve_design`: a mapping from some of ``at`` [m],
        ``azimuth`` [rad] and its dimensions, such as ``height`` [m], to ``(lowest, highest)``.

    Raises
    ------
    InputError
        If the numbers describe no place or no direction.

    Examples
    --------
    >>> Magnet(Disc(8e-3, 3e-3, 1300.0), segment=1, at=0.045, direction=[1, 0, 0]).place.rotation[:, 2]
    array([1., 0., 0.])
    """

    shape: Shape
    segment: int
    at: float
    direction: ArrayLike | None = None
    position: ArrayLike | None = None
    tolerance: Mapping[str, float] | None = None
    free: Mapping[str, tuple[float, float]] | None = None

    def __post_init__(self) -> None:
        known = isinstance(self.shape, Shape)
        require(known, "shape", "Magnet", "a Ring, Disc or Cube", type(self.shape).__name__)
        check_tolerance(self.tolerance, "Magnet")
        check_free(self, [name for name in vars(self.shape) if name != "polarisation_mt"])
        _ = self.place

    @cached_property
    def place(self) -> Place:
        """Where it is; the z axis of its frame is its axis."""
        return place("Magnet", self.segment, self.at, self.position, None, self.direction)


def simulated_readings(robot: Assembly, q: ArrayLike, earth_mt: ArrayLike | None = None) -> Array:
    """Return what the sensors and IMUs of a robot read without noise, by magpylib's exact fields.

    Parameters
    ----------
    robot
        With its magnets, sensors and IMUs.
    q
        Configurations ``[..., n_q]``.
    earth_mt
        Field of the Earth in the base frame ``[..., 3]`` [mT]; none if not given.

    Returns
    -------
    numpy.ndarray
        Readings ``[..., s]`` as :class:`repro.Sensing` orders them: flux densities [mT] of all sensors, one for
        every axis, then a rotation vector [rad] for every IMU.

    Raises
    ------
    InputError
        If there is nothing to read, or a sensor and no magnet.

    Examples
    --------
    The robot of Baaij et al. 2023 with one segment, straight:

    >>> from repro import ConstantCurvature, Robot, Sensor
    >>> magnets = [Magnet(Ring(24e-3, 12e-3, 6e-3, 1450.0), segment=1, at=0.055)]
    >>> sensors = [Sensor(1, 0.11, radial=0.013, azimuth=k * 2 * np.pi / 3) for k in range(3)]
    >>> robot = Robot([ConstantCurvature(0.11, 0.022)], magnets, sensors)
    >>> simulated_readings(robot, [0.0, 0.0, 0.0]).round(3)
    array([-2.248, -2.248, -2.248])
    """
    q = robot.check_q(q, "simulated_readings")
    require(robot.n_readings, "robot", "simulated_readings", "one with sensors or IMUs", "neither")
    parts = [*robot.magnets, *robot.sensors, *robot.imus]
    T = robot.poses(q, [part.place for part in parts])
    n_m, n_s = len(robot.magnets), len(robot.sensors)
    earth = np.zeros(3) if earth_mt is None else numbers(earth_mt, "earth_mt", "simulated_readings", (..., 3))
    columns = []
    if robot.sensors:
        R, axes = T[..., None, :n_m, :3, :3], T[..., n_m : n_m + n_s, :3, :3]
        offset = T[..., n_m : n_m + n_s, None, :3, 3] - T[..., None, :n_m, :3, 3]
        local = (R.mT @ offset[..., None])[..., 0]
        B = np.broadcast_to(earth[..., None, :], (*q.shape[:-1], n_s, 3)).copy()
        for shape in dict.fromkeys(magnet.shape for magnet in robot.magnets):  # one call of magpylib each
            own = [k for k, magnet in enumerate(robot.magnets) if magnet.shape == shape]
            B += (R[..., own, :, :] @ shape.field(local[..., own, :])[..., None])[..., 0].sum(-2)
        read = (axes.mT @ B[..., None])[..., 0]
        columns += [read[..., j, -sensor.axes :] for j, sensor in enumerate(robot.sensors)]
    if robot.imus:
        turns = Rotation.from_matrix(T[..., n_m + n_s :, :3, :3].reshape(-1, 3, 3)).as_rotvec()
        columns.append(turns.reshape(*q.shape[:-1], -1))
    return np.concatenate(columns, axis=-1)
