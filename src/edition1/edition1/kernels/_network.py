"""Networks compiled: the reading predicted from relations, and its slopes by one backward pass.

Layers are linear with ReLU (networks of the paper, batch norms folded in) or SiLU (networks on cosines) between them.
As in torch they are computed in the precision of the weights. Nodes that a ReLU has switched off cost nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch

from edition1.kernels.compilation import machine_code
from edition1.sensing.ensemble import SeedEnsemble

_RELU, _SILU = 0, 1


class Layers(NamedTuple):
    """Networks of one architecture."""

    widths: np.ndarray
    """Inputs, nodes of the hidden layers, one output; empty when there is no network."""
    activation: int
    """``_RELU`` or ``_SILU``."""
    weights: np.ndarray
    """``[networks, size]``: for each layer the weights ``[in, out]``, then the biases; single or double precision."""
    network: np.ndarray
    """Network ``[seeds, s]`` of every sensor."""


NO_NETWORK = Layers(np.zeros(0, dtype=np.int64), _RELU, np.zeros((0, 0)), np.zeros((0, 0), dtype=np.int64))


def layers(ensemble: SeedEnsemble) -> Layers:
    """Tables of the networks of several seeds."""
    blocks, widths = [], [ensemble.n_inputs]
    for k in range(ensemble.n_layers):
        W, b = ensemble.get_buffer(f"weight_{k}").detach(), ensemble.get_buffer(f"bias_{k}").detach()
        blocks += [W.flatten(1), b.flatten(1)]
        widths.append(W.shape[-1])
    slots, n_s = ensemble.n_slots, ensemble.n_sensors
    slot = np.empty(n_s, dtype=np.int64)
    slot[ensemble.order or range(n_s)] = np.arange(n_s) // (n_s // slots)
    return Layers(
        np.array(widths),
        _RELU if ensemble.activation is torch.relu else _SILU,
        np.array(torch.cat(blocks, dim=1).cpu().numpy(), order="C"),
        slots * np.arange(ensemble.n_seeds)[:, None] + slot,
    )


@machine_code()
def nodes(layers):
    """Room for one evaluation of ``predict``: values and slopes of the nodes of every layer."""
    widest = 1
    for k in range(len(layers.widths)):
        widest = max(widest, layers.widths[k])
    n = max(len(layers.widths), 1)
    return np.zeros((3, n, widest), dtype=layers.weights.dtype), np.zeros(widest, dtype=np.int64)


@machine_code(reorder=True)
def predict(layers, network, xi, slopes, gradient, room):
    """Reading predicted by one network; its slopes go to ``gradient`` if ``slopes``."""
    hidden, on = room
    value, slope, back = hidden[0], hidden[1], hidden[2]
    widths, weights = layers.widths, layers.weights[network]
    last = len(widths) - 1
    for i in range(widths[0]):
        value[0, i] = xi[i]
    at = 0
    for k in range(last):
        n_in, n_out = widths[k], widths[k + 1]
        _linear(weights, at, n_in, n_out, value[k], value[k + 1], on)
        at += (n_in + 1) * n_out
        if k < last - 1:
            for o in range(n_out):
                z = value[k + 1, o]
                if layers.activation == _RELU:
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


@machine_code(reorder=True)
def _linear(weights, at, n_in, n_out, x, y, on):
    """``y = W x + b``, by four inputs at a time; inputs that are zero are left out."""
    n_on = _nonzero(x, n_in, on)
    bias = weights[at + n_in * n_out : at + (n_in + 1) * n_out]
    for o in range(n_out):
        y[o] = bias[o]
    k = 0
    while k + 4 <= n_on:
        i_0, i_1, i_2, i_3 = on[k], on[k + 1], on[k + 2], on[k + 3]
        x_0, x_1, x_2, x_3 = x[i_0], x[i_1], x[i_2], x[i_3]
        w_0 = weights[at + i_0 * n_out : at + (i_0 + 1) * n_out]
        w_1 = weights[at + i_1 * n_out : at + (i_1 + 1) * n_out]
        w_2 = weights[at + i_2 * n_out : at + (i_2 + 1) * n_out]
        w_3 = weights[at + i_3 * n_out : at + (i_3 + 1) * n_out]
        for o in range(n_out):
            y[o] += x_0 * w_0[o] + x_1 * w_1[o] + x_2 * w_2[o] + x_3 * w_3[o]
        k += 4
    while k < n_on:
        row = weights[at + on[k] * n_out : at + (on[k] + 1) * n_out]
        for o in range(n_out):
            y[o] += x[on[k]] * row[o]
        k += 1


@machine_code(reorder=True)
def _linear_back(weights, at, n_in, n_out, slope, y, x, on):
    """``x = slope * (W^T y)``, two nodes at a time; nodes of slope zero are left out."""
    n_on = _nonzero(slope, n_in, on)
    for i in range(n_in):
        x[i] = 0.0
    for k in range(0, n_on, 2):
        i_0, i_1 = on[k], on[min(k + 1, n_on - 1)]
        w_0 = weights[at + i_0 * n_out : at + (i_0 + 1) * n_out]
        w_1 = weights[at + i_1 * n_out : at + (i_1 + 1) * n_out]
        total_0, total_1 = w_0[0] * y[0], w_1[0] * y[0]  # from here on in the precision of the weights
        for o in range(1, n_out):
            total_0 += w_0[o] * y[o]
            total_1 += w_1[o] * y[o]
        x[i_0], x[i_1] = slope[i_0] * total_0, slope[i_1] * total_1


@machine_code()
def _nonzero(x, n, on):
    """Write the indices of the numbers that are not zero; return how many. Without branches to mispredict."""
    n_on = 0
    for i in range(n):
        on[n_on] = i
        n_on += x[i] != 0.0
    return n_on
