"""The models of the live figures, in the browser, against the library: the same numbers on random inputs.

Readings, slopes, steps of the estimators and chains of IMUs are computed by ``book/_static/live/model.js`` in a page
that is opened from disk, and by the library; they may differ by rounding only.
"""

from __future__ import annotations

import base64
import math
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from repro import (
    BendSensor,
    ConstantCurvature,
    Cube,
    GradientDescent,
    LevenbergMarquardt,
    Magnet,
    ParticleFilter,
    Ring,
    Robot,
    Sensing,
    Sensor,
)
from repro.chain import point_on
from repro.estimators.least_squares import CHI2
from repro.estimators.particle import BendDisc, ParticleState, _points, _stream

RELEASED, PUBLISHED = Ring(24e-3, 12e-3, 6e-3, 1450.0), Ring(12e-3, 6e-3, 6e-3, 1450.0)
B444B = Cube(6.35e-3, 1320.0)
LIVE = Path(__file__).resolve().parents[2] / "book" / "_static" / "live"
CONFIGURATIONS = 10_000
TOLERANCE = 1e-9
"""Largest relative difference, in the largest number of a row."""

PAGE = """<!doctype html><meta charset="utf-8"><title>Models</title><script src="MODEL"></script><script>
const numbers = text => new Float64Array(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);
const packed = list => {
  const bytes = new Uint8Array(Float64Array.from(list).buffer), parts = [];
  for (let k = 0; k < bytes.length; k += 32768) parts.push(String.fromCharCode(...bytes.subarray(k, k + 32768)));
  return btoa(parts.join(""));
};
const parts = (x, n) => Array.from({length: x.length / n}, (_, k) => x.slice(k * n, k * n + n));
const rows = (text, n) => parts(numbers(text), n), pairs = x => parts([...x], 2);
const flat = ({u, p, J}) => [...(u || p), ...J.flatMap(row => [...row])];
</script>"""

BODY = "const body = REPRO.robot(d.segments, d.length, d.radius, d.magnets, d.sensors);"
SENSING = BODY + "const sensing = REPRO.magneticSensing(body, d.moments, d.gains);"


@pytest.fixture(scope="module")
def models(browser, tmp_path_factory):
    """Run a function ``d => numbers`` in a page that has the models; return the numbers in rows."""
    path = tmp_path_factory.mktemp("live") / "models.html"
    path.write_text(PAGE.replace("MODEL", (LIVE / "model.js").as_uri()), encoding="utf-8")
    page = browser.new_page()
    page.goto(path.as_uri())

    def run(body: str, given: dict) -> np.ndarray:
        data = {k: packed(x) if isinstance(x, np.ndarray) else x for k, x in given.items()}
        found = page.evaluate(f"d => {{ {body} }}", data)
        return np.frombuffer(base64.b64decode(found), dtype=np.float64)

    yield run
    page.close()


def packed(x: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(x, dtype=np.float64).tobytes()).decode()


def assert_same(found: np.ndarray, expected) -> None:
    """Each row within the tolerance, relative to its largest number."""
    expected = np.asarray(expected, dtype=np.float64)
    rows = expected.reshape(len(expected), -1)
    difference = np.abs(found.reshape(rows.shape) - rows).max(1) / np.abs(rows).max(1)
    assert difference.max() <= TOLERANCE, f"row {difference.argmax()} differs by {difference.max():.1e}"


class Example:
    """A robot whose parts are not as drawn, and configurations: straight or all but, and bent up to 80 degrees."""

    def __init__(self, n_segments: int, n: int) -> None:
        rng, self.n_segments = np.random.default_rng(n_segments), n_segments
        magnets = [
            Magnet(RELEASED, i, rng.uniform(0.05, 0.06), direction=rng.normal([0, 0, 3], 0.3))
            for i in range(1, n_segments + 1)
        ]
        sensors = [
            Sensor(
                i,
                rng.uniform(0.09, 0.11),
                radial=rng.uniform(0.005, 0.02),
                azimuth=rng.uniform(0, 7),
                tilt=rng.uniform(-0.3, 1),
            )
            for i in range(1, n_segments + 1)
            for _ in range(4)
        ]
        self.robot = Robot([ConstantCurvature(0.11, 0.022)] * n_segments, magnets, sensors)
        self.gain = rng.uniform(0.9, 1.1, len(sensors))
        self.sensing = Sensing(self.robot, gain=self.gain)
        size = rng.choice([0.0, 1e-12, 1e-4, 1.0], n, p=[0.01, 0.05, 0.05, 0.89])
        unit = rng.uniform(-1, 1, (n, n_segments, 3)) * [0.022, 0.022, 3.3e-3]
        self.q = (size[:, None, None] * unit + [0, 0, 3.3e-3]).reshape(n, -1)
        self.start = np.tile([0.0, 0.0, 3e-3], n_segments)
        self.low, self.high = (
            np.tile([s * 0.0225, s * 0.0225, dL], n_segments) for s, dL in ((-1, 0.0), (1, 6.6e-3))
        )
        self.use = rng.random((n, len(sensors))) < 0.9
        self.use[:, 0] = True
        self.u = self.sensing(self.q) + 1e-3 * rng.normal(size=self.use.shape)

    def data(self, **more) -> dict:
        def mounts(parts) -> list:
            return [
                {
                    "segment": place.segment - 1,
                    "axial": place.at,
                    "position": place.position.tolist(),
                    "axis": place.rotation[:, 2].tolist(),
                }
                for place in (part.place for part in parts)
            ]

        return {
            "segments": self.n_segments,
            "length": 0.11,
            "radius": 0.022,
            "magnets": mounts(self.robot.magnets),
            "sensors": mounts(self.robot.sensors),
            "moments": RELEASED.multipoles(9).tolist(),
            "gains": self.gain.tolist(),
            "n": self.robot.n_q,
            "s": len(self.robot.sensors),
            **{name: x.astype(float) if isinstance(x, np.ndarray) else x for name, x in more.items()},
        }


