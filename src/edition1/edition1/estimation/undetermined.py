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
    texts = []
    for direction, ratio in _directions(covariance, threshold):
        parts = [f"{direction[k]:+.2f} {names[k]}" for k in _largest(direction)]
        texts.append(f"{' '.join(parts)} (uncertainty {ratio:.2f} of the prior)")
    return texts


def not_determined(
    names: Sequence[str], covariance: Float[np.ndarray, "k k"], threshold: float = 0.9
) -> list[str]:
    """Sentences about the same combinations, for errors of sensors during a motion.

    Parameters
    ----------
    names
        Names of the errors; of those that begin with "moment" or "gain" the reading is a product.
    covariance, threshold
        As of :func:`undetermined`.

    Examples
    --------
    Nothing but the product of a moment and a gain is read:

    >>> learnt = np.array([[0.5, -0.5], [-0.5, 0.5]])
    >>> not_determined(["moment 1", "gain 2"], learnt)
    ['The ratio of moment 1 and gain 2 is not determined by this motion.']
    """
    texts = []
    for direction, _ in _directions(covariance, threshold):
        here = _largest(direction)
        named = [names[k] for k in here]
        factors = all(name.startswith(("moment", "gain")) for name in named)
        if len(here) == 1:
            what = named[0][0].upper() + named[0][1:]
        elif len(here) == 2:
            together = direction[here[0]] * direction[here[1]] > 0
            word = ("product" if together else "ratio") if factors else ("sum" if together else "difference")
            what = f"The {word} of {named[0]} and {named[1]}"
        else:
            what = f"A combination of {', '.join(named[:-1])} and {named[-1]}"
        texts.append(f"{what} is not determined by this motion.")
    return texts


def _largest(direction: np.ndarray) -> list[int]:
    """Parameters of a direction, the largest first; those below half of it are left out."""
    size = np.abs(direction)
    return [int(k) for k in np.argsort(-np.round(size, 9), kind="stable") if size[k] > size.max() / 2]


def _directions(covariance: np.ndarray, threshold: float) -> list[tuple[np.ndarray, float]]:
    """Combinations that stay uncertain, as close to single parameters as they can be, and their ratios."""
    variances, vectors = np.linalg.eigh(covariance)
    vectors = vectors[:, np.sqrt(np.maximum(variances, 0.0)) > threshold]
    projector, found = vectors @ vectors.T, []
    for _ in range(vectors.shape[1]):  # Cholesky with pivots: the parameter least determined comes next
        pivot = int(np.argmax(np.diag(projector)))
        direction = projector[:, pivot] / np.sqrt(projector[pivot, pivot])
        projector = projector - np.outer(direction, direction)
        found.append((direction, float(np.sqrt(direction @ covariance @ direction))))
    return found
