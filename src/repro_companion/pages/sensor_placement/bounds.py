r"""Errors to be expected of a layout, before anything is estimated: from noise, and from parts that are not as drawn.

For readings with Jacobian :math:`J`, white noise :math:`\sigma` and parts that are off by :math:`e` with covariance
:math:`\Sigma`, which changes readings by :math:`G e`, least squares has the covariance

.. math:: \sigma^2 (J^T J)^{-1} \quad\text{(noise: the Cramér-Rao bound)}, \qquad
          J^+ G \Sigma G^T J^{+T} \quad\text{(parts not as drawn, without calibration)}.

Both are given as standard deviations relative to the range of each coordinate, as the relative error of eq. (13) of
Baaij et al. 2023. Tolerances may exceed what an estimate within bounds can be off by; with :math:`s` the standard
deviation relative to the range, the error is taken as :math:`s/\sqrt{1 + 3 s^2}`, which tends to :math:`1/\sqrt 3`:
an estimate at either bound, whatever the truth.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from repro.estimation.information import cramer_rao, fisher_information
from repro.sensing.linearised import LinearisedSensing
from repro.sensing.magnets import ring
from repro.sensing.placement import PlacedReadings, Tolerances
from repro_companion.pages.sensor_placement.layouts import Layout
from repro_companion.pages.sensor_placement.tasks import Task

NOISE_MT = 7.1e-4
"""Noise of a reading [mT]: 3.55 mV (section 5.2) at 5000 mV/mT."""
L_MAX = 15
"""Highest order of the multipole series: within 2e-5 mT of magpylib down to 26 mm from the centre of the ring."""


def expected_errors(
    task: Task,
    layout: Layout,
    shapes: Float[Tensor, "n n_q"] | None = None,
    *,
    noise_mt: float = NOISE_MT,
    tolerances: Tolerances | None = None,
) -> tuple[Float[Tensor, "n u"], Float[Tensor, "n u"] | None]:
    """Standard deviation of every unknown coordinate in every shape, in per cent of its range.

    Parameters
    ----------
    task, layout
        Robot and placement; gradients pass to the values of the layout.
    shapes
        Configurations; those of the task when not given.
    noise_mt
        Noise of a reading [mT].
    tolerances
        Of the parts. Multipole moments are taken as known: the gains stand for the strength of the magnets.

    Returns
    -------
    tuple
        From noise (the Cramér-Rao bound; infinite for a coordinate that the readings leave open), and from the
        tolerances without calibration (``None`` without tolerances; not a number where a coordinate is open).
    """
    q = task.shapes if shapes is None else shapes
    robot, moments, by_part = layout.robot(), ring_moments(), None
    if tolerances is None:
        J = LinearisedSensing(robot, moments).linearise(q)[1]
    else:
        spread = tolerances.of_parameters(robot, len(moments))
        spread[-len(moments) :] = 0.0
        _, by_part, J = PlacedReadings(robot, q, moments).linearise(torch.zeros_like(spread))
        by_part = by_part * spread
    J, width = J[..., task.unknown], task.width[task.unknown]
    bound = cramer_rao(fisher_information(J, noise_mt))
    noise = 100 * bound.diagonal(dim1=-2, dim2=-1).sqrt() / width
    if by_part is None:
        return noise, None
    off = torch.linalg.vector_norm(bound @ J.mT @ by_part, dim=-1) / noise_mt**2 / width
    return noise, 100 * off / (1 + 3 * off.square()).sqrt()


def guaranteed_error(
    task: Task, layout: Layout, shapes: Float[Tensor, "n n_q"] | None = None, *, noise_mt: float = NOISE_MT
) -> float:
    """Largest standard deviation along any direction in any of the shapes, coordinates scaled by their ranges [%].

    The inverse root of the smallest eigenvalue of the scaled information: what a layout guarantees.
    """
    q = task.shapes if shapes is None else shapes
    J = LinearisedSensing(layout.robot(), ring_moments()).linearise(q)[1].detach()
    J = J[..., task.unknown] * task.width[task.unknown]
    weakest = torch.linalg.svdvals(J)[..., -1].min() if J.shape[-2] >= J.shape[-1] else torch.zeros(())
    return float(100 * noise_mt / weakest)


def mean_errors(task: Task, layout: Layout, noise_mt: float = NOISE_MT) -> tuple[float, float]:
    """Mean over shapes and coordinates of both expected errors [%], with the tolerances of :class:`Tolerances`."""
    noise, tolerance = expected_errors(task, layout, noise_mt=noise_mt, tolerances=Tolerances())
    assert tolerance is not None
    return noise.detach().mean().item(), tolerance.detach().mean().item()


def ring_moments() -> Float[Tensor, " terms"]:
    """Moments of the ring ``"released"`` [mT m^(l+2)], up to :data:`L_MAX`."""
    return torch.from_numpy(ring("released").multipoles(L_MAX))
