r"""How many IMUs, and where: error of the models between perfect IMUs, on curves of limited curvature and on the arm.

The paper asks for "a method to compute this number for any soft arm as a function of its maximum curvature and
some tolerated error threshold" (Martin et al. 2022, section V). `edition1_companion.pages.how_many_imus.bounds` bounds
the error; its leading terms make a rule. With :math:`n` even links on an arm of length :math:`L`, curvature at most
:math:`\kappa`, its derivative at most :math:`\kappa'`, and :math:`m` sub-segments per link, the tip is off by at most
about

.. math::
   \frac{\kappa L^2}{2n}, \qquad
   \frac{L^3}{24 n^2}\sqrt{\kappa'^2 + \kappa^4}, \qquad
   \frac{L^3}{n^2}\Bigl(\frac{3\kappa'}{32} + \frac{\kappa^2}{24 m^2}\Bigr)

for rigid links with the IMU at their ends, in their middles, and for the PCC-extended chain (for exact arcs without
the term of :math:`m`). Independent errors of
:math:`\sigma` about each axis add :math:`\sigma L\sqrt{2/n}` (root mean square).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd

from edition1.errors import bad_input
from edition1.estimation.imu_models import (
    ShapeModel,
    exact_arcs,
    pcc_extended,
    rigid_links,
    tangent_interpolation,
    tangent_spline,
)
from edition1.estimation.imu_selection import Selection
from edition1.estimation.orientations import exponential, product
from edition1_companion.pages.how_many_imus.bounds import arcs_bound, pcc_bound, rigid_bound
from edition1_companion.pages.how_many_imus.curves import STEPS, Curves
from edition1_companion.pages.how_many_imus.needed import imus_needed
from edition1_companion.recordings.martin2022_models import MARKERS, selection
from edition1_companion.twins.arm_markers import mid_section
from edition1_companion.twins.arm_recording import MotionCapture
from edition1_companion.twins.arm_trial import drawn
from edition1_companion.twins.imu_errors import PERFECT
from edition1_companion.twins.soft_arm import SoftArm

DISCRETE_M = 1e-6
"""Error of the steps of the curves allowed for beside the bounds [m]."""
SUB_LINKS = 2
"""Sub-segments per link, as with 8 IMUs and 16 segments."""
END, MIDDLE, PCC, ARCS, SPLINE = (
    "rigid-body, IMU at the end",
    "rigid-body, IMU in the middle",
    "PCC-extended",
    "exact arcs",
    "spline",
)
MODELS: dict[str, ShapeModel] = {
    END: rigid_links,
    MIDDLE: rigid_links,
    PCC: pcc_extended,
    ARCS: exact_arcs,
    SPLINE: tangent_spline,
}
"""Models by their names here."""
BOUNDS: dict[str, Callable[..., np.ndarray]] = {
    END: rigid_bound,
    MIDDLE: rigid_bound,
    PCC: pcc_bound,
    ARCS: arcs_bound,
}
"""Closed-form bounds; the spline has none."""


def placed(model: str, n_imus: int, length_m: float, crowding: float = 1.0) -> Selection:
    """IMUs of a model, evenly spread or crowded towards the base.

    Parameters
    ----------
    model
        One of :data:`MODELS`.
    n_imus
        Number of links.
    length_m
        Length of the arm [m].
    crowding
        Link i ends at ``length_m (i/n)**crowding``: 1 is even, above 1 is denser near the base.

    Raises
    ------
    InputError
        Unknown model, or so many IMUs that two fall on one step of a curve.
    """
    if model not in MODELS:
        raise bad_input("model", "placed", f"one of {', '.join(MODELS)}", model)
    step = length_m / STEPS
    ends = np.round(STEPS * (np.arange(n_imus + 1) / n_imus) ** crowding) * step
    lengths = np.diff(ends)
    if n_imus < 1 or not (np.round(lengths / step) >= 2).all():
        raise bad_input("n_imus", "placed", "1 or more, with links of 2 steps at least", n_imus)
    if model == MIDDLE:
        arcs = np.round((ends[1:] + ends[:-1]) / 2 / step) * step
        return _made(range(1, n_imus + 1), arcs, lengths)
    if model == END:
        return _made(range(1, n_imus + 1), ends[1:], lengths)
    return _made(range(n_imus + 1), ends, lengths, SUB_LINKS)


def errors_by_count(
    curves: Curves, counts: Sequence[int], *, crowding: float = 1.0, sensor_rad: float = 0.0, seed: int = 0
) -> pd.DataFrame:
    """Error of the tip by model and number of IMUs, beside the bound for the largest curvature and slope.

    Parameters
    ----------
    curves
        What the arm does.
    counts
        Numbers of IMUs, the base not counted.
    crowding
        As for :func:`placed`.
    sensor_rad
        Standard deviation of the error of each IMU about each axis [rad]; the base has none.
    seed
        Of these errors.

    Returns
    -------
    DataFrame
        Columns ``model, n_imus, crowding, sensor_deg, median_mm, largest_mm, bound_mm`` (NaN for models without one),
        and ``within``: whether every curve keeps at every point to the bound for its own curvature and slope (of no
        meaning with sensor errors).
    """
    tip, lines = curves.points[:, -1], []
    for model, shape in MODELS.items():
        for n in counts:
            arm = placed(model, n, curves.length_m, crowding)
            q = _readings(curves, arm, sensor_rad, seed)
            error = 1e3 * np.linalg.norm(shape(q, arm, [sum(arm.link_lengths)])[:, 0] - tip, axis=-1)
            limits = {"curvature": float(curves.curvature.max()), "slope": float(curves.slope.max())}
            bound, within = np.nan, True
            if model in BOUNDS:
                bound = 1e3 * float(BOUNDS[model](arm, sum(arm.link_lengths), **limits)[0])
                within = bool((error <= bound).all())
            lines.append(
                (model, n, crowding, np.degrees(sensor_rad), np.median(error), error.max(), bound, within)
            )
    columns = ["model", "n_imus", "crowding", "sensor_deg", "median_mm", "largest_mm", "bound_mm", "within"]
    return pd.DataFrame(lines, columns=columns)


def below_bounds(curves: Curves, n_imus: int, points: int = 16) -> pd.DataFrame:
    """Errors along each curve against the bound for that curve's own curvature and slope.

    Returns
    -------
    DataFrame
        Columns ``model, checked`` (points of all curves), ``above`` (those above their bound), ``largest_share`` and
        ``median_share`` (of the bound that the error is).
    """
    lines = []
    rows = np.round(np.linspace(STEPS / points, STEPS, points)).astype(int)
    arcs = rows * curves.length_m / STEPS
    for model, bound in BOUNDS.items():
        arm = placed(model, n_imus, curves.length_m)
        estimate = MODELS[model](_readings(curves, arm, 0.0, 0), arm, arcs)
        error = np.linalg.norm(estimate - curves.points[:, rows], axis=-1)
        limits = np.array([
            bound(arm, arcs, curvature=float(k), slope=float(g))
            for k, g in zip(curves.curvature, curves.slope, strict=True)
        ])  # fmt: skip
        share = error / limits
        above = int((error > limits + DISCRETE_M).sum())
        lines.append((model, share.size, above, share.max(), np.median(share)))
    return pd.DataFrame(lines, columns=["model", "checked", "above", "largest_share", "median_share"])


def rule(model: str, length_m: float, tolerance_m: float, *, curvature: float, slope: float) -> int:
    """Number of IMUs by the leading term of the bound, see the head of this module.

    Raises
    ------
    InputError
        If there is no rule for the model.
    """
    if model == END:
        n = curvature * length_m**2 / (2 * tolerance_m)
    elif model == MIDDLE:
        n = length_m * math.sqrt(length_m * math.hypot(slope, curvature**2) / (24 * tolerance_m))
    elif model in (PCC, ARCS):
        per_link = 3 * slope / 32 + (curvature**2 / (24 * SUB_LINKS**2) if model == PCC else 0.0)
        n = length_m * math.sqrt(length_m * per_link / tolerance_m)
    else:
        raise bad_input("model", "rule", f"one of {', '.join(BOUNDS)}", model)
    return max(1, math.ceil(n - 1e-9))


def needed(curves: Curves, tolerances_m: Sequence[float], largest: int = 64) -> pd.DataFrame:
    """Numbers of IMUs for a tolerance of the tip: by the rule, by the bound, and as the curves need them.

    Parameters
    ----------
    curves
        What the arm does; rule and bound take its largest curvature and slope.
    tolerances_m
        Largest error of the tip [m].
    largest
        Number of IMUs at which the search over the curves ends.

    Returns
    -------
    DataFrame
        Columns ``model, tolerance_mm, by_rule, by_bound, by_curves`` (NaN where there is none); the last is the
        smallest number from which on no curve is off by more, NaN where that is above ``largest``.

    Raises
    ------
    InputError
        If a tolerance is not above zero.
    """
    for tolerance in tolerances_m:
        if not tolerance > 0:
            raise bad_input("tolerances_m", "needed", "above zero [m]", tolerance)
    limits = {"curvature": float(curves.curvature.max()), "slope": float(curves.slope.max())}
    tip, lines = curves.points[:, -1], []
    for model in MODELS:
        worst = []
        for n in range(1, largest + 1):
            arm = placed(model, n, curves.length_m)
            estimate = MODELS[model](_readings(curves, arm, 0.0, 0), arm, [sum(arm.link_lengths)])[:, 0]
            worst.append(np.linalg.norm(estimate - tip, axis=-1).max())
        for tolerance in tolerances_m:
            over = np.flatnonzero(np.array(worst) > tolerance)
            enough = 1 + (int(over[-1]) + 1 if over.size else 0)
            by_curves = enough if enough <= largest else np.nan
            by_rule = by_bound = np.nan
            if model in BOUNDS:
                by_rule = rule(model, curves.length_m, tolerance, **limits)
            if model in BOUNDS and model != END:  # of the first order: the bound is the rule
                by_bound = imus_needed(
                    BOUNDS[model], curves.length_m, tolerance, **limits, sub_links=SUB_LINKS
                )
            lines.append((model, 1e3 * tolerance, by_rule, by_bound, by_curves))
    return pd.DataFrame(lines, columns=["model", "tolerance_mm", "by_rule", "by_bound", "by_curves"])


def perfect_sensors(arm: SoftArm) -> pd.DataFrame:
    """Median errors of the markers in the synthetic trial with perfect sensors and an exact frame, eight IMUs.

    Returns
    -------
    DataFrame
        Columns ``model, m1_mm, m2_mm``, and the ratios to the PCC-extended model ``m1_ratio, m2_ratio``.
    """
    trial = drawn(arm, 0, PERFECT, MotionCapture(noise_m=0.0)).trial
    pcc = selection("pcc", 8)
    models = {
        END: (rigid_links, selection("rigid", 8)),
        "rigid-body, IMU in the middle (rigid.csv)": (rigid_links, mid_section()),
        f"{PCC}, 16 segments": (pcc_extended, pcc),
        "linear interpolation of tangents, 16 segments": (tangent_interpolation, pcc),
        ARCS: (exact_arcs, pcc),
        SPLINE: (tangent_spline, pcc),
    }
    lines = []
    for name, (model, made) in models.items():
        estimate = model(made.of(trial.orientations), made, MARKERS)
        medians = 1e3 * np.median(np.linalg.norm(estimate - trial.points[:, :2], axis=-1), axis=0)
        lines.append({"model": name, "m1_mm": medians[0], "m2_mm": medians[1]})
    table = pd.DataFrame(lines)
    base = table.set_index("model").loc[f"{PCC}, 16 segments"]
    return table.assign(m1_ratio=table["m1_mm"] / base["m1_mm"], m2_ratio=table["m2_mm"] / base["m2_mm"])


def _made(imus: Sequence[int], arcs: np.ndarray, lengths: np.ndarray, sub_links: int = 0) -> Selection:
    return Selection(tuple(imus), tuple(arcs.tolist()), tuple(lengths.tolist()), sub_links=sub_links)


def _readings(curves: Curves, arm: Selection, sensor_rad: float, seed: int) -> np.ndarray:
    """Orientations at the IMUs of a selection; the base, number 0, is exact."""
    steps = np.round(np.array(arm.arcs) / curves.length_m * STEPS).astype(int)
    turns = sensor_rad * np.random.default_rng(seed).standard_normal((len(curves.frames), len(steps), 3))
    turns = turns * (np.array(arm.imus) > 0)[:, None]
    return product(exponential(turns), curves.frames[:, steps])
