"""Errors of the bend of several methods on a recording of the rig."""

from __future__ import annotations

import numpy as np

from repro_companion.recordings.baaij2023 import Recording
from repro_companion.twins.rig_filter import OursRun

ELLIPSE = 5.991
"""95 % quantile of chi-squared with two degrees of freedom."""


def method_errors(part: Recording, found: dict[str, np.ndarray], own: OursRun) -> dict[str, float]:
    """Errors of the bend of several methods and of ours, as in a row of the page on random twins.

    Parameters
    ----------
    part
        With the truth.
    found
        Configurations by method ``[t, seeds, 3]``, whose errors are the means over the seeds.
    own
        What ours finds.
    """
    row = {}
    for method, q in (found | {"ours": own.q[:, None]}).items():
        error = np.sqrt(((q - part.q[:, None]) ** 2).mean(axis=0)).mean(axis=0)
        row |= {f"{method}_delta_{axis}_mm": 1e3 * error[k] for k, axis in enumerate("xy")}
    return row | _own_uncertainty(own.q - part.q, own.covariance)


def _own_uncertainty(error: np.ndarray, covariance: np.ndarray) -> dict[str, float]:
    """How the covariance of ours fits its errors."""
    e, C = error[:, :2], covariance[:, :2, :2]
    squares = np.einsum("ni,ni->n", e, np.linalg.solve(C, e[..., None])[..., 0])
    within = np.abs(error[:, 2]) < 1.96 * np.sqrt(covariance[:, 2, 2])
    return {
        "ours_delta_L_mm": 1e3 * float(np.sqrt((error[:, 2] ** 2).mean())),
        "covered": float((squares < ELLIPSE).mean()),
        "nees": float(np.median(squares)),
        "covered_delta_L": float(within.mean()),
    }
