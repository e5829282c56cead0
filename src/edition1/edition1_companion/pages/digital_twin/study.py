r"""The digital twin of the rig beside what is known of the authors' sensors; all numbers of the twin are SYNTHETIC.

Known are the means, ranges and slopes of the readings, how well simple functions describe them, how recordings
differ, and the workspace: from networks trained on the released recordings, and from the paper. Everything here goes
through the files: the twin writes raw ones, the pipeline reads them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import torch
from edition1.sensing.magnetic import field_at_sensors
from edition1.sensing.magnets import ring
from jaxtyping import Float

from edition1_companion.recordings.baaij2023 import Recording, split
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ, RIG_SENSORS, rig_robot
from edition1_companion.twins.pneumatic_actuation import TRAJECTORIES
from edition1_companion.twins.pneumatic_rig import FILL_S, TwinRecordings
from edition1_companion.twins.rig_twins import ELONGATION_MM
from edition1_companion.twins.sensor_board import analogue_readings

SLOW, FAST = ("T0", "T4"), ("T2", "T3")
"""Slow recordings and fast lemniscates; of T1 nothing is known but its error in Table 2."""
MEAN_MV = (1282.0, 1205.0, 1387.0)
RANGE_MV = ((144.0, 156.0), (60.0, 74.0), (82.0, 110.0))
SLOPE = ((-5.3, -3.0), (0.9, -2.8), (-4.3, -1.2))
GAIN = (3333.0, 982.0, -891.0)
TABLE_2 = {
    "T0": (9.90, 3.90, 0.37, 3.70, 0.44, 3.50),
    "T1": (8.80, 4.40, 0.36, 6.50, np.nan, np.nan),
    "T2": (11.10, 4.30, 0.78, 13.60, 0.74, 5.90),
    "T3": (12.30, 4.60, 0.52, 4.50, 0.47, 3.10),
    "T4": (3.01, 1.08, 0.33, 2.40, 0.52, 3.10),
    "T5": (1.60, 0.58, 0.24, 1.90, 0.24, 1.40),
}
"""Table 2: errors of the readings [mV, %] and of the bend along x and y [mm, %]; their ratios are the ranges."""
KNOWN_ELONGATION = {
    name: {"mean_mm": mean, "per_mm2": slope, "centre_x_mm": centre}
    for name, mean, slope, centre in zip(
        TRAJECTORIES,
        ELONGATION_MM,
        (0.0255, 0.0255, -0.038, 0.0255, np.nan, 0.0255),  # the middle of 0.021 to 0.030, of T4 nothing
        (np.nan, 5.1, -2.0, np.nan, np.nan, 1.9),
        strict=True,
    )
}
"""Elongation of the authors' recordings, from running means and variances of networks that were trained on them."""


