"""The particle filter of Mitchell et al.: module, curves, closed forms of its error, study, scorecard."""

import ast
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import repro
from repro_companion import show
from repro_companion.papers import mitchell
from repro_companion.scorecard import published, scorecard
from repro_companion.show import KEY, project_folder
from tests.library.robots import STORED

STUDY = pd.read_csv(project_folder() / "data" / "studies" / "particle_filter.csv")


def rmse(error):
    return float(np.sqrt((np.asarray(error) ** 2).mean()))


@pytest.mark.parametrize("name", mitchell.CURVES)
def test_curves_and_readings_are_those_of_the_first_edition(name):
    q, old = mitchell.curve(name)[::100], STORED[f"curve_{name}_readings"]
    np.testing.assert_allclose(q, STORED[f"curve_{name}"], rtol=0, atol=1e-14)
    np.testing.assert_allclose(mitchell.readings(q, 14e-3), old, rtol=0, atol=1e-11)


def test_a_quarter_circle_ends_where_the_paper_has_it():
    q = mitchell.bend_vector(np.array([math.pi / 2, -math.pi / 2]), np.array([0.3, 0.3 + math.pi]))
    np.testing.assert_allclose(q[0], q[1])
    module, side = mitchell.robot(), 2 / math.pi * mitchell.LENGTH
    at = module.poses(q[0], [module.magnets[0].place])[0, :3, 3]
    np.testing.assert_allclose(at, [side * math.cos(0.3), side * math.sin(0.3), side])
    assert mitchell.position_errors(q[0], np.zeros(2)) == pytest.approx(
        1e3 * math.hypot(side, mitchell.LENGTH - side)
    )


def test_noise_is_that_of_the_real_sensor():
    q = mitchell.curve("seagull")
    u = mitchell.readings(q, noise_mt=0.025, generator=np.random.default_rng(0))
    np.testing.assert_allclose((u - mitchell.readings(q)).std(axis=0), 0.025, rtol=0.05)
    for setting in (mitchell.BEST, mitchell.NOISY, mitchell.KALMAN, mitchell.SINGLE):
        assert setting.noise_mt == mitchell.SENSOR_NOISE_MT == 0.025
    assert mitchell.BEST.method().noise == pytest.approx(0.025)
    assert mitchell.PRINTED.method().noise == pytest.approx(0.01 / math.sqrt(2))


