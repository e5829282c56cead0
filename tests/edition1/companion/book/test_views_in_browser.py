"""Views of a page in a real browser: side by side where there is room, and named as they are given."""

import numpy as np
import pytest
from test_viewer import seen, show  # noqa: F401  # fixtures

from edition1_companion.pages.table_2.views import ShapeViews
from edition1_live.view.shape_view import Markers, Shape, ShapeView, Traces


@pytest.fixture(scope="module")
def views():
    """Two views of an arm that leans over, with IMUs."""
    lean = np.linspace(0.0, 0.05, 6)
    points = np.stack(
        [np.outer(lean, [0, 0.5, 1]), np.zeros((6, 3)), np.tile([0, 0.05, 0.1], (6, 1))], axis=-1
    )
    imus = Markers(points[:, 1:], np.tile([0.0, 0.0, 1.0], (6, 2, 1)), "IMUs")
    traces = (Traces("lean", "mm", {"x": 1e3 * lean - 0.012345}),)
    view = ShapeView("An arm.", np.arange(6.0), (Shape("arm", points),), 0.01, sensors=imus, traces=traces)
    return ShapeViews({"T0": view, "T1": view})


@pytest.mark.parametrize(("width", "columns"), [(900, 2), (390, 1), (240, 1)])
def test_side_by_side_where_there_is_room(views, show, width, columns):  # noqa: F811
    page = show(views.to_html(), width=width)
    boxes = [page.get_by_role("group", name=name).bounding_box() for name in ("T0", "T1")]
    assert len({box["x"] for box in boxes}) == columns
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator("canvas").count() == 2


def test_each_has_its_own_time(views, show):  # noqa: F811
    page = show(views.to_html(), width=900)
    first, second = (page.get_by_role("group", name=name).get_by_role("slider") for name in ("T0", "T1"))
    first.focus()
    page.keyboard.press("End")
    assert (first.input_value(), second.input_value()) == ("5", "0")


def test_sensors_are_called_what_they_are(views, show):  # noqa: F811
    page = show(views.to_html(), width=900)
    legend = page.locator(".shape-view-legend").first.inner_text()
    assert "IMUs" in legend
    assert "sensors" not in legend


def test_cursor_stands_below_its_end(views, show):  # noqa: F811
    """Numbers of many digits at the side leave the lines, and the times below them, where they are."""
    page = show(views.to_html(), width=900)
    drawing = page.locator(".shape-view-row svg").first.bounding_box()
    times = page.locator(".shape-view-ends").first.bounding_box()
    assert abs(drawing["x"] - times["x"]) < 3
