"""Are faults of sensors noticed? The faults that an emulated robot can have, with the monitor watching; synthetic."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import torch
from edition1.estimation.base import Estimate
from edition1.estimation.consistency import Status, Verdict, lasting
from edition1.estimation.levenberg_marquardt import jacobian
from edition1.kinematics.motion import tip_motion
from edition1.robot_file.load import load_robot
from edition1.robot_file.robot_file import RobotFile
from edition1_live.emulate.robot_readings import RobotReadings, course, readings_along
from edition1_live.emulate.sensor_faults import SensorFaults, with_sensor_faults
from edition1_live.follow.robot_estimator import RobotEstimator, robot_estimator
from jaxtyping import Float
from scipy import stats
from torch import Tensor
from tqdm import tqdm

from edition1_companion.book.project import find_project
from edition1_companion.book.studies import Study

SCENARIOS: dict[str, dict[str, float]] = {
    "none": {},
    "start bent": {},
    "jump": {},
    "no reading": {"nan": 1},
    "unplugged": {"unplug": 1},
    "stuck": {"stick": 1},
    "saturated": {"saturate": 1},
    "gain +5 %": {"gain": 1},
    "magnet near": {"magnet": 150.0},
    "noise x 5": {"noise": 5.0},
}
"""By name, faults as :class:`~edition1_live.emulate.sensor_faults.SensorFaults` takes them; 1 is any sensor."""
FAULT_AT_S, DURATION_S = 2.0, 6.0
SHORTEST_S, FEWEST = 0.25, 10
"""Time and readings within which a fault is to be noticed: the larger of the two."""
TIMES = 3.0
"""A tip error counts if it exceeds the half width of the fault-free 95 % interval by this factor."""
SEEN, CLEAR = 5.0, 30.0
"""Size of what a fault adds to the residuals, in standard deviations: from where it must be noticed, and named."""


def watched(
    described: RobotFile, estimator: RobotEstimator, scenario: str, *, sensor: int, seed: int
) -> pd.DataFrame:
    """Let a robot move, let a sensor fail, and watch.

    Parameters
    ----------
    described
        The robot; it is as described, and its file says the rate.
    estimator
        Of this robot.
    scenario
        One of :data:`SCENARIOS`.
    sensor
        Number of the sensor that fails, from 1.
    seed
        Of motion and noise.

    Returns
    -------
    pandas.DataFrame
        One row for each reading: ``time_s``; ``status`` of the monitor, and the sensors that it names, ``suspects``;
        ``holds``, whether the 95 % ellipsoid holds the true configuration; ``tip_error`` and ``tip_interval``, the
        distance of the tip from the true one, and 1.96 standard deviations that it has without a fault, by the noise
        alone (root of the sum of the variances) [m]; ``signal``, the size of what the fault adds to the readings, of
        that which no configuration can [standard deviations].
    """
    time_s = np.arange(round(DURATION_S * described.rate_hz)) / described.rate_hz
    lead_s = 20.0 if scenario == "start bent" else 0.0  # the robot has long been moving
    q = course(described, time_s + lead_s, seed=seed)
    if scenario == "jump":
        after = time_s >= FAULT_AT_S
        q[after] = course(described, time_s[after] + 40.0, seed=seed)
    sound = readings_along(described, time_s, q, rng=np.random.default_rng([seed, 1]))
    named = {name: sensor if value == 1 else value for name, value in SCENARIOS[scenario].items()}
    sent = with_sensor_faults(sound, SensorFaults(**named), from_s=FAULT_AT_S, seed=seed)  # type: ignore[arg-type]
    truth, J = torch.from_numpy(q), jacobian(described.sensing(), torch.from_numpy(q))[1]
    tips, J_tip = tip_motion(described.robot, truth)
    free = described.noise**2 * torch.linalg.inv(J.mT @ J)
    interval = 1.96 * (J_tip @ free @ J_tip.mT).diagonal(dim1=-2, dim2=-1).sum(-1).sqrt()
    estimates, verdicts = _followed(described, estimator, sent)
    q_hat, C = (torch.stack([getattr(found, name) for found in estimates]) for name in ("q", "covariance"))
    error = (q_hat - truth).unsqueeze(-1)
    squared = (error.mT @ torch.linalg.solve(C, error)).flatten()
    return pd.DataFrame(
        {
            "time_s": time_s,
            "status": [verdict.status for verdict in verdicts],
            "suspects": [verdict.suspects for verdict in verdicts],
            "holds": squared <= stats.chi2.isf(0.05, q.shape[1]),
            "tip_error": torch.linalg.vector_norm(described.robot.tip(q_hat)[..., :3, 3] - tips, dim=-1),
            "tip_interval": interval,
            "signal": _signal(described, sound, sent, J),
        }
    )


def alarm_counts(run: pd.DataFrame, sensor: int, rate_hz: float) -> dict[str, int]:
    """What became of one run, after the fault.

    ``due`` readings are those where the tip has been off by :data:`TIMES` its interval and the signal above
    :data:`SEEN` for the time within which that is to be noticed; ``noticed`` are those of them with an alarm.
    """
    patience = max(FEWEST, math.ceil(SHORTEST_S * rate_hz))
    after, alarm = (run["time_s"] >= FAULT_AT_S).to_numpy(), (run["status"] > Status.CONSISTENT).to_numpy()
    wrong, signal = (
        after & (run["tip_error"] > TIMES * run["tip_interval"]).to_numpy(),
        run["signal"].to_numpy(),
    )
    due, clear = (lasting(wrong & (signal > size), patience) for size in (SEEN, CLEAR))
    named = [suspects for suspects in run.loc[after, "suspects"] if suspects]
    right = [sensor - 1 in suspects for suspects in named]
    counts = {
        "wrong": wrong.sum(),
        "due": due.sum(),
        "noticed": (due & alarm).sum(),
        "unseen": lasting(wrong & (signal <= SEEN), patience).sum(),
        "clear": clear.any(),
        "named": bool(named),
        "named_clear": bool(named) and clear.any(),
        "named_right": bool(named) and right[-1],
        "named_readings": len(named),
        "named_readings_right": sum(right),
        "alarms": (alarm & after).sum(),
        "alarms_before": (alarm & ~after).sum(),
        "trusted": (after & ~alarm).sum(),
        "trusted_hold": (after & ~alarm & run["holds"]).sum(),
        "readings": after.sum(),
    }
    return {name: int(count) for name, count in counts.items()}


def alarm_trials(described: RobotFile, name: str, scenario: str, *, trials: int, seed: int) -> dict[str, int]:
    """Sums of :func:`alarm_counts` over trials, each with its own motion, noise and sensor that fails.

    Parameters
    ----------
    described
        The robot; its file says the rate.
    name
        One of :data:`edition1_live.follow.robot_estimator.ESTIMATORS`.
    scenario
        One of :data:`SCENARIOS`.
    trials, seed
        How many, and the seed of the first.
    """
    estimator, rows = robot_estimator(described, name), []
    for trial in range(trials):
        sensor = 1 + (seed + trial) % len(described.channel)
        run = watched(described, estimator, scenario, sensor=sensor, seed=seed + trial)
        rows.append(alarm_counts(run, sensor, described.rate_hz))
    return {"trials": trials, **{name: sum(row[name] for row in rows) for name in rows[0]}}


def alarm_sums(
    rates_hz: dict[str, float],
    estimators: Sequence[str],
    scenarios: Sequence[str],
    *,
    trials: int,
    seed: int,
    progress: bool = False,
) -> pd.DataFrame:
    """:func:`alarm_trials` for all robots, estimators and scenarios, one row for each of them.

    Parameters
    ----------
    rates_hz
        Names of robots in ``data/robots``, and readings per second of each.
    estimators, scenarios, trials, seed
        As for :func:`alarm_trials`.
    progress
        Show a bar.
    """
    cases = [(robot, name, scenario) for robot in rates_hz for name in estimators for scenario in scenarios]
    rows = []
    for robot, name, scenario in tqdm(cases, desc="alarms", disable=not progress):
        described = load_robot(find_project().data / "robots" / f"{robot}.toml")
        described = replace(described, rate_hz=rates_hz[robot])
        sums = alarm_trials(described, name, scenario, trials=trials, seed=seed)
        rows.append({"robot": robot, "estimator": name, "scenario": scenario} | sums)
    return pd.DataFrame(rows)


def alarm_table(study: pd.DataFrame) -> pd.DataFrame:
    """What the study says, in per cent.

    Returns
    -------
    pandas.DataFrame
        ``robot, estimator, scenario``; ``off_percent``, readings after the fault at which the tip is off;
        ``noticed_percent`` of those that are due; ``unseen_percent``, readings at which it is off and the residuals
        cannot tell; ``named_percent``, trials with a clear signal in which a sensor was named, and
        ``named_right_percent`` of those in which one was; ``alarms_before``, readings with an alarm before the fault;
        ``holds_percent``, trusted readings whose 95 % ellipsoid holds the truth.
    """
    share = {
        "off_percent": ("wrong", "readings"),
        "noticed_percent": ("noticed", "due"),
        "unseen_percent": ("unseen", "readings"),
        "named_percent": ("named_clear", "clear"),
        "named_right_percent": ("named_right", "named"),
        "holds_percent": ("trusted_hold", "trusted"),
    }
    columns = {name: study[name] for name in ("robot", "estimator", "scenario")}
    for column, (part, whole) in share.items():
        columns[column] = 100 * study[part] / study[whole].where(study[whole] > 0)
    return pd.DataFrame(columns | {"alarms_before": study["alarms_before"].astype(int)})


def _followed(
    described: RobotFile, estimator: RobotEstimator, sent: RobotReadings
) -> tuple[list[Estimate], list[Verdict]]:
    state, estimates, verdicts = estimator.method.init(estimator.start, seed=0), [], []
    for time_s, values in zip(sent.time_s.tolist(), sent.values.tolist(), strict=True):
        state, found = estimator.method.step(state, described.signal(values), time_s, mask=estimator.use)
        estimates.append(found)
        verdicts.append(state.verdict)
    return estimates, verdicts


def _signal(
    described: RobotFile, sound: RobotReadings, sent: RobotReadings, J: Tensor
) -> Float[np.ndarray, " n"]:
    """What a fault adds, less the part that another configuration would explain (to first order)."""
    channels = list(described.channel)
    added = torch.from_numpy((sent.values - sound.values)[:, channels]) / described.noise
    gone = torch.isnan(added)
    J = torch.where(gone.unsqueeze(-1), 0.0, J)
    added = torch.where(gone, 0.0, added).unsqueeze(-1)
    explained = J @ torch.linalg.lstsq(J, added, driver="gelsd").solution
    return torch.linalg.vector_norm(added - explained, dim=(-2, -1)).numpy()


STUDIES = (
    Study(
        "alarms",
        alarm_sums,
        {
            "rates_hz": {"two_segments": 100.0, "one_segment": 40.0},
            "estimators": ["levenberg_marquardt", "kalman"],
            "scenarios": list(SCENARIOS),
            "trials": 20,
            "seed": 1000,
        },
        ("progress",),
    ),
)
