"""Write the landscape of the live figure on the page ``table_2``, book/_static/live/landscape_grid.js.

``python scripts/live_grid.py`` computes the loss of one instant of T2 on the simulated rig, and its slopes, on a grid
of bends: the instant at which Fig. 10 of that page shows an estimate that jumps.
"""

from __future__ import annotations

import base64
import json

import numpy as np

from repro import Sensing
from repro_companion.papers import rig, table_2
from repro_companion.show import project_folder

FRAME, SEED = 429, 2
"""Of the largest jump on T2, as the page finds it."""
REACH_MM, POINTS = 20.0, 81


def landscape(sensing: Sensing, u: np.ndarray, elongation: float) -> np.ndarray:
    """Return the loss [mV²] and its slopes by x and y [mV²/mm] on the grid, ``[3, y, x]``."""
    axis = np.linspace(-REACH_MM, REACH_MM, POINTS)
    x, y = np.meshgrid(axis, axis)
    u_hat, J = sensing.linearise(np.stack([1e-3 * x, 1e-3 * y, np.full_like(x, elongation)], axis=-1))
    off, J = u_hat - u, 1e-3 * J[..., :2]
    slopes = 2 / rig.SENSORS * np.einsum("yxs,yxsc->cyx", off, J)
    return np.stack([(off**2).mean(axis=-1), *slopes])


def main() -> None:
    """Compute the grid and write it, as a script that a page can read from disk."""
    data = table_2.load("simulated")
    q, u = data.tests["T2"].q[FRAME], data.tests["T2"].u[FRAME]
    sensing = Sensing(rig.robot(), table_2.networks(data, SEED), earth=rig.EARTH)
    values = landscape(sensing, u, q[2]).astype("<f4")
    about = {
        "points": POINTS,
        "reach": REACH_MM,
        "seed": SEED,
        "readings": u.tolist(),
        "elongation": q[2],
        "truth": (1e3 * q[:2]).round(3).tolist(),
        "values": base64.b64encode(values.tobytes()).decode(),
    }
    path = project_folder() / "book" / "_static" / "live" / "landscape_grid.js"
    path.write_text(f"REPRO.grid = {json.dumps(about)};\n", encoding="utf-8")


if __name__ == "__main__":
    main()
