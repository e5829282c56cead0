"""Floors of the shape models in numbers: by trial and by bend, with intervals over blocks of time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1_companion.book.bootstrap import interval, mean_rms, resampled_blocks
from edition1_companion.recordings.continuum_robot import STATIONS_M

RAW, OFFSET, FREE = "as recorded", "bodies moved onto the rod", "base frame free"
TIP, TIP_MIDDLE, TURNS, POSES = "tip pose", "tip and middle pose", "all orientations", "all poses"
SENSORS: dict[str, tuple[list[int], bool]] = {
    TIP: ([3], True),
    TIP_MIDDLE: ([1, 3], True),
    TURNS: ([0, 1, 2, 3], False),
    POSES: ([0, 1, 2, 3], True),
}
"""Stations that a set of sensors shows, and whether their positions are part of it."""
Shape = tuple[Callable[[Tensor], Tensor], int]
"""Poses of the stations from coordinates, and the number of these."""


def judged(sensors: str) -> list[int]:
    """Stations whose positions the sensors do not know; all of them where none is left."""
    stations, positions = SENSORS[sensors]
    left = [k for k in range(len(STATIONS_M)) if not (positions and k in stations)]
    return left or list(range(len(STATIONS_M)))


def with_free_base(shape: Shape) -> Shape:
    """Poses of the base body and the stations, where the rod's base may sit anywhere on that body."""
    stations, n_q = shape

    def moved(x: Tensor) -> Tensor:
        T = stations(x[..., :n_q])
        base = torch.eye(4).to(T).expand_as(T[..., :1, :, :])
        return se3.exponential(x[..., n_q:]).unsqueeze(-3) @ torch.cat([base, T], dim=-3)

    return moved, n_q + 6


class Judged:
    """Errors of the fits, frame by frame, and their tables."""

    def __init__(self, frames: Mapping[str, np.ndarray], block: int, bootstraps: int, seed: int) -> None:
        """Take the bends [deg] of the frames by trial, in their order, and how intervals are made."""
        self.bends, self._errors = dict(frames), {}
        rng = np.random.default_rng(seed)
        self._draws = {
            trial: resampled_blocks(len(bend), min(block, len(bend)), rng, bootstraps=bootstraps)
            for trial, bend in self.bends.items()
        }

    def add(self, key: tuple[str, str, str], errors_mm: Float[np.ndarray, "n 4"]) -> None:
        """Keep the errors of a setting, a set of sensors and a shape: of all trials, in their order."""
        ends = np.cumsum([len(bend) for bend in self.bends.values()])[:-1]
        for trial, part in zip(self.bends, np.split(errors_mm, ends), strict=True):
            self._errors[(trial, *key)] = part

    def by_trial(self) -> pd.DataFrame:
        """Mean over the stations judged of the root mean square over the frames, with its 95 % interval."""
        lines = []
        for key, errors in self._errors.items():
            part = errors[:, judged(key[2])]
            drawn = mean_rms(part, self._draws[key[0]])
            low, high = interval(drawn)
            lines.append((*key, len(part), float(np.sqrt((part**2).mean(0)).mean()), low, high))
        return pd.DataFrame(lines, columns=[*_KEY, "frames", "error_mm", "low_mm", "high_mm"])

    def by_station(self) -> pd.DataFrame:
        """Root mean square at every station; whether its position was known to the fit."""
        lines = []
        for key, errors in self._errors.items():
            rms = np.sqrt((errors**2).mean(0))
            known = [k not in judged(key[2]) or key[2] == POSES for k in range(len(STATIONS_M))]
            lines += [(*key, 1e3 * s, u, e) for s, u, e in zip(STATIONS_M, known, rms, strict=True)]
        return pd.DataFrame(lines, columns=[*_KEY, "station_mm", "known", "rmse_mm"])

    def by_bend(self, edges_deg: Sequence[float]) -> pd.DataFrame:
        """As :meth:`by_trial`, for the frames of all trials within each range of bend; empty ranges are left out."""
        bend, lines = np.concatenate(list(self.bends.values())), []
        starts = np.cumsum([0, *(len(part) for part in self.bends.values())])[:-1]
        draws = np.hstack([draw + n for draw, n in zip(self._draws.values(), starts, strict=True)])
        keys = dict.fromkeys(key[1:] for key in self._errors)
        for low_deg, high_deg in pairwise(edges_deg):
            inside = (bend >= low_deg) & (bend < high_deg)
            if not inside.any():
                continue
            for key in keys:
                errors = np.concatenate([self._errors[(trial, *key)] for trial in self.bends])
                part = np.where(inside[:, None], errors[:, judged(key[1])], np.nan)
                some = draws[inside[draws].any(1)]
                low, high = interval(mean_rms(part, some))
                rms = float(np.sqrt(np.nanmean(part**2, axis=0)).mean())
                lines.append((low_deg, high_deg, *key, int(inside.sum()), rms, low, high))
        names = ["bend_from_deg", "bend_to_deg", *_KEY[1:], "frames", "error_mm", "low_mm", "high_mm"]
        return pd.DataFrame(lines, columns=names)

    def ratio(self, upper: tuple[str, str, str], lower: tuple[str, str, str]) -> pd.DataFrame:
        """Error of one fit by that of another, by trial, with the interval of the pair."""
        lines = []
        for trial, draw in self._draws.items():
            parts = [self._errors[(trial, *key)][:, judged(key[1])] for key in (upper, lower)]
            ratio = mean_rms(parts[0], draw) / mean_rms(parts[1], draw)
            mean = [float(np.sqrt((part**2).mean(0)).mean()) for part in parts]
            lines.append((trial, mean[0] / mean[1], *interval(ratio)))
        return pd.DataFrame(lines, columns=["trial", "ratio", "ratio_low", "ratio_high"])


_KEY = ["trial", "setting", "sensors", "shape"]
