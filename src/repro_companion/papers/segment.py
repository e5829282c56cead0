"""One simulated segment that carries the sensors of all three papers: how it moves, what is read, how far off we are.

The segment is that of Baaij et al. 2023. It carries their ring and three sensors, the cube and the Hall sensor of
Mitchell et al. 2021, and an IMU at either end as in Martin et al. 2022. All data are synthetic.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation, Slerp

from repro import (
    AffineCurvature,
    ConstantCurvature,
    Cube,
    FreeBody,
    Imu,
    Magnet,
    Robot,
    Sensor,
    simulated_readings,
)
from repro.estimators.calibration import Tolerances
from repro.robot import point_on
from repro_companion.papers import baaij, martin
from repro_companion.papers.baaij import LENGTH, RADIUS

MOTIONS = ("constant curvature", "affine curvature", "rod under load")
ELEMENTS = 44
NODES = np.linspace(0, LENGTH, ELEMENTS + 1)
"""Where the shape is known: distances along the straight segment [m]."""
RING, CUBE = baaij.RINGS["released"], Cube(6.35e-3, 1320.0)
HALL_AT, APART = 0.0475, 0.015
"""Where the Hall sensor is, and how far beyond it the cube: on either side of the middle [m]."""
CUBE_AT_BASE = APART
"""Where the cube is on a robot that carries ring and cube: in the middle there is no room for both [m]."""
RING_NOISE, HALL_NOISE, HALL_STEP = baaij.NOISE_MT, 0.025, 0.01
"""Noise of the ring's sensors; noise and resolution of the Hall sensor in the takes of Mitchell et al. [mT]."""
ELONGATION = baaij.ELONGATION
"""Elongation that is assumed where nothing sees it: half of the largest of a trajectory [m]."""
FORCE_N, SECTION, MODULUS = 0.5, 0.011, 1e6
"""Sideways force on the tip; radius [m] and Young's modulus [Pa] of the rod, a soft silicone: all assumed."""
IMU_LATENCY_S, IMU_SKEW_S = 0.010, 0.0038
"""Age of a reading, and time from one IMU to the next: assumed."""


# How the segment moves


def motion(name: str, steps: int = baaij.STEPS, force_n: float = FORCE_N) -> np.ndarray:
    """Return poses ``[steps, nodes, 4, 4]`` along the segment, over 10 s."""
    q = baaij.lemniscate(1, steps=steps)
    if name == MOTIONS[2]:
        return rod(q[:, :2] / RADIUS, 1 + q[:, 2] / LENGTH, [force_n, 0.0, 0.0])
    if name == MOTIONS[0]:
        return backbone(baaij.robot(1), q)
    s = np.linspace(0, 1, steps)
    c, turn = (1 - np.cos(6 * math.pi * s)) / 2, 2 * math.pi * s
    flower = [
        c * math.pi / 12,
        math.pi * (0.1 + 0.9 * c) / 3,
        turn,
        q[:, 2],
    ]  # a third of the paper's curvatures
    return backbone(Robot([AffineCurvature(LENGTH)]), np.stack(flower, axis=-1))


def backbone(robot: Robot, q: np.ndarray, every: int = 1) -> np.ndarray:
    """Return poses at every n-th node of a robot of one or more segments that together are as long as ours."""
    n, places = len(robot.segments), []
    for arc in NODES[::every]:
        k = min(int(arc / LENGTH * n + 1e-9), n - 1)
        places.append(point_on(k + 1, arc - k * LENGTH / n))
    return robot.poses(q, places)


