"""What a layout of sensors is for: the shapes of a robot, those to optimise for and those to judge by."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from repro.errors import bad_input
from repro.kinematics.paper_robots import MAGNET_SHIFT_M, affine_robot, pcc_robot
from repro.kinematics.robot import Robot
from repro.kinematics.trajectories import flower, lemniscate
from repro.sensing.training_set import BENDING_M, CURVATURE_RAD, ELONGATION_M
from repro_companion.pages.sensor_placement.layouts import Layout, layout_of

TEST_SEED = 2_000_000
"""Added to the seed for the shapes and the noise that judge a layout."""


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
    _check_counts("pcc_task", shapes, steps)
    n_q = 3 * n_segments
    high = torch.tensor([BENDING_M, BENDING_M, ELONGATION_M["released"]] * n_segments, dtype=torch.float64)
    low = torch.tensor([-BENDING_M, -BENDING_M, 0.0] * n_segments, dtype=torch.float64)
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
        starts=torch.tensor([[0.0, 0.0, 2.75e-3] * n_segments], dtype=torch.float64),
        known=tuple(range(2, n_q, 3)) if known_elongation else (),
    )


def affine_task(*, seed: int = 0, shapes: int = 64, steps: int = 400) -> Task:
    r"""Robot of section 4.1: shapes as in section 4.2, judged on the flower and on fresh random shapes.

    Each shape is drawn under the one of its two configurations that has :math:`\kappa_1 \ge 0`. The estimator starts
    from six bent shapes around the backbone.

    Parameters
    ----------
    seed, shapes, steps
        As for :func:`pcc_task`.
    """
    _check_counts("affine_task", shapes, steps)
    (k0, k1), top = CURVATURE_RAD, ELONGATION_M["released"]
    low = torch.tensor([-k0, 0.0, 0.0, 0.0], dtype=torch.float64)
    high = torch.tensor([k0, k1, 2 * math.pi, top], dtype=torch.float64)
    around = torch.arange(6, dtype=torch.float64) * (math.pi / 3)
    bent = torch.tensor([0.0, k1 / 2, 0.0, 2.75e-3], dtype=torch.float64).repeat(6, 1)
    bent[:, 2] = around
    free = torch.tensor([0.0, k1, 2 * math.pi, 0.0], dtype=torch.float64)
    robot = affine_robot(magnet_shift_m=0.0)
    # A layout has its magnets on the backbone: where the shifted ones are when the robot is straight.
    magnets = replace(robot.magnets, axial=robot.magnets.axial + MAGNET_SHIFT_M["released"])
    return Task(
        name="affine, n_s=9",
        nominal=layout_of(replace(robot, magnets=magnets)),
        low=low - free,
        high=high + free,
        width=high - low,
        shapes=_uniform(low, high, shapes, seed),
        tests={"flower": flower(steps=steps), "random shapes": _uniform(low, high, steps, seed + TEST_SEED)},
        starts=bent,
    )


def _uniform(low: Tensor, high: Tensor, n: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return low + (high - low) * torch.rand(n, len(low), generator=generator, dtype=torch.float64)


def _check_counts(owner: str, shapes: int, steps: int) -> None:
    if shapes < 1 or steps < 2:
        raise bad_input("shapes, steps", owner, "at least 1 and 2", (shapes, steps))
