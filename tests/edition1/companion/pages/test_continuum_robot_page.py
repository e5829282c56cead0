"""The page of the filter on a recorded robot: what is judged, on what, and the released program's printed errors."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from edition1 import se3
from edition1_companion.pages.continuum_robot import figures, judged, tables
from edition1_companion.recordings.continuum_robot import STATIONS_M, find_trials
from edition1_companion.twins import followed_rod

ROOT = Path(__file__).parents[4]
RECORDINGS = ROOT / "data" / "recordings" / "continuum_robot"
TRIALS = {trial.name: trial for trial in find_trials(RECORDINGS)}


@pytest.fixture(scope="module")
def method():
    """The filter of the page."""
    notebook = json.loads((ROOT / "notebooks" / "continuum_robot.ipynb").read_text(encoding="utf-8"))
    cells = {cell["id"]: "".join(cell["source"]) for cell in notebook["cells"]}
    names = {"display": print}
    exec(cells["continuum-01"], names)
    exec(cells["continuum-02"].split("recordings =")[0], names)
    exec(cells["continuum-04"].split("method =")[0], names)
    return names["rod_filter"]()


def test_other_pages_have_the_filter_of_this_one(method, capture):
    """The settings, and with them what it says of a recording."""
    other = followed_rod.chosen_filter()
    assert (other.sensors, other.strain_std, other.rate) == (method.sensors, method.strain_std, method.rate)
    plain, same = (followed_rod.estimates(m, capture)["filter"] for m in (method, other))
    assert all(np.array_equal(a, b) for a, b in zip(plain, same, strict=True))


@pytest.fixture(scope="module")
def capture():
    """Two seconds of a trial with a blow."""
    return followed_rod.load(replace(TRIALS["impulse_1"], window_s=(25.0, 27.0)))


@pytest.mark.parametrize(
    ("trial", "ending", "printed_mm"),
    [
        ("slow_free_space", "filter", [7.5, 13.8, 12.1, 5.4]),
        ("impulse_1", "filter", [8.3, 16.1, 15.8, 8.3]),
        ("fast_contact", "filter", [8.5, 12.6, 9.5, 8.1]),
    ],
)
def test_released_estimates_give_the_errors_that_their_program_prints(trial, ending, printed_mm):
    parts = judged.released(
        followed_rod.load(TRIALS[trial]), RECORDINGS / "released_estimates", ending, np.zeros(18)
    )
    assert [round(value, 1) for value in judged.rmse_mm(parts)] == printed_mm


def test_a_trial_without_released_estimates_has_none(capture):
    other = replace(capture, name="another")
    assert judged.released(other, RECORDINGS / "released_estimates", "filter", np.zeros(18)) is None


def test_every_frame_of_every_station_is_judged_at_its_own_time(method, capture):
    found = followed_rod.estimates(method, capture)
    for values in found.values():
        parts = followed_rod.errors(capture, values)
        assert [len(error) for error, _ in parts] == [len(time_s) for time_s, _ in capture.truth]


def test_the_filter_is_causal_and_the_smoother_is_not(method, capture):
    """Readings after a time leave its estimates of before it alone."""
    u = capture.u.clone()
    late = capture.time_s > 26.0
    u[torch.from_numpy(late)] += 0.05
    before = capture.asked_s <= 26.0
    plain, other = (followed_rod.estimates(method, c) for c in (capture, replace(capture, u=u)))
    assert np.array_equal(plain["filter"][0][before], other["filter"][0][before])
    assert not np.allclose(plain["smoother"][0][before], other["smoother"][0][before], atol=1e-4)


def test_drop_outs_take_a_third_of_the_time_in_runs(capture):
    gone = judged.without_tracker(capture, 3, run_s=0.3, share=1 / 3)
    left = {t for t, u in zip(gone.time_s, gone.u, strict=True) if not torch.isnan(u[followed_rod.TIP]).any()}
    every = [
        t
        for t, u in zip(capture.time_s, capture.u, strict=True)
        if not torch.isnan(u[followed_rod.TIP]).any()
    ]
    runs = {int((t - capture.time_s[0]) / 0.3): t in left for t in every}
    assert sum(not kept for kept in runs.values()) == round(len(runs) / 3)
    for t in every:
        assert (t in left) == runs[int((t - capture.time_s[0]) / 0.3)]
    assert torch.equal(
        gone.u[:, 12:][~torch.isnan(gone.u[:, 12:])], capture.u[:, 12:][~torch.isnan(capture.u[:, 12:])]
    )


def test_constants_are_found_from_trackers_that_are_off_by_them():
    constants = 1e-2 * np.random.default_rng(2).normal(size=18)
    T = judged.exponential(np.random.default_rng(3).normal(size=(5, 6)) * 0.3)
    frame, base, tip = (se3.exponential(torch.from_numpy(x)).numpy() for x in constants.reshape(3, 6))
    np.testing.assert_allclose(judged.with_constants(constants, T, 0.0), frame @ T @ base, atol=1e-15)
    np.testing.assert_allclose(judged.with_constants(constants, T, 1.0), frame @ T @ tip, atol=1e-15)


def test_constants_bring_the_trackers_nearer_to_the_motion_capture():
    trial = TRIALS["slow_free_space"]
    constants = judged.fitted_constants(trial, rotation_m=0.1)
    plain = followed_rod.load(trial)
    moved = judged.calibrated(plain, constants)

    def off(capture):
        read = ~torch.isnan(capture.u[:, 6])
        T = judged.exponential(capture.u[read][:, followed_rod.TIP].numpy())
        time_s, truth = capture.truth[3]
        near = np.abs(time_s[:, None] - capture.time_s[read.numpy()]).argmin(1)
        return np.linalg.norm(T[near, :3, 3] - truth[:, :3, 3], axis=-1)

    assert np.sqrt((off(moved) ** 2).mean()) < 0.7 * np.sqrt((off(plain) ** 2).mean())


@pytest.mark.parametrize("by", judged.WIDER)
def test_wider_covariances_hold_as_asked(by):
    """Errors three times as large as said need a factor of nine."""
    rng = np.random.default_rng(4)
    error, spread = 3e-3 * rng.normal(size=(40_000, 3)), np.tile(1e-6 * np.eye(3), (40_000, 1, 1))
    (number,) = judged.widened([(error, spread)], by, 1)
    assert number == pytest.approx({"factor": 9.0, "addition": 8e-6}[by], rel=0.03)
    normalised, axes = judged.coverage([(error, spread)], by, [number])
    assert judged.held_percent(normalised) == pytest.approx(95.0, abs=0.1)
    assert axes == pytest.approx(3.0 * np.sqrt(7.815), rel=0.02)


def test_a_further_folder_is_judged_with_the_others(tmp_path):
    """Scored whole; the same content twice is one trial."""
    folder = tmp_path / "recordings"
    shutil.copytree(RECORDINGS / "slow_free_space", folder / "slow_free_space")
    shutil.copytree(RECORDINGS / "slow_free_space", folder / "again")
    trials = find_trials(folder)
    assert len(trials) == 1
    for path in (folder / "again").glob("*.csv"):
        path.write_text("\n".join(path.read_text().splitlines()[:200]), encoding="utf-8")
    whole = [trial for trial in find_trials(folder) if trial.name == "again"]
    assert [trial.window_s for trial in whole] == [None]
    assert len(followed_rod.load(whole[0]).truth) == len(STATIONS_M)


def test_tables_have_the_columns_that_others_read(method, capture):
    parts = {
        ("raw", name, estimator): followed_rod.errors(capture, values)
        for name in ("slow_free_space", "impulse_1")
        for estimator, values in followed_rod.estimates(method, capture).items()
    }
    table = tables.error_table(parts, {})
    assert list(table) == ["trial", "setting", "estimator", "station_mm", "rmse_mm"]
    assert sorted(set(table["station_mm"])) == [116.5, 233.0, 349.5, 466.0]
    coverage = tables.coverage_table({key[1:]: values for key, values in parts.items()})
    assert list(coverage)[:3] == ["trial", "estimator", "coverage_percent"]
    assert set(coverage["trial"]) == {"slow_free_space", "impulse_1", "judged"}


def test_a_line_over_time_is_broken_where_frames_are_missing():
    time_s, values = figures.broken_at_gaps(np.array([0.0, 0.1, 0.2, 0.6, 0.7]), np.arange(5.0))
    assert (np.diff(time_s) >= 0).all()
    assert np.array_equal(values, [0.0, 1.0, 2.0, np.nan, 3.0, 4.0], equal_nan=True)
