"""Where a configuration may be: regions that particles never leave and can be drawn from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edition1.errors import bad_input, require


@runtime_checkable
class Region(Protocol):
    """Set of configurations."""

    def contains(self, q: Tensor) -> Tensor:
        """Whether each configuration ``[*batch, n_q]`` is inside."""
        ...

    def sample(self, n: int, generator: np.random.Generator) -> Tensor:
        """Return ``n`` configurations, uniform over the region."""
        ...


@dataclass(frozen=True)
class Disc:
    """Bend vectors up to a bend angle: the parameter space of Mitchell et al. 2021, Fig. 3.

    Parameters
    ----------
    radius
        Largest bend angle [rad].

    Raises
    ------
    InputError
        If the radius is not positive.
    """

    radius: float

    def __post_init__(self) -> None:
        require(self.radius > 0, "radius", "Disc", "positive [rad]", self.radius)

    def contains(self, q: Float[Tensor, "*batch 2"]) -> Bool[Tensor, "*batch"]:
        """Whether the bend angle is at most the radius."""
        return (q * q).sum(-1) <= self.radius**2

    def sample(self, n: int, generator: np.random.Generator) -> Float[Tensor, "n 2"]:
        """Return bend vectors that are uniform over the disc."""
        angle, direction = self.radius * np.sqrt(generator.random(n)), 2 * math.pi * generator.random(n)
        return torch.from_numpy(np.stack([angle * np.cos(direction), angle * np.sin(direction)], axis=-1))


@dataclass(frozen=True)
class Box:
    """Configurations between bounds, as for least squares.

    Parameters
    ----------
    lower, upper
        Bounds of every coordinate.

    Raises
    ------
    InputError
        If the bounds are not ordered.
    """

    lower: Float[Tensor, " n_q"]
    upper: Float[Tensor, " n_q"]

    def __post_init__(self) -> None:
        if self.lower.shape != self.upper.shape or bool((self.lower >= self.upper).any()):
            bounds = (self.lower.tolist(), self.upper.tolist())
            raise bad_input("lower, upper", "Box", "ordered bounds", bounds)

    def contains(self, q: Float[Tensor, "*batch n_q"]) -> Bool[Tensor, "*batch"]:
        """Whether every coordinate is within its bounds."""
        return ((q >= self.lower.to(q)) & (q <= self.upper.to(q))).all(-1)

    def sample(self, n: int, generator: np.random.Generator) -> Float[Tensor, "n n_q"]:
        """Return configurations that are uniform over the box."""
        share = torch.from_numpy(generator.random((n, len(self.lower))))
        return self.lower + share.to(self.lower) * (self.upper - self.lower)
