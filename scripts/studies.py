"""Compute what takes minutes or hours and is committed in data/studies: ``python scripts/studies.py NAME ...``.

A study is written whole or not at all, with its settings beside it. Without a name the studies are listed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from magpylib.func import dipole_field
from scipy import stats
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import repro
from repro import GradientDescent, Sensing, exact_arcs, pcc_extended, track
from repro.networks import load_network, network_of
from repro_board.emulate import course, faulty
from repro_companion.papers import (
    baaij,
    martin,
    mitchell,
    released_networks,
    rig,
    sensor_count,
    simulated_rig,
    table_2,
    wandering,
)
from repro_companion.papers.bend_filter import BendFilter
from repro_companion.show import project_folder


def rig_starts() -> pd.DataFrame:
    """Return errors [mm] of the descent of Table 2 from starts that differ by rounding: five minutes.

    One row for each trajectory, seed, start and step, on the simulated rig: the published step, and half of it with
    twice the iterations.
    """
    data = table_2.load("simulated")
    q, u = data.beginnings(15.0)
    q, u = (np.broadcast_to(x[:, :, None], (*x.shape[:2], table_2.STARTS, 3)) for x in (q, u))
    known = np.where([False, False, True], q, np.nan)
    apart = 1 + table_2.APART * np.random.default_rng(0).uniform(-1, 1, (table_2.STARTS, 3))
    lines = []
    for step, shorter in (("published", 1), ("half", 2)):
        for seed in table_2.SEEDS:
            sensing = Sensing(rig.robot(), table_2.networks(data, seed), earth=rig.EARTH)
            moves = np.array(table_2.STEP_SIZE) / shorter
            descent = GradientDescent(sensing, moves, table_2.MOMENTUM, table_2.ITERATIONS * shorter)
            found = track(descent, u, q[0] * apart, known=known, progress=f"{step} step, seed {seed}").q
            off = 1e3 * np.sqrt(((found - q) ** 2).mean(axis=0))
            for i, name in enumerate(data.tests):
                lines += [
                    (step, table_2.row_name(name), seed, k, *off[i, k, :2]) for k in range(table_2.STARTS)
                ]
    table = pd.DataFrame(lines, columns=["step", "row", "seed", "start", "delta_x", "delta_y"])
    table.attrs = {
        "trajectories": list(data.tests),
        "seeds": table_2.SEEDS,
        "starts": table_2.STARTS,
        "apart": table_2.APART,
    }
    table.attrs |= {"seconds": 15.0, "steps": ["published", "half"]}
    return table


def rig_sensors() -> pd.DataFrame:
    """Return slopes [mV/mm] and ranges [mV] of the simulated sensors and of the authors' networks: half a minute.

    One row for each recording and sensor, along the motion of the simulated rig; slopes are those of the plane that
    fits best, of T1 those of a line in x. The settings hold the sensors that fit the networks best, and the rig has
    these rounded: what no field of the ring explains, and directions of sensors of 5,000 mV/mT. Every recording
    counts as much, and its offset is left out. It needs the authors' networks (``repro fetch baaij2023_networks``).
    """
    names = [name for name in rig.TRAJECTORIES if name not in released_networks.LEFT_OUT]
    q = {name: simulated_rig.simulated(name).q[:: 40 if name == "T5" else 4] for name in names}
    seeds, predicted = released_networks.SEEDS, released_networks.load_sensing
    u = {name: np.mean([predicted(name, seed)(q[name]) for seed in seeds], axis=0) for name in names}

    def sensors(values: np.ndarray) -> SimpleNamespace:
        azimuth, polar, *curvature, ripple = values.reshape(6, 3)
        across = np.sin(polar)
        axis = np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(polar)])
        own = {"sensitivity": 5000 * axis, "curvature": np.transpose(curvature), "ripple": ripple}
        return SimpleNamespace(**vars(simulated_rig.RIG) | own)

    def simulated(of: SimpleNamespace, name: str) -> np.ndarray:
        felt = q[name].copy()
        felt[:, 2] = 1e-3 * simulated_rig.RIG.elongation
        return simulated_rig.readings(of, felt, felt)

    def differences(values: np.ndarray) -> np.ndarray:
        off = [u[name] - simulated(sensors(values), name) for name in names]
        return np.concatenate([((d - d.mean(axis=0)) / len(d) ** 0.5).ravel() for d in off])

    x, y, z = np.transpose(simulated_rig.RIG.sensitivity)
    first = [
        np.arctan2(y, x),
        np.arctan2(np.hypot(x, y), z),
        *np.transpose(simulated_rig.RIG.curvature),
        simulated_rig.RIG.ripple,
    ]
    best = sensors(least_squares(differences, np.concatenate(first)).x)
    rest = simulated_rig.RIG.rest + (u["T5"] - simulated(best, "T5")).mean(axis=0)
    lines = []
    for name in names:
        moves = 1 if name == "T1" else 2
        plane = np.column_stack([1e3 * q[name][:, :moves], np.ones(len(q[name]))])
        both = u[name], simulated(simulated_rig.RIG, name)
        slopes = [np.linalg.lstsq(plane, readings, rcond=None)[0][:moves] for readings in both]
        for j in range(rig.SENSORS):
            own = [value for slope in slopes for value in (*slope[:, j], np.nan)[:2]]
            lines.append((name, j + 1, *own, *(np.ptp(readings[:, j]) for readings in both)))
    columns = ["slope_x_networks", "slope_y_networks", "slope_x", "slope_y", "range_networks", "range"]
    table = pd.DataFrame(lines, columns=["recording", "sensor", *columns])
    table.attrs = {
        name: np.round(getattr(best, name), 2).tolist() for name in ("sensitivity", "curvature", "ripple")
    }
    table.attrs |= {"rest": np.round(rest, 1).tolist(), "seeds": seeds}
    return table


def table_2_networks() -> pd.DataFrame:
    """Return errors of Table 2 where readings are the authors' networks of each recording: two minutes.

    It needs their files (``repro fetch baaij2023_networks``), of which nothing but errors is kept. The method is the
    paper's with each seed of the networks that were trained on T5.
    """
    seconds, data = 15.0, released_networks.robots()
    q, u = data.beginnings(seconds)
    known = np.where([False, False, True], q, np.nan)
    sensings = [released_networks.load_sensing("T5", seed) for seed in released_networks.SEEDS]
    descents = [GradientDescent(s, table_2.STEP_SIZE, table_2.MOMENTUM, table_2.ITERATIONS) for s in sensings]
    found = np.stack([track(descent, u, q[0], known=known).q for descent in descents], axis=2)
    predicted = np.stack([sensing(q) for sensing in sensings], axis=2)
    table = table_2.errors(data, {"known": found}, predicted, seconds)
    starts = 8
    q, u, known = (np.broadcast_to(x[:, :, None], (*x.shape[:2], starts, 3)) for x in (q, u, known))
    apart = 1 + table_2.APART * np.random.default_rng(0).uniform(-1, 1, (starts, 3))
    again = np.stack([track(descent, u, q[0] * apart, known=known).q for descent in descents])
    off = np.sqrt(((again - q) ** 2).mean(axis=1))[..., :2]  # [seed, trajectory, start, axis]
    moved = (np.ptp(off, axis=2) / off.mean(axis=2)).max(axis=0) > 0.1
    table.attrs = {
        "seconds": seconds,
        "seeds": released_networks.SEEDS,
        "noise_mv": released_networks.NOISE_MV,
    }
    table.attrs |= {"left_out": released_networks.LEFT_OUT}
    table.attrs |= {"decided_by_rounding": int(moved.sum()), "of_errors": moved.size, "starts": starts}
    return table


FAR_MM = 5.0
"""From here on an estimate of the bend counts as lost."""
EPOCHS = 60
"""Of the networks of random rigs, a quarter of the paper's, averaged over the second half."""


