"""From the configuration of a robot to the readings of its magnetic sensors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input
from edition1.kinematics.robot import Robot
from edition1.sensing._multipoles import multipole_factors
from edition1.sensing.magnets import Cube, Ring
from edition1.sensing.relations import relations

EARTH_MT = 0.065
"""Flux density of the Earth field in Baaij et al. 2023, section 3.5 [mT]."""


@dataclass(frozen=True)
class MagneticSensing:
    r"""Predicted readings of a robot: ``u = sensing(q)``, eq. (7) followed by a sensor model.

    Parameters
    ----------
    robot
        With its magnets and sensors.
    model
        Any callable from relations ``[..., sensors, 1 + 4 magnets]`` to readings ``[..., sensors]``: a
        network, :class:`~edition1.sensing.multipole.MultipoleField`, a closed form of the user.
    inputs
        Whether the model takes the relations as ``"angles"`` (as in the paper) or as ``"cosines"``.
    earth_axis
        Direction of the Earth field in the base frame; the x axis when not given.

    Raises
    ------
    InputError
        If ``inputs`` is unknown, or the model does not return one reading for each sensor.

    Examples
    --------
    >>> from edition1.kinematics.paper_robots import pcc_robot
    >>> sensing = MagneticSensing(pcc_robot(1), lambda xi: 1.0 / xi[..., 1] ** 3)
    >>> sensing(torch.zeros(3, dtype=torch.float64)).shape
    torch.Size([3])
    """

    robot: Robot
    model: Callable[[Tensor], Tensor]
    inputs: str = "cosines"
    earth_axis: Float[Tensor, "*earth 3"] | None = None

    def __post_init__(self) -> None:
        if self.inputs not in ("angles", "cosines"):
            raise bad_input("inputs", "MagneticSensing", "'angles' or 'cosines'", repr(self.inputs))

    def __call__(self, q: Float[Tensor, "*batch n_q"]) -> Float[Tensor, "*batch s"]:
        """Return the predicted readings [unit of the model] at configuration ``q``."""
        related = relations(self.robot, q, self.earth_axis)
        xi = related.cosines() if self.inputs == "cosines" else related.angles()
        u = self.model(xi)
        if u.shape != xi.shape[:-1]:
            expected = f"a callable that maps {tuple(xi.shape)} to {tuple(xi.shape[:-1])}"
            raise bad_input("model", "MagneticSensing", expected, f"one that returns {tuple(u.shape)}")
        return u


def field_at_sensors(
    robot: Robot,
    q: Float[Tensor, "*q n_q"],
    magnet: Ring | Cube | Sequence[Ring | Cube],
    *,
    route: str = "magpylib",
    l_max: int = 9,
    earth_mt: Float[Tensor, "*earth 3"] | None = None,
) -> Float[Tensor, "*batch s 3"]:
    """Flux density at every sensor, in the frame of the sensor: what a three-axis sensor reads.

    Parameters
    ----------
    robot
        With its magnets and sensors.
    q
        Configuration.
    magnet
        The magnet at every magnet mount, or one for each of them (``"magpylib"`` only).
    route
        ``"magpylib"``: closed forms, the oracle, no derivatives. ``"multipole"``: the axisymmetric series up
        to ``l_max`` in torch, differentiable.
    l_max
        Highest order of the series.
    earth_mt
        Earth field vector in the base frame [mT]; none when not given.

    Returns
    -------
    Tensor
        Flux density [mT]; the last component is along the measurement direction.

    Raises
    ------
    InputError
        If the route is unknown, the magnets are not as many as their mounts, or the series is asked for several
        magnets or for one that is not axisymmetric.
    """
    T_m, T_s = robot.magnet_and_sensor_poses(q)
    offset = T_s[..., :, None, :3, 3] - T_m[..., None, :, :3, 3]
    rotation = T_m[..., None, :, :3, :3]
    if route == "magpylib":
        local = (rotation.transpose(-1, -2) @ offset.unsqueeze(-1)).squeeze(-1)
        flux = torch.from_numpy(_fields(magnet, local.detach().cpu().double().numpy())).to(q)
        B = (rotation @ flux.unsqueeze(-1)).squeeze(-1).sum(-2)
    elif route == "multipole":
        if not isinstance(magnet, Ring):
            raise bad_input("magnet", "field_at_sensors", "a Ring for route='multipole'", magnet)
        axis = rotation[..., 2]
        d = torch.linalg.vector_norm(offset, dim=-1)
        f, g = multipole_factors(torch.as_tensor(magnet.multipoles(l_max)), d, (axis * offset).sum(-1) / d)
        B = (f.unsqueeze(-1) * axis + (g / d).unsqueeze(-1) * offset).sum(-2)
    else:
        raise bad_input("route", "field_at_sensors", "'magpylib' or 'multipole'", repr(route))
    if earth_mt is not None:
        B = B + earth_mt.to(q).unsqueeze(-2)
    return (T_s[..., :3, :3].transpose(-1, -2) @ B.unsqueeze(-1)).squeeze(-1)


def _fields(magnet: Ring | Cube | Sequence[Ring | Cube], local: np.ndarray) -> np.ndarray:
    """Field of every magnet at positions ``[..., s, m, 3]`` in its own frame."""
    if isinstance(magnet, Ring | Cube):
        return magnet.field(local)
    if len(magnet) != local.shape[-2]:
        expected = f"one, or one for each of {local.shape[-2]} mounts"
        raise bad_input("magnet", "field_at_sensors", expected, f"{len(magnet)} magnets")
    return np.stack([one.field(local[..., k, :]) for k, one in enumerate(magnet)], axis=-2)


def readings(
    robot: Robot,
    q: Float[Tensor, "*q n_q"],
    magnet: Ring | Cube | Sequence[Ring | Cube],
    *,
    route: str = "magpylib",
    l_max: int = 9,
    earth_mt: Float[Tensor, "*earth 3"] | None = None,
) -> Float[Tensor, "*batch s"]:
    """Readings [mT] of single-axis sensors: the flux density along their measurement directions.

    Parameters are those of :func:`field_at_sensors`.

    Examples
    --------
    >>> from edition1.kinematics.paper_robots import pcc_robot
    >>> from edition1.sensing.magnets import ring
    >>> readings(pcc_robot(1), torch.zeros(3, dtype=torch.float64), ring("released")).round(decimals=3)
    tensor([-2.2480, -2.2480, -2.2480], dtype=torch.float64)
    """
    B = field_at_sensors(robot, q, magnet, route=route, l_max=l_max, earth_mt=earth_mt)
    return B[..., 2]
