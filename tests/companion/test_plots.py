"""Figures of the pages draw the numbers that they are given, in the units of their axes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from repro import Ring
from repro_companion.plots import beyond, imus, one_magnet, rig, simulated_robots, style


def table(**columns):
    return pd.DataFrame(columns)


def shapes(panel):
    """Points of all that a panel shows: lines, then outlines of patches and collections, then dots."""
    yield from (line.get_xydata() for line in panel.get_lines())
    for patch in panel.patches:
        yield patch.get_patch_transform().transform(patch.get_path().vertices)
    for collection in panel.collections:
        yield from (path.vertices for path in collection.get_paths())
        yield np.asarray(collection.get_offsets())


def is_drawn(panel, points):
    """Whether a line has exactly these points, or an outline has them among its corners."""
    points = np.asarray(points, dtype=float)
    lines = len(panel.get_lines())
    for k, shape in enumerate(shapes(panel)):
        near = (np.abs(shape[:, None] - points) < 1e-9 * (1 + np.abs(points))).all(-1)
        if near.any(0).all() and (k >= lines or len(shape) == len(points)):
            return True
    return False


QUANTILES = {"q05_mm": 1.0, "q25_mm": 2.0, "median_mm": 5.0, "q75_mm": 7.0, "q95_mm": 9.0}
BOXES = table(figure="Fig. 4", marker=["M1", "M2"], n_imus=8, segments=64, **QUANTILES)
PRINTED = table(
    row=["M1 PCC-extended, 16 segments and more", "M2 PCC-extended, 16 segments and more"],
    quantity=["median", "q3"], unit=["%", "mm"], value=[2.0, 30.0],
)  # fmt: skip
LEANING = np.array([[0.03, 0.04, 0.1], [0.06, 0.08, 0.2]])
MINUTES = table(
    method="fused", minute=[1, 1, 1, 2, 2, 2], tip_rmse_percent=[1.0, 2.0, 6.0, 2.0, 3.0, 4.0],
)  # fmt: skip
LOOP = pd.concat([
    table(feedback=name, time_s=[0.0, 1.0], delta_x_mm=[k, 4.0], delta_y_mm=[4.0, 0.0],
          reference_x_mm=[k - 3.0, 4.0], reference_y_mm=[0.0, -2.0])
    for k, name in enumerate(("truth", "least squares", "filter", "informed"))
])  # fmt: skip
DESCENT = table(delta_x_mm=[0.0, 1.0, 2.0], delta_y_mm=[0.0, 2.0, 4.0], rmse_mV=[9.0, 3.0, 5.0])
LOSS = table(delta_x_mm=[0.0, 1.0, 0.0, 1.0], delta_y_mm=[0.0, 0.0, 2.0, 2.0], rmse_mV=1.0)
SERIES = np.array([[[1.0, 1.0, 3.0], [0.0, 0.0, 0.0]], [[2.0, 2.0, 2.0], [0.0, 0.0, 0.0]]])
CHIP = SimpleNamespace(
    times=np.array([0.0, 1.0]), suspects=np.zeros((2, 4), bool), readings=np.full((2, 4), 3.0),
    u_hat=np.full((2, 4), 2.5), robot=SimpleNamespace(part_names=list("abcd"), parts=np.arange(4)),
)  # fmt: skip
IMU_COUNTS = pd.concat([
    table(model=list("abcd"), sensor_deg=deg, n_imus=2, largest_mm=[1.0, 2.0, 3.0, 4.0], bound_mm=8.0,
          rms_mm=[5.0, 6.0, 7.0, 9.0], rule_mm=10.0)
    for deg in (0.0, 0.5)
])  # fmt: skip
NOISY = table(
    setting="random walk", process_noise_pi=[0.01, 0.01], rmse_mm=[1.0, 3.0], curve=["flower", "spiral"]
)
BULB = table(
    file="light_1", time_s=[0.0, 1.0], bend_deg=1.0, direction_deg=2.0, ratio=0.5, baseline=[0.1, 0.2]
)
TAKES = table(
    name=["a", "a", "b", "b"],
    take=["bend_1", "bend_2"] * 2,
    rmse_deg=[1.0, 2.0, 3.0, 4.0],
    rmse_tilt_z_deg=8.0,
    direction_deg=9.0,
)
FIGURES = {
    "shares of the length in print are drawn as lengths": (
        lambda: imus.marker_boxes(BOXES, {f"Fig. {k}": PRINTED for k in (3, 4, 5)}),
        1,
        [[[-0.2, 7.2]], [[0.2, 30.0]]],
    ),
    "gaps of a chain go from the end of each link to its place on the arm": (
        lambda: imus.links_of_models({"a": 2 * LEANING, "b": LEANING}, np.vstack([[0, 0, 0], LEANING]), 2),
        0,
        [[[100.0, 200.0], [50.0, 100.0]], [[0.0, 0.0], [100.0, 200.0], [200.0, 400.0]]],
    ),
    "a band of two deviations": (
        lambda: beyond.drift_learnt(
            table(error="e [mT]", minute=[1, 2], truth=0.0, estimate=[5.0, 6.0], std=1.0)
        ),
        0,
        [[[1, 3], [1, 7], [2, 4], [2, 8]]],
    ),
    "medians of all runs by minute, and bands of the least and the largest": (
        lambda: beyond.drift_errors(MINUTES, 1),
        0,
        [[[1, 2], [2, 3]], [[1, 1], [1, 6], [2, 2], [2, 4]], [[1.5, 0], [2.5, 1]]],
    ),
    "distances to the reference": (lambda: beyond.loop_over_time(LOOP), 0, [[[0, 5], [1, 2]]]),
    "intervals of mean errors": (
        lambda: beyond.segment_errors(
            table(
                trajectory=["arc"] * 2,
                method="2 IMUs",
                calibrated=[True, False],
                tip_mm=2.0,
                low_mm=1.5,
                high_mm=4.0,
            )
        ),
        0,
        [[[0, 1.5], [0, 4.0]], [[0.05, 1.5], [0.05, 4.0]]],
    ),
    "an arm from its base on": (
        lambda: beyond.real_arm_still(table(line="our smoother", x_mm=[3.0], y_mm=[4.0], z_mm=[9.0])),
        1,
        [[[0, 0], [4, 9]]],
    ),
    "a bar as long as it says": (
        lambda: beyond.robots_of_others(
            table(robot="a", look="shape", x_mm=[0.0, 0.0], z_mm=[0.0, 100.0], bar_mm=20)
        ),
        0,
        [[[-10, -12], [10, -12]]],
    ),
    "an ellipse of the median half-widths": (
        lambda: beyond.contacts(
            table(x_mm=[0.1, 0.1, 0.1], y_mm=0.0, half_x_mm=[1.0, 2.0, 9.0], half_y_mm=[3.0, 3.0, 3.0])
        ),
        0,
        [
            np.stack(
                [2 * np.cos(np.linspace(0, 2 * np.pi, 100)), 3 * np.sin(np.linspace(0, 2 * np.pi, 100))],
                axis=1,
            )
        ],
    ),
    "stated intervals of poses": (
        lambda: beyond.magnet_errors(
            table(**{f"{n}{axis}_mm": [2.0] for n in ("", "half_") for axis in "xyz"})
        ),
        2,
        [[[1, 0], [1, 4]]],
    ),
    "errors of the longest arm, and bounds where there are some": (
        lambda: beyond.sensors_and_noise(
            table(
                n_segments=[1, 3, 3],
                n_sensors=[2, 2, 3],
                noise_mt=0.005,
                mean_percent=[9.0, 4.0, 3.0],
                bound_percent=[1.0, np.inf, 2.0],
            )
        ),
        0,
        [[[2, 4], [3, 3]], [[3, 2]]],
    ),
    "perfect IMUs above, and the second model with errors below": (
        lambda: beyond.imus_and_errors(IMU_COUNTS),
        1,
        [[[2, 6]], [[2, 10]]],
    ),
    "residuals are readings less predictions": (
        lambda: beyond.failing_chip(CHIP, np.ones(2), 0.5),
        2,
        [[[0, 0.5], [1, 0.5]]],
    ),
    "a threshold above the baseline": (
        lambda: one_magnet.light_bulb(BULB, table(file=["light_1"], start_s=0.25, end_s=0.75), 0.3),
        2,
        [[[0, 0.4], [1, 0.5]], [[0.25, 0], [0.75, 1]]],
    ),
    "marks of methods stand about their take": (
        lambda: one_magnet.bend_errors(TAKES),
        0,
        [[[-0.1, 1], [0.9, 2]], [[0.1, 3], [1.1, 4]]],
    ),
    "with noise the mean of the curves": (
        lambda: one_magnet.bend_error_by_noise(NOISY[:0], pd.Series(dtype=float), NOISY, 1.0, [1.0, 2.0]),
        1,
        [[[0.01, 2.0]]],
    ),
    "the estimate is the best bend that the descent tries": (
        lambda: rig.landscapes({"a": (LOSS, [DESCENT], np.array([7.0, 8.0]))}),
        0,
        [[[1, 2]], [[0, 0]], [[7, 8]]],
    ),
    "forty readings in a second, and a deviation over the seeds": (
        lambda: rig.estimates_over_time({"T2": SERIES, "T5": SERIES}, (0.0, 1.0)),
        2,
        [[[0, 1], [0.025, 2]], [[0, 2], [0.025, 2]], [[0, 2 - 2**0.5], [0, 2 + 2**0.5], [0.025, 2]]],
    ),
    "paths of tips": (
        lambda: simulated_robots.tip_paths({"a": (LEANING, 2 * LEANING)}),
        0,
        [[[30, 40], [60, 80]], [[60, 80], [120, 160]]],
    ),
    "the middle of both curves of eq. (15)": (
        lambda: simulated_robots.equation_15(
            table(
                v=[0.0, 0.4, 0.9],
                x_mm=[0.0, 1.0, 4.0],
                z_mm=[0.0, 5.0, 9.0],
                x_printed_mm=[0.0, 2.0, 4.0],
                z_printed_mm=[0.0, 6.0, 9.0],
            )
        ),
        0,
        [[[1, 5]], [[2, 6]], [[4, 9]]],
    ),
}


@pytest.mark.parametrize("words", FIGURES)
def test_a_figure_draws(words):
    draw, panel, expected = FIGURES[words]
    figure = draw()
    assert [is_drawn(figure.axes[panel], points) for points in expected] == [True] * len(expected)


def test_halves_of_a_ring_are_as_large_as_it_is():
    """A ring of 4 mm inside, 10 mm outside and 6 mm height whose axis is that of x."""
    ring = Ring(inner_diameter=4e-3, outer_diameter=10e-3, height=6e-3, polarisation_mt=1.0)
    left, right = style.halves_of_rings(np.array([[1.0, 2.0]]), np.array([[1.0, 0.0]]), ring)
    for half, side in ((left, 1), (right, -1)):
        xy = half.get_xy()
        assert sorted({*xy[:, 0]}) == [-2, 4]
        assert sorted({*(side * (xy[:, 1] - 2))}) == [2, 5]


def test_the_named_choice_of_imus_has_the_least_error_at_the_second_marker():
    figure = imus.errors_at_markers(
        {(1, 2, 3): np.array([1.0, 9.0]), (2, 4, 6): np.array([3.0, 4.0])}, np.ones(2)
    )
    assert [text.get_text() for text in figure.axes[0].texts] == ["2, 4, 6"]
