"""One step of the paper's training, as a compiled kernel: what :mod:`edition1.sensing.training` does by autograd.

The network is a vector of parameters in the order of ``network.parameters()``: batch norm of the inputs, four blocks
of linear layer, ReLU and batch norm, a linear layer; dropout comes as factors from outside. Everything is float32,
sums over a batch are float64 over blocks of float32.
"""

from __future__ import annotations

import numpy as np

from edition1.kernels.compilation import machine_code

EPS = 1e-5
"""Added to variances by batch norm, as in torch."""
ROWS = 64
"""Rows that are summed in single precision before they are added in double."""


@machine_code(reorder=True)
def train_step(theta, x, y, widths, masks, work, learning_rate):
    """Move the parameters one step down the mean squared error of a batch; return the error before it.

    Parameters
    ----------
    theta
        Parameters, changed in place.
    x, y
        Inputs and readings of the batch.
    widths
        Nodes: of the inputs, of the four blocks.
    masks
        Factors of the dropout of each block's input, and ones for the output of the last: five arrays.
    work
        Ten arrays: outputs of the four ReLU layers, then masked inputs of the four blocks and of the last layer, and
        one of the size of the largest.
    learning_rate
        Factor of the gradient.
    """
    n = len(x)
    r0, r1, r2, r3, a0, a1, a2, a3, a4, scratch = work
    m0, m1, m2, m3, m4 = masks
    n_in, w0, w1, w2, w3 = widths
    gradient = np.empty_like(theta)
    s0 = 2 * n_in
    s1 = s0 + _size(n_in, w0)
    s2 = s1 + _size(w0, w1)
    s3 = s2 + _size(w1, w2)
    s4 = s3 + _size(w2, w3)
    mean, inverse = _statistics(x)
    _normalise(x, mean, inverse, theta[:n_in], theta[n_in:s0], m0, a0)
    mean0, inverse0 = _forward(theta[s0:s1], n_in, w0, a0, m1, r0, a1)
    mean1, inverse1 = _forward(theta[s1:s2], w0, w1, a1, m2, r1, a2)
    mean2, inverse2 = _forward(theta[s2:s3], w1, w2, a2, m3, r2, a3)
    mean3, inverse3 = _forward(theta[s3:s4], w2, w3, a3, m4, r3, a4)

    weights, bias = theta[s4 : s4 + w3], theta[s4 + w3]
    error = np.dot(a4, weights) + bias - y
    loss = 0.0
    for i in range(n):
        loss += error[i] * error[i]
    error *= np.float32(2.0 / n)
    gradient[s4 : s4 + w3] = np.dot(a4.T, error)
    gradient[s4 + w3] = error.sum()
    for i in range(n):
        for j in range(w3):
            a4[i, j] = error[i] * weights[j]

    # The gradient of a masked input takes the place of that input.
    _backward(theta[s3:s4], gradient[s3:s4], w2, w3, a3, m4, r3, mean3, inverse3, a4, scratch)
    _backward(theta[s2:s3], gradient[s2:s3], w1, w2, a2, m3, r2, mean2, inverse2, a3, scratch)
    _backward(theta[s1:s2], gradient[s1:s2], w0, w1, a1, m2, r1, mean1, inverse1, a2, scratch)
    _backward(theta[s0:s1], gradient[s0:s1], n_in, w0, a0, m1, r0, mean0, inverse0, a1, scratch)
    scale, shift = _sums(a0, m0, x, mean, inverse)
    gradient[:n_in], gradient[n_in:s0] = scale, shift
    for k in range(len(theta)):
        theta[k] -= learning_rate * gradient[k]
    return loss / n


@machine_code()
def _size(n_in, n_out):
    return n_out * n_in + 3 * n_out


@machine_code(reorder=True)
def _statistics(x):
    """Mean of each column and the reciprocal of its standard deviation."""
    n, width = x.shape
    total, part = np.zeros(width), np.zeros(width, np.float32)
    for start in range(0, n, ROWS):
        part[:] = 0
        for i in range(start, min(start + ROWS, n)):
            for j in range(width):
                part[j] += x[i, j]
        total += part
    mean = (total / n).astype(np.float32)
    total[:] = 0
    for start in range(0, n, ROWS):
        part[:] = 0
        for i in range(start, min(start + ROWS, n)):
            for j in range(width):
                apart = x[i, j] - mean[j]
                part[j] += apart * apart
        total += part
    return mean, (1.0 / np.sqrt(total / n + EPS)).astype(np.float32)


@machine_code(reorder=True)
def _normalise(x, mean, inverse, scale, shift, mask, out):
    n, width = x.shape
    factor = scale * inverse
    constant = shift - mean * factor
    for i in range(n):
        for j in range(width):
            out[i, j] = (x[i, j] * factor[j] + constant[j]) * mask[i, j]


@machine_code(reorder=True)
def _forward(theta, n_in, n_out, a, mask, r, out):
    """Linear layer and ReLU into ``r``, batch norm and dropout into ``out``; return the statistics."""
    size = n_in * n_out
    bias = theta[size : size + n_out]
    np.dot(a, theta[:size].reshape(n_out, n_in).T, r)
    for i in range(len(r)):
        for j in range(n_out):
            r[i, j] = max(r[i, j] + bias[j], np.float32(0))
    mean, inverse = _statistics(r)
    _normalise(r, mean, inverse, theta[size + n_out : size + 2 * n_out], theta[size + 2 * n_out :], mask, out)
    return mean, inverse


@machine_code(reorder=True)
def _sums(d, mask, r, mean, inverse):
    """Gradients of scale and shift of a batch norm whose masked output has the gradient ``d``."""
    n, width = r.shape
    scale, shift = np.zeros(width), np.zeros(width)
    part, other = np.zeros(width, np.float32), np.zeros(width, np.float32)
    for start in range(0, n, ROWS):
        part[:] = 0
        other[:] = 0
        for i in range(start, min(start + ROWS, n)):
            for j in range(width):
                value = d[i, j] * mask[i, j]
                other[j] += value
                part[j] += value * (r[i, j] - mean[j]) * inverse[j]
        scale += part
        shift += other
    return scale.astype(np.float32), shift.astype(np.float32)


@machine_code(reorder=True)
def _backward(theta, gradient, n_in, n_out, a, mask, r, mean, inverse, d, scratch):
    """From the gradient ``d`` of a block's masked output to that of its masked input, which takes its place."""
    n, size = len(r), n_in * n_out
    scale, shift = _sums(d, mask, r, mean, inverse)
    gradient[size + n_out : size + 2 * n_out], gradient[size + 2 * n_out :] = scale, shift
    factor = theta[size + n_out : size + 2 * n_out] * inverse
    shift, scale = shift / np.float32(n), scale * inverse / np.float32(n)
    zero = np.float32(0)
    for i in range(n):
        for j in range(n_out):
            value = factor[j] * (d[i, j] * mask[i, j] - shift[j] - (r[i, j] - mean[j]) * scale[j])
            d[i, j] = value if r[i, j] > zero else zero
    bias = gradient[size : size + n_out]
    bias[:] = 0
    for i in range(n):
        for j in range(n_out):
            bias[j] += d[i, j]
    np.dot(d.T, a, gradient[:size].reshape(n_out, n_in))
    new = scratch[: n * n_in].reshape(n, n_in)
    np.dot(d, theta[:size].reshape(n_out, n_in), new)
    a[:] = new
