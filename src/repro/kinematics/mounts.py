"""Where magnets and sensors sit on a robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from repro import se3
from repro.errors import bad_input

Numbers = float | Sequence[float] | Tensor


@dataclass(frozen=True)
class Mounts:
    """Rigid mounts of ``n`` magnets or sensors.

    Parameters
    ----------
    segment
        Segment of each mount, counted from 0 at the base.
    axial
        Distance [m] from the base of that segment along the unextended backbone. Leading dimensions, as
        in ``local``, describe a batch of robots.
    local
        Rigid motion ``T_backbone_mount`` from the mount to the backbone frame at ``axial``; its z axis is
        the axis of a magnet or the measurement direction of a sensor, eq. (3).

    Raises
    ------
    InputError
        If the three do not describe the same number of mounts.
    """

    segment: tuple[int, ...]
    axial: Float[Tensor, "*axial n"]
    local: Float[Tensor, "*local m 4 4"]

    def __post_init__(self) -> None:
        n = len(self.segment)
        if self.axial.shape[-1] != n or self.local.shape[-3:] != (n, 4, 4):
            shapes = f"axial {tuple(self.axial.shape)} and local {tuple(self.local.shape)}"
            raise bad_input("axial, local", "Mounts", f"for the {n} mounts of segment", shapes)

    def __len__(self) -> int:
        """Return the number of mounts."""
        return len(self.segment)

    def joined(self, other: Mounts) -> Mounts:
        """These mounts, then those of ``other``; batches broadcast."""
        parts = (self.axial.shape[:-1], other.axial.shape[:-1], self.local.shape[:-3], other.local.shape[:-3])
        batch = torch.broadcast_shapes(*parts)
        axial, local = (
            torch.cat([x.expand(*batch, *x.shape[-rank:]) for x in (a, b)], dim=-rank)
            for a, b, rank in ((self.axial, other.axial, 1), (self.local, other.local, 3))
        )
        return Mounts(self.segment + other.segment, axial, local)


def magnet_mounts(segment: Sequence[int], axial: Numbers) -> Mounts:
    """Magnets on the backbone, magnetised along it (Baaij et al. 2023, section 2.2).

    Parameters
    ----------
    segment
        Segment of each magnet, from 0.
    axial
        Distance ``d_m`` [m] from the base of the segment to the centre of the magnet.
    """
    d = _numbers("axial", "magnet_mounts", axial, len(segment))
    local = torch.eye(4, dtype=d.dtype).expand(*d.shape, 4, 4)
    return Mounts(tuple(segment), d, local)


def sensor_mounts(
    segment: Sequence[int], axial: Numbers, radial: Numbers = 0.0, azimuth: Numbers = 0.0, tilt: Numbers = 0.0
) -> Mounts:
    r"""Sensors in a cylindrical plane of a segment, eq. (2), measuring towards the base.

    With the azimuth :math:`\varphi` and the tilt :math:`\psi`, the local rotation is
    :math:`R_z(\varphi) R_y(\psi) R_x(\pi)`: the measurement direction is
    :math:`R_z(\varphi) (-\sin\psi, 0, -\cos\psi)`, so a positive tilt points it inwards.

    Parameters
    ----------
    segment
        Segment of each sensor, from 0.
    axial
        Distance ``d_s,a`` [m] from the base of the segment to the plane of the sensor.
    radial
        Distance ``d_s,r`` [m] from the backbone.
    azimuth
        Angle [rad] of the sensor in its plane.
    tilt
        Angle ``psi_s`` [rad] about the tangential direction.

    Raises
    ------
    InputError
        If a number is missing, not finite, or a radius is negative.

    Examples
    --------
    >>> mounts = sensor_mounts([0], axial=0.11, radial=0.013, tilt=torch.pi / 6)
    >>> mounts.local[0, :3, 2]
    tensor([-0.5000,  0.0000, -0.8660], dtype=torch.float64)
    """
    n, owner = len(segment), "sensor_mounts"
    names = ("axial", "radial", "azimuth", "tilt")
    values = [
        _numbers(name, owner, x, n) for name, x in zip(names, (axial, radial, azimuth, tilt), strict=True)
    ]
    d, r, phi, psi = torch.broadcast_tensors(*values)
    if bool((r < 0).any()):
        raise bad_input("radial", owner, "not negative [m]", float(r.min()))
    flip = torch.diag(d.new_tensor([1.0, -1.0, -1.0]))  # R_x(pi), without the rounding of sin(pi)
    rotation = se3.rotation_z(phi) @ se3.rotation_y(psi) @ flip
    position = torch.stack([r * phi.cos(), r * phi.sin(), torch.zeros_like(r)], dim=-1)
    return Mounts(tuple(segment), d, se3.pose(rotation, position))


def ring_azimuths(n: int, offset: Tensor | float = 0.0) -> Tensor:
    """Azimuths [rad] of ``n`` sensors spaced evenly around a segment, the first at ``offset``."""
    return torch.as_tensor(offset, dtype=torch.float64).unsqueeze(-1) + torch.arange(
        n, dtype=torch.float64
    ) * (2 * torch.pi / n)


def _numbers(name: str, owner: str, value: Numbers, n: int) -> Tensor:
    x = torch.as_tensor(value, dtype=torch.float64)
    if x.ndim == 0:
        x = x.expand(n)
    if x.shape[-1] not in (1, n):
        raise bad_input(name, owner, f"one number or one for each of {n} mounts", f"shape {tuple(x.shape)}")
    se3.require_finite(x, name, owner)
    return x.expand(*x.shape[:-1], n)
