"""One simulated segment with the sensors of each of the three papers: how it moves, what is read, how far off we are.

The segment of Baaij et al. 2023 carries, one set at a time, their ring and three sensors, the cube and the Hall
sensor of Mitchell et al. 2021, and an IMU at each end as in Martin et al. 2022. All data are synthetic.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from repro import (
    AffineCurvature,
    BendSensor,
    ConstantCurvature,
    Cube,
    FreeBody,
    Imu,
    Magnet,
    Ring,
    Robot,
    Sensor,
    calibrate,
    simulated_readings,
)
from repro.chain import point_on
from repro.tolerances import Tolerances
from repro_companion.papers import baaij, martin
from repro_companion.papers.baaij import ELONGATION, LENGTH, RADIUS
from repro_companion.show import mean_ratio, number, sentences

MOTIONS = ("constant curvature", "affine curvature", "rod under load")
ELEMENTS = 44
NODES = np.linspace(0, LENGTH, ELEMENTS + 1)
"""Where the shape is known: distances along the straight segment [m]."""
HALL_AT, APART = 0.0475, 0.015
"""Where the Hall sensor is, and how far beyond it the cube: on either side of the middle [m]."""
RING_NOISE, HALL_NOISE, HALL_STEP = baaij.NOISE_MT, 0.025, 0.01
"""Noise of the ring's sensors; noise and resolution of the Hall sensor in the takes of Mitchell et al. [mT]."""
FORCE_N, SECTION, MODULUS = 0.5, 0.011, 1e6
"""Sideways force on the tip; radius [m] and Young's modulus [Pa] of the rod, a soft silicone: all assumed."""
IMU_NOISE = math.sqrt(2) * np.radians([1.0, 1.0, 2.0])
"""Errors of two IMUs that vary: tilt and heading of one as seen from the other [rad]."""


SEEN_BY_HALL = BendSensor(APART * (1 + ELONGATION / LENGTH))
"""The Hall sensor beside its cube, at the mean elongation."""


# How the segment moves


def motion(name: str, steps: int = baaij.STEPS, force_n: float = FORCE_N) -> np.ndarray:
    """Return poses ``[steps, nodes, 4, 4]`` along the segment, over 10 s."""
    q = baaij.lemniscate(1, steps=steps)
    if name == MOTIONS[2]:
        return rod(q[:, :2] / RADIUS, 1 + q[:, 2] / LENGTH, [force_n, 0.0, 0.0])
    if name == MOTIONS[0]:
        return backbone(baaij.robot(1), q)
    turn = np.linspace(0, 2 * math.pi, steps)
    c = (1 - np.cos(3 * turn)) / 2
    flower = [c * math.pi / 12, math.pi * (0.1 + 0.9 * c) / 3, turn, q[:, 2]]  # 1/3 of the paper's
    return backbone(Robot([AffineCurvature(LENGTH)]), np.stack(flower, axis=-1))


def backbone(robot: Robot, q: np.ndarray, every: int = 1) -> np.ndarray:
    """Return poses at every n-th node of a robot of one or more segments that together are as long as ours."""
    n, arcs = len(robot.segments), NODES[::every]
    before = np.minimum((arcs / LENGTH * n + 1e-9).astype(int), n - 1)
    places = [point_on(k + 1, arc - k * LENGTH / n) for k, arc in zip(before, arcs, strict=True)]
    return robot.poses(q, places)


