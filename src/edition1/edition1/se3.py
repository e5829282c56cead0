r"""Rotations and rigid motions that stay exact, with exact derivatives, at zero angle.

Everything that bends depends on the angle only through even functions such as
:math:`\sin(\theta)/\theta`. They are smooth functions of :math:`z = \theta^2`, so they are written as
functions of ``z``: no square root is differentiated at zero and no small constant is added.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input

_SERIES_SWITCH = 1.0
"""Squared angle [rad^2] below which the series is used. Ten terms leave less than 1e-18 there."""

_TERMS = 10
_SINC = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(_TERMS))
_COSC = tuple((-1) ** k / math.factorial(2 * k + 2) for k in range(_TERMS))
_SINCC = tuple((-1) ** k / math.factorial(2 * k + 3) for k in range(_TERMS))
# acos(1 - x)/sin(acos(1 - x)) = 2F1(1, 1; 3/2; x/2): each coefficient from the one before it.
_ACOSC_SWITCH = 0.1
_ACOSC = [1.0]
for _k in range(13):
    _ACOSC.append(_ACOSC[-1] * (_k + 1) / (2 * _k + 3))


def _horner(coefficients: tuple[float, ...] | list[float], x: Tensor) -> Tensor:
    total = torch.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total


def sinc(z: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    r""":math:`\sin\theta/\theta` of the squared angle :math:`z = \theta^2`.

    Parameters
    ----------
    z
        Squared angle [rad^2], not negative.

    Examples
    --------
    >>> sinc(torch.tensor([0.0, (math.pi / 2) ** 2], dtype=torch.float64))
    tensor([1.0000, 0.6366], dtype=torch.float64)
    """
    small = z < _SERIES_SWITCH
    theta = torch.where(small, 1.0, z).sqrt()
    return torch.where(small, _horner(_SINC, torch.where(small, z, 0.0)), theta.sin() / theta)


def cosc(z: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    r""":math:`(1 - \cos\theta)/\theta^2` of the squared angle :math:`z = \theta^2`.

    Parameters
    ----------
    z
        Squared angle [rad^2], not negative.

    Examples
    --------
    >>> cosc(torch.tensor([0.0, math.pi**2], dtype=torch.float64))
    tensor([0.5000, 0.2026], dtype=torch.float64)
    """
    small = z < _SERIES_SWITCH
    theta = torch.where(small, 1.0, z).sqrt()
    half = (theta / 2).sin() / theta
    return torch.where(small, _horner(_COSC, torch.where(small, z, 0.0)), 2 * half * half)


def sincc(z: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    r""":math:`(\theta - \sin\theta)/\theta^3` of the squared angle :math:`z = \theta^2`.

    Parameters
    ----------
    z
        Squared angle [rad^2], not negative.

    Examples
    --------
    >>> sincc(torch.tensor([0.0, math.pi**2], dtype=torch.float64))
    tensor([0.1667, 0.1013], dtype=torch.float64)
    """
    small = z < _SERIES_SWITCH
    theta = torch.where(small, 1.0, z).sqrt()
    return torch.where(small, _horner(_SINCC, torch.where(small, z, 0.0)), (theta - theta.sin()) / theta**3)


def acosc(c: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    r""":math:`\theta/\sin\theta` of the cosine :math:`c = \cos\theta`, for :math:`0 \le \theta < \pi`.

    Parameters
    ----------
    c
        Cosine, in (-1, 1]. Values that rounding has put above 1 continue the series smoothly.

    Examples
    --------
    >>> acosc(torch.tensor([1.0, 0.0], dtype=torch.float64))
    tensor([1.0000, 1.5708], dtype=torch.float64)
    """
    x = 1 - c
    small = x < _ACOSC_SWITCH
    far = torch.where(small, 0.5, c)
    closed = far.acos() / (1 - far * far).sqrt()
    return torch.where(small, _horner(_ACOSC, torch.where(small, x, 0.0)), closed)


def rotation_x(angle: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation by ``angle`` [rad] about the x axis."""
    c, s, o, i = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    return _matrix((i, o, o), (o, c, -s), (o, s, c))


