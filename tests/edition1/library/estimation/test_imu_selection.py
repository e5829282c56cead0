"""Table I in its three readings."""

from dataclasses import replace

import numpy as np
import pytest

from edition1.errors import InputError
from edition1.estimation.imu_selection import Selection
from edition1_companion.recordings.martin2022_models import IMU_ARCS, MARKERS, READINGS, selection

ALL = tuple(range(9))


@pytest.mark.parametrize(
    ("model", "imus", "reading", "expected"),
    [
        ("rigid", 2, "table", (2, 6)),
        ("rigid", 4, "table", (2, 4, 6, 8)),
        ("rigid", 8, "table", ALL[1:]),
        ("rigid", 2, "text", (2, 6)),
        ("rigid", 4, "text", (1, 3, 5, 7)),
        ("rigid", 8, "text", ALL[1:]),
        ("rigid", 2, "files", (1, 6)),
        ("rigid", 4, "files", (1, 3, 5, 7)),
        ("rigid", 8, "files", ALL[:8]),
        ("pcc", 2, "table", (0, 4, 8)),
        ("pcc", 4, "text", (0, 2, 4, 6, 8)),
        ("pcc", 8, "files", ALL),
    ],
)
def test_imus(model, imus, reading, expected):
    assert selection(model, imus, reading).imus == expected


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("imus", [2, 4, 8])
def test_links(imus, reading):
    rigid, pcc = selection("rigid", imus, reading), selection("pcc", imus, reading)
    assert pcc.sub_links * len(pcc.link_lengths) == 16
    for found in (rigid, pcc):
        assert found.arcs == tuple(IMU_ARCS[imu] for imu in found.imus)
        first = np.sum(found.link_lengths) + found.origin_m[2]
        short = {("rigid", 8): 0.0852, ("pcc", 8): 0.0052, ("rigid", 2): 0.0002, ("rigid", 4): 0.0002}
        key = ("rigid" if found is rigid else "pcc", imus)
        assert first == pytest.approx(0.64 - (short.get(key, 0.0) if reading == "files" else 0.0))
    if reading != "files":
        assert rigid.markers == pcc.markers == MARKERS == (0.36, 0.6)
        assert rigid.sub_links == 0
        np.testing.assert_allclose(rigid.link_lengths, 0.64 / imus)
        np.testing.assert_allclose(pcc.link_lengths, np.diff(pcc.arcs))


def test_released_points():
    """Points from the base: 40 mm below the markers but where Table II takes the PCC-extended model."""
    made = {
        ("rigid", 2): (319.8, 559.8), ("rigid", 4): (319.8, 559.8), ("rigid", 8): (314.8, 554.8),
        ("pcc", 2): (320, 560), ("pcc", 4): (320, 560), ("pcc", 8): (354.8, 594.8),
    }  # fmt: skip
    for (model, imus), points_mm in made.items():
        found = selection(model, imus, "files")
        np.testing.assert_allclose(1e3 * (np.array(found.markers) + found.origin_m[2]), points_mm, atol=1e-9)
        assert found.origin_m == (0, 0, 0.0178)
        assert found.base_turn == ((0, 0, 1, 0) if found.imus[0] == 0 else (0, 0, 0, 1))
    assert selection("rigid", 8, "files") == selection("pcc", 8, "files", segments=8)
    for segments in (16, 32, 64):
        found = selection("pcc", 8, "files", segments=segments)
        assert (found.markers, found.sub_links) == ((0.337, 0.577), segments // 8)
        assert found.link_lengths == (0.057, *[0.08] * 7)
        assert found.interpolation == "inner points"
        assert selection("pcc", 4, "files").interpolation == "midpoints"


def test_base_is_turned_where_it_is_picked():
    q = np.tile([0.0, 0.0, 0.0, 1.0], (2, 9, 1))
    made = selection("pcc", 4, "files")
    picked = made.of(q)
    np.testing.assert_array_equal(picked[:, 0], [[0, 0, 1, 0]] * 2)
    np.testing.assert_array_equal(picked[:, 1:], q[:, :4])
    np.testing.assert_array_equal(q[:, 0], [[0, 0, 0, 1]] * 2)
    np.testing.assert_array_equal(selection("rigid", 4, "files").of(q), q[:, :4])
    quarter = replace(made, base_turn=(0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)))
    q[:, 0] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]  # z axis along -y; turned about it, x axis along z
    np.testing.assert_allclose(quarter.of(q)[:, 0], [[0.5, -0.5, 0.5, 0.5]] * 2, atol=1e-15)


