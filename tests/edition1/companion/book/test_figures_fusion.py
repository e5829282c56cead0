"""Figure of the fused filter: what is drawn is what the table holds."""

import pandas as pd

from edition1_companion.pages.fusion.figures import errors_and_nees


def test_points_are_those_of_the_table():
    rows = [
        (setting, "affine curvature", method, 1.0 + k, 0.5, 2.0 + k, 0.4, 1.7)
        for setting in ("quiet", "loud")
        for k, method in enumerate(("magnets", "IMUs", "both", "both, inflated"))
        if not (setting == "loud" and k == 3)
    ]
    columns = [
        "setting",
        "trajectory",
        "method",
        "orientation_deg",
        "predicted_orientation_deg",
        "nees_direction",
    ]
    table = pd.DataFrame(rows, columns=[*columns, "low_direction", "high_direction"])
    quiet, below, _, _ = errors_and_nees(table).axes
    assert [line.get_ydata()[0] for line in quiet.lines] == [1.0, 0.5, 2.0, 0.5, 3.0, 0.5, 4.0, 0.5]
    assert [line.get_ydata()[0] for line in below.lines] == [2.0, 3.0, 4.0, 5.0]
