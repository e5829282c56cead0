r"""Hysteresis of one coordinate: memory of the path, and a term that depends on the rate.

Two standard models of the memory, both normalised to [-1, 1] and independent of the rate:

* ``"bouc-wen"``: Bouc-Wen with exponent 1 and without its second shape term, which is Dahl's model of friction,
  :math:`\dot z = (\dot x - |\dot x| z)/r`, solved exactly between samples (Wen, 1976; Dahl, 1968);
* ``"prandtl-ishlinskii"``: the mean of stop operators of evenly spaced thresholds up to ``r``, each divided by
  its threshold (Brokate and Sprekels, *Hysteresis and Phase Transitions*, 1996, chapter 2).
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

MODELS = ("bouc-wen", "prandtl-ishlinskii")
"""Names of the models."""
STOPS = 6
"""Number of stop operators."""


def memory(
    x: Float[np.ndarray, " samples"], stroke: float, model: str = "bouc-wen"
) -> Float[np.ndarray, " samples"]:
    """Memory of a path, in [-1, 1]: it tends to 1 while ``x`` rises and to -1 while it falls.

    Parameters
    ----------
    x
        Samples of the path. The memory is zero at the first one.
    stroke
        How far ``x`` has to travel for the memory to turn over, in the unit of ``x``: after a long rise the
        Bouc-Wen memory is within ``1/e`` of 1 one stroke after the turn; all stops have turned after two.
    model
        One of :data:`MODELS`.

    Examples
    --------
    >>> memory(np.array([0.0, 1.0, 2.0, 1.0]), stroke=1.0).round(3)
    array([ 0.   ,  0.632,  0.865, -0.314])
    """
    return _bouc_wen(x, stroke) if model == "bouc-wen" else _prandtl_ishlinskii(x, stroke)


def _bouc_wen(x: np.ndarray, stroke: float) -> np.ndarray:
    z, found = 0.0, [0.0] * len(x)
    for k, step in enumerate(np.diff(x).tolist(), start=1):
        end = math.copysign(1.0, step)
        z = end + (z - end) * math.exp(-abs(step) / stroke)
        found[k] = z
    return np.array(found)


def _prandtl_ishlinskii(x: np.ndarray, stroke: float) -> np.ndarray:
    found = np.zeros(len(x))
    steps = np.diff(x).tolist()
    for threshold in stroke * np.arange(1, STOPS + 1) / STOPS:
        z, limit, stop = 0.0, float(threshold), [0.0] * len(x)
        for k, step in enumerate(steps, start=1):
            z = min(max(z + step, -limit), limit)
            stop[k] = z
        found += np.array(stop) / (limit * STOPS)
    return found
