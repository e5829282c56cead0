"""Figures of Martin et al.: Table II, Figs 3 to 6."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from repro_companion.plots.style import (
    BESIDE,
    BLUE,
    LEVELS,
    ORANGE,
    PINK,
    WIDTH,
    marks,
    row_of_panels,
    style,
    with_legend,
    with_spread,
)
from repro_companion.show import rendered

MARKER_LOOKS = {"M1": (BLUE, 360.0), "M2": (PINK, 600.0)}
"""Colours of the paper, and distances along the arm [mm]."""


def table_ii(
    printed: pd.DataFrame, errors: pd.DataFrame, at_markers: pd.DataFrame, badge: str, words: str
) -> HTML:
    """Return Table II as printed: published relative errors [%], below them ours; words say what ours are.

    Where the errors of a model at the markers are known to differ, they stand below these.
    """
    known = printed.set_index(["row", "quantity"])["printed"]
    models = {"rigid-body": "rigid-body, 8 IMUs", "PCC-extended": "PCC-extended, 8 IMUs, 16 segments"}
    quantities = {"median": ("median", "median_mm"), "q3": ("Q3", "q75_mm")}
    rows = {}
    for (marker, (_, at)), (quantity, (name, column)) in product(MARKER_LOOKS.items(), quantities.items()):
        cells = []
        for model, case in models.items():
            found = []
            for table in (errors, at_markers):
                own = table[(table["case"] == case) & (table["marker"] == marker)]
                ours = own.groupby("draw")[column].mean() * 100 / at
                found += [with_spread(ours.mean(), ours.std(), 1)] * (len(own) > 0)
            cells.append((known[f"{marker} {model}", quantity], *dict.fromkeys(found)))
        rows[f"{marker} ({at:.0f} mm), {name}"] = cells
    heads = ["rigid-body, as in the files", "PCC-extended"]
    return HTML(rendered("table_ii.html", heads=heads, rows=rows, badge=badge, words=words))


@style(**LEVELS)
def marker_boxes(boxes: pd.DataFrame, printed: dict[str, pd.DataFrame]) -> Figure:
    """Draw Figs 3 to 5: boxes of the markers' errors [mm] with published medians and third quartiles."""
    groups = {
        "Fig. 3": ("n_imus", "IMUs", "rigid-body"),
        "Fig. 4": ("segments", "segments", "PCC, 8 IMUs"),
        "Fig. 5": ("n_imus", "IMUs", "PCC, 16 segments"),
    }
    figure, panels = row_of_panels(3, 3.6, "error [mm]", sharey=True, width_ratios=(3, 4, 3))
    for panel, (name, (column, label, model)) in zip(panels, groups.items(), strict=True):
        own = boxes[boxes["figure"] == name]
        steps = sorted(own[column].unique())
        for _, case in own.iterrows():
            shift = -0.2 if case["marker"] == "M1" else 0.2
            _box(panel, case, steps.index(case[column]) + shift, case[column], column, printed[name])
        panel.set(
            title=f"{name}:\n{model}", xlabel=label, ylim=(0, None),
            xticks=range(len(steps)), xticklabels=steps,
        )  # fmt: skip
    looks = {marker: {"color": colour, "lw": 6, "alpha": 0.4} for marker, (colour, _) in MARKER_LOOKS.items()}
    looks |= {"published median": PRINTED | {"marker": "D"}, "published Q3": PRINTED | {"marker": "^"}}
    return with_legend(figure, looks, columns=4)


PRINTED: dict[str, Any] = {"color": "#1A1A1A", "mec": "white", "ls": ""}
"""Look of what is printed, on boxes."""


def _box(panel: Axes, case: pd.Series, x: float, number: int, column: str, printed: pd.DataFrame) -> None:
    """Draw the box of one case, and what is printed of it."""
    colour, at = MARKER_LOOKS[case["marker"]]
    shares = {"whislo": "q05", "q1": "q25", "med": "median", "q3": "q75", "whishi": "q95"}
    panel.bxp([{key: case[f"{q}_mm"] for key, q in shares.items()}], positions=[x], widths=0.34,
              showfliers=False, patch_artist=True, manage_ticks=False,
              boxprops={"facecolor": colour, "alpha": 0.35, "edgecolor": colour},
              medianprops={"color": colour, "lw": 2}, whiskerprops={"color": colour},
              capprops={"color": colour})  # fmt: skip
    ending = {"n_imus": "IMUs", "segments": "segments( and more)?"}[column]
    printed_as = rf"{case['marker']} .*\b{min(number, 16)} {ending}"  # "16 segments and more"
    for row in printed[printed["row"].str.fullmatch(printed_as)].itertuples():
        value = row.value * (at / 100 if row.unit == "%" else 1)
        panel.plot(x, value, marker="D" if row.quantity == "median" else "^", ms=6, **PRINTED)


