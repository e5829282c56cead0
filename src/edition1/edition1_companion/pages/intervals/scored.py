"""Estimates whose truth is known, as distances in units of what is stated, each with those that may calibrate it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from scipy.stats import chi2

from edition1.estimation.conformal import ellipsoid_scores
from edition1.estimation.rod_filter import RodFilter
from edition1.sensing.bend_sensor import BendSensor
from edition1_companion.pages.intervals.studies import AS_IT_IS, distance_and_deviation
from edition1_companion.recordings.continuum_robot import ONE_RECORDING, Trial
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ
from edition1_companion.twins import followed_rod
from edition1_companion.twins.bend_filters import OUR_LENGTH_MM, fit_takes, ours
from edition1_companion.twins.bend_tests import BendTake, take_in_words
from edition1_companion.twins.rig_data import RigData
from edition1_companion.twins.rig_filter import filtered
from edition1_companion.twins.rig_map import fit_map

THINNED = 4
"""Every which reading of a bend test is judged: 16 in a second."""
FIRST_SHARE = 0.4
"""Part of a recording, from its start, that calibrates methods which need its own truth; the rest is judged."""
_TIP_MM = OUR_LENGTH_MM / 2
"""What the tip of an arc moves for a radian of bend, to first order."""


@dataclass(frozen=True)
class Scored:
    """Estimates in the order of time.

    Attributes
    ----------
    time_s
        Of the estimates.
    distance
        Mahalanobis distance from the truth.
    deviation_mm
        Stated: geometric mean along the axes of the covariance.
    coordinates
        Number of coordinates that the distance is in.
    """

    time_s: Float[np.ndarray, " k"]
    distance: Float[np.ndarray, " k"]
    deviation_mm: Float[np.ndarray, " k"]
    coordinates: int

    def _edge(self, level: float) -> float:
        return float(np.sqrt(chi2(self.coordinates).ppf(level)))

    def scores(self, level: float) -> Float[np.ndarray, " k"]:
        """1 on the edge of the stated ellipsoid; as :func:`edition1.estimation.conformal.ellipsoid_scores`."""
        return self.distance / self._edge(level)

    def semi_axis_mm(self, level: float) -> Float[np.ndarray, " k"]:
        """Of the stated ellipsoid, geometric mean."""
        return self.deviation_mm * self._edge(level)

    @property
    def late(self) -> Bool[np.ndarray, " k"]:
        """Which estimates are judged."""
        return self.time_s > self.time_s[0] + FIRST_SHARE * (self.time_s[-1] - self.time_s[0])


@dataclass(frozen=True)
class Judged:
    """A recording that is judged, and what may calibrate it: none of that has seen its truth."""

    name: str
    kind: str
    own: Scored
    others: tuple[Scored, ...]


def _of_ellipsoids(time_s: np.ndarray, error_m: np.ndarray, C_m2: np.ndarray) -> Scored:
    n = error_m.shape[-1]
    distance = ellipsoid_scores(error_m, C_m2, 0.5) * np.sqrt(chi2(n).ppf(0.5))
    return Scored(time_s, distance, 1e3 * np.linalg.det(C_m2) ** (0.5 / n), n)


def of_rod(method: RodFilter, trial: Trial) -> dict[str, Scored]:
    """The tip, and the whole shape: the worst of the four stations at the frames that show all."""
    capture = followed_rod.load(trial)
    found = followed_rod.errors(capture, followed_rod.estimates(method, capture)["filter"])
    stations = [_of_ellipsoids(t, *part) for (t, _), part in zip(capture.truth, found, strict=True)]
    shared = stations[0].time_s
    for station in stations[1:]:
        shared = np.intersect1d(shared, station.time_s)
    seen = [np.isin(station.time_s, shared) for station in stations]
    distance = np.max([s.distance[k] for s, k in zip(stations, seen, strict=True)], axis=0)
    deviation = np.mean([s.deviation_mm[k] for s, k in zip(stations, seen, strict=True)], axis=0)
    return {"tip": stations[-1], "shape": Scored(shared, distance, deviation, 3)}


def rods(method: RodFilter, trials: Sequence[Trial]) -> list[Judged]:
    """The scored window of each trial, with the whole of all other recordings of the robot."""
    whole = {t.name: of_rod(method, Trial(t.name, t.folder, None)) for t in trials}
    recording = {t.name: ONE_RECORDING.get(t.name, t.name) for t in trials}
    rows = []
    for trial in trials:
        others = {recording[n]: n for n in whole if recording[n] != recording[trial.name]}.values()
        for part, own in of_rod(method, trial).items():
            name = f"{trial.name.replace('_', ' ')}, {part}"
            rows.append(Judged(name, f"rod, {part}", own, tuple(whole[n][part] for n in others)))
    return rows


def bends(takes: Sequence[BendTake], source: str) -> list[Judged]:
    """The bend of each take, with the takes of all other tests; none with less than three tests.

    The calibration of the sensor has seen neither the judged test nor that of the take itself.
    """
    sensor = BendSensor(1e-3 * OUR_LENGTH_MM)
    tests = {take.test for take in takes}

    @cache
    def fitted(left_out: frozenset[int]):
        return fit_takes("", [take for take in takes if take.test not in left_out], sensor)

    def scored(take: BendTake, judged_test: int) -> Scored:
        table = ours(take, fitted(frozenset({take.test, judged_test})), sensor)
        seen = np.flatnonzero(take.truth["bend_rad"].notna())[::THINNED]
        error = (table["bend_rad"] - take.truth["bend_rad"]).to_numpy()[seen]
        deviation = table["deviation_rad"].to_numpy()[seen]
        return Scored(take.time_s[seen], np.abs(error) / deviation, _TIP_MM * deviation, 1)

    label = "" if source == "recorded" else f" ({source})"
    return [
        Judged(
            take_in_words(take.name) + label,
            f"bend tests{label}",
            scored(take, take.test),
            tuple(scored(other, take.test) for other in takes if other.test != take.test),
        )
        for take in takes
        if len(tests) > 2
    ]


def of_study(table: pd.DataFrame, changed: str = AS_IT_IS) -> dict[tuple[int, str], Scored]:
    """Random twins of the study, by twin and trajectory."""
    columns = ("time_s", "distance", "deviation_mm")
    groups = table[table["changed"] == changed].groupby(["twin", "trajectory"], sort=False)
    return {key: Scored(*(part[c].to_numpy(float) for c in columns), 2) for key, part in groups}


def random_twins(table: pd.DataFrame) -> list[Judged]:
    """Each trajectory of each random twin, with that trajectory of all others."""
    twins = of_study(table)
    return [
        Judged(f"twin {twin}", name, own, tuple(x for (t, n), x in twins.items() if n == name and t != twin))
        for (twin, name), own in twins.items()
    ]


def rig(data: RigData, table: pd.DataFrame, longest_s: float) -> list[Judged]:
    """The bend on each trajectory of the rig's twin, with that trajectory of the random twins."""
    twins, bend_map, rows = of_study(table), fit_map(data.train), []
    for name, part in data.shortened(longest_s).items():
        distance, deviation_mm = distance_and_deviation(filtered(bend_map, part.u), part)
        own = Scored(np.arange(len(part)) / RIG_RATE_HZ, distance, deviation_mm, 2)
        others = tuple(x for (_, n), x in twins.items() if n == name)
        rows.append(Judged(f"rig twin {name} (synthetic)", name, own, others))
    return rows
