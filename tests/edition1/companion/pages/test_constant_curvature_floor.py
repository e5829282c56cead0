"""The floors of shape models: none where the arm is of the class, and those of the recorded arm."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from edition1_companion.pages.constant_curvature_floor import figures
from edition1_companion.pages.constant_curvature_floor.floors import (
    FREE,
    POSES,
    RAW,
    SENSORS,
    TIP,
    TIP_MIDDLE,
    TURNS,
    Judged,
    judged,
    with_free_base,
)
from edition1_companion.recordings.continuum_robot import LENGTH_M, find_trials
from edition1_companion.twins.captured_rod import captured, stations
from edition1_companion.twins.curvature_series import CurvatureSeries

ROOT = Path(__file__).parents[4]
CLASSES = {"one arc": 2, "two arcs": 4, "three arcs": 6, "affine curvature": 4, "quadratic curvature": 6}


@pytest.fixture(scope="module")
def page():
    """What the cell of the method defines."""
    notebook = json.loads((ROOT / "notebooks" / "constant_curvature_floor.ipynb").read_text(encoding="utf-8"))
    cells = {cell["id"]: "".join(cell["source"]) for cell in notebook["cells"]}
    names = {}
    for name in ("01", "02", "shapes"):
        exec(cells[f"constant-curvature-floor-{name}"], names)
    return names


def error_mm(page, shape, T, sensors):
    at, positions = SENSORS[sensors]
    return 1e3 * (page["fitted"](page["SHAPES"][shape], T, at, positions) - T)[..., :3, 3].norm(dim=-1)


def test_stations_that_are_judged():
    assert [judged(name) for name in (TIP, TIP_MIDDLE, TURNS, POSES)] == [
        [0, 1, 2], [0, 2], [0, 1, 2, 3], [0, 1, 2, 3],
    ]  # fmt: skip


@pytest.mark.parametrize("sensors", SENSORS)
@pytest.mark.parametrize("shape", CLASSES)
def test_an_arm_of_constant_curvature_has_no_floor_in_any_class(page, shape, sensors):
    """All classes hold it, and the fit finds it where the sensors determine it."""
    arm = CurvatureSeries(LENGTH_M, 1).quarters(torch.tensor([[0.4, 0.3], [1.2, -0.5]], dtype=torch.float64))
    limit = 1e-4 if CLASSES[shape] < 6 or sensors != TIP else 5.0
    assert float(error_mm(page, shape, arm, sensors).max()) < limit


@pytest.mark.parametrize("shape", CLASSES)
def test_an_arm_of_the_class_has_no_floor(page, shape):
    poses, n_q = page["SHAPES"][shape]
    assert n_q == CLASSES[shape]
    q = torch.as_tensor(np.random.default_rng(0).normal(0, 0.4, (3, n_q)))
    assert float(error_mm(page, shape, poses(q), POSES).max()) < 1e-3


def test_one_arc_from_orientations_of_an_affine_arm_has_its_closed_form(page):
    """In a plane, with directions alone: the mean of the bends that the four stations show, by their arc lengths."""
    k0, k1 = 0.1, 0.15
    T = CurvatureSeries(LENGTH_M, 2).quarters(torch.tensor([[k0, k1, 0.0, 0.0]], dtype=torch.float64))
    v = np.array([0.25, 0.5, 0.75, 1.0])
    turned = k0 * v + k1 * (v * v - v)
    guess = turned @ v / (v @ v)  # small angles: directions differ by the angles
    fit = page["fitted"](page["SHAPES"]["one arc"], T, [0, 1, 2, 3], False)
    bend = math.acos(float(fit[0, -1, 2, 2]))
    assert bend == pytest.approx(guess, rel=1e-2)


def test_a_base_that_is_free_takes_up_a_tilt(page):
    """Held, it leaves an error; free, none."""
    arm = CurvatureSeries(LENGTH_M, 1).quarters(torch.tensor([[0.4, 0.3], [0.9, -0.5]], dtype=torch.float64))
    tilt = CurvatureSeries(1e-9, 1).quarters(torch.tensor([0.1, 0.0], dtype=torch.float64))[-1]
    base = torch.eye(4, dtype=torch.float64).expand_as(arm[:, :1])
    T = torch.cat([base, tilt @ arm], dim=1)
    assert float(error_mm(page, "one arc", T[:, 1:], POSES).max()) > 1
    free = page["fitted"](with_free_base(page["SHAPES"]["one arc"]), T, [0, 1, 2, 3, 4], True)
    left = (free - T)[..., :3, 3].norm(dim=-1).max()
    assert 1e3 * float(left) < 0.3 * float(error_mm(page, "one arc", T[:, 1:], POSES).max())


def test_recorded_floor_with_a_free_base(page, monkeypatch, tmp_path):
    """The figures of a first look: all poses 8.8, 5.1 and 2.6 mm for one arc, 2.4, 2.5 and 1.4 for affine curvature.

    There the weights of positions and directions were others: hence the room.
    """
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    trials = {trial.name: trial for trial in find_trials(ROOT / "data" / "recordings" / "continuum_robot")}
    first = {"one arc": (8.8, 5.1, 2.6), "affine curvature": (2.4, 2.5, 1.4)}
    for shape, expected in first.items():
        for name, looked_mm in zip(("slow_free_space", "impulse_1", "fast_contact"), expected, strict=True):
            T = torch.as_tensor(stations(captured(trials[name])[1][::12]))
            T = torch.cat([torch.eye(4, dtype=torch.float64).expand_as(T[:, :1]), T], dim=1)
            free = page["fitted"](with_free_base(page["SHAPES"][shape]), T, [0, 1, 2, 3, 4], True)
            rms = (free - T)[:, 1:, :3, 3].square().sum(-1).mean(0).sqrt().mean()
            assert 1e3 * float(rms) == pytest.approx(looked_mm, abs=0.8)


@pytest.fixture
def tables():
    rng = np.random.default_rng(1)
    frames = {"slow_free_space": np.linspace(0, 100, 40), "other": np.linspace(0, 20, 20)}
    found = Judged(frames, block=5, bootstraps=300, seed=0)
    for setting in (RAW, "bodies moved onto the rod", FREE):
        for sensors in SENSORS:
            for n, shape in enumerate(CLASSES):
                found.add((setting, sensors, shape), (n + 1) * (2 + rng.random((60, 4))))
    return found


def test_tables_hold_root_mean_squares(tables):
    """A constant error is its own mean, its interval a point, and ratios are exact."""
    constant = Judged({"a": np.linspace(0, 50, 30)}, block=4, bootstraps=100, seed=0)
    constant.add((RAW, TIP, "one arc"), np.tile([1.0, 2.0, 3.0, 50.0], (30, 1)))
    constant.add((RAW, TIP, "two arcs"), np.tile([0.5, 1.0, 1.5, 50.0], (30, 1)))
    for line in constant.by_trial().to_dict("records"):
        assert line["low_mm"] == pytest.approx(line["error_mm"]) == pytest.approx(line["high_mm"])
    np.testing.assert_allclose(constant.by_trial()["error_mm"], [2, 1])  # the tip is known
    np.testing.assert_allclose(
        constant.ratio((RAW, TIP, "one arc"), (RAW, TIP, "two arcs")).iloc[0, 1:].to_list(), 2
    )
    assert constant.by_station()["known"].tolist() == [False, False, False, True] * 2
    by_bend = constant.by_bend([0.0, 10.0, 60.0, 90.0])
    assert by_bend["frames"].tolist() == [6, 6, 24, 24]  # the empty range is left out
    table = tables.by_trial()
    assert ((table["low_mm"] < table["error_mm"]) & (table["error_mm"] < table["high_mm"])).all()


def test_figures_draw_the_tables(tables):
    figure = figures.floors_by_shape(tables.by_trial())
    table = tables.by_trial()
    panel = figure.axes[0]
    drawn = [round(y, 9) for dots in panel.collections[1::3] for y in dots.get_offsets()[:, 1]]
    raw = table[(table["setting"] == RAW) & (table["sensors"] == TIP)]
    assert sorted(drawn) == sorted(raw["error_mm"].round(9))
    by_bend = tables.by_bend([0.0, 20.0, 200.0])
    lines = figures.floors_by_bend(by_bend).axes[1].lines
    part = by_bend[
        (by_bend["setting"] == RAW) & (by_bend["sensors"] == TURNS) & (by_bend["shape"] == "one arc")
    ]
    np.testing.assert_allclose(lines[0].get_ydata().astype(float), part["error_mm"])
    assert isinstance(by_bend, pd.DataFrame)


def test_a_frame_is_drawn_across_the_plane_of_its_tip():
    """The drawn tip is as far sideways as it is from the axis of the base."""
    T = CurvatureSeries(LENGTH_M, 1).quarters(torch.tensor([0.8, 0.6], dtype=torch.float64)).numpy()
    panel = figures.two_frames([("one", T, {"one arc": T})]).axes[0]
    curve, bodies = panel.lines
    tip = 1e3 * np.array([np.hypot(*T[-1, :2, 3]), T[-1, 2, 3]])
    np.testing.assert_allclose(bodies.get_xydata()[-1], tip)
    np.testing.assert_allclose(curve.get_xydata()[-1], tip)
    radius = 1e3 * LENGTH_M  # a bend of one radian
    np.testing.assert_allclose(np.hypot(*(curve.get_xydata() - [radius, 0]).T), radius, atol=0.1)