def bend_filter() -> pd.DataFrame:
    """Return errors of the bend [mm] by our filter and by the paper's descent on seven robots: six minutes.

    One row for each robot, recording and method: the simulated rig, the robots whose readings are the authors'
    networks (which it needs), and five random rigs. The descent starts at the truth and knows the elongation, our
    filter neither. Shares of frames [%]: those whose bend is off by more than 5 mm, those of them in which the filter
    does not say that it is lost, and those whose true bend its 95 % ellipse holds. A random rig that is finished
    stands in runs/bend_filter and is not computed again.
    """
    seconds, rigs, parts = 15.0, range(5), []
    folder = project_folder() / "runs" / "bend_filter"
    folder.mkdir(parents=True, exist_ok=True)
    for seed in rigs:
        path = folder / f"{seed}.csv"
        if not path.is_file():
            random, robot = random_rig(seed), f"random rig {seed}"
            recordings = {name: simulated_rig.simulated(name, random, seed) for name in rig.TRAJECTORIES}
            data = table_2.divided(recordings, "simulated")
            errors = bend_errors(robot, data, [quick_sensing(data.train, folder / f"{seed}.state")], seconds)
            errors.to_csv(path, index=False)
        parts.append(pd.read_csv(path))
    data = table_2.load("simulated")
    sensings = [Sensing(rig.robot(), table_2.networks(data, seed), earth=rig.EARTH) for seed in table_2.SEEDS]
    parts.insert(0, bend_errors("simulated rig", data, sensings, seconds))
    sensings = [released_networks.load_sensing("T5", seed) for seed in released_networks.SEEDS]
    parts.insert(1, bend_errors("authors' networks", released_networks.robots(), sensings, seconds))
    table = pd.concat(parts, ignore_index=True)
    table.attrs = {"seconds": seconds, "random_rigs": len(rigs), "far_mm": FAR_MM, "epochs": EPOCHS}
    return table


