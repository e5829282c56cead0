"""The studies of the closed loop: tracking errors; all SYNTHETIC.

They run the loops for some minutes: with every controller, to tell causes apart, by what ours knows, and on rigs
that the loop does not know exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from edition1_companion.book.studies import Study
from edition1_companion.pages.closed_loop.loop import (
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
from edition1_companion.pages.closed_loop.rig_loop import SESSIONS
from edition1_companion.twins.pneumatic_rig import TwinConfig
from edition1_companion.twins.rig_twins import nominal_twin, random_twin

MARGIN = tuple(CONTROLLERS)[:2]
"""The controllers that were tuned with a margin."""
WATCHED = "ours only watches"
"""The true bend is fed back and ours runs beside it."""
PROMPT = "the magnet does not lag"
"""A twin whose magnet follows the tip without a lag across the direction of bending, with what is learned on it."""
CHANGES = {"softer by a fifth": 1.2, "stiffer by a fifth": 0.8}
"""How much further the rig bends than the one that was learned."""
OTHER: dict[str, Any] = {"controllers": MARGIN, "kinds": SESSIONS[1:]}
"""With a margin, in another session."""
COMPARED = ESTIMATORS[2:]
"""With the lag and the command, and the command alone: on rigs that the loop does not know exactly."""


def run_errors(
    config: TwinConfig,
    seeds: Sequence[int],
    duration_s: float,
    *,
    controllers: Sequence[str] = tuple(CONTROLLERS),
    kinds: Sequence[str] = SESSIONS,
    estimator: str = ESTIMATORS[0],
    learned: Learned | None = None,
    watched: bool = False,
) -> pd.DataFrame:
    """Tracking errors with one estimator and with the true bend, on a twin; synthetic.

    Parameters
    ----------
    config
        The twin.
    seeds
        Of noise, drift, bias and gains.
    duration_s
        Length of each run [s].
    controllers, kinds
        Controllers and sessions.
    estimator
        One of `edition1_companion.pages.closed_loop.loop.ESTIMATORS`. The command alone has one row for a controller and
        reference: nothing about it is random, and no session matters.
    learned
        What the loop knows; of this twin when not given.
    watched
        Whether the true bend is fed back, and ours only watches.

    Returns
    -------
    pandas.DataFrame
        Columns ``controller, session, reference, seed``; ``tracking_mm`` and ``tracking_truth_mm``, the tracking
        errors with ours and with the true bend; ``estimate_mm``, the root mean square error of ours in the loop,
        ``offset_mm``, the length of its mean over time; ``apparent_mm``, the tracking error as the controller sees
        it; ``bounded_%``, the share of readings with a command at the bound.
    """
    if estimator == ESTIMATORS[3]:
        kinds, seeds = kinds[:1], seeds[:1]
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


def loop_errors(seeds: Sequence[int], *, duration_s: float) -> pd.DataFrame:
    """:func:`run_errors` of the filter of Table 2 on the nominal twin."""
    return run_errors(nominal_twin(), seeds, duration_s)


def cause_errors(seeds: Sequence[int], *, duration_s: float) -> pd.DataFrame:
    """:func:`run_errors` with a margin, in a session as trained, by ``case``: :data:`WATCHED` and :data:`PROMPT`."""
    plain: dict[str, Any] = {"controllers": MARGIN, "kinds": SESSIONS[:1]}
    cases = [
        ({"case": WATCHED}, nominal_twin(), plain | {"watched": True}),
        ({"case": PROMPT}, _prompt_twin(), plain),
    ]
    return _labelled_errors(cases, seeds, duration_s)


def estimator_errors(seeds: Sequence[int], *, duration_s: float) -> pd.DataFrame:
    """:func:`run_errors` of each of ours that knows the commands, on the nominal twin, by ``estimator``."""
    cases = [({"estimator": name}, nominal_twin(), {"estimator": name}) for name in ESTIMATORS[1:]]
    return _labelled_errors(cases, seeds, duration_s)


def changed_errors(seeds: Sequence[int], *, duration_s: float) -> pd.DataFrame:
    """:func:`run_errors` on rigs that have changed since they were learned, by ``estimator`` and ``rig``.

    Of :data:`COMPARED`, with a margin, another session; rigs of :data:`CHANGES`, and to tell causes apart
    :data:`PROMPT`.
    """
    config, prompt = nominal_twin(), _prompt_twin()
    rigs = {name: (_bent(config, factor), learn(config)) for name, factor in CHANGES.items()}
    rigs[PROMPT] = prompt, learn(prompt)
    cases = [
        ({"estimator": estimator, "rig": name}, rig, OTHER | {"estimator": estimator, "learned": learned})
        for name, (rig, learned) in rigs.items()
        for estimator in COMPARED
    ]
    return _labelled_errors(cases, seeds, duration_s)


def twin_errors(twins: Sequence[int], seeds: Sequence[int], *, duration_s: float) -> pd.DataFrame:
    """:func:`run_errors` on random twins, each with what is learned on it, by ``estimator`` and ``twin``.

    Without and with lag and command, with a margin, another session; twins with the hysteresis that can be stepped.
    """
    cases = [
        ({"estimator": estimator, "twin": twin}, random_twin(twin), OTHER | {"estimator": estimator})
        for twin in twins
        for estimator in (ESTIMATORS[0], ESTIMATORS[2])
    ]
    return _labelled_errors(cases, seeds, duration_s)


def _labelled_errors(
    cases: Sequence[tuple[dict[str, Any], TwinConfig, dict[str, Any]]],
    seeds: Sequence[int],
    duration_s: float,
) -> pd.DataFrame:
    """:func:`run_errors` of labels, twins and options, one case below the other."""
    parts = [
        run_errors(config, seeds, duration_s, **options).assign(**labels) for labels, config, options in cases
    ]
    return pd.concat(parts, ignore_index=True)


def _prompt_twin() -> TwinConfig:
    config = nominal_twin()
    return replace(config, inner=replace(config.inner, across_s=0.0))


def _bent(config: TwinConfig, factor: float) -> TwinConfig:
    """The twin with all bends but the one without torque multiplied."""
    bending = config.bending
    names = ("linear_mm", "quadratic_mm", "cubic_mm")
    changed: dict[str, Any] = {name: tuple(factor * x for x in getattr(bending, name)) for name in names}
    return replace(config, bending=replace(bending, **changed))


SETTINGS = {"seeds": list(range(12)), "duration_s": 25.0}
STUDIES = (
    Study("closed_loop", loop_errors, SETTINGS),
    Study("loop_causes", cause_errors, SETTINGS),
    Study("loop_estimators", estimator_errors, SETTINGS),
    Study("loop_changed", changed_errors, {"seeds": [0, 1, 2, 3], "duration_s": 25.0}),
    Study("loop_twins", twin_errors, {"twins": [2, 3, 4, 7], "seeds": [0, 1], "duration_s": 25.0}),
)
