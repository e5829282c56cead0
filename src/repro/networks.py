"""Trained networks without torch: their weights, the readings that they predict, and the slopes of these.

A network maps the relations of one sensor, eq. (1) of Baaij et al. 2023, to its reading. Training is in
``scripts/training.py`` of the project.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from repro.common import Array, ArrayLike, bad_input, kernel, numbers, require

RELU, SILU = 0, 1
_PAPER = "a network of the paper: batch norm, four blocks of linear layer and batch norm, linear layer"


class Network:
    """Linear layers with ReLU or SiLU between them.

    It computes in the precision of its weights, as torch does.

    Parameters
    ----------
    layers
        Weights ``[out, in]`` and biases ``[out]`` from the first layer to the last, which has one output.
    activation
        ``"relu"`` or ``"silu"``.
    inputs
        ``"angles"`` or ``"cosines"``: which relations it takes.

    Raises
    ------
    InputError
        If the layers do not fit together.

    Examples
    --------
    >>> double = Network([(np.array([[2.0, 0.0]]), np.array([1.0]))], "relu", "cosines")
    >>> double([[3.0, 5.0]])
    array([7.])
    """

    def __init__(self, layers: Sequence[tuple[ArrayLike, ArrayLike]], activation: str, inputs: str) -> None:
        owner = "Network"
        require(activation in ("relu", "silu"), "activation", owner, '"relu" or "silu"', repr(activation))
        require(inputs in ("angles", "cosines"), "inputs", owner, '"angles" or "cosines"', repr(inputs))
        require(layers, "layers", owner, "at least one", "none")
        dtype = np.float32 if np.asarray(layers[0][0]).dtype == np.float32 else np.float64
        self.layers = [
            (numbers(W, "weights", owner, (None, None)), numbers(b, "biases", owner, (None,)))
            for W, b in layers
        ]
        self.activation, self.inputs = activation, inputs
        width = self.layers[0][0].shape[1]
        self.widths = [width]
        for W, b in self.layers:
            fits = W.shape == (len(b), self.widths[-1])
            expected = f"of shape ({len(b)}, {self.widths[-1]})"
            require(fits, "weights", owner, expected, f"shape {W.shape}")
            self.widths.append(len(b))
        require(self.widths[-1] == 1, "layers", owner, "with one output", f"{self.widths[-1]} outputs")
        flat = [np.concatenate([W.T.ravel(), b]) for W, b in self.layers]
        self.weights = np.concatenate(flat).astype(dtype)

    @property
    def architecture(self) -> tuple[object, ...]:
        """What networks that are evaluated together have in common."""
        return self.widths, self.activation, self.inputs, self.weights.dtype

    @property
    def n_inputs(self) -> int:
        """Number of relations, four for each magnet and one more."""
        return self.widths[0]

    def __call__(self, xi: ArrayLike) -> Array:
        """Return the reading predicted for relations ``[..., n_inputs]``."""
        return self.linearise(xi)[0]

    def linearise(self, xi: ArrayLike) -> tuple[Array, Array]:
        """Return readings ``[...]`` and their slopes by the relations ``[..., n_inputs]``."""
        rows = numbers(xi, "xi", "Network", (..., self.n_inputs))
        flat = np.ascontiguousarray(rows.reshape(-1, self.n_inputs))
        u, slopes = np.empty(len(flat)), np.empty(flat.shape)
        act = RELU if self.activation == "relu" else SILU
        _predict_rows(np.array(self.widths), act, self.weights[None], flat, u, slopes)
        return u.reshape(rows.shape[:-1]), slopes.reshape(rows.shape)


def load_network(path: str | Path) -> Network:
    """Read a network from a safetensors file that ``scripts/training.py`` has written; no code in it is run.

    Parameters
    ----------
    path
        File with the weights of a network of the paper (inputs as angles) or of our fast network (as cosines).

    Raises
    ------
    InputError
        If there is no such file, or it holds another network.

    Examples
    --------
    A fast network of one layer that adds its inputs:

    >>> from tempfile import mkdtemp
    >>> from safetensors.numpy import save_file
    >>> state = {"centre": np.zeros(5), "spread": np.ones(5), "offset": np.zeros(()), "scale": np.ones(())}
    >>> state |= {"layers.0.weight": np.ones((1, 5)), "layers.0.bias": np.zeros(1)}
    >>> path = Path(mkdtemp()) / "sum.safetensors"
    >>> save_file(state, path)
    >>> load_network(path)([1.0, 2.0, 3.0, 4.0, 5.0])
    array(15.)
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    path = Path(path)
    require(path.is_file(), "path", "load_network", "a file", f"{path}, which does not exist")
    try:
        return network_of(load_file(path))
    except SafetensorError as error:
        raise bad_input("path", "load_network", "a safetensors file", f"{path}: {error}") from error


