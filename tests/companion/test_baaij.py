"""The simulated robots of Baaij et al.: published numbers, closed forms, and the first edition as an oracle."""

import math

import numpy as np
import pandas as pd
import pytest

from repro_companion.papers import baaij
from repro_companion.plots import simulated_robots as plots
from repro_companion.scorecard import published, scorecard
from repro_companion.show import project_folder

RESULTS = project_folder() / "results"


def row(name: str) -> baaij.Row:
    return next(row for row in baaij.ROWS if row.name == name)


@pytest.mark.parametrize(("n", "ranges"), baaij.RELEASED_RANGES_MT.items())
def test_readings_have_the_range_of_the_released_data(n, ranges):
    u = baaij.simulate(baaij.robot(n), baaij.lemniscate(n)).reshape(baaij.STEPS, n, 3)
    assert np.ptp(u, axis=(0, 2)) == pytest.approx(ranges, abs=5e-5)


def test_trajectories_stay_within_45_degrees_and_five_percent():
    q = baaij.lemniscate(3).reshape(baaij.STEPS, 3, 3)
    assert np.abs(q[..., :2]).max() == pytest.approx(22e-3 * math.pi / 4, rel=1e-4)
    assert (q[..., 2].min(), q[..., 2].max()) == pytest.approx((0, 5.5e-3), abs=1e-6)


def test_relative_errors_are_equation_13():
    truth = np.array([[0.0, 1.0], [2.0, 1.0], [4.0, 3.0]])
    assert baaij.relative_errors(truth + np.array([0.4, -0.2]), truth) == pytest.approx([10, 10])
    batch = np.stack([truth, truth + np.array([0.4, 0.0])], axis=1)
    assert baaij.relative_errors(batch, truth) == pytest.approx(np.array([[0, 0], [10, 0]]))


@pytest.mark.parametrize(
    ("n", "bending", "elongation"), [(1, 3.5e-4, 3.5e-4), (2, 3e-3, 3e-4), (3, 2e-3, 2e-4)]
)
def test_step_sizes_are_those_of_section_3_3(n, bending, elongation):
    assert baaij.step_sizes(n) == [bending, bending, elongation] * n
    assert (baaij.MOMENTUM, baaij.ITERATIONS) == (0.3, 20)


def test_the_table_prints_two_runs_again_and_names_every_row():
    printed = published("baaij2023", "Table 1")
    assert [row.name for row in baaij.ROWS] == list(printed["row"].unique())
    for again in (row for row in baaij.ROWS if row.same_as):
        same = printed[printed["row"] == again.same_as]
        assert printed.loc[printed["row"] == again.name, "printed"].to_list() == same["printed"].to_list()
    assert len(baaij.rows_named()) == 11
    with pytest.raises(ValueError, match="Table 1 has no row n_b=4; it has n_b=1, n_b=2"):
        baaij.rows_named(["n_b=1", "n_b=4"])


def test_errors_of_one_segment_are_the_committed_ones():
    new, found = baaij.run_row(row("n_b=1"), 0)
    assert found.shape == (baaij.STEPS, 3)
    old = pd.read_csv(RESULTS / "table_1_errors.csv").query("row == 'n_b=1' and seed == 0")
    assert new["quantity"].to_list() == old["quantity"].to_list()
    assert new["error"].to_numpy() == pytest.approx(old["error"].to_numpy(), rel=1e-4)


def test_a_robot_with_errors_is_within_its_limits_and_measured_with_the_stated_noise():
    """The deviations of 40 poses and readings lie within four standard errors of those that are stated."""
    measured, drawn = baaij.session(row("n_e=(0,1,0)"), 1), row("n_e=(0,1,0)").robot()
    for part, plan in zip(measured.robot.magnets, drawn.magnets, strict=True):
        off = np.abs(part.place.position - plan.place.position)
        assert 0 < off.max() <= baaij.ERRORS.magnet_position
        tilted = math.acos(np.dot(part.direction, [0, 0, 1]))
        assert 0 < tilted <= math.sqrt(2) * baaij.ERRORS.magnet_tilt
    for part, plan in zip(measured.robot.sensors, drawn.sensors, strict=True):
        assert 0 < abs(part.azimuth - plan.azimuth) <= baaij.ERRORS.sensor_azimuth
        assert 0 < abs(part.radial / plan.radial - 1) <= baaij.ERRORS.sensor_radius
    exact = baaij.simulate(measured.robot, measured.q, earth_mt=row("n_e=(0,1,0)").earth_mt())
    noise = measured.readings - exact
    assert noise.std() == pytest.approx(baaij.NOISE_MT, rel=4 / math.sqrt(2 * noise.size))
    q = baaij.configurations(measured.robot, measured.poses)[0]
    off = measured.poses[..., :3, 3] - measured.robot.poses(q, baaij.tips(measured.robot))[..., :3, 3]
    # The fit of three coordinates to six numbers of a tip explains a part of them.
    assert 0.3 * baaij.POSITION < off.std() < baaij.POSITION
    again = baaij.session(row("n_e=(0,1,0)"), 1)
    assert np.array_equal(measured.readings, again.readings)


