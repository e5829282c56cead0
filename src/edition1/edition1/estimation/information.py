r"""What readings can tell about a configuration: Fisher information and the Cramér-Rao bound.

For readings :math:`u = h(q) + \epsilon` with independent normal noise, the information about :math:`q` is
:math:`J^T \mathrm{diag}(1/\sigma^2)\, J` with :math:`J = \partial h/\partial q`, and no unbiased estimate has a
covariance below its inverse. An estimate that is biased, such as one kept within bounds, can have a smaller error.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input


def fisher_information(
    J: Float[Tensor, "*batch s n_q"], noise_mt: float | Tensor
) -> Float[Tensor, "*batch n_q n_q"]:
    r"""Fisher information :math:`J^T \mathrm{diag}(1/\sigma^2)\, J` of independent normal readings.

    Parameters
    ----------
    J
        Derivatives of the readings with respect to the configuration [mT per unit of ``q``].
    noise_mt
        Standard deviation of a reading [mT]: one number, or one for each sensor (last dimension ``s``), which may
        be infinite for a sensor that does not count.

    Raises
    ------
    InputError
        If the noise is not positive, or does not have one value for each sensor.

    Examples
    --------
    Two sensors that read the same coordinate with slopes 3 and 4 mT/m and a noise of 0.5 mT:

    >>> J = torch.tensor([[3.0], [4.0]], dtype=torch.float64)
    >>> fisher_information(J, 0.5)
    tensor([[100.]], dtype=torch.float64)
    """
    noise = torch.as_tensor(noise_mt, dtype=J.dtype, device=J.device)
    if noise.ndim and noise.shape[-1] != J.shape[-2]:
        expected = f"one number, or one for each of {J.shape[-2]} sensors"
        raise bad_input("noise_mt", "fisher_information", expected, f"shape {tuple(noise.shape)}")
    if not bool((noise > 0).all()):
        raise bad_input("noise_mt", "fisher_information", "positive", noise.tolist())
    whitened = J / (noise.unsqueeze(-1) if noise.ndim else noise)
    return whitened.mT @ whitened


def cramer_rao(information: Float[Tensor, "*batch n_q n_q"]) -> Float[Tensor, "*batch n_q n_q"]:
    r"""Cramér-Rao bound: the inverse of the Fisher information, a covariance.

    A direction counts as undetermined where the eigenvalue of the information, its coordinates scaled to a diagonal
    of ones, is within rounding of zero. Coordinates that take part in such a direction get an infinite variance, and
    their covariances are not a number; the other coordinates keep their finite bound. So an average over coordinates
    or time cannot look better than it is. Differentiable where nothing is undetermined.

    Parameters
    ----------
    information
        Symmetric and positive semi-definite, as from :func:`fisher_information`; the information of several
        independent measurements, or of a prior, may be added.

    Raises
    ------
    InputError
        If the information is not finite, not symmetric, or has a negative eigenvalue.

    Examples
    --------
    One reading of two coordinates, of which it sees only the first:

    >>> J = torch.tensor([[2.0, 0.0]], dtype=torch.float64)
    >>> cramer_rao(fisher_information(J, 1.0)).diagonal()
    tensor([0.2500,    inf], dtype=torch.float64)
    """
    n = information.shape[-1]
    diagonal = information.diagonal(dim1=-2, dim2=-1)
    if not bool(torch.isfinite(information).all()):
        raise bad_input("information", "cramer_rao", "finite", "values that are not")
    scale = torch.where(diagonal > 0, diagonal, 1.0).sqrt()
    scaled = information / (scale.unsqueeze(-1) * scale.unsqueeze(-2))
    rounding = 10 * n * torch.finfo(information.dtype).eps
    with torch.no_grad():
        if bool(((scaled - scaled.mT).abs() > rounding).any()):
            raise bad_input("information", "cramer_rao", "symmetric", "a matrix that is not")
        values, vectors = torch.linalg.eigh(scaled)
        if bool((values < -rounding).any()):
            received = f"an eigenvalue of {float(values.min()):.3g} of the diagonal"
            raise bad_input("information", "cramer_rao", "positive semi-definite", received)
        empty = values <= rounding
        projector = (vectors * empty.unsqueeze(-2)) @ vectors.mT  # onto what is undetermined
        share = projector.diagonal(dim1=-2, dim2=-1)
        undetermined = share > rounding**0.5
        both = undetermined.unsqueeze(-1) | undetermined.unsqueeze(-2)
    # Filling the undetermined directions leaves the bound of the coordinates outside them as it is.
    bound = torch.linalg.inv(scaled + projector) / (scale.unsqueeze(-1) * scale.unsqueeze(-2))
    bound = torch.where(both, torch.nan, bound)
    infinite = torch.diag_embed(torch.where(undetermined, torch.inf, 0.0).to(bound))
    return torch.where(torch.diag_embed(undetermined), infinite, bound)
