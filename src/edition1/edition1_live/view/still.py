"""The picture of a shape view, for readers without its script or without WebGL."""

from __future__ import annotations

import io

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from edition1_live.view.shape_view import ROLES, ShapeView
from edition1_live.view.style import MAGNET, SENSOR, page_figure

_POSES = 5


@page_figure
def still_picture(view: ShapeView) -> Figure:
    """Draw up to five of the shapes, the later the darker, with magnets and sensors of the last."""
    figure = plt.figure(figsize=(6.4, 4.6))
    axes = figure.add_subplot(projection="3d")
    chosen = np.unique(np.linspace(0, len(view.time_s) - 1, _POSES).round().astype(int))
    for shape in view.shapes:
        style = {"color": ROLES[shape.role], "linestyle": "-" if shape.role == "truth" else "--"}
        for depth, k in enumerate(chosen, start=1):
            last = k == chosen[-1]
            alpha = 0.25 + 0.75 * depth / len(chosen)
            label = shape.name if last else None
            axes.plot(*(1e3 * shape.points_m[k].T), linewidth=2.2, alpha=alpha, label=label, **style)
    for name, markers, colour, mark in (
        ("magnets", view.magnets, MAGNET, "o"),
        ("sensors", view.sensors, SENSOR, "^"),
    ):
        if markers is not None and markers.points_m.size:
            points = 1e3 * markers.points_m[chosen[-1]]
            label = markers.name or name
            axes.plot(*points.T, linestyle="none", marker=mark, color=colour, markersize=5, label=label)
    axes.plot(0, 0, 0, color="black", marker="s", markersize=6, linestyle="none", label="base")
    low, high = (1e3 * corner for corner in view._box_m())
    reach = max(np.abs(np.concatenate([low[:2], high[:2]])))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(min(low[2], 0.0), high[2]))
    axes.set_aspect("equal")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.locator_params(nbins=5)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.pane.fill = False  # its pale greys would become other colours where the picture is made small
    axes.view_init(elev=18, azim=-60)
    times = " to ".join(dict.fromkeys(f"{t:.4g}" for t in view.time_s[[0, -1]])) + " s"
    axes.set_title(f"Shape at {times}" + (", the later the darker" if len(chosen) > 1 else ""))
    figure.legend(loc="outside lower center", ncols=5)
    return figure


def small_png(figure: Figure) -> bytes:
    """Draw a figure small, with 64 colours: a third of the size."""
    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=80, facecolor="white")
    # this method keeps rare colours, such as those of the few sensors
    colours = Image.open(drawn).convert("RGB").quantize(64, method=Image.Quantize.MAXCOVERAGE)
    colours.save(small, format="png", optimize=True)
    return small.getvalue()
