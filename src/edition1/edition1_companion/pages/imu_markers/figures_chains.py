"""Chains of links beside the arm that they follow."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from edition1_live.view.style import page_figure


@page_figure
def link_by_link(chains_m: Mapping[str, np.ndarray], truth_m: np.ndarray, links: int) -> Figure:
    """Chains with the gap at the end of each link, side by side, in the vertical plane through the tip of the arm.

    Parameters
    ----------
    chains_m
        Ends of the parts of each chain by its name, from the base at zero, ``[points, 3]`` [m]: as many parts for
        each link.
    truth_m
        Points of the arm in the same way [m].
    links
        How many.
    """
    away = truth_m[-1, :2] / np.linalg.norm(truth_m[-1, :2])

    def side(points_m: np.ndarray) -> np.ndarray:
        return 1e3 * np.column_stack([points_m[:, :2] @ away, points_m[:, 2]])

    base = np.zeros((1, 3))
    truth_m = np.vstack([base, truth_m])
    ends = truth_m[:: (len(truth_m) - 1) // links]
    figure, panels = plt.subplots(
        1, len(chains_m), figsize=(3.2 * len(chains_m), 4.4), sharex=True, sharey=True
    )
    for panel, (name, chain), colour in zip(panels, chains_m.items(), ("#D55E00", "#0072B2"), strict=True):
        chain = np.vstack([base, chain])
        each = (len(chain) - 1) // links
        panel.plot(*side(truth_m).T, color="black", lw=2, label="arm")
        for k in range(1, links + 1):
            link = side(chain[(k - 1) * each : k * each + 1])
            panel.plot(*link.T, color=colour, marker="o", ms=3.5, lw=2.2)
            gap = side(np.stack([chain[k * each], ends[k]]))
            panel.plot(*gap.T, color="0.45", ls=":", lw=1.6)
        off_mm = 1e3 * np.linalg.norm(chain[-1] - ends[-1])
        panel.text(0.97, 0.95, f"{off_mm:.0f} mm", transform=panel.transAxes, ha="right")
        panel.set(title=f"{name[0].upper()}{name[1:]}", xlabel="away from the base [mm]", aspect="equal")
    panels[0].set_ylabel("height [mm]")
    panels[0].margins(0.08)
    handles = [
        Line2D([], [], color="black", lw=2, label="arm"),
        Line2D(
            [], [], color="0.45", ls=":", lw=1.6, label="from the end of the chain to its place on the arm"
        ),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure
