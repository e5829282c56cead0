r"""The shape of an arm from the orientations of IMUs along it (Martin, Bruder and Wood 2022).

Orientations are unit quaternions XYZW ``[..., imus, 4]`` that turn coordinates of an IMU into coordinates of
the world; the z axis of an IMU points along the arm, towards the tip. All models have one signature,
``model(orientations, arm, arc_lengths) -> positions``, and return positions ``[..., points, 3]`` [m] in the
world.

Between two IMUs the orientation turns about a fixed axis by :math:`\varphi`. Let :math:`d_0, d_1` be the
tangents at both ends of this link and :math:`d` the one halfway. Then :math:`p = (d - (d_0 + d_1)/2)/(1 -
\cos\frac\varphi2)` is the part of :math:`d` across the axis, and :math:`d - p` the part along it. The sum of
eq. (5) is a geometric series: a link of length :math:`L` and :math:`n` sub-segments takes us by

.. math:: L\,\bigl(S\,d + (1 - S)(d - p)\bigr), \qquad
          S = \frac{\mathrm{sinc}(\varphi/2)}{\mathrm{sinc}(\varphi/2n)}, \qquad
          \mathrm{sinc}\,x = \frac{\sin x}x.

For :math:`n \to \infty` the denominator is 1, and the link is an arc of constant curvature and torsion. The
same holds for the first :math:`k` of the sub-segments, with their own :math:`d` and a share :math:`k/n` of
the turn, so that no sum is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from repro.chain import unit_quaternions
from repro.common import Array, kernel, numbers, require


@dataclass(frozen=True)
class Arm:
    """Which IMUs of an arm a model takes, where they are, and the model's links.

    Parameters
    ----------
    imus
        Numbers of the IMUs, base to tip; 0 is the base itself.
    imu_arcs
        Where they are: distances along the arm [m], increasing.
    link_lengths
        Lengths of the links [m], base to tip: one per IMU for a rigid-body model, one between each two IMUs
        else.
    markers
        Distances along the links [m] of points that motion capture sees.
    sub_segments
        Sub-segments of every link between two IMUs (section II-B), one number or one per link; 0 for a
        rigid-body model.
    interpolation
        How far sub-segment k of n is turned from one IMU to the next: "midpoints", (2k + 1)/2n as printed in
        eq. (3), or "inner points", (k + 1)/(n + 1) as in some of the released files.
    base_turn
        Turn of the base against the orientation given for it to :meth:`select`, a quaternion XYZW.
    origin
        Where the links begin, in the world [m].
    link_offsets
        For a rigid-body model, where each link ends beside its length along z, in the frame of its IMU
        ``[links, 3]`` [m]; nowhere else if not given.

    Raises
    ------
    InputError
        If numbers of IMUs, distances and links do not fit together, or one of them cannot be used.

    Examples
    --------
    The PCC-extended model with two IMUs of Table I, 16 sub-segments in all:

    >>> from repro import Arm
    >>> Arm([0, 4, 8], [0.0, 0.32, 0.64], [0.32, 0.32], markers=[0.36, 0.6], sub_segments=8).imus
    (0, 4, 8)
    """

    imus: Sequence[int]
    imu_arcs: Sequence[float]
    link_lengths: Sequence[float]
    markers: Sequence[float] = ()
    sub_segments: int | Sequence[int] = 0
    interpolation: str = "midpoints"
    base_turn: Sequence[float] = (0.0, 0.0, 0.0, 1.0)
    origin: Sequence[float] = (0.0, 0.0, 0.0)
    link_offsets: Sequence[Sequence[float]] = ()

    def __post_init__(self) -> None:
        k, n = numbers(self.imus, "imus", "Arm", (None,)), numbers(self.sub_segments, "sub_segments", "Arm")
        links = len(k) - bool(n.any())
        distinct = links > 0 and len(set(k.tolist())) == len(k) and (k >= 0).all() and not (k % 1).any()
        require(
            distinct,
            "imus",
            "Arm",
            "different whole numbers from 0 on, at least two of them if there are sub-segments",
            self.imus,
        )
        sizes = {"imu_arcs": len(k), "link_lengths": links, "markers": None, "base_turn": 4, "origin": 3}
        found = {name: numbers(getattr(self, name), name, "Arm", (size,)) for name, size in sizes.items()}
        increasing = (np.diff(found["imu_arcs"], prepend=-1e-300) > 0).all()
        require(increasing, "imu_arcs", "Arm", "increasing from 0 or above [m]", self.imu_arcs)
        require((found["link_lengths"] > 0).all(), "link_lengths", "Arm", "positive [m]", self.link_lengths)
        fits = n.shape in ((), (links,)) and not (n % 1).any() and (n >= min(n.ndim, 1)).all()
        expected = "0 or a positive whole number, or one such number per link"
        require(fits, "sub_segments", "Arm", expected, self.sub_segments)
        known = self.interpolation in ("midpoints", "inner points")
        require(known, "interpolation", "Arm", "'midpoints' or 'inner points'", repr(self.interpolation))
        unit_quaternions(self.base_turn, "base_turn", "Arm", (4,))
        if len(self.link_offsets):
            require(links == len(k), "link_offsets", "Arm", "those of a rigid-body model", self.link_offsets)
            found["link_offsets"] = numbers(self.link_offsets, "link_offsets", "Arm", (links, 3))
        for name, values in (found | {"imus": k.astype(int)}).items():
            object.__setattr__(self, name, tuple(values.tolist()))
        object.__setattr__(self, "sub_segments", tuple(n.astype(int).tolist()) if n.ndim else int(n))

    @cached_property
    def links(self) -> Array:
        """For the kernels, length, number of sub-segments and the share of the turn these spread over, of every link.

        "Inner points" spread the sub-segments over the share ``n/(n + 1)`` of the turn, about its middle.
        """
        n = np.broadcast_to(np.array(self.sub_segments, dtype=float), len(self.link_lengths))
        share = n / (n + 1) if self.interpolation == "inner points" else np.ones(len(n))
        return np.stack([np.array(self.link_lengths), n, share])

    @cached_property
    def arcs(self) -> Array:
        """The same for links that are arcs."""
        n = len(self.link_lengths)
        return np.stack([np.array(self.link_lengths), np.full(n, np.inf), np.ones(n)])

    def select(self, orientations: ArrayLike) -> Array:
        """Return the orientations of this arm's IMUs ``[..., imus, 4]``, the base turned by ``base_turn``.

        Parameters
        ----------
        orientations
            Quaternions XYZW of the base and IMUs #1, #2 and so on ``[..., n, 4]``.

        Raises
        ------
        InputError
            If there is no orientation for one of the IMUs.
        """
        q = numbers(orientations, "orientations", "select", (..., None, 4), finite=False)
        last = max(self.imus)
        require(
            q.shape[-2] > last, "orientations", "select", f"those of IMUs 0 to {last}", f"shape {q.shape}"
        )
        q = q[..., list(self.imus), :]
        if 0 in self.imus:
            base = self.imus.index(0)
            q[..., base, :] = _product(q[..., base, :], np.array(self.base_turn))
        return q


ShapeModel = Callable[[ArrayLike, Arm, ArrayLike], Array]
"""From orientations ``[..., imus, 4]``, an arm and distances along it [m] to positions ``[..., points, 3]``."""


def rigid_body(orientations: ArrayLike, arm: Arm, arc_lengths: ArrayLike) -> Array:
    r"""Return positions on straight links along the z axes of the IMUs, equation (2).

    .. math:: \hat x_i = \sum_{j=0}^{i-1} R(q_j)\,(0, 0, L_j)^T

    Parameters
    ----------
    orientations
        Quaternions XYZW of the arm's IMUs ``[..., imus, 4]``.
    arm
        With one link per IMU (``sub_segments=0``).
    arc_lengths
        Distances from the origin of the chain along it [m], one or several.

    Returns
    -------
    numpy.ndarray
        Positions ``[..., points, 3]`` [m] in the world; between two joints by linear interpolation.

    Raises
    ------
    InputError
        If quaternions are not finite or not unit within 1e-3, there is not one per IMU, the arm has other
        links, or a distance lies beyond the chain.

    References
    ----------
    Martin, Bruder and Wood (2022), section II-A.

    Examples
    --------
    Two links of 80 mm, upright and lying along x:

    >>> from repro import Arm, rigid_body
    >>> arm = Arm([1, 2], [0.04, 0.12], [0.08, 0.08])
    >>> rigid_body([[0, 0, 0, 1], [0, np.sqrt(0.5), 0, np.sqrt(0.5)]], arm, [0.04, 0.16]).round(3) + 0.0
    array([[0.  , 0.  , 0.04],
           [0.08, 0.  , 0.08]])

    One link that ends 10 mm beside its z axis:

    >>> rigid_body([[0, 0, 0, 1]], Arm([1], [0.0], [0.08], link_offsets=[[0.01, 0, 0]]), 0.08)
    array([[0.01, 0.  , 0.08]])
    """
    p = _positions(orientations, arm, arc_lengths, "rigid_body")
    return p + _beside(orientations, arm, arc_lengths) if arm.link_offsets else p


def _beside(orientations: ArrayLike, arm: Arm, arc_lengths: ArrayLike) -> Array:
    """Return how far points are from where lengths along z alone would take them ``[..., points, 3]``."""
    q = unit_quaternions(orientations, "orientations", "rigid_body", (..., len(arm.imus), 4))
    lengths = np.array(arm.link_lengths)
    starts = np.cumsum(lengths) - lengths
    share = np.clip((np.atleast_1d(arc_lengths)[:, None] - starts) / lengths, 0.0, 1.0)
    v, w = np.array(arm.link_offsets), q[..., 3:]
    twice = 2 * np.cross(q[..., :3], v)
    return share @ (v + w * twice + np.cross(q[..., :3], twice))


def pcc_extended(orientations: ArrayLike, arm: Arm, arc_lengths: ArrayLike) -> Array:
    """Return positions on straight sub-segments, their orientations interpolated between IMUs, eqs (3) to (7).

    Sub-segment k of n has the orientation ``slerp(q_i, q_i+1, (2k + 1)/2n)`` by the shorter way round, or the
    arm's other interpolation. We take the sum in closed form; points between joints follow by linear
    interpolation.

    Parameters
    ----------
    orientations, arc_lengths
        As in :func:`rigid_body`.
    arm
        With a link between each two IMUs, and its ``sub_segments``.

    Raises
    ------
    InputError
        As in :func:`rigid_body`.

    References
    ----------
    Martin, Bruder and Wood (2022), section II-B.

    Examples
    --------
    A quarter circle of 640 mm, whose radius is 407.4 mm, in 16 sub-segments and in the limit:

    >>> from repro import Arm, exact_arcs, pcc_extended
    >>> quarter = [[0, 0, 0, 1], [0, np.sqrt(0.5), 0, np.sqrt(0.5)]]
    >>> arm = Arm([0, 8], [0.0, 0.64], [0.64], sub_segments=16)
    >>> pcc_extended(quarter, arm, 0.64).round(4) + 0.0
    array([[0.4076, 0.    , 0.4076]])
    >>> exact_arcs(quarter, arm, 0.64).round(4) + 0.0
    array([[0.4074, 0.    , 0.4074]])
    """
    return _positions(orientations, arm, arc_lengths, "pcc_extended")


def exact_arcs(orientations: ArrayLike, arm: Arm, arc_lengths: ArrayLike) -> Array:
    """Return positions in the limit of ever more sub-segments: between IMUs a frame turns at a constant rate.

    A link is an arc of constant curvature if its IMUs differ by bending alone, a helix if they are twisted as
    well. The number of sub-segments has no effect.

    Parameters
    ----------
    orientations, arm, arc_lengths
        As in :func:`pcc_extended`, which has an example.

    Raises
    ------
    InputError
        As in :func:`rigid_body`.

    References
    ----------
    Martin, Bruder and Wood (2022), section II-B: "As n increases, this model approximates a PCC model".

    Examples
    --------
    A quarter circle of 640 mm, from IMUs at its ends, ends at 2 L/pi:

    >>> from repro import Arm, exact_arcs
    >>> quarter = [[0.0, 0.0, 0.0, 1.0], [0.0, 0.5**0.5, 0.0, 0.5**0.5]]
    >>> exact_arcs(quarter, Arm([0, 8], [0.0, 0.64], [0.64], sub_segments=1), [0.64]).round(4) + 0.0
    array([[0.4074, 0.    , 0.4074]])
    """
    return _positions(orientations, arm, arc_lengths, "exact_arcs")


def _positions(orientations: ArrayLike, arm: Arm, arc_lengths: ArrayLike, owner: str) -> Array:
    """Check what a model is given, and return its positions."""
    between = owner != "rigid_body"
    require(isinstance(arm, Arm), "arm", owner, "an Arm", type(arm).__name__)
    kind = "one with links between IMUs (sub_segments above 0)" if between else "one with a link per IMU"
    require((len(arm.link_lengths) < len(arm.imus)) == between, "arm", owner, kind, arm)
    q = numbers(orientations, "orientations", owner, (..., len(arm.imus), 4))
    points, total = np.atleast_1d(numbers(arc_lengths, "arc_lengths", owner)), sum(arm.link_lengths)
    inside = points.ndim == 1 and points.size and points.min() >= 0 and points.max() <= total * (1 + 1e-12)
    require(inside, "arc_lengths", owner, f"distances between 0 and {total:g} m, at least one", points)
    rows = q.reshape(-1, len(arm.imus), 4).copy()
    p = np.empty((*q.shape[:-2], len(points), 3))
    links = arm.arcs if owner == "exact_arcs" else arm.links
    if not _chain(rows, links, np.array(arm.origin), points.copy(), p.reshape(-1, 3)):
        unit_quaternions(q, "orientations", owner, (..., *q.shape[-2:]))
    return p


@kernel(entry=True, allocates=True)
def _chain(q, links, origin, points, out):
    """Write points on chains of links, by the formula of this module; return whether quaternions are unit ones.

    Without sub-segments links are straight. ``out`` holds the points of one sample after those of another.
    """
    length, n_links, n_points = links[0], links.shape[1], len(points)
    d, at, bends = np.zeros((q.shape[1], 3)), np.zeros((n_links + 1, 3)), np.zeros((n_links, 6))
    at[0] = origin
    for k in range(len(q)):
        if not _scaled(q[k]):
            return False
        for i in range(q.shape[1]):
            _tangent(q[k, i, 0], q[k, i, 1], q[k, i, 2], q[k, i, 3], d[i])
        for g in range(n_links):
            if links[1, g] > 0.0:
                _link(q[k, g], q[k, g + 1], d[g], d[g + 1], links[:, g], bends[g], at[g + 1])
            for c in range(3):
                at[g + 1, c] = at[g, c] + length[g] * (at[g + 1, c] if links[1, g] > 0.0 else d[g, c])
        for i in range(n_points):
            g, end = 0, length[0]
            while g < n_links - 1 and end < points[i]:
                g += 1
                end += length[g]
            share = min(max((points[i] - end) / length[g] + 1.0, 0.0), 1.0)
            p = out[k * n_points + i]
            if links[1, g] > 0.0:
                _within(q[k, g], q[k, g + 1], bends[g], links[:, g], share, p)
            for c in range(3):
                p[c] = at[g, c] + length[g] * (p[c] if links[1, g] > 0.0 else share * d[g, c])
    return True


@kernel
def _scaled(q):
    """Scale the quaternions of a sample to norm 1; return whether they were that but for rounding."""
    for i in range(len(q)):
        norm = math.sqrt(q[i, 0] * q[i, 0] + q[i, 1] * q[i, 1] + q[i, 2] * q[i, 2] + q[i, 3] * q[i, 3])
        if not abs(norm - 1.0) <= 1e-3:
            return False
        for c in range(4):
            q[i, c] /= norm
    return True


@kernel
def _tangent(x, y, z, w, d):
    """Write the z axis of the frame of a unit quaternion."""
    d[0], d[1], d[2] = 2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)


@kernel
def _sinc(x):
    return math.sin(x) / x if x != 0.0 else 1.0


@kernel
def _link(a, b, d, onward, link, bend, step):
    """Write the chord of a link, in units of its length.

    ``bend`` takes the angle phi/2 between the quaternions as vectors, the sign of the second one that is closer to
    the first, and the part of the tangent along the axis.
    """
    cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    sign = math.copysign(1.0, cosine)
    angle = math.acos(min(abs(cosine), 1.0))
    bend[0], bend[1] = angle, sign
    scale = 0.5 / math.cos(0.5 * angle)
    _tangent(
        scale * (a[0] + sign * b[0]), scale * (a[1] + sign * b[1]), scale * (a[2] + sign * b[2]),
        scale * (a[3] + sign * b[3]), step,
    )  # fmt: skip
    n, c = link[1], link[2]
    S = _sinc(c * angle) / _sinc(c / n * angle)
    for i in range(3):
        # Where the angle vanishes so does 1 - S, and any bounded p will do.
        p = (step[i] - 0.5 * (d[i] + onward[i])) / max(1.0 - math.cos(angle), 1e-16)
        bend[2 + i] = step[i] - p
        step[i] -= (1.0 - S) * p


@kernel
def _within(a, b, bend, link, share, p):
    """Write the way along a share of a link, in units of its length."""
    angle, n, c = bend[0], link[1], link[2]
    done = share if n == math.inf else math.floor(share * n) / n
    S = _sinc(c * done * angle) / _sinc(c / n * angle)
    _between(a, b, bend, 0.5 * (1.0 - c + c * done), p)
    chord_x, chord_y, chord_z = p[0], p[1], p[2]
    _between(a, b, bend, 0.5 * (1.0 - c) + c * (done + 0.5 / n), p)
    rest = share - done
    p[0] = done * (S * chord_x + (1.0 - S) * bend[2]) + rest * p[0]
    p[1] = done * (S * chord_y + (1.0 - S) * bend[3]) + rest * p[1]
    p[2] = done * (S * chord_z + (1.0 - S) * bend[4]) + rest * p[2]


@kernel
def _between(a, b, bend, share, d):
    """Write the tangent of the spherical linear interpolation of eq. (4)."""
    rest, whole = 1.0 - share, _sinc(bend[0])
    of_a, of_b = rest * _sinc(rest * bend[0]) / whole, bend[1] * share * _sinc(share * bend[0]) / whole
    _tangent(
        of_a * a[0] + of_b * b[0], of_a * a[1] + of_b * b[1], of_a * a[2] + of_b * b[2],
        of_a * a[3] + of_b * b[3], d,
    )  # fmt: skip


def _product(first: Array, second: Array) -> Array:
    """Return the quaternion ``[..., 4]`` of ``second`` followed by ``first``, both turns in the world."""
    ax, ay, az, aw = np.moveaxis(first, -1, 0)
    bx, by, bz, bw = np.moveaxis(second, -1, 0)
    product = [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
    return np.stack(product, axis=-1)


def _exponential(vector: Array) -> Array:
    """Return the quaternion ``[..., 4]`` of a rotation vector ``[..., 3]`` [rad]."""
    half = np.linalg.norm(vector, axis=-1, keepdims=True) / 2
    return np.concatenate([0.5 * np.sinc(half / np.pi) * vector, np.cos(half)], axis=-1)


@dataclass(frozen=True)
class ImuCalibration:
    """Frame, headings and mountings that fit motion capture best, from :func:`calibrate_imus`.

    Parameters
    ----------
    names
        Names of the parameters: ``heading_3`` belongs to IMU #3.
    estimate
        The parameters: rotation vector of the frame [rad], its translation [m], then angles [rad].
    covariance
        Their posterior covariance, in the same units.
    imus
        Numbers of the arm's IMUs: the order of the orientations that :func:`calibrated` takes.
    rms
        Root mean square distance between markers and model after calibration [m].
    used
        Number of marker positions that were used.
    missing
        Number of marker positions that were left out because they were not finite.
    """

    names: tuple[str, ...]
    estimate: Array
    covariance: Array
    imus: tuple[int, ...]
    rms: float
    used: int
    missing: int

    @property
    def deviation(self) -> Array:
        """Standard deviations of the parameters."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def translation(self) -> Array:
        """Position of the arm's base in the frame of the motion capture [m]."""
        return self.estimate[3:6]

    def arm(self, arm: Arm) -> Arm:
        """Return the arm that was calibrated with its links as they were found."""
        return _with_links(arm, self.names, self.estimate)


