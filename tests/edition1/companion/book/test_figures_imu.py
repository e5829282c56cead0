"""Figures of the IMU pages: what is drawn is what the tables hold."""

import numpy as np
import pandas as pd
import pytest

from edition1_companion.pages.how_many_imus.figures import errors_and_bounds, placement_and_sensors
from edition1_companion.pages.imu_markers.figures import (
    _tube,
    calibration_ratios,
    error_boxes,
    error_hull,
    errors_along_arm,
)
from edition1_companion.pages.imu_markers.figures_chains import link_by_link
from edition1_companion.pages.recorded_trial.figures import (
    CHAINS,
    differences_of_files,
    fewer_imus,
    settings_of_figure_5,
)

MODELS = ("rigid-body, 8 IMUs", "IMUs at mid-section", "PCC-extended, 8 IMUs, 16 segments")


@pytest.fixture
def boxes():
    lines = [
        {
            "figure": figure,
            "case": f"{n}",
            "n_imus": n,
            "segments": 2 * n,
            "evaluation": way,
            "marker": marker,
        }
        | {"q05_mm": 1.0, "q25_mm": 2.0, "median_mm": 3.0 + n, "q75_mm": 13.0, "q95_mm": 20.0}
        for way in ("as described", "as in the files")
        for figure in ("Fig. 3", "Fig. 4")
        for n in (4, 8)
        for marker in ("M1", "M2")
    ]
    return pd.DataFrame(lines)


def test_boxes_and_printed_values(boxes):
    published = pd.DataFrame({
        "artefact": ["Fig. 3", "Fig. 3", "Fig. 4"],
        "row": ["M1 rigid-body 4 IMUs", "M2 rigid-body 8 IMUs", "M1 PCC-extended 8 segments"],
        "quantity": ["median", "q3", "q3"],
        "unit": ["mm", "mm", "%"],
        "paper": [55.0, 99.0, 10.0],
    })  # fmt: skip
    panels = np.array(error_boxes(boxes, published).axes).reshape(2, 2)

    def marks(panel, shape):
        return [
            (line.get_xdata()[0], line.get_ydata()[0]) for line in panel.lines if line.get_marker() == shape
        ]

    for left, right in panels:
        assert marks(left, "D") == [(-0.2, 55.0)]
        assert marks(left, "^") == [(1.2, 99.0)]
        assert marks(right, "^") == [(-0.2, 36.0)]  # 10 % of 360 mm; 8 segments are the first of these cases
        medians = [
            line.get_ydata()[0]
            for line in left.lines
            if line.get_color() == "black" and len(line.get_xdata()) == 2
        ]
        assert sorted(medians) == [7.0, 7.0, 11.0, 11.0]


def test_along_the_arm_and_by_mode():
    lines = [
        (model, mode, arc, arc / 10, arc / 8)
        for model in MODELS
        for mode in ("all", "oscillating", "circling")
        for arc in (200.0, 360.0, 600.0)
    ]
    along = pd.DataFrame(lines, columns=["model", "mode", "arc_mm", "median_mm", "q75_mm"])
    left, right = errors_along_arm(along).axes
    np.testing.assert_array_equal(left.lines[0].get_ydata(), [20, 36, 60])
    dots = sorted(line.get_ydata()[0] for line in right.lines if line.get_marker() == "o")
    assert dots == [36.0] * 6 + [60.0] * 6


def test_hull_has_the_radius_of_the_table():
    arcs = np.arange(1, 6) * 100.0
    hull = pd.DataFrame({
        "mode": "buckling", "time_s": 1.0, "arc_mm": arcs, "radius_mm": arcs / 10,
        "x_mm": 0.0, "y_mm": 0.0, "z_mm": arcs,
        "estimate_x_mm": 0.0, "estimate_y_mm": 0.0, "estimate_z_mm": arcs,
    })  # fmt: skip
    panel = error_hull(hull).axes[0]
    # A straight arm: the tube, widest at its end, sets the limits sideways, the arm those along z.
    np.testing.assert_array_equal(panel.lines[0].get_data_3d()[2], [0, *arcs])
    tube = _tube(np.column_stack([np.zeros((6, 2)), np.append(0, arcs)]), np.append(0, arcs / 10))
    np.testing.assert_allclose(np.hypot(tube[0], tube[1]), np.tile(np.append(0, arcs / 10), (25, 1)).T)
    np.testing.assert_allclose(tube[2], np.tile(np.append(0, arcs), (25, 1)).T, atol=1e-12)


