"""What faults do to a recording: an emulated board, a real port and the recorder, compared with what was sent.

All readings are SYNTHETIC. Played as fast as it is read, nothing is lost that a fault does not lose, so that a seed
tells every number; only the estimate of the clock needs real time.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from edition1_companion.twins.recorded_run import Run, play_and_record
from edition1_companion.twins.takes import open_take
from edition1_live.emulate.faults import Faults
from edition1_live.wire.formats import parser

CASES = {
    "none": Faults(),
    "flips": Faults(flips=1e-3),
    "drops": Faults(drops=1e-3),
    "duplicates": Faults(duplicates=1e-3),
    "bursts": Faults(bursts=2e-4, burst_bytes=64),
    "stalls": Faults(stalls=5e-4, stall_s=0.1),
    "disconnects": Faults(disconnects=1e-3, away_s=0.2),
    "reboots": Faults(reboots=1e-3, boot_s=0.2),
}
"""One fault at a time; chances as in :class:`edition1_live.emulate.faults.Faults`."""
TOGETHER = Faults(
    flips=1e-3, drops=1e-3, duplicates=1e-3, bursts=2e-4, burst_bytes=64, stalls=5e-4, stall_s=0.1,
    disconnects=1e-3, away_s=0.2, reboots=1e-3, boot_s=0.2,
)  # fmt: skip
"""All of them."""
FORMATS = {"frames": "twin:T2", "millivolts": "twin:T2", "hall": "flower", "quaternions": "arm"}
"""Of each wire format what is sent in it."""


def faults_table(*, readings: int = 4000, seed: int = 0, rate_hz: float = 1000.0) -> pd.DataFrame:
    """Record the lemniscate in our own frames under each of :data:`CASES`, and under all faults together.

    Parameters
    ----------
    readings
        How many the board takes in each run; it may send fewer, when the port is away or it starts anew.
    seed
        Of the faults.
    rate_hz
        Readings per second.

    Returns
    -------
    pandas.DataFrame
        One row per case: ``fault``, frames ``sent``, ``intact``, ``accepted``, ``wrong`` (accepted, but never sent
        so), ``intact_lost``, then the counters of the recorder.
    """
    take = open_take("lemniscate", rate_hz=rate_hz)
    rows = []
    for name, faults in (CASES | {"all together": TOGETHER}).items():
        run = play_and_record(take, faults, readings=readings, seed=seed)
        rows.append({"fault": name} | _compared(run))
    return pd.DataFrame(rows)


def formats_table(
    *, readings: int = 4000, seed: int = 0, flips: float = 1e-3
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Record with flipped bits in each wire format.

    Parameters
    ----------
    readings
        How many are sent in each format.
    seed
        Of the flips.
    flips
        Chance of each byte that one of its bits flips.

    Returns
    -------
    errors, series
        One row per format: frames ``sent``, ``intact``, ``accepted``, ``wrong``, ``intact_lost`` and counters; and
        the readings of the rig's first sensor that the recordings in ``frames`` and ``millivolts`` hold: ``format,
        index, u_1_mV, wrong``, the index being that of the last frame that is known to have been sent.
    """
    rows, series = [], []
    for format, source in FORMATS.items():
        run = play_and_record(open_take(source, format), Faults(flips=flips), readings=readings, seed=seed)
        rows.append({"format": format, "readings": source} | _compared(run))
        if source.startswith("twin"):
            found = run.matches()
            values = run.recording.frames[run.recording.channels[0]].to_numpy()
            part = {"index": np.maximum.accumulate(found), "u_1_mV": values, "wrong": found < 0}
            series.append(pd.DataFrame(part).assign(format=format))
    return pd.DataFrame(rows), pd.concat(series, ignore_index=True)


def trace_tables(
    *,
    readings: int = 2000,
    seed: int = 0,
    rate_hz: float = 100.0,
    disconnects: float = 1e-3,
    reboots: float = 1e-3,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Record the lemniscate while the port disappears, the board starts anew, and bits flip and get lost.

    Parameters
    ----------
    readings, seed, rate_hz
        As for :func:`faults_table`.
    disconnects, reboots
        Chances of each frame; away for 2 s and silent for 1 s.

    Returns
    -------
    recorded, counters
        Frames of the recording with the time at which they were sent: ``time_s, device_s, sequence, u_1_mT …``; and
        what the parser has counted until then: ``time_s, connection``, and the counters.
    """
    faults = Faults(flips=3e-4, drops=3e-4, disconnects=disconnects, away_s=2.0, reboots=reboots, boot_s=1.0)
    run = play_and_record(open_take("lemniscate", rate_hz=rate_hz), faults, readings=readings, seed=seed)
    found, frames = run.matches(), run.recording.frames
    time_s = np.concatenate([passage.time_s for passage in run.sent])
    recorded = pd.DataFrame(
        {
            "time_s": np.where(found < 0, np.nan, time_s[found]),
            "device_s": 1e-6 * frames["device_us"].to_numpy(float),
            "sequence": frames["sequence"].to_numpy(np.int64),
        }
        | {f"u_{j + 1}_mT": frames[name] for j, name in enumerate(run.recording.channels)}
    )
    return recorded, _counted(run)


def clock_estimate(*, drift_ppm: float = 500.0, seconds: float = 12.0, rate_hz: float = 100.0) -> str:
    """Play and record in real time, and say what the recorder makes of a board whose clock is fast.

    What it says depends on this computer's timing: it is shown, not a result.

    Parameters
    ----------
    drift_ppm
        By how much the clock is fast [parts per million].
    seconds
        How long; the recorder estimates no drift from less than 10 s.
    rate_hz
        Readings per second.
    """
    run = play_and_record(
        open_take("lemniscate", rate_hz=rate_hz),
        Faults(drift_ppm=drift_ppm),
        readings=round(seconds * rate_hz),
        seed=0,
        speed=1.0,
    )
    fit = run.recording.metadata["clock"]
    told = "no drift estimated"
    if fit and fit["drift_ppm"] is not None:
        told = f"estimated {fit['drift_ppm']:.0f} ppm, standard deviation {fit['drift_error_ppm']:.0f} ppm"
    frames = run.counters["frames"]
    return f"The clock is fast by {drift_ppm:.0f} ppm: {told}, from {frames} frames in {seconds:.0f} s."


def _compared(run: Run) -> dict[str, int]:
    found = run.matches()
    intact = np.concatenate([passage.intact for passage in run.sent])
    delivered = np.zeros(len(intact), bool)
    delivered[found[found >= 0]] = True
    return {
        "sent": len(intact),
        "intact": int(intact.sum()),
        "accepted": len(found),
        "wrong": int((found < 0).sum()),
        "intact_lost": int((intact & ~delivered).sum()),
        **{name: value for name, value in run.counters.items() if name != "frames"},
    }


def _counted(run: Run) -> pd.DataFrame:
    """Let a parser read what was sent frame by frame; return its counters after each."""
    reader, connection, rows = parser(run.recording.format), 0, []
    for passage in run.sent:
        if passage.connection != connection:
            connection = passage.connection
            reader.reopened()
        start = 0
        for time_s, end in zip(passage.time_s.tolist(), passage.ends.tolist(), strict=True):
            reader.feed(passage.data[start:end])
            start = end
            rows.append({"time_s": time_s, "reconnects": connection} | reader.counters.as_dict())
    return pd.DataFrame(rows)