def network_of(state: dict[str, Array]) -> Network:
    """Return the network of a state dict: batch norms and scalings become part of the linear layers.

    Raises
    ------
    InputError
        If it is the state of neither of our two networks.
    """
    if "centre" in state:
        return _fast_network(state)
    numbered = sorted({int(key.split(".")[0]) for key in state if key[0].isdigit()})
    norms = [k for k in numbered if f"{k}.running_mean" in state]
    linear = [k for k in numbered if k not in norms]
    if len(linear) != 5 or len(norms) != 5 or len(state) != len(numbered) * 2 + len(norms) * 3:
        raise bad_input("state", "network_of", _PAPER, f"layers {', '.join(state)}")
    layers = []
    for k, n in zip(linear, norms, strict=True):  # every linear layer stands behind a batch norm
        norm = {
            name: state[f"{n}.{name}"].astype(float)
            for name in ("weight", "bias", "running_mean", "running_var")
        }
        gain = norm["weight"] / np.sqrt(norm["running_var"] + 1e-5)
        shift = norm["bias"] - gain * norm["running_mean"]
        W, b = state[f"{k}.weight"], state[f"{k}.bias"]
        layers.append(((W * gain).astype(W.dtype), (b + W.astype(float) @ shift).astype(W.dtype)))
    return Network(layers, "relu", "angles")


def _fast_network(state: dict[str, Array]) -> Network:
    numbered = sorted({int(key.split(".")[1]) for key in state if key.startswith("layers.")})
    layers = [(state[f"layers.{k}.weight"], state[f"layers.{k}.bias"]) for k in numbered]
    dtype = layers[0][0].dtype
    W = layers[0][0].astype(float) / state["spread"]
    layers[0] = (W.astype(dtype), (layers[0][1] - W @ state["centre"].astype(float)).astype(dtype))
    W, b = layers[-1]
    layers[-1] = (W * state["scale"], b * state["scale"] + state["offset"])
    return Network(layers, "silu", "cosines")


class Layers(NamedTuple):
    """Networks of one architecture for the kernels, with room for one evaluation."""

    widths: Array
    activation: int
    weights: Array
    """Of every network ``[n, weights]``."""
    value: Array
    slope: Array
    back: Array
    on: Array
    """A list of indices."""


@kernel(allocates=True)
def nodes(widths, weights):
    """Room for one evaluation of ``predict``: values, slopes and gradients of the nodes, and a list of indices."""
    widest = 1
    for k in range(len(widths)):
        widest = max(widest, widths[k])
    room = np.zeros((3, max(len(widths), 1), widest), dtype=weights.dtype)
    return room[0], room[1], room[2], np.zeros(widest, dtype=np.int64)


@kernel(reorder=True)
def predict(network, which, xi, slopes, gradient):
    """Return the reading predicted for relations by a network; write its slopes to ``gradient`` if ``slopes``."""
    widths, activation, weights = network.widths, network.activation, network.weights[which]
    value, slope, back, on = network.value, network.slope, network.back, network.on
    last = len(widths) - 1
    for i in range(widths[0]):
        value[0, i] = xi[i]
    at = 0 * last  # no literal, for which the layers would be compiled once more
    for k in range(last):
        n_in, n_out = widths[k], widths[k + 1]
        _linear(weights, at, n_in, n_out, value[k], value[k + 1], on)
        at += (n_in + 1) * n_out
        if k < last - 1:
            for o in range(n_out):
                z = value[k + 1, o]
                if activation == RELU:
                    slope[k + 1, o] = 1.0 if z > 0.0 else 0.0
                    value[k + 1, o] = z if z > 0.0 or z != z else 0.0
                else:
                    gate = 1.0 / (1.0 + math.exp(-z))
                    slope[k + 1, o] = gate * (1.0 + z * (1.0 - gate))
                    value[k + 1, o] = z * gate
    if slopes:
        slope[0, :] = 1.0
        back[last, 0] = 1.0
        for k in range(last - 1, -1, -1):
            at -= (widths[k] + 1) * widths[k + 1]
            _linear_back(weights, at, widths[k], widths[k + 1], slope[k], back[k + 1], back[k], on)
        for i in range(widths[0]):
            gradient[i] = back[0, i]
    return value[last, 0]


