"""The rules of the scorecard, at their boundaries."""

from __future__ import annotations

from fractions import Fraction

import pytest

from edition1_companion.book.verdicts import Verdict, half_printed_unit, is_weak, verdict


@pytest.mark.parametrize(
    ("printed", "half"),
    [
        ("0.015", Fraction(1, 2000)),
        ("9.90", Fraction(1, 200)),
        ("60", Fraction(1, 2)),
        ("1080", Fraction(1, 2)),
        ("1.5e-3", Fraction(1, 20000)),
    ],
)
def test_half_printed_unit(printed, half):
    assert half_printed_unit(printed) == half


@pytest.mark.parametrize(
    ("published", "published_std", "regenerated", "regenerated_std", "expected"),
    [
        # half a printed unit, its edge included; 0.0155 - 0.015 > 0.0005 in floating point
        ("0.015", "", "0.0155", "", "reproduced"),
        ("0.015", "", "0.01550001", "", "differs"),
        ("0.015", "", "0.0145", "", "reproduced"),
        ("0.015", "", "0.01449999", "", "better"),
        # trailing zeros make a number more exact
        ("9.90", "", "9.905", "", "reproduced"),
        ("9.90", "", "9.94", "", "differs"),
        ("9.9", "", "9.94", "", "reproduced"),
        # stds: 3 sqrt((1 + 2)/3) = 3 is met exactly with variances 1 and 2, and with 3 = 1.5^2 + 0.75
        ("10", "1", "13", "1.414213563", "reproduced"),
        ("10", "1", "13", "1.414213562", "differs"),
        ("10.0", "0.6", "11.8", "0.8485281375", "reproduced"),
        # a missing std counts as 0: the band is 3 s/sqrt(3) = 1.7320508...
        ("10.0", "1", "11.7320508", "", "reproduced"),
        ("10.0", "1", "11.7320509", "", "differs"),
        ("10.0", "", "11.7320508", "1", "reproduced"),
        ("10.0", "", "11.7320508", "0", "differs"),
        # the wider of the two bands counts
        ("10", "0.01", "10.5", "0.01", "reproduced"),
        # nothing computed
        ("10", "1", "", "", "missing"),
    ],
)
def test_verdicts_of_errors(published, published_std, regenerated, regenerated_std, expected):
    assert verdict("e_u", published, published_std, regenerated, regenerated_std) == expected


@pytest.mark.parametrize("quantity", ["update_rate", "reduction"])
@pytest.mark.parametrize(
    ("regenerated", "expected"), [("70", "better"), ("50", "differs"), ("60.5", "reproduced")]
)
def test_more_is_better_for_some_quantities(quantity, regenerated, expected):
    assert verdict(quantity, "60", "", regenerated, "") == expected


def test_not_comparable():
    assert verdict("e_u", "1.0", "", "1.0", "", comparable=False) is Verdict.NOT_COMPARABLE
    assert verdict("time", "1080", "", "12", "", setting="benchmark") is Verdict.NOT_COMPARABLE
    assert verdict("e_u", "1.0", "", "", "", comparable=False) is Verdict.MISSING


@pytest.mark.parametrize(
    ("published", "published_std", "regenerated_std", "weak"),
    [
        ("1.0", "0.5", "", False),
        ("1.0", "0.58", "", True),
        ("1.0", "", "0.58", True),
        ("0.001", "0.001", "", True),
        # half a unit reaches zero only for a number of one half unit, which nobody prints
        ("1", "", "", False),
        ("0", "", "", True),
    ],
)
def test_weak_rows(published, published_std, regenerated_std, weak):
    assert is_weak(published, published_std, regenerated_std) is weak


def test_words():
    assert [each.words for each in Verdict] == [
        "reproduced",
        "better",
        "differs",
        "not comparable",
        "missing",
    ]
