"""Tables of the closed loop: ratios of tracking errors, and what happens over time; all SYNTHETIC."""

from __future__ import annotations

import numpy as np
import pandas as pd

from edition1.errors import bad_input
from edition1_companion.book.bootstrap import interval, resampled
from edition1_companion.pages.closed_loop.identification import record_experiment, turning
from edition1_companion.pages.closed_loop.loop import (
    CONTROLLERS,
    ESTIMATORS,
    REFERENCES,
    Run,
    learn,
    run_loops,
    training_part,
)
from edition1_companion.twins.rig_networks import RECORDING_SEED
from edition1_companion.twins.rig_twins import nominal_twin

TARGET = 1.3
"""Largest ratio of the tracking errors that was aimed at."""


def loops_over_time(*, controller: str, session: str, seed: int, duration_s: float) -> pd.DataFrame:
    """One run of each reference with the true bend, with readings alone, and with lag and command; nominal twin.

    Parameters
    ----------
    controller
        One of `edition1_companion.pages.closed_loop.loop.CONTROLLERS`.
    session, seed
        Of the readings.
    duration_s
        Length of each run [s].

    Returns
    -------
    pandas.DataFrame
        Columns ``reference, feedback`` (``truth`` or the estimator) ``, time_s``, and for each axis
        ``reference_x_mm, delta_x_mm, fed_back_x_mm``.

    Raises
    ------
    InputError
        If there is no such controller.
    """
    if controller not in CONTROLLERS:
        expected = f"one of {', '.join(CONTROLLERS)}"
        raise bad_input("controller", "loops_over_time", expected, repr(controller))
    config, gains, parts = nominal_twin(), CONTROLLERS[controller], []
    fed_back = {"truth": ("truth",)} | {e: (session, seed, e) for e in (ESTIMATORS[0], ESTIMATORS[2])}
    shown = [(reference, feedback) for reference in REFERENCES for feedback in fed_back]
    runs = [Run(reference, gains, *fed_back[feedback]) for reference, feedback in shown]
    trace = run_loops(config, learn(config), runs, duration_s=duration_s)
    for k, (reference, feedback) in enumerate(shown):
        part = {"reference": reference, "feedback": feedback, "time_s": trace.time_s}
        for i, axis in enumerate("xy"):
            part[f"reference_{axis}_mm"] = trace.reference_mm[:, k, i]
            part[f"delta_{axis}_mm"] = trace.bend_mm[:, k, i]
            part[f"fed_back_{axis}_mm"] = trace.fed_back_mm[:, k, i]
        parts.append(pd.DataFrame(part))
    return pd.concat(parts, ignore_index=True)


def tracking_ratios(errors: pd.DataFrame, group: str, *, draws: int) -> pd.DataFrame:
    """Tracking error with the estimate over the one with the true bend, with 95 % bootstrap intervals over the seeds.

    Parameters
    ----------
    errors
        Tracking errors of a study of the closed loop, with the column ``group``.
    group
        Column by which they stand besides controller, session and reference.
    draws
        Of the bootstrap.

    Returns
    -------
    pandas.DataFrame
        Columns ``group, controller, session, reference, seeds``; the means ``tracking_mm, tracking_truth_mm,
        estimate_mm, offset_mm``; the mean ``ratio`` with its interval ``low, high``, the largest one ``worst``, and
        whether the mean meets :data:`TARGET`, ``met``.
    """
    keys, rows = [group, "controller", "session", "reference"], []
    for _, of_group in errors.groupby(group, sort=False):
        rng = np.random.default_rng(0)
        for values, part in of_group.groupby(keys, sort=False):
            ratio = (part["tracking_mm"] / part["tracking_truth_mm"]).to_numpy()
            low, high = interval(ratio[resampled(len(ratio), rng, bootstraps=draws)].mean(axis=1))
            names = ("tracking_mm", "tracking_truth_mm", "estimate_mm", "offset_mm")
            rows.append(
                dict(zip(keys, values, strict=True))
                | {"seeds": len(ratio)}
                | {name: part[name].mean() for name in names}
                | {"ratio": ratio.mean(), "low": low, "high": high, "worst": ratio.max()}
                | {"met": bool(ratio.mean() <= TARGET)}
            )
    return pd.DataFrame(rows)


def ratio_of_estimators(table: pd.DataFrame) -> pd.DataFrame:
    """Mean ratios of all estimators, one column each, NaN where one was not run; from :func:`tracking_ratios`.

    Returns
    -------
    pandas.DataFrame
        Columns ``controller, reference, session, truth_mm``, the tracking error with the true bend, and the
        estimators.
    """
    keys = ["controller", "reference", "session"]
    wide = table.pivot_table(index=keys, columns="estimator", values="ratio", sort=False)
    wide = wide.loc[:, list(dict.fromkeys(table["estimator"]))].rename_axis(columns=None)
    wide.insert(0, "truth_mm", table.groupby(keys, sort=False)["tracking_truth_mm"].first())
    return wide.reset_index()


def ratio_ranges(changed: pd.DataFrame, twins: pd.DataFrame) -> pd.DataFrame:
    """Ratios on changed rigs and random twins, over all references.

    Parameters
    ----------
    changed, twins
        The studies ``loop_changed`` and ``loop_twins``.

    Returns
    -------
    pandas.DataFrame
        Columns ``rig, controller, estimator``; ``smallest, largest``, of the mean ratios of the references; and
        how many of them meet the target, ``met``, of ``references``.
    """
    named = twins.assign(rig="random twin " + twins["twin"].astype(str))
    errors = pd.concat([changed, named], ignore_index=True)
    errors["ratio"] = errors["tracking_mm"] / errors["tracking_truth_mm"]
    keys = ["rig", "controller", "estimator"]
    means = errors.groupby([*keys, "reference"], sort=False)["ratio"].mean().reset_index()
    means["met"] = means["ratio"] <= TARGET
    columns = {"smallest": ("ratio", "min"), "largest": ("ratio", "max"), "met": ("met", "sum")}
    return means.groupby(keys, sort=False).agg(**columns, references=("ratio", "size")).reset_index()


def lag_by_recording(*, seed: int = RECORDING_SEED) -> pd.DataFrame:
    """What T5.train and the experiment tell about the lag, for the nominal twin; synthetic.

    Returns
    -------
    pandas.DataFrame
        Columns ``recording``; ``turning_mm/s``, root mean square of what the lag is proportional to; ``own_%``, how
        much of it no function of the bend takes up; ``left_mV`` and ``left_with_lag_mV``, root mean square of the
        readings about the map of T5.train, without and with the lag, after their mean. The second experiment is one
        that nothing was fitted to.
    """
    config = nominal_twin()
    learned, (training, _) = learn(config), training_part(config)
    parts = {
        "T5.train": training,
        "experiment": record_experiment(config, seed=seed),
        "second experiment": record_experiment(config, seed=seed + 1),
    }
    rows = []
    for name, part in parts.items():
        size, own = turning(learned.bend_map, part, learned.segment)
        left = part.recording.u - learned.bend_map(part.bend_mm)
        after = left - learned.segment.lag_mv(*part.lagged(learned.segment.lag_s), part.bend_mm)
        spread = [float(np.sqrt(x.var(axis=0).mean())) for x in (left, after)]
        rows.append((name, size, 100 * own, *spread))
    return pd.DataFrame(rows, columns=["recording", "turning_mm/s", "own_%", "left_mV", "left_with_lag_mV"])
