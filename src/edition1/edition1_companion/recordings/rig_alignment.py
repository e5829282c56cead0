"""Alignment of readings and motion capture of the rig of Baaij et al. 2023, section 5.2: they have no common trigger.

Each shows the first inflation, and the two starts are put together. Whether they are the same instant is then
checked: readings are a smooth function of the bend, so at the right lag such a function explains them best.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from edition1.errors import bad_input, require
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ

START_M, START_MV = 0.2e-3, 1.0
"""Inflation has begun where the elongation and the readings (root mean square) have changed by more [m, mV]."""
REST_ROWS = 10
"""Readings at rest at the beginning of a recording, 0.25 s: their median and their noise are those at rest."""
NOISE_TIMES = 6.0
"""Changes up to so many times the noise at rest are no start."""
RULES = ("noise", "released")
"""How the start of the readings is found, see :func:`start_of_readings`."""
SEARCH_S = 3.0
"""Lags are tried up to this much in either direction [s], or a quarter of the recording."""
NEAR_S, FAR_S = 0.125, 0.5
"""Lags from which on an alignment can be doubted (the magnet follows the tip a little late), and refused [s]."""
DOUBTED, REFUSED = 1.5, 2.0
"""By how much another lag divides the residual where the alignment is doubted, and refused."""
EXPLAINED = 0.5
"""Residual, as a share of the spread of the readings, above which they do not follow the motion."""
RESOLVED_MV = 0.02
"""Smaller residuals are taken for this: the converter's steps of 1/16 mV leave as much."""
CHECKED_FRAMES = 4000
"""Frames, evenly spread over the recording, on which lags are compared."""


def start_of_motion(q: Float[np.ndarray, "frames 3"], owner: str) -> int:
    """First frame in which the elongation differs from that of frame 0 by more than 0.2 mm.

    Raises
    ------
    InputError
        If there is none.
    """
    return _first(
        np.abs(q[:, 2] - q[0, 2]) > START_M, owner, f"an elongation that changes by {1e3 * START_M:g} mm"
    )


def noise_at_rest(u: Float[np.ndarray, "rows 3"]) -> float:
    """Standard deviation of the noise [mV] of one reading in the first 0.25 s, from the differences of neighbours.

    Examples
    --------
    >>> found = [noise_at_rest(np.random.default_rng(k).normal(1200.0, 0.4, (40, 3))) for k in range(100)]
    >>> round(float(np.mean(found)), 1)
    0.4
    """
    apart = np.diff(u[:REST_ROWS], axis=0)
    return float(np.sqrt((apart**2).mean() / 2.0)) if apart.size else 0.0


def start_of_readings(u: Float[np.ndarray, "rows 3"], owner: str, *, rule: str = "noise") -> int:
    """First row in which the readings have changed (root mean square over the sensors).

    Parameters
    ----------
    u
        Readings [mV] at 40 Hz.
    owner
        Name of the recording, for messages.
    rule
        ``"noise"``: by more than six times the noise at rest, at least 1 mV, from the median of the first ten rows;
        rows right before that differ by half as much, and 1 mV, count.
        ``"released"``: by more than 1 mV from row 0, as in the released code; from noise of 0.3 mV on it often
        finds a start where nothing moves.

    Raises
    ------
    InputError
        If there is none; an unknown rule; or, by the rule ``"noise"``, readings that move within the first ten
        rows.
    """
    if rule == "released":
        return _first(_rms(u - u[0]) > START_MV, owner, f"readings that change by {START_MV:g} mV")
    require(rule == "noise", "rule", "start_of_readings", f"one of {', '.join(map(repr, RULES))}", repr(rule))
    limit = max(START_MV, NOISE_TIMES * noise_at_rest(u))
    rest, half = np.median(u[:REST_ROWS], axis=0), REST_ROWS // 2
    moved = _rms(np.median(u[half:REST_ROWS], axis=0) - np.median(u[:half], axis=0))
    if len(u) < REST_ROWS or moved > limit / 2 or _rms(u[REST_ROWS - 1] - rest) > limit:
        expected = f"at rest in their first {REST_ROWS} rows ({REST_ROWS / RIG_RATE_HZ:g} s)"
        raise bad_input(
            "readings", owner, expected, f"a change of {moved:.3g} mV between the halves of these"
        )
    change = _rms(u - rest)
    still = np.arange(len(u)) < REST_ROWS  # one row that is off, as the first of a converter, is no start
    start = _first((change > limit) & ~still, owner, f"readings that change by {limit:.3g} mV")
    # The limit is passed a row or two after the start: rows just before it that are clear of the noise belong to it.
    while start > REST_ROWS and change[start - 1] > max(START_MV, limit / 2):
        start -= 1
    return start


def _rms(x: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt((x**2).mean(axis=-1)))


