"""Robots that several tests use, and the routes that check them: complex steps and stored answers."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from repro import (
    AffineCurvature,
    BallJoint,
    ConstantCurvature,
    Cube,
    Disc,
    FreeBody,
    Imu,
    Link,
    Magnet,
    Ring,
    Robot,
    Sensor,
)
from repro.chain import point_on

STORED = np.load(Path(__file__).parents[1] / "oracles" / "first_edition.npz")
"""What the first edition of this project answered, an implementation of its own by torch (commit 13f7d3e)."""
RELEASED = Ring(24e-3, 12e-3, 6e-3, 1450.0)
SEGMENTS = {
    "constant": ConstantCurvature(0.11, 0.022),
    "bend": ConstantCurvature(0.05, 1.0, extensible=False),
    "affine": AffineCurvature(0.2),
    "link": Link(0.03),
    "elbow": Link(0.03, offset=[0.01, -0.02, 0.005], orientation=[0.1, 0.5, 0.1, 0.73**0.5]),
    "plate": Link(0.0, offset=[0.01, -0.02, 0.0]),
    "joint": BallJoint("xyz"),
    "universal": BallJoint("xy"),
    "hinge": BallJoint("y"),
    "free": FreeBody(),
}
CHAINS = [(name,) for name in SEGMENTS] + [
    *itertools.permutations(("constant", "link", "affine"), 3),
    ("constant", "hinge", "link"),
    ("joint", "bend", "affine"),
    ("free", "constant"),
    ("elbow", "hinge", "elbow", "constant"),
    ("constant", "constant", "constant"),
]


def chain(names: tuple[str, ...]) -> Robot:
    """A robot of these segments, with magnets, chips and IMUs on all of them and on the base."""
    segments = [SEGMENTS[name] for name in names]
    magnets, sensors, imus = [Magnet(Cube(6e-3, 1300.0), 0, 0.0, [1, 0, 2], [0.06, 0.02, -0.05])], [], []
    sensors.append(Sensor(0, 0.0, position=[0.0, 0.05, -0.04], axes=3, orientation=[0.5, 0.5, 0.5, 0.5]))
    for g, segment in enumerate(segments, 1):
        shape = (RELEASED, Disc(8e-3, 3e-3, 1300.0))[g % 2]
        magnets.append(Magnet(shape, g, 0.4 * segment.length, position=[0.0, 0.004, 0.0]))
        sensors.append(Sensor(g, segment.length, radial=0.05 + 0.01 * g, azimuth=1.1 * g, tilt=0.2))
        imus.append(Imu(g, 0.7 * segment.length, orientation=[0.1, 0.7, 0.1, 0.7]))
    return Robot(segments, magnets, sensors, imus)


def configuration(robot: Robot, share: np.ndarray) -> np.ndarray:
    """A configuration from shares in [-1, 1]: bends and turns of about 1 rad, lengths of some millimetres."""
    sizes = {"delta_x": 0.02, "delta_y": 0.02, "delta_L": 0.006, "x": 0.02, "y": 0.02, "z": 0.02}
    size = [
        1.0 if segment is SEGMENTS["bend"] else sizes.get(name, 1.2)
        for segment in robot.segments
        for name in segment.coordinates
    ]
    return np.array(size) * share


def paper_robot(n_b: int, n_s: int = 3, tilt: float = 0.0) -> Robot:
    """The robot of Baaij et al. 2023, section 3.1."""
    magnets = [Magnet(RELEASED, i, 0.055) for i in range(1, n_b + 1)]
    sensors = [
        Sensor(i, 0.11, radial=0.013, azimuth=k * 2 * np.pi / n_s, tilt=tilt)
        for i in range(1, n_b + 1)
        for k in range(n_s)
    ]
    return Robot([ConstantCurvature(0.11, 0.022)] * n_b, magnets, sensors)


def bounds(n_b: int) -> tuple[np.ndarray, np.ndarray]:
    """The workspace of that robot."""
    return np.tile([-0.02073, -0.02073, 0.0], n_b), np.tile([0.02073, 0.02073, 0.0066], n_b)


def _turn(w: np.ndarray) -> np.ndarray:
    """Rotation matrix of a rotation vector, analytic in complex numbers."""
    x, y, z = w
    W = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    square = x * x + y * y + z * z
    if abs(square) < 1e-6:  # series: the complex step goes through zero
        return np.eye(3) + (1 - square / 6) * W + (0.5 - square / 24) * W @ W
    t = np.sqrt(square + 0j)
    return np.eye(3) + np.sin(t) / t * W + (1 - np.cos(t)) / square * W @ W


def complex_frame(segment, q: np.ndarray, v: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and position of a segment's frame, written down once more for complex numbers and by quadrature."""
    q = np.asarray(q, dtype=complex)
    if isinstance(segment, Link):
        x, y, z = np.zeros(3) if segment.offset is None else segment.offset
        own = (
            np.eye(3) if segment.orientation is None else Rotation.from_quat(segment.orientation).as_matrix()
        )
        return own.astype(complex), v * np.array([x, y, z + segment.length], dtype=complex)
    if isinstance(segment, FreeBody):
        return _turn(q[3:]), q[:3]
    if isinstance(segment, BallJoint):
        w = np.zeros(3, dtype=complex)
        w[["xyz".index(axis) for axis in segment.axes]] = q
        return _turn(w), np.zeros(3, dtype=complex)
    nodes, weights = np.polynomial.legendre.leggauss(30)
    s = v * (nodes + 1) / 2
    if isinstance(segment, AffineCurvature):
        k0, k1, phi, dL = q
        axis, angle = np.array([np.cos(phi), np.sin(phi), 0]), lambda s: k0 * s + k1 * s * s / 2
    else:
        a, b = q[:2] / segment.radius
        axis, angle = np.array([-b, a, 0]), lambda s: s
        dL = q[2] if segment.extensible else 0.0
    tangents = np.stack([_turn(axis * angle(x))[:, 2] for x in s])
    return _turn(axis * angle(v)), (segment.length + dL) * v / 2 * weights @ tangents


def complex_pose(robot: Robot, q: np.ndarray, place) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and position of a place on a robot at a complex configuration."""
    R, p, at = np.eye(3, dtype=complex), np.zeros(3, dtype=complex), 0
    for g, segment in enumerate(robot.segments[: place.segment], 1):
        n = len(segment.coordinates)
        v = place.at / segment.length if g == place.segment and segment.length else 1.0
        T, x = complex_frame(segment, q[at : at + n], v)
        R, p, at = R @ T, p + R @ x, at + n
    return R @ place.rotation, p + R @ place.position


def tips(robot):
    """Return the places at the ends of all segments."""
    return [point_on(g, segment.length) for g, segment in enumerate(robot.segments, 1)]