def test_picks_orientations_in_order():
    q = np.arange(2.0 * 9 * 4).reshape(2, 9, 4)
    np.testing.assert_array_equal(selection("pcc", 4).of(q), q[:, ::2])
    message = r"^Input orientations of Selection must be those of the base and IMUs #1 to #8 at least; .* \(2, 8, 4\)"
    with pytest.raises(InputError, match=message):
        selection("pcc", 4).of(q[:, :8])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: selection("soft", 8),
            'Input model of selection must be "rigid" or "pcc"; instead received soft.',
        ),
        (lambda: selection("pcc", 3), "Input n_imus of selection must be 2, 4 or 8; instead received 3."),
        (
            lambda: selection("pcc", 8, "figure"),
            'Input reading of selection must be one of "table", "text" and "files"; instead received figure.',
        ),
        (
            lambda: selection("rigid", 8, segments=16),
            "Input segments of selection must be left out for the rigid-body model; instead received 16.",
        ),
        (
            lambda: selection("pcc", 8, segments=12),
            r"Input segments of selection must be a multiple of 8 \(one link per IMU\); instead received 12.",
        ),
        (lambda: selection("pcc", 4, segments=0), "must be a multiple of 4"),
        (
            lambda: selection("pcc", 4, "files", segments=8),
            r"Input segments of selection must be one of those released, \(16,\); instead received 8.",
        ),
        (lambda: Selection((), (), ()), "Input arcs of Selection must be one per IMU, 0 in all"),
        (lambda: Selection((1, 2), (0.08,), (0.1, 0.1)), "one per IMU, 2 in all"),
        (lambda: Selection((1, 2), (0.08, 0.08), (0.1, 0.1)), r"must be increasing from 0 or above \[m\]"),
        (lambda: Selection((1,), (-0.1,), (0.1,)), "increasing from 0"),
        (lambda: Selection((1,), (np.nan,), (0.1,)), "increasing from 0"),
        (
            lambda: Selection((1, 2), (0.08, 0.16), (0.1,)),
            "link_lengths of Selection must be one per link, 2 in all",
        ),
        (lambda: Selection((0,), (0.0,), (), sub_links=1), "one per link, 0 in all"),
        (lambda: Selection((1,), (0.08,), (0.0,)), r"link_lengths of Selection must be positive \[m\]"),
        (lambda: Selection((1,), (0.08,), (np.inf,)), "positive"),
        (
            lambda: replace(selection("pcc", 8), sub_links=-1),
            r"sub_links of Selection must be 0 \(rigid-body model\) or above; instead received -1",
        ),
        (
            lambda: replace(selection("pcc", 8), interpolation="ends"),
            'interpolation of Selection must be "midpoints" or "inner points"; instead received ends',
        ),
        (
            lambda: replace(selection("pcc", 8), base_turn=(0.0, 0.0, 1.0, 1.0)),
            r"base_turn of Selection must be a unit quaternion XYZW; instead received \(0.0, 0.0, 1.0, 1.0\)",
        ),
        (lambda: replace(selection("pcc", 8), base_turn=(0.0, 0.0, np.nan, 0.0)), "a unit quaternion XYZW"),
        (
            lambda: replace(selection("pcc", 8), origin_m=(0.0, np.inf, 0.0)),
            "origin_m of Selection must be three",
        ),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
