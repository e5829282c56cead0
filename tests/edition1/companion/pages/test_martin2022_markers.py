"""Three evaluations of the markers: what changes between them, and errors that are known in advance."""

import numpy as np
import pytest
from short_arm import short_arm

from edition1.errors import InputError
from edition1.estimation.imu_models import pcc_extended
from edition1_companion.recordings.martin2022_models import MARKERS, selection
from edition1_companion.twins.arm_markers import (
    DESCRIBED,
    EVALUATIONS,
    FILES,
    PCC_16,
    RIGID_8,
    SAME_POINT,
    Case,
    cases,
    differences,
    distances_mm,
    errors_along,
    hull,
    marker_errors,
    mid_section,
    over_draws,
)
from edition1_companion.twins.arm_recording import MotionCapture
from edition1_companion.twins.arm_trial import draw, drawn, errors_with
from edition1_companion.twins.imu_errors import PERFECT, ImuErrors


@pytest.fixture(scope="module")
def arm():
    return short_arm()


@pytest.fixture(scope="module")
def perfect(arm):
    return drawn(arm, 0, PERFECT, MotionCapture(noise_m=0.0))


def test_cases_of_the_figures():
    found = [(case.figure, case.name) for case in cases()]
    assert found[2] == ("Fig. 3", RIGID_8)
    assert found[4] == ("Fig. 4", PCC_16)
    assert found[9] == ("Fig. 5", PCC_16)
    assert len(found) == 10


class TestChains:
    @pytest.mark.parametrize("case", cases(), ids=lambda case: f"{case.figure} {case.name}")
    def test_same_point_has_the_imus_of_the_files_and_the_markers(self, case):
        files, same = case.chain(FILES), case.chain(SAME_POINT)
        assert same.imus[: len(files.imus)] == files.imus
        # Where the base link is short, all points of the chain are.
        short = 0.64 - sum(same.link_lengths) - same.origin_m[2]
        np.testing.assert_allclose(np.array(same.markers) + same.origin_m[2] + short, MARKERS, atol=1e-12)
        expected = 0.0052 if same.imus == tuple(range(9)) else 0.0 if case.model == "pcc" else 0.0002
        assert short == pytest.approx(expected)

    def test_as_described_is_by_text_or_table(self):
        four = Case("Fig. 3", "rigid", 4, 4)
        assert four.chain(DESCRIBED).imus == (1, 3, 5, 7)
        assert four.chain(DESCRIBED, "table").imus == (2, 4, 6, 8)

    def test_rigid_body_of_the_files_is_the_chain_of_eight_segments(self):
        rigid, pcc = Case("Fig. 3", "rigid", 8, 8), Case("Fig. 4", "pcc", 8, 8)
        assert rigid.chain(FILES) == pcc.chain(FILES)
        assert rigid.chain(SAME_POINT) == pcc.chain(SAME_POINT)
        assert rigid.chain(SAME_POINT).imus == tuple(range(9))


class TestErrors:
    def test_points_below_the_markers_are_off_by_their_distance(self, perfect):
        released = distances_mm(perfect.trial, Case("Fig. 3", "rigid", 8, 8).chain(FILES))
        # 40 mm along the arm, less what the arm bends in between.
        assert (np.abs(np.median(released, axis=0) - 40) < 5).all()

    def test_quantiles_are_those_of_the_distances(self, perfect):
        chosen = cases(imus=(), segments=(16,))
        table = marker_errors([perfect.trial], chosen, [DESCRIBED])
        made = selection("pcc", 8)
        estimate = pcc_extended(made.of(perfect.trial.orientations), made, MARKERS)
        error = 1e3 * np.linalg.norm(estimate - perfect.trial.points[:, :2], axis=-1)
        np.testing.assert_allclose(table["median_mm"], np.median(error, axis=0))
        np.testing.assert_allclose(table["q75_mm"], np.percentile(error, 75, axis=0))

    def test_mean_and_spread_over_draws(self, arm):
        trials = [draw(arm, seed).trial for seed in range(2)]
        table = marker_errors(trials, cases(imus=(8,), segments=()))
        means = over_draws(table)
        assert set(means["evaluation"]) == set(EVALUATIONS)
        assert (means["draws"] == 2).all()
        pairs = table.groupby(["case", "evaluation", "marker"], sort=False)["median_mm"]
        np.testing.assert_allclose(means["median_mm"], pairs.mean())
        np.testing.assert_allclose(
            means["median_mm_std"], pairs.apply(lambda x: abs(np.diff(x)[0]) / np.sqrt(2))
        )


