"""The released tables of Martin et al. (2022) as chains: which gave which points, and what ours gives instead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from edition1.errors import bad_input
from edition1.estimation.imu_models import chain
from edition1.estimation.imu_selection import Selection
from edition1_companion.pages.recorded_trial.orientations import (
    last_orientation,
    orientations_between,
    unevenness_deg,
)
from edition1_companion.recordings.martin2022_models import (
    FILES_BASE_TURN,
    FILES_ORIGIN_M,
    IMU_ARCS,
    selection,
)
from edition1_companion.recordings.martin2022_trial import RIGID_LINKS_M, ModelOutput

RIGID, PCC_1, PCC_2 = "elephant/rigid/rigid.csv", "elephant/pcc/pcc1.csv", "elephant/pcc/pcc2.csv"
PCC_16_2 = "fly/pcc16/pcc16_2.csv"
NEEDED = (RIGID, PCC_1, PCC_2, PCC_16_2)
"""Tables that tell the orientations of the trial: the first two those of IMUs #1 to #7, the others that of #8."""
LARGEST_SHIFT = 40
"""Largest shift between two tables that is tried [rows]."""
HALF_TURN = 1e-6
"""Neighbours whose quaternions have a smaller product are half a turn apart: neither way round is the shorter one."""
SAME_M = 1e-6
"""Points closer than this count as the same [m]."""


@dataclass(frozen=True)
class ReleasedChain:
    """What gave a released table: a chain, and by number the arc positions of its points from its origin [m]."""

    made: Selection
    arcs: dict[int, float]

    def up_to(self, imu: int) -> ReleasedChain:
        """The chain as far as an IMU, and the points on it."""
        n = self.made.imus.index(imu)
        imus, arcs, links = (field[:k] for field, k in zip(
            (self.made.imus, self.made.arcs, self.made.link_lengths), (n + 1, n + 1, n), strict=True
        ))  # fmt: skip
        made = replace(self.made, imus=imus, arcs=arcs, link_lengths=links)
        return ReleasedChain(made, {k: arc for k, arc in self.arcs.items() if arc <= sum(links) + 1e-9})

    def points(self, nine: Float[np.ndarray, "rows imus 4"]) -> Float[np.ndarray, "rows points 3"]:
        """Its points as in the tables: from the chain's own origin [m]."""
        found = chain(
            self.made.of(nine), self.made, [min(a, sum(self.made.link_lengths)) for a in self.arcs.values()]
        )
        return found - np.array(self.made.origin_m)


def released_chains() -> dict[str, ReleasedChain]:
    """Chain and points of every table of `edition1_companion.recordings.martin2022_trial.OUTPUTS`, by its name."""

    def joints(first: float) -> dict[int, float]:
        return {0: 0.0} | {k: first + 0.08 * (k - 1) for k in range(1, 8)}

    numbers = tuple(range(1, 8))
    arcs = tuple(IMU_ARCS[k] for k in numbers)
    halves = {0: 0.0285} | {k: 0.017 + 0.08 * k for k in range(1, 8)}  # the middles of the links
    found = {
        RIGID: ReleasedChain(Selection(numbers, arcs, RIGID_LINKS_M, origin_m=FILES_ORIGIN_M), joints(0.102)),
        PCC_1: ReleasedChain(selection("pcc", 8, "files", segments=8), joints(0.057)),
    }
    for n in (2, 4, 8):
        found[f"elephant/pcc/pcc{n}.csv"] = ReleasedChain(
            selection("pcc", 8, "files", segments=8 * n), halves
        )
    for n in (2, 4):
        found[f"fly/less_imu/less_imu_{n}.csv"] = ReleasedChain(selection("rigid", n, "files"), joints(0.062))
        found[f"fly/pcc16/pcc16_{n}.csv"] = ReleasedChain(
            selection("pcc", n, "files"), {4: 0.3022, 7: 0.5422}
        )
    return found


@dataclass(frozen=True)
class TrialOrientations:
    """Orientations in the trial, and how well the tables agree on them.

    Attributes
    ----------
    orientations
        Unit quaternions XYZW, IMU to world: an upright base, which is not measured, then IMUs #1 to #8.
    unevenness_deg
        Per row what the equations leave, the largest over IMUs #1 to #7 [deg].
    told_deg
        Per row and IMU #1 to #7 how far the direction halfway is from that of the IMU before: the smaller, the less
        is told of the turn about the arm [deg].
    """

    orientations: Float[np.ndarray, "rows 9 4"]
    unevenness_deg: Float[np.ndarray, " rows"]
    told_deg: Float[np.ndarray, "rows 7"]


