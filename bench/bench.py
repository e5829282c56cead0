"""How fast the library is beside what a user would take instead, and what it costs: ``make bench``.

Rates are ratios of processor time in one run. Our method and the other one run in turn, and the shortest
time of each counts, so that a busy computer changes little. All work has one thread. Readings of magnets come
from magpylib, with noise. The table goes to ``data/benchmark.csv``. With ``--fast FILE`` everything runs once
with few numbers and the kernels that are on disk, for a test; the table goes to that file, and its figures mean
nothing. With ``--ratios`` the ratios alone are measured, on few numbers: a target that is missed by more than a
factor of two ends it with 1.
"""

from __future__ import annotations

import os

# Libraries read the number of threads when they are imported.
os.environ |= {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}

import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial, reduce
from importlib.util import find_spec
from pathlib import Path
from timeit import timeit
from typing import Any

import numpy as np

import repro
from repro.networks import load_network
from repro.sensing import sensing_of
from repro.tolerances import Tolerances, placed, priors_of

ROOT = Path(__file__).resolve().parents[1]
FAST, RATIOS = sys.argv[1:2] == ["--fast"], sys.argv[1:] == ["--ratios"]
SLACK = 2.0
NOISE_MT = 5e-3
RING = repro.Ring(24e-3, 12e-3, 6e-3, 1450.0)
NETWORKS = [ROOT / f"data/networks/pcc_nb3_segment{i}_seed0.safetensors" for i in (1, 2, 3)]
Rows = Iterator[tuple[str, float, str]]
"""Capability, figure, and target such as ``>= 1``; NaN says that a package is not installed."""


