"""The trained networks of Baaij et al. 2023, sections 3 and 4: what each was trained on, how, and its file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from edition1.kinematics.paper_robots import affine_robot
from edition1.sensing.fast_training import train_dipole_residual, train_fast
from edition1.sensing.relations import relations
from edition1.sensing.training import SPLIT
from edition1_companion.book.provenance import processor
from edition1_companion.twins.training_set import TrainingSet, affine_training_set, training_set

DATA_SEED = 1
SEEDS = (0, 1, 2)
PCC_LEARNING_RATE = 0.18
AFFINE_LEARNING_RATE = 0.15
TRAINERS = {"fast": train_fast, "dipole": train_dipole_residual}


@dataclass(frozen=True)
class NetworkSpec:
    """One network of the paper's recipe: shared by the sensors of one segment (section 3.2).

    Parameters
    ----------
    n_segments
        Segments of the robot.
    segment
        Segment whose sensors it predicts, from 0.
    earth
        Trained with an Earth field of random direction (last section of Table 1).
    seed
        Split of the data, initial weights and dropout.
    """

    n_segments: int
    segment: int
    earth: bool
    seed: int

    learning_rate: ClassVar[float] = PCC_LEARNING_RATE
    exponential_head: ClassVar[bool] = False

    @property
    def name(self) -> str:
        """File name without ending."""
        kind = "earth" if self.earth else "pcc"
        return f"{kind}_nb{self.n_segments}_segment{self.segment + 1}_seed{self.seed}"

    def rows(self) -> tuple[Tensor, Tensor]:
        """Relations and readings that it is trained on."""
        return training_rows(self.n_segments, self.segment, self.earth)


@dataclass(frozen=True)
class AffineSpec:
    r"""One network of the paper's recipe for one sensor of the affine robot (section 4.2).

    Parameters
    ----------
    sensor
        Sensor whose reading it predicts, from 0.
    seed
        Split of the data, initial weights and dropout.
    exponential_head
        With the last layer :math:`y = \operatorname{sign}(x) e^{|x|}` of the text; the published networks do
        without it.
    """

    sensor: int
    seed: int
    exponential_head: bool = False

    learning_rate: ClassVar[float] = AFFINE_LEARNING_RATE

    @property
    def name(self) -> str:
        """File name without ending."""
        kind = "affine_head" if self.exponential_head else "affine"
        return f"{kind}_sensor{self.sensor + 1}_seed{self.seed}"

    def rows(self) -> tuple[Tensor, Tensor]:
        """Relations and readings that it is trained on: 120,000 rows.

        The magnets are shifted in the readings and not in the relations, as in the released data.
        """
        data = affine_training_set(seed=DATA_SEED)
        printed = replace(data.robot, magnets=affine_robot(magnet_shift_m=0.0).magnets)
        xi = relations(printed, data.q).angles()
        return sensor_rows(data, xi, [self.sensor])


def specs() -> Iterator[NetworkSpec | AffineSpec]:
    """Yield the networks of the paper's tables.

    27 of Table 1: robots of 1, 2 and 3 segments, and 3 segments with an Earth field. 27 of section 4.4: one for each
    of nine sensors and three seeds.
    """
    robots = ((1, False), (2, False), (3, False), (3, True))
    yield from (NetworkSpec(n, k, earth, seed) for n, earth in robots for seed in SEEDS for k in range(n))
    yield from (AffineSpec(sensor, seed) for seed in SEEDS for sensor in range(9))


def training_rows(
    n_segments: int, segment: int, earth: bool, *, samples: int = 120_000
) -> tuple[Tensor, Tensor]:
    """Relations as angles and readings of the sensors of one segment, float32: 360,000 rows."""
    data = training_set(n_segments, seed=DATA_SEED, samples=samples, earth=earth)
    return segment_rows(data, relations(data.robot, data.q, data.earth_axis).angles(), segment)


def segment_rows(data: TrainingSet, xi: Tensor, segment: int) -> tuple[Tensor, Tensor]:
    """Relations and readings of the sensors of one segment, one row per sample and sensor, float32.

    ``xi`` holds the relations of all sensors of ``data``, as angles or as cosines.
    """
    return sensor_rows(data, xi, [j for j, i in enumerate(data.robot.sensors.segment) if i == segment])


def sensor_rows(
    data: TrainingSet, xi: Float[Tensor, "n s xi"], sensors: list[int]
) -> tuple[Float[Tensor, "rows xi"], Float[Tensor, " rows"]]:
    """Relations and readings of these sensors, one row per sample and sensor, float32."""
    return xi[:, sensors].flatten(0, 1).float().contiguous(), data.u[
        :, sensors
    ].flatten().float().contiguous()


def train_own(
    data: TrainingSet, *, seed: int, recipe: str = "fast"
) -> tuple[list[nn.Module], list[dict[str, float]]]:
    """Train our networks, one per segment as in the paper, in seconds; nothing is kept on disk.

    Parameters
    ----------
    data
        Of any robot: more segments, other magnets.
    seed
        Initial weights, batches and split of the data.
    recipe
        ``"fast"``: a network on cosines; ``"dipole"``: dipole and residual network.

    Returns
    -------
    list, list
        Networks in double precision, their weights constant, and their errors [mT], base to tip.
    """
    cosines = relations(data.robot, data.q, data.earth_axis).cosines()
    networks, metrics = [], []
    for segment in range(len(data.robot.segments)):
        network, errors = TRAINERS[recipe](*segment_rows(data, cosines, segment), seed=seed, progress=False)
        networks.append(network.double().requires_grad_(False))
        metrics.append(errors)
    return networks, metrics


def rows_sha256(xi: Tensor, u: Tensor) -> str:
    """Hash of the rows that a network is trained on, for its manifest."""
    return hashlib.sha256(xi.numpy().tobytes() + u.numpy().tobytes()).hexdigest()


def training_record(
    unit: str,
    metrics: Mapping[str, float],
    curve: Float[Tensor, "epochs 2"] | None = None,
) -> dict[str, Any]:
    """What the manifest of a network of this recipe says of its training.

    Parameters
    ----------
    unit
        Unit of the readings; the metrics are under ``metrics_mt`` or ``metrics_mv``.
    metrics, curve
        As :func:`train_paper` returns them; the curve is left out when not given.
    """
    losses = {}
    if curve is not None:
        columns = {name: curve[:, k].tolist() for k, name in enumerate(("train", "validation"))}
        # Five digits: for a plot, and to see where another training parts from this one.
        losses = {name: [float(f"{x:.5g}") for x in column] for name, column in columns.items()}
        losses = {"loss_by_epoch": {"unit": f"{unit}^2", **losses}}
    return {
        f"metrics_{unit.lower()}": dict(metrics),
        **losses,
        "split": SPLIT,
        "threads": torch.get_num_threads(),
        "processor": processor(),
    }
