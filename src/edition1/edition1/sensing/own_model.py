"""Sensor models that a user brings: modules of torch, TorchScript, or any callable, made to fit the estimators."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from edition1.errors import InputError, bad_input, require
from edition1.sensing._slopes import with_jacobian

_OWNER = "a sensor model of your own"
Given = Callable[[Tensor], Any] | str | Path
"""A callable, among them modules of torch and TorchScript, or the path of a TorchScript file."""


@dataclass(frozen=True)
class OwnModel:
    """Readings from the relations of all sensors, float64 to float64, by the networks of a user.

    Made by :meth:`OwnModel.of`.

    Parameters
    ----------
    networks
        Each with its dtype found.
    network_of_sensor
        Index of the network for every sensor; empty for one callable that takes all sensors at once.
    inputs
        ``"angles"`` or ``"cosines"``.
    """

    networks: tuple[_Network, ...]
    network_of_sensor: tuple[int, ...]
    inputs: str

    def __call__(self, xi: Float[Tensor, "*batch s xi"]) -> Float[Tensor, "*batch s"]:
        """Return the reading of every sensor [unit of the model]."""
        if self.inputs == "cosines":
            xi = _within(xi, torch.finfo(min((n.dtype for n in self.networks), key=_digits)).eps)
        if not self.network_of_sensor:
            (network,) = self.networks
            return network.of_all(xi)
        columns: dict[int, Tensor] = {}
        for k, network in enumerate(self.networks):
            here = [j for j, n in enumerate(self.network_of_sensor) if n == k]
            rows = xi[..., here, :]
            u = with_jacobian(rows.flatten(0, -2), network).unflatten(0, rows.shape[:-1])
            columns.update(zip(here, u.squeeze(-1).unbind(-1), strict=True))
        return torch.stack([columns[j] for j in range(len(self.network_of_sensor))], dim=-1)

    @classmethod
    def of(
        cls,
        model: Given | Sequence[Given],
        relations: Float[Tensor, "s xi"],
        of_segment: Sequence[int],
        inputs: str,
    ) -> OwnModel:
        """Make a sensor model for estimators of what a user brings.

        A module is copied, set to evaluation mode (batch norms use their running statistics) and called with rows of
        relations ``[rows, 1 + 4 magnets]``; it returns ``[rows]`` or ``[rows, 1]``. If it does not take rows, or for
        a callable that is no module, it is called with ``[..., sensors, 1 + 4 magnets]`` and returns
        ``[..., sensors]``. Weights are taken to float64, which changes no weight and lets estimators converge in
        fewer steps; a network that does not go on with that is called in its own dtype, float64 or float32, whatever
        it takes.

        Cosines are kept one rounding of that dtype away from 1 and -1, so that an inverse cosine in the model has a
        finite derivative at the straight pose, where it is then multiplied with zero. Angles are safe by themselves.

        Parameters
        ----------
        model
            One for all sensors, or a sequence of one per segment or one per sensor.
        relations
            Of every sensor where estimators start: the model is tried with them.
        of_segment
            Segment of every sensor, from 0.
        inputs
            ``"angles"`` or ``"cosines"``: what the relations are.

        Raises
        ------
        InputError
            If it is no model, their number does not fit, or it does not take the relations and return a finite
            reading, with finite derivatives, for every sensor.
        """
        given = list(model) if isinstance(model, list | tuple | nn.ModuleList) else [model]
        loaded = [_loaded(one) for one in given]
        n, segments = len(relations), max(of_segment) + 1
        if len(loaded) == 1:
            found, rows = _tried(loaded[0], relations)
            made = cls((found,), (0,) * n if rows else (), inputs)
        elif len(loaded) in (segments, n):
            of_sensor = tuple(of_segment) if len(loaded) == segments else tuple(range(n))
            networks = []
            for k, network in enumerate(loaded):
                found, rows = _tried(network, relations[[j for j in range(n) if of_sensor[j] == k]])
                if not rows:
                    raise bad_input(
                        "model", _OWNER, f"a sequence of callables on rows {_rows(relations)}", network
                    )
                networks.append(found)
            made = cls(tuple(networks), of_sensor, inputs)
        else:
            expected = f"one, or {segments} (one per segment), or {n} (one per sensor)"
            raise bad_input("model", _OWNER, expected, f"{len(loaded)} of them")
        _check_finite(made, relations)
        return made


@dataclass(frozen=True)
class _Network:
    """One network, called in its own dtype on its own device."""

    call: Callable[[Tensor], Any]
    dtype: torch.dtype
    device: torch.device

    def of_all(self, xi: Tensor) -> Tensor:
        u = self.call(xi.to(self.device, self.dtype)).to(xi)
        return u.squeeze(-1) if u.shape == (*xi.shape[:-1], 1) else u

    def linearise(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Readings of rows of relations, ``[rows, 1]``, and their derivatives by the relations, ``[rows, 1, xi]``.

        Rows do not depend on each other, so one backward pass from the sum holds the derivatives of all.
        """
        with torch.enable_grad():
            x = q.detach().to(self.device, self.dtype, copy=True).requires_grad_(True)
            u = self.call(x).reshape(len(q), 1)
            J = _slopes(u, x)
        return u.detach().to(q), J.to(q).unsqueeze(-2)


