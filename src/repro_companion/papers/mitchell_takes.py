"""Bend tests and light bulb of Mitchell et al. 2021: what methods find on the recordings, in tables and words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from repro import BendSensor
from repro.estimators.base import Estimate
from repro_companion.papers.mitchell_files import (
    BULB,
    DIRECTIONS_DEG,
    Hall,
    NominalBends,
    Take,
    ratio,
    side_by_side,
)
from repro_companion.show import fold, number, sentences

# A module at nominal bends


def nominal_length_mm(bends: NominalBends, length_mm: float) -> float:
    """Return the length of the arc [mm] with which the model's field across the body fits nominal bends best.

    This field is nearly a dipole's and goes with the inverse cube of the length, so one length gives all others.
    """
    own = bends.of(~bends.suspect)
    u = BendSensor(1e-3 * length_mm)(np.stack([own.q.real, own.q.imag], axis=-1))
    model = u[:, 0] + 1j * u[:, 1]
    gain = abs((own.across_mt * model.conj()).sum()) / (np.abs(model) ** 2).sum()
    return length_mm * gain ** (-1 / 3)


def nominal_errors(
    bends: NominalBends, calibrate: Callable[..., complex], invert: Callable[..., Sequence[np.ndarray]]
) -> pd.DataFrame:
    """Return what nominal bends calibrate, how well, and how well they repeat: of all, and of each direction alone.

    The bend of a file is found with the other repetitions as calibration.
    """
    suspect, direction = bends.suspect, bends.files["direction"].to_numpy()
    groups = {"all": ~suspect} | {
        f"{degrees:.0f}°": (direction == folder) & ~suspect for folder, degrees in DIRECTIONS_DEG.items()
    }
    groups |= {"all, with 90° in direction 0°": ~suspect | suspect, "90° in direction 0°": suspect}
    lines = []
    for name, own in ((name, bends.of(chosen)) for name, chosen in groups.items() if chosen.any()):
        c, repetition = calibrate([own]), own.files["repetition"].to_numpy()
        crossed, bend = np.full(len(own.q), np.nan), np.abs(invert(own.ratio, c)[0])
        for left in (repetition == one for one in set(repetition)):
            if not left.all():
                crossed[left] = np.abs(invert(own.ratio[left], calibrate([own.of(~left)]))[0])
        # Two draws differ by the root of twice their variance.
        alike = own.files.assign(twice=np.sqrt(2) * bend).groupby(["direction", "bend_deg"])["twice"]
        line = {"direction": name, "files": len(own.q), "gain": abs(c), "turn_deg": np.degrees(np.angle(c)),
                "error_deg": rms_deg(crossed - np.abs(own.q)), "repeat_deg": rms_deg(alike.std().to_numpy()),
                "largest_ratio": np.abs(own.ratio).max(), "rest": abs(own.rest)}  # fmt: skip
        lines.append(line | own.files[["rows", "spikes", "unreadable"]].sum().to_dict())
    return pd.DataFrame(lines)


NOMINAL_WORDS = """
**On the takes, ratios calibrated at nominal bends have an error of {{ at_bends }}°, which is {{ "worse" if worse
else "better" }} than without any calibration.** Without it the error is {{ without }}°, and with a calibration on
other tests {{ tests }}°.
"""
REASON = """
**Why are they {{ "worse" if worse else "better" }}?** The files show a part of the reason. In them the ratio is {{
all.gain | two }} times as large as in the model, on the takes {{ low | two }} to {{ high | two }} times, so every
bend comes out at about {{ size | fixed(0) }} % of its size. At rest the ratio has a size of {{ all.rest | two }}
there, and of about {{ rest | two }} on the takes. So it is probably another module, or the same one mounted in
another way (inferred). Nor need a nominal bend be the bend between sensor and magnet. A dipole on an arc of up to
90° has ratios of at most 1/3, and the files reach {{ all.largest_ratio | two }}.
"""
AGREEMENT = """
**The files disagree with each other.** Bends of two repetitions differ by {{ all.repeat_deg | two }}° (RMS). Bends
that we find with the other repetitions as calibration have an error of {{ all.error_deg | two }}°. With a *c* for
each direction it is {{ least | two }}° to {{ most | two }}°, which helps little, so we keep one *c*.
{% if suspect is not none %}
The {{ suspect.files | fixed(0) }} files of 90° in direction 0° alone would give a *c* of {{ suspect.gain | two }}.
They read like much smaller bends, and we do not know why. We leave them out.
{% endif %}
"""


def nominal_in_words(nominal: pd.DataFrame, rmse_deg: pd.Series, takes: pd.DataFrame) -> str:
    """Return what a calibration at nominal bends is worth on the takes, and why, as far as the files show it."""
    by = nominal.set_index("direction")
    one, turned = by.loc["all"], by.loc[by.index.str.fullmatch(r"\d+°"), "error_deg"]
    hows = ("nominal bends", "none", "other tests")
    at_bends, without, tests = rmse_deg.reindex([METHODS["ours", how] for how in hows]).to_numpy(float)
    if np.isnan(at_bends):
        return "The files at nominal bends are not here. The table has what this page found with them."
    low, middle, high = np.quantile(takes["gain"], [0, 0.5, 1])
    errors = {"at_bends": number(at_bends, 2), "without": number(without, 2), "tests": number(tests, 2)}
    sizes = {"low": low, "high": high, "size": 100 * middle / one["gain"], "rest": takes["rest"].median()}
    worse = at_bends > without
    worth, reason = (
        sentences(NOMINAL_WORDS, worse=worse, **errors),
        sentences(REASON, worse=worse, all=one, **sizes),
    )
    suspect = by.loc["90° in direction 0°"] if "90° in direction 0°" in by.index else None
    agreement = sentences(AGREEMENT, all=one, least=turned.min(), most=turned.max(), suspect=suspect)
    both = fold("Why, and do the files agree with each other?", f"{reason}\n\n{agreement}")
    return f"{worth}\n\n{both}"


# Fig. 9 as tables


class Run(NamedTuple):
    """What one method found on one take."""

    method: str
    calibration: str
    length_mm: float
    take: Take
    q: np.ndarray
    """Bend vectors [rad], complex."""
    deviation: np.ndarray | None = None
    """Standard deviation of the bend [rad] that the method states."""

    @property
    def name(self) -> str:
        """The method as a reader sees it."""
        label, length = METHODS[self.method, self.calibration], f"{self.length_mm:.3g} mm"
        if (self.method, self.calibration) == COMPARED[0] and self.length_mm != RELEASED_MM:
            return f"{label} but {length}"
        return f"{label}, {length}" if self.method.startswith("paper") else label

    @property
    def turned(self) -> np.ndarray:
        """Direction beyond that of motion capture, as complex numbers of size one, where the bend is large enough."""
        bent = (np.abs(self.take.q) >= np.radians(LEAST_BEND_DEG)) & np.isfinite(self.q)
        return np.exp(1j * np.angle(self.q[bent] / self.take.q[bent]))


TURN_UNKNOWN = ("none", "nominal bends")
"""Calibrations without motion capture."""
LEAST_BEND_DEG = 20.0
"""Directions are compared from this bend on."""
METHODS = {
    ("motion capture", "none"): "motion capture",
    ("paper, printed noise", "none"): "paper's filter, printed noise",
    ("paper, as released", "none"): "paper's filter, released settings",
    ("authors' output", "none"): "authors' own output",
    ("ours", "none"): "ratios, not calibrated",
    ("paper, as released", "nominal bends"): "paper's filter, arc from nominal bends",
    ("ours", "nominal bends"): "ratios, calibrated at nominal bends",
    ("ours", "other tests"): "ratios, calibrated on other tests",
    ("ours", "other try"): "ratios, calibrated on the other try",
}
FIG_9 = (("paper, as released", "none"), ("authors' output", "none"), ("ours", "other tests"))
"""Methods that are drawn over time, and their calibrations."""
COMPARED = (("paper, as released", "none"), ("ours", "none"), ("ours", "other tests"))
"""And those whose errors the page compares, the first one with both arcs."""
RELEASED_MM = 13.0
"""Length of the arc in the released code."""
BENDS_DEG = {
    "rmse_deg": (0, 180),
    "rmse_below_20_deg": (0, 20),
    "rmse_20_to_40_deg": (20, 40),
    "rmse_above_40_deg": (40, 180),
}


def bend_deviation(found: Estimate) -> np.ndarray:
    """Return the standard deviation of the bend [rad] from the covariance of the bend vector."""
    along = found.q / np.maximum(np.linalg.norm(found.q, axis=-1, keepdims=True), 1e-12)
    return np.sqrt(np.einsum("...i,...ij,...j", along, found.covariance, along))


def rms_deg(x: np.ndarray) -> float:
    """Return a root mean square in degrees, over what is known."""
    return float(np.degrees(np.sqrt(np.nanmean(np.abs(x) ** 2)))) if np.isfinite(x).any() else np.nan


def bend_errors(runs: Sequence[Run]) -> pd.DataFrame | None:
    """Return errors of the bend by method and take, also by the size of the bend, and of the direction.

    A sensor does not know how it was turned against motion capture: unless other takes calibrate it, the mean turn of
    the takes of other tests is taken off.
    """
    if not runs:
        return None
    lines = []
    for run in runs:
        truth, off = np.abs(run.take.q), np.abs(run.q) - np.abs(run.take.q)
        size = np.degrees(truth)
        alike = [other for other in runs if other.name == run.name and other.take.test != run.take.test]
        mean = sum(other.turned.sum() for other in alike) if run.calibration in TURN_UNKNOWN else 1.0
        within = None if run.deviation is None else (np.abs(off) <= 2 * run.deviation)[np.isfinite(off)]
        lines.append({
            "method": run.method,
            "calibration": run.calibration,
            "length_mm": run.length_mm,
            "name": run.name,
            "take": run.take.name,
            **{name: rms_deg(off[(size >= low) & (size < high)]) for name, (low, high) in BENDS_DEG.items()},
            "rmse_tilt_z_deg": rms_deg(np.abs(run.q) - run.take.tilt_z),
            "direction_deg": rms_deg(np.angle(run.turned / np.exp(1j * np.angle(mean)))),
            "within_percent": np.nan if within is None else 100 * within.mean(),
        })  # fmt: skip
    return pd.DataFrame(lines)


def taken(takes: Sequence[Take], gains: Sequence[float]) -> pd.DataFrame | None:
    """Return what was found of each take on the way, with the size of the c that fits it; None without takes."""
    if not takes:
        return None
    table = pd.DataFrame([{"take": take.name, **take.facts} for take in takes])
    others = [table["lag_s"].drop(k).median() for k in table.index]
    return table.assign(
        lag_off_s=table["lag_s"] - others,
        peak_deg=[np.degrees(np.nanmax(abs(x.q))) for x in takes],
        rest=[abs(ratio(x.rest_mt)) for x in takes],
        gain=gains,
    )


def runs_of_the_paper(
    takes: Sequence[Take],
    bends: NominalBends | None,
    follow: Callable[..., np.ndarray],
    across: Callable[[np.ndarray, np.ndarray], np.ndarray],
    length_mm: float,
) -> list[Run]:
    """Return what the paper's filter finds on all takes at once, by settings, and the authors' own output."""
    if not takes:
        return []
    zeroed = side_by_side([across(take.u, take.rest_mt) for take in takes])
    arcs = [("none", length_mm), ("none", 15.0)]
    if bends:
        arcs.append(("nominal bends", nominal_length_mm(bends, length_mm)))
    printed = follow(side_by_side([take.u for take in takes]), process_noise_pi=0.002)
    filtered = {("paper, printed noise", "none", length_mm): printed}
    filtered |= {("paper, as released", *arc): follow(zeroed, arc[1]) for arc in arcs}
    runs = [
        Run(*how, take, q[: len(take.u), k] @ [1, 1j])
        for how, q in filtered.items()
        for k, take in enumerate(takes)
    ]
    logged = [take for take in takes if take.log is not None]
    return runs + [Run("authors' output", "none", np.nan, take, take.log) for take in logged]


def compared(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the errors of the methods that the page compares: the paper's filter also with an arc of 15 mm."""
    return errors[pd.MultiIndex.from_frame(errors[["method", "calibration"]]).isin(COMPARED)]


