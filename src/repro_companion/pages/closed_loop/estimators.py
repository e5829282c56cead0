"""Tables of the closed loop by what ours knows: of the lag, and of the command; all SYNTHETIC."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from repro.errors import bad_input
from repro_companion.pages.closed_loop.experiment import record_experiment
from repro_companion.pages.closed_loop.identification import told_by
from repro_companion.pages.closed_loop.loop import CONTROLLERS, ESTIMATORS, learn, training_part
from repro_companion.pages.closed_loop.rig_loop import SESSIONS
from repro_companion.pages.closed_loop.tables import ratios, run_errors
from repro_companion.twins.pneumatic_rig import TwinConfig
from repro_companion.twins.rig_networks import RECORDING_SEED
from repro_companion.twins.rig_twins import nominal_twin, random_twin

CHANGES = {"softer by a fifth": 1.2, "stiffer by a fifth": 0.8}
"""How much further the rig bends than the one that was learned."""
PROMPT = "the magnet does not lag"
"""A twin without the lag of the magnet across the direction of bending, with what is learned on it."""
COMPARED = ESTIMATORS[2:]
"""With the lag and the command, and the command alone: on rigs that the loop does not know exactly."""


def estimator_errors(seeds: Sequence[int], *, duration_s: float = 25.0) -> pd.DataFrame:
    """Tracking errors with each of ours that knows the commands; synthetic, the nominal twin.

    Parameters
    ----------
    seeds, duration_s
        As for :func:`~repro_companion.pages.closed_loop.tables.loop_errors`.

    Returns
    -------
    pandas.DataFrame
        Columns of that function, and ``estimator``. The command alone has one row for a controller and reference:
        nothing about it is random, and no session matters.
    """
    parts = []
    for estimator in ESTIMATORS[1:]:
        alone = estimator == ESTIMATORS[3]
        drawn = (SESSIONS[:1], seeds[:1]) if alone else (SESSIONS, seeds)
        part = run_errors(nominal_twin(), tuple(CONTROLLERS), *drawn, duration_s, estimator=estimator)
        parts.append(part.assign(estimator=estimator))
    return pd.concat(parts, ignore_index=True)


def changed_errors(seeds: Sequence[int], *, duration_s: float = 25.0) -> pd.DataFrame:
    """As :func:`estimator_errors` for :data:`COMPARED`, on rigs that have changed since they were learned.

    The controllers with a margin, another session; columns also ``rig``, one of :data:`CHANGES`,
    and to tell causes apart :data:`PROMPT`.
    """
    config, parts = nominal_twin(), []
    known = learn(config)
    rigs = {name: (_bent(config, factor), known) for name, factor in CHANGES.items()}
    prompt = replace(config, inner=replace(config.inner, across_s=0.0))
    rigs[PROMPT] = prompt, learn(prompt)
    for name, (rig, learned) in rigs.items():
        for estimator in COMPARED:
            options = {"estimator": estimator, "learned": learned}
            drawn = seeds[:1] if estimator == ESTIMATORS[3] else seeds
            part = run_errors(rig, tuple(CONTROLLERS)[:2], SESSIONS[1:], drawn, duration_s, **options)
            parts.append(part.assign(estimator=estimator, rig=name))
    return pd.concat(parts, ignore_index=True)


def twin_errors(twins: Sequence[int], seeds: Sequence[int], *, duration_s: float = 25.0) -> pd.DataFrame:
    """As :func:`estimator_errors` on random twins, each with what is learned on it: columns also ``twin``.

    The controllers with a margin, another session, without and with lag and command.

    Parameters
    ----------
    twins
        Seeds of `repro_companion.twins.rig_twins.random_twin`, of twins with the hysteresis that can be stepped.
    seeds, duration_s
        As in :func:`estimator_errors`.
    """
    parts = []
    for twin in twins:
        for estimator in (ESTIMATORS[0], ESTIMATORS[2]):
            part = run_errors(
                random_twin(twin),
                tuple(CONTROLLERS)[:2],
                SESSIONS[1:],
                seeds,
                duration_s,
                estimator=estimator,
            )
            parts.append(part.assign(estimator=estimator, twin=twin))
    return pd.concat(parts, ignore_index=True)


def by_group(errors: pd.DataFrame, group: str, *, draws: int = 10_000) -> pd.DataFrame:
    """Ratios, as `repro_companion.pages.closed_loop.tables.ratios`, for every value of one column or several.

    Parameters
    ----------
    errors
        From a function of this module.
    group
        Column, put in front.
    draws
        Of the bootstrap.

    Raises
    ------
    InputError
        If there is no such column.
    """
    if group not in errors:
        raise bad_input("group", "by_group", "a column of the errors", repr(group))
    parts = [
        ratios(part, draws=draws).assign(**{group: key}) for key, part in errors.groupby(group, sort=False)
    ]
    table = pd.concat(parts, ignore_index=True)
    return table.loc[:, [group, *table.columns.drop(group)]]


def together(plain: pd.DataFrame, others: pd.DataFrame) -> pd.DataFrame:
    """Errors of `repro_companion.pages.closed_loop.tables.loop_errors`, and below them those of other estimators."""
    return pd.concat([plain.assign(estimator=ESTIMATORS[0]), others], ignore_index=True)


def beside(table: pd.DataFrame, group: str = "controller") -> pd.DataFrame:
    """Mean ratios of all estimators side by side.

    Parameters
    ----------
    table
        From :func:`by_group`, by estimator, or with that column.
    group
        Column that stands in front.

    Returns
    -------
    pandas.DataFrame
        Columns ``group, controller, reference, session, truth_mm``, the tracking error with the true bend, and one
        for each estimator: the ratio, NaN where it was not run.
    """
    keys = list(dict.fromkeys([group, "controller", "reference", "session"]))
    wide = table.pivot_table(index=keys, columns="estimator", values="ratio", sort=False)
    wide = wide.loc[:, list(dict.fromkeys(table["estimator"]))].rename_axis(columns=None)
    wide.insert(0, "truth_mm", table.groupby(keys, sort=False)["tracking_truth_mm"].first())
    return wide.reset_index()


def worst_by(errors: pd.DataFrame, group: str, *, draws: int = 100) -> pd.DataFrame:
    """Ratios of every value of a column, over all references.

    Parameters
    ----------
    errors
        With the columns ``estimator`` and ``group``.
    group
        Column.
    draws
        Of the bootstrap, which does not enter here.

    Returns
    -------
    pandas.DataFrame
        Columns ``group, controller, estimator``; ``smallest, largest``, of the mean ratios of the references; and
        how many of them meet the target, ``met``, of ``references``.
    """
    keys, rows = [group, "controller", "estimator"], []
    for values, part in errors.groupby(keys, sort=False):
        table = ratios(part, draws=draws)
        found = {"smallest": table["ratio"].min(), "largest": table["ratio"].max()}
        counts = {"met": int(table["met"].sum()), "references": len(table)}
        rows.append(dict(zip(keys, values, strict=True)) | found | counts)
    return pd.DataFrame(rows)


def other_rigs(changed: pd.DataFrame, twins: pd.DataFrame) -> pd.DataFrame:
    """Both tables as :func:`worst_by`, one below the other, by the column ``rig``."""
    named = twins.assign(rig="random twin " + twins["twin"].astype(str))
    return worst_by(pd.concat([changed, named], ignore_index=True), "rig")


def told(*, seed: int = RECORDING_SEED) -> pd.DataFrame:
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
        size, own = told_by(learned.bend_map, part, learned.segment)
        left = part.recording.u - learned.bend_map(part.bend_mm)
        after = left - learned.segment.lag_mv(*part.lagged(learned.segment.lag_s), part.bend_mm)
        spread = [float(np.sqrt(x.var(axis=0).mean())) for x in (left, after)]
        rows.append((name, size, 100 * own, *spread))
    return pd.DataFrame(rows, columns=["recording", "turning_mm/s", "own_%", "left_mV", "left_with_lag_mV"])


def _bent(config: TwinConfig, factor: float) -> TwinConfig:
    """The twin with all bends but the one without torque multiplied."""
    bending = config.bending

    def times(pair: tuple[float, float]) -> tuple[float, float]:
        return factor * pair[0], factor * pair[1]

    changed = {name: times(getattr(bending, name)) for name in ("linear_mm", "quadratic_mm", "cubic_mm")}
    return replace(config, bending=replace(bending, **changed))
