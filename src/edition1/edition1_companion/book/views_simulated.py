"""3-D views of the simulated robots of Baaij et al. 2023, section 3: constant curvature."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from edition1.errors import require
from edition1.kinematics.paper_robots import pcc_robot
from edition1_companion.book.views_frames import every_nth, readings
from edition1_companion.twins import table_1_method as table1
from edition1_companion.twins.table_1_rows import Row, simulate
from edition1_companion.twins.trajectories import RATE_HZ, lemniscate
from edition1_live.view.robot_view import shape_view
from edition1_live.view.shape_view import ShapeView

FRAMES = 100
"""Most frames of these views."""


def lemniscate_view(n_segments: int, amplitude_m: float) -> ShapeView:
    """Robot with segments of constant curvature along one period of the lemniscate of section 3.4.

    Parameters
    ----------
    n_segments
        Segments of the robot.
    amplitude_m
        Bending amplitude D of every segment [m].
    """
    q = lemniscate(n_segments, amplitude_m=amplitude_m)
    shown = every_nth(len(q), FRAMES)
    label = f"Simulated robot with segments of constant curvature, {n_segments} in all, along the lemniscate."
    return shape_view(pcc_robot(n_segments), q[shown], times=times(len(q))[shown], label=label)


def paper_method_view(
    rows: Sequence[Row],
    folder: Path,
    seed: int,
    *,
    iterations: int = table1.ITERATIONS,
    step_size: Sequence[float] = (),
    noise_mt: float = 0.0,
    steps: int = 400,
) -> ShapeView:
    """Run the paper's method of Table 1 on the robot with the most segments, and show truth and estimate.

    Parameters
    ----------
    rows
        Rows of the table whose networks are there; the first of those with the most segments is shown.
    folder, seed
        Of the networks.
    iterations, step_size, noise_mt, steps
        As in :func:`edition1_companion.twins.table_1_method.run`.

    Raises
    ------
    InputError
        If there is no row.
    """
    require(rows, "rows", "paper_method_view", "at least one with trained networks", "none")
    row = max(rows, key=lambda row: row.n_segments)
    simulation = simulate([row], steps=steps)
    found, _ = table1.paper_method(
        simulation,
        table1.networks([row], folder, [seed]),
        1,
        iterations=iterations,
        step_size=table1.step_sizes(row.n_segments, *step_size),
        noise_mt=noise_mt,
    )
    shown = every_nth(steps, FRAMES)
    u, u_hat = simulation.u[shown, 0].numpy(), found.u_hat[shown, 0, 0].numpy()
    robot = f"a robot of {row.n_segments} segment{'s' * (row.n_segments > 1)}"
    label = (
        f"Row {row.name} of Table 1, simulated: {robot} on the lemniscate T3, and what the paper's gradient descent "
        f"on its networks (seed {seed}) finds, which starts at the ground truth."
    )
    return shape_view(
        row.robot(),
        simulation.q[shown],
        times=times(steps)[shown],
        label=label,
        estimate=found.q[shown, 0, 0],
        traces=[readings(u, "mT", u_hat)],
    )


def times(steps: int) -> Float[np.ndarray, " t"]:
    """Times of a simulated trajectory [s]."""
    return torch.arange(steps, dtype=torch.float64).numpy() / RATE_HZ
