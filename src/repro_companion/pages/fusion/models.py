"""Sensor models of one robot with magnets and IMUs: configuration, slow errors and stray field to readings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from repro.kinematics.paper_robots import RADIUS_M
from repro.sensing.linearised import LinearisedSensing
from repro_companion.pages.fusion.orientation_readings import between_errors, left_jacobian, rotation_matrix
from repro_companion.twins.calibration_session import released_moments
from repro_companion.twins.segment_motion import ROBOT


@dataclass(frozen=True)
class Magnets:
    """The ring's sensors as a model of ``(q, ..., stray field)``, whatever stands between.

    Parameters
    ----------
    stray
        Whether the last three coordinates are a field in the base frame [mT].
    """

    stray: bool

    def __call__(self, x: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch s"]:
        """Return the predicted readings [mT]."""
        return self.linearise(x)[0]

    def linearise(
        self, x: Float[Tensor, "*batch n"]
    ) -> tuple[Float[Tensor, "*batch s"], Float[Tensor, "*batch s n"]]:
        """Predicted readings [mT] and their derivatives."""
        u, J = _compiled().linearise(x[..., :3])
        J = torch.nn.functional.pad(J, (0, x.shape[-1] - 3))
        if self.stray:
            turn, by_q = _turn(x[..., :3])
            direction, stray = ROBOT.sensors.local[:, :3, 2].to(x), x[..., -3:]
            axes = direction @ turn.mT
            u = u + (axes @ stray.unsqueeze(-1)).squeeze(-1)
            by_turn = torch.linalg.cross(
                axes, stray.unsqueeze(-2).expand_as(axes)
            )  # (e x o) . b = e . (o x b)
            by_q = by_turn @ by_q
            J = J + torch.cat([by_q, J.new_zeros(*J.shape[:-1], J.shape[-1] - 6), axes], dim=-1)
        return u, J


@dataclass(frozen=True)
class Imus:
    """The IMUs as a model of ``(q, constant, wandering, mounting, ...)``: three errors of three components.

    Parameters
    ----------
    held
        Whether ``q`` has no elongation: it is held in the middle.
    """

    held: bool

    def __call__(self, x: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch s"]:
        """Return the predicted rotation vector [rad]."""
        return self.linearise(x)[0]

    def linearise(
        self, x: Float[Tensor, "*batch n"]
    ) -> tuple[Float[Tensor, "*batch s"], Float[Tensor, "*batch s n"]]:
        """Predicted rotation vector [rad] and its derivatives."""
        n = 2 if self.held else 3
        turn, by_q = _turn(x[..., :n])
        left = x[..., n : n + 3] + x[..., n + 3 : n + 6]
        u, by_q, by_left, by_right = between_errors(turn, by_q, left, x[..., n + 6 : n + 9])
        J = torch.cat([by_q, by_left, by_left, by_right], dim=-1)
        return u, torch.nn.functional.pad(J, (0, x.shape[-1] - n - 9))


@cache
def _compiled() -> Any:
    from repro.kernels.sensing import CompiledSensing  # here: numba takes a second to import

    return CompiledSensing(LinearisedSensing(ROBOT, released_moments()))


def _turn(q: Tensor) -> tuple[Tensor, Tensor]:
    """Orientation of the tip, and how the coordinates turn it: its rotation vector is linear in them."""
    chart = q.new_tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])[:, : q.shape[-1]] / RADIUS_M
    vector = q @ chart.mT
    return rotation_matrix(vector), left_jacobian(vector) @ chart
