"""One segment with the sensors of all papers: the rod against beams and elastica, readings, errors and tables."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from repro import BendSensor, LevenbergMarquardt
from repro.tolerances import Tolerances
from repro_companion.papers import baaij, segment
from repro_companion.papers.segment import LENGTH, MODULUS, RADIUS, SECTION

from .sample import ONE_DEVIATION

THIN = 1e-3
"""Radius of a rod [m] whose shear and stretch do not count."""
STIFFNESS = MODULUS * math.pi / 4 * THIN**4
STEPS = 40
BESIDE = "other magnet on board"


def straight_rod(force_n, axis=0):
    force = np.zeros(3)
    force[axis] = force_n
    return segment.rod(np.zeros((1, 2)), np.ones(1), force, THIN)[0]


@pytest.mark.parametrize("axis", [0, 1])
def test_a_small_force_bends_a_straight_rod_as_a_beam(axis):
    force = 1e-8
    T = straight_rod(force, axis)
    s = segment.NODES
    beam = force * s**2 * (3 * LENGTH - s) / (6 * STIFFNESS)
    np.testing.assert_allclose(T[:, axis, 3], beam, rtol=0, atol=1e-3 * beam[-1])
    assert T[-1, axis, 2] == pytest.approx(force * LENGTH**2 / (2 * STIFFNESS), rel=1e-3)
    np.testing.assert_allclose(T[:, 1 - axis, 3], 0.0, atol=1e-15)


@pytest.mark.parametrize("load", [0.5, 1.0, 2.0])
def test_a_large_force_bends_a_straight_rod_as_the_elastica(load):
    """First integral of EI theta'' = -F cos(theta); x**2 is what is left to the slope at the tip."""

    def integral(tip, weight):
        def share(x):
            root = math.sqrt(4 * load * math.cos(tip - x * x / 2) * math.sin(x * x / 2))
            return weight(tip - x * x) * 2 * x / root

        return quad(share, 1e-9, math.sqrt(tip))[0]

    tip = brentq(lambda angle: integral(angle, lambda _: 1.0) - 1, 1e-3, 1.5)
    across, along = integral(tip, math.sin), math.sqrt(2 * math.sin(tip) / load)
    if load == 1.0:  # printed: Mattiasson 1981, table 1
        assert (across, 1 - along, tip) == pytest.approx((0.30172, 0.05643, 0.46135), abs=1e-5)
    end = straight_rod(load * STIFFNESS / LENGTH**2)[-1]
    assert end[0, 3] / LENGTH == pytest.approx(across, rel=5e-4)
    assert end[2, 3] / LENGTH == pytest.approx(along, rel=5e-4)


def test_an_unloaded_rod_is_the_arc_and_a_force_that_is_too_large_is_refused():
    q = baaij.lemniscate(1, steps=7)
    np.testing.assert_allclose(
        segment.motion(segment.MOTIONS[2], 7, 0.0), segment.motion(segment.MOTIONS[0], 7), rtol=0, atol=1e-12
    )
    with pytest.raises(ValueError, match="A force of 1e"):
        segment.rod(q[:, :2] / RADIUS, np.ones(7), [1e3, 0.0, 0.0])


def test_a_rod_in_equilibrium_carries_the_moment_of_its_load_also_in_twist():
    bend, force = np.array([[0.3, 0.8]]), np.array([0.4, -0.2, 0.1])
    T = segment.rod(bend, np.ones(1), force)[0]
    turns = Rotation.from_matrix(np.swapaxes(T[:-1, :3, :3], -1, -2) @ T[1:, :3, :3]).as_rotvec()
    middle = (T[1:, :3, 3] + T[:-1, :3, 3]) / 2
    half = T[:-1, :3, :3] @ Rotation.from_rotvec(turns / 2).as_matrix()
    h = LENGTH / segment.ELEMENTS
    strain = turns / h - np.array([-0.8, 0.3, 0.0]) / LENGTH
    moment = np.einsum("kji,kj->ki", half, np.cross(T[-1, :3, 3] - middle, force))
    thick = MODULUS * math.pi / 4 * SECTION**4
    np.testing.assert_allclose(strain * thick * [1, 1, 2 / 3], moment, rtol=0, atol=1e-9)
    assert np.abs(moment[:, 2]).max() > 1e-4


def test_a_thick_rod_shears_and_stretches_too():
    axial, stiffness = MODULUS * math.pi * SECTION**2, MODULUS * math.pi / 4 * SECTION**4
    pulled = segment.rod(np.zeros((1, 2)), np.ones(1), [1e-3, 0.0, 0.0])[0, -1, 0, 3]
    shear = pulled - 1e-3 * LENGTH**3 / (3 * stiffness)
    assert shear == pytest.approx(1e-3 * LENGTH / (axial / 3 * 27 / 28), rel=0.02)
    stretched = segment.rod(np.zeros((1, 2)), np.full(1, 1.05), [0.0, 0.0, 0.5])[0]
    assert stretched[-1, 2, 3] == pytest.approx(LENGTH * (1.05 + 0.5 / axial), rel=1e-12)


def test_the_affine_motion_bends_by_a_third_of_the_paper_and_begins_nearly_straight():
    T = segment.motion(segment.MOTIONS[1], 7)
    turned = np.degrees(np.arccos(T[:, -1, 2, 2]))
    np.testing.assert_allclose(
        turned[[0, 3]], [3.0, 45.0], atol=1e-9
    )  # (pi/12 c + pi/6 (0.1 + 0.9 c)) of 1 rad


def test_two_arcs_have_the_nodes_of_one_arc_of_the_same_shape():
    one, two = (segment.of_arcs(baaij.robot(1), n) for n in (1, 2))
    half = [0.004, -0.002, 0.001]
    np.testing.assert_allclose(
        segment.backbone(two, np.tile(half, 2)), segment.backbone(one, 2 * np.array(half)), atol=1e-14
    )
    np.testing.assert_allclose(two.sensing()(np.tile(half, 2)), one.sensing()(2 * np.array(half)), atol=1e-12)
    assert two.lower[2] == two.upper[2] == baaij.ELONGATION / 2
    ends = [(robot.lower[-1], robot.upper[-1]) for robot in (one, two)]
    np.testing.assert_allclose(ends, [(0, baaij.bounds(1)[1][2]), (0, baaij.bounds(1)[1][2] / 2)])


def noiseless(name, size=0.0, seed=3):
    T = segment.motion(name, STEPS)
    robot = segment.built(np.random.default_rng(seed), size)
    return robot, T, *segment.read(robot, T, np.random.default_rng(0), 0.0)


def test_readings_without_errors_are_those_of_the_drawing():
    *_, seen, together = noiseless(segment.MOTIONS[0])
    q = baaij.lemniscate(1, steps=STEPS)
    np.testing.assert_allclose(seen.ring, baaij.simulate(baaij.robot(1), q), atol=1e-12)
    found = LevenbergMarquardt(segment.of_arcs(baaij.robot(1), 1).replaced(imus=()), noise=segment.RING_NOISE)
    at = found.step(found.init(), seen.ring)[1].q
    np.testing.assert_allclose(at, q, atol=2e-7)  # multipoles up to order 9 against the exact field
    assert 1e-3 < np.abs(together.ring - seen.ring).max() < 0.1
    np.testing.assert_array_equal(together.hall, seen.hall)
    bend = q[:, :2] / RADIUS * segment.APART / LENGTH
    field = [BendSensor(segment.APART * (1 + x / LENGTH))(b) for x, b in zip(q[:, 2], bend, strict=True)]
    np.testing.assert_allclose(seen.hall, field, atol=1e-9)
    np.testing.assert_allclose(seen.imus[:, 0], np.tile([0, 0, 0, 1.0], (STEPS, 1)), atol=1e-15)


@pytest.mark.parametrize("interval_s", [1.0, 10.0])
def test_headings_of_imus_fade_within_forty_seconds_however_often_they_are_read(interval_s):
    robot, rng = segment.built(np.random.default_rng(0), 0.0), np.random.default_rng(1)
    q = segment._imus(robot, Rotation.identity(20_000), interval_s, rng, 1.0)
    heading, later = Rotation.from_quat(q[:, 0]).as_rotvec()[:, 2], round(40 / interval_s)
    like = (heading[later:] * heading[:-later]).mean() / (heading**2).mean()
    assert like == pytest.approx(math.exp(-1), abs=0.12)


def test_imus_show_the_orientation_of_up_to_one_round_and_the_latency_before():
    T = segment.motion(segment.MOTIONS[0], 400)
    seen = segment.read(segment.built(np.random.default_rng(0), 0.0), T, np.random.default_rng(0), 0.0)[0]
    turns = np.unwrap(Rotation.from_quat(seen.imus[:, 1]).as_rotvec()[:, 1])
    true = Rotation.from_matrix(T[:, -1, :3, :3]).as_rotvec()[:, 1]
    fast = slice(180, 220)  # the bend goes through zero at a constant rate
    age = (true[fast] - turns[fast]) / np.gradient(true, 0.025)[fast]
    assert 0.009 < age.min() < 0.02
    assert 0.03 < age.max() < 0.01 + 1 / 31 + 0.002


def test_each_kind_of_error_is_in_the_readings_of_its_sensor():
    robot, T, *_ = noiseless(segment.MOTIONS[0], 1.0)
    quiet, loud = (segment.read(robot, T, np.random.default_rng(1), size)[0] for size in (0.0, 1.0))
    assert np.std(loud.ring - quiet.ring) == pytest.approx(segment.RING_NOISE, rel=0.2)
    assert np.std(loud.hall - quiet.hall) == pytest.approx(segment.HALL_NOISE, rel=0.2)
    np.testing.assert_allclose(loud.hall / 0.01, np.round(loud.hall / 0.01), atol=1e-9)
    turned = (Rotation.from_quat(loud.imus[:, 0]) * Rotation.from_quat(quiet.imus[:, 0]).inv()).magnitude()
    assert 0.2 < np.degrees(turned).mean() < 6


def test_a_session_measures_the_tip_of_the_poses_in_which_it_reads():
    robot = segment.built(np.random.default_rng(0), 0.0)
    tips, seen = segment.session(robot, 30, np.random.default_rng(5))
    q, _ = baaij.configurations(baaij.robot(1), tips[:, None])
    off = baaij.simulate(baaij.robot(1), q) - seen.ring
    assert np.median(np.abs(off)) < 0.02 < np.std(seen.ring)
    angle = (Rotation.from_quat(seen.imus[:, 1]).inv() * Rotation.from_matrix(tips[:, :3, :3])).magnitude()
    assert 0.3 < np.degrees(angle).mean() < 6


def test_what_is_known_without_a_sensor():
    turns = Rotation.from_rotvec([[0.1, 0.0, 0.0], [0.1, 0.4, 0.0]])
    seen = segment.Readings(np.ones((2, 3)), np.ones((2, 3)), np.stack([turns.as_quat()] * 2))
    known = segment.nominal()
    base, tip = segment.orientations(known, segment.without(seen, "imus", 0))
    assert base.magnitude() == pytest.approx([0, 0])
    assert tip.approx_equal(Rotation.concatenate([turns[1]] * 2)).all()
    lost = segment.without(seen, "imus", 1)
    base, tip = segment.orientations(known, lost)
    assert base.approx_equal(tip).all()
    assert np.isnan(segment.turn_of_tip(known, lost)).all()
    assert segment.turn_of_tip(known, seen)[0] == pytest.approx((turns[0].inv() * turns[1]).as_rotvec())
    assert np.isnan(segment.fixed_coordinates(seen)).all()
    assert segment.fixed_coordinates(segment.without(seen, "ring", 1))[2] == baaij.ELONGATION


def test_shape_errors_are_root_mean_squares_over_time_and_the_tip_is_the_last_node():
    """In one of four steps, and at one of twelve nodes."""
    T = segment.motion(segment.MOTIONS[0], 4)
    points, tip = segment.shape(baaij.robot(1), baaij.lemniscate(1, steps=4))
    np.testing.assert_allclose(points, T[:, :: segment.EVERY, :3, 3], atol=1e-12)
    points[2, -1, 1] += 6e-3
    tip[2] = tip[2] @ Rotation.from_rotvec([0.0, 0.0, math.radians(4)]).as_matrix()
    assert segment.shape_errors((points, tip), T) == pytest.approx(
        {"tip_mm": 3.0, "orientation_deg": 2.0, "shape_mm": math.sqrt(36 / 4 / 12)}
    )


def test_parts_are_off_by_their_tolerances():
    """Each by twice the deviation; IMUs have deviations of 1, 1 and 6 degrees in the world and of 3 on the robot."""
    robot, t, drawn = segment.built(ONE_DEVIATION, 2.0), Tolerances(), baaij.robot(1).sensors
    for magnet, polarisation in ((robot.ring.magnets[0], 1450.0), (robot.cube.magnets[0], 1320.0)):
        off = magnet.shape.polarisation_mt / polarisation - 1, math.asin(magnet.direction[0])
        assert (*off, *magnet.place.position) == pytest.approx(
            [2 * t.moments, 2 * t.magnet_tilt, *[2 * t.magnet_position] * 3]
        )
    for sensor, plan in zip(robot.ring.sensors, drawn, strict=True):
        off = sensor.azimuth - plan.azimuth, sensor.radial / plan.radial - 1, sensor.tilt, sensor.gain - 1
        assert off == pytest.approx(
            [2 * t.sensor_azimuth, 2 * t.sensor_radius, 2 * t.sensor_tilt, 2 * t.sensor_gain]
        )
    np.testing.assert_allclose(robot.cube.sensors[0].gain, 1 + 2 * t.sensor_gain)
    np.testing.assert_allclose(np.degrees(robot.world.as_rotvec()), [[2, 2, 12]] * 2)
    np.testing.assert_allclose(np.degrees(robot.mounting.as_rotvec()), 6)


def test_the_worst_sensor_is_the_one_whose_loss_costs_most():
    T = segment.motion(segment.MOTIONS[0], 5)
    seen = segment.Readings(np.ones((5, 3)), np.ones((5, 3)), np.ones((5, 2, 4)))
    rows = [segment.Run("arc", c, 0, segment.nominal(), seen, seen, T) for c in (True, False)]

    def off(some):  # by 1 mm for each sensor of the ring that is missing, times its number
        lost = [np.isnan(one.ring).any(0) @ [1.0, 2.0, 3.0] for _, one in some]
        return [(T[:, ::4, :3, 3] + [1e-3 * k, 0, 0], T[:, -1, :3, :3]) for k in lost]

    found = segment.errors(rows, {"ring and 3 sensors": off}).set_index(["calibrated", "condition"])["tip_mm"]
    assert found.to_dict() == pytest.approx(
        {
            (True, "all sensors"): 0,
            (False, "all sensors"): 0,
            (True, "one sensor failed"): 3,
            (True, BESIDE): 0,
        }
    )
    hall = segment.without(seen, "hall", 0)
    assert np.isnan(hall.hall).all()
    assert np.isnan(segment.without(seen, "imus", 1).imus[:, 1]).all()


def test_means_and_ratios_are_paired_over_the_robots():
    draws = np.arange(6)
    parts = [
        pd.DataFrame({"trajectory": "arc", "method": method, "calibrated": True, "condition": "all sensors",
                      "draw": draws, "tip_mm": factor * (1.0 + draws)})
        for method, factor in (("ring", 0.5), ("2 IMUs", 1.0))
    ]  # fmt: skip
    table = pd.concat(parts, ignore_index=True)
    ratio = segment.ratios(table)
    assert ratio[["ratio", "low", "high"]].to_numpy().tolist() == [[0.5, 0.5, 0.5]]
    assert list(ratio["method"]) == ["ring"]
    crossed = segment.ratios(table.assign(tip_mm=[3, 3, 3, 1, 1, 1, *[1] * 3, *[3] * 3]))
    assert crossed["ratio"].item() == 1  # of the means, where the mean of the ratios is 5/3
    means = segment.mean_errors(table).set_index("method")
    assert means["tip_mm"].to_dict() == {"ring": 1.75, "2 IMUs": 3.5}
    # The mean of six has the standard deviation sqrt(35/12/6); normal quantiles are near enough.
    width = 1.96 * math.sqrt(35 / 12 / 6)
    assert means.loc["2 IMUs", "high_mm"] - 3.5 == pytest.approx(width, rel=0.1)
    assert 3.5 - means.loc["2 IMUs", "low_mm"] == pytest.approx(width, rel=0.1)


def means_of(errors, width=0.5):
    """Return mean errors of every method in every situation of the page, with intervals so wide on either side."""
    keys = itertools.product(segment.MOTIONS, segment.PARTS, (True, False), segment.CONDITIONS)
    table = pd.DataFrame(list(keys), columns=segment.KEYS)
    tip = table["method"].map(dict(zip(segment.PARTS, errors, strict=True)))
    return table.assign(tip_mm=tip, low_mm=tip - width, high_mm=tip + width)


def test_two_sensors_are_named_where_their_intervals_overlap():
    means = means_of([4.0, 9.0, 5.5, 3.0, 2.0])
    assert segment.take(means, "true arc, calibrated") == ("ring", "ring 4.0; IMUs 5.5")
    wide = means_of([4.0, 9.0, 5.5, 3.0, 2.0], width=1.0)
    assert segment.take(wide, "true arc, calibrated") == ("ring or IMUs", "ring 4.0; IMUs 5.5")
    said = segment.in_words(means, -0.5)
    assert "build the ring (4.0 mm at the tip)" in said
    assert "0.5 N sideways" in said
    assert "shape of two arcs (2.0 mm, against 4.0 mm for the ring and 5.5 mm for the IMUs)" in said
    turn = "at about 0.2 N, a load that moves the straight tip by 10 mm"  # 0.25 N: 0.5 N times 2/4
    assert turn in said
    assert segment.situations(means)["take"].iloc[:2].to_list() == ["ring", "both (two arcs)"]


def test_a_loss_is_explained_only_where_it_gains():
    means = means_of([4.0, 9.0, 5.5, 3.0, 2.0])
    assert segment.missing_in_words(means) == ""
    lost = (means["method"] == segment.TWO) & (means["condition"] == segment.FAILED)
    means.loc[lost, "tip_mm"] = 1.5
    assert "(1.5 mm against 2.0 mm)" in segment.missing_in_words(means)
    ratios = pd.DataFrame({
        "method": [segment.ONE] * 2 + [segment.TWO] * 2, "trajectory": segment.MOTIONS[1:] * 2,
        "ratio": [1.3, 3.0, 0.5, 0.7],
    })  # fmt: skip
    said = segment.together_in_words(means, ratios)
    assert "More sensors do not help" in said
    assert "50 % of the error" in said
    assert "as a ring with all its sensors has" not in said
    means.loc[lost, "tip_mm"] = 4.0
    assert "ring and IMUs then have 4.0 mm" in segment.together_in_words(means, ratios)
    straight = pd.DataFrame({name: [30.0] for name in segment.MOTIONS})
    table = segment.by_method(means, straight).set_index("sensors")
    assert table.loc[segment.TWO].to_list() == [2, 2, 2, 4, 2]
    assert table.loc["no sensor, straight"].to_list()[:3] == [30] * 3


def test_a_straight_guess_is_off_by_as_much_as_the_tip_moves():
    T = segment.motion(segment.ARC, STEPS)
    rest = np.array([0.0, 0.0, LENGTH + segment.ELONGATION])
    off = 1e3 * np.sqrt(((T[:, -1, :3, 3] - rest) ** 2).sum(-1).mean())
    assert segment.straight_errors({"a": T})["a"][0] == pytest.approx(off)
