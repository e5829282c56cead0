"""The models of the live figures, in the browser, against the library: the same numbers on random inputs.

Readings, slopes, steps of the estimators and chains of IMUs are computed by ``book/_static/live/model.js`` in a page
that is opened from disk, and by the library; they may differ by rounding only.
"""

from __future__ import annotations

import base64
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from edition1 import (
    BendSensor,
    ConstantCurvature,
    GradientDescent,
    LevenbergMarquardt,
    Ring,
    Robot,
    magnet_mounts,
    sensor_mounts,
)
from edition1.estimation._resampling import draws, stream
from edition1.estimation.levenberg_marquardt import covariance
from edition1.estimation.particle_filter import ParticleFilter, ParticleState
from edition1.estimation.regions import Disc
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnets import B444B, ring

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
        rng = np.random.default_rng(n_segments)
        of_sensor = [i for i in range(n_segments) for _ in range(4)]
        directions = rng.normal([0, 0, 3], 0.3, (n_segments, 3)).tolist()
        magnets = magnet_mounts(range(n_segments), rng.uniform(0.05, 0.06, n_segments).tolist(), directions)
        k = len(of_sensor)
        sensors = sensor_mounts(of_sensor, rng.uniform(0.09, 0.11, k).tolist(), rng.uniform(0.005, 0.02, k).tolist(),
                                rng.uniform(0, 7, k).tolist(), rng.uniform(-0.3, 1, k).tolist())  # fmt: skip
        self.robot = Robot((ConstantCurvature(0.11, 0.022),) * n_segments, magnets, sensors)
        self.moments = torch.from_numpy(ring("released").multipoles(9))
        self.gain = torch.from_numpy(rng.uniform(0.9, 1.1, k))
        self.sensing = LinearisedSensing(self.robot, self.moments, self.gain)
        size = rng.choice([0.0, 1e-12, 1e-4, 1.0], n, p=[0.01, 0.05, 0.05, 0.89])
        unit = rng.uniform(-1, 1, (n, n_segments, 3)) * [0.022, 0.022, 3.3e-3]
        self.q = torch.from_numpy((size[:, None, None] * unit + [0, 0, 3.3e-3]).reshape(n, -1))
        self.low, self.high = (torch.tensor([s * 0.0225, s * 0.0225, dL] * n_segments, dtype=torch.float64)
                               for s, dL in ((-1, 0.0), (1, 6.6e-3)))  # fmt: skip
        self.use = torch.from_numpy(rng.random((n, k)) < 0.9)
        self.use[:, 0] = True
        self.u = self.sensing(self.q) + 1e-3 * torch.from_numpy(rng.normal(size=(n, k)))

    def data(self, **more) -> dict:
        def mounts(them) -> list:
            return [
                {"segment": i, "axial": a, "position": T[:3, 3].tolist(), "axis": T[:3, 2].tolist()}
                for i, a, T in zip(them.segment, them.axial.tolist(), them.local, strict=True)
            ]

        return {
            "segments": len(self.robot.segments),
            "length": 0.11,
            "radius": 0.022,
            "magnets": mounts(self.robot.magnets),
            "sensors": mounts(self.robot.sensors),
            "moments": self.moments.tolist(),
            "gains": self.gain.tolist(),
            "n": self.robot.n_q,
            "s": len(self.robot.sensors),
            **{name: x.double().numpy() if isinstance(x, torch.Tensor) else x for name, x in more.items()},
        }


