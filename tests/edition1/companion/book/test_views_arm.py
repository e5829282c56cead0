"""Views of the arm: chains and tubes against closed forms, and a trial against its own truth."""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from edition1_companion.book.project import find_project
from edition1_companion.book.views_arm import RADIUS_M, chain_view
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
