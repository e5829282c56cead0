"""Section 4 of Baaij et al. 2023 with the paper's method: one affine segment on the flower trajectory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import require
from edition1.estimation.base import Trajectory, track
from edition1.estimation.gradient_descent import GradientDescent
from edition1.kernels import compiled
from edition1.kinematics.paper_robots import affine_robot
from edition1.sensing.ensemble import SeedEnsemble
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1.sensing.weights import load_paper_network
from edition1_companion.book.views_frames import every_nth
from edition1_companion.book.views_frames import readings as trace
from edition1_companion.book.views_simulated import FRAMES, times
from edition1_companion.twins.networks import AffineSpec
from edition1_companion.twins.robot_tables import stills as stills_of
from edition1_companion.twins.table_1_method import ITERATIONS, MOMENTUM
from edition1_companion.twins.trajectories import RATE_HZ, flower
from edition1_live.view.robot_view import shape_view
from edition1_live.view.shape_view import ShapeView

STEP_SIZE = (1.0, 5.0, 1.0, 2e-4)
"""Step sizes of the released code for kappa_0, kappa_1, phi and delta_L (ring ``"released"``)."""
ROW = "affine flower"
QUANTITIES = ("kappa_0", "kappa_1", "phi", "delta_L")
PRINTED_UNITS = ("rad/m", "rad/m^2", "rad", "mm")
"""Units of the absolute errors in section 4.4; the curvatures are angles [rad], the elongation is in mm."""
TO_PRINTED = (1.0, 1.0, 1.0, 1e3)


@dataclass(frozen=True)
class Flower:
    """The flower trajectory, and what the sensors of the nominal robot read on it."""

    q: Float[Tensor, "t 4"]
    u: Float[Tensor, "t 9"]

    @classmethod
    def simulated(cls, steps: int = 400) -> Flower:
        """Readings by magpylib, without noise."""
        q = flower(steps=steps)
        return cls(q, readings(affine_robot(), q, ring("released")))

    def thinned(self, every: int) -> Flower:
        """Every so many steps only."""
        return Flower(self.q[::every], self.u[::every])


@dataclass(frozen=True)
class PaperRun:
    """What the paper's method finds on a flower: estimates, and readings predicted at the truth, by seed."""

    flower: Flower
    seeds: tuple[int, ...]
    estimates: Trajectory
    predicted: Float[Tensor, "t seeds 9"]


def networks(folder: Path, seeds: Sequence[int]) -> SeedEnsemble:
    """Committed networks of the paper's recipe, one for each sensor and seed.

    Raises
    ------
    InputError
        If one of them is not there.
    """
    by_seed = [
        [load_paper_network(folder / f"{AffineSpec(j, seed).name}.safetensors") for j in range(9)]
        for seed in seeds
    ]
    return SeedEnsemble(by_seed, range(9))


def paper_method(
    data: Flower,
    model: SeedEnsemble,
    seeds: Sequence[int],
    *,
    iterations: int = ITERATIONS,
    step_size: Sequence[float] = STEP_SIZE,
    noise_mt: float = 0.0,
    noise_seed: int = 0,
) -> PaperRun:
    """Gradient descent as in section 4.2, for all seeds at once.

    As in the published run it starts at the ground truth and carries its momentum from step to step.

    Raises
    ------
    InputError
        If there are not four step sizes.
    """
    require(len(step_size) == len(STEP_SIZE), "step_size", "paper_method", "four numbers", step_size)
    # The networks were trained on relations to magnets that are not shifted.
    sensing = MagneticSensing(affine_robot(magnet_shift_m=0.0), model, "angles")
    u = data.u.unsqueeze(1).expand(-1, len(seeds), -1)
    generator = torch.Generator().manual_seed(noise_seed)
    u = u + noise_mt * torch.randn(u.shape, generator=generator, dtype=u.dtype)
    gamma = torch.tensor(step_size, dtype=torch.float64)
    descent = GradientDescent(compiled(sensing), gamma, MOMENTUM, iterations)
    estimates = track(descent, u, data.q[0].expand(len(seeds), -1))
    with torch.no_grad():
        predicted = sensing(data.q.expand(len(seeds), -1, -1)).movedim(0, 1)
    return PaperRun(data, tuple(seeds), estimates, predicted)


def configuration_error(
    found: Float[Tensor, "*batch 4"], truth: Float[Tensor, "*truth 4"]
) -> Float[Tensor, "*error 4"]:
    """Error of affine configurations: between those with ``kappa_1 >= 0``, the azimuth as an angle below pi."""
    found, truth = canonical(found), canonical(truth)
    phi = azimuth_difference(found[..., 2:3], truth[..., 2:3])
    return torch.cat([found[..., :2] - truth[..., :2], phi, found[..., 3:] - truth[..., 3:]], -1)


def relative_error(
    found: Float[Tensor, "t *batch 4"], truth: Float[Tensor, "t 4"]
) -> Float[Tensor, "*batch 4"]:
    """Relative RMSE over time, eq. (13): in per cent of the range of the truth (of the azimuth: a full turn)."""
    width = truth.amax(0) - truth.amin(0)
    truth = truth.reshape(len(truth), *(1,) * (found.ndim - 2), -1)
    return 100 * configuration_error(found, truth).square().mean(0).sqrt() / width


