"""What a calibration leaves open: the combinations of parameters that data did not make more certain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def undetermined(
    names: Sequence[str], covariance: Float[np.ndarray, "k k"], threshold: float = 0.9
) -> list[str]:
    """Combinations of parameters that stay as uncertain as their priors, in words.

    Parameters
    ----------
    names
        Names of the parameters.
    covariance
        Posterior covariance in units of the priors: the identity where nothing was learnt.
    threshold
        Ratio of posterior to prior standard deviation from which a combination counts as undetermined.

    Returns
    -------
    list of str
        One text per combination, parameters in units of their priors, the largest first, those below half of
        it left out. Combinations are orthogonal and as close to single parameters as they can be.

    Examples
    --------
    >>> undetermined(["gain", "offset"], np.diag([0.01, 1.0]))
    ['+1.00 offset (uncertainty 1.00 of the prior)']
    """
    variances, vectors = np.linalg.eigh(covariance)
    vectors = vectors[:, np.sqrt(np.maximum(variances, 0.0)) > threshold]
    projector = vectors @ vectors.T
    texts = []
    for _ in range(vectors.shape[1]):  # Cholesky with pivots: the parameter least determined comes next
        pivot = int(np.argmax(np.diag(projector)))
        direction = projector[:, pivot] / np.sqrt(projector[pivot, pivot])
        projector = projector - np.outer(direction, direction)
        least = np.abs(direction).max() / 2
        ratio = np.sqrt(direction @ covariance @ direction)
        parts = [f"{direction[k]:+.2f} {names[k]}" for k in np.argsort(-np.abs(direction))]
        parts = parts[: int((np.abs(direction) > least).sum())]
        texts.append(f"{' '.join(parts)} (uncertainty {ratio:.2f} of the prior)")
    return texts