@style()
def error_hull(hull: pd.DataFrame) -> Figure:
    """Draw Fig. 6: the arm in one pose of each mode, leaning to one side, in a hull with the error as radius."""
    modes = hull.groupby("mode", sort=False)
    figure, grid = plt.subplots(2, 2, figsize=(WIDTH, 4.6), sharex=True, sharey=True)
    *panels, beside = grid.ravel()
    for panel, (mode, part) in zip(panels, modes, strict=True):
        arm, estimate = (part[[f"{of}{axis}_mm" for axis in "xyz"]].to_numpy() for of in ("", "estimate_"))
        line = from_the_side(arm, arm)
        joints, fine = np.arange(len(line)), np.linspace(0, len(line) - 1, 400)
        dense = [np.interp(fine, joints, y) for y in (*line.T, np.r_[0.0, part["radius_mm"]])]
        discs = [Circle((x, z), r) for x, z, r in zip(*dense, strict=True)]
        for look in ({"color": BLUE, "lw": 2.5}, {"color": "#A6D5F2", "lw": 0}):  # outline, hull
            panel.add_collection(PatchCollection(discs, **look))
        panel.plot(*line.T, color="#1A1A1A", lw=2)
        panel.plot(*from_the_side(estimate, arm).T, color=ORANGE)
        panel.set(title=mode, aspect="equal", xlabel="horizontal [mm]", ylabel="height [mm]")
        panel.tick_params(labelbottom=True, labelleft=True)
    looks = {"arm": {"color": "#1A1A1A"}, "estimate": {"color": ORANGE}}
    looks["within Q3 of the error"] = {"color": "#A6D5F2", "lw": 6}
    beside.set_axis_off()
    beside.legend(handles=marks(looks), loc="center", **BESIDE)
    return figure


def from_the_side(points: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Return the base and points ``[n, 3]`` as seen from the side to which an arm leans ``[1 + n, 2]``."""
    away = arm[-1, :2] / np.linalg.norm(arm[-1, :2])
    return np.vstack([[0, 0], np.stack([points[:, :2] @ away, points[:, 2]], axis=-1)])


@style()
def links_of_models(chains: dict[str, np.ndarray], arm: np.ndarray, links: int) -> Figure:
    """Draw joints of models ``[points, 3]`` [m] beside the arm, from the side, with the gap after each link."""
    figure, panels = row_of_panels(len(chains), 3.8, "height [mm]", sharex=True, sharey=True)
    side = 1e3 * from_the_side(arm, arm)[1:]
    for panel, (name, joints), colour in zip(panels, chains.items(), (ORANGE, BLUE), strict=True):
        line = 1e3 * from_the_side(joints, arm)
        panel.plot(*side.T, color="#1A1A1A", lw=2, label="arm")
        panel.plot(*line.T, "o-", color=colour, ms=3.5, lw=2)
        ends = [x[:: (len(x) - 1) // links] for x in (line, side)]
        panel.plot(*np.stack(ends, axis=1)[1:].T, color="0.45", ls=":")
        panel.plot([], [], color="0.45", ls=":", label="from the end of a link to its place on the arm")
        panel.set(title=name, xlabel="horizontal [mm]", aspect="equal")
    return with_legend(figure, panels[0], columns=2)


@style()
def errors_at_markers(choices: Mapping[Sequence[int], np.ndarray], marked: np.ndarray) -> Figure:
    """Draw median errors at both markers [mm] of choices of IMUs, and of one other."""
    figure, (panel,) = row_of_panels(1, 3.2, "error at M2 [mm]")
    panel.plot(*np.transpose([*choices.values()]), "o", ms=4, label="three IMUs")
    panel.plot(*marked, "s", color=ORANGE, ms=7, label="IMUs 2, 4, 6 and 8")
    best = min(choices, key=lambda imus: choices[imus][1])
    panel.annotate(", ".join(map(str, best)), choices[best], (6, -4), textcoords="offset points")
    panel.set(xlabel="error at M1 [mm]", xlim=(0, None), ylim=(0, None))
    return with_legend(figure)
