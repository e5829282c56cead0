"""Rows for training sensor models, compiled: the draws of the training set, with readings by the multipole field."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from edition1.errors import bad_input
from edition1.kernels._motion import chain, move, scratch
from edition1.kernels._multipole import multipole
from edition1.kernels._relations import pairs, relate
from edition1.kernels.compilation import machine_code
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.magnetic import EARTH_MT
from edition1.sensing.magnets import Ring, ring
from edition1_companion.twins.training_set import ELONGATION_M, draw
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class TrainingRows:
    """Random configurations of random robots, as a sensor model sees them.

    Parameters
    ----------
    q
        Configurations [m].
    cosines
        Relations as cosines, as :meth:`edition1.sensing.relations.Relations.cosines` gives them.
    u
        Readings [mT].
    """

    q: Float[Tensor, "n n_q"]
    cosines: Float[Tensor, "n s xi"]
    u: Float[Tensor, "n s"]


def training_rows(
    n_segments: int,
    *,
    seed: int,
    samples: int = 120_000,
    magnet: Ring | None = None,
    l_max: int = 9,
    earth: bool = False,
    elongation_m: float = ELONGATION_M["released"],
    sensors_per_segment: int = 3,
) -> TrainingRows:
    """Rows of the training set of section 3.2, by one compiled kernel.

    The same draws, to the bit, as :func:`edition1_companion.twins.training_set.training_set` makes for the same seed,
    without the robots. The readings are those of the multipole series in place of magpylib: for the ring
    ``"released"`` and ``l_max = 9`` they differ by less than 1e-6 mT. Parameters that are not listed are those of
    that function.

    Parameters
    ----------
    magnet
        Ring in every segment; the ring ``"released"`` when not given.
    l_max
        Highest order of the series.

    Raises
    ------
    InputError
        If ``samples`` is not positive.
    """
    if samples < 1:
        raise bad_input("samples", "training_rows", "positive", samples)
    drawn = draw(seed, samples, n_segments, sensors_per_segment, earth=earth, elongation_m=elongation_m)
    axis = torch.tensor([[1.0, 0.0, 0.0]]).double() if drawn.earth_axis is None else drawn.earth_axis
    robot = pcc_robot(n_segments, sensors_per_segment)
    links, _ = chain(robot, robot.magnets.joined(robot.sensors))
    placements = torch.stack([drawn.azimuth, drawn.tilt, drawn.radial], dim=-1).numpy()
    moments = (magnet or ring("released")).multipoles(l_max)
    field = (moments, EARTH_MT if earth else 0.0, axis.numpy())
    cosines, u = _rows(links, sensors_per_segment, drawn.q.numpy(), placements, field)
    return TrainingRows(drawn.q, torch.from_numpy(cosines), torch.from_numpy(u))


@machine_code()
def _rows(chain, per_segment, q, placements, field):
    """Relations and readings of every sample; the mounts of the sensors in ``chain`` are overwritten."""
    moments, earth_mt, earth_axis = field
    n_m = len(chain.family)
    n_s = n_m * per_segment
    cosines, u = np.empty((len(q), n_s, 1 + 4 * n_m)), np.empty((len(q), n_s))
    motion, pair = scratch(chain), pairs(n_m)
    for i in range(len(q)):
        azimuth, tilt, radial = placements[i, 0], placements[i, 1], placements[i, 2]
        for k in range(per_segment):
            phi = azimuth + 2.0 * math.pi / per_segment * k
            x, y = math.cos(phi), math.sin(phi)
            for s in range(k, n_s, per_segment):
                axis, position = chain.axis[0, n_m + s], chain.position[0, n_m + s]
                axis[0], axis[1], axis[2] = -x * math.sin(tilt), -y * math.sin(tilt), -math.cos(tilt)
                position[0], position[1] = radial * x, radial * y
        move(chain, 0, q[i], False, motion)
        earth = earth_axis[i if len(earth_axis) > 1 else 0]
        for s in range(n_s):
            relate(motion.axis, motion.position, n_m + s, earth, False, pair)
            reading = earth_mt * pair.xi[0]
            for k in range(n_m):
                at = 1 + 4 * k
                part = multipole(moments, pair.xi[at], pair.xi[at + 1], pair.xi[at + 2], pair.xi[at + 3])
                reading += part[0]
            u[i, s] = reading
            for r in range(1 + 4 * n_m):
                cosines[i, s, r] = pair.xi[r]
    return cosines, u
