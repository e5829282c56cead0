"""Layouts of sensors and magnets: there and back, limits and distances, random ones."""

import math

import pytest
import torch

from edition1.errors import InputError
from edition1.kinematics.paper_robots import Dimensions, affine_robot, pcc_robot
from edition1_companion.pages.sensor_placement.layouts import Room, layout_of

ROBOTS = {
    "one segment": pcc_robot(1),
    "three tilted segments": pcc_robot(3, 2, tilt=0.3, radial=0.016, azimuth_offset=0.7),
    "inverted sensors": pcc_robot(1, 4, tilt=2.5),
    "affine": affine_robot(magnet_shift_m=0.0),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_layout_gives_the_robot_back(name):
    robot = ROBOTS[name]
    again = layout_of(robot).robot()
    for old, new in ((robot.sensors, again.sensors), (robot.magnets, again.magnets)):
        assert new.segment == old.segment
        torch.testing.assert_close(new.axial, old.axial, rtol=0, atol=1e-13)
        torch.testing.assert_close(new.local, old.local)


@pytest.mark.parametrize("name", ROBOTS)
def test_table_lists_the_parts(name):
    layout = layout_of(ROBOTS[name])
    table = layout.table()
    assert table["azimuth_deg"].between(0, 360, inclusive="left").all()
    axial, radial, azimuth, tilt, _ = layout.parts()
    sensors = table[table["part"] == "sensor"]
    for column, value in (
        ("axial_mm", 1e3 * axial),
        ("radial_mm", 1e3 * radial),
        ("tilt_deg", tilt.rad2deg()),
    ):
        assert sensors[column].tolist() == pytest.approx(value.tolist())
    assert sensors["azimuth_deg"].tolist() == pytest.approx((azimuth.rad2deg() % 360).tolist())


def test_heights_count_from_the_base_of_the_robot():
    sensors, magnets = layout_of(pcc_robot(3, 1)).heights()
    torch.testing.assert_close(
        sensors, Dimensions.LENGTH_M * torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
    )
    torch.testing.assert_close(
        magnets, Dimensions.LENGTH_M * torch.tensor([0.5, 1.5, 2.5], dtype=torch.float64)
    )


def test_kinds_select_blocks():
    layout = layout_of(pcc_robot(1, 2))
    assert layout.of_kind(("tilt", "magnet")).tolist() == [False] * 6 + [True] * 3


def test_nominal_layouts_have_room():
    for n in (1, 3):
        assert Room().holds(layout_of(pcc_robot(n)))
    assert Room().holds(layout_of(affine_robot(magnet_shift_m=0.0)))


def test_clearances_of_a_layout_by_hand():
    """Two sensors opposite each other at 13 mm, 55 mm above their magnet: distances by Pythagoras."""
    clearances = Room().clearances(layout_of(pcc_robot(1, 2)))
    expected = torch.tensor([math.hypot(0.055, 0.013) - 0.030] * 2 + [0.026 - 0.008], dtype=torch.float64)
    torch.testing.assert_close(clearances, expected)


@pytest.mark.parametrize(
    ("kind", "value"),
    [("axial", 0.111), ("radial", 0.005), ("tilt", 1.6), ("magnet", 0.001), ("axial", 0.06)],
)
def test_what_leaves_the_room_is_seen(kind, value):
    layout = layout_of(pcc_robot(1))
    values = layout.values.clone()
    values[torch.from_numpy(layout.of_kind((kind,)))] = value
    assert not Room().holds(layout.moved(values))


def test_magnets_keep_their_distance():
    layout = layout_of(pcc_robot(2))
    values = layout.values.clone()
    values[-2:] = torch.tensor([0.100, 0.010], dtype=torch.float64)  # 20 mm apart across the joint
    assert not Room(magnet_to_sensor_m=0.02).holds(layout.moved(values))
    assert float(Room().clearances(layout.moved(values))[12]) == pytest.approx(0.020 - 0.080)


@pytest.mark.parametrize("name", ["one segment", "three tilted segments", "affine"])
def test_random_layouts_keep_everything_and_repeat(name):
    layout, room = layout_of(ROBOTS[name]), Room()
    generators = [torch.Generator().manual_seed(3) for _ in range(2)]
    for _ in range(5):
        one, two = (room.random(layout, g) for g in generators)
        assert room.holds(one)
        assert torch.equal(one.values, two.values)
        assert not torch.equal(one.values, layout.values)


def test_every_mount_has_a_derivative_of_its_own():
    """Sensors in one plane move apart: each height changes the pose of its own sensor only."""
    layout = layout_of(pcc_robot(1))
    q = torch.tensor([0.01, 0.005, 0.001], dtype=torch.float64)
    J = torch.func.jacrev(lambda values: layout.moved(values).robot().sensor_poses(q)[:, :3, 3])(
        layout.values
    )
    assert (J[:, :, :3].norm(dim=1) > 0.5).tolist() == torch.eye(3, dtype=torch.bool).tolist()
    assert float(J[:, :, :3].norm(dim=1).fill_diagonal_(0).max()) == 0


def test_no_room_for_all_parts():
    with pytest.raises(InputError, match=r"one with room for all parts; instead received no room for part 2"):
        Room(magnet_to_magnet_m=0.5).random(layout_of(pcc_robot(2)), torch.Generator().manual_seed(0))