def rod(
    bend: np.ndarray, stretch: np.ndarray, force_n: Any, section: float = SECTION, modulus: float = MODULUS
) -> np.ndarray:
    r"""Return poses ``[t, nodes, 4, 4]`` of a Cosserat rod at rest that is clamped and pulled at its tip.

    Its rest shape is an arc by the bend vector ``[t, 2]`` [rad], ``stretch`` ``[t]`` times as long as the rod. In the
    frame of the rod the curvature is off its rest by :math:`K^{-1} R^T (p_\mathrm{tip} - p) \times F` and the strain
    by :math:`S^{-1} R^T F`. We repeat this from the last shape until the shape is its own answer.
    """
    force, h, area = np.asarray(force_n, dtype=float), LENGTH / ELEMENTS, math.pi * section**2
    bending = modulus * area * section**2 / 4 * np.array([1.0, 1.0, 2 / 3])  # incompressible: G = E/3
    stretching = modulus * area * np.array([9 / 28, 9 / 28, 1.0])  # 27/28 of a round section count in shear
    shape, zero = (len(bend), ELEMENTS, 3), np.zeros(len(bend))
    rest_turn = np.stack([-bend[:, 1], bend[:, 0], zero], axis=-1)[:, None] / ELEMENTS
    rest_step = np.stack([zero, zero, h * stretch], axis=-1)[:, None]
    turn, step = np.broadcast_to(rest_turn, shape), np.broadcast_to(rest_step, shape)
    T = np.broadcast_to(np.eye(4), (len(bend), ELEMENTS + 1, 4, 4)).copy()
    element = np.broadcast_to(np.eye(4), (*shape[:2], 4, 4)).copy()
    for _ in range(300):
        half, whole = (
            Rotation.from_rotvec(turn.reshape(-1, 3) * x).as_matrix().reshape(*shape, 3) for x in (0.5, 1.0)
        )
        short = np.sinc(np.linalg.norm(turn, axis=-1, keepdims=True) / (2 * math.pi))  # chord of an arc
        element[..., :3, :3], element[..., :3, 3] = whole, short * (half @ step[..., None])[..., 0]
        for k in range(ELEMENTS):
            T[:, k + 1] = T[:, k] @ element[:, k]
        to_middle = np.swapaxes(T[:, :-1, :3, :3] @ half, -1, -2)
        middle = (T[:, 1:, :3, 3] + T[:, :-1, :3, 3]) / 2
        moment = np.cross(T[:, -1:, :3, 3] - middle, force)
        new_turn = rest_turn + h * (to_middle @ moment[..., None])[..., 0] / bending
        new_step = rest_step + h * (to_middle @ force) / stretching
        change = max(np.abs(new_turn - turn).max(), np.abs(new_step - step).max() / h)
        turn, step = (turn + new_turn) / 2, (step + new_step) / 2
        if change < 1e-12:
            return T
    raise ValueError(
        f"A force of {np.linalg.norm(force):.3g} N is too large for this rod: no shape at rest found."
    )


# Robots with manufacturing errors, and what is read


class Built(NamedTuple):
    """A robot as it was built: magnets and sensors on free bodies, and how its IMUs and their worlds are turned."""

    ring: Robot
    cube: Robot
    at_base: Magnet
    world: Rotation
    mounting: Rotation


class Readings(NamedTuple):
    """Readings of the ring's sensors ``[t, 3]`` and the Hall sensor ``[t, 3]`` [mT], and of the IMUs at base and tip.

    An IMU reads the quaternion XYZW ``[t, 2, 4]`` that turns its own frame to the world.
    """

    ring: np.ndarray
    hall: np.ndarray
    imus: np.ndarray


PLACES = (CUBE_AT_BASE, HALL_AT, baaij.MAGNET_AT, HALL_AT + APART, LENGTH)
"""Where something magnetic is mounted; each place has a free body of its own, numbered from 1."""


