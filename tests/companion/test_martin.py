"""Martin et al.: Table I, the synthetic trial, errors, calibration, released files."""

import json
import re
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import repro
from repro import InputError
from repro_companion.papers import martin
from repro_companion.run import project_folder
from repro_companion.scorecard import published

from .sample import ONE_DEVIATION
from .trial_files import turned_about


@pytest.fixture(scope="module")
def moved():
    return martin.motion()


@pytest.fixture(scope="module")
def trial(moved):
    return martin.draw(moved, 0)


@pytest.fixture(scope="module")
def short(trial):
    """Every twentieth sample."""
    parts = {name: getattr(trial, name)[::20] for name in ("time_s", "orientations", "points")}
    return replace(trial, **parts)


@pytest.fixture(scope="module")
def table(short):
    return martin.marker_errors([short], martin.cases())


# The arm and Table I


@pytest.mark.parametrize(
    ("given", "imus"),
    [
        (("rigid", 2, 2, "table"), (2, 6)),
        (("rigid", 4, 4, "table"), (2, 4, 6, 8)),
        (("rigid", 4, 4, "text"), (1, 3, 5, 7)),
        (("rigid", 8, 8, "table"), (1, 2, 3, 4, 5, 6, 7, 8)),
        (("pcc", 2), (0, 4, 8)),
        (("pcc", 4), (0, 2, 4, 6, 8)),
        (("pcc", 8), (0, 1, 2, 3, 4, 5, 6, 7, 8)),
    ],
)
def test_table_i(given, imus):
    arm = martin.arm(*given)
    assert arm.imus == imus
    assert sum(arm.link_lengths) == pytest.approx(0.64)
    np.testing.assert_allclose(arm.imu_arcs, 0.08 * np.array(imus), atol=1e-15)
    assert np.sum(arm.sub_segments) * len(arm.link_lengths) == 16 * (given[0] == "pcc")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("soft",), "Input model of arm must be 'rigid' or 'pcc'; instead received 'soft'."),
        (("pcc", 3), "Input n_imus of arm must be 2, 4 or 8; instead received 3."),
        (("pcc", 8, 12), "Input segments of arm must be a multiple of the 8 IMUs; instead received 12."),
        (("rigid", 4, 4, "paper"), "Input reading of arm must be table, text or files; instead received 'paper'."),
    ],
)  # fmt: skip
def test_other_arms_are_refused(given, message):
    with pytest.raises(InputError, match=re.escape(message)):
        martin.arm(*given)


def test_the_models_of_the_page_are_those_of_the_library(short):
    cells = json.loads((project_folder() / "notebooks" / "imu_markers.ipynb").read_text(encoding="utf-8"))[
        "cells"
    ]
    (source,) = ("".join(cell["source"]) for cell in cells if "def rigid_links" in "".join(cell["source"]))
    shown = source[source.index("def rigid_links") : source.index("base, *imus")]
    page = {"np": np, "Rotation": Rotation, "pairwise": pairwise}
    exec(shown, page)
    imus = [Rotation.from_quat(short.orientations[:, k]) for k in range(9)]
    rigid, arcs = page["rigid_links"](imus[1:], 0.08), 0.08 * np.arange(1, 9)
    np.testing.assert_allclose(rigid, martin.shape(short.orientations, martin.arm("rigid"), arcs), atol=1e-12)
    for n in (1, 2, 5):
        ours = page["pcc_extended"](imus, 0.08, n)
        theirs = martin.shape(
            short.orientations, martin.arm("pcc", 8, 8 * n), 0.08 / n * np.arange(1, 8 * n + 1)
        )
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("beta", [0.1, 0.8])
def test_what_a_link_gets_wrong_on_an_arc(beta, n):
    """A rigid link is off sideways by half the turn; interpolated ones have the right direction, and are too long."""
    q = turned_about([0, 1.0, 0], 0.0, beta)
    arm = repro.Arm([0, 1], [0, 0.08], [0.08], sub_segments=n)
    arc = martin.shape(q, replace(arm, sub_segments=1000), 0.08)[0]
    rigid = martin.shape(q, repro.Arm([1], [0.08], [0.08]), 0.08)[0]
    chain = martin.shape(q, arm, 0.08)[0]
    np.testing.assert_allclose(np.linalg.norm(rigid - arc), 0.08 * beta / 2, rtol=0.1)
    np.testing.assert_allclose(np.linalg.norm(chain - arc), 0.08 * beta**2 / 24 / n**2, rtol=0.05)
    np.testing.assert_allclose(np.cross(chain, arc), 0, atol=1e-12)


