"""Compute what takes minutes or hours and is committed in data/studies: ``python scripts/studies.py NAME ...``.

A study is written whole or not at all, with its settings beside it. Without a name the studies are listed.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from repro import GradientDescent, Sensing, exact_arcs, pcc_extended, track
from repro_companion.papers import baaij, martin, mitchell, rig
from repro_companion.show import project_folder


def rig_starts() -> pd.DataFrame:
    """Return errors [mm] of the descent of Table 2 from starts that differ by rounding: half an hour.

    One row for each trajectory, seed, start and step, on the simulated rig: the published step, and half of it with
    twice the iterations.
    """
    data = rig.load("simulated")
    q, u = data.beginnings(15.0)
    q, u = (np.broadcast_to(x[:, :, None], (*x.shape[:2], rig.STARTS, 3)) for x in (q, u))
    known = np.where([False, False, True], q, np.nan)
    apart = 1 + rig.APART * np.random.default_rng(0).uniform(-1, 1, (rig.STARTS, 3))
    lines = []
    for step, shorter in (("published", 1), ("half", 2)):
        for seed in rig.SEEDS:
            sensing = Sensing(rig.robot(), rig.networks(data, seed), earth=rig.EARTH)
            moves = np.array(rig.STEP_SIZE) / shorter
            descent = GradientDescent(sensing, moves, rig.MOMENTUM, rig.ITERATIONS * shorter)
            found = track(descent, u, q[0] * apart, known=known, progress=f"{step} step, seed {seed}").q
            off = 1e3 * np.sqrt(((found - q) ** 2).mean(axis=0))
            for i, name in enumerate(data.tests):
                lines += [(step, rig.row_name(name), seed, k, *off[i, k, :2]) for k in range(rig.STARTS)]
    table = pd.DataFrame(lines, columns=["step", "row", "seed", "start", "delta_x", "delta_y"])
    table.attrs = {
        "trajectories": list(data.tests),
        "seeds": rig.SEEDS,
        "starts": rig.STARTS,
        "apart": rig.APART,
    }
    table.attrs |= {"seconds": 15.0, "steps": ["published", "half"]}
    return table


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


STUDIES: dict[str, Callable[[], pd.DataFrame]] = {
    study.__name__: study
    for study in (rig_starts, table_1_best, table_1_noise, particle_filter, martin_calibration)
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
