"""Martin et al. 2022: motion capture of the trial, errors as the authors computed them, and with our alignment.

The authors' steps are those of ``data analysis/main.ipynb`` in their repository (commit 6045c11, cells 5 to 34). We
wrote them from its text, and could not run them on the motion capture: confirm them with `THIRD_QUARTILES_MM`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from repro import exact_arcs, pcc_extended, rigid_body
from repro.common import InputError, require
from repro.estimators.imu import ShapeModel
from repro_companion.papers import martin, martin_files
from repro_companion.papers.martin import CAPTURE_HZ, MARKERS, ORIGIN, Case, Trial, arm
from repro_companion.papers.martin_files import (
    CAPTURE,
    NEEDED,
    PCC_1,
    PCC_2,
    PCC_16_2,
    QUATERNIONS,
    RIGID_FILE,
)
from repro_companion.run import project_folder
from repro_companion.scorecard import AUTHORS
from repro_companion.show import KEY, sentences, show

HEADER = [f"{name}{body}" for body in ("base", "4", "7") for name in "RPYxyz"]
"""Columns after frame and sub-frame, which have no name: three angles, which nobody uses, and x, y, z of a body."""
BELOW_THE_BASE_MM = (0.0, 0.0, 17.0)
"""What the authors subtract from the markers, besides the place of the base."""
CAPTURE_LATER = 700
"""Rows that the authors drop at the start of the motion capture, which has one row for each of rigid.csv."""
TABLES = {
    Case("Fig. 3", "rigid", 2, 2): ("fly/less_imu/less_imu_2.csv", 36),
    Case("Fig. 3", "rigid", 4, 4): ("fly/less_imu/less_imu_4.csv", 38),
    Case("Fig. 3", "rigid", 8, 8): (PCC_1, 53),
    Case("Fig. 4", "pcc", 8, 8): (PCC_1, 53),
    Case("Fig. 4", "pcc", 8, 16): (PCC_2, 54),
    Case("Fig. 4", "pcc", 8, 32): ("elephant/pcc/pcc4.csv", 54),
    Case("Fig. 4", "pcc", 8, 48): ("elephant/pcc/pcc6.csv", 56),
    Case("Fig. 4", "pcc", 8, 64): ("elephant/pcc/pcc8.csv", 56),
    Case("Fig. 5", "pcc", 2, 16): (PCC_16_2, 55),
    Case("Fig. 5", "pcc", 4, 16): ("fly/pcc16/pcc16_4.csv", 51),
    Case("Fig. 5", "pcc", 8, 16): (PCC_2, 54),
}
"""Table behind each box of Figs 3 to 5, and the rows that the authors drop at its start."""
SCORED = slice(1000, 8001)
"""Rows that the authors evaluate, after both shifts."""
THIRD_QUARTILES_MM = (63.852491, 97.579998)
"""Of pcc1.csv at M1 and M2 in the authors' notebook (cell 34), the only printed numbers without rounding."""
ROWS_OF_PCC_2 = TABLES[Case("Fig. 4", "pcc", 8, 16)][1]
FIRST_S, WIDEST_S = 60.0, 30.0
"""Part of the trial on which we align, and how far the clocks may be apart beyond the authors' shift [s]."""
OTHER_RATES_HZ = (50.0, 120.0, 200.0, 250.0)
LONGEST_GAP_S = 0.05


# The motion capture


class Capture(NamedTuple):
    """Motion capture as the models have it: a row every 10 ms."""

    points: np.ndarray
    """M1 and M2 ``[rows, 2, 3]`` [m] from the base, in the axes of the models; NaN where not seen."""
    lost: int
    """Number of rows that lack a marker or the base."""