# The synthetic trial


def test_perfect_sensors_and_cameras_see_the_arm(moved):
    seen = martin.draw(moved, 3, martin.Errors(0, 0, 0, 0, 0, 0))
    off = 1e3 * np.linalg.norm(seen.points - seen.truth(moved, martin.SEEN), axis=-1)
    assert (
        np.median(off) < 1.6
    )  # noise of 1 mm along each axis, interpolated; a lag of 10 ms would add 1 mm and more
    assert np.median(martin.distances(seen, martin.arm("pcc"))) < 6
    arms = martin.arm("pcc"), martin.mid_section(), martin.arm("rigid")
    pcc, middle, ends = (np.median(martin.distances(seen, made)[:, 1]) for made in arms)
    assert pcc < middle < ends / 3


def test_errors_of_the_sensors_have_their_sizes(moved):
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (1000, 9, 1))  # 20 s
    quick = martin.Motion(moved.time_s[:1000], moved.positions[:1000], moved.arcs, upright)
    errors = martin.Errors(mounting_deg=0, heading_deg=6, heading_wander_deg=2, tilt_deg=1)
    turns, again = [], []
    for seed in range(40):
        read_s, q = martin.read_imus(quick, errors, np.random.default_rng(seed))
        again.append((np.diff(q, axis=0) == 0).all(axis=-1).mean())
        turns.append(np.degrees(Rotation.from_quat(q[::100].reshape(-1, 4)).as_rotvec()))
    np.testing.assert_allclose(np.std(np.concatenate(turns), axis=0), [2**0.5, 2**0.5, 40**0.5], rtol=0.15)
    assert np.mean(again) == pytest.approx(1e-3, rel=0.3)  # of a hundred and ninety-eight, four deviations
    np.testing.assert_allclose(q * 2**14, np.round(q * 2**14))
    np.testing.assert_allclose(np.diff(read_s, axis=1), martin.SKEW_S)


@pytest.mark.parametrize(
    ("errors", "on_the_imu", "turn_deg"),
    [
        (martin.Errors(3, 0, 0, 0), True, [3, 3, 3]),
        (martin.Errors(0, 6, 0, 0), False, [0, 0, 6]),
        (martin.Errors(0, 0, 0, 0), True, [0, 0, 0]),
    ],
)
def test_a_mounting_turns_with_its_imu_and_a_heading_with_the_world(moved, errors, on_the_imu, turn_deg):
    times = moved.time_s[:200]
    turned = np.repeat(turned_about([1.0, 0, 0], *times)[:, None], 9, axis=1)  # a radian in a second
    rolling = martin.Motion(times, moved.positions[:200], moved.arcs, turned)
    read_s, q = martin.read_imus(rolling, errors, ONE_DEVIATION)
    true, seen = (Rotation.from_quat(x) for x in (rolling.imu(read_s[:, 4] - martin.LATENCY_S, 5), q[:, 4]))
    off = true.inv() * seen if on_the_imu else seen * true.inv()
    np.testing.assert_allclose(np.degrees(off.as_rotvec()), np.tile(turn_deg, (len(q), 1)), atol=0.01)


@pytest.mark.parametrize("lag_s", [-1.5, 0.0, 0.987, 3.2041])
def test_lag_of_a_bump(lag_s):
    t, other = np.arange(0, 20, 0.032), np.arange(0, 20, 0.01)
    found = martin.clock_lag(t, np.exp(-((t - 9) ** 2)), other, 3 * np.exp(-((other - 9 + lag_s) ** 2)) - 1)
    assert found == pytest.approx(lag_s, abs=2e-4)


