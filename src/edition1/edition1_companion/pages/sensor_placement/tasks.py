r"""What a layout of sensors is for, the shapes of a robot, and the errors to be expected of it before any estimate.

Errors come from noise, and from parts that are not as drawn.

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

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import require
from edition1.estimation.information import cramer_rao, fisher_information
from edition1.kinematics.paper_robots import pcc_robot
from edition1.kinematics.robot import Robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnets import ring
from edition1.sensing.placement import PlacedReadings, Tolerances
from edition1_companion.pages.sensor_placement.layouts import Layout, layout_of
from edition1_companion.twins.calibrated_robots import box, start
from edition1_companion.twins.trajectories import lemniscate

TEST_SEED = 2_000_000
"""Added to the seed for the shapes and the noise that judge a layout."""
NOISE_MT = 7.1e-4
"""Noise of a reading [mT]: 3.55 mV (section 5.2) at 5000 mV/mT."""
L_MAX = 15
"""Highest order of the multipole series: within 2e-5 mT of magpylib down to 26 mm from the centre of the ring."""


@dataclass(frozen=True)
class Task:
    """What a layout is for: the shapes of one robot.

    Parameters
    ----------
    name
        Of the robot.
    nominal
        Layout of the paper.
    low, high
        Bounds of the configuration for the estimator.
    width
        Range of every coordinate over the training box.
    shapes
        Configurations for which a layout is optimised.
    tests
        Held-out configurations by their name.
    starts
        Where the estimator starts; of several it keeps the one that ends with the least residual.
    known
        Coordinates that are given to the estimator, by index.
    """

    name: str
    nominal: Layout
    low: Float[Tensor, " n_q"]
    high: Float[Tensor, " n_q"]
    width: Float[Tensor, " n_q"]
    shapes: Float[Tensor, "n n_q"]
    tests: dict[str, Tensor]
    starts: Float[Tensor, "k n_q"]
    known: tuple[int, ...] = ()

    @property
    def unknown(self) -> list[int]:
        """Coordinates to be estimated, by index."""
        return [k for k in range(len(self.width)) if k not in self.known]

    @property
    def coordinates(self) -> list[str]:
        """Names of the coordinates to be estimated."""
        names = Robot(self.nominal.segments).coordinates
        return [names[k] for k in self.unknown]


def pcc_task(
    n_segments: int,
    sensors_per_segment: int = 3,
    *,
    known_elongation: bool = False,
    seed: int = 0,
    shapes: int = 64,
    steps: int = 400,
) -> Task:
    """Robot of section 3.1: shapes from the training box, judged on the lemniscate T3 and on fresh random shapes.

    Parameters
    ----------
    n_segments, sensors_per_segment
        Size of the robot; the nominal layout is that of Table 1.
    known_elongation
        The elongation is an input, as in the experiments of section 5.
    seed
        Of the shapes.
    shapes
        Number of shapes for which the layout is optimised.
    steps
        Number of shapes in each test.
    """
    require(steps >= 2, "steps", "pcc_task", "at least 2", steps)
    n_q = 3 * n_segments
    low, high = box(n_segments)
    fresh = _uniform(low, high, steps, seed + TEST_SEED)
    name = f"n_b={n_segments}, n_s={n_segments * sensors_per_segment}"
    return Task(
        name=name + (", elongation known" if known_elongation else ""),
        nominal=layout_of(pcc_robot(n_segments, sensors_per_segment)),
        low=low,
        high=high,
        width=high - low,
        shapes=_uniform(low, high, shapes, seed),
        tests={"lemniscate T3": lemniscate(n_segments, steps=steps), "random shapes": fresh},
        starts=start(n_segments)[None],
        known=tuple(range(2, n_q, 3)) if known_elongation else (),
    )


def _uniform(low: Tensor, high: Tensor, n: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return low + (high - low) * torch.rand(n, len(low), generator=generator, dtype=torch.float64)


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
        spread = spread_of_parts(robot, tolerances)
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


def mean_errors(
    task: Task, layout: Layout, noise_mt: float = NOISE_MT, shapes: Float[Tensor, "n n_q"] | None = None
) -> tuple[float, float]:
    """Mean over shapes and coordinates of both expected errors [%], with the tolerances of :class:`Tolerances`."""
    noise, tolerance = expected_errors(task, layout, shapes, noise_mt=noise_mt, tolerances=Tolerances())
    assert tolerance is not None
    return noise.detach().mean().item(), tolerance.detach().mean().item()


def ring_moments() -> Float[Tensor, " terms"]:
    """Moments of the ring ``"released"`` [mT m^(l+2)], up to :data:`L_MAX`."""
    return torch.from_numpy(ring("released").multipoles(L_MAX))


def spread_of_parts(robot: Robot, tolerances: Tolerances) -> Float[Tensor, " parameters"]:
    """Standard deviation of every parameter; the multipole moments are as drawn."""
    spread = tolerances.of_parameters(robot, len(ring_moments()))
    spread[-len(ring_moments()) :] = 0.0
    return spread
