"""How far the bend filter is off on random twins of the rig, and how far it says it is; all numbers are SYNTHETIC."""

from __future__ import annotations

import numpy as np

from edition1.estimation.base import Trajectory
from edition1_companion.recordings.baaij2023 import Recording

AS_IT_IS, NO_LAG = "as it is", "no lag across the bend"


def distance_and_deviation(found: Trajectory, part: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Mahalanobis distance of the bend from the truth, and the geometric mean of its stated deviations [mm]."""
    assert found.covariance is not None
    error, C = (found.q.numpy() - part.q)[:, :2], found.covariance.numpy()[:, :2, :2]
    squared = np.einsum("ti,ti->t", error, np.linalg.solve(C, error[..., None])[..., 0])
    return np.sqrt(squared), 1e3 * np.linalg.det(C) ** 0.25
