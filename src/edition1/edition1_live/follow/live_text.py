"""The state of a live session in words and numbers, for the terminal and for the page in the browser."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch

from edition1.estimation.consistency import Status, Verdict
from edition1_live.follow.latency import STAGES
from edition1_live.follow.live_state import LiveState, trusted
from edition1_live.follow.robot_estimator import RobotEstimator
from edition1_live.robot.calibration_poses import coordinate_columns

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
        Of :class:`edition1.estimation.monitor.Monitored`.
    sensors
        Names of the sensors.

    Examples
    --------
    >>> verdict_words(Verdict(Status.WRONG, True, 41.7, "sensors", (1,)), ["sensor 1", "sensor 2"])
    'Wrong, not to be trusted: residuals are 42 times those of the noise. It is sensor 2 (--failed 2 leaves it out).'
    """
    if verdict.status == Status.CONSISTENT:
        return ""
    doubt = "not to be trusted" if verdict.status == Status.WRONG else "perhaps not to be trusted"
    head = f"{Status(verdict.status).word.capitalize()}, {doubt}"
    if verdict.cause not in ("anew", "too few"):
        head += f": residuals are {verdict.excess:.2g} times those of the noise"
    return f"{head}. {_cause(verdict, sensors)}".rstrip()


def lasting_words(verdict: Verdict, sensors: Sequence[str]) -> str:
    """Return the same without numbers, so that it stays the same while it lasts.

    Examples
    --------
    >>> lasting_words(Verdict(Status.WRONG, True, 41.7, "several"), ["sensor 1", "sensor 2"])[:66]
    'The shape does not explain the readings. No single sensor explains'
    """
    if verdict.status == Status.CONSISTENT:
        return ""
    return f"The shape does not explain the readings. {_cause(verdict, sensors)}".rstrip()


def _cause(verdict: Verdict, sensors: Sequence[str]) -> str:
    if verdict.cause != "sensors":
        return CAUSES[verdict.cause]
    names = " or ".join(sensors[k] for k in verdict.suspects)
    options = " or ".join(f"--failed {k + 1}" for k in verdict.suspects)
    return f"It is {names} ({options} leaves it out)."


_SHOWN_COUNTERS = ("frames", "gaps", "checksum_errors", "malformed", "reconnects")


class Quantity(NamedTuple):
    """A number with its standard deviation, which is NaN where the estimator has none.

    It is undetermined if the deviation is larger than the width of its bounds.
    """

    name: str
    value: float
    deviation: float
    unit: str
    width: float = math.inf

    def __str__(self) -> str:
        """Return it with as many digits as its unit deserves."""
        digits = 4 if self.unit == "rad" else 2
        text = f"{self.name} {self.value:.{digits}f}"
        if self.deviation > self.width:
            return f"{text} {self.unit} (undetermined)"
        if not math.isnan(self.deviation):
            text += f" ± {self.deviation:.{digits + 1}f}"
        return f"{text} {self.unit}"


def quantities(estimator: RobotEstimator, state: LiveState) -> list[Quantity]:
    """Estimated coordinates in mm, deg and rad, or for IMUs the position of the tip [mm]; none before an estimate.

    Deviations are standard deviations by the covariance of the estimator.
    """
    if state.estimate is None:
        return []
    q, covariance = state.estimate.q, state.estimate.covariance
    deviation = (
        torch.full_like(q, torch.nan)
        if covariance is None
        else covariance.diagonal(dim1=-2, dim2=-1).clamp_min(0).sqrt()
    )
    if estimator.positions:
        names = [(f"tip {axis}", "mm", 1e-3) for axis in "xyz"]
        q, deviation = q[-3:], deviation[-3:]
        width = torch.full_like(q, torch.inf)
    else:
        columns = coordinate_columns(estimator.robot)
        names = [(*column.rsplit("_", 1), factor) for column, factor in columns.items()]
        width = estimator.robot.upper - estimator.robot.lower
    numbers = zip(names, *(x.tolist() for x in (q, deviation, width)), strict=True)
    return [Quantity(name, x / f, s / f, unit, w / f) for (name, unit, f), x, s, w in numbers]


def latency(state: LiveState) -> str:
    """Median and 99th percentile of the time from the last bytes of a time step to its estimate, by stage."""
    if not state.estimated:
        return "latency: no estimate yet"
    parts = {
        stage: "/".join(f"{1e3 * state.latencies[stage].quantile(share):.2f}" for share in (0.5, 0.99))
        for stage in STAGES
    }
    total = parts.pop("total")
    stages = ", ".join(f"{stage} {text}" for stage, text in parts.items())
    return f"latency p50/p99 {total} ms ({stages})"


def pace(estimator: RobotEstimator, state: LiveState) -> str:
    """Estimates per second, or for how long there were no readings."""
    if state.silent:
        return f"no {'usable ' * state.refused_now}readings for {state.age_s:.0f} s"
    return f"{state.rate_hz:.1f} estimates/s by {estimator.name}"


def mark(state: LiveState) -> str:
    """What to put beside a shape that is not to be trusted; empty where it is, or there is none."""
    if state.estimate is None:
        return ""
    if state.silent:
        return f"{state.age_s:.0f} s old"
    doubt = Status(state.verdict.status).word if state.verdict.status else ""
    return doubt if trusted(state) else f"{doubt}, not to be trusted"


