"""3-D view of the simulated segment of Baaij et al. 2023, section 4: affine curvature."""

from __future__ import annotations

from repro.kinematics.paper_robots import affine_robot
from repro_companion.book.views_frames import every_nth, readings
from repro_companion.book.views_simulated import FRAMES, times
from repro_companion.pages.affine_curvature.method import PaperRun, configuration_error
from repro_live.view.robot_view import shape_view
from repro_live.view.shape_view import ShapeView


def flower_view(run: PaperRun) -> ShapeView:
    """Affine segment on the flower of section 4.3, and what the paper's method finds with its first seed."""
    q, shown = run.flower.q, every_nth(len(run.flower.q), FRAMES)
    # The same shape has two configurations, and any number of turns: the one next to the truth is shown.
    near = q + configuration_error(run.estimates.q[:, 0], q)
    u, u_hat = run.flower.u[shown].numpy(), run.estimates.u_hat[shown, 0].numpy()
    label = (
        "Simulated segment of affine curvature on the flower, and what the paper's gradient descent on its networks "
        f"(seed {run.seeds[0]}) finds, which starts at the ground truth."
    )
    return shape_view(
        affine_robot(),
        q[shown],
        times=times(len(q))[shown],
        label=label,
        estimate=near[shown],
        traces=[readings(u, "mT", u_hat)],
    )