def few(n: int) -> int:
    """Return a size of a problem, small in a fast run."""
    return max(n // 50, 4) if FAST else max(n // 10, 20) if RATIOS else n


def fastest(*jobs: Callable[[], Any]) -> list[float]:
    """Return the shortest processor time of every job [s], after a first call that compiles."""
    return np.min(
        [
            [timeit(job, timer=time.process_time, number=1) for job in jobs]
            for _ in range(2 if FAST else 6 if RATIOS else 25)
        ][1:],
        axis=0,
    ).tolist()


def ratio(ours: Callable[[], Any], other: Callable[[], Any]) -> float:
    """Return how many times as fast as the other job ours is."""
    return float(np.divide(*fastest(other, ours)))


def paper_robot(n_b: int) -> tuple[repro.Robot, np.ndarray, np.ndarray]:
    """Return the robot of Baaij et al. 2023, section 3.1, and the bounds of its workspace."""
    sensors = [
        repro.Sensor(i, 0.11, radial=0.013, azimuth=2 * np.pi / 3 * k)
        for i in range(1, n_b + 1)
        for k in range(3)
    ]
    magnets = [repro.Magnet(RING, i, 0.055) for i in range(1, n_b + 1)]
    robot = repro.Robot([repro.ConstantCurvature(0.11, 0.022)] * n_b, magnets, sensors)
    return robot, np.tile([-0.02073, -0.02073, 0.0], n_b), np.tile([0.02073, 0.02073, 0.0066], n_b)


def on_t3(n_b: int, steps: int) -> tuple[repro.Robot, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return that robot with its bounds, the first of 400 time steps of trajectory T3, and readings there.

    Readings are those of magpylib with noise [mT]. The elongation keeps 0.5 mm from its bounds, near which
    SciPy is slow.
    """
    robot, low, high = paper_robot(n_b)
    s, p = 2 * np.pi * np.arange(steps)[:, None] / 400, 2 * np.pi * np.arange(n_b) / n_b
    q = np.stack(
        [0.01728 * np.sin(2 * s + p), 0.01728 * np.sin(s + p), 2.75e-3 * (1.2 + np.sin(s + p))], axis=-1
    ).reshape(steps, 3 * n_b)
    u = repro.simulated_readings(robot, q)
    return robot, low, high, q, u + NOISE_MT * np.random.default_rng(0).normal(size=u.shape)


def flower(steps: int) -> np.ndarray:
    """Return bend vectors of the curve Flower of Mitchell et al. 2021 [rad]."""
    t = 0.01 * np.arange(steps)[:, None]
    return np.sin(t) * np.concatenate([np.cos((0.1 * t) ** 2), np.sin((0.1 * t) ** 2)], axis=1)


def against_scipy(sensing: Any, q: Any, u: Any, noise: float, low: Any, high: Any) -> float:
    """Return the ratio of rates against a loop with SciPy: warm start, same bounds, same sensor model.

    Both end within a hundredth of a standard deviation of the minimum. SciPy has its faster method, and the
    loosest tolerance that does it.
    """
    from scipy.optimize import least_squares

    def theirs(tolerance: float) -> np.ndarray:
        options: dict[str, Any] = dict.fromkeys(("xtol", "ftol", "gtol"), tolerance) | {
            "jac": (lambda x: sensing.linearise(x)[1] / noise)
            if hasattr(sensing, "linearise")
            else "2-point",
            "bounds": (low, high),
            "method": "dogbox",
        }

        def fit(x: np.ndarray, row: np.ndarray) -> np.ndarray:
            return least_squares(lambda x: (sensing(x) - row) / noise, x, **options).x

        return np.array(reduce(lambda found, row: [*found, fit(found[-1], row)], u, [q[0]])[1:])

    ours = partial(repro.track, repro.LevenbergMarquardt(sensing, low, high, noise), u, q[0])
    exact = repro.track(repro.LevenbergMarquardt(sensing, low, high, noise, tolerance=1e-9), u, q[0])
    std = np.sqrt(np.diagonal(exact.covariance, axis1=1, axis2=2))
    tolerance = next(x for x in 10.0 ** -np.arange(1, 15) if (abs(theirs(x) - exact.q) < 0.01 * std).all())
    assert (abs(ours().q - exact.q) < 0.01 * std).all()
    return ratio(ours, partial(theirs, tolerance))


def solver_rows() -> Rows:
    """Yield least squares against SciPy: on magnets, and on functions of a user's own."""
    for n_b in (1, 3):
        robot, low, high, q, u = on_t3(n_b, few(200))
        sensing = repro.Sensing(robot)
        yield (
            f"LevenbergMarquardt, n_b = {n_b}, one at a time, against SciPy with our slopes [times as fast]",
            against_scipy(sensing, q, u, NOISE_MT, low, high),
            ">= 5",
        )
    W, noise = np.random.default_rng(1).normal(size=(45, 9)) / 3, np.random.default_rng(2)
    q = 0.5 * np.sin(0.02 * np.arange(few(200))[:, None] * np.arange(1, 10) + np.arange(9))
    u = np.arctan(q @ W.T) + 1e-3 * noise.normal(size=(len(q), 45))
    for text, target, function in (
        ("of one configuration", ">= 1", lambda x: np.arctan(W @ x)),
        ("of one configuration, no complex numbers", ">= 1", lambda x: np.arctan2(W @ x, 1.0)),
        ("of a batch", ">= 3", lambda x: np.arctan(x @ W.T)),
        ("of a batch, no complex numbers", ">= 3", lambda x: np.arctan2(x @ W.T, 1.0)),
    ):
        yield (
            f"track, NumPy function {text}, 9 coordinates, 45 readings, against SciPy [times as fast]",
            against_scipy(function, q, u, 1e-3, -np.ones(9), np.ones(9)),
            target,
        )


def against(ours: Callable[[], Any], other: Callable[[], Any], q: np.ndarray) -> tuple[float, float]:
    """Return how many times as fast our estimates of ``q`` are, and the ratio of the errors."""
    return ratio(ours, other), float(np.std(ours() - q) / np.std(other() - q))


def against_filterpy(smoothing: bool = False) -> tuple[float, float]:
    """Return rate and error of our Kalman filter or smoother against unscented ones of the same model."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    robot, low, high, q, u = on_t3(1, few(200))
    sensing = repro.Sensing(robot)
    method = repro.KalmanFilter(sensing, low, high, NOISE_MT, [0.03, 0.03, 1e-3], [0.02, 0.02, 2e-3])
    F, Q = method.motion(1 / 40)
    points, P = MerweScaledSigmaPoints(6, 0.5, 2.0, 0.0), method.init(q[0]).covariance

    def unscented() -> np.ndarray:
        other = UnscentedKalmanFilter(6, 3, 1 / 40, lambda x: sensing(x[:3]), lambda x, dt: F @ x, points)
        other.x, other.P, other.Q, other.R = np.append(q[0], np.zeros(3)), P, Q, NOISE_MT**2 * np.eye(3)
        found = other.batch_filter(u)
        return (other.rts_smoother(*found) if smoothing else found)[0][:, :3]

    ours = repro.smooth if smoothing else repro.track
    return against(lambda: ours(method, u, q[0], rate_hz=40).q, unscented, q)


def against_particles() -> tuple[float, float]:
    """Return rate and error of our particle filter against a bootstrap filter of the same model."""
    from particles import SMC, collectors, distributions, state_space_models

    sensor, width, noise, q = repro.BendSensor(0.015), 0.02 * np.pi, 0.1, flower(few(200))
    u = sensor(q) + noise * np.random.default_rng(0).normal(size=(len(q), 3))
    method = repro.ParticleFilter(sensor, [width, width], noise)  # systematic resampling, as there

    def normal(mean: np.ndarray, std: float) -> Any:
        return distributions.IndepProd(*(distributions.Normal(loc=x, scale=std) for x in mean.T))

    methods = {
        "PX0": lambda self: normal(q[0], width),
        "PX": lambda self, t, xp: normal(xp, width),
        "PY": lambda self, t, xp, x: normal(sensor(x), noise),
    }
    bend: Any = type("Bend", (state_space_models.StateSpaceModel,), methods)()

    def bootstrap() -> np.ndarray:
        model = state_space_models.Bootstrap(bend, u)
        found: Any = SMC(model, 1000, ESSrmin=1.0, collect=[collectors.Moments()])
        found.run()
        return np.array([moments["mean"] for moments in found.summaries.moments])

    return against(lambda: repro.track(method, u, q[0]).q, bootstrap, q)


def filter_rows() -> Rows:
    """Yield filters against the packages filterpy and particles."""
    for package, name, function in (
        ("filterpy", "KalmanFilter, n_b = 1, against filterpy's unscented filter", against_filterpy),
        (
            "filterpy",
            "smooth, n_b = 1, against filterpy's Rauch-Tung-Striebel smoother",
            partial(against_filterpy, smoothing=True),
        ),
        (
            "particles",
            "ParticleFilter, N = 1000, against the bootstrap filter of particles",
            against_particles,
        ),
    ):
        rate, error = function() if find_spec(package) else (np.nan, np.nan)
        yield f"{name} [times as fast]", rate, ""
        yield f"{name} [times its error]", error, ""


def against_rotation() -> float:
    """Return the rate of a chain of eight IMUs, one sample at a time, against SciPy's rotations and Slerp."""
    from scipy.spatial.transform import Rotation, Slerp

    turns = np.random.default_rng(0).normal(size=(few(200), 9, 4))
    turns /= np.linalg.norm(turns, axis=-1)[..., None]
    arm = repro.Arm(range(9), 0.08 * np.arange(9), [0.08] * 8, [0.64], sub_segments=2)
    between = np.arange(8)[:, None] + np.array([0.25, 0.75])

    def chained() -> np.ndarray:
        tangents = [
            Slerp(range(9), Rotation.from_quat(x))(between.ravel()).apply([0, 0, 0.04]) for x in turns
        ]
        return np.array(tangents).sum(1)

    def ours() -> np.ndarray:
        return np.array([repro.pcc_extended(x, arm, [0.64])[0] for x in turns])

    assert np.allclose(ours(), chained(), rtol=0, atol=1e-12)
    return ratio(ours, chained)


def against_autograd() -> float:
    """Return the rate of the paper's descent with a network, one segment, against torch's automatic slopes."""
    import torch

    robot, _, _, q, u = on_t3(1, few(100))
    network = load_network(ROOT / "data/networks/pcc_nb1_segment1_seed0.safetensors")
    method = repro.GradientDescent(repro.Sensing(robot, network), 1e-5, 0.3, 8)
    layers = [(torch.tensor(W).double(), torch.tensor(b).double()) for W, b in network.layers]
    up, zero = torch.tensor([0.0, 0.0, 1.0]).double(), torch.zeros(1).double()

    def pose(q: Any, at: float) -> Any:  # the exponential of a twist, eq. (15)
        x, y, length = -q[1:2] / 0.022, q[0:1] / 0.022, 0.11 + q[2:3]
        twist = [zero, zero, y, zero, zero, zero, -x, zero, -y, x, zero, length, zero, zero, zero, zero]
        return torch.linalg.matrix_exp(torch.cat(twist).reshape(4, 4) * at)

    def predicted(q: Any) -> Any:
        magnet, tip, found = pose(q, 0.5), pose(q, 1.0), []
        for k in range(3):
            azimuth = torch.tensor([math.cos(2 * math.pi * k / 3), math.sin(2 * math.pi * k / 3), 0.0])
            apart = tip[:3, 3] + tip[:3, :3] @ (0.013 * azimuth.double()) - magnet[:3, 3]
            d, o_m, o_s = torch.linalg.norm(apart), magnet[:3, :3] @ up, -tip[:3, :3] @ up
            cosines = torch.stack([o_s[0], o_s @ o_m, o_s @ apart / d, o_m @ apart / d])
            angles = torch.arccos(cosines.clip(-1 + 1e-12, 1 - 1e-12))
            x = torch.cat([angles[:1], d[None], angles[1:]])
            for W, b in layers[:-1]:
                x = torch.relu(W @ x + b)
            found.append(layers[-1][0] @ x + layers[-1][1])
        return torch.cat(found)

    def descended() -> np.ndarray:
        x, found = q[0], []
        for row in torch.tensor(u):
            trials, b = [], 0.0
            for _ in range(8):
                at = torch.tensor(x, requires_grad=True)
                loss = ((predicted(at) - row) ** 2).mean()
                trials.append((loss.item(), x))
                b = torch.autograd.grad(loss, at)[0].numpy() + 0.3 * b
                x = x - 1e-5 * b
            x = min(trials, key=lambda trial: trial[0])[1]
            found.append(x)
        return np.array(found)

    assert np.allclose(predicted(torch.tensor(q[3])).detach(), method.model(q[3]), rtol=0, atol=1e-5)
    return ratio(partial(repro.track, method, u, q[0]), descended)


def against_residuals() -> float:
    """Return the rate of a calibration in 100 poses against SciPy with the same parameters, priors and readings."""
    from scipy.optimize import least_squares

    robot, _, _, q, _ = on_t3(1, few(100))
    seen = repro.simulated_readings(placed(robot, {"magnet 1 x": 3e-4, "sensor 2 azimuth": 0.02}), q)
    seen = seen + NOISE_MT * np.random.default_rng(0).normal(size=seen.shape)
    priors = priors_of(robot, Tolerances())
    std = np.array(list(priors.values()))

    def residuals(x: np.ndarray) -> np.ndarray:
        off = placed(robot, dict(zip(priors, x * std, strict=True)))
        return np.concatenate([((sensing_of(off)(q) - seen) / NOISE_MT).ravel(), x])

    return ratio(
        partial(repro.calibrate, robot, q, seen, NOISE_MT),
        partial(least_squares, residuals, np.zeros(len(std)), xtol=1e-3, ftol=1e-3),
    )


def against_lines() -> float:
    """Return the rate of a live session, from lines to shapes, against lines that are split and fitted by SciPy."""
    from scipy.optimize import least_squares

    from repro_board.session import Follower
    from repro_board.steps import Steps
    from repro_board.wire import Parser

    robot, low, high, _, u = on_t3(1, max(few(400), 40))
    robot = robot.replaced(lower=low, upper=high, noise=NOISE_MT)
    lines = [",".join(f"{x:.5f}" for x in row).encode() + b"\n" for row in u]
    sensing = repro.Sensing(robot)

    def live() -> list[Any]:
        parser, steps, follower = Parser("csv", robot.n_readings), Steps(robot), Follower(robot)
        rows = [step for k, line in enumerate(lines) for step in steps.feed(parser.feed(line), 0.01 * k)]
        return [follower.step(step.u, step.time_s) for step in rows]

    def by_hand() -> np.ndarray:
        x = (low + high) / 2
        for line in lines:
            row = np.array([float(text) for text in line.split(b",")])
            x = least_squares(
                lambda q, row=row: (sensing(q) - row) / NOISE_MT,
                x,
                lambda q: sensing.linearise(q)[1] / NOISE_MT,
            ).x
        return x

    assert len(live()) > 0.9 * len(lines)
    return ratio(live, by_hand)


def paper_rows() -> Rows:
    """Yield the rates beside those that two papers print: Mitchell et al. 2021, Martin et al. 2022."""
    q = flower(few(200))
    method = repro.ParticleFilter(repro.BendSensor(0.015), [0.02 * np.pi] * 2, 0.1)
    seconds = fastest(partial(repro.track, method, repro.BendSensor(0.015)(q), q[0]))[0]
    yield "ParticleFilter, N = 1000 [updates/s]", len(q) / seconds, ""
    turns = np.random.default_rng(0).normal(size=(few(8000), 9, 4))
    arm = repro.Arm(range(9), 0.08 * np.arange(9), [0.08] * 8, [0.36, 0.6], sub_segments=2)
    turns /= np.linalg.norm(turns, axis=-1)[..., None]
    seconds = fastest(partial(repro.pcc_extended, turns, arm, [0.36, 0.6]))[0]
    yield "pcc_extended, 8 IMUs, 16 segments [samples/s]", len(turns) / seconds, ""
    yield (
        "pcc_extended, 8 IMUs, one sample at a time, against SciPy's Slerp [times as fast]",
        against_rotation(),
        ">= 4",
    )


def user_rows() -> Rows:
    """Yield what a user would else write by hand: a descent, a calibration, and a loop over lines of a board."""
    rate = against_autograd()
    yield "GradientDescent, network, n_b = 1, against torch's automatic slopes [times as fast]", rate, ">= 30"
    rate = against_residuals()
    yield "calibrate, n_b = 1, 100 poses, against SciPy with the same priors [times as fast]", rate, ">= 3"
    rate = against_lines()
    yield (
        "live session, lines to shapes with monitor, against SciPy on split lines [times as fast]",
        rate,
        ">= 2",
    )


def batch(method: Any, start: Any, readings: Any, *at: float) -> Callable[[], Any]:
    """Return a job: one step of many robots."""
    return partial(method.step, method.init(start), readings, *at)


def own_robot_rows() -> Rows:
    """Yield what the monitor costs, and how fast shapes are fitted to motion capture."""
    from repro.chain import point_on

    for n_b in (1, 3):
        robot, low, high, q, u = on_t3(n_b, few(1000))
        for name in ("LevenbergMarquardt", "KalmanFilter"):
            method = getattr(repro, name)(repro.Sensing(robot), low, high, NOISE_MT)
            watched = partial(repro.track, method, u, q[0], rate_hz=40)
            with_monitor, without = fastest(watched, partial(watched, monitor=None))
            yield (
                f"track, {name}, n_b = {n_b}, what the monitor costs a row [µs]",
                1e6 * (with_monitor - without) / len(q),
                "<= 15",
            )
    poses = robot.poses(q, [point_on(segment, 0.11) for segment in (1, 2, 3)])
    seconds = fastest(partial(repro.fit_shape, robot, poses))[0]
    yield "fit_shape, three segments, poses of their tips [shapes/s]", len(q) / seconds, ">= 10000"


def operation_rows() -> Rows:
    """Yield what slopes cost, and the operations of an evaluation and of a fit: how many, and how fast."""
    for n_b, paths in ((3, NETWORKS), (1, []), (3, [])):
        robot, low, high, q, u = on_t3(n_b, few(2000))
        sensing = repro.Sensing(robot, [load_network(x) for x in paths] or None)
        fit = repro.LevenbergMarquardt(sensing, low, high, NOISE_MT, iterations=3, tolerance=1e-12)
        plain, *seconds = fastest(partial(sensing, q), partial(sensing.linearise, q), batch(fit, q, u))
        case = f"{'network' if paths else 'multipoles'}, n_b = {n_b}"
        yield (
            f"plain call of Sensing, {case}, 2,000 configurations, against one with slopes [times as fast]",
            seconds[0] / plain,
            ">= 1",
        )
        counts = (
            []
            if paths
            else child(f"from bench.operations import count; count({n_b})", NUMBA_DISABLE_JIT="1")[1].split()
        )
        for work, number, duration in zip(("evaluation with slopes", "fit"), counts, seconds, strict=False):
            yield f"one {work}, {case} [floating-point operations]", float(number), ""
            yield f"one {work}, {case} [GFLOP/s]", 1e-9 * float(number) * len(q) / duration, ""


def answer(path: str, rows: int) -> None:
    """Estimate shapes from readings in a file, and print the peak memory of this process [MB]."""
    robot, low, high = paper_robot(3)
    fit = repro.LevenbergMarquardt(repro.Sensing(robot), low, high, NOISE_MT)
    repro.track(fit, np.load(path)[:rows], (low + high) / 2)
    # ru_maxrss counts the process that started this one, too.
    print(
        int(status.read_text().partition("VmHWM:")[2].split()[0]) / 2**10
        if (status := Path("/proc/self/status")).exists()
        else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    )


def child(call: str, **environment: str) -> tuple[float, str]:
    """Run a call of a function of this file, or an import, in a fresh process.

    Returns its wall time [s], and what it printed.
    """
    ours = call.endswith(")") and "import" not in call
    code = f"from bench.bench import *; {call}" if ours else call
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT, env=os.environ | environment, stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    return time.perf_counter() - start, done.stdout


def process_rows() -> Rows:
    """Yield what fresh processes take."""

    def shortest(code: str, **environment: str) -> float:
        return min(child(code, **environment)[0] for _ in range(1 if FAST else 9))

    bare, names = shortest(""), "from repro import LevenbergMarquardt, Robot, Sensing, track"
    yield "import repro, over a bare interpreter [s]", shortest("import repro") - bare, "<= 0.01"
    yield f"{names}, over a bare interpreter [s]", shortest(names) - bare, ""
    with tempfile.TemporaryDirectory() as folder:
        np.save(file := f"{folder}/readings.npy", on_t3(3, few(10000))[-1])
        start, cache = f"answer({file!r}, 4)", {} if FAST else {"NUMBA_CACHE_DIR": folder}
        yield "first answer, no kernel compiled yet [s]", child(start, **cache)[0], "<= 20"
        yield "first answer, kernels on disk [s]", shortest(start, **cache), "<= 1"
        yield (
            "peak memory of a process that tracks 10,000 time steps, n_b = 3 [MB]",
            float(child(f"answer({file!r}, 10000)", **cache)[1]),
            "",
        )


def check_ratios() -> None:
    """Measure the ratios once, on few numbers, and end with 1 where a target is missed by more than the slack."""
    missed = 0
    for capability, figure, target in (*solver_rows(), *filter_rows(), *paper_rows(), *user_rows()):
        bound = float(target[3:] or "nan")
        if target and "[times as fast]" in capability:
            missed += figure < bound / SLACK
            print(f"{capability:115} {figure:9.4g} {target:7} {figure >= bound / SLACK}", flush=True)
    sys.exit(bool(missed))


def main() -> None:
    """Measure everything, write the table and print it."""
    import pandas as pd
    from llvmlite.binding import get_host_cpu_name

    table = []
    for part in (
        solver_rows(),
        filter_rows(),
        paper_rows(),
        user_rows(),
        own_robot_rows(),
        operation_rows(),
        process_rows(),
    ):
        for capability, figure, target in part:
            above, bound = target.startswith(">="), float(target[3:] or "nan")
            met = str(figure >= bound if above else figure <= bound) if target else ""
            row = ["", "", "not installed"] if np.isnan(figure) else [f"{figure:.4g}", target, met]
            table.append([capability, *row, get_host_cpu_name()])
            print("{:115} {:>9} {:7} {}".format(capability, *row), flush=True)
    file = pd.DataFrame(table, columns=["capability", "figure", "target", "met", "processor"])
    file.to_csv(sys.argv[2] if FAST else ROOT / "data/benchmark.csv", index=False, lineterminator="\n")


if __name__ == "__main__":
    check_ratios() if RATIOS else main()
