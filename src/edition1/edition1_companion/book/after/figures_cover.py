"""The picture of the README and of the landing page: one robot of each paper. All that it shows is synthetic.

``python -m edition1_companion.book.after.figures_cover FOLDER`` draws it from the tables that the notebooks
``sensor_failure``, ``probabilistic_curvature`` and ``recorded_arm`` wrote there, the last with its synthetic stream.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from edition1_live.view.style import MAGNET, SENSOR, page_figure
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from mpl_toolkits.mplot3d.axes3d import Axes3D
from PIL import Image

from edition1_companion.book.project import find_project

TRUTH, ESTIMATE = "black", "#D55E00"
COVER = "cover.png"
"""Name of the picture in the folder ``book/_static``."""
ARM_SHAPES = 5
POINTS_PER_IN = 110


@page_figure
def cover(shapes: pd.DataFrame, parts: pd.DataFrame, cloud: pd.DataFrame, arm: pd.DataFrame) -> Figure:
    """A segmented robot with magnets and sensors, particles in the bend space, and an arm with IMUs.

    Parameters
    ----------
    shapes, parts
        As for :func:`edition1_companion.pages.sensor_failure.figures.shape_stills`.
    cloud
        As for :func:`edition1_companion.pages.probabilistic_curvature.figures.bend_space`.
    arm
        As for :func:`edition1_companion.pages.recorded_arm.figures.arm_shapes`.
    """
    figure = plt.figure(figsize=(9.0, 4.2))
    left, right = (figure.add_subplot(1, 3, k, projection="3d") for k in (1, 3))
    middle = figure.add_subplot(1, 3, 2)
    _segments(left, shapes, parts)
    _particles(middle, cloud)
    _arm(right, arm)
    titles = (
        "Magnets and sensors\nBaaij et al. 2023",
        "One magnet, one sensor\nMitchell et al. 2021",
        "Orientations along an arm\nMartin et al. 2022",
    )
    for axes, title in zip((left, middle, right), titles, strict=True):
        axes.set_title(title, fontsize=10)
    return figure


def _segments(axes: Axes3D, shapes: pd.DataFrame, parts: pd.DataFrame) -> None:
    times = np.unique(shapes["time_s"])
    moment = times[len(times) // 3]  # before sensors fail
    for estimated, colour, look in ((False, "0.7", {"lw": 8}), (True, ESTIMATE, {"lw": 2, "ls": "--"})):
        here = shapes[(shapes["time_s"] == moment) & (shapes["estimated"] == estimated)]
        axes.plot(*_points(here), color=colour, **look, label="estimate" if estimated else "truth")
    there = parts[(parts["time_s"] == moment) & ~parts["estimated"]]
    for kind, colour, marker in (("magnet", MAGNET, "o"), ("sensor", SENSOR, "s")):
        axes.plot(*_points(there[there["part"] == kind]), marker, color=colour, ms=5, label=kind)
    reach = float(np.ptp(_points(here), axis=1).max()) / 3
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    _bare(axes, 1.05)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.05), ncols=2)


def _particles(axes: Axes, cloud: pd.DataFrame) -> None:
    degrees = np.rad2deg(cloud[["bend_x_rad", "bend_y_rad"]].to_numpy())
    truth = cloud["is_truth"].to_numpy(dtype=bool)
    axes.plot(*degrees[~truth].T, ".", ms=3, color=ESTIMATE, alpha=0.5, mew=0, label="particles")
    axes.plot(*degrees[truth].T, "o", ms=6, color=TRUTH, label="truth")
    for radius in (30, 60, 90):
        axes.add_patch(Circle((0, 0), radius, fill=False, lw=0.8, color="0.6"))
        axes.text(0, radius - 3, f"{radius}°", ha="center", va="top", fontsize=8, color="0.35")
    axes.set(aspect="equal", xlim=(-95, 95), ylim=(-95, 95))
    axes.axis("off")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=2, markerscale=1.5)


def _arm(axes: Axes3D, arm: pd.DataFrame) -> None:
    moments = np.unique(arm["time_s"])
    chosen = moments[np.linspace(0, len(moments) - 1, min(ARM_SHAPES, len(moments))).astype(int)]
    for k, moment in enumerate(chosen):
        shade = f"{0.75 * (1 - (k + 1) / len(chosen)):.2f}"
        xyz = _points(arm[arm["time_s"] == moment])
        axes.plot(*xyz, color=shade, lw=1.5)
        axes.plot(*xyz[:, 1:], "s", color=SENSOR, ms=4, mew=0, alpha=0.9)
    _bare(axes, 1.35)


def _points(table: pd.DataFrame) -> np.ndarray:
    return table[["x_mm", "y_mm", "z_mm"]].to_numpy(dtype=float).T


def _bare(axes: Axes3D, zoom: float) -> None:
    """Equal axes, not drawn: the picture shows what there is, not how large."""
    sides = [np.ptp(limits) for limits in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())]
    axes.set_box_aspect(sides, zoom=zoom)
    axes.view_init(elev=14, azim=-60)
    axes.axis("off")


def main(arguments: Sequence[str]) -> int:
    """Draw the picture from a folder of tables."""
    (folder,) = map(Path, arguments)
    names = ("sensor_failure_shapes", "sensor_failure_parts", "bend_cloud", "recorded_arm_shapes")
    figure = cover(*(pd.read_csv(folder / f"{name}.csv") for name in names))
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=POINTS_PER_IN, facecolor="white")
    # few colours, little weight: the landing page shows it
    Image.open(drawn).convert("RGB").quantize(64).save(find_project().book / "_static" / COVER, optimize=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
