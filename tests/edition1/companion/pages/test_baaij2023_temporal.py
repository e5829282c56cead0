"""The filter over time: its frozen choice, its gain on other trajectories, and readings with several explanations."""

import pandas as pd
import pytest
import torch
from edition1.errors import InputError
from edition1_companion.pages.temporal_filter.figures import gain_and_bands
from edition1_companion.pages.temporal_filter.filters import (
    METHODS,
    SHARE,
    errors_by_draw,
    filter_to_least_squares,
    minima_by_robot,
    noisy_readings,
)
from edition1_companion.twins.calibrated_robots import box
from edition1_companion.twins.trajectories import TRAJECTORIES, trajectory


def scores_by_process_noise(n_segments: int, seeds: tuple[int, ...], shares: tuple[float, ...]) -> pd.Series:
    """Mean score of every process noise on T2."""
    tables = {share: errors_by_draw(n_segments, ["T2"], seeds, share=share) for share in shares}
    scores = {
        share: table.loc[table["method"] == METHODS[1], "score"].mean() for share, table in tables.items()
    }
    return pd.Series(scores)


@pytest.mark.parametrize("n_segments", sorted(SHARE))
def test_frozen_process_noise_is_in_the_flat_optimum_on_t2(n_segments):
    score = scores_by_process_noise(n_segments, (0, 1), (0.05, SHARE[n_segments], 0.2, 0.5))
    assert score[SHARE[n_segments]] < score.min() + 0.1
    assert score[0.5] > score.min() + 0.5  # the score does tell candidates apart


def test_filter_gains_on_other_trajectories_and_least_squares_is_calibrated():
    table = filter_to_least_squares(errors_by_draw(1, ["T1", "T3"], (0, 1, 2)))
    assert table["chosen_here"].tolist() == [False, False]
    assert (table["ratio_high"] < 0.9).all()
    assert table["lm_covered_percent"].between(92, 98).all()


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_trajectories_stay_in_the_box(name):
    q, (low, high) = trajectory(name, 3), box(3)
    assert q.shape == (400, 9)
    assert bool(((q >= low) & (q <= high)).all())
    assert torch.equal(trajectory(name, 3, steps=7), q[:7])


def test_readings_are_those_of_their_seed():
    q = trajectory("T3", 1, steps=3)
    both = noisy_readings(q, 1, (4, 5), 0.01)
    assert torch.equal(both[:, 1:], noisy_readings(q, 1, (5,), 0.01))
    assert not torch.equal(both[:, 0], both[:, 1])


def test_figure_draws_the_tables():
    table = errors_by_draw(1, ["T2", "T3"], (0, 1), steps=10)
    over_time = pd.DataFrame(
        [
            {"time_s": t, "method": method, "error_mm": 0.1, "two_sigma_mm": 0.3}
            for method in METHODS
            for t in (0.0, 0.025)
        ]
    )
    left, right = gain_and_bands(filter_to_least_squares(table), over_time).axes
    assert [text.get_text() for text in left.get_xticklabels()] == ["T2", "T3"]
    assert len(right.lines) == 2


def test_search_reports_what_readings_do_not_tell_apart():
    table = minima_by_robot().set_index("robot")
    assert table["minima"]["three sensors, constant curvature"] == 1
    assert table["minima"]["two sensors, constant curvature"] > 1
    assert table["minima"]["nine sensors, affine curvature"] > 1
    assert table["furthest_mm"]["nine sensors, affine curvature"] < 1.0  # one shape


def test_bad_input():
    with pytest.raises(InputError, match="Input name of trajectory must be one of 'T0', 'T1', 'T2', 'T3'"):
        trajectory("T9", 1)
