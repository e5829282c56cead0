"""How fast a core computes: kernels that do one kind of operation over and over, and nothing else."""

from __future__ import annotations

import math

from edition1.kernels.compilation import machine_code

CHAINS = 8
"""Sums that ``multiply_add`` keeps at once: enough for a processor to start two every cycle."""
TERMS = 32
"""Multiplications and additions that ``polynomial`` does for every number."""


@machine_code(reorder=True)
def multiply_add(x, y, n):
    """Multiply and add ``CHAINS * n`` times, one number at a time."""
    a, b, c, d, e, f, g, h = y, y, y, y, y, y, y, y
    for _ in range(n):
        a = a * x + y
        b = b * x + y
        c = c * x + y
        d = d * x + y
        e = e * x + y
        f = f * x + y
        g = g * x + y
        h = h * x + y
    return a + b + c + d + e + f + g + h


@machine_code(reorder=True)
def polynomial(x, out, coefficients):
    """Multiply and add ``TERMS * len(x)`` times, several numbers at a time."""
    c_0, c_1, c_2, c_3 = coefficients[0], coefficients[1], coefficients[2], coefficients[3]
    for i in range(len(x)):
        t = x[i]
        p = c_0
        p = ((p * t + c_1) * t + c_2) * t + c_3
        p = (((p * t + c_0) * t + c_1) * t + c_2) * t + c_3
        p = (((p * t + c_0) * t + c_1) * t + c_2) * t + c_3
        p = (((p * t + c_0) * t + c_1) * t + c_2) * t + c_3
        p = (((p * t + c_0) * t + c_1) * t + c_2) * t + c_3
        p = (((p * t + c_0) * t + c_1) * t + c_2) * t + c_3
        p = (((p * t + c_0) * t + c_1) * t + c_2) * t + c_3
        p = (((p * t + c_0) * t + c_1) * t + c_2) * t + c_3
        out[i] = p * t


@machine_code()
def divide(x):
    """Divide ``len(x)`` times."""
    total = 0.0
    for i in range(len(x)):
        total += 1.0 / x[i]
    return total


@machine_code()
def root(x):
    """Take ``len(x)`` square roots."""
    total = 0.0
    for i in range(len(x)):
        total += math.sqrt(x[i])
    return total


@machine_code()
def sine(x):
    """Take ``len(x)`` sines."""
    total = 0.0
    for i in range(len(x)):
        total += math.sin(x[i])
    return total


@machine_code()
def cosine(x):
    """Take ``len(x)`` cosines."""
    total = 0.0
    for i in range(len(x)):
        total += math.cos(x[i])
    return total


@machine_code()
def exponential(x):
    """Take ``len(x)`` exponentials."""
    total = 0.0
    for i in range(len(x)):
        total += math.exp(x[i])
    return total


@machine_code()
def logarithm(x):
    """Take ``len(x)`` logarithms."""
    total = 0.0
    for i in range(len(x)):
        total += math.log(x[i])
    return total


@machine_code()
def arctangent(x):
    """Take ``len(x)`` arctangents of two arguments."""
    total = 0.0
    for i in range(len(x)):
        total += math.atan2(x[i], 0.7)
    return total
