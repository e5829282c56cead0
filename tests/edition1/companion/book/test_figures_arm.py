"""Figures of an arm: what is drawn is what the table holds, also at the edges."""

from io import BytesIO

import numpy as np
import pandas as pd
import pytest

from edition1_companion.pages.recorded_arm.figures import arm_shapes, neighbour_angles, tip_path

TIMES = np.linspace(0, 10, 12)
JUMPS = pd.DataFrame({"time_s": [2.0, 3.0], "imu": [1, 2], "step_deg": [30.0, 25.0], "axis_z": [-1.0, 0.1]})


def png(figure) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()


@pytest.fixture
def shapes() -> pd.DataFrame:
    rng = np.random.default_rng(0)
    xyz = np.cumsum(rng.normal(0, 50, (12, 9, 3)), axis=1).reshape(-1, 3)
    return pd.DataFrame(xyz, columns=["x_mm", "y_mm", "z_mm"]).assign(
        time_s=np.repeat(TIMES, 9), joint=np.tile(range(9), 12)
    )


@pytest.fixture
def angles() -> pd.DataFrame:
    return pd.DataFrame({"angle_0_1_deg": TIMES, "angle_1_2_deg": 2 * TIMES, "time_s": TIMES})


def test_one_shape_can_be_drawn(shapes):
    assert png(arm_shapes(shapes.head(9), "synthetic stream")).startswith(b"\x89PNG")


def test_tip_is_drawn_over_time_and_from_above(shapes):
    figure = tip_path(shapes, "recorded bag")
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), shapes["z_mm"])
    pieces = np.array(figure.axes[1].collections[0].get_segments())
    np.testing.assert_array_equal(pieces[:, 1, 0], shapes["x_mm"][1:])


def test_jumps_are_marked_in_the_panels_of_their_pairs(angles):
    panels = neighbour_angles(angles, JUMPS, "recorded bag").axes
    assert [[line.get_xdata()[0] for line in panel.lines[1:]] for panel in panels] == [[2.0], [3.0, 2.0]]


def test_same_table_same_bytes(angles):
    first, second = (png(neighbour_angles(angles, JUMPS, "recorded bag")) for _ in range(2))
    assert first == second