def test_measured_poses_give_configurations_with_honest_covariances():
    measured = baaij.session(row("n_b=2"), 0)
    exact = measured.robot.poses(measured.q, baaij.tips(measured.robot))
    q, covariance = baaij.configurations(baaij.robot(2), exact)
    assert q == pytest.approx(measured.q, abs=1e-9)
    g = np.random.default_rng(0)
    noisy = exact.copy()
    noisy[..., :3, 3] += baaij.POSITION * g.standard_normal(noisy[..., :3, 3].shape)
    off = baaij.configurations(baaij.robot(2), noisy)[0] - q
    # Only positions are off here, so the errors are smaller than their covariance says.
    assert 0.3 < np.einsum("ti,tij,tj->t", off, np.linalg.inv(covariance), off).mean() / 6 < 1.0


def test_more_noise_is_twenty_times_as_much_on_the_same_robot():
    less, more = (baaij.session(row("n_b=1"), 0, noise) for noise in (baaij.NOISE_MT, baaij.MORE_NOISE_MT))
    exact = baaij.simulate(less.robot, less.q)
    ratio = baaij.MORE_NOISE_MT / baaij.NOISE_MT
    assert more.readings - exact == pytest.approx(ratio * (less.readings - exact), abs=1e-12)
    assert np.array_equal(more.poses, less.poses)


def test_errors_are_told_apart_by_the_two_noises_of_the_study():
    noisy = pd.DataFrame(
        {"row": "n_b=1", "method": ["a", "b"] * 2, "error_percent": [1.0, 2.0, 3.0, 4.0]}
    ).assign(noise_mt=np.repeat([baaij.NOISE_MT, baaij.MORE_NOISE_MT], 2))
    for found, errors in zip(baaij.by_noise(noisy[::-1]), ([1, 2], [3, 4]), strict=True):
        assert found.loc["n_b=1", ["a", "b"]].tolist() == errors


@pytest.mark.parametrize(("name", "rel"), [("n_b=1", 2e-4), ("n_s=6", 1e-2)])
def test_the_study_of_robots_with_errors_comes_out_again(name, rel):
    """Also with six readings of nine unknowns, where the estimator decides most of the error."""
    old = pd.read_csv(project_folder() / "data" / "studies" / "table_1_best.csv").query(
        "row == @name and draw == 0"
    )
    for errors, known in zip(baaij.errors_of_draw(row(name), 0), (True, False), strict=True):
        expected = old.loc[old["calibrated"] == known, "error_percent"].to_numpy()
        assert errors == pytest.approx(expected, rel=rel)


def test_calibration_finds_a_robot_with_errors():
    calibrated, nominal = baaij.errors_of_draw(row("n_b=1"), 0)
    assert calibrated.mean() < 0.5 < 3 < nominal.mean()


def errors_table(*errors: tuple[str, str, float]) -> pd.DataFrame:
    """Errors of 1/2 and 3/2 times a mean with two seeds: their deviation is the root of a half."""
    cells = [(row, name, "%", seed, x * (0.5 + seed)) for row, name, x in errors for seed in (0, 1)]
    return pd.DataFrame(cells, columns=["row", "quantity", "unit", "seed", "error"])


def test_bias_is_a_geometric_mean_of_ratios():
    """Half and twice the printed errors and deviations are once on average; six sensors do not count."""
    errors = errors_table(
        ("n_b=1", "delta_x_1", 2.0), ("n_b=1", "delta_y_1", 8.0), ("n_s=6", "delta_x_1", 9.0)
    )
    printed = errors[errors["seed"] == 0].assign(value=[4.0, 4.0, 1.0], std=[8**0.5, 8**0.5, 1.0])
    table = baaij.bias(errors, printed)
    assert table["n_b"].to_list() == ["1", "all"]
    for line in table.drop(columns="n_b").to_numpy():
        assert line == pytest.approx([2, 1, 1.0, 0.5, 1.5, 1.0])


def test_gain_is_a_ratio_of_means_with_a_paired_interval():
    """Of two robots one has a third of the error with calibration, and the other has three times the error."""
    cells = [("n_b=1", "delta_x_1", d, c, 1.0 + 2 * (c == d)) for d in (0, 1) for c in (True, False)]
    names = ["row", "quantity", "draw", "calibrated", "error_percent"]
    table = baaij.gain(pd.DataFrame(cells, columns=names))
    assert table["quantity"].to_list() == ["delta_x_1", "mean"]
    for line in table.iloc[:, 2:].to_numpy():
        assert line == pytest.approx([2.0, 2**0.5, 2.0, 2**0.5, 1.0, 1 / 3, 3.0])


def test_a_cell_of_the_scorecard_is_the_mean_over_the_seeds():
    errors = pd.DataFrame({"row": "a", "quantity": "b", "unit": "%", "error": [1.0, 2.0, 6.0]})
    cell = baaij.of_seeds(errors).iloc[0]
    assert cell[["regenerated", "regenerated_std", "n_seeds"]].to_list() == [3.0, 7**0.5, 3]
    assert cell["note"] == "of the single seeds: 1, 2, 6"