def rotation_y(angle: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation by ``angle`` [rad] about the y axis."""
    c, s, o, i = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    return _matrix((c, o, s), (o, i, o), (-s, o, c))


def rotation_z(angle: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation by ``angle`` [rad] about the z axis."""
    c, s, o, i = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    return _matrix((c, -s, o), (s, c, o), (o, o, i))


def _matrix(*rows: tuple[Tensor, ...]) -> Tensor:
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def pose(rotation: Float[Tensor, "*r 3 3"], position: Float[Tensor, "*p 3"]) -> Float[Tensor, "*batch 4 4"]:
    """Homogeneous matrix of a rotation and a position [m]; their batch dimensions broadcast."""
    batch = torch.broadcast_shapes(rotation.shape[:-2], position.shape[:-1])
    top = torch.cat([rotation.expand(*batch, 3, 3), position.expand(*batch, 3).unsqueeze(-1)], dim=-1)
    bottom = top.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*batch, 1, 4)
    return torch.cat([top, bottom], dim=-2)


def inverse(T: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
    """Inverse of a rigid motion: ``T_b_a`` from ``T_a_b``.

    Examples
    --------
    >>> T = pose(rotation_z(torch.tensor(0.3)), torch.tensor([1.0, 2.0, 3.0]))
    >>> torch.allclose(inverse(T) @ T, torch.eye(4), atol=1e-6)
    True
    """
    R_T = T[..., :3, :3].transpose(-1, -2)
    return pose(R_T, -(R_T @ T[..., :3, 3:]).squeeze(-1))


def cross_matrix(v: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Matrix of the cross product: ``cross_matrix(v) @ x`` is ``v`` times ``x``."""
    x, y, z = v.unbind(-1)
    o = torch.zeros_like(x)
    return _matrix((o, -z, y), (z, o, -x), (-y, x, o))


def exponential(xi: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 4 4"]:
    r"""Rigid motion of a twist :math:`(\rho, \phi)`, translation part first: a screw of angle :math:`\|\phi\|`.

    The rotation is :math:`\exp(\phi^\wedge)`, the position :math:`V(\phi)\,\rho` with the left Jacobian V of SO(3).

    Parameters
    ----------
    xi
        Twist [m, rad].

    Examples
    --------
    A quarter turn about y along an arc of length pi/2 ends one radius to the side and one ahead:

    >>> quarter = torch.tensor([0, 0, math.pi / 2, 0, math.pi / 2, 0], dtype=torch.float64)
    >>> exponential(quarter)[:3, 3]
    tensor([1.0000, 0.0000, 1.0000], dtype=torch.float64)
    """
    rho, phi = xi[..., :3], xi[..., 3:]
    z, W, eye = phi.square().sum(-1), cross_matrix(phi), torch.eye(3).to(xi)
    a, b, c = (f(z)[..., None, None] for f in (sinc, cosc, sincc))
    W2 = W @ W
    return pose(eye + a * W + b * W2, ((eye + b * W + c * W2) @ rho.unsqueeze(-1)).squeeze(-1))


def logarithm(T: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 6"]:
    """Twist of a rigid motion [m, rad]: the inverse of :func:`exponential` for turns below pi.

    Examples
    --------
    >>> xi = torch.tensor([0.1, -0.2, 0.3, 0.4, 0.5, -0.6], dtype=torch.float64)
    >>> torch.allclose(logarithm(exponential(xi)), xi)
    True
    """
    R = T[..., :3, :3]
    odd = torch.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1
    )
    cosine = (R.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    phi = odd / 2 * acosc(cosine.clamp(max=1.0)).unsqueeze(-1)
    z, W, eye = phi.square().sum(-1), cross_matrix(phi), torch.eye(3).to(T)
    b, c = cosc(z)[..., None, None], sincc(z)[..., None, None]
    left = eye + b * W + c * (W @ W)
    rho = torch.linalg.solve(left, T[..., :3, 3])
    return torch.cat([rho, phi], dim=-1)


def require_finite(x: Tensor, name: str, owner: str) -> None:
    """Refuse values that are not finite, wherever they can be read.

    Raises
    ------
    InputError
        If ``x`` holds NaN or infinity. Inside ``torch.func.vmap`` values cannot be read; the call that
        entered the transformation has checked them already.
    """
    try:
        finite = bool(torch.isfinite(x).all())
    except RuntimeError:
        return
    if not finite:
        count = int((~torch.isfinite(x)).sum())
        raise bad_input(name, owner, "finite", f"{count} values that are NaN or infinite")
