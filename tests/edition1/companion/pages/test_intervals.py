"""The page on intervals: what calibrates has not seen what is judged, and bands hold as often as they say."""

import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pytest

from edition1.estimation.conformal import adaptive_factors, block_weights, conformal_factor, ellipsoid_scores
from edition1_companion.book.studies import joined
from edition1_companion.pages.intervals import figures, scored, tables
from edition1_companion.recordings.continuum_robot import find_trials
from edition1_companion.twins import followed_rod
from edition1_companion.twins.bend_takes import write_bend_takes
from edition1_companion.twins.bend_tests import bend_takes
from edition1_companion.twins.rig_data import load_recordings

ROOT = Path(__file__).parents[4]
RECORDINGS = ROOT / "data" / "recordings" / "continuum_robot"
STUDY = joined(["intervals_twins"])


def methods_of_the_page():
    """The functions in the cells of the notebook, with its parameters."""
    notebook = json.loads((ROOT / "notebooks" / "intervals.ipynb").read_text(encoding="utf-8"))
    cells = {cell["id"]: "".join(cell["source"]) for cell in notebook["cells"]}
    names: dict = {"np": np} | {f.__name__: f for f in (adaptive_factors, block_weights, conformal_factor)}
    exec(cells["intervals-01"], names)
    exec(cells["intervals-06"], names)
    return names["methods"]


METHODS = methods_of_the_page()
conformal = METHODS["conformal"]
TWO = {name: METHODS[name] for name in ("gaussian", "conformal")}


def rows(table):
    """Rows of a table by recording and method."""
    return table.set_index(["recording", "method"]).to_dict("index")


@pytest.fixture(scope="module")
def takes():
    """Synthetic bend tests."""
    with TemporaryDirectory() as folder:
        write_bend_takes(Path(folder), seed=0, duration_s=6.0)
        return bend_takes(Path(folder))


def made(seed, k=400, twice=1.0):
    """Scores of a Gaussian, whose stated deviation is too small by a factor."""
    rng = np.random.default_rng(seed)
    distance = twice * np.linalg.norm(rng.normal(size=(k, 2)), axis=-1)
    return scored.Scored(np.arange(k) / 10, distance, np.full(k, 3.0), 2)


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9])
def test_independent_samples_of_an_autoregression(phi):
    """Its autocorrelation is phi to the lag: n (1 - phi) / (1 + phi)."""
    rng, x = np.random.default_rng(0), np.zeros(40_000)
    for k, noise in enumerate(rng.normal(size=len(x) - 1)):
        x[k + 1] = phi * x[k] + noise
    assert tables.independent_samples(x) == pytest.approx(len(x) * (1 - phi) / (1 + phi), rel=0.1)


def test_numbers_that_are_all_alike_are_one_sample():
    assert tables.independent_samples(np.ones(9)) == 1.0


def test_scores_are_those_of_the_library():
    rng = np.random.default_rng(1)
    error, C = rng.normal(size=(30, 2)), np.diag([4.0, 0.25])[None].repeat(30, 0)
    own = scored.Scored(np.arange(30.0), np.sqrt((error**2 / [4.0, 0.25]).sum(1)), np.ones(30), 2)
    np.testing.assert_allclose(own.scores(0.9), ellipsoid_scores(error, C, 0.9))
    np.testing.assert_allclose(own.semi_axis_mm(0.9), np.sqrt(-2 * np.log(0.1)))


def test_the_first_part_of_a_recording_is_not_judged():
    late = made(0).late
    assert late.sum() == 240
    assert not late[:160].any()


@pytest.mark.parametrize("twice", [1.0, 3.0])
def test_bands_from_others_hold_when_what_is_stated_is_too_small(twice):
    """And cost less than the stated ones, which the table shows."""
    others = tuple(made(seed, twice=twice) for seed in range(1, 9))
    judged = scored.Judged("one", "made", made(0, 4000, twice), others)
    by = rows(tables.by_recording([judged], TWO, 0.9, block_s=0.1, draws=100, pooled=["one"]))
    one, stated, pooled = by["one", "conformal"], by["one", "gaussian"], by[tables.RECORDED, "conformal"]
    assert one["coverage_percent"] == pytest.approx(90, abs=2.5)
    assert one["median_width_mm"] == pytest.approx(twice * stated["median_width_mm"], rel=0.08)
    assert one["interval_score_mm"] < (1.01 if twice == 1 else 0.7) * stated["interval_score_mm"]
    for column in ("coverage_percent", "median_width_mm", "interval_score_mm"):
        assert pooled[column] == pytest.approx(one[column])
    assert one["coverage_low_percent"] < 90 < one["coverage_high_percent"]
    assert one["coverage_high_percent"] - one["coverage_low_percent"] < 4