def read_capture(path: Path) -> Capture:
    """Read the motion capture: rows of 10 ms [mm], numbered by frame; a frame that is not there is a lost row."""
    table = martin_files.read_csv(path)
    form = f"frame and sub-frame without a name, then {', '.join(HEADER[3:6])}, … {', '.join(HEADER[-3:])}"
    names = ["" if name.startswith("Unnamed") else name for name in table]
    require(names == ["", "", *HEADER], "columns", path.name, form, ", ".join(names) or "none")
    values = table.apply(pd.to_numeric, errors="coerce").to_numpy(float)
    odd = np.flatnonzero((np.isnan(values) & table.notna().to_numpy()).any(axis=1))
    require(not len(odd), "rows", path.name, "numbers", f"words in line {odd[0] + 2 if len(odd) else 0}")
    frame = _frames(values[:, :2], path.name)
    bodies = values[:, 2:].reshape(-1, 3, 6)[..., 3:]
    bodies = np.where(
        (bodies == 0).all(axis=-1, keepdims=True), np.nan, bodies
    )  # so some programs write a lost body
    mm = np.full((frame[-1] + 1, 2, 3), np.nan)
    mm[frame] = bodies[:, 1:] - bodies[:, :1]
    distance = np.linalg.norm(mm, axis=-1)
    counts = np.isfinite(distance).sum(axis=0)
    require(
        counts.min() > 0,
        "markers",
        path.name,
        "each seen with the base",
        f"{counts[0]} and {counts[1]} times",
    )
    far = np.nanmedian(distance, axis=0)
    said = f"medians of {far[0]:.3g} and {far[1]:.3g}"
    within = (far > [50.0, 100.0]).all() and (far < [450.0, 700.0]).all()
    require(within, "distances from base to markers", path.name, "in mm, as of an arm of 660 mm", said)
    mm = mm - BELOW_THE_BASE_MM
    points = 1e-3 * np.stack([-mm[..., 1], mm[..., 0], mm[..., 2]], axis=-1)
    return Capture(points, len(mm) - int(np.isfinite(points).all(axis=(1, 2)).sum()))


def _frames(numbered: np.ndarray, owner: str) -> np.ndarray:
    """Return the row of each frame, from 0: by its number where the file has one, else as it stands."""
    require(len(numbered) > CAPTURE_LATER, "rows", owner, f"more than {CAPTURE_LATER}", len(numbered))
    frame, part = numbered.T
    if np.isnan(frame).all():
        return np.arange(len(frame))
    require(np.isfinite(frame).all(), "frames", owner, "a number in each row", "rows without one")
    steps = np.diff(frame)
    whole = np.median(steps) == 1 and (steps >= 1).all() and not np.nan_to_num(part).any()
    said = f"steps of {steps.min():g} to {steps.max():g}, sub-frames up to {np.nan_to_num(part).max():g}"
    require(whole, "frames", owner, "one later in each row, without sub-frames: 100 rows a second", said)
    return np.rint(frame - frame[0]).astype(int)


def check_rate(capture: Capture, height_s: np.ndarray, height: np.ndarray) -> None:
    """Refuse a capture whose heights of M2 follow those of a model at another rate, but not at 100 Hz."""

    def agreement(rate_hz: float) -> float:
        seen_s, seen = np.arange(len(capture.points)) / rate_hz, _bridged(capture.points[:, 1, 2])
        lag = martin.clock_lag(height_s, height, seen_s, seen, 2 * WIDEST_S)
        both = (height_s >= seen_s[0] + lag) & (height_s <= seen_s[-1] + lag)
        there = np.interp(height_s[both], seen_s + lag, seen)
        return float(np.corrcoef(there, height[both])[0, 1])

    if (own := agreement(CAPTURE_HZ)) > 0.8:
        return
    others = {rate: agreement(rate) for rate in OTHER_RATES_HZ}
    best = max(others, key=lambda rate: others[rate])
    said = f"heights that follow {RIGID_FILE} at {best:g} Hz (correlation {others[best]:.2f}; at 100 Hz {own:.2f})"
    require(others[best] < max(0.8, own), "rate", CAPTURE, "100 rows a second", said)


def _bridged(values: np.ndarray) -> np.ndarray:
    """Return values with straight lines over what is NaN."""
    known = np.isfinite(values)
    return np.interp(np.arange(len(values)), np.flatnonzero(known), values[known])


# The recording as a whole


