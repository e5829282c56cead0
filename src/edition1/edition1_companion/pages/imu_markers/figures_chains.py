"""Chains of links that are laid out one after the other."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.lines import Line2D

from edition1_companion.book.frame_strip import Frame, FrameStrip, page_strip


@page_strip
def link_by_link(chains_m: Mapping[str, np.ndarray], truth_m: np.ndarray, links: int) -> FrameStrip:
    """Chains that are laid out link by link, side by side, in the vertical plane through the tip of the arm.

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
    seen: list[list[Artist]] = [[] for _ in range(links + 1)]
    figure, panels = plt.subplots(
        1, len(chains_m), figsize=(3.2 * len(chains_m), 4.4), sharex=True, sharey=True
    )
    off_mm = {}
    for panel, (name, chain), colour in zip(panels, chains_m.items(), ("#D55E00", "#0072B2"), strict=True):
        chain = np.vstack([base, chain])
        each = (len(chain) - 1) // links
        off_mm[name] = 1e3 * np.linalg.norm(chain[::each] - ends, axis=1)
        panel.plot(*side(truth_m).T, color="black", lw=2, label="arm")
        for k in range(1, links + 1):
            link = side(chain[(k - 1) * each : k * each + 1])
            (line,) = panel.plot(*link.T, color=colour, marker="o", ms=3.5, lw=2.2)
            for later in seen[k:]:
                later.append(line)
            gap = side(np.stack([chain[k * each], ends[k]]))
            (apart,) = panel.plot(*gap.T, color="0.45", ls=":", lw=1.6)
            told = panel.text(0.97, 0.95, f"{off_mm[name][k]:.0f} mm", transform=panel.transAxes, ha="right")
            seen[k] += [apart, told]
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

    def says(k: int) -> str:
        off = ", ".join(f"{name} {mm[k]:.0f} mm" for name, mm in off_mm.items())
        return f"Link {k} of {links}. The end is off by: {off}." if k else "The arm, and no link yet."

    frames = [Frame(says(k), artists) for k, artists in enumerate(seen)]
    return FrameStrip(figure, frames, f"An arm that bends over, and two chains beside it. {says(links)}")
