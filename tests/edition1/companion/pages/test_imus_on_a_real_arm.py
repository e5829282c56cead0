"""Chains of ideal IMUs on the stations of the recorded arm: exact on arcs, and as the recordings have it."""

from pathlib import Path

import numpy as np
import pytest
import torch

from edition1_companion.pages.imus_on_a_real_arm import figures
from edition1_companion.pages.imus_on_a_real_arm.chains import (
    ARCS,
    END,
    INNER,
    MIDDLE,
    MODELS,
    PCC,
    RAW,
    SPLINE,
    STATIONS,
    Blocks,
    error_table,
    misread,
    orientations,
    placed,
    ratio_table,
    with_sensor_errors,
)
from edition1_companion.recordings.continuum_robot import LENGTH_M, STATIONS_M, find_trials
from edition1_companion.twins.captured_rod import captured, stations
from edition1_companion.twins.curvature_series import CurvatureSeries

RECORDED = Path(__file__).parents[4] / "data" / "recordings" / "continuum_robot"


def arm(*coefficients):
    q = torch.tensor(coefficients, dtype=torch.float64)
    return CurvatureSeries(LENGTH_M, q.shape[-1] // 2).quarters(q).numpy()


def positions(q, model, n_imus):
    made = placed(model, n_imus)
    return MODELS[model](made.of(q), made, np.minimum(STATIONS_M, sum(made.link_lengths)))


def error_mm(T, model, n_imus):
    return 1e3 * np.linalg.norm(positions(orientations(T), model, n_imus) - T[..., :3, 3], axis=-1)


@pytest.mark.parametrize("n_imus", STATIONS)
def test_exact_arcs_are_exact_on_an_arc(n_imus):
    assert error_mm(arm([0.4, 0.3], [1.2, -0.5]), ARCS, n_imus).max() < 1e-6


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("n_imus", STATIONS)
def test_every_model_is_exact_on_a_straight_arm_and_as_long(model, n_imus):
    assert error_mm(arm([0.0, 0.0]), model, n_imus).max() < 1e-9
    made = placed(model, n_imus)
    assert sum(made.link_lengths) == pytest.approx(LENGTH_M)
    assert len(made.imus) == n_imus - (model == END)


@pytest.mark.parametrize("n_imus", [3, 5])
def test_links_on_an_arc_have_their_closed_forms(n_imus):
    """Chains of equal turns: the tip is on the circle about their polygon."""
    theta = 1.2
    T = arm([theta, 0.0])
    tip = {model: np.linalg.norm(positions(orientations(T), model, n_imus)[0, -1]) for model in MODELS}
    chord = LENGTH_M * np.sin(theta / 2) / (theta / 2)

    def of_equal_links(
        count,
    ):  # a chain of equal turns reaches as far as chords that are longer than the arc's
        return LENGTH_M / count * np.sin(theta / 2) / np.sin(theta / 2 / count)

    links = n_imus - 1
    assert tip[ARCS] == pytest.approx(chord)
    assert tip[PCC] == pytest.approx(of_equal_links(2 * links))
    assert tip[END] == pytest.approx(of_equal_links(links))
    assert tip[MIDDLE] == pytest.approx(of_equal_links(links) * np.cos(theta / 2 / links))


def test_ways_to_interpolate_are_one_on_a_straight_arm_and_two_on_a_bent_one():
    assert error_mm(arm([0.8, 0.0]), PCC, 3).max() != error_mm(arm([0.8, 0.0]), INNER, 3).max()
    assert (placed(PCC, 3).interpolation, placed(INNER, 3).interpolation) == ("midpoints", "inner points")


def test_base_is_never_misread_and_angles_are_those_drawn():
    q = orientations(arm([0.4, 0.3], [1.2, -0.5]))
    drawn = [misread(q, 0.1, np.random.default_rng(seed)) for seed in range(400)]
    np.testing.assert_array_equal(drawn[0][:, 0], q[:, 0])
    turned = 2 * np.arccos(np.abs((np.array(drawn)[:, :, 1:] * q[:, 1:]).sum(-1)).clip(max=1))
    np.testing.assert_allclose(turned[:, 0], turned[:, 1], atol=1e-7)  # the same in all frames
    assert np.sqrt((turned**2).mean()) == pytest.approx(0.1 * np.sqrt(3), rel=0.05)
    np.testing.assert_array_equal(misread(q, 0.0, np.random.default_rng(0)), q)


@pytest.fixture(scope="module")
def recorded():
    trials = {trial.name: trial for trial in find_trials(RECORDED)}
    return {name: stations(captured(trials[name])[1][::4]) for name in ("impulse_1", "slow_free_space")}


def test_tables_of_the_recorded_arm(recorded):
    """With the IMU at the end of its link the paper's gain is surpassed; centred on it, there is hardly one."""
    errors = {
        (name, RAW, n, model): error_mm(T, model, n)
        for name, T in recorded.items()
        for n in STATIONS
        for model in MODELS
    }
    blocks = Blocks(8, 300, 0)
    table, ratios = error_table(errors, blocks), ratio_table(errors, blocks)
    assert ((table["low_mm"] <= table["error_mm"]) & (table["error_mm"] <= table["high_mm"])).all()
    line = table[(table["trial"] == "impulse_1") & (table["n_imus"] == 5) & (table["model"] == SPLINE)]
    part = errors["impulse_1", RAW, 5, SPLINE]
    assert line["tip_mm"].item() == pytest.approx(np.sqrt((part[:, -1] ** 2).mean()))
    five = ratios[(ratios["n_imus"] == 5) & (ratios["model"] == PCC)].groupby("against")["ratio"]
    assert five.max()[END] < 0.5
    assert five.min()[MIDDLE] > 0.8
    assert not set(ratios["model"]) & {END, MIDDLE}
    panel = figures.errors_by_number(table).axes[0]
    assert len(panel.containers) == len(MODELS)


def test_sensors_without_error_change_nothing_and_large_ones_make_all_worse(recorded):
    T = {name: part[::4] for name, part in recorded.items()}
    table = with_sensor_errors(positions, T, [0.0, 20.0], [0, 1, 2])
    first = table[table["sensor_deg"] == 0].set_index(["n_imus", "model"])["error_mm"]
    last = table[table["sensor_deg"] == 20].set_index(["n_imus", "model"])["error_mm"]
    ideal = np.concatenate([error_mm(part, PCC, 5) for part in T.values()])
    assert first[5, PCC] == pytest.approx(np.sqrt((ideal**2).mean(axis=0)).mean())
    assert (last[5] > first[5]).all()
    again = with_sensor_errors(positions, T, [0.0, 20.0], [0, 1, 2])
    assert table.equals(again)
    lines = figures.errors_with_sensors(table).axes[2].lines
    np.testing.assert_allclose(lines[2].get_ydata(), [first[5, PCC], last[5, PCC]])


def test_a_frame_is_drawn_across_the_plane_of_its_tip():
    (T,) = arm([0.8, 0.6])
    points = np.concatenate([np.zeros((1, 3)), T[:, :3, 3]])
    panel = figures.chains_in_a_frame(T, {3: {PCC: points}}).axes[0]
    np.testing.assert_allclose(panel.lines[0].get_xydata(), panel.lines[1].get_xydata())
    sideways = 1e3 * np.hypot(*T[-1, :2, 3])
    np.testing.assert_allclose(panel.lines[0].get_xydata()[-1], [sideways, 1e3 * T[-1, 2, 3]])