def configuration_errors(run: PaperRun) -> pd.DataFrame:
    """Errors of section 4.4, one row per seed, quantity and unit: ``row, seed, quantity, unit, error``.

    ``e_u`` [mT] is the root-mean-squared error of the prediction at the ground truth, averaged over the sensors.
    The others come relative (eq. 13) and absolute, in the units in which they are printed.
    """
    truth = run.flower.q
    e_u = (run.predicted - run.flower.u.unsqueeze(1)).square().mean(0).sqrt().mean(-1)
    relative = relative_error(run.estimates.q, truth)
    absolute = configuration_error(run.estimates.q, truth.unsqueeze(1)).square().mean(0).sqrt()
    absolute = absolute * absolute.new_tensor(TO_PRINTED)
    table = []
    for i, seed in enumerate(run.seeds):
        key = {"row": ROW, "seed": seed}
        table.append(key | {"quantity": "e_u", "unit": "mT", "error": float(e_u[i])})
        for values, units in ((relative, ("%",) * 4), (absolute, PRINTED_UNITS)):
            for name, unit, value in zip(QUANTITIES, units, values[i].tolist(), strict=True):
                table.append(key | {"quantity": name, "unit": unit, "error": value})
    return pd.DataFrame(table)


def series(run: PaperRun) -> pd.DataFrame:
    """Fig. 6 as a table: ``time_s``, ``kind`` (reading or configuration), ``name``, ``truth``, ``mean``, ``std``.

    Readings [mT] are those predicted at the true configuration; configurations [rad, rad, rad, mm] the estimates.
    Mean and sample standard deviation are taken over the seeds, those of the azimuth along the continuous truth.
    """
    q, u = run.flower.q, run.flower.u
    near = q.unsqueeze(1) + configuration_error(run.estimates.q, q.unsqueeze(1))
    scale = q.new_tensor(TO_PRINTED)
    names = [f"u_{j + 1}" for j in range(u.shape[1])]
    tables = []
    for kind, labels, truth, found in (
        ("reading", names, u, run.predicted),
        ("configuration", QUANTITIES, q * scale, near * scale),
    ):
        mean = found.mean(1)
        std = found.std(1) if found.shape[1] > 1 else torch.full_like(mean, torch.nan)
        for k, name in enumerate(labels):
            columns = {"truth": truth[:, k], "mean": mean[:, k], "std": std[:, k]}
            table = pd.DataFrame(
                {"time_s": torch.arange(len(q)).numpy() / RATE_HZ, "kind": kind, "name": name}
            )
            tables.append(table.assign(**{key: value.numpy() for key, value in columns.items()}))
    return pd.concat(tables, ignore_index=True)


def stills(
    run: PaperRun, times_s: Sequence[float] = (0.0, 1.6, 3.3, 5.0, 6.7, 8.3)
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Fig. 7 as tables: the backbone at these times, true and estimated, and the parts in the true shape."""
    steps = sorted({min(round(t * RATE_HZ), len(run.flower.q) - 1) for t in times_s})
    at = [step / RATE_HZ for step in steps]
    return stills_of(affine_robot(), at, run.flower.q[steps], run.estimates.q[steps], run.seeds)


def flower_view(run: PaperRun) -> ShapeView:
    """Affine segment on the flower of section 4.3, and what the paper's method finds with its first seed."""
    q, shown = run.flower.q, every_nth(len(run.flower.q), FRAMES)
    # The same shape has two configurations, and any number of turns: the one next to the truth is shown.
    near = q + configuration_error(run.estimates.q[:, 0], q)
    u, u_hat = run.flower.u[shown].numpy(), run.estimates.u_hat[shown, 0].numpy()
    label = (
        "Simulated segment of affine curvature on the flower, and what the paper's gradient descent on its networks "
        f"(seed {run.seeds[0]}) finds, which starts at the ground truth."
    )
    return shape_view(
        affine_robot(),
        q[shown],
        times=times(len(q))[shown],
        label=label,
        estimate=near[shown],
        traces=[trace(u, "mT", u_hat)],
    )


def canonical(q: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    r"""Of the two configurations of a shape, the one with :math:`\kappa_1 \ge 0`, and :math:`\phi` in (-pi, pi].

    Errors are taken between canonical configurations; the azimuth, an angle, by :func:`azimuth_difference`.
    """
    k0, k1, phi, dL = q.unbind(-1)
    flip = k1 < 0
    sign = torch.where(flip, -1.0, 1.0).to(q)
    return torch.stack([sign * k0, sign * k1, _wrapped(phi + flip.to(q) * math.pi), dL], dim=-1)


def azimuth_difference(a: Float[Tensor, "*a"], b: Float[Tensor, "*b"]) -> Float[Tensor, "*batch"]:
    """Difference ``a - b`` of two angles [rad], between -pi and pi."""
    return _wrapped(a - b)


def _wrapped(angle: Tensor) -> Tensor:
    return math.pi - torch.remainder(math.pi - angle, 2 * math.pi)
