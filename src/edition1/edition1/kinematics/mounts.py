"""Where magnets and sensors sit on a robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input

_Numbers = float | Sequence[float] | Tensor


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


def magnet_mounts(
    segment: Sequence[int],
    axial: _Numbers,
    direction: Sequence[Sequence[float]] | Tensor | None = None,
    shift: _Numbers = 0.0,
) -> Mounts:
    """Magnets on the backbone, magnetised along it (Baaij et al. 2023, section 2.2) or in directions of their own.

    Parameters
    ----------
    segment
        Segment of each magnet, from 0.
    axial
        Distance ``d_m`` [m] from the base of the segment to the centre of the magnet.
    direction
        Direction of magnetisation of each magnet, ``[m, 3]``, in the frame of the cross-section (z along the
        backbone towards the tip) and of any length; along the backbone when not given.
    shift
        Distance [m] by which each magnet is moved along its own axis from there. It moves rigidly, in the frame of
        the cross-section at ``axial``: it does not follow the bent backbone.

    Raises
    ------
    InputError
        If a number is missing or not finite, or a direction is zero.

    Examples
    --------
    >>> magnet_mounts([0], 0.05, [[2.0, 0.0, 0.0]]).local[0, :3, 2]
    tensor([1., 0., 0.], dtype=torch.float64)
    """
    d = _numbers("axial", "magnet_mounts", axial, len(segment))
    local = torch.eye(4, dtype=d.dtype).expand(*d.shape, 4, 4)
    if direction is not None:
        rotation = _directed(direction, d.new_tensor([0.0, 1.0, 0.0]), len(segment), "magnet_mounts")
        local = se3.pose(rotation, local[..., :3, 3])
    along = _numbers("shift", "magnet_mounts", shift, len(segment))
    local = se3.pose(local[..., :3, :3], local[..., :3, 3] + along.unsqueeze(-1) * local[..., :3, 2])
    return Mounts(tuple(segment), d, local)


def sensor_mounts(
    segment: Sequence[int],
    axial: _Numbers,
    radial: _Numbers = 0.0,
    azimuth: _Numbers = 0.0,
    tilt: _Numbers = 0.0,
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


def directed_sensors(
    segment: Sequence[int],
    axial: _Numbers,
    radial: _Numbers,
    azimuth: _Numbers,
    direction: Sequence[Sequence[float]] | Tensor,
) -> Mounts:
    """Sensors at any place of a cross-section that measure in any direction.

    Parameters
    ----------
    segment, axial, radial, azimuth
        As for :func:`sensor_mounts`; the azimuth says where a sensor is, and nothing about its direction.
    direction
        Measurement directions ``[s, 3]`` in the frame of the cross-section (z along the backbone towards the tip),
        of any length.

    Raises
    ------
    InputError
        As :func:`sensor_mounts`, and if a direction is zero.

    Examples
    --------
    A three-axis sensor beside the backbone; of azimuth and tilt none could measure along y there:

    >>> mounts = directed_sensors([0] * 3, 0.1, 0.013, 0.0, torch.eye(3))
    >>> mounts.local[:, :3, 2]
    tensor([[1., 0., 0.],
            [0., 1., 0.],
            [0., 0., 1.]], dtype=torch.float64)
    """
    placed = sensor_mounts(segment, axial, radial, azimuth)
    # The tilt of a calibration turns a mount about its y axis: opposite to the tangential direction if it can be.
    rotation = _directed(direction, placed.local[..., :3, 1], len(segment), "directed_sensors")
    return Mounts(placed.segment, placed.axial, se3.pose(rotation, placed.local[..., :3, 3]))


def _directed(direction: Sequence[Sequence[float]] | Tensor, side: Tensor, n: int, owner: str) -> Tensor:
    """Rotations ``[n, 3, 3]`` whose z axis is a direction; y is across it and the backbone, on the given side."""
    d = torch.as_tensor(direction, dtype=torch.float64)
    if d.shape != (n, 3):
        raise bad_input("direction", owner, f"of shape ({n}, 3)", f"shape {tuple(d.shape)}")
    se3.require_finite(d, "direction", owner)
    length = torch.linalg.vector_norm(d, dim=-1, keepdim=True)
    if not bool((length > 0).all()):
        raise bad_input("direction", owner, "not zero", d[int(length.argmin())].tolist())
    z, side = d / length, side.expand(n, 3)
    y = torch.linalg.cross(d.new_tensor([0.0, 0.0, 1.0]).expand(n, 3), z)
    y = torch.where((y * side).sum(-1, keepdim=True) < 0, -y, y)
    sine = torch.linalg.vector_norm(y, dim=-1, keepdim=True)
    y = torch.where(sine > 0, y / torch.where(sine > 0, sine, 1.0), side)
    return torch.stack([torch.linalg.cross(y, z), y, z], dim=-1)


def ring_azimuths(n: int, offset: Tensor | float = 0.0) -> Tensor:
    """Azimuths [rad] of ``n`` sensors spaced evenly around a segment, the first at ``offset``."""
    return torch.as_tensor(offset, dtype=torch.float64).unsqueeze(-1) + torch.arange(
        n, dtype=torch.float64
    ) * (2 * torch.pi / n)


def _numbers(name: str, owner: str, value: _Numbers, n: int) -> Tensor:
    x = torch.as_tensor(value, dtype=torch.float64)
    if x.ndim == 0:
        x = x.expand(n)
    if x.shape[-1] not in (1, n):
        raise bad_input(name, owner, f"one number or one for each of {n} mounts", f"shape {tuple(x.shape)}")
    se3.require_finite(x, name, owner)
    return x.expand(*x.shape[:-1], n)