def rod(
    bend: np.ndarray,
    stretch: np.ndarray,
    force_n: ArrayLike,
    section: float = SECTION,
    modulus: float = MODULUS,
) -> np.ndarray:
    r"""Return poses ``[t, nodes, 4, 4]`` of a Cosserat rod at rest that is clamped and pulled at its tip.

    Its rest shape is an arc by the bend vector ``[t, 2]`` [rad], ``stretch`` ``[t]`` times as long as the rod. In the
    frame of the rod the curvature is off its rest by :math:`K^{-1} R^T (p_\mathrm{tip} - p) \times F` and the strain
    by :math:`S^{-1} R^T F`. We repeat this from the last shape until the shape is its own answer.
    """
    force, shape, zero = np.asarray(force_n, dtype=float), (len(bend), ELEMENTS, 3), np.zeros(len(bend))
    h, axial = LENGTH / ELEMENTS, modulus * math.pi * section**2
    bending = axial * section**2 / 4 * np.array([1.0, 1.0, 2 / 3])  # incompressible: G = E/3
    stretching = axial * np.array([9 / 28, 9 / 28, 1.0])  # 27/28 of a round section count in shear
    rest = np.stack([-bend[:, 1], bend[:, 0], zero], axis=-1)[:, None] / ELEMENTS
    turn = np.broadcast_to(rest, shape)
    step = rest_step = h * np.stack([zero, zero, stretch], axis=-1)[:, None]
    T = np.broadcast_to(np.eye(4), (len(bend), ELEMENTS + 1, 4, 4)).copy()
    element = T[:, 1:].copy()
    for _ in range(300):
        half = Rotation.from_rotvec(turn.reshape(-1, 3) / 2)
        short = np.sinc(np.linalg.norm(turn, axis=-1, keepdims=True) / (2 * math.pi))  # chord of an arc
        to_end = half.as_matrix().reshape(*shape, 3)
        element[..., :3, :3] = (half * half).as_matrix().reshape(*shape, 3)
        element[..., :3, 3] = short * (to_end @ step[..., None])[..., 0]
        for k in range(ELEMENTS):
            T[:, k + 1] = T[:, k] @ element[:, k]
        to_middle = np.swapaxes(T[:, :-1, :3, :3] @ to_end, -1, -2)
        moment = np.cross(T[:, -1:, :3, 3] - (T[:, 1:, :3, 3] + T[:, :-1, :3, 3]) / 2, force)
        change = rest + h * (to_middle @ moment[..., None])[..., 0] / bending - turn
        strained = rest_step + h * (to_middle @ force) / stretching
        off = max(np.abs(change).max(), np.abs(strained - step).max() / h)
        turn, step = turn + change / 2, strained
        if off < 1e-12:
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


PLACES = (APART, HALL_AT, baaij.MAGNET_AT, HALL_AT + APART, LENGTH)
"""Where something magnetic is mounted; each place has a free body of its own, numbered from 1.

The cube is at the first one if it is on board together with the ring: in the middle there is no room for both.
"""


def built(rng: np.random.Generator, size: float = 1.0) -> Built:
    """Draw a robot whose parts are off by their tolerances, times ``size``."""
    t, n = Tolerances(), lambda *shape: size * rng.standard_normal(shape)

    def magnet(shape: Ring | Cube, body: int) -> Magnet:
        shape = replace(shape, polarisation_mt=shape.polarisation_mt * (1 + t.moments * float(n())))
        a, b = t.magnet_tilt * n(2)
        axis = [math.sin(b), -math.sin(a) * math.cos(b), math.cos(a) * math.cos(b)]
        return Magnet(shape, body, 0.0, axis, t.magnet_position * n(3))

    def around_tip(sensor: Sensor) -> Sensor:
        azimuth, radial, tilt, gain = n(4) * [t.sensor_azimuth, t.sensor_radius, t.sensor_tilt, t.sensor_gain]
        return Sensor(
            5, 0.0, sensor.radial * (1 + radial), sensor.azimuth + azimuth, sensor.tilt + tilt, gain=1 + gain
        )

    bodies = [FreeBody()] * len(PLACES)
    turn = Rotation.from_rotvec(n(3) * [t.sensor_tilt, t.sensor_tilt, t.sensor_azimuth])
    hall = Sensor(2, 0.0, axes=3, orientation=turn.as_quat(), gain=tuple(1 + t.sensor_gain * n(3)))
    ring, cube = magnet(baaij.RINGS["released"], 3), magnet(Cube(6.35e-3, 1320.0), 4)
    return Built(
        Robot(bodies, [ring], [around_tip(sensor) for sensor in baaij.robot(1).sensors]),
        Robot(bodies, [cube], [hall]),
        replace(cube, segment=1),
        Rotation.from_rotvec(np.radians([1.0, 1.0, 6.0]) * n(2, 3)),
        Rotation.from_rotvec(np.radians(3.0) * n(2, 3)),
    )


