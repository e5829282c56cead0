"""From bytes to a shape, measured: an emulated board, a real port, reader and estimator, compared with the truth.

All readings are SYNTHETIC: the field of the magnets by magpylib, and white noise. What depends on the timing of the
computer is kept apart from what does not: estimates are taken from the recording, which holds every frame.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import torch

from edition1.estimation.base import Estimate
from edition1.kinematics.motion import tip_motion
from edition1.robot_file.robot_file import RobotFile
from edition1_companion.twins.played import PERIOD_S, Played, played, with_sensors
from edition1_companion.twins.recorded_run import play_and_record
from edition1_companion.twins.takes import Take
from edition1_live.emulate.board import passages
from edition1_live.emulate.emulator import Emulator
from edition1_live.emulate.faults import Faults
from edition1_live.emulate.links import open_link
from edition1_live.follow.follower import Follower
from edition1_live.follow.live_state import LiveEstimate, LiveState
from edition1_live.follow.robot_estimator import RobotEstimator, robot_estimator
from edition1_live.follow.session import follow
from edition1_live.follow.time_steps import TimeSteps
from edition1_live.record.recording import Recording, read_recording
from edition1_live.robot.calibration_poses import coordinate_columns

FAILURES = ("none", "no reading", "stuck", "stuck, not used")
"""What one sensor does: works; sends NaN; repeats its last reading; does so while told to `repro live --failed`."""


@dataclass(frozen=True)
class LiveRun:
    """A live session with an emulated board.

    Attributes
    ----------
    state
        At its end.
    latencies
        One row per estimate: ``line_ms, parse_ms, queue_ms, estimate_ms, total_ms``, from the moment at which the
        last byte of its frame was sent. They depend on the computer, and on what else it does.
    live, recorded
        The estimates of the session, and those from its recording, as :func:`estimates` returns them.
    """

    state: LiveState
    latencies: pd.DataFrame
    live: pd.DataFrame
    recorded: pd.DataFrame

    @property
    def words(self) -> str:
        """What the session says about itself; the numbers depend on the computer."""
        p50, p99 = self.latencies["total_ms"].quantile([0.5, 0.99])
        same = self.recorded[self.recorded["row"].isin(self.live["row"])].reset_index(drop=True)
        told = "equal to those from the recording"
        if self.state.dropped:  # after it a live estimator starts elsewhere than one that had the step
            told = "the recording has all of them"
        elif not same.equals(self.live):
            told = "DIFFERENT from those from the recording"
        return (
            f"{self.state.estimated} estimates, {self.state.dropped} time steps dropped; from the last byte to the "
            f"estimate {p50:.2f} ms in the median, {p99:.2f} ms at the 99th percentile; "
            f"{told}"
        )


def live_run(sent: Played, name: str = "", *, seed: int = 0) -> LiveRun:
    """Play readings in real time into a port, follow and record it, and estimate once more from the recording.

    Parameters
    ----------
    sent
        What the board sends.
    name
        One of :data:`edition1_live.follow.robot_estimator.ESTIMATORS`.
    seed
        Of estimators that draw random numbers.
    """
    estimator, found, stop = robot_estimator(sent.robot, name), list[LiveEstimate](), threading.Event()
    parts = list(passages(sent.take.readings(), sent.take.format))
    ends = np.cumsum(np.concatenate([np.diff(passage.ends, prepend=0) for passage in parts]))
    writes: list[tuple[int, int]] = []

    def said(_: str) -> None:
        if emulator.finished.is_set():  # the port is gone for good
            stop.set()

    estimator.prepared()
    emulator = Emulator(parts, open_link(), hang_up=True, each=lambda *write: writes.append(write))
    with TemporaryDirectory() as folder, emulator:
        path = Path(folder) / "recording"
        state = follow(
            emulator.address, estimator, output=path, stop=stop, each=found.append, warn=said, seed=seed
        )
        recording = read_recording(path)
    rows = [_row(one) for one in found]
    began_ns, sizes = np.array(writes).T
    sent_ns = began_ns[np.searchsorted(np.cumsum(sizes), ends[rows])]  # the writing that held the last byte
    times = zip(found, sent_ns.tolist(), strict=True)
    moments = np.array([(at, s.arrival_ns, s.parsed_ns, a, b) for (s, _, a, b), at in times])
    names = ("line_ms", "parse_ms", "queue_ms", "estimate_ms")
    latencies = pd.DataFrame(np.diff(moments) * 1e-6, columns=names)
    latencies["total_ms"] = (moments[:, -1] - moments[:, 0]) * 1e-6
    live = _table(sent, rows, [s.step.time_s for s in found], [one.estimate for one in found])
    return LiveRun(state, latencies, live, estimates(sent, recording, estimator, seed=seed))


def estimates(
    sent: Played, recording: Recording, estimator: RobotEstimator, *, seed: int = 0
) -> pd.DataFrame:
    """Estimate from a recording as a live session does, and put the truth beside it.

    Returns
    -------
    pandas.DataFrame
        One row per time step: its number ``row``, ``time_s``, for each coordinate truth, estimate and standard
        deviation (``delta_x_1_true_mm, delta_x_1_mm, delta_x_1_std_mm``, NaN for estimators without), and the
        distance of the estimated tip from the true one, ``tip_error_mm``; ``status`` of the monitor, above 0 in an
        alarm.
    """
    steps, follower = TimeSteps(estimator.streams, sent.robot.rate_hz), Follower(estimator, seed=seed)
    rows, times, found = [], [], []
    for host_ns, frame in recording.as_frames():
        for step in steps.add(host_ns, [frame]):
            _, estimate = follower.step(step)
            if estimate is not None:
                rows.append(frame.sequence)
                times.append(step.time_s)
                found.append(estimate)
    return _table(sent, rows, times, found)


def failures(
    robot: RobotFile,
    *,
    sensors: tuple[int, ...] = (3, 6),
    failed: int = 1,
    at_s: float = 4.0,
    rate_hz: float = 40.0,
    seconds: float = PERIOD_S,
    seed: int = 0,
    name: str = "kalman",
) -> pd.DataFrame:
    """Let one sensor fail in each of the ways of :data:`FAILURES`; play, record, estimate.

    Parameters
    ----------
    robot
        Of one segment.
    sensors
        Numbers of sensors.
    failed
        Number of the sensor that fails, from 1.
    at_s
        When it fails [s].
    rate_hz, seconds, seed
        As for :func:`played`.
    name
        One of :data:`edition1_live.follow.robot_estimator.ESTIMATORS`.

    Returns
    -------
    pandas.DataFrame
        ``sensors, failure, time_s, tip_error_mm, tip_std_mm, status``; ``tip_std_mm`` is the root of the sum of the
        variances of the tip's position by the covariance of the estimator, ``status`` that of the monitor.
    """
    parts = []
    for n in sensors:
        sent = played(with_sensors(robot, n), rate_hz=rate_hz, seconds=seconds, seed=seed)
        for failure in FAILURES:
            broken = replace(sent, take=_failing(sent.take, failure, failed, at_s))
            run = play_and_record(broken.take, Faults(), readings=len(broken.q), seed=seed)
            estimator = robot_estimator(
                broken.robot, name, failed=[failed] if failure == FAILURES[-1] else []
            )
            table = estimates(broken, run.recording, estimator)
            shown = ["time_s", "tip_error_mm", "tip_std_mm", "status"]
            parts.append(table[shown].assign(sensors=n, failure=failure))
    return pd.concat(parts, ignore_index=True)


def failure_summary(table: pd.DataFrame, at_s: float) -> pd.DataFrame:
    """After the failure: error of the tip, its standard deviation as estimated, and how often there is an alarm."""
    after = table[table["time_s"] >= at_s].groupby(["sensors", "failure"], sort=False)
    return pd.DataFrame(
        {
            "median_tip_error_mm": after["tip_error_mm"].median(),
            "largest_tip_error_mm": after["tip_error_mm"].max(),
            "median_tip_std_mm": after["tip_std_mm"].median(),
            "alarm_percent": after["status"].apply(lambda status: 100 * (status > 0).mean()),
        }
    ).reset_index()


def _failing(take: Take, failure: str, failed: int, at_s: float) -> Take:
    values, after = take.values.copy(), take.time_s >= at_s
    if failure == "no reading":
        values[after, failed - 1] = np.nan
    elif failure != "none":
        values[after, failed - 1] = values[np.argmax(after), failed - 1]
    return replace(take, values=values)


def _row(one: LiveEstimate) -> int:
    frame = one.step.frames[0]
    assert frame is not None
    assert frame.sequence is not None
    return frame.sequence


def _table(sent: Played, rows: list[int], times: list[float], estimates: list[Estimate]) -> pd.DataFrame:
    robot = sent.robot.robot
    q, truth = torch.stack([one.q for one in estimates]), sent.q[rows]
    unknown = torch.full((robot.n_q,) * 2, torch.nan).to(q)
    C = torch.stack([unknown if one.covariance is None else one.covariance for one in estimates])
    deviation = C.diagonal(dim1=-2, dim2=-1).sqrt()
    found: dict[str, object] = {"row": rows, "time_s": times}
    for k, (column, factor) in enumerate(coordinate_columns(sent.robot).items()):
        name, unit = column.rsplit("_", 1)
        for kind, values in (("true_", truth), ("", q), ("std_", deviation)):
            found[f"{name}_{kind}{unit}"] = (values[:, k] / factor).numpy()
    tips, J = tip_motion(robot, q)
    away = tips - robot.tip(truth)[..., :3, 3]
    found["tip_error_mm"] = 1e3 * torch.linalg.vector_norm(away, dim=-1).numpy()
    spread = (J @ C @ J.mT).diagonal(dim1=-2, dim2=-1).sum(-1)
    found["tip_std_mm"] = 1e3 * spread.clamp_min(0).sqrt().numpy()
    found["status"] = [int(one.diagnostics["status"]) for one in estimates]
    return pd.DataFrame(found)
