"""The cover shows what the tables hold: shapes of one moment before a failure, particles, some of the arms."""

import numpy as np
import pandas as pd
from edition1_companion.book.after.figures_cover import ARM_SHAPES, cover


def test_the_cover_shows_truth_and_estimate_particles_and_arms():
    line = pd.DataFrame({"x_mm": [0.0, 1.0], "y_mm": 0.0, "z_mm": [0.0, 50.0]})
    shapes = pd.concat(
        [
            line.assign(segment=1, time_s=t, estimated=e, x_mm=line["x_mm"] * t)
            for t in (1.0, 2.0, 3.0, 4.0)
            for e in (False, True)
        ]
    )
    parts = pd.concat(
        [line.assign(part=p, time_s=2.0, estimated=False, working=True) for p in ("magnet", "sensor")]
    )
    cloud = pd.DataFrame({"bend_x_rad": [0.5, 0.6, 0.7], "bend_y_rad": 0.0, "is_truth": [False, False, True]})
    arm = pd.concat([line.assign(joint=[0, 1], time_s=float(t)) for t in range(9)])
    left, right, middle = cover(shapes, parts, cloud, arm).axes
    lines = {drawn.get_label(): drawn for drawn in left.lines}
    assert list(lines) == ["truth", "estimate", "magnet", "sensor"]
    assert lines["truth"].get_data_3d()[0].tolist() == [0.0, 2.0]  # the second of four moments
    np.testing.assert_allclose(middle.lines[0].get_xdata(), np.rad2deg([0.5, 0.6]))
    np.testing.assert_allclose(middle.lines[1].get_xdata(), np.rad2deg([0.7]))
    assert len(right.lines) == 2 * ARM_SHAPES
