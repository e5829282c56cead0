"""A better design: laws of the search, and the file that it writes."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from repro import ConstantCurvature, Disc, InputError, Link, Magnet, Ring, Robot, Sensor, load_robot
from repro.check import check_design, median_tip
from repro.improve import _moved, improve_design, median_of
from repro.robot_file import write_improved

FEW = {"samples": 60, "tries": 60}
TEXT = """
# an arm that cannot work
[stream]
noise_mt = 0.02

[[segments]]
kind = "constant_curvature"
length_mm = 110.0
radius_mm = 15.0
delta_x_mm = [-12.0, 12.0]
delta_y_mm = [-12.0, 12.0]
delta_L_mm = 0.0

[[magnets]]
kind = "disc"
segment = 1
at_mm = 110.0 # at the tip
diameter_mm = 6.0
height_mm = 2.0
polarisation_mt = 1300.0
free = { at_mm = [60, 110], diameter_mm = [4, 8] }

[[sensors]]
name = "B1"
axes = 3
channels = ["Bx", "By", "Bz"]
segment = 1
at_mm = 10.0
radial_mm = 12.0
free = { at_mm = [0, 80], azimuth_deg = [-90, 90] }
"""


def arm(magnet_at=0.06, chip_at=0.0, noise=0.005, *, chips=1, free=None, chip_free=None):
    """An arm of 60 mm with a magnet at its tip and chips at its base, too far away to be of use."""
    return Robot(
        [ConstantCurvature(0.06, 0.01)],
        [Magnet(Disc(3e-3, 2e-3, 1300.0), 1, magnet_at, free=free)],
        [Sensor(1, chip_at, radial=0.01, azimuth=2.0 * k, axes=3, free=chip_free) for k in range(chips)],
        lower=[-0.01, -0.01, 0.0], upper=[0.01, 0.01, 0.003], noise=noise,
    )  # fmt: skip


def written(tmp_path, text=TEXT):
    (tmp_path / "robot.toml").write_text(text, encoding="utf-8")
    return load_robot(tmp_path / "robot.toml")


@pytest.mark.parametrize("seed", range(2))
def test_a_better_design_never_gets_a_worse_verdict(seed):
    rng = np.random.default_rng(seed)
    robot = arm(*rng.uniform(0, 0.06, 2), chips=2, noise=10 ** rng.uniform(-2.5, -0.5))
    for as_built in (False, True):
        before = check_design(robot, samples=60)
        found = improve_design(robot, target=0.5 * median_of(before, as_built), as_built=as_built, **FEW)
        assert all(new >= old for old, new in zip(before.grades, found.grades, strict=True))
        better = median_of(found, as_built) < median_of(before, as_built)
        assert better == bool(found.changes) == (found.robot is not robot)


def test_it_finds_a_design_that_works_and_says_the_way_there():
    robot = arm()
    found = improve_design(robot, **FEW)
    assert not found.before.can_work
    assert found.can_work
    again = check_design(found.robot, samples=60)
    np.testing.assert_array_equal(again.tip, found.tip)
    lines = repr(found).splitlines()
    assert lines[0].startswith(
        "Nothing is marked as free: chips and magnets may move along their whole segments"
    )
    assert lines[1] == "It works with as many chips."
    assert lines[2].startswith(("sensor 1 ", "magnet 1 "))
    assert f"±{1e3 * median_of(found.before, False):.2g} mm →" in lines[2]
    assert lines[3].endswith(f"→ ±{1e3 * median_of(found, False):.2g} mm") or len(found.changes) > 2
    assert lines[-1] == found.verdict


def test_the_one_free_number_goes_to_its_best_place():
    robot = arm(free={"at": (0.02, 0.06)})
    found = improve_design(robot, **FEW)
    at = np.arange(200, 601) / 10 * 1e-3
    every = [median_tip(robot.replaced(magnets=[replace(robot.magnets[0], at=x)]), samples=60) for x in at]
    assert median_of(found, False) < 1.02 * min(every)
    best = 1e3 * found.robot.magnets[0].at
    assert found.changes[0].startswith(f"magnet 1 {60 - best:.2g} mm towards the base, to {best:.4g} mm: ±")


@pytest.mark.parametrize(("start", "length"), [(None, 61.5), ([0.0, 0.0, 0.0], 60.0)])
def test_a_chip_says_by_how_much_it_comes_nearer_to_its_magnet(start, length):
    """At rest the arm is straight, by its bounds 1.5 mm longer, and the chip 10 mm beside the axis of the magnet."""
    found = improve_design(arm(chip_free={"at": (0.0, 0.06)}).replaced(start=start), **FEW)
    at = 1e3 * found.robot.sensors[0].at
    nearer = math.hypot(length, 10.0) - math.hypot(length * (1 - at / 60), 10.0)
    assert found.changes[0].startswith(f"sensor 1 {nearer:.2g} mm nearer to magnet 1, to {at:.4g} mm: ±")


def test_a_design_that_is_the_best_stays():
    best = improve_design(arm(free={"at": (0.02, 0.06)}), **FEW).robot
    again = improve_design(best, target=1e-6, **FEW)
    assert again.robot is best
    assert again.changes == ()
    assert "No better layout was found." in again.remarks
    np.testing.assert_array_equal(again.tip, check_design(best, samples=60).tip)


def test_a_design_that_works_needs_no_better_one():
    robot = arm(magnet_at=0.02, chip_at=0.035, noise=0.0002)
    found = improve_design(robot, **FEW)
    assert found.robot is robot
    assert found.remarks == ("This design needs no better one. State a smaller target to look for one.",)
    with pytest.raises(
        InputError, match="rows of plot must be those of a design for which a better one was sought"
    ):
        found.plot()


def test_ranges_hold_and_all_else_stays():
    free = {"at": (0.0405, 0.06), "diameter": (2e-3, 3.55e-3)}
    chips = {"at": (0.0, 0.0333), "azimuth": (-1.0, 1.0)}
    robot = arm(free=free, chip_free=chips)
    fixed = Sensor(1, 0.03, radial=0.01, axes=3)
    found = improve_design(robot.replaced(sensors=[*robot.sensors, fixed]), target=1e-6, **FEW)
    magnet, chip = found.robot.magnets[0], found.robot.sensors[0]
    assert found.remarks[0] == "Free is what the design marks as such."
    assert 0.0405 - 1e-12 <= magnet.at <= 0.06 + 1e-12
    assert 2e-3 - 1e-12 <= magnet.shape.diameter <= 3.55e-3 + 1e-12
    assert magnet.shape.height == 2e-3
    assert 0.0 <= chip.at <= 0.0333 + 1e-12
    assert abs(math.remainder(chip.azimuth, 2 * math.pi)) <= 1.0 + 1e-9
    assert found.robot.sensors[1] is fixed


def test_the_same_seed_finds_the_same_design():
    one, two = (improve_design(arm(), **FEW) for _ in range(2))
    assert one.changes == two.changes
    assert one.by_chips == two.by_chips


def test_more_chips_know_the_tip_better_and_are_added_where_they_are_needed():
    one_axis = arm().replaced(sensors=[Sensor(1, 0.0, radial=0.01)])
    found = improve_design(one_axis, **FEW)
    assert [row.chips for row in found.by_chips] == [1, 2, 3, 4]
    errors = [row.calibrated for row in found.by_chips]
    assert sorted(errors, reverse=True) == errors
    assert max(row.as_built for row in found.by_chips) <= found.before.spread
    assert found.can_work
    more = len(found.robot.sensors) - 1
    assert more > 0
    assert found.remarks[1] == f"It works with {more} more chip{'s' if more > 1 else ''}."
    assert sum(x.startswith("one more chip at ") for x in found.changes) == more
    assert found.robot.part_names[1] == "chip 2"
    axes = found.plot()
    assert [*axes.lines[1].get_xdata()] == [1, 2, 3, 4]
    np.testing.assert_allclose(axes.lines[1].get_ydata(), 1e3 * np.array(errors))


def test_magnets_do_not_touch():
    """Nor do they after the changes that are enough; all that help by more than a hundredth are made."""
    robot = arm(chips=3)
    two = robot.replaced(magnets=[Magnet(Disc(6e-3, 8e-3, 1300.0), 1, at) for at in (0.02, 0.06)])
    found = improve_design(two, target=1.2e-4, **FEW)
    a, b = (magnet.at for magnet in found.robot.magnets)
    assert abs(a - b) >= 8e-3
    assert [row.chips for row in found.by_chips] == [1, 2, 3, 4, 5, 6]
    assert median_of(found, False) <= 1.01 * found.by_chips[2].calibrated
    assert " mm → magnets touch" in found.changes[-2]
    near = [Magnet(Disc(6e-3, 8e-3, 1300.0), 1, at) for at in (0.02, 0.03)]  # a gap of 2 mm, and they stay
    fixed = arm(chips=2, chip_free={"at": (0.0, 0.06)}).replaced(magnets=near)
    assert improve_design(fixed, target=1e-6, **FEW).changes


def test_a_part_off_the_backbone_turns_around_it_at_its_distance():
    robot = arm(chips=1)
    magnet = replace(robot.magnets[0], position=[0.003, 0.004, 0.001], free={"azimuth": (0.5, 2.5)})
    found = improve_design(robot.replaced(magnets=[magnet]), target=1e-6, **FEW)
    x, y, z = found.robot.magnets[0].place.position
    assert math.hypot(x, y) == pytest.approx(0.005, abs=1e-6)
    assert z == 0.001
    assert 0.5 - 1e-3 <= math.atan2(y, x) <= 2.5 + 1e-3


@pytest.mark.parametrize(
    ("name", "low", "high", "now", "step"),
    [
        ("at", 0.0, 0.0333, 0.03, 1e-4),
        ("azimuth", -1.0, 1.0, 0.9, math.radians(0.1)),
        ("azimuth", 0.0, 2 * math.pi, 0.05, math.radians(0.1)),
    ],
)
def test_a_free_number_moves_by_a_share_of_its_range_and_stays_in_it(name, low, high, now, step):
    """All over it without a share; a whole turn has no end."""
    chip, rng = (
        Sensor(1, **{"at": 0.01, "radial": 0.01, name: now}, free={name: (low, high)}),
        np.random.default_rng(0),
    )
    for share in (0.01, 0.3, None):
        found = np.array([getattr(_moved(chip, rng, share), name) for _ in range(300)])
        assert ((found >= low) & (found <= high)).all()
        if share is None:
            assert np.ptp(found) > 0.95 * (high - low)
            continue
        away, most = found - now, share * (high - low)
        away = away - high * np.round(away / high) if high > 6 else away
        assert np.abs(away).max() <= most + step / 2
        assert away.min() < -0.9 * most + step / 2


def test_a_ring_keeps_its_wall():
    ring = Magnet(Ring(8e-3, 4e-3, 2e-3, 1300.0), 1, 0.06)
    free = {"outer_diameter": (2e-3, 9e-3), "inner_diameter": (1e-3, 8.5e-3)}
    found = improve_design(arm().replaced(magnets=[replace(ring, free=free)]), target=1e-6, **FEW)
    assert found.robot.magnets[0].shape.inner_diameter < found.robot.magnets[0].shape.outer_diameter


@pytest.mark.parametrize(
    ("robot", "options", "message"),
    [
        (
            lambda: arm(free={"at": (0.01, 0.05)}),
            {},
            "free at of Magnet must be a range with what it is now in it",
        ),
        (
            lambda: arm(free={"at": (0.01, 0.07)}),
            {},
            "free at of Robot must be between 0 and 60 mm along segment 1",
        ),
        (lambda: arm(free={"at": (0.05, 0.01)}), {}, r"free at of Magnet must be \(lowest, highest\)"),
        (
            lambda: arm(free={"edge": (1e-3, 2e-3)}),
            {},
            "of at, azimuth, diameter, height; instead received 'edge'",
        ),
        (lambda: arm(chip_free={"diameter": (0, 1)}), {}, "free of Sensor must be of at, azimuth;"),
        (lambda: arm().replaced(moments=[[1e-9]]), {}, "robot of improve must be as drawn"),
        (arm, {"target": 0.0}, r"target of improve must be positive \[m\]"),
        (arm, {"tries": 3}, "tries of improve must be at least 20"),
    ],
)
def test_what_is_refused(robot, options, message):
    with pytest.raises(InputError, match=message):
        improve_design(robot(), **{**FEW, **options})


def test_nothing_is_free_on_a_base():
    joint = Robot(
        [ConstantCurvature(0.06, 0.01), Link(0.0)], [Magnet(Disc(3e-3, 1e-3, 1300.0), 2, 0.0)],
        [Sensor(0, 0.0, axes=3)], lower=[-0.01, -0.01, 0.0], upper=[0.01, 0.01, 0.003], noise=0.5,
    )  # fmt: skip
    with pytest.raises(InputError, match="robot of improve must be one of which something may change"):
        improve_design(joint, **FEW)


def test_check_of_a_robot_improves_it():
    robot = arm()
    assert (
        robot.check(samples=60, improve="calibrated", target=2e-3).robot.sensors[0].at != robot.sensors[0].at
    )
    with pytest.raises(InputError, match="target of check must be left out without improve"):
        robot.check(target=1e-3)
    with pytest.raises(
        InputError, match="improve of check must be one of calibrated, as built; instead received 'yes'"
    ):
        robot.check(improve="yes")


def test_the_written_file_gives_the_same_check(tmp_path):
    robot = written(tmp_path)
    assert robot.sensors[0].free == {"at": (0.0, 0.08), "azimuth": (-math.pi / 2, math.pi / 2)}
    found = improve_design(robot, **FEW)
    write_improved(tmp_path / "robot.toml", found.robot, tmp_path / "new.toml")
    new = load_robot(tmp_path / "new.toml")
    np.testing.assert_array_equal(check_design(new, samples=60).tip_as_built, found.tip_as_built)
    lines = (tmp_path / "new.toml").read_text(encoding="utf-8").splitlines()
    assert [line for line in TEXT.splitlines() if line not in lines] == [
        "at_mm = 110.0 # at the tip", "diameter_mm = 6.0", "at_mm = 10.0",
    ]  # fmt: skip
    assert f"at_mm = {1e3 * found.robot.magnets[0].at:.6g} # at the tip" in lines


def test_a_chip_more_is_written_with_channels_of_its_own(tmp_path):
    for channels, named in (
        ('["Bx", "By", "Bz"]', ["chip 2 x", "chip 2 y", "chip 2 z"]),
        ("[1, 2, 3]", [4, 5, 6]),
    ):
        path = tmp_path / str(named[0])
        path.mkdir()
        robot = written(path, TEXT.replace('["Bx", "By", "Bz"]', channels))
        target = 0.9 * improve_design(robot, **FEW).by_chips[0].calibrated
        found = improve_design(robot, target=target, **FEW)
        assert len(found.robot.sensors) == 2
        write_improved(path / "robot.toml", found.robot, path / "new.toml")
        np.testing.assert_array_equal(check_design(load_robot(path / "new.toml"), samples=60).tip, found.tip)
        chip = tomllib.loads((path / "new.toml").read_text(encoding="utf-8"))["sensors"][1]
        assert chip["channels"] == named
        assert chip["name"] == "chip 2"


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    tables = TEXT.split("[[sensors]]")[0]
    chip = (
        "sensors = [{ axes = 3, segment = 1, at_mm = 10.0, radial_mm = 12.0, free = { at_mm = [0, 80] } }]\n"
    )
    robot = written(tmp_path, chip + tables)
    found = improve_design(robot, **FEW)
    with pytest.raises(
        InputError, match=r"tables \[\[magnets\]\] and \[\[sensors\]\] with a key on each line"
    ):
        write_improved(tmp_path / "robot.toml", found.robot, tmp_path / "new.toml")
    robot = written(tmp_path)
    with pytest.raises(InputError, match=r"robot\.toml"):
        write_improved(tmp_path / "robot.toml", robot, tmp_path / "robot.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["robot.toml"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "at_mm = [60, 110]",
            "at = [60, 110]",
            r"^Input at of robot.toml, line 21, \[\[magnets\]\] 1, must be one of at_mm, azimuth_deg, ",
        ),
        ("at_mm = [60, 110]", "at_mm = [110, 60]", r"must be \[lowest, highest\] \[mm\], the smaller first"),
        (
            "azimuth_deg = [-90, 90]",
            "azimuth_deg = 90",
            r"must be \[lowest, highest\] \[deg\], the smaller first",
        ),
        ("diameter_mm = [4, 8]", "edge_mm = [4, 8]", "Input edge_mm of robot.toml, line 21"),
    ],
)
def test_a_free_that_is_none_is_refused_by_its_line(tmp_path, old, new, message):
    with pytest.raises(InputError, match=message):
        written(tmp_path, TEXT.replace(old, new))
