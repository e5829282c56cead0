r"""How many sensors a robot needs: bounds of magnetic sensors by their information, and a rule for IMUs.

**Magnets.** Readings with the slopes :math:`J` and white noise :math:`\sigma` carry the information
:math:`J^T J/\sigma^2`. Its inverse is the Cramér-Rao bound: no unbiased estimate from one set of readings has a
smaller covariance. All data are synthetic, by magpylib.

**IMUs.** Between perfect IMUs, a model of the arm is off because it does not know how the arm bends there. The arm
has the length :math:`L` and does not stretch. Its curvature is at most :math:`\kappa`, and the derivative of the
curvature along the arm at most :math:`\kappa'`, without twist. There are :math:`n` links of length :math:`h = L/n`,
and the bound of one link counts :math:`n` times.

A rigid link that ends at its IMU has the direction of its far end, so at the distance :math:`x` from there its
direction is off by at most :math:`\kappa x`: by :math:`\kappa h^2/2` over the link. If the IMU is in the middle, the
errors of both halves cancel but for the second derivative of the tangent, at most
:math:`M = \sqrt{\kappa'^2 + \kappa^4}`, and Taylor's formula leaves :math:`M h^3/24`.

An arc has the right direction at both ends. Its mean rate differs from the rate of the arm by at most
:math:`\kappa'(x^2 + (h - x)^2)/2h`, whose integral from the nearer end, integrated over the link, is
:math:`3\kappa' h^3/32`. That rates at different places do not commute adds :math:`D h^2/4`, where :math:`Dh` is the
smallest solution of

.. math:: Dh = \kappa h\,(3\kappa'h^2/32 + Dh/4) + g\,(\kappa'h^2/3 + Dh), \qquad
          g = 1 - \tfrac{e}{2}\cot\tfrac{e}{2}, \quad e = \kappa'h^2/6 + Dh/2 .

In the PCC-extended chain with :math:`m` sub-segments each link is longer than its arc by the factor
:math:`1/\mathrm{sinc}(\kappa h/2m) \approx 1 + \kappa^2 h^2/24m^2`. The leading terms give the rule. A direction that
is off by independent errors :math:`\sigma` about two axes moves the tip by :math:`\sqrt2\,\sigma h`, and :math:`n` of
them add as squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate, product
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from repro import (
    Arm,
    Robot,
    Sensing,
    calibrate,
    exact_arcs,
    pcc_extended,
    rigid_body,
)
from repro.improve import Improvement
from repro_companion.papers import baaij, martin
from repro_companion.show import sentences

# Magnetic sensors

ITERATIONS, TOLERANCE = 12, 1e-7
"""Where least squares ends: next to the minimum, to compare its errors with the bound."""


def covariance(sensing: Sensing, q: np.ndarray, noise_mt: float) -> np.ndarray:
    """Return Cramér-Rao bounds of configurations ``[t, n_q, n_q]``; infinite where readings leave one open."""
    J = sensing.linearise(q)[1] / noise_mt
    A = np.swapaxes(J, -1, -2) @ J
    determined = np.linalg.matrix_rank(J) == q.shape[-1]
    bound = np.full(A.shape, np.inf)
    bound[determined] = np.linalg.inv(A[determined])
    return bound


def bound_percent(sensing: Sensing, q: np.ndarray, noise_mt: float) -> float:
    """Return the bound of the mean error of eq. (13) along a trajectory [%]."""
    variance = np.diagonal(covariance(sensing, q, noise_mt), axis1=-2, axis2=-1)
    return float((100 * np.sqrt(variance.mean(0)) / np.ptp(q, axis=0)).mean())


def errors(n_segments: int, n_sensors: int, noise_mt: float, normal: np.ndarray) -> pd.DataFrame:
    """Return errors along T3, one row for each draw of the noise; ``normal`` are its numbers ``[t, draw, s]``."""
    robot, q = baaij.robot(n_segments, n_sensors), baaij.lemniscate(n_segments, steps=len(normal))
    u = baaij.simulate(robot, q)[:, None] + noise_mt * normal
    fit = baaij.least_squares(Sensing(robot), u, noise_mt, ITERATIONS, TOLERANCE)
    found = fit.q
    off = np.linalg.norm((robot.tip(found) - robot.tip(q)[:, None])[..., :3, 3], axis=-1)
    return pd.DataFrame({
        "draw": np.arange(normal.shape[1]),
        "mean_percent": baaij.relative_errors(found, q).mean(-1),
        "tip_mm": 1e3 * np.sqrt((off**2).mean(0)),
        "at_bound_percent": 100 * fit.details["at_bound"].any(-1).mean(0),
        "bound_percent": bound_percent(Sensing(robot), q, noise_mt),
    })  # fmt: skip


def grid(
    segments: Sequence[int],
    sensors: Sequence[int],
    noise_mt: Sequence[float],
    draws: int,
    steps: int,
    seed: int,
) -> pd.DataFrame:
    """Return means of :func:`errors` over the draws at every point of a grid.

    *Ratio* is the error over the error of three sensors, *averaging* what a mean of n readings would gain on three.
    """
    parts = []
    for n_b, noise, n_s in product(sorted(segments), sorted(noise_mt), sorted(sensors)):
        normal = np.random.default_rng(seed).standard_normal((steps, draws, n_b * n_s))
        own = errors(n_b, n_s, noise, normal).drop(columns="draw").mean()
        parts.append({"n_segments": n_b, "noise_mt": noise, "n_sensors": n_s, **own})
    table = pd.DataFrame(parts)
    three = (
        table["mean_percent"].where(table["n_sensors"] == 3).groupby([table["n_segments"], table["noise_mt"]])
    )
    averaging = np.sqrt(3 / table["n_sensors"].where(table["n_sensors"] >= 3))
    return table.assign(ratio=table["mean_percent"] / three.transform("max"), averaging=averaging)


# Where the sensors are


def moved(above: float, radius: float, n_sensors: int = 3) -> Robot:
    """Return the robot of one segment with its plane of sensors so far above the magnet, and so wide [m].

    It states bounds, noise, and tolerances: the standard deviations of what :func:`simulated` draws evenly.
    """
    robot, limits, even = baaij.robot(1, n_sensors, radial=radius), baaij.ERRORS, 1 / math.sqrt(3)
    magnet = {"position": even * limits.magnet_position, "tilt": even * limits.magnet_tilt}
    sensor = {"azimuth": even * limits.sensor_azimuth, "radius": even * limits.sensor_radius * radius}
    sensor |= {"tilt": 0.0, "gain": 0.0}
    return robot.replaced(
        magnets=[replace(part, tolerance=magnet) for part in robot.magnets],
        sensors=[replace(s, at=baaij.MAGNET_AT + above, tolerance=sensor) for s in robot.sensors],
        **dict(zip(("lower", "upper"), baaij.bounds(1), strict=True)),
        noise=baaij.NOISE_MT,
    )


def places(heights_mm: Sequence[float], radii_mm: Sequence[float], samples: int) -> pd.DataFrame:
    """Return the median deviation of the tip [mm] over random shapes, by noise alone and not calibrated."""
    checks = {
        (above, radial): moved(above / 1e3, radial / 1e3).check(samples=samples)
        for above, radial in product(heights_mm, radii_mm)
    }
    rows = [
        (*place, 1e3 * np.median(check.tip), 1e3 * np.median(check.tip_as_built))
        for place, check in checks.items()
    ]
    return pd.DataFrame(rows, columns=["above_mm", "radial_mm", "noise_mm", "off_mm"])


def tip_bound(robot: Robot, q: np.ndarray, noise_mt: float) -> float:
    """Return the bound of the root mean square error of the tip along a trajectory [mm]."""
    G = robot.tip_slopes(q)[1]
    variance = np.trace(
        G @ covariance(Sensing(robot), q, noise_mt) @ np.swapaxes(G, -1, -2), axis1=-2, axis2=-1
    )
    return 1e3 * math.sqrt(variance.mean())


def simulated(robot: Robot, draws: int, steps: int) -> dict[str, float]:
    """Return mean errors of the tip along T3 [mm] with the noise of the robot, and the bound.

    The robot is as drawn, or off by the limits of Table 1's own study: used as drawn, or calibrated in 100 poses.
    """
    q, box, noise = baaij.lemniscate(1, steps=steps), baaij.bounds(1), baaij.NOISE_MT
    bare, rows = Robot(robot.segments, robot.magnets, robot.sensors), []
    for draw in range(draws):
        measured = baaij.measured_draw(bare, q, box, draw)
        poses, spread = baaij.configurations(bare, measured.poses)
        model = calibrate(bare, poses, measured.pose_readings, noise, spread).sensing()
        settings = {
            "drawn_mm": (Sensing(bare), baaij.simulate(bare, q, noise_mt=noise, seed=draw)),
            "off_mm": (Sensing(bare), measured.readings),
            "calibrated_mm": (model, measured.readings),
        }
        found = {
            name: baaij.least_squares(sensing, u, noise, ITERATIONS, TOLERANCE).q
            for name, (sensing, u) in settings.items()
        }
        rows.append(
            {name: baaij.pose_errors(bare, estimate, q)["tip_mm"] for name, estimate in found.items()}
        )
    return {"bound_mm": tip_bound(bare, q, noise), **pd.DataFrame(rows).mean()}


# IMUs

END, MIDDLE = "rigid-body, IMU at the end", "rigid-body, IMU in the middle"
PCC, ARCS = "PCC-extended", "exact arcs"
IMU_MODELS = {END: rigid_body, MIDDLE: rigid_body, PCC: pcc_extended, ARCS: exact_arcs}
SUB_SEGMENTS, STEPS, LARGEST = 2, 1280, 64
"""Sub-segments of every link, steps of a curve, and the largest number of IMUs that we try on curves."""


class Curves(NamedTuple):
    """Curves of one length [m] from an upright base: orientations ``[curve, 1281, 4]`` along them and their tips.

    And the largest curvature [rad/m] and its largest derivative [rad/m^2] of each.
    """

    length: float
    frames: np.ndarray
    tips: np.ndarray
    curvature: np.ndarray
    slope: np.ndarray


def random_curves(count: int, length: float, curvature: float, slope: float, seed: int) -> Curves:
    """Return smooth curves, a sum of four cosines about each axis, that use up one of two limits."""
    waves = np.pi * np.arange(4)
    amplitudes = np.random.default_rng(seed).normal(size=(count, 2, 4)) / (1 + np.arange(4))
    s = (np.arange(STEPS) + 0.5)[:, None] / STEPS
    rates = np.einsum("cam,sm->csa", amplitudes, np.cos(waves * s))
    slopes = np.einsum("cam,sm->csa", amplitudes, -waves / length * np.sin(waves * s))
    largest, steepest = (np.linalg.norm(x, axis=-1).max(axis=1) for x in (rates, slopes))
    scale = np.minimum(curvature / largest, slope / steepest)
    h = length / STEPS
    turns = h * scale[:, None, None] * np.concatenate([rates, np.zeros_like(rates[..., :1])], axis=-1)
    whole, half = (
        Rotation.from_rotvec(x.reshape(-1, 3)).as_quat().reshape(count, STEPS, 4) for x in (turns, turns / 2)
    )
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    frames = np.stack([*accumulate(np.moveaxis(whole, 1, 0), martin.product, initial=upright)], axis=1)
    x, y, z, w = np.moveaxis(martin.product(frames[:, :-1], half), -1, 0)
    chords = h * np.sinc(np.linalg.norm(turns, axis=-1) / (2 * np.pi))
    along = np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=-1)
    return Curves(length, frames, (chords[..., None] * along).sum(1), scale * largest, scale * steepest)


def imu_arm(model: str, n: int, length: float) -> Arm:
    """Return ``n`` even links with the IMUs where the model wants them, to the step of a curve."""
    ends = np.round(STEPS * np.arange(n + 1) / n) * length / STEPS
    if model not in (END, MIDDLE):
        return Arm(range(n + 1), ends, np.diff(ends), sub_segments=SUB_SEGMENTS)
    arcs = ends[1:]
    if model == MIDDLE:
        arcs = np.round((ends[1:] + ends[:-1]) / 2 * STEPS / length) * length / STEPS
    return Arm(range(1, n + 1), arcs, np.diff(ends))


def tip_errors(curves: Curves, model: str, n: int, sigma: float = 0.0, seed: int = 0) -> np.ndarray:
    """Return errors of the tip [m] of every curve, with independent errors of the IMUs about each axis [rad]."""
    arm = imu_arm(model, n, curves.length)
    q = curves.frames[:, np.round(np.array(arm.imu_arcs) * STEPS / curves.length).astype(int)]
    off = sigma * np.random.default_rng(seed).standard_normal((*q.shape[:-1], 3))
    off *= np.array(arm.imus)[:, None] > 0  # the base is known
    q = martin.product(Rotation.from_rotvec(off.reshape(-1, 3)).as_quat().reshape(q.shape), q)
    tips = IMU_MODELS[model](q, arm, curves.length)[:, 0]
    return np.linalg.norm(tips - curves.tips, axis=-1)


def imu_rule(model: str, length: float, tolerance: float, curvature: float, slope: float) -> int:
    """Return a number of perfect IMUs that keeps the tip within a tolerance [m], by the leading terms."""
    per_link = {
        MIDDLE: math.hypot(slope, curvature**2) / 24,
        PCC: 3 * slope / 32 + curvature**2 / (24 * SUB_SEGMENTS**2),
        ARCS: 3 * slope / 32,
    }
    if model == END:
        return max(1, math.ceil(curvature * length**2 / (2 * tolerance) - 1e-9))
    return max(1, math.ceil(length * math.sqrt(length * per_link[model] / tolerance) - 1e-9))


def imu_bound(model: str, n: int, length: float, curvature: float, slope: float) -> float:
    """Return the whole bound of the error of the tip [m] with ``n`` even links, see the head of this module."""
    h = length / n
    k, a = curvature * h, slope * h**2
    links = {
        END: k * h / 2,
        MIDDLE: min(k / 4, math.hypot(a, k**2) / 24) * h,
        ARCS: min(k / 2, 3 * a / 32 + _commutator(k, a) / 4) * h,
    }
    links[PCC] = links[ARCS] + h / np.sinc(min(k, math.pi) / (2 * math.pi * SUB_SEGMENTS)) - h
    return float(min(n * links[model], 2 * length))


def _commutator(k: float, a: float) -> float:
    """Return the smallest solution D h of the equation at the head of this module; infinite if there is none."""
    D = 0.0
    for _ in range(1000):
        e = a / 6 + D / 2
        if k >= math.pi or e >= math.pi / 2:
            return math.inf
        g = 1 - (e / 2) / math.tan(e / 2) if e > 1e-4 else e * e / 12
        new = k * (3 * a / 32 + D / 4) + g * (a / 3 + D)
        if new - D <= 1e-13 * new:
            return new
        D = new
    return math.inf


def imu_errors(
    curves: Curves, limits: tuple[float, float], counts: Sequence[int], sensor_deg: Sequence[float], seed: int
) -> pd.DataFrame:
    """Return errors of the tip over all curves [mm] by model, errors of the IMUs and their number.

    The bound is for curves of these limits, curvature and its slope.
    """
    rows = []
    for model, deg, n in product(IMU_MODELS, sensor_deg, counts):
        off = 1e3 * tip_errors(curves, model, n, math.radians(deg), seed)
        rows.append({
            "model": model,
            "sensor_deg": deg,
            "n_imus": n,
            "rms_mm": math.sqrt((off**2).mean()),
            "largest_mm": off.max(),
            "bound_mm": np.nan if deg else 1e3 * imu_bound(model, n, curves.length, *limits),
            "rule_mm": 1e3 * math.radians(deg) * curves.length * math.sqrt(2 / n) if deg else np.nan,
        })  # fmt: skip
    return pd.DataFrame(rows)


def imus_needed(curves: Curves, limits: tuple[float, float], tolerances: Sequence[float]) -> pd.DataFrame:
    """Return numbers of IMUs by the rule, by the whole bound, and as the curves need them; empty above 64."""
    rows = []
    for model in IMU_MODELS:
        worst = np.array([tip_errors(curves, model, n).max() for n in range(1, LARGEST + 1)])
        bound = np.array([imu_bound(model, n, curves.length, *limits) for n in range(1, 1001)])
        rows += [
            {
                "model": model,
                "tolerance_mm": 1e3 * tolerance,
                "by_rule": imu_rule(model, curves.length, tolerance, *limits),
                "by_bound": _enough(bound, tolerance),
                "by_curves": _enough(worst, tolerance),
            }
            for tolerance in tolerances
        ]
    return pd.DataFrame(rows)


def _enough(errors: np.ndarray, tolerance: float) -> float:
    """Return the number, from 1, from which on no error is above a tolerance; NaN if the last one is."""
    above = np.flatnonzero(errors > tolerance)
    n = above[-1] + 2 if len(above) else 1
    return n if n <= len(errors) else np.nan


# What the page says

IN_SHORT = """
**In short.** *Magnets:* use three single-axis sensors on each segment. One three-axis chip in place of the three also
does, with {{ (one / three) | fixed(1) }} times their error ({{ one | two }} against {{ three | two }} mm at the
tip). Two single-axis sensors leave one of the three coordinates open, however quiet they are. More than three help
little: {{ most }} sensors have {{ share | fixed(0) }} % of the error of three. Calibrate the robot before you add
sensors.
"""
IMUS_IN_SHORT = """
*IMUs:* take an arm of {{ length }} mm, with a curvature of at most {{ curvature }} rad/m that changes by at most
{{ slope }} rad/m². If its IMUs are perfect and in the middle of their links, about {{ enough }} of them keep the tip
within 10 mm. With real IMUs, better ones help more than many: half the error is worth four times as many.
"""


def chip_and_three() -> tuple[float, float]:
    """Return the tip's deviations [mm] of one three-axis chip and of the paper's three sensors."""
    three = moved(above=0.055, radius=0.013)
    chip = three.replaced(sensors=[replace(three.sensors[0], axes=3)])
    one, all_ = (1e3 * float(np.median(robot.check().tip)) for robot in (chip, three))
    return one, all_


def in_words(means: pd.DataFrame, length_mm: float, curvature: float, slope: float) -> str:
    """Return how many sensors of either kind to use, from the errors of :func:`grid` and the rule."""
    own = means[(means["n_segments"] == 1) & (means["noise_mt"] == baaij.NOISE_MT)]
    ratio = own.set_index("n_sensors")["ratio"]
    enough = imu_rule(MIDDLE, length_mm / 1e3, 0.010, curvature, slope)
    numbers = {"length": length_mm, "curvature": curvature, "slope": slope}
    words = {name: f"{value:g}" for name, value in numbers.items()}
    one, three = chip_and_three()
    share = 100 * ratio[ratio.index.max()]
    magnets = sentences(IN_SHORT, most=ratio.index.max(), share=share, one=one, three=three)
    return f"{magnets}\n\n{sentences(IMUS_IN_SHORT, enough=enough, **words)}"


def shape_error_mm(robot: Robot, found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return root mean squares of the distance along the backbone [mm], by draw."""
    points = np.linalg.norm(robot.backbone(found) - robot.backbone(truth)[:, None], axis=-1)
    return 1e3 * np.sqrt((points**2).mean((0, 2)))


