"""What an emulated board can play: a recording, or SYNTHETIC readings of the robots of the three papers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from edition1.errors import bad_input, require
from edition1.robot_file.columns import FORMATS
from edition1_live.emulate.board import Reading

CURVES = ("spiral", "flower", "seagull")
TRAJECTORIES = ("T0", "T1", "T2", "T3", "T4", "T5")
SOURCES = ("lemniscate", *CURVES, *(f"twin:{name}" for name in TRAJECTORIES), "arm")
"""Synthetic takes: T3 of Baaij et al. [mT]; the curves of Mitchell et al. [mT]; the twin of the rig [mV]; the IMUs of
Martin et al."""
# Names and rates stand here too, since this module needs no torch; a test holds them to the others.
STEPS, RATE_HZ, RIG_RATE_HZ, TIME_STEP = 400, 40.0, 40.0, 0.01
KEPT = Path(__file__).with_name("courses.npz")
"""The takes at their own rates, of seed 0."""
ADC_STEPS = 16
"""Steps of the converter of the rig in 1 mV."""
COUNT_MT = 0.01
"""One count of the Hall sensor of Mitchell et al. [mT]."""
ARM_S, ARM_HZ = 20.0, 35.0


@dataclass(frozen=True)
class Take:
    """Readings that a board can send.

    Attributes
    ----------
    label
        What they are; says so if they are synthetic.
    format
        Wire format that their unit is meant for.
    time_s
        Time of each since the board was switched on [s].
    stream
        Stream of each.
    values
        Readings in the unit of the format, rounded to what it can carry; NaN where one has fewer.
    period_s
        After this time the take can begin again [s].
    """

    label: str
    format: str
    time_s: Float[np.ndarray, " readings"]
    stream: Int[np.ndarray, " readings"]
    values: Float[np.ndarray, "readings channels"]
    period_s: float

    def readings(self, *, loop: bool = False) -> Iterator[Reading]:
        """Yield the readings one by one; over and over if ``loop``."""
        heads = list(zip(self.time_s.tolist(), self.stream.tolist(), strict=True))
        rows = [tuple(row) for row in self.values.tolist()]
        for turn in count() if loop else range(1):
            for (time_s, stream), row in zip(heads, rows, strict=True):
                yield Reading(turn * self.period_s + time_s, stream, row)


def open_take(source: str, format: str = "", *, rate_hz: float | None = None, seed: int = 0) -> Take:
    """Return the readings of a source in the unit of a wire format.

    Parameters
    ----------
    source
        One of :data:`SOURCES`, or the path of a recording.
    format
        One of :data:`edition1_live.wire.formats.FORMATS`; by default that of the source. Our own frames
        take any source, ``csv`` any of one stream, the other text formats only what they were made for.
    rate_hz
        Readings per second of each stream; by default 40 Hz for Baaij et al., 100 for Mitchell et al., 35 for Martin
        et al., and as recorded. Readings in between are interpolated, but those of a recording only move in time.
    seed
        Of the synthetic readings.

    Raises
    ------
    InputError
        If there is no such source or format, they do not fit, or the rate is not positive.
    """
    if format and format not in FORMATS:
        raise bad_input("format", "open_take", f"one of {', '.join(FORMATS)}", format)
    require(rate_hz is None or 0 < rate_hz < math.inf, "rate_hz", "open_take", "above zero [Hz]", rate_hz)
    if source == "lemniscate":
        take = _lemniscate(rate_hz or RATE_HZ)
    elif source in CURVES:
        take = _curve(source, rate_hz or 1 / TIME_STEP, format)
    elif source.removeprefix("twin:") in TRAJECTORIES and source.startswith("twin:"):
        take = _twin(source.removeprefix("twin:"), rate_hz or RIG_RATE_HZ, seed)
    elif source == "arm":
        take = _arm(rate_hz or ARM_HZ, seed)
    elif Path(source).is_file():
        take = _recorded(Path(source), rate_hz)
    else:
        expected = f"one of {', '.join(SOURCES)}, or the path of a recording"
        raise bad_input("source", "open_take", expected, repr(source))
    chosen = format or take.format
    one_stream = ["csv"] if (take.stream == 0).all() else []
    fitting = dict.fromkeys((take.format, "frames", *one_stream))
    if chosen not in fitting:
        fitting = " or ".join(fitting)
        raise bad_input("format", f"the take {source}", fitting, chosen)
    values = carried(chosen, take.values)
    return Take(take.label, chosen, take.time_s, take.stream, values, take.period_s)


def carried(format: str, values: np.ndarray) -> np.ndarray:
    """Round to what the format carries, so that what is sent can be compared with what arrives."""
    if format == "frames":
        return values.astype(np.float32).astype(float)
    if format == "csv":
        return values
    return np.round(values, {"hall": 0, "millivolts": 4, "quaternions": 6}[format]) + 0.0


def even(label: str, format: str, values: np.ndarray, rate_hz: float) -> Take:
    """Readings of one stream at equal steps of time."""
    n = len(values)
    return Take(label, format, np.arange(n) / rate_hz, np.zeros(n, np.int64), values, n / rate_hz)


def _resampled(values: np.ndarray, rate_hz: float, wanted_hz: float) -> np.ndarray:
    if wanted_hz == rate_hz:
        return values
    at = np.arange(0, len(values) - 1, rate_hz / wanted_hz)
    return np.column_stack([np.interp(at, np.arange(len(values)), column) for column in values.T])


def _lemniscate(rate_hz: float) -> Take:
    label = "lemniscate T3 of one segment [mT], SYNTHETIC"
    if rate_hz == RATE_HZ:
        return even(label, "frames", _kept("lemniscate"), rate_hz)
    from edition1_companion.twins.courses import lemniscate_mt

    return even(label, "frames", lemniscate_mt(max(2, round(STEPS * rate_hz / RATE_HZ))), rate_hz)


def _curve(name: str, rate_hz: float, format: str) -> Take:
    """Field of the cube; counts in the order of the board for its lines, else mT in the axes of the model."""
    u = _kept(name)
    if format == "frames":
        return even(f"{name} [mT], SYNTHETIC", "frames", _resampled(u, 1 / TIME_STEP, rate_hz), rate_hz)
    # Axes of the files, as `file_axes` has them; the board sends the component along the body last.
    counts = np.column_stack([-u[:, 1], u[:, 0], -u[:, 2]]) / COUNT_MT
    label = f"{name} [counts], SYNTHETIC"
    return even(label, "hall", _resampled(counts, 1 / TIME_STEP, rate_hz).round(), rate_hz)


def _twin(name: str, rate_hz: float, seed: int) -> Take:
    if seed:
        from edition1_companion.twins.courses import rig_mv

        u = rig_mv(name, seed)
    else:
        u = _kept(f"twin:{name}") / ADC_STEPS
    label = f"{name} of the digital twin [mV], SYNTHETIC"
    return even(label, "millivolts", _resampled(u, RIG_RATE_HZ, rate_hz), rate_hz)


def _arm(rate_hz: float, seed: int) -> Take:
    if rate_hz == ARM_HZ and not seed:
        table = _kept("arm")
    else:
        from edition1_companion.twins.courses import arm_table

        table = arm_table(seed, duration_s=max(ARM_S, 2 / rate_hz), rate_hz=rate_hz)
    time_s, stream = table[:, 0], table[:, 1].astype(np.int64)
    label = "eight IMUs on an arm, SYNTHETIC"
    return Take(label, "quaternions", time_s, stream, table[:, 2:], float(time_s[-1] + time_s[1]))


def _kept(name: str) -> np.ndarray:
    with np.load(KEPT) as courses:
        return courses[name]


def _recorded(path: Path, rate_hz: float | None) -> Take:
    from edition1_live.record.recording import read_recording

    recording = read_recording(path)
    stream = recording.stream
    n = len(stream)
    require(n >= 2, "source", "open_take", "a recording of at least two frames", n)
    if rate_hz is None:
        time_s = np.maximum.accumulate(recording.time_s - recording.time_s[0])
    else:
        time_s = np.arange(n) / (rate_hz * len(np.unique(stream)))
    period_s = time_s[-1] * n / (n - 1)
    label = "; ".join([path.name, *recording.remarks])
    return Take(label, recording.format, time_s, stream, recording.values, period_s)
