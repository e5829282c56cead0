"""The scorecard in one picture: every published number beside its regenerated one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter

from repro_companion.book.scorecard import ScorecardRow
from repro_companion.book.verdicts import Verdict, band
from repro_live.view.style import page_figure

LOWEST, HIGHEST = 0.1, 10.0
"""Ratios at which the picture ends; what lies beyond stands at its edge."""

_MARKS = {
    Verdict.REPRODUCED: {"marker": "o", "color": "#009E73"},
    Verdict.BETTER: {"marker": "v", "color": "#0072B2"},
    Verdict.DIFFERS: {"marker": "D", "color": "#D55E00"},
    Verdict.NOT_COMPARABLE: {"marker": "o", "color": "#555555", "markerfacecolor": "none"},
    Verdict.MISSING: {"marker": "x", "color": "#999999"},
}
_SHORT = {"baaij2023": "Baaij", "mitchell2021": "Mitchell", "martin2022": "Martin"}
_GAP = 2.5  # rows of room between two artefacts
_NARROW = 9  # an artefact of fewer rows has its label written upright


@page_figure
def scorecard_picture(rows: Sequence[ScorecardRow]) -> Figure:
    """Draw regenerated over published for every row, with the bands, on two lines of artefacts.

    Parameters
    ----------
    rows
        The scorecard; rows that are missing stand at the lower edge.
    """
    artefacts: dict[tuple[str, str], list[ScorecardRow]] = {}
    for row in rows:
        artefacts.setdefault((row.paper, row.artefact), []).append(row)
    lines = _two_lines(artefacts)
    figure, axes = plt.subplots(
        len(lines), 1, figsize=(10, 3.1 * len(lines)), squeeze=False, layout="constrained"
    )
    for ax, line in zip(axes[:, 0], lines, strict=True):
        _draw_line(ax, line)
    counts = Counter(row.verdict for row in rows)
    handles = [
        Line2D([], [], linestyle="none", markersize=5, label=f"{verdict.words} ({counts[verdict]})", **mark)
        for verdict, mark in _MARKS.items()
        if counts[verdict]
    ]
    handles.append(Line2D([], [], color="#bbbbbb", linewidth=3, label="band"))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
    return figure


def _two_lines(
    artefacts: dict[tuple[str, str], list[ScorecardRow]],
) -> list[dict[tuple[str, str], list[ScorecardRow]]]:
    """Return the artefacts in two groups of about as many rows, in their order; one group where there is one."""
    total, seen = sum(map(len, artefacts.values())), 0
    lines: list[dict[tuple[str, str], list[ScorecardRow]]] = [{}, {}]
    for place, members in artefacts.items():
        lines[seen + len(members) / 2 > total / 2][place] = members
        seen += len(members)
    return [line for line in lines if line]


def _draw_line(ax: Axes, artefacts: dict[tuple[str, str], list[ScorecardRow]]) -> None:
    start = 0.0
    ticks = []
    for (paper, artefact), members in artefacts.items():
        for k, row in enumerate(members):
            _draw_row(ax, start + k, row)
        middle = start + (len(members) - 1) / 2
        ticks.append((middle, f"{_SHORT.get(paper, paper)}, {artefact}", len(members)))
        start += len(members) + _GAP
        ax.axvline(start - (_GAP + 1) / 2, color="#dddddd", linewidth=0.8)
    ax.axhline(1, color="black", linewidth=0.8, zorder=0)
    ax.set_yscale("log")
    ax.set_ylim(LOWEST * 0.85, HIGHEST * 1.15)
    ax.set_xlim(-2, start - 1)
    ax.set_yticks([0.1, 0.2, 0.5, 1, 2, 5, 10])
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_xticks([middle for middle, _, _ in ticks], [label for _, label, _ in ticks])
    for label, (_, _, count) in zip(ax.get_xticklabels(), ticks, strict=True):
        label.set_rotation(90 if count < _NARROW else 0)
    ax.tick_params(axis="x", length=0)
    ax.grid(axis="x", visible=False)
    ax.set_ylabel("regenerated / published")


def _draw_row(ax: Axes, at: float, row: ScorecardRow) -> None:
    mark = _MARKS[row.verdict]
    if not row.regenerated or float(row.published) == 0:
        ax.plot(at, LOWEST, markersize=3, linestyle="none", **mark)
        return
    published = float(row.published)
    width = band(row.published, row.published_std, row.regenerated_std) / abs(published)
    if row.verdict is not Verdict.NOT_COMPARABLE:
        low, high = max(1 - width, LOWEST), min(1 + width, HIGHEST)
        ax.plot([at, at], [low, high], color="#bbbbbb", linewidth=2.2, solid_capstyle="butt", zorder=1)
    ratio = min(max(float(row.regenerated) / published, LOWEST), HIGHEST)
    ax.plot(at, ratio, markersize=3.5, linestyle="none", zorder=2, **mark)


def picture_alt(rows: Sequence[ScorecardRow]) -> str:
    """Return what the picture shows, in one line with its numbers."""
    counts = Counter(row.verdict for row in rows)
    named = ", ".join(f"{counts[verdict]} {verdict.words}" for verdict in Verdict)
    ratios = sorted(
        float(row.regenerated) / float(row.published)
        for row in rows
        if row.verdict not in (Verdict.MISSING, Verdict.NOT_COMPARABLE) and float(row.published)
    )
    text = f"Regenerated over published for {len(rows)} numbers of the papers: {named}."
    if not ratios:
        return text
    low, middle, high = ratios[0], ratios[len(ratios) // 2], ratios[-1]
    return (
        text
        + f" The {len(ratios)} ratios that are compared go from {low:.2g} to {high:.2g}, median {middle:.2f}."
    )
