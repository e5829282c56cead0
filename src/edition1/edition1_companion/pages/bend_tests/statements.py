"""What the page of the bend tests says of its tables, in Markdown: every number is that of the takes found."""

from __future__ import annotations

import pandas as pd

from edition1_companion.book.formatted import as_read
from edition1_companion.pages.bend_tests.errors import TARGET_DEG
from edition1_companion.twins.bend_filters import OUR_LENGTH_MM
from edition1_companion.twins.bend_tests import LARGEST_LAG_OFF_S, take_in_words

SAME_OUTPUT_DEG = 0.5
"""Largest difference at which our run of the filter and the authors' output count as the same [deg]."""


def span(values: pd.Series, digits: int = 1) -> str:
    """Smallest and largest value, or the one there is.

    Examples
    --------
    >>> span(pd.Series([2.04, 1.0])), span(pd.Series([2.0]))
    ('1.0 to 2.0', '2.0')
    """
    low, high = (f"{value:.{digits}f}" for value in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"


def of_hall(takes: pd.DataFrame) -> str:
    """What was dropped of the Hall files, and their gaps."""
    dropped = f"{takes['unreadable'].sum()} unreadable rows and {takes['drained'].sum()} from a buffer"
    return (
        f"Hall files: {dropped} were dropped ({span(takes['drained'], 0)} per take), {takes['beyond_range'].sum()} "
        "readings are beyond the range. "
        f"The longest interval between readings is {takes['longest_gap_s'].max():.2f} s."
    )


def of_capture(takes: pd.DataFrame) -> str:
    """What was undone and masked of the motion capture, and what speaks for the y axis."""
    undone, high = span(takes["undone_percent"]), takes["undone_above_40_percent"].max()
    masked, before = span(takes["masked_percent"]), span(takes["masked_if_not_undone_percent"])
    off, azimuth = span(takes["off_displacement_deg"], 2), span(takes["azimuth_off_deg"].abs())
    if takes["masked_if_not_undone_percent"].any():
        repaired = (
            f"exchanged markers were undone in {undone} % of the frames of a take, and in up to {high:.0f} % of "
            f"those above 40 deg; {masked} % are masked. If nothing were undone, {before} % would be masked."
        )
    else:
        repaired = "no markers are exchanged, and no frame is masked."
    return (
        f"Motion capture: {repaired} The tilt of the y axis follows the displacement of the body within {off} deg "
        f"(root mean square about a smooth curve), and their azimuths differ by {azimuth} deg."
    )


def of_lags(takes: pd.DataFrame) -> str:
    """Lags between the clocks, and those that differ from the others."""
    text = f"Lags between the clocks: {span(takes['lag_s'], 2)} s, each with r of {takes['r'].min():.3f} or more."
    if len(takes) == 1:
        return text
    doubtful = takes[takes["lag_off_s"].abs() > LARGEST_LAG_OFF_S]
    if doubtful.empty:
        furthest = takes["lag_off_s"].abs().max()
        return f"{text} None is further than {furthest:.2f} s from the median of the other takes."
    named = [f"{take_in_words(row.take)} ({row.lag_off_s:+.2f} s)" for row in doubtful.itertuples()]
    return f"{text} **Doubtful, far from the median of the other takes: {', '.join(named)}.**"


def of_peaks(takes: pd.DataFrame) -> str:
    """Largest bends by both readings of motion capture and by the sensor, and the sensor's direction."""
    share = takes["peak_hall_deg"] / takes["peak_tilt_y_deg"]
    return as_read(
        f"The sensor as drawn ends at {span(takes['peak_hall_deg'], 0)} deg, {span(share, 2)} of the tilt of the y "
        f"axis, which peaks at {span(takes['peak_tilt_y_deg'], 0)} deg; the tilt of the z axis peaks at "
        f"{span(takes['peak_tilt_z_deg'], 0)} deg. The direction of the sensor less the azimuth of the y axis is "
        f"{span(takes['turned_deg'], 0)} deg."
    )


def of_errors(errors: pd.DataFrame, source: str) -> str:
    """Errors of the bend angle against the tilt of the y axis: medians over the takes, with the range."""
    drawn = errors[(errors["length_mm"] == OUR_LENGTH_MM) | errors["length_mm"].isna()]
    by = drawn.set_index(["method", "calibration"]).sort_index()

    def of(method: str, calibration: str = "none", column: str = "rmse_deg") -> str:
        if (method, calibration) not in by.index:
            return "not run"
        values = by.loc[[(method, calibration)], column].dropna()
        return f"{values.median():.1f} deg ({span(values)}; {len(values)})" if len(values) else "no reading"

    logged, high = of("authors' output"), "rmse_above_40_deg"
    return (
        f"**Error of the bend angle, {source} takes**, median over takes (range; number of takes). "
        f"As drawn: paper's filter as printed {of('paper, as printed')}, as released {of('paper, as released')}, "
        f"authors' output {logged}, least squares on ratios {of('ours')}. The last with a factor and a turn "
        f"fitted to the other try {of('ours', 'other try')}, target {TARGET_DEG:g} deg; to the other tests "
        f"{of('ours', 'other tests')}. Above 40 deg these two are {of('ours', 'other try', high)} and "
        f"{of('ours', 'other tests', high)}."
    )


def of_lengths(medians: pd.DataFrame) -> str:
    """Errors of the filter as released by the length of its model; nothing where there is one length."""
    rows = medians[(medians["method"] == "paper, as released") & medians["length_mm"].notna()]
    if len(rows) < 2:
        return ""
    tries = {True: "takes", False: "first tries"}
    by_length = (
        f"{row.rmse_deg:.1f} deg at {row.length_mm:g} mm ({row.takes} {tries[row.length_mm == OUR_LENGTH_MM]})"
        for row in rows.itertuples()
    )
    return f"The paper's filter as released errs by {', '.join(by_length)}, in the median over the takes."


def of_logs(states: pd.DataFrame, differences: pd.DataFrame) -> str:
    """What became of the authors' own output, and how our run of the released filter compares."""
    there = states[states["state"] != "none"]
    if there.empty:
        return "There is no output of the authors."
    scored = there[there["state"] == "scored"]
    text = f"The authors' own output exists of {len(there)} takes and is scored in {len(scored)}"
    text += f", where it covers {span(scored['share_percent'], 0)} % of the readings." if len(scored) else "."
    for row in there[there["state"] != "scored"].itertuples():
        share = "" if pd.isna(row.share_percent) else f" ({row.share_percent:.0f} %)"
        text += f" **{take_in_words(row.take)}{share} is {row.state.rstrip('.')}.**"
    released = differences[differences["method"] == "paper, as released"]
    if len(released):
        same = released[released["difference_deg"] <= SAME_OUTPUT_DEG]["take"]
        where = "; ".join(map(take_in_words, same)) if len(same) else "no take"
        text += (
            f" Our run of the filter as released differs from it by {span(released['difference_deg'])} deg: the "
            f"settings of the released code are those of {where}, and not known elsewhere. Its median mixes settings."
        )
    return text


def of_factors(table: pd.DataFrame, trouble: str) -> str:
    """Factors of :func:`~edition1_companion.pages.bend_tests.errors.factors`; why there are no calibration readings."""
    nominal = table["fitted_to"] == "calibration readings"
    text = f"The factor of a single take is {span(table['factor'][~nominal], 2)}."
    if not bool(nominal.any()):
        return f"{text} There are no calibration readings: {trouble.rstrip('.')}."
    return (
        f"{text} That of the calibration readings is {table['factor'][nominal].item():.2f}: they were taken at "
        "nominal bends of a set-up that is not described."
    )
