r"""The recordings T0 to T5 of Baaij et al. 2023, section 5: raw files and pipeline.

Readings at 40 Hz and motion capture at 40 Hz have no common trigger: both show when the segment is first inflated,
and are aligned there (section 5.2). The pipeline repeats the released one; each repair is counted in `Recording`.
Only the start of the readings is found by another rule, unless the released one is named: it takes noise for a start.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float

from edition1.errors import InputError, bad_input, require
from edition1.sensing.relations import relations
from edition1_companion.recordings.rig_alignment import (
    RULES,
    check_lags,
    doubts,
    start_of_motion,
    start_of_readings,
)
from edition1_companion.recordings.rig_capture import RingMotion, read_ring_motion
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ, RIG_SENSORS, rig_earth_axis, rig_robot
from edition1_companion.recordings.sources import data_dir

FOLDER = "baaij2023"
NAMES = {
    "T0": "2022-05-02_RAND_200mBar_200s_P0_R1",
    "T1": "2022-05-02_T1_270deg_P0_R1",
    "T2": "2022-05-02_T2_P0_R1",
    "T3": "2022-05-02_T3_90deg_P0_R1",
    "T4": "2022-05-02_SPIRAL_FORWARD_120s_P0_R1",
    "T5": "2022-05-02_FLOWER_SLOW_NOMINAL_P0_R1",
}
"""The authors' names of the recordings."""
INFLATION_S, DEFLATION_S = 8.0, 5.0
"""Cut at the start and at the end [s]."""
CLIPPED_MV = (0.0, 2047.9375)
"""Ends of the converter's range [mV]."""
READINGS = [f"u{j + 1}" for j in range(RIG_SENSORS)]


@dataclass(frozen=True)
class Recording:
    """Configurations and readings of one recording at common frames, 40 Hz.

    Attributes
    ----------
    name
        Name of its files.
    frame
        Number of each frame (``time_idx`` of the merged files), from 0.
    q
        Configurations ``(delta_x, delta_y, delta_L)`` by motion capture [m].
    u
        Readings [mV].
    repairs
        What was repaired or cut, in frames, by name; empty for merged files, which do not tell.
    remarks
        Sentences on its alignment for whoever uses it: where the two rules of the start differ, and what speaks
        against it. Empty where nothing does.
    """

    name: str
    frame: np.ndarray
    q: Float[np.ndarray, "frames 3"]
    u: Float[np.ndarray, "frames 3"]
    repairs: dict[str, int] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.frame)

    @property
    def time_s(self) -> Float[np.ndarray, " frames"]:
        """Times after the first frame [s]."""
        return self.frame / RIG_RATE_HZ

    def relations(self) -> Float[np.ndarray, "frames 3 5"]:
        """Relations ``xi = (lambda, d, alpha, beta, theta)`` of every sensor [rad, m], of the robot as drawn."""
        return relations(rig_robot(), torch.from_numpy(self.q), rig_earth_axis()).angles().numpy()


def raw_paths(name: str, folder: Path | None = None) -> tuple[Path, Path]:
    """Files of motion capture and readings of a recording below the paper's folder; they need not exist."""
    data = data_folder(folder)
    capture = data / "raw_motion_capture_data" / name.split("_")[0] / f"{name}_Quat.csv"
    return capture, data / "sensor_data" / f"{name}_SV.csv"


def data_folder(folder: Path | None = None) -> Path:
    """Return the authors' folder of experimental data below the paper's folder; it need not exist."""
    return (folder or data_dir() / FOLDER) / "datasets" / "experimental"


def read_readings(path: Path) -> tuple[Float[np.ndarray, "frames 3"], int]:
    """Read a file of readings (``NAME_SV.csv``): columns u1, u2, u3 [mV], one row per 1/40 s.

    Rows at the end that are not complete are dropped.

    Returns
    -------
    tuple
        Readings [mV], and how many rows were dropped.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    InputError
        A missing column; a value that is no number; an incomplete row before the end; saturated readings; no reading.
    """
    table = pd.read_csv(path, skip_blank_lines=True)
    if missing := [column for column in READINGS if column not in table.columns]:
        raise bad_input("columns", path.name, ", ".join(READINGS), f"none named {', '.join(missing)}")
    try:
        u = table[READINGS].to_numpy(dtype=float)
    except ValueError as error:
        raise bad_input("readings", path.name, "numbers [mV]", error) from error
    incomplete = np.asarray(~np.isfinite(u).all(axis=1))
    kept = int(np.argmax(incomplete)) if incomplete.any() else len(u)
    require(kept != 0, "readings", path.name, "rows of three numbers", "none in the first row")
    require(incomplete[kept:].all(), "readings", path.name, "complete up to the end", f"a gap in row {kept}")
    u = u[:kept]
    clipped = (u <= CLIPPED_MV[0]) | (u >= CLIPPED_MV[1])
    if clipped.any():
        counts = ", ".join(
            f"{n} of {name}" for name, n in zip(READINGS, clipped.sum(axis=0), strict=True) if n
        )
        raise bad_input(
            "readings", path.name, f"above {CLIPPED_MV[0]:g} and below {CLIPPED_MV[1]:g} mV", counts
        )
    return u, len(table) - kept


