"""SYNTHETIC bend and light-bulb tests in the file formats of Mitchell et al. (2021); nothing in them was measured.

What a Hall sensor and motion capture would have seen of a module that bends as told, written as the authors' recorder
and OptiTrack wrote theirs, so that both pass through the loaders of the recordings. The field comes from magpylib.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from edition1_companion.recordings.mitchell2021_conventions import file_axes
from edition1_companion.twins.bend_curves import bend_readings

START_UNIX_S = 1_600_000_000.0
"""When the first synthetic recording begins [s since 1970 UTC]; invented."""
DRAINED = 15
"""Rows from a buffer at the beginning of a Hall file: 14 to 23 in the authors'."""
BODY_MM = 116.0
"""Length of the arc below the body Module, whose end is captured: about that of the authors' [mm]."""
CAPTURE_HZ = 120
UTC_OFFSET_H = -5


@dataclass(frozen=True)
class BendRecorder:
    """How the synthetic module is made and recorded.

    Parameters
    ----------
    length_m
        Distance of sensor and magnet along the arc [m].
    noise_mt
        Noise of the Hall sensor on every axis [mT].
    transverse_gain
        The sensor's gain across the body over that along it; invented.
    rest_mt
        Constant field across the body [mT], along the model's x and y: what a magnet that is a little tilted or off
        the axis would add; invented.
    direction_rad
        By how much the capture's azimuth is ahead of the bend direction [rad]; invented.
    lag_s
        By how much the Hall sensor's clock is ahead of the capture's [s].
    rate_hz
        Readings per second; their intervals scatter.
    """

    length_m: float = 13e-3
    noise_mt: float = 0.025
    transverse_gain: float = 1.2
    rest_mt: tuple[float, float] = (0.3, -0.5)
    direction_rad: float = 0.4
    lag_s: float = 0.5
    rate_hz: float = 61.0


RECORDER = BendRecorder()


def up_and_down(
    time_s: Float[np.ndarray, " times"], *, duration_s: float = 24.0
) -> Float[np.ndarray, " times"]:
    """Bend angle [rad] of a test that rises to 50 deg and falls again: at rest for 4 s, then a squared sine.

    Examples
    --------
    >>> np.degrees(up_and_down(np.array([0.0, 16.0, 30.0]))).round(6)
    array([ 0., 50.,  0.])
    """
    phase = np.clip((time_s - 4.0) / duration_s, 0.0, 1.0)
    return np.radians(50.0) * np.sin(np.pi * phase) ** 2


def tightening(time_s: Float[np.ndarray, " times"], events: Sequence[float]) -> Float[np.ndarray, " times"]:
    """Bend angle [rad] of a module that grasps a bulb (40 deg from 5 s on) and is bent by 8 deg at each event [s]."""
    grasp = np.radians(40.0) * np.clip((time_s - 3.0) / 2.0, 0.0, 1.0)
    bumps = [np.radians(8.0) * np.exp(-(((time_s - at) / 0.5) ** 2)) for at in events]
    return grasp + np.sum(bumps, axis=0, initial=0.0) if bumps else grasp


def write_bend_takes(
    folder: Path,
    *,
    seed: int,
    takes: Sequence[tuple[int, int]] = ((0, 1), (0, 2), (2, 1), (4, 1)),
    recorder: BendRecorder = RECORDER,
    duration_s: float = 24.0,
) -> None:
    """Write synthetic bend tests: Hall files and motion captures, 60 deg of direction from test to test.

    Parameters
    ----------
    folder
        Where the authors' folders ``experiment_data`` and ``mocap`` are made.
    seed
        Of noise and intervals.
    takes
        Numbers of test and try.
    recorder
        How the module is made and recorded.
    duration_s
        From the first to the last movement [s]; rests of 4 s come before and after.
    """
    for k, (test, attempt) in enumerate(takes):
        rng = np.random.default_rng([seed, test, attempt])
        start_s = START_UNIX_S + 100.0 * k
        direction = np.radians(60.0) * test
        time_s = _uneven(duration_s + 8.0, recorder.rate_hz, rng)
        field = _field(up_and_down(time_s, duration_s=duration_s), direction, recorder, rng)
        name = f"{test}_try_{attempt}"
        _write_hall(folder / f"experiment_data/bend_test_{name}.csv", start_s + time_s, field)
        capture_s = np.arange(1.0, duration_s + 7.0, 1.0 / CAPTURE_HZ)
        bend = up_and_down(capture_s, duration_s=duration_s)
        _write_capture(
            folder / f"mocap/bend_{name}.csv",
            start_s + 1.0 - recorder.lag_s,
            bend,
            direction + recorder.direction_rad,
        )


