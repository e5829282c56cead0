"""A robot: segments in series, with the mounts of its magnets and sensors (Baaij et al. 2023, section 2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input
from edition1.kinematics.mounts import Mounts, magnet_mounts

_NO_MOUNTS = magnet_mounts([], [])
"""No magnets, or no sensors."""


@runtime_checkable
class Segment(Protocol):
    """What a segment must offer: any finite-dimensional kinematics fits (section 2)."""

    @property
    def length(self) -> float:
        """Unextended length [m]."""
        ...

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the configuration variables."""
        ...

    @property
    def n_q(self) -> int:
        """Number of configuration variables."""
        ...

    def pose(self, q: Tensor, v: Tensor) -> Tensor:
        """Pose ``T_base_v`` of the backbone frame at ``v`` in [0, 1]."""
        ...


@dataclass(frozen=True)
class Robot:
    """Segments from base to tip, with magnets and sensors mounted on them.

    Parameters
    ----------
    segments
        From base to tip. The configuration of the robot is theirs, one after the other.
    magnets, sensors
        Their mounts. Leading dimensions describe a batch of robots and broadcast against the batch of the
        configuration.

    Raises
    ------
    InputError
        If there is no segment, or a mount sits on a segment that does not exist or beyond its ends.

    Examples
    --------
    >>> from edition1.kinematics.constant_curvature import ConstantCurvature
    >>> robot = Robot((ConstantCurvature(0.11, 0.022),) * 2)
    >>> robot.tip(torch.zeros(6, dtype=torch.float64))[:3, 3]
    tensor([0.0000, 0.0000, 0.2200], dtype=torch.float64)
    """

    segments: tuple[Segment, ...]
    magnets: Mounts = _NO_MOUNTS
    sensors: Mounts = _NO_MOUNTS

    def __post_init__(self) -> None:
        if not self.segments:
            raise bad_input("segments", "Robot", "at least one segment", "none")
        for name in ("magnets", "sensors"):
            self._check_mounts(name, getattr(self, name))

    def _check_mounts(self, name: str, mounts: Mounts) -> None:
        n = len(self.segments)
        for k, i in enumerate(mounts.segment):
            if not 0 <= i < n:
                raise bad_input(f"{name}.segment", "Robot", f"between 0 and {n - 1}", f"{i} for mount {k}")
            axial, length = mounts.axial[..., k], self.segments[i].length
            if bool((axial < 0).any()) or bool((axial > length * (1 + 1e-12)).any()):
                worst = float(axial.flatten()[(axial - length / 2).abs().argmax()])
                raise bad_input(
                    f"{name}.axial",
                    "Robot",
                    f"between 0 and the length {length} m of segment {i}",
                    f"{worst} m for mount {k}",
                )

    @property
    def n_q(self) -> int:
        """Number of configuration variables."""
        return sum(segment.n_q for segment in self.segments)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the configuration variables, numbered by segment from 1: ``delta_x_1`` and so on."""
        return tuple(f"{name}_{i}" for i, s in enumerate(self.segments, start=1) for name in s.coordinates)

    @property
    def length(self) -> float:
        """Unextended length of the robot [m]."""
        return sum(segment.length for segment in self.segments)

    def split(self, q: Float[Tensor, "*batch n_q"]) -> tuple[Tensor, ...]:
        """Configuration of each segment.

        Raises
        ------
        InputError
            If the last dimension of ``q`` is not :attr:`n_q`, or ``q`` is not finite.
        """
        if q.ndim == 0 or q.shape[-1] != self.n_q:
            expected = f"of last dimension {self.n_q} ({', '.join(self.coordinates)})"
            raise bad_input("q", "Robot", expected, f"shape {tuple(q.shape)}")
        se3.require_finite(q, "q", "Robot")
        return tuple(q.split([segment.n_q for segment in self.segments], dim=-1))

    def base_poses(self, q: Float[Tensor, "*batch n_q"]) -> Float[Tensor, "*batch i 4 4"]:
        """Pose ``T_0_i`` of the base of every segment and, last, of the tip: ``n_segments + 1`` rigid motions."""
        tips = self._segment_poses(q, tuple(range(len(self.segments))), torch.ones(len(self.segments)).to(q))
        return self._chain(tips)

    def tip(self, q: Float[Tensor, "*batch n_q"]) -> Float[Tensor, "*batch 4 4"]:
        """Pose ``T_0_tip`` of the tip of the robot."""
        return self.base_poses(q)[..., -1, :, :]

    def mount_poses(self, q: Float[Tensor, "*q n_q"], mounts: Mounts) -> Float[Tensor, "*batch n 4 4"]:
        """Poses ``T_0_mount`` of all mounts, in their order."""
        if not len(mounts):
            return q.new_zeros(*q.shape[:-1], 0, 4, 4)
        # One evaluation for the tips of all segments but the last and for all mounts.
        n = len(self.segments) - 1
        v = mounts.axial.to(q) / q.new_tensor([self.segments[i].length for i in mounts.segment])
        v = torch.cat([v.new_ones(*v.shape[:-1], n), v], dim=-1)
        T = self._segment_poses(q, (*range(n), *mounts.segment), v)
        bases = self._chain(T[..., :n, :, :])
        return bases[..., list(mounts.segment), :, :] @ T[..., n:, :, :] @ mounts.local.to(q)

    def magnet_poses(self, q: Float[Tensor, "*q n_q"]) -> Float[Tensor, "*batch m 4 4"]:
        """Poses ``T_0_m`` of the magnets."""
        return self.mount_poses(q, self.magnets)

    def sensor_poses(self, q: Float[Tensor, "*q n_q"]) -> Float[Tensor, "*batch s 4 4"]:
        """Poses ``T_0_s`` of the sensors, eq. (2)."""
        return self.mount_poses(q, self.sensors)

    def magnet_and_sensor_poses(self, q: Float[Tensor, "*q n_q"]) -> tuple[Tensor, Tensor]:
        """Poses of the magnets and of the sensors, in one evaluation of the kinematics."""
        T = self.mount_poses(q, self.magnets.joined(self.sensors))
        return T[..., : len(self.magnets), :, :], T[..., len(self.magnets) :, :, :]

    def backbone(self, q: Float[Tensor, "*batch n_q"], n_points: int = 33) -> Float[Tensor, "*batch k 3"]:
        """Points on the backbone [m], ``n_points`` per segment, both ends of every segment included."""
        n = len(self.segments)
        index = tuple(i for i in range(n) for _ in range(n_points))
        T = self._segment_poses(q, index, torch.linspace(0, 1, n_points).to(q).repeat(n))
        return (self.base_poses(q)[..., list(index), :, :] @ T)[..., :3, 3]

    def _segment_poses(self, q: Tensor, index: tuple[int, ...], v: Tensor) -> Tensor:
        """Poses at ``v[..., k]`` of segment ``index[k]``, each in the frame of its base; equal segments at once."""
        parts = self.split(q)
        groups: dict[Segment, list[int]] = {}
        for k, i in enumerate(index):
            groups.setdefault(self.segments[i], []).append(k)
        blocks = [
            segment.pose(torch.stack([parts[index[k]] for k in here], dim=-2), v[..., here])
            for segment, here in groups.items()
        ]
        order = [k for here in groups.values() for k in here]
        T = torch.cat(blocks, dim=-3)
        return T if order == sorted(order) else T[..., [order.index(k) for k in range(len(order))], :, :]

    @staticmethod
    def _chain(tips: Tensor) -> Tensor:
        """Cumulative products of rigid motions ``[..., n, 4, 4]``, the identity first."""
        poses = [torch.eye(4).to(tips).expand(*tips.shape[:-3], 4, 4)]
        for T in tips.unbind(-3):
            poses.append(poses[-1] @ T)
        return torch.stack(poses, dim=-3)
