"""Bank of iterated Kalman filters for the rig, one for each bias, as one kernel.

Millimetres, millivolts and seconds inside. The model is that of `edition1_companion.twins.rig_filter`.
"""

from __future__ import annotations

import numpy as np

from edition1.kernels.compilation import machine_code

STATES = 7
"""Bend x, y; its rate; errors of the three sensors."""


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
    """One frame of the filters of all biases, and their mixture; nothing that is given is changed.

    Parameters
    ----------
    frame
        Number of the frame: before the first, 0, nothing moves, and only there ``firsts`` count.
    u
        Readings of the frame ``[3]``; one that is NaN is left out.
    states, moments, log_weights
        Of each filter after the frame before: ``[filters, 7]``, ``[filters, 7, 7]``, ``[filters]``.
    factors, degree, scale
        Factors of the monomials ``[terms, 3]``, their degree, and the unit of the bend in them [mm].
    biases
        Common bias of each filter ``[filters]``.
    firsts
        Bends about which the first update of each filter is linearised ``[filters, 2]``.
    bounds
        Lower and upper bounds of the bend ``[2, 2]``.
    numbers
        Time between frames, time constant of the sensors' errors, density of the acceleration, largest number of
        iterations in an update.
    noise, error
        Standard deviations of the white noise and of the slow error of each sensor.

    Returns
    -------
    states, moments, log_weights, mean, covariance, weights, predicted, square
        Of each filter, then of the mixture: bend and its rate ``[4]``, covariance of the bend with the spread between
        the filters ``[2, 2]``, the weights ``[filters]``, the readings that bend and bias let expect ``[3]``, and the
        mean square of what is left of ``u``, in units of noise and error together.
    """
    dt, tau, acceleration, iterations = numbers
    filters = len(biases)
    new_states, new_moments = np.empty((filters, STATES)), np.empty((filters, STATES, STATES))
    new_logs = np.empty(filters)
    move, driven = _motion(dt, tau, acceleration, error)
    R = np.diag(noise**2)
    H, used = np.zeros((3, STATES)), ~np.isnan(u)
    for b in range(filters):
        mean, P, log_weight = states[b].copy(), moments[b].copy(), log_weights[b]
        if frame:
            mean, P = move @ mean, move @ P @ move.T + driven
        x = mean.copy()
        if frame == 0:
            x[:2] = firsts[b]
        reading = u - biases[b]
        for step in range(int(iterations)):
            predicted = _linearise(x, factors, degree, scale, used, H)
            HP = H @ P
            S = HP @ H.T + R
            innovation = np.where(used, reading - predicted - H @ (mean - x), 0.0)
            gained = np.linalg.solve(S, innovation)
            if step == 0:
                log_weight -= 0.5 * (innovation @ gained + np.log(np.linalg.det(S)))
            new = mean + HP.T @ gained
            for k in range(2):
                new[k] = min(max(new[k], bounds[0, k]), bounds[1, k])
            change = np.abs(new[:2] - x[:2]).max()
            x = new
            if change < 1e-5:
                break
        _linearise(x, factors, degree, scale, used, H)
        HP = H @ P
        P = P - HP.T @ np.linalg.solve(HP @ H.T + R, HP)
        new_states[b] = x
        new_moments[b] = (P + P.T) / 2
        new_logs[b] = log_weight
    mean, covariance, weights = _mixture(new_states, new_moments, new_logs)
    x = np.zeros(STATES)
    x[:2] = mean[:2]
    predicted = _linearise(x, factors, degree, scale, used, H) + weights @ biases
    square = np.nanmean((u - predicted) ** 2 / (noise**2 + error**2))
    return new_states, new_moments, new_logs, mean, covariance, weights, predicted, square


@machine_code()
def bank_estimate(mean, covariance, weights, biases, slopes, spread, elongation, numbers):
    """Configuration and common bias of a mixture; the covariance of bend and elongation is left out.

    Parameters
    ----------
    mean, covariance, weights
        Of the mixture.
    biases
        Common bias of each filter ``[filters]``.
    slopes
        Derivatives of the readings by the bend at the mean ``[3, 2]``.
    spread
        Standard deviation of the bend in T5.train ``[2]``.
    elongation
        Elongation without bend, and its change with the square of the bend ``[2]``.
    numbers
        Change of a reading with the elongation, standard deviations of the elongation and of all that sensors have in
        common, of their difference from the map elsewhere, step between biases, spread of the elongation elsewhere.

    Returns
    -------
    q, covariance, bias, deviation
        Bend and elongation ``[3]``, ``[3, 3]``; the bias proper, and its standard deviation.
    """
    g, spread_l, common, shape_mv, step_mv, elsewhere = numbers
    bend, straight, per_mm2 = mean[:2], elongation[0], elongation[1]
    c = weights @ biases
    c_variance = weights @ biases**2 - c**2 + step_mv**2 / 12
    share = g * spread_l**2 / common**2  # millimetres of elongation for each millivolt of c
    rest = spread_l**2 * (1 - g * share)
    of_bend = covariance + np.linalg.inv(slopes.T @ slopes / shape_mv**2 + np.diag(spread**-2.0))
    by_bend = 2 * per_mm2 * bend
    C = np.zeros((3, 3))
    C[:2, :2] = of_bend
    C[2, 2] = by_bend @ of_bend @ by_bend + rest + share**2 * c_variance + elsewhere**2
    q = np.array([bend[0], bend[1], straight + per_mm2 * (bend * bend).sum() + share * c])
    deviation = np.sqrt(g**2 * rest + (1 - g * share) ** 2 * c_variance)
    return q, C, (1 - g * share) * c, deviation


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
def _linearise(state, factors, degree, scale, used, H):
    """Predicted readings; their derivatives by the state go to ``H``, none of a reading that is not used."""
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
        if not used[s]:
            H[s] = 0.0
    return predicted