# Errors, scorecard, calibration


def test_hull_is_the_third_quartile_around_the_arm(moved, short):
    found = martin.hull(moved, [short, short], 4)
    assert list(found["mode"].unique()) == ["oscillating", "buckling", "circling"]
    for mode, part in found.groupby("mode"):  # in a pose a quarter of the way through it
        own = short.time_s[short.mode == mode]
        assert {*part["time_s"]} == {own[len(own) // 4]}
    tip = martin.shape(short.orientations[::4], martin.arm("pcc"), 0.64) - short.truth(moved, [0.64], 4)
    radius = found.loc[found["arc_mm"] == 640, "radius_mm"]
    np.testing.assert_allclose(
        radius, 1e3 * np.percentile(np.linalg.norm(tip, axis=-1)[[*range(len(tip))] * 2], 75)
    )
    there = short.truth(moved, [0.64])[np.isin(short.time_s, found["time_s"].unique()), 0]
    np.testing.assert_allclose(found.loc[found["arc_mm"] == 640, ["x_mm", "y_mm", "z_mm"]], 1e3 * there)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        # Of 0 to 4 mm the median is 2 and the third quartile 3.
        (
            lambda: martin.by_mode(
                np.array([[0.0, 40], [1, 10], [2, 20], [3, 30], [4, 0]]), np.array([*"aaabb"]), [0.36, 0.6]
            ).iloc[:, 1:],
            [[360, 2, 3], [600, 20, 30], [360, 1, 1.5], [600, 20, 30], [360, 3.5, 3.75], [600, 15, 22.5]],
        ),
        # Two draws, of which one has the errors of the other model and the other way round: the means are the same.
        (
            lambda: (
                martin.calibration_ratios(
                    pd.DataFrame(
                        list(product((martin.BEST, martin.BASELINE), ("all",), (360.0, 600.0), (0, 1))),
                        columns=["method", "mode", "point_mm", "draw"],
                    ).assign(median_mm=[1.0, 3.0, 5.0, 7.0, 3.0, 1.0, 7.0, 5.0])
                )
                .query("method == @martin.BEST")
                .set_index("point")
                .loc[["markers", "360 mm", "600 mm"]]
                .iloc[:, 2:]
            ),
            [[4, 1, 3 / 5, 5 / 3, 2], [2, 1, 1 / 3, 3, 2], [6, 1, 5 / 7, 7 / 5, 2]],
        ),
    ],
)
def test_numbers_of_the_page_by_hand(found, expected):
    np.testing.assert_allclose(found(), expected, rtol=1e-9)


def test_markers_are_three_four_five_and_have_the_quantiles_of_their_names(short, monkeypatch):
    made = martin.arm("rigid")
    points = martin.shape(short.orientations, made, [*made.markers] * 2) + np.array([3e-3, 4e-3, 0.0])
    np.testing.assert_allclose(martin.distances(replace(short, points=points), made), 5.0)
    monkeypatch.setattr(martin, "distances", lambda trial, made: np.stack([np.arange(101.0)] * 2, axis=1))
    table = martin.marker_errors([short], martin.cases([8], [])[:1])
    np.testing.assert_array_equal(
        table[["q05_mm", "q25_mm", "median_mm", "q75_mm", "q95_mm"]], [[5, 25, 50, 75, 95]] * 6
    )


def test_chains_beside_what_table_ii_prints(table):
    """13.3 and 11.8 % of 360 and 600 mm are 48 and 71 mm; 20 mm are 50 % less than 40, and a quarter more than 16."""
    names = ["ends", "middle", "8 interpolated links", "16 interpolated links, files"]
    numbers = [[9, 9, 53, 9], [9, 9, 19, 9], [40, 50, 16, 30], [9, 9, 20, 30]]
    apart = martin.chains_at_points(dict(zip(names, numbers, strict=True)))
    shown = martin.chains_shown(apart, martin.printed_numbers()["Table II"])
    assert list(shown["Table II"]) == ["–", "–", "48, 71 before", "37, 55 at"]
    words = martin.chains_in_words(apart, table, synthetic=True)
    assert "**On our synthetic arm the place of evaluation matters more" in words
    assert "**In the authors' trial the place" in martin.chains_in_words(apart, table, synthetic=False)
    assert (
        "40.0 mm with 20.0 mm, 50 % less. At the same point it would be 16.0 mm with 20.0 mm, 25 % more."
        in words
    )
    assert "53 mm if it ends at its IMU, as in the text, and 19 mm if the IMU is in its middle." in words