@pytest.fixture(scope="module", params=[1, 2, 3])
def example(request) -> Example:
    return Example(request.param, CONFIGURATIONS // 3 + 1)


@pytest.mark.parametrize("magnet", [RELEASED, PUBLISHED, Ring(8e-3, 0.0, 3e-3, 900.0)])
def test_moments_of_a_ring(models, magnet):
    given = {"size": list(astuple(magnet))}
    found = models("return packed(REPRO.ringMoments(...d.size, 9));", given)
    np.testing.assert_allclose(found, magnet.multipoles(9), rtol=TOLERANCE)


def test_readings_and_slopes(models, example):
    u, J = example.sensing.linearise(example.q)
    body = f"{SENSING} return packed(rows(d.q, d.n).flatMap(q => flat(sensing(q))));"
    found = models(body, example.data(q=example.q)).reshape(len(u), -1)
    assert_same(found[:, : u.shape[-1]], u)
    assert_same(found[:, u.shape[-1] :], J)


def test_tip_and_its_slopes(models, example):
    q = example.q
    expected = example.robot.tip(q)[:, :3, 3]
    T, twists = example.robot.motion(q, [point_on(example.n_segments, 0.11)])
    arm = np.cross(twists[..., 0, :, :3], T[:, :1, :3, 3])  # of the turn about the base
    J = np.swapaxes(twists[..., 0, :, 3:] + arm, -1, -2)
    body = f"{BODY} return packed(rows(d.q, d.n).flatMap(q => flat(REPRO.tip(body, q))));"
    found = models(body, example.data(q=q)).reshape(len(q), -1)
    assert_same(found[:, :3], expected)
    assert_same(found[:, 3:], J)


@pytest.mark.parametrize(("iterations", "n"), [(1, CONFIGURATIONS), (3, 300)])
def test_steps_of_levenberg_marquardt(models, example, iterations, n):
    """From the straight pose, some sensors off; some end at a bound."""
    q, u, use = example.q[:n], example.u[:n], example.use[:n]
    method = LevenbergMarquardt(
        example.sensing, example.low, example.high, noise=1e-3, iterations=iterations, tolerance=1e-12
    )
    # A prior that says nothing: only the library treats open directions in a way of their own.
    n, start = example.robot.n_q, np.tile(example.start, (len(q), 1))
    x, u_hat, _, _, status, _ = method.fit(start, np.where(use, u, np.nan), None, (start, np.zeros((n, n))))
    body = f"""{SENSING} const use = rows(d.use, d.s), u = rows(d.u, d.s);
      return packed(u.flatMap((u, k) => {{
        const f = REPRO.levenbergMarquardt(sensing, d.start, [...u], use[k], d.low, d.high, {iterations});
        return [...f.q, ...f.u, f.rmse];
      }}));"""
    lists = {"start": example.start.tolist(), "low": example.low.tolist(), "high": example.high.tolist()}
    found = models(body, example.data(u=u, use=use, **lists)).reshape(len(q), -1)
    s = len(example.robot.sensors)
    assert_same(found[:, :n], x)
    assert_same(found[:, n : n + s], u_hat)
    rmse_mt = 1e-3 * np.sqrt(status[:, CHI2] / use.sum(1))
    np.testing.assert_allclose(found[:, n + s], rmse_mt, rtol=TOLERANCE, atol=1e-12)
    assert iterations > 1 or ((x == example.low) | (x == example.high)).any()


def test_covariance_of_least_squares(models, example):
    J = example.sensing.linearise(example.q)[1]
    expected = 1e-6 * np.linalg.inv(np.swapaxes(J, -1, -2) @ J)
    body = f"""{SENSING} const use = d.gains.map(() => true);
      return packed(rows(d.q, d.n).flatMap(q => REPRO.covariance(sensing(q).J, use, 1e-3).flatMap(r => [...r])));"""
    assert_same(models(body, example.data(q=example.q)), expected)


def test_gradient_descent(models, example):
    """Four evaluations, with a momentum that is carried along; step sizes at which the descent is stable."""
    q, u, use = example.q[:500], example.u[:500], example.use[:500]
    steps = {1: (3e-5, 3e-5), 2: (3e-4, 3e-5), 3: (2e-4, 2e-5)}[example.n_segments]
    gamma = np.tile([steps[0], steps[0], steps[1]], example.n_segments)
    method = GradientDescent(example.sensing, gamma, 0.3, 4)
    state, _ = method.step(method.init(np.tile(example.start, (len(q), 1))), u, mask=use)
    state, expected = method.step(state, u, mask=use)
    body = f"""{SENSING} const use = rows(d.use, d.s), u = rows(d.u, d.s);
      return packed(u.flatMap((u, k) => {{
        let f = {{ q: d.start, momentum: d.start.map(() => 0) }};
        for (const _ of [0, 1]) f = REPRO.gradientDescent(sensing, f.q, f.momentum, [...u], use[k], d.steps, 0.3, 4);
        return [...f.q, ...f.momentum, f.loss];
      }}));"""
    lists = {"start": example.start.tolist(), "steps": gamma.tolist()}
    found = models(body, example.data(u=u, use=use, **lists)).reshape(len(q), -1)
    n = example.robot.n_q
    assert_same(found[:, :n], expected.q)
    assert_same(found[:, n : 2 * n], state.momentum)
    assert_same(found[:, 2 * n], expected.details["loss"][:, None])


def bends(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Bend vectors on a disc of 90 degrees, some straight or all but straight."""
    q = rng.uniform(-1, 1, (*shape, 2)) * math.pi / 2 / math.sqrt(2)
    return q * rng.choice([0.0, 1e-9, 1e-2, 1.0], (*shape, 1), p=[0.01, 0.05, 0.05, 0.89])


def test_readings_of_a_bent_arc(models):
    q = bends(np.random.default_rng(0), CONFIGURATIONS)
    body = "return packed(rows(d.q, 2).flatMap(q => REPRO.bendReading(q[0], q[1], 0.015, d.edge, d.mt)));"
    found = models(body, {"q": q, "edge": B444B.edge, "mt": B444B.polarisation_mt})
    assert_same(found, BendSensor(15e-3)(q))


@pytest.mark.parametrize(("estimate", "scheme"), [("best tenth", "multinomial"), ("weighted", "systematic")])
def test_a_step_of_the_particle_filter(models, estimate, scheme):
    """On given random numbers: estimate, particles drawn, and moved within the disc."""
    rng, n, members = np.random.default_rng(1), 20, CONFIGURATIONS // 4
    sensor, region = BendSensor(15e-3), BendDisc(math.pi / 2)
    method = ParticleFilter(sensor, [0.1, 0.1], 0.1, region, n, estimate, scheme)
    body = """const sensing = (x, y) => REPRO.bendReading(x, y, 0.015, d.edge, d.mt);
      const clouds = rows(d.q, 2 * d.n).map(pairs), noise = rows(d.noise, 2 * d.n).map(pairs), u = rows(d.u, 3);
      return packed(clouds.flatMap((cloud, k) => {
        const w = REPRO.weigh(cloud, u[k], 0.1, sensing), estimates = REPRO.cloudEstimates(cloud, w);
        const drawn = REPRO.resample(w, d.shares).map(k => cloud[k]);
        return [...estimates[d.kind], ...REPRO.moveParticles(drawn, 0.1, Math.PI / 2, k => noise[k]).flat(), ...w];
      }));"""
    for seed in range(4):
        truth = bends(rng, members)
        q = truth[:, None] + 0.05 * rng.normal(size=(members, n, 2))
        q *= np.minimum(1, math.pi / 2 / np.linalg.norm(q, axis=-1, keepdims=True) * (1 - 1e-9))
        u = sensor(truth) + 0.1 * rng.normal(size=(members, 3))
        after, expected = method.step(ParticleState(q, np.zeros_like(q), seed, 3), u)
        generator = _stream(seed, 3)
        shares, noise = _points(n, scheme, generator), generator.standard_normal((51, n, 2))
        kind = "bestTenth" if estimate == "best tenth" else "mean"
        given = {"q": q, "u": u, "noise": noise, "shares": shares.tolist(), "n": n, "kind": kind}
        found = models(body, given | {"edge": B444B.edge, "mt": B444B.polarisation_mt}).reshape(members, -1)
        assert_same(found[:, :2], expected.q)
        assert_same(found[:, 2 : 2 + 2 * n], after.q)
        effective = 1 / (found[:, 2 + 2 * n :] ** 2).sum(1)
        np.testing.assert_allclose(effective, expected.details["effective_sample_size"], rtol=1e-8)