def merge(
    motion: RingMotion,
    u: Float[np.ndarray, "rows 3"],
    name: str,
    *,
    skip: int = 1,
    dropped: int = 0,
    rule: str = "noise",
) -> Recording:
    """Align motion capture and readings at the start of inflation, cut both ends, and number the frames from 0.

    Parameters
    ----------
    motion, u
        From `edition1_companion.recordings.rig_capture.read_ring_motion` and :func:`read_readings`.
    name
        Name of the recording.
    skip
        Frames by which the later of the two is cut further than the two starts differ. The released code drops one
        frame more than that, when they differ (the default); 0 puts the two starts at one frame.
    dropped
        Incomplete readings that were dropped, to be reported.
    rule
        How the start of the readings is found, see
        :func:`~edition1_companion.recordings.rig_alignment.start_of_readings`.

    Raises
    ------
    InputError
        No detectable start; less than 13 s in common, of which nothing is left; or, by the rule ``"noise"``, an
        alignment that the readings contradict: at another lag, half a second away or more, a function of the bend
        explains them twice as well. By the released rule this is only said, in the remarks.
    """
    k_q, k_u = start_of_motion(motion.q, name), start_of_readings(u, name, rule=rule)
    differing = _other_start(u, k_u, name, rule)
    extra = skip if k_q != k_u else 0
    cut_q, cut_u = (k_q - k_u + extra, 0) if k_q > k_u else (0, k_u - k_q + extra)
    q, u = motion.q[cut_q:], u[cut_u:]
    common = min(len(q), len(u))
    # time_idx of the released code starts at 0, or at the frame skipped where motion capture is cut.
    index = np.arange(common) + (extra if cut_q else 0)
    kept = (
        (index >= INFLATION_S * RIG_RATE_HZ) & (index < index[-1] - DEFLATION_S * RIG_RATE_HZ)
        if common
        else []
    )
    if not np.any(kept):
        expected = f"longer than {INFLATION_S + DEFLATION_S:g} s together"
        raise bad_input("motion capture and readings", name, expected, f"{common / RIG_RATE_HZ:g} s")
    repairs = {
        "frames interpolated": motion.filled,
        "gaps": motion.gaps,
        "incomplete readings dropped": dropped,
        "frames of motion capture cut to align": cut_q,
        "readings cut to align": cut_u,
        "frames of motion capture without reading": len(q) - common,
        "readings without frame": len(u) - common,
        "cut at the ends": common - int(np.sum(kept)),
    }
    q, u = q[:common][kept], u[:common][kept]
    remarks = [*differing, *doubts(check_lags(q, u), name, refuse=rule == "noise")]
    return Recording(name, np.arange(len(q)), q, u, repairs, tuple(remarks))


def _other_start(u: np.ndarray, k_u: int, name: str, rule: str) -> list[str]:
    """Say what the other rule of the start finds, where it differs."""
    other = RULES[1 - RULES.index(rule)]
    try:
        found = start_of_readings(u, name, rule=other)
    except InputError:
        return [f"{name}: the readings begin in row {k_u} by the rule {rule!r}, nowhere by {other!r}."]
    if found == k_u:
        return []
    apart = (found - k_u) / RIG_RATE_HZ
    return [
        f"{name}: the readings begin in row {k_u} by the rule {rule!r}, in row {found} ({apart:+g} s) by {other!r}."
    ]


def process(name: str, folder: Path | None = None, *, skip: int = 1, rule: str = "noise") -> Recording:
    """Read the raw files of a recording and run the pipeline: configurations, alignment, cut.

    Parameters
    ----------
    name
        A value of :data:`NAMES`, or the name of a twin's recording.
    folder
        The paper's folder; by default ``baaij2023`` below `edition1_companion.recordings.sources.data_dir`.
    skip, rule
        See :func:`merge`; the authors' own files are those of the rule ``"released"``.
    """
    capture, sensors = raw_paths(name, folder)
    u, dropped = read_readings(sensors)
    return merge(read_ring_motion(capture), u, name, skip=skip, dropped=dropped, rule=rule)


def split(recording: Recording, test_share: float = 0.3) -> tuple[Recording, Recording]:
    """Split off the end as a test set, and number the frames of both from 0.

    Parameters
    ----------
    recording
        The whole.
    test_share
        Share of the test set: 0.3 in the released code, 0.2 in section 5.3.

    Raises
    ------
    InputError
        If the share is not between 0 and 1, or a part would be empty.
    """
    require(0 < test_share < 1, "test_share", "split", "between 0 and 1", test_share)
    last = np.ptp(recording.frame) * (1.0 - test_share) + recording.frame[0]
    test = recording.frame >= last
    if test.all() or not test.any():
        raise bad_input("recording", "split", "long enough for two parts", f"{len(recording)} frames")
    parts = []
    for chosen in (~test, test):
        frame = recording.frame[chosen]
        parts.append(replace(recording, frame=frame - frame[0], q=recording.q[chosen], u=recording.u[chosen]))
    return parts[0], parts[1]