def write_light_tests(
    folder: Path,
    *,
    seed: int,
    events: Sequence[Sequence[float]] = ((10.0, 15.0, 20.0), (9.0, 14.0, 20.0), (15.0,)),
    recorder: BendRecorder = RECORDER,
) -> None:
    """Write synthetic light-bulb tests: file -1 is moved and then at rest for 15 s, files 0, 1, … have events.

    Parameters
    ----------
    folder, seed, recorder
        As for :func:`write_bend_takes`.
    events
        Times at which the bulb is tightened [s], per file.
    """
    for k, at in enumerate([None, *events]):
        rng = np.random.default_rng([seed, 100 + k])
        time_s = _uneven(30.0, recorder.rate_hz, rng)
        bend = up_and_down(time_s, duration_s=11.0) if at is None else tightening(time_s, at)
        field = _field(bend, np.radians(30.0), recorder, rng)
        path = folder / f"experiment_data/light_test_{k - 1}.csv"
        _write_hall(path, START_UNIX_S + 10_000.0 + 100.0 * k + time_s, field)


def _uneven(duration_s: float, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    steps = rng.uniform(0.8, 1.2, int(duration_s * rate_hz)) / rate_hz
    return np.cumsum(steps) - steps[0]


def _field(
    bend: np.ndarray, direction: float, recorder: BendRecorder, rng: np.random.Generator
) -> np.ndarray:
    """Readings [mT] in the axes of the files."""
    towards = np.array([np.cos(direction), np.sin(direction)])
    q = torch.from_numpy(bend[:, None] * towards)
    u = bend_readings(q, recorder.length_m)
    u[:, :2] = recorder.transverse_gain * u[:, :2] + torch.tensor(recorder.rest_mt, dtype=u.dtype)
    return file_axes(u).numpy() + recorder.noise_mt * rng.standard_normal(u.shape)


def _write_hall(path: Path, unix_s: np.ndarray, field_mt: np.ndarray) -> None:
    """Rows ``[x y z],unix_time`` in thousands of counts of 0.01 mT, after the emptying of a buffer."""
    burst_s = unix_s[0] - 0.01 - 3e-4 * np.arange(DRAINED, 0, -1)
    rows = np.round(np.concatenate([np.repeat(field_mt[:1], DRAINED, axis=0), field_mt]) / 10.0, 3)
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [
        f"[{row[0]:g} {row[1]:g} {row[2]:g}],{t!r}\n"
        for row, t in zip(rows, np.concatenate([burst_s, unix_s]).tolist(), strict=True)
    ]
    path.write_text("".join(lines), encoding="utf-8")


def _write_capture(path: Path, start_unix_s: float, bend: np.ndarray, azimuth: float) -> None:
    """Export of OptiTrack: the y axis of the body Module tilts by the bend, towards an azimuth from z to x."""
    about = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
    quaternions = Rotation.from_rotvec(bend[:, None] * about).as_quat()
    zone = timezone(timedelta(hours=UTC_OFFSET_H))
    began = datetime.fromtimestamp(start_unix_s, zone)
    at = f"{began:%Y-%m-%d %I.%M.%S}.{began.microsecond // 1000:03d} {began:%p}"
    kinds = ["Rotation"] * 4 + ["Position"] * 3 + ["Error Per Marker"]
    header = [
        f"Format Version,1.21,Take Name,{path.stem},Capture Frame Rate,{CAPTURE_HZ},Export Frame Rate,{CAPTURE_HZ},"
        f"Capture Start Time,{at},Total Frames in Take,{len(bend)},Total Exported Frames,{len(bend)},"
        "Rotation Type,Quaternion,Length Units,Millimeters",
        "",
        ",".join(["", "", *["Rigid Body"] * 16]),
        ",".join(["", "", *["Ground"] * 8, *["Module"] * 8]),
        ",".join(["", "", *["0"] * 16]),
        ",".join(["", "", *kinds, *kinds]),
        ",".join(["Frame", "Time", *["X", "Y", "Z", "W", "X", "Y", "Z", "error"] * 2]),
    ]
    ground = "0,0,0,1,0,0,0,0"
    # The end of an arc: (1 - cos) / bend = bend / 2 sinc^2(bend / 2), and sin / bend.
    aside = BODY_MM * bend / 2 * np.sinc(bend / 2 / np.pi) ** 2
    place = np.stack(
        [np.sin(azimuth) * aside, BODY_MM * np.sinc(bend / np.pi), np.cos(azimuth) * aside], axis=1
    )
    frames = [
        f"{k},{k / CAPTURE_HZ:.6f},{ground},{','.join(f'{x:.6f}' for x in row)},0"
        for k, row in enumerate(np.concatenate([quaternions, place], axis=1))
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([*header, *frames]) + "\n", encoding="utf-8")
