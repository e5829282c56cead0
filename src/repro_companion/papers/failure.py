"""Sensors that fail, section 3.5 of Baaij et al. 2023: what a failure costs, and whether a monitor notices it."""

from __future__ import annotations

import numpy as np
import pandas as pd

from repro import Robot
from repro.estimators.track import Trajectory
from repro_companion.papers import baaij
from repro_companion.show import sentences

AUTHORS_PERCENT = {
    "before": (3.5, 3.8, 3.5, 2.8, 3.1, 3.6, 1.5, 1.3, 2.4),
    "after": (3.7, 5.8, 5.8, 2.2, 3.0, 5.1, 1.6, 2.2, 3.5),
}
"""Errors [%] of the networks that the authors released, on regenerated data, before and after the failure.

They are not in print. They were evaluated outside this project and cannot be regenerated here, so they stand here.
"""


# Figs 4(b) and 5


Found = dict[tuple[int, str], Trajectory]
"""Estimates by seed of the networks and name of the run, ``failure`` or ``all sensors``."""


def of_run(found: Found, run: str, name: str) -> np.ndarray:
    """Return what is found in one run ``[seed, t, ...]``: its ``q`` or ``u_hat``."""
    return np.stack([getattr(shape, name) for (_, own), shape in found.items() if own == run])


