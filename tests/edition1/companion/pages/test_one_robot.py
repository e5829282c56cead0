"""One robot with three sets of sensors: what is read, what is estimated from it, and the tables."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from scipy.spatial.transform import Rotation

from edition1 import se3
from edition1.errors import InputError
from edition1.kinematics.paper_robots import Dimensions
from edition1.sensing.bend_sensor import BendSensor
from edition1.sensing.magnetic import readings
from edition1_companion.pages.one_robot import tables
from edition1_companion.pages.one_robot.estimates import (
    METHODS,
    as_drawn,
    by_hall,
    by_imus,
    by_magnets,
    calibrated,
    two_turns,
)
from edition1_companion.pages.one_robot.tables import (
    CONDITIONS,
    QUANTITIES,
    one_robot_errors,
    shape_alone,
    shape_errors,
)
from edition1_companion.twins.imu_errors import PERFECT
from edition1_companion.twins.segment_motion import ROBOT, TRAJECTORIES, motion
from edition1_companion.twins.segment_robot import (
    APART_M,
    HALL_NOISE_MT,
    HALL_STEP_MT,
    MAGNET_NOISE_MT,
    MID_ELONGATION_M,
    RING,
    calibration_session,
    draw_parts,
    simulate,
)

ARC, AFFINE, LOADED = TRAJECTORIES
STEPS = 40
AT_ONCE = replace(PERFECT, rate_hz=40.0, skew_s=0.0)
"""IMUs without errors or delay, read at every step of a motion of 400."""


@pytest.fixture(scope="module")
def robots():
    parts = draw_parts(4)
    return parts, calibrated(*calibration_session(parts))


def clean(name, steps=STEPS, errors=AT_ONCE):
    moved = motion(name, steps=steps)
    return moved, simulate(moved, replace(draw_parts(1, as_drawn=True), errors=errors), noise=False)


def test_a_rod_without_load_moves_as_the_arc():
    assert torch.allclose(motion(LOADED, steps=9, load_n=0.0).poses, motion(ARC, steps=9).poses, atol=1e-13)
    bent = motion(LOADED, steps=9).poses[:, -1] - motion(ARC, steps=9).poses[:, -1]
    assert bent[:, 0, 3].min() > 5e-3  # the force pulls along x


def test_the_affine_motion_turns_its_tip_by_the_integral_of_the_curvature():
    tip = motion(AFFINE, steps=7).at(Dimensions.LENGTH_M)
    assert math.degrees(math.acos(tip[1, 2, 2])) == pytest.approx(
        (45 + 180 / 2) / 3
    )  # outermost point of a petal


def test_too_few_robots_and_poses_are_refused():
    with pytest.raises(InputError, match="Input draws of draw_parts must be at least 1; instead received 0."):
        draw_parts(0)
    with pytest.raises(InputError, match="Input poses of calibration_session must be at least 3"):
        calibration_session(draw_parts(1), poses=2)


def test_readings_as_drawn_are_those_of_the_robot_and_of_the_arc_between_sensor_and_cube():
    moved, seen = clean(ARC)
    assert torch.allclose(seen.magnets[:, 0], readings(ROBOT, moved.q, RING), atol=1e-12)
    for k in (0, 13, 27):  # the sensor model of an arc of this length, in torch
        length = APART_M * (1 + moved.q[k, 2].item() / Dimensions.LENGTH_M)
        local = moved.q[k, :2] / Dimensions.RADIUS_M * APART_M / Dimensions.LENGTH_M
        expected = BendSensor(length)(local)
        assert torch.allclose(seen.hall[k, 0, 0], expected, atol=1e-9)
        assert torch.allclose(seen.hall[k, 0, 1], expected, atol=1e-9)  # an arc is the same everywhere


def test_imus_without_errors_read_the_ends_of_the_segment():
    moved, seen = clean(LOADED, 400)
    R = torch.from_numpy(Rotation.from_quat(seen.imus[:, 0].reshape(-1, 4)).as_matrix()).reshape(-1, 2, 3, 3)
    assert torch.allclose(R[:, 0], torch.eye(3).double().expand(400, 3, 3), atol=1e-12)
    assert torch.allclose(R[:, 1], moved.at(Dimensions.LENGTH_M)[:, :3, :3], atol=1e-9)


def test_imus_show_what_was_true_one_latency_ago():
    moved, seen = clean(ARC, 400, replace(AT_ONCE, latency_s=0.05))
    _, now = clean(ARC, 400)
    assert torch.allclose(seen.imus[2:], now.imus[:-2], atol=1e-9)
    assert moved.time_s[2] == pytest.approx(0.05)


def test_the_other_magnet_is_a_dipole_far_away():
    moved = motion(ARC, steps=3)
    parts = draw_parts(1, as_drawn=True)
    alone, both = (simulate(moved, parts, noise=False, both_magnets=x) for x in (False, True))
    volume_mt = 1320.0 * 6.35e-3**3 / (4 * math.pi)
    far = (Dimensions.LENGTH_M - APART_M) * (1 + MID_ELONGATION_M / Dimensions.LENGTH_M)
    added = both.magnets[0, 0] - alone.magnets[0, 0]  # straight; they measure towards the base
    expected = -volume_mt * (3 * far**2 / (far**2 + 0.013**2) - 1) / (far**2 + 0.013**2) ** 1.5
    assert torch.allclose(added, torch.full((3,), expected, dtype=torch.float64), rtol=0.01)
    along = (both.hall - alone.hall)[0, 0, :, 2]
    assert along[0].item() == pytest.approx(
        RING.field(np.array([0.0, 0.0, -0.055 - MID_ELONGATION_M / 2]))[2], rel=1e-9
    )
    assert along[1] == 0.0


def test_draws_are_their_own_and_noise_is_as_stated():
    few, many = draw_parts(2, seed=3), draw_parts(200, seed=3)
    assert torch.equal(few.ring_sensors, many.ring_sensors[:2])
    assert np.array_equal(few.turns, many.turns[:, :2])
    assert many.ring[:, :3, 3].std().item() == pytest.approx(0.5e-3, rel=0.1)
    assert many.cube[:, :3, 3].std().item() == pytest.approx(0.5e-3, rel=0.1)
    assert many.strength.std().item() == pytest.approx(0.02, rel=0.1)
    mounting = Rotation.from_quat(many.turns[0].reshape(-1, 4)).as_rotvec(degrees=True)
    assert mounting.std() == pytest.approx(3.0, rel=0.1)
    moved = motion(ARC, steps=300)
    noisy, still = simulate(moved, few), simulate(moved, few, noise=False)
    assert (noisy.magnets - still.magnets).std().item() == pytest.approx(MAGNET_NOISE_MT, rel=0.1)
    hall = math.hypot(HALL_NOISE_MT, HALL_STEP_MT / math.sqrt(12))
    assert (noisy.hall - still.hall).std().item() == pytest.approx(hall, rel=0.1)
    again = simulate(moved, few)
    assert torch.equal(noisy.hall, again.hall)
    assert torch.equal(noisy.imus, again.imus)
    assert not torch.equal(simulate(moved, few, seed=1).magnets, noisy.magnets)


def test_with_nothing_wrong_the_arc_is_found():
    moved, seen = clean(ARC, 400)
    by_ring = shape_errors(by_magnets(as_drawn(), seen.magnets, moved.arcs_m), moved)
    assert max(x.item() for x in by_ring.values()) < 1e-4
    ends = by_imus(as_drawn(), seen.imus, moved.arcs_m)
    q = moved.q.clone()
    q[:, 2] = MID_ELONGATION_M  # all that IMUs cannot see
    expected = ROBOT.segments[0].pose(q.unsqueeze(1), moved.arcs_m / Dimensions.LENGTH_M)[..., :3, 3]
    assert torch.allclose(ends.points[:, 0], expected, atol=1e-9)
    (base, middle) = by_hall(as_drawn(), seen.hall, moved.arcs_m)
    assert torch.allclose(base.points, middle.points, atol=1e-5)
    assert shape_errors(base, moved)["tip_mm"].item() < 4.0


def test_the_ring_sees_the_half_between_itself_and_its_sensors():
    """The bend of the tip half is found although the shape is no arc; that of the other half is its copy."""
    for name in (AFFINE, LOADED):
        moved, seen = clean(name)
        arcs = torch.tensor([0.055, 0.0549, 0.110, 0.1099], dtype=torch.float64)
        points = by_magnets(as_drawn(), seen.magnets, arcs).points[:, 0]
        middle, tip = points[:, 0] - points[:, 1], points[:, 2] - points[:, 3]
        true = moved.poses[..., :3, 2]

        def angle(a, b):
            cosine = torch.nn.functional.cosine_similarity(a, b, dim=-1).clamp(-1, 1)
            return cosine.acos()

        straight = torch.tensor([0.0, 0.0, 1.0]).double().expand_as(tip)
        near = angle(middle, tip) - angle(true[:, 22], true[:, 44])
        far = angle(straight, middle) - angle(true[:, 0], true[:, 22])
        assert near.square().mean().sqrt() < 0.4 * far.square().mean().sqrt()


def test_calibration_lowers_every_error(robots):
    parts, models = robots
    moved = motion(ARC, steps=200)
    seen = simulate(moved, parts)
    for estimate, u in ((by_magnets, seen.magnets), (by_imus, seen.imus)):
        before, after = (shape_errors(estimate(m, u, moved.arcs_m), moved) for m in (as_drawn(), models))
        assert after["tip_mm"].mean() < 0.7 * before["tip_mm"].mean()
    before, after = (by_hall(m, seen.hall, moved.arcs_m)[1] for m in (as_drawn(), models))
    assert shape_errors(after, moved)["tip_mm"].mean() < 15.0
    assert shape_errors(before, moved)["tip_mm"].mean() > 30.0


def test_two_turns_are_recovered():
    turns = torch.from_numpy(Rotation.random(32, rng=np.random.default_rng(0)).as_matrix())
    small = Rotation.from_rotvec([[0.1, -0.2, 0.05], [-0.1, 0.04, 0.2]]).as_matrix()
    E, M = torch.from_numpy(small)
    found_E, found_M = two_turns((E @ turns @ M)[None], turns[None])
    assert torch.allclose(found_E[0], E, atol=1e-6)
    assert torch.allclose(found_M[0], M, atol=1e-6)


def test_failed_sensors_are_not_used():
    moved, seen = clean(ARC)
    for k in range(3):
        u = seen.magnets.clone()
        u[..., k] = 1e3
        spoilt, whole = (by_magnets(as_drawn(), x, moved.arcs_m, failed=k) for x in (u, seen.magnets))
        assert torch.equal(spoilt.points, whole.points)
    for shape in by_hall(as_drawn(), seen.hall, moved.arcs_m, failed=0):
        assert shape.points[..., :2].abs().max() == 0
        assert shape.points[0, 0, -1, 2].item() == pytest.approx(Dimensions.LENGTH_M + MID_ELONGATION_M)
    assert torch.equal(
        by_imus(as_drawn(), seen.imus, moved.arcs_m, failed=0).tip,
        by_imus(as_drawn(), seen.imus, moved.arcs_m).tip,
    )
    straight = by_imus(as_drawn(), seen.imus, moved.arcs_m, failed=1)
    assert straight.points[..., :2].abs().max() < 1e-12


def test_errors_of_a_shape_that_is_off_by_a_known_amount():
    moved = motion(ARC, steps=5)
    turn = se3.rotation_x(torch.tensor(0.01, dtype=torch.float64))
    shape = by_magnets(as_drawn(), clean(ARC, 5)[1].magnets, moved.arcs_m)
    off = shape.points + torch.tensor([1e-3, 0.0, 0.0], dtype=torch.float64)
    found = shape_errors(replace(shape, points=off, tip=shape.tip @ turn), moved)
    assert found["tip_mm"].item() == pytest.approx(1.0, rel=1e-4)
    assert found["shape_mm"].item() == pytest.approx(1.0, rel=1e-4)
    assert found["orientation_deg"].item() == pytest.approx(math.degrees(0.01), rel=1e-4)


def test_the_table_has_every_case_and_the_same_numbers_again():
    table = one_robot_errors(2, steps=20, poses=10)
    counts = table.groupby("condition").size().to_dict()
    everywhere = len(TRAJECTORIES) * 2 * 2  # trajectories, as drawn and calibrated, draws
    assert counts == dict(zip(CONDITIONS, (4 * everywhere, 4 * everywhere, 2 * everywhere), strict=True))
    assert np.isfinite(table[list(QUANTITIES)].to_numpy()).all()
    again = one_robot_errors(2, steps=20, poses=10)
    assert again.to_csv(float_format="%.10g") == table.to_csv(float_format="%.10g")
    lines = tables.overview(tables.mean_errors(table))
    assert len(lines) == 2 * len(METHODS)
    assert list(lines["parts"]) == [4, 4, 2, 2, 2, 2, 2, 2]
    assert list(lines["tip, other magnet [mm]"] != "") == [True] * 4 + [False] * 4


def test_the_shape_alone_leaves_no_error_of_the_ring_on_the_arc():
    table = shape_alone(steps=20).set_index(["trajectory", "method"])
    assert len(table) == len(TRAJECTORIES) * len(METHODS)
    assert table.loc[(ARC, METHODS[0]), "tip_mm"] < 1e-3 < table.loc[(AFFINE, METHODS[0]), "tip_mm"]


def made_up(factors):
    rows = [
        {"trajectory": t, "method": m, "calibrated": True, "condition": CONDITIONS[0], "draw": d}
        | dict.fromkeys(QUANTITIES, f * (1.0 + d))
        for t in TRAJECTORIES
        for m, f in factors.items()
        for d in range(10)
    ]
    return pd.DataFrame(rows)


def test_means_with_intervals_and_paired_ratios():
    table = made_up(dict(zip(METHODS, (2.0, 3.0, 4.0, 1.0), strict=True)))
    means = tables.mean_errors(table)
    line = means[means["method"] == METHODS[0]].iloc[0]
    assert line["tip_mm"] == pytest.approx(11.0)
    assert 5.5 < line["tip_low_mm"] < 9.0
    assert 13.0 < line["tip_high_mm"] < 16.5
    found = tables.ratio_to_imus(table)
    first = found[found["trajectory"] == ARC]
    assert first["ratio"].tolist() == pytest.approx([2.0, 3.0, 4.0])
    assert first["low"].tolist() == pytest.approx([2.0, 3.0, 4.0])  # paired: the draws' spread drops out


def test_latency_of_every_method():
    table = tables.latency(repeats=3)
    assert table["method"].tolist() == list(METHODS)
    assert (table["cpu_ms"] > 0).all()
    assert table["seen_percent"].tolist() == pytest.approx([50.0, 100 * 15 / 110, 100 * 15 / 110, 100.0])
