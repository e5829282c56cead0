"""What the live figures of failing sensors, landscape and IMUs show, against the library, within rounding."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import repro
from repro.networks import load_network
from repro_companion.papers import baaij, martin, rig

ROOT = Path(__file__).resolve().parents[2]
GRID = ROOT / "book" / "_static" / "live" / "landscape_grid.js"
TOLERANCE = 1e-9
NOW = "document.querySelector('.live-figure').live.now"
LARGEST_BYTES = 150_000


# The landscape of a loss


@pytest.fixture(scope="module")
def grid() -> dict:
    """Return what the file of the landscape says, with loss and slopes ``[3, y, x]``."""
    about = json.loads(GRID.read_text(encoding="utf-8").removeprefix("REPRO.grid = ").removesuffix(";\n"))
    n = about["points"]
    values = np.frombuffer(base64.b64decode(about["values"]), "<f4").reshape(3, n, n).astype(float)
    return about | {"values": values, "axis": np.linspace(-about["reach"], about["reach"], n)}


def bicubic(grid: dict, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return loss, gradient ``[points, 2]`` and largest curvature, by values and slopes of the corners of a cell."""
    loss, by_x, by_y = grid["values"]
    axis, h = grid["axis"], grid["axis"][1] - grid["axis"][0]
    mixed = (np.gradient(by_x, h, axis=0) + np.gradient(by_y, h, axis=1)) / 2
    i, j = np.clip(np.searchsorted(axis, points.T, "right") - 1, 0, len(axis) - 2)
    corners = np.array([[loss, h * by_y], [h * by_x, h * h * mixed]])  # [slope in x, slope in y, y, x]
    at = np.stack([corners[..., j + b, i + a] for a in (0, 1) for b in (0, 1)], axis=2)
    F = at.reshape(2, 2, 2, 2, -1).transpose(4, 0, 2, 1, 3).reshape(-1, 4, 4)
    M = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [-3, 3, -2, -1], [2, -2, 1, 1]])
    s, t = ((points - np.stack([axis[i], axis[j]], axis=-1)) / h).T

    def of(dx: int, dy: int) -> np.ndarray:
        powers = [
            np.stack([np.polynomial.Polynomial.basis(k).deriv(m)(z) / h**m for k in range(4)], axis=-1)
            for z, m in ((s, dx), (t, dy))
        ]
        return np.einsum("pi,pij,pj->p", powers[0], M @ F @ M.T, powers[1])

    H = np.array([[of(2, 0), of(1, 1)], [of(1, 1), of(0, 2)]]).transpose(2, 0, 1)
    return of(0, 0), np.stack([of(1, 0), of(0, 1)], axis=-1), np.linalg.eigvalsh(H)[:, -1]


