"""Tables of the closed loop: tracking errors, their ratios, and what happens over time; all SYNTHETIC."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from repro.errors import bad_input
from repro_companion.book.bootstrap import interval, resampled
from repro_companion.pages.closed_loop.loop import (
    CONTROLLERS,
    ESTIMATORS,
    REFERENCES,
    SKIPPED_S,
    Learned,
    Run,
    judged_rms_mm,
    learn,
    rms_mm,
    run_loops,
)
from repro_companion.pages.closed_loop.rig_loop import SESSIONS
from repro_companion.twins.pneumatic_rig import TwinConfig
from repro_companion.twins.rig_twins import nominal_twin

TARGET = 1.3
"""Largest ratio of the tracking errors that was aimed at."""


def loop_errors(seeds: Sequence[int], *, duration_s: float = 25.0) -> pd.DataFrame:
    """Tracking errors with ours and with the true bend; synthetic, the nominal twin.

    Parameters
    ----------
    seeds
        Of noise, drift, bias and gains.
    duration_s
        Length of each run [s].

    Returns
    -------
    pandas.DataFrame
        Columns ``controller, session, reference, seed``; ``tracking_mm`` and ``tracking_truth_mm``, the tracking
        errors with ours and with the true bend; ``estimate_mm``, the root mean square error of ours in the loop,
        ``offset_mm``, the length of its mean over time; ``apparent_mm``, the tracking error as the controller sees
        it; ``bounded_%``, the share of readings with a command at the bound.
    """
    return run_errors(nominal_twin(), tuple(CONTROLLERS), SESSIONS, seeds, duration_s)


CASES = ("ours only watches", "the magnet does not lag")
"""The true bend is fed back and ours runs beside it; and a twin whose magnet follows the tip without a lag across the
direction of bending, with ours trained on its own T5."""


def cause_errors(seeds: Sequence[int], *, duration_s: float = 25.0) -> pd.DataFrame:
    """Each of :data:`CASES` with the controllers that were tuned with a margin, in a session as trained; synthetic.

    Parameters
    ----------
    seeds, duration_s
        As in :func:`loop_errors`.

    Returns
    -------
    pandas.DataFrame
        Columns of :func:`loop_errors`, and ``case``.
    """
    config, margin = nominal_twin(), tuple(CONTROLLERS)[:2]
    prompt = replace(config, inner=replace(config.inner, across_s=0.0))
    watching = run_errors(config, margin, SESSIONS[:1], seeds, duration_s, watched=True)
    following = run_errors(prompt, margin, SESSIONS[:1], seeds, duration_s)
    return pd.concat([watching.assign(case=CASES[0]), following.assign(case=CASES[1])], ignore_index=True)


def run_errors(
    config: TwinConfig,
    controllers: Sequence[str],
    kinds: Sequence[str],
    seeds: Sequence[int],
    duration_s: float,
    *,
    estimator: str = ESTIMATORS[0],
    learned: Learned | None = None,
    watched: bool = False,
) -> pd.DataFrame:
    """Tracking errors of one estimator on a twin, as :func:`loop_errors`; synthetic.

    Parameters
    ----------
    config
        The twin.
    controllers, kinds, seeds, duration_s
        Controllers, sessions, seeds and length of the runs.
    estimator
        One of `repro_companion.pages.closed_loop.loop.ESTIMATORS`.
    learned
        What the loop knows; of this twin when not given.
    watched
        Whether the true bend is fed back, and ours only watches.
    """
    names = {CONTROLLERS[name]: name for name in controllers}
    truth = [Run(r, gains, "truth") for gains in names for r in REFERENCES]
    runs = [
        Run(r, gains, kind, seed, estimator, watched=watched)
        for gains in names
        for kind in kinds
        for r in REFERENCES
        for seed in seeds
    ]
    trace = run_loops(config, learned or learn(config), [*truth, *runs], duration_s=duration_s)
    tracking, apart = rms_mm(trace), trace.fed_back_mm - trace.bend_mm
    off = np.linalg.norm(apart[trace.time_s >= SKIPPED_S].mean(axis=0), axis=-1)
    estimate = judged_rms_mm(trace, apart)
    apparent = judged_rms_mm(trace, trace.reference_mm - trace.fed_back_mm)
    with_truth = {(run.gains, run.reference): tracking[k] for k, run in enumerate(truth)}
    rows = [
        {
            "controller": names[run.gains],
            "session": run.session,
            "reference": run.reference,
            "seed": run.seed,
            "tracking_mm": tracking[k],
            "tracking_truth_mm": with_truth[run.gains, run.reference],
            "estimate_mm": estimate[k],
            "offset_mm": off[k],
            "apparent_mm": apparent[k],
            "bounded_%": 100 * trace.bounded[:, k].mean(),
        }
        for k, run in enumerate(runs, start=len(truth))
    ]
    return pd.DataFrame(rows)


def loops_over_time(
    *,
    controller: str = "PI and feed-forward",
    session: str = "another",
    seed: int = 100,
    duration_s: float,
    estimators: Sequence[str] = (ESTIMATORS[0], ESTIMATORS[2]),
) -> pd.DataFrame:
    """One run of each reference with the true bend fed back, and one with each of ours; synthetic, nominal twin.

    Parameters
    ----------
    controller
        One of `repro_companion.pages.closed_loop.loop.CONTROLLERS`.
    session, seed
        Of the readings.
    duration_s
        Length of each run [s].
    estimators
        Some of `repro_companion.pages.closed_loop.loop.ESTIMATORS`.

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
    config, gains = nominal_twin(), CONTROLLERS[controller]
    runs = [
        run
        for r in REFERENCES
        for run in (Run(r, gains, "truth"), *(Run(r, gains, session, seed, e) for e in estimators))
    ]
    trace = run_loops(config, learn(config), runs, duration_s=duration_s)
    parts = []
    for k, run in enumerate(runs):
        part = {
            "reference": run.reference,
            "feedback": "truth" if run.session == "truth" else run.estimator,
            "time_s": trace.time_s,
        }
        for i, axis in enumerate("xy"):
            part[f"reference_{axis}_mm"] = trace.reference_mm[:, k, i]
            part[f"delta_{axis}_mm"] = trace.bend_mm[:, k, i]
            part[f"fed_back_{axis}_mm"] = trace.fed_back_mm[:, k, i]
        parts.append(pd.DataFrame(part))
    return pd.concat(parts, ignore_index=True)


