"""Table I in its three readings."""

from dataclasses import replace

import numpy as np
import pytest

from repro.errors import InputError
from repro.estimation.imu_selection import IMU_ARCS, MARKERS, READINGS, Selection, selection

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
        total = {("rigid", "files", 8): 0.56, ("pcc", "files", 8): 0.635}
        key = ("rigid" if found is rigid else "pcc", reading, imus)
        assert sum(found.link_lengths) == pytest.approx(total.get(key, 0.64))
    if reading != "files":
        assert rigid.markers == pcc.markers == MARKERS == (0.36, 0.6)
        assert rigid.sub_links == 0
        np.testing.assert_allclose(rigid.link_lengths, 0.64 / imus)
        np.testing.assert_allclose(pcc.link_lengths, np.diff(pcc.arcs))


def test_released_points():
    below = [selection("rigid", n, "files").markers for n in (2, 4, 8)]
    below += [selection("pcc", n, "files").markers for n in (2, 4)]
    below += [selection("pcc", 8, "files", segments=8).markers]
    assert set(below) == {(0.32, 0.56)}
    assert selection("rigid", 8, "files") == selection("pcc", 8, "files", segments=8)
    for segments in (16, 32, 64):
        found = selection("pcc", 8, "files", segments=segments)
        assert (found.markers, found.sub_links) == ((0.355, 0.595), segments // 8)
        assert found.link_lengths == (0.075, *[0.08] * 7)


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
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