class TestTruth:
    def test_truth_is_what_perfect_motion_capture_saw(self, arm):
        one = draw(arm, 3, errors=PERFECT)
        seen = one.trial.points - one.truth(arm, one.trial.point_arcs_m)
        # Noise of 1 mm per axis, interpolated, and a delay known to a millisecond.
        assert np.sqrt((seen**2).mean()) < 1.2e-3
        np.testing.assert_allclose(seen.mean(axis=0), 0, atol=3e-4)

    def test_frame_is_drawn_as_given(self, arm):
        exact = draw(arm, 0, errors=PERFECT, origin_m=0.0, heading_rad=0.0).capture
        assert exact == MotionCapture(origin_m=(0.0, 0.0, 0.0), heading_rad=0.0)
        first, second = (
            draw(arm, 0, errors=PERFECT, origin_m=s, heading_rad=s).capture for s in (0.01, 0.02)
        )
        np.testing.assert_allclose(second.origin_m, 2 * np.array(first.origin_m))
        assert second.heading_rad == pytest.approx(2 * first.heading_rad)

    def test_same_seed_same_bits(self, arm):
        np.testing.assert_array_equal(draw(arm, 1).trial.orientations, draw(arm, 1).trial.orientations)


def test_errors_along_the_arm_meet_those_of_the_markers(arm, perfect):
    along = errors_along(arm, [perfect], every=1)
    direct = distances_mm(perfect.trial, selection("pcc", 8))
    own = along[(along["model"] == PCC_16) & (along["mode"] == "all")].set_index("arc_mm")["median_mm"]
    # The points differ by the interpolation of motion capture and the delay found.
    np.testing.assert_allclose(own.loc[[360.0, 600.0]], np.median(direct, axis=0), atol=0.3)
    assert set(along["mode"]) == {"all", "oscillating"}
    assert along.loc[along["model"] == "IMUs at mid-section", "arc_mm"].max() == 600


def test_hull_is_the_arm_with_the_third_quartile(arm, perfect):
    along = errors_along(arm, [perfect], every=8)
    table = hull(arm, perfect, along)
    assert list(table["mode"].unique()) == ["oscillating"]
    own = along[(along["model"] == PCC_16) & (along["mode"] == "all")]
    np.testing.assert_array_equal(table["radius_mm"], own["q75_mm"])
    steps = np.diff(table[["x_mm", "y_mm", "z_mm"]].to_numpy(), axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 40, atol=1.5)


def test_mid_section_is_the_chain_of_the_released_table():
    made = mid_section()
    np.testing.assert_allclose(np.cumsum(made.link_lengths), 0.12 + 0.08 * np.arange(7))
    assert made.markers == MARKERS


def test_one_factor_at_a_time(arm):
    table = differences(arm, ImuErrors()).set_index(["sensors", "evaluation"])
    same = table.loc[("perfect", SAME_POINT)]
    files = table.loc[("perfect", FILES)]
    # What is printed as a difference of models is, with perfect sensors, mostly one of the points evaluated.
    assert files["rigid_M1_percent"] > 3 * same["rigid_M1_percent"]
    assert files["pcc_M1_percent"] == same["pcc_M1_percent"]
    expected = 100 * (1 - table["pcc_M2_percent"] / table["rigid_M2_percent"])
    np.testing.assert_allclose(table["reduction_M2_percent"], expected)


def test_unknown_angle():
    message = r"Input angles_deg of errors_with must be among mounting, .*; instead received yaw\."
    with pytest.raises(InputError, match=message):
        errors_with({"yaw": 1.0})
    assert errors_with({}) == ImuErrors()