def quadratic(q: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 6"]:
    """Columns ``1, x, y, x²/2, xy, y²/2`` of the bend in mm: what a quadratic map is linear in."""
    x, y = 1e3 * q[:, 0], 1e3 * q[:, 1]
    return np.column_stack([np.ones(len(x)), x, y, x * x / 2, x * y, y * y / 2])


def facts_table(twin: TwinRecordings) -> pd.DataFrame:
    """Compare the twin with each fact about the authors' sensors.

    A fact is met when the twin's figure is in its interval, widened by the tolerance: half a unit of its last digit,
    1 % of a gain, and three standard errors of the noise at rest, of which there are only seconds. Slopes and the
    fits named "map" are those of the twin's noise-free readings without hysteresis, over the workspace of T5, as the
    facts are of trained networks. In fits the elongation is held at its mean, which it hardly leaves. The difference
    of shape is the standard deviation of the difference from T5's quadratic map, beyond that of T5 itself.

    Parameters
    ----------
    twin
        Recordings T0 to T5.

    Returns
    -------
    pandas.DataFrame
        Columns ``fact, of, unit, low, high, tolerance, twin, met``.
    """
    t5, board = twin.read["T5"], twin.config.board
    rows: list[tuple[str, str, str, float, float, float, float]] = []
    still = np.column_stack([t5.q[:, :2], np.full(len(t5), t5.q[:, 2].mean())])
    clean = analogue_readings(board, still, still)
    A, span = quadratic(t5.q), np.ptp(clean, axis=0)
    factors, misfit = _fit(A, clean)
    _, linear_misfit = _fit(A[:, :3], clean)
    B = field_at_sensors(rig_robot(), torch.from_numpy(still), ring("published")).numpy()
    mean, reach = t5.u.mean(axis=0), np.ptp(t5.u, axis=0)
    for j in range(RIG_SENSORS):
        of, one = f"sensor {j + 1}", np.ones((len(t5), 1))
        gain, axial = _fit(np.hstack([one, B[:, j, 2:]]), t5.u[:, j : j + 1])
        _, three = _fit(np.hstack([one, B[:, j]]), t5.u[:, j : j + 1])
        rows += [
            ("mean on T5", of, "mV", MEAN_MV[j], MEAN_MV[j], 0.5, mean[j]),
            ("range on T5", of, "mV", *RANGE_MV[j], 0.5, reach[j]),
            ("slope of the map in +x", of, "mV/mm", SLOPE[j][0], SLOPE[j][0], 0.05, factors[1, j]),
            ("slope of the map in +y", of, "mV/mm", SLOPE[j][1], SLOPE[j][1], 0.05, factors[2, j]),
            ("map less a quadratic one", of, "% of range", 1.0, 1.5, 0.05, 100 * misfit[j] / span[j]),
            ("map less a linear one", of, "% of range", 5.0, 15.0, 0.5, 100 * linear_misfit[j] / span[j]),
            ("gain of the drawn model", of, "mV/mT", GAIN[j], GAIN[j], 0.01 * abs(GAIN[j]), gain[1, 0]),
            ("less drawn model, offset, gain", of, "% of range", 14.0, 15.0, 0.5, 100 * axial[0] / reach[j]),
            ("less drawn model, three gains", of, "% of range", 5.0, 12.0, 0.5, 100 * three[0] / reach[j]),
        ]  # fmt: skip
    centre, spread = 1e3 * t5.q.mean(axis=0), 1e3 * t5.q.std(axis=0)
    for k, axis in enumerate("xy"):
        rows.append(("centre of T5", axis, "mm", (1.9, -0.1)[k], (1.9, -0.1)[k], 0.05, centre[k]))
        rows.append(("spread of T5", axis, "mm", (2.4, 4.4)[k], (2.4, 4.4)[k], 0.05, spread[k]))
    rows.append(("elongation on T5", "mean", "mm", 4.5, 4.5, 0.05, centre[2]))
    map_5, own = _fit(A, t5.u)
    for name in (*SLOW, *FAST):
        other = twin.read[name]
        apart = other.u - quadratic(other.q) @ map_5
        shape = np.sqrt(max(0.0, float((apart.var(axis=0) - own**2).mean())))
        low, high = (2.0, 3.0) if name in SLOW else (3.0, 7.0)
        rows.append(("bias against T5", name, "mV", -4.0, -2.0, 0.5, apart.mean()))
        rows.append(("difference of shape from T5", name, "mV", low, high, 0.5, shape))
    rows.append(("noise at rest", "all", "mV", 0.24, 0.24, 0.015, _noise_at_rest(twin)))
    rows.append(("quadratic map of T5.train on T5.test", "mean", "mV", 1.3, 1.9, 0.0, _own_error(t5).mean()))
    columns = ["fact", "of", "unit", "low", "high", "tolerance", "twin"]
    table = pd.DataFrame(rows, columns=columns)
    off = np.maximum(table["low"] - table["twin"], table["twin"] - table["high"])
    return table.assign(met=off <= table["tolerance"])


def table_2_ranges(twin: TwinRecordings) -> pd.DataFrame:
    """Ranges that follow from Table 2, and its errors of the readings, beside the twin's; nothing was fitted to them.

    The error of the twin is that of a quadratic map fitted to T5.train, so of another sensor model than the authors'
    networks: the two are not comparable as results, only in kind.

    Returns
    -------
    pandas.DataFrame
        One row per recording: ``recording, frames``, and for readings and bend published and twin values.
    """
    train, _ = split(twin.read["T5"])
    map_5, _ = _fit(quadratic(train.q), train.u)
    rows = []
    for name, (e_u, e_u_percent, e_x, e_x_percent, e_y, e_y_percent) in TABLE_2.items():
        whole = twin.read[name]
        test = whole if name == "T4" else split(whole)[1]
        error = np.sqrt(((test.u - quadratic(test.q) @ map_5) ** 2).mean(axis=0)).mean()
        x, y, _ = 1e3 * np.ptp(test.q, axis=0)
        rows.append(
            {
                "recording": name,
                "frames": len(whole),
                "pooled_range_table_2_mV": 100 * e_u / e_u_percent,
                "pooled_range_twin_mV": np.ptp(test.u),
                "range_x_table_2_mm": 100 * e_x / e_x_percent,
                "range_x_twin_mm": x,
                "range_y_table_2_mm": 100 * e_y / e_y_percent,
                "range_y_twin_mm": y,
                "error_networks_table_2_mV": e_u,
                "error_quadratic_twin_mV": error,
            }
        )
    return pd.DataFrame(rows)


def repairs_table(twin: TwinRecordings) -> pd.DataFrame:
    """What the pipeline repaired and cut in each recording [frames], and how far its alignment is from the truth."""
    rows = []
    for name, recording in twin.read.items():
        raw = twin.raw[name]
        cut = (
            recording.repairs["frames of motion capture cut to align"]
            - recording.repairs["readings cut to align"]
        )
        late = cut - RIG_RATE_HZ * (raw.sensors_start_s - raw.capture_start_s)
        rows.append({"recording": name, **recording.repairs, "motion capture late in frames": late})
    return pd.DataFrame(rows)


def actuation_table(twin: TwinRecordings) -> pd.DataFrame:
    """Pressures, torque and bend in the first 125 s of each sequence, 10 of the 100 samples per second.

    The inflation is left out. Torques are in units of the reference torque and turned so that they point where the
    segment bends.
    """
    parts = []
    for name, raw in twin.raw.items():
        motion = raw.motion
        begin = int(np.searchsorted(motion.time_s, 8.0))
        kept = slice(begin, min(begin + 12_500, len(motion.time_s) - 500), 10)
        torque = twin.config.chambers.bending_torque(motion.pressures_mbar[kept])
        part = {"time_s": motion.time_s[kept] - motion.time_s[begin]}
        part |= {f"torque_{axis}": torque[:, k] for k, axis in enumerate("xy")}
        part |= {f"pressure_{k + 1}_mbar": motion.pressures_mbar[kept, k] for k in range(3)}
        part |= {f"delta_{axis}_mm": 1e3 * motion.q[kept, k] for k, axis in enumerate("xy")}
        parts.append(pd.DataFrame(part).assign(recording=name))
    return pd.concat(parts, ignore_index=True)


def readings_table(twin: TwinRecordings) -> pd.DataFrame:
    """Readings and bend after the pipeline, in the first 30 s of each recording."""
    parts = []
    for name, recording in twin.read.items():
        kept = slice(0, int(30.0 * RIG_RATE_HZ))
        part = {"time_s": recording.time_s[kept]}
        part |= {f"delta_{axis}_mm": 1e3 * recording.q[kept, k] for k, axis in enumerate("xy")}
        part |= {f"u_{j + 1}_mV": recording.u[kept, j] for j in range(RIG_SENSORS)}
        parts.append(pd.DataFrame(part).assign(recording=name))
    return pd.concat(parts, ignore_index=True)


def differences_table(twin: TwinRecordings) -> pd.DataFrame:
    """Readings less T5's quadratic map [mV], over time and bend, in the first 20 s of T5 and T3."""
    map_5, _ = _fit(quadratic(twin.read["T5"].q), twin.read["T5"].u)
    parts = []
    for name in ("T5", "T3"):
        recording, kept = twin.read[name], slice(0, int(20.0 * RIG_RATE_HZ))
        apart = (recording.u - quadratic(recording.q) @ map_5)[kept]
        part = {"recording": name, "time_s": recording.time_s[kept], "delta_y_mm": 1e3 * recording.q[kept, 1]}
        parts.append(pd.DataFrame(part | {f"u_{j + 1}_mV": apart[:, j] for j in range(RIG_SENSORS)}))
    return pd.concat(parts, ignore_index=True)


def elongations_table(twins: Mapping[str, TwinRecordings]) -> pd.DataFrame:
    """What twins and the authors' recordings T0 to T5 (networks trained on them) say of the elongation.

    Returns
    -------
    pandas.DataFrame
        ``of, recording``; mean elongation ``mean_mm``, its change with the square of the bend ``per_mm2``, and the
        mean bend along x ``centre_x_mm``, where known.
    """
    rows = [{"of": "authors", "recording": name} | KNOWN_ELONGATION[name] for name in TRAJECTORIES]
    for of, twin in twins.items():
        for name, recording in twin.read.items():
            x, y, elongation = 1e3 * recording.q.T
            slope = np.polynomial.Polynomial.fit(x**2 + y**2, elongation, 1).convert().coef[1]
            found = {"mean_mm": elongation.mean(), "per_mm2": slope, "centre_x_mm": x.mean()}
            rows.append({"of": of, "recording": name} | found)
    return pd.DataFrame(rows)


def _fit(A: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares; return the factors and the root mean square of what is left of each column."""
    factors = np.linalg.lstsq(A, u, rcond=None)[0]
    return factors, np.sqrt(((u - A @ factors) ** 2).mean(axis=0))


def _own_error(t5: Recording) -> np.ndarray:
    train, test = split(t5)
    factors, _ = _fit(quadratic(train.q), train.u)
    return np.sqrt(((test.u - quadratic(test.q) @ factors) ** 2).mean(axis=0))


def _noise_at_rest(twin: TwinRecordings) -> float:
    """Root mean square of the readings about their means before the chambers fill, over all recordings."""
    squares, count = 0.0, 0
    for raw in twin.raw.values():
        rest = raw.readings_mv[: int((FILL_S - raw.sensors_start_s) * RIG_RATE_HZ)]
        squares += float(((rest - rest.mean(axis=0)) ** 2).sum())
        count += rest.size - RIG_SENSORS
    return float(np.sqrt(squares / count))
