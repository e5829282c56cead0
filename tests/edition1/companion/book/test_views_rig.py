"""Views of the rig: frames, tubes and words are those of the recordings, six of them on one page stay light."""

import json

import numpy as np
import torch

from edition1.estimation.base import Trajectory
from edition1_companion.pages.table_2.views import FRAMES, LONGEST_S, ShapeViews, rig_view, rig_views
from edition1_companion.recordings.baaij2023 import Recording
from edition1_companion.recordings.rig_robot import RIG_LENGTH_M, RIG_RADIUS_M, RIG_RATE_HZ

DEVIATION_M = 3e-4


def recorded(n, first=0):
    """A bend to one side and back, and readings that follow it."""
    phase = np.linspace(0, 4 * np.pi, n)
    q = np.stack([6e-3 * np.sin(phase), 0 * phase, 0 * phase], axis=-1)
    return Recording("toy", first + np.arange(n), q, 1000 + 10 * np.stack([np.sin(phase)] * 3, axis=-1))


def found(n):
    """Zero throughout, with one covariance."""
    covariance = np.diag([DEVIATION_M**2, DEVIATION_M**2, 0.0])
    zero = torch.zeros(n, 3).double()
    return Trajectory(zero, torch.from_numpy(np.tile(covariance, (n, 1, 1))), zero, {})


def test_tube_of_a_straight_segment():
    """The tip moves by half of the angle of bending times the length: closed form."""
    view = rig_view(recorded(40), found(40), "T0 (toy)")
    estimate = view.shapes[1]
    assert (estimate.name, estimate.role) == ("estimate", "estimate")
    assert estimate.deviation_m is not None
    np.testing.assert_allclose(
        estimate.deviation_m[:, -1], DEVIATION_M / RIG_RADIUS_M * RIG_LENGTH_M / 2, rtol=1e-9
    )
    assert (estimate.deviation_m[:, 0] == 0).all()
    assert view.shapes[0].deviation_m is None


def test_time_begins_at_zero_and_ends_in_time():
    """A test part does not begin with its recording; of a long one the beginning is shown."""
    part = recorded(4000, first=700)
    view = rig_view(part, found(4000), "T0 (toy)")
    assert view.time_s[0] == 0
    assert LONGEST_S - 0.3 < view.time_s[-1] < LONGEST_S
    assert len(view.time_s) <= FRAMES
    step = round(view.time_s[1] * RIG_RATE_HZ)
    u = view.traces[-1]
    assert (u.title, u.unit, list(u.values)) == ("readings", "mV", ["u_1", "u_2", "u_3"])
    np.testing.assert_array_equal(u.values["u_2"], part.u[: round(LONGEST_S * RIG_RATE_HZ) : step, 1])
    np.testing.assert_array_equal(
        view.traces[0].values["delta_x_1"], 1e3 * part.q[: round(LONGEST_S * RIG_RATE_HZ) : step, 0]
    )


def test_six_views_are_light_and_say_what_they_are():
    names = [f"T{k}" for k in range(6)]
    views = rig_views(
        {name: recorded(600) for name in names}, {name: found(600) for name in names}, "SYNTHETIC"
    )
    assert list(views.views) == [f"{name} (SYNTHETIC)" for name in names]
    text = views._repr_html_()
    assert len(text) < 6 * 60_000
    assert text.count('<div class="shape-view">') == 6
    assert text.count('<div class="shape-views">') == 1
    for title, view in views.views.items():
        assert f'<div role="group" aria-label="{title}"><p><strong>{title}</strong></p>' in text
        assert view.label.startswith(f"{title}: the segment by motion capture")
        assert json.dumps(view.data(), separators=(",", ":"), ensure_ascii=False) in text
    assert repr(views).splitlines()[5].startswith("T5 (SYNTHETIC): ShapeView of 75 frames, 0 to 14.8 s")


def test_titles_cannot_end_an_element():
    view = rig_view(recorded(4), found(4), "T0")
    assert "<b>" not in ShapeViews({'"<b>': view}).to_html()
