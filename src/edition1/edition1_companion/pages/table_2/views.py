"""3-D views of the experiments of Baaij et al. 2023, section 5: motion capture, and what both methods find."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from edition1.errors import bad_input
from edition1.estimation.base import Trajectory
from edition1_companion.book.views_frames import every_nth, readings
from edition1_companion.recordings.baaij2023 import Recording
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ, rig_robot
from edition1_companion.twins.rig_descent import PaperRun
from edition1_live.view.robot_view import shape_view
from edition1_live.view.shape_view import ShapeView

LONGEST_S = 15.0
"""No view shows more than the beginning of this length [s]; a fast lemniscate takes a few seconds."""
FRAMES = 75
"""Most frames of a view: six on one page have to be light."""
LOST_M = 5e-3
"""A bend further from the truth is lost [m]."""


@dataclass(frozen=True, repr=False)
class ShapeViews:
    """Views, each below its title; displays itself in a notebook and in the book.

    Parameters
    ----------
    views
        By title.
    """

    views: Mapping[str, ShapeView]

    def to_html(self) -> str:
        """Return the views as groups named by their titles; the viewer's style puts them side by side."""
        groups = (
            f'<div role="group" aria-label="{html.escape(title)}">'
            f"<p><strong>{html.escape(title)}</strong></p>{view.to_html()}</div>"
            for title, view in self.views.items()
        )
        return f'<div class="shape-views">{"".join(groups)}</div>'

    def _repr_html_(self) -> str:
        return self.to_html()

    def __repr__(self) -> str:
        return "\n".join(f"{title}: {view!r}" for title, view in self.views.items())


def rig_views(parts: Mapping[str, Recording], ours: Mapping[str, Trajectory], source: str) -> ShapeViews:
    """One view for each trajectory: see :func:`rig_view`.

    Parameters
    ----------
    parts, ours
        Recordings, and what ours finds on them, by trajectory.
    source
        Where the recordings come from.
    """
    titles = {name: f"{name} ({source})" for name in parts}
    return ShapeViews({title: rig_view(parts[name], ours[name], title) for name, title in titles.items()})


def rig_view(part: Recording, ours: Trajectory, title: str) -> ShapeView:
    """Segment by motion capture, ours with a tube of two standard deviations that it gives itself, and readings.

    Parameters
    ----------
    part, ours
        A recording, and what ours finds on it.
    title
        Which recording it is, and where it comes from.
    """
    n = min(len(part), len(ours.q), round(LONGEST_S * RIG_RATE_HZ))
    shown = every_nth(n, FRAMES)
    return shape_view(
        rig_robot(),
        torch.from_numpy(part.q[shown]),
        times=part.time_s[shown] - part.time_s[0],
        label=f"{title}: the segment by motion capture (truth), and the filter with a tube of two deviations.",
        estimate=ours.q[shown],
        covariance=None if ours.covariance is None else ours.covariance[shown],
        traces=[readings(part.u[shown], "mV")],
    )


def lost_views(paper: PaperRun, names: Sequence[str], source: str) -> ShapeViews:
    """The paper's method with known elongation on some trajectories, with the seed that loses the bend longest."""
    views = {}
    for name in names:
        if name not in paper.parts:
            raise bad_input("trajectories", "the views", f"with {name} among them", list(paper.parts))
        part, found = paper.parts[name], paper.estimates["known", name]
        off_m = np.linalg.norm(found[..., :2] - part.q[:, None, :2], axis=-1)
        seed = int((off_m > LOST_M).mean(axis=0).argmax())
        shown = every_nth(min(len(part), round(LONGEST_S * RIG_RATE_HZ)), FRAMES)
        title = f"{name}, the paper's method, seed {paper.seeds[seed]} ({source})"
        views[title] = shape_view(
            rig_robot(),
            torch.from_numpy(part.q[shown]),
            times=part.time_s[shown] - part.time_s[0],
            label=f"{title}: the segment by motion capture (truth), and the estimate of the gradient descent.",
            estimate=torch.from_numpy(found[shown, seed]),
            traces=[readings(part.u[shown], "mV")],
        )
    return ShapeViews(views)
