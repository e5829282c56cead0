"""The recording page: what is drawn is what the tables hold, and no line crosses a silence."""

import numpy as np
import pandas as pd

from edition1_companion.pages.recording.figures import COUNTED, flipped_digits, interruptions


def test_silences_interrupt_the_curves_and_are_shaded():
    time_s = np.array([0.0, 0.1, 0.2, 2.0, 2.1, 2.2])
    recorded = pd.DataFrame({"time_s": time_s, "device_s": time_s, "sequence": range(6), "u_1_mT": time_s**2})
    recorded.loc[1, "time_s"] = np.nan  # never sent so: nobody knows when
    counters = pd.DataFrame({"time_s": time_s} | dict.fromkeys(COUNTED, 0)).assign(gaps=[0, 0, 0, 17, 17, 17])
    readings, clock, counted = interruptions(recorded, counters).axes
    x, y = readings.lines[0].get_data()
    np.testing.assert_allclose(x, [0.0, 0.2, 1.1, 2.0, 2.1, 2.2])
    np.testing.assert_allclose(y, [0.0, 0.04, np.nan, 4.0, 4.41, 4.84])
    assert np.isnan(clock.lines[0].get_ydata()[2])
    for panel in (readings, clock, counted):
        (shade,) = panel.patches
        assert (shade.get_x(), shade.get_x() + shade.get_width()) == (0.2, 2.0)
    assert counted.lines[0].get_ydata().tolist() == [0, 0, 0, 17, 17, 17]


def test_wrong_readings_are_marked():
    series = pd.DataFrame(
        {
            "format": ["frames"] * 2 + ["millivolts"] * 3,
            "index": [0, 1, 0, 0, 1],
            "u_1_mV": [1.0, 2.0, 1.0, 9.0, 2.0],
            "wrong": [False, False, False, True, False],
        }
    )
    ours, lines = flipped_digits(series).axes
    assert lines.lines[0].get_ydata().tolist() == [1.0, 2.0]
    assert lines.lines[1].get_ydata().tolist() == [9.0]
    assert len(ours.lines[1].get_ydata()) == 0
