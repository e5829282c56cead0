"""Views of the arm: chains and tubes against closed forms, and a trial against its own truth."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1_companion.book.project import find_project
from edition1_companion.book.views_arm import RADIUS_M, chain_view
from edition1_companion.pages.imu_markers.views import trial_view
from edition1_companion.twins.arm_trial import draw
from edition1_companion.twins.imu_errors import PERFECT, ImuErrors
from edition1_companion.twins.soft_arm import load_soft_arm

LINKS_M = np.full(8, 0.08)


@cache
def short_arm():
    """The first 40 s of the synthetic motion."""
    arm = load_soft_arm(find_project().data / "soft_arm.npz")
    kept = arm.time_s <= 40.0
    return replace(
        arm, time_s=arm.time_s[kept], positions=arm.positions[kept], orientations=arm.orientations[kept]
    )


@cache
def trial(errors=ImuErrors(), origin_m=0.005, heading_rad=0.03):  # noqa: B008
    """One draw of the short arm."""
    return draw(short_arm(), 0, errors=errors, origin_m=origin_m, heading_rad=heading_rad)


def view_of(one, errors=ImuErrors(), **options):  # noqa: B008
    return trial_view(short_arm(), one, errors, between_s=(5.0, 35.0), frames=40, **options)


class TestChain:
    def test_body_is_as_thick_as_the_simulated_rod(self):
        assert short_arm().parameters["rod"]["radius_m"] == RADIUS_M

    def test_links_turn_by_equal_angles(self):
        """Link k leans by k times 10 degrees: a polygon, its joints by sums of sines."""
        angles = np.radians(10.0) * np.arange(1, 9)
        q = np.broadcast_to(Rotation.from_rotvec(np.outer(angles, [0, 1, 0])).as_quat(), (3, 8, 4))
        view = chain_view(np.arange(3.0), q, LINKS_M, "synthetic stream")
        x, z = np.cumsum(0.08 * np.sin(angles)), np.cumsum(0.08 * np.cos(angles))
        (shape,) = view.shapes
        assert (shape.role, shape.deviation_m) == ("estimate", None)
        np.testing.assert_allclose(shape.points_m[0, 4::4], np.stack([x, 0 * x, z], axis=-1), atol=1e-12)
        assert view.sensors is not None
        np.testing.assert_allclose(view.sensors.points_m[1], shape.points_m[1, 4::4], atol=1e-12)
        np.testing.assert_allclose(view.sensors.directions[2, :, 0], np.sin(angles), atol=1e-12)
        middles = chain_view(np.arange(3.0), q, LINKS_M, "s", np.arange(0.04, 0.64, 0.08)).sensors
        assert middles is not None
        np.testing.assert_allclose(middles.points_m[1, 1, 0], (x[0] + x[1]) / 2, atol=1e-12)
        between, inclination, tip = view.traces
        np.testing.assert_allclose(between.values["6 to 7"], 10.0)
        np.testing.assert_allclose(inclination.values["IMU 7"], 80.0)
        np.testing.assert_allclose(tip.values["z"], 1e3 * z[-1])
        assert view.label == (
            "Arm as a chain of 8 straight links along its IMUs, from a synthetic stream. 3 frames from 0 to 2 s. "
            f"The tip is at z = {1e3 * z[-1]:.0f} to {1e3 * z[-1]:.0f} mm; neighbours are turned by 10 "
            "degrees at most."
        )

    def test_long_streams_are_thinned_and_cut(self):
        """Every seventh of the 1400 readings of 40 s."""
        q = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (2000, 8, 4))
        view = chain_view(5 + np.arange(2000) / 35, q, LINKS_M, "synthetic stream")
        np.testing.assert_allclose(view.time_s, 5 + np.arange(200) / 5)
        assert view.sensors is not None
        assert view.data()["sensors"]["name"] == "IMUs"


class TestTrial:
    def test_truth_and_markers_are_those_of_the_arm(self):
        """The markers, seen with noise, lie where the arm is; without errors so does the estimate."""
        one = trial(PERFECT, 0.0, 0.0)
        view = view_of(one, PERFECT)
        truth, estimate = view.shapes
        assert view.magnets is not None
        off = np.linalg.norm(view.magnets.points_m - truth.points_m[:, [9, 15]], axis=-1)
        assert np.median(off) < 2e-3
        assert off.max() < 5e-3  # the next point is 40 mm away
        assert np.linalg.norm(truth.points_m - estimate.points_m, axis=-1).max() < 0.015
        for name in ("M1", "M2"):
            seen, found = view.traces[0].values[name], view.traces[0].estimates[name]
            assert (np.abs(seen - found) <= view.traces[1].values[name] + 1e-9).all()

    def test_arrows_point_along_the_arm(self):
        view = view_of(trial(PERFECT, 0.0, 0.0), PERFECT)
        along = np.diff(view.shapes[0].points_m, axis=1)
        assert view.magnets is not None
        assert view.sensors is not None
        at_markers = (view.magnets.directions * along[:, [9, 15 - 1]]).sum(-1)
        at_imus = (view.sensors.directions[:, :7] * along[:, 2::2]).sum(-1)
        assert (at_markers > 0.8 * 0.04).all()
        assert (at_imus > 0.8 * 0.04).all()

    def test_frame_widens_the_tube(self):
        """Perfect IMUs: the origin's error everywhere, the heading's with the distance from the vertical."""
        one = trial()
        points = view_of(one, PERFECT).shapes[1].points_m
        origin = view_of(one, PERFECT, origin_m=0.004).shapes[1].deviation_m
        assert origin is not None
        np.testing.assert_allclose(origin, 0.004, rtol=1e-6)
        heading = view_of(one, PERFECT, heading_rad=0.03).shapes[1].deviation_m
        assert heading is not None
        expected = 0.03 * np.hypot(points[..., 0], points[..., 1])
        np.testing.assert_allclose(heading, expected, atol=1e-8)

    def test_tube_of_an_upright_arm(self):
        """Each IMU leads half of the links on its two sides: sigma L sqrt(7 + 1/4) at the tip."""
        one = trial()
        upright = np.zeros_like(one.trial.orientations)
        upright[..., 3] = 1.0
        one = replace(one, trial=replace(one.trial, orientations=upright))
        errors = replace(PERFECT, mounting_rad=0.02)
        deviation = view_of(one, errors).shapes[1].deviation_m
        assert deviation is not None
        np.testing.assert_allclose(deviation[:, -1], 0.02 * 0.08 * np.sqrt(7.25), rtol=1e-6)
        assert deviation[:, 0].max() == 0

    def test_label_counts_the_true_points_in_the_tube(self):
        one = trial()
        view = view_of(one, ImuErrors(), origin_m=0.005, heading_rad=0.03)
        truth, estimate = view.shapes
        assert estimate.deviation_m is not None
        error = np.linalg.norm(estimate.points_m - truth.points_m, axis=-1)
        held = (error < 2 * estimate.deviation_m).mean()
        assert f"{100 * held:.0f} % of the true points" in view.label
        assert view.label.startswith("Synthetic arm")
        assert ": oscillating." in view.label
        assert error[:, 0] == pytest.approx(np.linalg.norm(one.capture.origin_m))

    def test_times_outside_are_refused(self):
        one = trial()
        with pytest.raises(
            InputError, match="between_s of trial_view must be such that samples from"
        ) as caught:
            trial_view(short_arm(), one, ImuErrors(), between_s=(100.0, 120.0))
        assert str(caught.value).endswith("instead received (100.0, 120.0).")