def read(
    robot: Built, T: np.ndarray, rng: np.random.Generator, size: float = 1.0
) -> tuple[Readings, Readings]:
    """Return what is read along a motion of 10 s, and the same where cube and ring are on board together.

    Errors that vary are multiplied by ``size``; without them nothing is rounded. The latency of the IMUs stays.
    """
    time_s = np.arange(len(T)) * (baaij.STEPS / baaij.RATE_HZ / len(T))
    seen_s = np.arange(-2, time_s[-1] * martin.RATE_HZ) / martin.RATE_HZ  # when what is read was true
    tip = Slerp(time_s, Rotation.from_matrix(T[:, -1, :3, :3]))(np.maximum(seen_s, 0.0))
    latest = np.searchsorted(seen_s + martin.LATENCY_S, time_s + 1e-9) - 1
    imus = _imus(robot, tip, 1 / martin.RATE_HZ, rng, size)[latest]
    noise = rng.standard_normal((len(T), 6))
    rings = robot.ring, robot.ring.replaced(magnets=[*robot.ring.magnets, robot.at_base])
    alone, together = (_magnetic(robot._replace(ring=ring), T, noise, size) for ring in rings)
    return Readings(*alone, imus), Readings(*together, imus)


def session(robot: Built, poses: int, rng: np.random.Generator) -> tuple[np.ndarray, Readings]:
    """Return measured poses of the tip ``[poses, 4, 4]`` of arcs, a second apart, and what is read there."""
    T = backbone(baaij.robot(1), rng.uniform(*baaij.bounds(1), (poses, 3)))
    tip = np.copy(T[:, -1])
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
    q = np.hstack([x for T in steps for x in (T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_rotvec())])
    ring, hall = (
        one.per_reading("gain", 1.0, 1.0) * simulated_readings(one, q) for one in (robot.ring, robot.cube)
    )
    hall = hall + size * HALL_NOISE * noise[:, 3:]
    return ring + size * RING_NOISE * noise[:, :3], np.round(hall / HALL_STEP) * HALL_STEP if size else hall


def _imus(
    robot: Built, tip: Rotation, interval_s: float, rng: np.random.Generator, size: float
) -> np.ndarray:
    """Return quaternions ``[t, 2, 4]`` of both IMUs at even intervals: the base stays, the tip turns."""
    ticks, columns = (
        interval_s * martin.RATE_HZ,
        [],
    )  # steps of a wandering error are those of the IMUs' own rate
    for k, true in enumerate((Rotation.identity(len(tip)), tip)):
        heading = np.radians(2.0) * martin.wandering(len(tip), (1,), 40.0 / ticks, rng)
        tilt = np.radians(1.0) * martin.wandering(len(tip), (2,), 3.0 / ticks, rng)
        varying = Rotation.from_rotvec(size * np.concatenate([tilt, heading], axis=-1))
        q = (varying * robot.world[k] * true * robot.mounting[k]).as_quat()
        columns.append(np.round(q * 2.0**14) / 2.0**14 if size else q)  # datasheet BST-BNO055-DS000
    return np.stack(columns, axis=1)


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


def nominal() -> Known:
    """Return what the drawing says."""
    return Known(baaij.robot(1), np.eye(2), np.zeros(2), Rotation.identity(2), Rotation.identity(2))


def fixed_coordinates(seen: Readings) -> np.ndarray:
    """Return what the ring's coordinates are fixed at, NaN if free: two readings do not tell all three."""
    return np.array([np.nan, np.nan, ELONGATION if np.isnan(seen.ring).any() else np.nan])