def calibrate_imus(
    orientations: ArrayLike,
    markers: ArrayLike,
    model: ShapeModel,
    arm: Arm,
    *,
    per_imu: bool = True,
    noise: float = 0.01,
    rotation: float = math.radians(10.0),
    translation: float = 0.05,
    heading: float = math.radians(10.0),
    mounting: float = math.radians(5.0),
    link: float = 0.0,
) -> ImuCalibration:
    r"""Fit the frame of the motion capture, and headings and mountings of the IMUs, to positions of markers.

    The orientation of link :math:`i` in the frame of the motion capture is :math:`R_i = R_f\, R_z(\psi_i)\,
    \hat R_i\, e^{[\mu_i]_\times}` with the measured :math:`\hat R_i`, its heading error :math:`\psi_i` about
    the vertical, its mounting :math:`\mu_i` about x and y of the link, and the rotation :math:`R_f` of the
    frame. Points are at :math:`p = \hat x(R_0, \ldots, R_N) + p_f`. We minimise :math:`\|z\|^2 + \sum \|p -
    \hat p\|^2/\sigma^2` over the parameters :math:`z` in units of their tolerances. Without this scaling
    least squares stops early, because metres and radians differ too much.

    Parameters
    ----------
    orientations
        Quaternions XYZW of the arm's IMUs ``[samples, imus, 4]``.
    markers
        Positions of the arm's ``markers`` at the same times ``[samples, markers, 3]`` [m], in the frame of
        the motion capture; NaN where a marker was not seen.
    model
        The model to calibrate for; the calibration absorbs a part of its error.
    arm
        Its IMUs, links and markers.
    per_imu
        Whether headings and mountings are fitted too, of all IMUs between the base and the last marker.
    noise
        Standard deviation of a marker against the model along each axis [m]. The error of the model counts.
        Samples are taken for independent; neighbouring ones are not, so give a larger value or every k-th
        sample.
    rotation
        Tolerance of the rotation of the frame [rad]: standard deviation of its prior, assumed as the next three.
    translation
        Tolerance of its translation [m].
    heading
        Tolerance of a heading [rad].
    mounting
        Tolerance of a mounting [rad].
    link
        Tolerance of where a link ends along each axis of its IMU [m]; zero for links as drawn. For a rigid-body
        model: ``arm = calibration.arm(arm)`` has them as they were found.

    Raises
    ------
    InputError
        If orientations and markers do not fit together, fewer than two positions were seen, or a standard
        deviation is not positive.

    References
    ----------
    Beyond the paper: Martin, Bruder and Wood (2022) calibrate nothing against motion capture.

    Examples
    --------
    An arm that lies along -y of the motion capture, 1 m above its origin:

    >>> from repro import Arm, calibrate_imus, exact_arcs
    >>> arm = Arm([0, 1], [0.0, 0.3], [0.3], markers=[0.2, 0.3], sub_segments=1)
    >>> bent = [[[0, 0, 0, 1], [np.sin(a), 0, 0, np.cos(a)]] for a in (0.1, 0.3, 0.5)]
    >>> seen = exact_arcs(bent, arm, arm.markers)[..., [0, 2, 1]] * [1, -1, 1] + [0, 0, 1]
    >>> calibrate_imus(bent, seen, exact_arcs, arm, per_imu=False, noise=1e-6).estimate.round(4) + 0.0
    array([1.5708, 0.    , 0.    , 0.    , 0.    , 1.    ])
    """
    owner = "calibrate_imus"
    tolerances = {"rotation": rotation, "translation": translation, "heading": heading, "mounting": mounting}
    for name, value in {"noise": noise, **tolerances}.items():
        require(0 < value < math.inf, name, owner, "positive", value)
    fits = 0 <= link < math.inf and (not link or len(arm.link_lengths) == len(arm.imus))
    require(fits, "link", owner, "not negative, and zero but for a rigid-body model", link)
    q = unit_quaternions(orientations, "orientations", owner, (None, len(arm.imus), 4))
    positions = numbers(markers, "markers", owner, (len(q), len(arm.markers), 3), finite=False)
    seen = np.isfinite(positions).all(axis=-1)
    used = int(seen.sum())
    require(used >= 2, "markers", owner, "at least two positions that were seen", used)
    names = _errors_of(arm, per_imu, link > 0)

    def predicted(x: Array) -> Array:
        turned = _corrected(q, names, x, arm.imus)
        return model(turned, _with_links(arm, names, x), arm.markers)[seen] + x[3:6]

    scale = np.array([{**tolerances, "link": link}[name.split("_")[0]] for name in names])
    x, covariance = _fitted(predicted, positions[seen], noise, scale)
    rms = np.sqrt(np.mean(np.sum((predicted(x) - positions[seen]) ** 2, axis=-1)))
    return ImuCalibration(names, x, covariance, tuple(arm.imus), float(rms), used, seen.size - used)


