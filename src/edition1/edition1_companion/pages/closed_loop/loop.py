"""Closing the loop (future work of Baaij et al. 2023, section 6): the bend of the rig's digital twin is controlled.

The same controller, at 40 Hz, is fed with ours or with the true bend. Everything is SYNTHETIC. Ours is the filter of
Table 2, which knows nothing of the commands, or one of `edition1_companion.pages.closed_loop.filter`. The command that
follows from a reading is applied from the next reading on: a delay of one sample, beside the lag and the hysteresis
of the twin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float

from edition1.errors import require
from edition1_companion.pages.closed_loop.curvature_control import (
    CurvatureController,
    Gains,
    InverseMap,
    fit_inverse,
)
from edition1_companion.pages.closed_loop.filter import CommandAlone, LoopFilter
from edition1_companion.pages.closed_loop.identification import (
    Commanded,
    Segment,
    commanded,
    identify,
    record_experiment,
)
from edition1_companion.pages.closed_loop.rig_loop import SteppedRig, sessions
from edition1_companion.recordings.baaij2023 import split
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ, RIG_SENSORS
from edition1_companion.twins.pneumatic_actuation import DURATION_S
from edition1_companion.twins.pneumatic_rig import REGULATOR_HZ, SEQUENCE_S, TwinConfig, record_twin
from edition1_companion.twins.rig_map import BendMap, fit_map
from edition1_companion.twins.rig_networks import RECORDING_SEED
from edition1_companion.twins.sensor_board import analogue_readings

REFERENCES = ("step", "circle", "lemniscate")
"""References that the loops are judged on."""
TRAINING = "raised cosine"
"""The reference that gains were tuned on: one-sided as T1 and with its period, along both axes."""
SETTLE_S, SKIPPED_S = 3.0, 5.0
"""Time from empty chambers to the start of the loop, and the time after it that is not judged, of filter and loop to
settle [s]."""
ESTIMATORS = ("readings", "lag", "lag and command", "command alone")
"""Ours: the filter of Table 2; the same with the lag of the readings; this with the command as input; and, to
compare, the bend that the command alone lets expect, without any reading."""


@dataclass(frozen=True)
class Learned:
    """What the loop knows of its rig.

    Attributes
    ----------
    bend_map
        Of ours, from the recorded files of T5.train.
    inverse
        Of the controller, from pressures and true bends of T5.train.
    segment
        Of ours with the lag, from the recorded files of T5.train and of the experiment.
    """

    bend_map: BendMap
    inverse: InverseMap
    segment: Segment


@cache
def training_part(config: TwinConfig) -> tuple[Commanded, InverseMap]:
    """Record T5 with a twin; return T5.train with its commands, and the inverse map of its true bends."""
    recorded = record_twin(config, seed=RECORDING_SEED, trajectories=["T5"])
    raw, read = recorded.raw["T5"], recorded.read["T5"]
    frames, motion = len(split(read)[0]), raw.motion
    end = SEQUENCE_S + frames / len(read) * DURATION_S["T5"]
    first, last = np.searchsorted(motion.time_s, [SEQUENCE_S, end])
    kept = slice(int(first), int(last), int(REGULATOR_HZ / 10))
    inverse = fit_inverse(config.chambers, motion.pressures_mbar[kept], 1e3 * motion.q[kept, :2])
    return commanded(config.chambers, raw, read, frames=frames), inverse


@cache
def learn(config: TwinConfig) -> Learned:
    """Record T5 and the experiment with a twin, and fit to T5.train and the experiment; some seconds."""
    training, inverse = training_part(config)
    bend_map = fit_map(training.recording)
    excited = record_experiment(config, seed=RECORDING_SEED)
    return Learned(bend_map, inverse, identify(bend_map, excited, training, inverse.rest_mm))


def reference_mm(name: str, time_s: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 2"]:
    """Bend to follow [mm], about (2.5, 0), near the middle of the workspace.

    Steps of 3 to 9 mm every 5 s; a circle of 4 mm in 10 s; a lemniscate of 3 and 6 mm in 10 s, as T3; and for the
    tuning a raised cosine of 5 mm along each axis in 5 s.
    """
    phase = 2.0 * np.pi * time_s / 10.0
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [-3.0, 4.0], [-3.0, -5.0], [0.0, -5.0]])
    shapes = {
        "step": corners[(time_s // 5.0).astype(int) % len(corners)],
        "circle": 4.0 * np.column_stack([np.cos(phase), np.sin(phase)]),
        "lemniscate": np.column_stack([3.0 * np.sin(2.0 * phase), 6.0 * np.sin(phase)]),
        TRAINING: 2.5 * (1.0 - np.cos(2.0 * phase))[:, None] * np.array([0.6, -1.0]),
    }
    return shapes[name] + np.array([2.5, 0.0])


@dataclass(frozen=True)
class Run:
    """One loop.

    Parameters
    ----------
    reference
        One of :data:`REFERENCES`, or :data:`TRAINING`.
    gains
        Of the controller.
    session
        One of `edition1_companion.pages.closed_loop.rig_loop.SESSIONS`; with ``"truth"`` the true bend is fed back.
    seed
        Of the readings.
    estimator
        One of :data:`ESTIMATORS`.
    late
        By how many readings the true bend is fed back late, for the tuning.
    """

    reference: str
    gains: Gains
    session: str
    seed: int = 0
    estimator: str = ESTIMATORS[0]
    late: int = 0


@dataclass(frozen=True)
class LoopTrace:
    """What happened in some runs, from the start of the loop.

    Attributes
    ----------
    time_s
        Of the readings.
    reference_mm, bend_mm, fed_back_mm
        Reference, true bend, and the bend that the controller was told.
    bounded
        Whether the command was at the bound of the pressures.
    """

    time_s: Float[np.ndarray, " t"]
    reference_mm: Float[np.ndarray, "t runs 2"]
    bend_mm: Float[np.ndarray, "t runs 2"]
    fed_back_mm: Float[np.ndarray, "t runs 2"]
    bounded: Bool[np.ndarray, "t runs"]


def run_loops(
    config: TwinConfig, learned: Learned, runs: Sequence[Run], *, duration_s: float = 25.0
) -> LoopTrace:
    """Close the loops of several runs, all at once.

    Parameters
    ----------
    config
        The twin.
    learned
        From :func:`learn`; of another twin if the rig has changed since.
    runs
        Which ones.
    duration_s
        Length [s].

    Raises
    ------
    InputError
        If the duration is not above the time that is not judged.
    """
    require(duration_s > SKIPPED_S, "duration_s", "run_loops", f"above {SKIPPED_S:g} [s]", duration_s)
    ticks, waited = round(duration_s * RIG_RATE_HZ), round(SETTLE_S * RIG_RATE_HZ)
    time_s = np.arange(ticks) / RIG_RATE_HZ
    wanted = np.stack([reference_mm(run.reference, time_s) for run in runs], axis=1)
    own = np.array([k for k, run in enumerate(runs) if run.session != "truth"], dtype=int)
    drawn = sessions(config, [runs[k].session for k in own], [runs[k].seed for k in own], ticks)
    rig, ours = SteppedRig(config), _estimators(learned)
    members = {e: [i for i, k in enumerate(own) if runs[k].estimator == e] for e in ESTIMATORS}
    filters = {e: ours[e].init(torch.zeros(len(at), 3).double()) for e, at in members.items() if at}
    controller = CurvatureController(config.chambers, learned.inverse, [run.gains for run in runs])
    control = controller.init()
    pressures = np.full((len(runs), 3), config.chambers.offset_mbar)
    state, rest = rig.init(len(runs)), np.zeros((len(own), RIG_SENSORS))
    torque = np.zeros((len(runs), 2))
    for _ in range(waited):
        state, *_ = rig.step(state, pressures)

    bends, fed_backs, bounded = [], [], []
    for tick in range(ticks):
        state, q, q_magnet = rig.step(state, pressures)
        following = config.chambers.bending_torque(pressures)  # held up to the next reading
        bends.append(1e3 * q[:, :2])
        fed_back = np.stack([bends[max(tick - run.late, 0)][k] for k, run in enumerate(runs)])
        if len(own):
            clean = analogue_readings(config.board, q[own], q_magnet[own])
            rest = clean if tick == 0 else rest  # no command has been applied yet
            u = torch.from_numpy(
                np.column_stack([drawn.readings_mv(tick, clean, rest), torque[own], following[own]])
            )
            for e, state_of_filters in filters.items():
                at = members[e]
                filters[e], estimate = ours[e].step(state_of_filters, u[at], time_s[tick])
                fed_back[own[at]] = estimate.diagnostics["bend_mm"].numpy()
        torque = following
        control, pressures = controller.step(control, wanted[tick], fed_back)
        fed_backs.append(fed_back)
        bounded.append(control.bounded)
    return LoopTrace(time_s, wanted, np.stack(bends), np.stack(fed_backs), np.stack(bounded))


def _estimators(learned: Learned) -> dict[str, Any]:
    bend_map, segment = learned.bend_map, learned.segment
    no_lag = replace(segment, across=np.zeros_like(segment.across), error_mv=bend_map.error_mv)
    return {
        "readings": LoopFilter(bend_map, no_lag, follows=False),
        "lag": LoopFilter(bend_map, segment, follows=False),
        "lag and command": LoopFilter(bend_map, segment, follows=True),
        "command alone": CommandAlone(bend_map, segment),
    }


CONTROLLERS = {
    "PI": Gains(0.5, 2.0, False),
    "PI and feed-forward": Gains(0.7, 0.5, True),
    "without margin": Gains(2.0, 45.0, True),
}
"""Half of the best gains for the training reference, so that the loop stays stable when the rig is twice as soft.

The true bend was fed back 0.2 s late: the lag of the segment, as a margin for a late estimate; for the last without
the delay. For the nominal twin; the last two with feed-forward. A test chooses them again.
"""