def orientations(known: Known, seen: Readings) -> tuple[Rotation, Rotation]:
    """Return how base and tip are turned: the base upright without its IMU, the tip as the base without the other."""
    missing = np.isnan(seen.imus).any(axis=(0, 2))
    imus = [Rotation.from_quat(np.nan_to_num(seen.imus[:, k], nan=0.5)) for k in range(2)]
    ends = [known.world[k].inv() * imu * known.mounting[k].inv() for k, imu in enumerate(imus)]
    base = Rotation.identity(len(seen.imus)) if missing[0] else ends[0]
    return base, base if missing[1] else ends[1]


def turn_of_tip(known: Known, seen: Readings) -> np.ndarray:
    """Return the rotation vector ``[t, 3]`` of the tip as seen from the base, NaN without the IMU at the tip."""
    base, tip = orientations(known, seen)
    return np.where(np.isnan(seen.imus[:, 1]).any(), np.nan, (base.inv() * tip).as_rotvec())


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


KEYS = ["trajectory", "method", "calibrated", "condition"]
CONDITIONS = ("all sensors", "one sensor failed", "other magnet on board")
PARTS = {
    "ring and 3 sensors": {"ring": 3},
    "cube and Hall sensor, middle": {"hall": 1},
    "2 IMUs": {"imus": 2},
    "ring and IMUs, one arc": {"ring": 3, "imus": 2},
    "ring and IMUs, two arcs": {"ring": 3, "imus": 2},
}
"""Methods, and how many sensors each has to lose."""
EVERY, RESAMPLES = 4, 2000
"""Shapes are compared at every fourth node, every 10 mm; resamples of a bootstrap interval."""

Shape = tuple[np.ndarray, np.ndarray]
"""Points ``[t, 12, 3]`` [m] along the segment, and how the tip is turned ``[t, 3, 3]``."""


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
        robot = built(rng := np.random.default_rng([seed, draw]))
        models = {True: calibrated(*session(robot, poses, rng)), False: nominal()}
        for name, T in trajectories.items():
            seen = read(robot, T, np.random.default_rng([seed, draw, 1]))
            found += [Run(name, known, draw, model, *seen, T) for known, model in models.items()]
    return found


def shape(robot: Robot, q: np.ndarray) -> Shape:
    """Return the shape of configurations."""
    T = backbone(robot, q, EVERY)
    return T[..., :3, 3], T[..., -1, :3, :3]


def across(known: Known, seen: Readings) -> np.ndarray:
    """Return what the Hall sensor reads ``[t, 3]`` [mT] as the nominal one would; NaN along the body."""
    u = (seen.hall[:, :2] - known.offset) @ np.linalg.inv(known.matrix).T
    return np.insert(u, 2, np.nan, axis=-1)


def calibrated(tips: np.ndarray, seen: Readings) -> Known:
    """Return what is known of a robot from readings in poses of which the tip ``[t, 4, 4]`` is measured."""
    drawn = baaij.robot(1)
    q, covariance = baaij.configurations(drawn, tips[:, None])
    ring = calibrate(drawn, q, seen.ring, RING_NOISE, covariance)
    field = SEEN_BY_HALL(q[:, :2] * APART / LENGTH / RADIUS)[:, :2]
    columns = np.column_stack([field, np.ones(len(field))])
    fitted = np.linalg.lstsq(columns, seen.hall[:, :2], rcond=None)[0]
    base, tip = (Rotation.from_quat(seen.imus[:, k]) for k in range(2))
    true = Rotation.from_matrix(tips[:, :3, :3])
    world = mounting = Rotation.identity()
    for _ in range(20):  # each with the other one held
        world = (tip * (true * mounting).inv()).mean()
        mounting = ((world * true).inv() * tip).mean()
    worlds = Rotation.concatenate([base.mean(), world])
    mountings = Rotation.concatenate([Rotation.identity(), mounting])
    return Known(ring.robot, fitted[:2].T, fitted[2], worlds, mountings)