def test_the_grid_is_the_library_s(grid):
    """Loss and slopes at all nodes, to the seven digits of the file, which is small."""
    assert GRID.stat().st_size < LARGEST_BYTES
    folder = ROOT / "data" / "networks"
    files = (folder / f"rig_sensor{j + 1}_seed{grid['seed']}.safetensors" for j in range(3))
    sensing = repro.Sensing(rig.robot(), [load_network(file) for file in files], earth=rig.EARTH)
    x, y = np.meshgrid(grid["axis"], grid["axis"])
    u, J = sensing.linearise(np.stack([1e-3 * x, 1e-3 * y, np.full_like(x, grid["elongation"])], axis=-1))
    off = u - grid["readings"]
    slopes = 2 / 3 * (off[..., None] * 1e-3 * J[..., :2]).sum(axis=-2)
    expected = np.stack([(off**2).mean(axis=-1), *np.moveaxis(slopes, -1, 0)])
    assert_allclose(grid["values"], expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_the_map_is_bicubic(figure, grid):
    """At random bends, at nodes and on the edges."""
    rng, reach = np.random.default_rng(0), grid["reach"]
    points = rng.uniform(-reach, reach, (3000, 2))
    points[:100] = rng.choice(grid["axis"], (100, 2))
    points[100:200, 0] = rng.choice([-reach, reach], 100)
    page = figure("landscape")
    body = """points => points.map(([x, y]) => { const { loss, gradient, curvature } = REPRO.landscape.lossAt(x, y);
      return [loss, ...gradient, curvature]; })"""
    found = np.array(page.evaluate(body, points.tolist()))
    loss, gradient, curvature = bicubic(grid, points)
    inside = np.ones(len(points), dtype=bool)
    inside[:200] = False  # on an edge of cells the curvature jumps
    for k, expected in enumerate((loss, *gradient.T)):
        assert_allclose(found[:, k], expected, rtol=TOLERANCE, atol=TOLERANCE * np.abs(expected).max())
    size = np.abs(curvature[inside]).max()
    assert_allclose(found[inside, 3], curvature[inside], rtol=TOLERANCE, atol=TOLERANCE * size)


@pytest.mark.parametrize(("step", "momentum"), [(1, 0.2), (0.1, 0.9), (0.5, 0.0)])
def test_each_step_of_the_descent(figure, grid, step, momentum):
    """Equations (9) to (12) from each bend that was tried to the next; the estimate is the best of them."""
    page = figure("landscape", f"#landscape=step:{step},momentum:{momentum},x:-2.5,y:4.5")
    now = page.evaluate(NOW)
    tried = np.array([[one["x"], one["y"]] for one in now["trail"]])
    loss, gradient, _ = bicubic(grid, tried)
    assert_allclose([one["loss"] for one in now["trail"]], loss, rtol=TOLERANCE)
    b = np.zeros(2)
    for k in range(len(tried) - 1):
        b = momentum * b + gradient[k]
        assert_allclose(tried[k + 1], tried[k] - 1.5e-2 * step * b, rtol=TOLERANCE, atol=TOLERANCE)
    assert now["best"]["loss"] == min(one["loss"] for one in now["trail"])
    assert len(tried) > 5


# Sensors that fail


@pytest.mark.parametrize("off", ["4", "4;8;12", "1;6;7"])
def test_estimates_without_lost_sensors(figure, off):
    """Each estimate of the course, from the one before, with the readings that are left; and what a loss costs."""
    page = figure("failure", f"#failure=off:{off}")
    now, course = page.evaluate(NOW), baaij.lemniscate(3, steps=101)
    robot, u = baaij.robot(n_segments=3, sensors_per_segment=4), np.array(now["u"])
    sensing = repro.Sensing(robot)
    left = np.array([one["q"] for one in now["left"]])
    mask = np.ones(u.shape, dtype=bool)
    mask[50:] = now["working"]
    assert sorted(np.flatnonzero(~mask[-1]) + 1) == [int(s) for s in off.split(";")]

    start = np.vstack([course[:1], left[:-1]])
    bend = 0.022 * np.radians(54)
    low, high = np.tile([-bend, -bend, 0.0], 3), np.tile([bend, bend, 6.6e-3], 3)
    method = repro.LevenbergMarquardt(sensing, low, high, noise=1e-3, iterations=3, tolerance=1e-12)
    prior = start, np.zeros((9, 9))  # it says nothing
    expected = method.fit(start, np.where(mask, u, np.nan), None, prior)[0]
    assert_allclose(left, expected, rtol=0, atol=TOLERANCE * np.abs(expected).max())

    tips = [robot.tip(q)[:, :3, 3] for q in (left, course)]
    off_mm = 1e3 * np.linalg.norm(tips[0] - tips[1], axis=-1)
    assert_allclose([one["off"] for one in now["left"]], off_mm, rtol=1e-6, atol=TOLERANCE)
    J = sensing.linearise(course[now["k"]])[1]
    whole, less = (np.sqrt(np.diag(np.linalg.inv(A.T @ A))) for A in (J, J[mask[-1]]))
    assert_allclose(now["factors"], less / whole, rtol=1e-8)


# Orientations along an arm


@pytest.mark.parametrize(("imus", "segments"), [(2, 16), (4, 16), (8, 8), (8, 64)])
def test_markers_of_both_models(figure, imus, segments):
    """From what the IMUs read, as the library places the markers; errors are distances from those on the arm."""
    page = figure("imus", f"#imus=imus:{imus},segments:{segments},seed:3")
    now = page.evaluate(NOW)
    readings, points = np.array(now["readings"]), np.array(now["points"])
    for name, model in (("rigid", repro.rigid_body), ("pcc", repro.pcc_extended)):
        arm = martin.arm(name, imus, segments)
        expected = model(arm.select(readings), arm, arm.markers)
        assert_allclose(now[name]["marked"], expected, rtol=0, atol=TOLERANCE)
        off = 1e3 * np.linalg.norm(expected - points[[90, 150]], axis=-1)
        assert_allclose(now[name]["errors"], off, rtol=0, atol=1e3 * TOLERANCE)


def test_the_arm_itself(figure):
    """Bent evenly it is an arc, and perfect IMUs read how it is turned."""
    page = figure("imus", "#imus=mounting:0,heading:0,tilt:0,shape:70;30;0;0")
    now = page.evaluate(NOW)
    turns, points = np.array(now["turns"]), np.array(now["points"])
    assert_allclose(now["readings"], turns[::20], atol=TOLERANCE)
    arm = repro.Arm([0, 8], [0.0, 0.64], [0.64], sub_segments=1)
    arc = repro.exact_arcs(turns[[0, -1]], arm, np.linspace(0, 0.64, 161))
    assert_allclose(points, arc, rtol=0, atol=1e-5)