def test_no_method_but_adaptive_sees_the_judged_truth():
    """Other errors in the judged part change the factors of that one alone, and only after a second."""
    others = tuple(made(seed) for seed in range(1, 9))
    own = made(0)
    worse = replace(own, distance=np.where(own.late, 5 * own.distance, own.distance))
    plain, other = (scored.Judged("one", "made", x, others) for x in (own, worse))
    for name, method in METHODS.items():
        assert np.array_equal(method(plain), method(other)) == (name != "adaptive"), name
    factors = [METHODS["adaptive"](x) for x in (plain, other)]
    first = int(own.late.argmax())
    assert np.array_equal(factors[0][: first + 10], factors[1][: first + 10])


def test_old_scores_count_less_when_weighted():
    """In a recording whose errors grow, weighted is wider than split."""
    own = made(3)
    growing = replace(own, distance=own.distance * (1 + own.time_s / 10))
    judged = scored.Judged("one", "made", growing, ())
    assert METHODS["weighted"](judged) > 1.1 * METHODS["split"](judged)


def test_no_recording_of_the_rod_calibrates_itself():
    """Two windows of one recording are that recording; of others, all is used."""
    trials = find_trials(RECORDINGS)
    found = {j.name: j for j in scored.rods(followed_rod.chosen_filter(), trials)}
    assert len(found) == 2 * len(trials)
    seconds = {"impulse 1, tip": 45, "fast contact, shape": 45, "slow free space, tip": 34}
    for name, longest in seconds.items():
        (other,) = found[name].others
        assert other.time_s[-1] - other.time_s[0] == pytest.approx(longest, abs=2)
    shape, tip = found["impulse 1, shape"].own, found["impulse 1, tip"].own
    at = np.searchsorted(tip.time_s, shape.time_s)
    assert (shape.distance >= tip.distance[at]).all()


def test_what_calibrates_a_take_has_not_seen_its_truth(takes):
    """Nor has the sensor's calibration: another truth of the judged test changes its own scores alone."""
    test = takes[0].test
    wrong = [
        replace(t, truth=t.truth.assign(bend_rad=0.5 * t.truth["bend_rad"])) if t.test == test else t
        for t in takes
    ]
    plain, other = scored.bends(takes, "synthetic")[0], scored.bends(wrong, "synthetic")[0]
    assert "synthetic" in plain.name
    assert not np.allclose(plain.own.distance, other.own.distance)
    assert len(plain.others) == sum(t.test != test for t in takes)
    for a, b in zip(plain.others, other.others, strict=True):
        assert np.array_equal(a.distance, b.distance)


def test_fewer_than_three_tests_are_not_judged(takes):
    assert scored.bends([t for t in takes if t.test < 2], "synthetic") == []


def test_bands_hold_on_random_twins_as_often_as_they_say():
    """Each twin with the factor of the others, on each trajectory and on all; the stated ones do not on fast T3."""
    table = tables.of_random_twins(scored.random_twins(STUDY), TWO, 0.9, draws=100)
    by = rows(table)
    total, stated = by[tables.TWINS, "conformal"], by[tables.TWINS, "gaussian"]
    assert total["independent_samples"] >= 2000
    assert 88 <= total["coverage_percent"] <= 92
    assert total["interval_score_mm"] < stated["interval_score_mm"]
    t3 = "random twins T3 (synthetic)"
    assert by[t3, "gaussian"]["coverage_percent"] < 60
    assert by[t3, "conformal"]["coverage_percent"] == pytest.approx(90, abs=3)


def test_bands_of_the_rig_come_from_the_same_trajectory():
    data = load_recordings("twin", trajectories=("T3", "T5"))
    t3, t5 = scored.rig(data, STUDY, 2.0)
    assert conformal(t3) > 3 * conformal(t5)
    assert len(t3.others) == STUDY["twin"].nunique()
    assert len(t3.own.time_s) == 80


def test_figures_show_every_recording_and_both_bands():
    table = pd.DataFrame(
        [(r, m, 50.0, 40.0, 60.0) for r in ("a", "b") for m in figures.STYLES],
        columns=["recording", "method", "coverage_percent", "coverage_low_percent", "coverage_high_percent"],
    )
    (panel,) = figures.coverage(table, 0.9).axes
    assert [label.get_text() for label in panel.get_yticklabels()] == ["a", "b"]
    bands = pd.DataFrame({"time_s": [0.0, 1.0], "error_mm": 1.0, "gaussian_mm": 2.0, "conformal_mm": 3.0})
    (panel,) = figures.bands_over_time(bands).axes
    assert [np.asarray(line.get_ydata())[0] for line in panel.lines] == [2.0, 3.0]