def _first(found: np.ndarray, owner: str, what: str) -> int:
    require(found.any(), "start", owner, what, "none that does")
    return int(np.argmax(found))


@dataclass(frozen=True)
class LagCheck:
    """How well readings follow the motion as aligned, and at the best of other lags.

    Attributes
    ----------
    best_s
        How much later the readings are to be taken for the least residual [s].
    residual_mv, best_mv
        Root mean square of what a quadratic function of the configuration leaves of them, as aligned and at the best
        lag.
    spread_mv
        Root mean square of the readings about their means.
    at_edge
        Whether the best lag is the last one tried.
    """

    best_s: float
    residual_mv: float
    best_mv: float
    spread_mv: float
    at_edge: bool

    @property
    def gain(self) -> float:
        """By how much the best lag divides the residual."""
        return max(self.residual_mv, RESOLVED_MV) / max(self.best_mv, RESOLVED_MV)


def check_lags(q: Float[np.ndarray, "frames 3"], u: Float[np.ndarray, "frames 3"]) -> LagCheck | None:
    """Compare the residual of aligned readings over lags; None for less than 2 s, which say little.

    At each lag the readings of each sensor are fitted by a quadratic function of the bend that is linear in the
    elongation. On a path that such a function can turn into itself later, as an ellipse at an even pace, every lag
    fits alike, and nothing is found.

    Parameters
    ----------
    q
        Configurations [m] at 40 Hz.
    u
        Readings [mV] of the same frames.

    Examples
    --------
    A reading that is taken half a second too early:

    >>> t = np.arange(2400) / 40
    >>> x, y = np.sin(t), np.sin(2 * t + 0.3)
    >>> q = np.stack([5e-3 * x, 8e-3 * y, 5e-3 + 0 * t], axis=-1)
    >>> late = np.roll(30 * q @ np.array([[1e3, 0, 500], [0, 1e3, 800], [0, 0, 0]]), 20, axis=0)
    >>> check_lags(q[40:-40], late[40:-40]).best_s
    0.5
    """
    frames, reach = len(q), min(round(SEARCH_S * RIG_RATE_HZ), len(q) // 4)
    if frames < 2 * RIG_RATE_HZ:
        return None
    # A column for each frame in the middle; at the ends other lags would have none.
    chosen = np.unique(np.linspace(reach, frames - 1 - reach, CHECKED_FRAMES).astype(int))
    x, y, longer = 1e3 * (q[chosen] - q[chosen].mean(axis=0)).T
    columns, _ = np.linalg.qr(np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y, longer]))
    level = u.mean(axis=0)

    def residual(lag: int) -> float:
        apart = u[chosen + lag] - level
        left = (apart**2).sum() - ((columns.T @ apart) ** 2).sum()
        return float(np.sqrt(max(left, 0.0) / apart.size))

    lags = np.arange(-reach, reach + 1)
    found = np.array([residual(int(lag)) for lag in lags])
    best = int(np.argmin(found))
    spread = float(np.sqrt(((u[chosen] - level) ** 2).mean()))
    edge = best in (0, len(lags) - 1)
    return LagCheck(float(lags[best] / RIG_RATE_HZ), float(found[reach]), float(found[best]), spread, edge)


def doubts(check: LagCheck | None, owner: str, *, refuse: bool) -> list[str]:
    """Say what speaks against an alignment, in sentences; nothing where it is good.

    Parameters
    ----------
    check
        From :func:`check_lags`.
    owner
        Name of the recording.
    refuse
        Raise where another lag, half a second away or more, halves the residual.

    Raises
    ------
    InputError
        If the alignment is refused.
    """
    if check is None:
        return [f"{owner}: too short to check how readings and motion capture are aligned."]
    found = []
    if max(check.best_mv, RESOLVED_MV) > EXPLAINED * check.spread_mv:
        found.append(
            f"{owner}: the readings hardly follow the motion; of {check.spread_mv:.3g} mV (root mean square) the bend"
            f" leaves {check.best_mv:.3g} mV at the best lag, so the alignment cannot be checked."
        )
    elif abs(check.best_s) > NEAR_S and check.gain > DOUBTED:
        way, more = ("later" if check.best_s > 0 else "earlier"), " or more" if check.at_edge else ""
        better = f"{abs(check.best_s):.3g} s{more} {way}, with {check.best_mv:.3g} mV left"
        if refuse and abs(check.best_s) >= FAR_S and check.gain > REFUSED:
            expected = "aligned at the start of inflation"
            seen = f"readings that fit {better} instead of {check.residual_mv:.3g} mV"
            raise bad_input("motion capture and readings", owner, expected, seen)
        found.append(
            f"{owner}: the alignment is in doubt; the readings fit motion capture best {better} instead of"
            f" {check.residual_mv:.3g} mV."
        )
    return found
