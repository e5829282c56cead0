r"""The field of axisymmetric magnets as a sensor model: exact, differentiable, linear in its moments.

With the relations of eq. (1) as cosines, the reading of a sensor is

.. math:: u = B_e \cos\lambda + \sum_k f_k \cos\alpha_k + g_k \cos\beta_k, \qquad
          f = -\sum_l \frac{A_l P'_l(\cos\theta)}{d^{l+2}}, \quad
          g = \sum_l \frac{A_l P'_{l+1}(\cos\theta)}{d^{l+2}}

over odd ``l``: the structure that a network of Baaij et al. 2023 has to learn.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input
from edition1.sensing._multipoles import multipole_factors
from edition1.sensing.magnets import Ring


@dataclass(frozen=True)
class MultipoleField:
    """Sensor model ``u = model(cosines)``, one reading per row of relations.

    Parameters
    ----------
    moments
        Multipole moments :math:`A_1, A_3, ...` [mT m^(l+2)] of each magnet (or one row for all alike).
    earth_mt
        Flux density of the Earth field [mT]; 0.065 in section 3.5.

    Raises
    ------
    InputError
        If there are no moments, or they are not finite.
    """

    moments: Float[Tensor, "*m terms"]
    earth_mt: float = 0.0

    def __post_init__(self) -> None:
        if not self.moments.numel() or not bool(torch.isfinite(self.moments).all()):
            raise bad_input("moments", "MultipoleField", "finite, at least one", self.moments.tolist())

    @classmethod
    def of(cls, magnet: Ring, l_max: int = 9, earth_mt: float = 0.0) -> MultipoleField:
        """Model of a ring up to order ``l_max``.

        Against magpylib, at distances of at least 43 mm (51 mm): released ring 1.7e-4 (3e-5) mT for
        ``l_max = 7``, 2.6e-6 (3e-7) mT for 9; published ring 1.2e-5 (2.8e-6) mT for 5, 3.5e-7 mT for 7.
        """
        return cls(torch.as_tensor(magnet.multipoles(l_max)), earth_mt)

    def __call__(self, cosines: Float[Tensor, "*batch xi"]) -> Float[Tensor, "*batch"]:
        """Reading [mT] for relations ``(cos lambda, then d, cos alpha, cos beta, cos theta per magnet)``.

        Raises
        ------
        InputError
            If the width of the relations is not one plus four for every magnet.
        """
        n_m = self.moments.shape[0] if self.moments.ndim == 2 else None
        width = cosines.shape[-1]
        if width % 4 != 1 or (n_m is not None and width != 1 + 4 * n_m):
            expected = f"of last dimension {'1 + 4 m' if n_m is None else 1 + 4 * n_m}"
            raise bad_input("cosines", "MultipoleField", expected, f"shape {tuple(cosines.shape)}")
        d, cos_alpha, cos_beta, cos_theta = cosines[..., 1:].unflatten(-1, (-1, 4)).unbind(-1)
        f, g = multipole_factors(self.moments, d, cos_theta)
        return self.earth_mt * cosines[..., 0] + (f * cos_alpha + g * cos_beta).sum(-1)
