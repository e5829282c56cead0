"""How often bands hold, how wide they are and what they cost, with intervals by blocks of time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float

from edition1.estimation.conformal import interval_score
from edition1_companion.book.bootstrap import interval, resampled, resampled_blocks
from edition1_companion.pages.intervals.scored import Judged, Scored

COLUMNS = ["recording", "method", "coverage_percent", "median_width_mm", "interval_score_mm"]
COLUMNS += ["coverage_low_percent", "coverage_high_percent", "independent_samples"]
RECORDED, TWINS = "all recorded", "random twins (synthetic)"
"""Names of what is pooled."""
Factors = Callable[[Judged], float | Float[np.ndarray, " k"]]
"""A method: the factor of the stated ellipsoid, one for all estimates or one for each."""


def independent_samples(x: Float[np.ndarray, " k"]) -> float:
    """As many independent numbers would have a mean as sure as theirs: by the autocorrelation, while it is positive.

    Neighbouring lags are summed in pairs, until a pair is negative (Geyer 1992, initial positive sequence).
    """
    apart = x - x.mean()
    if not apart.any():
        return 1.0
    spectrum = np.abs(np.fft.rfft(apart, 2 * len(x))) ** 2
    r = np.fft.irfft(spectrum)[: len(x)]
    pairs = (r[: len(r) // 2 * 2] / r[0]).reshape(-1, 2).sum(1)
    last = int((pairs <= 0).argmax()) if (pairs <= 0).any() else len(pairs)
    return float(len(x) / max(1.0, 2 * pairs[:last].sum() - 1))


def held(judged: Judged, factors: Factors, level: float, late: bool = True) -> tuple[np.ndarray, ...]:
    """Whether each judged estimate is held, the width of its band [mm], and its interval score [mm]."""
    own = judged.own
    kept = own.late if late else np.ones(len(own.time_s), dtype=bool)
    factor = np.broadcast_to(np.asarray(factors(judged), dtype=float), own.time_s.shape)[kept]
    score, axis = own.scores(level)[kept], own.semi_axis_mm(level)[kept]
    return score <= factor, 2 * factor * axis, interval_score(score * axis, factor * axis, level)


def _drawn_anew(inside: np.ndarray, own: Scored, block_s: float, seed: int, draws: int) -> np.ndarray:
    """Coverage [%] of the estimates drawn in blocks of time."""
    step_s = (own.time_s[-1] - own.time_s[0]) / (len(own.time_s) - 1)
    block = max(1, round(block_s / step_s))
    return 100 * inside[resampled_blocks(len(inside), block, seed, bootstraps=draws)].mean(1)


def by_recording(
    recordings: Sequence[Judged],
    methods: Mapping[str, Factors],
    level: float,
    *,
    block_s: float,
    draws: int,
    pooled: Sequence[str] = (),
) -> pd.DataFrame:
    """A row for each recording and method, and one for all that are pooled, in which each counts alike.

    There, widths and scores are geometric means, as robots differ in size; coverages are means.
    """
    rows = []
    samples = {j.name: independent_samples(j.own.scores(level)[j.own.late]) for j in recordings}
    for method, factors in methods.items():
        means, coverages = [], []
        for seed, judged in enumerate(recordings):
            inside, width, cost = held(judged, factors, level)
            anew = _drawn_anew(inside, judged.own, block_s, seed, draws)
            mean = (100 * inside.mean(), float(np.median(width)), float(cost.mean()))
            rows.append((judged.name, method, *mean, *interval(anew), samples[judged.name]))
            if judged.name in pooled:
                means.append(mean)
                coverages.append(anew)
        if means:
            index = resampled(len(means), len(recordings), bootstraps=draws)
            anew = np.stack(coverages)[index, np.arange(draws)[:, None]].mean(1)
            total = sum(samples[name] for name in pooled)
            held_percent, *sizes = np.transpose(means)
            sizes = [float(np.exp(np.log(size).mean())) for size in sizes]
            rows.append((RECORDED, method, held_percent.mean(), *sizes, *interval(anew), total))
    return pd.DataFrame(rows, columns=COLUMNS)


def of_random_twins(
    twins: Sequence[Judged], methods: Mapping[str, Factors], level: float, *, draws: int
) -> pd.DataFrame:
    """A row for each trajectory and method, and for all; drawn anew are whole twins."""
    rows = []
    names = list(dict.fromkeys(j.kind for j in twins))
    for method, factors in methods.items():
        found = [(j, *held(j, factors, level, late=False)) for j in twins]
        for label, kinds in [*((f"random twins {n} (synthetic)", [n]) for n in names), (TWINS, names)]:
            part = [x for x in found if x[0].kind in kinds]
            seeds = list(dict.fromkeys(j.name for j, *_ in part))
            sums = np.array(
                [
                    [np.sum([np.sum(x[1]) for x in part if x[0].name == s]) for s in seeds],
                    [np.sum([len(x[1]) for x in part if x[0].name == s]) for s in seeds],
                ]
            )
            index = resampled(len(seeds), 0, bootstraps=draws)
            anew = 100 * sums[0][index].sum(1) / sums[1][index].sum(1)
            inside, width, cost = (np.concatenate([x[k] for x in part]) for k in (1, 2, 3))
            samples = sum(independent_samples(j.own.scores(level)) for j, *_ in part)
            mean = (100 * inside.mean(), np.median(width), cost.mean())
            rows.append((label, method, *mean, *interval(anew), samples))
    return pd.DataFrame(rows, columns=COLUMNS)