def random_rig(seed: int) -> SimpleNamespace:
    """Return the simulated rig with other sensors, magnet, hystereses, lags, drift and biases."""
    rng, own = np.random.default_rng(seed), SimpleNamespace(**vars(simulated_rig.RIG))

    def times(values: Any, low: float, high: float) -> Any:
        return np.array(values) * rng.uniform(low, high, np.shape(values))

    turned = Rotation.from_rotvec(np.radians(10.0) * rng.standard_normal((rig.SENSORS, 3)))
    own.lag, own.hysteresis = times(own.lag, 0.7, 1.5), times(own.hysteresis, 0.5, 2.0)
    own.inner_hysteresis = times(own.inner_hysteresis, 0.5, 2.0)
    own.inner_stroke, own.across = times(own.inner_stroke, 0.5, 2.0), times(own.across, 0.5, 1.5)
    own.sensitivity = turned.apply(own.sensitivity)
    own.sensor_shift = 0.5 * rng.standard_normal((rig.SENSORS, 3))
    own.magnet_shift, own.magnet_tilt = 0.5 * rng.standard_normal(3), 1.5 * rng.standard_normal(2)
    own.curvature = times(own.curvature, 0.5, 1.5)
    own.ripple, own.ripple_period = rng.uniform(0.0, 4.0, rig.SENSORS), rng.uniform(7.0, 12.0)
    own.ripple_azimuth = rng.uniform(0.0, 180.0, rig.SENSORS)
    own.drift, own.bias_scatter = rng.uniform(0.3, 2.0), rng.uniform(0.5, 3.0)
    own.bias = (*(-3.0 + 0.7 * rng.standard_normal(len(rig.TRAJECTORIES) - 1)), 0.0)
    return own


