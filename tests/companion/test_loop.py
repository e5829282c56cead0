"""The page on closed loops: its filter, its loop, references, loads and errors."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import repro
from repro_companion.papers import baaij, loop
from repro_companion.show import project_folder, study

METHOD = ["noise_mt: float", "def moved", "def closed_loop", "def dot", "def kalman"]


@pytest.fixture(scope="module")
def page():
    """Return the names that the cells of the page define; the loops themselves do not run."""
    text = Path(project_folder(), "notebooks", "closed_loop.ipynb").read_text(encoding="utf-8")
    cells = ["".join(c["source"]) for c in json.loads(text)["cells"] if c["cell_type"] == "code"]
    space = {}
    for words in METHOD:
        [cell] = [cell for cell in cells if words in cell]
        exec(compile(cell, words, "exec"), space)
        space["fast"] = True
    return space


def follow(page, cases, estimator=None, **options):
    """Run the loop of the page over other cases, the truth fed back if there is no estimator."""
    r = cases.reference
    page |= {"cases": cases, "steps": len(r) - 1, "r": r, "velocity": np.diff(r, axis=0) / page["tau"]}
    truth = {"read": lambda q, k: q, "late": 0}
    return page["closed_loop"](
        *([estimator()] if estimator else [lambda q, c: q]), **({} if estimator else truth) | options
    )


def rms_mm(difference):
    return 1e3 * np.sqrt((difference[80:, :, :2] ** 2).sum(-1).mean())


def test_the_filter_of_the_page_is_the_filter_of_the_library(page):
    width, noise_mt, steps = page["width"], 0.005, 200
    q = loop.reference("lemniscate", np.arange(steps) * page["tau"])
    u = repro.simulated_readings(page["robot"], q) + noise_mt * np.random.default_rng(0).normal(
        size=(steps, 3)
    )
    method = repro.KalmanFilter(page["h"], page["low"], page["high"], noise_mt, 0.1 * width, tolerance=1e-12)
    shape = repro.track(method, u, loop.REST, rate_hz=baaij.RATE_HZ, monitor=None)
    inside = np.cumsum(shape.details["at_bound"].any(-1)) == 0  # the page has no bounds
    assert inside.sum() > 50
    x, P = np.concatenate([loop.REST, np.zeros(3)]), np.diag(np.concatenate([width**2 / 12, width**2 / 4]))
    for k in np.flatnonzero(inside):
        x, P = page["update"](x, P, u[k], noise_mt)
        np.testing.assert_allclose(x[:3], shape.q[k], atol=1e-8)
        np.testing.assert_allclose(P[:3, :3], shape.covariance[k], rtol=1e-4, atol=1e-13)
        x, P = page["predict"](x, P, page["constant_velocity"](0.1 * width))


def test_a_linear_update_is_the_textbook_one(page, monkeypatch):
    rng = np.random.default_rng(1)
    H, A = rng.normal(size=(3, 3)), rng.normal(size=(6, 6))
    x, P, u = rng.normal(size=6), A @ A.T, rng.normal(size=3)
    linear = type("Linear", (), {"linearise": staticmethod(lambda q: (H @ q, H))})
    monkeypatch.setitem(page, "h", linear)
    wide = np.hstack([H, np.zeros((3, 3))])
    K = P @ wide.T @ np.linalg.inv(wide @ P @ wide.T + 0.3**2 * np.eye(3))
    mean, covariance = page["update"](x, P, u, 0.3)
    np.testing.assert_allclose(mean, x + K @ (u - wide @ x), rtol=1e-7)
    np.testing.assert_allclose(covariance, P - K @ wide @ P, atol=1e-8)


def test_the_motion_of_the_arm_solves_its_equation(page):
    """T dq/dt = c + d - q with a constant load: the transition of the filter, and the step of the loop."""
    c, d, T, tau = 3.0, 1.0, page["lag_s"], page["tau"]
    exact = solve_ivp(lambda t, q: (c + d - q) / T, (0, tau), [0.5], rtol=1e-10, atol=1e-12).y[0, -1]
    F, Q = page["following"](np.ones(3))
    x, _ = page["predict"](
        np.repeat([0.5, d], 3), np.eye(6), (F, Q), np.repeat([(1 - page["lag"]) * c, 0], 3)
    )
    np.testing.assert_allclose(x, np.repeat([exact, d], 3), rtol=1e-8)
    np.testing.assert_allclose(np.diag(Q), np.repeat([0, tau], 3))


def test_without_load_and_noise_the_arm_follows_and_a_softer_one_overshoots(page):
    cases = loop.Cases([0], 0.0, 0.0, 400, ["circle"])
    q, fed_back, _ = follow(page, cases)
    np.testing.assert_array_equal(q, fed_back)
    off = [rms_mm((cases.reference[:400] - q)[:, [case]]) for case in range(len(cases.table))]
    error = cases.table.assign(off=off).pivot(index="controller", columns="session", values="off")
    # What the command of a modelled arm leaves is half a sample of hold.
    half_a_sample = 10 * 2 * math.pi / 4 * page["tau"] / 2
    assert (error["as modelled"] < half_a_sample).all()
    assert (error["softer by a fifth"] > error["as modelled"]).all()


def test_the_late_truth_is_the_truth_of_the_sample_before(page):
    cases = loop.Cases([3], 0.0, 2.0, 60)
    q, fed_back, _ = follow(page, cases, late=1)
    np.testing.assert_array_equal(fed_back[1:], q[:-1])


def test_with_exact_readings_the_filter_with_the_command_predicts_the_present(page, monkeypatch):
    """Without a load the late reading and the command determine where the arm is now."""
    monkeypatch.setitem(page, "loop_noise_mt", 1e-4)
    cases = loop.Cases([0], 1e-4, 0.0, 160, ["lemniscate"])
    own = (cases.table["session"] == "as modelled").to_numpy()
    motion = page["following"](page["width"] * loop.LOAD)
    q, fed_back, _ = follow(page, cases, lambda: page["kalman"](motion, 1 - page["lag"]))
    off = rms_mm((q - fed_back)[:, own])
    late = rms_mm((q[1:] - q[:-1])[:, own])
    assert off < 0.1 * late
    assert (
        off < 1.5 * 1e3 * 0.051 * 1e-4 * math.sqrt(2) * 3
    )  # 51 mm per mT, some of it by the gain of the loop


def test_the_process_noise_in_the_loop_is_the_best_on_the_ellipse(page, monkeypatch):
    monkeypatch.setattr(loop, "ARMS", {"as modelled": 1.0})
    seeds, factors = [1000, 1001, 1002, 1003], np.array([0.5, 1.0, 2.0])
    cases = loop.Cases(seeds * 3, page["loop_noise_mt"], page["load_mm"], 400, ["ellipse"])
    own = factors.repeat(4)[np.arange(len(cases.table)) % 12]
    for motion, share, push in (
        (page["constant_velocity"], loop.VELOCITY, 0.0),
        (page["following"], loop.LOAD, 1 - page["lag"]),
    ):
        F, Q = motion(share * page["width"])
        both = F, Q * own[:, None, None] ** 2  # a variance
        run = follow(page, cases, lambda motion=both, push=push: page["kalman"](motion, push))
        errors = cases.errors({"truth": run})["tracking_mm"]
        assert errors.groupby(own).mean().idxmin() == 1.0


@pytest.mark.parametrize("name", [*loop.REFERENCES, "ellipse"])
def test_references_are_smooth_and_start_again(name):
    period = {"step": 8.0, "circle": 4.0, "lemniscate": 8.0, "ellipse": 5.0}[name]
    r = loop.reference(name, np.linspace(period, 2 * period, 2001))
    np.testing.assert_allclose(r[0], r[-1], atol=1e-12)
    speed = np.linalg.norm(np.diff(r, axis=0), axis=1) * 2000 / period
    farthest = 9e-3 * math.sqrt(2) * math.pi / 2 / loop.RISE_S  # a cosine over the rise
    assert speed.max() <= farthest * 1.001
    np.testing.assert_array_equal(r[:, 2], loop.REST[2])


def test_steps_rest_at_their_corners():
    r = 1e3 * loop.reference("step", np.array([1.99, 2.0, 2.25, 2.5, 3.9, 7.9]))
    np.testing.assert_allclose(r[:, :2], [[9, 0], [9, 0], [4.5, 4.5], [0, 9], [0, 9], [0, -9]], atol=1e-9)


def test_a_load_has_its_size_and_forgets_within_a_second():
    noise, load = loop.disturbances(5, 0.02, 2.0, 40_000)
    assert load[:, :2].std() == pytest.approx(2e-3, rel=0.1)
    assert noise.std() == pytest.approx(0.02, rel=0.02)
    x = load[:, 0] / load[:, 0].std()
    assert (x[40:] * x[:-40]).mean() == pytest.approx(math.exp(-1), abs=0.1)
    assert not load[:, 2].any()


def test_errors_of_a_loop_by_hand():
    cases = loop.Cases([0], 0.0, 0.0, 100, ["circle"])
    q = cases.reference[:100].copy()
    command = q.copy()
    command[90:, :, 0] = baaij.bounds(1)[1][0]
    command[:, :, 2] = baaij.bounds(1)[1][2]  # an elongation bounds no bend
    off = np.zeros((100, 1, 3))
    off[::4] = 2.0  # once in four samples: 1 in the root mean square, a half in the mean
    off[:80] = 9.0  # before the loop has settled
    runs = {"truth": (q + off * [3e-3, 0, 9], q + off * [3e-3, 4e-3, 9], command)}
    table = cases.errors(runs)
    columns = ["tracking_mm", "estimate_mm", "offset_mm", "apparent_mm", "bounded_%"]
    np.testing.assert_allclose(table[columns], np.tile([3, 4, 2, 5, 50], (len(table), 1)))


MEANS = pd.DataFrame(
    {
        "controller": [*loop.CONTROLLERS],
        "tracking_mm": [3.0, 1.0],
        "estimate_mm": [2.0, 6.0],
        "bounded_%": [0, 9],
    }
).assign(session="a", estimator="b", offset_mm=[4.0, 2.0])


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        # Two seeds of one loop.
        (
            lambda: loop.tracking_means(MEANS.assign(controller="high gain", seed=[0, 1])).iloc[0, 3:],
            [2, 2, 4, 3, 4.5],
        ),
        (
            lambda: loop.over_time(
                loop.Cases([0], 0.0, 0.0, 4, ["circle"]),
                dict.fromkeys(
                    ("truth", loop.ALONE, loop.FILTER, loop.INFORMED),
                    (np.full((4, 4, 3), 2e-3), np.full((4, 4, 3), 5e-3), None),
                ),
                "moderate gain",
                "circle",
            ).iloc[0, 2:],
            [0, 10, 2, 5, 0, 2, 5],
        ),
        # The larger error of an estimate, whatever the controller.
        (lambda: loop.tracking_table(MEANS, "a").iloc[:, 1:], [[3, 1, 6]]),
    ],
)
def test_numbers_of_the_page_by_hand(found, expected):
    np.testing.assert_allclose(np.asarray(found(), dtype=float), expected, rtol=1e-9)


def test_the_study_of_noise_continues_the_page():
    keys = ["estimator", "controller", "session"]
    committed = pd.read_csv(project_folder() / "results" / "closed_loop_means.csv").set_index(keys)
    noises = study("closed_loop")
    here = noises[noises["noise_mt"] == noises["noise_mt"].max()].set_index(keys)
    np.testing.assert_allclose(here["tracking_mm"], committed["tracking_mm"], rtol=1e-3)
    table = loop.noise_table(noises)
    assert len(table) == 2 * noises["noise_mt"].nunique()
    assert f"{table[loop.INFORMED].iloc[0]:.2f} mm off its reference" in loop.in_words(table)
