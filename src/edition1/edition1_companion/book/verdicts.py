"""The rules by which a regenerated number is compared with a printed one.

Let d be the difference, s_pub and s_reg the standard deviations over three seeds (0 where missing) and h half
a unit of the last printed digit. The band is max(3 sqrt((s_pub^2 + s_reg^2)/3), h); its edge belongs to it.
The arithmetic is exact (fractions of the printed decimals), so that a difference of 0.0005 is not outside a
band of 0.0005 by rounding.
"""

from __future__ import annotations

import enum
from decimal import Decimal
from fractions import Fraction

HIGHER_IS_BETTER = frozenset({"update_rate", "reduction"})
"""Quantities of which more is better; of all others, less."""

TIMING_SETTING = "benchmark"
"""Setting of rows that are timings: they depend on the computer and are never compared."""


class Verdict(enum.StrEnum):
    """What a comparison came to."""

    REPRODUCED = "reproduced"
    BETTER = "better"
    DIFFERS = "differs"
    NOT_COMPARABLE = "not_comparable"
    MISSING = "missing"

    @property
    def words(self) -> str:
        """The verdict as it is read."""
        return self.value.replace("_", " ")


HOLDS = frozenset({Verdict.REPRODUCED, Verdict.BETTER})
"""Verdicts by which a printed number holds."""

NEAR_EDGE = Fraction(1, 20)
"""Within this share of its band's edge a difference is near it: rounding or another machine may decide."""


def half_printed_unit(printed: str) -> Fraction:
    """Return half a unit of the last printed digit.

    Examples
    --------
    >>> half_printed_unit("9.90"), half_printed_unit("60")
    (Fraction(1, 200), Fraction(1, 2))
    """
    exponent = Decimal(printed).as_tuple().exponent
    # is_number has already refused NaN and infinity, whose exponents are letters.
    return Fraction(10) ** int(exponent) / 2


def within_band(difference: Fraction, printed: str, printed_std: str, regenerated_std: str) -> bool:
    """Return whether a difference lies within the band of a printed number.

    Parameters
    ----------
    difference
        Any sign; in the unit of the printed number, as all arguments.
    printed
        The number as printed.
    printed_std, regenerated_std
        Standard deviations; empty texts count as 0.
    """
    variance = Fraction(printed_std or 0) ** 2 + Fraction(regenerated_std or 0) ** 2
    # (3 sqrt(v/3))^2 = 3 v: compared as squares, nothing is rounded.
    return abs(difference) <= half_printed_unit(printed) or difference**2 <= 3 * variance


def band(printed: str, printed_std: str, regenerated_std: str) -> float:
    """Return how far from a printed number a regenerated one may be; for pictures, rounded as floats are.

    Examples
    --------
    >>> band("1.7", "", ""), band("1.0", "0.3", "0.4")
    (0.05, 0.8660254037844386)
    """
    variance = float(printed_std or 0) ** 2 + float(regenerated_std or 0) ** 2
    return max((3 * variance) ** 0.5, float(half_printed_unit(printed)))


def verdict(
    quantity: str,
    published: str,
    published_std: str,
    regenerated: str,
    regenerated_std: str,
    *,
    setting: str = "",
    comparable: bool = True,
) -> Verdict:
    """Return the verdict on one number.

    Parameters
    ----------
    quantity
        Name of the quantity; decides which side is better.
    published, published_std
        As printed; the standard deviation may be empty.
    regenerated, regenerated_std
        As computed; an empty number is missing, an empty standard deviation counts as 0.
    setting
        Where the number comes from; ``benchmark`` marks timings.
    comparable
        False where the published number came from hardware and the data are synthetic, or is a slip in print.

    Examples
    --------
    >>> verdict("e_u", "0.015", "", "0.0155", "").words
    'reproduced'
    """
    if not regenerated:
        return Verdict.MISSING
    if not comparable or setting == TIMING_SETTING:
        return Verdict.NOT_COMPARABLE
    difference = Fraction(regenerated) - Fraction(published)
    if within_band(difference, published, published_std, regenerated_std):
        return Verdict.REPRODUCED
    return Verdict.BETTER if (difference > 0) == (quantity in HIGHER_IS_BETTER) else Verdict.DIFFERS


def is_near_edge(published: str, published_std: str, regenerated: str, regenerated_std: str) -> bool:
    """Return whether a number lies within 5 % of the edge of its band, on either side.

    Examples
    --------
    >>> is_near_edge("1.0", "0.3", "1.85", "0.4"), is_near_edge("1.0", "0.3", "1.6", "0.4")  # the edge is 1.866
    (True, False)
    """
    difference = Fraction(regenerated) - Fraction(published)
    inner, outer = (
        within_band(difference / x, published, published_std, regenerated_std)
        for x in (1 - NEAR_EDGE, 1 + NEAR_EDGE)
    )
    return outer and not inner


def is_weak(published: str, published_std: str, regenerated_std: str) -> bool:
    """Return whether an error of zero would also pass: the band reaches from the printed number to zero."""
    return within_band(Fraction(published), published, published_std, regenerated_std)
