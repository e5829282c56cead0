"""Sensor models of the simulated robots by name: those that pages compare, with one member for each seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from repro.sensing.ensemble import SeedEnsemble
from repro.sensing.magnets import ring
from repro.sensing.multipole import MultipoleField
from repro.sensing.network import DipoleResidual
from repro_companion.twins.networks import DATA_SEED, train_own
from repro_companion.twins.table_1_method import available, networks
from repro_companion.twins.table_1_rows import Row
from repro_companion.twins.training_set import training_set

MODELS = ("network of the paper", "fast network", "multipole")
DIPOLE = "dipole and residual"
RECIPES = {MODELS[1]: "fast", DIPOLE: "dipole"}
"""Networks of ours, and how :func:`~repro_companion.twins.networks.train_own` trains them."""
SOLVERS = ("gradient descent", "Levenberg-Marquardt")


def sensor_models(
    wanted: Sequence[str],
    n_segments: int,
    seeds: Sequence[int],
    folder: Path,
    ring_name: str,
    *,
    samples: int = 120_000,
) -> dict[str, tuple[Callable[[Tensor], Tensor], str]]:
    """Sensor models by name, each with the form of its inputs, for all seeds in one batch.

    The paper's network only where its files are in ``folder``, for the ring ``"released"``; ours are trained here and
    now, on ``samples`` configurations.
    """
    row = Row(f"n_b={n_segments}", n_segments=n_segments)
    found: dict[str, tuple[Callable[[Tensor], Tensor], str]] = {}
    if MODELS[0] in wanted and available([row], folder, seeds) and ring_name == "released":
        found[MODELS[0]] = (networks([row], folder, seeds), "angles")
    recipes = {name: recipe for name, recipe in RECIPES.items() if name in wanted}
    if recipes:
        data = training_set(n_segments, seed=DATA_SEED, samples=samples, magnet=ring(ring_name))
        segments = list(data.robot.sensors.segment)
        for name, recipe in recipes.items():
            trained = [train_own(data, seed=seed, recipe=recipe)[0] for seed in seeds]
            ensemble = _dipoles if name == DIPOLE else SeedEnsemble
            found[name] = ensemble(trained, segments), "cosines"
    if MODELS[2] in wanted:
        found[MODELS[2]] = (MultipoleField.of(ring(ring_name)), "cosines")
    return found


@dataclass(frozen=True)
class _Dipoles:
    """Dipole and residual network of every seed, in one batch like :class:`SeedEnsemble`."""

    coefficients: Float[Tensor, "seeds s terms"]
    residual: SeedEnsemble

    def __call__(self, xi: Tensor) -> Tensor:
        own = self.coefficients[(slice(None), *[None] * (xi.ndim - 3))]
        return (DipoleResidual.terms(xi) * own).sum(-1) + self.residual(xi)


def _dipoles(trained: Sequence[Sequence[nn.Module]], segments: list[int]) -> _Dipoles:
    coefficients = torch.stack(
        [torch.stack([m.get_buffer("coefficients") for m in seed]) for seed in trained]
    )
    residual = SeedEnsemble([[m.get_submodule("residual") for m in seed] for seed in trained], segments)
    return _Dipoles(coefficients[:, segments], residual.double())
