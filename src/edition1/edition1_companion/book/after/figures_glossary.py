"""The sketch of the trajectories in the glossary: paths in the plane of bending, in the colour of the text.

``python -m edition1_companion.book.after.figures_glossary`` writes it; it is committed, since it never changes.
"""

from __future__ import annotations

import sys

import numpy as np
from edition1.files import write_whole

from edition1_companion.book.project import find_project
from edition1_companion.twins.pneumatic_actuation import TRAJECTORIES, Chambers, torque_sequence
from edition1_companion.twins.trajectories import flower, trajectory

SKETCH = "trajectories.svg"
"""Name of the sketch in the folder ``book``."""
WIDTH, HALF = 110, 40
SHOWN_S = {"T0": 60.0, "T1": 5.0, "T2": 10.0, "T3": 10.0, "T4": 120.0, "T5": 250.0}
"""Of each actuation sequence [s]: a period; of the random one and of the flower as much as can be told apart."""
POINTS = 360
ALT = (
    "Paths in the plane of bending. Experiments: T0 random straight lines, T1 a line to one side, T2 one lobe of a"
    " lemniscate, T3 a figure of eight, T4 a spiral, T5 a fan of lines whose direction turns. Simulation: T0 a smooth"
    " random path, T1 a line, T2 a lobe, T3 a figure of eight, a flower of three petals."
)


def experiment_path(name: str) -> np.ndarray:
    """Return where an actuation sequence bends the segment to, as ``[points, 2]``, in shares of its reach."""
    chambers = Chambers()
    time_s = np.linspace(0.0, SHOWN_S[name], 4 * POINTS)
    tau = torque_sequence(name, time_s, chambers, seed=0) / chambers.reference_nm
    return np.column_stack([tau[:, 1], -tau[:, 0]])  # a torque about x bends along y


def simulated_path(name: str) -> np.ndarray:
    """Return the bend of one segment on a simulated trajectory, in shares of its reach."""
    if name == "flower":
        kappa_0, kappa_1, phi, _ = flower().numpy().T
        angle = kappa_0 + kappa_1 / 2  # of the tip: the curvature is affine in the arc
        xy = np.column_stack([angle * np.cos(phi), angle * np.sin(phi)])
    else:
        xy = trajectory(name, 1).numpy()[:, :2]
    return xy / np.abs(xy).max()


def sketch() -> str:
    """Return the sketch: the six sequences of the experiments, below them the simulated trajectories."""
    rows = (
        ("experiments", {name: experiment_path(name) for name in TRAJECTORIES}),
        ("simulation", {name: simulated_path(name) for name in ("T0", "T1", "T2", "T3", "flower")}),
    )
    parts = [f'<figure class="schematic"><div role="img" aria-label="{ALT}">']
    for kind, paths in rows:
        parts.append(f'<p class="trajectories-title">{kind}</p><div class="trajectories">')
        parts += [_drawn(name, path) for name, path in paths.items()]
        parts.append("</div>")
    return "\n".join([*parts, "</div></figure>", ""])


def _drawn(name: str, path: np.ndarray) -> str:
    """Return one path as a picture of its own, so that a narrow screen breaks the row."""
    x, y = WIDTH // 2, HALF + 4
    points = path[:: max(1, len(path) // POINTS)]
    line = " ".join(f"{x + HALF * dx:.1f},{y - HALF * dy:.1f}" for dx, dy in points)
    return (
        f'<svg width="{WIDTH}" height="{y + HALF + 24}" font-size="13" fill="currentColor" stroke="currentColor"'
        f' stroke-width="0">\n<circle cx="{x}" cy="{y}" r="1.5" opacity="0.6"/>\n'
        f'<polyline points="{line}" fill="none" stroke-width="1"/>\n'
        f'<text x="{x}" y="{y + HALF + 18}" text-anchor="middle">{name}</text>\n</svg>'
    )


if __name__ == "__main__":
    write_whole(find_project().book / SKETCH, sketch())
    sys.exit()