def quick_sensing(train: rig.Recording, checkpoint: Any) -> Sensing:
    """Return networks of the paper's recipe with fewer epochs, of seed 0."""
    from training import train_paper  # needs torch, and no other study does

    networks = []
    for j in range(rig.SENSORS):
        settings = {"epochs": EPOCHS, "swa_start": EPOCHS // 2, "progress": checkpoint.stem}
        state = checkpoint.with_suffix(f".{j}.state")
        network = train_paper(*table_2.training_rows(train, j), 0, table_2.LEARNING_RATE, state, **settings)[
            0
        ]
        networks.append(network_of({name: value.numpy() for name, value in network.state_dict().items()}))
    return Sensing(rig.robot(), networks, earth=rig.EARTH)


def bend_errors(robot: str, data: table_2.Data, sensings: list[Sensing], seconds: float) -> pd.DataFrame:
    """Return the errors of all methods on one robot: of descents the mean over the networks."""
    q, u = data.beginnings(seconds)
    known, truth, lines = np.where([False, False, True], q, np.nan), 1e3 * q[..., :2], []

    def add(method: str, bends: np.ndarray, unsaid: Any = np.nan, covered: Any = np.nan) -> None:
        off = bends - truth[:, :, None]
        rms, far = np.sqrt((off**2).mean(axis=0)).mean(axis=1), np.linalg.norm(off, axis=-1) > FAR_MM
        shares = [far.mean(axis=2), unsaid * far[..., 0], covered * np.ones(far.shape[:2])]
        percent = np.transpose([100 * share.mean(axis=0) for share in shares])
        for name, own in zip(data.tests, np.column_stack([rms, percent]), strict=True):
            lines.append((robot, name, method, *own))

    for method, shorter in (("descent", 1), ("half step", 2)):
        moves = np.array(table_2.STEP_SIZE) / shorter
        descents = [
            GradientDescent(s, moves, table_2.MOMENTUM, table_2.ITERATIONS * shorter) for s in sensings
        ]
        found = [track(descent, u, q[0], known=known).q[..., :2] for descent in descents]
        add(method, 1e3 * np.stack(found, axis=2))
    for method, own in (("filter", False), ("filter, own biases", True)):
        bend = BendFilter(data.train, own_biases=own).follow(u)
        off = bend.mean - truth
        square = np.einsum("tki,tkij,tkj->tk", off, np.linalg.inv(bend.covariance), off)
        add(method, bend.mean[:, :, None], ~np.array(bend.doubtful), square <= stats.chi2.isf(0.05, 2))
    columns = ["delta_x", "delta_y", "far_percent", "far_unsaid_percent", "covered_percent"]
    return pd.DataFrame(lines, columns=["robot", "recording", "method", *columns])


def table_1_best() -> pd.DataFrame:
    """Return errors [%] of our method on robots with manufacturing errors, twenty for each row of Table 1: a minute.

    One row for each row of Table 1, coordinate and robot, calibrated and as drawn.
    """
    rows, draws, lines = baaij.rows_named(), range(20), []
    tasks = [delayed(baaij.errors_of_draw)(row, draw) for row in rows for draw in draws]
    found = iter(Parallel(n_jobs=-1, verbose=5)(tasks))
    for row in rows:
        errors = np.array([next(found) for _ in draws])  # [draw, calibrated or not, coordinate]
        for calibrated, of_draws in zip((True, False), errors.swapaxes(0, 1), strict=True):
            for name, values in zip(row.robot().coordinates, of_draws.T, strict=True):
                lines += [(row.name, name, draw, calibrated, values[draw]) for draw in draws]
    table = pd.DataFrame(lines, columns=["row", "quantity", "draw", "calibrated", "error_percent"])
    drawn = ("magnet_position", "magnet_tilt", "sensor_azimuth", "sensor_radius")
    table.attrs = {"draws": len(draws), "poses": baaij.POSES, "noise_mt": baaij.NOISE_MT}
    table.attrs |= {"pose_position": baaij.POSITION, "pose_rotation": baaij.ROTATION}
    table.attrs |= {name: getattr(baaij.ERRORS, name) for name in drawn}
    return table


def particle_filter() -> pd.DataFrame:
    """Return errors [mm] of the particle filter on the curves of Mitchell et al.: ten minutes."""
    found = Parallel(n_jobs=-1, verbose=5)(delayed(mitchell.study_rows)(*one) for one in mitchell.study())
    table = pd.DataFrame([line for lines in found for line in lines or []], columns=mitchell.STUDY_COLUMNS)
    table.attrs = {"seeds": sorted(map(int, set(table["seed"]))), "noise_mt": mitchell.SENSOR_NOISE_MT}
    table.attrs |= {"curves": list(mitchell.CURVES), "steps": len(mitchell.times())}
    return table


def bend_tests() -> pd.DataFrame:
    """Return errors [deg] on the authors' bend tests, from the page bend_tests as built with these recordings."""
    table = of_bend_tests("bend_tests_errors").round(2)
    table.attrs["takes"] = sorted(set(table["take"]))
    return table


def bend_tests_takes() -> pd.DataFrame:
    """Return what was counted in each of the authors' bend tests, and its lag, from the page built with these."""
    return of_bend_tests("bend_tests_takes").round(3)


def nominal_bends() -> pd.DataFrame:
    """Return errors [deg] and gains of the authors' files at nominal bends, from the page built with these."""
    return of_bend_tests("nominal_bends").round(3)


def light_bulb() -> pd.DataFrame:
    """Return how many events each setting finds in the authors' light-bulb files, from the page built with these."""
    table = of_bend_tests("light_bulb_counts")
    table.attrs["files"] = [name for name in table if name[:6] == "light_"]
    return table


def of_bend_tests(name: str) -> pd.DataFrame:
    """Return a table of the page bend_tests as built with the authors' recordings."""
    table = pd.read_csv(project_folder() / "results" / "with_recordings" / f"{name}.csv")
    table.attrs = {"page": "notebooks/bend_tests.ipynb"}
    return table


def martin_files() -> pd.DataFrame:
    """Return how far our tables are from the authors' files [um], from the page imu_markers built with these."""
    table = pd.read_csv(project_folder() / "results" / "with_recordings" / "recorded_trial_files.csv")
    table.attrs = {"page": "notebooks/imu_markers.ipynb", "files": list(table["file"])}
    return table


def martin_calibration() -> pd.DataFrame:
    """Return errors [mm] after the first minute of ten synthetic trials, with and without a calibration: a minute."""
    methods = {martin.BASELINE: (pcc_extended, None), "PCC-16 + frame": (pcc_extended, False)}
    methods |= {"exact arcs": (exact_arcs, None), "exact arcs + frame": (exact_arcs, False)}
    methods[martin.BEST] = (exact_arcs, True)
    moved, parts = martin.motion(), []
    for seed in range(10):
        trial = martin.draw(moved, seed)
        for name, (model, per_imu) in methods.items():
            errors = martin.calibrated_errors(trial, model, per_imu).rename(columns={"arc_mm": "point_mm"})
            parts.append(errors.assign(method=name, draw=seed))
    columns = ["method", "mode", "point_mm", "median_mm", "q75_mm", "draw"]
    table = pd.concat(parts, ignore_index=True).reindex(columns=columns)
    table.attrs = {"draws": list(range(10)), "first_s": 60.0, "every": 10}
    return table


def table_1_noise() -> pd.DataFrame:
    """Return errors [%] of three methods on robots with manufacturing errors, at two noises: two minutes.

    One row for each robot of one to three segments, noise, method and draw: the mean over the coordinates. The
    paper's network and descent start at the truth, least squares starts straight.
    """
    draws, lines = range(20), []
    for row in baaij.rows_named(["n_b=1", "n_b=2", "n_b=3"]):
        for noise_mt in (baaij.NOISE_MT, baaij.MORE_NOISE_MT):
            sessions = [baaij.session(row, draw, noise_mt) for draw in draws]
            u, q = np.stack([session.readings for session in sessions], axis=1), sessions[0].q
            start = np.broadcast_to(q[0], (len(draws), q.shape[1]))
            descent = baaij.descent(row.sensing(seed=0), row.n_segments)
            found = track(descent, u, start, progress=f"{row.name}, {noise_mt:g} mT").q
            tasks = [delayed(baaij.errors_of_draw)(row, draw, noise_mt) for draw in draws]
            both = np.array(list(Parallel(n_jobs=-1)(tasks))).mean(axis=-1)
            errors = [*both.T, baaij.relative_errors(found, q).mean(axis=-1)]
            for method, of_draws in zip(("calibrated", "nominal", "network"), errors, strict=True):
                lines += [(row.name, noise_mt, method, draw, of_draws[draw]) for draw in draws]
    table = pd.DataFrame(lines, columns=["row", "noise_mt", "method", "draw", "error_percent"])
    table.attrs = {"draws": len(draws), "seed": 0, "noises_mt": [baaij.NOISE_MT, baaij.MORE_NOISE_MT]}
    return table


RATES_HZ = {"two_segments": 100.0, "one_segment": 40.0, "four_chips": 25.0}
QUIET = ["consistent", "unchecked"]
"""What the monitor says of a row without an alarm."""
METHODS = {"levenberg_marquardt": repro.LevenbergMarquardt, "kalman": repro.KalmanFilter}
FAULTS = {
    "no reading": "missing",
    "unplugged": "unplugged",
    "stuck": "stuck",
    "saturated": "saturated",
    "gain +5 %": "scaled",
}
OF_ONE = (*FAULTS, "offset 50 uT", "drift 2 uT/s", "glitches", "clipped")
"""Faults of one part: with an offset, with an error that grows, with an impossible value in a twentieth of the rows,
and never above the median of what it read."""
SCENARIOS = ("none", "start bent", "jump", *OF_ONE, "magnet near", "noise x 5")
HOUR = "an hour without a fault"
FAULT_S, LASTS_S, AFTERWARDS_S = 2.0, 4.0, 2.0
"""A fault begins, lasts and is over again [s]; a drift ends 10 s after it has passed ten standard deviations."""
LARGE, SOON_S, SOON_OF_A_DRIFT_S, OVER_S = 10.0, 1.0, 5.0, 1.0
"""Size of a change of a reading [standard deviations] after which there is to be an alarm so soon, and time after a
fault until there is none [s]."""
PATIENCE_S, PATIENCE = 0.25, 10
"""Time and rows within which a fault is to be noticed: the larger of the two."""
TIMES, SEEN, CLEAR = 3.0, 5.0, 30.0
"""How far the tip is off, in half widths of the 95 % interval by noise alone; how large a fault is, in standard
deviations of what no configuration explains, to be noticed and to be named."""


def alarms() -> pd.DataFrame:
    """Return what the monitor says of faults of emulated robots: ten minutes.

    One row for each robot, estimator and scenario; numbers of rows during the fault, unless they count trials. A row
    that is finished stands in runs/alarms and is not computed again.
    """
    trials, seed = 20, 3000  # the monitor was set on those from 1000 to 1023
    folder, parts = project_folder() / "runs" / "alarms", []
    folder.mkdir(parents=True, exist_ok=True)
    for case in product(RATES_HZ, METHODS, (*SCENARIOS, HOUR)):
        path = folder / ("-".join(case).replace("/", " per ") + ".csv")
        if not path.is_file():
            run = alarm_hour if case[-1] == HOUR else alarm_trial
            counts = pd.DataFrame([run(*case, seed + k) for k in range(trials)])
            partial = path.with_suffix(".partial")
            counts.sum().to_frame().T.to_csv(partial, index=False)
            partial.replace(path)
        row = pd.read_csv(path).assign(robot=case[0], estimator=case[1], scenario=case[2], trials=trials)
        parts.append(row)
        print(f"{len(parts)} {', '.join(case)}", file=sys.stderr)
    table: Any = pd.concat(parts, ignore_index=True)
    first = ["robot", "estimator", "scenario", "trials"]
    table = table[first + [name for name in parts[0] if name not in first]]
    table[table.columns[3:]] = table[table.columns[3:]].fillna(0).astype(int)
    table.attrs = {"rates_hz": RATES_HZ, "estimators": list(METHODS), "scenarios": list(SCENARIOS)}
    table.attrs |= {"trials": trials, "seed": seed, "fault_s": FAULT_S, "lasts_s": LASTS_S}
    return table


def alarm_robot(name: str) -> Any:
    """Return an emulated robot by its name."""
    if name == "four_chips":
        return repro.load_robot(repro.example() / "robot.toml")
    return repro.load_robot(project_folder() / "data" / "robots" / f"{name}.toml")


def alarm_hour(name: str, estimator: str, _: str, seed: int) -> dict[str, Any]:
    """Count alarms in three minutes of readings without a fault: twenty of them are an hour."""
    robot, rate_hz = alarm_robot(name), RATES_HZ[name]
    times = np.arange(round(180 * rate_hz)) / rate_hz
    u = repro.simulated_readings(robot, course(robot, times, seed=seed), robot.earth)
    u += robot.noise * np.random.default_rng([seed, 3]).standard_normal(u.shape)
    found: Any = track(METHODS[estimator](robot), u, robot.start, times=times)
    alarm = ~np.isin(found.status, QUIET)
    return {"alarms": alarm.sum(), "named": found.suspects.any(), "readings": len(u)}


def failing(
    robot: Any, scenario: str, times: np.ndarray, q: np.ndarray, during: np.ndarray, seed: int
) -> Any:
    """Return readings with noise ``[t, s]``, without and with a fault, and the number of the part that fails."""
    rng, part = np.random.default_rng([seed, 1]), seed % len(robot.part_names)
    sound = repro.simulated_readings(robot, q, robot.earth)
    sound += robot.noise * rng.standard_normal(sound.shape)
    sent, since, columns = sound.copy(), int(np.argmax(during)), robot.parts == part
    wrong: Any = sound.copy()
    if scenario in FAULTS:
        wrong = faulty(sound, FAULTS[scenario], columns, since)
    elif scenario == "offset 50 uT":
        wrong[:, columns] += 0.05
    elif scenario == "drift 2 uT/s":
        wrong[:, columns] += 2e-3 * (times - times[since])[:, None]
    elif scenario == "glitches":
        wrong[np.ix_(rng.random(len(times)) < 0.05, columns)] = 32.767
    elif scenario == "clipped":
        wrong[:, columns] = np.minimum(sound, np.median(sound, axis=0))[:, columns]
    elif scenario == "magnet near":
        wrong += foreign_field(robot, q)
    elif scenario == "noise x 5":
        wrong += robot.noise * np.sqrt(24) * rng.standard_normal(sound.shape)
    sent[during] = wrong[during]
    return sound, sent, part


def alarm_trial(name: str, estimator: str, scenario: str, seed: int) -> dict[str, Any]:
    """Let an emulated robot move, let a part of it fail for a while, and count what the monitor says."""
    robot, rate_hz, drifts = alarm_robot(name), RATES_HZ[name], scenario.startswith("drift")
    lasts_s = LARGE * robot.noise.max() / 2e-3 + 10.0 if drifts else LASTS_S
    times = np.arange(round((FAULT_S + lasts_s + AFTERWARDS_S) * rate_hz)) / rate_hz
    after, over = times >= FAULT_S - 1e-9, times >= FAULT_S + lasts_s - 1e-9
    during = after & ~over
    q = course(robot, times + 20.0 * (scenario == "start bent"), seed=seed)
    if scenario == "jump":
        q[after] = course(robot, times[after] + 40.0, seed=seed)
    sound, sent, part = failing(robot, scenario, times, q, during, seed)

    moves = robot.upper > robot.lower
    J = robot.sensing().linearise(q)[1][..., moves] / robot.noise[:, None]
    tip, G = robot.tip_slopes(q)
    spread = G[..., moves] @ np.linalg.inv(np.swapaxes(J, 1, 2) @ J) @ np.swapaxes(G[..., moves], 1, 2)
    interval = 1.96 * np.sqrt(np.trace(spread, axis1=1, axis2=2))
    added = (sent - sound) / robot.noise
    large = np.flatnonzero((np.abs(np.nan_to_num(added)) > LARGE).any(axis=1))
    J = np.where(np.isnan(added)[..., None], 0.0, J)
    added = np.nan_to_num(added)[..., None]
    signal = np.linalg.norm(added - J @ (np.linalg.pinv(J) @ added), axis=(1, 2))

    method = METHODS[estimator](robot)
    runs: Any = (track(method, sent, robot.start, times=times, monitor=m) for m in (None, "auto"))
    bare, found = runs
    off, wrong = (
        during & (np.linalg.norm(robot.tip(shape.q)[:, :3, 3] - tip, axis=-1) > TIMES * interval)
        for shape in (bare, found)
    )
    e, C = (found.q - q)[:, moves, None], found.covariance[:, moves][:, :, moves]
    holds = (np.swapaxes(e, 1, 2) @ np.linalg.solve(C, e))[:, 0, 0] <= stats.chi2.isf(0.05, moves.sum())
    patience = max(PATIENCE, int(np.ceil(PATIENCE_S * rate_hz)))
    due, clear = (lasting(off & (signal > size), patience) for size in (SEEN, CLEAR))
    alarm, some = ~np.isin(found.status, QUIET), after & found.suspects.any(axis=-1)
    named, alone = some & during, found.suspects.sum(axis=-1) == 1
    right, trusted = (
        named & found.suspects[:, part],
        during & np.isin(found.status, [*QUIET, "left out"]),
    )
    soon = after & (times <= times[large[:1]].sum() + (SOON_OF_A_DRIFT_S if drifts else SOON_S))
    first = int(np.argmax(some))
    return {
        "without": off.sum(),
        "wrong": wrong.sum(),
        "due": due.sum(),
        "noticed": (due & alarm).sum(),
        "unseen": lasting(wrong & (signal <= SEEN), patience).sum(),
        "clear": clear.any(),
        "named": named.any(),
        "named_clear": named.any() & clear.any(),
        "named_right": named.any() and right[np.flatnonzero(named)[-1]],
        "named_readings": named.sum(),
        "named_readings_right": right.sum(),
        "alarms": (alarm & during).sum(),
        "alarms_before": (alarm & ~after).sum(),
        "trusted": trusted.sum(),
        "trusted_hold": (trusted & holds).sum(),
        "readings": during.sum(),
        "large": len(large) > 0,
        "alarm_soon": len(large) > 0 and (alarm & soon).any(),
        "named_soon": len(large) > 0 and (named & alone & right & soon).any(),
        "some": some.any(),
        "first_right": some.any() and alone[first] and found.suspects[first, part],
        "ended": not (alarm & (times >= FAULT_S + lasts_s + OVER_S)).any(),
    }


def lasting(condition: np.ndarray, rows: int) -> np.ndarray:
    """Return where a condition has held for more than so many rows, up to and with this one."""
    here = np.arange(len(condition))
    return here - np.maximum.accumulate(np.where(condition, -1, here)) > rows


def foreign_field(robot: repro.Robot, q: np.ndarray) -> np.ndarray:
    """Return what a dipole of 1 A m^2 that stands upright 150 mm beside the robot adds to its readings [mT]."""
    T = robot.poses(q, [sensor.place for sensor in robot.sensors])
    away = T[..., :3, 3] - [0.15, 0.0, robot.length / 2]
    field = 1e3 * dipole_field("B", away.reshape(-1, 3), np.array([0.0, 0.0, 1.0])).reshape(away.shape)
    along = np.einsum("tkji,tkj->tki", T[..., :3, :3], field)
    return np.concatenate([along[:, k, 3 - s.axes :] for k, s in enumerate(robot.sensors)], axis=1)


LOOP_NOISE_MT = (0.02, 0.005, 0.002, 7.1e-4)
"""Noises of the sensors in the loop; the last one is that of real sensors."""
NOISE_MT = (1e-5, 4.8e-5, 2e-4, 7.1e-4, 2e-3, 5e-3, 2e-2, 1e-1)
"""Noise of a reading [mT]; 4.8e-5 and 7.1e-4 are inferred from what section 5.2 of Baaij et al. prints."""
NETWORKS = {"network of the paper": "pcc", "fast network": "fast", "multipole": ""}
"""Sensor models, and how the files of their networks begin."""
MEASURES = ["mean_percent", "bending_percent", "elongation_percent", "at_bound_percent"]


def noise() -> pd.DataFrame:
    """Return mean errors on T3 by sensor model, estimator and noise of the sensors, beside the bound: three minutes.

    A seed names a network and the noise. Levenberg-Marquardt starts straight at every time step, gradient descent is
    the paper's and starts at the truth. There is a fast network for one segment only.
    """
    parts, folder, levels = [], project_folder() / "data" / "networks", np.array(NOISE_MT)
    for n_b, seed, (model, kind) in product((1, 2, 3), baaij.SEEDS, NETWORKS.items()):
        if kind == "fast" and n_b > 1:
            continue
        robot, q = baaij.robot(n_b), baaij.lemniscate(n_b, steps=baaij.STEPS)
        names = [f"{kind}_nb{n_b}_segment{k}_seed{seed}.safetensors" for k in range(1, n_b + 1)]
        sensing = Sensing(robot, [load_network(folder / name) for name in names] if kind else None)
        clean = baaij.simulate(robot, q)
        normal = np.random.default_rng(seed).standard_normal(clean.shape)
        u = clean[:, None] + levels[:, None] * normal[:, None]
        found = baaij.least_squares(sensing, u, levels.min(), 20, sensor_count.TOLERANCE)
        descent = track(baaij.descent(sensing, n_b), u, np.tile(q[0], (len(levels), 1))).q
        own = {"n_b": n_b, "model": model, "noise_mt": levels}
        own["bound_percent"] = sensor_count.bound_percent(Sensing(robot), q, 1.0) * levels
        for solver, start, estimate, at in (
            ("Levenberg-Marquardt", "straight", found.q, 100 * found.details["at_bound"].any(-1).mean(0)),
            ("gradient descent", "ground truth", descent, np.nan),
        ):
            percent = baaij.relative_errors(estimate, q).reshape(len(levels), n_b, 3)
            values = percent.mean((1, 2)), percent[..., :2].mean((1, 2)), percent[..., 2].mean(1), at
            row = {**own, "solver": solver, "start": start, **dict(zip(MEASURES, values, strict=True))}
            parts.append(pd.DataFrame(row))
    keys = ["n_b", "model", "solver", "start", "noise_mt"]
    means: Any = pd.concat(parts).groupby(keys, sort=False)[[*MEASURES, "bound_percent"]].mean()
    table = means.reset_index()
    table = table.sort_values("solver", ascending=True, kind="stable", ignore_index=True)
    table = table.assign(of_bound=table["mean_percent"] / table["bound_percent"])
    table.attrs = {"noise_mt": list(NOISE_MT), "seeds": list(baaij.SEEDS), "steps": baaij.STEPS}
    return table


def drift_by_minute(seed: int) -> pd.DataFrame:
    """Return the rows of the study of drift for one run: every method, minute by minute."""
    run = wandering.draw(seed)
    hall = np.broadcast_to(np.arange(18) < 9, run.readings.shape)
    length = np.where(np.arange(9) % 3 == 2, wandering.START, np.nan)  # which no IMU sees
    plain = {
        "IMU only": {"mask": ~hall, "known": np.broadcast_to(length, run.q.shape)},
        "magnets only": {"mask": hall},
        "fused": {},
    }
    kalman, start = wandering.kalman_filter([]), wandering.START
    own = wandering.kalman_filter(wandering.drifts())
    # To know the drift is to have sensors without it.
    undrifted = wandering.draw(seed, size=0.0)
    ways = {name: (kalman, run, options) for name, options in plain.items()} | {
        "magnets self-calibrating": (own, run, {"mask": hall}),
        "self-calibrating": (own, run, {}),
        "oracle": (wandering.kalman_filter([wandering.SWAYING]), undrifted, {}),
    }
    found = {
        name: track(method, one.readings, start, times=one.times, monitor=None, **options)
        for name, (method, one, options) in ways.items()
    }
    parts = [wandering.by_minute(run, x).assign(method=name) for name, x in found.items()]
    table = pd.concat(parts, ignore_index=True).assign(twin=seed)
    return table.reindex(columns=["twin", "method", *table.columns[:-2]])


def drift() -> pd.DataFrame:
    """Return errors of the tip by minute for 20 robots whose sensors drift, and six methods: four minutes.

    A run that is finished stands in runs/drift and is not computed again.
    """
    folder, parts = project_folder() / "runs" / "drift", []
    folder.mkdir(parents=True, exist_ok=True)
    for seed in range(20):
        path = folder / f"{seed}.csv"
        if not path.is_file():
            drift_by_minute(seed).to_csv(path, index=False, float_format="%.4g")
        parts.append(pd.read_csv(path))
    table = pd.concat(parts, ignore_index=True)
    table.attrs = {"twins": 20, "minutes": wandering.MINUTES, "methods": list(table["method"].unique())}
    return table


def closed_loop() -> pd.DataFrame:
    """Return tracking errors [mm] of the page closed_loop at four noises of the sensors: two minutes."""
    root, parts = project_folder(), []
    for noise_mt in LOOP_NOISE_MT:
        folder = root / "runs" / "closed_loop" / f"{noise_mt:g}"
        folder.mkdir(parents=True, exist_ok=True)
        page = [root / "notebooks" / "closed_loop.ipynb", folder / "page.ipynb", folder, root]
        values = json.dumps({"loop_noise_mt": noise_mt})
        subprocess.run([sys.executable, "-m", "repro_companion.run", *page, values], check=True)
        means = pd.read_csv(folder / "closed_loop_means.csv").drop(
            columns=["seeds", "offset_mm", "bounded_%"]
        )
        parts.append(means.assign(noise_mt=noise_mt))
    table = pd.concat(parts, ignore_index=True)
    table.attrs = {"noise_mt": list(LOOP_NOISE_MT), "seeds": list(range(10))}
    return table


STUDIES: dict[str, Callable[[], pd.DataFrame]] = {
    study.__name__: study
    for study in (
        rig_starts,
        rig_sensors,
        table_2_networks,
        bend_filter,
        table_1_best,
        table_1_noise,
        particle_filter,
        bend_tests,
        bend_tests_takes,
        nominal_bends,
        light_bulb,
        martin_files,
        martin_calibration,
        alarms,
        noise,
        drift,
        closed_loop,
    )
}


def main() -> int:
    """Compute the studies that are named."""
    unknown = [name for name in sys.argv[1:] if name not in STUDIES]
    if unknown or not sys.argv[1:]:
        print(f"Studies: {', '.join(STUDIES)}.", file=sys.stderr)
        return 2
    for name in sys.argv[1:]:
        path = project_folder() / "data" / "studies" / f"{name}.csv"
        partial = path.with_suffix(".partial")
        table = STUDIES[name]()
        table.to_csv(partial, index=False, float_format="%.6g", lineterminator="\n")
        partial.replace(path)
        path.with_suffix(".json").write_text(json.dumps(table.attrs, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
