"""Pictures: a robot in space, estimates over time. matplotlib is imported when the first one is drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from repro.chain import ConstantCurvature, point_on
from repro.common import Array, ArrayLike, require
from repro.parts import Assembly
from repro.sensing import sensing_of

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_NORTH, _SOUTH = "#C1272D", "#3B5BA5"
_LEGENDS: tuple[dict[str, Any], ...] = (
    {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "fontsize": "small", "ncols": 3},
    {"loc": "upper left", "fontsize": "x-small"},
)
"""Above the axes, and within them."""
_BESIDE: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5), "fontsize": "x-small"}
_BAND = 1.96
"""Half of a band that holds 95 % of a normal distribution, in standard deviations."""


def plot_robot(
    robot: Assembly, q: ArrayLike | None = None, *, axes: Any = None, labels: Sequence[str] | None = None
) -> Any:
    """Draw a robot in one shape or in several on each other: see :meth:`repro.Robot.plot`.

    Parameters
    ----------
    robot
        Its segments are tubes of their radius (where they have one), joints dots, magnets bars with a red north pole,
        sensors arrows along their measuring directions, IMUs the three axes of their frames.
    q
        Configurations ``[n_q]`` or ``[k, n_q]``; its start, the middle of its bounds, or straight, if not given.
    axes
        matplotlib axes in three dimensions to draw on; new ones if not given.
    labels
        One name for each shape.

    Returns
    -------
    matplotlib.axes.Axes
        In mm, in the frame of the base.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("agg")
    >>> from repro import ConstantCurvature, Robot
    >>> robot = Robot([ConstantCurvature(0.11, 0.022)])
    >>> plot_robot(robot, [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]], labels=["straight", "bent"]).get_zlabel()
    'z [mm]'
    """
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    given = robot.usual_shape if q is None else robot.check_q(q, "plot")
    shapes = np.atleast_2d(given)
    require(shapes.ndim == 2, "q", "plot", "of shape (n_q) or (k, n_q)", f"shape {shapes.shape}")
    names = [None] * len(shapes) if labels is None else list(labels)
    require(
        len(names) == len(shapes), "labels", "plot", f"one for each of {len(shapes)} shapes", f"{len(names)}"
    )
    flat = axes is not None and not hasattr(axes, "get_zlim")
    require(not flat, "axes", "plot", 'matplotlib axes with projection="3d"', type(axes).__name__)
    with mpl.rc_context({"text.usetex": False}):
        ax = plt.figure(figsize=(6.4, 6.0)).add_subplot(projection="3d") if axes is None else axes
        for shape, name, tone in zip(shapes, names, _tones(_COLOURS, len(shapes)), strict=False):
            _draw(ax, robot, shape, tone, name)
        ax.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
        ax.set_aspect("equal")
        ax.locator_params(nbins=5)
        handles, words = ax.get_legend_handles_labels()
        named = dict(zip(words, handles, strict=True))  # each once
        for where in _LEGENDS:  # until one lies within the figure
            box = ax.legend(named.values(), named, frameon=False, **where).get_window_extent()
            if ax.figure.bbox.containsx(box.x0) and ax.figure.bbox.contains(box.x1, box.y1):
                break
    return ax


def _tones(usual: Sequence[Any], n: int) -> Sequence[Any]:
    """Return colours of which the first ``n`` differ."""
    import matplotlib as mpl

    return usual if n <= len(usual) else [*mpl.colormaps["turbo"](np.linspace(0.05, 0.95, n))]


def _draw(ax: Any, robot: Assembly, q: Array, colour: str, name: str | None) -> None:
    _draw_segments(ax, robot, q, colour, name)

    def poses(parts: Sequence[Any]) -> Any:
        found = robot.poses(q, [part.place for part in parts])
        return zip(parts, 1e3 * found[:, :3, 3], found[:, :3, :3], strict=True)

    for magnet, at, R in poses(robot.magnets):
        size = vars(magnet.shape)
        half = 500 * size.get("height", size.get("edge")) * R[:, 2]
        for end, pole in ((half, _NORTH), (-half, _SOUTH)):
            bar = np.stack([at, at + end], axis=1)
            ax.plot(*bar, color=pole, lw=7, solid_capstyle="butt", label="magnet, north red")
    arrow = 80 * max(robot.length, 0.05)
    for sensor, at, R in poses(robot.sensors):
        for axis in R.T if sensor.axes == 3 else [R[:, 2]]:
            ax.quiver(*at, *(arrow * axis), color="#111111", lw=1, label="sensor")
    for _, at, R in poses(robot.imus):
        for axis, tone in zip(R.T, _COLOURS[1:4], strict=True):
            ax.quiver(*at, *(arrow * axis), color=tone, lw=1.5, label="IMU")


def _draw_segments(ax: Any, robot: Assembly, q: Array, colour: str, name: str | None) -> None:
    around = np.linspace(0, 2 * math.pi, 25)
    for g, segment in enumerate(robot.segments, 1):
        share = np.linspace(0, 1, 25) if segment.length else np.ones(1)
        T = robot.poses(q, [point_on(g, v * segment.length) for v in share])
        line = 1e3 * T[:, :3, 3]
        ax.plot(*line.T, color=colour, lw=2, marker="" if segment.length else "o", label=name)
        radius = segment.radius if isinstance(segment, ConstantCurvature) else 0.0
        ring = radius * np.stack([np.cos(around), np.sin(around), 0 * around])
        if 0 < np.ptp(ring) < 2 * segment.length:
            tube = line[:, :, None] + 1e3 * T[:, :3, :3] @ ring
            ax.plot_surface(*np.moveaxis(tube, 1, 0), color=colour, alpha=0.12, linewidth=0, shade=False)
            for end in (tube[0], tube[-1]):
                ax.plot(*end, color=colour, lw=0.8, alpha=0.6)


def plot_shape(shape: Any, axes: Any = None) -> Any:
    """Draw estimates over time: see :meth:`.Trajectory.plot`.

    Parameters
    ----------
    shape
        A :class:`.Trajectory`: its coordinates with their 95 % band, one panel for each unit; then readings as
        dots with what is predicted as lines, and the residuals. What the monitor suspects is marked.
    axes
        As many matplotlib axes as there are panels; new ones if not given.

    Returns
    -------
    numpy.ndarray
        The axes.
    """
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    require(shape.q.ndim == 2, "shape", "plot", "of one robot", f"of shape {shape.q.shape}")
    fixed = getattr(shape.robot, "fixed", np.zeros(0, dtype=bool))
    fixed = fixed if len(fixed) == shape.q.shape[-1] else np.zeros(shape.q.shape[-1], dtype=bool)
    units = [(k, *unit) for k, unit in enumerate(shape.units()) if not fixed[k]]
    kinds = list(dict.fromkeys(unit for _, _, unit, _ in units))
    n_readings = 0 if shape.readings is None else 2
    usual = mpl.rcParams["axes.prop_cycle"].by_key().get("color", _COLOURS)
    with mpl.rc_context({"text.usetex": False}):
        rows = len(kinds) + n_readings
        if axes is None:
            axes = plt.subplots(
                rows, 1, sharex=True, figsize=(8, 2.3 * rows), squeeze=False, layout="constrained"
            )[1][:, 0]
        axes = np.atleast_1d(axes)
        require(
            len(axes) == rows, "axes", "plot", f"{rows} matplotlib axes, one for each panel", f"{len(axes)}"
        )
        for ax, kind in zip(axes, kinds, strict=False):
            ax.set_prop_cycle(color=_tones(usual, sum(unit == kind for _, _, unit, _ in units)))
            for k, name, unit, factor in units:
                if unit != kind:
                    continue
                middle = factor * shape.q[:, k]
                (line,) = ax.plot(shape.times, middle, label=name)
                if shape.covariance is not None:
                    half = _BAND * factor * np.sqrt(np.maximum(shape.covariance[:, k, k], 0.0))
                    half = np.where(
                        half < 1e3 * (np.nanmax(middle) - np.nanmin(middle) + 1e-9), half, np.nan
                    )  # an open coordinate
                    ax.fill_between(
                        shape.times, middle - half, middle + half, color=line.get_color(), alpha=0.25, lw=0
                    )
            ax.set_ylabel(f"coordinates [{kind}]" if kind else "coordinates")
            ax.legend(**_BESIDE)
        if n_readings:
            _readings(shape, usual, *axes[len(kinds) : len(kinds) + 2])
        axes[-1].set_xlabel("time [s]")
    return axes


def plot_chips(rows: Sequence[Any], axes: Any = None) -> Any:
    """Draw how well the tip is known over the number of chips: see :meth:`.Improvement.plot`.

    Parameters
    ----------
    rows
        Number of chips, and median deviations of the tip after a calibration and before [m].
    axes
        matplotlib axes to draw on; new ones if not given.

    Returns
    -------
    matplotlib.axes.Axes
        Deviations in mm, on a logarithmic axis.
    """
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    require(len(rows), "rows", "plot", "those of a design for which a better one was sought", "none")
    with mpl.rc_context({"text.usetex": False}):
        ax = plt.figure(figsize=(5.6, 3.6), layout="constrained").add_subplot() if axes is None else axes
        chips, after, before = np.array(rows, dtype=float).T
        ax.plot(chips, 1e3 * before, "o--", color=_COLOURS[1], label="before a calibration")
        ax.plot(chips, 1e3 * after, "o-", color=_COLOURS[0], label="after a calibration")
        ax.set(xlabel="chips", ylabel="± of the tip, median [mm]", yscale="log", xticks=chips)
        within_a_decade = max(before.max(), after.max()) < 10 * min(before.min(), after.min())
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter("{x:g}" if within_a_decade else "")
        ax.legend(frameon=False)
    return ax


def _readings(shape: Any, usual: Sequence[Any], above: Any, below: Any) -> None:
    s = shape.u_hat.shape[-1]
    above.set_prop_cycle(color=_tones(usual, s))
    robot = shape.robot if shape.robot is not None and shape.robot.n_readings == s else None
    names = [f"u{k}" for k in range(1, s + 1)] if robot is None else robot.names
    parts, part_names = (range(s), names) if robot is None else (robot.parts, robot.part_names)
    minus: Any = np.subtract if robot is None else sensing_of(robot).difference  # of orientations a rotation
    residuals, labelled = minus(shape.readings, shape.u_hat), set()
    for j, name in enumerate(names):
        (line,) = above.plot(shape.times, shape.u_hat[:, j], lw=1, label=name)
        for ax, dots in ((above, shape.readings[:, j]), (below, residuals[:, j])):
            ax.plot(shape.times, dots, ".", ms=3, color=line.get_color())
        rows = [] if shape.suspects is None else np.flatnonzero(shape.suspects[:, parts[j]])
        if len(rows):
            label = None if parts[j] in labelled else f"suspect: {part_names[parts[j]]}"
            labelled.add(parts[j])
            below.plot(shape.times[rows], residuals[rows, j], "x", color=_NORTH, label=label)
            below.legend(**_BESIDE)
    if s <= 24:
        above.legend(**_BESIDE)
    unit = "" if robot is None else " [mT, rad]" if robot.imus else " [mT]"
    above.set_ylabel(f"readings{unit}")
    below.set_ylabel(f"residuals{unit}")