def built(rng: np.random.Generator, size: float = 1.0) -> Built:
    """Draw a robot whose parts are off by their tolerances, times ``size``."""
    t, n = Tolerances(), lambda *shape: size * rng.standard_normal(shape)

    def magnet(shape: Any, body: int) -> Magnet:
        shape = replace(shape, polarisation_mt=shape.polarisation_mt * (1 + t.moments * float(n())))
        a, b = t.magnet_tilt * n(2)
        axis = [math.sin(b), -math.sin(a) * math.cos(b), math.cos(a) * math.cos(b)]
        return Magnet(shape, body, 0.0, axis, t.magnet_position * n(3))

    def around_tip(sensor: Sensor) -> Sensor:
        azimuth, radial, tilt, gain = n(4) * [t.sensor_azimuth, t.sensor_radius, t.sensor_tilt, t.sensor_gain]
        own = {"radial": sensor.radial * (1 + radial), "azimuth": sensor.azimuth + azimuth}
        return replace(sensor, segment=5, at=0.0, tilt=sensor.tilt + tilt, gain=1 + gain, **own)

    bodies, drawn = [FreeBody()] * len(PLACES), baaij.robot(1)
    turn = Rotation.from_rotvec(n(3) * [t.sensor_tilt, t.sensor_tilt, t.sensor_azimuth]).as_quat()
    hall = Sensor(2, 0.0, axes=3, orientation=turn, gain=tuple(1 + t.sensor_gain * n(3)))
    ring, cube = magnet(RING, 3), magnet(CUBE, 4)
    errors = martin.Errors()
    world = np.radians([errors.tilt_deg, errors.tilt_deg, errors.heading_deg]) * n(2, 3)
    mounting = np.radians(errors.mounting_deg) * n(2, 3)
    return Built(
        Robot(bodies, [ring], [around_tip(sensor) for sensor in drawn.sensors]),
        Robot(bodies, [cube], [hall]),
        replace(cube, segment=1),
        Rotation.from_rotvec(world),
        Rotation.from_rotvec(mounting),
    )


def read(
    robot: Built, T: np.ndarray, rng: np.random.Generator, size: float = 1.0
) -> tuple[Readings, Readings]:
    """Return what is read along a motion of 10 s, and the same where cube and ring are on board together.

    Errors that vary are multiplied by ``size``; without them nothing is rounded. The latency of the IMUs stays.
    """
    time_s = np.arange(len(T)) * (baaij.STEPS / baaij.RATE_HZ / len(T))
    start, skew = -2 / martin.RATE_HZ - IMU_LATENCY_S, IMU_SKEW_S * np.arange(2)
    rounds = int((time_s[-1] - start) * martin.RATE_HZ) + 1
    seen_s = np.clip(start + np.arange(rounds)[:, None] / martin.RATE_HZ + skew, 0.0, time_s[-1])
    tip = Slerp(time_s, Rotation.from_matrix(T[:, -1, :3, :3]))(seen_s[:, 1])
    imus = _imus(robot, tip, 1 / martin.RATE_HZ, rng, size)
    latest = np.floor((time_s[:, None] - IMU_LATENCY_S - skew - start) * martin.RATE_HZ + 1e-9).astype(int)
    imus = np.stack([imus[latest[:, k], k] for k in range(2)], axis=1)
    both = robot.ring.replaced(magnets=[*robot.ring.magnets, robot.at_base])
    noise = rng.standard_normal((len(T), 6))
    alone, together = (_magnetic(robot._replace(ring=ring), T, noise, size) for ring in (robot.ring, both))
    return Readings(*alone, imus), Readings(*together, imus)


def session(robot: Built, poses: int, rng: np.random.Generator) -> tuple[np.ndarray, Readings]:
    """Return measured poses of the tip ``[poses, 4, 4]`` of arcs, a second apart, and what is read there."""
    T = backbone(baaij.robot(1), rng.uniform(*baaij.bounds(1), (poses, 3)))
    tip = T[:, -1].copy()
    seen = Readings(
        *_magnetic(robot, T, rng.standard_normal((poses, 6)), 1.0),
        _imus(robot, Rotation.from_matrix(tip[:, :3, :3]), 1.0, rng, 1.0),
    )
    turn = Rotation.from_euler("XYZ", baaij.ROTATION * rng.standard_normal((poses, 3)))
    tip[:, :3, :3] = tip[:, :3, :3] @ turn.as_matrix()
    tip[:, :3, 3] += baaij.POSITION * rng.standard_normal((poses, 3))
    return tip, seen