def courses(
    robot: Robot, time_s: np.ndarray, q: np.ndarray, u: np.ndarray, found: Found
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return readings [mT] and configurations [mm] with a failure, every second step: truth, and means over seeds."""
    u_hat, q_hat = (of_run(found, "failure", name)[:, ::2] for name in ("u_hat", "q"))
    sensors = list(range(1, len(robot.sensors) + 1))
    readings = baaij.over_seeds(time_s[::2], sensors, u[::2], u_hat)
    return readings, baaij.over_seeds(time_s[::2], robot.coordinates, 1e3 * q[::2], 1e3 * q_hat)


def stills(
    robot: Robot, time_s: np.ndarray, q: np.ndarray, works: np.ndarray, found: Found
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return shapes and parts [mm] at six even times: the truth, and the mean over seeds of each run."""
    k = np.linspace(0, len(q) - 1, 6).round().astype(int)
    means = {run: of_run(found, run, "q").mean(axis=0)[k] for run in ("all sensors", "failure")}
    return baaij.stills(robot, time_s[k], {"truth": q[k]} | means, works[k])


def errors(found: dict[tuple[int, str], np.ndarray], q: np.ndarray, after: np.ndarray) -> pd.DataFrame:
    """Return errors of eq. (13) before and after a failure, of estimates ``[t, n_q]`` by seed and run."""
    lines, names = [], baaij.robot(q.shape[1] // 3).coordinates
    for part, steps in (("before", ~after), ("after", after)):
        for (seed, run), estimate in found.items():
            error = 100 * np.sqrt(((estimate - q)[steps] ** 2).mean(0)) / np.ptp(q, axis=0)
            lines += [(seed, run, part, *both) for both in zip(names, error, strict=True)]
    return pd.DataFrame(lines, columns=["member", "run", "part", "quantity", "error_percent"])


def means(errors: pd.DataFrame) -> pd.DataFrame:
    """Return mean and deviation of these errors over seeds, beside the errors of the released networks."""
    columns = {}
    for name, run, part in (
        ("before", "failure", "before"), ("after", "failure", "after"), ("all_sensors", "all sensors", "after")
    ):  # fmt: skip
        own = errors[(errors["run"] == run) & (errors["part"] == part)]
        by_quantity = own.groupby("quantity", sort=False)["error_percent"]
        columns |= {f"{name}_percent": by_quantity.mean(), f"{name}_percent_std": by_quantity.std()}
    authors = {f"authors_{part}_percent": values for part, values in AUTHORS_PERCENT.items()}
    return pd.DataFrame(columns).rename_axis("quantity").reset_index().assign(**authors)


KINDS = {"delta_x": "bend in x", "delta_y": "bend in y", "delta_L": "elongation"}


def by_kind(errors: pd.DataFrame) -> pd.DataFrame:
    """Return errors after the failure [%] by kind of coordinate and their mean, a column for each run and network."""
    late = errors[errors["part"] == "after"]
    late = late.assign(kind=late["quantity"].str.rpartition("_")[0].map(KINDS))
    table = late.pivot_table("error_percent", "kind", ["run", "member"]).loc[list(KINDS.values())]
    table.loc["mean"] = table.mean()
    return table


def cost(errors: pd.DataFrame) -> pd.DataFrame:
    """Return these errors as a page shows them, and by how many percentage points they change for each network."""
    kinds = by_kind(errors)
    table = pd.DataFrame({("", "coordinate"): kinds.index}, index=kinds.index)
    for run, name in (("all sensors", "all sensors"), ("failure", "with failure")):
        table["error [%]", name] = kinds[run].mean(axis=1)
    for seed, change in (kinds["failure"] - kinds["all sensors"]).items():
        table["change, network", str(seed + 1)] = change.round(1) + 0.0  # no minus zero
    return table


COST = """
**{% if clear > 0 %}The failure costs accuracy.{% elif clear < 0 %}With the failure the errors are smaller.{% else %}
{{ "One training" if networks == 1 else "Our " ~ networks ~ " trainings" }} cannot tell whether the failure costs
accuracy.{% endif %}** The mean error is {{ failed }} %
{{ "with and without the failure" if failed == whole else "with the failure and " ~ whole ~ " % without it" }},
and it grows with {{ worse }} of our {{ networks }} network{{ "s" if networks > 1 }}.
{% if networks > 1 %}
On average it changes by {{ change }} percentage points, with a standard error of {{ error }}; we speak of a
{{ "loss" if clear >= 0 else "gain" }} only beyond three standard errors.
{% endif %}
The {{ most }} suffers most, from {{ rise[0] | fixed(1) }} to {{ rise[1] | fixed(1) }} %. The networks that the
authors released have {{ authors | fixed(1) }} % after the failure; we have no run of theirs without it.
"""


def cost_in_words(errors: pd.DataFrame, means: pd.DataFrame) -> str:
    """Return what the failure costs, from single errors and their means over seeds."""
    kinds, mean = by_kind(errors), means.mean(numeric_only=True)
    change = kinds["failure"] - kinds["all sensors"]
    most = change.drop("mean").mean(axis=1).idxmax()
    failed, whole = (f"{mean[name]:.1f}" for name in ("after_percent", "all_sensors_percent"))
    sizes = {"failed": failed, "whole": whole, "authors": mean["authors_after_percent"]}
    sizes["rise"] = [kinds[run].mean(axis=1)[most] for run in ("all sensors", "failure")]
    own = change.loc["mean"]
    worse, error = int((own > 0).sum()), float(own.sem())
    clear = int(np.sign(own.mean())) if abs(own.mean()) > 3 * error else 0
    sizes |= {"change": f"{own.mean():+.1f}".replace("-", "−"), "error": f"{error:.1f}"}
    return sentences(COST, most=most, worse=worse, networks=len(own), clear=clear, **sizes)


# Is a failure noticed?


def alarms(study: pd.DataFrame) -> pd.DataFrame:
    """Return what an emulated robot with a monitor noticed of faults of its sensors, and without it [%]."""
    table = study[["robot", "estimator", "scenario"]].copy()
    for name, part, whole in (
        ("off", "wrong", "readings"),
        ("off_without", "without", "readings"),
        ("alarm", "alarms", "readings"),
        ("alarm_right", "named_readings_right", "readings"),
        ("noticed", "noticed", "due"),
        ("unseen", "unseen", "readings"),
        ("named", "named_clear", "clear"),
        ("named_right", "named_right", "named"),
        ("holds", "trusted_hold", "trusted"),
        ("alarm_soon", "alarm_soon", "large"),
        ("named_soon", "named_soon", "large"),
        ("first_right", "first_right", "some"),
        ("ended", "ended", "trials"),
    ):
        table[f"{name}_percent"] = 100 * study[part] / study[whole].where(study[whole] > 0)
    return table.assign(alarms_before=study["alarms_before"].astype(int))


FAULTS = {
    "no reading": "no reading",
    "unplugged": "unplugged",
    "stuck": "stuck",
    "saturated": "saturated",
    "gain +5 %": "wrong gain",
    "offset 50 uT": "offset",
    "drift 2 uT/s": "drift",
    "glitches": "glitches",
    "clipped": "clipped",
    "magnet near": "magnet nearby",
}
"""Faults of the study that a page shows, and what it calls them."""
SEEN = {
    ("8 sensors", "no monitor: tip off"): ("off_without_percent", "two_segments"),
    ("8 sensors", "tip off"): ("off_percent", "two_segments"),
    ("8 sensors", "named"): ("alarm_right_percent", "two_segments"),
    ("3 sensors", "tip off"): ("off_percent", "one_segment"),
    ("3 sensors", "alarm"): ("alarm_percent", "one_segment"),
}
"""Columns that a page shows, and what they are in the table of alarms."""
SHOWN = ("two_segments", "one_segment")
"""Arms of the study that it shows; a third one is on another page."""


def alarms_shown(alarms: pd.DataFrame) -> pd.DataFrame:
    """Return the table of alarms as a page shows it, for least squares [%]."""
    own = alarms[(alarms["estimator"] == "levenberg_marquardt") & alarms["scenario"].isin(FAULTS)]
    wide = own.pivot(index="scenario", columns="robot").loc[list(FAULTS)]
    table = pd.DataFrame({name: wide[column] for name, column in SEEN.items()})
    table.loc[["no reading", "magnet near"], [("8 sensors", "named")]] = np.nan  # no sensor is the right one
    table = table.round().astype("Int64")
    table.insert(0, ("", "fault"), list(FAULTS.values()))
    return table


NOTICED = """
**If there are readings to spare, a failed sensor is noticed.** On the arm with eight sensors, once a reading was off
by ten standard deviations, an alarm followed within a second (for the drift within five) in at least {{ soon }} % of
the trials, with either estimator. The first sensor that the monitor named was the right one in at least {{ first }} %
of the trials in which it named any. One second after the fault the alarm had ended in
{{ "all" if ended == "100" else "at least " ~ ended ~ " % of the" }} trials. An hour without a fault, of each arm and
estimator, had {{ "an alarm in " ~ quiet ~ " readings" if quiet else "no alarm" }}.
**A magnet nearby is the exception**, because it disturbs several sensors. The tip is off in {{ low.wrong }} to
{{ high.wrong }} % of the readings, in {{ low.unseen }} to {{ high.unseen }} % without an alarm. The Kalman filter
then blames a sensor in {{ blamed.kalman }} of {{ trials }} trials, and least squares in
{{ blamed.levenberg_marquardt or "none" }}.
"""


def alarms_in_words(study: pd.DataFrame) -> str:
    """Return how soon and how rightly the monitor notices a fault where readings are spare, and a magnet nearby."""
    eight = study[study["scenario"].isin(FAULTS) & (study["robot"] == "two_segments")]
    near = eight["scenario"] == "magnet near"
    one, magnet = (eight[part].groupby("estimator").sum(numeric_only=True) for part in (~near, near))
    parts = {"soon": ("alarm_soon", "large"), "first": ("first_right", "some"), "ended": ("ended", "trials")}
    least = {name: f"{np.floor((100 * one[x] / one[of]).min()):.0f}" for name, (x, of) in parts.items()}
    hours = study[(study["scenario"] == "an hour without a fault") & study["robot"].isin(SHOWN)]
    shares = 100 * magnet[["wrong", "unseen"]].div(magnet["readings"], axis=0)
    low, high = (shares.agg(of).map("{:.0f}".format) for of in ("min", "max"))
    blamed, trials = magnet["some"].astype(int).to_dict(), magnet["trials"].max()
    quiet = int(hours["alarms"].sum())
    return sentences(NOTICED, **least, low=low, high=high, blamed=blamed, quiet=quiet, trials=trials)
