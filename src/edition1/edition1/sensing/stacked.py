r"""Several kinds of sensors as one sensor model: readings one after the other, each in units of its own noise.

Estimators take one noise for all readings. In units of the noise it is 1 for every kind, and the information of
independent readings adds: :math:`J^T J = \sum_k J_k^T \mathrm{diag}(1/\sigma_k^2)\, J_k`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input
from edition1.sensing._slopes import with_jacobian


@dataclass(frozen=True)
class StackedSensing:
    """Sensor model ``u = sensing(q)`` of several parts; an estimator takes :meth:`scaled` readings and a noise of 1.

    Parameters
    ----------
    parts
        Sensor models of the same configuration, batched and differentiable. If all of them have a method
        ``linearise`` as :class:`~edition1.sensing.linearised.LinearisedSensing`, derivatives are taken from there.
    noise
        Standard deviation of the readings of each part, in their unit: one number, or one for each reading (last
        dimension).

    Raises
    ------
    InputError
        If there is no part, or not one positive noise for each.

    Examples
    --------
    Two readings of one coordinate, 2 q with noise 0.5 and q with noise 0.25:

    >>> sensing = StackedSensing((lambda q: 2 * q, lambda q: q), (0.5, 0.25))
    >>> sensing(torch.ones(1, dtype=torch.float64))
    tensor([4., 4.], dtype=torch.float64)
    """

    parts: tuple[Callable[[Tensor], Tensor], ...]
    noise: tuple[float | Tensor, ...]

    def __post_init__(self) -> None:
        if not self.parts or len(self.parts) != len(self.noise):
            counts = f"{len(self.parts)} parts and {len(self.noise)} noises"
            raise bad_input("parts, noise", "StackedSensing", "one noise for each of some parts", counts)
        for noise in self.noise:
            if not bool((torch.as_tensor(noise) > 0).all()):
                received = noise.tolist() if isinstance(noise, Tensor) else noise
                raise bad_input("noise", "StackedSensing", "positive", received)

    def __call__(self, q: Float[Tensor, "*batch n_q"]) -> Float[Tensor, "*batch s"]:
        """Return the predicted readings of all parts, in units of their noise."""
        if all(hasattr(part, "linearise") for part in self.parts):
            return with_jacobian(q, self)
        return self.scaled([part(q) for part in self.parts])

    def linearise(
        self, q: Float[Tensor, "*batch n_q"]
    ) -> tuple[Float[Tensor, "*batch s"], Float[Tensor, "*batch s n_q"]]:
        """Predicted readings and their derivatives by ``q``, in units of the noise, from those of the parts."""
        linearised: list[Any] = list(self.parts)
        u, J = zip(*(part.linearise(q) for part in linearised), strict=True)
        slopes = self.scaled([slope.mT for slope in J])
        return self.scaled(u), slopes.mT

    def scaled(self, readings: Sequence[Tensor]) -> Float[Tensor, "*batch s"]:
        """Readings of all parts, each in its own unit, as one vector in units of their noise.

        Raises
        ------
        InputError
            If there are not as many readings as parts, or a noise does not fit its readings.
        """
        if len(readings) != len(self.parts):
            expected = f"one for each of {len(self.parts)} parts"
            raise bad_input("readings", "StackedSensing", expected, len(readings))
        columns = []
        for k, (u, noise) in enumerate(zip(readings, self.noise, strict=True)):
            sigma = torch.as_tensor(noise, dtype=u.dtype, device=u.device)
            if sigma.ndim and sigma.shape[-1] != u.shape[-1]:
                expected = f"one number or one for each of {u.shape[-1]} readings of part {k}"
                raise bad_input("noise", "StackedSensing", expected, f"shape {tuple(sigma.shape)}")
            columns.append(u / sigma)
        return torch.cat(columns, dim=-1)
