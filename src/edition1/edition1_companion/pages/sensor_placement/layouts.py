r"""Where the sensors and magnets of a robot sit, as numbers that can be optimised, and the room they have."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input
from edition1.kinematics.mounts import magnet_mounts, sensor_mounts
from edition1.kinematics.robot import Robot, Segment
from edition1_companion.twins.training_set import RADIAL_M

KINDS = ("axial", "radial", "azimuth", "tilt", "magnet")
"""What can be placed: distance of a sensor from the base of its segment, its distance from the backbone, its azimuth
and its tilt; distance of a magnet from the base of its segment."""

TOLERANCE_M = 1e-6
"""Clearances that are missing less than this count as kept: the solver meets constraints to rounding only."""


@dataclass(frozen=True)
class Layout:
    """Placement of every sensor and magnet, on segments that are given.

    Parameters
    ----------
    segments
        Of the robot, from base to tip.
    sensor_segment, magnet_segment
        Segment of each sensor and magnet, from 0.
    values
        One block for each of :data:`KINDS`: axial and radial distances [m], azimuths and tilts [rad] of the sensors,
        axial distances of the magnets [m]; as in :func:`~edition1.kinematics.mounts.sensor_mounts`.

    Examples
    --------
    >>> from edition1.kinematics.paper_robots import pcc_robot
    >>> layout = layout_of(pcc_robot(1, sensors_per_segment=2))
    >>> layout.values
    tensor([0.1100, 0.1100, 0.0130, 0.0130, 0.0000, 3.1416, 0.0000, 0.0000, 0.0550],
           dtype=torch.float64)
    """

    segments: tuple[Segment, ...]
    sensor_segment: tuple[int, ...]
    magnet_segment: tuple[int, ...]
    values: Float[Tensor, " k"]

    def parts(self) -> tuple[Tensor, ...]:
        """Blocks of the values, in the order of :data:`KINDS`."""
        return self.values.split(self._sizes())

    def of_kind(self, kinds: Sequence[str]) -> np.ndarray:
        """Tell for every value whether it is of one of these kinds."""
        return np.repeat([name in kinds for name in KINDS], self._sizes())

    def robot(self) -> Robot:
        """Robot with this layout; gradients pass from its mounts to the values."""
        axial, radial, azimuth, tilt, magnet = self.parts()
        # Mounts at equal distances share one frame of the backbone, and then only the first gets the derivative: a
        # femtometre between them lets each have its own.
        inwards = torch.where(axial.detach() < 0.5 * self._lengths(self.sensor_segment), 1e-15, -1e-15)
        axial = axial + inwards * torch.arange(1, len(axial) + 1)
        return Robot(
            self.segments,
            magnet_mounts(self.magnet_segment, magnet),
            sensor_mounts(self.sensor_segment, axial, radial, azimuth, tilt),
        )

    def moved(self, values: Float[Tensor, " k"]) -> Layout:
        """Return the layout with other values."""
        return replace(self, values=values)

    def heights(self) -> tuple[Float[Tensor, " s"], Float[Tensor, " m"]]:
        """Heights of sensors and magnets over the base of the straight, unextended robot [m]."""
        bottom = torch.tensor([0.0, *(s.length for s in self.segments)], dtype=torch.float64).cumsum(0)
        axial, *_, magnet = self.parts()
        return axial + bottom[list(self.sensor_segment)], magnet + bottom[list(self.magnet_segment)]

    def table(self) -> pd.DataFrame:
        """List the parts, sensors first.

        Columns ``part``, ``segment`` (from 1), ``height_mm``, ``axial_mm``, ``radial_mm``, ``azimuth_deg``,
        ``tilt_deg``. The azimuth is between 0 and 360 degrees; magnets have radius, azimuth and tilt 0.
        """
        axial, radial, azimuth, tilt, magnet = (x.detach().numpy() for x in self.parts())
        rows = [("sensor", i + 1) for i in self.sensor_segment]
        rows += [("magnet", i + 1) for i in self.magnet_segment]
        none = np.zeros(len(magnet))
        turn = np.degrees(azimuth) % 360
        return pd.DataFrame(rows, columns=["part", "segment"]).assign(
            height_mm=1e3 * np.concatenate([x.detach().numpy() for x in self.heights()]),
            axial_mm=1e3 * np.concatenate([axial, magnet]),
            radial_mm=1e3 * np.concatenate([radial, none]),
            azimuth_deg=np.concatenate([np.where(turn > 360 - 1e-9, 0.0, turn), none]),
            tilt_deg=np.concatenate([np.degrees(tilt), none]),
        )

    def _sizes(self) -> list[int]:
        return [len(self.sensor_segment)] * 4 + [len(self.magnet_segment)]

    def _lengths(self, segment: tuple[int, ...]) -> Tensor:
        return torch.tensor([self.segments[i].length for i in segment], dtype=torch.float64)


def layout_of(robot: Robot) -> Layout:
    """Layout of a robot whose magnets sit on the backbone and whose sensors have no tangential direction."""
    local = robot.sensors.local
    x, y, _ = local[:, :3, 3].unbind(-1)
    radial, azimuth = torch.hypot(x, y), torch.atan2(y, x)
    inwards = -(local[:, 0, 2] * azimuth.cos() + local[:, 1, 2] * azimuth.sin())
    tilt = torch.atan2(inwards, -local[:, 2, 2]) + 0.0  # the zero turns -0 into 0
    values = torch.cat([robot.sensors.axial, radial, azimuth, tilt, robot.magnets.axial])
    return Layout(robot.segments, robot.sensors.segment, robot.magnets.segment, values)


@dataclass(frozen=True)
class Room:
    """Where parts may sit: every sensor and magnet within its own segment, and none too near to another.

    Distances are those of the straight, unextended robot.

    Parameters
    ----------
    radial_m
        Bounds of the distance of a sensor from the backbone [m]: those of the training set, section 3.2, which leave
        4.7 mm to the surface (radius 22 mm).
    tilt_rad
        Bound of the tilt [rad]: 90 degrees, all directions in the plane through the backbone.
    margin_m
        Distance of a magnet's centre from the ends of its segment [m]: half the height of the ring.
    magnet_to_sensor_m
        Least distance of a sensor from the centre of a magnet [m]. Above :data:`RADIAL_M`, so no magnet is in the
        plane of a sensor.
    magnet_to_magnet_m
        Least distance of two magnets [m]: at 80 mm two rings ``"released"`` attract each other with 0.08 N.
    sensor_to_sensor_m
        Least distance of two sensors [m]: the size of a package.
    """

    radial_m: tuple[float, float] = RADIAL_M
    tilt_rad: float = math.pi / 2
    margin_m: float = 3e-3
    magnet_to_sensor_m: float = 0.030
    magnet_to_magnet_m: float = 0.080
    sensor_to_sensor_m: float = 0.008

    def limits(self, layout: Layout) -> tuple[Float[Tensor, " k"], Float[Tensor, " k"]]:
        """Lowest and highest value of everything in a layout; an azimuth has two turns either way."""
        n = len(layout.sensor_segment)
        sensor, magnet = (
            [layout.segments[i].length for i in segment]
            for segment in (layout.sensor_segment, layout.magnet_segment)
        )
        low = [*[0.0] * n, *[self.radial_m[0]] * n, *[-4 * math.pi] * n, *[-self.tilt_rad] * n]
        high = [*sensor, *[self.radial_m[1]] * n, *[4 * math.pi] * n, *[self.tilt_rad] * n]
        low, high = low + [self.margin_m] * len(magnet), high + [x - self.margin_m for x in magnet]
        return torch.tensor(low, dtype=torch.float64), torch.tensor(high, dtype=torch.float64)

    def clearances(self, layout: Layout) -> Float[Tensor, " pairs"]:
        """Distances of magnets to sensors, of magnets and of sensors, less the least that is allowed [m]."""
        z_s, z_m = layout.heights()
        _, r, phi, _, _ = layout.parts()
        near = torch.hypot(z_s.unsqueeze(-1) - z_m, r.unsqueeze(-1)) - self.magnet_to_sensor_m
        i, j = torch.triu_indices(len(z_m), len(z_m), 1)
        magnets = (z_m[i] - z_m[j]).abs() - self.magnet_to_magnet_m
        i, j = torch.triu_indices(len(z_s), len(z_s), 1)
        p = torch.stack([r * phi.cos(), r * phi.sin(), z_s], dim=-1)
        # The small number keeps the slope finite for two sensors in one place.
        sensors = ((p[i] - p[j]).square().sum(-1) + 1e-18).sqrt() - self.sensor_to_sensor_m
        return torch.cat([near.flatten(), magnets, sensors])

    def holds(self, layout: Layout) -> bool:
        """Whether a layout keeps all limits and distances."""
        low, high = self.limits(layout)
        inside = (layout.values >= low) & (layout.values <= high)
        return bool(inside.all()) and bool((self.clearances(layout) >= -TOLERANCE_M).all())

    def random(self, layout: Layout, generator: torch.Generator) -> Layout:
        """Layout drawn evenly within the limits, part by part until it keeps its distance from those before it.

        Raises
        ------
        InputError
            If 500 draws of a part do not fit: there is no room for so many parts.
        """
        low, high = self.limits(layout)
        n, n_m = len(layout.sensor_segment), len(layout.magnet_segment)
        turn = slice(2 * n, 3 * n)
        low[turn], high[turn] = 0.0, 2 * math.pi
        values = layout.values.clone()
        magnets = [[4 * n + k] for k in range(n_m)]
        sensors = [[j, n + j, 2 * n + j, 3 * n + j] for j in range(n)]
        for k, part in enumerate([*magnets, *sensors]):
            for _ in range(500):
                u = torch.rand(len(part), generator=generator, dtype=torch.float64)
                values[part] = low[part] + u * (high[part] - low[part])
                if bool((self.clearances(_first(layout.moved(values), k + 1)) >= 0).all()):
                    break
            else:
                expected = "one with room for all parts"
                raise bad_input("layout", "Room.random", expected, f"no room for part {k + 1}")
        return layout.moved(values)


def _first(layout: Layout, count: int) -> Layout:
    """Only the first ``count`` parts, magnets before sensors."""
    n_m = min(count, len(layout.magnet_segment))
    n = count - n_m
    *sensor, magnet = layout.parts()
    values = torch.cat([*(x[:n] for x in sensor), magnet[:n_m]])
    return Layout(layout.segments, layout.sensor_segment[:n], layout.magnet_segment[:n_m], values)