def each(
    method: Callable[..., Shape], **given: int
) -> Callable[[Sequence[tuple[Known, Readings]]], list[Shape]]:
    """Return a method of one run as one of many, with what else it is given."""
    return lambda runs: [method(*run, **given) for run in runs]


def shape_errors(found: Shape, T: np.ndarray) -> dict[str, float]:
    """Return the root mean squares over time of the errors at the tip, of its orientation, and along the segment."""
    squares = ((found[0] - T[:, ::EVERY, :3, 3]) ** 2).sum(-1)
    angles = Rotation.from_matrix(np.swapaxes(T[:, -1, :3, :3], -1, -2) @ found[1]).magnitude()
    means = [1e6 * squares[:, -1].mean(), (np.degrees(angles) ** 2).mean(), 1e6 * squares.mean()]
    return dict(zip(("tip_mm", "orientation_deg", "shape_mm"), np.sqrt(means), strict=True))


def without(seen: Readings, part: str, k: int) -> Readings:
    """Return readings without one sensor: one of the ring's sensors, the whole Hall sensor, or one IMU."""
    found = getattr(seen, part).copy()
    found[:, slice(None) if part == "hall" else k] = np.nan
    return seen._replace(**{part: found})


def errors(
    runs: Sequence[Run],
    estimators: Mapping[str, Callable[[list[tuple[Known, Readings]]], Sequence[Shape]]],
) -> pd.DataFrame:
    """Return the errors of every method in every run: with all sensors, without one of them, with the other magnet.

    Mishaps happen to calibrated robots. The sensor that is missing is the one that costs most, for each quantity by
    itself. The field of the cube is in no model, and we let it reach the ring's sensors only.
    """
    lines, known = [], [run for run in runs if run.calibrated]
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
                key = (run.trajectory, method, run.calibrated, condition, run.draw)
                lines.append({**dict(zip([*KEYS, "draw"], key, strict=True)), **worst})
    return pd.DataFrame(lines)


def mean_errors(table: pd.DataFrame) -> pd.DataFrame:
    """Return the mean tip error over the robots with the ends of its bootstrap interval (95 %)."""
    wide = table.pivot_table(index=KEYS, columns="draw", values="tip_mm", sort=False)
    found = mean_ratio(wide.to_numpy().T, 1.0, RESAMPLES)
    return pd.DataFrame(found.T, wide.index, columns=["tip_mm", "low_mm", "high_mm"]).reset_index()


def ratios(table: pd.DataFrame) -> pd.DataFrame:
    """Return how many times the tip error of the IMUs the other methods have, calibrated; paired over the robots."""
    over, healthy = "2 IMUs", table[table["calibrated"] & (table["condition"] == CONDITIONS[0])]
    wide = healthy.pivot_table(index=KEYS[:2], columns="draw", values="tip_mm", sort=False)
    below = wide.xs(over, level=1).loc[wide.index.get_level_values(0)]
    found = mean_ratio(wide.to_numpy().T, below.to_numpy().T, RESAMPLES)
    ratio = pd.DataFrame(found.T, wide.index, columns=["ratio", "low", "high"])
    return ratio.drop(over, level=1).reset_index()