def test_ratios_with_their_targets():
    lines = [
        (method, mode, point, 0.4, 0.3, 0.6, target)
        for method, target in (("PCC-16", np.nan), ("PCC-16 + frame", 0.8), ("spline + all", 0.6))
        for mode in ("all", "circling")
        for point in ("markers", "200 mm")
    ]
    columns = ["method", "mode", "point", "ratio", "ratio_low", "ratio_high", "target"]
    left, _ = calibration_ratios(pd.DataFrame(lines, columns=columns)).axes
    heights = sorted(line.get_ydata()[0] for line in left.lines if line.get_linestyle() == "--")
    assert heights == [0.6, 0.8]


def test_differences_of_files_name_their_source():
    files = pd.DataFrame(
        {"file": ["a/one.csv", "b/two.csv"], "median_um": [0.01, 0.02], "largest_um": [0.1, 3.0]}
    )
    (panel,) = differences_of_files(files, "recorded").axes
    assert panel.get_title() == "Released tables, recorded"
    assert differences_of_files(files, "synthetic").axes[0].get_title() == "Tables of the trial, synthetic"
    assert [label.get_text() for label in panel.get_yticklabels()] == ["one.csv", "two.csv"]
    np.testing.assert_array_equal(panel.lines[0].get_xdata(), [0.01, 0.02])
    np.testing.assert_array_equal(panel.lines[1].get_xdata(), [0.1, 3.0])


def test_settings_of_figure_5_beside_the_printed_errors():
    lines = [
        (n, chain, marker, 10.0 * n, 12.0 * n, 100.0 / n, 120.0 / n)
        for n in (2, 4)
        for chain in CHAINS
        for marker in ("M1", "M2")
    ]
    columns = ["n_imus", "chain", "marker", "median_mm", "q75_mm", "printed_median_mm", "printed_q75_mm"]
    _, second = settings_of_figure_5(pd.DataFrame(lines, columns=columns), "synthetic").axes
    drawn = [line.get_ydata() for line in second.lines]
    np.testing.assert_array_equal(drawn[0], [20, 40])
    np.testing.assert_array_equal(drawn[-1], [50, 25])


def test_fewer_imus_has_a_panel_per_point():
    lines = [("spline", n, point, 10.0 * n, 20.0 * n) for n in (2, 8) for point in (360.0, 640.0)]
    table = pd.DataFrame(lines, columns=["model", "n_imus", "point_mm", "median_mm", "q75_mm"])
    first, _ = fewer_imus(table, "synthetic").axes
    drawn = [y for line in first.lines if len(y := line.get_ydata())]
    np.testing.assert_array_equal(drawn[0], [20, 80])


def test_count_figures_draw_errors_and_bounds():
    lines = [
        (model, n, 1.0, angle, 50.0 / n, 100.0 / n, 400.0 / n)
        for model in ("PCC-extended", "spline")
        for n in (4, 8)
        for angle in (0.0, 3.0)
    ]
    table = pd.DataFrame(
        lines, columns=["model", "n_imus", "crowding", "sensor_deg", "median_mm", "largest_mm", "bound_mm"]
    )
    exact = table[table["sensor_deg"] == 0]
    panel = errors_and_bounds([exact], ["random"]).axes[0]
    np.testing.assert_array_equal(panel.lines[0].get_ydata(), [25, 12.5])
    np.testing.assert_array_equal(panel.lines[1].get_ydata(), [100, 50])
    right = placement_and_sensors(exact, table, 640.0).axes[1]
    rule = [line.get_ydata() for line in right.lines if line.get_color() == "0.6"]
    np.testing.assert_allclose(rule[0], 640 * np.deg2rad(3) * np.sqrt(2 / np.array([4, 8])))


def test_a_chain_is_drawn_link_by_link():
    """Each panel has the links of a chain, and says how far its end is from its place on the arm."""
    arm = np.outer(np.arange(1, 5), [0.03, 0.04, 0.0]) + np.array([0.0, 0.0, 0.2])
    chains = {"rigid links": arm[1::2] + np.array([0.0, 0.0, 0.01]), "interpolated links": arm}
    panels = link_by_link(chains, arm, links=2).axes
    assert [panel.texts[0].get_text() for panel in panels] == ["10 mm", "0 mm"]
    rigid, interpolated = (panel.lines[3].get_xydata() for panel in panels)
    np.testing.assert_allclose(rigid, [[100.0, 210.0], [200.0, 210.0]])  # along the arm, and height
    np.testing.assert_allclose(interpolated, [[100.0, 200.0], [150.0, 200.0], [200.0, 200.0]])
