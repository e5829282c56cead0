"""Bank of iterated Kalman filters for the rig, one for each bias, as one kernel.

Millimetres, millivolts and seconds inside. The model is that of `repro_companion.twins.rig_filter`.
"""

from __future__ import annotations

import numpy as np

from repro.kernels.compilation import machine_code

STATES = 7
"""Bend x, y; its rate; errors of the three sensors."""


@machine_code()
def filter_bank(
    u, factors, degree, scale, biases, log_weights, firsts, start, spread, bounds, numbers, noise, error
):
    """Mixture of the filters of all biases, for every frame from the readings up to it: a loop over `bank_step`.

    Parameters
    ----------
    u
        Readings ``[frames, 3]``.
    factors, degree, scale
        Factors of the monomials ``[terms, 3]``, their degree, and the unit of the bend in them [mm].
    biases, log_weights
        Common bias of each filter, and the logarithm of its prior weight ``[filters]``.
    firsts
        Bends about which the first update of each filter is linearised ``[filters, 2]``.
    start, spread
        Mean and standard deviation of the state before the first reading ``[7]``.
    bounds
        Lower and upper bounds of the bend ``[2, 2]``.
    numbers
        Time between frames, time constant of the sensors' errors, density of the acceleration, largest number of
        iterations in an update.
    noise, error
        Standard deviations of the white noise and of the slow error of each sensor.

    Returns
    -------
    means, covariances, weights
        Bend and its rate ``[frames, 4]``, covariance of the bend with the spread between the filters
        ``[frames, 2, 2]``, and the weights ``[frames, filters]``.
    """
    frames, filters = len(u), len(biases)
    means, covariances = np.empty((frames, 4)), np.empty((frames, 2, 2))
    weights = np.empty((frames, filters))
    states, moments = bank_start(filters, start, spread)
    logs = log_weights
    for t in range(frames):
        states, moments, logs, means[t], covariances[t], weights[t] = bank_step(
            t,
            u[t],
            states,
            moments,
            logs,
            factors,
            degree,
            scale,
            biases,
            firsts,
            bounds,
            numbers,
            noise,
            error,
        )
    return means, covariances, weights


@machine_code()
def bank_start(filters, start, spread):
    """State and covariance of each filter before the first reading ``[filters, 7]``, ``[filters, 7, 7]``."""
    states, moments = np.empty((filters, STATES)), np.empty((filters, STATES, STATES))
    for b in range(filters):
        states[b] = start
        moments[b] = np.diag(spread**2)
    return states, moments


@machine_code()
def bank_step(
    frame,
    u,
    states,
    moments,
    log_weights,
    factors,
    degree,
    scale,
    biases,
    firsts,
    bounds,
    numbers,
    noise,
    error,
):
    """One frame of :func:`filter_bank`; nothing that is given is changed.

    Parameters
    ----------
    frame
        Number of the frame: before the first, 0, nothing moves, and only there ``firsts`` count.
    u
        Readings of the frame ``[3]``.
    states, moments, log_weights
        Of each filter after the frame before: ``[filters, 7]``, ``[filters, 7, 7]``, ``[filters]``.
    factors, degree, scale, biases, firsts, bounds, numbers, noise, error
        As in :func:`filter_bank`.

    Returns
    -------
    states, moments, log_weights, mean, covariance, weights
        Of each filter, then of the mixture ``[4]``, ``[2, 2]``, and the weights ``[filters]``.
    """
    dt, tau, acceleration, iterations = numbers
    filters = len(biases)
    new_states, new_moments = np.empty((filters, STATES)), np.empty((filters, STATES, STATES))
    new_logs = np.empty(filters)
    move, driven = _motion(dt, tau, acceleration, error)
    R = np.diag(noise**2)
    H = np.zeros((3, STATES))
    for b in range(filters):
        mean, P, log_weight = states[b].copy(), moments[b].copy(), log_weights[b]
        if frame:
            mean, P = move @ mean, move @ P @ move.T + driven
        x = mean.copy()
        if frame == 0:
            x[:2] = firsts[b]
        reading = u - biases[b]
        for step in range(int(iterations)):
            predicted = _linearise(x, factors, degree, scale, H)
            HP = H @ P
            S = HP @ H.T + R
            innovation = reading - predicted - H @ (mean - x)
            if step == 0:
                surprise = innovation @ np.linalg.solve(S, innovation) + np.log(np.linalg.det(S))
                log_weight -= 0.5 * surprise
            new = mean + HP.T @ np.linalg.solve(S, innovation)
            for k in range(2):
                new[k] = min(max(new[k], bounds[0, k]), bounds[1, k])
            change = np.abs(new[:2] - x[:2]).max()
            x = new
            if change < 1e-5:
                break
        _linearise(x, factors, degree, scale, H)
        HP = H @ P
        P = P - HP.T @ np.linalg.solve(HP @ H.T + R, HP)
        new_states[b] = x
        new_moments[b] = (P + P.T) / 2
        new_logs[b] = log_weight
    mean, covariance, weights = _mixture(new_states, new_moments, new_logs)
    return new_states, new_moments, new_logs, mean, covariance, weights


@machine_code()
def _mixture(states, moments, log_weights):
    """Mean of bend and rate, covariance of the bend, and the weights of the filters."""
    likely = np.exp(log_weights - log_weights.max())
    weights = likely / likely.sum()
    mean, covariance = np.zeros(4), np.zeros((2, 2))
    for b in range(len(weights)):
        mean += weights[b] * states[b, :4]
    for b in range(len(weights)):
        apart = states[b, :2] - mean[:2]
        covariance += weights[b] * (moments[b, :2, :2] + np.outer(apart, apart))
    return mean, covariance, weights


@machine_code()
def _motion(dt, tau, acceleration, error):
    """Transition of the state from frame to frame, and the covariance that is added."""
    move, driven = np.eye(STATES), np.zeros((STATES, STATES))
    keep = np.exp(-dt / tau)
    for k in range(2):
        move[k, 2 + k] = dt
        driven[k, k] = acceleration**2 * dt**3 / 3
        driven[k, 2 + k] = driven[2 + k, k] = acceleration**2 * dt**2 / 2
        driven[2 + k, 2 + k] = acceleration**2 * dt
    for j in range(3):
        move[4 + j, 4 + j] = keep
        driven[4 + j, 4 + j] = error[j] ** 2 * (1 - keep**2)
    return move, driven


@machine_code()
def _linearise(state, factors, degree, scale, H):
    """Predicted readings; their derivatives by the state go to ``H``."""
    x, y = state[0] / scale, state[1] / scale
    across, up = np.ones(degree + 1), np.ones(degree + 1)
    for k in range(degree):
        across[k + 1] = across[k] * x
        up[k + 1] = up[k] * y
    predicted = state[4:].copy()
    H[:, :2] = 0.0
    n = 0
    for total in range(degree + 1):
        for j in range(total + 1):
            i = total - j
            by_x = i * across[max(i - 1, 0)] * up[j] / scale
            by_y = j * across[i] * up[max(j - 1, 0)] / scale
            for s in range(3):
                predicted[s] += factors[n, s] * across[i] * up[j]
                H[s, 0] += factors[n, s] * by_x
                H[s, 1] += factors[n, s] * by_y
            n += 1
    for s in range(3):
        H[s, 4 + s] = 1.0
    return predicted