def ratios(errors: pd.DataFrame, *, draws: int = 10_000) -> pd.DataFrame:
    """Tracking error with ours over the one with the true bend, with 95 % bootstrap intervals over the seeds.

    Parameters
    ----------
    errors
        From :func:`loop_errors`.
    draws
        Of the bootstrap.

    Returns
    -------
    pandas.DataFrame
        Columns ``controller, session, reference, seeds``; the means ``tracking_mm, tracking_truth_mm, estimate_mm,
        offset_mm``; the mean ``ratio`` with its interval ``low, high``, the largest one ``worst``, and whether the
        mean meets :data:`TARGET`, ``met``.
    """
    rng, rows = np.random.default_rng(0), []
    for keys, part in errors.groupby(["controller", "session", "reference"], sort=False):
        ratio = (part["tracking_mm"] / part["tracking_truth_mm"]).to_numpy()
        low, high = interval(ratio[resampled(len(ratio), rng, bootstraps=draws)].mean(axis=1))
        names = ("tracking_mm", "tracking_truth_mm", "estimate_mm", "offset_mm")
        means = {name: part[name].mean() for name in names}
        rows.append(
            dict(zip(("controller", "session", "reference"), keys, strict=True))
            | {"seeds": len(ratio)}
            | means
            | {"ratio": ratio.mean(), "low": low, "high": high, "worst": ratio.max()}
            | {"met": bool(ratio.mean() <= TARGET)}
        )
    return pd.DataFrame(rows)


def causes(errors: pd.DataFrame, *, draws: int = 10_000) -> pd.DataFrame:
    """As :func:`ratios`, for :func:`cause_errors`: with the column ``case`` in front."""
    parts = [ratios(part, draws=draws).assign(case=case) for case, part in errors.groupby("case", sort=False)]
    table = pd.concat(parts, ignore_index=True)
    return table.loc[:, ["case", *table.columns.drop("case")]]