def straight_errors(motions: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """Return the error at the tip [mm] of a guess that always says "straight", by motion."""
    errors = {}
    for name, T in motions.items():
        rest = shape(baaij.robot(1), np.tile([0.0, 0.0, ELONGATION], (len(T), 1)))
        errors[name] = [shape_errors(rest, T)["tip_mm"]]
    return pd.DataFrame(errors)


# What the page says

RING, CUBE, IMUS, ONE, TWO = PARTS
ARC, AFFINE, LOAD = MOTIONS
HEALTHY, FAILED, BESIDE = CONDITIONS
SHORT = {RING: "ring", CUBE: "cube", IMUS: "IMUs", ONE: "both (one arc)", TWO: "both (two arcs)"}
HOW = {
    RING: "build the ring",
    IMUS: "take the IMUs",
    TWO: "read ring and IMUs together with a shape of two arcs",
}
NAMES = {RING: "the ring", IMUS: "the IMUs", TWO: "ring and IMUs with two arcs"}
TABLE = {
    "arc": (ARC, True, HEALTHY),
    "affine": (AFFINE, True, HEALTHY),
    "load": (LOAD, True, HEALTHY),
    "arc, one sensor missing": (ARC, True, FAILED),
    "arc, not calibrated": (ARC, False, HEALTHY),
}
"""Columns of the page's table: how the segment moves, whether the robot is calibrated, and what happens."""


def by_method(means: pd.DataFrame, straight: pd.DataFrame) -> pd.DataFrame:
    """Return errors at the tip [mm] by method, and those of the guess without sensors."""
    of = means.set_index(["trajectory", "calibrated", "condition", "method"])["tip_mm"].sort_index()
    table = pd.DataFrame({name: of[key] for name, key in TABLE.items()}).loc[list(PARTS)]
    table.loc["no sensor, straight"] = [*straight.iloc[0], np.nan, np.nan]
    return table.rename_axis("sensors").reset_index()


def best_first(
    means: pd.DataFrame,
    methods: Sequence[str],
    at: str = ARC,
    calibrated: bool = True,
    condition: str = HEALTHY,
) -> pd.DataFrame:
    """Return mean errors with their intervals in one situation, the smallest first."""
    here = (
        (means["trajectory"] == at) & (means["calibrated"] == calibrated) & (means["condition"] == condition)
    )
    return means[here].set_index("method").loc[list(methods)].sort_values("tip_mm")


SITUATIONS = {
    "true arc, calibrated": ((RING, IMUS), {}),
    "load at the tip, calibrated": ((TWO, IMUS, RING), {"at": LOAD}),
    "load, only one kind of sensor": ((IMUS, RING), {"at": LOAD}),
    "load, not calibrated": ((IMUS, RING), {"at": LOAD, "calibrated": False}),
    "true arc, not calibrated": ((IMUS, RING), {"calibrated": False}),
    "true arc, a sensor fails": ((ONE, TWO, RING, IMUS), {"condition": FAILED}),
}
"""Methods that can be taken in each situation, and the situation."""


def take(means: pd.DataFrame, words: str) -> tuple[str, str]:
    """Return what to take in a situation, both of the first two if their intervals overlap, and all errors [mm]."""
    methods, how = SITUATIONS[words]
    own = best_first(means, methods, **how)
    clear = own["high_mm"].iloc[0] < own["low_mm"].iloc[1]
    best = " or ".join(SHORT[name] for name in own.index[: 1 if clear else 2])
    return best, "; ".join(f"{SHORT[name]} {number(error, 2)}" for name, error in own["tip_mm"].items())


def situations(means: pd.DataFrame) -> pd.DataFrame:
    """Return which sensors to take in which situation."""
    beside, alone = (
        number(best_first(means, [RING], condition=x)["tip_mm"].iloc[0], 2) for x in (BESIDE, HEALTHY)
    )
    rows = [(words, *take(means, words)) for words in SITUATIONS]
    rows.append((
        "true arc, unknown magnet near the base", "ring, magnet kept away",
        f"ring {beside}; without the magnet {alone}",
    ))  # fmt: skip
    return pd.DataFrame(rows, columns=["situation", "take", "error at the tip [mm]"])


IN_SHORT = """
**In short.** If your segment bends as a true arc and you calibrate it, {{ how[arc.index[0]] }}
({{ mm[arc.index[0]] }} at the tip). If something pulls at it, here with {{ "%g" | format(force) }} N sideways at the
tip, {{ how[best] }} ({{ pulled[best] }}, against {{ pulled[second] }} for {{ names[second] }} and {{ pulled[third] }}
for {{ names[third] }}).
{% if turn %}
The choice turns at about {{ turn }} N, a load that moves the straight tip by {{ moved }} mm: below it the ring alone
is better.
{% endif %}
If it is not calibrated and bends as an arc, take {{ bare }}, and if something pulls at it,
take {{ bare_pulled }}.
"""


def _in_mm(table: pd.DataFrame) -> dict[str, str]:
    """Return errors by method, with their unit."""
    return {name: f"{number(error, 2)} mm" for name, error in table["tip_mm"].items()}


def in_words(means: pd.DataFrame, force_n: float) -> str:
    """Return which sensors to take, in a paragraph."""
    arc, load = best_first(means, [RING, IMUS]), best_first(means, [RING, IMUS, TWO], at=LOAD)
    best, second, third = load.index
    turns = best == TWO and arc.index[0] == RING
    # the ring's error grows in proportion to the load, the error of two arcs hardly does
    turn = abs(force_n) * load.loc[TWO, "tip_mm"] / load.loc[RING, "tip_mm"] if turns else 0.0
    moved = 1e3 * turn * LENGTH**3 / (3 * MODULUS * math.pi * SECTION**4 / 4)
    return sentences(
        IN_SHORT, how=HOW, names=NAMES, arc=arc, mm=_in_mm(arc), pulled=_in_mm(load), force=abs(force_n),
        turn=number(turn, 1) if turns else "", moved=f"{moved:.0f}",
        best=best, second=second, third=third,
        bare=take(means, "true arc, not calibrated")[0], bare_pulled=take(means, "load, not calibrated")[0],
    )  # fmt: skip


MISSING = """
{% if better %}
With a sensor missing, the two-arc method is better than with all ({{ lost }} against {{ all }}). If the base
IMU is lost, its error is lost with it, because the base stands still. If another sensor is lost, the method goes back
to one arc, which here is the true shape.
{% endif %}
"""


def missing_in_words(means: pd.DataFrame) -> str:
    """Return why the method with two arcs may gain from a loss; nothing if it does not."""
    lost, all_ = (best_first(means, [TWO], condition=x)["tip_mm"].iloc[0] for x in (FAILED, HEALTHY))
    in_mm = {name: f"{number(error, 2)} mm" for name, error in (("lost", lost), ("all", all_))}
    return sentences(MISSING, better=lost < all_, **in_mm)


TOGETHER = """
{{ "More sensors do not help if the shape is wrong." if hurts }}
With *one* arc, ring and IMUs together have {{ one[0] | fixed(1) }} times the error of the IMUs alone on the affine
curvature, and {{ one[1] | fixed(1) }} times under the load.
{{ "The ring's sensors have so little noise that least squares believes them." if hurts }}
With *two* arcs they have {{ (100 * two[0]) | fixed(0) }} % of the error of the IMUs on the affine curvature, and
{{ (100 * two[1]) | fixed(0) }} % under the load.
{% if as_ring %}
Under a load, losing the IMU at the tip costs the advantage: ring and IMUs then have {{ lost }}, as a ring with all
its sensors has.
{% endif %}
"""


def together_in_words(means: pd.DataFrame, ratios: pd.DataFrame) -> str:
    """Return what it gains or costs to read ring and IMUs together."""
    ratio = ratios.set_index(["method", "trajectory"])["ratio"]
    one, two = ([ratio[name, at] for at in (AFFINE, LOAD)] for name in (ONE, TWO))
    lost = best_first(means, [TWO], at=LOAD, condition=FAILED)["tip_mm"].iloc[0]
    ring = best_first(means, [RING], at=LOAD)["tip_mm"].iloc[0]
    as_ring = two[1] < 1 and abs(lost - ring) < 1e-3
    lost = f"{number(lost, 2)} mm"
    return sentences(TOGETHER, one=one, two=two, lost=lost, as_ring=as_ring, hurts=min(one) > 1.2)