def _fitted(
    predicted: Callable[[Array], Array], seen: Array, noise: float, scale: Array
) -> tuple[Array, Array]:
    """Return the parameters that predict positions best, and their covariance, by their priors' deviations."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    def residuals(z: Array) -> Array:
        return np.concatenate([((predicted(z * scale) - seen) / noise).ravel(), z])

    # We start at the frame that fits best without priors (Kabsch 1976): tolerances are no bounds.
    x = np.zeros(len(scale))
    points = predicted(x)
    R = Rotation.align_vectors(seen - seen.mean(0), points - points.mean(0))[0]
    x[:3], x[3:6] = R.as_rotvec(), seen.mean(0) - R.apply(points.mean(0))
    fit = least_squares(residuals, x / scale, x_scale=1.0, ftol=1e-6, xtol=1e-6)
    return fit.x * scale, np.linalg.inv(fit.jac.T @ fit.jac) * np.outer(scale, scale)


def _with_links(arm: Arm, names: tuple[str, ...], z: Array) -> Arm:
    """Return an arm whose links end elsewhere."""
    own = [k for k, name in enumerate(names) if name.startswith("link_")]
    if not own:
        return arm
    before = np.array(arm.link_offsets) if arm.link_offsets else np.zeros((len(arm.link_lengths), 3))
    moved = np.pad(z[own].reshape(-1, 3), ((0, len(before) - len(own) // 3), (0, 0)))
    return replace(arm, link_offsets=(before + moved).tolist())


def _errors_of(arm: Arm, per_imu: bool, links: bool) -> tuple[str, ...]:
    """Return the names of what may be off: the frame, and headings, mountings and links up to the last marker."""
    last = max(arm.markers)
    own = [k for k, at in zip(arm.imus, arm.imu_arcs, strict=True) if per_imu and k > 0 and at <= last]
    names = [f"{part}_{axis}" for part in ("rotation", "translation") for axis in "xyz"]
    names += [f"{part}_{k}" for k in own for part in ("heading", "mounting_x", "mounting_y")]
    ends = zip(arm.imus, np.cumsum(arm.link_lengths) - arm.link_lengths, strict=links)
    return (*names, *(f"link_{x}_{k}" for k, begins in ends if links and begins < last for x in "xyz"))


def calibrated(orientations: ArrayLike, calibration: ImuCalibration) -> Array:
    """Return orientations ``[..., imus, 4]`` of links in the frame of the motion capture.

    Positions that a model finds from them, plus ``calibration.translation``, are positions in that frame.

    Parameters
    ----------
    orientations
        Quaternions XYZW of the IMUs that were calibrated ``[..., imus, 4]``.
    calibration
        From :func:`calibrate_imus`.

    Raises
    ------
    InputError
        If there is not one quaternion per IMU, or one is not finite or not unit within 1e-3.

    Examples
    --------
    An arm that stands upright in the motion capture keeps its orientations:

    >>> from repro import Arm, calibrate_imus, calibrated, exact_arcs
    >>> arm = Arm([0, 8], [0.0, 0.64], [0.64], markers=[0.36, 0.6], sub_segments=1)
    >>> bent = np.array([[[0, 0, 0, 1.0], [0, np.sin(a), 0, np.cos(a)]] for a in (0.1, 0.3, 0.5)])
    >>> found = calibrate_imus(bent, exact_arcs(bent, arm, arm.markers), exact_arcs, arm, per_imu=False)
    >>> np.allclose(calibrated(bent, found), bent, atol=1e-6)
    True
    """
    q = unit_quaternions(orientations, "orientations", "calibrated", (..., len(calibration.imus), 4))
    return _corrected(q, calibration.names, calibration.estimate, calibration.imus)


def _corrected(q: Array, names: tuple[str, ...], z: Array, imus: Sequence[int]) -> Array:
    """Apply frame, headings and mountings."""
    row = [k for k, imu in enumerate(imus) if f"heading_{imu}" in names]
    heading, mounting = np.zeros((len(imus), 3)), np.zeros((len(imus), 3))
    own = z[6 : 6 + 3 * len(row)].reshape(-1, 3)
    heading[row, 2], mounting[row, 0], mounting[row, 1] = own.T
    before = _product(_exponential(z[:3]), _exponential(heading))
    return _product(_product(before, q), _exponential(mounting))