def _magnetic(robot: Built, T: np.ndarray, noise: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return readings of the ring's sensors and the Hall sensor, by magpylib at the true poses."""
    at = [np.broadcast_to(np.eye(4), T[:, 0].shape)] + [
        T[:, round(arc / LENGTH * ELEMENTS)] for arc in PLACES
    ]
    steps = [np.linalg.solve(before, after) for before, after in itertools.pairwise(at)]
    q = [(T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_rotvec()) for T in steps]
    q = np.concatenate([part for pair in q for part in pair], axis=-1)
    ring, hall = (
        one.per_reading("gain", 1.0, 1.0) * simulated_readings(one, q) for one in (robot.ring, robot.cube)
    )
    hall = hall + size * HALL_NOISE * noise[:, 3:]
    hall = np.round(hall / HALL_STEP) * HALL_STEP if size else hall
    return ring + size * RING_NOISE * noise[:, :3], hall


def _imus(
    robot: Built, tip: Rotation, interval_s: float, rng: np.random.Generator, size: float
) -> np.ndarray:
    """Return quaternions ``[t, 2, 4]`` of both IMUs at even intervals: the base stays, the tip turns."""
    errors, ticks, columns = martin.Errors(), interval_s * martin.RATE_HZ, []
    for k, true in enumerate((Rotation.identity(len(tip)), tip)):
        heading = np.radians(errors.heading_wander_deg) * martin.wandering(len(tip), (1,), 40.0 / ticks, rng)
        tilt = np.radians(errors.tilt_deg) * martin.wandering(len(tip), (2,), 3.0 / ticks, rng)
        varying = Rotation.from_rotvec(size * np.concatenate([tilt, heading], axis=-1))
        columns.append((varying * robot.world[k] * true * robot.mounting[k]).as_quat())
    q = np.stack(columns, axis=1)
    return np.round(q * 2.0**14) / 2.0**14 if size else q  # datasheet BST-BNO055-DS000


# What estimators know, and how far off they are


class Known(NamedTuple):
    """What is known of one robot.

    Magnet and sensors of the ring stand in a robot; the transverse field at the Hall sensor is ``matrix`` times the
    nominal field plus ``offset``; IMUs read ``world`` times their orientation times ``mounting``.
    """

    ring: Robot
    matrix: np.ndarray
    offset: np.ndarray
    world: Rotation
    mounting: Rotation
    imu_noise: np.ndarray
    """Error of the tip's orientation as seen from the base, about each axis [rad]: what the design expects."""


def nominal() -> Known:
    """Return what the drawing says."""
    return Known(
        baaij.robot(1), np.eye(2), np.zeros(2), Rotation.identity(2), Rotation.identity(2), imu_noise(False)
    )


def imu_noise(calibrated: bool) -> np.ndarray:
    """Return the assumed errors of two IMUs together about each axis [rad]; constant ones go by calibration."""
    errors = martin.Errors()
    varying = np.array([errors.tilt_deg, errors.tilt_deg, errors.heading_wander_deg])
    constant = np.hypot([errors.tilt_deg, errors.tilt_deg, errors.heading_deg], errors.mounting_deg)
    return np.radians(math.sqrt(2) * (varying if calibrated else np.hypot(varying, constant)))


def of_arcs(robot: Robot, arcs: int) -> Robot:
    """Return the robot as one arc or as two with the ring between them, with bounds and an IMU at its tip.

    Of two arcs the first has its elongation fixed: no magnetic sensor sees it.
    """
    bend, longer, piece = RADIUS * math.pi / 2, ELONGATION / arcs, LENGTH / arcs
    low, high = [-bend, -bend, 0.0], [bend, bend, 6.6e-3 / arcs]
    fixed = [[-bend, -bend, longer], [bend, bend, longer]]
    magnets = [replace(magnet, segment=1) for magnet in robot.magnets]
    sensors = [replace(sensor, segment=arcs, at=piece) for sensor in robot.sensors]
    return Robot(
        [ConstantCurvature(piece, RADIUS)] * arcs, magnets, sensors, [Imu(arcs, piece)], moments=robot.moments,
        lower=[*fixed[0][: 3 * (arcs - 1)], *low], upper=[*fixed[1][: 3 * (arcs - 1)], *high],
        start=[0.0, 0.0, longer] * arcs,
    )  # fmt: skip


CONDITIONS = ("all sensors", "one sensor failed", "other magnet on board")
QUANTITIES = ("tip_mm", "orientation_deg", "shape_mm")
PARTS = {
    "ring and 3 sensors": {"ring": 3},
    "cube and Hall sensor, middle": {"hall": 1},
    "2 IMUs": {"imus": 2},
    "ring and IMUs, one arc": {"ring": 3, "imus": 2},
    "ring and IMUs, two arcs": {"ring": 3, "imus": 2},
}
"""Methods, and how many sensors each has to lose."""
EVERY = 4
"""Shapes are compared at every fourth node, every 10 mm."""

Shape = tuple[np.ndarray, np.ndarray]
"""Points ``[t, 12, 3]`` [m] along the segment, and how the tip is turned ``[t, 3, 3]``."""


Estimator = Callable[[list[tuple[Known, Readings]]], Sequence[Shape]]
"""From what is known and what is read, of all runs, to their shapes."""


class Run(NamedTuple):
    """One robot on one trajectory: what is known, what is read, the same with the other magnet, and the truth."""

    trajectory: str
    calibrated: bool
    draw: int
    known: Known
    seen: Readings
    together: Readings
    T: np.ndarray


def runs(
    calibrated: Callable[[np.ndarray, Readings], Known],
    trajectories: Mapping[str, np.ndarray],
    draws: int,
    poses: int,
    seed: int = 0,
) -> list[Run]:
    """Return all robots on all trajectories, calibrated and as drawn; a robot's noise is the same on each of them."""
    found = []
    for draw in range(draws):
        rng = np.random.default_rng([seed, draw])
        robot = built(rng)
        known = calibrated(*session(robot, poses, rng))
        for name, T in trajectories.items():
            seen = read(robot, T, np.random.default_rng([seed, draw, 1]))
            found += [Run(name, True, draw, known, *seen, T), Run(name, False, draw, nominal(), *seen, T)]
    return found


def shape(robot: Robot, q: np.ndarray) -> Shape:
    """Return the shape of configurations."""
    T = backbone(robot, q, EVERY)
    return T[..., :3, 3], T[..., -1, :3, :3]


def shape_errors(found: Shape, T: np.ndarray) -> dict[str, float]:
    """Return the root mean squares over time of the errors at the tip, of its orientation, and along the segment."""
    points, tip = found
    squares = ((points - T[:, ::EVERY, :3, 3]) ** 2).sum(-1)
    angles = Rotation.from_matrix(np.swapaxes(T[:, -1, :3, :3], -1, -2) @ tip).magnitude()
    rms = math.degrees(math.sqrt((angles**2).mean()))
    values = 1e3 * math.sqrt(squares[:, -1].mean()), rms, 1e3 * math.sqrt(squares.mean())
    return dict(zip(QUANTITIES, values, strict=True))


def without(seen: Readings, part: str, k: int) -> Readings:
    """Return readings without one sensor: one of the ring's sensors, the whole Hall sensor, or one IMU."""
    found = getattr(seen, part).copy()
    found[:, slice(None) if part == "hall" else k] = np.nan
    return seen._replace(**{part: found})


def one_by_one(estimator: Callable[[Known, Readings], Shape]) -> Estimator:
    """Return an estimator of all runs from an estimator of one."""
    return lambda some: [estimator(*one) for one in some]


def errors(
    runs: Sequence[Run],
    estimators: Mapping[str, Estimator],
) -> pd.DataFrame:
    """Return the errors of every method in every run: with all sensors, without one of them, with the other magnet.

    Mishaps happen to calibrated robots. The sensor that is missing is the one that costs most, for each quantity by
    itself. The field of the cube is in no model, and we let it reach the ring's sensors only.
    """
    lines = []
    known = [run for run in runs if run.calibrated]
    for method, estimator in estimators.items():
        lost = [(part, k) for part, n in PARTS[method].items() for k in range(n)]
        cases = [
            (CONDITIONS[0], runs, [[run.seen for run in runs]]),
            (CONDITIONS[1], known, [[without(run.seen, *one) for run in known] for one in lost]),
        ]
        if method == "ring and 3 sensors":
            cases.append((CONDITIONS[2], known, [[run.together for run in known]]))
        for condition, some, variants in cases:
            pairs = [[(run.known, seen) for run, seen in zip(some, own, strict=True)] for own in variants]
            for run, *shapes in zip(some, *map(estimator, pairs), strict=True):
                worst = pd.DataFrame([shape_errors(one, run.T) for one in shapes]).max().to_dict()
                key = {"trajectory": run.trajectory, "method": method, "calibrated": run.calibrated}
                lines.append({**key, "condition": condition, "draw": run.draw, **worst})
    return pd.DataFrame(lines)


def _resampled(draws: int) -> np.ndarray:
    return np.random.default_rng(0).integers(draws, size=(2000, draws))


def mean_errors(table: pd.DataFrame) -> pd.DataFrame:
    """Return the mean tip error over the robots with the ends of its bootstrap interval (95 %)."""
    lines = []
    keys = ["trajectory", "method", "calibrated", "condition"]
    for key, part in table.groupby(keys, sort=False):
        tip = part["tip_mm"].to_numpy()
        low, high = np.quantile(tip[_resampled(len(tip))].mean(-1), [0.025, 0.975])
        line = dict(zip(keys, key, strict=True))
        lines.append({**line, "tip_mm": tip.mean(), "low_mm": low, "high_mm": high})
    return pd.DataFrame(lines)


def ratios(table: pd.DataFrame, over: str = "2 IMUs") -> pd.DataFrame:
    """Return how many times the tip error of one method the calibrated others have; paired over the robots."""
    chosen = table[table["calibrated"] & (table["condition"] == CONDITIONS[0])]
    lines = []
    for name, part in chosen.groupby("trajectory", sort=False):
        tips = part.pivot(index="draw", columns="method", values="tip_mm")
        again = _resampled(len(tips))
        for method in [method for method in part["method"].unique() if method != over]:
            above, below = tips[method].to_numpy(), tips[over].to_numpy()
            low, high = np.quantile(above[again].mean(-1) / below[again].mean(-1), [0.025, 0.975])
            lines.append((name, method, above.mean() / below.mean(), low, high))
    return pd.DataFrame(lines, columns=["trajectory", "method", "ratio", "low", "high"])


def still(run: Run, found: Mapping[str, Shape]) -> pd.DataFrame:
    """Return truth and estimates [mm] at the moment at which all of them together are farthest off at the tip."""
    T, names = run.T[:, ::EVERY, :3, 3], list(found)
    off = sum(np.linalg.norm(found[name][0][:, -1] - T[:, -1], axis=-1) for name in names)
    k = int(np.argmax(off))
    lines = {"truth": T[k], **{name: found[name][0][k] for name in names}}
    frames = [
        pd.DataFrame(1e3 * xyz, columns=["x_mm", "y_mm", "z_mm"]).assign(line=name)
        for name, xyz in lines.items()
    ]
    return pd.concat(frames, ignore_index=True)
