"""Calibration: known errors found again, its uncertainty against Monte Carlo, what a segment leaves open."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from smooth_curves import read, smooth_curves

from edition1.errors import InputError
from edition1.estimation.imu_calibration import ImuTolerances, calibrate_imus, calibrated
from edition1.estimation.imu_models import exact_arcs, rigid_links, tangent_spline
from edition1.estimation.imu_selection import Selection
from edition1.estimation.orientations import exponential, product
from edition1.estimation.undetermined import undetermined
from edition1_companion.recordings.martin2022_models import selection

ARM = selection("pcc", 8)
FRAME = Rotation.from_euler("xyz", [3.0, -4.0, 12.0], degrees=True)
OFFSET = np.array([0.006, -0.014, -0.034])


def measured(count, *, seed=0, per_imu=True, arm=ARM, noise_m=0.0):
    """Orientations of a model arm with known headings and mountings, and markers that this model predicts."""
    rng = np.random.default_rng(seed)
    q = read(smooth_curves(count, seed=6)[0], arm)
    heading, mounting = np.zeros((len(arm.imus), 3)), np.zeros((len(arm.imus), 3))
    if per_imu:
        heading[1:, 2] = math.radians(6.0) * rng.normal(size=len(arm.imus) - 1)
        mounting[1:, :2] = math.radians(3.0) * rng.normal(size=(len(arm.imus) - 1, 2))
    raw = product(product(exponential(-heading), q), exponential(-mounting))
    markers = exact_arcs(q, arm, arm.markers)
    markers = FRAME.apply(markers.reshape(-1, 3)).reshape(markers.shape) + OFFSET
    truth = np.concatenate([heading[:, 2:], mounting[:, :2]], axis=1)
    return raw, markers + noise_m * rng.normal(size=markers.shape), truth


def distances_mm(raw, markers, found, model=exact_arcs):
    positions = model(calibrated(raw, found), ARM, ARM.markers) + found.translation_m
    return 1e3 * np.linalg.norm(positions - markers, axis=-1)


def test_frame_alone_is_found_exactly():
    raw, markers, _ = measured(10, per_imu=False)
    found = calibrate_imus(raw, markers, exact_arcs, ARM, per_imu=False, noise_m=1e-6)
    assert found.names[:4] == ("rotation_x", "rotation_y", "rotation_z", "translation_x")
    np.testing.assert_allclose(found.estimate[:3], FRAME.as_rotvec(), atol=1e-7)
    np.testing.assert_allclose(found.translation_m, OFFSET, atol=1e-7)
    assert (found.samples, found.dropped) == (20, 0)
    assert found.rms_m < 1e-7


def test_twenty_seven_parameters_are_found_in_noise_free_data():
    raw, markers, truth = measured(60)
    found = calibrate_imus(raw, markers, exact_arcs, ARM, noise_m=1e-5)
    assert len(found.names) == 27
    assert found.names[6:9] == ("heading_1", "mounting_x_1", "mounting_y_1")
    assert found.names[-1] == "mounting_y_7"  # #8 is beyond M2
    assert found.rms_m < 1e-3  # M2 depends a little on #8
    held_out, there, _ = measured(80)
    assert distances_mm(held_out[60:], there[60:], found).max() < 3.0
    assert found.undetermined(0.99) == []
    # Nearly nothing tells a common heading from a rotation of the frame about z.
    common = found.estimate[2] - FRAME.as_rotvec()[2]
    np.testing.assert_allclose(found.estimate[6::3] + common, truth[1:8, 0], atol=math.radians(3.0))


def test_calibration_lowers_the_error_of_held_out_samples_step_by_step():
    raw, markers, _ = measured(100, noise_m=1e-3)
    fit, test = slice(0, 60), slice(60, None)
    frame, full = (
        calibrate_imus(raw[fit], markers[fit], tangent_spline, ARM, per_imu=per_imu, noise_m=3e-3)
        for per_imu in (False, True)
    )
    none = 1e3 * np.linalg.norm(tangent_spline(raw[test], ARM, ARM.markers) - markers[test], axis=-1)
    before, some, all_of_it = (
        np.median(x, axis=0)
        for x in (
            none,
            distances_mm(raw[test], markers[test], frame, tangent_spline),
            distances_mm(raw[test], markers[test], full, tangent_spline),
        )
    )
    assert (some < before / 3).all()
    assert (all_of_it < some / 2).all()


def test_deviation_is_what_estimates_scatter_around_the_truth():
    """Truth drawn from the prior, noise as stated: the whitened errors have unit covariance."""
    arm = Selection((0, 4, 8), (0.0, 0.32, 0.64), (0.32, 0.32), (0.36, 0.6), sub_links=1)
    tolerances = ImuTolerances(math.radians(3.0), 0.02, math.radians(4.0), math.radians(2.0))
    scale = np.array([math.radians(3.0)] * 3 + [0.02] * 3 + [math.radians(4.0)] + [math.radians(2.0)] * 2)
    q = read(smooth_curves(15, seed=7)[0], arm)
    rng, whitened = np.random.default_rng(8), []
    for _ in range(24):
        z = rng.normal(size=9) * scale
        heading, mounting = np.zeros((3, 3)), np.zeros((3, 3))
        heading[1, 2], mounting[1, :2] = z[6], z[7:]
        raw = product(product(exponential(-heading), q), exponential(-mounting))
        markers = exact_arcs(q, arm, arm.markers)
        markers = Rotation.from_rotvec(z[:3]).apply(markers.reshape(-1, 3)).reshape(markers.shape) + z[3:6]
        markers = markers + 0.01 * rng.normal(size=markers.shape)
        found = calibrate_imus(raw, markers, exact_arcs, arm, noise_m=0.01, tolerances=tolerances)
        np.testing.assert_allclose(found.deviation, np.sqrt(np.diag(found.covariance)) * scale)
        error = (found.estimate - z) / scale
        whitened.append(np.linalg.solve(np.linalg.cholesky(found.covariance), error))
    assert 0.75 < np.mean(np.square(whitened)) < 1.25  # 216 squares: standard deviation 0.096


def test_directions_that_a_segment_does_not_determine_are_named():
    """On an arm that stays upright a heading moves nothing."""
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (30, 9, 1))
    markers = exact_arcs(upright, ARM, ARM.markers)
    found = calibrate_imus(upright, markers, exact_arcs, ARM, noise_m=1e-3)
    named = " ".join(found.undetermined(0.98))
    for imu in range(1, 8):
        assert f"heading_{imu}" in named
    assert "rotation_z" in named
    assert "translation_z" not in named
    np.testing.assert_allclose(found.estimate, 0.0, atol=1e-9)


def test_undetermined_combinations_in_words():
    names = ["a", "b", "c"]
    mixed = np.eye(3) - 0.99 * np.outer([0.0, 1.0, 1.0], [0.0, 1.0, 1.0]) / 2
    assert undetermined(names, mixed) == [
        "+1.00 a (uncertainty 1.00 of the prior)",
        "+0.71 b -0.71 c (uncertainty 1.00 of the prior)",
    ]
    assert undetermined(names, 0.1 * np.eye(3)) == []


def test_markers_that_were_not_seen_are_left_out_and_counted():
    raw, markers, _ = measured(12, noise_m=1e-3)
    markers[3:8, 1] = np.nan
    markers[10, 0, 2] = np.nan
    found = calibrate_imus(raw, markers, exact_arcs, ARM, noise_m=3e-3)
    assert (found.samples, found.dropped) == (18, 6)
    other = markers.copy()
    other[10, 0] = np.nan
    again = calibrate_imus(raw, other, exact_arcs, ARM, noise_m=3e-3)
    np.testing.assert_array_equal(again.estimate, found.estimate)


def test_rigid_links_are_calibrated_too():
    arm = selection("rigid", 8)
    frames, points, _, _ = smooth_curves(20, seed=6)
    found = calibrate_imus(read(frames, arm), points[:, [720, 1200]], rigid_links, arm, noise_m=0.01)
    before = np.linalg.norm(
        rigid_links(read(frames, arm), arm, arm.markers) - points[:, [720, 1200]], axis=-1
    )
    assert found.rms_m < 0.5 * np.sqrt((before**2).mean())


def test_calibrated_with_nothing_to_correct_changes_nothing():
    raw, _, _ = measured(3, per_imu=False)
    found = calibrate_imus(raw, exact_arcs(raw, ARM, ARM.markers), exact_arcs, ARM)
    np.testing.assert_allclose(np.abs((calibrated(raw, found) * raw).sum(-1)), 1.0, atol=1e-12)
    with pytest.raises(
        InputError, match=r"orientations of calibrated must be those of the 9 IMUs of the cal.* 8, 4\)"
    ):
        calibrated(raw[:, 1:], found)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"markers": np.zeros((5, 1, 3))},
            r"must be of shape \(5, 2, 3\), as there are orientations and markers",
        ),
        ({"markers": np.zeros((4, 2, 3))}, r"Input markers of calibrate_imus must be of shape \(5, 2, 3\)"),
        (
            {"markers": np.full((5, 2, 3), np.inf)},
            "markers of calibrate_imus must be finite, or NaN where not seen",
        ),
        ({"markers": np.full((5, 2, 3), np.nan)}, "must be at least two positions that were seen; .* 0"),
        ({"noise_m": 0.0}, r"noise_m of calibrate_imus must be positive \[m\]; instead received 0\.0"),
        ({"q": np.full((5, 9, 4), np.nan)}, "orientations of calibrate_imus must be finite unit quaternions"),
        (
            {"q": np.tile([0.0, 0.0, 0.0, 1.0], (5, 8, 1))},
            "orientations of calibrate_imus must be those of the 9 IMUs of the selection",
        ),
    ],
)
def test_bad_input(change, message):
    given = {
        "q": np.tile([0.0, 0.0, 0.0, 1.0], (5, 9, 1)),
        "markers": np.zeros((5, 2, 3)),
        "noise_m": 0.01,
    } | change
    with pytest.raises(InputError, match=message):
        calibrate_imus(given["q"], given["markers"], exact_arcs, ARM, noise_m=given["noise_m"])


@pytest.mark.parametrize("name", ["rotation_rad", "translation_m", "heading_rad", "mounting_rad"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_tolerances_must_be_positive(name, value):
    with pytest.raises(InputError, match=f"Input {name} of ImuTolerances must be positive; instead received"):
        ImuTolerances(**{name: value})