def trial_orientations(outputs: Mapping[str, ModelOutput]) -> TrialOrientations:
    """Orientations of base and IMUs in the trial, for the rows that all tables of :data:`NEEDED` have.

    IMUs #1 to #7 follow in closed form from the links of ``rigid.csv`` and ``pcc1.csv``, #8 from the last points of
    ``pcc2.csv`` and ``pcc16_2.csv`` (`edition1_companion.pages.recorded_trial.orientations`).

    Raises
    ------
    InputError
        If a table is not there or too short, or has no points where they are needed.
    """
    if missing := [name for name in NEEDED if name not in outputs]:
        raise bad_input(
            "outputs", "trial_orientations", f"those of {', '.join(NEEDED)}", f"none of {missing}"
        )
    needed = {name: outputs[name].points for name in NEEDED}
    for name, points in needed.items():
        if np.isnan(points[:, [4, 7] if name == PCC_16_2 else slice(None)]).any():
            raise bad_input("points", name, "given in every row", "rows without")
    along, halfway = _directions(needed[RIGID]), _directions(needed[PCC_1])
    before = np.concatenate([np.broadcast_to([0.0, 0.0, 1.0], along[:, :1].shape), along[:, :-1]], axis=1)

    def uneven(shift: int) -> float:
        ours, theirs = common_rows(len(along), len(halfway), shift)
        return float(np.median(np.abs(unevenness_deg(before[ours], halfway[theirs], along[ours]))))

    ours, theirs = common_rows(len(along), len(halfway), min(_shifts(), key=uneven))
    along, before, halfway = along[ours], before[ours], halfway[theirs]
    turned = np.broadcast_to(np.array(FILES_BASE_TURN), (len(along), 4))
    eight = orientations_between(turned, halfway, along)
    eight[:, 0] = [0.0, 0.0, 0.0, 1.0]
    chains = released_chains()
    seven, four = chains[PCC_2].up_to(7), chains[PCC_16_2].up_to(4)
    later = {
        PCC_2: row_shift(eight, seven, needed[PCC_2]),
        PCC_16_2: row_shift(eight, four, needed[PCC_16_2]),
    }
    first = max(0, *(-shift for shift in later.values()))
    end = min(len(eight), *(len(needed[name]) - shift for name, shift in later.items()))
    q, two, sixteen = eight[first:end], *(needed[n][first + later[n] : end + later[n]] for n in later)
    # From point 6 of pcc2.csv half a link on to IMU #7, then half a link along one of two sub-segments to point 7.
    half = np.diff(
        ReleasedChain(seven.made, {6: seven.arcs[6], 7: sum(seven.made.link_lengths)}).points(q), axis=1
    )[:, 0]
    third = two[:, 7] - two[:, 6] - half
    third /= np.linalg.norm(third, axis=-1, keepdims=True)
    imu_8 = last_orientation(q[:, 7], third, q[:, 4], sixteen[:, 7] - sixteen[:, 4], 0.32, 8)
    return TrialOrientations(
        np.concatenate([q, imu_8[:, None]], axis=1),
        np.abs(unevenness_deg(before, halfway, along)).max(axis=1)[first:end],
        np.degrees(np.arcsin(np.minimum(np.linalg.norm(np.cross(before, halfway), axis=-1), 1.0)))[first:end],
    )


def compared(name: str, output: ModelOutput, nine: Float[np.ndarray, "rows 9 4"]) -> dict[str, Any]:
    """How far the chain of a table, from the orientations of the trial, is from the table's points.

    Rows in which two neighbours of the chain are half a turn apart (:data:`HALF_TURN`) are counted and left out.

    Returns
    -------
    dict
        ``file``, ``rows``, ``later`` (rows by which the table is later than the orientations), ``half_turns``, the
        distance as ``median_um``, ``largest_um``, and ``same_percent``, the share of points within :data:`SAME_M`.

    Raises
    ------
    InputError
        If the table has none of the points that are needed, or has too few rows.
    """
    given = released_chains()[name]
    later = row_shift(nine, given, output.points)
    ours, theirs = common_rows(len(nine), len(output.points), later)
    error = np.linalg.norm(given.points(nine[ours]) - output.points[theirs][:, list(given.arcs)], axis=-1)
    tied = half_turns(given.made, nine[ours])
    error = error[~tied]
    return {
        "file": name,
        "rows": len(error),
        "later": later,
        "half_turns": int(tied.sum()),
        "median_um": 1e6 * float(np.median(error)),
        "largest_um": 1e6 * float(error.max()),
        "same_percent": 100 * float((error <= SAME_M).mean()),
    }


def half_turns(made: Selection, nine: Float[np.ndarray, "rows 9 4"]) -> np.ndarray:
    """Rows in which two neighbours of a chain with sub-segments are half a turn apart."""
    q = made.of(nine)
    tied = np.abs((q[:, :-1] * q[:, 1:]).sum(axis=-1)) < HALF_TURN
    return tied.any(axis=1) & (made.sub_links > 0)


def row_shift(nine: np.ndarray, given: ReleasedChain, points: np.ndarray) -> int:
    """Rows by which a table is later than orientations: where its points are closest to those of the chain.

    Raises
    ------
    InputError
        If the table has none of the chain's points, or too few rows.
    """
    if np.isnan(points[:, list(given.arcs)]).any():
        raise bad_input(
            "points", "a released table", f"given at {list(given.arcs)} in every row", "rows without"
        )
    made = given.points(nine)

    def distance(shift: int) -> float:
        ours, theirs = common_rows(len(made), len(points), shift)
        return float(np.median(np.linalg.norm(made[ours] - points[theirs][:, list(given.arcs)], axis=-1)))

    return min(_shifts(), key=distance)


def common_rows(ours: int, theirs: int, later: int) -> tuple[slice, slice]:
    """Rows of two tables that belong together, the second being ``later``.

    Raises
    ------
    InputError
        If there are fewer than twice the shifts that are tried.
    """
    first, end = max(0, -later), min(ours, theirs - later)
    if end - first < 2 * LARGEST_SHIFT:
        raise bad_input("rows", "a released table", f"{2 * LARGEST_SHIFT} in common at least", end - first)
    return slice(first, end), slice(first + later, end + later)


def _shifts() -> range:
    return range(-LARGEST_SHIFT, LARGEST_SHIFT + 1)


def _directions(points: np.ndarray) -> np.ndarray:
    """Unit vectors from each point to the next."""
    steps = np.diff(points, axis=1)
    return steps / np.linalg.norm(steps, axis=-1, keepdims=True)