@dataclass(frozen=True)
class Recording:
    """The released files of the trial that are here: motion capture, tables of the models, clock of rigid.csv."""

    capture: Capture
    tables: dict[str, np.ndarray]
    clock_s: np.ndarray

    @cached_property
    def measured(self) -> np.ndarray:
        """M1 and M2 ``[rows, 2, 3]`` [m] at the rows of rigid.csv, without those that the authors drop."""
        row = np.rint(CAPTURE_HZ * self.clock_s).astype(int)
        return self.capture.points[row[row < len(self.capture.points)]][CAPTURE_LATER:]

    def paired(self, name: str, later: int) -> tuple[np.ndarray, np.ndarray]:
        """Return M1 and M2 ``[rows, 2, 3]`` [m], measured and of a table, in the rows that the authors evaluate."""
        modelled = self.tables[name][later:, [4, 7]]
        rows = min(len(self.measured), len(modelled))
        return self.measured[:rows][SCORED], modelled[:rows][SCORED]

    @cached_property
    def orientations(self) -> np.ndarray:
        """Of base and IMUs at the rows of rigid.csv ``[rows, 9, 4]``."""
        return martin_files.trial_orientations(self.tables)

    @cached_property
    def as_evaluated(self) -> Trial:
        """The rows that the authors evaluate as a trial, for chains of which there is no table."""
        later = ROWS_OF_PCC_2 - martin_files.LATER
        q = self.orientations[later:]
        rows = min(len(self.measured), len(q))
        points, q, times = (x[:rows][SCORED] for x in (self.measured + ORIGIN, q, self.clock_s[later:]))
        seen = np.isfinite(points).all(axis=(1, 2))
        return Trial(times[seen], q[seen], points[seen])

    @cached_property
    def sensors(self) -> tuple[np.ndarray, np.ndarray, str]:
        """Times [s] and orientations ``[t, 9, 4]`` with our alignment, and what they come from, in words."""
        path, why = martin_files.place_of(QUATERNIONS), ""
        if path.is_file():
            try:
                return *martin_files.read_quaternions(path), "the raw quaternions"
            except InputError as error:
                why = f", because the raw quaternions have another form than we inferred ({error})"
        rows = min(len(self.clock_s), len(self.orientations))
        return self.clock_s[:rows], self.orientations[:rows], f"the tables{why}"

    @cached_property
    def aligned(self) -> Trial:
        """The trial on the clock of the IMUs. The lag is that of the heights of M2 in the first part alone."""
        clock_s, q, _ = self.sensors
        seen, first = self.capture.points, clock_s - clock_s[0] < FIRST_S
        start_s = self.clock_s[CAPTURE_LATER - ROWS_OF_PCC_2 + martin_files.LATER]  # of the authors' rows
        seen_s = np.arange(len(seen)) / CAPTURE_HZ - start_s
        height = martin.shape(q[first], arm("pcc"), MARKERS[1])[:, 0, 2]
        seen_s = seen_s + martin.clock_lag(clock_s[first], height, seen_s, _bridged(seen[:, 1, 2]), WIDEST_S)
        known = (clock_s >= seen_s[0]) & (clock_s <= seen_s[-1])
        return Trial(clock_s[known], q[known], _at(clock_s[known], seen_s, seen))


def recording() -> Recording | None:
    """Return the recording; None without the motion capture or a table that tells the orientations."""
    if not all(martin_files.place_of(name).is_file() for name in (CAPTURE, *NEEDED)):
        return None
    capture = read_capture(martin_files.place_of(CAPTURE))
    clock_s = martin_files.read_clock(martin_files.place_of(RIGID_FILE))
    return checked(Recording(capture, martin_files.recorded_tables(), clock_s))


def checked(found: Recording) -> Recording:
    """Return a recording whose capture has the rate of the tables, and covers what the authors evaluate."""
    check_rate(found.capture, found.clock_s, found.tables[RIGID_FILE][:, 7, 2])
    least = SCORED.start + 100
    must_be = f"{(CAPTURE_LATER + least) * np.median(np.diff(found.clock_s)):.0f} s or longer"
    length = f"{len(found.capture.points) / CAPTURE_HZ:.0f} s"
    require(len(found.measured) >= least, "length", CAPTURE, must_be, length)
    return found


# As the authors did