def median_errors(errors: pd.DataFrame) -> pd.DataFrame:
    """Return medians over the takes, and how many takes there are."""
    groups = errors.groupby(["method", "calibration", "length_mm", "name"], sort=False, dropna=False)
    return groups.median(numeric_only=True).assign(takes=groups.size()).reset_index()


def over_time(runs: Sequence[Run], points: int = 200) -> pd.DataFrame:
    """Return bends and directions over time, these less their mean and where the bend is large enough."""
    lines = []
    takes = {run.take.name: run.take for run in runs}
    for run in [*(Run("motion capture", "none", np.nan, take, take.q) for take in takes.values()), *runs]:
        bent = (np.abs(run.take.q) >= np.radians(LEAST_BEND_DEG)) & np.isfinite(run.q)
        mean = np.exp(1j * np.angle(run.q[bent])).sum()
        direction = np.where(bent, np.degrees(np.angle(run.q / mean)), np.nan)
        columns = {"time_s": run.take.time_s - run.take.time_s[0], "bend_deg": np.degrees(np.abs(run.q))}
        table = pd.DataFrame(
            {**columns, "direction_deg": direction, "take": run.take.name, "method": run.name}
        )
        lines.append(table[:: max(len(table) // points, 1)])
    return pd.concat(lines, ignore_index=True)


# Fig. 8

Events = Callable[[pd.DataFrame, float, float], list[tuple[float, float]]]


def event_counts(rises: Mapping[str, pd.DataFrame], noise: float, events: Events) -> pd.DataFrame | None:
    """Return how many events every file has, by threshold in units of the noise and by what is merged."""
    if not rises:
        return None
    return pd.DataFrame(
        {"times_noise": times, "threshold": times * noise, "merged_s": apart}
        | {"frozen": (times, apart) == (10, 1.0)}
        | {name: len(events(one, times * noise, apart)) for name, one in rises.items()}
        for times in (5, 10, 20, 40)
        for apart in (0.25, 1.0)
    )


def bulb_events(rises: Mapping[str, pd.DataFrame], noise: float, events: Events) -> pd.DataFrame:
    """Return start and end [s] of the events of every file, above ten times the noise."""
    marks = [(name, *span) for name in BULB for span in events(rises[name], 10 * noise, 1.0)]
    return pd.DataFrame(marks, columns=["file", "start_s", "end_s"])


def bulb_curves(
    light: Mapping[str, Hall],
    rises: Mapping[str, pd.DataFrame],
    follow: Callable[..., np.ndarray],
    across: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> pd.DataFrame:
    """Return ratios over time with bend and direction by the paper's filter, a row in four."""
    rested = [across(light[name].u, light[name].u[:100].mean(axis=0)) for name in BULB]
    bent = follow(side_by_side(rested)) @ [1, 1j]
    parts = []
    for name, q in zip(BULB, bent.T, strict=True):
        own = q[: len(rises[name])]
        columns = {"bend_deg": np.degrees(abs(own)), "direction_deg": np.degrees(np.angle(own))}
        parts.append(rises[name].assign(file=name, **columns))
    return pd.concat(parts)[::4]


def bulb_shown(counts: pd.DataFrame) -> pd.DataFrame:
    """Return the events in each file beside the attempts that the caption of Fig. 8 counts."""
    number_of = counts.set_index("frozen")[[*BULB, "light_-1"]]
    return pd.DataFrame({
        "file": ["0", "1", "2", "trial run"],
        "attempts by the caption": ["3", "3", "1", "–"],
        "events": number_of.loc[True].to_numpy(),
        "fewest, of all settings": number_of.min().to_numpy(),
        "most": number_of.max().to_numpy(),
    })  # fmt: skip


BULB_WORDS = """
On the authors' files 0, 1 and 2 the detector finds {{ events | join(", ") }} events, and {{ trial }} in the trial
run. The caption counts 3, 3 and 1. With other thresholds and other pauses between events it finds these in {{ equal
or "none" }} of {{ settings }} settings. So a threshold alone does not tell the attempts from other movements. Which
file is which experiment is our guess.
{% if here %}
To our eye there are three sharp peaks in file 1 and one long one in file 2, but in file 0 we cannot count three.
Two things are ours and not the paper's. The ratio starts far above zero, because the module rests in another shape
than in the trial run (inferred). In file 1 the field across the body changes its sign after 24 s. Less the readings
at rest it is then larger than any bend makes it, so our run of the filter goes to its bound of 90°.
{% else %}
The figure itself needs the recordings. The commands at the top of this page bring them.
{% endif %}
"""


def bulb_in_words(counts: pd.DataFrame, here: bool) -> str:
    """Return what the detector finds, and how that depends on its settings."""
    frozen = counts[counts["frozen"]].iloc[0]
    equal = int((counts[BULB] == [3, 3, 1]).all(axis=1).sum())
    found = {"events": [*frozen[BULB]], "trial": frozen["light_-1"], "equal": equal, "settings": len(counts)}
    return sentences(BULB_WORDS, here=here, **found)


# What the page shows of the takes

CAPTION = (
    "Paper Fig. 9, from the authors' recordings. Upper panels: bend angle over time. Lower panels: bend direction"
    " minus its mean, where the bend is above 20°. Wide grey: motion capture."
)
ERRORS = {
    "name": "method",
    "rmse_deg": "bend, y [°]",
    "rmse_above_40_deg": "above 40° [°]",
    "rmse_tilt_z_deg": "bend, z [°]",
    "direction_deg": "direction [°]",
    "takes": "takes",
}
"""Of the methods."""


def exchanged_in_words(facts: pd.DataFrame) -> str:
    """Return in how many frames and takes markers were exchanged, and how well the tilt then fits the place."""
    many, misfit = facts["undone_above_40_percent"].gt(30).sum(), facts["off_displacement_deg"].median()
    return fold(
        "Markers that change places",
        "Motion capture takes markers for each other if they lie nearly symmetrically. Then the body seems to turn by"
        " a half turn from one frame to the next. The jumps tell us which half turn to undo. Without these frames"
        " several takes would lose most of their large bends.\n\n"
        f"In {facts['undone'].sum():,} of {facts['frames'].sum():,} frames markers were exchanged, and we turned the"
        f" body back. In {many} takes this concerns more than 30 % of the frames above 40°. Where the body is hardly"
        " depends on which marker is which, so we can check the result: its tilt should be a smooth function of its"
        f" place. It is, within {number(misfit, 1)}° (root mean square, median over the takes).",
    )


WORTH = """
{% macro closer(of) %}{{ "the ratios" if of[0] < of[1] else "the filter" }}{% endmacro %}
**{{ "Against either tilt of the body " ~ closer(y) ~ " came closer to motion capture"
if closer(y) == closer(z) else "Which method is closer to motion capture depends on what we call the bend" }}.**
If it is the tilt of the body's *y* axis, the ratios, calibrated on other recordings, have an error of
{{ y[0] | two }}°, and the paper's filter with the released settings has {{ y[1] | two }}°. If it is the tilt of *z*,
as in the released code, the ratios, still calibrated on *y*,
have {{ z[0] | two }}° and the filter has {{ z[1] | two }}°. With an arc of 15 mm
the filter comes to {{ y[2] | two }}° for *y* and {{ z[2] | two }}° for *z* without any calibration; we explain below
why. All these are medians over {{ takes }} of the 12 recorded takes. The paper prints no errors for Fig. 9.
"""


OF_TWO_TILTS = """
We take *y*, because the body moves to where *y* tilts. We also calibrate on it, which favours our ratios.
{% if alike %}
In {{ alike }} of the takes the choice hardly matters to the filter. There the ratios have an error of
{{ there[0] | two }}° and the filter {{ there[1] | two }}°.
{% endif %}
"""


def errors_in_words(errors: pd.DataFrame) -> str:
    """Return how near the methods come to the bend, and how that depends on the axis whose tilt it is."""
    own, filtered = compared(errors), COMPARED[0]
    by = own.pivot(index="take", columns=["method", "calibration", "length_mm"])
    length = own["length_mm"].iloc[0]
    chosen = [(*COMPARED[2], length), (*filtered, length), (*filtered, 15.0)]
    y, z = (by[of].reindex(columns=chosen) for of in ("rmse_deg", "rmse_tilt_z_deg"))
    alike = (y.iloc[:, 1] - z.iloc[:, 1]).abs() < 0.5  # degrees between errors that are taken for the same
    parts = {"y": y, "z": z, "there": y[alike]}
    numbers = {name: part.median().tolist() for name, part in parts.items()}
    why = sentences(OF_TWO_TILTS, there=numbers.pop("there"), alike=alike.sum())
    worth = sentences(WORTH, **numbers, takes=len(y))
    return f"{worth}\n\n{fold('Which tilt is the bend?', why)}"