def silence(estimator: RobotEstimator, state: LiveState) -> str:
    """Why there are no readings, in a sentence that stays the same while this lasts; empty if there are."""
    robot = estimator.robot
    if not state.silent:
        return ""
    if state.arriving == "no port":
        return "The port is gone; waiting for it to come back."
    if state.arriving == "bytes":
        return f"Bytes arrive, but no frame of the format {robot.format}."
    if state.arriving == "nothing":
        return f"No readings: nothing arrives{' any more' * bool(state.recorded.counters.get('frames'))}."
    if state.refused_now:
        return "Frames arrive, but none of them can be used."
    if state.dropped_now or not state.other_streams:
        return "Frames arrive, but the estimator is done with none."
    return f"Frames arrive, but none of a stream of {robot.name}."


def _hint(estimator: RobotEstimator, state: LiveState) -> str:
    """What to look at while there are no readings; empty where `silence` and the other troubles say it all."""
    robot = estimator.robot
    if not state.silent or state.arriving in ("no port", "frames"):
        return ""
    if state.arriving == "bytes":
        channels = f" with {robot.channels} values" if robot.channels and robot.format == "millivolts" else ""
        return (
            state.foreign or f"Is the board's rate that of --baud, and does it send {robot.format}{channels}?"
        )
    if state.recorded.counters.get("frames"):
        return "Has the board stopped, or lost its power or its wires? A reset may start it again."
    return (
        "Is the board powered, wired and programmed? A reset may start it; some boards wait to be asked. "
        f"Its rate must be that of --baud, and its format {robot.format}, as {robot.name} says."
    )


def troubles(estimator: RobotEstimator, state: LiveState) -> list[str]:
    """What is or was wrong, one sentence or two each; none if all is and was well."""
    reason, look = silence(estimator, state), _hint(estimator, state)
    said = [f"{reason} {look}".strip()] if reason else []
    if not state.silent and state.verdict.status:
        said.append(verdict_words(state.verdict, estimator.sensors))
    elif state.doubted:
        said.append(f"{state.doubted} estimates did not explain their readings, at a time that is over.")
    if state.dropped:
        kept = "the recording has them." if state.recorded.path else "nothing is recorded."
        count = f"{state.dropped} time steps were not estimated"
        said.append(
            f"Overload: the estimator is slower than the stream. {count} so far, the newest first; {kept}"
            if state.dropped_now
            else f"{count}, in an overload that is over; {kept}"
        )
    for name, count, now in zip(estimator.sensors, state.missing, state.missing_now, strict=True):
        if count:
            since = "gives no reading" if now and not state.silent else "gave no reading"
            said.append(f"{name} {since} and is left out: {count} time steps so far.")
    unused = [name for name, used in zip(estimator.sensors, estimator.used, strict=True) if not used]
    if unused:
        said.append(f"Not used, as asked: {', '.join(unused)}.")
    if state.refused:
        said.append(f"{state.refused} time steps without an estimate. {state.refusal}")
    if state.other_streams:
        streams = ", ".join(f"{stream} ({count} frames)" for stream, count in state.other_streams.items())
        said.append(f"Streams that {estimator.robot.name} does not have: {streams}.")
    return said


def limits(estimator: RobotEstimator) -> list[str]:
    """What can never be told of this robot, with one reading for each unknown; and whether deviations are grown."""
    grown = f"Every ± is {estimator.grown:g} times what the estimator states."
    said = [grown] * (estimator.grown != 1.0)
    readings, unknowns = estimator.redundancy
    if readings > unknowns:
        return said
    counts = f"{readings} readings for {unknowns} unknowns"
    return [*said, f"No redundancy, {counts}: a wrong sensor looks like another shape and cannot be told."]


def alerts(estimator: RobotEstimator, state: LiveState) -> list[str]:
    """What is wrong at the moment, in sentences that stay the same while it is: to be read aloud once."""
    said = [silence(estimator, state)] if state.silent else []
    if state.dropped_now:
        said.append("Overload: the estimator is too slow, time steps are left out.")
    if not state.silent:
        said += [lasting_words(state.verdict, estimator.sensors)] * bool(state.verdict.status)
        pairs = zip(estimator.sensors, state.missing_now, strict=True)
        said += [f"{name} gives no reading and is left out." for name, gone in pairs if gone]
        said += ["Readings that cannot be used came."] * state.refused_now
    return said


def counters(state: LiveState) -> str:
    """What was received and what went wrong on the way."""
    known = state.recorded.counters
    others = [f"{known[name]} {name.replace('_', ' ')}" for name in _SHOWN_COUNTERS[1:] if known.get(name)]
    return ", ".join([f"{known.get('frames', 0)} frames", *others])


def block(estimator: RobotEstimator, state: LiveState) -> list[str]:
    """Lines for a terminal."""
    head = f"{state.seconds:.0f} s: {pace(estimator, state)}; {latency(state)}"
    rows, old = [str(quantity) for quantity in quantities(estimator, state)], mark(state)
    told = f"{old}: " if old else ""
    lines = [head, *(told + "   ".join(rows[k : k + 3]) for k in range(0, len(rows), 3))]
    return [*lines, counters(state), *limits(estimator), *troubles(estimator, state)]
