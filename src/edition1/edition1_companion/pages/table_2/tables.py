"""Table 2 of Baaij et al. 2023, printed and regenerated, and its Figs 9 to 11 as tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import torch

from edition1.errors import bad_input
from edition1.estimation.base import Trajectory
from edition1.sensing.ensemble import SeedEnsemble
from edition1_companion.book.project import find_project
from edition1_companion.book.published import read_published
from edition1_companion.recordings.baaij2023 import Recording
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ, rig_robot
from edition1_companion.twins.rig_data import RigData
from edition1_companion.twins.rig_descent import (
    ITERATIONS,
    MOMENTUM,
    STEP_SIZE,
    PaperRun,
    bend_errors,
    reading_errors,
    rig_sensing,
    row_name,
)
from edition1_companion.twins.rig_filter import filtered
from edition1_companion.twins.rig_map import BendMap
from edition1_companion.twins.robot_tables import stills as stills_of

LANDSCAPE_S = 3.0
"""Time in T5's test part of Fig. 10(a), as in the released code [s]."""
LANDSCAPE_CLIP_MV = 100.0


def ours_runs(bend_map: BendMap, tests: dict[str, Recording]) -> dict[str, Trajectory]:
    """Ours on every test part; of these it takes the readings alone."""
    return {name: filtered(bend_map, part.u) for name, part in tests.items()}


def ours_errors(runs: dict[str, Trajectory], bend_map: BendMap, data: RigData) -> pd.DataFrame:
    """Errors of Table 2 with ours: ``row, quantity, unit, error``, for test parts or their beginnings."""
    rows = []
    for name, run in runs.items():
        whole = data.tests[name]
        n = len(run.q)
        part = Recording(whole.name, whole.frame[:n], whole.q[:n], whole.u[:n])
        predicted = bend_map.readings_mv(part.q)[:, None]
        for cell in reading_errors(predicted, part, whole) + bend_errors(run.q[:, None].numpy(), part, whole):
            del cell["model"]
            rows.append({"row": row_name(name)} | cell)
    return pd.DataFrame(rows)


def trajectories_table(
    tests: dict[str, Recording], *, longest_s: float = 60.0, every: int = 4
) -> pd.DataFrame:
    """Fig. 9: bend and tip [mm] of the first part of each trajectory, ``recording, time_s, ..., tip_z_mm``."""
    parts = []
    for name, part in tests.items():
        kept = slice(0, round(longest_s * RIG_RATE_HZ), every)
        q = part.q[kept]
        tip = rig_robot().tip(torch.from_numpy(q))[..., :3, 3].numpy()
        columns = {"recording": name, "time_s": part.time_s[kept]}
        columns |= {f"delta_{axis}_mm": 1e3 * q[:, k] for k, axis in enumerate("xy")}
        parts.append(pd.DataFrame(columns | {f"tip_{a}_mm": 1e3 * tip[:, k] for k, a in enumerate("xyz")}))
    return pd.concat(parts, ignore_index=True)


def shapes_table(tests: dict[str, Recording], *, shapes: int = 12, longest_s: float = 60.0) -> pd.DataFrame:
    """Fig. 9: backbones [mm] at evenly spaced times, ``recording, shape, x_mm, y_mm, z_mm``."""
    parts = []
    for name, part in tests.items():
        last = min(len(part), round(longest_s * RIG_RATE_HZ)) - 1
        for k, step in enumerate(np.linspace(0, last, shapes).round().astype(int)):
            curve = rig_robot().backbone(torch.from_numpy(part.q[step])).numpy()
            table = pd.DataFrame(1e3 * curve, columns=["x_mm", "y_mm", "z_mm"])
            parts.append(table.assign(recording=name, shape=k))
    return pd.concat(parts, ignore_index=True)