def authors_errors(found: Recording) -> dict[Case, np.ndarray]:
    """Return how far M1 and M2 ``[rows, 2]`` [mm] of each table are from the motion capture; NaN where not seen."""
    here = {case: table for case, table in TABLES.items() if table[0] in found.tables}
    return {
        case: 1e3 * np.linalg.norm(np.subtract(*found.paired(*table)), axis=-1)
        for case, table in here.items()
    }


def marker_errors(found: Recording, chosen: Sequence[Case]) -> pd.DataFrame:
    """Return quantiles of the markers' errors [mm], in the columns of the synthetic ones.

    As in the files: the tables themselves. The other chains take the orientations behind the tables.
    """
    errors, lines = authors_errors(found), []
    here = [case for case in chosen if case in errors]
    for case in here:
        quantiles = np.nanpercentile(errors[case], [*martin.QUANTILES.values()], axis=0)
        own = 0, case.figure, case.name, *case[1:], martin.FILES
        lines += [(*own, *both) for both in (("M1", *quantiles[:, 0]), ("M2", *quantiles[:, 1]))]
    tables = pd.DataFrame(lines, columns=["draw", *martin.KEYS, *martin.QUANTILES])
    others = martin.marker_errors([found.as_evaluated], here)
    return pd.concat([tables, others[others["evaluation"] != martin.FILES]], ignore_index=True)


def own_check(found: Recording) -> pd.DataFrame:
    """Return the third quartiles [mm] of pcc1.csv: as printed in the authors' notebook, and ours."""
    errors = authors_errors(found).get(Case("Fig. 4", "pcc", 8, 8))
    ours = [np.nan] * 2 if errors is None else np.nanpercentile(errors, 75, axis=0)
    table = pd.DataFrame({"marker": ["M1", "M2"], "printed_mm": THIRD_QUARTILES_MM, "ours_mm": ours})
    return table.assign(agree=(table["ours_mm"] - table["printed_mm"]).abs() <= 1e-3)


# With our alignment: clocks and frame fitted on the first part, evaluated on the rest


class Chain(NamedTuple):
    """A model of the arm, and what is fitted to the first part besides the clocks."""

    name: str
    model: ShapeModel
    arm: martin.Arm
    per_imu: bool = False
    case: Case | None = None
    """Where the authors released its table."""


def chains() -> list[Chain]:
    """Return the models that both columns compare: those of the files, of the text, and ours."""
    rigid_8, pcc_16 = Case("Fig. 3", "rigid", 8, 8), Case("Fig. 4", "pcc", 8, 16)
    return [
        Chain("rigid-body (pcc1.csv)", pcc_extended, martin.released_arm("rigid"), case=rigid_8),
        Chain("PCC-extended (pcc2.csv)", pcc_extended, martin.released_arm("pcc"), case=pcc_16),
        Chain("rigid-body, of the text", rigid_body, arm("rigid")),
        Chain("PCC-extended, of the text", pcc_extended, arm("pcc")),
        Chain("exact arcs", exact_arcs, arm("pcc")),
        Chain(martin.BEST, exact_arcs, arm("pcc"), per_imu=True),
    ]


