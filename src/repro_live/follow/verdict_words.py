"""What a monitor says, in words."""

from __future__ import annotations

from collections.abc import Sequence

from repro.estimation.consistency import CONSISTENT, STATUS, WRONG, Verdict

CAUSES = {
    "": "",
    "several": (
        "No single sensor explains it: something magnetic nearby, several sensors, more noise than stated, or a "
        "robot that is not as described (repro calibrate)."
    ),
    "untold": "Which sensor it is cannot be told so far.",
    "no redundancy": "Which sensor it is cannot be told: there is no redundancy.",
    "estimator": "The sensors agree with each other: the estimator lags behind them.",
    "too few": "There are fewer readings than unknowns: they do not determine the shape.",
    "anew": "Another shape explained the readings much better: the estimator was started anew there.",
}


def verdict_words(verdict: Verdict, sensors: Sequence[str]) -> str:
    """Return what is wrong in sentences, empty if nothing is.

    Parameters
    ----------
    verdict
        Of :class:`repro.estimation.monitor.Monitored`.
    sensors
        Names of the sensors.

    Examples
    --------
    >>> verdict_words(Verdict(WRONG, True, 41.7, "sensors", (1,)), ["sensor 1", "sensor 2"])
    'Wrong, not to be trusted: residuals are 42 times those of the noise. It is sensor 2 (--failed 2 leaves it out).'
    """
    if verdict.status == CONSISTENT:
        return ""
    doubt = "not to be trusted" if verdict.status == WRONG else "perhaps not to be trusted"
    head = f"{STATUS[verdict.status].capitalize()}, {doubt}"
    if verdict.cause not in ("anew", "too few"):
        head += f": residuals are {verdict.excess:.2g} times those of the noise"
    return f"{head}. {_cause(verdict, sensors)}".rstrip()


def lasting_words(verdict: Verdict, sensors: Sequence[str]) -> str:
    """Return the same without numbers, so that it stays the same while it lasts.

    Examples
    --------
    >>> lasting_words(Verdict(WRONG, True, 41.7, "several"), ["sensor 1", "sensor 2"])[:66]
    'The shape does not explain the readings. No single sensor explains'
    """
    if verdict.status == CONSISTENT:
        return ""
    return f"The shape does not explain the readings. {_cause(verdict, sensors)}".rstrip()


def _cause(verdict: Verdict, sensors: Sequence[str]) -> str:
    if verdict.cause != "sensors":
        return CAUSES[verdict.cause]
    names = " or ".join(sensors[k] for k in verdict.suspects)
    options = " or ".join(f"--failed {k + 1}" for k in verdict.suspects)
    return f"It is {names} ({options} leaves it out)."


def redundancy_words(readings: int, unknowns: int) -> str:
    """Return what can never be told, empty if there is more than one reading for each unknown.

    Examples
    --------
    >>> redundancy_words(3, 3)
    'No redundancy, 3 readings for 3 unknowns: a wrong sensor looks like another shape and cannot be told.'
    """
    if readings > unknowns:
        return ""
    counts = f"{readings} readings for {unknowns} unknowns"
    return f"No redundancy, {counts}: a wrong sensor looks like another shape and cannot be told."