@pytest.fixture(scope="module", params=[1, 2, 3])
def example(request) -> Example:
    return Example(request.param, CONFIGURATIONS // 3 + 1)


@pytest.mark.parametrize("magnet", [ring("released"), ring("published"), Ring(8e-3, 0.0, 3e-3, 900.0)])
def test_moments_of_a_ring(models, magnet):
    given = {"size": [magnet.outer_diameter, magnet.inner_diameter, magnet.height, magnet.polarisation_mt]}
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
    J = torch.func.jacrev(lambda x: example.robot.tip(x)[:, :3, 3].sum(0))(q).movedim(0, -2)
    body = f"{BODY} return packed(rows(d.q, d.n).flatMap(q => flat(REPRO.tip(body, q))));"
    found = models(body, example.data(q=q)).reshape(len(q), -1)
    assert_same(found[:, :3], expected)
    assert_same(found[:, 3:], J)


@pytest.mark.parametrize(("iterations", "n"), [(1, CONFIGURATIONS), (3, 300)])
def test_steps_of_levenberg_marquardt(models, example, iterations, n):
    """From the straight pose, some sensors off; some end at a bound."""
    q, u, use = example.q[:n], example.u[:n], example.use[:n]
    method = LevenbergMarquardt(
        example.sensing, example.low, example.high, noise_mt=1e-3, iterations=iterations
    )
    start = torch.tensor([0.0, 0.0, 3e-3] * len(example.robot.segments), dtype=torch.float64)
    _, expected = method.step(method.init(start.expand_as(q)), u, 0.0, mask=use)
    body = f"""{SENSING} const use = rows(d.use, d.s), u = rows(d.u, d.s);
      return packed(u.flatMap((u, k) => {{
        const f = REPRO.levenbergMarquardt(sensing, d.start, [...u], use[k], d.low, d.high, {iterations});
        return [...f.q, ...f.u, f.rmse];
      }}));"""
    lists = {"start": start.tolist(), "low": example.low.tolist(), "high": example.high.tolist()}
    found = models(body, example.data(u=u, use=use, **lists)).reshape(len(q), -1)
    n, s = example.robot.n_q, len(example.robot.sensors)
    assert_same(found[:, :n], expected.q)
    assert_same(found[:, n : n + s], expected.u_hat)
    np.testing.assert_allclose(
        found[:, n + s], expected.diagnostics["rmse"], rtol=TOLERANCE, atol=1e-12
    )  # [mT]
    assert bool(expected.diagnostics["at_bound"].any())


def test_covariance_of_least_squares(models, example):
    expected = covariance(example.sensing.linearise(example.q)[1], 1e-3)
    body = f"""{SENSING} const use = d.gains.map(() => true);
      return packed(rows(d.q, d.n).flatMap(q => REPRO.covariance(sensing(q).J, use, 1e-3).flatMap(r => [...r])));"""
    assert_same(models(body, example.data(q=example.q)), expected)


def test_gradient_descent(models, example):
    """Four evaluations, with a momentum that is carried along; step sizes at which the descent is stable."""
    q, u, use = example.q[:500], example.u[:500], example.use[:500]
    n_segments = len(example.robot.segments)
    steps = {1: (3e-5, 3e-5), 2: (3e-4, 3e-5), 3: (2e-4, 2e-5)}[n_segments]
    gamma = torch.tensor([steps[0], steps[0], steps[1]] * n_segments, dtype=torch.float64)
    start = torch.tensor([0.0, 0.0, 3e-3] * n_segments, dtype=torch.float64).expand_as(q)
    method = GradientDescent(example.sensing, gamma, 0.3, 4)
    state, _ = method.step(method.init(start), u, 0.0, mask=use)
    state, expected = method.step(state, u, 0.0, mask=use)
    body = f"""{SENSING} const use = rows(d.use, d.s), u = rows(d.u, d.s);
      return packed(u.flatMap((u, k) => {{
        let f = {{ q: d.start, momentum: d.start.map(() => 0) }};
        for (const _ of [0, 1]) f = REPRO.gradientDescent(sensing, f.q, f.momentum, [...u], use[k], d.steps, 0.3, 4);
        return [...f.q, ...f.momentum, f.loss];
      }}));"""
    lists = {"start": start[0].tolist(), "steps": gamma.tolist()}
    found = models(body, example.data(u=u, use=use, **lists)).reshape(len(q), -1)
    n = example.robot.n_q
    assert_same(found[:, :n], expected.q)
    assert_same(found[:, n : 2 * n], state.momentum)
    assert_same(found[:, 2 * n], expected.diagnostics["loss"][:, None])


def bends(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Bend vectors on a disc of 90 degrees, some straight or all but straight."""
    q = rng.uniform(-1, 1, (*shape, 2)) * math.pi / 2 / math.sqrt(2)
    return q * rng.choice([0.0, 1e-9, 1e-2, 1.0], (*shape, 1), p=[0.01, 0.05, 0.05, 0.89])


def test_readings_of_a_bent_arc(models):
    q = bends(np.random.default_rng(0), CONFIGURATIONS)
    body = "return packed(rows(d.q, 2).flatMap(q => REPRO.bendReading(q[0], q[1], 0.015, d.edge, d.mt)));"
    found = models(body, {"q": q, "edge": B444B.edge, "mt": B444B.polarisation_mt})
    assert_same(found, BendSensor(15e-3)(torch.from_numpy(q)))


@pytest.mark.parametrize(("estimate", "scheme"), [("best tenth", "multinomial"), ("weighted", "systematic")])
def test_a_step_of_the_particle_filter(models, estimate, scheme):
    """On given random numbers: estimate, particles drawn, and moved within the disc."""
    rng, n, members = np.random.default_rng(1), 20, CONFIGURATIONS // 4
    method = ParticleFilter(BendSensor(15e-3), torch.tensor([0.1, 0.1], dtype=torch.float64), 0.1, Disc(math.pi / 2),
                            particles=n, estimate=estimate, resampling=scheme)  # fmt: skip
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
        u = BendSensor(15e-3)(torch.from_numpy(truth)) + 0.1 * torch.from_numpy(rng.normal(size=(members, 3)))
        state = ParticleState(torch.from_numpy(q), torch.zeros(members, n, 2, dtype=torch.float64), seed, 3)
        after, expected = method.step(state, u, 0.0)
        generator = stream(seed, 3)
        shares, noise = draws(n, scheme, generator), generator.standard_normal((51, n, 2))
        kind = "bestTenth" if estimate == "best tenth" else "mean"
        given = {"q": q, "u": u.numpy(), "noise": noise, "shares": shares.tolist(), "n": n, "kind": kind}
        found = models(body, given | {"edge": B444B.edge, "mt": B444B.polarisation_mt}).reshape(members, -1)
        assert_same(found[:, :2], expected.q)
        assert_same(found[:, 2 : 2 + 2 * n], after.q)
        effective = 1 / (found[:, 2 + 2 * n :] ** 2).sum(1)
        np.testing.assert_allclose(effective, expected.diagnostics["effective_sample_size"], rtol=1e-8)