def _at(times: np.ndarray, seen_s: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return points at other times by straight lines; NaN where none was seen for a while."""
    columns = []
    for values in seen.reshape(len(seen), -1).T:
        known = np.flatnonzero(np.isfinite(values))
        there = np.interp(times, seen_s[known], values[known])
        after = np.clip(np.searchsorted(seen_s[known], times), 1, len(known) - 1)
        gap = seen_s[known][after] - seen_s[known][after - 1]
        columns.append(np.where(gap <= LONGEST_GAP_S, there, np.nan))
    return np.stack(columns, axis=-1).reshape(len(times), *seen.shape[1:])


def aligned_errors(trial: Trial, chain: Chain) -> np.ndarray:
    """Return the errors of M1 and M2 ``[t, 2]`` [mm] after the first part, on which the frame is fitted."""
    first = trial.time_s - trial.time_s[0] < FIRST_S
    require(
        not first.all(), "length", "the trial", f"longer than {FIRST_S:g} s", f"{np.ptp(trial.time_s):.0f} s"
    )
    q = chain.arm.select(trial.orientations)
    fit = martin.calibrate_imus(
        q[first][::10], trial.points[first][::10], chain.model, chain.arm, per_imu=chain.per_imu
    )
    points = chain.model(martin.calibrated(q[~first], fit), chain.arm, chain.arm.markers) + fit.translation
    return 1e3 * np.linalg.norm(points - trial.points[~first], axis=-1)


def both_ways(found: Recording) -> pd.DataFrame:
    """Return median and third quartile [mm] of each chain at both markers, as the authors did and as we align."""
    errors, rows, lines = authors_errors(found), found.as_evaluated, []
    for chain in chains():
        own = errors[chain.case] if chain.case else None
        if chain.case is None and not chain.per_imu:
            points = chain.model(chain.arm.select(rows.orientations), chain.arm, chain.arm.markers)
            own = 1e3 * np.linalg.norm(points - rows.points, axis=-1)
        both = own, aligned_errors(found.aligned, chain)
        quartiles = [
            np.full(4, np.nan) if x is None else np.nanpercentile(x, [50, 75], axis=0).T for x in both
        ]
        lines.append((chain.name, *np.ravel(quartiles[0]), *np.ravel(quartiles[1])))
    columns = [f"{way}_{q}_{m}_mm" for way in ("authors", "ours") for m in ("m1", "m2") for q in SHORT]
    return pd.DataFrame(lines, columns=["chain", *columns])


SHORT = {"median": "median_mm", "q75": "q75_mm"}
"""Of both ways, and of the rows of the scorecard."""
SETTING = f"{AUTHORS}: tables of the models and motion capture, rows paired as in the authors' notebook"


def scorecard_rows(table: pd.DataFrame, both: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the recording; numbers whose table is not here stay those of the committed simulation."""
    ours = both.set_index("chain").loc[martin.BEST]
    columns = {name: [ours[f"ours_{short}_{m}_mm"] for m in ("m1", "m2")] for short, name in SHORT.items()}
    best = pd.DataFrame(columns, index=1e3 * np.array(MARKERS))
    found = martin.scorecard_rows(table, best, SETTING, f"{martin.BEST_METHOD}; {AUTHORS}")
    found = found.assign(comparable=found["comparable"].eq(True))  # the time is another computer's
    path = project_folder() / "results" / "imu_markers.rows.csv"
    committed = pd.read_csv(path) if path.is_file() else found[:0]
    own = pd.MultiIndex.from_frame(found[KEY])
    rest = committed[~pd.MultiIndex.from_frame(committed[KEY]).isin(own)]
    return pd.concat([found, rest.assign(comparable=rest["comparable"].astype(bool))], ignore_index=True)


# Fig. 6, and words


def through_markers(trial: Trial, k: int, arcs: np.ndarray) -> np.ndarray:
    """Return the arm at one sample [m]: the PCC-extended model, moved so that it passes through both markers.

    There is motion capture of two points alone. Between base and markers the arm moves by their distances from the
    model, proportional to the arc.
    """
    q, known = trial.orientations[k : k + 1], [0.0, *MARKERS]
    off = np.vstack([np.zeros(3), trial.points[k, :2] - martin.shape(q, arm("pcc"), MARKERS)[0]])
    moved = [np.interp(arcs, known, x) for x in off.T]
    return martin.shape(q, arm("pcc"), arcs)[0] + np.stack(moved, axis=-1)


def hull(found: Recording) -> pd.DataFrame:
    """Return the arm at three heights of M2 with the third quartile of the error as radius: Fig. 6."""
    rows, errors = found.as_evaluated, authors_errors(found)[Case("Fig. 4", "pcc", 8, 16)]
    arcs, height, parts = 0.04 * np.arange(1, 17), rows.points[:, 1, 2], []
    radius = np.interp(arcs, [0.0, *MARKERS], [0.0, *np.nanpercentile(errors, 75, axis=0)])
    for name, share in {"low": 0.05, "middle": 0.5, "high": 0.95}.items():
        k = int(np.abs(height - np.quantile(height, share)).argmin())
        estimate = martin.shape(rows.orientations[k : k + 1], arm("pcc"), arcs)[0]
        both = np.hstack([through_markers(rows, k, arcs), estimate])
        parts.append(martin.in_hull(name, rows.time_s[k], arcs, both, radius))
    return pd.concat(parts, ignore_index=True)


CAPTIONS = {
    "links": "Both models of Fig. 2 on the authors' trial, seen from the side, at the moment when their ends are"
    " farthest apart. Coloured lines: links with their joints. Black: the PCC-extended model, moved so"
    " that it passes through both recorded markers. Dotted lines: from the end of each link to its place"
    " on it.",
    "boxes": "Paper Figs 3, 4 and 5, regenerated from the authors' tables and motion capture. Boxes run from the"
    " first to the third quartile Q3, whiskers from 5 to 95 % (in the paper they are 1.5 times the box)."
    " Diamonds and triangles are published values. For Fig. 4 the paper prints two third quartiles, which"
    " we assign to M1; we read those of Figs 3 and 5 off the figures, to about 1.5 mm.",
    "hull": "Paper Fig. 6, regenerated from the authors' files and seen from the side (the paper draws one pose"
    " in 3-D). Low, middle, high: the height of M2 is its 5, 50 or 95 % quantile. The radius of the hull"
    " is the third quartile of the error of the chain of pcc2.csv, known at the base and both markers and"
    " straight in between. Orange: the PCC-extended model of the text. Black: the same, moved so that it"
    " passes through both recorded markers.",
}
"""Of the page's figures with the authors' files."""
ABOUT_THE_ARM = "We take orientations and two recorded markers of the authors' trial."
BELOW_TABLE_II = (
    "Lower: the tables of the models against the motion capture. The rigid-body column is the chain with 8 segments,"
    " 40 mm before the markers, as in the authors' files. Italic: the chains that we compute at the markers."
)


def both_ways_shown(both: pd.DataFrame) -> pd.DataFrame:
    """Return the table of both evaluations as a reader sees it: median (third quartile) [mm]."""
    columns = {"chain": both["chain"]}
    for way, words in (("authors", "authors"), ("ours", "aligned")):
        for marker in ("M1", "M2"):
            pairs = both[[f"{way}_{short}_{marker.lower()}_mm" for short in SHORT]].to_numpy()
            shown = [f"{median:.2f} ({q3:.2f})" if np.isfinite(median) else "–" for median, q3 in pairs]
            columns[f"{words} {marker}"] = pd.Series(shown)
    return pd.DataFrame(columns)


def both_ways_in_words(found: Recording, both: pd.DataFrame) -> str:
    """Return how to read the table of both evaluations."""
    best = both.set_index("chain").loc[[both["chain"].iloc[1], martin.BEST], "ours_median_m2_mm"]
    return (
        "**Two evaluations** of eight IMUs, as median and, in brackets, third quartile in mm. *Authors* pairs rows by"
        " number and fits nothing. *Aligned* brings the clocks"
        " together and fits the frame of the cameras, both on the first minute, and has the errors of the rest."
        f" The orientations are those of {found.sensors[2]}. Aligned, the median error at M2 is {best.iloc[0]:.2f} mm"
        f" with the chain of `pcc2.csv`, and {best.iloc[1]:.2f} mm with exact arcs, headings and mountings."
    )


EVALUATED = """
**A check.** {{ checked }} Ours are {{ ours }} mm, and the printed ones {{ printed }} mm.
{% if agree %}
They agree to 0.001 mm, so we evaluate as the authors did.
{% else %}
**They do not agree**: this is another motion capture, or our evaluation is not theirs.
{% endif %}
We compare {{ rows }} rows as the notebook does (its cells 5 to 34): from row 1,000 to row 8,000 or to the end of the
motion capture.
{% if lost %}
{{ lost }} of {{ captured }} rows of the motion capture lack a marker or the base, and we left these out.
{% endif %}
Pairs of rows are not equally far apart in time: by the clock of `rigid.csv` earliest and latest pair differ by
{{ apart | fixed(2) }} s.
"""


def badge() -> str:
    """Return in a word what the page is about."""
    other = martin_files.unlike_released()
    return (
        f"{len(other)} files are not the released ones" if other else "the authors' tables and motion capture"
    )


def evaluated_in_words(found: Recording) -> str:
    """Return what the authors' evaluation came to here, with the check against their notebook."""
    check, rows = own_check(found), len(authors_errors(found)[Case("Fig. 4", "pcc", 8, 16)])
    ours, printed = (" and ".join(f"{x:.3f}" for x in check[c]) for c in ("ours_mm", "printed_mm"))
    later = CAPTURE_LATER - ROWS_OF_PCC_2 + martin_files.LATER
    apart = np.ptp(found.clock_s[later:] - found.clock_s[:-later])
    lost = f"{found.capture.lost:,}" if found.capture.lost else ""
    counts = {"rows": f"{rows:,}", "lost": lost, "captured": f"{len(found.capture.points):,}"}
    said = {"checked": CHECKED, "agree": check["agree"].all(), "ours": ours, "printed": printed}
    return sentences(EVALUATED, apart=apart, **counts, **said)


CHECKED = (
    "The authors' notebook prints two errors without rounding, the third quartiles of `pcc1.csv` at M1 and M2. They"
    " are the 17.7 and 16.25 % of the rigid-body model in Table II."
)


# What the page shows in both states


def caption(figure: str, found: Recording | None) -> dict[str, str]:
    """Return the metadata of a figure: its caption where it shows the recording."""
    return {"caption": CAPTIONS[figure]} if found else {}


def all_errors(
    found: Recording | None, trials: Sequence[Trial], imus: Sequence[int], segments: Sequence[int]
) -> pd.DataFrame:
    """Return quantiles of the markers' errors [mm]: of the authors' tables, or of synthetic trials."""
    if found:
        return marker_errors(found, martin.cases(imus, sorted({*segments, 48})))
    return martin.marker_errors(trials, martin.cases(imus, segments))


def around_table_ii(found: Recording | None, table: pd.DataFrame) -> tuple[str, str]:
    """Return what stands over and under Table II."""
    if found:
        return badge(), BELOW_TABLE_II
    return "synthetic trial against hardware: not comparable", martin.below_table_ii(table)


def farthest_apart(
    found: Recording | None, trial: Trial, rigid: np.ndarray, extended: np.ndarray
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the joints of both models and the arm with its base [m], where the models' ends are farthest apart."""
    seen = np.isfinite(trial.points[:, :2]).all(axis=(1, 2))
    k = int((seen * np.linalg.norm(extended[:, -1] - rigid[:, -1], axis=-1)).argmax())
    arcs = 0.04 * np.arange(1, 17)
    if found:
        there = through_markers(trial, k, arcs)
    else:
        moment = trial.time_s[[k]] - martin.LATENCY_S  # of what the IMUs show
        there = martin.motion().points(moment, arcs)[0]
    return {"rigid-body": rigid[k], "PCC-extended": extended[k]}, np.vstack([np.zeros(3), there])


def card(table: pd.DataFrame, study: pd.DataFrame, both: pd.DataFrame | None) -> pd.DataFrame:
    """Return the rows of the scorecard; without the recording, our best is that of the synthetic study."""
    if both is None:
        return martin.scorecard_rows(table, martin.best_errors(study))
    return scorecard_rows(table, both)


WRITTEN = (
    "We wrote this evaluation from the text of their notebook, without a motion capture to try it on. So the page"
    " checks itself."
)


def both_ways_on_the_page(found: Recording | None, both: pd.DataFrame | None) -> list[object]:
    """Return words and table of both evaluations; nothing without the recording."""
    if found is None or both is None:
        return []
    return [both_ways_in_words(found, both), show(both_ways_shown(both))]


def files_on_the_page(found: Recording | None, files: pd.DataFrame) -> list[object]:
    """Return which files are here, how to get them, and how well our chains give the released tables."""
    here, tables = martin_files.files_in_words(), martin_files.tables_in_words(files)
    if found:
        compared = show(files[list(martin_files.HEADS)], martin_files.HEADS)
        return [f"{evaluated_in_words(found)} {here}\n\n{tables}", compared]
    fetch = f"{here} These commands get them and build the page:\n\n{martin_files.FETCH}"
    return [f"{fetch}\n\n{WRITTEN} {CHECKED}\n\n{tables}"]