def test_rows_of_the_scorecard(table):
    study = pd.read_csv(project_folder() / "data" / "studies" / "martin_calibration.csv")
    rows = martin.scorecard_rows(table, martin.best_errors(study)).set_index(["artefact", "row", "quantity"])
    assert len(rows) == len(published("martin2022")) == 43
    own = table[(table["case"] == martin.RIGID_8) & (table["evaluation"] == martin.FILES)].iloc[1]
    assert own["marker"] == "M2"
    percent = rows.loc[("Table II", "M2 rigid-body", "q3"), "regenerated"]
    assert percent == pytest.approx(own["q75_mm"] / 6)
    finer = table.query(
        "figure == 'Fig. 4' and segments > 8 and marker == 'M1' and evaluation == @martin.FILES"
    )
    more = rows.loc[("Fig. 4", "M1 PCC-extended 16 segments and more", "q3")]
    assert more["regenerated"] == pytest.approx(finer["q75_mm"].mean() / 3.6)
    assert more["note"].startswith("mean of 16, 32, 64; the chain of the text: ")
    medians = table[table["evaluation"] == martin.FILES].groupby(["case", "marker"])["median_mm"].first()
    less = 100 * (1 - medians[martin.PCC_16] / medians[martin.RIGID_8]).mean()  # of both markers
    assert rows.xs("reduction", level="quantity")["regenerated"].item() == pytest.approx(less)
    three = [
        table.assign(draw=k, median_mm=k * table["median_mm"], q75_mm=k * table["q75_mm"]) for k in (1, 2, 6)
    ]
    drawn = martin.scorecard_rows(pd.concat(three), martin.best_errors(study)).set_index(rows.index.names)
    own = rows[~rows.index.get_level_values("quantity").isin(["reduction", "time"])].index
    expected = np.outer(rows.loc[own, "regenerated"], [3, 7**0.5])  # mean and deviation of 1, 2 and 6
    np.testing.assert_allclose(drawn.loc[own, ["regenerated", "regenerated_std"]], expected)
    best = rows["best"].dropna()
    assert len(best) == 11
    assert {"PCC" in row for _, row, _ in best.index} == {True}
    assert set(rows["comparable"].dropna()) == {False}
    assert set(rows["setting"]) == {"synthetic", "benchmark"}
    few = martin.scorecard_rows(table[table["n_imus"] == 2], martin.best_errors(study))
    assert set(few["artefact"]) == {"Fig. 3", "Fig. 5", "Section IV-A", "Section IV-B"}


def test_a_frame_is_found_on_the_first_minute(moved):
    seen = martin.draw(moved, 1, martin.Errors(0, 0, 0, 0, 40, 5))
    raw, fitted = (
        martin.calibrated_errors(seen, repro.exact_arcs, per_imu).query("mode == 'all'").set_index("arc_mm")
        for per_imu in (None, False)
    )
    assert raw["median_mm"].min() > 40
    assert fitted["median_mm"].max() < 7  # what an arc between IMUs gets wrong


def test_the_fit_sees_the_first_minute_only(trial):
    """What comes later may be anything: the calibrated points do not move."""
    first = trial.time_s - trial.time_s[0] < 60
    other = trial.points + np.where(first, 0.0, 0.1)[:, None, None]
    errors = [
        martin.calibrated_errors(replace(trial, points=points), repro.exact_arcs, False)["median_mm"]
        for points in (trial.points, other)
    ]
    assert errors[1].min() > 1e3 * 0.1 * 3**0.5 - errors[0].max() - 20
    assert errors[0].max() < 40