@kernel(reorder=True)
def _linear(weights, at, n_in, n_out, x, y, on):
    """``y = W x + b``, four inputs at a time; inputs that a ReLU has set to zero cost nothing."""
    n_on = _nonzero(x, n_in, on)
    bias = weights[at + n_in * n_out : at + (n_in + 1) * n_out]
    for o in range(n_out):
        y[o] = bias[o]
    k = 0
    while k + 4 <= n_on:
        a, b, c, d = on[k], on[k + 1], on[k + 2], on[k + 3]
        xa, xb, xc, xd = x[a], x[b], x[c], x[d]
        wa = weights[at + a * n_out : at + (a + 1) * n_out]
        wb = weights[at + b * n_out : at + (b + 1) * n_out]
        wc = weights[at + c * n_out : at + (c + 1) * n_out]
        wd = weights[at + d * n_out : at + (d + 1) * n_out]
        for o in range(n_out):
            y[o] += xa * wa[o] + xb * wb[o] + xc * wc[o] + xd * wd[o]
        k += 4
    while k < n_on:
        row = weights[at + on[k] * n_out : at + (on[k] + 1) * n_out]
        for o in range(n_out):
            y[o] += x[on[k]] * row[o]
        k += 1


@kernel(reorder=True)
def _linear_back(weights, at, n_in, n_out, slope, y, x, on):
    """``x = slope * (W^T y)``, two nodes at a time; nodes of slope zero cost nothing."""
    n_on = _nonzero(slope, n_in, on)
    for i in range(n_in):
        x[i] = 0.0
    for k in range(0, n_on, 2):
        a, b = on[k], on[min(k + 1, n_on - 1)]
        wa = weights[at + a * n_out : at + (a + 1) * n_out]
        wb = weights[at + b * n_out : at + (b + 1) * n_out]
        total_a, total_b = wa[0] * y[0], wb[0] * y[0]  # from here on in the precision of the weights
        for o in range(1, n_out):
            total_a += wa[o] * y[o]
            total_b += wb[o] * y[o]
        x[a], x[b] = slope[a] * total_a, slope[b] * total_b


@kernel
def _nonzero(x, n, on):
    """Write the indices of the numbers that are not zero and return how many, without branches to mispredict."""
    n_on = 0
    for i in range(n):
        on[n_on] = i
        n_on += x[i] != 0.0
    return n_on


@kernel(entry=True, allocates=True)
def _predict_rows(widths, activation, weights, xi, u, slopes):
    network = Layers(widths, activation, weights, *nodes(widths, weights))
    for n in range(len(xi)):
        u[n] = predict(network, 0, xi[n], len(xi) > 0, slopes[n])


class TorchModel:
    """A torch module of coordinates as a sensor model, with slopes by automatic differentiation.

    The module takes coordinates ``[rows, n]`` in float64 and returns readings ``[rows, s]``, each row by itself.

    Examples
    --------
    >>> import torch
    >>> model = TorchModel(lambda q: torch.stack([q[:, 0] ** 2, q[:, 0] * q[:, 1]], dim=-1))
    >>> u, slopes = model.linearise([3.0, 2.0])
    >>> u, slopes.tolist()
    (array([9., 6.]), [[6.0, 0.0], [2.0, 3.0]])
    """

    def __init__(self, module: Callable[[Any], Any]) -> None:
        self.module = module

    def __call__(self, q: ArrayLike) -> Array:
        """Return readings ``[..., s]`` at coordinates ``[..., n]``."""
        return self.linearise(q)[0]

    def linearise(self, q: ArrayLike) -> tuple[Array, Array]:
        """Return readings ``[..., s]``, and their slopes by the coordinates ``[..., s, n]``."""
        import torch

        rows = numbers(q, "q", "TorchModel", (..., None))
        x = torch.tensor(rows.reshape(-1, rows.shape[-1]), requires_grad=True)
        u = self.module(x)
        of_rows = u.ndim == 2 and len(u) == len(x)
        require(of_rows, "module", "TorchModel", f"one that returns readings [{len(x)}, s]", tuple(u.shape))
        slopes = [torch.autograd.grad(of_one.sum(), x, retain_graph=True)[0] for of_one in u.unbind(dim=1)]
        J = torch.stack(slopes, dim=1).numpy()
        return u.detach().numpy().reshape(*rows.shape[:-1], -1), J.reshape(*rows.shape[:-1], *J.shape[1:])