def test_the_law_is_the_error_of_a_mean_over_the_best_tenth():
    """Particles around the truth with deviation s; the nearest tenth, by the metric of the field near straight."""
    rng, s, n, runs = np.random.default_rng(0), 0.02 * math.pi, 1000, 4000
    q = s * rng.standard_normal((runs, n, 2))
    near = np.argpartition((q**2).sum(-1), n // 10, axis=1)[:, : n // 10]
    mean = np.take_along_axis(q, near[..., None], axis=1).mean(axis=1)
    expected = 1e3 * mitchell.LENGTH / 2 * np.sqrt((mean**2).sum(-1).mean())
    assert mitchell.law_mm(0.02, n) == pytest.approx(expected, rel=0.02)
    assert mitchell.law_mm(0.02, 100, 30e-3) == pytest.approx(2 * math.sqrt(10) * mitchell.law_mm(0.02))
    bias = np.hypot(*np.take_along_axis(q, near[..., None], axis=1).mean(axis=0).T)  # of one place: none
    assert bias.mean() < s / 20
    angles = np.linalg.norm(np.take_along_axis(q, near[..., None], axis=1), axis=-1)
    assert angles.mean() == pytest.approx(2 / 3 * s * math.sqrt(2 * math.log(10 / 9)), rel=0.01)


def notebook_filter():
    """The cells of the page that hold the filter, as functions of the process noise and the sensor."""
    cells = json.loads(Path("notebooks/particle_filter.ipynb").read_text(encoding="utf-8"))["cells"]
    [cell] = ["".join(c["source"]) for c in cells if "def particle_filter" in "".join(c["source"])]
    tree = ast.parse(cell)
    assert sum(bool(line.strip()) for line in cell.splitlines()) <= 25
    space = {"np": np, "process_noise_pi": 0.02, "sensor": repro.BendSensor(mitchell.LENGTH)}
    exec(compile(tree, "particle_filter", "exec"), space)
    return space["particle_filter"]


def test_the_filter_of_the_page_and_the_library_have_the_same_error(monkeypatch):
    monkeypatch.chdir(project_folder())
    q = mitchell.curve("flower")[:150]
    u, scratch, library = mitchell.readings(q), [], []
    for seed in range(6):
        run = notebook_filter()(u, 300, np.random.default_rng(seed))
        found = np.array([estimate for estimate, *_ in run])
        scratch.append(rmse(mitchell.position_errors(found, q)))
        few = replace(mitchell.PRINTED, particles=300)
        library.append(rmse(mitchell.follow(few, seed, 150, ["flower"])))
    error = math.hypot(np.std(scratch, ddof=1), np.std(library, ddof=1)) / math.sqrt(6)
    assert abs(np.mean(scratch) - np.mean(library)) < 3 * error


def test_the_study_is_what_the_methods_give():
    tasks = mitchell.study(range(2))
    assert {seed for setting, seed in tasks if setting == mitchell.BEST} == {0, 1}
    assert {seed for setting, seed in tasks if setting.name == "random walk"} == {100, 101}
    own = STUDY[(STUDY["setting"] == mitchell.SINGLE.name) & (STUDY["seed"] == 1)]
    found = mitchell.study_rows(mitchell.SINGLE, 1)
    np.testing.assert_allclose([row[-1] for row in found], own["rmse_mm"], rtol=1e-4)


def test_motion_and_noise_of_ours_are_best_on_spiral():
    tried = mitchell.over_seeds(STUDY[STUDY["setting"].isin(["random walk", "constant velocity"])])
    best = tried[tried["curve"] == "spiral"].nsmallest(1, "rmse_mm").iloc[0]
    assert best["setting"] == mitchell.BEST.how[-1]
    assert best["process_noise_pi"] == mitchell.BEST.process_noise_pi
    assert STUDY[STUDY["setting"] == "random walk"]["seed"].min() == 100


def test_the_gain_is_paired():
    lines = [(x, 0, 0, name, seed, 3.0 if (x == "a") == seed else 1.0)
             for x in "ab" for name in mitchell.CURVES for seed in (0, 1)]  # fmt: skip
    gain = mitchell.gain(pd.DataFrame(lines, columns=mitchell.STUDY_COLUMNS), "a", "b")
    np.testing.assert_allclose(gain[["ratio", "ratio_low", "ratio_high"]], [[1, 1 / 3, 3]] * 3)  # not 5/3
    both = pd.concat([mitchell.gain(STUDY, mitchell.BEST.name, mitchell.SINGLE.name),
                      mitchell.gain(STUDY, mitchell.KALMAN.name, mitchell.BEST.name)])  # fmt: skip
    held = both[(both["setting"] == mitchell.BEST.name) & (both["curve"] != "spiral")]
    assert held["ratio_high"].max() < 0.75
    assert mitchell.gain_in_words(both).startswith(
        "With velocities our particle filter has 65 % of the error"
    )
    assert "is 0.6 % smaller still on Flower, and 7 % on Seagull." in mitchell.gain_in_words(both)


def test_errors_over_time_and_their_summary():
    error = np.array([0.0, 0.0, 3.0])
    table = mitchell.errors_over_time({(mitchell.PRINTED, "spiral"): error, (mitchell.FITS, "flower"): error})
    assert table["t"].tolist() == [0.0, 0.01, 0.02] * 2
    found = mitchell.summary(table)
    assert found["setting"].tolist() == [mitchell.PRINTED.name, mitchell.FITS.name]
    np.testing.assert_allclose(found[["rmse_mm", "mean_mm", "worst_mm"]], [[math.sqrt(3), 1.0, 3.0]] * 2)
    study = pd.DataFrame(
        {"setting": "a", "process_noise_pi": 0.0, "particles": 1, "curve": "spiral"}, [0, 1, 2]
    )
    means = mitchell.over_seeds(study.assign(seed=range(3), rmse_mm=[1.0, 2.0, 6.0])).iloc[0]
    assert means[["rmse_mm", "rmse_std_mm", "seeds"]].to_list() == [3, math.sqrt(7), 3]


def test_rows_of_the_scorecard_keep_their_verdicts(tmp_path, monkeypatch):
    errors = STUDY[(STUDY["setting"] == mitchell.PRINTED.name) & (STUDY["seed"] == 0)]
    own = replace(mitchell.PRINTED, length=14e-3)
    rows = mitchell.scorecard_rows(errors, mitchell.over_seeds(STUDY), mitchell.changed(own, 150))
    assert len(rows) == 4
    assert not rows.duplicated(KEY).any()
    assert str(rows["setting"].iloc[0]).endswith("start straight; here L = 14 mm; here 150 steps")
    assert mitchell.changed(mitchell.PRINTED, 3142) == ""
    monkeypatch.setenv("REPRO_RESULTS", str(tmp_path))
    show.rows(rows, "mitchell")
    card = scorecard(project_folder() / "data/published/published.csv", [tmp_path / "mitchell.rows.csv"])
    own = card[(card["paper"] == "mitchell2021") & (card["verdict"] != "missing")]
    assert own["verdict"].tolist() == ["differs"] * 3 + ["not_comparable"]
    assert published("mitchell2021", "Section II-D")["value"].tolist() == [0.0044, 0.0046, 0.0046]


def test_the_kalman_filter_moves_as_our_cloud_does():
    """What a step adds to a velocity, times the step, is what moves a particle of our cloud."""
    change = mitchell.KALMAN.method().acceleration * math.sqrt(mitchell.STEP)
    np.testing.assert_allclose(change * mitchell.STEP, mitchell.BEST.method().process_noise[0])