CHIPS = {"chips": "chips", "calibrated": "calibrated [mm]", "as_built": "not calibrated [mm]"}


def chips_table(better: Improvement) -> pd.DataFrame:
    """Return the median deviations of the tip [mm] by the number of chips of a design."""
    table = pd.DataFrame(better.by_chips)
    return table.assign(calibrated=1e3 * table["calibrated"], as_built=1e3 * table["as_built"])


BOUND = """
Bound and error, in percent of the range: {{ each }}. Over {{ draws }} draws of the noise the mean error is
{{ ratio | fixed(2) }} times the bound. It can be below the bound because least squares also uses limits, for example
that the arm cannot be shorter than at rest.
"""
FLOOR = """
A sensor model with errors of its own has a floor, below which quieter sensors are wasted. At 0.7 µT our
trainings of the paper's network for one segment have {{ of_bound | fixed(0) }} times the error of the bound
({{ mean_percent | two }} against {{ bound_percent | two }} % of the range), so a better model gains more than
more sensors.
"""


def bound_in_words(table: pd.DataFrame, study: pd.DataFrame, bound: np.ndarray, error: np.ndarray) -> str:
    """Return how errors compare with the bound, by coordinate and on the mean, and the floor of a network."""
    names = ["Δx", "Δy", "δL"] * (len(bound) // 3)
    each = ", ".join(f"{name} {a:.2f} and {b:.2f}" for name, a, b in zip(names, bound, error, strict=True))
    ratio = table["mean_percent"].mean() / table["bound_percent"].mean()
    real = study[(study["noise_mt"] == baaij.NOISE_MT) & (study["n_b"] == 1)].set_index(["model", "solver"])
    found = real.loc[("network of the paper", "Levenberg-Marquardt")]
    bounds = sentences(BOUND, each=each, draws=len(table), ratio=ratio)
    return f"{bounds}\n\n{sentences(FLOOR, **found)}"


PLACES = {
    "where": "place (height, radius [mm])",
    "bound_mm": "bound [mm]",
    "drawn_mm": "exact parts [mm]",
    "off_mm": "not calibrated [mm]",
    "calibrated_mm": "calibrated [mm]",
}


def tried(places: dict[str, tuple[float, float]], draws: int, steps: int) -> pd.DataFrame:
    """Return errors of the tip [mm] at places (radius and height [mm]), by name."""
    rows = [
        {"above_mm": above, "radial_mm": radial, **simulated(moved(above / 1e3, radial / 1e3), draws, steps)}
        for radial, above in places.values()
    ]
    return pd.DataFrame(rows).assign(place=list(places))


def places_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return errors by place, each with its height and radius."""
    where = [f"{row.place} ({row.above_mm:g}, {row.radial_mm:g})" for row in table.itertuples()]
    return table.assign(where=where)[list(PLACES)]


PLACES_IN_WORDS = """
Closer to the magnet noise matters less. But the sensor moves less against the magnet when the arm bends, so the same
half millimetre looks like a larger bend. Before a calibration the error is {{ closer.off_mm | fixed(1) }} mm at the
closer place, against {{ paper.off_mm | fixed(1) }} mm at the place in the paper. After one it is
{{ closer.calibrated_mm | fixed(2) }} against {{ paper.calibrated_mm | fixed(2) }} mm.
"""


def places_in_words(table: pd.DataFrame) -> str:
    """Return what a place closer to the magnet gains and costs."""
    of = table.set_index("place")
    return sentences(PLACES_IN_WORDS, paper=of.loc["paper"], closer=of.loc["closer"])


def needed_table(needed: pd.DataFrame) -> pd.DataFrame:
    """Return numbers of IMUs by the rule and, in brackets, as the curves need them, by model and tolerance."""
    by_rule, by_curves = (
        needed.pivot(index="model", columns="tolerance_mm", values=x) for x in ("by_rule", "by_curves")
    )
    cells = by_rule.astype(str) + by_curves.map(lambda n: f"\u00a0({'–' if pd.isna(n) else int(n)})")
    cells.columns = [f"{tolerance:g} mm" for tolerance in cells]
    return cells.loc[list(IMU_MODELS)].reset_index()


NEEDED = """
The exact bound asks for at most {{ more | fixed(0) }} more than the rule. The rule asks for {{ low | fixed(1) }} to
{{ high | fixed(1) }} times as many as these curves need, and for more if links end at their IMU.
"""


def needed_in_words(needed: pd.DataFrame) -> str:
    """Return how far the rule is from the whole bound, and from what curves need."""
    share = (needed["by_rule"] / needed["by_curves"])[needed["model"] != END].dropna()
    more = (needed["by_bound"] - needed["by_rule"]).max()
    return sentences(NEEDED, more=more, low=share.min(), high=share.max())