def _loaded(given: Any) -> Callable[[Tensor], Any]:
    if isinstance(given, str | Path):
        given = _script(Path(given))
    if isinstance(given, nn.Module):
        with torch.no_grad():
            return copy.deepcopy(given).eval()
    if not callable(given):
        expected = "a torch.nn.Module, TorchScript or the path of its .pt file, or a callable"
        raise bad_input("model", _OWNER, expected, type(given).__name__)
    return given


def _script(path: Path) -> nn.Module:
    expected = "a TorchScript file (as torch.jit.save writes it; weights alone are none)"
    require(path.is_file(), "model", _OWNER, expected, f"{path}, which is not there")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            return torch.jit.load(path, map_location="cpu")
    except (RuntimeError, ValueError, OSError) as error:
        raise bad_input("model", _OWNER, expected, f"{path}, which is none") from error


def _tried(call: Callable[[Tensor], Any], relations: Tensor) -> tuple[_Network, bool]:
    """Return a network in a dtype that it takes, and whether it takes rows."""
    batch = torch.stack([relations, relations]).detach()
    told = []
    for rows in (True, False) if isinstance(call, nn.Module) else (False, True):
        xi = batch.flatten(0, 1) if rows else batch
        for network in _in_each_dtype(call):
            name = f"{tuple(xi.shape)} of {str(network.dtype).removeprefix('torch.')}"
            try:
                u = network.call(xi.to(network.device, network.dtype))
            except Exception as error:  # whatever a user's model raises is said, in one line
                told.append(f"for {name}: {_last_line(error)}")
                continue
            if isinstance(u, Tensor) and u.shape in (xi.shape[:-1], (*xi.shape[:-1], 1)):
                return network, rows
            shape = f"shape {tuple(u.shape)}" if isinstance(u, Tensor) else type(u).__name__
            told.append(f"for {name}: {shape}")
    n, width = relations.shape
    expected = f"one that maps rows of {width} relations, or {n} sensors x {width}, to a reading each"
    raise InputError(
        f"{bad_input('model', _OWNER, expected, told[0])}" + "".join(f"\n  {x}" for x in told[1:])
    )


def _in_each_dtype(call: Callable[[Tensor], Any]) -> Iterator[_Network]:
    """Yield a network with weights in float64, in which estimators converge in fewer steps, then as it is."""
    weights = list(call.parameters()) if isinstance(call, nn.Module) else []
    device = weights[0].device if weights else torch.device("cpu")
    if isinstance(call, nn.Module) and weights:
        with torch.no_grad():
            exact = copy.deepcopy(call).double()
        yield _Network(exact, torch.float64, device)
    for dtype in [w.dtype for w in weights if w.is_floating_point()][:1] or (torch.float64, torch.float32):
        yield _Network(call, dtype, device)


def _check_finite(model: OwnModel, relations: Tensor) -> None:
    xi = relations.detach().clone().requires_grad_(True)
    u = model(xi)
    if not bool(torch.isfinite(u).all()):
        expected = "one that returns finite readings where estimators start"
        raise bad_input("model", _OWNER, expected, u.tolist())
    slopes = _slopes(u, xi)
    if not bool(torch.isfinite(slopes).all()) or not bool(slopes.any()):
        expected = (
            "one whose readings change with the relations, with finite derivatives where estimators start"
        )
        raise bad_input("model", _OWNER, expected, f"derivatives {slopes.tolist()}")


def _slopes(u: Tensor, xi: Tensor) -> Tensor:
    """Return the derivatives of the sum of readings by the relations; zero where they do not depend on them."""
    (slopes,) = torch.autograd.grad(u.sum(), xi, allow_unused=True) if u.requires_grad else (None,)
    return torch.zeros_like(xi) if slopes is None else slopes


def _within(cosines: Tensor, rounding: float) -> Tensor:
    """Keep cosines that much away from 1 and -1; distances stay."""
    is_distance = torch.zeros(cosines.shape[-1], dtype=torch.bool, device=cosines.device)
    is_distance[1::4] = True
    return torch.where(is_distance, cosines, cosines.clamp(rounding - 1, 1 - rounding))


def _digits(dtype: torch.dtype) -> float:
    return -torch.finfo(dtype).eps


def _rows(relations: Tensor) -> str:
    return f"[rows, {relations.shape[-1]}]"


def _last_line(error: Exception) -> str:
    lines = [line for line in str(error).splitlines() if line.strip()]
    return (lines[-1].strip() if lines else type(error).__name__)[:200]
