"""What a person should know of a live session, in words. Nothing here changes; whoever shows it only reads.

A session knows :class:`Facts` of itself. They become a :class:`Moment`: numbers, words, and what the page draws.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from repro.common import Array
from repro.estimators.base import Estimate
from repro.estimators.monitor import (
    BEYOND_BOUNDS,
    CONSISTENT,
    FROZEN,
    INCONSISTENT,
    LEFT_OUT,
    STATUS,
    TRUSTED,
    UNCHECKED,
    UNDETERMINED,
)
from repro.estimators.track import trajectory
from repro.robot import Robot
from repro_board.view import view

SILENT_S = 1.0
"""After this time nothing comes, or what is shown is old [s]."""
BY_BOUNDS = 0.9 / math.sqrt(12)
"""Standard deviation from which a coordinate is known by its bounds alone [widths of the bounds]."""
_DAMAGED = ("checksum_errors", "malformed", "oversized")
_ASK = "Is --baud the rate of the board, and does it send what the robot file says?"


Row = tuple[float, Array, Estimate]
"""Time [s], readings and estimate of a time step."""


class Facts(NamedTuple):
    """What a session knows of itself at one time."""

    robot: Robot
    estimator: str
    failed: tuple[int, ...]
    grown: float
    last: Row | None
    """Time [s], readings and estimate of the newest time step that was estimated."""
    age_s: float
    """How old that is; zero while it is of now."""
    running_s: float
    silent_s: float
    """Time since the session began, and since the last byte [s]."""
    lost: str
    """Why the port is away; empty while it is there."""
    blind: str
    """Which view has failed, and why."""
    counts: Mapping[str, int]
    recent: Mapping[str, int]
    span_s: float
    """Of the whole session, and of the last ``span_s`` seconds."""
    latencies: tuple[float, ...]
    remarks: tuple[str, ...]
    """Of parser and steps, and of what is missing, so far."""
    cause: str
    """The last remark since the last estimate: those before are no cause of a fault."""

    @property
    def status(self) -> int:
        """The number of what the monitor says."""
        return 0 if self.last is None else int(self.last[2].details.get("status", 0))

    @property
    def apart_s(self) -> float:
        """Three time steps of the robot file [s]."""
        return 3.0 / (self.robot.rate_hz or 3.0)

    @property
    def quiet(self) -> bool:
        """Whether nothing comes for longer than time steps are apart."""
        return self.silent_s > max(SILENT_S, self.apart_s)


class Moment(NamedTuple):
    """What is shown of a session."""

    made_s: float
    """When, by the clock of the session [s]."""
    numbers: tuple[str, ...]
    summary: tuple[tuple[str, str], ...]
    alarms: tuple[str, ...]
    notes: tuple[str, ...]
    trusted: bool
    doubt: str
    """Why the shape is not to be trusted; empty if it is."""
    suspects: tuple[int, ...]
    """Readings of the parts that the monitor names."""
    age_s: float
    last: tuple[float, Array, Array] | None
    """Time [s], readings, and these less what the estimate predicts, in units of the noise."""
    shape: Mapping[str, Any] | None
    """What the viewer of the page draws; None where there is no page."""


class Watched(Protocol):
    """What those who show a session may see of it, and tell it."""

    robot: Robot
    moment: Moment

    def guarded(self, work: Callable[[], Any], view: str = "") -> Any:
        """Work in another thread; what fails there is told."""
        ...

    def blinded(self, view: str, error: BaseException) -> str:
        """Take note that a view has failed, and say so."""
        ...


def moment(facts: Facts, made_s: float, *, with_shape: bool) -> Moment:
    """Return what is shown."""
    last, robot, status = facts.last, facts.robot, facts.status
    named, seen, shape = suspects(last[2] if last else None), None, None
    if last is not None and np.isfinite(last[2].q).all():
        t, u, found = last
        noise: Any = robot.total_noise
        seen = t, u, (u - found.u_hat) / noise
        if with_shape:
            C: Any = found.covariance
            shape = dict(view(robot, found.q[None], [0.0], "now", covariance=C[None]).data)
            shape["suspects"] = [k for k in named if k < len(robot.sensors)]
    doubt = "old" if facts.age_s else STATUS[status] if status not in (CONSISTENT, UNCHECKED) else ""
    doubtful = tuple(np.flatnonzero(np.isin(robot.parts, named)).tolist())
    return Moment(
        made_s, numbers(facts), tuple(summary(facts).items()), sentences(facts), notes(facts),
        not facts.age_s and status in TRUSTED, doubt, doubtful, facts.age_s, seen, shape,
    )  # fmt: skip


def suspects(found: Estimate | None) -> tuple[int, ...]:
    """Return the parts that the monitor names."""
    return () if found is None else tuple(np.flatnonzero(found.details.get("suspects", ())).tolist())


def sentences(facts: Facts) -> tuple[str, ...]:
    """Return what is wrong at the moment, in sentences that stay the same as long as it is."""
    wrong = _of_the_wire(facts)
    return (wrong,) if wrong else (*_of_the_pace(facts), *_of_the_estimate(facts))


def _of_the_wire(facts: Facts) -> str:
    """Return why there are no time steps; nothing if there are some."""
    counts, recent = facts.counts, facts.recent
    late, why = facts.running_s > SILENT_S, facts.cause or _ASK
    causes = {
        "The port is gone; we wait until it is there again.": facts.lost,
        "Nothing arrives yet. Is the board powered and programmed? Reset it.": late and not counts["bytes"],
        "Nothing arrives any more. Has the board lost its power or its wires?": counts["bytes"]
        and facts.quiet,
        f"Bytes arrive, but no readings. {why}": late and recent["bytes"] and not recent["frames"],
        f"What arrives does not fit this robot. {why}": (
            late and recent["frames"] and not recent["estimates"]
        ),
    }
    return next((text for text, holds in causes.items() if holds), "")


def _of_the_pace(facts: Facts) -> list[str]:
    """Return what is odd about the number of frames and time steps."""
    recent, stated = facts.recent, facts.robot.rate_hz or 0.0
    damaged = sum(recent.get(name, 0) for name in _DAMAGED)
    share, rate = damaged / max(damaged + recent["frames"], 1), recent["time_steps"] / facts.span_s
    goes_on = facts.silent_s < max(SILENT_S / 4, facts.apart_s)
    steady = goes_on and facts.counts["time_steps"] > recent["time_steps"] > 0
    another = stated and steady and not damaged and not 0.8 < rate / stated < 1.25
    word = "More" if rate > stated else "Fewer"
    odd = {
        f"About {10 * round(10 * share) or 5} % of the frames are damaged: look at cable and --baud.": share
        > 0.05,
        f"{word} than the {stated:g} time steps of the robot file arrive in a second.": another,
        "The estimator is slower than the board: time steps are left out.": recent["skipped"],
    }
    return [text for text, holds in odd.items() if holds]


def _of_the_estimate(facts: Facts) -> list[str]:
    """Return what the monitor says, which bounds the shape touches, and which sensors say nothing."""
    if facts.last is None or facts.age_s:
        return []
    (_, u, found), robot, named = facts.last, facts.robot, suspects(facts.last[2])
    names = robot.part_names
    who, leave = " or ".join(names[k] for k in named), "".join(f" (--failed {k + 1})" for k in named[:1])
    causes = (
        "something magnetic nearby, several sensors, or a robot that is not as described (repro calibrate)"
    )
    words = {
        LEFT_OUT: f"What {who or 'a sensor'} reads does not fit the other readings and is left out{leave}.",
        INCONSISTENT: f"Do not trust the shape: it does not explain the readings. The cause may be {who or causes}.",
        FROZEN: "Do not trust the shape: the board repeats itself, all its readings are old.",
        UNDETERMINED: "Do not trust the shape: there are fewer readings than unknowns.",
        BEYOND_BOUNDS: "The readings fit only beyond the bounds of the robot file. The shape stays within them.",
    }
    touched = np.flatnonzero(found.details.get("at_bound", ()))
    near = np.flatnonzero(found.details.get("too_near", ()))
    there = np.bincount(robot.parts, np.isfinite(u), len(names)) > 0
    return [
        *([words[facts.status]] if facts.status in words else []),
        *(f"{robot.coordinates[c]} is at a bound of the robot file." for c in touched),
        *(
            f"{names[k]} is so close to a magnet that its field is not known: it is left out."
            for k in np.unique(robot.parts[near])
        ),
        *(
            f"There is no reading of {names[k]}; it is left out."
            for k in np.flatnonzero(~there)
            if k not in facts.failed
        ),
    ]


def notes(facts: Facts) -> tuple[str, ...]:
    """Return what else to know: what was asked for, and what happened so far."""
    skipped, unused = facts.counts["skipped"], ", ".join(facts.robot.part_names[k] for k in facts.failed)
    bare = facts.last is not None and facts.status == UNCHECKED
    said = {
        facts.blind: facts.blind,
        f"Not used, as asked: {unused}.": unused,
        f"Every ± is {facts.grown:g} times what the estimator states.": facts.grown != 1.0,
        f"{skipped} time steps were left out because newer ones had come; a recording has them.": skipped,
        "There are no more readings than unknowns: a wrong sensor looks like another shape.": bare,
    }
    return (*facts.remarks, *(text for text, holds in said.items() if holds))


def numbers(facts: Facts) -> tuple[str, ...]:
    """Return the tip and the coordinates, each with its standard deviation."""
    robot, last = facts.robot, facts.last
    if last is None or not np.isfinite(last[2].q).all():
        return ()
    t, u, found = last
    low: Any = robot.lower
    q, C = found.q, np.asarray(found.covariance)
    p, G = robot.tip_slopes(q)
    values, slopes = np.concatenate([p, q]), np.concatenate([G, np.eye(len(q))])
    sd = np.sqrt(np.maximum(np.diag(slopes @ C @ slopes.T), 0.0))
    widths = np.concatenate([np.full(3, robot.length), robot.upper - low])
    units = [(f"tip {axis}", "mm", 1e3) for axis in "xyz"]
    units += trajectory([t], [u], [found], robot, None).units()
    said = []
    for (name, unit, factor), x, s, w in zip(units, values, sd, widths, strict=True):
        if w == 0:  # fixed by its bounds
            continue
        digits = 4 if unit == "rad" else 2
        known = f"{name} {factor * x:.{digits}f} ± {factor * s:.{digits}f} {unit}"
        alone = " by its bounds alone" if s > BY_BOUNDS * w and not name.startswith("tip") else ""
        said.append(f"{name} undetermined" if not s <= w else known + alone)
    return tuple(said)


def summary(facts: Facts) -> dict[str, str]:
    """Return fit, pace, latency and losses in words."""
    fit, counts = "no estimate yet", facts.counts
    if facts.last is not None:
        found = facts.last[2]
        chi2, dof, fit = float(found.chi2), float(found.dof), STATUS[facts.status]
        if chi2 >= 0 and dof > 0:
            fit += f", residuals {math.sqrt(chi2 / dof):.1f} times the noise"
    p50, p99 = 1e3 * np.quantile(facts.latencies or [np.nan], [0.5, 0.99])
    own = ("bytes", "time_steps", "estimates", "skipped")
    others = [f"{n} {name.replace('_', ' ')}" for name, n in counts.items() if n and name not in own]
    pace = f"{facts.recent['time_steps'] / facts.span_s:.3g} time steps/s, {counts['estimates']} estimates"
    return {
        "fit": f"{facts.age_s:.0f} s old; {fit}" if facts.age_s else fit,
        "pace": f"{pace} by {facts.estimator}",
        "latency": f"{p50:.2g} ms in the median, {p99:.2g} ms in 99 %"
        if facts.latencies
        else "no estimate yet",
        "received": ", ".join(others) or "nothing",
    }