def test_rows_of_the_scorecard_are_those_of_the_committed_tables():
    errors, gains = (pd.read_csv(RESULTS / f"table_1_{name}.csv") for name in ("errors", "gain"))
    new = baaij.scorecard_rows(errors, gains, baaij.setting()).set_index(
        ["artefact", "row", "quantity", "unit"]
    )
    old = pd.read_csv(RESULTS / "table_1.rows.csv", keep_default_na=False).set_index(new.index.names)
    assert set(new.index) == set(old.index)
    new = new.reindex(old.index)
    for column in ("regenerated", "regenerated_std", "best"):
        assert new[column].to_numpy() == pytest.approx(
            pd.to_numeric(old[column]).to_numpy(), rel=1e-8, nan_ok=True
        )
    for column in ("note", "setting", "best_method"):
        assert new[column].fillna("").to_list() == old[column].to_list()
    drifts = new["note"].str.contains("drifts")
    assert {key[1:3] for key in new.index[drifts]} == {("n_s=6", f"delta_y_{k}") for k in (1, 2, 3)}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({}, "carried"),
        ({"iterations": 200}, "carried; here 200 evaluations"),
        ({"noise_mt": 0.005, "steps": 100}, "carried; here noise 0.005 mT; here 100 steps"),
    ],
)
def test_the_setting_says_what_is_not_as_released(changed, words):
    assert baaij.setting(**changed).endswith(words)


def test_noise_has_its_deviation_and_one_seed_is_one_draw():
    arm, q = baaij.robot(1), np.zeros((2000, 3))
    clean, seen = baaij.simulate(arm, q), baaij.simulate(arm, q, noise_mt=0.01, seed=3)
    assert (seen - clean).std() == pytest.approx(0.01, rel=0.03)
    assert (baaij.simulate(arm, q, noise_mt=0.01, seed=3) == seen).all()


def test_errors_of_poses_are_millimetres_and_degrees():
    arm, q = baaij.robot(1), np.zeros((4, 3))
    longer = np.zeros((4, 3))
    longer[3, 2] = 2e-3  # once in four steps: half of it in the root mean square
    found = baaij.pose_errors(arm, longer, q)
    assert found == pytest.approx(
        {"tip_mm": 1.0, "orientation_deg": 0.0, "shape_mm": found["shape_mm"]}, abs=1e-9
    )
    assert found["shape_mm"] == pytest.approx(math.sqrt(np.mean(np.linspace(0, 1, 33) ** 2)))
    turned = baaij.pose_errors(arm, q + np.array([22e-3 * math.radians(10), 0, 0]), q)
    assert turned["orientation_deg"] == pytest.approx(10)


@pytest.fixture(scope="module")
def card() -> pd.DataFrame:
    whole = scorecard(project_folder() / "data/published/published.csv", [RESULTS / "table_1.rows.csv"])
    return whole[whole["artefact"] == "Table 1"]


def test_every_cell_of_table_1_shows_the_printed_number_and_ours(card):
    html = plots.table_1(card, baaij.ROWS).data
    lines = html.partition("<tbody>")[2].split("<tr")[1:]
    for own, line in zip(baaij.ROWS, lines, strict=True):
        cells = card[card["row"] == own.name].set_index("quantity")
        for quantity, cell in cells[cells["unit"] == "%"].iterrows():
            mean, std = float(cell["regenerated"]), float(cell["regenerated_std"])
            ours = f"{mean:.1f}±{std:.1f}" if std >= 0.05 else f"{mean:.2f}±{std:.2f}"
            printed = f"<small>{cell['published']}±{cell['published_std']}</small>"
            assert f"{printed}{ours}<" in line, (own.name, quantity)
        assert line.count("<td") == 10
        assert line.count("–") == 10 - len(cells)
        assert ('class="again"' in line) == bool(own.same_as)
        assert "±0.0<" not in line
    assert "<small>15±2</small>12±7<" in lines[0]
    assert html.count('title="differs"') == 1
    assert html.count('title="better"') == 2
    ruled = [line for line in html.splitlines() if "nth-child" in line]
    assert ruled, "lines between groups of rows"
    assert all(line.startswith("#fig-table-1.") for line in ruled), "Table 2 and Table II have other groups"
    assert 'id="fig-table-1"' in html


@pytest.mark.parametrize(
    ("names", "drawn"),
    [(["n_b=1", "n_b=2", "n_s=12"], ["n_b=1", "n_b=2"]), (["n_s=12", "n_s=18"], ["n_s=12"])],
)
def test_paths_are_drawn_by_number_of_segments_or_of_the_first_row(names, drawn):
    rows = [row(name) for name in names]
    found = {one.name: baaij.lemniscate(one.n_segments, steps=5) + 1e-3 for one in rows}
    paths = baaij.tips_over_time(rows, found, 5)
    assert list(paths) == [row(name).label for name in drawn]
    for name, (truth, estimate) in zip(drawn, paths.values(), strict=True):
        robot = row(name).robot()
        np.testing.assert_allclose(truth, robot.tip(found[name] - 1e-3)[:, :3, 3], atol=1e-12)
        np.testing.assert_allclose(estimate, robot.tip(found[name])[:, :3, 3])