def landscape(
    data: RigData, model: SeedEnsemble, seeds: Sequence[int], *, time_s: float = LANDSCAPE_S, points: int = 50
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Fig. 10(a): root mean square of the readings' error over the bend, for the first seed, and the descent's path.

    Over the range of T5's test part, at the true elongation, clipped at 100 mV. The descent starts straight.

    Returns
    -------
    DataFrame, DataFrame
        ``delta_x_mm, delta_y_mm, rmse_mV``; and ``iteration, delta_x_mm, delta_y_mm, rmse_mV``, of which the row of
        iteration -1 is the truth.

    Raises
    ------
    InputError
        If T5 is not among the tests, or does not reach this time.
    """
    step = round(time_s * RIG_RATE_HZ)
    if "T5" not in data.tests or not 0 <= step < len(data.tests["T5"]):
        raise bad_input("time_s", "landscape", "within T5's test part, which is among the tests", time_s)
    part, sensing = data.tests["T5"], rig_sensing(model)
    u, truth = torch.from_numpy(part.u[step]), torch.from_numpy(part.q[step])
    axes = [np.linspace(part.q[:, k].min(), part.q[:, k].max(), points) for k in range(2)]
    x, y = (torch.from_numpy(g.ravel()) for g in np.meshgrid(*axes))
    grid = torch.stack([x, y, truth[2].expand_as(x)], dim=-1)

    def rmse(q: torch.Tensor) -> torch.Tensor:
        """Of the first seed; a network for each seed is evaluated."""
        return (sensing(q.expand(len(seeds), *q.shape))[0] - u).square().mean(-1).sqrt()

    with torch.no_grad():
        values = rmse(grid).clamp_max(LANDSCAPE_CLIP_MV)
    q, b = torch.stack([0 * truth[0], 0 * truth[0], truth[2]]), torch.zeros(3, dtype=torch.float64)
    path = [(-1, truth, float(rmse(truth[None])))]
    gamma = torch.tensor(STEP_SIZE, dtype=torch.float64)
    for iteration in range(ITERATIONS):
        q = q.detach().requires_grad_()
        error = rmse(q[None])[0]
        path.append((iteration, q.detach(), float(error.detach())))
        (gradient,) = torch.autograd.grad(error.square(), q)
        b = MOMENTUM * b + gradient
        q = q - gamma * b
    columns = {"delta_x_mm": 1e3 * x, "delta_y_mm": 1e3 * y, "rmse_mV": values}
    steps = [
        {"iteration": i, "delta_x_mm": 1e3 * float(p[0]), "delta_y_mm": 1e3 * float(p[1]), "rmse_mV": e}
        for i, p, e in path
    ]
    return pd.DataFrame({k: v.numpy() for k, v in columns.items()}), pd.DataFrame(steps)


def series_table(
    run: PaperRun, ours: dict[str, Trajectory], names: Sequence[str] = ("T2", "T5")
) -> pd.DataFrame:
    """Fig. 10(b): bend over time [mm]: ``recording, time_s, name, truth, mean, std, ours, ours_std``.

    Mean and sample standard deviation of the paper's method with known elongation over the seeds; ours with the
    standard deviation that it gives itself.
    """
    parts = []
    for name in names:
        part, q = run.parts[name], run.estimates["known", name]
        own, covariance = ours[name].q.numpy(), ours[name].covariance
        assert covariance is not None
        for k, axis in enumerate("xy"):
            several = q.shape[1] > 1
            columns = {
                "time_s": part.time_s,
                "truth": 1e3 * part.q[:, k],
                "mean": 1e3 * q[:, :, k].mean(axis=1),
                "std": 1e3 * q[:, :, k].std(axis=1, ddof=1) if several else np.full(len(q), np.nan),
                "ours": 1e3 * own[: len(part), k],
                "ours_std": 1e3 * np.sqrt(covariance.numpy()[: len(part), k, k]),
            }
            parts.append(pd.DataFrame(columns).assign(recording=name, name=f"delta_{axis}"))
    return pd.concat(parts, ignore_index=True)


def stills(run: PaperRun, *, name: str = "T3") -> tuple[pd.DataFrame, pd.DataFrame]:
    """Fig. 11: backbone along T3, true and estimated with known elongation, and the parts in the true shape."""
    part, found = run.parts[name], run.estimates["known", name]
    steps = sorted({min(round(t * RIG_RATE_HZ), len(part) - 1) for t in (0.0, 2.0, 4.0, 6.0, 8.0)})
    truth, estimates = torch.from_numpy(part.q[steps]), torch.from_numpy(found[steps])
    return stills_of(rig_robot(), part.time_s[steps].tolist(), truth, estimates, run.seeds)


def published_table_2() -> pd.DataFrame:
    """Columns ``row, quantity, unit, published, published_std``, in the order of the paper."""
    rows = [
        (key.row, key.quantity, key.unit, float(cell.value), float(cell.std))
        for key, cell in read_published(find_project().published).items()
        if (key.paper, key.artefact) == ("baaij2023", "Table 2")
    ]
    return pd.DataFrame(rows, columns=["row", "quantity", "unit", "published", "published_std"])


def all_cells(published: pd.DataFrame, paper: pd.DataFrame, ours: pd.DataFrame) -> pd.DataFrame:
    """Every row and column of Table 2: published, the paper's method with each elongation, and ours.

    Parameters
    ----------
    published
        From :func:`published_table_2`.
    paper
        Columns ``elongation, row, seed, quantity, unit, error``.
    ours
        Columns ``row, quantity, unit, error``.

    Returns
    -------
    DataFrame
        Columns ``row, quantity, unit, published, published_std``, for each elongation its name and ``..._std``, and
        ``ours``; a cell that the paper does not print, the relative error across T1, is left out.
    """
    keys = ["row", "quantity", "unit"]
    table = ours.rename(columns={"error": "ours"})
    for name, part in paper.groupby("elongation", sort=False):
        cells = part.groupby(keys)["error"].agg(["mean", "std"]).reset_index()
        cells = cells.rename(columns={"mean": name, "std": f"{name}_std"})
        table = table.merge(cells, on=keys, how="left")
    table = table.merge(published, on=keys)
    names = [f"{c}{s}" for c in ("published", *dict.fromkeys(paper["elongation"])) for s in ("", "_std")]
    return table.loc[:, [*keys, *names, "ours"]]
