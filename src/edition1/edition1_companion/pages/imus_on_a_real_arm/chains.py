"""The models of Martin et al. 2022 on the stations of the recorded arm, and their errors in tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from edition1.estimation.imu_models import ShapeModel, exact_arcs, pcc_extended, rigid_links, tangent_spline
from edition1.estimation.imu_selection import Selection
from edition1.estimation.orientations import exponential, product
from edition1_companion.book.bootstrap import interval, mean_rms, ratio_of_means, resampled, resampled_blocks
from edition1_companion.recordings.continuum_robot import LENGTH_M, STATIONS_M

RAW, CALIBRATED = "as recorded", "calibrated on slow free space"
STATIONS = {2: (0, 4), 3: (0, 2, 4), 5: (0, 1, 2, 3, 4)}
"""Bodies that are taken for IMUs, by their number; the base is one of them."""
SUB_LINKS = 2
"""Sub-segments of a link, as with 8 IMUs and 16 segments."""
END, MIDDLE, PCC, INNER, ARCS, SPLINE = (
    "rigid links, IMU at the end",
    "rigid links, IMU in the middle",
    "PCC-extended",
    "PCC-extended, inner points",
    "exact arcs",
    "spline",
)
MODELS: dict[str, ShapeModel] = {
    END: rigid_links,
    MIDDLE: rigid_links,
    PCC: pcc_extended,
    INNER: pcc_extended,
    ARCS: exact_arcs,
    SPLINE: tangent_spline,
}
"""Models by their names here."""
_MARKERS_M = (STATIONS_M[1], STATIONS_M[3])


def placed(model: str, n_imus: int) -> Selection:
    """IMUs and links of a model on the arm: evenly spread, the base is IMU 0."""
    imus, link = STATIONS[n_imus], LENGTH_M / (n_imus - 1)
    arcs = tuple(i * LENGTH_M / 4 for i in imus)
    if model == END:  # the base has no link of its own
        return Selection(imus[1:], arcs[1:], (link,) * (n_imus - 1), _MARKERS_M)
    if model == MIDDLE:  # at base and tip half a link is left
        return Selection(imus, arcs, (link / 2, *(link,) * (n_imus - 2), link / 2), _MARKERS_M)
    way = "inner points" if model == INNER else "midpoints"
    return Selection(imus, arcs, (link,) * (n_imus - 1), _MARKERS_M, SUB_LINKS, way)


def orientations(T_base_station: Float[np.ndarray, "n 4 4 4"]) -> Float[np.ndarray, "n 5 4"]:
    """Quaternions XYZW of the base and the stations, body to base."""
    q = Rotation.from_matrix(T_base_station[..., :3, :3].reshape(-1, 3, 3)).as_quat().reshape(-1, 4, 4)
    return np.concatenate([np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(q), 1, 4)), q], axis=1)


def misread(
    q: Float[np.ndarray, "n 5 4"], sensor_rad: float, rng: np.random.Generator
) -> Float[np.ndarray, "n 5 4"]:
    """Turn each IMU but the base by a rotation of its own that stays the same, about every axis of the base."""
    turns = sensor_rad * rng.standard_normal((5, 3)) * (np.arange(5) > 0)[:, None]
    return product(exponential(turns), q)


@dataclass(frozen=True)
class Blocks:
    """How intervals over time are made."""

    length: int
    """Of a block, in frames."""
    bootstraps: int
    seed: int

    def draws(self, n: int) -> np.ndarray:
        """Numbers of the frames in each bootstrap."""
        return resampled_blocks(n, min(self.length, n), self.seed, bootstraps=self.bootstraps)


Errors = Mapping[tuple[str, str, int, str], np.ndarray]
"""Errors [mm], frames by stations, of a trial, setting, number of IMUs and model."""


def error_table(errors: Errors, blocks: Blocks) -> pd.DataFrame:
    """Mean over the stations of the root mean square, with its 95 % interval, and of the median over the frames."""
    lines = []
    for key, part in errors.items():
        low, high = interval(mean_rms(part, blocks.draws(len(part))))
        rms = np.sqrt((part**2).mean(axis=0))
        lines.append((*key, rms.mean(), low, high, np.median(part, axis=0).mean(), rms[-1]))
    names = ["trial", "setting", "n_imus", "model", "error_mm", "low_mm", "high_mm", "median_mm", "tip_mm"]
    return pd.DataFrame(lines, columns=names)


def ratio_table(errors: Errors, blocks: Blocks) -> pd.DataFrame:
    """Error of every model by that of each way to lay rigid links, paired frame by frame."""
    lines = []
    for (trial, setting, n, model), part in errors.items():
        for rigid in (END, MIDDLE):
            if model in (END, MIDDLE):
                continue
            other, draws = errors[(trial, setting, n, rigid)], blocks.draws(len(part))
            low, high = interval(mean_rms(part, draws) / mean_rms(other, draws))
            itself = np.arange(len(part))[None]
            ratio = float((mean_rms(part, itself) / mean_rms(other, itself))[0])
            medians = np.median(part, axis=0).mean() / np.median(other, axis=0).mean()
            lines.append((trial, setting, n, model, rigid, ratio, low, high, medians))
    names = ["trial", "setting", "n_imus", "model", "against", "ratio", "ratio_low", "ratio_high"]
    return pd.DataFrame(lines, columns=[*names, "ratio_of_medians"])


def with_sensor_errors(
    estimate: Callable[[np.ndarray, str, int], np.ndarray],
    T: Mapping[str, Float[np.ndarray, "n 4 4 4"]],
    sensor_deg: Sequence[float],
    seeds: Sequence[int],
) -> pd.DataFrame:
    """Error over all trials and draws of the sensors, by model and number, and its ratio to each way of rigid links.

    Parameters
    ----------
    estimate
        Positions of the stations [m] from orientations, a model and a number of IMUs.
    T
        Poses of the stations in the base, by trial.
    sensor_deg
        Standard deviations about each axis [deg].
    seeds
        One draw each; the same for every model.
    """
    truth = np.concatenate(list(T.values()))
    q, lines = orientations(truth), []
    for angle in sensor_deg:
        drawn = [misread(q, float(np.radians(angle)), np.random.default_rng(seed)) for seed in seeds]
        for n in STATIONS:
            rms = {}
            for model in MODELS:
                off = (
                    1e3 * np.linalg.norm(estimate(one, model, n) - truth[..., :3, 3], axis=-1)
                    for one in drawn
                )
                rms[model] = np.array([np.sqrt((part**2).mean(axis=0)).mean() for part in off])
            index = resampled(len(seeds), 0, bootstraps=2000)
            for model, values in rms.items():
                low, high = interval(values[index].mean(axis=1))
                ratio = ratio_of_means(values, rms[MIDDLE], index)
                lines.append({"n_imus": n, "model": model, "sensor_deg": angle, "error_mm": values.mean()})
                lines[-1] |= {"low_mm": low, "high_mm": high} | ratio
    return pd.DataFrame(lines)
